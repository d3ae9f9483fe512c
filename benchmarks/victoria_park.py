"""Victoria Park: the EKF beside iSAM2, and what in the baselines is not gtsam."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import gtsam
from ratios import at_least, at_most

import ekfslam
from baselines.batch import GtsamBatch
from baselines.isam2 import GtsamIsam2
from ekfslam.filters.ekf import Ekf

REPEATS = 5


def victoria_park() -> list[list[Any]]:
    """The EKF with covariances against feeding iSAM2; what in the baselines is not gtsam."""
    data = ekfslam.load("victoria-park")
    Ekf().estimate(data)  # compile
    ekf = statistics.median(Ekf().estimate(data).time_total for _ in range(REPEATS))
    plain = GtsamIsam2(marginals=False)
    isam2 = statistics.median(plain.estimate(data).time_total for _ in range(3))
    rows = [at_least("Victoria Park: EKF, iSAM2", ekf, isam2, "s", 100)]
    for name, estimator, module, calls in (
        ("batch", GtsamBatch(marginals=False), "LevenbergMarquardtOptimizer",
         ("__init__", "optimize")),
        ("iSAM2", plain, "ISAM2", ("update", "calculateEstimatePose2", "calculateEstimate")),
    ):  # fmt: skip
        total, inside = inside_gtsam(module, calls, lambda e=estimator: e.estimate(data).time_total)
        rows.append(at_most(f"{name}: outside of gtsam, total", total - inside, total, "s", 0.15))
    return rows


def inside_gtsam(
    name: str, calls: tuple[str, ...], run: Callable[[], float]
) -> tuple[float, float]:
    """Total time of a run, and what of it passes inside some methods of a gtsam class."""
    original = getattr(gtsam, name)
    spent = 0.0

    def timed(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            nonlocal spent
            begin = time.perf_counter()
            result = method(*args, **kwargs)
            spent += time.perf_counter() - begin
            return result

        return call

    wrapped = type(name, (original,), {call: timed(getattr(original, call)) for call in calls})
    setattr(gtsam, name, wrapped)
    try:
        total = run()
    finally:
        setattr(gtsam, name, original)
    return total, spent
