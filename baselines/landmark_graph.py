"""The factor graph of a dataset, with exactly the noise of the filters.

Factors are gtsam's own, without a Python callback:

- prior: `PriorFactorPose2`, constrained where the start is exactly known;
- motion: `BetweenFactorPose2`, whose noise lives in the frame of the *second* pose: the increment's
  covariance is rotated by R(dtheta)';
- range and bearing: `BearingRangeFactor2D` (order bearing, range). A mount's heading adds to the
  bearing; a displaced sensor gets a pose of its own, tied to the robot's by a constrained factor;
- x and y: `PlanarProjectionFactor2`. A pinhole camera that looks straight down on landmarks at
  depth 1 reports exactly their position in its frame, and it takes the mount.

gtsam's tangent of `Pose2` is that of the body, and its errors of prior and motion are
``Log(measured^-1 actual)``: equal to the filters' additive errors to first order in the error of
the heading. Covariances are rotated into the package's additive convention on the way out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam import noiseModel

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Decision, Estimate, Innovations
from ekfslam.geometry import Array
from ekfslam.models.sensors import XY

ODOMETRY_FLOOR = 1e-4  # [m] and [rad]; at 1e-6 the system is indeterminate to gtsam
PRIOR_FLOOR = 1e-6
DEPTH_SIGMA = 1e-6  # [m]; moves a point at 10 m by 1e-5 of its smallest sigma here or less

POSE_KEY = gtsam.symbol("x", 0)
LANDMARK_KEY = gtsam.symbol("l", 0)
SENSOR_KEY = gtsam.symbol("s", 0)
PINHOLE = (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # unit focal length, no distortion


def pose_key(step: int) -> int:
    """Key of a pose."""
    return POSE_KEY + step


def landmark_key(landmark: int) -> int:
    """Key of a landmark."""
    return LANDMARK_KEY + landmark


def key_name(key: int) -> str:
    """A variable in words, for messages."""
    symbol = gtsam.Symbol(key)
    kind = {"x": "pose", "l": "landmark", "s": "sensor pose"}.get(chr(symbol.chr()), "variable")
    return f"{kind} {symbol.index()}"


@dataclass(frozen=True)
class Association:
    """Which landmark each observation belongs to, for the graph.

    Attributes
    ----------
    landmark : (M,) ndarray of int
        Identity, -1 for an observation that is not used.
    name : str
        "known", or the method of the estimate that decided.
    """

    landmark: np.ndarray
    name: str

    @classmethod
    def known(cls, dataset: Dataset) -> Association:
        """Identities of the dataset."""
        return cls(dataset.sightings.landmark, "known")

    def record(self) -> Innovations:
        """What a smoother made of each observation: it decides, but it has no innovations."""
        count = len(self.landmark)
        _, first = np.unique(self.landmark, return_index=True)
        decision = np.full(count, Decision.ACCEPTED, dtype=np.int64)
        decision[first] = Decision.NEW
        decision[self.landmark < 0] = Decision.REJECTED
        return Innovations(
            decision, self.landmark, np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
        )

    @classmethod
    def of(cls, estimate: Estimate) -> Association:
        """Decisions of an online estimate: what it accepted, and what it started landmarks with."""
        if estimate.innovations is None:
            raise UnsupportedError(f"{estimate.estimator} made no associations")
        innovations = estimate.innovations
        used = np.isin(innovations.decision, [Decision.ACCEPTED, Decision.NEW])
        return cls(np.where(used, innovations.landmark, -1), estimate.association)


class LandmarkGraph:
    """Factors of a dataset, step by step or all at once.

    Parameters
    ----------
    dataset : Dataset
        With one robot. A landmark may be seen by sensors of one kind only.
    association : Association
    odometry_floor : float
        Smallest standard deviation of a motion along any direction [m, rad]: two control noises
        without slip make its covariance singular, which gtsam cannot use.

    Raises
    ------
    UnsupportedError
        If range-bearing and xy sightings are mixed: gtsam has no factors that share a landmark.
    """

    def __init__(
        self, dataset: Dataset, association: Association, odometry_floor: float = ODOMETRY_FLOOR
    ) -> None:
        self.dataset, self.association = dataset, association
        self.notes: list[str] = []
        sightings = dataset.sightings
        self._used = np.flatnonzero(association.landmark >= 0)
        kinds = np.unique(sightings.kind[self._used])
        if len(kinds) > 1:
            raise UnsupportedError("gtsam cannot mix range-bearing and xy sightings in one graph")
        self.points_3d = bool(len(kinds) and kinds[0] == XY)
        self.landmarks = np.unique(association.landmark[self._used])
        self._prior = self._prior_factor()
        self._motions = self._motion_factors(odometry_floor)
        self._factors_of = self._projections() if self.points_3d else self._bearing_ranges()

    @property
    def dof(self) -> int:
        """Rows of the residual minus dimensions of the state.

        Ties of sensor poses and the fixed depth of a projection add as many rows as dimensions.
        """
        rows = 3 * self.dataset.poses + 2 * len(self._used)
        return rows - 3 * self.dataset.poses - 2 * len(self.landmarks)

    # Factors of one step ------------------------------------------------------------------------

    def step(self, k: int) -> list[gtsam.NonlinearFactor]:
        """Factors of step k: prior or motion, then sightings."""
        motion = self._prior if k == 0 else self._motions[k - 1]
        return [motion, *self._factors_of(k)]

    def graph(self) -> gtsam.NonlinearFactorGraph:
        """All factors."""
        graph = gtsam.NonlinearFactorGraph()
        for k in range(self.dataset.poses):
            for factor in self.step(k):
                graph.add(factor)
        return graph

    def _prior_factor(self) -> gtsam.NonlinearFactor:
        prior = self.dataset.prior
        covariance = geo.additive_to_body(prior.mean, prior.covariance)
        if not covariance.any():
            noise = noiseModel.Constrained.All(3)
        else:
            floored, raised = _floored(covariance[None], PRIOR_FLOOR)
            noise = noiseModel.Gaussian.Covariance(floored[0])
            if raised:
                self.notes.append(f"prior noise floored at {PRIOR_FLOOR:g}")
        return gtsam.PriorFactorPose2(POSE_KEY, gtsam.Pose2(*prior.mean), noise)

    def _motion_factors(self, floor: float) -> list[gtsam.NonlinearFactor]:
        deltas, covariances = self.dataset.robot.increments
        covariances, raised = _floored(geo.additive_to_body(deltas, covariances), floor)
        if raised:
            self.notes.append(
                f"odometry noise floored at {floor:g} (m, rad) in {raised} of {len(deltas)} steps"
            )
        return [
            gtsam.BetweenFactorPose2(POSE_KEY + k, POSE_KEY + k + 1, gtsam.Pose2(*delta), noise)
            for k, (delta, noise) in enumerate(
                zip(deltas.tolist(), _noise_models(covariances), strict=True)
            )
        ]

    def _rows(self) -> list[list[int]]:
        """Positions among the used rows, by step."""
        bounds = np.searchsorted(self._used, self.dataset.offsets).tolist()
        return [list(range(bounds[k], bounds[k + 1])) for k in range(self.dataset.poses)]

    def _bearing_ranges(self):  # type: ignore[no-untyped-def]
        sightings = self.dataset.sightings
        used, rows = self._used, self._rows()
        mount = sightings.mount[used]
        displaced = (mount[:, :2] != 0).any(axis=1).tolist()
        turn = np.where(displaced, 0.0, mount[:, 2])
        bearings = (sightings.values[used, 1] + turn).tolist()
        ranges = sightings.values[used, 0].tolist()
        keys = (self.association.landmark[used] + LANDMARK_KEY).tolist()
        noises = _noise_models(sightings.covariance[used][:, ::-1, ::-1])  # bearing comes first
        sensors = self.dataset.observations.sensor[used].tolist()
        poses = [gtsam.Pose2(*sensor.mount) for sensor in self.dataset.sensors]
        tie = noiseModel.Constrained.All(3)
        count = len(self.dataset.sensors)

        def factors(k: int) -> Iterator[gtsam.NonlinearFactor]:
            tied: set[int] = set()
            for i in rows[k]:
                at = POSE_KEY + k
                if displaced[i]:
                    at = SENSOR_KEY + k * count + sensors[i]
                    if at not in tied:
                        tied.add(at)
                        yield gtsam.BetweenFactorPose2(POSE_KEY + k, at, poses[sensors[i]], tie)
                yield gtsam.BearingRangeFactor2D(
                    at, keys[i], gtsam.Rot2(bearings[i]), ranges[i], noises[i]
                )

        return factors

    def _projections(self):  # type: ignore[no-untyped-def]
        sightings = self.dataset.sightings
        used, rows = self._used, self._rows()
        values = sightings.values[used]
        keys = (self.association.landmark[used] + LANDMARK_KEY).tolist()
        noises = _noise_models(sightings.covariance[used])
        sensors = self.dataset.observations.sensor[used].tolist()
        cameras = [
            gtsam.Pose3(gtsam.Rot3.Rz(s.mount[2]), np.array([s.mount[0], s.mount[1], 0.0]))
            for s in self.dataset.sensors
        ]
        calibration = gtsam.Cal3DS2(*PINHOLE)
        _, first = np.unique(self.association.landmark[used], return_index=True)
        is_first = np.isin(np.arange(len(used)), first).tolist()
        # Depth is held at 1; x and y are left alone (1e9 m is no information). A constraint would
        # do the same, but gtsam's marginals of a partly constrained variable are wrong.
        depth = noiseModel.Diagonal.Sigmas(np.array([1e9, 1e9, DEPTH_SIGMA]))

        def factors(k: int) -> Iterator[gtsam.NonlinearFactor]:
            for i in rows[k]:
                if is_first[i]:
                    yield gtsam.PriorFactorPoint3(keys[i], np.array([0.0, 0.0, 1.0]), depth)
                yield gtsam.PlanarProjectionFactor2(
                    POSE_KEY + k, keys[i], values[i], cameras[sensors[i]], calibration, noises[i]
                )

        return factors

    # Values -------------------------------------------------------------------------------------

    def point(self, position: Array) -> Array:
        """A landmark's position as the graph holds it."""
        return np.array([position[0], position[1], 1.0]) if self.points_3d else position

    def values_of_step(
        self, k: int, pose: Array, landmarks: Iterable[tuple[int, Array]]
    ) -> gtsam.Values:
        """Initial values of the variables that step k adds.

        Parameters
        ----------
        k : int
        pose : (3,) sequence
            Of the robot at step k.
        landmarks : iterable of (int, (2,) ndarray)
            New landmarks with their positions.
        """
        values = gtsam.Values()
        self.insert_pose(values, k, pose)
        for landmark, position in landmarks:
            values.insert(LANDMARK_KEY + landmark, self.point(position))
        return values

    def insert_pose(self, values: gtsam.Values, k: int, pose: Array) -> None:
        """Insert a pose, and the poses of displaced sensors that look at step k."""
        robot = gtsam.Pose2(*pose)
        values.insert(POSE_KEY + k, robot)
        if self.points_3d:
            return
        count = len(self.dataset.sensors)
        for sensor in self._displaced_at(k):
            mount = gtsam.Pose2(*self.dataset.sensors[sensor].mount)
            values.insert(SENSOR_KEY + k * count + sensor, robot.compose(mount))

    def _displaced_at(self, k: int) -> list[int]:
        displaced = [i for i, s in enumerate(self.dataset.sensors) if s.mount[:2].any()]
        if not displaced:
            return []
        rows = slice(self.dataset.offsets[k], self.dataset.offsets[k + 1])
        used = self.association.landmark[rows] >= 0
        seen = set(self.dataset.observations.sensor[rows][used].tolist())
        return [i for i in displaced if i in seen]

    def values(self, estimate: Estimate) -> gtsam.Values:
        """Initial values of all variables from an estimate with the same association."""
        trajectory, landmarks = estimate.final_trajectory, estimate.landmarks
        if trajectory is None or landmarks is None:
            raise UnsupportedError(f"{estimate.estimator} offers nothing to start from")
        values = gtsam.Values()
        for k, pose in enumerate(trajectory.poses.tolist()):
            self.insert_pose(values, k, pose)
        position = dict(zip(landmarks.ids.tolist(), landmarks.positions, strict=True))
        for landmark in self.landmarks.tolist():
            if landmark not in position:
                raise UnsupportedError(f"{estimate.estimator} has no landmark {landmark}")
            values.insert(LANDMARK_KEY + landmark, self.point(position[landmark]))
        return values

    def poses_of(self, values: gtsam.Values) -> Array:
        """Poses (K + 1, 3) of a solution."""
        # Keys sort by letter: sensor poses (s) come before the robot's (x).
        return gtsam.utilities.extractPose2(values)[-self.dataset.poses :]

    def positions_of(self, values: gtsam.Values) -> Array:
        """Landmark positions (L, 2) of a solution, in the order of `landmarks`."""
        extract = gtsam.utilities.extractPoint3 if self.points_3d else gtsam.utilities.extractPoint2
        return np.asarray(extract(values)).reshape(-1, 3 if self.points_3d else 2)[:, :2]


def pose_covariances(poses: Array, marginals: Iterable[Array]) -> Array:
    """gtsam's marginals of poses in the additive convention, (K + 1, 3, 3)."""
    return geo.body_to_additive(poses, np.array(list(marginals)).reshape(-1, 3, 3))


def point_covariances(marginals: Iterable[Array]) -> Array:
    """gtsam's marginals of landmarks in x and y, (L, 2, 2)."""
    return np.array([marginal[:2, :2] for marginal in marginals]).reshape(-1, 2, 2)


def _floored(covariances: Array, floor: float) -> tuple[Array, int]:
    """Covariances with no standard deviation below a floor, and how many were changed."""
    eigenvalues, vectors = np.linalg.eigh(covariances)
    low = eigenvalues[:, 0] < floor**2
    if not low.any():
        return covariances, 0
    raised = vectors[low] * np.maximum(eigenvalues[low], floor**2)[:, None, :]
    covariances = covariances.copy()
    covariances[low] = raised @ np.swapaxes(vectors[low], 1, 2)
    return covariances, int(low.sum())


def _noise_models(covariances: Array) -> list[noiseModel.Base]:
    """Noise models of covariances (n, d, d); equal ones share a model."""
    if len(covariances) == 0:
        return []
    flat = covariances.reshape(len(covariances), -1)
    if (np.abs(flat - flat[0]) <= 1e-12 * np.abs(flat[0]).max()).all():
        return [noiseModel.Gaussian.Covariance(covariances[0])] * len(covariances)
    return [noiseModel.Gaussian.Covariance(covariance) for covariance in covariances]
