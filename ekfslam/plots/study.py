"""The figure of a study: what methods reach against the noise that they meet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ekfslam.plots.rows import numbers
from ekfslam.plots.style import METHODS, PAGE, TRUTH, add_key, drawing, look

_DODGE = 0.5  # share of the distance of two scales that the methods spread over


class _Panel(NamedTuple):
    column: str
    label: str
    scale: str = "linear"
    expected: float | None = None


_PANELS = (
    _Panel("precision_mean", "precision"),
    _Panel("recall_mean", "recall"),
    _Panel("share_diverged", "share of diverged runs"),
    _Panel("ate_m_mean", "ATE [m]", "log"),
    _Panel("nees_mean", "NEES of the pose, mean", "log", expected=3.0),
    _Panel("nees_median", "NEES of the pose, median", "log", expected=3.0),
)


def plot_study(summary: pd.DataFrame, title: str = "") -> Figure:
    """Precision, recall, diverged runs, ATE and NEES against the scale of the odometry noise.

    Error bars are one standard error of the mean; shares and medians have none. A bar that would
    reach below zero ends at the foot of its logarithmic panel.

    Parameters
    ----------
    summary : DataFrame
        Of `ekfslam.experiments.association.AssociationStudy`.
    title : str

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If the table lacks columns.
    """
    methods = list(summary["method"].astype(str).unique())
    scales = list(dict.fromkeys(numbers(summary, "odometry_noise")))
    with drawing(PAGE, 4.6) as figure:
        axes = figure.subplots(2, 3, sharex=True)
        for panel, axis in zip(_PANELS, axes.flat, strict=True):
            for index, method in enumerate(methods):
                aside = _DODGE * ((index + 0.5) / len(methods) - 0.5)
                rows = summary[summary["method"].astype(str) == method]
                at = np.array([scales.index(scale) for scale in numbers(rows, "odometry_noise")])
                _draw(axis, panel, rows, at + aside, method)
            if panel.expected is not None:
                label = f"expected: {panel.expected:g}"
                axis.axhline(panel.expected, color=TRUTH, linewidth=0.8, label=label)
            axis.set(title=panel.label, yscale=panel.scale)
            axis.set_xticks(range(len(scales)), [f"{scale:g}" for scale in scales])
            axis.grid(False, axis="x")
        for axis in axes[-1]:
            axis.set_xlabel("scale of the odometry noise")
        figure.suptitle(title)
        handles, labels = axes[-1, -1].get_legend_handles_labels()
        named = dict(zip(labels, handles, strict=True))
        named[labels[0]] = named.pop(labels[0])  # methods first
        add_key(figure, named, most=5)
    return figure


def _draw(axis: Axes, panel: _Panel, rows: pd.DataFrame, at: np.ndarray, method: str) -> None:
    own = METHODS.get(method) or look(method)
    values = numbers(rows, panel.column)
    bars = panel.column.replace("_mean", "_se")
    axis.errorbar(
        at,
        values,
        yerr=numbers(rows, bars) if bars in rows and bars != panel.column else None,
        color=own.color,
        marker=own.marker,
        linestyle=own.linestyle,
        markersize=3.5,
        linewidth=0.7,
        elinewidth=0.8,
        capsize=1.5,
        label=method,
    )
