"""SLAM where all is linear: headings are known, positions are relative; and its least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
from textbook import two_sensors

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, Prior
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import simulate


def known_headings(seed: int = 3) -> Dataset:
    """Smith and Cheeseman's problem made linear: exact headings, relative positions."""
    scenario = two_sensors(
        motion=MotionModel("odometry", covariance=np.diag([4e-3, 2e-3, 0.0])),
        sensors=(Sensor("xy", [[0.04, 0.01], [0.01, 0.02]], mount=[0.5, 0.1, 0.2], max_range=9.0),),
        prior=Prior([0.0, -3.0, 3.0], np.diag([0.04, 0.09, 0.0])),
        controls=np.tile([0.3, 0.02, 0.1], (40, 1)),
    )
    return simulate(scenario, seed=seed)


def least_squares(dataset: Dataset) -> tuple[Any, Any, Any]:
    """Positions of all poses and landmarks where headings are known: one dense linear problem."""
    poses, ids = dataset.poses, np.unique(dataset.observations.landmark)
    size = 2 * (poses + len(ids))
    headings = dataset.prior.mean[2] + np.concatenate([[0], np.cumsum(dataset.robot.controls.T[2])])
    blocks, rights = [], []

    def add(terms, right, covariance):
        row = np.zeros((2, size))
        for at, matrix in terms:
            row[:, 2 * at : 2 * at + 2] = matrix
        whitener = np.linalg.inv(np.linalg.cholesky(covariance))
        blocks.append(whitener @ row)
        rights.append(whitener @ right)

    add([(0, np.eye(2))], dataset.prior.mean[:2], dataset.prior.covariance[:2, :2])
    deltas, noise = dataset.robot.increments
    for k in range(poses - 1):
        R = geo.rotation(headings[k])
        add(
            [(k, -np.eye(2)), (k + 1, np.eye(2))],
            R @ deltas[k, :2],
            R @ noise[k, :2, :2] @ R.T,
        )
    sensor, seen = dataset.sensors[0], dataset.observations
    for k, value, landmark in zip(seen.step, seen.values, seen.landmark, strict=True):
        at = poses + int(np.searchsorted(ids, landmark))
        C = geo.rotation(headings[k] + sensor.mount[2]).T
        lever = geo.rotation(sensor.mount[2]).T @ sensor.mount[:2]
        add([(k, -C), (at, C)], value + lever, sensor.covariance)
    A, b = np.concatenate(blocks), np.concatenate(rights)
    covariance = np.linalg.inv(A.T @ A)
    return ids, (covariance @ A.T @ b).reshape(-1, 2), covariance
