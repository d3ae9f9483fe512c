"""Write the stored tables that the accuracy regressions compare with: `make reference`.

`results/reference/simulated.csv` has the summary of every scenario for SEEDS seeds,
`results/reference/victoria-park.csv` that of the recorded run. Times are left out: they belong to
a machine.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

import ekfslam

FOLDER = Path(__file__).parents[1] / "results" / "reference"
FOUR = ("ekf", "gtsam-batch", "gtsam-isam2", "dead-reckoning")
TWO = ("ekf", "gtsam-batch")
SCENARIOS = {
    "cloister": FOUR,
    "loop-15": FOUR,
    "park": FOUR,
    "cloister-bearing": TWO,
    "cloister-range": TWO,
    "two-sensors": TWO,
    "team": TWO,
    "hand-held": TWO,
    "orchard": TWO,
}
"""What is simulated, and the estimators that are held to it."""

SEEDS = 20


def simulated(scenario: str, seed: int) -> pd.DataFrame:
    """Summary of the estimators on one draw."""
    return _without_times(ekfslam.compare(scenario, SCENARIOS[scenario], seed=seed).summary)


def recorded() -> pd.DataFrame:
    """Summary on Victoria Park."""
    return _without_times(ekfslam.compare("victoria-park").summary)


def _without_times(summary: pd.DataFrame) -> pd.DataFrame:
    return summary[[name for name in summary.columns if not name.startswith("time_")]]


def main() -> None:
    """Run everything and write both tables."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    parts = []
    for scenario in SCENARIOS:
        for seed in range(SEEDS):
            print(f"{scenario}, seed {seed}", flush=True)
            parts.append(simulated(scenario, seed))
    pd.concat(parts).to_csv(FOLDER / "simulated.csv", index=False)
    print("victoria-park", flush=True)
    recorded().to_csv(FOLDER / "victoria-park.csv", index=False)


if __name__ == "__main__":
    main()
