"""Right-invariant EKF on SE_{1+N}(2) (Barrau and Bonnabel 2015; Zhang et al. 2017).

The error is ``X = Exp(xi) estimate``: the heading error turns robot and map about the origin as
one. In these coordinates neither the motion nor the observation of a landmark has a Jacobian that
depends on the estimate, so that nothing needs to be chosen. Nor does it matter where the origin is,
but to round-off: the start is put there, however far from that of the world it is.
"""

from __future__ import annotations

import math

import numpy as np

from ekfslam.compiled import compiled
from ekfslam.filters.kernels import advance, wrap


@compiled
def move(mean, P, n, delta, Q):  # type: ignore[no-untyped-def]
    """Robot motion: the error stays as it is, and gains ``G Q G'``; O(n^2).

    G turns the noise of the position by the heading before the motion; the noise of the heading
    swings the position after it, and every landmark, about the origin.
    """
    c, s = math.cos(mean[2]), math.sin(mean[2])
    advance(mean, 0, delta)
    swing = np.empty(n)  # column of G of the heading
    swing[0], swing[1], swing[2] = mean[1], -mean[0], 1.0
    for l in range(3, n, 2):
        swing[l], swing[l + 1] = mean[l + 1], -mean[l]
    if Q[2, 2] > 0.0:
        for i in range(n):
            row, factor, rest = P[i, i:n], Q[2, 2] * swing[i], swing[i:]
            for j in range(row.size):
                row[j] += factor * rest[j]
    # The noise of the position, in the world, and its covariance with that of the heading.
    P[0, 0] += c * c * Q[0, 0] - 2.0 * c * s * Q[0, 1] + s * s * Q[1, 1]
    P[0, 1] += c * s * (Q[0, 0] - Q[1, 1]) + (c * c - s * s) * Q[0, 1]
    P[1, 1] += s * s * Q[0, 0] + 2.0 * c * s * Q[0, 1] + c * c * Q[1, 1]
    ax, ay = c * Q[0, 2] - s * Q[1, 2], s * Q[0, 2] + c * Q[1, 2]
    for j in range(n):
        P[0, j] += ax * swing[j]
        if j > 0:
            P[1, j] += ay * swing[j]
    P[0, 0] += swing[0] * ax
    P[0, 1] += swing[0] * ay
    P[1, 1] += swing[1] * ay


@compiled
def exponential(angle):  # type: ignore[no-untyped-def]
    """(sin a / a, (1 - cos a) / a): what turns a constant velocity into the chord of its arc."""
    if abs(angle) < 1e-4:
        square = angle * angle
        return 1.0 - square / 6.0, angle * (0.5 - square / 24.0)
    return math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle


@compiled
def retract(mean, step, n):  # type: ignore[no-untyped-def]
    """``Exp(step) * mean``: the step turns and moves the robot and every landmark."""
    c, s = math.cos(step[2]), math.sin(step[2])
    along, across = exponential(step[2])
    mean[2] = wrap(mean[2] + step[2])
    for k in range((n - 1) // 2):
        at = 0 if k == 0 else 2 * k + 1  # the heading stands between the position and the map
        x, y, dx, dy = mean[at], mean[at + 1], step[at], step[at + 1]
        mean[at] = c * x - s * y + along * dx - across * dy
        mean[at + 1] = s * x + c * y + across * dx + along * dy


@compiled
def additive(mean, P, at, size, out):  # type: ignore[no-untyped-def]
    """Covariance of the pose, or of a landmark, in additive (x, y, theta): ``T P T'``.

    Parameters
    ----------
    at, size : int
        0 and 3, or the offset of a landmark and 2.
    out : (size, size) ndarray
        Written.
    """
    heading = P[2, 2]
    turn = np.zeros(3)  # column of T of the heading, less the identity
    turn[0], turn[1] = -mean[at + 1], mean[at]
    for i in range(size):
        for j in range(i, size):
            a, b = at + i, at + j
            with_a = P[min(a, 2), max(a, 2)]
            with_b = P[min(b, 2), max(b, 2)]
            value = P[a, b] + turn[i] * with_b + with_a * turn[j] + turn[i] * heading * turn[j]
            out[i, j] = out[j, i] = value


@compiled
def pose_of(origin, mean, P, pose, covariance):  # type: ignore[no-untyped-def]
    """The pose of the robot in the world, and its additive covariance.

    Parameters
    ----------
    origin : (>= 2,) ndarray
        Of the errors, in the world.
    mean, P
        The map.
    pose : (3,) ndarray
        Written.
    covariance : (3, 3) ndarray
        Written.
    """
    pose[0], pose[1], pose[2] = mean[0] + origin[0], mean[1] + origin[1], mean[2]
    additive(mean, P, 0, 3, covariance)
