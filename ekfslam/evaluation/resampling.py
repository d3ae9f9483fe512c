"""Intervals and tests for the mean of paired differences, from the differences alone.

The interval is the symmetric bootstrap-t (Hall 1988): the mean plus and minus the quantile of
``|mean* - mean| / se*`` over resamples, times the standard error. It may be written x ± y, and its
coverage is nearer to what it claims than that of percentile intervals where differences are skewed
or few. The test flips signs at random: if the two estimators are alike, a difference is as likely
as its negative. It is exact, and it judges the mean, as the interval does.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import stdtrit

from ekfslam.geometry import Array

ROUNDING = 1e-9
"""What differs by no more than this share is equal."""

_BLOCK = 4_000_000  # numbers in a block of resamples
_EXACT = 13  # pairs up to which all patterns of signs are tried


def mean_interval(
    samples: Array, probability: float, resamples: int, seed: int
) -> tuple[Array, Array]:
    """Half widths of symmetric bootstrap-t intervals for means, and p of a mean of zero.

    Parameters
    ----------
    samples : (n, m) ndarray
        n independent samples of m quantities; n >= 2.
    probability : float
        Of the interval, in (0, 1).
    resamples : int
    seed : int
        The resamples depend on it and on n alone.

    Returns
    -------
    half_width : (m,) ndarray
        Infinite where too many samples are equal to tell.
    p : (m,) ndarray
        Of the two-sided test that belongs to the interval: the mean is zero.
    """
    n = len(samples)
    means = samples.mean(axis=0)
    centred = samples - means
    # What is left of equal samples is rounding.
    centred[np.abs(centred) <= ROUNDING * np.abs(samples).max(axis=0)] = 0.0
    error = np.sqrt(np.sum(centred**2, axis=0) / (n - 1) / n)
    ratios = np.concatenate([_ratios(counts, centred) for counts in _counts(n, resamples, seed)])
    # As many ratios are beyond the quantile as the test counts: the two never disagree.
    rank = min(int(np.ceil(probability * (resamples + 1))), resamples + 1)
    ranked = np.sort(np.vstack([ratios, np.full_like(means, np.inf)]), axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        half_width = np.where(error > 0, ranked[rank - 1] * error, 0.0)
        observed = np.where(error > 0, np.abs(means) / error, np.where(means == 0, 0.0, np.inf))
    beyond = np.sum(ratios >= observed, axis=0)
    return half_width, np.where(error > 0, (beyond + 1) / (resamples + 1), 1.0 * (means == 0))


def sign_flip_p(differences: Array, resamples: int, seed: int) -> Array:
    """p values of the two-sided sign-flip test: how often random signs make a mean as large.

    Parameters
    ----------
    differences : (n, m) ndarray
        n paired differences of m comparisons.
    resamples : int
        Patterns of signs; with few pairs all there are, and p is then exact.
    seed : int

    Returns
    -------
    (m,) ndarray
        At least 2 / 2^n, or 1 / (resamples + 1).
    """
    n = len(differences)
    # Sums that are equal but for the order of their terms are equal.
    observed = np.abs(differences.sum(axis=0)) - 1e-12 * np.abs(differences).sum(axis=0)
    if n <= _EXACT:
        patterns = (np.arange(2**n)[:, None] >> np.arange(n)) & 1
        return np.mean(np.abs((2.0 * patterns - 1.0) @ differences) >= observed, axis=0)
    rng = np.random.default_rng([seed, n, 1])
    beyond = np.zeros(differences.shape[1])
    for size in _blocks(n, resamples):
        signs = 2.0 * rng.integers(0, 2, (size, n), dtype=np.int8) - 1.0
        beyond += np.sum(np.abs(signs @ differences) >= observed, axis=0)
    return (beyond + 1) / (resamples + 1)


def holm(p: Array) -> Array:
    """P values adjusted for the number of them (Holm 1979); NaN ones do not count.

    The chance that any true hypothesis has an adjusted value below a level is at most that level,
    however the tests depend on each other.
    """
    adjusted = np.full(len(p), np.nan)
    judged = np.flatnonzero(~np.isnan(p))
    order = judged[np.argsort(p[judged], kind="stable")]
    scaled = p[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return adjusted


def student_runs(deviation: float, half_width: float, probability: float) -> int:
    """Smallest n with ``t(n - 1) deviation / sqrt(n) <= half_width``, at least 2."""

    def wide(n: int) -> bool:
        quantile = float(stdtrit(n - 1, 0.5 + 0.5 * probability))
        return quantile * deviation > half_width * np.sqrt(n)

    low, high = 1, 2
    while wide(high):
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if wide(middle) else (low, middle)
    return high


def _blocks(n: int, resamples: int) -> Iterator[int]:
    """Sizes of the blocks that resamples of n numbers are made in."""
    size = max(_BLOCK // n, 1)
    for start in range(0, resamples, size):
        yield min(size, resamples - start)


def _counts(n: int, resamples: int, seed: int) -> Iterator[Array]:
    """How often each of n samples is drawn, in blocks (size, n)."""
    rng = np.random.default_rng([seed, n, 0])
    for size in _blocks(n, resamples):
        drawn = rng.integers(0, n, (size, n)) + n * np.arange(size)[:, None]
        yield np.bincount(drawn.ravel(), minlength=size * n).reshape(size, n).astype(float)


def _ratios(counts: Array, centred: Array) -> Array:
    """Of each resample ``|mean* - mean| / se*``: infinite if all that was drawn is equal."""
    n = len(centred)
    means = counts @ centred / n
    variances = (counts @ centred**2 / n - means**2) / (n - 1)
    # What is left of the variance of equal values is rounding, too.
    floor = 1e-15 * np.max(centred**2, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(variances > floor, np.abs(means) / np.sqrt(variances), np.inf)
