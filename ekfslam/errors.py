"""Typed exceptions: what a user can mend is an `EkfslamError`, said in one line."""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from functools import partial
from inspect import isroutine
from pathlib import Path
from typing import Any

WITHIN = ("ekfslam", "baselines")  # whose files are not a user's


class EkfslamError(Exception):
    """Base of every error that this package raises on purpose."""


class InputError(EkfslamError, ValueError):
    """An argument or a record holds something that cannot be used."""


class UnknownNameError(EkfslamError, LookupError):
    """A name that no scenario, dataset or estimator carries."""

    def __init__(self, what: str, name: str, known: Iterable[str]) -> None:
        names = sorted(known)
        close = get_close_matches(str(name), names, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(close)}?" if close else f"known: {', '.join(names)}"
        super().__init__(f"unknown {what} {name!r}; {hint}")


class FileFormatError(EkfslamError):
    """A file that cannot be read as what it should be; the message names file and line."""


class UnsupportedError(EkfslamError):
    """The estimator does not apply to this dataset; becomes a row with status `skipped`."""


def in_words(error: BaseException) -> str:
    """An error in one line: its type, what it says, and the notes on it."""
    said = " ".join(str(error).split())
    notes = "; ".join(getattr(error, "__notes__", []))
    return f"{type(error).__name__}: {said}" + (f" ({notes})" if notes else "")


@contextmanager
def blamed(owner: Any, when: str = "") -> Iterator[None]:
    """What is raised inside gets a note that says where, in the files of the owner's package.

    Parameters
    ----------
    owner : class, callable or object
    when : str
        Is part of the note.
    """
    try:
        yield
    except UnsupportedError:
        raise
    except Exception as error:
        note = ", ".join(filter(None, (place(error, _packages_of(owner)), when)))
        if note:
            error.add_note(note)
        raise


def place(error: BaseException, packages: set[str]) -> str:
    """File, line and function that an error came from last in some packages, or nothing.

    Parameters
    ----------
    error : BaseException
    packages : set of str
        Names of packages, or of modules outside of one. Of this one, nothing is said.
    """
    words = ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        module = str(frame.f_globals.get("__name__"))
        if module.partition(".")[0] in packages.difference(WITHIN):
            file = Path(frame.f_code.co_filename)
            above = module.count(".") + (file.name == "__init__.py")
            # From the package on: wherever it is installed, the words are the same.
            words = f"{'/'.join(file.parts[-1 - above :])}, line {line}, in {frame.f_code.co_name}"
    return words


def _packages_of(owner: Any) -> set[str]:
    """Where a function is from, or a class and those that it inherits from."""
    while isinstance(owner, partial):
        owner = owner.func
    if not isroutine(owner):
        kinds = owner.__mro__ if isinstance(owner, type) else type(owner).__mro__
        return {kind.__module__.partition(".")[0] for kind in kinds}
    return {str(owner.__module__).partition(".")[0]}
