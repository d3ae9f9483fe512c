"""What a dataset is made of besides its observations: robots, priors and maps."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ekfslam.checks import check_finite, checked_array, checked_covariance, frozen, is_covariance
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.mixture import Components
from ekfslam.models.motion import Increments, MotionModel
from ekfslam.own_models import OwnMotion


@dataclass(frozen=True, eq=False)
class LandmarkMap:
    """Point landmarks: identities and positions.

    Parameters
    ----------
    ids : (L,) array_like of int
        Distinct, not negative.
    positions : (L, 2) array_like
        In the world [m].
    """

    ids: np.ndarray
    positions: Array

    def __post_init__(self) -> None:
        ids = checked_array(self.ids, np.int64, (None,), "landmark ids")
        positions = checked_array(self.positions, float, (len(ids), 2), "landmark positions")
        check_finite(positions, "landmark positions")
        if (ids < 0).any() or len(np.unique(ids)) != len(ids):
            raise InputError("landmark ids must be distinct and not negative")
        object.__setattr__(self, "ids", ids)
        object.__setattr__(self, "positions", positions)

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the first pose.

    Parameters
    ----------
    mean : (3,) array_like
        Pose in the world [m, m, rad].
    covariance : (3, 3) array_like
        Additive in (x, y, theta); zero for an exactly known start.
    """

    mean: Array = field(default_factory=lambda: np.zeros(3))
    covariance: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        mean = checked_array(self.mean, float, (3,), "prior mean")
        check_finite(mean, "prior mean")
        object.__setattr__(self, "mean", mean)
        object.__setattr__(
            self, "covariance", checked_covariance(self.covariance, 3, "prior covariance")
        )


@dataclass(frozen=True, eq=False)
class Robot:
    """One robot: how it moves, what it was told, where it started, where it truly was.

    Parameters
    ----------
    motion : MotionModel
        Or one of the user's own, `ekfslam.own_models.OwnMotion`.
    controls : (K, m) array_like
        Columns as `MotionModel.control_names`.
    prior : Prior
    truth : (K + 1, 3) array_like, optional
        True poses [m, m, rad]. NaN where it is not known: of a whole pose, or of its heading alone.
    name : str
    covariance : (K, n, n) array_like, optional
        Noise of each control, where the set gives it; the motion model's by default.
    """

    motion: MotionModel
    controls: Array
    prior: Prior = field(default_factory=Prior)
    truth: Array | None = None
    name: str = "robot"
    covariance: Array | None = None

    def __post_init__(self) -> None:
        width = len(self.motion.control_names)
        controls = checked_array(self.controls, float, (None, width), f"controls of {self.name}")
        check_finite(controls, f"controls of {self.name}")
        object.__setattr__(self, "controls", controls)
        if self.truth is not None:
            truth = checked_array(
                self.truth, float, (len(controls) + 1, 3), f"truth of {self.name}"
            )
            _check_truth(truth, f"truth of {self.name}")
            object.__setattr__(self, "truth", truth)

        if self.covariance is not None:
            noisy = self.motion.noises
            shape, name = (len(controls), noisy, noisy), f"covariance of {self.name}"
            given = checked_array(self.covariance, float, shape, name)
            check_finite(given, name)
            bad = np.flatnonzero(~is_covariance(given))
            if len(bad):
                raise InputError(f"{name} is not positive semi-definite in row {bad[0]}")
            object.__setattr__(self, "covariance", given)

    @property
    def truth_known(self) -> bool:
        """Whether the truth of every pose is known."""
        return self.truth is not None and bool(np.isfinite(self.truth).all())

    @cached_property
    def increments(self) -> Increments:
        """Body increments of the whole run with their covariances, computed once."""
        return Increments(*map(frozen, self.motion.increments(self.controls, self.covariance)))

    @cached_property
    def components(self) -> Components:
        """Body increments of the whole run as the mixture that their noise is, computed once."""
        return Components(*map(frozen, self.motion.components(self.controls, self.covariance)))

    @property
    def saved(self) -> Robot:
        """The robot as files keep it: with the increments that a motion model of one's own makes.

        They are controls of kind ``odometry``, each with its covariance, so that estimates are the
        same; any other robot is itself.
        """
        if not isinstance(self.motion, OwnMotion):
            return self
        deltas, covariances = self.increments
        typical = covariances.sum(axis=0) / max(1, len(covariances))  # each step has its own
        motion = MotionModel("odometry", typical)
        return replace(self, motion=motion, controls=deltas, covariance=covariances)


def _check_truth(truth: Array, name: str) -> None:
    """Refuse what is neither a pose, nor a position, nor unknown."""
    known = np.isfinite(truth)
    half = known[:, 0] != known[:, 1]
    bad = np.isinf(truth).any(axis=1) | half | (known[:, 2] & ~known[:, 0])
    if bad.any():
        raise InputError(
            f"{name} holds no pose in row {np.flatnonzero(bad)[0]}: what is not known is NaN, "
            "of the whole pose or of its heading alone"
        )
