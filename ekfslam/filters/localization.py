"""Localization on a known map: the EKF of the notes on Brenner's lectures."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ekfslam.adapters import Progress
from ekfslam.association.gates import Gates, chi2_gate, quantiles
from ekfslam.checks import checked_number
from ekfslam.compiled import prepare
from ekfslam.dataset import Dataset, LandmarkMap, Sightings
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.estimates import DIVERGED, OK, Decision, Estimate, Innovations, Trajectory
from ekfslam.filters.arrays import Log
from ekfslam.filters.map_matching import KNOWN, NEAREST, NEAREST_POSITION, Matching, localize
from ekfslam.geometry import Array
from ekfslam.models.sensors import BEARING, RANGE
from ekfslam.observations import NO_LANDMARK, WIDTH

ASSOCIATIONS = {
    "known": KNOWN,
    "nearest": NEAREST,
    "nearest-position": NEAREST_POSITION,
}
RECENT = 50  # sightings by which a robot is found lost


@dataclass(frozen=True)
class EkfLocalization:
    """EKF localization: the state is the pose, the landmarks are those of the dataset's known map.

    Each step moves the pose by the odometry; then all that a sensor saw at one instant is matched
    at the pose that this look begins with, and corrects it sighting after sighting, each with the
    expected measurement and Jacobian at the pose that the one before left (notes on Brenner's
    lectures, "The correction step"). Nothing in it needs an inverse model, so bearings or ranges
    alone will do, but for "nearest-position".

    A map may hold a part of the landmarks: sightings of others are rejected. Robots of a team
    localize each alone; sightings of robots are rejected, too. An estimate has no landmarks, for
    none is estimated.

    A sighting is odd if it matches no landmark of the map; where identities are known, if its
    innovation is outside the gate. Where more than half of the sightings are odd, of the run or of
    the last 50, a message says so. The status is `diverged` if all of the run are; or if more than
    half of the last 50 are and, where identities are not known, more than half of the landmarks of
    the map that the sensors should have seen from the estimated poses, in these looks or in all,
    were not matched. Else the map may just be a part of the world.

    Parameters
    ----------
    association : {"known", "nearest", "nearest-position"}, optional
        Identities of the dataset; the landmark of the smallest squared Mahalanobis distance of the
        innovation inside the gate, one that two sightings of a look claim going to the nearer one
        (the other is ambiguous and not used); or the landmark nearest to the back-projected point
        within `radius`, which two sightings may share, as in the notes. By default "known" where
        every observation has its identity, else "nearest".
    accept : float
        The gate: probability with which a true match falls inside, see `ekfslam.association.gates`.
        Known identities are trusted, and it only says which of them do not fit.
    radius : float
        Epsilon of the notes, of "nearest-position" [m].

    Raises
    ------
    InputError
        For a value that makes no sense; the message names it.
    """

    association: str | None = None
    accept: float = Gates.accept
    radius: float = 1.0
    name = "ekf-localization"

    def __post_init__(self) -> None:
        if self.association not in (None, *ASSOCIATIONS):
            listed = ", ".join(ASSOCIATIONS)
            raise InputError(f"association must be one of {listed}, got {self.association!r}")
        if not chi2_gate(self.accept, 1) > 0:
            raise InputError("accept 0 would let nothing pass")
        if not 0 < checked_number(self.radius, "radius") < np.inf:
            raise InputError(f"radius must be positive and finite, got {self.radius}")

    def estimate(self, dataset: Dataset, progress: Progress | None = None) -> Estimate:
        """Localize the robots of a dataset.

        Parameters
        ----------
        dataset : Dataset
        progress : callable, optional
            Called with (steps done, steps in all).

        Returns
        -------
        Estimate
            With the online trajectory, innovations and times.

        Raises
        ------
        UnsupportedError
            For a dataset without a known map, or views that the association cannot work with.
        """
        association, known = self._association(dataset), known_map(dataset)
        self.warm_up(dataset)
        started = time.perf_counter()
        steps, robots = dataset.poses, len(dataset.robots)
        priors = [robot.prior for robot in dataset.robots]
        mean = np.array([prior.mean for prior in priors])
        P = np.array([prior.covariance for prior in priors])
        log = Log.of(robots, steps, len(dataset.observations), int(Decision.REJECTED))
        rest = _arguments(dataset, known, mean, P, self._matching(association), log)
        k, chunk = 0, steps if progress is None else max(1, steps // 100)
        while k < steps:
            stop = min(k + chunk, steps)
            k = localize(k, stop, *rest)
            if progress is not None:
                progress(k, steps)
            if k < stop:
                break
        elapsed = time.perf_counter() - started
        if k < steps:
            log.nis[k] = log.nis[k] if log.dof[k] > 0 else np.nan
            status = DIVERGED
            message = f"innovation covariance not positive definite at step {k}"
        else:
            status, message = verdict(dataset, known, self._matching(association), log)
        one = robots == 1
        return Estimate(
            estimator=self.name,
            dataset=dataset.name,
            association=association,
            online=Trajectory(
                log.poses[0] if one else log.poses, log.covariances[0] if one else log.covariances
            ),
            innovations=Innovations(
                log.decision, np.append(known.ids, NO_LANDMARK)[log.landmark], log.innovation, log.S
            ),
            step_nis=log.nis,
            step_dof=log.dof,
            step_seconds=log.seconds,
            time_total=elapsed,
            time_marginals=0.0,
            status=status,
            message=message,
            options=asdict(self),
        )

    def warm_up(self, dataset: Dataset) -> None:
        """Compile, or load from disk, what a dataset needs, so that no clock has to count it."""
        matching = self._matching(self._association(dataset))
        robots = len(dataset.robots)
        log = Log.of(robots, 0, 0, int(Decision.REJECTED))
        mean, P = np.zeros((robots, 3)), np.zeros((robots, 3, 3))
        prepare(localize, 0, 0, *_arguments(dataset, known_map(dataset), mean, P, matching, log))

    def _association(self, dataset: Dataset) -> str:
        """The method: as stated, or what the dataset allows."""
        default = "known" if dataset.association_known else "nearest"
        association = self.association or default
        sightings = dataset.sightings
        partial = np.isin(sightings.kind, [BEARING, RANGE]) & (sightings.target < 0)
        if association == "nearest-position" and partial.any():
            raise UnsupportedError(
                "association 'nearest-position' needs sensors that determine a point"
            )
        return association

    def _matching(self, association: str) -> Matching:
        gates = quantiles(self.accept, WIDTH)
        return Matching(ASSOCIATIONS[association], gates, float(self.radius))


def known_map(dataset: Dataset) -> LandmarkMap:
    """The map to localize on.

    Raises
    ------
    UnsupportedError
        If the dataset has none.
    """
    if dataset.known_map is None:
        raise UnsupportedError(
            f"{dataset.name} has no known map to localize on; estimators of SLAM make their own"
        )
    return dataset.known_map


def on_map(ids: np.ndarray, known: LandmarkMap) -> np.ndarray:
    """Row of the map of each identity, -1 for those that are not on it."""
    order = np.argsort(known.ids)
    ordered = np.append(known.ids[order], NO_LANDMARK)
    place = np.searchsorted(ordered[:-1], ids)
    return np.where(ordered[place] == ids, np.append(order, -1)[place], -1)


def _arguments(
    dataset: Dataset, known: LandmarkMap, mean: Array, P: Array, matching: Matching, log: Log
) -> tuple[Any, ...]:
    """What the compiled loop takes behind its bounds."""
    sightings = Sightings(*(column.copy() for column in dataset.sightings))
    sightings = sightings._replace(landmark=on_map(sightings.landmark, known))
    moves = tuple(array.copy() for array in dataset.moves)
    offsets, places = dataset.offsets.copy(), known.positions.copy()
    return (*moves, offsets, sightings, places, mean, P, matching, log)


def verdict(dataset: Dataset, known: LandmarkMap, matching: Matching, log: Log) -> tuple[str, str]:
    """Whether the robots seem to be lost, as `EkfLocalization` says.

    Parameters
    ----------
    dataset : Dataset
    known : LandmarkMap
    matching : Matching
    log : Log
        Of a whole run.

    Returns
    -------
    str, str
        Status and message.
    """
    look, by_identity = dataset.sightings.look, matching.method == KNOWN
    counted = dataset.sightings.target < 0
    if by_identity:
        counted &= log.landmark >= 0
        odd = _squared(log) > matching.gates[np.isfinite(log.innovation).sum(axis=1)]
    else:
        odd = log.decision == Decision.REJECTED
    rows = np.flatnonzero(counted)
    if not len(rows):
        return OK, ""
    # Whole looks: what else was in view counts, too.
    recent = rows[look[rows] >= look[rows[-RECENT:][0]]]
    now, ever = _mostly(odd[recent]), _mostly(odd[rows])
    if not (now or ever):
        return OK, ""
    of = recent if now and not ever else rows
    count = f"{odd[of].sum()} of {'the last ' if len(of) < len(rows) else ''}{len(of)} sightings"
    what = "do not fit their landmarks" if by_identity else "match no landmark of the map"
    lost = odd[rows].all() or (now and by_identity)
    if lost or (now and any(_blind(dataset, known, log, some) for some in (recent, rows))):
        return DIVERGED, f"{count} {what}: lost, or the start was far off"
    why = "the start was far off" if by_identity else "the map is a part of the world"
    return OK, f"{count} {what}: {why}, or the robot was lost"


def _mostly(flags: np.ndarray) -> bool:
    return bool(2 * flags.sum() > len(flags))


def _squared(log: Log) -> Array:
    """Squared Mahalanobis norm of each innovation; 0 where there is none."""
    nu = np.nan_to_num(log.innovation)
    S = np.where(np.isnan(log.S), np.eye(WIDTH), log.S)
    return np.sum(nu * np.linalg.solve(S, nu[..., None])[..., 0], axis=-1)


def _blind(dataset: Dataset, known: LandmarkMap, log: Log, rows: np.ndarray) -> bool:
    """Whether more than half of what the looks of some rows should have shown was not matched."""
    seen = dataset.observations
    first = rows[np.unique(dataset.sightings.look[rows], return_index=True)[1]]
    expected = 0
    for index, sensor in enumerate(dataset.sensors):
        mine = first[seen.sensor[first] == index]
        poses = log.poses[seen.robot[mine], seen.step[mine]]
        expected += int(sensor.sees(poses[:, None], known.positions).sum())
    matched = int((log.decision[rows] == Decision.ACCEPTED).sum())
    return 2 * (expected - matched) > expected
