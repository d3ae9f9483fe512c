"""Recorded datasets by name; one module per set."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ekfslam.datasets.catalogue import RECORDED, Recorded
from ekfslam.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from ekfslam.dataset import Dataset

__all__ = ["RECORDED", "Recorded", "is_recorded", "load_recorded", "of_name"]


def is_recorded(name: str) -> bool:
    """Whether a name, with or without a part after a slash, is that of a recorded set."""
    return name.partition("/")[0] in RECORDED


def of_name(name: str) -> tuple[Recorded, str]:
    """The set of a name, and the part of it that follows after a slash, empty if none does.

    Raises
    ------
    UnknownNameError
        For an unknown name or part.
    InputError
        For a part of a set that has none.
    """
    whole, slash, part = name.partition("/")
    if whole not in RECORDED:
        raise UnknownNameError("recorded dataset", whole, RECORDED)
    recorded = RECORDED[whole]
    if slash and not recorded.parts:
        raise InputError(f"{whole} has no parts, so no {name}")
    if slash and part not in recorded.parts:
        raise UnknownNameError(f"part of {whole}", part, recorded.parts)
    return recorded, part


def load_recorded(name: str, path: str | Path | None = None, /, **options: Any) -> Dataset:
    """Load a recorded set.

    Parameters
    ----------
    name : str
        A key of `RECORDED`; a part of the set may follow, as in ``mrclam1/robot3``.
    path : path, optional
        Its file or folder, or a folder that holds the folders of several sets; by default that
        of the environment variable EKFSLAM_DATA, or what comes with a package.
    **options
        Of its loader, such as another noise.

    Raises
    ------
    InputError
        For an option that the loader does not have.
    UnknownNameError
        For an unknown name or part.
    FileFormatError
        For a file that is missing or malformed.
    """
    recorded, part = of_name(name)
    arguments = (recorded.number,) * bool(recorded.number) + (path,)
    named = {"part": part} if part else {}
    loader: Callable[..., Dataset] = getattr(import_module(recorded.module), recorded.loader)
    try:
        signature(loader).bind(*arguments, **named, **options)
    except TypeError as error:
        raise InputError(f"{name}: {error}") from None
    return loader(*arguments, **named, **options)
