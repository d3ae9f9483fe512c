"""Incremental smoothing with iSAM2 (Kaess et al. 2012), fed step by step."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import gtsam

from baselines import covariances, entry
from baselines.batch import in_words
from baselines.landmark_graph import ODOMETRY_FLOOR, LandmarkGraph
from baselines.noise import chosen
from baselines.stepwise import Arrivals, checked_count, fed, opened, parameters_of
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
        Whether to recover covariances: of each pose as it comes, and of all at the end. They are
        those of iSAM2's own linear system, so of the points where it linearised last.
    marginal_every : int
        At how many steps those of the pose that comes: every so many, and the last. gtsam takes
        about as long for one as for the update where many landmarks are in view.
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
        For a loss that is not there, or numbers that make no sense.
    """

    relinearize_threshold: float = 0.1
    relinearize_skip: int = 10
    final_updates: int = 0
    marginals: bool = True
    marginal_every: int = 1
    association: Any = "ekf"
    odometry_floor: float = ODOMETRY_FLOOR
    robust: str | None = None
    robust_scale: float | None = None
    name = "gtsam-isam2"

    def __post_init__(self) -> None:
        chosen(self.robust, self.robust_scale)
        checked_count(self.marginal_every, "marginal_every")

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
        problem, estimate, started = opened(self, dataset)
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
        parameters = parameters_of(self, problem)
        isam = gtsam.ISAM2(parameters)

        def update(new: Arrivals) -> None:
            isam.update(new.graph, new.values)

        def marginal(variables: list[int]) -> list[Array]:
            return [isam.marginalCovariance(key) for key in variables]

        every = self.marginal_every if self.marginals else None
        run = fed(problem, isam, update, marginal, every, progress=progress)
        for _ in range(self.final_updates):
            isam.update()
        values = isam.calculateEstimate()
        smoothed, (ids, points) = problem.poses_of(values), problem.map_of(values)
        time_total = time.perf_counter() - started - run.time_marginals
        rows = entry.rows_of(problem, run.entry)
        graph = problem.graph(rows)
        begin = time.perf_counter()
        of_poses = of_points = None
        if self.marginals:
            there = isam.getLinearizationPoint()
            of_poses, of_points = covariances.recovered(problem, graph, there, smoothed)
            of_poses = problem.by_robot(of_poses)
        return replace(
            estimate,
            online=run.online,
            smoothed=Trajectory(problem.by_robot(smoothed), of_poses),
            landmarks=LandmarkEstimates(ids, points, of_points),
            innovations=problem.association.record(run.entry),
            step_seconds=run.seconds,
            time_total=time_total,
            time_marginals=time.perf_counter() - begin + run.time_marginals,
            graph_error=graph.error(values),
            graph_dof=problem.dof(rows),
            message="; ".join(problem.notes + entry.notes(problem, run.entry)),
        )
