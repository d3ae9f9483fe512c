"""Small problems that are hard on frames, made by hand, and their dense least squares."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
from numerics import central_difference

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.estimates import Estimate, LandmarkEstimates, Trajectory
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations, padded
from ekfslam.robots import LandmarkMap, Prior, Robot

START = np.array([[0.09, 0.01, 0.02], [0.01, 0.01, 0], [0.02, 0, 0.04]])
INCREMENT = np.array([[9e-3, 2e-3, 4e-4], [2e-3, 1e-3, -2e-4], [4e-4, -2e-4, 1e-3]])
MAP = LandmarkMap([3, 5, 8, 13, 21], [[2, 3], [4, -1], [-2, 2], [1, -3], [5, 2]])
STARTS = np.array([[0.5, -0.5, 2.5], [3.0, 1.0, -1.0], [-1.0, -2.0, 0.3]])


def scanner(*mount: float) -> Sensor:
    return Sensor("range-bearing", [[0.01, 0.001], [0.001, 0.0004]], mount=mount or np.zeros(3))


def camera(*mount: float) -> Sensor:
    return Sensor("xy", [[0.04, 0.01], [0.01, 0.02]], mount=mount or np.zeros(3))


def compass(*mount: float) -> Sensor:
    return Sensor("bearing", [[0.0004]], mount=mount or np.zeros(3))


def sonar(*mount: float) -> Sensor:
    return Sensor("range", [[0.01]], mount=mount or np.zeros(3))


def problem(
    *sensors: Sensor,
    robots: int = 1,
    meet: Any = (),
    known_start: bool = False,
    steps: int = 9,
    turn: float = 1.0,
    landmarks: LandmarkMap = MAP,
    noise: float = 1.0,
    seed: int = 0,
) -> Dataset:
    """Robots with large turns and anisotropic correlated noise, landmarks always in view.

    Parameters
    ----------
    *sensors : Sensor
        On every robot.
    robots : int
        Up to three.
    meet : sequence of int
        Sensors that see the other robots too.
    known_start : bool
    steps : int
    turn : float
        Factor on the turns; 0 goes straight on.
    landmarks : LandmarkMap
    noise : float
        Standard deviations that are drawn, over those that are stated.
    seed : int
    """
    rng = np.random.default_rng(seed)

    def draw(covariance: Any, count: int | None = None) -> Any:
        return noise * rng.multivariate_normal(np.zeros(len(covariance)), covariance, size=count)

    crew = []
    for index in range(robots):
        turns = turn * np.roll(np.resize([1.2, -0.8, 0.9], steps), index)
        controls = np.column_stack([np.full((steps, 2), [0.8, 0.2]), turns])
        truth = geo.integrate(STARTS[index], controls)
        prior = Prior(truth[0])
        if not known_start:
            off = truth[0] + draw(START)
            prior = Prior([*off[:2], geo.wrap(off[2])], START)
        measured = controls + draw(INCREMENT, steps)
        motion = MotionModel("odometry", covariance=INCREMENT)
        crew.append(Robot(motion, measured, prior, truth, f"robot-{index}"))
    columns: dict[str, list[Any]] = {
        name: [] for name in ("step", "robot", "sensor", "landmark", "observed_robot", "values")
    }
    for k in range(steps + 1):
        for r, robot in enumerate(crew):
            for s, sensor in enumerate(sensors):
                points = zip(landmarks.ids.tolist(), landmarks.positions, strict=True)
                targets = [(i, -1, point) for i, point in points]
                if s in meet:
                    targets += [
                        (-1, o, other.truth[k, :2]) for o, other in enumerate(crew) if o != r
                    ]
                for landmark, other, point in targets:
                    exact = sensor.observe(robot.truth[k], point)[0]
                    value = exact + draw(sensor.covariances(exact))
                    turned = sensor.difference(value, np.zeros_like(value))  # wrapped
                    entries = (k, r, s, landmark, other, padded(turned))
                    for column, entry in zip(columns.values(), entries, strict=True):
                        column.append(entry)
    return Dataset(
        name="by hand",
        robots=tuple(crew),
        times=np.arange(steps + 1.0),
        sensors=sensors,
        observations=Observations(**columns),
        true_map=landmarks,
        true_landmark=columns["landmark"],
    )


def truths(dataset: Dataset) -> Any:
    """True poses (R, K + 1, 3)."""
    return np.array([robot.truth for robot in dataset.robots])


def near(dataset: Dataset, rng: Any = None, size: float = 0.0) -> Estimate:
    """An estimate at the truth, or about it; a start that is known exactly stays there."""
    poses, points = truths(dataset), dataset.true_map.positions
    if rng is not None:
        poses = poses + size * rng.normal(size=poses.shape) * [1, 1, 0.5]
        points = points + size * rng.normal(size=points.shape)
    for robot, chain in zip(dataset.robots, poses, strict=True):
        if not robot.prior.covariance.any():
            chain[0] = robot.prior.mean
    poses = poses if len(poses) > 1 else poses[0]
    landmarks = LandmarkEstimates(dataset.true_map.ids, points)
    return Estimate("near", dataset.name, online=Trajectory(poses), landmarks=landmarks)


def rows_kept(dataset: Dataset, keep: Any) -> Dataset:
    """A dataset with some of its observations."""
    columns = {f.name: getattr(dataset.observations, f.name) for f in fields(Observations)}
    kept = Observations(**{name: c if c is None else c[keep] for name, c in columns.items()})
    return replace(dataset, observations=kept, true_landmark=dataset.true_landmark[keep])


def first_steps(dataset: Dataset, count: int) -> Dataset:
    """The first poses of a dataset, with what was seen from them."""
    robots = tuple(
        replace(robot, controls=robot.controls[: count - 1], truth=robot.truth[:count])
        for robot in dataset.robots
    )
    start = rows_kept(dataset, dataset.observations.step < count)
    return replace(start, robots=robots, times=dataset.times[:count])


class DenseSmoother:
    """Least squares over all poses and landmarks, additive in (x, y, theta) and (x, y).

    Errors of pose and motion are those of gtsam, ``Log(measured^-1 actual)``, with the covariance
    of the additive error turned into that frame; they agree with additive errors to first order.
    """

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        landmark = dataset.observations.landmark
        self.ids = np.unique(landmark[landmark >= 0])
        self.sizes = 3 * len(dataset.robots) * dataset.poses, 2 * len(self.ids)

    def residuals(self, x: Any) -> Any:
        """Whitened residuals, (rows,)."""
        dataset, seen = self.dataset, self.dataset.observations
        poses = x[: self.sizes[0]].reshape(len(dataset.robots), dataset.poses, 3)
        points = x[self.sizes[0] :].reshape(-1, 2)
        parts = []
        for robot, chain in zip(dataset.robots, poses, strict=True):
            deltas, noise = robot.increments
            moved = geo.log(geo.between(deltas, geo.between(chain[:-1], chain[1:])))
            parts.append(_whitened(geo.additive_to_body(deltas, noise), moved))
            if (prior := robot.prior).covariance.any():
                off = geo.log(geo.between(prior.mean, chain[0]))
                parts.append(_whitened(geo.additive_to_body(prior.mean, prior.covariance), off))
        for index, sensor in enumerate(dataset.sensors):
            for robots in (False, True):
                rows = (seen.sensor == index) & ((dataset.observed_robot >= 0) == robots)
                if robots:
                    target = poses[dataset.observed_robot[rows], seen.step[rows], :2]
                else:
                    target = points[np.searchsorted(self.ids, seen.landmark[rows])]
                expected = sensor.observe(poses[seen.robot[rows], seen.step[rows]], target)[0]
                values = seen.values[rows, : sensor.view.size]
                error = sensor.difference(expected, values)
                parts.append(_whitened(sensor.covariances(values), error))
        return np.concatenate(parts)

    def solve(self, x: Any) -> tuple[Any, Any]:
        """Minimum near x, and covariance there; an exactly known start stays where it is."""
        fixed = [
            3 * self.dataset.poses * index + np.arange(3)
            for index, robot in enumerate(self.dataset.robots)
            if not robot.prior.covariance.any()
        ]
        free = np.setdiff1d(np.arange(len(x)), np.array(fixed))
        x = x.copy()

        def at(step: Any) -> Any:
            moved = x.copy()
            moved[free] += step
            return self.residuals(moved)

        for _ in range(10):
            J = central_difference(at, np.zeros(len(free)), step=0.01)
            step = -np.linalg.lstsq(J, self.residuals(x), rcond=None)[0]
            x[free] += step
            if np.abs(step).max() < 1e-8:
                break
        covariance = np.zeros((len(x), len(x)))
        covariance[np.ix_(free, free)] = np.linalg.inv(J.T @ J)
        return x, covariance


def _whitened(covariance: Any, error: Any) -> Any:
    return np.linalg.solve(np.linalg.cholesky(covariance), error[..., None]).reshape(-1)


def stacked(estimate: Estimate) -> Any:
    """Poses and landmarks of a smoother as one vector."""
    return np.concatenate([estimate.smoothed.poses.ravel(), estimate.landmarks.positions.ravel()])


def gap(one: Estimate, other: Estimate) -> float:
    """Largest difference between the poses and the landmarks of two smoothers."""
    poses = geo.additive_error(one.smoothed.poses, other.smoothed.poses)
    points = one.landmarks.positions - other.landmarks.positions
    return max(np.abs(poses).max(), np.abs(points).max())


def diagonal_blocks(covariance: Any, start: int, count: int, size: int) -> Any:
    at = start + size * np.arange(count)[:, None] + np.arange(size)
    return covariance[at[:, :, None], at[:, None, :]]


def assert_solves(estimate: Estimate, dataset: Dataset, sure: float = 1e-7) -> None:
    """The estimate is the dense optimum, its covariances the inverse of the dense information.

    An objective near 100 is known to 1e-14, so a descent ends within 1e-7 standard deviations, of
    up to a metre; covariances are right to `sure` beside the largest.
    """
    assert estimate.status == "ok", estimate.message
    x, covariance = DenseSmoother(dataset).solve(stacked(estimate))
    np.testing.assert_allclose(stacked(estimate), x, rtol=0, atol=1e-6)
    count = dataset.poses * len(dataset.robots)
    poses = diagonal_blocks(covariance, 0, count, 3).reshape(estimate.smoothed.covariances.shape)
    points = diagonal_blocks(covariance, 3 * count, len(estimate.landmarks), 2)
    for actual, expected in (
        (estimate.smoothed.covariances, poses),
        (estimate.landmarks.covariances, points),
    ):
        np.testing.assert_allclose(
            actual,
            expected,
            rtol=0,
            atol=sure * np.abs(expected).max(),
        )
