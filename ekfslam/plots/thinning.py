"""What is drawn of much: no more than can be seen, so that a vector file stays small."""

from __future__ import annotations

import numpy as np

from ekfslam.geometry import Array

MOST_POINTS = 20_000
"""Points up to which lines and dots are drawn as they are."""

MOST_ELLIPSES = 1000
"""Ellipses that a map shows of an estimator, the largest."""

_BINS = 2000  # pieces of a line of more points: finer than a page is printed


def seen(*curves: Array) -> np.ndarray:
    """Which points of curves over one abscissa make lines that look the same, in order.

    Of each of 2000 runs of neighbours they are the first, the lowest and the highest of each curve,
    and one that is missing, where the line breaks. Up to `MOST_POINTS` points are all kept.

    Parameters
    ----------
    *curves : (n,) ndarray
        NaN where not known.

    Returns
    -------
    (m,) ndarray of int
    """
    count = len(curves[0])
    if count <= MOST_POINTS:
        return np.arange(count)
    width = -(-count // _BINS)
    starts = np.arange(0, count, width)
    kept = [starts, np.array([count - 1])]
    for curve in curves:
        runs = np.pad(curve, (0, width * len(starts) - count), constant_values=np.nan)
        runs = runs.reshape(len(starts), width)
        missing = np.isnan(runs)
        kept.append(starts + np.where(missing, np.inf, runs).argmin(axis=1))
        kept.append(starts + np.where(missing, -np.inf, runs).argmax(axis=1))
        kept.append(starts + missing.argmax(axis=1))
    found: np.ndarray = np.unique(np.concatenate(kept))
    return found[found < count]  # the last run may be short


def many(count: int) -> bool:
    """Whether dots, or a path, are so many that a vector file holds a picture of them instead."""
    return count > MOST_POINTS


def largest(covariances: Array) -> np.ndarray:
    """Which ellipses to show: the `MOST_ELLIPSES` of largest trace, in order.

    Parameters
    ----------
    covariances : (n, 2, 2) ndarray
        Those without a finite trace come last.

    Returns
    -------
    (m,) ndarray of int
    """
    size = np.nan_to_num(np.trace(covariances, axis1=1, axis2=2), nan=-np.inf)
    return np.sort(np.argsort(-size, kind="stable")[:MOST_ELLIPSES])
