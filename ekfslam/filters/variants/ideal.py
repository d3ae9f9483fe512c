"""Ideal EKF: every Jacobian at the truth, which only a simulation knows (Huang et al. 2010).

No filter can do this; it is the measure of what linearising at estimates costs.
"""

from __future__ import annotations

from ekfslam.compiled import compiled
from ekfslam.filters.kernels import advance, disperse
from ekfslam.filters.triangle import copy


@compiled
def move(mean, P, n, points, at, delta, Q, truth):  # type: ignore[no-untyped-def]
    """Robot motion, the Jacobians from the true pose before to the true pose after.

    Parameters
    ----------
    points : (capacity,) ndarray
        Where observations are linearised; the truth of the pose is put there.
    truth : (3,) ndarray
        True pose after the motion.
    """
    x, y, heading = points[at], points[at + 1], points[at + 2]
    advance(mean, at, delta)
    copy(truth, 3, points[at:])
    disperse(P, n, at, points[at] - x, points[at + 1] - y, heading, Q)
