"""The figure of a campaign that shows what runs scatter by: mean NEES along each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ekfslam.geometry import Array
from ekfslam.plots.rows import numbers
from ekfslam.plots.sheets import (
    BAND,
    LARGEST,
    Row,
    add_legend,
    counted,
    label_decades,
    name_lines,
    numbered,
    paged,
    plain,
    rows_of,
    sheet,
    text_height,
)
from ekfslam.plots.style import QUIET, TRUTH, Look

_EXPECTED = 3.0  # NEES of a pose
_COORDINATES = ("(x, y, θ)", "invariant")


def plot_run_means(
    runs: pd.DataFrame,
    summary: pd.DataFrame,
    title: str,
    found: Mapping[str, Look],
    lacking: str = "",
) -> dict[str, Figure]:
    """Mean NEES along each run: quartiles, tails, median and mean, and the share that diverged.

    No interval is drawn. The NEES along one run is almost one sample, so that even run means of a
    consistent estimator scatter far around 3. An arrow at the edge is for a median beyond it.

    Parameters
    ----------
    runs : DataFrame
        Runs of a campaign.
    summary : DataFrame
        Of `ekfslam.evaluation.summarise`.
    title : str
        Of the campaign.
    found : dict of Look
        Looks of the estimators by name.
    lacking : str
        What the title says of estimators that are not in the figure.

    Returns
    -------
    dict of Figure
    """
    columns = ("nees_pose_mean_kept", "nees_pose_invariant_mean_kept")
    group = ["scenario", "estimator", "series", "robot"]
    counts = summary.set_index(group)[["diverged", "runs"]]

    def draw(page: list[Row]) -> Figure:
        top = f"{title}: mean NEES of the pose along each run\n{lacking}"
        with sheet(top, [text_height(row.estimators) for row in page], 2) as axes:
            for row, panels in zip(page, axes, strict=True):
                names = row.estimators
                for panel, column in zip(panels, columns, strict=True):
                    for place, name in enumerate(names):
                        _draw_box(panel, numbers(row.of(name), column), place, found[name].color)
                    panel.axvline(_EXPECTED, color=TRUTH, linewidth=0.6, zorder=1)
                    panel.set_xscale("log")
                name_lines(panels, names)
                _share_decades(panels, numbers(row.table, *columns))
                for place, name in enumerate(names):
                    diverged, of = counts.loc[tuple(row.of(name)[group].iloc[0])]
                    _say_beside(panels[1], place, f"{diverged} of {of}")
                _say_beside(panels[1], -0.6, "diverged", va="bottom")
                runs_each = row.table["seed"].nunique()
                words = f"{row.title}: {counted(runs_each, runs_each, 'run')}"
                panels[0].set_title(words, loc="left")
            for panel, name in zip(axes[-1], _COORDINATES, strict=True):
                panel.set_xlabel(f"mean NEES along a run, {name}")
            handles = _box_handles() | _arrow_handles(axes)
            add_legend(axes[0, 0].figure, [], found, handles)
        return axes[0, 0].figure

    pages = paged(rows_of(runs, *columns), lambda row: text_height(row.estimators))
    return numbered("run-means", map(draw, pages))


def _draw_box(panel: Axes, values: Array, place: int, color: str) -> None:
    values = values[np.isfinite(values)]
    if not len(values):
        return
    if values.max() > LARGEST:  # a row would look as if there were nothing, or no more
        face = color if np.median(values) > LARGEST else "white"
        at_edge: dict[str, Any] = {"transform": panel.get_yaxis_transform(), "markersize": 4}
        panel.plot(0.98, place, ">", color=color, markerfacecolor=face, zorder=5, **at_edge)
    low, first, median, third, high = np.quantile(values, [0.05, 0.25, 0.5, 0.75, 0.95])
    panel.hlines(place, low, high, color=color, linewidth=0.8)
    panel.barh(place, third - first, left=first, height=0.6, color=color, alpha=0.35, linewidth=0)
    panel.vlines(median, place - 0.3, place + 0.3, color=color, linewidth=1.6)
    tails = values[(values < low) | (values > high)]
    panel.plot(tails, np.full(len(tails), place), ".", color=color, markersize=2, alpha=0.7)
    panel.plot(
        values.mean(),
        place,
        "D",
        color=color,
        markersize=3.5,
        markeredgecolor="white",
        markeredgewidth=0.5,
        zorder=4,
    )


def _share_decades(panels: Sequence[Axes], values: Array) -> None:
    values = values[np.isfinite(values) & (values > 0) & (values <= LARGEST)]
    low = min(float(values.min(initial=1.0)), 1.0)
    high = max(float(values.max(initial=10.0)), 10.0)
    for panel in panels:
        panel.set_xlim(low / 1.3, high * 1.3)
        label_decades(panel.xaxis, high / low)


def _say_beside(panel: Axes, height: float, text: str, va: str = "center_baseline") -> None:
    panel.annotate(
        text,
        (1.0, height),
        xycoords=panel.get_yaxis_transform(),
        xytext=(3, 0),
        textcoords="offset points",
        va=va,
        fontsize=7,
    )


def _arrow_handles(axes: np.ndarray) -> dict[str, Any]:
    """Of the arrows that there are."""
    arrows = [line for panel in axes.flat for line in panel.lines if line.get_marker() == ">"]
    hollow = {arrow.get_markerfacecolor() == "white" for arrow in arrows}
    look: dict[str, Any] = {"color": QUIET, "marker": ">", "markersize": 4, "linestyle": "none"}
    some, most = f"some above {plain(LARGEST)}", f"median above {plain(LARGEST)}"
    return ({some: Line2D([], [], markerfacecolor="white", **look)} if True in hollow else {}) | (
        {most: Line2D([], [], **look)} if False in hollow else {}
    )


def _box_handles() -> dict[str, Any]:
    def line(**more: Any) -> Line2D:
        return Line2D([], [], color=QUIET, **({"linestyle": "none"} | more))

    return {
        "quartiles": Patch(**BAND),
        "5 % to 95 % of the runs": line(linestyle="-", linewidth=0.8),
        "runs beyond": line(marker=".", markersize=3),
        "median": line(marker="|", markersize=7, markeredgewidth=1.6),
        "mean": line(marker="D", markersize=3.5),
        "expected: 3": Line2D([], [], color=TRUTH, linewidth=0.6),
    }
