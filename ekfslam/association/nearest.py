"""Nearest neighbour in innovation distance, with individual compatibility and two gates."""

from __future__ import annotations

import numpy as np

from ekfslam.compiled import compiled

NEW, AMBIGUOUS = -1, -2


@compiled
def nearest_neighbour(distances: np.ndarray, accept: float, new: float, choice: np.ndarray) -> None:
    """Choose a landmark for each observation of a step (Solà, C.3; gates of Bailey et al. 2006).

    Each observation takes its nearest landmark if that is inside the accept gate; it is new if
    even the nearest is outside the gate for new landmarks, and ambiguous in between. A landmark
    claimed twice goes to the nearer claim, and the other is ambiguous: one sensor sees a landmark
    once.

    Parameters
    ----------
    distances : (m, L) ndarray
        Squared Mahalanobis distance of the innovation of observation i with landmark j; infinite
        for a pair that is out of the question.
    accept, new : float
        Gates on that squared distance.
    choice : (m,) ndarray of int
        Written: index of the landmark, or `NEW`, or `AMBIGUOUS`.
    """
    for i in range(distances.shape[0]):
        choice[i] = NEW
        nearest = np.inf
        for j in range(distances.shape[1]):
            if distances[i, j] < nearest:
                nearest = distances[i, j]
                choice[i] = j
        if nearest > new:
            choice[i] = NEW
        elif nearest > accept:
            choice[i] = AMBIGUOUS
    for i in range(distances.shape[0]):
        for other in range(i):
            if choice[i] >= 0 and choice[i] == choice[other]:
                j = choice[i]
                farther = i if distances[i, j] >= distances[other, j] else other
                choice[farther] = AMBIGUOUS
