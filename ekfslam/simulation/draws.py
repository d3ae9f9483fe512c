"""Random streams, and draws shaped by covariances."""

from __future__ import annotations

import numpy as np

from ekfslam.geometry import Array
from ekfslam.robots import LandmarkMap

# First numbers of the keys of streams; sensor n has SENSORS + n.
CONTROL, START, POLICY, SENSORS = range(4)
# Purposes of further streams.
ROBOTS, CLUTTER, DESCRIPTORS, MISTAKES, COMPONENTS, KNOWN_MAP = range(6)


def stream(seed: int, first: int, robot: int = 0, *purpose: int) -> np.random.Generator:
    """A random stream of its own for each key, whatever other streams are drawn from.

    Parameters
    ----------
    seed : int
        Of the run.
    first : int
        `CONTROL`, `START`, `POLICY` (which landmarks), or `SENSORS` plus the sensor's number.
    robot : int
    *purpose : int
        Of a further stream, such as `CLUTTER`.
    """
    key = (first, robot, *purpose) if robot or purpose else (first,)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def shaped(covariances: Array, draws: Array) -> Array:
    """Standard normal draws (m, n) with covariances (m, n, n), which may be singular.

    The symmetric square root is unique, so that the draw does not hang on a library's choice.
    """
    values, vectors = np.linalg.eigh(covariances)
    along = np.einsum("mji,mj->mi", vectors, draws) * np.sqrt(np.maximum(values, 0.0))
    return np.einsum("mij,mj->mi", vectors, along)


def part_of(world: LandmarkMap, share: float, seed: int) -> LandmarkMap | None:
    """So many landmarks of a world, picked at random and in its order; none at all for a share 0.

    Parameters
    ----------
    world : LandmarkMap
    share : float
        From 0 to 1.
    seed : int
        Of the run.
    """
    if share == 0:
        return None
    count = round(share * len(world))
    if count == len(world):
        return world
    rows = stream(seed, POLICY, 0, KNOWN_MAP).choice(len(world), count, replace=False)
    rows.sort()
    return LandmarkMap(world.ids[rows], world.positions[rows])
