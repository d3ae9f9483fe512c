"""Feeding a smoother of gtsam step by step, and reading each pose as it comes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import gtsam
import numpy as np

from baselines import covariances, keys
from baselines.association import Association
from baselines.batch import in_words, ready
from baselines.entry import Entrance, warm_up
from baselines.landmark_graph import ODOMETRY_FLOOR, LandmarkGraph
from baselines.noise import chosen
from baselines.options import check
from ekfslam import geometry as geo
from ekfslam.adapters import Progress
from ekfslam.dataset import Dataset
from ekfslam.estimates import FAILED, Estimate, Trajectory
from ekfslam.geometry import Array


@dataclass(frozen=True, kw_only=True)
class Stepwise:
    """What the smoothers that are fed step by step have in common.

    Landmarks seen by bearings or ranges alone enter at the step at which their sightings so far,
    from the poses as they are known then, determine them (`ekfslam.models.fix.fix`).

    Parameters
    ----------
    relinearize_threshold : float
        Change of a variable [m, rad] from which it is linearised anew (gtsam's default).
    relinearize_skip : int
        Relinearisation is considered at every so many updates (gtsam's default).
    marginals : bool
        Whether to recover covariances: of each pose as it comes, and of all that is known at the
        end.
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
    marginals: bool = True
    marginal_every: int = 1
    association: Any = "ekf"
    odometry_floor: float = ODOMETRY_FLOOR
    robust: str | None = None
    robust_scale: float | None = None

    def __post_init__(self) -> None:
        check(self)

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
            A system that gtsam finds indeterminate gives status `failed` and names the variable.

        Raises
        ------
        UnsupportedError
            If the graph cannot be built, see `baselines.landmark_graph`.
        """
        return self.solve(*opened(self, dataset), progress)

    def solve(
        self,
        problem: LandmarkGraph,
        estimate: Estimate,
        started: float,
        progress: Progress | None,
    ) -> Estimate:
        """Smooth a graph step by step.

        Parameters
        ----------
        problem : LandmarkGraph
        estimate : Estimate
            What to fill in.
        started : float
            When the clock started.
        progress : callable or None

        Returns
        -------
        Estimate
            Or `failed`.
        """
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
        """Feed the smoother, and read what it knows at the end."""
        raise NotImplementedError


class Arrivals(NamedTuple):
    """What is new at a step.

    Attributes
    ----------
    step : int
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Of new variables, as they are predicted.
    landmarks : list of int
        Those that enter.
    auxiliaries : list of int
        Keys of auxiliary variables that enter.
    """

    step: int
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    landmarks: list[int]
    auxiliaries: list[int]


class Fed(NamedTuple):
    """What was read on the way.

    Attributes
    ----------
    online : Trajectory
    entry : dict of int to int
        Row at which each landmark entered.
    lost : list of int
        Rows that could not be used any more when their landmark entered.
    seconds : (K + 1,) ndarray
        Of each step, without covariances.
    time_marginals : float
    """

    online: Trajectory
    entry: dict[int, int]
    lost: list[int]
    seconds: Array
    time_marginals: float


def fed(
    problem: LandmarkGraph,
    smoother: Any,
    update: Callable[[Arrivals], None],
    marginal: Callable[[list[int]], list[Array]],
    every: int | None,
    lag: int | None = None,
    progress: Progress | None = None,
) -> Fed:
    """Feed a smoother the graph of a dataset.

    Parameters
    ----------
    problem : LandmarkGraph
    smoother : gtsam.ISAM2 or gtsam.IncrementalFixedLagSmoother
    update : callable
        Gives the smoother what is new at a step.
    marginal : callable
        Covariances of the variables of some keys, as the smoother knows them.
    every : int or None
        Covariances of the newest pose are recovered at every so many steps and at the last, or
        not at all.
    lag : int, optional
        How many steps back the smoother still knows poses, if not all.
    progress : callable, optional
        Called with (steps done, steps in all).

    Returns
    -------
    Fed
    """
    dataset, entrance = problem.dataset, Entrance(problem)
    robots, steps = range(len(dataset.robots)), dataset.poses
    moves = [[gtsam.Pose2(*move) for move in chain] for chain in dataset.moves.deltas.tolist()]
    bounds, used = np.searchsorted(problem.rows, dataset.offsets), problem.rows.tolist()
    now = _Now(smoother, dataset)
    online = np.empty((len(robots), steps, 3))
    blocks = np.full((len(robots), steps, 3, 3), np.nan)
    seconds, spent = np.empty(steps), 0.0
    present: set[int] = set()  # auxiliary variables
    poses = [gtsam.Pose2(*robot.prior.mean) for robot in dataset.robots]
    for k in range(steps):
        begin = time.perf_counter()
        poses = [pose.compose(chain[k]) for pose, chain in zip(poses, moves, strict=True)]
        now.predicted(k, poses)
        if lag is not None:
            entrance.forget(k - lag)
        rows, newcomers = entrance.arrive(used[bounds[k] : bounds[k + 1]], now.poses_at)
        landmarks = [landmark for landmark, _ in newcomers]
        fresh = [key for key in problem.auxiliaries(rows) if key not in present]
        present.update(fresh)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in problem.motions(k):
            graph.add(factor)
        for factor in problem.seen(rows, landmarks, fresh):
            graph.add(factor)
        for robot in robots:
            values.insert(keys.pose_key(k, robot), poses[robot])
        problem.insert(values, now.poses, newcomers, fresh)
        update(Arrivals(k, graph, values, landmarks, fresh))
        poses = [smoother.calculateEstimatePose2(keys.pose_key(k, robot)) for robot in robots]
        online[:, k] = [(pose.x(), pose.y(), pose.theta()) for pose in poses]
        seconds[k] = time.perf_counter() - begin
        if every is not None and (k % every == 0 or k == steps - 1):
            begin = time.perf_counter()
            marginals = marginal([keys.pose_key(k, robot) for robot in robots])
            blocks[:, k] = geo.body_to_additive(online[:, k], np.array(marginals))
            spent += time.perf_counter() - begin
        if progress is not None and k % 50 == 0:
            progress(k, steps)
    of_poses = None if every is None else problem.by_robot(blocks)
    trajectory = Trajectory(problem.by_robot(online), of_poses)
    return Fed(trajectory, entrance.entry, entrance.lost, seconds, spent)


def opened(smoother: Any, dataset: Dataset) -> tuple[LandmarkGraph, Estimate, float]:
    """What the smoothers that are fed step by step begin with.

    Parameters
    ----------
    smoother : GtsamIsam2 or GtsamFixedLag
    dataset : Dataset

    Returns
    -------
    problem : LandmarkGraph
    estimate : Estimate
        Without any results.
    started : float
        When the clock started: after compilation.
    """
    warm_up(dataset)
    covariances.warm_up()
    source = None if dataset.association_known else ready(smoother.association, dataset)
    started = time.perf_counter()
    if source is None:
        association = Association.known(dataset)
    else:
        association = Association.of(source.estimate(dataset))
    kernel = chosen(smoother.robust, smoother.robust_scale)
    problem = LandmarkGraph(dataset, association, smoother.odometry_floor, kernel)
    estimate = Estimate(
        estimator=smoother.name,
        dataset=dataset.name,
        association=association.name,
        options=asdict(replace(smoother, association=str(smoother.association))),
    )
    return problem, estimate, started


def parameters_of(smoother: Any, problem: LandmarkGraph) -> gtsam.ISAM2Params:
    """How iSAM2 is to work, by the options of a smoother.

    Where noise had to be floored, its floor stands beside noise that is orders of magnitude larger.
    Cholesky factors, which square that, then come out indeterminate; QR, which takes up to twice as
    long, does not.

    Parameters
    ----------
    smoother : GtsamIsam2 or GtsamFixedLag
    problem : LandmarkGraph

    Returns
    -------
    gtsam.ISAM2Params
    """
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(smoother.relinearize_threshold)
    parameters.relinearizeSkip = smoother.relinearize_skip
    if problem.floored:
        parameters.setFactorization("QR")
    return parameters


class _Now:
    """Poses as the smoother knows them at the step at hand; earlier ones are read when asked for.

    Attributes
    ----------
    poses : (R, K + 1, 3) ndarray
        As last read.
    """

    def __init__(self, smoother: Any, dataset: Dataset) -> None:
        self._smoother, self._observations = smoother, dataset.observations
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
            pose = self._smoother.calculateEstimatePose2(keys.pose_key(place[1], place[0]))
            self.poses[place] = pose.x(), pose.y(), pose.theta()
            self._fresh.add(place)
        return self.poses[robot, step]
