"""Where a filter stops believing a sighting: its gate, measured from outside.

The last sighting of a run is put at a chosen Mahalanobis distance. It is rejected if the answer is
that of the run without it, whatever the filter does with it instead.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtr, chdtri

from ekfslam.dataset import Dataset
from ekfslam.geometry import Array
from ekfslam.validation.probes import AT_A_DISTANCE, with_last
from ekfslam.validation.suspects import Answer, run

SCALE = 0.1  # of the uncertainty: far sightings are then still near the landmark
NEAREST, FARTHEST = 0.05, 20.0  # sigmas; who rejects the one believes nothing
DIRECTIONS = np.array([[1.0, 0.0], [0.0, 1.0], [-0.6, 0.8]])  # of whitened innovations
PROBABILITIES = (0.9, 0.95, 0.975, 0.99, 0.995, 0.999, 0.9999)
USUAL = (*(float(chdtri(2, 1 - p)) for p in PROBABILITIES), 9.0, *(3.841, 6.635))
NEAR = 3e-3  # relative: tables of quantiles have three digits


class Gate(NamedTuple):
    """Squared Mahalanobis distances at which sightings begin to be rejected, by direction.

    Attributes
    ----------
    squared : (3,) ndarray
        Infinite where all is believed.
    """

    squared: Array

    @property
    def of_mahalanobis(self) -> bool:
        """Whether the distance alone decides, whatever the direction."""
        return bool(self.squared.max() <= (1 + 1e-4) * self.squared.min())

    @property
    def threshold(self) -> float:
        """The least squared distance that is rejected."""
        return float(self.squared.min())

    @property
    def probability(self) -> float:
        """That a right sighting of two numbers falls inside the threshold."""
        return float(chdtr(2, self.threshold))

    def confused(self) -> tuple[str, float] | None:
        """Root or square of a usual threshold: which, and of what; None for what makes sense."""
        if not self.of_mahalanobis:
            return None
        for what, squared in (("root", self.threshold**2), ("square", self.threshold**0.5)):
            for usual in USUAL:
                if abs(squared - usual) <= NEAR * usual:
                    return what, usual
        return None


def measured_gate(
    answer: Callable[[Dataset], Answer], kind: str, wrong: Mapping[str, Any]
) -> Gate | None:
    """The gate of a filter.

    Parameters
    ----------
    answer : callable
        What the filter says of a dataset.
    kind : {"range-bearing", "xy"}
    wrong : mapping
        Mistakes that it is known to make: distances are those that it sees.

    Returns
    -------
    Gate or None
        None if it believes everything, or nothing.
    """
    dataset = AT_A_DISTANCE.dataset(kind, SCALE)
    look = run(dataset, wrong)[1]
    if look is None:
        return None
    root, without = np.linalg.cholesky(look.S), answer(with_last(dataset, None))
    sensor = dataset.sensors[0]

    def rejects(direction: Array, distance: float) -> bool:
        value = sensor.difference(look.expected + distance * root @ direction, np.zeros(2))
        return _same(answer(with_last(dataset, value)), without)

    def threshold(direction: Array) -> float:
        low, high = NEAREST, FARTHEST
        if not rejects(direction, high):
            return float("inf")
        while high - low > 1e-6 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if rejects(direction, middle) else (middle, high)
        return high

    if rejects(DIRECTIONS[0], NEAREST):
        return None
    squared = np.array([threshold(direction) for direction in DIRECTIONS]) ** 2
    return Gate(squared) if np.isfinite(squared).any() else None


def _same(one: Answer, other: Answer) -> bool:
    """Whether the final poses are equal, and so are the landmarks that both have."""
    _, here, there = np.intersect1d(one.ids, other.ids, return_indices=True)
    pairs = (one.poses[-1], other.poses[-1]), (one.positions[here], other.positions[there])
    return all(np.allclose(a, b, rtol=0.0, atol=1e-12) for a, b in pairs)
