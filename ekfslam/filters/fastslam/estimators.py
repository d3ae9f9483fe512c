"""The FastSLAM estimators over a dataset."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from ekfslam.adapters import Progress
from ekfslam.association.gates import Gates, chi2_gate
from ekfslam.checks import checked_number
from ekfslam.compiled import prepare
from ekfslam.dataset import Dataset, Sightings
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.estimates import Estimate, Trajectory
from ekfslam.filters.fastslam.gaussians import square_root, turned
from ekfslam.filters.fastslam.particles import Cloud, Maps, Paths
from ekfslam.filters.fastslam.step import Draws, Log, Motion, Scratch, Settings, run
from ekfslam.filters.fastslam.summary import (
    innovations,
    look_back,
    map_of_one,
    mixture,
    particle_of_each_step,
    smoothed,
)
from ekfslam.geometry import Array, heading_block, wrap
from ekfslam.models.sensors import RANGE_BEARING, VIEWS, XY

ASSOCIATIONS = ("known", "maximum-likelihood")
LANDMARKS = 64  # room to begin with, where their number is not known
BLOCK = 2**20  # random numbers that are drawn at once
MOST = 2**31 - 1  # particles times poses


@dataclass(frozen=True)
class Fastslam1:
    """FastSLAM: particles are drawn from the motion, and weighed by what is seen.

    Principles of Robot Autonomy, Alg. 3; Montemerlo et al. 2002. For one robot with sensors that
    determine a point.

    Parameters
    ----------
    particles : int
    seed : int
        Of all random numbers: the same seed, the same bytes.
    association : {"known", "maximum-likelihood"}, optional
        Identities from the dataset, or the likeliest landmark of each particle's own map. By
        default "known" where every observation has its identity.
    resample_below : float
        Share of the particles below which the effective number of samples, ``1 / sum w^2``, must
        fall for them to be resampled: 0 never, 1 after all that is seen.
    new : float
        A sighting shows something new if it is not likelier of any landmark than, of one known
        exactly, a sighting at this quantile; see `ekfslam.filters.fastslam.recognition`. It is
        the probability that a true match of a well-known landmark is taken.
    evidence : bool
        Forget landmarks that were not seen more often than they were, of looks that should have
        shown them (Montemerlo and Thrun 2003). Not where identities are known.

    Raises
    ------
    InputError
        For a value that makes no sense; the message names it.
    """

    particles: int = 100
    seed: int = 0
    association: str | None = None
    resample_below: float = 0.5
    new: float = Gates.new
    evidence: bool = True
    name = "fastslam1"
    informed = False  # no option: whether the proposal knows what is seen

    def __post_init__(self) -> None:
        for name, least, most in (("particles", 1, MOST), ("seed", 0, np.inf)):
            value = getattr(self, name)
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not whole or not least <= value <= most:
                bounds = f"{least} on" if most == np.inf else f"{least} to {most}"
                raise InputError(f"{name} must be a whole number from {bounds}, got {value!r}")
        if self.association not in (None, *ASSOCIATIONS):
            listed = ", ".join(ASSOCIATIONS)
            raise InputError(f"association must be one of {listed}, got {self.association!r}")
        if not 0 <= checked_number(self.resample_below, "resample_below") <= 1:
            raise InputError(f"resample_below must be in [0, 1], got {self.resample_below}")
        if not 0 < checked_number(self.new, "new") < 1:
            raise InputError(f"new must be a probability in (0, 1), got {self.new}")
        if not isinstance(self.evidence, bool | np.bool_):
            raise InputError(f"evidence must be True or False, got {self.evidence!r}")

    def estimate(self, dataset: Dataset, progress: Progress | None = None) -> Estimate:
        """Run the particles over a dataset.

        Parameters
        ----------
        dataset : Dataset
        progress : callable, optional
            Called with (steps done, steps in all).

        Returns
        -------
        Estimate
            Poses are weighted means of the particles, before they are resampled, with their
            covariance: online, and smoothed from the ancestry of the last. Where identities are
            known, landmarks are those of all particles together; where not, those of the heaviest
            particle in the end, which is also whose history of decisions is told. Innovations are
            those of the particles together, one row of a step after another. A landmark of unknown
            identity is named after the observation that mapped it.

        Raises
        ------
        UnsupportedError
            For several robots, and sensors that do not determine a point.
        """
        known = self._known(dataset)
        self._check(dataset, known)
        self.warm_up(dataset)
        started = time.perf_counter()
        steps, (ids, sightings) = dataset.poses, _coded(dataset)
        work = _work(dataset, sightings, self.particles, steps, len(ids) if known else None)
        settings, random = self._settings(known), _Random(self.seed)
        _start(dataset, work.cloud, random)
        block = max(1, BLOCK // (3 * self.particles))
        if progress is not None:
            block = min(block, max(1, steps // 100))
        k = 0
        while k < steps:
            stop = min(k + block, steps)
            draws = random.draws(k, stop - k, self.particles, len(work.motion.cumulative))
            while (k := run(k, stop, draws, settings, *work)) < stop:
                room = 2 * work.maps.room + len(work.scratch.choice)
                work = work._replace(maps=work.maps.grown(room))
            if progress is not None:
                progress(k, steps)
        cloud, maps, paths, log = work.cloud, work.maps, work.paths, work.log
        joint, names = None, sightings.landmark
        if known:
            landmarks, joint = mixture(cloud, maps, ids)
        else:
            heaviest = int(np.argmax(cloud.weights))
            landmarks = map_of_one(maps, heaviest)
            line = particle_of_each_step(paths, int(cloud.nodes[heaviest]), steps)
            names = log.choice[np.arange(len(names)), line[dataset.observations.step]]
        past = smoothed(cloud, paths, steps)
        seen = innovations(log, names.astype(np.int64), ids if known else None)
        lost, since = log.degenerate
        return Estimate(
            estimator=self.name,
            dataset=dataset.name,
            association=ASSOCIATIONS[not known],
            online=Trajectory(log.poses, log.covariances),
            smoothed=past,
            landmarks=landmarks,
            joint_covariance=joint,
            innovations=seen,
            step_nis=log.nis,
            step_dof=log.dof,
            step_seconds=log.seconds,
            effective_samples=log.effective,
            time_total=time.perf_counter() - started,
            time_marginals=0.0,
            message=f"no particle explains steps: {lost}, the first is {since}" if lost else "",
            options=asdict(self),
        )

    def warm_up(self, dataset: Dataset) -> None:
        """Compile, or load from disk, what a dataset needs, so that no clock has to count it."""
        _, sightings = _coded(dataset)
        nothing = Sightings(*(column[:0].copy() for column in sightings))
        work = _work(dataset, nothing, 1, 1, 1)
        draws = _Random(0).draws(0, 1, 1, len(work.motion.cumulative))
        prepare(run, 0, 0, draws, self._settings(True), *work)
        means, covariances = work.log.poses, work.log.covariances
        prepare(look_back, work.paths, work.cloud.nodes, work.cloud.weights, means, covariances)
        prepare(square_root, covariances[0], covariances[0])
        prepare(turned, covariances[0], 0.0, covariances[0])

    def _known(self, dataset: Dataset) -> bool:
        """Whether identities are taken from the dataset."""
        if self.association is None:
            return dataset.association_known
        return self.association == "known"

    def _check(self, dataset: Dataset, known: bool) -> None:
        """Refuse what particles of one robot with maps of points cannot work with."""
        if len(dataset.robots) > 1:
            raise UnsupportedError(
                f"{self.name} is for a single robot, there are {len(dataset.robots)}"
            )
        names = {view.code: kind for kind, view in VIEWS.items()}
        partial = set(np.unique(dataset.sightings.kind).tolist()) - {RANGE_BEARING, XY}
        if partial:
            listed = " and ".join(names[kind] for kind in sorted(partial))
            raise UnsupportedError(
                f"{self.name} needs sensors that determine a point, not {listed} alone"
            )
        if not known and not np.isfinite(_logdets(dataset.sightings)).all():
            raise UnsupportedError(
                f"{self.name} needs measurement noise in all directions for association "
                "'maximum-likelihood'"
            )
        if self.particles * dataset.poses > MOST:
            raise UnsupportedError(
                f"{self.name} has room for {MOST // dataset.poses} particles on {dataset.name}"
            )

    def _settings(self, known: bool) -> Settings:
        return Settings(
            known=known,
            informed=self.informed,
            least=float(self.resample_below * self.particles),
            gate=chi2_gate(self.new, 2),
            evidence=bool(self.evidence and not known),
        )


@dataclass(frozen=True)
class Fastslam2(Fastslam1):
    """FastSLAM 2.0: particles are drawn from the motion and what is seen after it.

    Montemerlo et al. 2003. The options are those of `Fastslam1`.
    """

    name = "fastslam2"
    informed = True


class _Random:
    """Random numbers from a stream for each purpose: how they are cut into blocks is all one."""

    def __init__(self, seed: int) -> None:
        streams = np.random.SeedSequence(seed).spawn(4)
        self.start, self.normal, self.component, self.resampling = map(
            np.random.default_rng, streams
        )

    def draws(self, first: int, steps: int, particles: int, components: int) -> Draws:
        """What the next steps need."""
        several = particles if components > 1 else 0
        return Draws(
            first,
            self.normal.standard_normal((steps, particles, 3)),
            self.component.random((steps, several)),
            self.resampling.random(steps),
        )


class _Work(NamedTuple):
    """The arrays of a run, as `run` takes them."""

    motion: Motion
    offsets: np.ndarray
    sightings: Sightings
    logdets: Array
    place: np.ndarray
    cloud: Cloud
    maps: Maps
    paths: Paths
    log: Log
    scratch: Scratch


def _work(
    dataset: Dataset, sightings: Sightings, particles: int, steps: int, landmarks: int | None
) -> _Work:
    """What so many particles need for so many steps; landmarks None for identities not known."""
    most = int(np.diff(dataset.offsets).max(initial=0))
    weights, deltas, covariances = dataset.robot.components
    still = np.zeros((len(weights), 1, 3))  # the first pose is there without a motion
    return _Work(
        Motion(
            np.cumsum(weights),
            np.concatenate([still, deltas], axis=1),
            np.concatenate([np.zeros((len(weights), 1, 3, 3)), covariances], axis=1),
        ),
        dataset.offsets.copy(),
        sightings,
        _logdets(sightings),
        np.full(landmarks or 0, -1, dtype=np.int64),
        Cloud.of(np.zeros((particles, 3))),
        Maps.of(particles, LANDMARKS if landmarks is None else landmarks + most),
        Paths.of(particles, steps),
        Log.of(steps, len(sightings.values), particles if landmarks is None else 0),
        Scratch.of(particles, most),
    )


def _start(dataset: Dataset, cloud: Cloud, random: _Random) -> None:
    """Particles from the prior."""
    mean, body, root = dataset.prior.mean.copy(), np.zeros((3, 3)), np.zeros((3, 3))
    turned(dataset.prior.covariance.copy(), -mean[2], body)
    square_root(body, root)
    normals = random.start.standard_normal(cloud.poses.shape)
    cloud.poses[:] = mean + normals @ root.T @ heading_block(mean[2]).T
    cloud.poses[:, 2] = wrap(cloud.poses[:, 2])


def _coded(dataset: Dataset) -> tuple[np.ndarray, Sightings]:
    """Identities, and private columns in which a landmark is its place among them."""
    sightings = Sightings(*(column.copy() for column in dataset.sightings))
    ids, codes = np.unique(sightings.landmark, return_inverse=True)
    codes = np.maximum(codes - np.searchsorted(ids, 0), -1)  # no identity becomes -1
    return ids[ids >= 0], sightings._replace(landmark=codes.astype(np.int64))


def _logdets(sightings: Sightings) -> Array:
    """ln det R of each row, minus infinity where it is singular."""
    R = sightings.covariance
    determinant = R[:, 0, 0] * R[:, 1, 1] - R[:, 0, 1] * R[:, 1, 0]
    return np.log(determinant, out=np.full(len(R), -np.inf), where=determinant > 0)
