"""The four operations of the map on one triangle of the covariance (Solà, Table 1).

State: poses (x, y, theta) of the robots first, then landmarks; each is found by the offset of its
first coordinate. Covariance: the upper triangle of a square array, ``P[i, j]`` with ``i <= j < n``;
what lies below the diagonal is never read. So the covariance is symmetric by construction.

Inner loops run over slices from their start: the compiler then knows that no index is negative,
and vectorises them.
"""

from __future__ import annotations

import math

import numpy as np

from ekfslam.compiled import compiled, lean
from ekfslam.filters.triangle import add_both_rows, add_rows, downdate


@lean
def wrap(angle: float) -> float:
    """Angle in [-pi, pi); see `ekfslam.geometry.wrap`."""
    if -math.pi <= angle < math.pi:
        return angle
    wrapped = angle - 2.0 * math.pi * np.floor((angle + math.pi) / (2.0 * math.pi))
    if wrapped >= math.pi:
        return wrapped - 2.0 * math.pi
    return max(wrapped, -math.pi)


# Robot motion -----------------------------------------------------------------------------------


@lean
def advance(mean, at, delta):  # type: ignore[no-untyped-def]
    """The mean of a robot's motion: ``pose * delta`` (Solà, Eq. 14; Ciatto, Eq. 3.1).

    Parameters
    ----------
    mean : (capacity,) ndarray
    at : int
        First coordinate of the robot's pose.
    delta : (3,) ndarray
        Body increment.
    """
    c, s = math.cos(mean[at + 2]), math.sin(mean[at + 2])
    mean[at] += c * delta[0] - s * delta[1]
    mean[at + 1] += s * delta[0] + c * delta[1]
    mean[at + 2] = wrap(mean[at + 2] + delta[2])


@lean
def disperse(P, n, at, dx, dy, heading, Q):  # type: ignore[no-untyped-def]
    """The covariance of a robot's motion (Solà, Eqs. 15 to 17; Ciatto, Eqs. 3.2 to 3.6), O(n).

    Parameters
    ----------
    P : (capacity, capacity) ndarray
    n : int
        Dimension of the state.
    at : int
        First coordinate of the robot's pose.
    dx, dy : float
        Way in the world that the heading swings: F = [1 0 -dy; 0 1 dx; 0 0 1].
    heading : float
        By which the noise is turned into the world.
    Q : (3, 3) ndarray
        Covariance of the increment, in the frame of the pose before.
    """
    x, y, t = at, at + 1, at + 2
    # F on the pose rows, cross-covariances first.
    for j in range(at):
        P[j, x] -= dy * P[j, t]
        P[j, y] += dx * P[j, t]
    px, py, pt = P[x, at + 3 : n], P[y, at + 3 : n], P[t, at + 3 : n]
    for j in range(pt.size):
        px[j] -= dy * pt[j]
        py[j] += dx * pt[j]
    P[x, x] += dy * (dy * P[t, t] - 2.0 * P[x, t])
    P[x, y] += dx * P[x, t] - dy * P[y, t] - dx * dy * P[t, t]
    P[y, y] += dx * (dx * P[t, t] + 2.0 * P[y, t])
    P[x, t] -= dy * P[t, t]
    P[y, t] += dx * P[t, t]
    # Plus the noise, turned into the world.
    c, s = math.cos(heading), math.sin(heading)
    P[x, x] += c * c * Q[0, 0] - 2.0 * c * s * Q[0, 1] + s * s * Q[1, 1]
    P[x, y] += c * s * (Q[0, 0] - Q[1, 1]) + (c * c - s * s) * Q[0, 1]
    P[y, y] += s * s * Q[0, 0] + 2.0 * c * s * Q[0, 1] + c * c * Q[1, 1]
    P[x, t] += c * Q[0, 2] - s * Q[1, 2]
    P[y, t] += s * Q[0, 2] + c * Q[1, 2]
    P[t, t] += Q[2, 2]


@lean
def move(mean, P, n, at, delta, Q):  # type: ignore[no-untyped-def]
    """Robot motion with its Jacobians at the estimate, O(n); see `advance` and `disperse`."""
    x, y, heading = mean[at], mean[at + 1], mean[at + 2]
    advance(mean, at, delta)
    disperse(P, n, at, mean[at] - x, mean[at + 1] - y, heading, Q)


# Map correction ---------------------------------------------------------------------------------


@lean
def project(P, n, pose, at, size, H, d, rows):  # type: ignore[no-untyped-def]
    """Rows of ``H P`` for one observation: few rows of P enter (Solà, Eq. 28), O(n).

    Parameters
    ----------
    P : (capacity, capacity) ndarray
    n : int
    pose, at, size : int
        First coordinates of the pose and of the target, and how many the target has.
    H : (>= d, >= 3 + size) ndarray
        With respect to (pose, target).
    d : int
        Rows of the observation.
    rows : (d, >= n) ndarray
        Written, up to column n.
    """
    for a in range(d):
        rows[a, :n] = 0.0
    if d == 2 and size == 2:  # the usual case: P is read once for both
        add_both_rows(P, n, pose, 3, H, 0, rows[0], rows[1])
        add_both_rows(P, n, at, 2, H, 3, rows[0], rows[1])
        return
    for a in range(d):
        add_rows(P, n, pose, 3, H[a, :3], rows[a])
        add_rows(P, n, at, size, H[a, 3:], rows[a])


@lean
def times_transposed(row, pose, at, size, H, a):  # type: ignore[no-untyped-def]
    """One entry of ``(H P) H'``: a row of H P with row a of an observation's H."""
    total = row[pose] * H[a, 0] + row[pose + 1] * H[a, 1] + row[pose + 2] * H[a, 2]
    if size == 2:
        return total + row[at] * H[a, 3] + row[at + 1] * H[a, 4]
    for c in range(size):
        total += row[at + c] * H[a, 3 + c]
    return total


@lean
def cholesky(S, m):  # type: ignore[no-untyped-def]
    """Lower Cholesky factor in place of the lower triangle of S (m x m).

    Returns
    -------
    bool
        Whether S was positive definite (and finite).
    """
    for i in range(m):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= S[i, k] * S[j, k]
            if i > j:
                S[i, j] = total / S[j, j]
            elif total > 0.0 and total < np.inf:
                S[i, i] = math.sqrt(total)
            else:
                return False
    return True


@lean
def whiten(L, rows, m, n):  # type: ignore[no-untyped-def]
    """Rows ``L^-1 rows`` in place (m x n) by forward substitution.

    The rows above enter four at a time, to read and write each row less often.
    """
    for i in range(m):
        row = rows[i, :n]
        k = 0
        while k + 4 <= i:
            w0, w1, w2, w3 = rows[k, :n], rows[k + 1, :n], rows[k + 2, :n], rows[k + 3, :n]
            a0, a1, a2, a3 = L[i, k], L[i, k + 1], L[i, k + 2], L[i, k + 3]
            for j in range(row.size):
                row[j] -= a0 * w0[j] + a1 * w1[j] + a2 * w2[j] + a3 * w3[j]
            k += 4
        while k < i:
            factor, above = L[i, k], rows[k, :n]
            for j in range(row.size):
                row[j] -= factor * above[j]
            k += 1
        inverse = 1.0 / L[i, i]
        for j in range(row.size):
            row[j] *= inverse


@lean
def solve(rows, S, innovation, m, n, step):  # type: ignore[no-untyped-def]
    """The step ``K innovation`` of a correction, and what the covariance loses by it.

    With S = L L', W = L^-1 H P and w = L^-1 innovation: K S K' = W' W and K innovation = W' w.

    Parameters
    ----------
    rows : (>= m, >= n) ndarray
        H P; becomes W.
    S : (>= m, >= m) ndarray
        Innovation covariance, lower triangle; becomes L.
    innovation : (>= m,) ndarray
        Becomes w.
    m, n : int
        Rows, and dimension of the state.
    step : (>= n,) ndarray
        Written.

    Returns
    -------
    float
        Squared Mahalanobis norm of the innovation (NIS); NaN if S is not positive definite.
    """
    if not cholesky(S, m):
        return np.nan
    whiten(S, rows, m, n)
    step[:n] = 0.0
    nis = 0.0
    for i in range(m):
        total = innovation[i]
        for k in range(i):
            total -= S[i, k] * innovation[k]
        innovation[i] = total / S[i, i]
        nis += innovation[i] * innovation[i]
        row, factor, out = rows[i, :n], innovation[i], step[:n]
        for j in range(row.size):
            out[j] += factor * row[j]
    return nis


@lean
def shift(mean, step, n, poses):  # type: ignore[no-untyped-def]
    """``mean += step``, the headings of the poses at the start of the state wrapped."""
    for j in range(n):
        mean[j] += step[j]
    for pose in range(poses):
        mean[3 * pose + 2] = wrap(mean[3 * pose + 2])


@compiled
def correct(mean, P, n, rows, S, innovation, m, poses):  # type: ignore[no-untyped-def]
    """Map correction (Solà, Eqs. 26 to 30; Ciatto, Eqs. 3.12 to 3.15), all rows at once.

    Parameters
    ----------
    mean, P, n
        The map.
    rows, S, innovation, m
        As for `solve`.
    poses : int
        At the start of the state, whose headings are wrapped.

    Returns
    -------
    float
        As `solve`; if NaN, the map is untouched.
    """
    step = np.empty(n)
    nis = solve(rows, S, innovation, m, n, step)
    if np.isnan(nis):
        return nis
    shift(mean, step, n, poses)
    downdate(P, rows, m, n)
    return nis


# Landmark initialization and deletion -----------------------------------------------------------


@compiled
def append(mean, P, n, poses, state, size, G, noise):  # type: ignore[no-untyped-def]
    """Landmark initialization (Solà, Eqs. 35 to 38, 44, 45; Ciatto, 3.7), O(n); n grows by size.

    Parameters
    ----------
    mean, P, n
        The map before, with room for `size` more.
    poses : (p,) ndarray of int
        First coordinates of the poses from which the landmark is seen: one, as a rule.
    state : (>= size,) ndarray
        Mean of the new coordinates.
    size : int
    G : (p, >= size, 3) ndarray
        Their derivative with respect to each pose.
    noise : (>= size, >= size) ndarray
        Their covariance given the poses: ``G_y R G_y'`` and, of a partial observation,
        ``G_s S G_s'``.
    """
    row = np.empty(n)
    for a in range(size):
        mean[n + a] = state[a]
        row[:] = 0.0
        for k in range(poses.size):
            add_rows(P, n, poses[k], 3, G[k, a], row)
        for j in range(n):
            P[j, n + a] = row[j]
    for a in range(size):
        for b in range(a, size):
            total = noise[a, b]
            for k in range(poses.size):
                for c in range(3):
                    total += G[k, a, c] * P[poses[k] + c, n + b]
            P[n + a, n + b] = total


@lean
def remove(mean, P, n, offset, size):  # type: ignore[no-untyped-def]
    """Landmark deletion (Solà, Table 1): marginalise coordinates by dropping rows and columns.

    Parameters
    ----------
    mean, P, n
        The map before.
    offset, size : int
        First coordinate of the landmark and how many it has; what follows moves up.
    """
    for j in range(offset, n - size):
        mean[j] = mean[j + size]
    for i in range(n - size):
        source = i if i < offset else i + size
        for j in range(max(i, offset), n - size):
            P[i, j] = P[source, j + size]


@compiled
def replace(mean, P, n, at, size, state, new_size, J):  # type: ignore[no-untyped-def]
    """Put a linear function of a landmark in its place, such as a point for an inverse depth.

    Parameters
    ----------
    mean, P, n
        The map before; n falls by ``size - new_size``.
    at, size : int
        First coordinate of the landmark and how many it has.
    state : (new_size,) ndarray
        Mean of what takes its place.
    new_size : int
        At most `size`.
    J : (new_size, size) ndarray
        Derivative of the new coordinates with respect to the old.
    """
    rows = np.zeros((new_size, n))
    for a in range(new_size):
        add_rows(P, n, at, size, J[a], rows[a])
    for a in range(new_size):
        mean[at + a] = state[a]
        for j in range(at):
            P[j, at + a] = rows[a, j]
        for j in range(at + size, n):
            P[at + a, j] = rows[a, j]
        for b in range(a, new_size):
            total = 0.0
            for c in range(size):
                total += rows[a, at + c] * J[b, c]
            P[at + a, at + b] = total
    remove(mean, P, n, at + new_size, size - new_size)
