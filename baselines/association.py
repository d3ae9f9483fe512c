"""Who saw whom, as a graph takes it: from the dataset, or from a filter's decisions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Decision, Estimate, Innovations
from ekfslam.observations import NO_LANDMARK
from ekfslam.robots import LandmarkMap


@dataclass(frozen=True)
class Association:
    """Which landmark each observation belongs to, for the graph.

    Attributes
    ----------
    landmark : (M,) ndarray of int
        Identity, -1 for an observation that shows no landmark or is not used.
    robots : (M,) ndarray of bool
        Which observations of robots are used.
    name : str
        "known", or the method of the estimate that decided.
    notes : tuple of str
        What there is to say of it.
    """

    landmark: np.ndarray
    robots: np.ndarray
    name: str
    notes: tuple[str, ...] = ()

    @classmethod
    def known(cls, dataset: Dataset) -> Association:
        """Identities of the dataset."""
        return cls(dataset.sightings.landmark, dataset.sightings.target >= 0, "known")

    @classmethod
    def of(cls, estimate: Estimate) -> Association:
        """Decisions of an online estimate: what it used of the landmarks that it kept.

        A landmark that is not in its final map was deleted for a reason, and is left out.

        Raises
        ------
        UnsupportedError
            If the estimate has no innovations or no map.
        """
        innovations, landmarks = estimate.innovations, estimate.landmarks
        if innovations is None or landmarks is None:
            raise UnsupportedError(f"{estimate.estimator} made no associations")
        named = innovations.landmark >= 0
        accepted = innovations.decision == Decision.ACCEPTED
        met = named & (accepted | np.isin(innovations.decision, [Decision.NEW, Decision.DELAYED]))
        final = landmarks.ids
        if landmarks.undetermined is not None:
            final = np.concatenate([final, landmarks.undetermined])
        kept = met & np.isin(innovations.landmark, final)
        gone = len(np.unique(innovations.landmark[met & ~kept]))
        note = f"landmarks not in the final map of {estimate.estimator}: {gone} left out"
        return cls(
            np.where(kept, innovations.landmark, -1),
            accepted & ~named,
            estimate.association,
            (note,) if gone else (),
        )

    @classmethod
    def on(cls, known: LandmarkMap, shown: np.ndarray, name: str) -> Association:
        """Sightings of the landmarks of a known map, and of nothing else.

        Parameters
        ----------
        known : LandmarkMap
        shown : (M,) ndarray of int
            Identity of what each observation shows.
        name : str
        """
        landmark = np.where(np.isin(shown, known.ids), shown, NO_LANDMARK)
        return cls(landmark, np.zeros(len(shown), dtype=bool), name)

    @property
    def rows(self) -> np.ndarray:
        """Observations that are used."""
        return np.flatnonzero((self.landmark >= 0) | self.robots)

    def record(self, entry: Mapping[int, int], lost: Sequence[int] = ()) -> Innovations:
        """What a smoother made of each observation: it decides, but it has no innovations.

        Parameters
        ----------
        entry : mapping of int to int
            Row at which each landmark of the graph entered it. Rows of this landmark before it
            were kept back until then; a landmark that is not here is not in the graph.
        lost : sequence of int
            Rows that were kept back, and could not be used then.
        """
        count = len(self.landmark)
        rows = np.arange(count)
        entered = np.array([entry.get(i, count) for i in self.landmark.tolist()], dtype=np.int64)
        inside = entered < count
        inside[list(lost)] = False
        decision = np.full(count, Decision.REJECTED, dtype=np.int64)
        decision[inside | self.robots] = Decision.ACCEPTED
        decision[inside & (rows < entered)] = Decision.DELAYED
        decision[inside & (rows == entered)] = Decision.NEW
        return Innovations(
            decision,
            np.where(inside, self.landmark, -1),
            np.full((count, 2), np.nan),
            np.full((count, 2, 2), np.nan),
        )
