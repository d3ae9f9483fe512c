"""Tables of a TOML document as arguments of what they stand for.

The signature of that says which keys a table may hold, which it must, and of what type: nothing
is said twice. Numbers are in SI units and radians; a string such as ``"3 deg"`` stands for an angle
in degrees. Wherever a ``covariance`` is asked for, standard deviations ``sigmas`` may be given.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from difflib import get_close_matches
from inspect import Parameter, signature
from types import UnionType
from typing import Any, get_args, get_type_hints

import numpy as np

from ekfslam.errors import EkfslamError, InputError
from ekfslam.geometry import Array
from ekfslam.models.motion import KINDS, MotionModel

DEFAULT_SLIP = 1e-3  # [m] per step: two noisy controls alone make a singular covariance
_DEGREES = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*deg\s*")


def section(document: dict[str, Any], key: str, where: str) -> tuple[dict[str, Any], str]:
    """A table that a document must hold, and what an error calls it."""
    table = document.get(key)
    if table is None:
        raise InputError(f"{where}: the table [{key}] is missing")
    if not isinstance(table, dict):
        raise InputError(f"{where}: [{key}] must be a table, got {table!r}")
    return table, f"{where}: [{key}]"


def tables(document: dict[str, Any], key: str, where: str) -> list[dict[str, Any]]:
    """Tables of which a document must hold at least one."""
    given = document.get(key, [])
    if not (isinstance(given, list) and given and all(isinstance(t, dict) for t in given)):
        raise InputError(f"{where}: at least one table [[{key}]] is needed")
    return given


def motion_model(table: dict[str, Any], where: str) -> MotionModel:
    """The motion model of a table, in which two noisy controls have a slip by default."""
    kind = table.get("kind")
    if isinstance(kind, str) and kind in KINDS and KINDS[kind].noisy == 2:
        table = {"slip": DEFAULT_SLIP, **table}
    return filled(MotionModel, table, where)


def filled(
    target: Callable[..., Any], table: dict[str, Any], where: str, also: Collection[str] = ()
) -> Any:
    """What `target` makes of a table."""
    return call(target, where, **arguments(target, table, where, also=also))


def call(target: Callable[..., Any], where: str, *values: Any, **named: Any) -> Any:
    """Call, and say in the error of a value that makes no sense where it was read."""
    try:
        return target(*values, **named)
    except (EkfslamError, TypeError, ValueError) as error:
        raise InputError(f"{where}: {error}") from None


def arguments(
    target: Callable[..., Any],
    table: dict[str, Any],
    where: str,
    skip: Collection[str] = (),
    also: Collection[str] = (),
) -> dict[str, Any]:
    """A table as arguments of `target`, checked against its signature.

    `skip` are parameters that no key may give, `also` further keys to propose for a misspelt one.
    """
    parameters = {k: p for k, p in signature(target).parameters.items() if k not in skip}
    shorthand = ("sigmas",) if "covariance" in parameters else ()
    for key in table:
        if key not in parameters and key not in shorthand:
            known = [*parameters, *shorthand, *also]
            close = get_close_matches(key, known, n=2)
            hint = f"did you mean {' or '.join(close)}?" if close else f"known: {', '.join(known)}"
            raise InputError(f"{where}: unknown key {key!r}; {hint}")
    if "sigmas" in table and "covariance" in table:
        raise InputError(f"{where}: give either covariance or sigmas")
    hints = get_type_hints(target)
    values = {k: read(v, hints[k], f"{where}: {k}") for k, v in table.items() if k in parameters}
    if "sigmas" in table:
        sigmas = read(table["sigmas"], Array, f"{where}: sigmas")
        if sigmas.ndim != 1:
            raise InputError(f"{where}: sigmas must be one number for each noisy value")
        if (sigmas < 0).any():
            raise InputError(f"{where}: sigmas must not be negative")
        values["covariance"] = np.diag(sigmas**2)
    for key, parameter in parameters.items():
        if parameter.default is Parameter.empty and key not in values:
            alternative = " or 'sigmas'" if key == "covariance" else ""
            raise InputError(f"{where}: missing key {key!r}{alternative}")
    return values


def read(value: Any, hint: Any, where: str) -> Any:
    """A TOML value as the type of a parameter: text, flag, whole number, number or array."""
    allowed = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    if float in allowed:
        return _number(value, where)
    for kind, name in ((str, "text"), (bool, "true or false"), (int, "a whole number")):
        if kind in allowed:
            if type(value) is not kind:
                raise InputError(f"{where} must be {name}, got {value!r}")
            return value
    if tuple[str, ...] in allowed:
        if not (isinstance(value, list) and all(isinstance(v, str) for v in value)):
            raise InputError(f"{where} must be a list of names, got {value!r}")
        return tuple(value)
    if not isinstance(value, list):
        raise InputError(f"{where} must be a list of numbers, got {value!r}")
    rows = _numbers(value, where)
    try:
        return np.array(rows)
    except ValueError:
        raise InputError(f"{where} has rows of different lengths") from None


def _numbers(value: Any, where: str) -> Any:
    return [_numbers(v, where) for v in value] if isinstance(value, list) else _number(value, where)


def _number(value: Any, where: str) -> float:
    # Degrees squared are not meant by a string in a covariance; it is refused like any other.
    degrees = isinstance(value, str) and not where.endswith(": covariance")
    if degrees and (angle := _DEGREES.fullmatch(value)):
        return float(np.deg2rad(float(angle[1])))
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where} must be a number (or an angle like '3 deg'), got {value!r}")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where} is larger than any number that can be computed with") from None
