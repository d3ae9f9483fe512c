"""Files of an experiment: all of them appear, or none does; tables as CSV or as Parquet."""

from __future__ import annotations

import json
import logging
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pandas as pd

from ekfslam.errors import InputError, UnknownNameError

logger = logging.getLogger(__name__)

SCRATCH = ".unfinished-"  # how folders are called whose files are on their way
PACKAGES = ("ekfslam", "gtsam", "numpy", "scipy", "pandas", "numba", "matplotlib")


COMPARISON, CAMPAIGN = "a comparison", "a campaign"
"""What a folder may hold results of; or of ``study NAME``."""


def check_folder(folder: str | Path, kind: str) -> None:
    """Refuse a folder that results cannot be written to, before hours of work depend on it.

    Parameters
    ----------
    folder : path
    kind : str
        What the results are of.

    Raises
    ------
    InputError
        If it is a file, neither it nor the nearest folder above can be written to, or it holds
        results of another kind, which would be lost.
    """
    place = Path(folder).absolute()
    while not place.exists():
        place = place.parent
    if not place.is_dir():
        raise InputError(f"cannot write to {folder}: there is no folder {place}")
    if not os.access(place, os.W_OK):
        raise InputError(f"cannot write to {folder}: permission denied")
    _check_kind(Path(folder), kind)


def _check_kind(folder: Path, kind: str) -> None:
    held = _kind(folder / "config.json")
    if held not in ("", kind):
        raise InputError(f"{folder} holds {held}, not {kind}: give another folder")


def _kind(path: Path) -> str:
    """What the results beside a ``config.json`` are of; empty if there is none."""
    if not path.exists():
        return ""
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        config = None
    if isinstance(config, dict):
        if "campaign" in config:
            return CAMPAIGN
        if "study" in config:
            return f"study {config['study']}"
        if "datasets" in config and "estimators" in config:
            return COMPARISON
    return "a config.json of something else"


def write_together(folder: str | Path, write: Callable[[Path], None]) -> list[Path]:
    """Write files into a folder, which is made if needed.

    The files appear when all of them have been written; if anything goes wrong, none does. Results
    of another kind stay.

    Parameters
    ----------
    folder : path
    write : callable
        Writes into the empty folder that it is given.

    Returns
    -------
    list of Path
        The files, in order.

    Raises
    ------
    InputError
        If the folder cannot be written to, or holds results of another kind.
    """
    folder = Path(folder)
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    scratch = None
    done = False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=SCRATCH, dir=folder))
        write(scratch)
        written = sorted(scratch.iterdir())
        if (scratch / "config.json").exists():
            _check_kind(folder, _kind(scratch / "config.json"))
        for path in written:
            os.replace(path, folder / path.name)
        done = True
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror or error}") from None
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)
        for place in () if done else missing:
            with suppress(OSError):
                place.rmdir()
    logger.info("%d files in %s", len(written), folder)
    return [folder / path.name for path in written]


FORMS = ("auto", "csv", "parquet")
CSV_ROWS = 200_000
"""Rows up to which a table is CSV unless asked for otherwise: some 50 to 100 MB of it."""


def check_form(form: str, every: int) -> None:
    """Refuse what says nothing of how tables are to be written.

    Raises
    ------
    UnknownNameError
        For a form that is none of `FORMS`.
    InputError
        If `every` is not a whole number from 1 on.
    """
    if form not in FORMS:
        raise UnknownNameError("form of tables", form, FORMS)
    if isinstance(every, bool) or not isinstance(every, int) or every < 1:
        raise InputError(f"every must be a whole number of steps from 1 on, got {every!r}")


def write_table(table: pd.DataFrame, folder: Path, name: str, form: str = "auto") -> None:
    """Write a table as ``name.csv`` or ``name.parquet``, both without loss.

    Parameters
    ----------
    table : DataFrame
    folder : Path
    name : str
    form : {"auto", "csv", "parquet"}
        "auto" is CSV up to `CSV_ROWS` rows and Parquet beyond.
    """
    if form == "csv" or (form == "auto" and len(table) <= CSV_ROWS):
        table.to_csv(folder / f"{name}.csv", index=False)
    else:
        table.to_parquet(folder / f"{name}.parquet", index=False, compression="zstd")


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that numbers may depend on."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def stem(*words: str) -> str:
    """Name of a file; names may come from a file that somebody else wrote."""
    return "-".join(re.sub(r"[^\w.-]+", "-", word).strip(".-") or "dataset" for word in words)
