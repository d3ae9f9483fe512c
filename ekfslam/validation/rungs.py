"""What each rung of the ladder measures.

A rung is a function of (estimator, dataset, scenario, seed) that returns the largest deviation and
where it was found. NaN fails every bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.differences import central_differences
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import (
    FAILED,
    SKIPPED,
    Estimate,
    LandmarkEstimates,
    Linearizations,
    Trajectory,
)
from ekfslam.geometry import Array
from ekfslam.models.landmarks import inverse_depth, observe_inverse_depth, to_point
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import BEARING, RANGE, Sensor
from ekfslam.registry import Estimator, linear_oracle, resolve
from ekfslam.simulation import load_scenario, simulate

RIGID_MOTION = np.array([50.0, -30.0, 2.0])
SCALES = (1 / 12, 1 / 24, 1 / 48)  # above, the second order of the gap can hide the first
SLIP = 1e-4 / SCALES[-1]  # [m]; keeps lateral noise above what smoothers can take for regular
FLOOR = 1e-5  # of odometry noise in the smoother (m, rad): below all that the scales leave
DRAWS = 4  # the gap of a single draw can pass through zero on its way
SMALL_NOISE = "gap to batch shrinks with the square of the noise"


class Measurement(NamedTuple):
    """A figure and where it was found."""

    value: float
    detail: str


def estimated(
    subject: Estimator, dataset: Dataset
) -> tuple[Estimate, Trajectory, LandmarkEstimates]:
    """The estimate with its parts, or the reason why there is none."""
    estimate = subject.estimate(dataset)
    if estimate.status == SKIPPED:
        raise UnsupportedError(estimate.message)
    trajectory, landmarks = estimate.final_trajectory, estimate.landmarks
    if estimate.status == FAILED or trajectory is None:
        raise RuntimeError(estimate.message or "the estimate holds no trajectory")
    if estimate.association not in ("", "known"):
        raise UnsupportedError("needs known association: else landmarks have the filter's numbers")
    if landmarks is None:  # dead reckoning has no map
        landmarks = LandmarkEstimates(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
    return estimate, trajectory, landmarks


def refuse_samples(estimate: Estimate, reason: str) -> None:
    """Some questions do not fit a filter whose poses are drawn at random."""
    if estimate.effective_samples is not None:
        raise UnsupportedError(f"particles are drawn with the noise of the model: {reason}")


def _linearizations(subject: Estimator, dataset: Dataset) -> tuple[Estimate, Linearizations]:
    method = getattr(subject, "linearizations", None)
    if method is None:
        raise UnsupportedError(
            "needs a method linearizations(dataset) that returns the estimate and the "
            "Linearizations behind it (ekfslam.estimates)"
        )
    return method(dataset)


def worst(parts: dict[str, Any], subject: str = "largest in") -> Measurement:
    """The largest of several deviations; NaN counts as infinite."""
    sizes = {
        name: float(np.max(np.nan_to_num(np.abs(part), nan=np.inf), initial=0.0))
        for name, part in parts.items()
    }
    name = max(sizes, key=lambda key: sizes[key])
    return Measurement(sizes[name], f"{subject} {name}")


def _by_id(known: np.ndarray, ids: np.ndarray, whose: str = "the estimate") -> np.ndarray:
    """Where each of some identities is among the known ones."""
    where = {int(landmark): i for i, landmark in enumerate(known)}
    missing = [int(i) for i in ids if int(i) not in where]
    if missing:
        raise RuntimeError(f"landmark {missing[0]} is missing in {whose}")
    return np.array([where[int(i)] for i in ids], dtype=np.int64)


def _undetermined(landmarks: LandmarkEstimates) -> tuple[np.ndarray, Array]:
    """Identities and parameters of the landmarks of open distance, none if there are none."""
    if landmarks.undetermined is None or landmarks.inverse_depth is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 4))
    return landmarks.undetermined, landmarks.inverse_depth


def _refuse(dataset: Dataset, views: tuple[int, ...], reason: str) -> None:
    """A question that some views do not allow."""
    for sensor in dataset.sensors:
        if sensor.view.code in views:
            raise UnsupportedError(f"{sensor.name} reports {sensor.kind} alone: {reason}")


# 1 ----------------------------------------------------------------------------------------------


def jacobians(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Compare every Jacobian that the filter used with central differences of the models."""
    _, linear = _linearizations(subject, dataset)
    before, after = (part.reshape(-1, 3) for part in (linear.motion_from, linear.motion_to))
    deltas = dataset.moves.deltas.reshape(-1, 3)
    numeric = central_differences(
        lambda pose: geo.additive_error(after, geo.compose(pose, deltas)), before
    )
    deviations = {"the motion": numeric - linear.motion_jacobian.reshape(-1, 3, 3)}
    sensor_of = np.where(linear.row < 0, -1, dataset.observations.sensor[linear.row])
    for index, sensor in enumerate(dataset.sensors):
        mine = sensor_of == index
        for size in np.unique(linear.size[mine]).tolist():
            for event, words, compare in (
                (linear.OBSERVED, "observations of", _observed),
                (linear.CREATED, "new landmarks of", _created),
            ):
                # One that waited for others to determine it has no equation of its own.
                rows = mine & (linear.event == event) & (linear.size == size) & (linear.rows > 0)
                if rows.any():
                    deviation = compare(dataset, linear, rows, sensor, size)
                    deviations[f"{words} the {sensor.name} ({size} coordinates)"] = deviation
    rows = linear.event == linear.CONVERTED
    direction = linear.point[rows, 3:]
    place = to_point(direction)[0]
    numeric = central_differences(lambda landmark: to_point(landmark)[0] - place, direction)
    deviations["conversions to points"] = numeric - linear.jacobian[rows, :2, 3:]
    return worst(deviations)


def _observed(
    dataset: Dataset, linear: Linearizations, rows: np.ndarray, sensor: Sensor, size: int
) -> Array:
    """Deviations of direct models, with respect to pose and target."""

    def observe(point: Array) -> Array:
        pose, target = point[:, :3], point[:, 3:]
        if size == 4:
            return observe_inverse_depth(sensor, pose, target)[0]
        return sensor.observe(pose, target[:, :2])[0]  # of a robot, the position is seen

    point = linear.point[rows, : 3 + size]
    expected = observe(point)
    numeric = central_differences(lambda moved: sensor.difference(observe(moved), expected), point)
    return numeric - linear.jacobian[rows, : sensor.view.size, : 3 + size]


def _created(
    dataset: Dataset, linear: Linearizations, rows: np.ndarray, sensor: Sensor, size: int
) -> Array:
    """Deviations of inverse models, with respect to the pose.

    A landmark of infinite uncertainty is put in without regard to the pose.
    """
    rows = rows & linear.jacobian.any(axis=(1, 2))
    pose, created = linear.point[rows, :3], linear.point[rows, 3 : 3 + size]
    values = dataset.observations.values[linear.row[rows], : sensor.view.size]
    if size == 4:
        place = inverse_depth(sensor, pose, values, created[:, 3])[0]
    elif sensor.view.back_project is not None:
        place = sensor.locate(pose, values)[0]
    else:  # a naive prior has put the point where it is in the sensor's frame
        local = geo.to_frame(geo.compose(pose, sensor.mount), created)

    def locate(moved: Array) -> Array:
        if size == 4:
            there = inverse_depth(sensor, moved, values, created[:, 3])[0] - place
            there[:, 2] = geo.wrap(there[:, 2])
            return there
        if sensor.view.back_project is not None:
            return sensor.locate(moved, values)[0] - place
        return geo.from_frame(geo.compose(moved, sensor.mount), local) - created

    return central_differences(locate, pose) - linear.jacobian[rows, :size, :3]


# 2 ----------------------------------------------------------------------------------------------


def zero_noise(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Estimate data drawn without noise (which still state theirs) and compare with the truth."""
    _refuse(dataset, (BEARING,), "the prior of its distance is not the truth")
    clean = simulate(scenario, seed=seed, draw=0.0)
    estimate, trajectory, landmarks = estimated(subject, clean)
    refuse_samples(estimate, "they do not return the truth")
    assert clean.true_map is not None
    truth = np.array([robot.truth for robot in clean.robots]).reshape(trajectory.poses.shape)
    deviations = {"the poses": geo.additive_error(truth, trajectory.poses)}
    if len(landmarks):
        true = clean.true_map.positions[_by_id(clean.true_map.ids, landmarks.ids, "the world")]
        deviations["the landmarks"] = landmarks.positions - true
    return worst(deviations)


# 3 ----------------------------------------------------------------------------------------------


def oracle(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Solve the filter's own linear models in one go and compare means and joint covariance."""
    estimate, linear = _linearizations(subject, dataset)
    joint, trajectory, landmarks = estimate.joint_covariance, estimate.online, estimate.landmarks
    if joint is None or trajectory is None or landmarks is None:
        raise UnsupportedError("needs the joint covariance of final pose and landmarks")
    solution = linear_oracle()([robot.prior for robot in dataset.robots], linear)
    open_ids, directions = _undetermined(landmarks)
    # The oracle also knows the landmarks that the filter has deleted.
    points = _by_id(solution.ids, landmarks.ids, "the linear oracle")
    beyond = _by_id(solution.undetermined, open_ids, "the linear oracle")
    poses = solution.poses.size
    first = poses + 2 * len(solution.ids)
    places = poses + 2 * points[:, None] + np.arange(2), first + 4 * beyond[:, None] + np.arange(4)
    rows = np.concatenate([np.arange(poses), *(place.reshape(-1) for place in places)])
    covariance = solution.covariance[np.ix_(rows, rows)]
    ahead = directions - solution.inverse_depth[beyond]
    ahead[:, 2] = geo.wrap(ahead[:, 2])
    final = trajectory.poses[..., -1, :].reshape(-1, 3)
    return worst(
        {
            "the final poses": geo.additive_error(solution.poses, final),
            "the landmarks": landmarks.positions - solution.positions[points],
            "the inverse depths": ahead,
            "the joint covariance (relative)": (joint - covariance) / np.abs(covariance).max(),
        }
    )


# 4 ----------------------------------------------------------------------------------------------


def rigid_motion(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Move the world by (50 m, -30 m, 2 rad) and see whether the answer moves with it."""
    _, here, map_here = estimated(subject, dataset)
    _, there, map_there = estimated(subject, dataset.moved(RIGID_MOTION))
    moved = geo.from_frame(RIGID_MOTION, map_here.positions)
    (ids, ahead), (ids_there, ahead_there) = map(_undetermined, (map_here, map_there))
    turned = np.concatenate([geo.compose(RIGID_MOTION, ahead[:, :3]), ahead[:, 3:]], axis=1)
    beyond = turned - ahead_there[_by_id(ids_there, ids)]
    beyond[:, 2] = geo.wrap(beyond[:, 2])
    deviations = {
        "the poses": geo.additive_error(geo.compose(RIGID_MOTION, here.poses), there.poses),
        "the landmarks": moved - map_there.positions[_by_id(map_there.ids, map_here.ids)],
        "the inverse depths": beyond,
    }
    if here.covariances is not None and there.covariances is not None:
        turned = geo.congruence(geo.heading_block(RIGID_MOTION[2]), here.covariances)
        scale = np.abs(turned).max()
        deviations["the covariances (relative)"] = (there.covariances - turned) / scale
    return worst(deviations)


# 5 ----------------------------------------------------------------------------------------------


def small_noise(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Exponent of the gap to the batch smoother over the same draws at smaller and smaller noise.

    An EKF differs from the smoother in second order only; a wrong Jacobian or a wrong noise shows
    in first order, also where the filter's own linearisations hide it.
    """
    _refuse(dataset, (BEARING, RANGE), "how a landmark starts counts in first order")
    regular = load_scenario(scenario)
    regular = replace(
        regular,
        motion=_with_slip(regular.motion),
        team=tuple(replace(plan, motion=_with_slip(plan.motion)) for plan in regular.team),
    )
    gaps = []
    for scale in SCALES:
        draws = [simulate(regular, seed=seed + i, noise=scale) for i in range(DRAWS)]
        gaps.append(float(np.sqrt(np.mean([_gap(subject, data) ** 2 for data in draws]))))
    listed = ", ".join(f"{gap:.1e}" for gap in gaps)
    if not np.isfinite(gaps).all():
        return Measurement(float("nan"), f"gaps {listed} m")
    if max(gaps) < 1e-7:
        return Measurement(2.0, f"gaps {listed} m: the same optimum")
    # The least of the successive exponents: a fit would smooth over a gap that does not shrink.
    exponent = np.min(np.diff(np.log(np.maximum(gaps, 1e-300))) / np.diff(np.log(SCALES)))
    scales = ", ".join(f"1/{1 / scale:.0f}" for scale in SCALES)
    return Measurement(float(exponent), f"gaps {listed} m at noise {scales}")


def _with_slip(motion: MotionModel) -> MotionModel:
    return replace(motion, slip=max(SLIP, motion.slip))


def _gap(subject: Estimator, data: Dataset) -> float:
    """Root mean square distance to the batch of the final positions and the landmarks [m]."""
    estimate, ours, landmarks = estimated(subject, data)
    refuse_samples(estimate, "their error is of first order in it")
    if not len(landmarks):
        raise UnsupportedError("needs an estimator of landmarks")
    smoother = resolve("gtsam-batch", marginals=False, odometry_floor=FLOOR)
    _, best, best_landmarks = estimated(smoother, data)
    final = (ours.poses - best.poses)[..., -1, :2].reshape(-1, 2)
    shared = best_landmarks.positions[_by_id(best_landmarks.ids, landmarks.ids)]
    apart = np.concatenate([final, landmarks.positions - shared])
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))


LADDER: tuple[tuple[str, float, Callable[..., Measurement]], ...] = (
    ("Jacobians equal central differences", 1e-6, jacobians),
    ("no noise returns the truth", 1e-9, zero_noise),
    ("linear oracle gives means and joint covariance", 1e-9, oracle),
    ("moving the world moves the answer", 1e-8, rigid_motion),
    (SMALL_NOISE, 1.7, small_noise),
)
