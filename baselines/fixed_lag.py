"""Fixed-lag smoothing: the last poses and the whole map, fed step by step."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np

from baselines import entry, keys
from baselines.batch import in_words
from baselines.landmark_graph import ODOMETRY_FLOOR, LandmarkGraph
from baselines.noise import chosen
from baselines.stepwise import Arrivals, checked_count, fed, opened, parameters_of
from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.estimates import FAILED, Estimate, LandmarkEstimates
from ekfslam.geometry import Array
from ekfslam.registry import Progress


@dataclass(frozen=True)
class GtsamFixedLag:
    """GTSAM's incremental fixed-lag smoother: iSAM2 that lets go of old poses.

    After step k it knows the poses k - lag to k and every landmark that has entered. An older pose
    is marginalised, and what it says of the rest stays as a linear factor; variables of such a
    factor keep the point where they are linearised for good. So the lag lies between a filter,
    which relinearises nothing, and iSAM2, which it equals if the lag is as long as the run.

    Landmarks stay in the window however long they have not been seen: they are what closes loops,
    and a landmark that was let go could not come back under its identity. The price is that all
    that are in the map hang together, as in a filter. Sightings that do not determine a landmark by
    themselves wait as in `baselines.isam2.GtsamIsam2`, but no longer than their poses are known.

    There is the online series and no smoothed one: a pose that leaves the window has been
    corrected by what was seen up to `lag` steps later, which is neither.

    Parameters
    ----------
    lag : int
        How many steps back poses are known.
    relinearize_threshold : float
        Change of a variable [m, rad] from which it is linearised anew (gtsam's default).
    relinearize_skip : int
        Relinearisation is considered at every so many updates (gtsam's default).
    marginals : bool
        Whether to recover covariances: of each pose as it comes, and jointly of the final poses
        and the map.
    marginal_every : int
        At how many steps those of the pose that comes: every so many, and the last.
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

    lag: int = 50
    relinearize_threshold: float = 0.1
    relinearize_skip: int = 10
    marginals: bool = True
    marginal_every: int = 1
    association: Any = "ekf"
    odometry_floor: float = ODOMETRY_FLOOR
    robust: str | None = None
    robust_scale: float | None = None
    name = "gtsam-fixed-lag"

    def __post_init__(self) -> None:
        chosen(self.robust, self.robust_scale)
        checked_count(self.lag, "lag")
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
            With the online trajectory and the final landmarks; without an error of the graph,
            for most of it is gone. A system that gtsam finds indeterminate gives status `failed`
            and names the variable.

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
        parameters.findUnusedFactorSlots = True
        smoother = gtsam.IncrementalFixedLagSmoother(float(self.lag), parameters)
        window = _Window(problem)

        def update(new: Arrivals) -> None:
            smoother.update(new.graph, new.values, window.stamps(new))

        def marginal(variables: list[int]) -> list[Array]:
            if len(problem.dataset.robots) == 1:
                return [smoother.marginalCovariance(key) for key in variables]
            whole = _marginals(smoother.getISAM2())
            return [whole.marginalCovariance(key) for key in variables]

        every = self.marginal_every if self.marginals else None
        run = fed(problem, smoother, update, marginal, every, self.lag, progress)
        ids, points = problem.map_of(smoother.calculateEstimate())
        total = time.perf_counter() - started - run.time_marginals
        begin = time.perf_counter()
        joint = of_map = blocks = None
        if self.marginals:
            final = np.reshape(run.online.poses, (-1, problem.dataset.poses, 3))[:, -1]
            joint = _joint(smoother.getISAM2(), problem, final, ids)
            of_map = joint[3 * len(final) :, 3 * len(final) :]
            blocks = np.einsum("iaib->iab", of_map.reshape(len(ids), 2, len(ids), 2))
        return replace(
            estimate,
            online=run.online,
            landmarks=LandmarkEstimates(ids, points, blocks, of_map),
            joint_covariance=joint,
            innovations=problem.association.record(run.entry, run.lost),
            step_seconds=run.seconds,
            time_total=total,
            time_marginals=time.perf_counter() - begin + run.time_marginals,
            message="; ".join(
                [*problem.notes, *entry.notes(problem, run.entry), *_notes(run.lost, self.lag)]
            ),
        )


class _Window:
    """Up to when variables stay.

    The smoother lets go of what has a stamp older than its lag. What has none it eliminates as if
    it were to go next, which it cannot do well: gtsam then finds landmarks indeterminate. So all of
    them get a new stamp at every step.
    """

    def __init__(self, problem: LandmarkGraph) -> None:
        self._robots = range(len(problem.dataset.robots))
        self._step = problem.dataset.observations.step
        self._landmarks: list[int] = []

    def stamps(self, new: Arrivals) -> dict[int, int]:
        """Stamps of the variables of a step, by key."""
        self._landmarks += [keys.landmark_key(landmark) for landmark in new.landmarks]
        stamps = {keys.pose_key(new.step, robot): new.step for robot in self._robots}
        for key in new.auxiliaries:
            of_sensor = keys.is_sensor(key)
            stamps[key] = keys.indices(key)[0] if of_sensor else int(self._step[key - keys.SEEN])
        return stamps | dict.fromkeys(self._landmarks, new.step)


def _marginals(isam: gtsam.ISAM2) -> gtsam.Marginals:
    """Covariances from the factors that are left.

    gtsam's own tree gives wrong ones, by tens of percent, once poses of several robots have left it
    together; its factors and its estimates are right.
    """
    factors, left = isam.getFactorsUnsafe(), gtsam.NonlinearFactorGraph()
    for place in range(factors.size()):
        if factors.at(place) is not None:
            left.push_back(factors.at(place))
    return gtsam.Marginals(left, isam.getLinearizationPoint())


def _joint(isam: gtsam.ISAM2, problem: LandmarkGraph, final: Array, ids: np.ndarray) -> Array:
    """Joint covariance of the final poses (R, 3) and the map, additive."""
    last = problem.dataset.poses - 1
    poses = [keys.pose_key(last, robot) for robot in range(len(final))]
    landmarks = keys.landmark_key(ids).tolist()
    # By key, so landmarks first; coordinates that are kept, in the package's order.
    known = isam if len(final) == 1 else _marginals(isam)
    whole = known.jointMarginalCovariance(landmarks + poses).fullMatrix()
    size = 3 if problem.points_3d else 2
    first = size * len(ids)
    kept = size * np.arange(len(ids))[:, None] + np.arange(2)
    order = np.concatenate([np.arange(first, first + 3 * len(final)), kept.ravel()])
    turn = np.eye(len(order))
    for robot, block in enumerate(geo.heading_block(final[:, 2])):
        at = slice(3 * robot, 3 * robot + 3)
        turn[at, at] = block
    return geo.congruence(turn, whole[np.ix_(order, order)])


def _notes(lost: Sequence[int], lag: int) -> list[str]:
    return [f"{len(lost)} sightings waited for longer than the lag of {lag}: not used"] * bool(lost)
