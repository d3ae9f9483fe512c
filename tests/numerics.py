"""Oracles that the tests share: numerical derivatives, sampled covariances, equality of records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

TAU = 2.0 * np.pi


def central_difference(
    function: Callable[[Array], Any],
    x: ArrayLike,
    step: float = 0.02,
    difference: Callable[[Any, Any], Any] = np.subtract,
) -> Array:
    """Jacobian of a function of a vector by central differences.

    Three step widths are combined by Richardson extrapolation, so that truncation falls with the
    sixth power of the step and a wide step keeps round-off near 1e-14: right to 1e-9 and better.

    Parameters
    ----------
    function : callable
        Maps (n,) to an array of any shape.
    x : (n,) array_like
    step : float
        Widest step.
    difference : callable
        How two values are subtracted, for values that wrap.

    Returns
    -------
    (..., n) ndarray
    """
    x = np.asarray(x, dtype=float)

    def slope(direction: Array, width: float) -> Array:
        ahead, behind = function(x + width * direction), function(x - width * direction)
        return np.asarray(difference(ahead, behind), dtype=float) / (2.0 * width)

    columns = []
    for direction in np.eye(len(x)):
        wide, middle, narrow = (slope(direction, step / k) for k in (1, 2, 4))
        first, second = (4 * middle - wide) / 3, (4 * narrow - middle) / 3
        columns.append((16 * second - first) / 15)
    return np.stack(columns, axis=-1)


def subtract_angles(a: ArrayLike, b: ArrayLike) -> Array:
    """Differences brought to (-pi, pi], independently of the code under test."""
    return np.angle(np.exp(1j * (np.asarray(a) - np.asarray(b))))


def subtract_last_angle(a: ArrayLike, b: ArrayLike) -> Array:
    """Differences of vectors whose last entry is an angle."""
    difference = np.array(np.asarray(a) - np.asarray(b), dtype=float)
    difference[..., -1] = subtract_angles(difference[..., -1], 0.0)
    return difference


def assert_sampled(samples: ArrayLike, covariance: ArrayLike, deviations: float = 5.0) -> None:
    """Assert that zero-mean samples have a covariance, within its Monte-Carlo spread.

    The second moment of N Gaussian samples has the variance (P_ii P_jj + P_ij^2) / N in each
    entry; five deviations leave one false alarm in a million entries, and the seed is fixed.

    Parameters
    ----------
    samples : (N, n) array_like
    covariance : (n, n) array_like
    deviations : float
        Bound in standard deviations.
    """
    samples, covariance = np.asarray(samples, dtype=float), np.asarray(covariance, dtype=float)
    sampled = samples.T @ samples / len(samples)
    variances = np.diag(covariance)
    spread = np.sqrt((np.outer(variances, variances) + covariance**2) / len(samples))
    np.testing.assert_array_less(
        np.abs(sampled - covariance), deviations * spread + 1e-12 * variances.max()
    )


def assert_same_record(record: Any, other: Any) -> None:
    """Assert that two records hold the same, every array bit for bit and of the same type."""
    assert type(record) is type(other)
    if isinstance(record, np.ndarray):
        assert record.dtype == other.dtype
        assert record.shape == other.shape
        assert record.tobytes() == other.tobytes()
    elif is_dataclass(record):
        for entry in fields(record):
            assert_same_record(getattr(record, entry.name), getattr(other, entry.name))
    elif isinstance(record, tuple | list):
        assert len(record) == len(other)
        for mine, theirs in zip(record, other, strict=True):
            assert_same_record(mine, theirs)
    else:
        assert record == other or (record != record and other != other)  # NaN is itself here
