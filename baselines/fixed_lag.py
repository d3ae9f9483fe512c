"""Fixed-lag smoothing: the last poses and the whole map, fed step by step."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from baselines import entry, keys
from baselines.landmark_graph import LandmarkGraph
from baselines.stepwise import Arrivals, Stepwise, fed, parameters_of
from ekfslam import geometry as geo
from ekfslam.adapters import Progress
from ekfslam.checks import check_fits
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Estimate, LandmarkEstimates
from ekfslam.geometry import Array

# Matrices of the whole map that are held at a time, as measured: by gtsam at a step, and with the
# joint covariance at the end.
SQUARES, SQUARES_JOINT = 7, 9


@dataclass(frozen=True, kw_only=True)
class GtsamFixedLag(Stepwise):
    """GTSAM's incremental fixed-lag smoother: iSAM2 that lets go of old poses.

    Options of `baselines.stepwise.Stepwise`, too.

    After step k it knows the poses k - lag to k and every landmark that has entered. An older pose
    is marginalised, and what it says of the rest stays as a linear factor; variables of such a
    factor keep the point where they are linearised for good. So the lag lies between a filter,
    which relinearises nothing, and iSAM2, which it equals if the lag is as long as the run.

    Landmarks stay in the window however long they have not been seen: they are what closes loops,
    and a landmark that was let go could not come back under its identity. The price is that all
    that are in the map hang together, as in a filter; but what a filter corrects, gtsam eliminates
    anew at every step, as one dense block: time grows with the cube of their number, memory with
    its square. Sightings that do not determine a landmark by themselves wait no longer than their
    poses are known.

    There is the online series and no smoothed one: a pose that leaves the window has been
    corrected by what was seen up to `lag` steps later, which is neither. Nor is there an error of
    the graph, for most of it is gone. Covariances at the end are those of the final poses and the
    map, jointly.

    Parameters
    ----------
    lag : int
        How many steps back poses are known.
    max_landmarks : int
        Of the graph. More are refused: a step with 1000 takes seconds.
    """

    lag: int = 50
    max_landmarks: int = 1000
    name = "gtsam-fixed-lag"

    def _run(
        self,
        problem: LandmarkGraph,
        estimate: Estimate,
        started: float,
        progress: Progress | None,
    ) -> Estimate:
        self._check_size(len(problem.landmarks_of(problem.rows)))
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

    def _check_size(self, landmarks: int) -> None:
        """Refuse what takes too long, or does not fit."""
        if landmarks > self.max_landmarks:
            raise UnsupportedError(
                f"{landmarks} landmarks are more than max_landmarks={self.max_landmarks}: gtsam "
                "eliminates all of them densely at every step; take gtsam-isam2, or raise it"
            )
        squares = SQUARES_JOINT if self.marginals else SQUARES
        check_fits(
            squares * 8 * (2 * landmarks) ** 2,
            f"a window with {landmarks} landmarks",
            "take gtsam-isam2",
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
    joint = whole[np.ix_(order, order)]
    for robot, turn in enumerate(geo.heading_block(final[:, 2])):
        at = slice(3 * robot, 3 * robot + 3)
        own = geo.congruence(turn, joint[at, at])
        joint[at] = turn @ joint[at]
        joint[at, at] = own
        joint[:, at] = joint[at].T
    return joint


def _notes(lost: Sequence[int], lag: int) -> list[str]:
    return [f"{len(lost)} sightings waited for longer than the lag of {lag}: not used"] * bool(lost)
