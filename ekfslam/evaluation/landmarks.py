"""Which estimated landmark is held against which true one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

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
    """Rows of points and of truth, paired."""
    finite = np.flatnonzero(np.isfinite(points).all(axis=1))
    apart = points[finite, None] - truth
    with np.errstate(over="ignore"):
        cost = np.minimum(np.sum(apart**2, axis=-1), radius**2)
    rows, columns = linear_sum_assignment(cost)
    near = cost[rows, columns] < radius**2
    return finite[rows[near]], columns[near]


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
    in_map = np.empty(0, np.int64) if dataset.true_map is None else dataset.true_map.ids
    true = in_map if origin is None else np.union1d(in_map, origin)
    return np.where(np.isin(ids, true), ids, NO_LANDMARK)


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
