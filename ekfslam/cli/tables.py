"""Tables of which every number is readable, in a terminal of any width and in a pipe.

In a terminal that is too narrow a table goes on below itself. In a pipe every row is one line,
however long, for other programs to read. Colours follow NO_COLOR and FORCE_COLOR.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Sequence
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from ekfslam.cli.columns import Column

if TYPE_CHECKING:
    import pandas as pd

WIDE = 150  # columns of text in a pipe
ENDLESS = 10_000
HEADINGS = {"odometry_noise": "noise"}


def console(width: int | None = None) -> Console:
    """Standard output, as wide as a terminal is; no escapes at all if NO_COLOR is set."""
    colours: Any = None if os.environ.get("NO_COLOR") else "auto"
    return Console(width=width or terminal_width() or WIDE, color_system=colours, highlight=False)


def terminal_width() -> int | None:
    """Columns of the terminal, which COLUMNS overrides; None if there is none to fit into."""
    return get_terminal_size().columns if sys.stdout.isatty() else None


def print_table(
    rows: pd.DataFrame,
    lead: Sequence[str],
    columns: Iterable[Column],
    title: str,
    apart: str | None = None,
) -> None:
    """Print some columns of text or keys, and those of the numbers that are known in any row.

    Parameters
    ----------
    rows : DataFrame
    lead : sequence of str
        Columns of text, which stand before those of numbers.
    columns : iterable of Column
    title : str
    apart : str, optional
        Rows of different values of this column are kept apart.
    """
    left = [column for column in columns if rows[column.name].notna().any()]
    width = terminal_width() or ENDLESS
    console().print(escape(title), style="bold", soft_wrap=True)
    while True:
        some = list(left)
        while len(some) > 1 and needed(_table(rows, lead, some, apart)) > width:
            some.pop()
        table = _table(rows, lead, some, apart)
        console(needed(table)).print(table)  # as wide as it is: a long name costs no number
        left = left[len(some) :]
        if not left:
            return


def needed(table: Table) -> int:
    """How wide a table is if nothing in it is wrapped."""
    wide = console(ENDLESS)
    return Measurement.get(wide, wide.options, table).maximum


def known(value: Any) -> bool:
    """Whether a cell says something."""
    import pandas as pd

    return not pd.isna(value)


def _table(
    rows: pd.DataFrame,
    lead: Sequence[str],
    columns: Sequence[Column],
    apart: str | None,
) -> Table:
    table = Table(box=None)
    for name in lead:
        table.add_column(escape(HEADINGS.get(name, name)), no_wrap=True)
    for column in columns:
        table.add_column(escape(column.heading), justify="right", no_wrap=True)
    before = None
    for _, row in rows.iterrows():
        if apart is not None and before is not None and row[apart] != before:
            table.add_row()
        before = None if apart is None else row[apart]
        words = [escape(_word(row[name])) for name in lead]
        table.add_row(*words, *(_text(row[c.name], c.form) for c in columns))
    return table


def _word(value: Any) -> str:
    if isinstance(value, float):
        return "" if value != value else f"{value:g}"
    return str(value) if known(value) else ""


def _text(value: Any, form: Callable[[Any], str]) -> str:
    return form(value) if known(value) else ""
