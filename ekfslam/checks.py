"""Values from outside, made into what the records hold, or refused in one line."""

from __future__ import annotations

from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from ekfslam.errors import InputError, UnsupportedError

ROUNDING = 1e-9  # of a matrix that should be symmetric or positive semi-definite, relative


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """The same array, made read-only."""
    array.flags.writeable = False
    return array


def checked_number(value: Any, name: str) -> float:
    """A number; NaN and infinity are for the caller to judge.

    Raises
    ------
    InputError
        For anything else.
    """
    if isinstance(value, str) or not hasattr(value, "__float__"):
        raise InputError(f"{name} must be a number, got {value!r}")
    return float(value)


def checked_array(value: Any, dtype: Any, shape: tuple[int | None, ...], name: str) -> NDArray[Any]:
    """A read-only array.

    Parameters
    ----------
    value : array_like
    dtype : type
        Whole numbers are not rounded to it.
    shape : tuple of int or None
        None stands for any length.
    name : str
        What the error calls it.

    Raises
    ------
    InputError
        If it is no such array.
    """
    try:
        given = np.array(value)
        with np.errstate(invalid="ignore"):
            array = given.astype(dtype)
        exact = np.issubdtype(dtype, np.floating) or bool((array == given).all())
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} cannot be read as numbers: {error}") from None
    if not exact:
        raise InputError(f"{name} must hold whole numbers")
    if len(array.shape) != len(shape) or any(
        want is not None and want != got for want, got in zip(shape, array.shape, strict=True)
    ):
        wanted = ", ".join("n" if want is None else str(want) for want in shape)
        wanted += "," if len(shape) == 1 else ""
        raise InputError(f"{name} must have shape ({wanted}), got {array.shape}")
    return frozen(array)


def check_finite(array: NDArray[Any], name: str) -> None:
    """Refuse NaN and infinite values; the error names the first row that has one."""
    bad = ~np.isfinite(array)
    if bad.any():
        row = int(np.argwhere(bad)[0][0])
        raise InputError(f"{name} holds NaN or infinite values, first in row {row}")


def checked_covariance(matrix: Any, size: int, name: str) -> NDArray[np.float64]:
    """A covariance as a read-only symmetric array.

    Parameters
    ----------
    matrix : (size, size) array_like
    size : int
    name : str
        What the error calls it.

    Raises
    ------
    InputError
        If the shape is wrong, a value is not finite, or it is not symmetric positive
        semi-definite.
    """
    given = checked_array(matrix, float, (size, size), name)
    check_finite(given, name)
    if not is_covariance(given[None])[0]:
        what = "symmetric" if np.abs(given - given.T).max() > 0 else "positive semi-definite"
        raise InputError(f"{name} is not {what}")
    return frozen(0.5 * (given + given.T))


def is_covariance(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether matrices (n, d, d) are symmetric positive semi-definite up to rounding.

    They are judged as correlations, so that a large variance does not hide a small negative one.
    """
    variances = np.einsum("nii->ni", matrices)
    # A variance of the size of rounding is zero, whatever its sign.
    floor = ROUNDING**1.5 * np.abs(variances).max(axis=1, initial=0.0, keepdims=True)
    scale = np.sqrt(np.maximum(variances, np.maximum(floor, np.finfo(float).tiny)))
    correlations = matrices / (scale[:, :, None] * scale[:, None, :])
    lopsided = np.abs(correlations - np.swapaxes(correlations, 1, 2)).max(axis=(1, 2), initial=0.0)
    smallest = np.linalg.eigvalsh(correlations).min(axis=1, initial=np.inf)
    return (variances >= -floor).all(axis=1) & (lopsided <= ROUNDING) & (smallest >= -ROUNDING)


def check_fits(size: int, what: str, instead: str = "") -> None:
    """Refuse what memory cannot hold, before it is asked for: the machine would swap, or kill.

    Parameters
    ----------
    size : int
        Bytes it needs beyond what is held already.
    what : str
        What the error calls it, in the singular.
    instead : str
        What to do.

    Raises
    ------
    UnsupportedError
        With the size, and what is free.
    """
    free = psutil.virtual_memory().available
    if size > free:
        hint = f": {instead}" if instead else ""
        raise UnsupportedError(f"{what} needs {in_bytes(size)}, {in_bytes(free)} are free{hint}")


def in_bytes(size: int) -> str:
    """A size in words: three digits and a decimal unit."""
    amount, units = float(size), ["B", "kB", "MB", "GB", "TB", "PB", "EB"]
    while amount >= 999.5 and len(units) > 1:
        amount, units = amount / 1000, units[1:]
    return f"{np.format_float_positional(amount, 3, fractional=False, trim='-')} {units[0]}"
