"""Write `results/plugin-rates.csv`, how often the assertions fail: `make rates`, 15 minutes.

False alarms: regressions in which nothing has become worse. Of `assert_not_worse` both sides are
the EKF on data that were jittered by a third of the sensor's noise, each side by a jitter of its
own: the numbers of every seed change, the quality does not. Of `assert_accuracy` the bound is the
true mean, that of all seeds together. Of `assert_consistent` the EKF runs on a problem of so little
noise that it is linear, where its covariances are exact; and `ekf-ri` on the full problem, where
nobody's are.

Power: the EKF that takes the sensor for better than it is. What it loses in the mean is scaled to
exactly 10 %, so that the scatter between the seeds is that of a real mistake. If all seeds are
worse alike, far less is seen, which is no news.

The regressions of a row are on disjoint seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from ekfslam.dataset import Dataset
from ekfslam.evaluation import absolute_errors, pose_nees, relative_errors
from ekfslam.evaluation.statistics import rmse
from ekfslam.registry import Estimator, resolve
from ekfslam.simulation import simulate
from ekfslam.testing.assertions import bounded
from ekfslam.testing.pairing import Pair, not_worse
from ekfslam.testing.runs import problem_of
from ekfslam.testing.statistics import expected_interval

FILE = Path(__file__).parents[1] / "results" / "plugin-rates.csv"
SCENARIO = "loop-15"
MANY, SOME, FEW = 20_000, 10_000, 5_000
"""Seeds: 200 regressions of 100, or half or a quarter of them."""
SEEDS = (20, 50, 100, 200)
ALPHA = 0.01
JITTER = 0.3
TAKEN_FOR_BETTER = 0.47
"""Factor on the sensor's covariance that costs the EKF some 13 %."""
LITTLE = 0.01
"""Factor on all noise that makes the problem linear."""

ATE, RPE, NEES = "ate_position_rmse_m", "rpe_position_rmse_m", "nees_pose_final"
KEPT = [ATE, RPE, NEES, "nis_sum", "nis_dof_sum"]


def jittered(data: Dataset, side: int) -> Dataset:
    """The draw with noise on top that is small beside the sensor's own."""
    random = np.random.default_rng([int(data.seed or 0), side])
    factor = np.linalg.cholesky(data.sensors[0].covariance)
    noise = JITTER * random.standard_normal(data.observations.values.shape) @ factor.T
    values = data.observations.values + noise
    return replace(data, observations=replace(data.observations, values=values))


def mistaken(data: Dataset) -> Dataset:
    """The draw whose sensor is stated to be better than it is."""
    stated = [replace(s, covariance=TAKEN_FOR_BETTER * s.covariance) for s in data.sensors]
    return replace(data, sensors=tuple(stated))


class Variant(NamedTuple):
    """What is run on so many seeds: an estimator, and what becomes of the data."""

    estimator: str
    seeds: int
    data: Callable[[Dataset], Dataset] = lambda data: data


VARIANTS = {
    "as it is": Variant("ekf", MANY),
    "jitter": Variant("ekf", MANY, partial(jittered, side=1)),
    "another jitter": Variant("ekf", MANY, partial(jittered, side=2)),
    "mistaken": Variant("ekf", SOME, mistaken),
    "linear": Variant("ekf", MANY, lambda data: simulate(SCENARIO, data.seed, noise=LITTLE)),
    "ekf-ri": Variant("ekf-ri", FEW),
}


def numbers(estimator: Estimator, data: Dataset) -> list[float]:
    """`KEPT` of one run, as the table `summary` has them."""
    estimate, truth = estimator.estimate(data), data.robots[0].truth
    poses, covariances = estimate.online.poses, estimate.online.covariances
    return [
        rmse(absolute_errors(poses, truth).position),
        rmse(relative_errors(poses, truth, 10.0).position),
        float(pose_nees(poses[-1], truth[-1], covariances[-1])),
        float(np.nansum(estimate.step_nis)),
        float(estimate.step_dof.sum()),
    ]


def pooled() -> dict[str, pd.DataFrame]:
    """Numbers of each variant, a row per seed."""
    estimators = {name: resolve(each.estimator) for name, each in VARIANTS.items()}
    found: dict[str, dict[int, list[float]]] = {name: {} for name in VARIANTS}
    for seed in range(MANY):
        if seed % 1000 == 0:
            print(f"seed {seed} of {MANY}", flush=True)
        data = simulate(SCENARIO, seed)
        for name, variant in VARIANTS.items():
            if seed < variant.seeds:
                found[name][seed] = numbers(estimators[name], variant.data(data))
    return {
        name: pd.DataFrame.from_dict(rows, orient="index", columns=KEPT)
        for name, rows in found.items()
    }


# Rows ------------------------------------------------------------------------------------------


def blocks(tables: list[pd.DataFrame], seeds: int) -> Iterator[list[pd.DataFrame]]:
    """The same disjoint seeds of some tables, so many at a time."""
    for start in range(0, min(map(len, tables)) - seeds + 1, seeds):
        yield [table.iloc[start : start + seeds] for table in tables]


def row(kind: str, assertion: str, case: str, seeds: int, margin: float, held: list[bool]) -> dict:
    """How often it failed, with the exact 95 % interval of the rate."""
    failed = len(held) - sum(held)
    low, high = binomtest(failed, len(held)).proportion_ci(0.95)
    return {
        "kind": kind,
        "assertion": assertion,
        "case": case,
        "seeds": seeds,
        "margin": margin,
        "alpha": ALPHA,
        "regressions": len(held),
        "failed": failed,
        "rate": failed / len(held),
        "low_95": low,
        "high_95": high,
    }


def paired(
    kind: str, case: str, now: pd.DataFrame, stored: pd.DataFrame, metric: str, worse: float = 1.0
) -> Iterator[dict[str, Any]]:
    """`assert_not_worse` on seeds of its own each time; `worse` scales what is now."""
    problem = problem_of(SCENARIO)
    for margin in (0.01, 0.0) if kind == "false alarm" else (0.01,):
        for seeds in SEEDS:
            held = [
                not_worse(
                    Pair(problem, metric, "", worse * a[metric], b[metric], False), margin, ALPHA
                )["holds"]
                for a, b in blocks([now, stored], seeds)
            ]
            yield row(kind, "assert_not_worse", case, seeds, margin, held)


def unpaired(
    kind: str, case: str, now: pd.DataFrame, bound: float, metric: str
) -> Iterator[dict[str, Any]]:
    """`assert_accuracy` against a bound."""
    for seeds in (*SEEDS, 1000):
        held = [
            bounded(block[metric].to_numpy(), metric, bound, ALPHA)["holds"]
            for (block,) in blocks([now], seeds)
        ]
        yield row(kind, "assert_accuracy", case, seeds, 0.0, held)


def consistent(kind: str, case: str, now: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """`assert_consistent`, both claims together."""

    def holds(block: pd.DataFrame, margin: float) -> bool:
        sums = ((block[NEES], 3.0 * len(block)), (block["nis_sum"], block["nis_dof_sum"].sum()))
        for values, dof in sums:
            low, high = expected_interval(float(dof), margin, ALPHA / 2)
            if not low <= values.sum() / dof <= high:
                return False
        return True

    for margin in (0.1, 0.0) if kind == "false alarm" else (0.1,):
        for seeds in SEEDS:
            held = [holds(block, margin) for (block,) in blocks([now], seeds)]
            yield row(kind, "assert_consistent", case, seeds, margin, held)


def rates(found: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """All rows."""
    usual, bad = found["as it is"], found["mistaken"]
    rows: list[dict[str, Any]] = []
    for metric in (ATE, RPE):
        mean = float(usual[metric].mean())
        scale = 1.1 * float(usual[metric][: len(bad)].mean() / bad[metric].mean())
        alarm, power = f"{metric}, two jitters", f"{metric}, 10 % worse"
        rows += paired("false alarm", alarm, found["jitter"], found["another jitter"], metric)
        rows += unpaired("false alarm", f"{metric}, bound at the mean", usual, mean, metric)
        rows += paired("power", power, bad, usual, metric, scale)
        rows += unpaired("power", power, scale * bad, mean, metric)
    alike = f"{ATE}, every seed 2 % worse"
    rows += paired("power", alike, usual, usual, ATE, 1.02)
    rows += consistent("false alarm", "linear", found["linear"])
    rows += consistent("false alarm", "ekf-ri", found["ekf-ri"])
    rows += consistent("power", "ekf, overconfident", usual)
    return pd.DataFrame(rows)


def main() -> None:
    """Run everything and write the table."""
    table = rates(pooled())
    table.round(5).to_csv(FILE, index=False)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
