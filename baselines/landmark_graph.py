"""The factor graph of a dataset, with exactly the noise of the filters.

Factors are gtsam's own, without a Python callback:

- prior of each robot: `PriorFactorPose2`, constrained where the start is exactly known;
- motion: `BetweenFactorPose2`, whose noise lives in the frame of the *second* pose: the increment's
  covariance is rotated by R(dtheta)';
- range and bearing: `BearingRangeFactor2D` (order bearing, range), `BearingFactor2D`,
  `RangeFactor2D`, which may share a landmark. A mount's heading adds to the bearing; a displaced
  sensor that reports a bearing gets a pose of its own, tied to the robot's by a constrained factor,
  and for a range alone `RangeFactorWithTransform2D` takes the mount;
- x and y: `PlanarProjectionFactor2`. A pinhole camera that looks straight down on landmarks at
  depth 1 reports exactly their position in its frame, and it takes the mount;
- robots that see robots: the same with `Pose2` in the place of the landmark. In x and y the camera
  looks at a point of its own near the seen robot, with a part of the noise, equal along all axes,
  between robot and point and the rest between point and camera: their sum, whatever the headings.
- landmarks of a known map, which are held where they are: each sighting has a copy of its landmark
  under a constraint. A single variable for all that see it would tie their poses together as a
  landmark that is estimated does; leaves are eliminated first, and the poses remain a chain. In x
  and y `PlanarProjectionFactor1` takes the point itself.

gtsam's tangent of `Pose2` is that of the body, and its errors of prior and motion are
``Log(measured^-1 actual)``: equal to the filters' additive errors to first order in the error of
the heading. Covariances are rotated into the package's additive convention on the way out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import gtsam
import numpy as np
from gtsam import noiseModel

from baselines import keys
from baselines.association import Association
from baselines.noise import Kernel, floored, models
from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, Prior
from ekfslam.errors import UnsupportedError
from ekfslam.geometry import Array
from ekfslam.models.sensors import BEARING, RANGE, RANGE_BEARING, XY
from ekfslam.observations import NO_LANDMARK, Sightings
from ekfslam.robots import LandmarkMap

ODOMETRY_FLOOR = 1e-4  # [m] and [rad]; at 1e-6 the system is indeterminate to gtsam
PRIOR_FLOOR = 1e-6
PINHOLE = (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # unit focal length, no distortion
# Depth is held at 1, to 1e-6 m (which moves a point at 10 m by 1e-5 of its smallest sigma here or
# less); x and y are left alone (1e9 m is no information). A constraint would do the same, but
# gtsam's marginals of a partly constrained variable are wrong.
DEPTH = noiseModel.Diagonal.Sigmas(np.array([1e9, 1e9, 1e-6]))
TIE, HOLD = noiseModel.Constrained.All(3), noiseModel.Constrained.All(2)
# Share of the least variance of an xy sighting of a robot that is between robot and point. In
# covariances a larger one would show as a knowledge of the robot's heading that is not there.
NEAR = 1e-3

# Factors of a landmark's sightings, and of a robot's.
FACTORS: tuple[dict[int, Any], dict[int, Any]] = (
    {
        RANGE_BEARING: gtsam.BearingRangeFactor2D,
        BEARING: gtsam.BearingFactor2D,
        RANGE: gtsam.RangeFactor2D,
    },
    {
        RANGE_BEARING: gtsam.BearingRangeFactorPose2,
        BEARING: gtsam.BearingFactorPose2,
        RANGE: gtsam.RangeFactorPose2,
    },
)
DISPLACED_RANGE = gtsam.RangeFactorWithTransform2D, gtsam.RangeFactorWithTransformPose2
MEASURED = {RANGE_BEARING: slice(2), BEARING: slice(1), RANGE: slice(1, 2)}  # of both


class LandmarkGraph:
    """Factors and variables of a dataset.

    Rows are those of the dataset's observations. What the sightings need besides poses and
    landmarks (poses of displaced sensors, points on robots, landmarks that are held) is called
    auxiliary.

    Parameters
    ----------
    dataset : Dataset
        A landmark may be seen by several kinds of sensors, but xy only by itself.
    association : Association
    odometry_floor : float
        Smallest standard deviation of a motion along any direction [m, rad]: two control noises
        without slip make its covariance singular, which gtsam cannot use.
    kernel : Kernel, optional
        Robust loss of the sightings of landmarks.
    held : LandmarkMap, optional
        Where all landmarks of the association are, exactly. None of them is estimated then.

    Attributes
    ----------
    mapped : (M,) ndarray of int
        Landmark that each row helps to estimate, -1 for none.

    Raises
    ------
    UnsupportedError
        If xy sightings of landmarks and others are mixed: gtsam has no factors that share a
        landmark.
    """

    def __init__(
        self,
        dataset: Dataset,
        association: Association,
        odometry_floor: float = ODOMETRY_FLOOR,
        kernel: Kernel | None = None,
        held: LandmarkMap | None = None,
    ) -> None:
        self.dataset, self.association = dataset, association
        self.rows = association.rows
        self.mapped = association.landmark
        self._places: dict[int, Array] = {}
        if held is not None:
            self.mapped = np.full_like(association.landmark, NO_LANDMARK)
            self._places = dict(zip(held.ids.tolist(), held.positions, strict=True))
        self.notes = list(association.notes)
        self.floored = False  # whether some noise had to be raised
        kinds = np.unique(dataset.sightings.kind[self.mapped >= 0])
        self.points_3d = XY in kinds
        if self.points_3d and len(kinds) > 1:
            raise UnsupportedError(
                "gtsam cannot mix xy sightings of landmarks with others in one graph"
            )
        if kernel is not None:
            self.notes.append(
                f"{kernel} on sightings of landmarks, and the error is the sum of its losses"
            )
        self._calibration = gtsam.Cal3DS2(*PINHOLE)
        self._mounts = [gtsam.Pose2(*sensor.mount) for sensor in dataset.sensors]
        self._cameras = [
            gtsam.Pose3(gtsam.Rot3.Rz(s.mount[2]), np.array([s.mount[0], s.mount[1], 0.0]))
            for s in dataset.sensors
        ]
        self.known_starts = np.array([not r.prior.covariance.any() for r in dataset.robots])
        priors = [self._prior_factor(i, r.prior) for i, r in enumerate(dataset.robots)]
        self._motions = [tuple(priors), *self._motion_factors(odometry_floor)]
        self._auxiliary: dict[int, list[int]] = {}
        self._sightings = dict(zip(self.rows.tolist(), self._sighting_factors(kernel), strict=True))

    # Factors ------------------------------------------------------------------------------------

    def motions(self, k: int) -> Sequence[gtsam.NonlinearFactor]:
        """What leads the robots to step k: their priors, or their motions."""
        return self._motions[k]

    def seen(
        self, rows: Iterable[int], landmarks: Iterable[int], auxiliaries: Iterable[int]
    ) -> Iterator[gtsam.NonlinearFactor]:
        """Factors of sightings.

        Parameters
        ----------
        rows : iterable of int
        landmarks : iterable of int
            Those that enter the graph with them.
        auxiliaries : iterable of int
            Keys of the auxiliary variables that enter with them.
        """
        for row in rows:
            yield self._sightings[row]
        if self.points_3d:
            for landmark in landmarks:
                yield self._depth(keys.landmark_key(landmark))
        for key in auxiliaries:
            if keys.is_sensor(key):
                step, robot, sensor = keys.indices(key)
                pose = keys.pose_key(step, robot)
                yield gtsam.BetweenFactorPose2(pose, key, self._mounts[sensor], TIE)
            elif keys.is_held(key):
                yield gtsam.PriorFactorPoint2(key, self._place(key - keys.HELD), HOLD)
            else:
                row = key - keys.SEEN
                robot, step = self._shown(row)
                pose = keys.pose_key(step, robot)
                noise = noiseModel.Isotropic.Variance(2, self._near(row))
                yield self._projection(pose, key, np.zeros(2), gtsam.Pose3(), noise)
                yield self._depth(key)

    def auxiliaries(self, rows: Iterable[int]) -> list[int]:
        """Keys of the auxiliary variables that sightings need."""
        needed = self._auxiliary
        return sorted({key for row in rows for key in needed.get(row, ())}) if needed else []

    def landmarks_of(self, rows: Iterable[int]) -> list[int]:
        """Landmarks that sightings help to estimate."""
        shown = np.unique(self.mapped[list(rows)])
        return shown[shown >= 0].tolist()

    def graph(self, rows: Iterable[int] | None = None) -> gtsam.NonlinearFactorGraph:
        """All motions, and sightings: of some rows, or all that are used."""
        rows = self.rows.tolist() if rows is None else list(rows)
        graph = gtsam.NonlinearFactorGraph()
        for factors in self._motions:
            for factor in factors:
                graph.add(factor)
        for factor in self.seen(rows, self.landmarks_of(rows), self.auxiliaries(rows)):
            graph.add(factor)
        return graph

    def dof(self, rows: Iterable[int]) -> int:
        """Rows of the residual minus dimensions of the state, of a graph with some sightings.

        Priors and motions have as many rows as poses have dimensions, and so have the factors that
        come with auxiliary variables; the fixed depth of a projection has its dimension.
        """
        rows = list(rows)
        kinds = self.dataset.sightings.kind[rows]
        partial = np.isin(kinds, [BEARING, RANGE]).sum()
        return int(2 * len(rows) - partial - 2 * len(self.landmarks_of(rows)))

    def _prior_factor(self, robot: int, prior: Prior) -> gtsam.NonlinearFactor:
        covariance = geo.additive_to_body(prior.mean, prior.covariance)
        noise: noiseModel.Base = TIE
        if not self.known_starts[robot]:
            regular, raised = floored(covariance[None], PRIOR_FLOOR)
            noise = noiseModel.Gaussian.Covariance(regular[0])
            if raised:
                self.floored = True
                self.notes.append(f"prior noise floored at {PRIOR_FLOOR:g}")
        return gtsam.PriorFactorPose2(keys.pose_key(0, robot), gtsam.Pose2(*prior.mean), noise)

    def _motion_factors(self, floor: float) -> Iterator[tuple[gtsam.NonlinearFactor, ...]]:
        """Motions of all robots, by step."""
        chains, low, count = [], 0, 0
        for index, robot in enumerate(self.dataset.robots):
            deltas, covariances = robot.increments
            covariances, raised = floored(geo.additive_to_body(deltas, covariances), floor)
            low, count = low + raised, count + len(deltas)
            start = keys.pose_key(0, index)
            chains.append(
                [
                    gtsam.BetweenFactorPose2(start + k, start + k + 1, gtsam.Pose2(*delta), noise)
                    for k, (delta, noise) in enumerate(
                        zip(deltas.tolist(), models(covariances), strict=True)
                    )
                ]
            )
        if low:
            self.floored = True
            self.notes.append(
                f"odometry noise floored at {floor:g} (m, rad) in {low} of {count} steps"
            )
        return zip(*chains, strict=True)

    def _sighting_factors(self, kernel: Kernel | None) -> Iterator[gtsam.NonlinearFactor]:
        """One factor for each used row, in order; notes what they need on the way."""
        rows, observations = self.rows, self.dataset.observations
        seen = Sightings(*(column[rows] for column in self.dataset.sightings))
        step, sensor = observations.step[rows], observations.sensor[rows]
        displaced = (seen.mount[:, :2] != 0).any(axis=1)
        of_robot = seen.target >= 0
        mounted = displaced & np.isin(seen.kind, [RANGE_BEARING, BEARING])
        pointed = of_robot & (seen.kind == XY)
        held = ~of_robot & (seen.kind != XY) & bool(self._places)
        at = keys.pose_key(step, seen.robot)
        at = np.where(mounted, keys.sensor_key(step, seen.robot, sensor), at).tolist()
        to = keys.landmark_key(self.association.landmark[rows])
        to = np.where(of_robot, keys.pose_key(step, seen.target), to)
        to = np.where(pointed, keys.seen_key(rows), to)
        to = np.where(held, keys.held_key(rows), to).tolist()
        for i in np.flatnonzero(mounted | pointed | held).tolist():
            ends = [at[i]] * bool(mounted[i]) + [to[i]] * bool(pointed[i] | held[i])
            self._auxiliary[int(rows[i])] = ends
        bearings = np.where(seen.kind == RANGE_BEARING, seen.values[:, 1], seen.values[:, 0])
        bearings = (bearings + np.where(displaced, 0.0, seen.mount[:, 2])).tolist()
        ranges, kinds = seen.values[:, 0].tolist(), seen.kind.tolist()
        noises = self._noises(sensor, of_robot, kernel)
        for i, (mine, robot) in enumerate(zip(sensor.tolist(), of_robot.tolist(), strict=True)):
            if kinds[i] == XY:
                point = self._place(int(rows[i])) if self._places and not robot else to[i]
                camera = self._cameras[mine]
                yield self._projection(at[i], point, seen.values[i], camera, noises[i])
            elif kinds[i] == RANGE and displaced[i]:
                make = DISPLACED_RANGE[robot]
                yield make(at[i], to[i], ranges[i], noises[i], self._mounts[mine])
            else:
                both = gtsam.Rot2(bearings[i]), ranges[i]
                make = FACTORS[robot][kinds[i]]
                yield make(at[i], to[i], *both[MEASURED[kinds[i]]], noises[i])

    def _noises(
        self, sensor: np.ndarray, of_robot: np.ndarray, kernel: Kernel | None
    ) -> list[noiseModel.Base]:
        """Noise model of each used row."""
        covariance = self.dataset.sightings.covariance[self.rows]
        noises = np.empty(len(self.rows), dtype=object)
        for index, view in enumerate(s.view for s in self.dataset.sensors):
            # gtsam has the bearing first.
            order = slice(None, None, -1) if view.code == RANGE_BEARING else slice(view.size)
            for robots in (False, True):
                rows = np.flatnonzero((sensor == index) & (of_robot == robots))
                own = covariance[rows][:, order, order]
                if robots and view.code == XY:
                    near = np.array([self._near(row) for row in self.rows[rows].tolist()])
                    own = own - near[:, None, None] * np.eye(2)
                noises[rows] = models(own, None if robots else kernel)
        return noises.tolist()

    def _shown(self, row: int) -> tuple[int, int]:
        """Robot that an observation shows, and the step."""
        return int(self.dataset.observed_robot[row]), int(self.dataset.observations.step[row])

    def _near(self, row: int) -> float:
        """Variance between the robot that an xy observation shows and its point."""
        return NEAR * float(np.linalg.eigvalsh(self.dataset.sightings.covariance[row])[0])

    def _place(self, row: int) -> Array:
        """Where the landmark is held that an observation shows."""
        return self._places[int(self.association.landmark[row])]

    def _projection(
        self,
        pose: int,
        point: int | Array,
        value: Array,
        camera: gtsam.Pose3,
        noise: noiseModel.Base,
    ) -> gtsam.NonlinearFactor:
        """A sighting of a variable, or of a point that is held."""
        rest = value, camera, self._calibration, noise
        if isinstance(point, int):
            return gtsam.PlanarProjectionFactor2(pose, point, *rest)
        return gtsam.PlanarProjectionFactor1(pose, np.append(point, 1.0), *rest)

    def _depth(self, key: int) -> gtsam.NonlinearFactor:
        return gtsam.PriorFactorPoint3(key, np.array([0.0, 0.0, 1.0]), DEPTH)

    # Values -------------------------------------------------------------------------------------

    def values(
        self, poses: Array, positions: Mapping[int, Array], rows: Iterable[int]
    ) -> gtsam.Values:
        """Initial values of all variables.

        Parameters
        ----------
        poses : (R, K + 1, 3) ndarray
        positions : mapping of int to (2,) array_like
            Landmarks of the graph.
        rows : iterable of int
            Its sightings.
        """
        values = gtsam.Values()
        for robot, chain in enumerate(poses.tolist()):
            for k, pose in enumerate(chain):
                values.insert(keys.pose_key(k, robot), gtsam.Pose2(*pose))
        self.insert(values, poses, positions.items(), self.auxiliaries(rows))
        return values

    def insert(
        self,
        values: gtsam.Values,
        poses: Array,
        positions: Iterable[tuple[int, Array]],
        auxiliaries: Iterable[int],
    ) -> None:
        """Insert landmarks and auxiliary variables, as the poses (R, K + 1, 3) have them."""
        for landmark, (x, y) in positions:
            point = np.array([x, y, 1.0] if self.points_3d else [x, y])
            values.insert(keys.landmark_key(landmark), point)
        for key in auxiliaries:
            if keys.is_sensor(key):
                step, robot, sensor = keys.indices(key)
                pose = gtsam.Pose2(*poses[robot, step])
                values.insert(key, pose.compose(self._mounts[sensor]))
            elif keys.is_held(key):
                values.insert(key, self._place(key - keys.HELD))
            else:
                x, y, _ = poses[self._shown(key - keys.SEEN)]
                values.insert(key, np.array([x, y, 1.0]))

    def poses_of(self, values: gtsam.Values) -> Array:
        """Poses (R, K + 1, 3) of a solution."""
        present = _keys(values)
        own = keys.has_letter(present, keys.POSE)
        both = own | keys.has_letter(present, keys.SENSOR)  # all that gtsam extracts, by key
        poses = gtsam.utilities.extractPose2(values)[own[both]]
        return poses.reshape(len(self.dataset.robots), self.dataset.poses, 3)

    def map_of(self, values: gtsam.Values) -> tuple[np.ndarray, Array]:
        """Identities (L,) and positions (L, 2) of the landmarks of a solution."""
        present = _keys(values)
        own = keys.has_letter(present, keys.LANDMARK)
        ids = present[own] - keys.LANDMARK
        if not self.points_3d:
            # gtsam leaves room for points of three coordinates, behind the others.
            return ids, gtsam.utilities.extractPoint2(values).reshape(-1, 2)[: len(ids)]
        both = own | keys.has_letter(present, keys.SEEN)
        return ids, gtsam.utilities.extractPoint3(values).reshape(-1, 3)[own[both], :2]

    def by_robot(self, series: Array) -> Array:
        """A series (R, ...) as trajectories hold it: without its first axis for one robot."""
        return series if len(self.dataset.robots) > 1 else series[0]


def _keys(values: gtsam.Values) -> np.ndarray:
    return np.array(values.keys(), dtype=np.int64)
