"""Estimators by name.

Names come from the entry-point group ``ekfslam.estimators``; a package joins by declaring one.
``module:attribute`` works wherever a name does. An estimator is an object with
``estimate(dataset) -> Estimate``, or a class or function without arguments that makes one.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol, runtime_checkable

from ekfslam.dataset import Dataset
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.estimates import Estimate

GROUP = "ekfslam.estimators"
ORACLES = "ekfslam.oracles"

Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all) on long work."""


@runtime_checkable
class Estimator(Protocol):
    """What every estimator offers."""

    def estimate(self, dataset: Dataset) -> Estimate:
        """Estimate a dataset."""
        ...


def registered() -> dict[str, EntryPoint]:
    """Names of the estimators that are installed, with where they come from."""
    return {point.name: point for point in sorted(entry_points(group=GROUP), key=lambda p: p.name)}


def estimator_name(estimator: str | Any) -> str:
    """How an estimator is called in tables: its name, `name` attribute or class."""
    if isinstance(estimator, str):
        return estimator.rpartition(":")[2]
    kind = estimator if isinstance(estimator, type) else type(estimator)
    return str(getattr(estimator, "name", kind.__name__))


def resolve(estimator: str | Any, **options: Any) -> Estimator:
    """The estimator of a name, a ``module:attribute``, a class or an object.

    Parameters
    ----------
    estimator : str or object
    **options
        Passed to the class that the name stands for.

    Raises
    ------
    UnknownNameError
        For a name that nothing carries; lists close ones.
    InputError
        For a module or attribute that cannot be imported, or something that is no estimator.
    """
    if isinstance(estimator, str):
        estimator = _load(estimator)
    if isinstance(estimator, type) or (callable(estimator) and not hasattr(estimator, "estimate")):
        try:
            estimator = estimator(**options)
        except TypeError as error:
            raise InputError(f"cannot make the estimator: {error}") from None
    elif options:
        raise InputError(f"options {', '.join(options)} are for a name or a class")
    if not isinstance(estimator, Estimator):
        raise InputError(f"{estimator!r} is no estimator: it has no estimate(dataset)")
    return estimator


def _load(name: str) -> Any:
    known = registered()
    if name in known:
        try:
            return known[name].load()
        except Exception as error:
            raise InputError(f"cannot load estimator {name!r}: {error}") from None
    if ":" not in name:
        raise UnknownNameError("estimator", name, known)
    module_name, _, attribute = name.partition(":")
    if os.getcwd() not in sys.path:  # a user's module lives where the command is run
        sys.path.insert(0, os.getcwd())
    try:
        target = importlib.import_module(module_name)
        for part in attribute.split("."):
            target = getattr(target, part)
    except Exception as error:
        raise InputError(f"cannot load estimator {name!r}: {error}") from None
    return target


def linear_oracle() -> Callable[..., Any]:
    """The solver of a filter's own linear models, ``solve(prior, linearizations)``.

    Raises
    ------
    UnsupportedError
        If no package offers one.
    """
    for point in entry_points(group=ORACLES, name="linear"):
        return point.load()
    raise UnsupportedError("no package offers a linear oracle; reinstall ekfslam")
