"""The linear oracle: a filter's own linear models, solved in one go by GTSAM.

A Kalman filter is an exact solver of linear Gaussian problems. So the Gaussian factor graph made of
a filter's own linearisations must give back its final pose, map and joint covariance to round-off;
any slip in the bookkeeping of the filter shows.
"""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np
from gtsam import noiseModel

from baselines.landmark_graph import landmark_key, pose_key
from ekfslam import geometry as geo
from ekfslam.dataset import Prior
from ekfslam.estimates import Linearizations
from ekfslam.geometry import Array

NEGLIGIBLE = 1e-15  # an eigenvalue this small beside the largest is an exact constraint


class OracleSolution(NamedTuple):
    """What the linear problem says.

    Attributes
    ----------
    pose : (3,) ndarray
        Final pose.
    ids : (L,) ndarray of int
    positions : (L, 2) ndarray
    covariance : (3 + 2 L, 3 + 2 L) ndarray
        Joint, of final pose and landmarks, additive.
    """

    pose: Array
    ids: np.ndarray
    positions: Array
    covariance: Array


def solve(prior: Prior, linear: Linearizations) -> OracleSolution:
    """Solve the linear problem of a filter.

    Parameters
    ----------
    prior : Prior
        Of the first pose.
    linear : Linearizations
        As the filter gives them.

    Returns
    -------
    OracleSolution
    """
    # Unknowns are differences from reference points, so that nothing is lost to large numbers.
    reference = linear.motion_to
    ids = linear.landmark[linear.new]
    anchor = dict(zip(ids.tolist(), linear.point[linear.new][:, 3:], strict=True))
    graph = gtsam.GaussianFactorGraph()
    jacobian = linear.motion_jacobian
    first = geo.congruence(jacobian[0], prior.covariance) + linear.motion_noise[0]
    _add(graph, [(pose_key(0), np.eye(3))], np.zeros(3), first)
    for k in range(1, len(reference)):
        drift = geo.additive_error(linear.motion_from[k], reference[k - 1])
        terms = [(pose_key(k - 1), -jacobian[k]), (pose_key(k), np.eye(3))]
        _add(graph, terms, jacobian[k] @ drift, linear.motion_noise[k])
    for i in range(len(linear.row)):
        k, landmark = int(linear.step[i]), int(linear.landmark[i])
        H, point = linear.jacobian[i], linear.point[i]
        from_reference = geo.additive_error(point[:3], reference[k])
        if linear.new[i]:
            terms = [(pose_key(k), -H[:, :3]), (landmark_key(landmark), np.eye(2))]
            right = H[:, :3] @ from_reference
        else:
            terms = [(pose_key(k), H[:, :3]), (landmark_key(landmark), H[:, 3:])]
            away = point[3:] - anchor[landmark]
            right = linear.innovation[i] - H[:, :3] @ from_reference + H[:, 3:] @ away
        _add(graph, terms, right, linear.noise[i])
    return _solution(graph, reference[-1], ids, anchor)


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
    graph: gtsam.GaussianFactorGraph, pose: Array, ids: np.ndarray, anchor: dict[int, Array]
) -> OracleSolution:
    """Eliminate all poses but the last, then solve what remains densely."""
    keys = [key for key in graph.keyVector() if gtsam.Symbol(key).chr() == ord("x")]
    last = max(keys)
    early = gtsam.Ordering()
    for key in sorted(keys)[:-1]:
        early.push_back(key)
    _, rest = graph.eliminatePartialSequential(early, gtsam.EliminateQR)
    order = gtsam.Ordering()
    for key in (last, *(landmark_key(int(i)) for i in ids)):
        order.push_back(key)
    A, b = rest.jacobian(order)
    _, R = np.linalg.qr(np.column_stack([A, b]))
    size = A.shape[1]
    R, d = R[:size, :size], R[:size, size]
    inverse = np.linalg.inv(R)
    x = inverse @ d
    positions = np.array([anchor[int(i)] for i in ids]).reshape(-1, 2)
    return OracleSolution(
        geo.additive_error(np.zeros(3), pose + x[:3]),
        ids,
        positions + x[3:].reshape(-1, 2),
        inverse @ inverse.T,
    )
