"""Covariances of a smoother's whole solution against the optimisation that led to it."""

from __future__ import annotations

import statistics
import time
from typing import Any

import gtsam
import numpy as np
from ratios import at_most

import ekfslam
from baselines import covariances
from baselines.association import Association
from baselines.entry import all_at_once
from baselines.landmark_graph import LandmarkGraph
from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, LandmarkMap, Observations, Prior, Robot
from ekfslam.filters.ekf import Ekf

REPEATS = 5


def recovery() -> list[list[Any]]:
    """Seconds for the covariances of all poses and landmarks, and for the optimisation."""
    covariances.warm_up()
    dense = all_seen(300, 200)
    measurements = [
        ("loop-15: covariances, batch", *measured(ekfslam.simulate("loop-15", seed=1))),
        ("Victoria Park: covariances, batch", *measured(ekfslam.load("victoria-park"))),
        # One iteration of gtsam takes half a minute here.
        ("300 landmarks, 200 poses see all: covariances, one iteration", *measured(dense, 1, 1)),
    ]
    return [at_most(what, ours, other, "s", 1.0) for what, ours, other in measurements]


def measured(data: Dataset, iterations: int = 100, repeats: int = REPEATS) -> tuple[float, float]:
    """Seconds for covariances, and for Levenberg-Marquardt from the EKF's estimate."""
    start = Ekf().estimate(data)
    problem = LandmarkGraph(data, Association.known(data))
    first = start.online.poses[None]
    positions = all_at_once(problem, first, start.landmarks)[1]
    graph, values = problem.graph(), problem.values(first, positions, problem.rows.tolist())
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-10)
    parameters.setAbsoluteErrorTol(0.0)
    parameters.setMaxIterations(iterations)
    ours, theirs = [], []
    for _ in range(repeats):
        begin = time.perf_counter()
        solution = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        theirs.append(time.perf_counter() - begin)
        poses = problem.poses_of(solution)
        begin = time.perf_counter()
        covariances.recovered(problem, graph, solution, poses)
        ours.append(time.perf_counter() - begin)
    return statistics.median(ours), statistics.median(theirs)


def all_seen(landmarks: int, steps: int) -> Dataset:
    """A robot on a circle inside a ring of landmarks, all seen at every step."""
    rng = np.random.default_rng(3)
    angle = geo.TAU * np.arange(landmarks) / landmarks
    radius = rng.uniform(16, 24, landmarks)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    sensor = ekfslam.Sensor("range-bearing", np.diag([0.1**2, 0.02**2]))
    motion = ekfslam.MotionModel("odometry", np.diag([0.01**2, 0.01**2, 0.002**2]))
    controls = np.tile([0.2, 0.0, 0.02], (steps, 1))
    truth = geo.integrate(np.array([10.0, 0.0, np.pi / 2]), controls)
    controls = controls + rng.normal(size=controls.shape) * [0.01, 0.01, 0.002]
    step = np.repeat(np.arange(1, steps + 1), landmarks)
    seen = np.tile(np.arange(landmarks), steps)
    values = sensor.observe(truth[step], points[seen])[0]
    values = values + rng.normal(size=values.shape) * [0.1, 0.02]
    return Dataset(
        "all seen",
        (Robot(motion, controls, Prior(truth[0]), truth),),
        np.arange(steps + 1.0),
        (sensor,),
        Observations(step, values, seen),
        true_map=LandmarkMap(np.arange(landmarks), points),
    )
