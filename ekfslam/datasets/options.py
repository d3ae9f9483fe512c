"""Options that several loaders take, judged in one line each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ekfslam.checks import checked_array, checked_number
from ekfslam.errors import InputError
from ekfslam.geometry import Array


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
