"""The benchmark of evaluation: the run that it evaluates, and the row that it writes."""

from __future__ import annotations

import numpy as np
from evaluation import evaluation, rounds
from ratios import COLUMNS

from ekfslam.simulation import load_scenario


def test_a_long_run_goes_round_and_round():
    """What is reported of each round differs from what was commanded by the same noise."""
    commanded = load_scenario("park").controls
    once = len(commanded)
    data = rounds("park", 2 * once + 7)
    noise = data.robot.controls - np.concatenate([commanded, commanded, commanded[:7]])
    first, second = noise[:once].std(axis=0), noise[once : 2 * once].std(axis=0)
    np.testing.assert_allclose(second, first, rtol=5 / np.sqrt(once))
    assert data.observations.step.max() > 2 * once


def test_the_row_has_the_time_of_both():
    (row,) = evaluation(steps=200, repeats=1)
    made = dict(zip(COLUMNS[1:], row, strict=True))
    assert made["what"] == "200 steps of loop-15: evaluation, ekf"
    assert made["ours"] > 0
    assert made["other"] > 0
    assert made["ratio"] == made["ours"] / made["other"]
    assert made["bound"] == "<= 1"
