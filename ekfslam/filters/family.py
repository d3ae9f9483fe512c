"""The estimators of the family: the EKF by other names, see `ekfslam.filters.variants`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekfslam.checks import checked_number
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.filters import variants
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.options import MOST, Settings
from ekfslam.geometry import Array


@dataclass(frozen=True)
class Iekf(Ekf):
    """Iterated EKF-SLAM: each correction is linearised again at its result.

    Parameters
    ----------
    iterations : int
        At most, of each correction.
    tolerance : float
        Iterates that differ by less, in every coordinate [m, rad], are the same.
    """

    iterations: int = 20
    tolerance: float = 1e-6
    name = "iekf"
    variant = variants.ITERATED

    def __post_init__(self) -> None:
        super().__post_init__()
        whole = isinstance(self.iterations, int | np.integer) and self.iterations is not True
        if not whole or not 1 <= self.iterations <= MOST:
            raise InputError(f"iterations must be a whole number from 1 on, got {self.iterations}")
        if not 0 <= checked_number(self.tolerance, "tolerance") < np.inf:
            raise InputError(f"tolerance must not be negative, got {self.tolerance}")

    def settings(self, association: str, kinds: set[int], landmarks: int, robots: int) -> Settings:
        """As of `Options`, with the iterations."""
        plain = super().settings(association, kinds, landmarks, robots)
        return plain._replace(iterations=int(self.iterations), tolerance=float(self.tolerance))


@dataclass(frozen=True)
class EkfIdeal(Ekf):
    """EKF-SLAM with every Jacobian at the truth: a yardstick, for simulated data alone."""

    name = "ekf-ideal"
    variant = variants.IDEAL

    def _truth(self, dataset: Dataset) -> tuple[Array, Array]:
        """True poses (R, K + 1, 3), and true place (M, 2) of what each observation shows."""
        truths = [robot.truth for robot in dataset.robots]
        if dataset.true_map is None or not all(r.truth_known for r in dataset.robots):
            raise UnsupportedError(f"{self.name} needs the truth of poses and landmarks")
        known = dataset.true_map
        shown = dataset.observations.landmark
        if dataset.true_landmark is not None:
            shown = dataset.true_landmark
        elif not dataset.association_known:
            raise UnsupportedError(f"{self.name} needs to know who truly was seen")
        order = np.argsort(known.ids)
        ids = known.ids[order]
        places = np.full((len(shown), 2), np.nan)
        real = np.isin(shown, ids)
        places[real] = known.positions[order[np.searchsorted(ids, shown[real])]]
        return np.array(truths), places


@dataclass(frozen=True)
class EkfFej(Ekf):
    """First-estimates Jacobian EKF-SLAM (Huang, Mourikis and Roumeliotis 2008)."""

    name = "ekf-fej"
    variant = variants.FEJ


@dataclass(frozen=True)
class EkfOc(Ekf):
    """Observability-constrained EKF-SLAM (Huang, Mourikis and Roumeliotis 2010)."""

    name = "ekf-oc"
    variant = variants.OC


@dataclass(frozen=True)
class EkfRi(Ekf):
    """Right-invariant EKF-SLAM (Barrau and Bonnabel 2015)."""

    name = "ekf-ri"
    variant = variants.INVARIANT


@dataclass(frozen=True)
class EkfRobocentric(Ekf):
    """Robocentric EKF-SLAM (Castellanos et al. 2004, 2007)."""

    name = "ekf-robocentric"
    variant = variants.ROBOCENTRIC
