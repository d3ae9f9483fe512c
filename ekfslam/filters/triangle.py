"""How one triangle of a covariance is read, written and moved as a whole."""

from __future__ import annotations

import numpy as np

from ekfslam.compiled import compiled


@compiled
def read_rows(P, n, which, rows):  # type: ignore[no-untyped-def]
    """Whole rows of a triangle, (which.size, n)."""
    for k in range(which.size):
        at = which[k]
        for j in range(at):
            rows[k, j] = P[j, at]
        rows[k, at:n] = P[at, at:n]


@compiled
def write_rows(P, n, which, rows):  # type: ignore[no-untyped-def]
    """The opposite; where two rows meet, the later one stands."""
    for k in range(which.size):
        at = which[k]
        for j in range(at):
            P[j, at] = rows[k, j]
        P[at, at:n] = rows[k, at:n]


@compiled
def times_symmetric(P, n, w, rows):  # type: ignore[no-untyped-def]
    """``rows += w P`` of two rows, reading each entry of the triangle once."""
    for i in range(n):
        tail, a, b = P[i, i + 1 : n], w[0, i], w[1, i]
        left, right = w[0, i + 1 : n], w[1, i + 1 : n]
        down, up = rows[0, i + 1 : n], rows[1, i + 1 : n]
        first, second = a * P[i, i], b * P[i, i]
        for j in range(tail.size):
            first += left[j] * tail[j]
            second += right[j] * tail[j]
            down[j] += a * tail[j]
            up[j] += b * tail[j]
        rows[0, i] += first
        rows[1, i] += second


@compiled
def copy_triangle(P, n, out):  # type: ignore[no-untyped-def]
    """Copy the triangle, and no memory that was never used."""
    for i in range(n):
        out[i, i:n] = P[i, i:n]


@compiled
def rearrange(P, n, order):  # type: ignore[no-untyped-def]
    """Make the triangle a full symmetric matrix, its coordinates in another order; in place.

    Parameters
    ----------
    P : (capacity, capacity) ndarray
    n : int
    order : (n,) ndarray of int
        Old coordinate of each new one: a permutation.
    """
    block = 64  # of rows and columns that the cache holds while they change places
    for first in range(0, n, block):
        for left in range(0, first + 1, block):
            for i in range(first, min(first + block, n)):
                for j in range(left, min(left + block, i)):
                    P[i, j] = P[j, i]
    if (order == np.arange(n)).all():
        return
    row = np.empty(n)
    for i in range(n):
        row[:] = P[i, :n]
        for j in range(n):
            P[i, j] = row[order[j]]
    placed = np.zeros(n, np.bool_)
    for start in range(n):  # along each cycle of the permutation
        if placed[start]:
            continue
        row[:] = P[start, :n]
        at = start
        while order[at] != start:
            P[at, :n] = P[order[at], :n]
            placed[at] = True
            at = order[at]
        P[at, :n] = row
        placed[at] = True
