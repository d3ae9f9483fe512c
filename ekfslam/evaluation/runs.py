"""What the tables are made of: one series of one robot, the map, and the keys of a row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary, ref

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.estimates import Estimate, LandmarkEstimates, Trajectory
from ekfslam.evaluation.consistency import squared_mahalanobis, turned_error
from ekfslam.evaluation.trajectory import frame_motion
from ekfslam.geometry import Array

quiet = np.errstate(over="ignore", invalid="ignore", divide="ignore")
"""For a run that has gone wrong: it holds NaN, inf or numbers whose squares overflow, so that its
errors are empty or infinite, which is the answer and no reason to warn."""


_Made = TypeVar("_Made")


def kept_with_estimate(make: Callable[..., _Made]) -> Callable[..., _Made]:
    """Make it of (dataset, estimate, ...) once, and forget it together with the estimate.

    A cache of the usual kind would keep the estimate alive, with a covariance of any size.
    """
    kept: WeakKeyDictionary[Estimate, tuple[Any, ...]] = WeakKeyDictionary()

    @wraps(make)
    def recalled(dataset: Dataset, estimate: Estimate, *others: Any) -> _Made:
        found = kept.get(estimate)
        if found is None or found[0]() is not dataset or found[1] != others:
            found = kept[estimate] = ref(dataset), others, make(dataset, estimate, *others)
        made: _Made = found[2]
        return made

    return recalled


@dataclass(frozen=True, eq=False)
class Run:
    """One series of one robot.

    Attributes
    ----------
    robot : int
    name : {"online", "smoothed"}
    series : Trajectory
        Of this robot as estimated; poses that are not finite are NaN.
    truth : (K + 1, 3) ndarray
        NaN where not known, of a whole pose or of its heading alone.
    motion : (3,) ndarray
        What brings poses and map into the frame of the truth: the alignment of the series.
    """

    robot: int
    name: str
    series: Trajectory
    truth: Array
    motion: Array

    @cached_property
    def positions(self) -> np.ndarray:
        """Which poses have a true position, (K + 1,) of bool."""
        return np.isfinite(self.truth[:, 0])

    @cached_property
    def headings(self) -> np.ndarray:
        """Which of them have a true heading as well, so that their whole pose is known."""
        return np.isfinite(self.truth[:, 2])

    @property
    def last_position(self) -> int:
        """The last pose with a true position; the last of all if there is none."""
        return last_of(self.positions)

    @property
    def last_heading(self) -> int:
        """The last pose with a true heading; the last of all if there is none."""
        return last_of(self.headings)

    @cached_property
    def error(self) -> Array:
        """Of the poses as estimated, additive, (K + 1, 3); NaN where the truth is."""
        return geo.additive_error(self.truth, self.series.poses)

    @cached_property
    def error_invariant(self) -> Array:
        """The same in right-invariant coordinates."""
        return geo.invariant_error(self.truth, self.series.poses)

    @property
    def nees(self) -> Array:
        """NEES of the poses as estimated, 3 dof, (K + 1,); NaN without a true pose or skipped."""
        return self._nees[0]

    @property
    def nees_invariant(self) -> Array:
        """The same in right-invariant coordinates."""
        return self._nees[1]

    @cached_property
    def nees_position(self) -> Array:
        """NEES of the positions alone, 2 dof, in their own covariance; needs no true heading."""
        if self.series.covariances is None or not self.positions.any():
            return np.full(len(self.truth), np.nan)
        return squared_mahalanobis(self.error[:, :2], self.series.covariances[:, :2, :2])

    @cached_property
    def _nees(self) -> Array:
        """Both, (2, K + 1): as `pose_nees` and `pose_nees_invariant`."""
        if self.series.covariances is None or not self.headings.any():
            return np.full((2, len(self.truth)), np.nan)
        errors = self.error, turned_error(self.series.poses, self.error_invariant)
        return squared_mahalanobis(np.stack(errors), self.series.covariances)

    @cached_property
    def aligned(self) -> Array:
        """The poses in the frame of the truth, (K + 1, 3)."""
        return geo.compose(self.motion, self.series.poses)


@kept_with_estimate
def runs(dataset: Dataset, estimate: Estimate, alignment: str) -> list[Run]:
    """Every series of every robot: the views of one robot that the tables are made of.

    They are kept with the estimate, so that its tables share what they have in common.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
    alignment : {"none", "se2"}
        One motion per series, see `ekfslam.evaluation.frame_motion`.
    """
    motions = {name: frame_motion(dataset, s, alignment) for name, s in estimate.series.items()}
    views = []
    for index, robot in enumerate(dataset.robots):
        truth = np.full((dataset.poses, 3), np.nan) if robot.truth is None else robot.truth
        for name, everybody in estimate.series.items():
            mine = everybody.of_robot(index)
            series = Trajectory(nan_unless_finite(mine.poses), mine.covariances)
            views.append(Run(index, name, series, truth, motions[name]))
    return views


def last_of(which: np.ndarray) -> int:
    """Number of the last one that is true; of the last of all if none is."""
    found = np.flatnonzero(which)
    return int(found[-1]) if len(found) else len(which) - 1


def nan_unless_finite(rows: Array) -> Array:
    """Rows (n, d) with those that are not finite made NaN throughout."""
    return np.where(np.isfinite(rows).all(axis=1, keepdims=True), rows, np.nan)


def aligned_map(landmarks: LandmarkEstimates, motion: Array) -> Array:
    """Positions in the frame of the truth, (L, 2); those that are not finite are NaN."""
    return geo.from_frame(motion, nan_unless_finite(landmarks.positions))


def landmark_nees(landmarks: LandmarkEstimates, truth: Array) -> Array:
    """NEES of the landmarks as estimated, (L,); NaN where skipped."""
    if landmarks.covariances is None:
        return np.full(len(landmarks), np.nan)
    return squared_mahalanobis(landmarks.positions - truth, landmarks.covariances)


def row_keys(dataset: Dataset, estimate: Estimate, robot: int | None = None) -> dict[str, Any]:
    """The columns that tell whose row it is.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
    robot : int, optional
        Without it the row belongs to all robots, and has a robot's name if there is only one.
    """
    names = [each.name for each in dataset.robots]
    everybody = names[0] if len(names) == 1 else None
    return {
        "dataset": dataset.name,
        "seed": dataset.seed,
        "robot": everybody if robot is None else names[robot],
        "estimator": estimate.estimator,
    }
