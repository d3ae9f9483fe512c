"""First run of a filter with nothing compiled and with all compiled; the command's help."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from ratios import alone

REPEATS = 5


def start_up() -> list[list[Any]]:
    """First run of the EKF with an empty and a full compilation cache; the command's help."""
    code = (
        "import time, ekfslam; data = ekfslam.simulate('loop-15'); begin = time.perf_counter(); "
        "ekfslam.estimate(data); print(time.perf_counter() - begin)"
    )
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        cold, warm = (
            float(subprocess.check_output([sys.executable, "-c", code], env=environment, text=True))
            for _ in range(2)
        )
    command = [str(Path(sys.executable).parent / "ekfslam"), "--help"]
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        times.append(time.perf_counter() - begin)
    return [
        alone("first run, nothing compiled", cold, "s", 20),
        alone("first run, compiled before", warm, "s"),
        alone("`ekfslam --help`", statistics.median(times), "s", 0.6),
    ]
