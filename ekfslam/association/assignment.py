"""Global nearest neighbour: one assignment for all observations of a look."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ekfslam.association.nearest import AMBIGUOUS, NEW


def global_nearest_neighbour(
    distances: NDArray[np.float64], accept: NDArray[np.float64], new: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Assign observations to landmarks one to one at the smallest total cost.

    A match costs its squared distance, and an observation without one costs its accept gate, as
    if a new landmark stood there: a match is never taken beyond the gate, and one more is taken
    wherever the sum of distances allows. An observation without a match is new if its nearest
    landmark is outside the gate for new landmarks, else ambiguous.

    Parameters
    ----------
    distances : (m, C) ndarray
        Squared Mahalanobis distance of the innovation of observation i with landmark j; infinite
        or NaN for a pair that is out of the question.
    accept, new : (m,) ndarray
        Gates on that squared distance.

    Returns
    -------
    (m,) ndarray of int
        Index of the landmark, or `NEW`, or `AMBIGUOUS`.
    """
    from scipy.optimize import linear_sum_assignment

    known = np.where(np.isnan(distances), np.inf, distances)
    choice = np.where(known.min(axis=1, initial=np.inf) > new, NEW, AMBIGUOUS)
    # Relative to the cost of no match, pairs beyond the gate cost nothing: they stand for none.
    rows, columns = linear_sum_assignment(np.minimum(known - accept[:, None], 0.0))
    matched = known[rows, columns] <= accept[rows]
    choice[rows[matched]] = columns[matched]
    return choice
