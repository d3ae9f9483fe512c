"""Which estimated landmark is held against which true one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ekfslam import geometry as geo
from ekfslam.checks import checked_number
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.estimates import Estimate, LandmarkEstimates
from ekfslam.geometry import Array
from ekfslam.observations import NO_LANDMARK

MATCH_RADIUS = 1.0
"""Distance [m] up to which an estimated landmark is held against a true one."""


def match_landmarks(
    dataset: Dataset,
    estimate: Estimate,
    radius: float = MATCH_RADIUS,
    motion: ArrayLike = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """True landmark that each estimated one is held against.

    With known association the identities are the dataset's and match themselves, at any distance.
    Otherwise the pairs are those of one assignment between the estimated and the true positions:
    the one of least cost, where a pair costs its squared distance and a landmark left alone the
    square of the radius (the cut-off distance of Schuhmacher et al. 2008, order 2). So no pair is
    farther apart than the radius, and every landmark is in one pair at most. True landmarks that
    were never observed take no part; where the origin of the observations is not known, all do.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
    radius : float
        Largest distance of a pair [m].
    motion : (3,) array_like
        Applied to the estimated positions first, see `ekfslam.evaluation.frame_motion`.

    Returns
    -------
    (L,) ndarray of int
        True identities, -1 for none: all of them where there is no true map and association is not
        known. No rows if the estimate has no map.

    Raises
    ------
    InputError
        If the radius is not a positive length.
    """
    if not 0.0 < checked_number(radius, "match_radius") < np.inf:
        raise InputError(f"match_radius must be a positive length [m], got {radius}")
    landmarks = estimate.landmarks
    if landmarks is None:
        return np.empty(0, dtype=np.int64)
    if identities_shared(dataset, estimate):
        return known_identities(dataset, landmarks.ids)
    matched = np.full(len(landmarks), NO_LANDMARK)
    if dataset.true_map is not None:
        origin = origins(dataset)
        there = dataset.true_map.ids
        there = there if origin is None else there[np.isin(there, origin)]
        moved = geo.from_frame(motion, landmarks.positions)
        rows, columns = _assign(moved, true_positions(dataset, there), radius)
        matched[rows] = there[columns]
    return matched


def _assign(points: Array, truth: Array, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of points and of truth, paired.

    Points that no chain of pairs within the radius connects do not compete: each such cluster has
    an assignment of its own, so that a large map costs no more than its clusters.
    """
    pairs = [(np.empty(0, np.int64), np.empty(0, np.int64))]
    for rows, columns in _clusters(points, truth, radius):
        cost = np.minimum(np.sum((points[rows, None] - truth[columns]) ** 2, axis=-1), radius**2)
        i, j = linear_sum_assignment(cost)
        near = cost[i, j] < radius**2
        pairs.append((rows[i[near]], columns[j[near]]))
    found, others = (np.concatenate(column) for column in zip(*pairs, strict=True))
    return found, others


def _clusters(
    points: Array, truth: Array, radius: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Rows of points and of truth that chains of pairs within the radius connect."""
    if not len(truth):
        return
    reach = radius * (1 + 1e-9)  # rounding leaves no pair out
    beside = (points >= truth.min(axis=0) - reach) & (points <= truth.max(axis=0) + reach)
    near = np.flatnonzero(beside.all(axis=1))  # what is not finite is nowhere
    of_truth = cKDTree(truth)
    pairs = cKDTree(points[near]).sparse_distance_matrix(of_truth, reach, output_type="ndarray")
    size = len(points) + len(truth)
    ends = near[pairs["i"]], len(points) + pairs["j"]
    graph = coo_array((np.ones(len(pairs)), ends), shape=(size, size))
    count, which = connected_components(graph, directed=False)
    order = np.argsort(which, kind="stable")  # in each cluster points come before truth
    for members in np.split(order, np.searchsorted(which[order], np.arange(1, count))):
        first = np.searchsorted(members, len(points))
        if 0 < first < len(members):
            yield members[:first], members[first:] - len(points)


def origins(dataset: Dataset) -> np.ndarray | None:
    """True identity of every observation, -1 for clutter and sightings of robots, (M,).

    The identities that the data carry stand for the true ones where those are not stated; None
    where neither is known.
    """
    if dataset.true_landmark is not None:
        return np.where(dataset.observed_robot < 0, dataset.true_landmark, NO_LANDMARK)
    return dataset.observations.landmark if dataset.association_known else None


def identities_shared(dataset: Dataset, estimate: Estimate) -> bool:
    """Whether the landmarks of the estimate carry the dataset's identities."""
    if estimate.association:
        return estimate.association == "known"
    return dataset.association_known


def known_identities(dataset: Dataset, ids: np.ndarray) -> np.ndarray:
    """Identities of the dataset's own, -1 for those that no true landmark carries."""
    origin = origins(dataset)
    # A map given in advance holds landmarks that were never seen; they are true nevertheless.
    true = np.zeros(len(ids), dtype=bool)
    for some in (origin, None if dataset.true_map is None else dataset.true_map.ids):
        if some is not None:
            true |= np.isin(ids, some)
    return np.where(true, ids, NO_LANDMARK)


def map_ids(landmarks: LandmarkEstimates) -> np.ndarray:
    """Identities of a map: of its points, then of its landmarks of open distance, (L + U,)."""
    opened = landmarks.undetermined
    return landmarks.ids if opened is None else np.append(landmarks.ids, opened)


def true_positions(dataset: Dataset, ids: ArrayLike) -> Array:
    """True positions of landmarks [m], (L, 2); NaN where not known.

    Parameters
    ----------
    dataset : Dataset
    ids : (L,) array_like of int
        True identities, -1 for none.
    """
    ids = np.asarray(ids)
    positions = np.full((len(ids), 2), np.nan)
    if dataset.true_map is not None:
        _, rows, columns = np.intersect1d(ids, dataset.true_map.ids, return_indices=True)
        positions[rows] = dataset.true_map.positions[columns]
    return positions


def common_landmarks(
    first: LandmarkEstimates, second: LandmarkEstimates
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the landmarks that two estimates share by identity, paired."""
    _, rows, others = np.intersect1d(first.ids, second.ids, return_indices=True)
    return rows, others
