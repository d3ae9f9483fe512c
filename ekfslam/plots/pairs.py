"""The figure of a campaign that compares estimators on the same seeds."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator, SymmetricalLogLocator

from ekfslam.plots.rows import numbers, typical
from ekfslam.plots.sheets import (
    Row,
    add_legend,
    counted,
    name_lines,
    numbered,
    paged,
    sheet,
    text_height,
)
from ekfslam.plots.style import QUIET, TRUTH, Look

_ABREAST = 2  # metrics that have room beside each other


def plot_pairs(
    pairs: pd.DataFrame, title: str, found: Mapping[str, Look], lacking: str = ""
) -> dict[str, Figure]:
    """Mean differences of estimators on the same seeds, with their intervals.

    A difference is filled where it is seen: where the p adjusted for all comparisons says so, see
    `ekfslam.evaluation.compare_pairs`. The scale is linear near zero and logarithmic far from it if
    the differences span decades.

    Parameters
    ----------
    pairs : DataFrame
        Of `ekfslam.evaluation.compare_pairs`.
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
    top = f"{title}: differences on the same seeds\n{lacking}"
    pairs = pairs[np.isfinite(numbers(pairs, "mean_difference"))]
    names = list(pairs["metric"].unique())
    figures = []
    for metrics in (names[i : i + _ABREAST] for i in range(0, len(names), _ABREAST)):
        some = pairs[pairs["metric"].isin(metrics)]
        for page in paged(_scenarios(some), lambda row: text_height(_compared(row.table))):
            figures.append(_draw_pairs(page, metrics, some, top, found))
    return numbered("pairs", figures)


def _scenarios(pairs: pd.DataFrame) -> list[Row]:
    several = pairs["robot"].nunique() > 1
    names = ["scenario", "robot"] if several else ["scenario"]
    return [
        Row(", ".join(str(part[name].iloc[0]) for name in names), part)
        for _, part in pairs.groupby(["scenario", "robot"], sort=False)
    ]


def _compared(pairs: pd.DataFrame) -> list[tuple[str, str]]:
    return list(dict.fromkeys(zip(pairs["a"], pairs["b"], strict=True)))


def _draw_pairs(
    page: list[Row],
    metrics: Sequence[str],
    pairs: pd.DataFrame,
    top: str,
    found: Mapping[str, Look],
) -> Figure:
    heights = [text_height(_compared(row.table)) for row in page]
    with sheet(top, heights, len(metrics), sharex="col") as axes:
        for row, panels in zip(page, axes, strict=True):
            compared = _compared(row.table)
            for panel, metric in zip(panels, metrics, strict=True):
                _draw_forest(panel, row.table[row.table["metric"] == metric], compared, found)
            name_lines(panels, [f"{a} − {b}" for a, b in compared])
            panels[0].set_title(f"{row.title}: {_seeds(row.table)}", loc="left")
        for panel, metric in zip(axes[-1], metrics, strict=True):
            _scale_differences(panel, pairs[pairs["metric"] == metric])
            panel.set_xlabel(f"mean difference of\n{_with_unit(metric)}")
        percent = f"{100 * numbers(pairs, 'probability')[0]:g}"
        known = np.isfinite(numbers(pd.concat(row.table for row in page), "half_width"))
        add_legend(axes[0, 0].figure, [], found, _forest_handles(percent, known))
    return axes[0, 0].figure


def _draw_forest(
    panel: Axes,
    rows: pd.DataFrame,
    compared: list[tuple[str, str]],
    found: Mapping[str, Look],
) -> None:
    panel.axvline(0.0, color=TRUTH, linewidth=0.6, zorder=1)
    means, widths = numbers(rows, "mean_difference", "half_width").T
    seen = rows["better"].notna().to_numpy()
    for a, b, mean, width, sure in zip(rows["a"], rows["b"], means, widths, seen, strict=True):
        own = found[_competitor(a)]
        panel.errorbar(
            mean,
            compared.index((a, b)),
            xerr=width if np.isfinite(width) else None,
            color=own.color,
            marker="o",
            markersize=3.5,
            markerfacecolor=own.color if sure else "white",
            markeredgewidth=0.8,
            elinewidth=0.9,
            capsize=1.5,
        )


def _scale_differences(panel: Axes, rows: pd.DataFrame) -> None:
    """Linear, or symmetric logarithmic where one interval would squash the others to points."""
    means, widths = np.nan_to_num(numbers(rows, "mean_difference", "half_width")).T
    reaches = np.abs(means) + widths
    small, large = typical(list(reaches[reaches > 0])), float(reaches.max())
    if large > 8 * small:
        linear = 10.0 ** np.floor(np.log10(small))
        panel.set_xscale("symlog", linthresh=linear)
        ends = np.array([min((means - widths).min(), 0.0), max((means + widths).max(), 0.0)])
        shown = panel.xaxis.get_transform()
        low, high = shown.transform(ends)
        margin = 0.05 * (high - low)
        panel.set_xlim(*shown.inverted().transform(np.array([low - margin, high + margin])))
        places = SymmetricalLogLocator(base=10.0, linthresh=linear)
        places.set_params(numticks=5)
        panel.xaxis.set_major_locator(places)
        panel.xaxis.set_minor_locator(NullLocator())


def _forest_handles(percent: str, known: np.ndarray) -> dict[str, Line2D]:
    """Of intervals, some or all of which may not be known: too few seeds, which is no verdict."""
    appearance: dict[str, Any] = {"color": QUIET, "marker": "o", "markersize": 3.5, "linestyle": ""}
    interval = {
        f"{percent} % interval of each alone": Line2D([], [], color=QUIET),
        "seen, p adjusted for all": Line2D([], [], **appearance),
    }
    unseen = ["not seen"] * bool(known.any()) + ["too few seeds to tell"] * (not known.all())
    open_mark = {", or ".join(unseen): Line2D([], [], markerfacecolor="white", **appearance)}
    return (interval if known.any() else {}) | open_mark


def _with_unit(metric: str) -> str:
    """A column of the tables, whose unit is the end of its name."""
    name, _, unit = metric.rpartition("_")
    return f"{name} [{unit}]" if unit in ("m", "rad", "s") else metric


def _competitor(name: str) -> str:
    """The estimator without the series in which it competes."""
    return re.sub(r" \((online|smoothed)\)$", "", str(name))


def _seeds(rows: pd.DataFrame) -> str:
    return counted(int(rows["seeds"].min()), int(rows["seeds"].max()), "seed")
