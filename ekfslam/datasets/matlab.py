"""Arrays of MATLAB files (version 5), plain or compressed."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ekfslam.datasets.mat5 import arrays_in
from ekfslam.errors import FileFormatError
from ekfslam.geometry import Array


def read_arrays(
    path: str | Path, shapes: Mapping[str, tuple[int | None, int | None]]
) -> dict[str, Array]:
    """Arrays of numbers of a file.

    Parameters
    ----------
    path : path
    shapes : mapping of str to (int or None, int or None)
        Rows and columns of each array that is wanted; None for any number of them.

    Returns
    -------
    dict of (n, c) ndarray

    Raises
    ------
    FileFormatError
        If the file cannot be read, has no such array, or one of another kind or shape, or with a
        value that is not finite; names file, array and row.
    """
    path = Path(path)
    if not path.is_file():
        raise FileFormatError(f"{path}: no such file")
    try:
        packed = path.read_bytes()
        content = arrays_in(gzip.decompress(packed) if path.suffix == ".gz" else packed)
    except (OSError, EOFError, zlib.error, ValueError) as error:
        raise FileFormatError(f"{path}: cannot be read ({error})") from None
    arrays = {}
    for name, shape in shapes.items():
        if name not in content:
            raise FileFormatError(f"{path}: has no array {name}")
        array = content[name]
        if array is None:
            raise FileFormatError(f"{path}: {name} is no array of real numbers")
        fits = array.ndim == 2 and all(
            want is None or want == got for want, got in zip(shape, array.shape, strict=True)
        )
        if not fits:
            wanted = " x ".join("n" if want is None else str(want) for want in shape)
            raise FileFormatError(
                f"{path}: {name} must be numbers, {wanted}, got an array of shape {array.shape}"
            )
        arrays[name] = array.astype(float)
        refuse(path, name, ~np.isfinite(arrays[name]).all(axis=1), "NaN or infinite value")
    return arrays


def refuse(path: str | Path, name: str, bad: np.ndarray, said: str) -> None:
    """Name the first bad row of an array, from 1 on as MATLAB counts, if there is one.

    Raises
    ------
    FileFormatError
    """
    for row in np.flatnonzero(bad)[:1]:
        raise FileFormatError(f"{path}: {said} in row {row + 1} of {name}")
