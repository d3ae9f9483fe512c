"""Batch smoothing: Levenberg-Marquardt on the whole landmark graph."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import gtsam
import numpy as np

from baselines import covariances, keys
from baselines.association import Association
from baselines.entry import all_at_once, notes, partial, rows_of, warm_up
from baselines.landmark_graph import ODOMETRY_FLOOR, LandmarkGraph
from baselines.noise import chosen
from baselines.options import check
from ekfslam.adapters import Progress
from ekfslam.dataset import Dataset
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import FAILED, Estimate, LandmarkEstimates, Trajectory
from ekfslam.geometry import Array
from ekfslam.registry import estimator_name, resolve

LARGE = 500


@dataclass(frozen=True)
class GtsamBatch:
    """GTSAM's Levenberg-Marquardt, started from an online estimate.

    Started from dead reckoning it is no baseline: on Victoria Park it stops in a local minimum.
    Landmarks seen by bearings or ranges alone are in the graph if all their sightings together,
    from the poses of the start, determine them (`ekfslam.models.fix.fix`).

    Parameters
    ----------
    initial : str, Estimator or Estimate
        Where to start, and whose association to take if it made its own. From `LARGE` landmarks of
        known identity and full views, ``ekf`` stands for ``ekf-compressed``: the same estimate.
    relative_tolerance : float
        Relative decrease of the error below which it stops.
    max_iterations : int
    marginals : bool
        Whether to recover the covariances of all poses and landmarks, see `baselines.covariances`.
    odometry_floor : float
        See `baselines.landmark_graph.LandmarkGraph`.
    robust : {"huber", "cauchy", "dcs"}, optional
        Loss of the sightings of landmarks, against wrong identities and other outliers. The error
        of the graph is then the sum of the losses, and covariances count each sighting as much as
        it weighs in the end.
    robust_scale : float, optional
        Of the loss; by default the customary one, see `baselines.noise.KERNELS`.

    Raises
    ------
    UnknownNameError, InputError
        For a loss that is not there, or numbers that make no sense.
    """

    initial: Any = "ekf"
    relative_tolerance: float = 1e-10
    max_iterations: int = 100
    marginals: bool = True
    odometry_floor: float = ODOMETRY_FLOOR
    robust: str | None = None
    robust_scale: float | None = None
    name = "gtsam-batch"

    def __post_init__(self) -> None:
        check(self)

    def estimate(self, dataset: Dataset, progress: Progress | None = None) -> Estimate:
        """Smooth a dataset.

        Parameters
        ----------
        dataset : Dataset
        progress : callable, optional
            Not used: gtsam tells nothing on its way.

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
        if self.initial == "ekf" and is_large(dataset):
            return replace(self, initial="ekf-compressed").estimate(dataset, progress)
        warm_up(dataset)
        covariances.warm_up()
        source = ready(self.initial, dataset)
        started = time.perf_counter()
        first = source if isinstance(source, Estimate) else source.estimate(dataset)
        named = first.association in ("", "known")  # else it names landmarks as it finds them
        association = Association.known(dataset) if named else Association.of(first)
        kernel = chosen(self.robust, self.robust_scale)
        problem = LandmarkGraph(dataset, association, self.odometry_floor, kernel)
        blank = Estimate(
            self.name,
            dataset.name,
            association.name,
            options=asdict(replace(self, initial=source_name(self.initial))),
        )
        poses = start_of(first, dataset)
        if poses is None:
            text = f"the start, {source_name(self.initial)}, is not finite"
            return replace(blank, status=FAILED, message=text)
        if first.landmarks is None:
            raise UnsupportedError(f"{first.estimator} offers nothing to start from")
        entry, positions = all_at_once(problem, poses, first.landmarks)
        del first  # it may hold the joint covariance of a large map
        found = self.solve(problem, blank, poses, positions, rows_of(problem, entry), started)
        if found.status == FAILED:
            return found
        return replace(
            found,
            innovations=association.record(entry),
            message="; ".join([found.message, *notes(problem, entry)]),
        )

    def solve(
        self,
        problem: LandmarkGraph,
        blank: Estimate,
        poses: Array,
        positions: Mapping[int, Array],
        rows: list[int],
        started: float,
    ) -> Estimate:
        """Smooth a graph.

        Parameters
        ----------
        problem : LandmarkGraph
        blank : Estimate
            What to fill in.
        poses : (R, K + 1, 3) ndarray
            Where to start.
        positions : mapping of int to (2,) ndarray
            Where to start the landmarks that are estimated.
        rows : list of int
            Observations to use.
        started : float
            When the clock started.

        Returns
        -------
        Estimate
            With poses, landmarks, times and the error of the graph; or `failed`.
        """
        graph, start = problem.graph(rows), problem.values(poses, positions, rows)
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(self.relative_tolerance)
        parameters.setAbsoluteErrorTol(0.0)
        parameters.setMaxIterations(self.max_iterations)
        try:
            optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters)
            values = optimizer.optimize()
            poses, (ids, points) = problem.poses_of(values), problem.map_of(values)
            error, iterations = graph.error(values), optimizer.iterations()
            time_total = time.perf_counter() - started
            of_poses = of_points = None
            started = time.perf_counter()
            if self.marginals:
                of_poses, of_points = covariances.recovered(problem, graph, values, poses)
                of_poses = problem.by_robot(of_poses)
        except RuntimeError as failure:
            return replace(blank, status=FAILED, message=in_words(failure))
        said = [f"{iterations} iterations from {source_name(self.initial)}", *problem.notes]
        if iterations >= self.max_iterations:
            said.insert(0, "stopped at the limit of iterations")
        return replace(
            blank,
            smoothed=Trajectory(problem.by_robot(poses), of_poses),
            landmarks=LandmarkEstimates(ids, points, of_points),
            time_total=time_total,
            time_marginals=time.perf_counter() - started,
            graph_error=error,
            graph_dof=problem.dof(rows),
            message="; ".join(said),
        )


def is_large(dataset: Dataset) -> bool:
    """Whether a start by the whole map would take longer than the smoother."""
    if (
        not dataset.association_known
        or partial(dataset, np.arange(len(dataset.observations))).any()
    ):
        return False
    return len(np.unique(dataset.observations.landmark)) > LARGE


def start_of(estimate: Estimate, dataset: Dataset) -> Array | None:
    """Poses (R, K + 1, 3) to start from, None if they are not finite."""
    trajectory = estimate.final_trajectory
    if trajectory is None or not np.isfinite(trajectory.poses).all():
        return None
    return np.reshape(trajectory.poses, (len(dataset.robots), dataset.poses, 3))


def in_words(failure: RuntimeError) -> str:
    """What gtsam's exception says, in one line that names the variable."""
    text = " ".join(str(failure).split())
    variable = re.search(r"near variable (\d+)", text)
    if variable is None:
        return text
    return f"indeterminate system near {keys.key_name(int(variable[1]))}"


def ready(source: Any, dataset: Dataset) -> Any:
    """An estimate, or the estimator of a name, compiled for a dataset before any clock starts."""
    if isinstance(source, Estimate):
        return source
    estimator = resolve(source)
    if hasattr(estimator, "warm_up"):
        estimator.warm_up(dataset)
    return estimator


def source_name(initial: Any) -> str:
    """How a start is called."""
    return initial.estimator if isinstance(initial, Estimate) else estimator_name(initial)
