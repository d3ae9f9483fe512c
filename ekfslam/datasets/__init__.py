"""Recorded datasets by name; one module per set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

from ekfslam.dataset import Dataset
from ekfslam.errors import InputError, UnknownNameError


class Recorded(NamedTuple):
    """A recorded set: what it is, and the function that loads it."""

    description: str
    module: str
    loader: str = "load"


RECORDED: Mapping[str, Recorded] = {
    "victoria-park": Recorded(
        "recorded: a car among the trees of a park in Sydney; 6969 poses, 151 landmarks, "
        "association given, no truth (Guivant and Nebot 2001)",
        "ekfslam.datasets.victoria_park",
    ),
    "plaza1": Recorded(
        "recorded: a mower and ranges to four radio beacons; 9658 poses, 3527 ranges, truth and "
        "association given (Djugash, Hamner and Roth 2009)",
        "ekfslam.datasets.plaza",
        "plaza1",
    ),
    "plaza2": Recorded(
        "recorded: as plaza1, faster; 4091 poses, 1816 ranges",
        "ekfslam.datasets.plaza",
        "plaza2",
    ),
}


def load_recorded(name: str, path: str | Path | None = None, /, **options: Any) -> Dataset:
    """Load a recorded set.

    Parameters
    ----------
    name : str
        A key of `RECORDED`.
    path : path, optional
        Its file or folder, where it does not come with a package.
    **options
        Of its loader, such as another noise.

    Raises
    ------
    InputError
        For an option that the loader does not have.
    UnknownNameError
        For an unknown name.
    FileFormatError
        For a file that is missing or malformed.
    """
    if name not in RECORDED:
        raise UnknownNameError("dataset", name, RECORDED)
    recorded = RECORDED[name]
    loader: Callable[..., Dataset] = getattr(import_module(recorded.module), recorded.loader)
    try:
        signature(loader).bind(path, **options)
    except TypeError as error:
        raise InputError(f"{name}: {error}") from None
    return loader(path, **options)
