"""Decisions from a table of distances: for each observation of a look, a landmark or none.

Every function writes `choice` (m,): the index of the landmark, or `NEW`, or `AMBIGUOUS`. A pair
whose distance is infinite or NaN is out of the question.
"""

from __future__ import annotations

import numpy as np

from ekfslam.compiled import compiled

NEW, AMBIGUOUS = -1, -2


@compiled
def nearest_of(distances):  # type: ignore[no-untyped-def]
    """Index of the nearest landmark and its distance; `NEW` and infinity if there is none."""
    index, least = NEW, np.inf
    for j in range(distances.size):
        if distances[j] < least:
            index, least = j, distances[j]
    return index, least


@compiled
def settle(claims, choice):  # type: ignore[no-untyped-def]
    """Leave a landmark claimed twice to the smaller claim; the other is ambiguous.

    Parameters
    ----------
    claims : (m,) ndarray
        What each observation's choice costs.
    choice : (m,) ndarray of int
        Changed in place.
    """
    for i in range(choice.size):
        for other in range(i):
            if choice[i] >= 0 and choice[i] == choice[other]:
                choice[i if claims[i] >= claims[other] else other] = AMBIGUOUS


@compiled
def nearest_neighbour(
    distances: np.ndarray, accept: np.ndarray, new: np.ndarray, choice: np.ndarray
) -> None:
    """Nearest neighbour with individual compatibility (Solà, C.3; gates of Bailey et al. 2006).

    Each observation takes its nearest landmark if that is inside the accept gate; it is new if
    even the nearest is outside the gate for new landmarks, and ambiguous in between. A landmark
    claimed twice goes to the nearer claim, and the other is ambiguous: one sensor sees a landmark
    once.

    Parameters
    ----------
    distances : (m, C) ndarray
        Squared Mahalanobis distance of the innovation of observation i with landmark j.
    accept, new : (m,) ndarray
        Gates on that squared distance.
    choice : (m,) ndarray of int
        Written.
    """
    claims = np.empty(choice.size)
    for i in range(choice.size):
        choice[i], claims[i] = nearest_of(distances[i])
        if claims[i] > new[i]:
            choice[i] = NEW
        elif claims[i] > accept[i]:
            choice[i] = AMBIGUOUS
    settle(claims, choice)


@compiled
def nearest_within(euclidean: np.ndarray, threshold: float, choice: np.ndarray) -> None:
    """Nearest landmark within epsilon, else new (notes on Brenner's lectures).

    As in the notes, two observations may claim the same landmark.

    Parameters
    ----------
    euclidean : (m, C) ndarray
        Distance of the point that observation i maps to from landmark j [m].
    threshold : float
        Epsilon [m]; a landmark at that distance is a match.
    choice : (m,) ndarray of int
        Written.
    """
    for i in range(choice.size):
        choice[i], distance = nearest_of(euclidean[i])
        if distance > threshold:
            choice[i] = NEW


@compiled
def first_within(distances: np.ndarray, threshold: float, choice: np.ndarray) -> None:
    """First landmark in the order of the map within the threshold, else new (Ciatto, 3.6).

    As stated there: the first, not the nearest, and two observations may claim the same one.

    Parameters
    ----------
    distances : (m, C) ndarray
        Unsquared distance of the point that observation i maps to from landmark j: Euclidean [m],
        or Mahalanobis in the landmark's own covariance, which leaves out how uncertain the robot
        and the measurement are.
    threshold : float
        D_min, on that unsquared distance; a landmark at that distance is a match.
    choice : (m,) ndarray of int
        Written.
    """
    for i in range(choice.size):
        choice[i] = NEW
        for j in range(distances.shape[1]):
            if distances[i, j] <= threshold:
                choice[i] = j
                break


@compiled
def smallest_distance(distances: np.ndarray, alpha: float, choice: np.ndarray) -> None:
    """Smallest distance, a new landmark's being alpha (Principles of Robot Autonomy, Alg. 2).

    As stated there: one threshold, nothing is ambiguous, and two observations may claim the same
    landmark.

    Parameters
    ----------
    distances : (m, C) ndarray
        Squared Mahalanobis distance of the innovation of observation i with landmark j.
    alpha : float
        On that squared distance; a landmark at that distance is a match.
    choice : (m,) ndarray of int
        Written.
    """
    nearest_within(distances, alpha, choice)  # the same rule, on another distance


@compiled
def maximum_likelihood(
    distances: np.ndarray,
    logdets: np.ndarray,
    accept: np.ndarray,
    new: np.ndarray,
    choice: np.ndarray,
) -> None:
    """Likeliest landmark inside the gate: the smallest ``d^2 + ln det S`` (Blanco et al. 2012).

    This is the maximum likelihood that the text of Principles of Robot Autonomy, 17.2, names;
    without the determinant, as in its Alg. 2, a vague landmark draws the matches of a precise one.
    An observation with no landmark inside the accept gate is new if its nearest is outside the
    gate for new landmarks, else ambiguous. A landmark claimed twice goes to the likelier claim,
    and the other is ambiguous.

    Parameters
    ----------
    distances : (m, C) ndarray
        Squared Mahalanobis distance of the innovation of observation i with landmark j.
    logdets : (m, C) ndarray
        Logarithm of the determinant of that innovation's covariance S.
    accept, new : (m,) ndarray
        Gates on the squared distance.
    choice : (m,) ndarray of int
        Written.
    """
    claims = np.empty(choice.size)
    for i in range(choice.size):
        choice[i], claims[i] = NEW, np.inf
        for j in range(distances.shape[1]):
            if distances[i, j] <= accept[i]:
                claim = distances[i, j] + logdets[i, j]
                if claim < claims[i]:
                    choice[i], claims[i] = j, claim
        if choice[i] == NEW:
            choice[i] = unmatched(distances[i], new[i])
    settle(claims, choice)


@compiled
def unmatched(distances, new):  # type: ignore[no-untyped-def]
    """`NEW` for an observation whose nearest landmark is outside the gate, else `AMBIGUOUS`."""
    return NEW if nearest_of(distances)[1] > new else AMBIGUOUS
