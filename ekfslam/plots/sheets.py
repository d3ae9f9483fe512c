"""Figures with a row of panels per scenario, over as many pages as they need."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogFormatter, LogLocator, NullLocator

from ekfslam.geometry import Array
from ekfslam.plots.panels import say
from ekfslam.plots.rows import numbers
from ekfslam.plots.style import PAGE, QUIET, Look, add_key, drawing, titled

BAND: dict[str, Any] = {"color": QUIET, "alpha": 0.35, "linewidth": 0.0}
LARGEST = 1e6
"""Where NEES is cut: a filter that is lost can reach any number."""

_TALLEST = 8.5  # of the panels of a page together [in]
_AROUND = 0.9  # its title and legend [in]
_HEAD = 0.15  # room for words above what is drawn, as a share of it


class Row(NamedTuple):
    """What a row of panels shows: the runs of a scenario, of one series and robot."""

    title: str
    table: pd.DataFrame

    @property
    def estimators(self) -> list[str]:
        """In order of appearance."""
        return list(self.table["estimator"].astype(str).unique())

    def of(self, estimator: str) -> pd.DataFrame:
        """The rows of one estimator."""
        return self.table[self.table["estimator"].astype(str) == estimator]


def rows_of(table: pd.DataFrame, *columns: str) -> list[Row]:
    """A row per scenario, series and robot that has a number in one of the columns."""
    known = [np.isfinite(numbers(table, column)) for column in columns]
    table = table[np.any(known, axis=0)]
    several = [name for name in ("series", "robot") if table[name].nunique() > 1]
    return [
        Row(", ".join(str(part[name].iloc[0]) for name in ["scenario", *several]), part)
        for _, part in table.groupby(["scenario", "series", "robot"], sort=False)
    ]


def paged(rows: Sequence[Row], height: Callable[[Row], float]) -> list[list[Row]]:
    """Rows by page, as many on each as fit."""
    pages: list[list[Row]] = []
    left = 0.0
    for row in rows:
        if height(row) > left:
            pages.append([])
            left = _TALLEST
        pages[-1].append(row)
        left -= height(row)
    return pages


def numbered(stem: str, figures: Iterable[Figure]) -> dict[str, Figure]:
    """Figures by the stem of their files: ``stem``, ``stem-2``, and so on."""
    return {
        stem if number == 1 else f"{stem}-{number}": figure
        for number, figure in enumerate(figures, start=1)
    }


@contextmanager
def sheet(
    title: str, heights: Sequence[float], columns: int, **shared: Any
) -> Iterator[np.ndarray]:
    """Panels (rows, columns) of a figure; they know which. Long lines of the title are wrapped."""
    heading = titled(PAGE, *title.split("\n"))
    with drawing(PAGE, sum(heights) + _AROUND + 0.15 * heading.count("\n")) as figure:
        figure.suptitle(heading)
        yield figure.subplots(
            len(heights), columns, squeeze=False, height_ratios=list(heights), **shared
        )


def counted(few: int, many: int, what: str) -> str:
    """How many there are of each, as "1 run" or "3 to 5 runs"."""
    several = f"{many}" if few == many else f"{few} to {many}"
    return f"{several} {what}{'s' * (many != 1)}"


def text_height(names: Sequence[Any]) -> float:
    """Height of a panel with a line of text for each name [in]."""
    return 0.42 + 0.14 * len(names)


def name_lines(panels: Sequence[Axes], names: Sequence[str]) -> None:
    """The ordinate of panels beside each other: a line for each name, from the top down."""
    for panel in panels:
        panel.set(ylim=(len(names) - 0.4, -0.6))
        panel.grid(False, axis="y")
        panel.set_yticks(range(len(names)), [])
        panel.tick_params(axis="y", length=0)
    panels[0].set_yticks(range(len(names)), names)


def add_legend(
    figure: Figure,
    estimators: Iterable[str],
    found: Mapping[str, Look],
    others: Mapping[str, Artist] | None = None,
) -> None:
    """One legend for all panels: estimators in the order of their looks, then others."""
    shown, handles = set(estimators), dict[str, Artist]()
    for name in (name for name in found if name in shown):
        look: dict[str, Any] = found[name]._asdict()
        handles[name] = Line2D([], [], markersize=3.5, linewidth=0.9, **look)
    add_key(figure, handles | dict(others or {}), most=5, handlelength=2.6)  # a whole dash-dot


def ends(values: Array, bars: Array) -> Array:
    """What an axis should show of values with bars: not where one goes down to almost nothing."""
    low, high = values - np.nan_to_num(bars), values + np.nan_to_num(bars)
    return np.concatenate([values, high, low[low > values / 3]])


def scale(axes: Axes, values: Array, inside: tuple[float, float], most: float) -> None:
    """Range of an ordinate of positive numbers: logarithmic if they span more than a decade.

    Parameters
    ----------
    axes : Axes
    values : array
        What is drawn.
    inside : (float, float)
        What is in view in any case.
    most : float
        What no value is shown beyond; where there are such, the axes say so.
    """
    positive = values[np.isfinite(values) & (values > 0)]
    shown = positive[positive <= most]
    low = min(float(shown.min(initial=inside[0])), inside[0])
    high = max(float(shown.max(initial=inside[1])), inside[1])
    if len(shown) < len(positive):
        say(axes, f"values above {plain(most)} are cut off")
        high *= (high / low) ** _HEAD if high > 10 * low else 1 + _HEAD
    if high > 10 * low:
        axes.set(yscale="log", ylim=(low / 1.3, high * 1.3))
        label_decades(axes.yaxis, high / low)
    else:
        axes.set_ylim(0.9 * low, 1.05 * high)


def label_decades(axis: Axis, span: float) -> None:
    """Plain numbers on a logarithmic axis, and enough of them where it has few decades."""
    axis.set_major_locator(LogLocator(subs=(1.0, 3.0) if span < 1e3 else (1.0,), numticks=7))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(plain))


def plain_numbers(axis: Axis) -> None:
    """As they are read, on a logarithmic axis: also between the powers of ten, where it has few."""
    axis.set_major_formatter(FuncFormatter(plain))
    axis.set_minor_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(1.0, 0.4)))


def plain(value: float, _: object = None) -> str:
    """A power of ten, or a number that is shorter than one."""
    if 1e-3 <= value < 1e4:
        return f"{value:g}"
    return f"$10^{{{round(np.log10(value))}}}$"
