"""Write `results/association-bars.csv`, what association without identities reaches: `make bars`.

Park: many draws with the identities withheld, against the known association on the same draws.

Victoria Park: one recorded run, against the batch smoother with the given association. With the
cautious default noise no method closes its loops. The noise of `TIGHT` is near what smoothing
leaves of the given association: ranges and bearings spread by 0.23 m and 0.034 rad; the odometry by
0.01 m and 0.0018 rad per step, but, since it drifts, by 0.03 m and 0.01 rad per root of the steps
when a hundred of them are added up. Noise and gates were chosen with this run in view,
and the share of `neighbours` says how far that choice carries.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import ekfslam

FILE = Path(__file__).parents[1] / "results" / "association-bars.csv"
SEEDS = 50
METHODS = ("nearest", "joint")

VICTORIA = "victoria-park"
TIGHT = "victoria-park(odometry_sigmas=(0.03, 0.03, 0.007), sensor_sigmas=(0.25, 0.035))"
GATES = "accept=0.99, new=0.99999"
LANDMARKS = 151
RECORDED = (
    *((VICTORIA, f"ekf(association={method})") for method in METHODS),
    *((VICTORIA, f"ekf(association={method}, {GATES})") for method in METHODS),
    (VICTORIA, "ekf(association=joint, confirm=3, within=20)"),
    *((TIGHT, f"ekf(association={method}, {GATES})") for method in METHODS),
)


def row(
    dataset: str,
    estimator: str,
    runs: int,
    quantity: str,
    value: float,
    low: float | None = None,
    high: float | None = None,
) -> dict[str, Any]:
    """One line of the table; without bounds it has no bar to meet."""
    inside = (low is None or low <= value) and (high is None or value <= high)
    return {
        "dataset": dataset,
        "estimator": estimator,
        "runs": runs,
        "quantity": quantity,
        "value": value,
        "low": low,
        "high": high,
        "met": None if low is None and high is None else inside,
    }


def park(seeds: int) -> Iterator[dict[str, Any]]:
    """Precision, recall and ATE without identities on draws of the park."""
    given = [ekfslam.compare("park", "ekf", seed=seed).summary for seed in range(seeds)]
    ate = pd.concat(given)["ate_position_rmse_m"].mean()
    names = [f"ekf(association={method})" for method in METHODS]
    withheld = [ekfslam.compare("park", names, s, withhold_ids=True).summary for s in range(seeds)]
    for name, runs in pd.concat(withheld).groupby("estimator", sort=False):
        for quantity in ("precision", "recall"):
            scores = runs[f"association_{quantity}"]
            for kind, value in (("mean", scores.mean()), ("least", scores.min())):
                yield row("park", str(name), seeds, f"{kind} {quantity}", value, low=0.99)
        ratio = runs["ate_position_rmse_m"].mean() / ate
        yield row("park", str(name), seeds, "ATE against known association", ratio, high=1.05)


def recorded(dataset: str, estimator: str) -> Iterator[dict[str, Any]]:
    """Landmarks and final position on Victoria Park without identities."""
    found = ekfslam.compare(dataset, estimator, withhold_ids=True)
    summary, estimate = found.summary.iloc[0], found.estimates[dataset, estimator]
    counted = float(summary["landmarks_estimated"])
    away = gap(estimate, batch(dataset))
    bounds = 0.75 * LANDMARKS, 1.25 * LANDMARKS
    yield row(dataset, estimator, 1, "landmarks", counted, *bounds)
    yield row(dataset, estimator, 1, "final gap to the batch [m]", away, high=5.0)
    for score in ("precision", "recall"):  # against the given association; no bar
        value = float(summary[f"association_{score}"])
        yield row(dataset, estimator, 1, score, value)


def neighbours() -> Iterator[dict[str, Any]]:
    """Share of the noises and gates around the chosen ones that reach both bars."""
    smoothed = batch(VICTORIA)
    met = []
    for along, heading, accept, new in product(
        (0.02, 0.03, 0.04), (0.006, 0.007, 0.008), (0.98, 0.99, 0.995), (1e-4, 1e-5, 1e-6)
    ):
        sigmas = f"odometry_sigmas=({along}, {along}, {heading}), sensor_sigmas=(0.25, 0.035)"
        data = ekfslam.load(f"{VICTORIA}({sigmas})").without_identities()
        options = {"association": "nearest", "accept": accept, "new": 1 - new}
        estimate = ekfslam.estimate(data, "ekf", **options)
        few = 0.75 * LANDMARKS <= len(estimate.landmarks) <= 1.25 * LANDMARKS
        met.append(few and gap(estimate, smoothed) < 5.0)
    share = float(np.mean(met))
    name = "ekf(association=nearest), noise and gates around"
    yield row(VICTORIA, name, len(met), "share that meets both", share)


def batch(dataset: str) -> ekfslam.Estimate:
    """The batch smoother with the given association."""
    return ekfslam.estimate(ekfslam.load(dataset), "gtsam-batch", marginals=False)


def gap(estimate: ekfslam.Estimate, smoothed: ekfslam.Estimate) -> float:
    """Distance of the final positions [m]."""
    assert estimate.online is not None
    assert smoothed.smoothed is not None
    return float(np.hypot(*(estimate.online.poses[-1] - smoothed.smoothed.poses[-1])[:2]))


def main() -> None:
    """Run everything and write the table."""
    rows = list(park(SEEDS))
    for dataset, estimator in RECORDED:
        rows += recorded(dataset, estimator)
    rows += neighbours()
    table = pd.DataFrame(rows)
    table.to_csv(FILE, index=False)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
