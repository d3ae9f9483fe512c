"""The EKF-SLAM estimator: `Ekf` over a dataset, `EkfSlam` step by step with the same numbers."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np

from ekfslam.association.gates import Gates, chi2_gate
from ekfslam.checks import check_finite, checked_array, checked_covariance
from ekfslam.dataset import Dataset, Prior, Sightings
from ekfslam.errors import InputError
from ekfslam.estimates import (
    DIVERGED,
    OK,
    Estimate,
    Innovations,
    LandmarkEstimates,
    Linearizations,
    Trajectory,
)
from ekfslam.filters.ekf_slam import (
    ACCEPTED,
    NEW,
    REJECTED,
    Log,
    Register,
    Settings,
    observe,
    predict,
    run,
)
from ekfslam.filters.gaussian_map import POINT, POSE, GaussianMap
from ekfslam.geometry import Array, compose, compose_jacobians, congruence, heading_block
from ekfslam.registry import Progress

ASSOCIATIONS = ("known", "nearest")
UPDATES = ("joint", "sequential")


@dataclass(frozen=True)
class Ekf:
    """The EKF-SLAM estimator.

    Parameters
    ----------
    association : {"known", "nearest"}, optional
        Identities from the dataset, or gated nearest neighbour in innovation distance. By default
        "known" where every observation has its identity, else "nearest".
    update : {"joint", "sequential"}
        All that a sensor saw at one instant in one correction, linearised at the predicted state
        (the default), or one after another as the texts do, each at the state that the one before
        left. The matches of a look are made at the predicted pose either way.
    accept, new : float
        Gates of the nearest neighbour as probabilities, see `ekfslam.association.gates.Gates`.
    """

    association: str | None = None
    update: str = "joint"
    accept: float = Gates.accept
    new: float = Gates.new
    name = "ekf"

    def __post_init__(self) -> None:
        _settings(self.association or "known", self.update, self.accept, self.new)

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
            With the online trajectory, landmarks, joint covariance, innovations and times.

        Raises
        ------
        UnsupportedError
            For a dataset with several robots.
        """
        return self._run(dataset, progress)[0]

    def warm_up(self) -> None:
        """Compile, or load from disk, so that no clock has to count it."""
        _warm_up()

    def linearizations(self, dataset: Dataset) -> tuple[Estimate, Linearizations]:
        """Estimate a dataset and tell every linearisation that was used.

        This is what the linear oracle of `ekfslam check` needs of a filter.
        """
        estimate, log = self._run(dataset, None)
        assert estimate.landmarks is not None
        assert estimate.innovations is not None
        moves = dataset.moves
        before = np.concatenate([dataset.prior.mean[None], log.poses[:-1]])
        used = np.flatnonzero(np.isin(log.decision, [ACCEPTED, NEW]))
        new = log.decision[used] == NEW
        noise = np.where(
            new[:, None, None], log.H[used][:, :, 3:], dataset.sightings.covariance[used]
        )
        return estimate, Linearizations(
            motion_from=before,
            motion_to=compose(before, moves.deltas),
            motion_jacobian=compose_jacobians(before, moves.deltas)[0],
            motion_noise=congruence(heading_block(before[:, 2]), moves.covariances),
            row=used,
            step=dataset.observations.step[used],
            landmark=estimate.innovations.landmark[used],
            new=new,
            point=log.point[used],
            jacobian=log.H[used],
            innovation=np.where(new[:, None], 0.0, log.innovation[used]),
            noise=noise,
        )

    def _run(self, dataset: Dataset, progress: Progress | None) -> tuple[Estimate, Log]:
        association = self.association or ("known" if dataset.association_known else "nearest")
        settings = _settings(association, self.update, self.accept, self.new)
        steps = dataset.poses
        _warm_up()
        started = time.perf_counter()
        deltas, covariances = (array.copy() for array in dataset.moves)
        offsets, sightings = (
            dataset.offsets.copy(),
            Sightings(*(c.copy() for c in dataset.sightings)),
        )
        ids, codes = np.unique(sightings.landmark, return_inverse=True)
        codes = codes - np.searchsorted(ids, 0)  # no identity becomes -1
        ids = ids[ids >= 0]
        sightings = sightings._replace(landmark=codes.astype(np.int64))
        slam = GaussianMap(dataset.prior, 32 if settings.nearest else len(ids))
        register = _register(len(slam.arrays.mean) if settings.nearest else len(ids))
        log = _log(steps, len(codes))
        k, why = 0, 0
        chunk = steps if progress is None else max(1, steps // 100)
        while k < steps and why != 2:
            k, why = run(
                k,
                min(k + chunk, steps),
                deltas,
                covariances,
                offsets,
                sightings,
                slam.arrays,
                register,
                settings,
                log,
            )
            if why == 1:
                slam.reserve(slam.size + POINT * int(np.diff(offsets).max()))
                register = _grown(register, len(slam.arrays.mean))
            elif progress is not None:
                progress(k, steps)
        if settings.nearest:
            ids = np.arange(register.used[0])
        mapped = np.flatnonzero(register.offsets[: len(ids)] >= 0)
        landmarks, joint = _final_map(slam, ids[mapped], register.offsets[mapped])
        elapsed = time.perf_counter() - started
        named = np.append(ids, -1)[log.landmark]
        return Estimate(
            estimator=self.name,
            dataset=dataset.name,
            association=association,
            online=Trajectory(log.poses, log.covariances),
            landmarks=landmarks,
            joint_covariance=joint,
            innovations=Innovations(log.decision, named, log.innovation, log.S),
            step_nis=log.nis,
            step_dof=log.dof,
            step_seconds=log.seconds,
            time_total=elapsed,
            time_marginals=0.0,
            status=DIVERGED if why == 2 else OK,
            message=f"innovation covariance not positive definite at step {k}" if why == 2 else "",
            options=asdict(self),
        ), log


class EkfSlam:
    """The same filter, step by step, for online use.

    Parameters
    ----------
    prior : Prior
        Of the first pose; the default is exactly the origin.
    association : {"known", "nearest"}
        "nearest" where observations come without identities.
    update : {"joint", "sequential"}
    accept, new : float
        As for `Ekf`.

    Examples
    --------
    >>> import ekfslam
    >>> data = ekfslam.simulate("loop-15", seed=1)
    >>> slam = ekfslam.EkfSlam(prior=data.prior)
    >>> for step in data.steps():
    ...     slam.predict(step.increment, step.covariance)
    ...     _ = slam.observe(step.observations)
    """

    def __init__(
        self,
        prior: Prior | None = None,
        association: str = "known",
        update: str = "joint",
        accept: float = Gates.accept,
        new: float = Gates.new,
    ) -> None:
        if prior is not None and not isinstance(prior, Prior):
            raise InputError(f"prior must be a Prior(mean, covariance), got {prior!r}")
        self._settings = _settings(association, update, accept, new)
        self._slam = GaussianMap(prior or Prior())
        self._register = _register(len(self._slam.arrays.mean))
        self._ids: dict[int, int] = {}

    def predict(self, increment: Any, covariance: Any) -> None:
        """Move the robot.

        Parameters
        ----------
        increment : (3,) array_like
            Body increment in the frame of the pose before [m, m, rad].
        covariance : (3, 3) array_like
            Of the increment, in that frame.

        Raises
        ------
        InputError
            For values that are not finite, or no covariance.
        """
        delta = checked_array(increment, float, (3,), "increment")
        check_finite(delta, "increment")
        Q = checked_covariance(covariance, 3, "covariance of the increment")
        predict(self._slam.arrays, delta, Q)

    def observe(self, observations: Sightings) -> Innovations:
        """Associate, correct and extend with the observations of one step.

        Parameters
        ----------
        observations : Sightings
            For instance ``Sightings.of(sensor, values, landmark)``.

        Returns
        -------
        Innovations
            What each observation met.

        Raises
        ------
        InputError
            If a column makes no sense, or the innovation covariance is not positive definite; what
            was seen before that look has then been used.
        """
        if not isinstance(observations, Sightings):
            raise InputError("observations must be Sightings, such as Sightings.of(sensor, values)")
        seen = observations.checked()
        count = len(seen.values)
        self._slam.reserve(self._slam.size + POINT * count)
        indices = max(len(self._ids), int(self._register.used[0])) + count
        self._register = _grown(self._register, max(len(self._slam.arrays.mean), indices))
        codes = [
            self._ids.setdefault(int(i), len(self._ids)) if i >= 0 else -1
            for i in seen.landmark.tolist()
        ]
        seen = seen._replace(landmark=np.array(codes, dtype=np.int64))
        log = _log(1, count)
        nis, _ = observe(self._slam.arrays, self._register, seen, 0, count, self._settings, log)
        if np.isnan(nis):
            raise InputError("the innovation covariance is not positive definite; check the noise")
        return Innovations(log.decision, self._names()[log.landmark], log.innovation, log.S)

    @property
    def pose(self) -> Array:
        """Estimated pose, (3,)."""
        return self._slam.mean[:POSE].copy()

    @property
    def pose_covariance(self) -> Array:
        """Its covariance, (3, 3), additive."""
        return self._slam.block(0, POSE)

    @property
    def landmarks(self) -> LandmarkEstimates:
        """The map so far, with its joint covariance."""
        ids = self._names()[:-1]
        mapped = np.flatnonzero(self._register.offsets[: len(ids)] >= 0)
        return _final_map(self._slam, ids[mapped], self._register.offsets[mapped])[0]

    def _names(self) -> np.ndarray:
        """Identity of each index of the register; the last entry is that of no landmark."""
        if self._settings.nearest:
            return np.append(np.arange(self._register.used[0]), -1)
        return np.array([*self._ids, -1], dtype=np.int64)


# Plumbing ---------------------------------------------------------------------------------------


def _settings(association: str, update: str, accept: float, new: float) -> Settings:
    for name, value, known in (
        ("association", association, ASSOCIATIONS),
        ("update", update, UPDATES),
    ):
        if value not in known:
            raise InputError(f"{name} must be one of {', '.join(known)}, got {value!r}")
    Gates(accept, new)
    return Settings(
        association == "nearest", update == "joint", chi2_gate(accept, 2), chi2_gate(new, 2)
    )


def _register(size: int) -> Register:
    return Register(np.full(size, -1, dtype=np.int64), np.zeros(1, dtype=np.int64))


def _grown(register: Register, size: int) -> Register:
    missing = size - len(register.offsets)
    if missing <= 0:
        return register
    return register._replace(offsets=np.append(register.offsets, np.full(missing, -1)))


def _log(steps: int, rows: int) -> Log:
    return Log(
        poses=np.full((steps, 3), np.nan),
        covariances=np.full((steps, 3, 3), np.nan),
        nis=np.full(steps, np.nan),
        dof=np.zeros(steps, dtype=np.int64),
        seconds=np.full(steps, np.nan),
        decision=np.full(rows, REJECTED, dtype=np.int64),
        landmark=np.full(rows, -1, dtype=np.int64),
        innovation=np.full((rows, 2), np.nan),
        S=np.full((rows, 2, 2), np.nan),
        H=np.full((rows, 2, 5), np.nan),
        point=np.full((rows, 5), np.nan),
    )


def _final_map(
    slam: GaussianMap, ids: np.ndarray, offsets: np.ndarray
) -> tuple[LandmarkEstimates, Array]:
    """The landmarks with covariances, and the joint covariance of pose and landmarks."""
    points = (offsets[:, None] + np.arange(POINT)).reshape(-1)
    order = np.concatenate([np.arange(POSE), points])
    joint = slam.covariance[np.ix_(order, order)]
    blocks = joint[POSE:, POSE:].reshape(len(ids), POINT, len(ids), POINT)
    return LandmarkEstimates(
        ids,
        slam.mean[points].reshape(-1, POINT),
        np.ascontiguousarray(np.einsum("iaib->iab", blocks)),
        joint[POSE:, POSE:],
    ), joint


@cache
def _warm_up() -> None:
    """Compile, or load from disk, before the clock of the first estimate starts."""
    slam = GaussianMap(Prior(), 1)
    none = np.zeros(0, np.int64)
    nothing = Sightings(none, np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2, 2)), none, none)
    settings = _settings("known", "joint", Gates.accept, Gates.new)
    still, offsets = (np.zeros((1, 3)), np.zeros((1, 3, 3))), np.zeros(2, np.int64)
    run(0, 1, *still, offsets, nothing, slam.arrays, _register(1), settings, _log(1, 0))
