"""Rewrites results/far-starts.csv: of robots that start where they are not, who comes back.

``make bars`` runs it. On 20 draws of `park`, identities withheld, the first pose is said to be so
far off along x, or turned, with a prior of 0.1 m and 1.8 degrees. A robot has come back if its
last position is within half a metre of the truth.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from ekfslam.dataset import Dataset, Prior
from ekfslam.evaluation import judged
from ekfslam.registry import resolve
from ekfslam.simulation import simulate

FILE = Path(__file__).parents[1] / "results" / "far-starts.csv"
SEEDS = range(20)
METHODS = ("nearest", "nearest-position")
BACK = 0.5  # [m]
PRIOR = np.diag([0.1, 0.1, np.deg2rad(1.8)]) ** 2
STARTS = {f"{d:g} m": (float(d), 0.0, 0.0) for d in (0.5, 1, 2, 5, 22, 200)} | {
    f"{a:g}°": (0.0, 0.0, float(np.deg2rad(a))) for a in (11, 86)
}


def started(seed: int, off: tuple[float, float, float]) -> Dataset:
    """A draw whose robot is told a wrong start."""
    data = simulate("park", seed=seed).without_identities()
    prior = Prior(data.prior.mean + np.array(off), PRIOR)
    return replace(data, robots=(replace(data.robot, prior=prior),))


def rows_of(start: str, method: str) -> dict[str, object]:
    """How many came back, and how many verdicts were right."""
    filtered = resolve("ekf-localization", association=method)
    back = right = 0
    for seed in SEEDS:
        data = started(seed, STARTS[start])
        # The verdict of the filter itself, which knows no truth.
        estimate = filtered.estimate(data)
        assert estimate.online is not None
        assert data.truth is not None
        off = np.linalg.norm(estimate.online.poses[-1, :2] - data.truth[-1, :2])
        there = off < BACK
        back += there
        right += (estimate.status == "ok") == there and judged(data, estimate).status in (
            ("ok",) if there else ("diverged",)
        )
    return {"start": start, "association": method, "runs": len(SEEDS), "back": back, "right": right}


if __name__ == "__main__":
    table = pd.DataFrame([rows_of(start, method) for start in STARTS for method in METHODS])
    table.to_csv(FILE, index=False)
    print(table.to_string(index=False))
