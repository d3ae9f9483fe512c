"""A world that grows with the run: what is linear in it is told from what is not."""

from __future__ import annotations

import numpy as np
from problems import INCREMENT, scanner

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.models.motion import MotionModel
from ekfslam.observations import Observations
from ekfslam.robots import LandmarkMap, Prior, Robot

STEP, REACH = 0.8, 2.5  # [m]


def corridor(steps: int, seed: int = 0) -> Dataset:
    """A robot that drives straight on past landmarks, one for each step, and sees about six."""
    rng, sensor = np.random.default_rng(seed), scanner()
    truth = geo.integrate(np.array([0.5, -0.5, 2.5]), np.tile([STEP, 0.0, 0.0], (steps, 1)))
    along = STEP * np.arange(steps + 1.0)
    points = geo.from_frame(truth[0], np.column_stack([along, np.resize([1.0, -1.0], steps + 1)]))
    near = np.linalg.norm(truth[:, None, :2] - points, axis=2) < REACH
    step, landmark = np.nonzero(near)
    noise = sensor.covariances(np.zeros((1, 2)))[0]
    values = sensor.observe(truth[step], points[landmark])[0]
    values = values + rng.multivariate_normal(np.zeros(2), noise, len(step))
    motion = MotionModel("odometry", covariance=0.01 * INCREMENT)
    controls = np.array([STEP, 0.0, 0.0]) + rng.multivariate_normal(
        np.zeros(3), motion.covariance, steps
    )
    return Dataset(
        name="corridor",
        robots=(Robot(motion, controls, Prior(truth[0]), truth),),
        times=np.arange(steps + 1.0),
        sensors=(sensor,),
        observations=Observations(step, values, landmark),
        true_map=LandmarkMap(np.arange(steps + 1), points),
    )
