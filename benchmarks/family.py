"""The family of filters on the small loop, beside the standard EKF and beside batch smoothing."""

from __future__ import annotations

import statistics
from typing import Any

from ratios import at_most

import ekfslam
from baselines.batch import GtsamBatch
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.family import EkfFej, EkfIdeal, EkfOc, EkfRi, EkfRobocentric, Iekf

RUNS, REPEATS = 100, 3


def family() -> list[list[Any]]:
    """All seven filters together against batch, and each against the EKF; steps alone there."""
    data = [ekfslam.simulate("loop-15", seed=seed) for seed in range(RUNS)]
    others = [Iekf(), EkfIdeal(), EkfFej(), EkfOc(), EkfRi(), EkfRobocentric()]
    totals = {each.name: [] for each in [Ekf(), *others]}
    steps = {name: [] for name in totals}
    batch = []
    for repeat in range(REPEATS + 1):  # the first one warms up
        runs = {each.name: [each.estimate(d) for d in data] for each in [Ekf(), *others]}
        smoothed = [GtsamBatch().estimate(d) for d in data]
        if repeat > 0:
            batch.append(sum(each.time_total + each.time_marginals for each in smoothed))
            for name, estimates in runs.items():
                totals[name].append(sum(each.time_total for each in estimates))
                steps[name].append(sum(each.step_seconds.sum() for each in estimates))
    all_seven = sum(statistics.median(times) for times in totals.values())
    rows = [
        at_most("loop-15: all seven filters, batch", all_seven, statistics.median(batch), "s", 1)
    ]
    plain = statistics.median(steps["ekf"])
    for name in steps:
        if name != "ekf":
            own = statistics.median(steps[name])
            rows.append(at_most(f"loop-15: steps of {name}, ekf", own, plain, "s", 2))
    return rows
