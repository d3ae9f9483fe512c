"""Observability-constrained EKF (Huang, Mourikis and Roumeliotis 2010), their first variant.

The points of linearisation are the nearest ones to the latest estimates, in the sense of least
squares, that keep the three unobservable directions of the true system. So the filter must know at
the prediction what will be seen next.
"""

from __future__ import annotations

from ekfslam.compiled import compiled
from ekfslam.filters.kernels import advance, disperse
from ekfslam.filters.triangle import copy


@compiled
def move(mean, P, n, points, first, at, delta, Q, seen):  # type: ignore[no-untyped-def]
    """Robot motion, the points of linearisation chosen anew.

    With p the estimate before, q the prediction that led to it, l the estimate of a landmark, f its
    first one and d the sum of what earlier choices moved, the points p* and l* minimise
    ``|p* - p|^2 + sum |l* - l|^2`` under ``p* - l* = q - f + d`` for each landmark seen next. The
    multipliers of N such equations have the closed form that is used here.

    Parameters
    ----------
    points : (capacity,) ndarray
        Holds the prediction q, and then the new one; and of the landmarks l*.
    first : (capacity,) ndarray
        Of the landmarks f, and of the position d.
    seen : (N,) ndarray of int
        Offsets of the landmarks that are seen next.
    """
    heading, N = mean[at + 2], seen.size
    qx, qy, dx, dy = points[at], points[at + 1], first[at], first[at + 1]
    x, y = mean[at], mean[at + 1]
    sum_x, sum_y = 0.0, 0.0
    for l in seen:
        sum_x += mean[l] - first[l] - (x - qx - dx)
        sum_y += mean[l + 1] - first[l + 1] - (y - qy - dy)
    x += sum_x / (N + 1)  # p*
    y += sum_y / (N + 1)
    for l in seen:
        points[l] = x - qx - dx + first[l]  # l*, from the constraint
        points[l + 1] = y - qy - dy + first[l + 1]
    first[at] += qx - x
    first[at + 1] += qy - y
    advance(mean, at, delta)
    copy(mean[at:], 3, points[at:])
    disperse(P, n, at, points[at] - x, points[at + 1] - y, heading, Q)
