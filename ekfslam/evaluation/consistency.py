"""Whether an estimate is as good as it claims: NEES, NIS, and its distance from a reference.

NEES is the squared Mahalanobis norm of the error in the estimate's own covariance, NIS that of the
innovation in its covariance S (Bar-Shalom et al. 2001, 5.4). Neither is divided by the degrees of
freedom: the expected NEES of a pose is 3, of a landmark 2.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.estimates import Estimate, Trajectory
from ekfslam.evaluation.landmarks import common_landmarks, identities_shared, map_ids
from ekfslam.evaluation.statistics import rmse
from ekfslam.geometry import Array

SINGULAR = 1e-10
"""Reciprocal condition number of the correlation matrix up to which a covariance is singular."""

NEGLIGIBLE = 1e-14
"""A variance this small beside the largest one is a zero with rounding on it."""

REGULAR = 1e-3
"""Determinant of a correlation matrix above which it is far from singular, whatever its size."""


def squared_mahalanobis(errors: ArrayLike, covariances: ArrayLike) -> Array:
    """``e' P^-1 e``, skipped where P cannot be inverted in earnest.

    P is scaled to its correlation matrix, so units hardly matter. It is skipped if a value is not
    finite, a variance is not above `NEGLIGIBLE` times the largest, or the smallest eigenvalue of
    the correlation matrix is not above `SINGULAR` times the largest: the first steps after an
    exactly known start, or a motion noise of lower rank. Only the lower triangle counts. Of errors
    that share a covariance, by broadcasting, it is decomposed once.

    Parameters
    ----------
    errors : (..., d) array_like
    covariances : (..., d, d) array_like

    Returns
    -------
    (...) ndarray
        NaN where skipped; count those with ``np.isnan(...).sum()``.
    """
    errors, covariances = np.asarray(errors, dtype=float), np.asarray(covariances, dtype=float)
    axes = range(covariances.shape[-1])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        variances = [covariances[..., i, i] for i in axes]
        floor = NEGLIGIBLE * np.maximum.reduce(variances, initial=0.0)
        sound = np.logical_and.reduce([variance > floor for variance in variances])
        for i, j in product(axes, axes):
            sound = sound & np.isfinite(covariances[..., i, j])
        for i in axes:
            sound = sound & np.isfinite(errors[..., i])
        squares, determinant = _by_cholesky(errors, covariances)
    # The eigenvalues of a correlation matrix add up to d, so that none is above d, and all but the
    # smallest have a product of (d / (d - 1))^(d - 1) < e at most: the smallest is above det / e.
    settled = (determinant > REGULAR) & (squares < np.inf)
    result = np.where(sound & settled, squares, np.nan)
    if (rest := sound & ~settled).any():
        result[rest] = _by_eigenvalues(errors, covariances, rest)
    return result


def _by_cholesky(errors: Array, covariances: Array) -> tuple[Array, Array]:
    """``e' P^-1 e`` and the determinant of the correlation matrix; NaN where P is not positive.

    Entry by entry, each for all matrices at once, which costs far less than their eigenvalues.
    """
    squares, determinant = np.zeros(()), np.ones(())
    sigmas: list[Array] = []
    factor: list[list[Array]] = []
    white: list[Array] = []
    for i in range(covariances.shape[-1]):
        sigmas.append(np.sqrt(covariances[..., i, i]))
        row: list[Array] = []
        for j, other in enumerate(factor):
            correlation = covariances[..., i, j] / (sigmas[i] * sigmas[j])
            row.append((correlation - _inner(row, other)) / other[j])
        pivot = 1.0 - _inner(row, row)
        row.append(np.sqrt(pivot))
        white.append((errors[..., i] / sigmas[i] - _inner(row, white)) / row[i])
        factor.append(row)
        squares, determinant = squares + white[i] ** 2, determinant * pivot
    return squares, determinant


def _inner(row: list[Array], other: list[Array]) -> Array:
    """Sum of the products of what both have."""
    return sum((a * b for a, b in zip(row, other, strict=False)), start=np.zeros(()))


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def _by_eigenvalues(errors: Array, covariances: Array, which: np.ndarray) -> Array:
    """``e' P^-1 e`` where it is asked for, of covariances with variances; NaN where singular."""
    size = covariances.shape[-1]
    matrices = covariances.reshape(-1, size, size)
    number = np.broadcast_to(np.arange(len(matrices)).reshape(covariances.shape[:-2]), which.shape)
    asked = np.zeros(len(matrices), dtype=bool)
    asked[number[which]] = True
    sigmas = np.sqrt(np.diagonal(matrices[asked], axis1=-2, axis2=-1))
    correlation = matrices[asked] / (sigmas[:, :, None] * sigmas[:, None, :])
    eigenvalues, vectors = np.linalg.eigh(correlation)
    regular = eigenvalues[:, 0] > SINGULAR * eigenvalues[:, -1]
    # Errors that share a covariance come back to it.
    shared = (np.cumsum(asked) - 1)[number[which]]
    scaled = np.broadcast_to(errors, (*which.shape, size))[which] / sigmas[shared]
    components = np.einsum("nij,ni->nj", vectors[shared], scaled)
    squares = np.sum(components**2 / eigenvalues[shared], axis=-1)
    return np.where(regular[shared], squares, np.nan)


def pose_nees(poses: ArrayLike, truth: ArrayLike, covariances: ArrayLike) -> Array:
    """NEES of poses in additive (x, y, theta), heading error wrapped; 3 degrees of freedom.

    Parameters
    ----------
    poses, truth : (..., 3) array_like
        Estimated poses as estimated, never aligned: alignment would hide the error of the frame,
        which the covariance accounts for.
    covariances : (..., 3, 3) array_like
        Additive.

    Returns
    -------
    (...) ndarray
        NaN where skipped, see `squared_mahalanobis`.
    """
    return squared_mahalanobis(geo.additive_error(truth, poses), covariances)


def pose_nees_invariant(poses: ArrayLike, truth: ArrayLike, covariances: ArrayLike) -> Array:
    """NEES of poses in right-invariant coordinates (Barrau and Bonnabel 2015); 3 dof.

    The error ``xi = Log(truth * estimate^-1)`` in its covariance ``T^-1 P T^-T``. It is computed as
    ``(T xi)' P^-1 (T xi)``, the same number without the ill-conditioned ``T^-1 P T^-T`` far from
    the origin, so that it is skipped at the same poses as `pose_nees`.

    Parameters
    ----------
    poses, truth : (..., 3) array_like
        As in `pose_nees`.
    covariances : (..., 3, 3) array_like
        Additive.

    Returns
    -------
    (...) ndarray
        NaN where skipped.
    """
    return squared_mahalanobis(turned_error(poses, geo.invariant_error(truth, poses)), covariances)


def turned_error(poses: ArrayLike, xi: ArrayLike) -> Array:
    """``T xi``: a right-invariant error in the coordinates of the additive covariance.

    Parameters
    ----------
    poses : (..., 3) array_like
        Estimated.
    xi : (..., 3) array_like

    Returns
    -------
    (..., 3) ndarray
    """
    poses, xi = np.asarray(poses, dtype=float), np.asarray(xi, dtype=float)
    position = xi[..., :2] + xi[..., 2:] * geo.perpendicular(poses[..., :2])
    return np.concatenate([position, xi[..., 2:]], axis=-1)


class Gaps(NamedTuple):
    """Distances of an estimate from a reference, and ratios of their sigmas; NaN where undefined.

    Attributes
    ----------
    final_position, final_heading : float
        Distance of the final positions [m], size of the wrapped heading difference [rad].
    landmark_rmse : float
        Over the landmarks that both have [m].
    sigma_ratio_position, sigma_ratio_heading : float
        Of the final pose, estimate over reference: roots of the traces of the position covariances,
        and of the heading variances. Below 1 where the estimate claims to know more.
    """

    final_position: float = float("nan")
    final_heading: float = float("nan")
    landmark_rmse: float = float("nan")
    sigma_ratio_position: float = float("nan")
    sigma_ratio_heading: float = float("nan")


def gaps(
    dataset: Dataset, estimate: Estimate, series: Trajectory, reference: Estimate, robot: int = 0
) -> Gaps:
    """Compare a series of an estimate with the reference, which needs no truth.

    At the last step the online and the smoothed estimate know the same measurements, so both
    compare with the final pose of the reference.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
    series : Trajectory
        Of the estimate.
    reference : Estimate
        Such as the batch estimate of the same dataset.
    robot : int
        Whose poses are compared.

    Returns
    -------
    Gaps
        Nothing is aligned. All NaN if the reference has no trajectory.
    """
    if reference.final_trajectory is None:
        return Gaps()
    series, best = series.of_robot(robot), reference.final_trajectory.of_robot(robot)
    gap = geo.additive_error(best.poses[-1], series.poses[-1])
    ratios = (float("nan"), float("nan"))
    if series.covariances is not None and best.covariances is not None:
        ours, theirs = np.diagonal(series.covariances[-1]), np.diagonal(best.covariances[-1])
        ratios = _sigma_ratio(ours[:2].sum(), theirs[:2].sum()), _sigma_ratio(ours[2], theirs[2])
    return Gaps(
        float(np.hypot(gap[0], gap[1])),
        float(abs(gap[2])),
        _landmark_gap(dataset, estimate, reference),
        *ratios,
    )


def _landmark_gap(dataset: Dataset, estimate: Estimate, reference: Estimate) -> float:
    if estimate.landmarks is None or reference.landmarks is None:
        return float("nan")
    # Identities of an estimator's own mean nothing to another one, unless both took the same.
    if not (
        _same_association(estimate, reference)
        or (identities_shared(dataset, estimate) and identities_shared(dataset, reference))
    ):
        return float("nan")
    rows, others = common_landmarks(estimate.landmarks, reference.landmarks)
    apart = estimate.landmarks.positions[rows] - reference.landmarks.positions[others]
    return rmse(np.hypot(apart[:, 0], apart[:, 1]))


def _same_association(estimate: Estimate, reference: Estimate) -> bool:
    """Whether both took every observation for the same landmark."""
    ours, theirs = estimate.innovations, reference.innovations
    return (
        ours is not None and theirs is not None and np.array_equal(ours.landmark, theirs.landmark)
    )


def _sigma_ratio(variance: float, reference: float) -> float:
    return float(np.sqrt(variance / reference)) if reference > 0 else float("nan")


def validate(dataset: Dataset, estimate: Estimate) -> None:
    """Check that an estimate has the sizes of its dataset.

    Raises
    ------
    InputError
        If an array of the estimate does not; the message names it.
    """
    k, m, r = dataset.poses, len(dataset.observations), len(dataset.robots)
    steps = (k,) if r == 1 else (r, k)
    shapes: dict[str, tuple[np.ndarray | None, tuple[int, ...]]] = {
        name: (getattr(estimate, name), (k,))
        for name in ("step_nis", "step_dof", "step_seconds", "effective_samples")
    }
    for name, series in estimate.series.items():
        shapes[f"{name}.poses"] = (series.poses, (*steps, 3))
        shapes[f"{name}.covariances"] = (series.covariances, (*steps, 3, 3))
    state = 3 * r
    if estimate.landmarks is not None:
        landmarks = estimate.landmarks
        ids, points = map_ids(landmarks), len(landmarks)
        opened = len(ids) - points
        if len(np.unique(ids)) != len(ids):
            raise InputError(f"landmark ids of {estimate.estimator} are not distinct")
        shapes["landmarks.positions"] = (landmarks.positions, (points, 2))
        shapes["landmarks.covariances"] = (landmarks.covariances, (points, 2, 2))
        shapes["landmarks.covariance"] = (landmarks.covariance, (2 * points, 2 * points))
        shapes["landmarks.inverse_depth"] = (landmarks.inverse_depth, (opened, 4))
        state += 2 * points + 4 * opened
    shapes["joint_covariance"] = (estimate.joint_covariance, (state, state))
    if estimate.innovations is not None:
        shapes["innovations.decision"] = (estimate.innovations.decision, (m,))
        shapes["innovations.landmark"] = (estimate.innovations.landmark, (m,))
        shapes["innovations.innovation"] = (estimate.innovations.innovation, (m, 2))
        shapes["innovations.S"] = (estimate.innovations.S, (m, 2, 2))
    for name, (array, shape) in shapes.items():
        if array is not None and array.shape != shape:
            raise InputError(
                f"{name} of {estimate.estimator} on {dataset.name} must have shape {shape}, "
                f"got {array.shape}"
            )
