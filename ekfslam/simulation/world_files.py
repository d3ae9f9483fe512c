"""Worlds and waypoints of others, in MATLAB files as Bailey's simulators have them.

Such a file is named, not copied: in the table ``[world]`` of kind ``points`` the key ``file``
stands for the landmarks, in a ``[path]`` of kind ``waypoints`` for the waypoints. Its arrays are
``lm`` (2 x n) and ``wp`` (2 x m), with rows x and y [m]. It is looked for from the folder of the
scenario's own file on, then from the folder that the environment variable EKFSLAM_DATA names.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ekfslam.errors import FileFormatError, InputError
from ekfslam.mat5 import read_arrays

VARIABLE = "EKFSLAM_DATA"


class Stand(NamedTuple):
    """What a ``file`` stands for: the key, of which kind of table, and the array in the file."""

    key: str
    kind: str
    array: str


LANDMARKS = Stand("landmarks", "points", "lm")
WAYPOINTS = Stand("waypoints", "waypoints", "wp")


def fill_in(document: dict[str, Any], folder: Path | None, where: str) -> None:
    """Put the points that a scenario's document names by file into it, in place.

    Parameters
    ----------
    document : dict
        As read from TOML.
    folder : path, optional
        Of the scenario's own file.
    where : str
        What an error calls the document.

    Raises
    ------
    FileFormatError
        If a file is missing or damaged; names it and the array, and says where it is published if
        the key ``source`` of the table does.
    InputError
        For a ``file`` beside the points themselves or of another kind of table.
    """
    for table, stand, here in _tables(document, where):
        if "file" not in table:
            continue
        file, source = table.pop("file"), table.pop("source", "")
        if not (isinstance(file, str) and file and isinstance(source, str)):
            raise InputError(f"{here}: file and source must be text")
        if table.get("kind") != stand.kind:
            raise InputError(f"{here}: file is for the kind {stand.kind!r}")
        if stand.key in table:
            raise InputError(f"{here}: give either {stand.key} or file")
        try:
            table[stand.key] = read_points(find(file, folder, source), stand.array).tolist()
        except FileFormatError as error:
            raise FileFormatError(f"{here}: {error}") from None


def _tables(document: dict[str, Any], where: str) -> Iterator[tuple[dict[str, Any], Stand, str]]:
    """Tables in which a file may be named; what is no table is for others to refuse."""
    robots = document.get("robots")
    places = [(document, "world", LANDMARKS, where), (document, "path", WAYPOINTS, where)]
    for number, robot in enumerate(robots if isinstance(robots, list) else [], start=1):
        places.append((robot, "path", WAYPOINTS, f"{where}: [[robots]] {number}"))
    for place, name, stand, here in places:
        table = place.get(name) if isinstance(place, dict) else None
        if isinstance(table, dict):
            yield table, stand, f"{here}: [{name}]"


def find(file: str, folder: Path | None, source: str = "") -> Path:
    """A file in a folder or the one of EKFSLAM_DATA.

    Parameters
    ----------
    file : str
        Its path from there on.
    folder : path, optional
        Looked in first.
    source : str
        Where it is published, for the error.

    Raises
    ------
    FileFormatError
        If it is in neither; says where to get it.
    """
    data = os.environ.get(VARIABLE)
    folders = [folder] if folder is not None else []
    folders += [Path(data)] if data else []
    for each in folders:
        if (each / file).is_file():
            return each / file
    looked = f", not in {' or '.join(map(str, folders))}" if folders else ""
    get = f"get it from {source} and " if source else ""
    raise FileFormatError(
        f"{file} is not here{looked}; {get}let the environment variable {VARIABLE} name the "
        "folder from which this path leads to it"
    )


def read_points(path: Path, array: str) -> np.ndarray:
    """Points (n, 2) of a MATLAB file.

    Parameters
    ----------
    path : path
    array : str
        Of shape 2 x n.

    Raises
    ------
    FileFormatError
        For a damaged file or array; names both.
    """
    points = read_arrays(path, {array: (2, None)})[array]
    if not points.size:
        raise FileFormatError(f"{path}: {array} is empty")
    return points.T
