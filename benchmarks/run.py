"""Speed as ratios, measured side by side in one run: `make bench`.

Writes ``results/bench/speed.csv`` and prints it with the machine and versions. Times are medians
over repeats; compilation is timed apart and counts in nothing else.
"""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

# One thread for everybody: the ratios then compare algorithms.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import gtsam
import numpy as np
import pandas as pd
from campaigns import campaigns
from covariance_recovery import recovery
from family import family
from fastslam import fastslam
from ratios import at_least, at_most
from textbook import TextbookEkf

import baselines.batch
import baselines.isam2
import ekfslam
from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, LandmarkMap, Observations, Prior, Robot, Sightings
from ekfslam.estimates import Decision
from ekfslam.filters.arrays import Log
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.ekf_slam import update
from ekfslam.filters.engine import Engine
from ekfslam.filters.initiation import extend
from ekfslam.filters.options import Options
from ekfslam.models.sensors import RANGE_BEARING

OUT = Path(__file__).parents[1] / "results" / "bench" / "speed.csv"
REPEATS = 5
PER_STEP = 5


def main() -> None:
    """Measure, print, write."""
    describe_machine()
    rows = [*victoria_park(), *covariances(), *map_sizes(), *association(), *family()]
    rows += [*fastslam(), *campaigns(), *start_up()]
    columns = ["what", "ours", "other", "unit", "ratio", "bound", "holds"]
    table = pd.DataFrame(rows, columns=columns)
    OUT.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(OUT, index=False, float_format="%.4g")
    print(table.to_string(index=False, float_format=lambda value: f"{value:.3g}"))
    print(f"written to {OUT.relative_to(Path.cwd()) if OUT.is_relative_to(Path.cwd()) else OUT}")


def describe_machine() -> None:
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = models[0].partition(":")[2].strip() if models else cpu
    packages = ", ".join(f"{p} {version(p)}" for p in ("ekfslam", "gtsam", "numpy", "numba"))
    print(f"{cpu}, {os.cpu_count()} cores, Python {platform.python_version()}, {packages}")


# Victoria Park -----------------------------------------------------------------------------------


def victoria_park() -> list[list[Any]]:
    """The EKF with covariances against feeding iSAM2; what in the baselines is not gtsam."""
    data = ekfslam.load("victoria-park")
    Ekf().estimate(data)  # compile
    ekf = statistics.median(Ekf().estimate(data).time_total for _ in range(REPEATS))
    plain = baselines.isam2.GtsamIsam2(marginals=False)
    isam2 = statistics.median(plain.estimate(data).time_total for _ in range(3))
    rows = [at_least("Victoria Park: EKF, iSAM2", ekf, isam2, "s", 100)]
    for name, estimator, module, calls in (
        ("batch", baselines.batch.GtsamBatch(marginals=False), "LevenbergMarquardtOptimizer",
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


def covariances() -> list[list[Any]]:
    """All covariances of the batch smoother against its optimisation."""
    return [at_most(what, ours, other, "s", 1.0) for what, ours, other in recovery()]


# Map sizes ---------------------------------------------------------------------------------------


def map_sizes() -> list[list[Any]]:
    """Time per observation, five observations a step, against the textbook filter."""
    rows = []
    for landmarks, bound, steps in ((20, 15, 400), (100, 7, 400), (300, 5, 200)):
        data = ring(landmarks, steps)
        ours, theirs = [], []
        for _ in range(REPEATS):  # in turn, so that a drift of the machine hits both
            estimate = Ekf().estimate(data)
            ours.append(float(np.median(estimate.step_seconds[2:])) / PER_STEP * 1e6)
            seconds, mean = textbook_run(data)
            theirs.append(float(np.median(seconds[2:])) / PER_STEP * 1e6)
        # The same problem: sequential updates of both agree.
        check = Ekf(update="sequential").estimate(data)
        apart = np.abs(geo.additive_error(check.online.poses[-1], mean[:3])).max()
        assert apart < 1e-8, f"the filters disagree by {apart}"
        what = f"{landmarks} landmarks: EKF, textbook NumPy"
        rows.append(
            at_least(what, statistics.median(ours), statistics.median(theirs), "us/obs", bound)
        )
    return rows


def ring(landmarks: int, steps: int) -> Dataset:
    """A robot on a circle inside a ring of landmarks, all seen at step 1, then five a step."""
    rng = np.random.default_rng(1)
    angle = geo.TAU * np.arange(landmarks) / landmarks
    points = 20.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    sensor = ekfslam.Sensor("range-bearing", np.diag([0.1**2, 0.02**2]))
    motion = ekfslam.MotionModel("odometry", np.diag([0.01**2, 0.01**2, 0.002**2]))
    controls = np.tile([0.2, 0.0, 0.02], (steps, 1))
    truth = geo.integrate(np.array([10.0, 0.0, np.pi / 2]), controls)
    step = np.concatenate([np.ones(landmarks), np.repeat(np.arange(2, steps + 1), PER_STEP)])
    some = [rng.choice(landmarks, PER_STEP, replace=False) for _ in range(steps - 1)]
    seen = np.concatenate([np.arange(landmarks), *some])
    values = sensor.observe(truth[step.astype(int)], points[seen])[0]
    values = values + rng.normal(size=values.shape) * [0.1, 0.02]
    return Dataset(
        "ring",
        (Robot(motion, controls, Prior(truth[0]), truth),),
        np.arange(steps + 1.0),
        (sensor,),
        Observations(step, values, seen),
        true_map=LandmarkMap(np.arange(landmarks), points),
    )


def textbook_run(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Seconds per step of the textbook filter from the mapped state on, and its final mean."""
    slam = ekfslam.EkfSlam(prior=data.prior, update="sequential")
    steps = list(data.steps())
    for step in steps[:2]:
        slam.predict(step.increment, step.covariance)
        slam.observe(step.observations)
    order = np.argsort(slam.landmarks.ids)
    assert (order == np.arange(len(order))).all()
    mapped = slam._engine.slam  # the state after all landmarks have been seen
    textbook = TextbookEkf(mapped.mean, mapped.covariance)
    seconds = np.full(len(steps), np.nan)
    for k, step in enumerate(steps[2:], start=2):
        begin = time.perf_counter()
        textbook.predict(step.increment, step.covariance)
        o = step.observations
        for i in range(len(o.values)):
            textbook.correct(int(o.landmark[i]), o.values[i], o.covariance[i])
        seconds[k] = time.perf_counter() - begin
    return seconds, textbook.mean


# Association -------------------------------------------------------------------------------------


def association() -> list[list[Any]]:
    """Association of a step of five observations against its correction, in a map of 1000."""
    rows = []
    data = field(1000, 60)
    for method in ("nearest", "joint"):
        deciding, correcting = [], []
        engine = Engine([data.prior], Options(method), method, {RANGE_BEARING})
        sightings = Sightings(*(column.copy() for column in data.sightings))
        log = Log.of(1, data.poses, len(sightings.values), 0)
        for k in range(data.poses):
            first, last = (int(row) for row in data.offsets[k : k + 2])
            engine.make_room(last - first)
            moves = (part[:, k].copy() for part in data.moves)
            engine.predict(k, *moves, sightings.rows(0, 0))
            look = engine.state, sightings, first, last
            begin = time.perf_counter()
            engine.recognise(sightings, first, last, log)
            middle = time.perf_counter()
            slam, register = engine.slam.arrays, engine.register
            update(slam, register, *look[1:], engine.settings, log, engine.other)
            end = time.perf_counter()
            extend(slam, register, *look[1:], engine.settings, log)
            deciding.append(middle - begin)
            correcting.append(end - middle)
        assert len(engine.register.offsets) >= 1000
        assert (log.decision[1000:] == Decision.ACCEPTED).mean() > 0.95
        ours, other = (1e6 * statistics.median(times[10:]) for times in (deciding, correcting))
        what = f"1000 landmarks, association ({method}), correction"
        rows.append(at_most(what, ours, other, "us/step", 1.0))
    return rows


def field(landmarks: int, steps: int) -> Dataset:
    """A robot among landmarks on a grid, all seen at step 1; then the five nearest a step."""
    rng = np.random.default_rng(2)
    side = int(np.ceil(np.sqrt(landmarks)))
    points = 4.0 * np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    points = points[:landmarks] + rng.uniform(-1, 1, (landmarks, 2))
    noise = np.diag([0.1**2, 0.005**2])
    sensors = (
        ekfslam.Sensor("range-bearing", noise, name="survey"),
        ekfslam.Sensor("range-bearing", noise, max_range=15.0, name="laser"),
    )
    motion = ekfslam.MotionModel("odometry", np.diag([0.01**2, 0.01**2, 0.002**2]))
    controls = np.tile([0.2, 0.0, 0.02], (steps, 1))
    truth = geo.integrate(np.array([60.0, 60.0, 0.0]), controls)
    seen = [np.arange(landmarks)]
    for pose in truth[2:]:
        seen.append(np.argsort(np.hypot(*(points - pose[:2]).T))[:PER_STEP])
    step = np.concatenate([np.full(len(some), k) for k, some in enumerate(seen, start=1)])
    which = np.concatenate(seen)
    values = sensors[0].observe(truth[step], points[which])[0]
    values = values + rng.normal(size=values.shape) * [0.1, 0.005]
    return Dataset(
        "field",
        (Robot(motion, controls, Prior(truth[0]), truth),),
        np.arange(steps + 1.0),
        sensors,
        Observations(step, values, sensor=(step > 1).astype(int)),
        true_map=LandmarkMap(np.arange(landmarks), points),
        true_landmark=which,
    )


# Start-up ----------------------------------------------------------------------------------------


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
        ["first run, nothing compiled", cold, np.nan, "s", np.nan, "<= 20 s", cold <= 20],
        ["first run, compiled before", warm, np.nan, "s", np.nan, "", ""],
        ["ekfslam --help", *(statistics.median(times), np.nan, "s", np.nan, "<= 0.6 s"),
         statistics.median(times) <= 0.6],
    ]  # fmt: skip


if __name__ == "__main__":
    main()
