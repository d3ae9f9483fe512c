"""Iterated EKF: every correction is linearised again at what it gives (Bell and Cathey 1993).

A Gauss-Newton search for the maximum of the posterior of one look. The step from the estimate x to
the next iterate is ``K (z - h(x_i) - H_i (x - x_i))``: without the last term the iteration does not
end where it should, and is not the plain filter on a linear model.
"""

from __future__ import annotations

import math

from ekfslam.compiled import lean
from ekfslam.filters.measure import expect, innovate


@lean
def foresee_again(kind, size, elsewhere, mean, points, pose, at, value, H, nu):  # type: ignore[no-untyped-def]
    """Innovation and Jacobian at an iterate, the innovation as seen from the estimate."""
    expect(kind, size, elsewhere, points[at : at + size], nu, H)
    innovate(kind, value, nu, nu)
    for a in range(2):
        for c in range(3):
            nu[a] -= H[a, c] * (mean[pose + c] - points[pose + c])
        for c in range(size):
            nu[a] -= H[a, 3 + c] * (mean[at + c] - points[at + c])


@lean
def iterate(mean, points, step, n, again):  # type: ignore[no-untyped-def]
    """Move the points to where the step leads; returns how far, in any turned world the same.

    They start at the mean, unless this happens again.
    """
    moved = 0.0
    for j in range(n):
        before = points[j] if again else mean[j]
        points[j] = mean[j] + step[j]
        moved += (points[j] - before) ** 2
    return math.sqrt(moved)
