"""A campaign of more than a minute in one process and with two workers, from command to tables."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from ratios import at_least

CAMPAIGN = Path(__file__).parents[1] / "experiments" / "loop-15.toml"
SEEDS = 60
MINUTE = 60.0


def campaigns() -> list[list[Any]]:
    """The whole command each time: imports, start and end of the cluster, statistics, CSVs."""
    alone, two = (seconds(workers) for workers in (1, 2))
    assert alone > MINUTE, f"the campaign takes {alone:.0f} s, which is too short to tell"
    return [at_least("campaign of loop-15: two workers, one process", two, alone, "s", 1.6)]


def seconds(workers: int) -> float:
    command = [sys.executable, "-m", "ekfslam", "campaign", str(CAMPAIGN), "--no-figures"]
    command += ["--seeds", str(SEEDS), "--workers", str(workers)]
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        subprocess.run([*command, "--out", folder], check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - begin
