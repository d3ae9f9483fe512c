"""Peak of the memory that a filter takes, against the covariance that it stores."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from ratios import at_most

from ekfslam.registry import registered

LANDMARKS, STEPS = 2000, 100
STORED = 8 * (3 + 2 * LANDMARKS) ** 2  # bytes of P
MEGABYTE = 1e6

RUN = """
import sys
from pathlib import Path
from ekfslam.registry import resolve
sys.path.insert(0, sys.argv[1])
from worlds import city, shortened

def resident(line):
    text = Path("/proc/self/status").read_text()
    return 1024 * int(text.partition(line)[2].split()[0])

estimator = resolve(sys.argv[2])
data = city(int(sys.argv[3]), int(sys.argv[4]))
estimator.estimate(shortened(city(50, 20), 10))  # compiles
Path("/proc/self/clear_refs").write_text("5")  # the peak begins here
before = resident("VmRSS:")
estimate = estimator.estimate(data)
print(resident("VmHWM:") - before)
"""


def memory() -> list[list[Any]]:
    """What a run adds to its process at most, joint covariance of the result included."""
    if not Path("/proc/self/clear_refs").exists():
        return []  # only Linux tells
    names = ["ekf", *(name for name in ("ekf-compressed",) if name in registered())]
    return [
        at_most(f"{LANDMARKS} landmarks: peak of {name}, stored covariance",
                peak(name) / MEGABYTE, STORED / MEGABYTE, "MB", 1.3)
        for name in names
    ]  # fmt: skip


def peak(estimator: str) -> float:
    """Resident memory that a run takes at most beyond what was there before [bytes]."""
    here = str(Path(__file__).parent)
    command = [sys.executable, "-c", RUN, here, estimator, str(LANDMARKS), str(STEPS)]
    return float(subprocess.check_output(command, text=True))
