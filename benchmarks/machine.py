"""The machine, and one thread for everybody: imported before NumPy is.

The ratios then compare algorithms. A BLAS kernel that the shell asks for (made for another
processor, or to be on the safe side of an old library) would slow all who use BLAS, so that the
library chooses for itself.
"""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"
for variable in ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"):
    os.environ.pop(variable, None)

import scipy.linalg  # noqa: F401  its BLAS is what the compiled filters call
import threadpoolctl


def describe() -> str:
    """Processor, cores, versions, and the kernels that BLAS runs."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = models[0].partition(":")[2].strip() if models else cpu
    packages = ", ".join(f"{p} {version(p)}" for p in ("ekfslam", "gtsam", "numpy", "numba"))
    pools = threadpoolctl.threadpool_info()
    kernels = {f"{p['internal_api']} {p['version']} {p.get('architecture', '')}" for p in pools}
    python = f"Python {platform.python_version()}"
    return f"{cpu}, {os.cpu_count()} cores, {python}, {packages}, {', '.join(sorted(kernels))}"
