"""The small Gaussians of FastSLAM: a motion, a pose before it is drawn, a landmark given the pose.

All covariances may be singular; nothing but innovation covariances is ever inverted.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ekfslam.compiled import compiled
from ekfslam.filters.kernels import wrap
from ekfslam.models.sensors import RANGE_BEARING

ROUNDING = 1e-14  # of a pivot, relative to the variance it is left of
LOG_TAU = math.log(2.0 * math.pi)


@compiled
def square_root(P, L):  # type: ignore[no-untyped-def]
    """Lower L with ``P = L L'``, of a 3 x 3 covariance that may be singular.

    A pivot that is nothing beside its variance is zero, and so is the column below it.
    """
    for j in range(3):
        for i in range(j):
            L[i, j] = 0.0
        pivot = P[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        if not pivot > ROUNDING * P[j, j]:
            for i in range(j, 3):
                L[i, j] = 0.0
            continue
        L[j, j] = math.sqrt(pivot)
        for i in range(j + 1, 3):
            total = P[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total / L[j, j]


@compiled
def turned(Q, heading, P):  # type: ignore[no-untyped-def]
    """Covariance of an increment (3, 3) in the world: P = B Q B', B the heading's rotation.

    Given the pose before, ``pose * delta`` is linear in delta, so that this is exact.
    """
    c, s = math.cos(heading), math.sin(heading)
    P[0, 0] = c * c * Q[0, 0] - 2.0 * c * s * Q[0, 1] + s * s * Q[1, 1]
    P[0, 1] = P[1, 0] = c * s * (Q[0, 0] - Q[1, 1]) + (c * c - s * s) * Q[0, 1]
    P[1, 1] = s * s * Q[0, 0] + 2.0 * c * s * Q[0, 1] + c * c * Q[1, 1]
    P[0, 2] = P[2, 0] = c * Q[0, 2] - s * Q[1, 2]
    P[1, 2] = P[2, 1] = s * Q[0, 2] + c * Q[1, 2]
    P[2, 2] = Q[2, 2]


@compiled
def drawn(mean, heading, L, normals, pose):  # type: ignore[no-untyped-def]
    """``pose = mean + B L normals``: a pose whose spread is given in a frame of some heading.

    Roots are taken in the frame of the robot, so that a world that is moved moves all that is
    drawn.

    Parameters
    ----------
    mean : (3,) ndarray
    heading : float
        Of the frame, in the world.
    L : (3, 3) ndarray
        Lower triangle: root of the covariance in that frame.
    normals : (3,) ndarray
    pose : (3,) ndarray
        Written, its heading wrapped.
    """
    x = L[0, 0] * normals[0]
    y = L[1, 0] * normals[0] + L[1, 1] * normals[1]
    turn = L[2, 0] * normals[0] + L[2, 1] * normals[1] + L[2, 2] * normals[2]
    c, s = math.cos(heading), math.sin(heading)
    pose[0], pose[1] = mean[0] + c * x - s * y, mean[1] + s * x + c * y
    pose[2] = wrap(mean[2] + turn)


class View(NamedTuple):
    """A point as a pose should see it, with derivatives; numbers alone, which stay in registers.

    Attributes
    ----------
    first, second : float
        What is expected: range and bearing, or x and y.
    xx, xy, yx, yy : float
        Derivative of the first and of the second with respect to the point: H_m, and with the
        other sign with respect to the robot's position.
    x_turn, y_turn : float
        Derivatives with respect to its heading.
    """

    first: float
    second: float
    xx: float
    xy: float
    yx: float
    yy: float
    x_turn: float
    y_turn: float


@compiled
def view(kind, sensor, x, y):  # type: ignore[no-untyped-def]
    """Direct model of a full view of a point; `ekfslam.filters.measure.expect` in numbers.

    Parameters
    ----------
    kind : int
        Code of the view.
    sensor : tuple
        Of `placed`.
    x, y : float
        The point.
    """
    sensor_x, sensor_y, c, s, lever_x, lever_y = sensor
    dx, dy = x - sensor_x, y - sensor_y
    u, w = c * dx + s * dy, c * dy - s * dx  # in the sensor
    if kind == RANGE_BEARING:
        square = dx * dx + dy * dy
        r = math.sqrt(square)
        inverse = 1.0 / r
        mx, my = dx * inverse, dy * inverse
        nx, ny = -my * inverse, mx * inverse
        # The heading swings the sensor about the robot, and turns its frame.
        turns = mx * lever_y - my * lever_x, nx * lever_y - ny * lever_x - 1.0
        return View(r, math.atan2(w, u), mx, my, nx, ny, turns[0], turns[1])
    turns = c * lever_y - s * lever_x + w, -s * lever_y - c * lever_x - u
    return View(u, w, c, s, -s, c, turns[0], turns[1])


@compiled
def innovation(kind, value, seen):  # type: ignore[no-untyped-def]
    """Measured minus expected, the bearing wrapped."""
    off = value[1] - seen.second
    return value[0] - seen.first, wrap(off) if kind == RANGE_BEARING else off


@compiled
def spread(seen, g, R):  # type: ignore[no-untyped-def]
    """``S = H_m Sigma H_m' + R``: what a sighting's covariance is where the pose is certain.

    Parameters
    ----------
    seen : View
    g : (5,) ndarray
        The landmark, see `Maps`.
    R : (2, 2) ndarray

    Returns
    -------
    tuple
        Entries 00, 01, 11.
    """
    ax, ay = seen.xx * g[2] + seen.xy * g[3], seen.xx * g[3] + seen.xy * g[4]
    cx, cy = seen.yx * g[2] + seen.yy * g[3], seen.yx * g[3] + seen.yy * g[4]
    return (
        ax * seen.xx + ay * seen.xy + R[0, 0],
        ax * seen.yx + ay * seen.yy + R[0, 1],
        cx * seen.yx + cy * seen.yy + R[1, 1],
    )


@compiled
def toward(seen, P):  # type: ignore[no-untyped-def]
    """``P H_x'`` of a pose's covariance (3, 3), its two columns."""
    a, b, t = -seen.xx, -seen.xy, seen.x_turn
    c, d, s = -seen.yx, -seen.yy, seen.y_turn
    return (
        P[0, 0] * a + P[0, 1] * b + P[0, 2] * t,
        P[0, 1] * a + P[1, 1] * b + P[1, 2] * t,
        P[0, 2] * a + P[1, 2] * b + P[2, 2] * t,
        P[0, 0] * c + P[0, 1] * d + P[0, 2] * s,
        P[0, 1] * c + P[1, 1] * d + P[1, 2] * s,
        P[0, 2] * c + P[1, 2] * d + P[2, 2] * s,
    )


@compiled
def wider(S, seen, PH):  # type: ignore[no-untyped-def]
    """``S + H_x P H_x'``: the spread where the pose is uncertain too, with PH of `toward`."""
    u0, u1, u2, w0, w1, w2 = PH
    return (
        S[0] - seen.xx * u0 - seen.xy * u1 + seen.x_turn * u2,
        S[1] - seen.xx * w0 - seen.xy * w1 + seen.x_turn * w2,
        S[2] - seen.yx * w0 - seen.yy * w1 + seen.y_turn * w2,
    )


@compiled
def inverse(S):  # type: ignore[no-untyped-def]
    """Entries of the inverse of S, and its determinant; that is NaN if S is not positive definite.

    The entries are then zero, and a correction with them changes nothing.
    """
    determinant = S[0] * S[2] - S[1] * S[1]
    if not (determinant > 0.0 and S[0] > 0.0 and determinant < np.inf):
        return 0.0, 0.0, 0.0, np.nan
    scale = 1.0 / determinant
    return S[2] * scale, -S[1] * scale, S[0] * scale, determinant


@compiled
def distance(nu, inverted):  # type: ignore[no-untyped-def]
    """Squared Mahalanobis distance ``nu' S^-1 nu`` of an innovation, NaN where there is none."""
    i00, i01, i11, determinant = inverted
    squared = i00 * nu[0] * nu[0] + 2.0 * i01 * nu[0] * nu[1] + i11 * nu[1] * nu[1]
    return squared if determinant > 0.0 else np.nan


@compiled
def log_likelihood(nu, inverted):  # type: ignore[no-untyped-def]
    """Logarithm of N(nu; 0, S): minus infinity where S is not positive definite.

    The exponent is ``nu' S^-1 nu``. Alg. 3 of Principles of Robot Autonomy has the inverse of the
    measurement noise there, and its first factor is to be transposed.
    """
    squared = distance(nu, inverted)
    if not squared < np.inf:
        return -np.inf
    return -0.5 * (squared + math.log(inverted[3])) - LOG_TAU


@compiled
def correct_landmark(seen, g, nu, inverted):  # type: ignore[no-untyped-def]
    """EKF of one landmark given the pose (Alg. 3: K, mu and Sigma), with S of the landmark alone.

    Parameters
    ----------
    seen : View
    g : (5,) ndarray
        The landmark; changed.
    nu, inverted
        Innovation, and `inverse` of S.
    """
    i00, i01, i11, determinant = inverted
    if not determinant > 0.0:
        return
    # Sigma H'
    x0, x1 = g[2] * seen.xx + g[3] * seen.xy, g[2] * seen.yx + g[3] * seen.yy
    y0, y1 = g[3] * seen.xx + g[4] * seen.xy, g[3] * seen.yx + g[4] * seen.yy
    kx0, kx1 = x0 * i00 + x1 * i01, x0 * i01 + x1 * i11
    ky0, ky1 = y0 * i00 + y1 * i01, y0 * i01 + y1 * i11
    g[0] += kx0 * nu[0] + kx1 * nu[1]
    g[1] += ky0 * nu[0] + ky1 * nu[1]
    g[2] -= kx0 * x0 + kx1 * x1
    g[3] -= kx0 * y0 + kx1 * y1
    g[4] -= ky0 * y0 + ky1 * y1


@compiled
def correct_pose(mean, P, PH, nu, inverted):  # type: ignore[no-untyped-def]
    """Fuse a sighting into the proposal, in covariance form (Montemerlo et al. 2003).

    Parameters
    ----------
    mean, P : (3,) and (3, 3) ndarray
        Changed: ``K = P H_x' S^-1``, ``mean += K nu``, ``P -= K S K'``.
    PH : tuple
        Of `toward`.
    nu, inverted
        Innovation, and `inverse` of S, which has the spread of landmark and pose.
    """
    i00, i01, i11, determinant = inverted
    if not determinant > 0.0:
        return
    u0, u1, u2, w0, w1, w2 = PH
    k00, k01 = u0 * i00 + w0 * i01, u0 * i01 + w0 * i11
    k10, k11 = u1 * i00 + w1 * i01, u1 * i01 + w1 * i11
    k20, k21 = u2 * i00 + w2 * i01, u2 * i01 + w2 * i11
    mean[0] += k00 * nu[0] + k01 * nu[1]
    mean[1] += k10 * nu[0] + k11 * nu[1]
    mean[2] = wrap(mean[2] + k20 * nu[0] + k21 * nu[1])
    P[0, 0] -= k00 * u0 + k01 * w0
    P[1, 1] -= k10 * u1 + k11 * w1
    P[2, 2] -= k20 * u2 + k21 * w2
    P[0, 1] = P[1, 0] = P[0, 1] - (k00 * u1 + k01 * w1)
    P[0, 2] = P[2, 0] = P[0, 2] - (k00 * u2 + k01 * w2)
    P[1, 2] = P[2, 1] = P[1, 2] - (k10 * u2 + k11 * w2)


@compiled
def moments(poses, weights, mean, covariance):  # type: ignore[no-untyped-def]
    """Mean and covariance of weighted poses; the heading's mean is that of directions.

    Parameters
    ----------
    poses : (N, 3) ndarray
    weights : (N,) ndarray
        Normalised.
    mean : (3,) ndarray
        Written.
    covariance : (3, 3) ndarray
        Written: of (x, y, theta), headings wrapped about their mean.
    """
    x = y = c = s = 0.0
    for i in range(weights.size):
        w = weights[i]
        x += w * poses[i, 0]
        y += w * poses[i, 1]
        c += w * math.cos(poses[i, 2])
        s += w * math.sin(poses[i, 2])
    mean[0], mean[1], mean[2] = x, y, wrap(math.atan2(s, c))
    covariance[:] = 0.0
    for i in range(weights.size):
        w, dx, dy = weights[i], poses[i, 0] - x, poses[i, 1] - y
        turn = wrap(poses[i, 2] - mean[2])
        covariance[0, 0] += w * dx * dx
        covariance[0, 1] += w * dx * dy
        covariance[0, 2] += w * dx * turn
        covariance[1, 1] += w * dy * dy
        covariance[1, 2] += w * dy * turn
        covariance[2, 2] += w * turn * turn
    for a in range(3):
        for b in range(a):
            covariance[a, b] = covariance[b, a]
