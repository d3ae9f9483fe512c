"""Batch smoothing: Levenberg-Marquardt on the whole landmark graph."""

from __future__ import annotations

import re
import time
from dataclasses import asdict, dataclass
from typing import Any

import gtsam
import numpy as np

from baselines.landmark_graph import (
    ODOMETRY_FLOOR,
    Association,
    LandmarkGraph,
    key_name,
    landmark_key,
    point_covariances,
    pose_covariances,
    pose_key,
)
from ekfslam.dataset import Dataset
from ekfslam.estimates import FAILED, Estimate, LandmarkEstimates, Trajectory
from ekfslam.registry import Progress, estimator_name, resolve


@dataclass(frozen=True)
class GtsamBatch:
    """GTSAM's Levenberg-Marquardt, started from an online estimate.

    Started from dead reckoning it is no baseline: on Victoria Park it stops in a local minimum.

    Parameters
    ----------
    initial : str, Estimator or Estimate
        Where to start, and whose association to take if it made its own.
    relative_tolerance : float
        Relative decrease of the error below which it stops.
    max_iterations : int
    marginals : bool
        Whether to recover the covariances of all poses and landmarks.
    odometry_floor : float
        See `baselines.landmark_graph.LandmarkGraph`.
    """

    initial: Any = "ekf"
    relative_tolerance: float = 1e-10
    max_iterations: int = 100
    marginals: bool = True
    odometry_floor: float = ODOMETRY_FLOOR
    name = "gtsam-batch"

    def estimate(self, dataset: Dataset, progress: Progress | None = None) -> Estimate:
        """Smooth a dataset.

        Parameters
        ----------
        dataset : Dataset
        progress : callable, optional
            Called with (steps done, steps in all) while covariances are recovered.

        Returns
        -------
        Estimate
            With the smoothed trajectory, landmarks, and the error of the graph. A system that
            gtsam finds indeterminate gives status `failed` and names the variable.

        Raises
        ------
        UnsupportedError
            If the graph cannot be built, see `baselines.landmark_graph`.
        """
        source = ready(self.initial)
        started = time.perf_counter()
        first = source if isinstance(source, Estimate) else source.estimate(dataset)
        named = first.association in ("", "known")  # else it names landmarks as it finds them
        association = Association.known(dataset) if named else Association.of(first)
        problem = LandmarkGraph(dataset, association, self.odometry_floor)
        common: dict[str, Any] = {
            "estimator": self.name,
            "dataset": dataset.name,
            "association": association.name,
            "options": {**asdict(self), "initial": _name(self.initial)},
        }
        if first.final_trajectory is None or not np.isfinite(first.final_trajectory.poses).all():
            text = f"the start, {_name(self.initial)}, is not finite"
            return Estimate(**common, status=FAILED, message=text)
        graph, start = problem.graph(), problem.values(first)
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(self.relative_tolerance)
        parameters.setAbsoluteErrorTol(0.0)
        parameters.setMaxIterations(self.max_iterations)
        try:
            optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters)
            values = optimizer.optimize()
            poses, positions = problem.poses_of(values), problem.positions_of(values)
            error, iterations = graph.error(values), optimizer.iterations()
            time_total = time.perf_counter() - started
            covariances = blocks = None
            started = time.perf_counter()
            if self.marginals:
                covariances, blocks = recovered(problem, graph, values, poses, progress)
        except RuntimeError as failure:
            return Estimate(**common, status=FAILED, message=in_words(failure))
        notes = [f"{iterations} iterations from {_name(self.initial)}", *problem.notes]
        if iterations >= self.max_iterations:
            notes.insert(0, "stopped at the limit of iterations")
        return Estimate(
            **common,
            innovations=association.record(),
            smoothed=Trajectory(poses, covariances),
            landmarks=LandmarkEstimates(problem.landmarks, positions, blocks),
            time_total=time_total,
            time_marginals=time.perf_counter() - started,
            graph_error=error,
            graph_dof=problem.dof,
            message="; ".join(notes),
        )


def recovered(
    problem: LandmarkGraph,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    poses: np.ndarray,
    progress: Progress | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Marginal covariances of all poses (K + 1, 3, 3) and landmarks (L, 2, 2) of a solution."""
    marginals = gtsam.Marginals(graph, values)
    blocks = []
    for k in range(len(poses)):
        blocks.append(marginals.marginalCovariance(pose_key(k)))
        if progress is not None and k % 100 == 0:
            progress(k, len(poses))
    points = [marginals.marginalCovariance(landmark_key(i)) for i in problem.landmarks.tolist()]
    return pose_covariances(poses, blocks), point_covariances(points)


def in_words(failure: RuntimeError) -> str:
    """What gtsam's exception says, in one line that names the variable."""
    text = " ".join(str(failure).split())
    variable = re.search(r"near variable (\d+)", text)
    if variable is None:
        return text
    return f"indeterminate system near {key_name(int(variable[1]))}"


def ready(source: Any) -> Any:
    """An estimate, or the estimator of a name, compiled before any clock starts."""
    if isinstance(source, Estimate):
        return source
    estimator = resolve(source)
    getattr(estimator, "warm_up", lambda: None)()
    return estimator


def _name(initial: Any) -> str:
    return initial.estimator if isinstance(initial, Estimate) else estimator_name(initial)
