"""Fixtures that several test files use."""

from __future__ import annotations

import os
import sys
from typing import NamedTuple

import numpy as np
import pytest

from ekfslam.cli import main
from ekfslam.dataset import Dataset, LandmarkMap, Prior, Robot
from ekfslam.datasets import RECORDED, load_recorded
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations


@pytest.fixture
def rng():
    """A seeded generator: the same draws in every run."""
    return np.random.default_rng(20240607)


class Run(NamedTuple):
    """What a command printed, and its exit status."""

    out: str
    err: str
    status: int


@pytest.fixture
def run_command(monkeypatch, capsys):
    """Run the command in this process."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["ekfslam", *map(str, words)])
        status = 0
        try:
            main()
        except SystemExit as stop:
            status = stop.code or 0
        printed = capsys.readouterr()
        return Run(printed.out, printed.err, status)

    return run


@pytest.fixture
def recorded_data():
    """Loads a recorded set as its authors publish it, or skips the test where it is not."""

    def load(name, **options):
        if not os.environ.get("EKFSLAM_DATA"):
            pytest.skip("EKFSLAM_DATA names no folder")
        if not RECORDED[name.partition("/")[0]].is_here(name):
            pytest.skip(f"{name} is not in the data folder")
        return load_recorded(name, **options)

    return load


@pytest.fixture
def wheels():
    """A robot with two correlated wheels, four steps, and a known truth."""
    motion = MotionModel(
        "wheel-increments", covariance=[[4e-4, 1e-4], [1e-4, 9e-4]], slip=1e-3, width=0.5
    )
    controls = [[0.4, 0.5], [0.5, 0.5], [0.6, 0.4], [0.3, 0.3]]
    prior = Prior([1.0, -2.0, 0.7], np.diag([0.01, 0.02, 1e-4]))
    truth = np.arange(15.0).reshape(5, 3) / 10
    return Robot(motion, controls, prior, truth, "wheels")


@pytest.fixture
def full_dataset(wheels):
    """A dataset in which every field and every optional column is set."""
    laser = Sensor(
        "range-bearing",
        [[0.01, 1e-4], [1e-4, 4e-4]],
        mount=[0.3, -0.1, 0.5],
        min_range=0.1,
        max_range=20.0,
        field_of_view=3.0,
        range_growth=0.02,
        name="laser",
    )
    camera = Sensor("xy", np.diag([0.04, 0.09]), name="camera")
    observations = Observations(
        step=[0, 1, 1, 3, 4],
        values=[[2.0, 0.1], [3.0, -0.2], [1.5, 0.5], [4.0, 0.3], [0.1 + 0.2, -1 / 3]],
        landmark=[7, 7, 9, -1, 12],
        sensor=[0, 0, 1, 0, 1],
        time=[0.0, 1.0, 1.25, 3.0, 4.5],
        covariance=[[[0.1 * k, 0.01], [0.01, 0.2]] for k in range(1, 6)],
        observed_robot=[-1, -1, -1, -1, -1],
        descriptor=[0.2, np.nan, 0.3, np.nan, 0.4],
    )
    return Dataset(
        name="full",
        robots=(wheels,),
        times=[0.0, 1.0, 2.0, 3.0, 4.5],
        sensors=(laser, camera),
        observations=observations,
        known_map=LandmarkMap([7, 9], [[1.0, 2.0], [3.0, 4.0]]),
        true_map=LandmarkMap([7, 9, 12], [[1.1, 2.1], [3.1, 4.1], [5.1, 6.1]]),
        true_landmark=[7, 7, 9, -1, 12],
        provenance="written by hand, with an é",
        seed=3,
    )
