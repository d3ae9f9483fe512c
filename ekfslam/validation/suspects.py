"""A small dense EKF that can make the classic mistakes, one by one or several at once.

With no mistake it is the filter of the texts (Solà, section 2.3). It is slow and meant for runs of
a few poses: what a filter under test says of these is compared with what this one says with this or
that mistake. What each means is in `ekfslam.validation.catalogue`.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Estimate
from ekfslam.geometry import Array
from ekfslam.models.sensors import Sensor


class Answer(NamedTuple):
    """What a filter says of a run; None for what it does not tell.

    Attributes
    ----------
    poses : (K + 1, 3) ndarray
        Online.
    covariances : (K + 1, 3, 3) ndarray or None
    ids : (L,) ndarray of int
        Increasing.
    positions : (L, 2) ndarray
    marginals : (L, 2, 2) ndarray or None
    joint : (3 + 2 L, 3 + 2 L) ndarray or None
        Of the final pose and the landmarks in the order of `ids`.
    """

    poses: Array
    covariances: Array | None
    ids: np.ndarray
    positions: Array
    marginals: Array | None
    joint: Array | None

    @classmethod
    def of(cls, estimate: Estimate) -> Answer:
        """The parts of an estimate.

        Raises
        ------
        UnsupportedError
            If there is no online series of one robot.
        """
        online, mapped = estimate.online, estimate.landmarks
        if online is None or online.poses.ndim != 2:
            raise UnsupportedError("needs an online series of one robot")
        nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
        ids, positions = (mapped.ids, mapped.positions) if mapped else nothing
        order = np.argsort(ids)
        rows = np.concatenate([np.arange(3), (3 + 2 * order[:, None] + np.arange(2)).reshape(-1)])
        marginals = mapped.covariances if mapped else None
        joint = estimate.joint_covariance
        if joint is not None and len(joint) != len(rows):
            joint = None
        return cls(
            online.poses,
            _told(online.covariances),
            ids[order],
            positions[order],
            None if marginals is None else _told(marginals[order]),
            None if joint is None else _told(joint[np.ix_(rows, rows)]),
        )

    def without_map(self) -> Answer:
        """What it says of the poses."""
        nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
        return Answer(self.poses, self.covariances, *nothing, None, None)


def _told(covariance: Array | None) -> Array | None:
    """Covariances, unless they are NaN: not computed."""
    return None if covariance is None or np.isnan(covariance).any() else covariance


class Look(NamedTuple):
    """The last correction of a run: what was expected, and how uncertain the innovation was."""

    expected: Array
    S: Array


def run(dataset: Dataset, wrong: Mapping[str, Any]) -> tuple[Answer, Look | None]:
    """Filter a dataset of one robot, full views and known identities.

    Parameters
    ----------
    dataset : Dataset
    wrong : mapping of str
        Mistakes, and the factors or matrices of those that have one.
    """
    suspect = _Suspect(dataset, wrong)
    poses, covariances = [], []
    for k, step in enumerate(dataset.steps()):
        suspect.predict(step.increment, step.covariance)
        rows = range(dataset.offsets[k], dataset.offsets[k + 1])
        for _, look in groupby(rows, dataset.sightings.look.item):
            suspect.observe(list(look))
        poses.append(suspect.x[:3].copy())
        covariances.append(suspect.P[:3, :3].copy())
    ids = np.array(sorted(suspect.place), dtype=np.int64)
    at = np.array([suspect.place[i] for i in ids.tolist()], dtype=np.int64).reshape(-1, 1)
    at = at + np.arange(2)
    whole, P = np.concatenate([np.arange(3), at.reshape(-1)]), suspect.P
    answer = Answer(
        np.array(poses),
        np.array(covariances),
        ids,
        suspect.x[at],
        P[at[:, :, None], at[:, None, :]],
        P[np.ix_(whole, whole)],
    )
    return answer, suspect.last


class _Suspect:
    """State of a run; `place` says where in it each landmark is."""

    def __init__(self, dataset: Dataset, wrong: Mapping[str, Any]) -> None:
        self.dataset, self.wrong = dataset, wrong
        self.x, self.P = dataset.prior.mean.copy(), dataset.prior.covariance.copy()
        self.place: dict[int, int] = {}
        self.last: Look | None = None

    # Motion (Solà, Eqs. 14 to 17) -------------------------------------------------------------

    def predict(self, increment: Array, Q: Array) -> None:
        wrong, before = self.wrong, self.x[2]
        forward, turn = increment[:2], float(increment[2])
        if "turn-in-degrees" in wrong:
            turn = np.deg2rad(turn)
        if "turn-clockwise" in wrong:
            turn = -turn
        heading = before
        if "turn-first" in wrong:
            heading = before + turn
        if "rotated-back" in wrong:
            heading = -before
        if "increment-in-world" in wrong:
            heading = 0.0
        self.x[:2] += geo.rotation(heading) @ forward
        self.x[2] = before + turn
        self._wrap_heading()
        F = self._motion_jacobian(forward, before, turn)
        noise = self._motion_noise(Q, before, turn)
        cross = self.P[:3, 3:] if "map-left-behind" in wrong else F @ self.P[:3, 3:]
        self.P[:3, :3] = F @ self.P[:3, :3] @ F.T + noise
        self.P[:3, 3:], self.P[3:, :3] = cross, cross.T

    def _wrap_heading(self) -> None:
        if "heading-unwrapped" not in self.wrong:
            self.x[2] = geo.wrap(self.x[2])

    def _motion_jacobian(self, forward: Array, before: float, turn: float) -> Array:
        wrong, F = self.wrong, np.eye(3)
        heading = before + turn if "jacobian-after" in wrong else before
        F[:2, 2] = geo.perpendicular(geo.rotation(heading) @ forward)
        if "motion-jacobian-sign" in wrong:
            F[:2, 2] *= -1
        c, s = np.cos(heading), np.sin(heading)
        for k, term in enumerate(np.array([-s, -c, c, -s]) * np.tile(forward, 2)):
            if f"motion-jacobian-term-{k}" in wrong:
                F[k // 2, 2] -= 2.0 * term
        if "motion-jacobian-identity" in wrong:
            F[:2, 2] = 0.0
        if "motion-jacobian-swapped" in wrong:
            F[:2, 2] = F[1::-1, 2]
        return F.T if "motion-jacobian-transposed" in wrong else F

    def _motion_noise(self, Q: Array, before: float, turn: float) -> Array:
        wrong = self.wrong
        Q = _mistaken(Q, wrong, "q")
        if "q-not-rotated" in wrong:
            return Q
        heading = before
        if "q-rotated-back" in wrong:
            heading = -before
        if "q-rotated-after" in wrong:
            heading = before + turn
        V = geo.heading_block(heading)
        return V @ Q @ V.T

    # What is seen -----------------------------------------------------------------------------

    def observe(self, rows: list[int]) -> None:
        """A look: corrections first, jointly, and then the new landmarks, unless it is told so."""
        seen, wrong = self.dataset.observations.landmark, self.wrong
        if "first-only" in wrong:
            rows = rows[:1]
        known = [i for i in rows if int(seen[i]) in self.place]
        if "in-order" in wrong or "stale" in wrong:
            before = self.x.copy()
            for i in rows:
                if i in known:
                    self.correct([i], before if "stale" in wrong else self.x)
                else:
                    self.extend(i)
            return
        for batch in [[i] for i in known] if "sequential" in wrong else [known] if known else []:
            self.correct(batch, self.x)
        for i in rows:
            if i not in known:
                self.extend(i)

    def _sensor(self, i: int) -> Sensor:
        return self.dataset.sensors[self.dataset.observations.sensor[i]]

    def _mount(self, i: int) -> Array:
        mount = self._sensor(i).mount.copy()
        if "no-mount" in self.wrong or "mount-not-turned" in self.wrong:
            mount[2] = 0.0
        if "no-mount" in self.wrong or "mount-not-shifted" in self.wrong:
            mount[:2] = 0.0
        return mount

    def _lever(self, mount: Array) -> Array:
        """Derivative of the sensor's pose with respect to the robot's."""
        if "no-lever" in self.wrong:
            return np.eye(3)
        return geo.compose_jacobians(self.x[:3], mount)[0]

    # Correction (Solà, Eqs. 26 to 30) ---------------------------------------------------------

    def _model(self, i: int, x: Array) -> tuple[Array, Array, Array]:
        """Expected value, innovation and dense Jacobian of a sighting, at a state x."""
        wrong, view = self.wrong, self._sensor(i).view
        at = self.place[int(self.dataset.observations.landmark[i])]
        if at >= len(x):
            x = self.x
        mount = self._mount(i)
        frame = geo.compose(x[:3], mount)
        local = geo.to_frame(frame, x[at : at + 2])
        expected = view.project(local)
        if "expected-unwrapped" in wrong and view.angular[1]:
            apart = x[at : at + 2] - frame[:2]
            expected[1] = np.arctan2(apart[1], apart[0]) - x[2] - mount[2]
        if "expected-without-heading" in wrong and view.angular[1]:
            expected[1] = geo.wrap(expected[1] + frame[2])
        of_robot, of_point = geo.to_frame_jacobians(frame, x[at : at + 2])
        of_robot, of_point = (view.project_jacobian(local) @ J for J in (of_robot, of_point))
        lever = self._lever(mount)
        if "mount-last" in wrong:
            of_robot = of_robot @ lever
        if wrong.keys() & {"h-transposed", "h-robot-transposed"}:
            of_robot[:, :2] = of_robot[:, :2].T.copy()
        if wrong.keys() & {"h-transposed", "h-landmark-transposed"}:
            of_point = of_point.T
        if "h-heading-missing" in wrong:
            of_robot[:, 2] = 0.0
        if "h-heading-sign" in wrong:
            of_robot[:, 2] *= -1
        if "h-landmark-sign" in wrong:
            of_point = -of_point
        if "h-robot-sign" in wrong:
            of_robot[:, :2] *= -1
        if "h-root-of-q" in wrong and view.angular[1]:
            of_robot[1, : 3 if "whole-row" in wrong else 2] *= expected[0]
            of_point = of_point * np.array([[1.0], [expected[0]]])
        if "mount-last" not in wrong:
            of_robot = of_robot @ lever
        H = np.zeros((2, len(self.x)))
        H[:, :3], H[:, at : at + 2] = of_robot, of_point
        return expected, self._innovation(self._value(i), expected, view.angular), H

    def _value(self, i: int) -> Array:
        value = self.dataset.observations.values[i].copy()
        if self._sensor(i).view.angular[1]:
            if "bearing-in-degrees" in self.wrong:
                value[1] = np.deg2rad(value[1])
            if "bearing-clockwise" in self.wrong:
                value[1] = -value[1]
        return value

    def _innovation(self, value: Array, expected: Array, angular: tuple[bool, ...]) -> Array:
        wrong, nu = self.wrong, value - expected
        if angular[1] and "no-wrap" not in wrong:
            nu[1] = nu[1] % geo.TAU if "wrapped-to-positive" in wrong else geo.wrap(nu[1])
        return -nu if "innovation-sign" in wrong else nu

    def correct(self, rows: list[int], x: Array) -> None:
        """Correct with some sightings at once, linearised at a state x."""
        wrong, n = self.wrong, len(self.x)
        models = [self._model(i, x) for i in rows]
        H = np.concatenate([model[2] for model in models])
        nu = np.concatenate([model[1] for model in models])
        S = H @ self.P @ H.T
        for j, i in enumerate(rows):
            R = _mistaken(_mistaken(self.dataset.sightings.covariance[i], wrong, "r"), wrong, "s")
            S[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] += R
        self.last = Look(models[-1][0], S[-2:, -2:])
        if nu @ np.linalg.solve(S, nu) > wrong.get("gate", np.inf):
            return
        K = self.P @ H.T @ np.linalg.inv(S)
        step, P = K @ nu, self.P - K @ S @ K.T
        if "covariance-grows" in wrong:
            P = self.P + K @ S @ K.T
        if "blocks-only" in wrong:
            own = np.where(np.arange(n) < 3, 0, (np.arange(n) - 1) // 2)
            P = np.where(own[:, None] == own, P, self.P)
        frozen, whole = self._frozen(rows), np.ones(n, dtype=bool)
        if "frozen-gain" in wrong:  # its rows are zero
            K[frozen] = 0.0
            P = (np.eye(n) - K @ H) @ self.P
            P = (P + P.T) / 2
        elif frozen.any() and "frozen-mean" not in wrong:
            kept = np.outer(~frozen, whole) & np.outer(whole, ~frozen)
            P = np.where(kept, P, self.P)
        step[frozen] = 0.0
        if "mean-kept" not in wrong:
            self.x = self.x + step
            self._wrap_heading()
        if "covariance-kept" not in wrong:
            self.P = P

    def _frozen(self, rows: list[int]) -> Any:
        """Coordinates that a correction leaves as they are."""
        frozen = np.zeros(len(self.x), dtype=bool)
        if "robot-only" in self.wrong:
            frozen[3:] = True
        if "map-only" in self.wrong:
            frozen[:3] = True
        if "seen-only" in self.wrong:
            frozen[3:] = True
            for i in rows:
                at = self.place[int(self.dataset.observations.landmark[i])]
                frozen[at : at + 2] = False
        return frozen

    # A new landmark (Solà, Eqs. 35 to 38) -----------------------------------------------------

    def extend(self, i: int) -> None:
        wrong, n, view = self.wrong, len(self.x), self._sensor(i).view
        assert view.back_project is not None
        assert view.back_project_jacobian is not None
        mount, value = self._mount(i), self._value(i)
        frame = geo.compose(self.x[:3], mount)
        if "new-without-heading" in wrong:
            frame[2] = mount[2]
        local = view.back_project(value)
        wrt_frame, wrt_local = geo.from_frame_jacobians(frame, local)
        if "new-heading-missing" in wrong:
            wrt_frame[:, 2] = 0.0
        if "new-heading-sign" in wrong:
            wrt_frame[:, 2] *= -1
        G = wrt_frame @ self._lever(mount)
        V = wrt_local @ view.back_project_jacobian(value)
        if "new-noise-not-turned" in wrong:
            V = np.eye(2)
        R = _mistaken(_mistaken(self.dataset.sightings.covariance[i], wrong, "r"), wrong, "new")
        own = V @ R @ V.T
        if "certain-pose" not in wrong:
            own = own + G @ self.P[:3, :3] @ G.T
        cross = G @ self.P[:3]
        if "cross-with-pose-only" in wrong:
            cross[:, 3:] = 0.0
        if "cross-with-map-only" in wrong:
            cross[:, :3] = 0.0
        if "new-fixed" in wrong:
            own = wrong["new-fixed"] * np.eye(2)
        if wrong.keys() & {"no-cross-covariance", "new-fixed"}:
            cross[:] = 0.0
        self.x = np.concatenate([self.x, geo.from_frame(frame, local)])
        self.P = np.block([[self.P, cross.T], [cross, own]])
        self.place[int(self.dataset.observations.landmark[i])] = n


def _mistaken(noise: Array, wrong: Mapping[str, Any], which: str) -> Array:
    """A noise covariance as it is misread: of the motion (q), everywhere (r), in S, of the new."""
    if f"{which}-own" in wrong and noise.any():
        return np.asarray(wrong[f"{which}-own"])
    if f"{which}-always" in wrong:
        return np.asarray(wrong[f"{which}-always"])
    if f"{which}-forgotten" in wrong:
        return np.zeros_like(noise)
    if f"{which}-root" in wrong:
        return np.diag(np.sqrt(np.diag(noise)))
    if f"{which}-squared" in wrong:
        return np.diag(np.diag(noise) ** 2)
    if f"{which}-squared-whole" in wrong:
        return noise**2
    if f"{which}-diagonal" in wrong:
        return np.diag(np.diag(noise))
    if f"{which}-swapped" in wrong:
        return noise[::-1, ::-1]
    return noise * wrong.get(f"{which}-scaled", 1.0)
