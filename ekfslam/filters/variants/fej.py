"""First-estimates Jacobian EKF (Huang, Mourikis and Roumeliotis 2008).

A pose is linearised at its prediction for good, a landmark at its first estimate: with one point
per variable the linearised system has the three unobservable directions of the true one, and the
filter gains no information along them.
"""

from __future__ import annotations

from ekfslam.compiled import compiled
from ekfslam.filters.kernels import advance, disperse
from ekfslam.filters.triangle import copy


@compiled
def move(mean, P, n, points, at, delta, Q):  # type: ignore[no-untyped-def]
    """Robot motion, the Jacobian from one prediction to the next.

    Parameters
    ----------
    points : (capacity,) ndarray
        Holds the prediction before, which the correction has left, and then the new one.
    """
    heading = mean[at + 2]  # of the noise: any choice keeps the directions unobservable
    x, y = points[at], points[at + 1]
    advance(mean, at, delta)
    copy(mean[at:], 3, points[at:])
    disperse(P, n, at, points[at] - x, points[at + 1] - y, heading, Q)
