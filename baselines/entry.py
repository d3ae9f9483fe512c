"""When landmarks enter a graph: as soon as their sightings determine them.

One bearing or one range leaves a system indeterminate, so sightings of a landmark are kept back
until together they say where it is; then all of them enter at once. A range and bearing, or an x
and y, does by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from baselines.landmark_graph import LandmarkGraph
from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.estimates import LandmarkEstimates
from ekfslam.geometry import Array
from ekfslam.models.fix import fix
from ekfslam.models.sensors import BEARING, RANGE, VIEWS

PosesAt = Callable[[list[int]], Array]
"""Poses (n, 3) of the robots that made some observations."""


def warm_up(dataset: Dataset) -> None:
    """Compile what finds landmarks, if a dataset needs it, before any clock starts."""
    if partial(dataset, np.arange(len(dataset.observations))).any():
        none = np.zeros((0, 2))
        fix(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), none, np.zeros(0))


def partial(dataset: Dataset, rows: np.ndarray) -> np.ndarray:
    """Which rows do not determine a landmark by themselves."""
    return np.isin(dataset.sightings.kind[rows], [BEARING, RANGE])


def located(dataset: Dataset, rows: list[int], poses_at: PosesAt) -> Array | None:
    """Where sightings of one landmark put it, None if they do not determine it.

    Parameters
    ----------
    dataset : Dataset
    rows : list of int
    poses_at : callable
        The poses that they were made from.

    Returns
    -------
    (2,) ndarray or None
    """
    observations, sightings = dataset.observations, dataset.sightings
    poses = poses_at(rows)
    full = np.flatnonzero(~partial(dataset, np.array(rows)))
    if len(full):
        row = rows[full[0]]
        sensor = dataset.sensors[int(observations.sensor[row])]
        return sensor.locate(poses[full[0]], observations.values[row])[0]
    determined, x, y, *_ = fix(
        sightings.kind[rows],
        geo.compose(poses, sightings.mount[rows]),
        sightings.values[rows],
        sightings.covariance[rows, 0, 0],
    )
    return np.array([x, y]) if determined else None


class Entrance:
    """Lets landmarks into a graph one by one, as sightings arrive.

    Parameters
    ----------
    problem : LandmarkGraph

    Attributes
    ----------
    entry : dict of int to int
        Row at which each landmark entered.
    lost : list of int
        Rows that were given up.
    """

    def __init__(self, problem: LandmarkGraph) -> None:
        self._dataset = problem.dataset
        self._landmark = problem.mapped.tolist()
        self._kept: dict[int, list[int]] = {}
        self.entry: dict[int, int] = {}
        self.lost: list[int] = []

    def forget(self, step: int) -> None:
        """Give up what was kept back from before a step: its poses are known no more."""
        first = int(self._dataset.offsets[max(step, 0)])
        waiting = {}
        for landmark, kept in self._kept.items():
            self.lost += [row for row in kept if row < first]
            if kept[-1] >= first:
                waiting[landmark] = [row for row in kept if row >= first]
        self._kept = waiting

    def arrive(
        self, rows: Iterable[int], poses_at: PosesAt
    ) -> tuple[list[int], list[tuple[int, Array]]]:
        """Take in the sightings of a step.

        Parameters
        ----------
        rows : iterable of int
        poses_at : callable
            Poses as they are known now.

        Returns
        -------
        ready : list of int
            Rows that enter now, also earlier ones.
        newcomers : list of (int, (2,) ndarray)
            Landmarks that enter now, and where.
        """
        ready, newcomers = [], []
        for row in rows:
            landmark = self._landmark[row]
            if landmark < 0 or landmark in self.entry:
                ready.append(row)
                continue
            kept = self._kept.setdefault(landmark, [])
            kept.append(row)
            position = located(self._dataset, kept, poses_at)
            if position is not None:
                self.entry[landmark] = row
                ready += self._kept.pop(landmark)
                newcomers.append((landmark, position))
        return ready, newcomers


def all_at_once(
    problem: LandmarkGraph, poses: Array, landmarks: LandmarkEstimates
) -> tuple[dict[int, int], dict[int, Array]]:
    """Landmarks that all their sightings together determine, and where to start them.

    Parameters
    ----------
    problem : LandmarkGraph
    poses : (R, K + 1, 3) ndarray
        The start.
    landmarks : LandmarkEstimates
        Its map; what it lacks is put where the sightings say.

    Returns
    -------
    entry : dict of int to int
        First row of each of them.
    positions : dict of int to (2,) ndarray
    """
    dataset, rows = problem.dataset, problem.rows
    observations = dataset.observations

    def poses_at(rows: list[int]) -> Array:
        return poses[observations.robot[rows], observations.step[rows]]

    shown = problem.mapped[rows]
    given = dict(zip(landmarks.ids.tolist(), landmarks.positions, strict=True))
    whole = set(shown[~partial(dataset, rows)].tolist())
    ids, counts = np.unique(shown, return_counts=True)
    ordered = rows[np.argsort(shown, kind="stable")]
    of_each = np.split(ordered, np.cumsum(counts))[:-1]
    entry, positions = {}, {}
    for landmark, own in zip(ids.tolist(), of_each, strict=True):
        if landmark < 0:
            continue
        position = given.get(landmark)
        if position is None or landmark not in whole:
            found = located(dataset, own.tolist(), poses_at)
            if found is None:
                continue
            position = found if position is None else position
        entry[landmark], positions[landmark] = int(own[0]), position
    return entry, positions


def rows_of(problem: LandmarkGraph, entry: dict[int, int]) -> list[int]:
    """Rows that are in a graph with these landmarks."""
    shown = problem.mapped[problem.rows]
    inside = (shown < 0) | np.isin(shown, list(entry))
    return problem.rows[inside].tolist()


def notes(problem: LandmarkGraph, entry: dict[int, int]) -> list[str]:
    """What there is to say of landmarks that could not enter at once."""
    dataset, rows = problem.dataset, problem.rows
    shown = problem.mapped[rows]
    late = partial(dataset, rows) & (shown >= 0)
    some = late & ~np.isin(shown, shown[~late])
    if not some.any():
        return []
    by = " and ".join(_reported(dataset, rows[some]))
    found = [f"landmarks seen by {by} alone enter when these determine them"]
    left = some & ~np.isin(shown, list(entry))
    if left.any():
        by = " and ".join(_reported(dataset, rows[left]))
        count, of = len(np.unique(shown[left])), len(np.unique(shown[shown >= 0]))
        found.append(f"{count} of {of} landmarks never determined by {by} alone: left out")
    return found


def _reported(dataset: Dataset, rows: np.ndarray) -> list[str]:
    kinds = np.unique(dataset.sightings.kind[rows]).tolist()
    return [f"{view.names[0]}s" for view in VIEWS.values() if view.code in kinds]
