"""A world that grows with the run: what is linear in it is told from what is not."""

from __future__ import annotations

import numpy as np
from problems import STARTS, problem, rows_kept, scanner

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.models.sensors import Sensor
from ekfslam.robots import LandmarkMap

SPACING, REACH = 1.0, 3.0  # [m]


def corridor(steps: int, *sensors: Sensor) -> Dataset:
    """A robot that drives straight on past landmarks, and sees about five of them at a time."""
    sensors = sensors or (scanner(),)
    path = geo.integrate(STARTS[0], np.tile([0.8, 0.2, 0.0], (steps, 1)))[:, :2]
    count = int(np.linalg.norm(path[-1] - path[0]) / SPACING)
    along = path[0] + np.linspace(0, 1, count)[:, None] * (path[-1] - path[0])
    points = along + np.resize([[0.8, 0.3], [-0.8, 0.4]], (count, 2))
    landmarks = LandmarkMap(np.arange(count), points)
    dataset = problem(*sensors, steps=steps, turn=0.0, landmarks=landmarks)
    o = dataset.observations
    away = dataset.robot.truth[o.step, :2] - points[o.landmark]
    return rows_kept(dataset, np.hypot(*away.T) < REACH)
