"""One file per record: arrays and a JSON header in a NumPy archive, without loss.

No pickles: a file from elsewhere can do no harm. The same record gives the same bytes. Arrays are
compressed but for large ones: the digits of a joint covariance are all different, so that it would
take a minute for a file some 5 % smaller. They are written and read piece by piece, without a copy.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

import numpy as np

from ekfslam.errors import FileFormatError, InputError

LARGE = 2**25
"""Bytes from which on an array is not compressed: a covariance of some 2000 rows."""


@contextmanager
def atomic_write(path: str | Path) -> Iterator[BinaryIO]:
    """Open a file that takes the place of `path` only when it has been written whole.

    Parameters
    ----------
    path : path

    Raises
    ------
    InputError
        If the folder does not exist or cannot be written to, or the disk is full.
    """
    path = Path(path)
    scratch = None
    try:
        handle, scratch = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())  # the name must not reach the disk before the content
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(scratch, 0o666 & ~umask)  # mkstemp keeps others out
        os.replace(scratch, path)
        scratch = None
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from None
    finally:
        if scratch is not None:
            Path(scratch).unlink(missing_ok=True)


def _plain(value: Any) -> Any:
    """NumPy's numbers and arrays as JSON holds them."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise InputError(f"cannot save {value!r}: only numbers, text and lists of them")


class Writer:
    """Collects a header and arrays, then writes them as one file."""

    def __init__(self, form: str, version: int) -> None:
        self.header: dict[str, Any] = {"format": form, "version": version}
        self._arrays: dict[str, np.ndarray] = {}

    def put(self, name: str, array: np.ndarray | None) -> None:
        """Add an array; None is left out."""
        if array is not None:
            self._arrays[name] = array

    def save(self, path: str | Path) -> None:
        """Write the file, whole or not at all."""
        content = self.header | {"arrays": list(self._arrays)}
        header = np.frombuffer(json.dumps(content, default=_plain).encode(), dtype=np.uint8)
        with atomic_write(path) as stream, ZipFile(stream, "w") as archive:
            for name, array in {"header": header, **self._arrays}.items():
                entry = ZipInfo(f"{name}.npy")
                entry.compress_type = ZIP_STORED if array.nbytes >= LARGE else ZIP_DEFLATED
                with archive.open(entry, "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)


class Reader:
    """Reads what `Writer` wrote; whatever is wrong with the file is a `FileFormatError`."""

    def __init__(self, path: str | Path, form: str, version: int) -> None:
        self.path, self._form, self._version = Path(path), form, version

    def __enter__(self) -> Reader:
        if not self.path.is_file():
            raise FileFormatError(f"{self.path}: no such file")
        try:
            with self.path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
                self._arrays = {name: archive[name] for name in archive.files}
            self.header = json.loads(self._arrays.pop("header").tobytes())
            form, version = self.header["format"], self.header["version"]
        except Exception:  # whatever a damaged archive sets off
            raise FileFormatError(f"{self.path}: damaged, or not a file of this package") from None
        if form != self._form:
            raise FileFormatError(f"{self.path}: holds {form}, not {self._form}")
        if not isinstance(version, int):
            raise FileFormatError(f"{self.path}: damaged, {version!r} is no version")
        if version > self._version:
            raise FileFormatError(
                f"{self.path}: has format version {version}, newer than {self._version}, "
                "which this ekfslam reads; update ekfslam"
            )
        if self.header.get("arrays") != list(self._arrays):
            raise FileFormatError(f"{self.path}: damaged, arrays are missing")
        return self

    def get(self, name: str) -> Any:
        """An array, or None if the file does not hold it."""
        return self._arrays.get(name)

    def need(self, name: str) -> np.ndarray:
        """An array that must be there."""
        if name not in self._arrays:
            raise FileFormatError(f"{self.path}: damaged, {name} is missing")
        return self._arrays[name]

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, Exception) and not isinstance(error, FileFormatError):
            raise FileFormatError(f"{self.path}: damaged ({error})") from None
