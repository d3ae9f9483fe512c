"""What particles are made of: poses and weights, maps that share pages, paths that share ancestors.

A particle's map is a row of a table: which page holds its landmarks 0 to 7, which the next eight,
and so on. Particles that descend from one another share pages, and a page counts its owners: who
wants to write takes a copy of a page that is not its own alone. So to duplicate a particle of n
landmarks costs n / 8 numbers, not n Gaussians, and what follows is paid for by what is touched. A
tree (Montemerlo et al. 2002) copies O(log n), but each of its reads goes through log n nodes, and
eight thousand landmarks would have to be mapped before the row of the table is as long as eight
landmarks are large.

Paths are a forest: a node is a pose and points to the one before. Where a line of descent ends,
its nodes are used again, so that the memory for all paths is what the particles do not share.

Pages and nodes come from arrays that are large enough for particles that share nothing; the
operating system gives memory for what has been touched.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekfslam.compiled import compiled
from ekfslam.geometry import Array

PAGE = 8  # landmarks on a page
GAUSSIAN = 5  # of a landmark: x, y, and xx, xy, yy of its covariance
NONE = -1


class Cloud(NamedTuple):
    """The particles without their maps.

    Attributes
    ----------
    poses : (N, 3) ndarray
    log_weights, weights : (N,) ndarray
        After every step normalised, the weights being their exponentials.
    nodes : (N,) ndarray of int
        Where the path of each ends.
    """

    poses: Array
    log_weights: Array
    weights: Array
    nodes: np.ndarray

    @classmethod
    def of(cls, poses: Array) -> Cloud:
        """Particles of equal weight."""
        count = len(poses)
        nodes = np.full(count, NONE, dtype=np.int32)
        equal = np.full(count, 1.0 / count)
        return cls(np.ascontiguousarray(poses), np.log(equal), equal, nodes)


class Maps(NamedTuple):
    """The landmarks of all particles.

    Attributes
    ----------
    table : (N, W) ndarray of int
        Page of each particle's landmarks 8 w to 8 w + 7, `NONE` for none.
    used : (N,) ndarray of int
        Landmarks of each particle.
    gaussians : (N W, 8, 5) ndarray
        Mean and covariance (x, y, xx, xy, yy) of each landmark on each page.
    names : (N W, 8) ndarray of int
        Identity of the landmark.
    evidence : (N W, 8) ndarray of int
        Looks in which it was seen less those in which it should have been.
    owners : (N W,) ndarray of int
        Entries of the table that name the page.
    free : (N W,) ndarray of int
        Pages that are to be used again.
    marks : (2,) ndarray of int
        How many those are, and how many pages have ever been used.
    """

    table: np.ndarray
    used: np.ndarray
    gaussians: Array
    names: np.ndarray
    evidence: np.ndarray
    owners: np.ndarray
    free: np.ndarray
    marks: np.ndarray

    @classmethod
    def of(cls, particles: int, landmarks: int) -> Maps:
        """Empty maps with room for so many landmarks in each."""
        width = -(-max(landmarks, 1) // PAGE)
        pages = particles * width
        return cls(
            np.full((particles, width), NONE, dtype=np.int32),
            np.zeros(particles, dtype=np.int64),
            np.empty((pages, PAGE, GAUSSIAN)),
            np.empty((pages, PAGE), dtype=np.int32),
            np.empty((pages, PAGE), dtype=np.int32),
            np.empty(pages, dtype=np.int32),
            np.empty(pages, dtype=np.int32),
            np.zeros(2, dtype=np.int64),
        )

    @property
    def room(self) -> int:
        """Landmarks that a particle can have."""
        return self.table.shape[1] * PAGE

    def grown(self, landmarks: int) -> Maps:
        """The same maps with room for more landmarks in each."""
        larger = Maps.of(len(self.used), landmarks)
        for old, new in zip(self[2:7], larger[2:7], strict=True):
            new[: len(old)] = old
        larger.table[:, : self.table.shape[1]] = self.table
        return larger._replace(used=self.used, marks=self.marks)

    def landmarks(self, particle: int) -> tuple[Array, np.ndarray]:
        """Gaussians (n, 5) and names (n,) of the landmarks of one particle."""
        index = np.arange(self.used[particle])
        at = self.table[particle, index // PAGE], index % PAGE
        return self.gaussians[at], self.names[at]


class Paths(NamedTuple):
    """Where the particles came from.

    Attributes
    ----------
    poses : (C, 3) ndarray
        Of each node.
    parent : (C,) ndarray of int
        Node of the step before, `NONE` at the first.
    particle : (C,) ndarray of int
        Which particle it was.
    owners, free, marks
        As of `Maps`; a node's owners are its children and the particles whose path ends there.
    """

    poses: Array
    parent: np.ndarray
    particle: np.ndarray
    owners: np.ndarray
    free: np.ndarray
    marks: np.ndarray

    @classmethod
    def of(cls, particles: int, steps: int) -> Paths:
        """No paths yet, with room for so many steps."""
        nodes = particles * steps
        whole = [np.empty(nodes, dtype=np.int32) for _ in range(4)]
        return cls._make([np.empty((nodes, 3)), *whole, np.zeros(2, dtype=np.int64)])


@compiled
def take(free, marks):  # type: ignore[no-untyped-def]
    """A page or node that is not in use."""
    if marks[0] > 0:
        marks[0] -= 1
        return np.int64(free[marks[0]])
    marks[1] += 1
    return marks[1] - 1


@compiled
def give(free, marks, index):  # type: ignore[no-untyped-def]
    """Give a page or node back."""
    free[marks[0]] = index
    marks[0] += 1


# Maps --------------------------------------------------------------------------------------------


@compiled
def own_page(maps, particle, entry):  # type: ignore[no-untyped-def]
    """The page of an entry of the table, to write on: a copy, if others have it too."""
    page = maps.table[particle, entry]
    if page >= 0 and maps.owners[page] == 1:
        return np.int64(page)
    own = take(maps.free, maps.marks)
    maps.owners[own] = 1
    maps.table[particle, entry] = own
    if page >= 0:
        maps.owners[page] -= 1
        for k in range(PAGE):
            maps.names[own, k] = maps.names[page, k]
            maps.evidence[own, k] = maps.evidence[page, k]
            for c in range(GAUSSIAN):
                maps.gaussians[own, k, c] = maps.gaussians[page, k, c]
    return own


@compiled
def share_map(maps, source, target):  # type: ignore[no-untyped-def]
    """A particle drops its map and takes that of another, page by page without a copy."""
    for entry in range(maps.table.shape[1]):
        page, old = maps.table[source, entry], maps.table[target, entry]
        if page >= 0:
            maps.owners[page] += 1
        if old >= 0:
            maps.owners[old] -= 1
            if maps.owners[old] == 0:
                give(maps.free, maps.marks, old)
        maps.table[target, entry] = page
    maps.used[target] = maps.used[source]


@compiled
def add_landmark(maps, particle, name):  # type: ignore[no-untyped-def]
    """Room for one more landmark of a particle, seen once; its page and place on it."""
    index = maps.used[particle]
    page, place = own_page(maps, particle, index // PAGE), index % PAGE
    maps.names[page, place], maps.evidence[page, place] = name, 1
    maps.used[particle] += 1
    return page, place


@compiled
def remove_landmark(maps, particle, index):  # type: ignore[no-untyped-def]
    """Forget a landmark of a particle; its last one takes the place."""
    last = maps.used[particle] - 1
    page, place = own_page(maps, particle, index // PAGE), index % PAGE
    other, there = np.int64(maps.table[particle, last // PAGE]), last % PAGE
    maps.names[page, place] = maps.names[other, there]
    maps.evidence[page, place] = maps.evidence[other, there]
    for c in range(GAUSSIAN):
        maps.gaussians[page, place, c] = maps.gaussians[other, there, c]
    maps.used[particle] = last


# Paths -------------------------------------------------------------------------------------------


@compiled
def lengthen(paths, cloud):  # type: ignore[no-untyped-def]
    """Every particle's path goes on to its present pose."""
    for i in range(cloud.nodes.size):
        node = take(paths.free, paths.marks)
        for c in range(3):
            paths.poses[node, c] = cloud.poses[i, c]
        # The child now holds the parent, in the particle's stead.
        paths.parent[node], paths.particle[node], paths.owners[node] = cloud.nodes[i], i, 1
        cloud.nodes[i] = node


@compiled
def share_path(paths, nodes, source, target):  # type: ignore[no-untyped-def]
    """A particle drops its path, with ancestors that nobody else has, and takes another's."""
    paths.owners[nodes[source]] += 1
    node = nodes[target]
    while node >= 0:
        paths.owners[node] -= 1
        if paths.owners[node] > 0:
            break
        give(paths.free, paths.marks, node)
        node = paths.parent[node]
    nodes[target] = nodes[source]


# Weights -----------------------------------------------------------------------------------------


@compiled
def normalise(log_weights, weights):  # type: ignore[no-untyped-def]
    """Weights from their logarithms, which are normalised too.

    Where no particle has a weight above zero, all are made equal; one whose weight is not a number
    has none.

    Parameters
    ----------
    log_weights : (N,) ndarray
    weights : (N,) ndarray
        Written.

    Returns
    -------
    effective : float
        Effective number of samples, ``1 / sum w^2``.
    usable : bool
        False where the weights had to be made equal.
    """
    most = -np.inf
    for i in range(weights.size):
        if np.isnan(log_weights[i]):
            log_weights[i] = -np.inf
        most = max(most, log_weights[i])
    usable = -np.inf < most < np.inf
    if not usable:
        log_weights[:] = most = 0.0
    total = 0.0
    for i in range(weights.size):
        weights[i] = np.exp(log_weights[i] - most)
        total += weights[i]
    squares, shift = 0.0, most + np.log(total)
    for i in range(weights.size):
        weights[i] /= total
        log_weights[i] -= shift
        squares += weights[i] * weights[i]
    return 1.0 / squares, usable


@compiled
def systematic(weights, u, counts):  # type: ignore[no-untyped-def]
    """Low-variance resampling: how often each particle is to be there.

    One draw for all: particle i is drawn as often as points ``(u + j) / N`` fall into its share of
    the weights, so N w_i times, rounded up or down, and in the mean exactly.

    Parameters
    ----------
    weights : (N,) ndarray
        Normalised.
    u : float
        In [0, 1).
    counts : (N,) ndarray of int
        Written.
    """
    n, total, j, last = weights.size, 0.0, 0, 0
    for i in range(n):
        total += weights[i]
        counts[i] = 0
        if weights[i] > 0.0:
            last = i
        while j < n and u + j < total * n:
            counts[i] += 1
            j += 1
    counts[last] += n - j  # where the sum of the weights was rounded down


@compiled
def resample(cloud, maps, paths, u):  # type: ignore[no-untyped-def]
    """Particles of little weight give their places to copies of heavy ones; all weigh the same.

    Survivors stay where they are, and cost nothing.
    """
    n = cloud.weights.size
    counts = np.empty(n, np.int64)
    systematic(cloud.weights, u, counts)
    target = 0
    for source in range(n):
        for _ in range(counts[source] - 1):
            while counts[target] > 0:
                target += 1
            for c in range(3):
                cloud.poses[target, c] = cloud.poses[source, c]
            share_map(maps, source, target)
            share_path(paths, cloud.nodes, source, target)
            target += 1
    cloud.log_weights[:] = -np.log(n)
    cloud.weights[:] = 1.0 / n
