"""Descriptors in the decision: what looks different is mistaken less often."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import ekfslam
from ekfslam.dataset import LandmarkMap, Observations, Prior, Robot
from ekfslam.evaluation import tables
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import load_scenario, simulate


def twins(descriptors):
    """Two trees 0.3 m apart, seen once; then one sighting that falls nearer to the wrong one."""
    sensor = Sensor("xy", 0.1**2 * np.eye(2))
    motion = MotionModel("odometry", 0.01**2 * np.eye(3))
    points = np.array([[5.0, 0.0], [5.0, 0.3]])
    values = np.array([[5.0, 0.0], [5.0, 0.3], [5.0, 0.1]])  # the third is of the second tree
    return ekfslam.Dataset(
        "twins",
        (Robot(motion, np.zeros((1, 3)), Prior(), np.zeros((2, 3))),),
        [0.0, 1.0],
        (sensor,),
        Observations([0, 0, 1], values, descriptor=descriptors),
        true_map=LandmarkMap([0, 1], points),
        true_landmark=[0, 1, 1],
    )


def decided(data, **options):
    estimate = ekfslam.estimate(data, "ekf", association="nearest", new=0.999, **options)
    return estimate.innovations.landmark.tolist()


def test_a_descriptor_turns_a_close_decision():
    thin_and_thick = [0.2, 0.5, 0.48]
    # Both trees are new at step 0: nothing is in the map while a look is matched.
    assert decided(twins(thin_and_thick)) == [0, 1, 0]
    assert decided(twins(thin_and_thick), descriptor_sigma=0.05) == [0, 1, 1]


def test_a_missing_descriptor_decides_nothing():
    with_none = [0.2, 0.5, np.nan]
    assert decided(twins(with_none), descriptor_sigma=0.05) == [0, 1, 0]
    assert decided(twins([np.nan, np.nan, 0.48]), descriptor_sigma=0.05) == [0, 1, 0]


def test_descriptors_help_where_odometry_is_poor():
    """Means over the same five runs; paired, so that the draw does not decide."""
    orchard = load_scenario("orchard")
    sizes = np.random.default_rng(0).uniform(0.1, 0.6, len(orchard.landmarks))
    orchard = replace(orchard, descriptors=sizes, descriptor_sigma=0.03)
    gained = []
    for seed in range(5):
        data = simulate(orchard, seed=seed, odometry_noise=3)
        scores = [
            tables.summary_rows(
                data, ekfslam.estimate(data, "ekf", confirm=3, within=8, descriptor_sigma=sigma)
            ).iloc[0]
            for sigma in (None, 0.03)
        ]
        gained.append(
            [scores[1][name] - scores[0][name] for name in ("association_precision",)]
            + [scores[1]["association_recall"] - scores[0]["association_recall"]]
        )
    assert (np.mean(gained, axis=0) > 0).all()
