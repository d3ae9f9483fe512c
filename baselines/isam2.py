"""Incremental smoothing with iSAM2 (Kaess et al. 2012), fed step by step."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import gtsam
import numpy as np

from baselines import keys
from baselines.association import Association
from baselines.batch import in_words, ready, recovered
from baselines.entry import Entrance, notes, rows_of, warm_up
from baselines.landmark_graph import ODOMETRY_FLOOR, LandmarkGraph, pose_covariances
from baselines.noise import chosen
from ekfslam.dataset import Dataset
from ekfslam.estimates import FAILED, Estimate, LandmarkEstimates, Trajectory
from ekfslam.geometry import Array
from ekfslam.registry import Progress


@dataclass(frozen=True)
class GtsamIsam2:
    """GTSAM's iSAM2, updated once per step.

    Landmarks seen by bearings or ranges alone enter at the step at which their sightings so far,
    from the poses as they are known then, determine them (`ekfslam.models.landmarks.fix`).

    Parameters
    ----------
    relinearize_threshold : float
        Change of a variable [m, rad] from which it is linearised anew (gtsam's default).
    relinearize_skip : int
        Relinearisation is considered at every so many updates (gtsam's default).
    final_updates : int
        Updates without new factors at the end, before the smoothed series is read.
    marginals : bool
        Whether to recover covariances: of each pose as it comes, and of all at the end.
    association : str or Estimator
        Whose association to take where the dataset has none.
    odometry_floor : float
        See `baselines.landmark_graph.LandmarkGraph`.
    robust : {"huber", "cauchy", "dcs"}, optional
        Loss of the sightings of landmarks, see `baselines.batch.GtsamBatch`.
    robust_scale : float, optional
        Of the loss; by default the customary one.

    Raises
    ------
    UnknownNameError, InputError
        For a loss that is not there.
    """

    relinearize_threshold: float = 0.1
    relinearize_skip: int = 10
    final_updates: int = 0
    marginals: bool = True
    association: Any = "ekf"
    odometry_floor: float = ODOMETRY_FLOOR
    robust: str | None = None
    robust_scale: float | None = None
    name = "gtsam-isam2"

    def __post_init__(self) -> None:
        chosen(self.robust, self.robust_scale)

    def estimate(self, dataset: Dataset, progress: Progress | None = None) -> Estimate:
        """Smooth a dataset step by step.

        Parameters
        ----------
        dataset : Dataset
        progress : callable, optional
            Called with (steps done, steps in all).

        Returns
        -------
        Estimate
            With the online and the final smoothed trajectory and the final landmarks. A system
            that gtsam finds indeterminate gives status `failed` and names the variable.

        Raises
        ------
        UnsupportedError
            If the graph cannot be built, see `baselines.landmark_graph`.
        """
        warm_up(dataset)
        known = dataset.association_known
        source = None if known else ready(self.association, dataset)
        started = time.perf_counter()
        if source is None:
            association = Association.known(dataset)
        else:
            association = Association.of(source.estimate(dataset))
        kernel = chosen(self.robust, self.robust_scale)
        problem = LandmarkGraph(dataset, association, self.odometry_floor, kernel)
        estimate = Estimate(
            estimator=self.name,
            dataset=dataset.name,
            association=association.name,
            options=asdict(replace(self, association=str(self.association))),
        )
        try:
            return self._run(problem, estimate, started, progress)
        except RuntimeError as failure:
            return replace(estimate, status=FAILED, message=in_words(failure))

    def _run(
        self,
        problem: LandmarkGraph,
        estimate: Estimate,
        started: float,
        progress: Progress | None,
    ) -> Estimate:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(self.relinearize_threshold)
        parameters.relinearizeSkip = self.relinearize_skip
        isam = gtsam.ISAM2(parameters)
        dataset, entrance = problem.dataset, Entrance(problem)
        robots, steps = range(len(dataset.robots)), dataset.poses
        moves = [[gtsam.Pose2(*move) for move in chain] for chain in dataset.moves.deltas.tolist()]
        bounds, used = np.searchsorted(problem.rows, dataset.offsets), problem.rows.tolist()
        now = _Now(isam, dataset)
        online = np.empty((len(robots), steps, 3))
        blocks: list[list[Array]] = [[] for _ in robots]
        seconds = np.empty(steps)
        spent = 0.0  # on covariances
        poses = [gtsam.Pose2(*robot.prior.mean) for robot in dataset.robots]
        for k in range(steps):
            begin = time.perf_counter()
            poses = [pose.compose(chain[k]) for pose, chain in zip(poses, moves, strict=True)]
            now.predicted(k, poses)
            rows, newcomers = entrance.arrive(used[bounds[k] : bounds[k + 1]], now.poses_at)
            fresh = [key for key in problem.auxiliaries(rows) if not isam.valueExists(key)]
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            for factor in problem.motions(k):
                graph.add(factor)
            for factor in problem.seen(rows, (landmark for landmark, _ in newcomers), fresh):
                graph.add(factor)
            for robot in robots:
                values.insert(keys.pose_key(k, robot), poses[robot])
            problem.insert(values, now.poses, newcomers, fresh)
            isam.update(graph, values)
            poses = [isam.calculateEstimatePose2(keys.pose_key(k, robot)) for robot in robots]
            online[:, k] = [(pose.x(), pose.y(), pose.theta()) for pose in poses]
            seconds[k] = time.perf_counter() - begin
            if self.marginals:
                begin = time.perf_counter()
                for robot in robots:
                    blocks[robot].append(isam.marginalCovariance(keys.pose_key(k, robot)))
                spent += time.perf_counter() - begin
            if progress is not None and k % 50 == 0:
                progress(k, steps)
        for _ in range(self.final_updates):
            isam.update()
        values = isam.calculateEstimate()
        smoothed, (ids, points) = problem.poses_of(values), problem.map_of(values)
        time_total = time.perf_counter() - started - spent
        begin = time.perf_counter()
        online_covariances = covariances = point_blocks = None
        if self.marginals:
            online_covariances = problem.by_robot(pose_covariances(online, blocks))
            covariances, point_blocks = recovered(isam.marginalCovariance, smoothed, ids)
            covariances = problem.by_robot(covariances)
        spent += time.perf_counter() - begin
        rows = rows_of(problem, entrance.entry)
        return replace(
            estimate,
            online=Trajectory(problem.by_robot(online), online_covariances),
            smoothed=Trajectory(problem.by_robot(smoothed), covariances),
            landmarks=LandmarkEstimates(ids, points, point_blocks),
            innovations=problem.association.record(entrance.entry),
            step_seconds=seconds,
            time_total=time_total,
            time_marginals=spent,
            graph_error=problem.graph(rows).error(values),
            graph_dof=problem.dof(rows),
            message="; ".join(problem.notes + notes(problem, entrance.entry)),
        )


class _Now:
    """Poses as iSAM2 knows them at the step at hand; earlier ones are read when asked for.

    Attributes
    ----------
    poses : (R, K + 1, 3) ndarray
        As last read.
    """

    def __init__(self, isam: gtsam.ISAM2, dataset: Dataset) -> None:
        self._isam, self._observations = isam, dataset.observations
        self._fresh: set[tuple[int, int]] = set()
        self.poses = np.zeros((len(dataset.robots), dataset.poses, 3))

    def predicted(self, k: int, poses: list[gtsam.Pose2]) -> None:
        """Go on to step k, to which the odometry leads."""
        self._fresh = {(robot, k) for robot in range(len(poses))}
        self.poses[:, k] = [(pose.x(), pose.y(), pose.theta()) for pose in poses]

    def poses_at(self, rows: list[int]) -> Array:
        """Poses (n, 3) from which some observations were made."""
        robot, step = self._observations.robot[rows], self._observations.step[rows]
        for place in set(zip(robot.tolist(), step.tolist(), strict=True)) - self._fresh:
            pose = self._isam.calculateEstimatePose2(keys.pose_key(place[1], place[0]))
            self.poses[place] = pose.x(), pose.y(), pose.theta()
            self._fresh.add(place)
        return self.poses[robot, step]
