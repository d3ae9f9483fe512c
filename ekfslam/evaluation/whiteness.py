"""Whether innovations are white: their correlation from one look at a landmark to the next.

Innovations of a consistent filter are uncorrelated in time (Bar-Shalom et al. 2001, 5.4). Each is
whitened by the Cholesky factor of its own covariance S, w = L^-1 nu, and paired with the one of the
same landmark at the next step. With sums over the pairs, of one run or of many,

    ``rho = sum w_k . w_{k+1} / sqrt(sum |w_k|^2  sum |w_{k+1}|^2)``,

which is near N(0, 1 / terms) if all the products are independent. Those of one step share the error
of the pose, so that rho scatters somewhat more than that; the spread between runs says how much.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.estimates import Decision, Estimate
from ekfslam.geometry import Array


class Whiteness(NamedTuple):
    """Sums over the pairs of one run; those of several runs add up.

    Attributes
    ----------
    cross : float
        Of w_k . w_{k+1}.
    before, after : float
        Of ``|w_k|^2`` and of ``|w_{k+1}|^2``.
    terms : int
        Scalar products in `cross`: 2 of a pair of full observations, 1 of bearings or ranges.
    """

    cross: float
    before: float
    after: float
    terms: int


def whiteness(dataset: Dataset, estimate: Estimate, robot: int = 0) -> Whiteness | None:
    """Sums of the whitened innovations of a robot at lag 1.

    A pair is two accepted observations of one landmark (or of one other robot) by one sensor, at
    two steps that follow each other among those at which the sensor saw anything: a sensor that
    looks at every eighth step is paired over eight steps.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
    robot : int
        Whose observations.

    Returns
    -------
    Whiteness or None
        None if the estimator kept no innovations.
    """
    met, seen = estimate.innovations, dataset.observations
    if met is None:
        return None
    size = np.array([sensor.view.size for sensor in dataset.sensors], dtype=int)[seen.sensor]
    white = whitened(met.innovation, met.S, size)
    used = (seen.robot == robot) & (met.decision == Decision.ACCEPTED)
    used &= np.isfinite(white).all(axis=1)
    # The looks of each sensor of this robot, counted: neighbours differ by one.
    looks = np.full(len(seen), -1)
    for sensor in range(len(dataset.sensors)):
        rows = (seen.robot == robot) & (seen.sensor == sensor)
        looks[rows] = np.unique(seen.step[rows], return_inverse=True)[1]
    keys = np.column_stack([seen.sensor, dataset.observed_robot, met.landmark, looks])[used]
    white, size = white[used], size[used]
    order = np.lexsort(keys.T[::-1])
    follows = np.diff(keys[order], axis=0)
    pairs = np.flatnonzero((follows[:, :-1] == 0).all(axis=1) & (follows[:, -1] == 1))
    first, second = white[order[pairs]], white[order[pairs + 1]]
    return Whiteness(
        float(np.sum(first * second)),
        float(np.sum(first**2)),
        float(np.sum(second**2)),
        int(size[order[pairs]].sum()),
    )


@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def whitened(innovation: Array, S: Array, size: np.ndarray) -> Array:
    """``L^-1 nu`` with S = L L' of each row.

    Parameters
    ----------
    innovation : (M, 2) ndarray
    S : (M, 2, 2) ndarray
    size : (M,) ndarray of int
        1 for rows that have a first number only: their second is then 0.

    Returns
    -------
    (M, 2) ndarray
        NaN where there is no innovation or S is not positive.
    """
    first = np.sqrt(S[:, 0, 0])
    across = S[:, 1, 0] / first
    second = np.sqrt(S[:, 1, 1] - across**2)
    white = innovation[:, 0] / first
    other = np.where(size == 1, 0.0, (innovation[:, 1] - across * white) / second)
    return np.column_stack([white, other])
