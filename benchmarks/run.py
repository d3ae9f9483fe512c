"""Speed as ratios, measured side by side in one run: `make bench`.

``python benchmarks/run.py map-size start-up`` measures some parts, without names all. The rows of a
part are renewed in ``results/bench/speed.csv`` and on the pages that show them, and printed with
the machine and versions; the part map-size has a table and a figure of its own beside it. Times are
medians over repeats; compilation is timed apart and counts in nothing else.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import machine  # isort: skip  before NumPy
import page
import pandas as pd
from association import association
from campaigns import campaigns
from covariance_recovery import recovery
from evaluation import evaluation
from family import family
from fastslam import fastslam
from map_size import map_size
from memory import memory
from ratios import COLUMNS, renewed
from start_up import start_up
from victoria_park import victoria_park

ROOT = Path(__file__).parents[1]
OUT = ROOT / "results" / "bench"

PARTS: dict[str, Callable[[], list[list[Any]]]] = {
    "victoria-park": victoria_park,
    "covariances": recovery,
    "map-size": lambda: map_size(OUT),
    "memory": memory,
    "association": association,
    "family": family,
    "fastslam": fastslam,
    "evaluation": evaluation,
    "campaigns": campaigns,
    "start-up": start_up,
}


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="part", help=f"{', '.join(PARTS)}; or all")
    parts = parser.parse_args().parts or list(PARTS)
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        parser.error(f"no part is called {unknown[0]!r}; there are {', '.join(PARTS)}")
    print(machine.describe())
    path = OUT / "speed.csv"
    OUT.mkdir(parents=True, exist_ok=True)
    for part in parts:  # each is written when it is done
        rows = pd.DataFrame([[part, *row] for row in PARTS[part]()], columns=COLUMNS)
        print(f"\n{part}")
        print(rows.drop(columns="part").to_string(index=False, float_format=lambda x: f"{x:.3g}"))
        table = pd.read_csv(path, dtype={"holds": object}) if path.exists() else rows[:0]
        renewed(table, part, rows).to_csv(path, index=False, float_format="%.4g")
    page.renew(ROOT)
    print(f"written to {path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path}")


if __name__ == "__main__":
    main()
