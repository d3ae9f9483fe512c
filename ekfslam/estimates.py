"""The record that comes out of every estimator."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.storage import LARGE, Reader, Writer

FORMAT = "ekfslam-estimate"
VERSION = 2  # of files that hold a shared block once; all others are of version 1

OK, DIVERGED, FAILED, SKIPPED = STATUSES = ("ok", "diverged", "failed", "skipped")


class Decision(IntEnum):
    """What an estimator made of an observation."""

    ACCEPTED = 0  # corrected the estimate of a mapped landmark
    NEW = 1  # put a landmark into the map
    REJECTED = 2  # not used: without identity, or outside what is allowed
    AMBIGUOUS = 3  # not used: too far to accept, too near to be new, or a second claim
    TENTATIVE = 4  # not used: of something that has not been seen often enough to be a landmark
    DELAYED = 5  # kept until its landmark was determined, and used then


def _freeze(record: Any) -> None:
    """Make the arrays of a record read-only."""
    for entry in fields(record):
        value = getattr(record, entry.name)
        if isinstance(value, np.ndarray):
            view = value.view()
            view.flags.writeable = False
            object.__setattr__(record, entry.name, view)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of a run.

    Attributes
    ----------
    poses : (K + 1, 3) or (R, K + 1, 3) ndarray
        In the world [m, m, rad]; with a leading axis if there are several robots.
    covariances : (K + 1, 3, 3) or (R, K + 1, 3, 3) ndarray or None
        Additive in (x, y, theta), world frame; NaN where not computed.
    """

    poses: Array
    covariances: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self)

    def of_robot(self, robot: int) -> Trajectory:
        """The poses (K + 1, 3) of one robot."""
        if self.poses.ndim == 2:
            return self
        covariances = None if self.covariances is None else self.covariances[robot]
        return Trajectory(self.poses[robot], covariances)


@dataclass(frozen=True, eq=False)
class LandmarkEstimates:
    """The final map.

    Attributes
    ----------
    ids : (L,) ndarray of int
        The dataset's identities where association is known, the estimator's own otherwise.
    positions : (L, 2) ndarray
        In the world [m].
    covariances : (L, 2, 2) ndarray or None
        Marginal covariance of each [m^2].
    covariance : (2 L, 2 L) ndarray or None
        Joint covariance, where the estimator has it.
    undetermined : (U,) ndarray of int or None
        Identities of landmarks whose distance is still open: not among the points above.
    inverse_depth : (U, 4) ndarray or None
        Their parameters (x0, y0, alpha, rho), see `ekfslam.models.landmarks`.
    """

    ids: np.ndarray
    positions: Array
    covariances: Array | None = None
    covariance: Array | None = None
    undetermined: np.ndarray | None = None
    inverse_depth: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self)

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class Innovations:
    """What each observation met, in the order of the dataset's rows.

    Attributes
    ----------
    decision : (M,) ndarray of int
        A `Decision` per observation.
    landmark : (M,) ndarray of int
        Landmark of the estimate that it was taken for, -1 for none.
    innovation : (M, 2) ndarray
        Measured minus expected, angles wrapped; NaN for a new landmark or where there is none.
    S : (M, 2, 2) ndarray
        Covariance of the innovation; NaN likewise.
    """

    decision: np.ndarray
    landmark: np.ndarray
    innovation: Array
    S: Array

    def __post_init__(self) -> None:
        _freeze(self)

    def __len__(self) -> int:
        return len(self.decision)


@dataclass(frozen=True, eq=False)
class Linearizations:
    """Every linear model that a filter used: what the linear oracle rebuilds its answer from.

    With x the poses of the robots and l the landmarks, the filter worked as if

    - ``x_k = motion_to[k] + motion_jacobian[k] (x_{k-1} - motion_from[k]) + w``, where w has
      covariance ``motion_noise[k]`` and for k = 0 the prior stands for x_{-1};

    and as if, in the order of the rows, with m the target of the row (a landmark, or the pose of
    another robot at the same step) and point = (pose, target),

    - `OBSERVED`: ``innovation = jacobian ((x_k, m) - point) + v``, v of covariance ``noise``;
    - `CREATED`: ``l = point[3:] + jacobian[:, :3] (x_k - point[:3]) + v``: from here on the
      identity stands for a new variable of `size` coordinates; without an equation (`rows` is 0)
      if nothing was known of it before its sightings;
    - `CONVERTED`: ``l' = innovation + jacobian[:, 3:] (l - point[3:])`` without noise: from here on
      the identity stands for l', a point, made from l of four coordinates.

    Deletion is marginalisation and leaves no trace. Arrays are as wide as the widest case; what is
    not used of them is 0. d = `rows` below is what a row has in earnest.

    Attributes
    ----------
    motion_from, motion_to : (R, K + 1, 3) ndarray
        Pose before and after each motion.
    motion_jacobian, motion_noise : (R, K + 1, 3, 3) ndarray
        Of the motion with respect to the pose, and its noise in the world frame.
    event : (n,) ndarray of int
        `OBSERVED`, `CREATED` or `CONVERTED`.
    row : (n,) ndarray of int
        Observation of the dataset, -1 for a conversion.
    robot, step : (n,) ndarray of int
        Whose pose, of which step.
    landmark, target : (n,) ndarray of int
        Identity of the landmark, or the robot that is seen; -1 for the one that it is not.
    size, rows : (n,) ndarray of int
        Coordinates of the target: 2 of a point, 4 of an inverse depth, 3 of a pose; and rows of
        the equation.
    point : (n, 7) ndarray
        Linearisation point (pose, target).
    jacobian : (n, 4, 7) ndarray
    innovation : (n, 4) ndarray
    noise : (n, 4, 4) ndarray
    """

    OBSERVED = 0
    CREATED = 1
    CONVERTED = 2

    motion_from: Array
    motion_to: Array
    motion_jacobian: Array
    motion_noise: Array
    event: np.ndarray
    row: np.ndarray
    robot: np.ndarray
    step: np.ndarray
    landmark: np.ndarray
    target: np.ndarray
    size: np.ndarray
    rows: np.ndarray
    point: Array
    jacobian: Array
    innovation: Array
    noise: Array


@dataclass(frozen=True, eq=False)
class Estimate:
    """What an estimator says of a dataset.

    Attributes
    ----------
    estimator, dataset : str
        Names.
    association : str
        "known", or the method's name.
    online : Trajectory or None
        Pose k from measurements up to k.
    smoothed : Trajectory or None
        Every pose from all measurements.
    landmarks : LandmarkEstimates or None
        The map at the end.
    joint_covariance : (3 R + 2 L + 4 U, 3 R + 2 L + 4 U) ndarray or None
        Of the final poses of all robots and the map, in this order, additive; landmarks that are
        still undetermined come last, in inverse depth.
    innovations : Innovations or None
    step_nis : (K + 1,) ndarray or None
        Joint squared Mahalanobis norm of the innovations of a step; NaN where there were none.
    step_dof : (K + 1,) ndarray of int or None
        Rows in it.
    step_seconds : (K + 1,) ndarray or None
        Wall time of each step [s].
    effective_samples : (K + 1,) ndarray or None
        Of a particle filter: ``1 / sum w^2`` after what was seen, before particles are resampled.
    time_total, time_marginals : float
        Wall time from dataset to means, and of recovering covariances beyond it [s]; a filter
        computes both at once and has `time_marginals` 0.
    graph_error : float
        Objective of a smoother at its estimate (half the squared whitened residuals).
    graph_dof : int
        Rows of its residual minus dimensions of its state.
    status : {"ok", "diverged", "failed", "skipped"}
    message : str
        What there is to say: the reason of a status, floors of noise used, ...
    options : dict
        The estimator's settings.
    """

    estimator: str
    dataset: str
    association: str = ""
    online: Trajectory | None = None
    smoothed: Trajectory | None = None
    landmarks: LandmarkEstimates | None = None
    joint_covariance: Array | None = None
    innovations: Innovations | None = None
    step_nis: Array | None = None
    step_dof: np.ndarray | None = None
    step_seconds: Array | None = None
    effective_samples: Array | None = None
    time_total: float = float("nan")
    time_marginals: float = float("nan")
    graph_error: float = float("nan")
    graph_dof: int = 0
    status: str = OK
    message: str = ""
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.status not in STATUSES:
            raise InputError(f"status must be one of {', '.join(STATUSES)}, got {self.status!r}")
        if not isinstance(self.options, dict):
            raise InputError(f"options must be a dict, got {self.options!r}")
        _freeze(self)

    @property
    def series(self) -> dict[str, Trajectory]:
        """The trajectories there are, by name: "online", "smoothed"."""
        both = {"online": self.online, "smoothed": self.smoothed}
        return {name: trajectory for name, trajectory in both.items() if trajectory is not None}

    @property
    def final_trajectory(self) -> Trajectory | None:
        """The series that knows most: smoothed, or else online."""
        return self.smoothed if self.smoothed is not None else self.online

    def save(self, path: str | Path) -> None:
        """Write to one file without loss; the file appears whole or not at all.

        A joint covariance is written as it is, 8 n^2 bytes. The covariance of a large map that is
        the block of it, and no copy, is not written again, and is that block when it is loaded.
        """
        shared = self._map_in_joint()
        writer = Writer(FORMAT, VERSION if shared else 1)
        parts = ("online", "smoothed", "landmarks", "innovations")
        if shared:
            writer.header["map_in_joint"] = True
        writer.header["parts"] = [name for name in parts if getattr(self, name) is not None]
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name in writer.header["parts"]:
                for inner in fields(value):
                    if shared and (entry.name, inner.name) == ("landmarks", "covariance"):
                        continue
                    writer.put(f"{entry.name}.{inner.name}", getattr(value, inner.name))
            elif isinstance(value, np.ndarray):
                writer.put(entry.name, value)
            elif entry.name not in parts and value is not None:
                writer.header[entry.name] = value
        writer.save(path)

    @classmethod
    def load(cls, path: str | Path) -> Estimate:
        """Read what `save` wrote.

        Raises
        ------
        FileFormatError
            If the file is missing, damaged, of another format or of a newer version.
        """
        parts: dict[str, Any] = {
            "online": Trajectory,
            "smoothed": Trajectory,
            "landmarks": LandmarkEstimates,
            "innovations": Innovations,
        }
        with Reader(path, FORMAT, VERSION) as reader:
            values: dict[str, Any] = {}
            for entry in fields(cls):
                if entry.name in parts:
                    if entry.name in reader.header["parts"]:
                        kind = parts[entry.name]
                        values[entry.name] = kind(
                            **{
                                f.name: reader.get(f"{entry.name}.{f.name}")
                                if f.default is None
                                else reader.need(f"{entry.name}.{f.name}")
                                for f in fields(kind)
                            }
                        )
                elif entry.name in reader.header:
                    values[entry.name] = reader.header[entry.name]
                elif (array := reader.get(entry.name)) is not None:
                    values[entry.name] = array
            estimate = cls(**values)
            if estimate.landmarks is None or not reader.header.get("map_in_joint"):
                return estimate
            mapped = replace(estimate.landmarks, covariance=estimate._map_block())
            return replace(estimate, landmarks=mapped)

    def _map_block(self) -> Array:
        """The rows and columns of the joint covariance that are the points of the map."""
        landmarks, joint = self.landmarks, self.joint_covariance
        assert landmarks is not None
        assert joint is not None
        opened = 0 if landmarks.inverse_depth is None else landmarks.inverse_depth.size
        end = len(joint) - opened
        start = end - landmarks.positions.size
        return joint[start:end, start:end]

    def _map_in_joint(self) -> bool:
        """Whether the covariance of the map is large and a view into the joint one."""
        if self.landmarks is None or self.joint_covariance is None:
            return False
        block = self.landmarks.covariance
        if block is None or block.nbytes < LARGE:
            return False
        return block.__array_interface__ == self._map_block().__array_interface__
