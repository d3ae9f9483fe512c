"""Who was taken for whom, against the truth: precision, recall, duplicates, merges.

What a landmark *stands for* is said by how it came into the map, never by where it is. With known
association it stands for the true landmark whose identity it carries. Otherwise it stands for the
true landmark that was seen in the observation that founded it: the `NEW` one, or the first of those
that were `DELAYED` until it was determined. One that clutter founded stands for nothing. A landmark
that no observation founded was in a map given in advance and stands for the one it is there; an
estimate that makes associations and has no map of its own works on the known map of the dataset.

A landmark is in the map from its founding, or the last delayed observation of it, to the end if the
final map holds it (determined or not), else to the last observation that was used for it: the
record does not say when it was deleted. A founding under an identity that was used before begins
another life.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.estimates import Decision, Estimate
from ekfslam.evaluation.landmarks import identities_shared, known_identities, map_ids, origins
from ekfslam.evaluation.runs import kept_with_estimate
from ekfslam.observations import NO_LANDMARK

_FOUNDING = (Decision.NEW, Decision.DELAYED)
_USED = (Decision.ACCEPTED, *_FOUNDING)
_NO_ROW = -1


class AssociationScores(NamedTuple):
    """What became of each observation; every attribute is (M,) of bool.

    Attributes
    ----------
    scored : ndarray
        Not of a robot. The others are false where this is.
    founded : ndarray
        It founded a landmark.
    accepted : ndarray
        Used for a landmark that had been founded.
    correct : ndarray
        Accepted, by a landmark that stands for its true landmark.
    mapped : ndarray
        Its true landmark was in the map: some landmark stood for it, put there by an earlier row.
        What was rightly kept for a landmark that was delayed counts, too.
    spurious : ndarray
        Clutter that founded a landmark.
    merging : ndarray
        The first of a second true landmark that one estimated landmark took.
    """

    scored: np.ndarray
    founded: np.ndarray
    accepted: np.ndarray
    correct: np.ndarray
    mapped: np.ndarray
    spurious: np.ndarray
    merging: np.ndarray

    @property
    def false(self) -> np.ndarray:
        """Accepted by another landmark, or clutter that was accepted."""
        return self.accepted & ~self.correct

    @property
    def missed(self) -> np.ndarray:
        """Not used although its true landmark was in the map."""
        return self.mapped & ~self.accepted & ~self.founded

    @property
    def duplicates(self) -> np.ndarray:
        """Founded a landmark although its true landmark was in the map: new that was old."""
        return self.mapped & self.founded

    @property
    def precision(self) -> float:
        """Share of the accepted that is correct; NaN if none was accepted."""
        return _share(self.correct, self.accepted)

    @property
    def recall(self) -> float:
        """Share of those with their true landmark in the map that is correct; NaN without any."""
        return _share(self.correct, self.mapped)

    def rows(self, which: np.ndarray) -> AssociationScores:
        """Those of some observations."""
        return AssociationScores(*(column[which] for column in self))


def association_scores(dataset: Dataset, estimate: Estimate) -> AssociationScores | None:
    """Score every association of an estimate, in the order of the dataset's rows.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate

    Returns
    -------
    AssociationScores or None
        None if the origin of the observations is not known or the estimate kept no innovations.
    """
    origin, met = origins(dataset), estimate.innovations
    if origin is None or met is None:
        return None
    lives = _lives(dataset, estimate)
    scored = dataset.observed_robot < 0
    founded = np.zeros(len(origin), dtype=bool)
    founded[lives.founder[lives.founder >= 0]] = True
    accepted = (lives.of_row >= 0) & ~founded
    whom = np.append(lives.whom, NO_LANDMARK)[lives.of_row]
    correct = accepted & (whom == origin) & (origin >= 0)
    return AssociationScores(
        scored,
        founded,
        accepted,
        correct,
        correct | _mapped(lives, origin),
        founded & (origin < 0),
        lives.merging,
    )


class LandmarkCounts(NamedTuple):
    """The final map, of landmarks determined and not, against the landmarks that were there.

    Landmarks of the map = (true - missed) + duplicate + spurious, but for those of a map given in
    advance that were never observed. A count is None where what it needs is not known.

    Attributes
    ----------
    true : int or None
        True landmarks that were observed at least once.
    missed : int or None
        Those of them that no landmark of the map stands for.
    spurious : int or None
        Landmarks of the map that stand for no true one.
    duplicate : int or None
        Landmarks of the map that stand for the same true landmark as another one, but for the
        first.
    merged : int or None
        Landmarks of the map that took observations of two or more true ones.
    """

    true: int | None = None
    missed: int | None = None
    spurious: int | None = None
    duplicate: int | None = None
    merged: int | None = None


def count_landmarks(dataset: Dataset, estimate: Estimate) -> LandmarkCounts:
    """Count what the landmarks of the final map stand for.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate

    Returns
    -------
    LandmarkCounts
        Positions play no part in it.
    """
    origin = origins(dataset)
    if origin is None:
        return LandmarkCounts()
    observed = np.unique(origin[origin >= 0])
    if estimate.landmarks is None:
        return LandmarkCounts(len(observed))
    merged = None
    if estimate.innovations is not None:
        lives = _lives(dataset, estimate)
        merged = int(lives.lasting[lives.of_row[lives.merging]].sum())
        whom = lives.whom[lives.lasting]
    elif identities_shared(dataset, estimate):
        whom = known_identities(dataset, map_ids(estimate.landmarks))
    else:
        return LandmarkCounts(len(observed))
    standing = whom[whom >= 0]
    return LandmarkCounts(
        len(observed),
        int((~np.isin(observed, standing)).sum()),
        len(whom) - len(standing),
        len(standing) - len(np.unique(standing)),
        merged,
    )


# Lives of landmarks -----------------------------------------------------------------------------


class _Lives(NamedTuple):
    """Landmarks from founding to deletion, E of them."""

    whom: np.ndarray  # true landmark that it stands for, -1 for none
    founder: np.ndarray  # row that founded it, -1 for a map given in advance
    entry: np.ndarray  # row that put it into the map, later than the founder if that was delayed
    last: np.ndarray  # last row at which it is in the map; M for one of the final map
    lasting: np.ndarray  # whether the final map holds it
    of_row: np.ndarray  # (M,) life that each observation was used for, -1 for none
    merging: np.ndarray  # (M,) whether it is the first of a second true landmark that a life took


@kept_with_estimate  # scores and counts are of the same lives
def _lives(dataset: Dataset, estimate: Estimate) -> _Lives:
    met, origin = estimate.innovations, origins(dataset)
    assert met is not None
    assert origin is not None
    count = len(origin)
    used = np.flatnonzero(np.isin(met.decision, _USED) & (dataset.observed_robot < 0))
    rows = used[np.argsort(met.landmark[used], kind="stable")]
    ids, decision = met.landmark[rows], met.decision[rows]
    founding = np.isin(decision, _FOUNDING)
    # What follows a delayed observation goes on with the founding, or is used by what it founded.
    begins = founding & (np.roll(decision, 1) != Decision.DELAYED)
    begins |= np.diff(ids, prepend=NO_LANDMARK - 1) != 0
    first = np.flatnonzero(begins)
    of_row = np.full(count, -1)
    of_row[rows] = np.cumsum(begins) - 1
    landmark, founder = ids[first], np.where(founding[first], rows[first], _NO_ROW)
    entry = np.maximum.reduceat(np.where(founding, rows, _NO_ROW), first)
    last = rows[np.append(first[1:], len(rows))[: len(first)] - 1]
    # The final map holds the last life of a landmark, and landmarks that no observation was of.
    lasting = np.append(np.diff(landmark) != 0, True)[: len(landmark)]
    in_map = _final_map(dataset, estimate)
    if in_map is not None:
        lasting &= np.isin(landmark, in_map)
        never = np.setdiff1d(in_map, landmark)
        nobody = np.full(len(never), _NO_ROW)
        landmark, last = np.append(landmark, never), np.append(last, nobody)
        founder, entry = np.append(founder, nobody), np.append(entry, nobody)
        lasting = np.append(lasting, np.ones(len(never), dtype=bool))
    whom = _whom(dataset, estimate, landmark, founder, origin)
    last, merging = np.where(lasting, count, last), _merging(of_row, origin)
    return _Lives(whom, founder, entry, last, lasting, of_row, merging)


def _final_map(dataset: Dataset, estimate: Estimate) -> np.ndarray | None:
    """Identities in the map at the end, None if nothing is known of it."""
    if estimate.landmarks is not None:
        return map_ids(estimate.landmarks)
    return None if dataset.known_map is None else dataset.known_map.ids


def _whom(
    dataset: Dataset,
    estimate: Estimate,
    landmark: np.ndarray,
    founder: np.ndarray,
    origin: np.ndarray,
) -> np.ndarray:
    if identities_shared(dataset, estimate):
        return known_identities(dataset, landmark)
    given = np.empty(0, np.int64) if dataset.known_map is None else dataset.known_map.ids
    itself = np.where(np.isin(landmark, given), landmark, NO_LANDMARK)
    return np.where(founder >= 0, np.append(origin, NO_LANDMARK)[founder], itself)


def _mapped(lives: _Lives, origin: np.ndarray) -> np.ndarray:
    """Whether at each row some landmark stood for the true one, (M,) of bool.

    Lives that began before a row less those that ended before it, counted among the lives that
    stand for one true landmark: keys order lives by true landmark first and then by row.
    """
    true, which = np.unique(origin, return_inverse=True)
    alive = np.isin(lives.whom, true) & (lives.whom >= 0)
    block = np.searchsorted(true, lives.whom[alive]) * (len(origin) + 2)
    starts = np.sort(block + lives.entry[alive] + 1)
    ends = np.sort(block + lives.last[alive] + 1)
    now = which * (len(origin) + 2) + np.arange(len(origin))
    before = [np.searchsorted(keys, now, side="right") for keys in (starts, ends)]
    return before[0] > before[1]


def _merging(of_row: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Whether a life took its second true landmark at a row, (M,) of bool; once per life."""
    rows = np.flatnonzero((of_row >= 0) & (origin >= 0))
    rows = rows[np.argsort(of_row[rows], kind="stable")]
    begins = np.diff(of_row[rows], prepend=-1) != 0
    # The rows of a life whose landmark is not that of its first row, and of those the first.
    other = rows[origin[rows] != origin[rows[begins]][np.cumsum(begins) - 1]]
    merging = np.zeros(len(origin), dtype=bool)
    merging[other[np.diff(of_row[other], prepend=-1) != 0]] = True
    return merging


def _share(part: np.ndarray, whole: np.ndarray) -> float:
    return float(part.sum() / whole.sum()) if whole.any() else float("nan")
