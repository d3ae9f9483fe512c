"""Datasets as a folder of CSV files: the tables of `ekfslam.datasets.tables`, one file each.

``controls.csv`` and, as far as there are any, ``observations.csv``, ``truth.csv``,
``landmarks.csv`` and ``known_map.csv``, each as it is or compressed (``.gz``), and the header::

    # dataset.toml
    name = "my-run"               # optional: of the folder by default
    start_time = 12.0             # [s] of the first pose; needed if controls have a time
    time_tolerance = 0.02         # optional: of times of sightings without a step [s]
    provenance = "..."            # optional, and so are seed and notes

    [motion]                      # as of a scenario, see `ekfslam.simulation.scenario`
    kind = "odometry"
    sigmas = [0.02, 0.02, "0.5 deg"]

    [prior]                       # optional: exactly the origin by default
    mean = [0, 0, 0]
    sigmas = [0.1, 0.1, "2 deg"]

    [[sensors]]
    name = "laser"
    kind = "range-bearing"
    sigmas = [0.1, "1 deg"]
    mount = [0.3, 0, 0]

Several robots have a table ``[[robots]]`` each, with ``name``, ``[robots.motion]`` and
``[robots.prior]``. All that a dataset holds is written, numbers with as many digits as it takes to
read the same ones back.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import tomli_w

from ekfslam.dataset import Dataset
from ekfslam.datasets.places import there
from ekfslam.datasets.sheets import read_csv
from ekfslam.datasets.table_columns import to_tables
from ekfslam.datasets.tables import TABLES, dataset_of
from ekfslam.errors import FileFormatError, InputError
from ekfslam.storage import atomic_write

HEADER = "dataset.toml"


def read_tables(folder: str | Path) -> Dataset:
    """The dataset of a folder.

    Raises
    ------
    FileFormatError, InputError
        If a file is missing or holds something that cannot be used; names file, line and column,
        or the key of the header.
    """
    folder = Path(folder)
    path = folder / HEADER
    try:
        header = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: {error}") from None
    except OSError as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise FileFormatError(f"{path}: {reason}") from None
    files = {name: there(path, f"{name}.csv") for name in TABLES}
    if files["controls"] is None:
        raise FileFormatError(f"{folder}: has no controls.csv beside {HEADER}")
    sheets = {name: read_csv(file) for name, file in files.items() if file is not None}
    return dataset_of(sheets, {"name": folder.resolve().name, **header}, str(path))


def write_tables(dataset: Dataset, folder: str | Path) -> list[Path]:
    """Write a dataset as a folder of CSV files, without loss.

    Of a motion model of one's own, its increments are written; see `ekfslam.Robot.saved`.

    Parameters
    ----------
    dataset : Dataset
    folder : path
        Made if it is not there; it must be empty.

    Returns
    -------
    list of Path
        The files, the header last.

    Raises
    ------
    InputError
        If the folder holds something or cannot be written to, or as `to_tables`.
    """
    folder = Path(folder)
    try:
        if folder.exists() and any(folder.iterdir()):
            raise InputError(f"{folder} holds other files already: name a folder that is new")
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write {folder}: {error.strerror}") from None
    tables, files = to_tables(dataset), []
    for name in TABLES:
        frame = getattr(tables, name)
        if frame is not None:
            text = frame.to_csv(index=False, lineterminator="\n")
            files.append(_write(folder / f"{name}.csv", text))
    return [*files, _write(folder / HEADER, tomli_w.dumps(tables.header))]


def _write(path: Path, text: str) -> Path:
    with atomic_write(path) as stream:
        stream.write(text.encode())
    return path
