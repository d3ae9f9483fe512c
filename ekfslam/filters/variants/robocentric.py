"""Robocentric EKF (Castellanos et al. 2004, 2007): the map is kept in the frame of the robot.

The state is (u, b, q_1, ..., q_N): the increment u since the frame was last moved, and in that
frame the pose b of the start and the landmarks q. The increment stands where other filters have the
pose, so motion, association, correction and new landmarks are those of the plain filter; then the
frame is moved along the corrected increment. What is uncertain is near: linearisation errors do not
grow with the distance from the start.
"""

from __future__ import annotations

import math

import numpy as np

from ekfslam.compiled import compiled
from ekfslam.filters.kernels import wrap

BASE, MAP = 3, 6  # where the pose of the start stands, and the first landmark


@compiled
def place(k):  # type: ignore[no-untyped-def]
    """Offset of the k-th pair of coordinates: of the start, then of the landmarks."""
    return BASE if k == 0 else MAP + 2 * (k - 1)


@compiled
def compose(mean, P, n):  # type: ignore[no-untyped-def]
    """Move the frame along u: ``q = R' (q - d)``, likewise b, and u becomes exactly 0; O(n^2).

    With C = R(dtheta)', the derivative of every pair of coordinates is ``C`` with respect to
    itself, ``-C`` to d, and ``-J q`` to dtheta; that of the start's heading is 1 and -1.
    """
    dx, dy, turn = mean[0], mean[1], mean[2]
    certain = P[0, 0] == 0.0 and P[1, 1] == 0.0 and P[2, 2] == 0.0
    if certain and dx == 0.0 and dy == 0.0 and turn == 0.0:
        return  # the frame is where the robot is
    c, s = math.cos(turn), math.sin(turn)
    pairs = 1 + (n - MAP) // 2
    U = np.zeros((3, n))  # derivative with respect to u, transposed
    for k in range(pairs):
        i = place(k)
        x, y = mean[i] - dx, mean[i + 1] - dy
        mean[i], mean[i + 1] = c * x + s * y, c * y - s * x
        U[0, i], U[1, i], U[2, i] = -c, -s, mean[i + 1]
        U[0, i + 1], U[1, i + 1], U[2, i + 1] = s, -c, -mean[i]
    mean[BASE + 2] = wrap(mean[BASE + 2] - turn)
    U[2, BASE + 2] = -1.0
    turn_pairs(P, n, pairs, c, s)
    E = np.empty((3, n))  # P_u C' + P_uu U' / 2, so that what u adds is U E + (U E)'
    for a in range(3):
        for j in range(n):
            E[a, j] = P[a, j]
            for b in range(3):
                E[a, j] += 0.5 * P[min(a, b), max(a, b)] * U[b, j]
    for i in range(BASE, n):
        row = P[i, i:n]
        u0, u1, u2, e0, e1, e2 = U[0, i:n], U[1, i:n], U[2, i:n], E[0, i:n], E[1, i:n], E[2, i:n]
        a0, a1, a2, b0, b1, b2 = u0[0], u1[0], u2[0], e0[0], e1[0], e2[0]
        for j in range(row.size):
            row[j] += a0 * e0[j] + a1 * e1[j] + a2 * e2[j] + b0 * u0[j] + b1 * u1[j] + b2 * u2[j]
    for a in range(3):
        mean[a] = 0.0
        P[a, :n] = 0.0


@compiled
def turn_pairs(P, n, pairs, c, s):  # type: ignore[no-untyped-def]
    """``C P C'`` on every pair of coordinates, on the triangle."""
    for row in range(n):
        values = P[row]
        after = 0 if row < BASE else 1 if row < MAP else (row - MAP) // 2 + 2
        for k in range(after, pairs):
            i = place(k)
            x, y = values[i], values[i + 1]
            values[i], values[i + 1] = c * x + s * y, c * y - s * x
    for k in range(pairs):
        i = place(k)
        upper, lower = P[i, i + 2 : n], P[i + 1, i + 2 : n]
        for j in range(upper.size):
            x, y = upper[j], lower[j]
            upper[j], lower[j] = c * x + s * y, c * y - s * x
        xx, xy, yy = P[i, i], P[i, i + 1], P[i + 1, i + 1]
        P[i, i] = c * c * xx + 2.0 * c * s * xy + s * s * yy
        P[i, i + 1] = c * s * (yy - xx) + (c * c - s * s) * xy
        P[i + 1, i + 1] = s * s * xx - 2.0 * c * s * xy + c * c * yy


@compiled
def pose_of(start, mean, P, pose, covariance):  # type: ignore[no-untyped-def]
    """The pose of the robot in the world, and its additive covariance.

    Parameters
    ----------
    start : (>= 3,) ndarray
        Mean of the prior, which the start stands for.
    mean, P
        The map, between two steps: u is 0.
    pose : (3,) ndarray
        Written.
    covariance : (3, 3) ndarray
        Written.
    """
    x, y, heading = mean[BASE], mean[BASE + 1], -mean[BASE + 2]
    c, s = math.cos(heading), math.sin(heading)
    px, py = s * y - c * x, -s * x - c * y  # in the frame of the start
    c0, s0 = math.cos(start[2]), math.sin(start[2])
    pose[0] = start[0] + c0 * px - s0 * py
    pose[1] = start[1] + s0 * px + c0 * py
    pose[2] = wrap(start[2] + heading)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    A = np.zeros((3, 3))  # of the pose with respect to b
    A[0, 0], A[0, 1], A[0, 2] = -c, s, pose[1] - start[1]
    A[1, 0], A[1, 1], A[1, 2] = -s, -c, start[0] - pose[0]
    A[2, 2] = -1.0
    for i in range(3):
        for j in range(i, 3):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += A[i, a] * P[BASE + min(a, b), BASE + max(a, b)] * A[j, b]
            covariance[i, j] = covariance[j, i] = total
