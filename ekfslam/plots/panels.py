"""What the panels of figures against time share: lines that break, words, one legend."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ekfslam.geometry import Array
from ekfslam.plots.rows import Series, isolated, numbers
from ekfslam.plots.style import COLUMN, add_key, drawing
from ekfslam.plots.thinning import seen

INTERVAL = "95 % interval"
FEW = 200
"""Points that have room for a marker that shows its form."""


def draw_lines(panel: Axes, curves: Iterable[tuple[Series, Array]]) -> None:
    """Values of series against time, each in its look."""
    for series, values in curves:
        color, _, linestyle = series.look
        shown = seen(values)
        time, values = numbers(series.rows, "time_s")[shown], values[shown]
        draw_line(panel, time, values, color=color, linestyle=linestyle, label=series.estimator)


def draw_line(panel: Axes, time: Array, values: Array, **look: Any) -> None:
    """A line that breaks where values are missing, with dots where it would not be seen."""
    panel.plot(time, values, linewidth=0.8, **look)
    alone = isolated(values)
    if alone.any():
        dots = {"linestyle": "none", "marker": ".", "markersize": 2, "color": look["color"]}
        panel.plot(time[alone], values[alone], **dots)


def finish(figure: Figure, title: str, axes: Iterable[Axes]) -> None:
    """Title, and one legend for all panels."""
    handles: dict[str, Artist] = {}
    for panel in axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    labels = sorted(handles, key=INTERVAL.__eq__)  # estimators first
    figure.suptitle(title)
    add_key(figure, {label: handles[label] for label in labels}, most=4, markerscale=2)


def nothing(title: str, message: str) -> Figure:
    """A small figure that says why there is none."""
    with drawing(COLUMN, 1.0) as figure:
        figure.suptitle(title)
        figure.text(0.5, 0.4, message, ha="center")
    return figure


def say(panel: Axes, words: str) -> None:
    """Words at the top of a panel, over what is drawn there."""
    box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    panel.text(
        0.5,
        0.96,
        words,
        transform=panel.transAxes,
        ha="center",
        va="top",
        fontsize=6,
        bbox=box,
    )
