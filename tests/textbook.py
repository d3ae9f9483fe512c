"""EKF-SLAM as the texts write it, in plain dense NumPy: an oracle, and a carrier of mistakes.

Solà's equations with full matrices: H has a column for every coordinate of the state, and the
correction is ``P - K S K'``. It shares the sensor and landmark models with the package, and no line
with its filters. `MISTAKES` are what a validation must find; each has an estimator by name, so that
``textbook:NoWrapEkf`` can be checked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from ekfslam import geometry as geo
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
from ekfslam.models.landmarks import inverse_depth, observe_inverse_depth, to_point
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
OBSERVED, CREATED, CONVERTED = range(3)
LINEAR = 0.02  # linearity index below which an inverse depth becomes a point


@dataclass(frozen=True)
class TextbookEkf:
    """EKF-SLAM with known association: any robots, full views, bearings in inverse depth.

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
        deltas, covariances = dataset.moves
        for k in range(dataset.poses):
            for robot in range(len(dataset.robots)):
                run.predict(robot, deltas[robot, k], covariances[robot, k])
            rows = range(dataset.offsets[k], dataset.offsets[k + 1])
            for _, look in groupby(rows, dataset.sightings.look.item):
                run.observe(list(look))
            run.write()
        return run.estimate(self.name), run.linearizations()


class _Event(NamedTuple):
    """A linear model as `Linearizations` tells it."""

    event: int
    row: int
    robot: int
    step: int
    landmark: int
    target: int
    point: Any
    jacobian: Any
    innovation: Any
    noise: Any


class _Model(NamedTuple):
    """A sighting at the present state: dense Jacobian, innovation and noise; and its record."""

    H: Any
    z: Any
    R: Any
    event: _Event


class _Run:
    """State and records of one run; `place` says which coordinates each landmark has."""

    def __init__(self, dataset: Dataset, mistake: str | None, joint: bool) -> None:
        self.dataset, self.mistake, self.joint = dataset, mistake, joint
        priors = [robot.prior for robot in dataset.robots]
        self.robots = len(priors)
        self.x = np.concatenate([prior.mean for prior in priors])
        self.P = np.zeros((3 * self.robots, 3 * self.robots))
        for robot, prior in enumerate(priors):
            at = self._pose(robot)
            self.P[np.ix_(at, at)] = prior.covariance
        self.landmark = dataset.observations.landmark.tolist()
        self.target = dataset.observed_robot.tolist()
        self.place: dict[int, Any] = {}
        self.poses: list[Any] = []
        self.covariances: list[Any] = []
        self.motions: list[list[Any]] = [[] for _ in priors]
        self.events: list[_Event] = []
        rows = len(self.landmark)
        self.decision = np.full(rows, Decision.REJECTED, dtype=np.int64)
        self.innovation = np.full((rows, 2), np.nan)
        self.S = np.full((rows, 2, 2), np.nan)

    def _pose(self, robot: int) -> Any:
        return 3 * robot + np.arange(3)

    def predict(self, robot: int, delta: Any, Q: Any) -> None:
        """Robot motion (Solà, Eqs. 14 to 17)."""
        at = self._pose(robot)
        before = self.x[at]
        c, s = np.cos(before[2]), np.sin(before[2])
        F_n = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        after = before + F_n @ delta
        after[2] = wrap(after[2])
        F_r = np.eye(3)
        F_r[0, 2], F_r[1, 2] = before[1] - after[1], after[0] - before[0]
        noise = F_n @ Q @ F_n.T
        F = np.eye(len(self.x))
        F[np.ix_(at, at)] = F_r
        self.P = F @ self.P @ F.T
        self.P[np.ix_(at, at)] += noise
        self.x[at] = after
        self.motions[robot].append((before, after, F_r, noise))

    def write(self) -> None:
        """Note poses and covariances of a step."""
        blocks = [self._pose(robot) for robot in range(self.robots)]
        self.poses.append([self.x[at] for at in blocks])
        self.covariances.append([self.P[np.ix_(at, at)] for at in blocks])

    def observe(self, rows: list[int]) -> None:
        """What one sensor saw at one instant."""
        known = [i for i in rows if self.target[i] >= 0 or self.landmark[i] in self.place]
        self.correct(known)
        for i in rows:
            if i not in known:
                self.extend(i)
        for i in known:
            if self.target[i] < 0 and len(self.place[self.landmark[i]]) == 4:
                self.convert(i)

    def correct(self, rows: list[int]) -> None:
        """Map correction (Solà, Eqs. 26 to 30), of all rows at once or of one after another."""
        for batch in [rows] if self.joint and rows else [[i] for i in rows]:
            models = [self._model(i) for i in batch]
            H = np.concatenate([model.H for model in models])
            z = np.concatenate([model.z for model in models])
            S, at = H @ self.P @ H.T, 0
            for i, model in zip(batch, models, strict=True):
                d = len(model.z)
                S[at : at + d, at : at + d] += model.R
                self.decision[i], self.innovation[i, :d] = Decision.ACCEPTED, model.z
                self.S[i, :d, :d] = S[at : at + d, at : at + d]
                self.events.append(model.event)
                at += d
            K = self.P @ H.T @ np.linalg.inv(S)
            self.x = self.x + K @ z
            headings = 3 * np.arange(self.robots) + 2
            self.x[headings] = wrap(self.x[headings])
            self.P = self.P - K @ S @ K.T

    def _model(self, i: int) -> _Model:
        """Dense Jacobian, innovation and noise of one observation at the present state."""
        sensor, robot = self._sensor(i), self.dataset.observations.robot[i]
        here, d = self._pose(robot), sensor.view.size
        there = self._pose(self.target[i]) if self.target[i] >= 0 else self.place[self.landmark[i]]
        pose, value = self.x[here], self.dataset.observations.values[i, :d]
        point = self.x[there]
        if len(there) == 4:
            if sensor.kind != "bearing":
                point = _on_the_ray(sensor, pose, point, value)
            expected, H_r, H_l = observe_inverse_depth(sensor, pose, point)
        else:
            expected, H_r, H_l = sensor.observe(pose, point[:2])
            H_l = np.pad(H_l, ((0, 0), (0, len(there) - 2)))  # of a robot, no heading is seen
        if self.mistake == "transposed-jacobian":
            H_r[:, :2] = H_r[:, :2].T.copy()
        if self.mistake == "sqrt-q" and sensor.kind == "range-bearing":
            H_r[1] *= expected[0]
            H_l[1] *= expected[0]
        H = np.zeros((d, len(self.x)))
        H[:, here], H[:, there] = H_r, H_l
        wrapped = self.mistake != "no-wrap"
        z = sensor.difference(value, expected) if wrapped else value - expected
        R = self._noise(i)
        told = np.concatenate([pose, point]), np.concatenate([H_r, H_l], axis=1)
        return _Model(
            H, z - H_l @ (self.x[there] - point), R, self._event(OBSERVED, i, *told, z, R)
        )

    def extend(self, i: int) -> None:
        """Landmark initialization (Solà, Eqs. 35 to 38, of a bearing 39 to 47 and 53)."""
        n, sensor = len(self.x), self._sensor(i)
        here = self._pose(self.dataset.observations.robot[i])
        value, R = self.dataset.observations.values[i, : sensor.view.size], self._noise(i)
        if sensor.kind == "bearing":
            rho, sigma = 1 / (2 * sensor.min_range), 1 / (4 * sensor.min_range)
            point, G_r, G_y, G_s = inverse_depth(sensor, self.x[here], value, rho)
            noise = G_y @ R @ G_y.T + G_s @ G_s.T * sigma**2
        else:
            point, G_r, G_y = sensor.locate(self.x[here], value)
            noise = G_y @ R @ G_y.T
        cross, size = G_r @ self.P[here], len(point)
        P = np.zeros((n + size, n + size))
        P[:n, :n] = self.P
        P[n:, n:] = G_r @ self.P[np.ix_(here, here)] @ G_r.T + noise
        if self.mistake != "no-cross-covariance":
            P[n:, :n], P[:n, n:] = cross, cross.T
        told = np.concatenate([self.x[here], point])
        self.x, self.P = np.concatenate([self.x, point]), P
        self.place[self.landmark[i]] = n + np.arange(size)
        self.decision[i] = Decision.NEW
        self.events.append(self._event(CREATED, i, told, G_r, np.zeros(size), noise))

    def convert(self, i: int) -> None:
        """An inverse depth becomes a point where it is linear enough (Civera et al. 2008)."""
        at, robot = self.place[self.landmark[i]], self.dataset.observations.robot[i]
        landmark, rho = self.x[at], self.x[at[3]]
        if rho <= 0:
            return
        point, J = to_point(landmark)
        apart = point - geo.compose(self.x[self._pose(robot)], self._sensor(i).mount)[:2]
        distance = np.linalg.norm(apart)
        parallax = np.array([np.cos(landmark[2]), np.sin(landmark[2])]) @ apart / distance
        sigma = np.sqrt(self.P[at[3], at[3]]) / rho**2
        if 4 * sigma / distance * abs(parallax) >= LINEAR:
            return
        told = np.concatenate([np.zeros(3), landmark])
        told_J = np.concatenate([np.zeros((2, 3)), J], axis=1)
        self.events.append(self._event(CONVERTED, i, told, told_J, point, np.zeros((2, 2))))
        T = np.eye(len(self.x))
        T[at[:2]] = 0.0
        T[np.ix_(at[:2], at)] = J
        keep = np.setdiff1d(np.arange(len(self.x)), at[2:])
        self.x[at[:2]] = point
        self.x, self.P = self.x[keep], (T @ self.P @ T.T)[np.ix_(keep, keep)]
        self.place[self.landmark[i]] = at[:2]
        self.place = {name: np.searchsorted(keep, each) for name, each in self.place.items()}

    def _sensor(self, i: int) -> Sensor:
        return self.dataset.sensors[self.dataset.observations.sensor[i]]

    def _noise(self, i: int) -> Any:
        d = self._sensor(i).view.size
        factor = 4 if self.mistake == "wrong-noise" else 1
        return self.dataset.sightings.covariance[i, :d, :d] * factor

    def _event(self, event: int, i: int, point: Any, jacobian: Any, z: Any, R: Any) -> _Event:
        seen = self.dataset.observations
        row = -1 if event == CONVERTED else i
        whom = self.landmark[i], self.target[i]
        return _Event(event, row, seen.robot[i], seen.step[i], *whom, point, jacobian, z, R)

    # Records ------------------------------------------------------------------------------------

    def estimate(self, name: str) -> Estimate:
        one = self.robots == 1
        poses, covariances = np.array(self.poses), np.array(self.covariances)
        poses, covariances = np.moveaxis(poses, 1, 0), np.moveaxis(covariances, 1, 0)
        points = {i: at for i, at in self.place.items() if len(at) == 2}
        ahead = {i: at for i, at in self.place.items() if len(at) == 4}
        robots = np.arange(3 * self.robots)
        order = np.concatenate([robots, *points.values(), *ahead.values()])
        places = np.array([*points.values()], dtype=np.int64).reshape(-1, 2)
        among = places.reshape(-1)
        return Estimate(
            estimator=name,
            dataset=self.dataset.name,
            association="known",
            online=Trajectory(poses[0] if one else poses, covariances[0] if one else covariances),
            landmarks=LandmarkEstimates(
                np.array([*points], dtype=np.int64),
                self.x[places],
                self.P[places[:, :, None], places[:, None, :]],
                self.P[np.ix_(among, among)],
                np.array([*ahead], dtype=np.int64) if ahead else None,
                self.x[np.array([*ahead.values()])] if ahead else None,
            ),
            joint_covariance=self.P[np.ix_(order, order)],
            innovations=Innovations(
                self.decision, np.array(self.landmark), self.innovation, self.S
            ),
        )

    def linearizations(self) -> Linearizations:
        motion = [
            np.array([[entry[column] for entry in motions] for motions in self.motions])
            for column in range(4)
        ]
        count = len(self.events)
        sizes = {"point": (7,), "jacobian": (4, 7), "innovation": (4,), "noise": (4, 4)}
        columns = {name: np.zeros((count, *shape)) for name, shape in sizes.items()}
        for e, event in enumerate(self.events):
            for name, column in columns.items():
                entry = np.asarray(getattr(event, name))
                column[(e, *map(slice, entry.shape))] = entry
        for name in ("event", "row", "robot", "step", "landmark", "target"):
            columns[name] = np.array([getattr(event, name) for event in self.events])
        return Linearizations(
            *motion,
            size=np.array([len(event.point) - 3 for event in self.events]),
            rows=np.array([len(event.innovation) for event in self.events]),
            **columns,
        )


def _on_the_ray(sensor: Sensor, pose: Any, landmark: Any, value: Any) -> Any:
    """The inverse depth whose point is the nearest of its ray to where it was seen."""
    ahead = np.array([np.cos(landmark[2]), np.sin(landmark[2])])
    distance = ahead @ (sensor.locate(pose, value)[0] - landmark[:2])
    return np.array([*landmark[:3], 1 / distance])


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
