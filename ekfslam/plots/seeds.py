"""The figure of an assertion: the numbers of each seed, and what they are held against."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ekfslam.plots.rows import numbers
from ekfslam.plots.sheets import add_legend, sheet
from ekfslam.plots.style import QUIET, TRUTH, Look, look

_MOST = 4  # panels that fit on a page


def plot_seeds(seeds: pd.DataFrame, name: str) -> Figure:
    """Numbers of each seed, a panel for each scenario and metric.

    Parameters
    ----------
    seeds : DataFrame
        ``scenario``, ``what``, ``seed`` and ``now``; ``stored`` where the same seeds were run
        before, ``claim`` where the mean is held against a number. Drawn in the order of the rows.
    name : str
        Of the estimator.

    Returns
    -------
    Figure
    """
    groups = [part for _, part in seeds.groupby(["scenario", "what"], sort=False)][:_MOST]
    own = look(name)
    with sheet(f"{name}: each seed, worst first", [1.8] * len(groups), 1) as axes:
        for panel, part in zip(axes[:, 0], groups, strict=True):
            _draw(panel, part, own)
            panel.set_title(str(part["scenario"].iloc[0]), loc="left")
            panel.set_ylabel(str(part["what"].iloc[0]))
        axes[-1, 0].set_xlabel("seeds, in order")
        add_legend(axes[0, 0].figure, [], {}, _handles(seeds, own))
    return axes[0, 0].figure


def _draw(panel: Axes, part: pd.DataFrame, own: Look) -> None:
    place, now = np.arange(len(part)), numbers(part, "now")
    panel.plot(place, now, own.marker, color=own.color, markersize=3)
    panel.axhline(float(now.mean()), color=own.color, linewidth=0.8)
    if "stored" in part:
        stored = numbers(part, "stored")
        panel.vlines(place, stored, now, color=QUIET, linewidth=0.5, zorder=1)
        panel.plot(place, stored, "o", color=TRUTH, markersize=3, markerfacecolor="white")
        panel.axhline(float(stored.mean()), color=TRUTH, linewidth=0.8, linestyle="--")
    if "claim" in part:
        panel.axhline(float(part["claim"].iloc[0]), color=TRUTH, linewidth=0.8, linestyle="--")
    panel.set_ylim(bottom=min(0.0, float(now.min())))


def _handles(seeds: pd.DataFrame, own: Look) -> dict[str, Line2D]:
    dots: dict[str, Any] = {"linestyle": "none", "markersize": 3.5}
    handles = {
        "now": Line2D([], [], color=own.color, marker=own.marker, **dots),
        "mean": Line2D([], [], color=own.color, linewidth=0.8),
    }
    if "stored" in seeds:
        handles["before"] = Line2D([], [], color=TRUTH, marker="o", markerfacecolor="white", **dots)
        handles["mean before"] = Line2D([], [], color=TRUTH, linewidth=0.8, linestyle="--")
    if "claim" in seeds:
        handles["claimed of the mean"] = Line2D([], [], color=TRUTH, linewidth=0.8, linestyle="--")
    return handles
