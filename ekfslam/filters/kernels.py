"""The hot loops of EKF-SLAM on one triangle of the covariance.

State: pose (x, y, theta) first, then landmarks; a landmark is found by the offset of its first
coordinate. Covariance: the upper triangle of a square array, ``P[i, j]`` with ``i <= j < n``;
what lies below the diagonal is never read. So the covariance is symmetric by construction.

Inner loops run over slices from their start: the compiler then knows that no index is negative,
and vectorises them.
"""

from __future__ import annotations

import math

import numpy as np

from ekfslam.compiled import compiled
from ekfslam.models.sensors import RANGE_BEARING


@compiled
def wrap(angle: float) -> float:
    """Angle in [-pi, pi); see `ekfslam.geometry.wrap`."""
    if -math.pi <= angle < math.pi:
        return angle
    wrapped = angle - 2.0 * math.pi * np.floor((angle + math.pi) / (2.0 * math.pi))
    if wrapped >= math.pi:
        return wrapped - 2.0 * math.pi
    return max(wrapped, -math.pi)


# Models ----------------------------------------------------------------------------------------


@compiled
def expect(kind, mount, pose, landmark, expected, H):  # type: ignore[no-untyped-def]
    """Direct model with Jacobian (Solà, Eqs. 24 and 25), by the chain rule over three frames.

    Parameters
    ----------
    kind : int
        Code of the view.
    mount : (3,) ndarray
        Pose of the sensor on the body.
    pose : (3,) ndarray
    landmark : (2,) ndarray
    expected : (2,) ndarray
        Written: h(pose, landmark).
    H : (2, 5) ndarray
        Written: derivative with respect to (x, y, theta, landmark x, landmark y).
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    bx, by = c * dx + s * dy, c * dy - s * dx  # in the body
    cm, sm = math.cos(mount[2]), math.sin(mount[2])
    x = cm * (bx - mount[0]) + sm * (by - mount[1])  # in the sensor
    y = cm * (by - mount[1]) - sm * (bx - mount[0])
    ca, sa = c * cm - s * sm, s * cm + c * sm  # heading of the sensor in the world
    # Turning the body turns the point the other way: d(bx, by) / d theta = (by, -bx).
    xt, yt = cm * by - sm * bx, -cm * bx - sm * by
    if kind == RANGE_BEARING:
        r = math.sqrt(x * x + y * y)
        expected[0], expected[1] = r, math.atan2(y, x)
        d00, d01 = x / r, y / r
        d10, d11 = -y / (r * r), x / (r * r)
    else:
        expected[0], expected[1] = x, y
        d00, d01, d10, d11 = 1.0, 0.0, 0.0, 1.0
    H[0, 3], H[0, 4] = d00 * ca - d01 * sa, d00 * sa + d01 * ca
    H[1, 3], H[1, 4] = d10 * ca - d11 * sa, d10 * sa + d11 * ca
    H[0, 0], H[0, 1], H[0, 2] = -H[0, 3], -H[0, 4], d00 * xt + d01 * yt
    H[1, 0], H[1, 1], H[1, 2] = -H[1, 3], -H[1, 4], d10 * xt + d11 * yt


@compiled
def innovate(kind, value, expected, innovation):  # type: ignore[no-untyped-def]
    """Innovation ``value - expected``, the bearing wrapped (Solà, Eq. 26)."""
    innovation[0] = value[0] - expected[0]
    innovation[1] = value[1] - expected[1]
    if kind == RANGE_BEARING:
        innovation[1] = wrap(innovation[1])


@compiled
def locate(kind, mount, pose, value, R, landmark, G):  # type: ignore[no-untyped-def]
    """Inverse model with Jacobian and mapped noise (Solà, Eqs. 32 to 35).

    Parameters
    ----------
    kind, mount, pose
        As for `expect`.
    value : (2,) ndarray
        Measurement.
    R : (2, 2) ndarray
        Its noise.
    landmark : (2,) ndarray
        Written: g(pose, value).
    G : (2, 5) ndarray
        Written: derivative with respect to the pose, and then the mapped noise ``G_y R G_y'``.
    """
    if kind == RANGE_BEARING:
        cb, sb = math.cos(value[1]), math.sin(value[1])
        x, y = value[0] * cb, value[0] * sb
        d00, d01, d10, d11 = cb, -y, sb, x
    else:
        x, y = value[0], value[1]
        d00, d01, d10, d11 = 1.0, 0.0, 0.0, 1.0
    cm, sm = math.cos(mount[2]), math.sin(mount[2])
    bx, by = mount[0] + cm * x - sm * y, mount[1] + sm * x + cm * y
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = c * bx - s * by, s * bx + c * by
    landmark[0], landmark[1] = pose[0] + dx, pose[1] + dy
    G[0, 0], G[0, 1], G[0, 2] = 1.0, 0.0, -dy
    G[1, 0], G[1, 1], G[1, 2] = 0.0, 1.0, dx
    ca, sa = c * cm - s * sm, s * cm + c * sm
    g00, g01 = ca * d00 - sa * d10, ca * d01 - sa * d11
    g10, g11 = sa * d00 + ca * d10, sa * d01 + ca * d11
    a0, a1 = g00 * R[0, 0] + g01 * R[1, 0], g00 * R[0, 1] + g01 * R[1, 1]
    b0, b1 = g10 * R[0, 0] + g11 * R[1, 0], g10 * R[0, 1] + g11 * R[1, 1]
    G[0, 3], G[1, 4] = a0 * g00 + a1 * g01, b0 * g10 + b1 * g11
    G[0, 4] = G[1, 3] = a0 * g10 + a1 * g11


# The four operations of the map (Solà, Table 1) -------------------------------------------------


@compiled
def move(mean, P, n, delta, Q):  # type: ignore[no-untyped-def]
    """Robot motion (Solà, Eqs. 14 to 17; Ciatto, Eqs. 3.1 to 3.6), O(n).

    Parameters
    ----------
    mean : (capacity,) ndarray
    P : (capacity, capacity) ndarray
    n : int
        Dimension of the state.
    delta : (3,) ndarray
        Body increment.
    Q : (3, 3) ndarray
        Its covariance, in the frame of the pose before.
    """
    c, s = math.cos(mean[2]), math.sin(mean[2])
    dx, dy = c * delta[0] - s * delta[1], s * delta[0] + c * delta[1]
    mean[0] += dx
    mean[1] += dy
    mean[2] = wrap(mean[2] + delta[2])
    # F = [1 0 -dy; 0 1 dx; 0 0 1] on the pose rows, cross-covariances first.
    px, py, pt = P[0, 3:n], P[1, 3:n], P[2, 3:n]
    for j in range(pt.size):
        px[j] -= dy * pt[j]
        py[j] += dx * pt[j]
    P[0, 0] += dy * (dy * P[2, 2] - 2.0 * P[0, 2])
    P[0, 1] += dx * P[0, 2] - dy * P[1, 2] - dx * dy * P[2, 2]
    P[1, 1] += dx * (dx * P[2, 2] + 2.0 * P[1, 2])
    P[0, 2] -= dy * P[2, 2]
    P[1, 2] += dx * P[2, 2]
    # Plus the noise, turned into the world.
    P[0, 0] += c * c * Q[0, 0] - 2.0 * c * s * Q[0, 1] + s * s * Q[1, 1]
    P[0, 1] += c * s * (Q[0, 0] - Q[1, 1]) + (c * c - s * s) * Q[0, 1]
    P[1, 1] += s * s * Q[0, 0] + 2.0 * c * s * Q[0, 1] + c * c * Q[1, 1]
    P[0, 2] += c * Q[0, 2] - s * Q[1, 2]
    P[1, 2] += s * Q[0, 2] + c * Q[1, 2]
    P[2, 2] += Q[2, 2]


@compiled
def project(P, n, offset, H, rows):  # type: ignore[no-untyped-def]
    """Rows of ``H P`` for one landmark: five rows of P enter (Solà, Eq. 28), O(n).

    Parameters
    ----------
    P : (capacity, capacity) ndarray
    n : int
    offset : int
        Of the landmark in the state.
    H : (2, 5) ndarray
    rows : (2, capacity) ndarray
        Written, up to column n.
    """
    for a in range(2):
        h0, h1, h2, h3, h4 = H[a, 0], H[a, 1], H[a, 2], H[a, 3], H[a, 4]
        row = rows[a, :n]
        row[0] = h0 * P[0, 0] + h1 * P[0, 1] + h2 * P[0, 2]
        row[1] = h0 * P[0, 1] + h1 * P[1, 1] + h2 * P[1, 2]
        row[2] = h0 * P[0, 2] + h1 * P[1, 2] + h2 * P[2, 2]
        out, px, py, pt = row[3:n], P[0, 3:n], P[1, 3:n], P[2, 3:n]
        for j in range(out.size):
            out[j] = h0 * px[j] + h1 * py[j] + h2 * pt[j]
        for j in range(offset):  # above the landmark its rows stand as columns
            row[j] += h3 * P[j, offset] + h4 * P[j, offset + 1]
        row[offset] += h3 * P[offset, offset] + h4 * P[offset, offset + 1]
        row[offset + 1] += h3 * P[offset, offset + 1] + h4 * P[offset + 1, offset + 1]
        out = row[offset + 2 : n]
        lx, ly = P[offset, offset + 2 : n], P[offset + 1, offset + 2 : n]
        for j in range(out.size):
            out[j] += h3 * lx[j] + h4 * ly[j]


@compiled
def times_transposed(row, offset, H, a):  # type: ignore[no-untyped-def]
    """One entry of ``(H P) H'``: a row of H P with row a of a landmark's H."""
    return (
        row[0] * H[a, 0]
        + row[1] * H[a, 1]
        + row[2] * H[a, 2]
        + row[offset] * H[a, 3]
        + row[offset + 1] * H[a, 4]
    )


@compiled
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


@compiled
def whiten(L, rows, m, n):  # type: ignore[no-untyped-def]
    """Rows ``L^-1 rows`` in place (m x n) by forward substitution."""
    for i in range(m):
        row = rows[i, :n]
        for k in range(i):
            factor = L[i, k]
            above = rows[k, :n]
            for j in range(row.size):
                row[j] -= factor * above[j]
        inverse = 1.0 / L[i, i]
        for j in range(row.size):
            row[j] *= inverse


@compiled
def downdate(P, W, m, n):  # type: ignore[no-untyped-def]
    """``P -= W' W`` on the triangle: the map correction (Solà, Eq. 30), O(m n^2).

    Parameters
    ----------
    P : (capacity, capacity) ndarray
    W : (>= m, >= n) ndarray
        m is even; rows enter four, then two at a time, to read and write P less often.
    """
    for i in range(n):
        row = P[i, i:n]
        k = 0
        while k + 4 <= m:
            w0, w1, w2, w3 = W[k, i:n], W[k + 1, i:n], W[k + 2, i:n], W[k + 3, i:n]
            a0, a1, a2, a3 = w0[0], w1[0], w2[0], w3[0]
            for j in range(row.size):
                row[j] -= a0 * w0[j] + a1 * w1[j] + a2 * w2[j] + a3 * w3[j]
            k += 4
        while k + 2 <= m:
            w0, w1 = W[k, i:n], W[k + 1, i:n]
            a0, a1 = w0[0], w1[0]
            for j in range(row.size):
                row[j] -= a0 * w0[j] + a1 * w1[j]
            k += 2


@compiled
def correct(mean, P, n, rows, S, innovation, m):  # type: ignore[no-untyped-def]
    """Map correction (Solà, Eqs. 26 to 30; Ciatto, Eqs. 3.12 to 3.15), all rows at once.

    With S = L L', W = L^-1 H P and w = L^-1 innovation: K S K' = W' W and K innovation = W' w.

    Parameters
    ----------
    mean, P, n
        The map.
    rows : (>= m, capacity) ndarray
        H P; destroyed.
    S : (>= m, >= m) ndarray
        Innovation covariance, lower triangle; destroyed.
    innovation : (>= m,) ndarray
        Destroyed.
    m : int
        Rows, even.

    Returns
    -------
    float
        Squared Mahalanobis norm of the innovation (NIS); NaN if S is not positive definite, and
        then the map is untouched.
    """
    if not cholesky(S, m):
        return np.nan
    whiten(S, rows, m, n)
    nis = 0.0
    for i in range(m):
        total = innovation[i]
        for k in range(i):
            total -= S[i, k] * innovation[k]
        innovation[i] = total / S[i, i]
        nis += innovation[i] * innovation[i]
        row, factor = rows[i, :n], innovation[i]
        for j in range(row.size):
            mean[j] += factor * row[j]
    mean[2] = wrap(mean[2])
    downdate(P, rows, m, n)
    return nis


@compiled
def append(mean, P, n, landmark, G):  # type: ignore[no-untyped-def]
    """Landmark initialization (Solà, Eqs. 35 to 38; Ciatto, 3.7): n grows by 2, O(n).

    Parameters
    ----------
    mean, P, n
        The map before, with room for two more.
    landmark : (2,) ndarray
        Position.
    G : (2, 5) ndarray
        Derivative with respect to the pose, and the noise of the landmark given the pose.
    """
    mean[n], mean[n + 1] = landmark[0], landmark[1]
    for a in range(2):
        g0, g1, g2 = G[a, 0], G[a, 1], G[a, 2]
        P[0, n + a] = g0 * P[0, 0] + g1 * P[0, 1] + g2 * P[0, 2]
        P[1, n + a] = g0 * P[0, 1] + g1 * P[1, 1] + g2 * P[1, 2]
        P[2, n + a] = g0 * P[0, 2] + g1 * P[1, 2] + g2 * P[2, 2]
        for j in range(3, n):
            P[j, n + a] = g0 * P[0, j] + g1 * P[1, j] + g2 * P[2, j]
    for a in range(2):
        for b in range(a, 2):
            P[n + a, n + b] = (
                G[a, 0] * P[0, n + b] + G[a, 1] * P[1, n + b] + G[a, 2] * P[2, n + b] + G[a, 3 + b]
            )


@compiled
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
def distances(mean, P, offsets, count, kind, mount, value, R, out):  # type: ignore[no-untyped-def]
    """Squared Mahalanobis distance of one observation's innovation with each landmark.

    Parameters
    ----------
    mean, P
        The map.
    offsets : (>= count,) ndarray of int
        Of the landmarks in the state, -1 for none.
    count : int
    kind, mount, value, R
        The observation.
    out : (>= count,) ndarray
        Written; infinite where there is no landmark.
    """
    expected, innovation = np.empty(2), np.empty(2)
    H = np.empty((2, 5))
    local = np.empty((2, 5))
    for index in range(count):
        at = offsets[index]
        out[index] = np.inf
        if at < 0:
            continue
        expect(kind, mount, mean[:3], mean[at : at + 2], expected, H)
        innovate(kind, value, expected, innovation)
        for a in range(2):  # H P on the five coordinates that matter
            for j in range(5):
                column = j if j < 3 else at + j - 3
                total = 0.0
                for k in range(5):
                    row = k if k < 3 else at + k - 3
                    total += H[a, k] * (P[row, column] if row <= column else P[column, row])
                local[a, j] = total
        s00, s01, s11 = R[0, 0], R[0, 1], R[1, 1]
        for j in range(5):
            s00 += local[0, j] * H[0, j]
            s01 += local[0, j] * H[1, j]
            s11 += local[1, j] * H[1, j]
        determinant = s00 * s11 - s01 * s01
        if determinant > 0.0:
            out[index] = (
                s11 * innovation[0] * innovation[0]
                - 2.0 * s01 * innovation[0] * innovation[1]
                + s00 * innovation[1] * innovation[1]
            ) / determinant
