"""The EKF-SLAM estimator over a dataset."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np

from ekfslam.adapters import Progress
from ekfslam.dataset import Dataset, Sightings
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import (
    DIVERGED,
    OK,
    Decision,
    Estimate,
    Innovations,
    Linearizations,
    Trajectory,
)
from ekfslam.filters.arrays import Journal, Log
from ekfslam.filters.ekf_slam import DONE, INDEFINITE
from ekfslam.filters.engine import Engine
from ekfslam.filters.options import Options
from ekfslam.filters.suitability import check_views, views_of_landmarks
from ekfslam.filters.variants import EKF
from ekfslam.geometry import Array, compose, compose_jacobians, congruence, heading_block

EVENTS = 4  # journal entries per observation at most, on average: seen, created, converted, waited


@dataclass(frozen=True)
class Ekf(Options):
    """The EKF-SLAM estimator; its options are those of `ekfslam.filters.options.Options`."""

    name = "ekf"
    engine: ClassVar[type[Engine]] = Engine

    def estimate(self, dataset: Dataset, progress: Progress | None = None) -> Estimate:
        """Run the filter over a dataset.

        Parameters
        ----------
        dataset : Dataset
        progress : callable, optional
            Called with (steps done, steps in all).

        Returns
        -------
        Estimate
            With the online trajectories, landmarks, joint covariance, innovations and times.

        Raises
        ------
        UnsupportedError
            For a dataset that the options cannot work with.
        """
        return self._run(dataset, progress, Journal.of(0))

    def warm_up(self, dataset: Dataset) -> None:
        """Compile, or load from disk, what a dataset needs, so that no clock has to count it."""
        association = self._association(dataset)
        self._prepare(dataset, association, views_of_landmarks(dataset.sightings), Journal.of(0))

    def linearizations(self, dataset: Dataset) -> tuple[Estimate, Linearizations]:
        """Estimate a dataset and tell every linearisation that was used.

        This is what the linear oracle of `ekfslam check` needs of a filter.

        Raises
        ------
        UnsupportedError
            For hypotheses of a bank, which share measurements and are no linear model; for other
            filters of the family, which linearise elsewhere or in other coordinates.
        """
        if self.variant != EKF:
            raise UnsupportedError(f"the Jacobians of {self.name} are not those of its models")
        if self.ranges == "bank":
            raise UnsupportedError("a bank of hypotheses is not one linear model")
        journal = Journal.of(EVENTS * len(dataset.observations) + 1)
        estimate = self._run(dataset, None, journal)
        assert estimate.online is not None
        deltas, covariances = dataset.moves
        after = estimate.online.poses.reshape(deltas.shape)
        priors = np.array([robot.prior.mean for robot in dataset.robots])
        before = np.concatenate([priors[:, None], after[:, :-1]], axis=1)
        used = slice(0, int(journal.used[0]))
        names = np.append(self._names(dataset, estimate), -1)
        columns = {name: getattr(journal, name)[used] for name in journal._fields[:-1]}
        columns["landmark"] = names[columns["landmark"]]
        return estimate, Linearizations(
            motion_from=before,
            motion_to=compose(before, deltas),
            motion_jacobian=compose_jacobians(before, deltas)[0],
            motion_noise=congruence(heading_block(before[..., 2]), covariances),
            **columns,
        )

    def _names(self, dataset: Dataset, estimate: Estimate) -> np.ndarray:
        """Identity of each register index."""
        if estimate.association == "known":
            ids = np.unique(dataset.sightings.landmark)
            return ids[ids >= 0]
        return np.arange(len(dataset.observations))

    def _truth(self, dataset: Dataset) -> tuple[Array, Array] | None:
        """What a filter may know of the truth: nothing, but for the ideal one."""
        return None

    def _association(self, dataset: Dataset) -> str:
        """The method: as stated, or what the dataset allows."""
        return self.association or ("known" if dataset.association_known else "nearest")

    def _prepare(
        self, dataset: Dataset, association: str, kinds: set[int], journal: Journal
    ) -> None:
        """Compile for such arrays as a run has, on a filter that holds nothing."""
        priors = [robot.prior for robot in dataset.robots]
        noted = len(journal.event) > 0
        known = 1 if association == "known" else 0
        engine = self.engine(priors, self, association, kinds, known, noted)
        moves = tuple(array[:, :1].copy() for array in dataset.moves)
        nothing = Sightings(*(column[:0].copy() for column in dataset.sightings))
        log = Log.of(len(priors), 1, 0, int(Decision.REJECTED))
        engine.prepare(moves, dataset.offsets[:1].copy(), nothing, log, journal)

    def _run(self, dataset: Dataset, progress: Progress | None, journal: Journal) -> Estimate:
        association, kinds = self._association(dataset), views_of_landmarks(dataset.sightings)
        check_views(self, association, dataset.sightings)
        truth = self._truth(dataset)
        steps = dataset.poses
        noted = len(journal.event) > 0
        self._prepare(dataset, association, kinds, journal)
        started = time.perf_counter()
        moves = tuple(array.copy() for array in dataset.moves)
        offsets = dataset.offsets.copy()
        sightings = Sightings(*(column.copy() for column in dataset.sightings))
        ids, codes = np.unique(sightings.landmark, return_inverse=True)
        codes = codes - np.searchsorted(ids, 0)  # no identity becomes -1
        ids = ids[ids >= 0]
        sightings = sightings._replace(landmark=np.maximum(codes, -1).astype(np.int64))
        priors = [robot.prior for robot in dataset.robots]
        landmarks = len(ids) if association == "known" else 0
        engine = self.engine(priors, self, association, kinds, landmarks, noted, truth)
        log = Log.of(len(priors), steps, len(codes), int(Decision.REJECTED))
        k, why = 0, DONE
        chunk = steps if progress is None else max(1, steps // 100)
        while k < steps and why != INDEFINITE:
            stop = min(k + chunk, steps)
            k, why = engine.run(k, stop, moves, offsets, sightings, log, journal)
            if progress is not None:
                progress(k, steps)
        if association != "known":
            ids = np.arange(int(engine.register.used[0]))
        mapped, joint = engine.landmarks(ids, surrender=True)
        elapsed = time.perf_counter() - started
        one = len(priors) == 1
        notes = []
        if why == INDEFINITE:
            log.nis[k] = log.nis[k] if log.dof[k] > 0 else np.nan
            notes.append(f"innovation covariance not positive definite at step {k}")
        if engine.undetermined:
            notes.append(f"{engine.undetermined} landmarks not determined")
        if engine.searches_cut:
            notes.append(f"{engine.searches_cut} searches for joint compatibility cut at the limit")
        return Estimate(
            estimator=self.name,
            dataset=dataset.name,
            association=association,
            online=Trajectory(
                log.poses[0] if one else log.poses, log.covariances[0] if one else log.covariances
            ),
            landmarks=mapped,
            joint_covariance=joint,
            innovations=Innovations(
                log.decision, np.append(ids, -1)[log.landmark], log.innovation, log.S
            ),
            step_nis=log.nis,
            step_dof=log.dof,
            step_seconds=log.seconds,
            time_total=elapsed,
            time_marginals=0.0,
            status=DIVERGED if why == INDEFINITE else OK,
            message="; ".join(notes),
            options=asdict(self),
        )
