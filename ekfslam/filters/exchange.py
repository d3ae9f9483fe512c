"""Between a filter's own state and the exchange convention: additive (x, y, theta) in the world."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Prior
from ekfslam.estimates import LandmarkEstimates
from ekfslam.filters.arrays import Register
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.filters.measure import INVERSE_DEPTH, POINT, POSE
from ekfslam.filters.options import Settings
from ekfslam.filters.variants import INVARIANT, OF_THEIR_OWN, ROBOCENTRIC, settle_pose
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


def poses_of(slam: GaussianMap, settings: Settings) -> tuple[Array, Array]:
    """Poses of the robots (R, 3), and their joint covariance (3 R, 3 R), additive in the world.

    Parameters
    ----------
    slam : GaussianMap
        In the filter's own coordinates; not changed.
    settings : Settings
    """
    variant, robots = settings.variant, settings.robots
    if variant not in OF_THEIR_OWN:
        return slam.mean[: POSE * robots].reshape(-1, POSE).copy(), slam.block(0, POSE * robots)
    arrays = slam.arrays
    if variant == ROBOCENTRIC:  # as if the step were over; the filter does not notice
        mean, P = arrays.mean[:MAP].copy(), arrays.covariance[:MAP, :MAP].copy()
        arrays = arrays._replace(mean=mean, covariance=P, size=np.array([MAP]))
    pose, covariance = np.empty(POSE), np.empty((POSE, POSE))
    settle_pose(variant, arrays, pose, covariance)
    return pose[None], covariance


def map_of(
    slam: GaussianMap,
    offsets: np.ndarray,
    register: Register,
    settings: Settings,
    ids: np.ndarray,
    surrender: bool,
) -> tuple[LandmarkEstimates, Array]:
    """The map, and the joint covariance (n, n) of poses and map, additive in the world.

    Parameters
    ----------
    slam : GaussianMap
        In the filter's own coordinates.
    offsets : (>= n,) ndarray of int
        Where landmarks stand in it, by register index.
    register : Register
    settings : Settings
    ids : (n,) ndarray of int
        Identity of each register index.
    surrender : bool
        Whether the joint covariance may have the memory of the map, which is then of no more use.
    """
    count, variant = len(ids), settings.variant
    offsets = offsets[:count]
    mapped = (offsets >= 0) & (register.sightings[:count] > 0)
    points = np.flatnonzero(mapped & (register.sizes[:count] == POINT))
    directions = np.flatnonzero(mapped & (register.sizes[:count] == INVERSE_DEPTH))
    where = offsets[points][:, None] + np.arange(POINT)
    beyond = offsets[directions][:, None] + np.arange(INVERSE_DEPTH)
    poses = POSE * settings.robots
    shorter = POSE * (settings.poses - settings.robots)
    where, beyond = where - shorter, beyond - shorter
    order = np.concatenate([np.arange(poses), where.reshape(-1), beyond.reshape(-1)])
    first = slam.arrays.points.first
    if surrender and variant not in OF_THEIR_OWN:
        mean, joint = slam.mean, slam.surrendered(order)
    else:
        mean, whole = exchanged(variant, slam.mean, slam.covariance, first)
        joint = whole[np.ix_(order, order)]
    end = poses + where.size
    blocks = joint[poses:end, poses:end].reshape(len(points), POINT, len(points), POINT)
    return LandmarkEstimates(
        ids[points],
        mean[where].reshape(-1, POINT),
        np.ascontiguousarray(np.einsum("iaib->iab", blocks)),
        joint[poses:end, poses:end],
        ids[directions] if len(directions) else None,
        mean[beyond] if len(directions) else None,
    ), joint
