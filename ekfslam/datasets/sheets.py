"""Tables of cells, of a DataFrame or a CSV file: an error names file, line and column."""

from __future__ import annotations

import re
import zlib
from collections.abc import Collection, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
import pandas as pd

from ekfslam.errors import FileFormatError, InputError
from ekfslam.geometry import Array

LARGEST = 2**63 - 1
_CELLS = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")


class Sheet(NamedTuple):
    """A table.

    Attributes
    ----------
    name : str
        What errors call it: a path, or the name of an argument.
    frame : DataFrame
        Of a file, all cells are text.
    lines : (n,) ndarray of int, optional
        Line of the file that each row is from.
    """

    name: str
    frame: pd.DataFrame
    lines: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.frame)

    def has(self, column: str) -> bool:
        """Whether there is such a column."""
        return column in self.frame.columns

    def place(self, row: int) -> str:
        """A row as errors call it: lines of a file are counted from 1, rows of a frame from 0."""
        return f"row {row}" if self.lines is None else f"line {self.lines[row]}"

    def refuse(self, said: str, row: int | None = None, column: str = "") -> NoReturn:
        """Say what is wrong with the table, or a row or a cell of it.

        Raises
        ------
        FileFormatError, InputError
            Of a file, and of a DataFrame.
        """
        where = self.name if row is None else f"{self.name}, {self.place(row)}"
        where += f", column {column}" if column else ""
        raise (InputError if self.lines is None else FileFormatError)(f"{where}: {said}")

    def refuse_where(self, bad: np.ndarray, said: str, column: str = "") -> None:
        """Refuse the first bad row, if there is one."""
        for row in np.flatnonzero(bad)[:1]:
            self.refuse(said, int(row), column)

    def check_columns(self, known: Collection[str], needed: Collection[str] = ()) -> None:
        """Refuse columns that have no meaning, that are there twice, or that are missing."""
        columns = [str(column) for column in self.frame.columns]
        listed = ", ".join(name for name in known if not name.startswith("cov_"))
        for column in columns:
            if column not in known:
                close = get_close_matches(column, known, n=2)
                hint = f"did you mean {' or '.join(close)}?" if close else f"known: {listed}"
                if ";" in column or "\t" in column:
                    hint = "columns are separated by commas"
                self.refuse(f"unknown column {column!r}; {hint}")
            if columns.count(column) > 1:
                self.refuse(f"the column {column!r} is there twice")
        for column in needed:
            if column not in columns:
                self.refuse(f"the column {column!r} is missing; there are: {', '.join(columns)}")

    def numbers(self, column: str, rows: Any = slice(None), blank: bool = False) -> Array:
        """A column of numbers.

        Parameters
        ----------
        column : str
        rows : index
            Which rows to read.
        blank : bool
            Whether cells may be blank, which is then NaN; all others must be finite.
        """
        which = np.arange(len(self))[rows]
        cells = self.frame[column].to_numpy(dtype=object)[which]
        values = np.empty(len(which))
        for at, (row, cell) in enumerate(zip(which.tolist(), cells, strict=True)):
            try:
                values[at] = _number(cell)
            except (TypeError, ValueError, OverflowError):
                self.refuse(f"is no number but {str(cell)[:40]!r}", row, column)
        bad = np.isinf(values) if blank else ~np.isfinite(values)
        for at in np.flatnonzero(bad)[:1]:
            infinite = np.isinf(values[at])
            self.refuse("is infinite" if infinite else "is blank", int(which[at]), column)
        return values

    def whole(
        self, column: str, least: int = 0, blank: int | None = None, rows: Any = slice(None)
    ) -> np.ndarray:
        """A column of whole numbers from `least` on; `blank` stands for blank cells, if given."""
        which = np.arange(len(self))[rows]
        cells = self.frame[column].to_numpy(dtype=object)[which]
        values = np.empty(len(which), dtype=np.int64)
        for at, (row, cell) in enumerate(zip(which.tolist(), cells, strict=True)):
            try:
                read = _whole(cell)
            except (TypeError, ValueError, OverflowError):
                hint = "; number what has names by pandas.factorize" if "land" in column else ""
                self.refuse(f"is no whole number but {str(cell)[:40]!r}{hint}", row, column)
            value = blank if read is None else read
            if value is None:
                self.refuse("is blank", row, column)
            if value != blank and not least <= value <= LARGEST:
                self.refuse(f"is {value}, not a number from {least} on", row, column)
            values[at] = value
        return values

    def named(
        self, column: str, known: Sequence[str], what: str, blank: int | None = None
    ) -> np.ndarray:
        """A column of names, as their indices; without the column, that of the only one.

        Parameters
        ----------
        column : str
        known : sequence of str
        what : str
            What they are names of.
        blank : int, optional
            What a blank cell stands for, if any may be.
        """
        if not self.has(column):
            if len(known) != 1 and len(self):
                listed = ", ".join(known)
                self.refuse(f"the column {column!r} is missing, which names a {what}: {listed}")
            return np.zeros(len(self), dtype=np.int64)
        index = {name: number for number, name in enumerate(known)}
        values = np.empty(len(self), dtype=np.int64)
        for row, cell in enumerate(self.frame[column].to_numpy(dtype=object)):
            name = str(cell) if isinstance(cell, str) or not _blank(cell) else ""
            found = index.get(name, index.get(name.strip()))
            if found is None and not name.strip():
                found = blank
            if found is None:
                listed = ", ".join(known) or "none"
                said = f"no {what} is called {name!r}; known: {listed}" if name else "is blank"
                self.refuse(said, row, column)
            values[row] = found
        return values

    def filled(self, column: str) -> np.ndarray:
        """Whether the cells of a column hold something, (n,) of bool; none do if there is none."""
        if not self.has(column):
            return np.zeros(len(self), dtype=bool)
        cells = self.frame[column].to_numpy(dtype=object)
        return np.array([not _blank(cell) for cell in cells], dtype=bool)


def read_csv(path: Path) -> Sheet:
    """A CSV file, which may be compressed, with its first line as the names of columns.

    Lines without a cell that holds something are left out.

    Raises
    ------
    FileFormatError
        If it cannot be read, or a line has more cells than the first; says which.
    """
    try:
        cells = pd.read_csv(
            path,
            header=None,
            dtype=str,
            keep_default_na=False,
            skip_blank_lines=False,
            encoding="utf-8-sig",
        ).fillna("")
    except pd.errors.EmptyDataError:
        said = "is empty, or its first line is, which has to name the columns"
        raise FileFormatError(f"{path}: {said}") from None
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except pd.errors.ParserError as error:
        found = _CELLS.search(str(error))
        if found is None:
            raise FileFormatError(f"{path}: cannot be read ({str(error).strip()})") from None
        first, line, count = found.groups()
        raise FileFormatError(
            f"{path}, line {line}: {count} cells, where the first line has {first}; "
            "commas separate cells, and numbers have a decimal point"
        ) from None
    except (OSError, EOFError, zlib.error, UnicodeError) as error:
        raise FileFormatError(f"{path}: cannot be read ({str(error).strip()})") from None
    lines = np.arange(1, len(cells) + 1)
    held = cells.apply(lambda column: column.str.strip() != "").any(axis=1).to_numpy()
    cells, lines = cells[held], lines[held]
    if not len(cells):
        raise FileFormatError(f"{path}: is empty")
    frame = cells.iloc[1:].reset_index(drop=True)
    frame.columns = pd.Index([name.strip() for name in cells.iloc[0]])
    return Sheet(str(path), frame, lines[1:])


def _blank(cell: Any) -> bool:
    """Whether a cell holds nothing, or what stands for that: NaN."""
    if isinstance(cell, str):
        return cell.strip().lower() in ("", "nan")
    return cell is None or cell is pd.NA or (isinstance(cell, float) and cell != cell)


def _number(cell: Any) -> float:
    """NaN for a blank cell."""
    if _blank(cell):
        return np.nan
    if isinstance(cell, bool | np.bool_) or (isinstance(cell, str) and "_" in cell):
        raise ValueError  # what Python takes for a number besides
    return float(cell)


def _whole(cell: Any) -> int | None:
    """None for a blank cell; all digits of a large number are kept."""
    if isinstance(cell, str) and cell.strip().lstrip("+-").isdecimal():
        return int(cell)
    if isinstance(cell, int | np.integer) and not isinstance(cell, bool):
        return int(cell)
    value = _number(cell)
    if value != value:
        return None
    if value != int(value) or abs(value) > 2**53:
        raise ValueError
    return int(value)
