"""Incremental smoothing with iSAM2 (Kaess et al. 2012), fed step by step."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import gtsam

from baselines import covariances, entry
from baselines.landmark_graph import LandmarkGraph
from baselines.stepwise import Arrivals, Stepwise, fed, parameters_of
from ekfslam.adapters import Progress
from ekfslam.estimates import Estimate, LandmarkEstimates, Trajectory
from ekfslam.geometry import Array


@dataclass(frozen=True, kw_only=True)
class GtsamIsam2(Stepwise):
    """GTSAM's iSAM2, updated once per step; options of `baselines.stepwise.Stepwise`, too.

    The estimate has the online and the final smoothed trajectory and the final landmarks.
    Covariances at the end are those of iSAM2's own linear system, so of the points where it
    linearised last.

    Parameters
    ----------
    final_updates : int
        Updates without new factors at the end, before the smoothed series is read.
    """

    final_updates: int = 0
    name = "gtsam-isam2"

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
