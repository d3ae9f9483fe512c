"""EKF-SLAM as the texts write it, in plain dense NumPy: an oracle, and a carrier of mistakes.

Solà's equations with full matrices: H has a column for every coordinate of the state, and the
correction is ``P - K S K'``. It shares the sensor models with the package, and no line with its
filters. `MISTAKES` are what a validation must find; each has an estimator by name, so that
``textbook:NoWrapEkf`` can be checked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from ekfslam.dataset import Dataset, LandmarkMap, Observations, Prior
from ekfslam.estimates import (
    Decision,
    Estimate,
    Innovations,
    LandmarkEstimates,
    Linearizations,
    Trajectory,
)
from ekfslam.geometry import wrap
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import Scenario

MISTAKES = (
    "transposed-jacobian",  # the position block of H with respect to the robot
    "no-cross-covariance",  # a new landmark that knows nothing of the robot
    "no-wrap",  # innovations of bearings as they come
    "sqrt-q",  # 1 / sqrt(q) for 1 / q in the row of the bearing
    "wrong-noise",  # four times the variance of the measurements
)


@dataclass(frozen=True)
class TextbookEkf:
    """EKF-SLAM with known association.

    Parameters
    ----------
    mistake : str, optional
        One of `MISTAKES`.
    update : {"joint", "sequential"}
    """

    mistake: str | None = None
    update: str = "joint"
    name = "textbook-ekf"

    def __post_init__(self) -> None:
        assert self.mistake in (None, *MISTAKES)
        assert self.update in ("joint", "sequential")

    def estimate(self, dataset: Dataset) -> Estimate:
        return self.linearizations(dataset)[0]

    def linearizations(self, dataset: Dataset) -> tuple[Estimate, Linearizations]:
        run = _Run(dataset, self.mistake, self.update == "joint")
        for k, step in enumerate(dataset.steps()):
            run.predict(step.increment, step.covariance)
            rows = range(dataset.offsets[k], dataset.offsets[k + 1])
            for _, look in groupby(rows, dataset.sightings.look.item):
                run.observe(list(look))
            run.poses.append(run.x[:3].copy())
            run.covariances.append(run.P[:3, :3].copy())
        return run.estimate(self.name), run.linearizations()


class _Run:
    """State and records of one run; `offset` says where each landmark stands in the state."""

    def __init__(self, dataset: Dataset, mistake: str | None, joint: bool) -> None:
        self.dataset, self.mistake, self.joint = dataset, mistake, joint
        self.x, self.P = dataset.prior.mean.copy(), dataset.prior.covariance.copy()
        self.landmark = dataset.observations.landmark.tolist()
        self.offset: dict[int, int] = {}
        self.poses: list[Any] = []
        self.covariances: list[Any] = []
        self.motions: list[Any] = []
        self.sightings: list[Any] = []

    def predict(self, delta: Any, Q: Any) -> None:
        """Robot motion (Solà, Eqs. 14 to 17)."""
        before = self.x[:3].copy()
        c, s = np.cos(before[2]), np.sin(before[2])
        F_n = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        self.x[:3] += F_n @ delta
        self.x[2] = wrap(self.x[2])
        F_r = np.eye(3)
        F_r[0, 2], F_r[1, 2] = before[1] - self.x[1], self.x[0] - before[0]
        noise = F_n @ Q @ F_n.T
        F = np.eye(len(self.x))
        F[:3, :3] = F_r
        self.P = F @ self.P @ F.T
        self.P[:3, :3] += noise
        self.motions.append((before, self.x[:3].copy(), F_r, noise))

    def observe(self, rows: list[int]) -> None:
        """What one sensor saw at one instant."""
        self.correct([i for i in rows if self.landmark[i] in self.offset])
        for i in rows:
            if self.landmark[i] not in self.offset:
                self.extend(i)

    def correct(self, rows: list[int]) -> None:
        """Map correction (Solà, Eqs. 26 to 30), of all rows at once or of one after another."""
        for batch in [rows] if self.joint and rows else [[i] for i in rows]:
            models = [self._model(i) for i in batch]
            H = np.concatenate([H for H, _, _ in models])
            z = np.concatenate([z for _, z, _ in models])
            S = H @ self.P @ H.T
            for j, (_, _, R) in enumerate(models):
                S[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] += R
            K = self.P @ H.T @ np.linalg.inv(S)
            for j, i in enumerate(batch):
                self._note(i, False, H[2 * j : 2 * j + 2], z[2 * j : 2 * j + 2], models[j][2])
            self.x = self.x + K @ z
            self.x[2] = wrap(self.x[2])
            self.P = self.P - K @ S @ K.T

    def _model(self, i: int) -> tuple[Any, Any, Any]:
        """Dense Jacobian, innovation and noise of one observation at the present state."""
        sensor, at, n = self._sensor(i), self.offset[self.landmark[i]], len(self.x)
        expected, H_r, H_l = sensor.observe(self.x[:3], self.x[at : at + 2])
        if self.mistake == "transposed-jacobian":
            H_r[:, :2] = H_r[:, :2].T.copy()
        if self.mistake == "sqrt-q" and sensor.kind == "range-bearing":
            H_r[1] *= expected[0]
            H_l[1] *= expected[0]
        H = np.zeros((2, n))
        H[:, :3], H[:, at : at + 2] = H_r, H_l
        value = self.dataset.observations.values[i]
        wrapped = self.mistake != "no-wrap"
        z = sensor.difference(value, expected) if wrapped else value - expected
        return H, z, self._noise(i)

    def extend(self, i: int) -> None:
        """Landmark initialization (Solà, Eqs. 35 to 38)."""
        n = len(self.x)
        value = self.dataset.observations.values[i]
        point, G_r, G_y = self._sensor(i).locate(self.x[:3], value)
        noise = G_y @ self._noise(i) @ G_y.T
        cross = G_r @ self.P[:3]
        P = np.zeros((n + 2, n + 2))
        P[:n, :n] = self.P
        P[n:, n:] = G_r @ self.P[:3, :3] @ G_r.T + noise
        if self.mistake != "no-cross-covariance":
            P[n:, :n], P[:n, n:] = cross, cross.T
        self.x, self.P = np.concatenate([self.x, point]), P
        self.offset[self.landmark[i]] = n
        H = np.zeros((2, n + 2))
        H[:, :3] = G_r
        self._note(i, True, H, np.zeros(2), noise)

    def _sensor(self, i: int) -> Sensor:
        return self.dataset.sensors[self.dataset.observations.sensor[i]]

    def _noise(self, i: int) -> Any:
        return self.dataset.sightings.covariance[i] * (4 if self.mistake == "wrong-noise" else 1)

    def _note(self, i: int, new: bool, H: Any, z: Any, R: Any) -> None:
        at = self.offset[self.landmark[i]]
        five = np.r_[:3, at : at + 2]
        S = H @ self.P @ H.T + R
        self.sightings.append((i, new, self.x[five], H[:, five], z, R, S))

    # Records ------------------------------------------------------------------------------------

    def estimate(self, name: str) -> Estimate:
        rows = len(self.landmark)
        decision = np.full(rows, Decision.REJECTED, dtype=np.int64)
        innovation, covariance = np.full((rows, 2), np.nan), np.full((rows, 2, 2), np.nan)
        for i, new, _, _, z, _, S in self.sightings:
            decision[i] = Decision.NEW if new else Decision.ACCEPTED
            if not new:
                innovation[i], covariance[i] = z, S
        points = np.array([*self.offset.values()], dtype=np.int64)[:, None] + np.arange(2)
        blocks = self.P[points[:, :, None], points[:, None, :]]
        return Estimate(
            estimator=name,
            dataset=self.dataset.name,
            association="known",
            online=Trajectory(np.array(self.poses), np.array(self.covariances)),
            landmarks=LandmarkEstimates(
                np.array([*self.offset], dtype=np.int64),
                self.x[points],
                blocks,
                self.P[3:, 3:],
            ),
            joint_covariance=self.P,
            innovations=Innovations(decision, np.array(self.landmark), innovation, covariance),
        )

    def linearizations(self) -> Linearizations:
        motion = (np.array(column) for column in zip(*self.motions, strict=True))
        columns = [np.array(column) for column in zip(*self.sightings, strict=True)]
        row, new, point, jacobian, innovation, noise, _ = columns
        observations = self.dataset.observations
        return Linearizations(
            *motion,
            row=row,
            step=observations.step[row],
            landmark=observations.landmark[row],
            new=new,
            point=point,
            jacobian=jacobian,
            innovation=innovation,
            noise=noise,
        )


TransposedJacobianEkf = partial(TextbookEkf, "transposed-jacobian")
NoCrossCovarianceEkf = partial(TextbookEkf, "no-cross-covariance")
NoWrapEkf = partial(TextbookEkf, "no-wrap")
SqrtQEkf = partial(TextbookEkf, "sqrt-q")
WrongNoiseEkf = partial(TextbookEkf, "wrong-noise")


def two_sensors(**changes: Any) -> Scenario:
    """A problem that uses everything: two mounted sensors that see the same landmarks, correlated
    noise, range noise that grows, a start that is not known exactly.
    """
    scenario = Scenario(
        name="two-sensors",
        landmarks=LandmarkMap(
            [2, 3, 5, 8, 13, 21, 34, 55],
            [[7, 0], [5, 5], [0, 7], [-5, 5], [-7, 0], [-5, -5], [0, -7], [5, -5]],
        ),
        start=[0.0, -3.0, 3.0],
        controls=np.tile([0.3, 0.02, 0.1], (90, 1)),
        motion=MotionModel(
            "odometry", covariance=[[4e-4, 1e-4, 0], [1e-4, 2e-4, -5e-5], [0, -5e-5, 1e-4]]
        ),
        sensors=(
            Sensor(
                "range-bearing",
                [[0.01, 0.001], [0.001, 0.0004]],
                mount=[0.5, 0.1, 0.2],
                field_of_view=np.pi,
                range_growth=0.01,
            ),
            Sensor("xy", [[0.04, 0.01], [0.01, 0.02]], mount=[-0.4, 0.0, 2.8], max_range=9.0),
        ),
        prior=Prior([0.0, -3.0, 3.0], np.diag([0.04, 0.09, 0.01])),
        draw_prior=True,
        observe_start=True,
    )
    return replace(scenario, **changes)


def first_poses(dataset: Dataset, count: int) -> Dataset:
    """The beginning of a dataset."""
    rows = dataset.observations.step < count
    columns = ("step", "values", "landmark", "sensor")
    robot = dataset.robot
    return replace(
        dataset,
        robots=(replace(robot, controls=robot.controls[: count - 1], truth=robot.truth[:count]),),
        times=dataset.times[:count],
        observations=Observations(**{c: getattr(dataset.observations, c)[rows] for c in columns}),
        true_landmark=dataset.true_landmark[rows],
    )
