"""What is said of a set of particles: paths from the ancestry, the map, who was seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekfslam.association.nearest import AMBIGUOUS
from ekfslam.compiled import compiled
from ekfslam.estimates import Decision, Innovations, LandmarkEstimates, Trajectory
from ekfslam.filters.fastslam.gaussians import moments
from ekfslam.filters.fastslam.particles import PAGE, Cloud, Maps, Paths
from ekfslam.filters.fastslam.step import Log
from ekfslam.geometry import Array, wrap


@compiled
def look_back(paths, nodes, weights, means, covariances):  # type: ignore[no-untyped-def]
    """Mean and covariance of the ancestors of all particles at every step, O(K N).

    Parameters
    ----------
    paths : Paths
    nodes : (N,) ndarray of int
        Where the paths end.
    weights : (N,) ndarray
        Of the particles in the end.
    means : (K + 1, 3), covariances : (K + 1, 3, 3) ndarray
        Written.
    """
    present, poses = nodes.copy(), np.empty((nodes.size, 3))
    for k in range(means.shape[0] - 1, -1, -1):
        for i in range(present.size):
            poses[i] = paths.poses[present[i]]
            present[i] = paths.parent[present[i]]
        moments(poses, weights, means[k], covariances[k])


def smoothed(cloud: Cloud, paths: Paths, steps: int) -> Trajectory:
    """The path of the particles from all measurements: each step from the ancestors of the last.

    Few ancestors of early steps have descendants left, so their covariance is too small, and zero
    where all descend from one.
    """
    means, covariances = np.empty((steps, 3)), np.empty((steps, 3, 3))
    look_back(paths, cloud.nodes, cloud.weights, means, covariances)
    return Trajectory(means, covariances)


def particle_of_each_step(paths: Paths, node: int, steps: int) -> np.ndarray:
    """Which particle, at each step (K + 1,), is the ancestor that a path has there."""
    line = np.empty(steps, dtype=np.int64)
    for k in range(steps - 1, -1, -1):
        line[k], node = paths.particle[node], paths.parent[node]
    return line


class Mixture(NamedTuple):
    """Mean and covariance of all particles together: of the pose, and of their landmarks."""

    landmarks: LandmarkEstimates
    joint: Array


def mixture(cloud: Cloud, maps: Maps, ids: np.ndarray) -> Mixture:
    """The map where identities are known: landmarks have the same index in all particles.

    The covariance is that between the particles, and in its landmark blocks the mean of those
    within; it has the rank of the number of particles beyond those blocks.

    Parameters
    ----------
    cloud : Cloud
    maps : Maps
    ids : (L,) ndarray of int
        Identity of each name.
    """
    particles, count = len(cloud.weights), int(maps.used[0])
    names = maps.landmarks(0)[1]
    order, w = np.argsort(names), cloud.weights
    gaussians, ids = maps.gaussians[maps.table[:, order // PAGE], order % PAGE], ids[names[order]]
    within = np.einsum("i,ilc->lc", w, gaussians[:, :, 2:])
    heading = np.arctan2(w @ np.sin(cloud.poses[:, 2]), w @ np.cos(cloud.poses[:, 2]))
    points = gaussians[:, :, :2].reshape(particles, 2 * count)
    centre = w @ points
    turn = wrap(cloud.poses[:, 2:] - heading)
    places = cloud.poses[:, :2] - w @ cloud.poses[:, :2]
    apart = np.sqrt(w)[:, None] * np.hstack([places, turn, points - centre])
    joint = apart.T @ apart
    x, y = 3 + 2 * np.arange(count), 4 + 2 * np.arange(count)
    joint[x, x] += within[:, 0]
    joint[x, y] += within[:, 1]
    joint[y, x] += within[:, 1]
    joint[y, y] += within[:, 2]
    own = np.stack([x, y], axis=1)
    return Mixture(
        LandmarkEstimates(
            ids, centre.reshape(-1, 2), joint[own[:, :, None], own[:, None, :]], joint[3:, 3:]
        ),
        joint,
    )


def map_of_one(maps: Maps, particle: int) -> LandmarkEstimates:
    """The map of one particle: its covariances are those given its path."""
    gaussians, names = maps.landmarks(particle)
    order = np.argsort(names)
    g = gaussians[order]
    covariances = g[:, [2, 3, 3, 4]].reshape(-1, 2, 2)
    return LandmarkEstimates(names[order].astype(np.int64), g[:, :2], covariances)


def innovations(log: Log, names: np.ndarray, ids: np.ndarray | None) -> Innovations:
    """What each observation met.

    Parameters
    ----------
    log : Log
    names : (M,) ndarray of int
        What each row was taken for: the name of a landmark, or a negative code.
    ids : (L,) ndarray of int or None
        Identities of the names; where there are none, a name is the row that mapped the landmark.
    """
    seen = names >= 0
    new = np.zeros(len(names), dtype=bool)
    new[np.unique(names, return_index=True)[1]] = True
    decision = np.full(len(names), Decision.ACCEPTED, dtype=np.int64)
    decision[new] = Decision.NEW
    decision[~seen] = Decision.REJECTED
    decision[names == AMBIGUOUS] = Decision.AMBIGUOUS
    landmark = np.full(len(names), -1, dtype=np.int64)
    landmark[seen] = names[seen] if ids is None else ids[names[seen]]
    used = (decision == Decision.ACCEPTED)[:, None]
    innovation = np.where(used, log.innovation, np.nan)
    return Innovations(decision, landmark, innovation, np.where(used[..., None], log.S, np.nan))
