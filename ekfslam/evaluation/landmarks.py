"""Which estimated landmark is which true one, and how many are missed or spurious."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ekfslam.dataset import Dataset
from ekfslam.estimates import Decision, Estimate, LandmarkEstimates
from ekfslam.geometry import Array
from ekfslam.observations import NO_LANDMARK


class LandmarkMatch(NamedTuple):
    """Estimated landmarks against true ones.

    Attributes
    ----------
    true_landmark : (L,) ndarray of int
        True identity of each estimated landmark, -1 for none.
    true : int or None
        True landmarks that were observed at least once in the data.
    missed : int or None
        Those of them that no estimated landmark is matched with.
    spurious : int or None
        Estimated landmarks that are matched with no true one.

    A count is None where what it needs is not known.
    """

    true_landmark: np.ndarray
    true: int | None = None
    missed: int | None = None
    spurious: int | None = None


def match_landmarks(dataset: Dataset, estimate: Estimate) -> LandmarkMatch:
    """Match the estimated landmarks with the true ones, never by position.

    With known association the identities are the dataset's and match themselves. Otherwise an
    estimated landmark is taken for the true landmark that most of the observations assigned to it
    (accepted or new) came from; of equally many the lowest identity wins, and clutter loses
    against any landmark. If several estimated landmarks claim the same true one, the one with most
    of its sightings has it (of equally many the lowest identity) and the others are spurious.
    Without the true origin of the observations nothing is matched or counted.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate

    Returns
    -------
    LandmarkMatch
        With no rows, and only the count `true`, if the estimate has no map.
    """
    landmarks = estimate.landmarks
    ids = np.empty(0, dtype=np.int64) if landmarks is None else landmarks.ids
    origin = _origin(dataset)
    nothing = np.full(len(ids), NO_LANDMARK)
    if origin is None:
        return LandmarkMatch(nothing)
    observed = np.unique(origin[origin >= 0])
    if landmarks is None:
        return LandmarkMatch(nothing, len(observed))
    if identities_shared(dataset, estimate):
        # A map given in advance holds landmarks that were never seen; they are not spurious.
        in_map = np.empty(0, np.int64) if dataset.true_map is None else dataset.true_map.ids
        true = np.where(np.isin(ids, np.union1d(observed, in_map)), ids, NO_LANDMARK)
    elif estimate.innovations is not None:
        true = _match_by_majority(ids, estimate, origin)
    else:
        return LandmarkMatch(nothing, len(observed))
    missed = int((~np.isin(observed, true)).sum())
    return LandmarkMatch(true, len(observed), missed, int((true == NO_LANDMARK).sum()))


def identities_shared(dataset: Dataset, estimate: Estimate) -> bool:
    """Whether the landmarks of the estimate carry the dataset's identities."""
    if estimate.association:
        return estimate.association == "known"
    return dataset.association_known


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


def _origin(dataset: Dataset) -> np.ndarray | None:
    """True identity of every observation, -1 for clutter; None where not known."""
    if dataset.true_landmark is not None:
        return dataset.true_landmark
    return dataset.observations.landmark if dataset.association_known else None


def _match_by_majority(ids: np.ndarray, estimate: Estimate, origin: np.ndarray) -> np.ndarray:
    innovations = estimate.innovations
    assert innovations is not None
    used = np.isin(innovations.decision, (Decision.ACCEPTED, Decision.NEW))
    used &= np.isin(innovations.landmark, ids)
    pairs = np.column_stack([innovations.landmark, origin])[used]
    pairs, counts = np.unique(pairs, axis=0, return_counts=True)
    best = _best(pairs[:, 0], -counts, pairs[:, 1] < 0, pairs[:, 1])
    best = best[pairs[best, 1] >= 0]
    pairs, counts = pairs[best], counts[best]
    best = _best(pairs[:, 1], -counts, pairs[:, 0])
    true_of = dict(pairs[best].tolist())
    return np.array([true_of.get(i, NO_LANDMARK) for i in ids.tolist()], dtype=np.int64)


def _best(group: np.ndarray, *keys: np.ndarray) -> np.ndarray:
    """Row of each group that comes first when ordered by the keys, the first key first."""
    order = np.lexsort((*reversed(keys), group))
    _, first = np.unique(group[order], return_index=True)
    return order[first]
