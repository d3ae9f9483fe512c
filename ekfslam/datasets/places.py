"""Where the files of recorded sets lie: a path that is given, or a folder for all of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ekfslam.errors import FileFormatError

VARIABLE = "EKFSLAM_DATA"
COMPRESSED = ".gz"


def located(
    dataset: str, path: str | Path | None, folders: Sequence[str], files: Sequence[str]
) -> dict[str, Path]:
    """The files of a set, each as it is or compressed (``.gz``).

    They are looked for in the folder that is given, or else in that of the environment variable
    EKFSLAM_DATA, and there in folders of the set's names.

    Parameters
    ----------
    dataset : str
        What errors call it.
    path : path, optional
        A folder; of a set of one file, the file itself.
    folders : sequence of str
        Names that the folder of the set may have, such as ``("mrclam/dataset1", "dataset1")``.
    files : sequence of str
        Names without ``.gz``.

    Returns
    -------
    dict of Path
        By name.

    Raises
    ------
    FileFormatError
        If there is no such folder, or a file is missing; says what was looked for and where.
    """
    given = path if path is not None else os.environ.get(VARIABLE)
    if not given:
        raise FileFormatError(
            f"{dataset}: give the folder of its files (--data PATH, or the environment variable "
            f"{VARIABLE}){hint(dataset)}"
        )
    root = Path(given)
    if root.is_file():
        if len(files) == 1:
            return {files[0]: root}
        raise FileFormatError(
            f"{dataset}: {root} is a file; give the folder of {', '.join(files)}{hint(dataset)}"
        )
    if not root.is_dir():
        raise FileFormatError(f"{dataset}: there is no file or folder {root}")
    places = [root, *(root / name for name in folders)]
    found = [{name: there for name in files if (there := _either(p, name))} for p in places]
    best = max(found, key=len)  # the first of those that have most
    if len(best) == len(files):
        return best
    missing = [name for name in files if name not in best]
    where = places[found.index(best)] if best else root
    within = f", itself or in {' or '.join(folders)}" if folders and not best else ""
    raise FileFormatError(
        f"{dataset}: {where} has no {', '.join(missing)} (nor with {COMPRESSED}){within}"
        f"{hint(dataset)}"
    )


def hint(dataset: str) -> str:
    """Where an error sends those who have no files."""
    return f"; ekfslam datasets {dataset} tells where to get the files"


def there(path: Path, file: str) -> Path | None:
    """A file that a set may have, as it is or compressed, beside one that it has."""
    return _either(path.parent, file)


def _either(folder: Path, name: str) -> Path | None:
    for each in (folder / name, folder / f"{name}{COMPRESSED}"):
        if each.is_file():
            return each
    return None
