"""The verdict `diverged`: what an estimate holds that no estimate should."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.estimates import DIVERGED, OK, Estimate, LandmarkEstimates, Trajectory
from ekfslam.evaluation.consistency import validate
from ekfslam.evaluation.trajectory import frame_motion, path_length
from ekfslam.geometry import Array

LOST_SIGMAS, LOST_SHARE = 10.0, 0.05
"""A final position off by more than both so many sigmas and this share of the path is lost."""

ROUND_OFF = float(np.sqrt(np.finfo(float).eps))
"""Negative eigenvalue of the correlation matrix that is still put down to rounding."""

JUDGED_WHOLE = 2000
"""Rows up to which a joint covariance is factored whole; a larger one is judged by its parts."""

_PART = 100  # rows of a part: so few are factored on one thread


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

    A joint covariance of more than `JUDGED_WHOLE` rows is neither copied nor factored, which would
    take n^3: it is judged by its parts, which costs a look at each number. They are every pair of
    coordinates, whose correlation must not be above 1, and the blocks of 100 neighbours. So there
    may be a negative eigenvalue that only more of it would show.

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
    if estimate.joint_covariance is not None and not _jointly_positive(estimate.joint_covariance):
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


def _jointly_positive(covariance: Array) -> bool:
    """As `_positive`, of one (n, n) that may be large: then what is necessary, in n^2 at most."""
    if len(covariance) <= JUDGED_WHOLE:
        return _positive(covariance)
    variances = np.diagonal(covariance)
    parts = [slice(start, start + _PART) for start in range(0, len(covariance), _PART)]
    if np.isnan(variances).all() and all(np.isnan(covariance[part]).all() for part in parts):
        return True
    if not np.isfinite(variances).all() or (variances < 0).any():
        return False
    sigmas = np.sqrt(np.where(variances > 0, variances, 1.0))
    largest = (1.0 + len(covariance) * ROUND_OFF) * sigmas
    return all(
        (np.abs(covariance[part]) <= sigmas[part, None] * largest).all()
        and _positive(covariance[part, part])
        for part in parts
    )


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
