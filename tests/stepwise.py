"""A filter that is driven over a dataset step by step, to compare with one that takes it whole."""

from __future__ import annotations

from typing import Any

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.estimates import Estimate, Innovations
from ekfslam.filters.online import EkfSlam


def slam_of(dataset: Dataset, **options: Any) -> EkfSlam:
    """A filter that starts where the robots of a dataset do."""
    return EkfSlam([robot.prior for robot in dataset.robots], **options)


def online(dataset: Dataset, **options: Any) -> tuple[EkfSlam, Any, Any, list[Innovations]]:
    """Drive through a dataset; the filter, poses (R, K + 1, 3), covariances, and what it met."""
    slam, robots = slam_of(dataset, **options), len(dataset.robots)
    poses, covariances, met = [], [], []
    for step in dataset.steps():
        slam.predict(step.increment, step.covariance)
        met.append(slam.observe(step.observations))
        poses.append(slam.pose.reshape(robots, 3))
        blocks = slam.pose_covariance.reshape(robots, 3, robots, 3)
        covariances.append([blocks[robot, :, robot] for robot in range(robots)])
    return slam, np.moveaxis(poses, 1, 0), np.moveaxis(covariances, 1, 0), met


def assert_same_bits(estimate: Estimate, dataset: Dataset, **options: Any) -> None:
    """The estimate of a dataset is what the filter says step by step, bit for bit."""
    slam, poses, covariances, met = online(dataset, **options)
    landmarks, expected = slam.landmarks, estimate.landmarks
    np.testing.assert_array_equal(poses, estimate.online.poses.reshape(poses.shape))
    shape = covariances.shape
    np.testing.assert_array_equal(covariances, estimate.online.covariances.reshape(shape))
    order = np.argsort(landmarks.ids)
    for name in ("ids", "positions", "covariances"):
        np.testing.assert_array_equal(getattr(landmarks, name)[order], getattr(expected, name))
    if expected.undetermined is None:
        assert landmarks.undetermined is None
    else:
        order = np.argsort(landmarks.undetermined)
        for name in ("undetermined", "inverse_depth"):
            np.testing.assert_array_equal(getattr(landmarks, name)[order], getattr(expected, name))
    for column in ("decision", "landmark", "innovation", "S"):
        together = np.concatenate([getattr(step, column) for step in met])
        np.testing.assert_array_equal(together, getattr(estimate.innovations, column))
