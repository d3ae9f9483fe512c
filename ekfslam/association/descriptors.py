"""Descriptors: one number that tells landmarks apart, such as a trunk's diameter.

A landmark that is distinctive is less often mistaken (Principles of Robot Autonomy, 17.2).
"""

from __future__ import annotations

import math

from ekfslam.compiled import compiled


@compiled
def descriptor_distance(value: float, mean: float, variance: float) -> float:
    """What a descriptor adds to the squared distance of an innovation.

    The sum has one degree of freedom more, since descriptors do not depend on where things stand.

    Parameters
    ----------
    value : float
        Observed; NaN if the observation has none.
    mean : float
        Of the landmark; NaN if it has none.
    variance : float
        Of their difference: ``s^2 (1 + 1 / n)`` for values of variance s^2 and a mean over n.

    Returns
    -------
    float
        Squared distance; 0 if either has no descriptor, and then no degree of freedom is added.
    """
    if math.isnan(value) or math.isnan(mean):
        return 0.0
    return (value - mean) ** 2 / variance


@compiled
def running_mean(mean: float, count: int, value: float) -> tuple[float, int]:
    """Mean over count values, and the count, after one more; a value of NaN is none."""
    if math.isnan(value):
        return mean, count
    if count == 0:
        return value, 1
    return mean + (value - mean) / (count + 1), count + 1
