"""Whether an estimate is as good as it claims: NEES, NIS, and its distance from a reference.

NEES is the squared Mahalanobis norm of the error in the estimate's own covariance, NIS that of the
innovation in its covariance S (Bar-Shalom et al. 2001, 5.4). Neither is divided by the degrees of
freedom: the expected NEES of a pose is 3, of a landmark 2.
"""

from __future__ import annotations

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
from ekfslam.mahalanobis import squared_mahalanobis


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
