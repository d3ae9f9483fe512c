"""Typed exceptions: what a user can mend is an `EkfslamError`, said in one line."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


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
