"""Options that several loaders take, judged in one line each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ekfslam.checks import checked_array, checked_number
from ekfslam.errors import InputError
from ekfslam.geometry import Array

MOST = 1e12  # of any unit: squares of what is beyond may overflow
LATEST = 10.0  # [s] that one clock of a log may be behind another


def variances(sigmas: Sequence[float], count: int, name: str) -> Array:
    """Covariance (count, count) of independent numbers from their standard deviations.

    Raises
    ------
    InputError
        If they are none.
    """
    array = checked_array(sigmas, float, (count,), name)
    if not (np.isfinite(array) & (array >= 0)).all():
        raise InputError(f"{name} must be standard deviations, got {sigmas!r}")
    _check_size(array, name)
    return np.diag(array**2)


def finite(values: Sequence[float], count: int, name: str) -> Array:
    """So many finite numbers, (count,).

    Raises
    ------
    InputError
        If they are not.
    """
    array = checked_array(values, float, (count,), name)
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be {count} finite numbers, got {values!r}")
    _check_size(array, name)
    return array


def delays(values: Sequence[float], count: int, name: str) -> Array:
    """So many times [s] between clocks of one log, (count,), below 10 s.

    Raises
    ------
    InputError
        If they are not.
    """
    array = finite(values, count, name)
    if not (np.abs(array) < LATEST).all():
        raise InputError(f"{name} must be below {LATEST:g} s, got {values!r}")
    return array


def positive(value: Any, name: str) -> float:
    """A positive finite number.

    Raises
    ------
    InputError
        For anything else.
    """
    number = checked_number(value, name)
    if not 0 < number < np.inf:
        raise InputError(f"{name} must be positive and finite, got {value}")
    _check_size(number, name)
    return number


def finite_number(value: Any, name: str) -> float:
    """A finite number.

    Raises
    ------
    InputError
        For anything else.
    """
    number = checked_number(value, name)
    if not np.isfinite(number):
        raise InputError(f"{name} must be finite, got {value}")
    _check_size(number, name)
    return number


def duration(value: Any, name: str) -> float:
    """A finite time [s] from 0 on.

    Raises
    ------
    InputError
        For anything else.
    """
    number = checked_number(value, name)
    if not 0 <= number < np.inf:
        raise InputError(f"{name} must be a time in seconds from 0 on, got {value}")
    return number


def one_of(value: Any, choices: Sequence[str], name: str) -> str:
    """One of several words.

    Raises
    ------
    InputError
        For another; names them all.
    """
    if value not in choices:
        raise InputError(f"{name} must be {' or '.join(map(repr, choices))}, got {value!r}")
    return str(value)


def _check_size(numbers: Array | float, name: str) -> None:
    """Refuse numbers whose squares may be none."""
    if np.max(np.abs(numbers), initial=0.0) > MOST:
        raise InputError(f"{name} must be below {MOST:g}")
