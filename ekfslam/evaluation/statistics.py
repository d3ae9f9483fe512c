"""Chi-square intervals and the share of samples inside them; intervals of shares."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv, gammaincinv

from ekfslam.errors import InputError
from ekfslam.geometry import Array


def chi2_interval(
    dof: ArrayLike, probability: float = 0.95, samples: int = 1
) -> tuple[Array, Array]:
    """Two-sided interval for the mean of independent chi-square samples (Bar-Shalom et al. 2001).

    N times the mean of N samples of chi2(d) is chi2(N d). This holds for the NEES of N runs at one
    time. It does not hold for the mean along one run: the errors of a run depend on each other so
    strongly that its mean NEES is worth little more than one sample.

    Parameters
    ----------
    dof : (...) array_like
        Degrees of freedom d > 0 of one sample: 3 for a pose, 2 for a landmark.
    probability : float
        Of the interval, as much outside on either side; in (0, 1).
    samples : int
        N; 1 gives the interval of a single sample.

    Returns
    -------
    low, high : (...) ndarray

    Raises
    ------
    InputError
        For a probability outside (0, 1), or dof or samples that are not positive.
    """
    dof = np.asarray(dof, dtype=float)
    if not 0.0 < probability < 1.0:
        raise InputError(f"probability must be in (0, 1), got {probability}")
    if samples < 1 or not (dof > 0).all():
        raise InputError("dof and samples must be positive")
    tail = 0.5 * (1.0 - probability)
    shape = 0.5 * samples * dof
    low, high = gammaincinv(shape, tail), gammaincinv(shape, 1.0 - tail)
    return 2.0 * low / samples, 2.0 * high / samples


def share_inside(values: ArrayLike, dof: ArrayLike, probability: float = 0.95) -> float:
    """Share of samples inside their own two-sided chi-square interval.

    Parameters
    ----------
    values : (N,) array_like
        Samples such as NEES or NIS; NaN for one that was skipped, which does not count.
    dof : (N,) array_like or float
        Degrees of freedom of each.
    probability : float
        In (0, 1).

    Returns
    -------
    float
        In [0, 1]; NaN if every sample was skipped.
    """
    values, dof = np.broadcast_arrays(np.asarray(values, dtype=float), np.asarray(dof, dtype=float))
    counts = ~np.isnan(values)
    if not counts.any():
        return float("nan")
    kept, (dofs, which) = values[counts], np.unique(dof[counts], return_inverse=True)
    low, high = chi2_interval(dofs, probability)
    return float(np.mean((kept >= low[which]) & (kept <= high[which])))


def share_interval(count: int, of: int) -> tuple[float, float]:
    """Exact two-sided 95 % interval of a probability (Clopper and Pearson 1934).

    Parameters
    ----------
    count, of : int
        How often something happened, of so many independent trials, at least one.
    """
    low = float(betaincinv(count, of - count + 1, 0.025)) if count else 0.0
    high = float(betaincinv(count + 1, of - count, 0.975)) if count < of else 1.0
    return low, high


def mean(values: ArrayLike) -> float:
    """Mean of the samples that were not skipped (NaN); NaN if there are none."""
    kept = np.asarray(values, dtype=float)
    kept = kept[~np.isnan(kept)]
    return float(kept.mean()) if len(kept) else float("nan")


def rmse(errors: ArrayLike) -> float:
    """Root of the mean square of errors (N,); NaN if one of them is NaN or there are none."""
    errors = np.asarray(errors, dtype=float)
    return float(np.sqrt(np.mean(errors**2))) if errors.size else float("nan")


def largest(errors: ArrayLike) -> float:
    """Largest of some sizes of errors (N,); NaN if one of them is NaN or there are none."""
    errors = np.asarray(errors, dtype=float)
    return float(errors.max()) if errors.size else float("nan")
