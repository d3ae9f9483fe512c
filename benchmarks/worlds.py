"""Made data: every landmark is seen once at first, and then a few at each step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import ekfslam
from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, LandmarkMap, Observations, Prior, Robot
from ekfslam.simulation.paths import tour
from ekfslam.simulation.worlds import streets

PER_STEP = 5
STRIDE, RANGE = 1.6, 12.0  # of the tour and its scanner [m]
SURVEYED = 100  # landmarks that a step of the city's survey maps
BLIND = 20  # steps at the end of a run in which nothing is seen
NOISE = np.diag([0.1**2, 0.02**2])  # of range and bearing [m², rad²]
MOTION = np.diag([0.01**2, 0.01**2, 0.002**2])


def ring(landmarks: int, steps: int) -> Dataset:
    """A robot on a circle inside a ring of landmarks that sees any five of them at a step.

    No two steps touch the same part of the map: the worst case for what works on a part of it.
    """
    rng = np.random.default_rng(1)
    angle = geo.TAU * np.arange(landmarks) / landmarks
    points = 20.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    controls = np.tile([0.2, 0.0, 0.02], (steps, 1))
    truth = geo.integrate(np.array([10.0, 0.0, np.pi / 2]), controls)
    some = [rng.choice(landmarks, PER_STEP, replace=False) for _ in range(steps - 1)]
    return _dataset("ring", points, controls, truth, [np.arange(landmarks), *some], rng)


def city(landmarks: int, steps: int) -> Dataset:
    """The tour of the scenario ``city``, of which a survey has mapped every landmark beforehand.

    Before it sets out, the robot is shown a hundred landmarks a step, street by street. On its tour
    it sees what is ahead of it within 12 m: five at a step or so.
    """
    rng = np.random.default_rng(2)
    points = streets(landmarks, seed=1)
    path = tour(landmarks, STRIDE, steps=steps)
    survey = np.array_split(np.arange(landmarks), -(-landmarks // SURVEYED))
    still = np.zeros((len(survey), 3))
    controls = np.concatenate([still, path.controls])
    truth = geo.integrate(path.start, controls)
    seen = [*survey, *(ahead(points, pose) for pose in truth[len(survey) + 1 :])]
    return _dataset("city", points, controls, truth, seen, rng)


def ahead(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Landmarks within range and field of view of the scenario's scanner."""
    way = points - pose[:2]
    facing = way @ np.array([np.cos(pose[2]), np.sin(pose[2])]) >= 0
    return np.flatnonzero(facing & ((way**2).sum(axis=1) < RANGE**2))


def _dataset(
    name: str,
    points: np.ndarray,
    controls: np.ndarray,
    truth: np.ndarray,
    seen: list[np.ndarray],
    rng: np.random.Generator,
) -> Dataset:
    """What is seen from step 1 on, with noise."""
    step = np.repeat(np.arange(1, len(seen) + 1), [len(some) for some in seen])
    which = np.concatenate(seen)
    sensor = ekfslam.Sensor("range-bearing", NOISE)
    values = sensor.observe(truth[step], points[which])[0]
    values = values + rng.normal(size=values.shape) * np.sqrt(np.diag(NOISE))
    motion = ekfslam.MotionModel("odometry", MOTION)
    return Dataset(
        name,
        (Robot(motion, controls, Prior(truth[0]), truth),),
        np.arange(len(truth)) * 1.0,
        (sensor,),
        Observations(step, values, which),
        true_map=LandmarkMap(np.arange(len(points)), points),
    )


def mapped_after(data: Dataset) -> int:
    """Poses after which every landmark has been seen."""
    first = np.unique(data.observations.landmark, return_index=True)[1]
    return 1 + int(data.observations.step[first].max())


def shortened(data: Dataset, steps: int, blind: int = 0) -> Dataset:
    """The first steps after the map is complete, and some more in which nothing is seen."""
    seen = mapped_after(data) + steps
    poses = seen + blind
    robot, o = data.robot, data.observations
    truth = None if robot.truth is None else robot.truth[:poses]
    kept = o.step < seen
    return replace(
        data,
        robots=(replace(robot, controls=robot.controls[: poses - 1], truth=truth),),
        times=data.times[:poses],
        observations=Observations(o.step[kept], o.values[kept], o.landmark[kept]),
    )
