"""What the sensors of a scenario see along the true paths."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.sensors import Sensor
from ekfslam.observations import NO_LANDMARK, padded
from ekfslam.simulation.draws import DESCRIPTORS, ROBOTS, SENSORS, shaped, stream
from ekfslam.simulation.plans import SensorPlan
from ekfslam.simulation.scenario import Scenario

PAIRS_AT_ONCE = 1_000_000  # (pose, landmark) pairs held in memory
ROUNDING = 1e-6  # [m] that a point may seem nearer than it is, and as a share of its range


class Rows(NamedTuple):
    """Rows of observations with the truth of who was seen.

    Attributes
    ----------
    step, robot, sensor : (m,) ndarray of int
    landmark : (m,) ndarray of int
        True identity, -1 for robots and clutter.
    named : (m,) ndarray of int
        Identity that the sighting carries.
    target : (m,) ndarray of int
        Robot that is seen, -1 for none.
    values : (m, 2) ndarray
    descriptor : (m,) ndarray
        NaN where there is none.
    """

    step: np.ndarray
    robot: np.ndarray
    sensor: np.ndarray
    landmark: np.ndarray
    named: np.ndarray
    target: np.ndarray
    values: Array
    descriptor: Array

    @classmethod
    def of(
        cls,
        step: np.ndarray,
        robot: int,
        sensor: int,
        values: Array,
        landmark: np.ndarray | int = NO_LANDMARK,
        target: int = NO_LANDMARK,
        descriptor: Array | float = np.nan,
    ) -> Rows:
        """Rows of one sensor of one robot; single numbers are for all rows."""
        count = len(step)
        return cls(
            step,
            np.full(count, robot),
            np.full(count, sensor),
            np.full(count, landmark),
            np.full(count, landmark),
            np.full(count, target),
            padded(values),
            np.full(count, descriptor, dtype=float),
        )

    def take(self, index: np.ndarray) -> Rows:
        """Some of the rows, in the order of an index, or those of a mask."""
        return Rows(*(column[index] for column in self))


def in_order(parts: Iterable[Rows]) -> Rows:
    """Rows put together, by step, robot and sensor; of each: landmarks, robots, clutter."""
    none = np.empty(0, dtype=np.int64)
    parts = [Rows.of(none, 0, 0, np.empty((0, 2))), *parts]
    rows = Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    what = np.where(rows.landmark >= 0, 0, np.where(rows.target >= 0, 1, 2))
    keys = (rows.landmark, rows.target, what, rows.sensor, rows.robot, rows.step)
    return rows.take(np.lexsort(keys))


def carried(scenario: Scenario) -> Iterator[tuple[int, SensorPlan, int]]:
    """Every sensor of every robot: number, plan, and robot."""
    for number, sensor in enumerate(scenario.sensor_plans):
        for robot, plan in enumerate(scenario.robot_plans):
            if sensor.carried_by(plan):
                yield number, sensor, robot


def see_landmarks(scenario: Scenario, truths: Array, seed: int, scale: float) -> Iterator[Rows]:
    """Sightings of landmarks, sensor by sensor and robot by robot.

    Parameters
    ----------
    scenario : Scenario
    truths : (R, K + 1, 3) ndarray
        True poses of the robots.
    seed : int
        Of the run.
    scale : float
        Of the noise.
    """
    poses, landmarks = truths.shape[1], scenario.landmarks
    points = np.broadcast_to(landmarks.positions, (poses, len(landmarks), 2))
    for number, sensor, robot in carried(scenario):
        random = stream(seed, SENSORS + number, robot)
        looking = scenario.looks(sensor)
        step, which, values = _see(sensor, truths[robot], points, looking, random, scale)
        described: Array | float = np.nan
        if scenario.descriptors is not None:
            random = stream(seed, SENSORS + number, robot, DESCRIPTORS)
            noise = _noise(step, which, poses, len(landmarks), random)
            described = scenario.descriptors[which] + scale * scenario.descriptor_sigma * noise
        ids = landmarks.ids[which]
        yield Rows.of(step, robot, number, values, ids, descriptor=described)


def _noise(
    step: np.ndarray, which: np.ndarray, poses: int, points: int, random: np.random.Generator
) -> Array:
    """One standard normal draw for each pose and point, of which those asked for are kept (m,)."""
    noise = np.empty(len(step))
    for some in _chunks(poses, points):
        draws = random.standard_normal((len(range(poses)[some]), points))
        mine = slice(*np.searchsorted(step, (some.start, some.stop)))
        noise[mine] = draws[step[mine] - some.start, which[mine]]
    return noise


def see_robots(scenario: Scenario, truths: Array, seed: int, scale: float) -> Iterator[Rows]:
    """Sightings of robots by others; parameters as of `see_landmarks`."""
    for number, sensor, robot in carried(scenario):
        for other in range(len(truths)):
            if sensor.mutual and other != robot:
                random = stream(seed, SENSORS + number, robot, ROBOTS, other)
                points = truths[other][:, None, :2]
                looking = scenario.looks(sensor)
                step, _, values = _see(sensor, truths[robot], points, looking, random, scale)
                yield Rows.of(step, robot, number, values, target=other)


def _see(
    sensor: Sensor,
    poses: Array,
    points: Array,
    looking: np.ndarray,
    random: np.random.Generator,
    scale: float,
) -> tuple[np.ndarray, np.ndarray, Array]:
    """Step, column and measurement of the points (K + 1, n, 2) that are seen from poses."""
    parts = []
    for some in _chunks(len(poses), points.shape[1]):
        draws = random.standard_normal((*points[some].shape[:2], 2))
        row, column = _visible(sensor, poses[some], points[some], looking[some])
        drawn = scale * draws[row, column, : sensor.view.size]
        values = _measure(sensor, poses[some][row], points[some][row, column], drawn)
        parts.append((some.start + row, column, values))
    step, column, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    return step, column, values


def _visible(
    sensor: Sensor, poses: Array, points: Array, looking: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the points (m, n, 2) that are seen from poses.

    Angles are worked out for the few points in a square about the sensor alone.
    """
    x, y, _ = geo.compose(poses, sensor.mount).T[..., None]
    reach = sensor.max_range + ROUNDING * (1.0 + sensor.max_range)
    near = (np.abs(points[..., 0] - x) <= reach) & (np.abs(points[..., 1] - y) <= reach)
    row, column = np.nonzero(near & looking[:, None])
    seen = sensor.sees(poses[row], points[row, column])
    return row[seen], column[seen]


def _chunks(poses: int, points: int) -> Iterator[slice]:
    size = max(1, PAIRS_AT_ONCE // max(1, points))
    return (slice(first, first + size) for first in range(0, poses, size))


def _measure(sensor: Sensor, poses: Array, points: Array, draws: Array) -> Array:
    """Direct model plus noise shaped from standard normal draws, (m, d)."""
    exact = sensor.view.project(geo.to_frame(geo.compose(poses, sensor.mount), points))
    values = exact + shaped(sensor.covariances(exact), draws)
    if sensor.view.names[0] == "range" and (values[:, 0] < 0).any():
        # Drawing again, or clipping, would bias the noise.
        near = exact[np.argmin(values[:, 0]), 0]
        raise InputError(
            f"noise made a range of {near:.3g} m of {sensor.name} negative; raise its min_range"
        )
    return np.where(sensor.view.angular, geo.wrap(values), values)


def introduce_slowly(seen: Rows, limit: int, landmarks: int, random: np.random.Generator) -> Rows:
    """Keep the sightings of landmarks seen before and, each step, of `limit` others.

    Parameters
    ----------
    seen : Rows
        Of landmarks, in order.
    limit, landmarks : int
        How many may be new in a step, and how many there are.
    random : Generator
    """
    mapped: set[int] = set()
    keep = np.ones(len(seen.step), dtype=bool)
    bounds = np.flatnonzero(np.diff(seen.step, prepend=-1, append=-1))
    for first, stop in pairwise(bounds):
        if len(mapped) == landmarks:
            break
        rows = seen.landmark[first:stop].tolist()
        fresh = sorted(set(rows) - mapped)
        mapped.update(random.permutation(fresh)[:limit].tolist())
        keep[first:stop] = [landmark in mapped for landmark in rows]
    return seen.take(keep)
