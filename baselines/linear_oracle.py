"""The linear oracle: a filter's own linear models, solved in one go by GTSAM.

A Kalman filter is an exact solver of linear Gaussian problems. So the Gaussian factor graph made of
a filter's own linearisations must give back its final poses, map and joint covariance to round-off;
any slip in the bookkeeping of the filter shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam import noiseModel

from baselines.keys import indices, is_landmark, landmark_key, pose_key
from ekfslam import geometry as geo
from ekfslam.estimates import Linearizations
from ekfslam.geometry import Array
from ekfslam.robots import Prior

NEGLIGIBLE = 1e-15  # an eigenvalue this small beside the largest is an exact constraint
RANK = 1e-10  # of exact constraints, beside the strongest: below it they repeat each other


class OracleSolution(NamedTuple):
    """What the linear problem says: final poses, and every landmark that ever was.

    An identity whose landmark was deleted and made again stands for the last one.

    Attributes
    ----------
    poses : (R, 3) ndarray
        Final poses.
    ids : (L,) ndarray of int
        Of points.
    positions : (L, 2) ndarray
    undetermined : (U,) ndarray of int
        Identities of landmarks in inverse depth.
    inverse_depth : (U, 4) ndarray
    covariance : (3 R + 2 L + 4 U, 3 R + 2 L + 4 U) ndarray
        Joint, additive, in the order of the fields above.
    """

    poses: Array
    ids: np.ndarray
    positions: Array
    undetermined: np.ndarray
    inverse_depth: Array
    covariance: Array


class _Landmark(NamedTuple):
    """A landmark now: ``anchor + matrix d``, with d the unknown of one of the variables."""

    variable: int
    anchor: Array
    matrix: Array


def solve(priors: Sequence[Prior], linear: Linearizations) -> OracleSolution:
    """Solve the linear problem of a filter.

    Parameters
    ----------
    priors : sequence of Prior
        Of the first pose of each robot.
    linear : Linearizations
        As the filter gives them.

    Returns
    -------
    OracleSolution
    """
    # Unknowns are differences from reference points, so that nothing is lost to large numbers.
    reference = linear.motion_to
    graph = gtsam.GaussianFactorGraph()
    for robot, prior in enumerate(priors):
        _add_motions(graph, robot, prior, linear)
    landmarks: dict[int, _Landmark] = {}
    sizes: list[int] = []  # of the variables of landmarks
    for i in range(len(linear.event)):
        robot, k, rows, size = (
            int(column[i]) for column in (linear.robot, linear.step, linear.rows, linear.size)
        )
        identity, target = int(linear.landmark[i]), int(linear.target[i])
        H, H_target = linear.jacobian[i, :rows, :3], linear.jacobian[i, :rows, 3 : 3 + size]
        innovation, noise = linear.innovation[i, :rows], linear.noise[i, :rows, :rows]
        pose, point = pose_key(k, robot), linear.point[i, 3 : 3 + size]
        off = geo.additive_error(linear.point[i, :3], reference[robot, k])
        if linear.event[i] == Linearizations.CREATED:
            landmarks[identity] = _Landmark(len(sizes), point, np.eye(size))
            key = landmark_key(len(sizes))
            sizes.append(size)
            _add(graph, [(pose, -H), (key, np.eye(size))], H @ off, noise)
        elif linear.event[i] == Linearizations.CONVERTED:
            # A linear function of the variable that was: no need for another one.
            variable, anchor, matrix = landmarks[identity]
            anchor = innovation + H_target @ _beyond(anchor, point)
            landmarks[identity] = _Landmark(variable, anchor, H_target @ matrix)
        elif target >= 0:
            away = geo.additive_error(point, reference[target, k])
            terms = [(pose, H), (pose_key(k, target), H_target)]
            _add(graph, terms, innovation - H @ off - H_target @ away, noise)
        else:
            variable, anchor, matrix = landmarks[identity]
            terms = [(pose, H), (landmark_key(variable), H_target @ matrix)]
            away = _beyond(anchor, point)
            _add(graph, terms, innovation - H @ off - H_target @ away, noise)
    return _solution(graph, reference[:, -1], landmarks, sizes)


def _beyond(landmark: Array, point: Array) -> Array:
    """``landmark - point``, with the angle of an inverse depth wrapped."""
    difference = landmark - point
    difference[2:3] = geo.wrap(difference[2:3])
    return difference


def _add_motions(
    graph: gtsam.GaussianFactorGraph, robot: int, prior: Prior, linear: Linearizations
) -> None:
    """The chain of one robot's poses."""
    before, after = linear.motion_from[robot], linear.motion_to[robot]
    jacobian, noise = linear.motion_jacobian[robot], linear.motion_noise[robot]
    first = geo.congruence(jacobian[0], prior.covariance) + noise[0]
    moved = jacobian[0] @ geo.additive_error(before[0], prior.mean)
    _add(graph, [(pose_key(0, robot), np.eye(3))], moved, first)
    for k in range(1, len(after)):
        drift = geo.additive_error(before[k], after[k - 1])
        terms = [(pose_key(k - 1, robot), -jacobian[k]), (pose_key(k, robot), np.eye(3))]
        _add(graph, terms, jacobian[k] @ drift, noise[k])


def _add(
    graph: gtsam.GaussianFactorGraph,
    terms: list[tuple[int, Array]],
    right: Array,
    covariance: Array,
) -> None:
    """Add ``sum A x = right + noise``, whitened along the axes of the noise.

    Directions without noise become exact constraints.
    """
    variances, axes = np.linalg.eigh(covariance)
    variances = np.where(variances > NEGLIGIBLE * variances[-1], variances, 0.0)
    arguments = [part for key, A in terms for part in (key, axes.T @ A)]
    model = noiseModel.Constrained.MixedSigmas(1.0, np.sqrt(variances))
    if variances.all():
        model = noiseModel.Diagonal.Sigmas(np.sqrt(variances))
    graph.add(gtsam.JacobianFactor(*arguments, axes.T @ right, model))


def _solution(
    graph: gtsam.GaussianFactorGraph,
    poses: Array,
    landmarks: dict[int, _Landmark],
    sizes: list[int],
) -> OracleSolution:
    """Eliminate all poses but the last, solve what remains densely, and pick what is asked for."""
    robots = len(poses)
    chains = sorted(indices(key) for key in graph.keyVector() if not is_landmark(key))
    early, rest = gtsam.Ordering(), gtsam.Ordering()
    for step, robot, _ in chains[:-robots]:
        early.push_back(pose_key(step, robot))
    for step, robot, _ in chains[-robots:]:
        rest.push_back(pose_key(step, robot))
    for variable in range(len(sizes)):
        rest.push_back(landmark_key(variable))
    if early.size():
        _, graph = graph.eliminatePartialSequential(early, gtsam.EliminateQR)
    mean, covariance = _dense(graph, rest)
    points = [i for i, landmark in landmarks.items() if len(landmark.anchor) == 2]
    rays = [i for i, landmark in landmarks.items() if len(landmark.anchor) == 4]
    chosen = [landmarks[i] for i in (*points, *rays)]
    starts = np.cumsum([3 * robots, *sizes])
    blocks = [np.eye(3 * robots, len(mean))]
    for landmark in chosen:
        block = np.zeros((len(landmark.anchor), len(mean)))
        start, width = starts[landmark.variable], landmark.matrix.shape[1]
        block[:, start : start + width] = landmark.matrix
        blocks.append(block)
    wanted = np.concatenate(blocks)
    values = np.concatenate([poses.reshape(-1), *(landmark.anchor for landmark in chosen)])
    values = values + wanted @ mean
    split = np.cumsum([3 * robots, 2 * len(points)])
    final, positions, depths = np.split(values, split)
    final, depths = final.reshape(-1, 3), depths.reshape(-1, 4)
    final[:, 2], depths[:, 2] = geo.wrap(final[:, 2]), geo.wrap(depths[:, 2])
    return OracleSolution(
        final,
        np.array(points, dtype=np.int64),
        positions.reshape(-1, 2),
        np.array(rays, dtype=np.int64),
        depths,
        wanted @ covariance @ wanted.T,
    )


def _dense(graph: gtsam.GaussianFactorGraph, order: gtsam.Ordering) -> tuple[Array, Array]:
    """Mean and covariance of all unknowns; exact constraints first, then least squares."""
    A, b = graph.jacobian(order)
    factors = [graph.at(i) for i in range(graph.size())]
    exact = np.concatenate(
        [
            f.get_model().sigmas() == 0 if f.isConstrained() else np.zeros(f.rows(), dtype=bool)
            for f in factors
        ]
    )
    start, free = np.zeros(A.shape[1]), np.eye(A.shape[1])
    if exact.any():
        left, sizes, right = np.linalg.svd(A[exact])
        rank = int((sizes > RANK * sizes[0]).sum())
        start = right[:rank].T @ ((left[:, :rank].T @ b[exact]) / sizes[:rank])
        free = right[rank:].T
    A, b = A[~exact], b[~exact]
    _, R = np.linalg.qr(np.column_stack([A @ free, b - A @ start]))
    size = free.shape[1]
    inverse = free @ np.linalg.inv(R[:size, :size])
    return start + inverse @ R[:size, size], inverse @ inverse.T
