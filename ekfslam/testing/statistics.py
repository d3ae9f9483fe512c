"""Bounds that data contradict only rarely if what is claimed is true.

Each has a level: the chance of contradicting a true claim.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import stdtrit

from ekfslam.errors import InputError
from ekfslam.evaluation import chi2_interval
from ekfslam.geometry import Array

__tracebackhide__ = True  # a failed test shows the user's line

SAME = 1e-6
"""What differs by no more than this share is equal: a reference has seven digits."""

_EXACT = 14  # numbers of which all subsets are taken
_MOST = 1_000_000  # subsets
_BLOCK = 4_000_000  # numbers in a block of them


def least_mean(values: Array, level: float) -> float:
    """Lower confidence bound of a mean by Student's t.

    Errors are skewed to the right: where their sample has a large mean it has a large spread, too,
    so that the bound is above the true mean less often than the level says.

    Parameters
    ----------
    values : (n,) ndarray
        Independent, n >= 2.
    level : float
        Chance that the bound is above the mean of normal samples.
    """
    error = values.std(ddof=1) / np.sqrt(len(values))
    return float(values.mean() - stdtrit(len(values) - 1, 1.0 - level) * error)


def least_ratio(new: Array, old: Array, level: float) -> float:
    """Lower confidence bound of the ratio of two means on the same seeds.

    A quantile of the ratios of sums over random subsets of the seeds: the typical values of
    Hartigan (1969). The ratio is contradicted by the data exactly if the one-sided sign-flip test
    of ``new - ratio * old`` rejects it. That test is exact, whatever the distribution and however
    many differences are zero, if new and old are exchangeable on each seed; and since it is
    monotone in every difference, a ratio above 1 is then contradicted even less often.

    Parameters
    ----------
    new, old : (n,) ndarray
        Not negative.
    level : float
        Chance that the bound is above 1 if the two are exchangeable.

    Returns
    -------
    float
        Infinite if old is zero where new is not; minus infinity if both are zero.

    Raises
    ------
    InputError
        If no data of so many seeds could contradict anything at this level.
    """
    n = len(new)
    resamples = 2**n if n <= _EXACT else min(max(9999, int(np.ceil(50 / level))), _MOST) + 1
    rank = int(np.floor(level * resamples * (1 + 1e-12)))
    if not rank:
        fewest = int(np.ceil(np.log2(1 / level)))
        raise InputError(
            f"{n} seeds cannot contradict anything at a level of {level:.2g}: give {fewest} or more"
            if n <= _EXACT
            else f"a level of {level:.2g} is below what can be told; allow more false alarms"
        )
    both = np.column_stack([new, old])
    sums = np.concatenate([chosen @ both for chosen in _subsets(n, resamples)])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(sums[:, 0] > 0, sums[:, 0] / sums[:, 1], -np.inf)
    return float(np.partition(ratios, rank)[rank])


def _subsets(n: int, resamples: int) -> Iterator[Array]:
    """Which of n numbers are in a subset, in blocks (size, n) of 0 and 1; the first is empty."""
    if n <= _EXACT:
        yield ((np.arange(2**n)[:, None] >> np.arange(n)) & 1).astype(float)
        return
    yield np.zeros((1, n))
    rng = np.random.default_rng(n)
    size = max(_BLOCK // n, 1)
    for start in range(1, resamples, size):
        yield rng.integers(0, 2, (min(size, resamples - start), n)).astype(float)


def expected_interval(dof: float, margin: float, level: float) -> tuple[float, float]:
    """Where the sum of NEES or NIS over the sum of its degrees of freedom may lie.

    The sum is chi-square if errors are normal with the stated covariance and independent (Bar-
    Shalom et al. 2001, 5.4): NEES of one time over independent runs, innovations over all steps.

    Parameters
    ----------
    dof : float
        Of the sum.
    margin : float
        The true mean may be off 1 by this share.
    level : float
        Chance of being outside where the true mean is 1 and the margin is 0, as much on either
        side.

    Returns
    -------
    low, high : float
    """
    low, high = chi2_interval(dof, 1.0 - level)
    return float(low) / dof * (1.0 - margin), float(high) / dof * (1.0 + margin)
