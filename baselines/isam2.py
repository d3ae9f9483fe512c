"""Incremental smoothing with iSAM2 (Kaess et al. 2012), fed step by step."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import gtsam
import numpy as np

from baselines.batch import in_words, ready
from baselines.landmark_graph import (
    ODOMETRY_FLOOR,
    Association,
    LandmarkGraph,
    landmark_key,
    point_covariances,
    pose_covariances,
    pose_key,
)
from ekfslam.dataset import Dataset
from ekfslam.estimates import FAILED, Estimate, LandmarkEstimates, Trajectory
from ekfslam.registry import Progress


@dataclass(frozen=True)
class GtsamIsam2:
    """GTSAM's iSAM2, updated once per step.

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
    """

    relinearize_threshold: float = 0.1
    relinearize_skip: int = 10
    final_updates: int = 0
    marginals: bool = True
    association: Any = "ekf"
    odometry_floor: float = ODOMETRY_FLOOR
    name = "gtsam-isam2"

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
        source = None if dataset.association_known else ready(self.association)
        started = time.perf_counter()
        if source is None:
            association = Association.known(dataset)
        else:
            association = Association.of(source.estimate(dataset))
        problem = LandmarkGraph(dataset, association, self.odometry_floor)
        estimate = Estimate(
            estimator=self.name,
            dataset=dataset.name,
            association=association.name,
            innovations=association.record(),
            options=asdict(self) | {"association": str(self.association)},
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
        dataset = problem.dataset
        steps = dataset.poses
        deltas = [gtsam.Pose2(*delta) for delta in dataset.robot.increments.deltas.tolist()]
        newcomers = _newcomers(problem)
        online = np.empty((steps, 3))
        blocks: list[np.ndarray] = []
        seconds = np.empty(steps)
        spent = 0.0  # on covariances
        pose = gtsam.Pose2(*dataset.prior.mean)
        for k in range(steps):
            begin = time.perf_counter()
            if k > 0:
                pose = pose.compose(deltas[k - 1])
            graph = gtsam.NonlinearFactorGraph()
            for factor in problem.step(k):
                graph.add(factor)
            online[k] = pose.x(), pose.y(), pose.theta()  # predicted: where the step starts
            fresh = [(i, pose.transformFrom(point)) for i, point in newcomers.get(k, ())]
            isam.update(graph, problem.values_of_step(k, online[k], fresh))
            pose = isam.calculateEstimatePose2(pose_key(k))
            online[k] = pose.x(), pose.y(), pose.theta()
            seconds[k] = time.perf_counter() - begin
            if self.marginals:
                begin = time.perf_counter()
                blocks.append(isam.marginalCovariance(pose_key(k)))
                spent += time.perf_counter() - begin
            if progress is not None and k % 50 == 0:
                progress(k, steps)
        for _ in range(self.final_updates):
            isam.update()
        values = isam.calculateEstimate()
        poses, positions = problem.poses_of(values), problem.positions_of(values)
        time_total = time.perf_counter() - started - spent
        begin = time.perf_counter()
        online_covariances = covariances = point_blocks = None
        if self.marginals:
            online_covariances = pose_covariances(online, blocks)
            final = [isam.marginalCovariance(pose_key(k)) for k in range(steps)]
            covariances = pose_covariances(poses, final)
            point_blocks = point_covariances(
                isam.marginalCovariance(landmark_key(i)) for i in problem.landmarks.tolist()
            )
        spent += time.perf_counter() - begin
        return replace(
            estimate,
            online=Trajectory(online, online_covariances),
            smoothed=Trajectory(poses, covariances),
            landmarks=LandmarkEstimates(problem.landmarks, positions, point_blocks),
            step_seconds=seconds,
            time_total=time_total,
            time_marginals=spent,
            graph_error=problem.graph().error(values),
            graph_dof=problem.dof,
            message="; ".join(problem.notes),
        )


def _newcomers(problem: LandmarkGraph) -> dict[int, list[tuple[int, np.ndarray]]]:
    """Landmarks first seen at each step, with their position in the body frame."""
    dataset = problem.dataset
    landmark = problem.association.landmark
    used = np.flatnonzero(landmark >= 0)
    _, first = np.unique(landmark[used], return_index=True)
    newcomers: dict[int, list[tuple[int, np.ndarray]]] = {}
    observations = dataset.observations
    for row in np.sort(used[first]).tolist():
        sensor = dataset.sensors[int(observations.sensor[row])]
        point = sensor.locate(np.zeros(3), observations.values[row])[0]
        step = int(observations.step[row])
        newcomers.setdefault(step, []).append((int(landmark[row]), point))
    return newcomers
