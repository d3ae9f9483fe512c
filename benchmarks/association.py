"""Association of a step of five observations against its correction, in a map of 1000."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from ratios import at_most

import ekfslam
from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, LandmarkMap, Observations, Prior, Robot, Sightings
from ekfslam.estimates import Decision
from ekfslam.filters.arrays import Log
from ekfslam.filters.compressed import EkfCompressed
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.ekf_slam import update
from ekfslam.filters.engine import Engine
from ekfslam.filters.initiation import extend
from ekfslam.filters.options import Options
from ekfslam.models.sensors import RANGE_BEARING

REPEATS, PER_STEP = 3, 5


def association() -> list[list[Any]]:
    """Means over the steps, since many of them share one update of the map; in a map of 1000."""
    rows = []
    data = field(1000, 160)
    for method in ("nearest", "joint"):
        times = [deciding_and_correcting(data, method) for _ in range(REPEATS)]
        ours, other = (1e6 * statistics.median(column) for column in zip(*times, strict=True))
        what = f"1000 landmarks, association ({method}), correction"
        rows.append(at_most(what, ours, other, "us/step", 1.0))
    scenario = ekfslam.load_scenario("city", {"path.steps": 2000})
    city = ekfslam.simulate(scenario, seed=1)
    for estimator in (Ekf("nearest"), EkfCompressed("nearest")):
        times = [deciding_and_all(city, estimator) for _ in range(REPEATS)]
        ours, other = (1e6 * statistics.median(column) for column in zip(*times, strict=True))
        what = f"city: association (nearest) of {estimator.name}, its whole step"
        rows.append(at_most(what, ours, other, "us/step", 0.4))
    return rows


def deciding_and_all(data: Dataset, estimator: Ekf) -> tuple[float, float]:
    """Seconds of a step that pass with finding out who is seen, and with everything."""
    spent = 0.0

    def timed(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            nonlocal spent
            begin = time.perf_counter()
            result = method(*arguments)
            spent += time.perf_counter() - begin
            return result

        return call

    names = [n for n in ("recognise", "_missing") if hasattr(estimator.engine, n)]
    methods = {name: timed(getattr(estimator.engine, name)) for name in names}
    engine = type("Timed", (estimator.engine,), methods)
    kind = type("Timed", (type(estimator),), {"engine": engine})
    estimate = kind("nearest").estimate(data)
    return spent / data.poses, estimate.time_total / data.poses


def deciding_and_correcting(data: Dataset, method: str) -> tuple[float, float]:
    """Seconds of a step's association, and of what it does to the map."""
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
    return statistics.mean(deciding[10:]), statistics.mean(correcting[10:])


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
