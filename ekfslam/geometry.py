"""SE(2), angles, frames and ellipses, vectorised over leading axes.

A pose is ``(x, y, theta)``: position [m] and heading [rad] of a frame in another one. Every
function takes arrays whose last axes are those named in its docstring and broadcasts over the
rest. Composition, its Jacobians and every conversion between conventions of covariance are
written here once; the rest of the package goes through them.

Conventions of covariance
-------------------------
additive
    Error ``(x, y, theta)`` added in the world frame. The package's exchange convention.
body tangent
    Error ``xi`` with ``truth = estimate * Exp(xi)`` (GTSAM's marginals of `Pose2`).
invariant
    Error ``xi`` with ``truth = Exp(xi) * estimate`` (Barrau and Bonnabel 2015).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

TAU = 2.0 * np.pi


def wrap(angle: ArrayLike) -> Array:
    """Wrap angles to [-pi, pi).

    Parameters
    ----------
    angle : (...) array_like
        Angles [rad].

    Returns
    -------
    (...) ndarray
        The same directions in [-pi, pi) [rad]; angles already there are returned unchanged.
    """
    angle = np.asarray(angle, dtype=float)
    wrapped = angle - TAU * np.floor((angle + np.pi) / TAU)
    # Rounding can land a hair's breadth outside the half-open interval, or leave its last number.
    wrapped = np.where(wrapped >= np.pi, wrapped - TAU, np.maximum(wrapped, -np.pi))
    return np.where((angle >= -np.pi) & (angle < np.pi), angle, wrapped)


def rotation(theta: ArrayLike) -> Array:
    """Rotation matrices R(theta) (Solà, Eq. 54).

    Parameters
    ----------
    theta : (...) array_like
        Angles [rad].

    Returns
    -------
    (..., 2, 2) ndarray
    """
    theta = np.asarray(theta, dtype=float)
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def perpendicular(v: ArrayLike) -> Array:
    """Rotate vectors by 90 degrees: J v with J = [0 -1; 1 0], the derivative of R(t) v at t = 0.

    Parameters
    ----------
    v : (..., 2) array_like

    Returns
    -------
    (..., 2) ndarray
    """
    v = np.asarray(v, dtype=float)
    return np.stack([-v[..., 1], v[..., 0]], axis=-1)


def _rotate(theta: Array, v: Array) -> Array:
    return np.einsum("...ij,...j->...i", rotation(theta), v)


def compose(a: ArrayLike, b: ArrayLike) -> Array:
    """Pose composition ``a * b``: the pose b, given in frame a, in the frame of a (Solà, A.3).

    Parameters
    ----------
    a, b : (..., 3) array_like
        Poses [m, m, rad].

    Returns
    -------
    (..., 3) ndarray
        Pose with heading in [-pi, pi).
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    position = a[..., :2] + _rotate(a[..., 2], b[..., :2])
    return np.concatenate([position, wrap(a[..., 2:] + b[..., 2:])], axis=-1)


def compose_jacobians(a: ArrayLike, b: ArrayLike) -> tuple[Array, Array]:
    """Jacobians of `compose` with respect to a and b.

    Returns
    -------
    (..., 3, 3) ndarray, (..., 3, 3) ndarray
        ``[I, J R(a) t_b; 0, 1]`` and ``blkdiag(R(a), 1)``.
    """
    a, b = np.broadcast_arrays(np.asarray(a, dtype=float), np.asarray(b, dtype=float))
    wrt_a = np.broadcast_to(np.eye(3), (*a.shape[:-1], 3, 3)).copy()
    wrt_a[..., :2, 2] = perpendicular(_rotate(a[..., 2], b[..., :2]))
    return wrt_a, heading_block(a[..., 2])


def heading_block(theta: ArrayLike) -> Array:
    """``blkdiag(R(theta), 1)``, which turns body errors of a pose into the world frame.

    Parameters
    ----------
    theta : (...) array_like
        Headings [rad].

    Returns
    -------
    (..., 3, 3) ndarray
    """
    theta = np.asarray(theta, dtype=float)
    block = np.zeros((*theta.shape, 3, 3))
    block[..., :2, :2] = rotation(theta)
    block[..., 2, 2] = 1.0
    return block


def inverse(a: ArrayLike) -> Array:
    """Inverse pose: ``compose(inverse(a), a)`` is the identity.

    Parameters
    ----------
    a : (..., 3) array_like

    Returns
    -------
    (..., 3) ndarray
    """
    a = np.asarray(a, dtype=float)
    position = -_rotate(-a[..., 2], a[..., :2])
    return np.concatenate([position, wrap(-a[..., 2:])], axis=-1)


def between(a: ArrayLike, b: ArrayLike) -> Array:
    """Pose b as seen from a: ``inverse(a) * b``.

    Parameters
    ----------
    a, b : (..., 3) array_like

    Returns
    -------
    (..., 3) ndarray
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    position = _rotate(-a[..., 2], b[..., :2] - a[..., :2])
    return np.concatenate([position, wrap(b[..., 2:] - a[..., 2:])], axis=-1)


def integrate(start: ArrayLike, increments: ArrayLike) -> Array:
    """Chain increments from a start pose: dead reckoning.

    Parameters
    ----------
    start : (3,) array_like
        First pose.
    increments : (K, 3) array_like
        Increment k leads from pose k to pose k + 1, in the frame of pose k.

    Returns
    -------
    (K + 1, 3) ndarray
    """
    start = np.asarray(start, dtype=float)
    increments = np.asarray(increments, dtype=float)
    headings = start[2] + np.concatenate([[0.0], np.cumsum(increments[:, 2])])
    steps = _rotate(headings[:-1], increments[:, :2])
    positions = start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.column_stack([positions, wrap(headings)])


def from_frame(frame: ArrayLike, points: ArrayLike) -> Array:
    """Points of a local frame in the global one (Solà, Eq. 55).

    Parameters
    ----------
    frame : (..., 3) array_like
        Pose of the local frame.
    points : (..., 2) array_like
        Points in the local frame [m].

    Returns
    -------
    (..., 2) ndarray
    """
    frame, points = np.asarray(frame, dtype=float), np.asarray(points, dtype=float)
    return frame[..., :2] + _rotate(frame[..., 2], points)


def from_frame_jacobians(frame: ArrayLike, points: ArrayLike) -> tuple[Array, Array]:
    """Jacobians of `from_frame` with respect to frame and point (Solà, C.1.1).

    Returns
    -------
    (..., 2, 3) ndarray, (..., 2, 2) ndarray
        ``[I, J R t]`` and ``R``.
    """
    frame, points = np.asarray(frame, dtype=float), np.asarray(points, dtype=float)
    turned = _rotate(frame[..., 2], points)
    wrt_frame = np.zeros((*turned.shape[:-1], 2, 3))
    wrt_frame[..., 0, 0] = wrt_frame[..., 1, 1] = 1.0
    wrt_frame[..., 2] = perpendicular(turned)
    wrt_point = np.broadcast_to(rotation(frame[..., 2]), (*turned.shape[:-1], 2, 2))
    return wrt_frame, wrt_point


def to_frame(frame: ArrayLike, points: ArrayLike) -> Array:
    """Global points in a local frame (Solà, Eq. 56; subtract before turning).

    Parameters
    ----------
    frame : (..., 3) array_like
        Pose of the local frame.
    points : (..., 2) array_like
        Points in the global frame [m].

    Returns
    -------
    (..., 2) ndarray
    """
    frame, points = np.asarray(frame, dtype=float), np.asarray(points, dtype=float)
    return _rotate(-frame[..., 2], points - frame[..., :2])


def to_frame_jacobians(frame: ArrayLike, points: ArrayLike) -> tuple[Array, Array]:
    """Jacobians of `to_frame` with respect to frame and point (Solà, C.1.1).

    Returns
    -------
    (..., 2, 3) ndarray, (..., 2, 2) ndarray
        ``[-R', -J y]`` with y the point in the frame, and ``R'``.
    """
    frame = np.asarray(frame, dtype=float)
    local = to_frame(frame, points)
    turn = np.broadcast_to(rotation(-frame[..., 2]), (*local.shape[:-1], 2, 2))
    wrt_frame = np.concatenate([-turn, -perpendicular(local)[..., None]], axis=-1)
    return wrt_frame, turn


# Arcs, exponential and logarithm --------------------------------------------------------------


def arc_coefficients(angle: ArrayLike) -> tuple[Array, Array]:
    """``s = sin(a) / a`` and ``c = (1 - cos(a)) / a``, smooth through a = 0.

    ``V(a) = [s, -c; c, s]`` maps the arc length vector of a constant turn to its chord.

    Parameters
    ----------
    angle : (...) array_like
        Turn angles [rad].

    Returns
    -------
    (...) ndarray, (...) ndarray
    """
    angle = np.asarray(angle, dtype=float)
    # 1 - cos(a) = 2 sin(a / 2)^2 does not cancel, so neither needs a series.
    half = np.sinc(angle / TAU)
    return np.sinc(angle / np.pi), 0.5 * angle * half * half


def arc_coefficient_derivatives(angle: ArrayLike) -> tuple[Array, Array]:
    """Derivatives of `arc_coefficients` with respect to the angle.

    Returns
    -------
    (...) ndarray, (...) ndarray
        ``ds/da`` (a series below 0.3 rad, where the closed form cancels) and ``dc/da``.
    """
    a = np.asarray(angle, dtype=float)
    s, _ = arc_coefficients(a)
    half = np.sinc(a / TAU)
    a2 = a * a
    series = a * (-1 / 3 + a2 * (1 / 30 + a2 * (-1 / 840 + a2 * (1 / 45360 - a2 / 3991680))))
    safe = np.where(np.abs(a) < 0.3, 1.0, a)
    closed = (np.cos(safe) - np.sin(safe) / safe) / safe
    return np.where(np.abs(a) < 0.3, series, closed), s - 0.5 * half * half


def _left_jacobian(angle: Array) -> Array:
    s, c = arc_coefficients(angle)
    return np.stack([np.stack([s, -c], axis=-1), np.stack([c, s], axis=-1)], axis=-2)


def exp(xi: ArrayLike) -> Array:
    """Exponential of SE(2): ``(V(a) rho, a)`` for the tangent ``(rho, a)``.

    Parameters
    ----------
    xi : (..., 3) array_like

    Returns
    -------
    (..., 3) ndarray
    """
    xi = np.asarray(xi, dtype=float)
    position = np.einsum("...ij,...j->...i", _left_jacobian(xi[..., 2]), xi[..., :2])
    return np.concatenate([position, wrap(xi[..., 2:])], axis=-1)


def log(pose: ArrayLike) -> Array:
    """Logarithm of SE(2), inverse of `exp` for angles in [-pi, pi).

    Parameters
    ----------
    pose : (..., 3) array_like

    Returns
    -------
    (..., 3) ndarray
    """
    pose = np.asarray(pose, dtype=float)
    angle = wrap(pose[..., 2])
    rho = np.linalg.solve(_left_jacobian(angle), pose[..., :2, None])[..., 0]
    return np.concatenate([rho, angle[..., None]], axis=-1)


# Covariance conventions ------------------------------------------------------------------------


def congruence(matrix: ArrayLike, covariance: ArrayLike) -> Array:
    """``M P M'`` over leading axes.

    Parameters
    ----------
    matrix : (..., m, n) array_like
    covariance : (..., n, n) array_like

    Returns
    -------
    (..., m, m) ndarray
        Symmetric to the last bit.
    """
    matrix, covariance = np.asarray(matrix, dtype=float), np.asarray(covariance, dtype=float)
    product = matrix @ covariance @ np.swapaxes(matrix, -1, -2)
    return 0.5 * (product + np.swapaxes(product, -1, -2))


def body_to_additive(pose: ArrayLike, covariance: ArrayLike) -> Array:
    """Covariance of the body tangent (GTSAM) in the additive convention: ``B P B'``.

    Parameters
    ----------
    pose : (..., 3) array_like
        Estimates.
    covariance : (..., 3, 3) array_like

    Returns
    -------
    (..., 3, 3) ndarray
    """
    return congruence(heading_block(np.asarray(pose, dtype=float)[..., 2]), covariance)


def additive_to_body(pose: ArrayLike, covariance: ArrayLike) -> Array:
    """Inverse of `body_to_additive`."""
    return congruence(heading_block(-np.asarray(pose, dtype=float)[..., 2]), covariance)


def _lever(pose: Array, sign: float) -> Array:
    matrix = np.broadcast_to(np.eye(3), (*pose.shape[:-1], 3, 3)).copy()
    matrix[..., :2, 2] = sign * perpendicular(pose[..., :2])
    return matrix


def additive_to_invariant(pose: ArrayLike, covariance: ArrayLike) -> Array:
    """Additive covariance of poses in right-invariant coordinates, ``T^-1 P T^-T``.

    ``T = [I, J p; 0, 1]`` to first order (Barrau and Bonnabel 2015).

    Parameters
    ----------
    pose : (..., 3) array_like
        Estimates.
    covariance : (..., 3, 3) array_like

    Returns
    -------
    (..., 3, 3) ndarray
    """
    return congruence(_lever(np.asarray(pose, dtype=float), -1.0), covariance)


def invariant_to_additive(pose: ArrayLike, covariance: ArrayLike) -> Array:
    """Inverse of `additive_to_invariant`."""
    return congruence(_lever(np.asarray(pose, dtype=float), 1.0), covariance)


def invariant_error(truth: ArrayLike, estimate: ArrayLike) -> Array:
    """Right-invariant error ``Log(truth * estimate^-1)``.

    Parameters
    ----------
    truth, estimate : (..., 3) array_like

    Returns
    -------
    (..., 3) ndarray
    """
    return log(compose(truth, inverse(estimate)))


def additive_error(truth: ArrayLike, estimate: ArrayLike) -> Array:
    """Additive error ``estimate - truth`` with the heading wrapped.

    Parameters
    ----------
    truth, estimate : (..., 3) array_like

    Returns
    -------
    (..., 3) ndarray
    """
    truth, estimate = np.asarray(truth, dtype=float), np.asarray(estimate, dtype=float)
    error = estimate - truth
    return np.concatenate([error[..., :2], wrap(error[..., 2:])], axis=-1)


# Rigid motions and ellipses --------------------------------------------------------------------


def align(source: ArrayLike, target: ArrayLike) -> Array:
    """Rigid motion g of the plane that minimises ``sum |g * source - target|^2``, in closed form.

    Parameters
    ----------
    source, target : (N, 2) array_like
        Paired points [m], N >= 2 and not all equal.

    Returns
    -------
    (3,) ndarray
        The motion as a pose; apply it with ``compose(g, poses)`` or ``from_frame(g, points)``.
    """
    source, target = np.asarray(source, dtype=float), np.asarray(target, dtype=float)
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    # The optimal angle maximises sum b . R a = cos * (a . b) + sin * (a x b).
    angle = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    shift = target_mean - rotation(angle) @ source_mean
    return np.array([shift[0], shift[1], float(wrap(angle))])


def ellipse(mean: ArrayLike, covariance: ArrayLike, sigmas: float = 3.0, points: int = 64) -> Array:
    """Contour of the n-sigma ellipse of a 2-D Gaussian, by SVD (Solà, Eq. 87; Ciatto, A.2).

    The share of probability inside is ``1 - exp(-sigmas^2 / 2)``: 39.3 %, 86.5 %, 98.9 % for
    1, 2, 3 (Solà, Table 3).

    Parameters
    ----------
    mean : (..., 2) array_like
    covariance : (..., 2, 2) array_like
    sigmas : float
        Size in standard deviations (unsquared Mahalanobis distance).
    points : int
        Points on the contour; first and last coincide.

    Returns
    -------
    (..., points, 2) ndarray
    """
    mean, covariance = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
    u, d, _ = np.linalg.svd(covariance)
    angle = np.linspace(0.0, TAU, points)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    axes = u * np.sqrt(d)[..., None, :]
    return mean[..., None, :] + sigmas * np.swapaxes(axes @ circle, -1, -2)
