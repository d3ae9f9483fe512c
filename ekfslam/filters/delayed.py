"""The delayed map update: P is ``P0 - U' U``, and a large map is touched once for many corrections.

A correction takes ``W' W`` from the covariance, W of as many rows as were observed: 2 n^2 flops for
each sighting of a point, most of which nothing reads before the next correction changes them again.
So the rows W wait as further rows of U. What the filter reads is made exact: the rows of the poses
are corrected at once, and to the rows of landmarks that are observed ``U' U`` is applied as they
are read; U is zero in the columns of the poses, so that motions and new landmarks need no more.
When U is full the whole map is brought up to date by one symmetric rank-k update, which runs at the
speed of BLAS. Nothing is approximated.
"""

from __future__ import annotations

import numpy as np

from ekfslam.blas import subtract_product, subtract_square
from ekfslam.compiled import compiled, inlined, lean
from ekfslam.filters.triangle import downdate_row

FROM = 120  # coordinates of a state from which waiting pays
ROWS = 128  # that wait at most: on small maps fewer pay


@inlined
def delays(slam, most, settings):  # type: ignore[no-untyped-def]
    """Whether a correction by at most so many rows is to wait."""
    return slam.size[0] >= settings.delay_from and most <= room(slam)


@inlined
def room(slam):  # type: ignore[no-untyped-def]
    """How many rows may wait.

    A row that waits costs 2 n flops with every one that is read, and saves a pass over the n^2 / 2
    entries of the map: on a small map fewer pay.
    """
    return room_for(slam.late.shape[0], slam.size[0])


@inlined
def room_for(rows, n):  # type: ignore[no-untyped-def]
    """How many of so many rows pay in a state of n coordinates."""
    return min(rows, max(32, n // 16))


@compiled
def bring_up_to_date(slam):  # type: ignore[no-untyped-def]
    """Apply what waits: ``P0 -= U' U``, U then empty."""
    held, n = slam.held[0], slam.size[0]
    if held > 0:
        subtract_square(slam.covariance, slam.late, held, n)
        slam.held[0] = 0


@compiled
def make_place(slam, most):  # type: ignore[no-untyped-def]
    """Make place for up to so many rows W of a correction, behind those that wait already."""
    if slam.held[0] + most > room(slam):
        bring_up_to_date(slam)


@compiled
def reduce_large(slam, W, m, poses, waits):  # type: ignore[no-untyped-def]
    """``P -= W' W`` on a large map, at once or later."""
    if waits:
        keep(slam, m, poses)
    else:
        subtract_square(slam.covariance, W, m, slam.size[0])


@compiled
def exact_rows(late, held, n, H, at, sizes, m, d, rows):  # type: ignore[no-untyped-def]
    """Take ``H U' U`` from rows of ``H P0``, which makes them rows of ``H P``.

    Parameters
    ----------
    late : (>= held, >= n) ndarray
        U; zero in the columns of the poses, whose rows are exact.
    held, n : int
    H : (>= m, >= d, >= 3 + size) ndarray
        Of m observations, with respect to pose and target.
    at, sizes : (>= m,) ndarray of int
        First coordinate of each target, and how many it has.
    m, d : int
    rows : (>= d m, >= n) ndarray
        Changed in place.
    """
    factors = np.empty((d * m, held))
    for i in range(m):
        for k in range(held):
            for a in range(d):
                total = 0.0
                for c in range(sizes[i]):
                    total += H[i, a, 3 + c] * late[k, at[i] + c]
                factors[d * i + a, k] = total
    subtract_product(rows, factors, late, d * m, held, n)


@lean
def keep(slam, m, poses):  # type: ignore[no-untyped-def]
    """The next m rows of `late` have corrected the mean: correct the poses, and let them wait."""
    P, late, first, n = slam.covariance, slam.late, slam.held[0], slam.size[0]
    for i in range(poses):
        downdate_row(P, late, first, first + m, n, i)
    clear(late, first, first + m, 0, poses)
    slam.held[0] = first + m


@lean
def clear(late, first, last, begin, end):  # type: ignore[no-untyped-def]
    """Rows from `first` to before `last` are zero in the columns from `begin` to before `end`."""
    for k in range(first, last):
        for j in range(begin, end):
            late[k, j] = 0.0


@lean
def entry(P, late, held, i, j):  # type: ignore[no-untyped-def]
    """One entry of the covariance, what waits included."""
    total = P[i, j] if i <= j else P[j, i]
    for k in range(held):
        total -= late[k, i] * late[k, j]
    return total
