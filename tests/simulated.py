"""What the tests of simulated data share."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from ekfslam.dataset import Dataset, LandmarkMap
from ekfslam.models.motion import MotionModel
from ekfslam.simulation import RobotPlan, Scenario, SensorPlan, simulate


def past_points(what: str, points: list[list[float]], steps: int, turn: float = 0.0) -> str:
    """A scenario that is quick to run, as TOML: a robot that sees points by range and bearing."""
    return f"""
description = "{what}"
[world]
kind = "points"
landmarks = {points}
[path]
kind = "controls"
start = [0, 0, 0]
controls = [[0.2, {turn}]]
repeat = {steps}
[motion]
kind = "advance-turn"
sigmas = [0.02, "1 deg"]
[[sensors]]
kind = "range-bearing"
sigmas = [0.1, "2 deg"]
"""


@cache
def drawn(name: str) -> Dataset:
    """A run of a named scenario, the same in all tests."""
    return simulate(name, seed=1)


def exact_values(dataset: Dataset) -> np.ndarray:
    """The direct model of every row's own sensor at the truth, NaN for clutter."""
    rows = dataset.observations
    truths = np.array([robot.truth for robot in dataset.robots])
    points = truths[dataset.observed_robot, rows.step, :2]
    places = dict(zip(dataset.true_map.ids, dataset.true_map.positions, strict=True))
    for k in np.flatnonzero(dataset.observed_robot < 0):
        points[k] = places.get(dataset.true_landmark[k], np.nan)
    values = np.zeros_like(rows.values)
    for index, sensor in enumerate(dataset.sensors):
        mine = rows.sensor == index
        poses = truths[rows.robot[mine], rows.step[mine]]
        values[mine, : sensor.view.size] = sensor.observe(poses, points[mine])[0]
    return values


def trio(steps: int = 40, **changes: Any) -> Scenario:
    """Three robots with different motions: all have a scanner that sees robots, too, and one of
    them a camera besides, which tells bearings alone. Three landmarks are out of their sight.
    """
    scanner = SensorPlan(
        "range-bearing",
        [[0.01, 0.001], [0.001, 0.0004]],
        mount=[0.5, 0.1, 0.2],
        min_range=1.0,
        max_range=9.0,
        field_of_view=4.0,
        name="scanner",
        mutual=True,
    )
    camera = SensorPlan(
        "bearing",
        [[0.0004]],
        mount=[0.0, 0.3, 1.5],
        max_range=12.0,
        name="camera",
        robots=("roller",),
        every=3,
        offset=1,
    )
    scenario = Scenario(
        name="trio",
        landmarks=LandmarkMap(
            [2, 3, 5, 8, 13, 21, 34, 55, 89],
            [[8, 0], [4, 7], [-4, 7], [-8, 0], [-4, -7], [4, -7], [40, 0], [0, 40], [-40, 0]],
        ),
        start=[0.0, -3.0, 0.3],
        controls=np.tile([0.3, 0.02, 0.1], (steps, 1)),
        motion=MotionModel("odometry", np.diag([4e-4, 9e-4, 1e-4])),
        robot_name="walker",
        team=(
            RobotPlan(
                [3.0, 3.0, 2.0],
                np.tile([0.25, 0.3], (steps, 1)),
                MotionModel("wheel-increments", np.diag([1e-4, 1e-4]), slip=1e-3, width=0.5),
                name="roller",
            ),
            RobotPlan(
                [-4.0, 0.0, -1.0],
                np.tile([0.3, -0.1], (steps, 1)),
                MotionModel("advance-turn", np.diag([4e-4, 4e-4]), slip=1e-3),
                name="turner",
            ),
        ),
        sensors=(scanner, camera),
    )
    return replace(scenario, **changes)
