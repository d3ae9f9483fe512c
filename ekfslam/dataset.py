"""The record that goes into every estimator: controls, observations, and what is known of truth.

Numbering: pose k is the pose after control k - 1, so K controls make K + 1 poses, and the
observations of step k are taken at pose k.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ekfslam import geometry as geo
from ekfslam.checks import check_finite, checked_array, frozen
from ekfslam.contradictions import check_observations
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.geometry import Array
from ekfslam.models.motion import Increments, MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import NO_LANDMARK, WIDTH, Observations, Sightings, padded
from ekfslam.robots import LandmarkMap, Prior, Robot
from ekfslam.storage import Reader, Writer

FORMAT = "ekfslam-dataset"
VERSION = 1


_Named = TypeVar("_Named", Sensor, Robot)


def _told_apart(given: Iterable[_Named]) -> tuple[_Named, ...]:
    """The sensors or robots, numbered where they share a name."""
    given = tuple(given)
    names = [one.name for one in given]
    return tuple(
        one if names.count(one.name) == 1 else replace(one, name=f"{one.name}-{i}")
        for i, one in enumerate(given, start=1)
    )


class Step(NamedTuple):
    """What happens at one step: the robot moves, then it looks.

    Attributes
    ----------
    increment : (3,) or (R, 3) ndarray
        From the pose before; zero for the first pose. One row per robot if there are several.
    covariance : (3, 3) or (R, 3, 3) ndarray
        Of the increment, in the frame of the pose before.
    observations : Sightings
    """

    increment: Array
    covariance: Array
    observations: Sightings


@dataclass(frozen=True, eq=False)
class Dataset:
    """One SLAM problem, simulated or recorded.

    Parameters
    ----------
    name : str
    robots : tuple of Robot
        All of them share the times of the poses; the column ``robot`` of the observations says
        whose they are. Robots of the same name are numbered.
    times : (K + 1,) array_like
        Strictly increasing times of the poses [s].
    sensors : tuple of Sensor
        Sensors of the same name are numbered.
    observations : Observations
    known_map : LandmarkMap, optional
        A map that estimators may use.
    true_map : LandmarkMap, optional
        For evaluation only.
    true_landmark : (M,) array_like of int, optional
        True identity of each observation, -1 for clutter; for evaluation only.
    provenance : str
        Where the data come from.
    seed : int, optional
        Of the simulation.
    notes : tuple of str
        What a reader of its tables must know, a sentence or two each. Those that speak of NEES also
        stand in the figures of it.

    Raises
    ------
    InputError
        If anything contradicts anything else; the message names the column and the row.
    """

    name: str
    robots: tuple[Robot, ...]
    times: Array
    sensors: tuple[Sensor, ...]
    observations: Observations
    known_map: LandmarkMap | None = None
    true_map: LandmarkMap | None = None
    true_landmark: np.ndarray | None = None
    provenance: str = ""
    seed: int | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.robots:
            raise InputError("a dataset needs at least one robot")
        listed = isinstance(self.notes, tuple | list)
        if not listed or not all(isinstance(note, str) for note in self.notes):
            raise InputError(f"notes must be several texts, got {self.notes!r}")
        object.__setattr__(self, "notes", tuple(self.notes))
        object.__setattr__(self, "robots", _told_apart(self.robots))
        object.__setattr__(self, "sensors", _told_apart(self.sensors))
        times = checked_array(self.times, float, (None,), "times")
        check_finite(times, "times")
        object.__setattr__(self, "times", times)
        late = np.flatnonzero(np.diff(times) <= 0)
        if len(late):
            raise InputError(
                f"times must increase: times[{late[0] + 1}] = {times[late[0] + 1]} "
                f"does not come after {times[late[0]]}"
            )
        for robot in self.robots:
            if len(robot.controls) + 1 != len(times):
                raise InputError(
                    f"{len(robot.controls)} controls of {robot.name} make "
                    f"{len(robot.controls) + 1} poses, but there are {len(times)} times"
                )
        check_observations(self.observations, times, self.sensors, self.robots)
        if self.true_landmark is not None:
            column = checked_array(
                self.true_landmark, np.int64, (len(self.observations),), "true_landmark"
            )
            object.__setattr__(self, "true_landmark", column)

    # What estimators and evaluation read ----------------------------------------------------

    @property
    def robot(self) -> Robot:
        """The only robot.

        Raises
        ------
        UnsupportedError
            If there are several.
        """
        if len(self.robots) != 1:
            raise UnsupportedError(f"{self.name} has {len(self.robots)} robots; this is for one")
        return self.robots[0]

    @property
    def prior(self) -> Prior:
        """Prior of the only robot."""
        return self.robot.prior

    @property
    def truth(self) -> Array | None:
        """True poses (K + 1, 3) of the only robot, if known."""
        return self.robot.truth

    @property
    def poses(self) -> int:
        """Number of poses, K + 1."""
        return len(self.times)

    @property
    def observation_times(self) -> Array:
        """Time of each observation [s], (M,)."""
        time = self.observations.time
        return self.times[self.observations.step] if time is None else time

    @property
    def observed_robot(self) -> np.ndarray:
        """Robot that each observation shows instead of a landmark, -1 for none, (M,)."""
        seen = self.observations.observed_robot
        return np.full(len(self.observations), -1) if seen is None else seen

    @property
    def association_known(self) -> bool:
        """Whether every observation carries the identity of its landmark, or shows a robot."""
        return bool(((self.observations.landmark >= 0) | (self.observed_robot >= 0)).all())

    @cached_property
    def sightings(self) -> Sightings:
        """Observations with their sensors looked up, all steps."""
        o = self.observations
        kinds = np.array([s.view.code for s in self.sensors], dtype=np.int64)
        mounts = np.array([s.mount for s in self.sensors]).reshape(-1, 3)
        limits = np.array([s.limits for s in self.sensors], dtype=float).reshape(-1, 3)
        noise = np.zeros((len(o), WIDTH, WIDTH))
        for index, sensor in enumerate(self.sensors):
            rows = o.sensor == index
            values = o.values[rows, : sensor.view.size]
            noise[rows] = padded(sensor.covariances(values), axes=2)
        if o.covariance is not None:
            noise = o.covariance
        look = np.column_stack([o.step, o.robot, o.sensor, self.observation_times])
        changes = (np.diff(look, axis=0) != 0).any(axis=1)
        first = np.zeros(min(len(o), 1), dtype=np.int64)
        return Sightings(
            frozen(kinds[o.sensor]),
            frozen(mounts[o.sensor]),
            o.values,
            frozen(np.ascontiguousarray(noise)),
            o.landmark,
            frozen(np.cumsum(np.concatenate([first, changes]))),
            o.robot,
            frozen(self.observed_robot),
            frozen(limits[o.sensor]),
            frozen(np.full(len(o), np.nan)) if o.descriptor is None else o.descriptor,
        )

    @cached_property
    def offsets(self) -> np.ndarray:
        """Row of the first observation of each step, (K + 2,): step k has offsets[k:k + 2]."""
        return frozen(np.searchsorted(self.observations.step, np.arange(self.poses + 1)))

    @cached_property
    def moves(self) -> Increments:
        """Increment of each robot that leads to each pose; the first one is zero.

        ``deltas`` is (R, K + 1, 3) and ``covariances`` (R, K + 1, 3, 3).
        """
        deltas = np.zeros((len(self.robots), self.poses, 3))
        covariances = np.zeros((len(self.robots), self.poses, 3, 3))
        for index, robot in enumerate(self.robots):
            deltas[index, 1:], covariances[index, 1:] = robot.increments
        return Increments(frozen(deltas), frozen(covariances))

    def steps(self) -> Iterator[Step]:
        """What happens step by step, from pose 0 to pose K."""
        deltas, covariances = self.moves
        which = slice(None) if len(self.robots) > 1 else 0
        for k in range(self.poses):
            rows = self.sightings.rows(int(self.offsets[k]), int(self.offsets[k + 1]))
            yield Step(deltas[which, k], covariances[which, k], rows)

    def moved(self, motion: Any) -> Dataset:
        """The same run in a world moved by a rigid motion.

        Parameters
        ----------
        motion : (3,) array_like
            Pose g; poses become g * pose, landmarks g * landmark.
        """
        turn = geo.heading_block(np.asarray(motion, dtype=float)[2])

        def moved_map(landmarks: LandmarkMap | None) -> LandmarkMap | None:
            if landmarks is None:
                return None
            return LandmarkMap(landmarks.ids, geo.from_frame(motion, landmarks.positions))

        robots = tuple(
            replace(
                r,
                prior=Prior(
                    geo.compose(motion, r.prior.mean), geo.congruence(turn, r.prior.covariance)
                ),
                truth=None if r.truth is None else geo.compose(motion, r.truth),
            )
            for r in self.robots
        )
        return replace(
            self,
            robots=robots,
            known_map=moved_map(self.known_map),
            true_map=moved_map(self.true_map),
        )

    def without_identities(self) -> Dataset:
        """The same run with the identities of its landmarks withheld from the estimators.

        The truth of the association, for evaluation, is kept; where there is none, the identities
        become it, if all are known.
        """
        known = self.observations.landmark if self.association_known else None
        return replace(
            self,
            observations=replace(
                self.observations, landmark=np.full(len(self.observations), NO_LANDMARK)
            ),
            true_landmark=known if self.true_landmark is None else self.true_landmark,
        )

    # Files ----------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write to one file without loss; the file appears whole or not at all.

        Of a motion model of one's own, its increments are written; see `Robot.saved`.

        Parameters
        ----------
        path : path
            The usual ending is ``.npz``.
        """
        robots = [robot.saved for robot in self.robots]
        writer = Writer(FORMAT, VERSION)
        writer.header.update(
            name=self.name,
            provenance=self.provenance,
            seed=self.seed,
            notes=self.notes,
            sensors=[s.to_dict() for s in self.sensors],
            robots=[{"name": r.name, "motion": r.motion.to_dict()} for r in robots],
        )
        writer.put("times", self.times)
        writer.put("true_landmark", self.true_landmark)
        for index, robot in enumerate(robots):
            writer.put(f"robot{index}.controls", robot.controls)
            writer.put(f"robot{index}.prior_mean", robot.prior.mean)
            writer.put(f"robot{index}.prior_covariance", robot.prior.covariance)
            writer.put(f"robot{index}.truth", robot.truth)
            writer.put(f"robot{index}.covariance", robot.covariance)
        for column in fields(Observations):
            writer.put(f"observations.{column.name}", getattr(self.observations, column.name))
        for name in ("known_map", "true_map"):
            landmarks = getattr(self, name)
            if landmarks is not None:
                writer.put(f"{name}.ids", landmarks.ids)
                writer.put(f"{name}.positions", landmarks.positions)
        writer.save(path)

    @classmethod
    def load(cls, path: str | Path) -> Dataset:
        """Read what `save` wrote.

        Raises
        ------
        FileFormatError
            If the file is missing, damaged, of another format or of a newer version.
        """
        with Reader(path, FORMAT, VERSION) as reader:
            header = reader.header
            robots = tuple(
                Robot(
                    MotionModel(**entry["motion"]),
                    reader.need(f"robot{index}.controls"),
                    Prior(
                        reader.need(f"robot{index}.prior_mean"),
                        reader.need(f"robot{index}.prior_covariance"),
                    ),
                    reader.get(f"robot{index}.truth"),
                    entry["name"],
                    reader.get(f"robot{index}.covariance"),
                )
                for index, entry in enumerate(header["robots"])
            )
            columns = {c.name: reader.get(f"observations.{c.name}") for c in fields(Observations)}

            def landmarks(name: str) -> LandmarkMap | None:
                ids = reader.get(f"{name}.ids")
                return None if ids is None else LandmarkMap(ids, reader.need(f"{name}.positions"))

            return cls(
                header["name"],
                robots,
                reader.need("times"),
                tuple(Sensor(**entry) for entry in header["sensors"]),
                Observations(**columns),
                landmarks("known_map"),
                landmarks("true_map"),
                reader.get("true_landmark"),
                header["provenance"],
                header["seed"],
                header.get("notes", ()),
            )
