"""EKF-SLAM step by step, with the same numbers as over a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ekfslam.checks import check_finite, checked_array, checked_covariance
from ekfslam.dataset import Prior, Sightings
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.estimates import Decision, Innovations, LandmarkEstimates
from ekfslam.filters.arrays import Log
from ekfslam.filters.compressed import EkfCompressed
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.family import EkfFej, EkfRi, EkfRobocentric, Iekf
from ekfslam.filters.suitability import check_views
from ekfslam.geometry import Array
from ekfslam.models.sensors import VIEWS, Sensor

ONLINE = {each.name: each for each in (Ekf, Iekf, EkfFej, EkfRi, EkfRobocentric, EkfCompressed)}


class EkfSlam:
    """The filter of `ekfslam.filters.ekf.Ekf`, step by step, for online use.

    Parameters
    ----------
    prior : Prior or sequence of Prior
        Of the first pose, of each robot if there are several; the default is exactly the origin.
    association : str
        "known", or a method for observations that come without identities.
    estimator : str
        Another filter of the family, such as "ekf-ri". Not "ekf-ideal", which needs the truth, nor
        "ekf-oc", which must know at a motion what will be seen after it.
    **options
        As for `ekfslam.filters.options.Options`.

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
        prior: Prior | Sequence[Prior] | None = None,
        association: str = "known",
        estimator: str = "ekf",
        **options: Any,
    ) -> None:
        priors = [prior or Prior()] if prior is None or isinstance(prior, Prior) else list(prior)
        if not priors or not all(isinstance(each, Prior) for each in priors):
            raise InputError(f"prior must be a Prior(mean, covariance), got {prior!r}")
        if estimator not in ONLINE:
            raise UnknownNameError("filter that runs step by step", estimator, ONLINE)
        try:
            self._options = ONLINE[estimator](association or "known", **options)
        except TypeError as error:
            raise InputError(f"EkfSlam: {error}") from None
        kinds = {view.code for view in VIEWS.values() if view.size == 2 or estimator == "ekf"}
        self._unseen = Sightings.of(Sensor("xy", np.eye(2)), np.zeros((0, 2)))
        known = self._options.association or "known"
        self._engine = self._options.engine(priors, self._options, known, kinds)
        self._ids: dict[int, int] = {}
        self._step = -1
        self._nis = float("nan")

    def predict(self, increment: Any, covariance: Any) -> None:
        """Move the robot, or all of them.

        Parameters
        ----------
        increment : (3,) or (R, 3) array_like
            Body increment in the frame of the pose before [m, m, rad]; one row for each robot if
            there are several.
        covariance : (3, 3) or (R, 3, 3) array_like
            Of the increment, in that frame.

        Raises
        ------
        InputError
            For values that are not finite, or no covariance.
        """
        robots = self._engine.settings.robots
        shape: tuple[int, ...] = (3,) if robots == 1 else (robots, 3)
        delta = checked_array(increment, float, shape, "increment")
        check_finite(delta, "increment")
        given = checked_array(covariance, float, (*shape, 3), "covariance of the increment")
        Q = [
            checked_covariance(each, 3, "covariance of the increment")
            for each in given.reshape(-1, 3, 3)
        ]
        self._step += 1
        self._engine.predict(self._step, delta.reshape(-1, 3).copy(), np.array(Q), self._unseen)

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
        UnsupportedError
            For views that the options cannot work with.
        """
        if not isinstance(observations, Sightings):
            raise InputError("observations must be Sightings, such as Sightings.of(sensor, values)")
        seen = observations.checked()
        robots = self._engine.settings.robots
        if (seen.robot >= robots).any() or (seen.target >= robots).any():
            raise InputError(f"observations name a robot that there is not: there are {robots}")
        check_views(self._options, self._engine.association, seen)
        count = len(seen.values)
        codes = [
            self._ids.setdefault(int(i), len(self._ids)) if i >= 0 else -1
            for i in seen.landmark.tolist()
        ]
        self._engine.make_room(count, len(self._ids))
        seen = seen._replace(landmark=np.array(codes, dtype=np.int64))
        log = Log.of(1, 1, count, int(Decision.REJECTED))
        done = self._engine.observe(seen, log)
        self._nis = float(log.nis[0]) if log.dof[0] > 0 else float("nan")
        if not done:
            raise InputError("the innovation covariance is not positive definite; check the noise")
        names = np.append(self._names(), -1)
        return Innovations(log.decision, names[log.landmark], log.innovation, log.S)

    def delete(self, landmark: int) -> None:
        """Take a landmark out of the map (Solà, Table 1); seen again, it starts anew.

        Parameters
        ----------
        landmark : int
            Its identity, as `landmarks` lists it.

        Raises
        ------
        InputError
            If there is no such landmark.
        """
        self._engine.delete(self._index(landmark))

    def _index(self, landmark: int) -> int:
        """Register index of a landmark that is in the map."""
        index = np.flatnonzero(self._names() == landmark)
        if not len(index) or not self._engine.knows(int(index[0])):
            raise InputError(f"there is no landmark {landmark} in the map")
        return int(index[0])

    def landmark(self, landmark: int) -> tuple[Array, Array]:
        """One landmark as it is now, at the cost of itself alone; `landmarks` is all of them.

        Parameters
        ----------
        landmark : int
            Its identity, as `landmarks` lists it.

        Returns
        -------
        (2,) ndarray, (2, 2) ndarray
            Position [m] and covariance [m^2], in the world.

        Raises
        ------
        InputError
            If there is no such landmark, or its distance is still open.
        """
        index = self._index(landmark)
        if not self._engine.is_point(index):
            raise InputError(f"landmark {landmark} is not a point yet: its distance is open")
        return self._engine.landmark(index)

    @property
    def association(self) -> str:
        """The method: "known", or how identities are found."""
        return self._engine.association

    @property
    def nis(self) -> float:
        """Joint squared Mahalanobis norm of what was observed last, NaN if nothing corrected."""
        return self._nis

    @property
    def pose(self) -> Array:
        """Estimated pose (3,), or poses (R, 3) of several robots."""
        poses = self._engine.poses[0]
        return poses[0] if len(poses) == 1 else poses

    @property
    def pose_covariance(self) -> Array:
        """Its covariance, additive: (3, 3), or jointly of all robots (3 R, 3 R)."""
        return self._engine.poses[1]

    @property
    def landmarks(self) -> LandmarkEstimates:
        """The map so far, with its joint covariance."""
        return self._engine.landmarks(self._names())[0]

    def _names(self) -> np.ndarray:
        """Identity of each index of the register."""
        if self._engine.association != "known":
            return np.arange(int(self._engine.register.used[0]))
        return np.array(list(self._ids), dtype=np.int64)
