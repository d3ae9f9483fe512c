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
from ekfslam.registry import Estimator, linear_oracle, resolve
from ekfslam.simulation import load_scenario, simulate

RIGID_MOTION = np.array([50.0, -30.0, 2.0])
SCALES = (1 / 12, 1 / 24, 1 / 48)  # above, the second order of the gap can hide the first
SLIP = 1e-4 / SCALES[-1]  # [m]; keeps lateral noise above what smoothers can take for regular
DRAWS = 4  # the gap of a single draw can pass through zero on its way
STEP = 1e-6  # of central differences, whose own error is then near 1e-9
SMALL_NOISE = "gap to batch shrinks with the square of the noise"


class Measurement(NamedTuple):
    """A figure and where it was found."""

    value: float
    detail: str


def _estimate(
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


def _linearizations(subject: Estimator, dataset: Dataset) -> tuple[Estimate, Linearizations]:
    method = getattr(subject, "linearizations", None)
    if method is None:
        raise UnsupportedError(
            "needs a method linearizations(dataset) that returns the estimate and the "
            "Linearizations behind it (ekfslam.estimates)"
        )
    return method(dataset)


def _worst(parts: dict[str, Any], subject: str = "largest in") -> Measurement:
    """The largest of several deviations; NaN counts as infinite."""
    sizes = {
        name: float(np.max(np.nan_to_num(np.abs(part), nan=np.inf), initial=0.0))
        for name, part in parts.items()
    }
    name = max(sizes, key=lambda key: sizes[key])
    return Measurement(sizes[name], f"{subject} {name}")


def _by_id(landmarks: LandmarkEstimates, ids: np.ndarray) -> np.ndarray:
    """Positions in the landmarks of the given identities."""
    where = {int(landmark): i for i, landmark in enumerate(landmarks.ids)}
    missing = [int(i) for i in ids if int(i) not in where]
    if missing:
        raise RuntimeError(f"landmark {missing[0]} is missing in the estimate")
    return np.array([where[int(i)] for i in ids], dtype=np.int64)


# 1 ----------------------------------------------------------------------------------------------


def central_differences(function: Callable[[Array], Array], point: Array) -> Array:
    """Derivative of a vectorised function: (n, d) -> (n, m) gives (n, m, d).

    The function returns differences from its value at `point`, so that angles can be wrapped.
    """
    columns = []
    for axis in range(point.shape[1]):
        nudge = np.zeros(point.shape[1])
        nudge[axis] = STEP
        columns.append((function(point + nudge) - function(point - nudge)) / (2 * STEP))
    return np.stack(columns, axis=-1)


def jacobians(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Compare every Jacobian that the filter used with central differences of the models."""
    _, linear = _linearizations(subject, dataset)
    deltas = dataset.moves.deltas
    numeric = central_differences(
        lambda pose: geo.additive_error(linear.motion_to, geo.compose(pose, deltas)),
        linear.motion_from,
    )
    deviations = {"the motion": numeric - linear.motion_jacobian}
    sensor_of = dataset.observations.sensor[linear.row]
    values = dataset.observations.values[linear.row]
    for index, sensor in enumerate(dataset.sensors):
        seen = (sensor_of == index) & ~linear.new
        expected = sensor.observe(linear.point[seen, :3], linear.point[seen, 3:])[0]

        def observe(point: Array, sensor: Any = sensor, expected: Array = expected) -> Array:
            return sensor.difference(sensor.observe(point[:, :3], point[:, 3:])[0], expected)

        numeric = central_differences(observe, linear.point[seen])
        deviations[f"observations of the {sensor.name}"] = numeric - linear.jacobian[seen]
        new = (sensor_of == index) & linear.new

        def locate(pose: Array, sensor: Any = sensor, new: np.ndarray = new) -> Array:
            return sensor.locate(pose, values[new])[0]

        numeric = central_differences(locate, linear.point[new, :3])
        deviations[f"new landmarks of the {sensor.name}"] = numeric - linear.jacobian[new, :, :3]
    return _worst(deviations)


# 2 ----------------------------------------------------------------------------------------------


def zero_noise(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Estimate data drawn without noise (which still state theirs) and compare with the truth."""
    clean = simulate(scenario, seed=seed, draw=0.0)
    _, trajectory, landmarks = _estimate(subject, clean)
    assert clean.truth is not None
    assert clean.true_map is not None
    deviations = {"the poses": geo.additive_error(clean.truth, trajectory.poses)}
    if len(landmarks):
        truth = dict(zip(clean.true_map.ids.tolist(), clean.true_map.positions, strict=True))
        true_positions = np.array([truth[int(i)] for i in landmarks.ids])
        deviations["the landmarks"] = landmarks.positions - true_positions
    return _worst(deviations)


# 3 ----------------------------------------------------------------------------------------------


def oracle(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Solve the filter's own linear models in one go and compare means and joint covariance."""
    estimate, linear = _linearizations(subject, dataset)
    joint, trajectory, landmarks = estimate.joint_covariance, estimate.online, estimate.landmarks
    if joint is None or trajectory is None or landmarks is None:
        raise UnsupportedError("needs the joint covariance of final pose and landmarks")
    solution = linear_oracle()(dataset.prior, linear)
    order = _by_id(landmarks, solution.ids)
    rows = np.concatenate([np.arange(3), (3 + 2 * order[:, None] + np.arange(2)).reshape(-1)])
    covariance = joint[np.ix_(rows, rows)] - solution.covariance
    return _worst(
        {
            "the final pose": geo.additive_error(solution.pose, trajectory.poses[-1]),
            "the landmarks": landmarks.positions[order] - solution.positions,
            "the joint covariance (relative)": covariance / np.abs(solution.covariance).max(),
        }
    )


# 4 ----------------------------------------------------------------------------------------------


def rigid_motion(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Move the world by (50 m, -30 m, 2 rad) and see whether the answer moves with it."""
    _, here, map_here = _estimate(subject, dataset)
    _, there, map_there = _estimate(subject, dataset.moved(RIGID_MOTION))
    moved = geo.from_frame(RIGID_MOTION, map_here.positions)
    deviations = {
        "the poses": geo.additive_error(geo.compose(RIGID_MOTION, here.poses), there.poses),
        "the landmarks": moved - map_there.positions[_by_id(map_there, map_here.ids)],
    }
    if here.covariances is not None and there.covariances is not None:
        turned = geo.congruence(geo.heading_block(RIGID_MOTION[2]), here.covariances)
        scale = np.abs(turned).max()
        deviations["the covariances (relative)"] = (there.covariances - turned) / scale
    return _worst(deviations)


# 5 ----------------------------------------------------------------------------------------------


def small_noise(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Exponent of the gap to the batch smoother over the same draws at smaller and smaller noise.

    An EKF differs from the smoother in second order only; a wrong Jacobian or a wrong noise shows
    in first order, also where the filter's own linearisations hide it.
    """
    regular = load_scenario(scenario)
    motion = replace(regular.motion, slip=max(SLIP, regular.motion.slip))
    regular = replace(regular, motion=motion)
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


def _gap(subject: Estimator, data: Dataset) -> float:
    """Root mean square distance to the batch of the final position and the landmarks [m]."""
    _, ours, landmarks = _estimate(subject, data)
    if not len(landmarks):
        raise UnsupportedError("needs an estimator of landmarks")
    _, best, best_landmarks = _estimate(resolve("gtsam-batch", marginals=False), data)
    final = ours.poses[-1, :2] - best.poses[-1, :2]
    shared = best_landmarks.positions[_by_id(best_landmarks, landmarks.ids)]
    apart = np.concatenate([final[None], landmarks.positions - shared])
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))


LADDER: tuple[tuple[str, float, Callable[..., Measurement]], ...] = (
    ("Jacobians equal central differences", 1e-6, jacobians),
    ("no noise returns the truth", 1e-9, zero_noise),
    ("linear oracle gives means and joint covariance", 1e-9, oracle),
    ("moving the world moves the answer", 1e-8, rigid_motion),
    (SMALL_NOISE, 1.7, small_noise),
)
