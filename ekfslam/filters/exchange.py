"""Between a filter's own state and the exchange convention: additive (x, y, theta) in the world."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Prior
from ekfslam.filters.measure import POINT, POSE
from ekfslam.filters.variants import INVARIANT, ROBOCENTRIC
from ekfslam.filters.variants.robocentric import BASE, MAP, pose_of
from ekfslam.geometry import Array


def starting(variant: int, priors: Sequence[Prior]) -> list[Prior]:
    """Poses that a filter's state starts with.

    Parameters
    ----------
    variant : int
        Of `ekfslam.filters.variants`.
    priors : sequence of Prior
        Of the robots, additive in the world.

    Returns
    -------
    list of Prior
        In the error coordinates of the filter. A right-invariant one has its origin where the prior
        has its mean, so that errors are additive there. A robocentric one has the increment, and
        the pose of the start in the frame of the robot; its origin is the mean of the prior.
    """
    if variant == INVARIANT:
        (prior,) = priors
        return [Prior(prior.mean * [0.0, 0.0, 1.0], prior.covariance)]
    if variant == ROBOCENTRIC:
        (prior,) = priors
        back = geo.heading_block(-prior.mean[2])
        return [Prior(), Prior(np.zeros(POSE), geo.congruence(back, prior.covariance))]
    return list(priors)


def exchanged(variant: int, mean: Array, P: Array, first: Array) -> tuple[Array, Array]:
    """Mean and joint covariance of poses and map, additive in the world, O(n^2).

    Parameters
    ----------
    variant : int
    mean : (n,) ndarray
    P : (n, n) ndarray
        Full.
    first : (>= 3,) ndarray
        Of a filter with an origin of its own, the mean of the prior. A robocentric one must be
        between two steps.

    Returns
    -------
    (m,) ndarray, (m, m) ndarray
        Poses first, then the map; a robocentric state is shorter by the increment.
    """
    if variant == INVARIANT:
        turn = np.zeros(len(mean))
        turn[:2] = geo.perpendicular(mean[:2])
        turn[POSE:] = geo.perpendicular(mean[POSE:].reshape(-1, POINT)).reshape(-1)
        half = np.outer(turn, P[2] + 0.5 * P[2, 2] * turn)
        origin = np.zeros(len(mean))
        origin[:2] = first[:2]
        origin[POSE:] = np.resize(first[:2], len(mean) - POSE)
        return mean + origin, P + half + half.T
    if variant == ROBOCENTRIC:
        return _from_robot(mean, P, first[:POSE])
    return mean, P


def _from_robot(mean: Array, P: Array, start: Array) -> tuple[Array, Array]:
    """A robocentric state in the world, see `ekfslam.filters.variants.robocentric`."""
    pose, covariance = np.empty(POSE), np.empty((POSE, POSE))
    pose_of(start, mean, P, pose, covariance)
    points = geo.from_frame(pose, mean[MAP:].reshape(-1, POINT))
    R = geo.rotation(pose[2])
    # With respect to the pose of the start: that of the robot, and that of each landmark.
    A = np.zeros((POSE, POSE))
    A[:2, :2], A[:2, 2], A[2, 2] = -R, -geo.perpendicular(pose[:2] - start[:2]), -1.0
    B = np.broadcast_to(A[:2], (len(points), POINT, POSE)).copy()
    B[:, :, 2] -= geo.perpendicular(points - pose[:2])
    B = np.concatenate([A, B.reshape(-1, POSE)])
    L = len(points)
    both = P[BASE:, BASE:]
    rotated = np.zeros_like(both)  # what the landmarks have by themselves
    cross = both[:POSE, POSE:].reshape(POSE, L, POINT) @ R.T
    rotated[:POSE, POSE:] = cross.reshape(POSE, -1)
    own = both[POSE:, POSE:].reshape(L, POINT, L, POINT)
    own = np.einsum("ab,ibjc,dc->iajd", R, own, R, optimize=True)
    half = B @ (0.5 * both[:POSE, :POSE] @ B.T + rotated[:POSE])
    joint = half + half.T
    joint[POSE:, POSE:] += own.reshape(2 * L, 2 * L)
    return np.concatenate([pose, points.reshape(-1)]), joint
