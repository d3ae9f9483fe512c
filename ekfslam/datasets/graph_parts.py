"""What a graph file holds, whatever its format: motions, sightings, vertices, priors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekfslam.errors import FileFormatError
from ekfslam.geometry import Array

ROBOT = 1 << 40  # ids of the poses of robot r are from r ROBOT on


class Edges(NamedTuple):
    """Measurements between two things, or, with the same on both ends, of one.

    Attributes
    ----------
    line : (n,) ndarray of int
        Of the file.
    start, end : (n,) ndarray of int
        Ids of poses; the end of a sighting is a landmark.
    values : (n, d) ndarray
        End in the frame of start, or what a sensor at start reports of it.
    covariances : (n, d, d) or (d, d) ndarray
        Of each, or of all.
    time : (n,) ndarray, optional
        [s].
    """

    line: np.ndarray
    start: np.ndarray
    end: np.ndarray
    values: Array
    covariances: Array
    time: Array | None = None


class Vertices(NamedTuple):
    """Values of poses or landmarks that a file gives to start from.

    Attributes
    ----------
    line, ids : (n,) ndarray of int
    values : (n, d) ndarray
    time : (n,) ndarray, optional
        [s].
    """

    line: np.ndarray
    ids: np.ndarray
    values: Array
    time: Array | None = None


NO_ROWS = np.zeros(0, dtype=np.int64)
NO_VERTICES = Vertices(NO_ROWS, NO_ROWS, np.zeros((0, 2)))
NO_PRIORS = Edges(NO_ROWS, NO_ROWS, NO_ROWS, np.zeros((0, 3)), np.zeros((0, 3, 3)))


class Seen(NamedTuple):
    """Sightings of one sensor."""

    kind: str
    edges: Edges
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "sensor"


class Graph(NamedTuple):
    """What a file holds.

    Attributes
    ----------
    path : Path
    motions : Edges
    sightings : sequence of Seen
    frame : {"first", "second"}
        Pose in whose frame the noise of a motion is, see above.
    poses, landmarks : Vertices
        If there is one, all of its kind are there.
    fixed : Vertices
        Poses and landmarks that are held where they are; without values.
    priors : Edges
        Of poses.
    beyond : sequence of (int, str)
        Further lines that a dataset has no place for, and what they are.
    named : callable
        How the file calls a pose.
    repeats : bool
        Whether a landmark may be seen twice from a pose with the same values; else that is damage.
    """

    path: Path
    motions: Edges
    sightings: Sequence[Seen]
    frame: str
    poses: Vertices = NO_VERTICES
    landmarks: Vertices = NO_VERTICES
    fixed: Vertices = NO_VERTICES
    priors: Edges = NO_PRIORS
    beyond: Sequence[tuple[int, str]] = ()
    named: Callable[[int], str] = str
    repeats: bool = False

    def refuse(self, line: np.ndarray, bad: np.ndarray, said: Callable[[int], str]) -> None:
        """Name the line of the first bad row, if there is one; `said` takes the row."""
        for row in np.flatnonzero(bad)[:1].tolist():
            raise FileFormatError(f"{self.path}, line {line[row]}: {said(row)}")


def repeated(keys: np.ndarray) -> np.ndarray:
    """Whether each row has been there before."""
    _, first = np.unique(keys, axis=0, return_index=True)
    return ~np.isin(np.arange(len(keys)), first)


def some(edges: Edges, rows: np.ndarray) -> Edges:
    """Some of the measurements."""
    return Edges(
        edges.line[rows],
        edges.start[rows],
        edges.end[rows],
        edges.values[rows],
        edges.covariances if edges.covariances.ndim == 2 else edges.covariances[rows],
        None if edges.time is None else edges.time[rows],
    )
