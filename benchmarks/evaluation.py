"""Evaluating a long run beside the filter that produced it."""

from __future__ import annotations

import statistics
import time
from dataclasses import replace
from typing import Any

import numpy as np
from ratios import at_most

from ekfslam.dataset import Dataset
from ekfslam.estimates import Estimate
from ekfslam.experiments import compare
from ekfslam.filters.ekf import Ekf
from ekfslam.simulation import load_scenario, simulate

STEPS, REPEATS = 100_000, 5


class Clocked:
    """The EKF, and the time of the processor that it took."""

    name = "ekf"
    seconds = 0.0

    def estimate(self, dataset: Dataset) -> Estimate:
        """As `Ekf`."""
        start = time.process_time()
        estimate = Ekf().estimate(dataset)
        self.seconds = time.process_time() - start
        return estimate


def evaluation(steps: int = STEPS, repeats: int = REPEATS) -> list[list[Any]]:
    """All of a comparison but the filter: the verdict and the five tables."""
    data, ekf = rounds("loop-15", steps), Clocked()
    filtered, evaluated = [], []
    for repeat in range(repeats + 1):  # the first one compiles
        start = time.process_time()
        compare(data, ekf)
        whole = time.process_time() - start
        if repeat > 0:
            filtered.append(ekf.seconds)
            evaluated.append(whole - ekf.seconds)
    times = statistics.median(evaluated), statistics.median(filtered)
    return [at_most(f"{steps:,} steps of loop-15: evaluation, ekf", *times, "s", 1)]


def rounds(name: str, steps: int) -> Dataset:
    """A scenario whose controls begin again until there are so many steps."""
    scenario = load_scenario(name)
    controls = np.resize(scenario.controls, (steps, scenario.controls.shape[1]))
    return simulate(replace(scenario, controls=controls), seed=1)
