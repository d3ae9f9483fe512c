"""Text files of numbers, plain or compressed, read line by line so that an error names its line."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekfslam.errors import FileFormatError
from ekfslam.geometry import Array


class Line(NamedTuple):
    """A line that holds something: its number, from 1 on, and its words."""

    number: int
    words: list[str]


class Table(NamedTuple):
    """Rows of numbers.

    Attributes
    ----------
    path : Path
    values : (n, c) ndarray
    lines : (n,) ndarray of int
        Line of the file that each row is from.
    """

    path: Path
    values: Array
    lines: np.ndarray

    def __len__(self) -> int:
        return len(self.values)

    def refuse(self, bad: np.ndarray, said: str) -> None:
        """Name the line of the first bad row, if there is one.

        Raises
        ------
        FileFormatError
        """
        for row in np.flatnonzero(bad)[:1]:
            raise FileFormatError(f"{self.path}, line {self.lines[row]}: {said}")

    def rows(self, which: np.ndarray) -> Table:
        """Some of the rows."""
        return Table(self.path, self.values[which], self.lines[which])


def read_text(path: str | Path) -> str:
    """The text of a file, which may be compressed (``.gz``); line ends of any kind are taken.

    Raises
    ------
    FileFormatError
        If it cannot be read, is no text, or is empty.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
        if path.suffix == ".gz":
            content = gzip.decompress(content)
        text = content.decode("utf-8-sig")
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: cannot be read ({error})") from None
    if not text.strip():
        raise FileFormatError(f"{path}: is empty")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def lines_of(path: str | Path, comment: str = "#") -> Iterator[Line]:
    """Lines that hold something other than a comment.

    Raises
    ------
    FileFormatError
        As `read_text`.
    """
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        words = line.partition(comment)[0].split()
        if words:
            yield Line(number, words)


def read_table(path: str | Path, columns: Sequence[str], comment: str = "#") -> Table:
    """A file of rows of numbers.

    Parameters
    ----------
    path : path
    columns : sequence of str
        Their names, for errors; every line has so many numbers.
    comment : str
        What the rest of a line is left out after.

    Raises
    ------
    FileFormatError
        For a file that cannot be read or holds no row, and for a line with another count of
        numbers, or with something that is no finite number; names file and line.
    """
    path = Path(path)
    lines, rows = [], []
    for number, words in lines_of(path, comment):
        rows.append(numbers(path, number, words, columns))
        lines.append(number)
    if not rows:
        raise FileFormatError(f"{path}: holds no row of {', '.join(columns)}")
    return Table(path, np.array(rows), np.array(lines))


def numbers(
    path: Path, number: int, words: Sequence[str], columns: Sequence[str], record: str = ""
) -> list[float]:
    """The numbers of a line, one for each column, all finite.

    Parameters
    ----------
    path : Path
    number : int
        Of the line.
    words : sequence of str
    columns : sequence of str
    record : str
        What the line is a record of, for errors.

    Raises
    ------
    FileFormatError
        Names file, line and column.
    """
    of = f" of {record}" if record else ""
    if len(words) != len(columns):
        raise FileFormatError(
            f"{path}, line {number}: {len(columns)} numbers{of} are wanted "
            f"({', '.join(columns)}), there are {len(words)}"
        )
    values = []
    for word, name in zip(words, columns, strict=True):
        try:
            value = _number(word)
        except ValueError:
            raise FileFormatError(
                f"{path}, line {number}: {name}{of} is no number but {word[:40]!r}"
            ) from None
        if not np.isfinite(value):
            raise FileFormatError(f"{path}, line {number}: {name}{of} is {word[:40]}")
        values.append(value)
    return values


def _number(word: str) -> float:
    if "_" in word:  # Python's own way to write numbers
        raise ValueError
    return float(word)


def whole(table: Table, column: int, name: str, least: int = 0) -> np.ndarray:
    """A column of whole numbers.

    Raises
    ------
    FileFormatError
        Names the line of one that is not, or is below the least.
    """
    values = table.values[:, column]
    table.refuse(values != np.floor(values), f"{name} is no whole number")
    table.refuse((values < least) | (values > 2**53), f"{name} is not a number from {least} on")
    return values.astype(np.int64)
