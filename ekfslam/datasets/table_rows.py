"""Rows of the tables of `ekfslam.datasets.tables`, read as what a dataset holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ekfslam.checks import checked_number, is_covariance
from ekfslam.datasets.sheets import Sheet
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import NO_LANDMARK, WIDTH, Observations, padded
from ekfslam.robots import LandmarkMap, Prior

INCREMENT = ("dx", "dy", "dtheta")


@dataclass(frozen=True)
class Header:
    """What a header says besides robots and sensors; see `from_tables`."""

    name: str = "tables"
    provenance: str = ""
    seed: int | None = None
    notes: tuple[str, ...] = ()
    start_time: float | None = None
    time_tolerance: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= checked_number(self.time_tolerance, "time_tolerance") < np.inf:
            raise InputError(f"time_tolerance must not be negative [s], got {self.time_tolerance}")


class Told(NamedTuple):
    """What the header says of a robot."""

    name: str
    motion: MotionModel
    prior: Prior

    @property
    def controls(self) -> tuple[str, ...]:
        """Columns of its controls."""
        return control_columns(self.motion)

    @property
    def noisy(self) -> tuple[str, ...]:
        """Those that carry noise; of no controls at all, the increment does."""
        return noisy_columns(self.motion)


def control_columns(motion: MotionModel) -> tuple[str, ...]:
    """Columns of the controls of a motion model."""
    return INCREMENT if motion.kind == "odometry" else motion.control_names


def noisy_columns(motion: MotionModel) -> tuple[str, ...]:
    """Columns of its controls that carry noise; without controls, the increment does."""
    return control_columns(motion)[: motion.noisy_controls] or INCREMENT


class Controls(NamedTuple):
    """What the table of controls holds: times of the poses, and of each robot its part."""

    times: Array
    controls: list[Array]
    covariances: list[Array | None]

    @classmethod
    def of(cls, sheet: Sheet, robots: Sequence[Told], header: Header, where: str) -> Controls:
        """Read the table; `where` is what errors call the header."""
        names = dict.fromkeys(name for robot in robots for name in robot.controls)
        noise = dict.fromkeys(n for robot in robots for n in noise_columns(robot.noisy))
        known = ["robot", "step", "time", *names, *noise]
        sheet.check_columns(known)
        whose = sheet.named("robot", [robot.name for robot in robots], "robot")
        parts, steps = [], np.bincount(whose, minlength=len(robots))
        for number, robot in enumerate(robots):
            rows = np.flatnonzero(whose == number)
            if steps[number] != steps[0]:
                sheet.refuse(
                    f"robots make the same number of steps, but {robot.name} makes "
                    f"{steps[number]} and {robots[0].name} {steps[0]}"
                )
            _check_count(sheet, rows)
            sheet.check_columns(known, robot.controls)
            columns = [sheet.numbers(name, rows) for name in robot.controls]
            controls = np.stack(columns, axis=1) if columns else np.zeros((len(rows), 0))
            for name in {*names, *noise} - {*robot.controls, *noise_columns(robot.noisy)}:
                _check_blank(sheet, rows, name, f"{robot.name} ({robot.motion.kind})")
            covariance, given = _covariances(sheet, rows, robot.noisy)
            if given.any() and not given.all():
                row = rows[np.flatnonzero(~given)[0]]
                sheet.refuse(f"the noise of {robot.name} is in other rows and not here", row)
            parts.append((rows, controls, covariance if given.any() else None))
        times = _times(sheet, parts, robots, header, where)
        return cls(times, [part[1] for part in parts], [part[2] for part in parts])


def _check_count(sheet: Sheet, rows: np.ndarray) -> None:
    """Steps count from 1 on."""
    if not sheet.has("step"):
        return
    steps = sheet.whole("step", 1, rows=rows)
    for at in np.flatnonzero(steps != np.arange(1, len(rows) + 1))[:1]:
        said = f"is {steps[at]} where {at + 1} is due: steps count 1, 2, ... in order, without gaps"
        sheet.refuse(said, int(rows[at]), "step")


def _times(
    sheet: Sheet, parts: Sequence[Any], robots: Sequence[Told], header: Header, where: str
) -> Array:
    """Times of the poses, which all robots share."""
    start = 0.0 if header.start_time is None else header.start_time
    if not sheet.has("time"):
        return start + _elapsed(sheet, parts, robots)
    if header.start_time is None:
        raise InputError(
            f"{where}: start_time is missing: the time of the first pose, before the first motion, "
            "since the time of a row of controls is that of the pose that it leads to"
        )
    first = sheet.numbers("time", parts[0][0])
    for rows, _, _ in parts:
        times = np.concatenate([[start], sheet.numbers("time", rows)])
        for at in np.flatnonzero(np.diff(times) <= 0)[:1]:
            said = f"times must increase, but {times[at + 1]} does not come after {times[at]}"
            said += "" if at else ", the start_time"
            sheet.refuse(said, int(rows[at]), "time")
        for at in np.flatnonzero(times[1:] != first)[:1]:
            said = f"robots share the times of poses, but {robots[0].name} has {first[at]}"
            sheet.refuse(said, int(rows[at]), "time")
    return np.concatenate([[start], first])


def _elapsed(sheet: Sheet, parts: Sequence[Any], robots: Sequence[Told]) -> Array:
    """Times since the first pose, by the ``dt`` of the controls, or 1 s a step."""
    timed = [
        (robot.name, rows, controls[:, robot.controls.index("dt")])
        for robot, (rows, controls, _) in zip(robots, parts, strict=True)
        if "dt" in robot.controls
    ]
    if not timed:
        return np.arange(len(parts[0][0]) + 1, dtype=float)
    first, _, shared = timed[0]
    for _, rows, spans in timed:
        for at in np.flatnonzero(spans <= 0)[:1]:
            sheet.refuse("is not positive", int(rows[at]), "dt")
        for at in np.flatnonzero(~np.isclose(spans, shared, rtol=1e-9, atol=0))[:1]:
            said = f"robots share the times of poses, but {first} has {shared[at]}; or state a time"
            sheet.refuse(said, int(rows[at]), "dt")
    return np.concatenate([[0.0], np.cumsum(shared)])


def sightings(
    sheet: Sheet, names: Sequence[str], sensors: Sequence[Sensor], times: Array, header: Header
) -> tuple[Observations, np.ndarray | None]:
    """Sightings, and their true landmarks if the sheet has them."""
    if len(sheet) and not sensors:
        sheet.refuse("the header names no sensors, of which it must tell kind and noise")
    values = dict.fromkeys(name for sensor in sensors for name in sensor.view.names)
    noise = dict.fromkeys(n for s in sensors for n in noise_columns(s.view.names))
    fixed = ("robot", "step", "time", "sensor", "landmark", "observed_robot", "descriptor")
    known = [*fixed, "true_landmark", *values, *noise]
    sheet.check_columns(known)
    which = sheet.named("sensor", [sensor.name for sensor in sensors], "sensor")
    step, time = _steps(sheet, times, header.time_tolerance)
    sheet.refuse_where(
        np.diff(step, prepend=0) < 0, "comes after a later step: sort the rows", "step"
    )
    reported, covariance = np.zeros((len(sheet), WIDTH)), np.zeros((len(sheet), WIDTH, WIDTH))
    own = False
    for number, sensor in enumerate(sensors):
        rows, view = np.flatnonzero(which == number), sensor.view
        if not len(rows):
            continue
        sheet.check_columns(known, view.names)
        columns = [sheet.numbers(name, rows) for name in view.names]
        reported[rows, : view.size] = np.stack(columns, axis=1)
        for name in {*values, *noise} - {*view.names, *noise_columns(view.names)}:
            _check_blank(sheet, rows, name, f"{sensor.name} ({', '.join(view.names)})")
        given, there = _covariances(sheet, rows, view.names)
        stated = sensor.covariances(reported[rows, : view.size])
        covariance[rows] = padded(np.where(there[:, None, None], given, stated), axes=2)
        own |= bool(there.any())

    def identities(column: str) -> Any:
        return sheet.whole(column, blank=NO_LANDMARK) if sheet.has(column) else None

    observations = Observations(
        step,
        reported,
        identities("landmark"),
        which,
        sheet.named("robot", names, "robot"),
        time,
        covariance if own else None,
        sheet.named("observed_robot", names, "robot", NO_LANDMARK)
        if sheet.has("observed_robot")
        else None,
        sheet.numbers("descriptor", blank=True) if sheet.has("descriptor") else None,
    )
    return observations, identities("true_landmark")


def _steps(sheet: Sheet, times: Array, tolerance: float) -> tuple[np.ndarray, Array | None]:
    """The pose of each row, and the row's own time if it has one."""
    given = sheet.numbers("time") if sheet.has("time") else None
    if sheet.has("step"):
        step = sheet.whole("step")
        last = len(times) - 1
        sheet.refuse_where(step > last, f"there are poses 0 to {last} alone", "step")
        return step, given
    if given is None:
        sheet.refuse("the column 'step' is missing, the number of the pose (or 'time', its time)")
    after = np.searchsorted(times, given).clip(0, len(times) - 1)
    before = (after - 1).clip(0)
    to_before, to_after = np.abs(given - times[before]), np.abs(given - times[after])
    step, away = np.where(to_before < to_after, before, after), np.minimum(to_before, to_after)
    for row in np.flatnonzero(away > tolerance)[:1]:
        sheet.refuse(
            f"{given[row]} is the time of no pose: the nearest, {step[row]}, is {away[row]:.3g} s "
            "away; state a time_tolerance, or bring it to the time of a pose",
            int(row),
            "time",
        )
    both = (np.maximum(to_before, to_after) <= tolerance) & (before != after)
    for row in np.flatnonzero(both)[:1]:
        two = f"{before[row]} and {after[row]}"
        said = f"{given[row]} is within time_tolerance of the poses {two}: make it smaller"
        sheet.refuse(said, int(row), "time")
    return step, None if (away == 0).all() else given


def truths(
    sheet: Sheet | None, names: Sequence[str], times: Array, tolerance: float
) -> list[Array | None]:
    """True poses (K + 1, 3) of each robot, as far as known; None if none is."""
    if sheet is None:
        return [None] * len(names)
    sheet.check_columns(("robot", "step", "time", "x", "y", "heading"), ("x", "y"))
    whose, (step, _) = sheet.named("robot", names, "robot"), _steps(sheet, times, tolerance)
    again = pd.DataFrame({"robot": whose, "step": step}).duplicated().to_numpy()
    sheet.refuse_where(again, "has a pose that an earlier row has, too")
    columns = [sheet.numbers(name, blank=True) for name in ("x", "y")]
    unknown = np.full(len(sheet), np.nan)
    heading = sheet.numbers("heading", blank=True) if sheet.has("heading") else unknown
    known = np.isfinite(columns)
    sheet.refuse_where(known[0] != known[1], "x and y are known, or neither")
    sheet.refuse_where(np.isfinite(heading) & ~known[0], "a heading needs a position")
    found: list[Array | None] = []
    for number in range(len(names)):
        rows = whose == number
        truth = np.full((len(times), 3), np.nan)
        truth[step[rows]] = np.stack([*columns, heading], axis=1)[rows]
        found.append(truth if rows.any() else None)
    return found


def landmark_map(sheet: Sheet | None) -> LandmarkMap | None:
    """The map that a table holds."""
    if sheet is None:
        return None
    sheet.check_columns(("id", "x", "y"), ("id", "x", "y"))
    ids = sheet.whole("id")
    sheet.refuse_where(pd.Series(ids).duplicated().to_numpy(), "is there twice", "id")
    return LandmarkMap(ids, np.stack([sheet.numbers("x"), sheet.numbers("y")], axis=1))


# Noise by row -----------------------------------------------------------------------------------


def noise_columns(names: Sequence[str]) -> list[str]:
    """Columns that may state the noise of these values."""
    return [f"sigma_{name}" for name in names] + [f"cov_{a}_{b}" for a in names for b in names]


def _covariances(sheet: Sheet, rows: np.ndarray, names: Sequence[str]) -> tuple[Array, np.ndarray]:
    """Covariances (m, n, n) of rows, and whether they are given (m,)."""
    size = len(names)
    matrices, stated = np.zeros((len(rows), size, size)), np.zeros((len(rows), size, size), bool)
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            filled_cells = sheet.filled(f"cov_{a}_{b}")[rows]
            if filled_cells.any():
                entry = sheet.numbers(f"cov_{a}_{b}", rows, blank=True)
                matrices[filled_cells, i, j] = entry[filled_cells]
                stated[filled_cells, i, j] = True
        by_sigma = sheet.filled(f"sigma_{a}")[rows]
        if by_sigma.any():
            sigma = sheet.numbers(f"sigma_{a}", rows, blank=True)
            for at in np.flatnonzero(by_sigma & (stated[:, i, i] | (sigma < 0)))[:1]:
                said = "is negative" if sigma[at] < 0 else f"stands beside cov_{a}_{a}: give one"
                sheet.refuse(said, int(rows[at]), f"sigma_{a}")
            matrices[by_sigma, i, i] = sigma[by_sigma] ** 2
            stated[by_sigma, i, i] = True
    mirrored = np.swapaxes(stated, 1, 2) & ~stated
    matrices[mirrored] = np.swapaxes(matrices, 1, 2)[mirrored]
    given = np.asarray(stated.any(axis=(1, 2)))
    for i, a in enumerate(names):
        for at in np.flatnonzero(given & ~stated[:, i, i])[:1]:
            sheet.refuse(f"states noise, but not sigma_{a} nor cov_{a}_{a}", int(rows[at]))
    for at in np.flatnonzero(~is_covariance(matrices))[:1]:
        said = f"the covariance of {', '.join(names)} is not positive semi-definite"
        sheet.refuse(said, int(rows[at]))
    return matrices, given


def _check_blank(sheet: Sheet, rows: np.ndarray, column: str, whose: str) -> None:
    for row in rows[sheet.filled(column)[rows]][:1]:
        sheet.refuse(f"is not of {whose}: leave it blank", int(row), column)
