"""FastSLAM beside one run of the EKF, and how its steps grow."""

from __future__ import annotations

import statistics
from typing import Any

import numpy as np
from ratios import at_most

import ekfslam
from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, Observations, Prior, Robot
from ekfslam.filters.fastslam.estimators import Fastslam1, Fastslam2

REPEATS = 5
STEPS = 60


def fastslam() -> list[list[Any]]:
    """A hundred particles against the EKF; the cost of a sighting in small and in large."""
    return [*against_the_ekf(), *growth()]


def against_the_ekf() -> list[list[Any]]:
    """Whole runs on `park`, in turn, so that a drift of the machine hits all."""
    data = ekfslam.simulate("park", seed=1)
    kinds = [ekfslam.Ekf(), Fastslam1(particles=100), Fastslam2(particles=100)]
    times = [[kind.estimate(data).time_total for kind in kinds] for _ in range(REPEATS + 1)][1:]
    ekf, *others = (statistics.median(column) for column in zip(*times, strict=True))
    return [
        at_most(f"park: {kind.name} of 100 particles, ekf", own, ekf, "s", 30)
        for kind, own in zip(kinds[1:], others, strict=True)
    ]


def growth() -> list[list[Any]]:
    """Time of a step per particle and sighting: no more of many than of few, whatever the map."""
    rows = []
    for kind in (Fastslam1, Fastslam2):
        small, large = per_sighting(kind, 50, 5, 5), per_sighting(kind, 800, 80, 80)
        what = f"{kind.name}: 800 particles seeing 80 landmarks, 50 seeing 5"
        rows.append(at_most(what, 1e9 * large, 1e9 * small, "ns/sighting", 1.0))
        small, large = per_sighting(kind, 200, 5, 5), per_sighting(kind, 200, 5, 1000)
        what = f"{kind.name}: 200 particles seeing 5 of 1000 landmarks, 5 of 5"
        rows.append(at_most(what, 1e9 * large, 1e9 * small, "ns/sighting", 1.5))
    return rows


def per_sighting(kind: type[Fastslam1], particles: int, seen: int, mapped: int) -> float:
    """Seconds of a step for each of its sightings and particles, after all is mapped."""
    data = disc(seen, mapped)
    estimator = kind(particles=particles)
    steps = [np.median(estimator.estimate(data).step_seconds[2:]) for _ in range(REPEATS)]
    return float(min(steps)) / (particles * seen)


def disc(seen: int, mapped: int) -> Dataset:
    """A robot on a circle among landmarks: all are seen at step 1, then so many a step, in turn."""
    rng = np.random.default_rng(1)
    points = 20.0 * np.sqrt(rng.random((mapped, 1))) * unit(geo.TAU * rng.random(mapped))
    sensor = ekfslam.Sensor("range-bearing", np.diag([0.1**2, 0.02**2]))
    motion = ekfslam.MotionModel("odometry", np.diag([0.01**2, 0.01**2, 0.002**2]))
    controls = np.tile([0.2, 0.0, 0.02], (STEPS, 1))
    truth = geo.integrate(np.array([10.0, 0.0, np.pi / 2]), controls)
    later = np.arange((STEPS - 1) * seen) % mapped
    which = np.concatenate([np.arange(mapped), later])
    step = np.concatenate([np.ones(mapped, int), np.repeat(np.arange(2, STEPS + 1), seen)])
    values = sensor.observe(truth[step], points[which])[0]
    values = values + rng.normal(size=values.shape) * [0.1, 0.02]
    values[:, 0] = np.abs(values[:, 0])
    return Dataset(
        "disc",
        (Robot(motion, controls, Prior(truth[0]), truth),),
        np.arange(STEPS + 1.0),
        (sensor,),
        Observations(step, values, which),
    )


def unit(angle: np.ndarray) -> np.ndarray:
    return np.column_stack([np.cos(angle), np.sin(angle)])
