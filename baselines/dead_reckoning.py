"""Dead reckoning: the odometry alone, with its growing uncertainty."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from ekfslam import geometry as geo
from ekfslam.adapters import Progress
from ekfslam.dataset import Dataset
from ekfslam.estimates import Estimate, Trajectory
from ekfslam.geometry import Array
from ekfslam.robots import Robot


@dataclass(frozen=True)
class DeadReckoning:
    """Chain the increments of each robot; observations are not looked at."""

    name = "dead-reckoning"

    def estimate(self, dataset: Dataset, progress: Progress | None = None) -> Estimate:
        """Integrate the odometry of a dataset.

        Parameters
        ----------
        dataset : Dataset
        progress : callable, optional
            Not used: this takes no time.

        Returns
        -------
        Estimate
            With the online trajectory and its covariances, and no map.
        """
        started = time.perf_counter()
        poses, covariances = map(np.array, zip(*map(_chained, dataset.robots), strict=True))
        if len(dataset.robots) == 1:
            poses, covariances = poses[0], covariances[0]
        return Estimate(
            estimator=self.name,
            dataset=dataset.name,
            association="",
            online=Trajectory(poses, covariances),
            time_total=time.perf_counter() - started,
            time_marginals=0.0,
        )


def _chained(robot: Robot) -> tuple[Array, Array]:
    """Poses (K + 1, 3) and covariances (K + 1, 3, 3) of one robot."""
    deltas, covariances = robot.increments
    poses = geo.integrate(robot.prior.mean, deltas)
    # In right-invariant coordinates an error stays what it was when the robot moves on, so
    # the covariance is a running sum.
    world = geo.congruence(geo.heading_block(poses[:-1, 2]), covariances)
    added = geo.additive_to_invariant(poses[1:], world)
    prior = geo.additive_to_invariant(poses[0], robot.prior.covariance)
    total = np.cumsum(np.concatenate([prior[None], added]), axis=0)
    return poses, geo.invariant_to_additive(poses, total)
