"""Tables of the page: what each cell shows, and the exact number that it sorts by."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import pandas as pd

from ekfslam.report.words import digits, known


class Cell(NamedTuple):
    """What a cell shows, and the number it stands for, with every digit; empty for text."""

    text: str
    value: str = ""


class Heading(NamedTuple):
    """A column: what it is called, and whether it holds numbers."""

    text: str
    numeric: bool


class Table(NamedTuple):
    """A table of the page.

    Attributes
    ----------
    key : str
        Unique on the page.
    caption : str
    headings : list of Heading
    rows : list of list of Cell
        The first cell of each is its heading.
    """

    key: str
    caption: str
    headings: list[Heading]
    rows: list[list[Cell]]


class Column(NamedTuple):
    """A column of a table of which only some are shown."""

    name: str
    heading: str
    form: Callable[[Any], str] = digits


def selected(
    key: str,
    caption: str,
    rows: pd.DataFrame,
    lead: Sequence[str],
    columns: Iterable[Column],
    last: Sequence[str] = (),
) -> Table:
    """Names in front, then those of the columns that hold anything, then other text.

    Parameters
    ----------
    key, caption : str
    rows : DataFrame
    lead, last : sequence of str
        Columns of text.
    columns : iterable of Column
        Numbers.
    """
    shown = [column for column in columns if rows[column.name].notna().any()]
    headings = [Heading(name.replace("_", " "), False) for name in lead]
    headings += [Heading(column.heading, True) for column in shown]
    headings += [Heading(name, False) for name in last]
    cells = []
    for _, row in rows.iterrows():
        numbers = [_number(row[column.name], column.form) for column in shown]
        cells.append([*(_text(row[n]) for n in lead), *numbers, *(_text(row[n]) for n in last)])
    return Table(key, caption, headings, cells)


def complete(key: str, caption: str, rows: pd.DataFrame) -> Table:
    """Every column that holds anything, as its file calls it."""
    filled = [name for name in rows.columns if rows[name].notna().any()]
    numeric = {name: pd.api.types.is_numeric_dtype(rows[name].dtype) for name in filled}
    cells = [
        [_number(row[n], digits) if numeric[n] else _text(row[n]) for n in filled]
        for _, row in rows.iterrows()
    ]
    return Table(key, caption, [Heading(name, numeric[name]) for name in filled], cells)


def _text(value: Any) -> Cell:
    return Cell(str(value) if known(value) else "")


def _number(value: Any, form: Callable[[Any], str]) -> Cell:
    return Cell(form(value), repr(float(value))) if known(value) else Cell("")
