"""MATLAB files of version 5, plain or compressed (``.gz``): numeric arrays by name.

A damaged file ends scipy's reader, and the process with it, so the format is read here: a header of
128 bytes, then elements of a tag (type, size) and data, a matrix being an element of elements
(MathWorks, MAT-File Format). What is no matrix of real numbers is named, not read.
"""

from __future__ import annotations

import gzip
import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ekfslam.errors import FileFormatError

HEADER, TAG = 128, 8
MATRIX, COMPRESSED = 14, 15
SMALL = 4  # bytes of data that fit into a tag
LARGEST = 1 << 30  # bytes of an unpacked array
STORED = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4",
           14: "i8", 15: "u8"}  # fmt: skip
COMPLEX = 0x0800


def read_arrays(
    path: str | Path, shapes: Mapping[str, tuple[int | None, int | None]]
) -> dict[str, np.ndarray]:
    """Arrays of numbers of a file.

    Parameters
    ----------
    path : path
    shapes : mapping of str to (int or None, int or None)
        Rows and columns of each array that is wanted; None for any number of them.

    Returns
    -------
    dict of (n, c) ndarray of float

    Raises
    ------
    FileFormatError
        If the file cannot be read, has no such array, or one of another kind or shape, or with a
        value that is not finite; names file, array, row and column.
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
        for row, column in np.argwhere(~np.isfinite(arrays[name]))[:1]:
            raise FileFormatError(
                f"{path}: NaN or infinite value in row {row + 1}, column {column + 1} of {name}"
            )
    return arrays


def refuse(path: str | Path, name: str, bad: np.ndarray, said: str) -> None:
    """Name the first bad row of an array, from 1 on as MATLAB counts, if there is one.

    Raises
    ------
    FileFormatError
    """
    for row in np.flatnonzero(bad)[:1]:
        raise FileFormatError(f"{path}: {said} in row {row + 1} of {name}")


def arrays_in(content: bytes) -> dict[str, np.ndarray | None]:
    """All variables of a file.

    Parameters
    ----------
    content : bytes

    Returns
    -------
    dict of ndarray or None
        None for what is no array of real numbers.

    Raises
    ------
    ValueError
        For what is no such file, or a damaged one; says where.
    """
    if len(content) < HEADER or content[126:128] not in (b"IM", b"MI"):
        raise ValueError("no MATLAB file of version 5")
    order = "<" if content[126:128] == b"IM" else ">"
    if struct.unpack(f"{order}H", content[124:126])[0] != 0x0100:
        raise ValueError("another version than 5 of MATLAB's files")
    arrays: dict[str, np.ndarray | None] = {}
    for kind, data in _elements(content[HEADER:], order):
        name, array = _matrix(*_unpacked(kind, data, order), order)
        if name in arrays:
            raise ValueError(f"two arrays {name!r}")
        arrays[name] = array
    return arrays


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Types and data of the elements that follow each other."""
    at = 0
    while at < len(data):
        if len(data) - at < TAG:
            raise ValueError("ends within a tag")
        kind, size = struct.unpack(f"{order}II", data[at : at + TAG])
        start, after = at + TAG, at + TAG + size
        if kind >> 16:  # a small element, size and type in one word
            kind, size = kind & 0xFFFF, kind >> 16
            start, after = at + SMALL, at + TAG
            if size > SMALL:
                raise ValueError(f"a small element of {size} bytes")
        elif kind != COMPRESSED:
            after += -size % TAG
        if start + size > len(data):
            raise ValueError(f"ends within an element of {size} bytes")
        yield kind, data[start : start + size]
        at = after


def _unpacked(kind: int, data: bytes, order: str) -> tuple[int, bytes]:
    """The element inside a compressed one."""
    if kind != COMPRESSED:
        return kind, data
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(data, LARGEST)
    except zlib.error as error:
        raise ValueError(f"an array cannot be unpacked, {error}") from None
    if not unpacker.eof:
        raise ValueError("a compressed array is cut, or too large")
    inside = list(_elements(unpacked, order))
    if len(inside) != 1:
        raise ValueError(f"{len(inside)} elements in a compressed one")
    return inside[0]


def _matrix(kind: int, data: bytes, order: str) -> tuple[str, np.ndarray | None]:
    """Name and array of a matrix."""
    if kind != MATRIX:
        raise ValueError(f"an element of type {kind} where a matrix is wanted")
    parts = _elements(data, order)
    (_, flags), (_, dims), (_, letters) = (next(parts, (0, b"")) for _ in range(3))
    if len(flags) != 8 or len(dims) < 8 or len(dims) % 4:
        raise ValueError("a matrix without kind or size")
    name = letters.decode("latin-1")
    flag = struct.unpack(f"{order}I", flags[:4])[0]
    if flag & 0xFF not in CLASSES or flag & COMPLEX:
        return name, None
    shape = np.frombuffer(dims, f"{order}i4").tolist()
    stored, numbers = next(parts, (0, b""))
    if stored not in STORED or next(parts, None) is not None:
        raise ValueError(f"{name} does not hold numbers of a known type")
    dtype = np.dtype(order + STORED[stored])
    if min(shape) < 0 or len(numbers) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"{name} of size {shape} has {len(numbers)} bytes of {dtype.name}")
    with np.errstate(invalid="ignore"):
        values = np.frombuffer(numbers, dtype).astype(CLASSES[flag & 0xFF])
    return name, values.reshape(shape, order="F")
