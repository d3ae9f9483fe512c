"""The files of a set of MRCLAM, read and judged: who is who, what was told, seen, and true."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekfslam.datasets.places import there
from ekfslam.datasets.text import Table, lines_of, read_table, whole
from ekfslam.errors import FileFormatError
from ekfslam.geometry import Array
from ekfslam.robots import LandmarkMap

BARCODES = "Barcodes.dat"
LANDMARKS = "Landmark_Groundtruth.dat"
CORRECTED = "Landmark_Groundtruth.corrected.dat"
ROBOTS = range(1, 6)  # subjects that move; all others are landmarks
UNKNOWN = 0  # subject of a barcode that is in no table
# What the published file of set 1 says of two landmarks; each lies where the other is listed.
SWAPPED = {11: (3.15071999, 2.38294871), 17: (0.03596156, -2.84396626)}
SAME_PLACE = 1e-3  # [m]
BACKWARDS = 1.0  # [s] that a stamp may go back: they repeat, and are not quite in order
SILENCE = 60.0  # [s] without a command: the published files have a second at most
BEYOND = 10.0  # [s] that a sighting may lie before the first command, or after the last


class Column(NamedTuple):
    """A column of a file: what it holds, how large that may be, and what it is if larger."""

    name: str
    most: float
    hint: str


TIME = Column("time [s]", 1e10, "milliseconds?")
PLACE = tuple(Column(f"{axis} [m]", 100.0, "millimetres?") for axis in "xy")
SPREAD = tuple(Column(f"standard deviation of {axis} [m]", 10.0, "millimetres?") for axis in "xy")
HEADING = Column("heading [rad]", 6.3, "degrees?")
COLUMNS: Mapping[str, tuple[Column, ...]] = {
    "Barcodes": (Column("subject", 1e6, "a number?"), Column("barcode", 1e6, "a number?")),
    "Landmarks": (Column("subject", 1e6, "a number?"), *PLACE, *SPREAD),
    "Odometry": (
        TIME,
        Column("forward velocity [m/s]", 2.0, "millimetres per second?"),
        Column("angular velocity [rad/s]", 10.0, "degrees per second?"),
    ),
    "Measurement": (
        TIME,
        Column("barcode", 1e6, "a number?"),
        Column("range [m]", 50.0, "millimetres?"),
        Column("bearing [rad]", 3.15, "degrees?"),
    ),
    "Groundtruth": (TIME, *PLACE, HEADING),
    "Groundtruth_sparse": (TIME, *PLACE, HEADING, Column("count", 1e6, "a number?")),
}


class Who(NamedTuple):
    """Barcodes and whose they are.

    Attributes
    ----------
    barcodes, subjects : (n,) ndarray of int
        In order of the barcodes.
    """

    barcodes: np.ndarray
    subjects: np.ndarray

    def of(self, barcodes: np.ndarray) -> np.ndarray:
        """Subjects of barcodes, `UNKNOWN` for one that is in no table."""
        place = np.minimum(np.searchsorted(self.barcodes, barcodes), len(self.barcodes) - 1)
        return np.where(self.barcodes[place] == barcodes, self.subjects[place], UNKNOWN)


class Log(NamedTuple):
    """What the files of one robot say; times in seconds as in the files.

    Attributes
    ----------
    robot : int
    commands : (n, 3) ndarray
        Time, forward and angular velocity, in order of time.
    time, subject, values : (m,), (m,) and (m, 2) ndarray
        Sightings in order of time; range and bearing.
    truth : (t, 4) ndarray
        Time, x, y, heading; times increase. No row if there is no file.
    sparse : bool
        Whether the truth is of single instants, between which nothing is known.
    """

    robot: int
    commands: Array
    time: Array
    subject: np.ndarray
    values: Array
    truth: Array
    sparse: bool

    @property
    def name(self) -> str:
        """Such as ``robot3``."""
        return f"robot{self.robot}"

    @property
    def timed(self) -> str:
        """Names of the files that say from when to when the robot runs."""
        kinds = ["Odometry"] + ["Groundtruth" + "_sparse" * self.sparse] * bool(len(self.truth))
        return ", ".join(f"Robot{self.robot}_{kind}.dat" for kind in kinds)

    def since(self, start: float) -> Log:
        """The same with times that count from some time on."""
        shift = np.array([start, 0.0, 0.0, 0.0])
        return self._replace(
            commands=self.commands - shift[:3], time=self.time - start, truth=self.truth - shift
        )


def read_who(path: Path) -> Who:
    """The table of barcodes.

    Raises
    ------
    FileFormatError
        For a malformed file, and for a subject or barcode that is there twice.
    """
    table = _read(path, "Barcodes")
    subjects, barcodes = (whole(table, i, name) for i, name in enumerate(("subject", "barcode")))
    table.refuse(subjects < 1, "subjects are numbered from 1 on")
    table.refuse(_again(subjects), "this subject has a barcode already")
    table.refuse(_again(barcodes), "this barcode is another subject's already")
    order = np.argsort(barcodes)
    return Who(barcodes[order], subjects[order])


def read_landmarks(path: Path, who: Who, number: int) -> tuple[LandmarkMap, str]:
    """True positions of the landmarks, and what was done about the two that set 1 has swapped.

    Parameters
    ----------
    path : path
        The published file; a corrected one beside it is read instead.
    who : Who
    number : int
        Of the set.

    Raises
    ------
    FileFormatError
        For a malformed file, and if the landmarks are not those of the table of barcodes.
    """
    corrected = there(path, CORRECTED)
    table = _read(corrected or path, "Landmarks")
    subjects, positions = whole(table, 0, "subject"), table.values[:, 1:3]
    table.refuse(_again(subjects), "this landmark is there already")
    table.refuse(table.values[:, 3:].min(axis=1) < 0, "a standard deviation is negative")
    table.refuse(~np.isin(subjects, who.subjects), "this landmark has no barcode in Barcodes.dat")
    missing = sorted(set(who.subjects.tolist()) - set(subjects.tolist()) - set(ROBOTS))
    if missing:
        raise FileFormatError(
            f"{table.path}, line {table.lines[-1]}: the last landmark, but there is none of "
            f"subject {missing[0]}, which has a barcode in Barcodes.dat"
        )
    said = ""
    if corrected:
        said = f"positions of landmarks from {corrected.name}"
    elif number == 1:
        rows = [np.flatnonzero(subjects == subject) for subject in SWAPPED]
        there_now = [positions[row].ravel() for row in rows]
        if _match(there_now, list(SWAPPED.values())):
            positions = positions.copy()
            positions[np.concatenate(rows)] = positions[np.concatenate(rows[::-1])]
            said = "landmarks 11 and 17, which the published file has swapped, were swapped back"
        elif not _match(there_now, list(SWAPPED.values())[::-1]):
            said = "the positions of landmarks 11 and 17 are not the published ones: not swapped"
    return LandmarkMap(subjects, positions), said


def missing_of(beside: Path, robot: int) -> str:
    """Names of the files of a robot that must be there and are not; empty if all are."""
    needed = (f"Robot{robot}_{kind}.dat" for kind in ("Odometry", "Measurement"))
    return " and ".join(file for file in needed if there(beside, file) is None)


def read_log(beside: Path, robot: int, who: Who) -> Log | None:
    """The files of one robot, or None if it has no odometry or no measurements.

    Parameters
    ----------
    beside : path
        A file of the set.
    robot : int
    who : Who

    Raises
    ------
    FileFormatError
        For a malformed file, and for files whose stamps are not of one run.
    """
    kinds = ("Odometry", "Measurement", "Groundtruth", "Groundtruth_sparse")
    paths = {kind: there(beside, f"Robot{robot}_{kind}.dat") for kind in kinds}
    if paths["Odometry"] is None or paths["Measurement"] is None:
        return None
    odometry = _in_order(_read(paths["Odometry"], "Odometry"))
    steps = np.diff(odometry.values[:, 0], prepend=odometry.values[0, 0])
    odometry.refuse(steps > SILENCE, f"no command for more than {SILENCE:g} s before this one")
    if np.median(steps) > 1:
        odometry.refuse(steps > 1, "commands are seconds apart: are the stamps milliseconds?")
    seen = _in_order(_read(paths["Measurement"], "Measurement"))
    seen.refuse(seen.values[:, 2] <= 0, "range must be positive")
    first, last = odometry.values[[0, -1], 0]
    seen.refuse(
        (seen.values[:, 0] < first - BEYOND) | (seen.values[:, 0] > last + BEYOND),
        f"stamp is outside of {odometry.path.name}, which has {first:.3f} (line "
        f"{odometry.lines[0]}) to {last:.3f} (line {odometry.lines[-1]}): is that one cut short?",
    )
    truth, sparse = np.empty((0, 4)), False
    for kind in kinds[:1:-1]:  # the full truth counts if both are there
        path = paths[kind]
        if path is not None:
            truth, sparse = _truth(path, kind, odometry), kind == "Groundtruth_sparse"
    barcodes = whole(seen, 1, "barcode")
    return Log(
        robot,
        odometry.values,
        seen.values[:, 0],
        who.of(barcodes),
        seen.values[:, 2:],
        truth,
        sparse,
    )


def _truth(path: Path, kind: str, odometry: Table) -> Array:
    """Rows of a file of truth, one at a time, that has something to do with the odometry."""
    first = next(lines_of(path), None)
    if first and len(first.words) == len(COLUMNS["Groundtruth"]):
        kind = "Groundtruth"  # the count of the sparse one may be missing
    table = _in_order(_read(path, kind))
    begin, end = odometry.values[[0, -1], 0]
    if not ((table.values[:, 0] >= begin) & (table.values[:, 0] <= end)).any():
        raise FileFormatError(
            f"{path}, line {table.lines[0]}: the stamps from {table.values[0, 0]:.3f} to "
            f"{table.values[-1, 0]:.3f} have nothing in common with those of "
            f"{odometry.path.name}, {begin:.3f} to {end:.3f}"
        )
    _, once = np.unique(table.values[:, 0], return_index=True)
    return table.values[once, :4]


def _read(path: Path, kind: str) -> Table:
    """A file of numbers none of which is too large for its unit."""
    columns = COLUMNS[kind]
    table = read_table(path, [column.name for column in columns])
    for value, column in zip(table.values.T, columns, strict=True):
        table.refuse(
            np.abs(value) > column.most,
            f"{column.name} is more than {column.most:g}; are these {column.hint}",
        )
    return table


def _in_order(table: Table) -> Table:
    """Rows in order of time; stamps may repeat or go back a little, and then keep their order."""
    time = table.values[:, 0]
    table.refuse(
        time < np.maximum.accumulate(time) - BACKWARDS,
        f"time goes back by more than {BACKWARDS:g} s",
    )
    return table.rows(np.argsort(time, kind="stable"))


def _again(ids: np.ndarray) -> np.ndarray:
    """Whether an id has been there before."""
    again = np.ones(len(ids), dtype=bool)
    again[np.unique(ids, return_index=True)[1]] = False
    return again


def _match(found: list[Array], wanted: list[tuple[float, float]]) -> bool:
    """Whether two landmarks are there, in these places."""
    return all(
        place.size == 2 and np.hypot(*(place - where)) < SAME_PLACE
        for place, where in zip(found, wanted, strict=True)
    )
