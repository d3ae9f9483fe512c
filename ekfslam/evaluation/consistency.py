"""Whether an estimate is as good as it claims: NEES, NIS, and the verdict `diverged`.

NEES is the squared Mahalanobis norm of the error in the estimate's own covariance, NIS that of the
innovation in its covariance S (Bar-Shalom et al. 2001, 5.4). Neither is divided by the degrees of
freedom: the expected NEES of a pose is 3, of a landmark 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.estimates import DIVERGED, OK, Estimate, LandmarkEstimates, Trajectory
from ekfslam.evaluation.landmarks import common_landmarks, identities_shared, map_ids
from ekfslam.evaluation.statistics import rmse
from ekfslam.evaluation.trajectory import frame_motion, path_length
from ekfslam.geometry import Array

SINGULAR = 1e-10
"""Reciprocal condition number of the correlation matrix up to which a covariance is singular."""

NEGLIGIBLE = 1e-14
"""A variance this small beside the largest one is a zero with rounding on it."""

LOST_SIGMAS, LOST_SHARE = 10.0, 0.05
"""A final position off by more than both so many sigmas and this share of the path is lost."""

ROUND_OFF = float(np.sqrt(np.finfo(float).eps))
"""Negative eigenvalue of the correlation matrix that is still put down to rounding."""


def squared_mahalanobis(errors: ArrayLike, covariances: ArrayLike) -> Array:
    """``e' P^-1 e``, skipped where P cannot be inverted in earnest.

    P is scaled to its correlation matrix, so units hardly matter. It is skipped if a value is not
    finite, a variance is not above `NEGLIGIBLE` times the largest, or the smallest eigenvalue of
    the correlation matrix is not above `SINGULAR` times the largest: the first steps after an
    exactly known start, or a motion noise of lower rank. Of errors that share a covariance, by
    broadcasting, it is decomposed once.

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
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)
    sound = np.isfinite(covariances).all(axis=(-2, -1))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        floor = NEGLIGIBLE * np.max(variances, axis=-1, initial=0.0, keepdims=True)
        sound &= (variances > floor).all(axis=-1)
        # Ones stand in for what is skipped.
        sigmas = np.sqrt(np.where(sound[..., None], variances, 1.0))
        correlation = covariances / (sigmas[..., :, None] * sigmas[..., None, :])
        correlation = np.where(sound[..., None, None], correlation, np.eye(sigmas.shape[-1]))
        eigenvalues, vectors = np.linalg.eigh(correlation)
        regular = sound & (eigenvalues[..., 0] > SINGULAR * eigenvalues[..., -1])
        components = np.einsum("...ij,...i->...j", vectors, errors / sigmas)
        squares = np.sum(components**2 / eigenvalues, axis=-1)
    return np.where(regular & np.isfinite(errors).all(axis=-1), squares, np.nan)


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


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def judged(dataset: Dataset, estimate: Estimate, alignment: str = "none") -> Estimate:
    """The estimate, with status `diverged` and the reason where it is finite in name only.

    An estimate has diverged if a pose or a landmark is not finite; if a final covariance (of the
    last pose, of a landmark, of pose and map together) is not finite or has a negative eigenvalue
    that rounding does not explain; or if the truth, where known, is lost: the last position whose
    truth is known is off by more than both 10 sigmas (of the largest axis of its own covariance)
    and 5 % of the length of the true path, see `ekfslam.evaluation.path_length`. A truth of fewer
    than two positions says nothing of that. Of several robots one is enough; the reason names it. A
    covariance that is NaN throughout was not computed and is not judged.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
        Returned unchanged unless its status is `ok`.
    alignment : {"none", "se2"}
        Applied before the position is compared with the truth.

    Returns
    -------
    Estimate

    Raises
    ------
    InputError
        If the estimate does not have the sizes of the dataset.
    """
    validate(dataset, estimate)
    if estimate.status != OK:
        return estimate
    reason = next(_faults(dataset, estimate, alignment), None)
    if reason is None:
        return estimate
    message = f"{reason}; {estimate.message}" if estimate.message else reason
    return replace(estimate, status=DIVERGED, message=message)


def _faults(dataset: Dataset, estimate: Estimate, alignment: str) -> Iterator[str]:
    for name, series in estimate.series.items():
        motion = frame_motion(dataset, series, alignment)
        for index, robot in enumerate(dataset.robots):
            whose = f"{robot.name}: " if len(dataset.robots) > 1 else ""
            for fault in _series_faults(name, series.of_robot(index), robot.truth, motion):
                yield whose + fault
    yield from _landmark_faults(estimate.landmarks)
    if estimate.joint_covariance is not None and not _positive(estimate.joint_covariance):
        yield "joint covariance of final pose and map is not positive"


def _series_faults(
    name: str, series: Trajectory, truth: Array | None, motion: Array
) -> Iterator[str]:
    bad = np.flatnonzero(~np.isfinite(series.poses).all(axis=1))
    if len(bad):
        yield f"{name} pose of step {bad[0]} is not finite"
    elif series.covariances is not None and not _positive(series.covariances[-1]):
        yield f"covariance of the final {name} pose is not positive"
    elif truth is not None and (lost := _lost(name, series, truth, motion)):
        yield lost


def _landmark_faults(landmarks: LandmarkEstimates | None) -> Iterator[str]:
    if landmarks is None:
        return
    lists = (
        (landmarks.ids, landmarks.positions),
        (landmarks.undetermined, landmarks.inverse_depth),
    )
    for ids, values in lists:
        if ids is not None and values is not None and not np.isfinite(values).all():
            yield f"landmark {ids[~np.isfinite(values).all(axis=1)][0]} is not finite"
    if landmarks.covariances is not None and not _positive(landmarks.covariances):
        yield "covariance of a landmark is not positive"


def _positive(covariances: Array) -> bool:
    """Whether covariances (..., n, n) are positive semi-definite up to rounding.

    One that is NaN throughout was not computed and does not count.
    """
    covariances = covariances[~np.isnan(covariances).all(axis=(-2, -1))]
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)
    if not np.isfinite(covariances).all() or (variances < 0).any():
        return False
    # A variance of zero (an exactly known start) leaves its row as it is, which must be zero.
    sigmas = np.sqrt(np.where(variances > 0, variances, 1.0))
    correlation = covariances / (sigmas[..., :, None] * sigmas[..., None, :])
    size = covariances.shape[-1]
    try:
        np.linalg.cholesky(correlation + size * ROUND_OFF * np.eye(size))
    except np.linalg.LinAlgError:
        return False
    return True


def _lost(name: str, series: Trajectory, truth: Array, motion: Array) -> str:
    """How far the last position with a truth is off, if it is lost; otherwise nothing."""
    known = np.flatnonzero(np.isfinite(truth[:, 0]))
    if series.covariances is None or len(known) < 2:
        return ""
    last = known[-1]
    covariance = series.covariances[last]
    if not np.isfinite(covariance).all():
        return ""
    error = np.linalg.norm(geo.compose(motion, series.poses[last])[:2] - truth[last, :2])
    sigma = np.sqrt(max(np.linalg.eigvalsh(covariance[:2, :2])[-1], 0.0))
    length = path_length(truth)[last]
    if error <= LOST_SIGMAS * sigma or error <= LOST_SHARE * length:
        return ""
    which = (
        f"final {name} position" if last == len(truth) - 1 else f"{name} position of step {last}"
    )
    sigmas = f"{error / sigma:.0f} of its sigmas" if sigma > 0 else "with a sigma of zero"
    share = f", {100 * error / length:.0f} % of the path" if length > 0 else ""
    return f"{which} is {error:.3g} m off: {sigmas}{share}"
