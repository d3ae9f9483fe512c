"""Time of an observation and of a prediction against the size of the map: us, and the others."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from contenders import (
    LOCAL,
    MANY,
    TWO_THREADS,
    Contender,
    Problem,
    Timing,
    by_dataset,
    check_same,
    in_the_city,
    on_the_ring,
)
from figure import draw
from growth import exponent
from limit import update_limit
from ratios import alone, at_least, at_most
from worlds import BLIND, PER_STEP, city, ring

from ekfslam.plots.style import save

LIMIT = "limit of the update"
LARGE = 300  # landmarks from which growth is fitted

AGAINST_TEXTBOOK = {  # the form, and how many times faster we must be by number of landmarks
    "textbook, sequential": {20: 15, 100: 7, 300: 5},
    "textbook, joint": {20: 15, 100: 7, 300: 6, 1000: 13, 2000: 25},
}
AGAINST_TOOLBOX = {20: 100, 100: 40, 300: 100, 1000: 100, 2000: 100}
LOCALLY = {  # the same of a filter that works on a part of the map
    "textbook, joint": {300: 6, 1000: 13, 2000: 25},
    "roboticstoolbox": {300: 100, 1000: 100, 2000: 100},
}


def map_size(folder: Path) -> list[list[Any]]:
    """Measure on both problems, write table and figure, return what is held to bars."""
    problems = [(ring(size, 1 + steps + BLIND), on_the_ring(size)) for size, steps in MANY.items()]
    problems += [(city(size, steps + BLIND), in_the_city(size)) for size, steps in LOCAL.items()]
    found = [row for data, contenders in problems for row in measured(data, contenders)]
    table = pd.DataFrame(found)
    folder.mkdir(parents=True, exist_ok=True)
    table.to_csv(folder / "map-size.csv", index=False, float_format="%.4g")
    drawn = table[table.estimator != TWO_THREADS]
    save(draw(drawn), folder, "map-size")
    return [*bars(table), *exponents(drawn)]


class Row(NamedTuple):
    """One estimator at one size; times in microseconds, medians over repeats.

    `to_limit` is the time of an observation over that of its share in a rank-256 `dsyrk` of the
    whole covariance, measured in the same run.
    """

    problem: str
    estimator: str
    landmarks: int
    us_per_observation: float
    us_per_prediction: float
    to_limit: float
    steps: int
    repeats: int
    note: str = ""


def measured(data: Any, contenders: list[Contender]) -> Iterator[Row]:
    """Time all contenders on one problem, in turn, so that a drift of the machine hits all."""
    size = len(data.true_map.ids)
    present = [contender for contender in contenders if contender.here]
    problem = Problem.of(data)
    repeats = 5 if size <= 300 else 3
    runs: dict[str, list[Timing]] = {contender.name: [] for contender in present}
    limits = []
    for repeat in range(repeats):
        limits.append(update_limit(len(problem.mean)))
        for contender in present:
            timing = contender.run(problem, contender.steps[size])
            if repeat == 0 and contender.update:
                check_same(contender, timing, reference(problem, contender, size))
            runs[contender.name].append(timing)
    limit = statistics.median(limits)
    yield Row(data.name, LIMIT, size, limit, np.nan, 1.0, 0, repeats)
    for name, steps, here in ((each.name, each.steps[size], each.here) for each in contenders):
        if not here:
            nothing = np.nan, np.nan, np.nan
            yield Row(data.name, name, size, *nothing, 0, 0, "not installed")
            continue
        seen, unseen = (
            statistics.median(column)
            for column in zip(*((t.observation, t.prediction) for t in runs[name]), strict=True)
        )
        yield Row(data.name, name, size, seen, unseen, seen / limit, steps, repeats)


def reference(problem: Problem, contender: Contender, size: int) -> Timing:
    """Our filter with the update that a contender computes."""
    ours = f"ekf(update={contender.update})"
    return by_dataset(ours, problem, contender.steps[size])


def bars(table: pd.DataFrame) -> list[list[Any]]:
    """Rows of ratios that are held to a bound; what was not measured has none."""
    times = {
        (row.problem, row.estimator, row.landmarks): row.us_per_observation
        for row in table.itertuples()
        if np.isfinite(row.us_per_observation)
    }
    rows = []
    for other, bounds in AGAINST_TEXTBOOK.items():
        rows += [faster(times, "ring", "ekf", other, *bound) for bound in bounds.items()]
    rows += [
        faster(times, "ring", "ekf", "roboticstoolbox", *bound) for bound in AGAINST_TOOLBOX.items()
    ]
    for other, bounds in LOCALLY.items():
        rows += [faster(times, "city", "ekf-compressed", other, *bound) for bound in bounds.items()]
    isam2 = "gtsam-isam2"
    rows += [faster(times, "ring", "ekf", isam2, size, 1, PER_STEP) for size in MANY]
    rows += [faster(times, "ring", TWO_THREADS, isam2, max(MANY), 1, PER_STEP)]
    for ours in ("ekf", "ekf-compressed"):
        rows += [faster(times, "city", ours, isam2, size, 1) for size in LOCAL]
    rows += below_the_limit(table)
    return [row for row in rows if row]


def faster(
    times: dict[tuple[str, str, int], float],
    problem: str,
    ours: str,
    other: str,
    size: int,
    bound: float,
    each: int = 1,
) -> list[Any]:
    """A row of ours against another, for so many observations; none if one was not measured."""
    pair = [times.get((problem, name, size)) for name in (ours, other)]
    if None in pair:
        return []
    unit = "us/obs" if each == 1 else "us/step"
    own, theirs = (each * value for value in pair)
    what = f"{problem}, {size} landmarks: {ours}, {other}"
    return at_least(what, own, theirs, unit, bound)


def below_the_limit(table: pd.DataFrame) -> list[list[Any]]:
    """The compressed filter against what any update of the whole map takes."""
    own = table[(table.estimator == "ekf-compressed") & (table.problem == "city")]
    if own.empty:
        return []
    ratio = own.set_index("landmarks").to_limit
    at_2000 = own.set_index("landmarks").us_per_observation[2000]
    what = "2000 landmarks: ekf-compressed, limit of the update"
    return [
        at_most(f"city, {what}", at_2000, at_2000 / ratio[2000], "us/obs", 0.5),
        at_most("city, ekf-compressed over the limit: at 5000 landmarks, at 1000",
                ratio[5000], ratio[1000], "", 1),
    ]  # fmt: skip


def exponents(table: pd.DataFrame) -> list[list[Any]]:
    """How the time of an observation grows with the number of landmarks, from 300 up."""
    rows = []
    large = table[(table.landmarks >= LARGE) & table.us_per_observation.notna()]
    for (problem, estimator), own in large.groupby(["problem", "estimator"], sort=False):
        if len(own) > 1:
            power = exponent(own.landmarks.to_numpy(), own.us_per_observation.to_numpy())
            what = f"{problem}: growth exponent of {estimator}, {own.landmarks.min()} to "
            rows.append(alone(what + f"{own.landmarks.max()} landmarks", power, ""))
    return rows
