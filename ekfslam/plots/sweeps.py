"""Figures of swept scenarios: what estimators reach against the value that was swept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ekfslam.geometry import Array
from ekfslam.plots.rows import numbers
from ekfslam.plots.sheets import (
    LARGEST,
    Row,
    add_legend,
    counted,
    ends,
    numbered,
    rows_of,
    scale,
    sheet,
)
from ekfslam.plots.style import TRUTH, Look

_DODGE = 0.03  # how far aside of each other estimators are drawn in all, as a share of the abscissa


class _Measure(NamedTuple):
    """A column of the summary that has a panel."""

    column: str
    bar: str | None  # what it scatters by
    label: str
    expected: float | None = None
    unit: float = 1.0


_DEGREE = float(np.degrees(1.0))
_NEES = (
    _Measure("run_nees_pose_mean", "run_nees_pose_se", "mean NEES, (x, y, θ)", 3.0),
    _Measure(
        "run_nees_pose_invariant_mean", "run_nees_pose_invariant_se", "mean NEES, invariant", 3.0
    ),
)
_HEADING = (
    _Measure("final_heading_rms_rad", None, "final heading: rms error [deg]", unit=_DEGREE),
    _Measure("final_heading_sigma_rms_rad", None, "final heading: claimed σ [deg]", unit=_DEGREE),
)
_NIS = _Measure("nis_per_dof", "nis_per_dof_sd", "NIS per degree of freedom", 1.0)
_WHITE = _Measure("white_rho", "white_rho_se", "correlation of innovations", 0.0)
_MEASURES = (*_NEES, _NIS, *_HEADING, _WHITE)
_AROUND = 0.1  # least half range of what should be constant, lest noise look like something


class _Sweep(NamedTuple):
    """An entry of the campaign that was swept."""

    name: str
    abscissa: str
    places: dict[str, float]  # by label of the scenario
    words: list[str] | None  # at the places, if they are no numbers


def plot_sweeps(
    summary: pd.DataFrame, config: Mapping[str, Any], found: Mapping[str, Look], lacking: str = ""
) -> dict[str, Figure]:
    """What estimators reach against a swept value, a figure per sweep and series.

    NEES is the mean over the runs of the mean along each. Bars are one standard error over the
    runs; those of NIS are what it scatters by in a consistent filter. Estimators stand a little
    aside of each other. A value that is a number is the abscissa; several at once, or others, are
    set out evenly.

    Parameters
    ----------
    summary : DataFrame
        Of `ekfslam.evaluation.summarise`.
    config : mapping
        Of the campaign, with what was swept.
    found : dict of Look
        Looks of the estimators by name.
    lacking : str
        What the title says of estimators that are not in the figure.

    Returns
    -------
    dict of Figure
        ``sweep``, ``sweep-2`` and so on; none if nothing was swept.
    """
    figures = []
    for sweep in _sweeps(config):
        rows = summary[summary["scenario"].isin(list(sweep.places))]
        # Scenarios are what a row of panels is told apart by elsewhere, here they are the abscissa.
        rows = rows.assign(at=rows["scenario"].map(sweep.places), scenario=sweep.name)
        for row in rows_of(rows, *(measure.column for measure in _MEASURES)):
            figures.append(_draw(row, sweep, found, lacking))
    return numbered("sweep", figures)


def _sweeps(config: Mapping[str, Any]) -> list[_Sweep]:
    """Entries of the campaign with more than one variant."""
    entries: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for scenario in config["scenarios"]:
        keys = tuple(scenario["swept"])
        if keys:
            label = str(scenario["label"]).partition(f"({keys[0]}=")[0]
            entries.setdefault((label, *keys), []).append(scenario)
    return [_sweep(*entry, of=some) for entry, some in entries.items() if len(some) > 1]


def _sweep(name: str, *keys: str, of: Sequence[Mapping[str, Any]]) -> _Sweep:
    labels = [str(scenario["label"]) for scenario in of]
    values = [list(scenario["swept"].values()) for scenario in of]
    measured = [m for each in values if len(keys) == 1 and (m := _measured(each[0]))]
    units = {unit for _, unit in measured}
    if len(measured) == len(values) and len(units) == 1:
        (unit,) = units
        amounts = [amount for amount, _ in measured]
        abscissa = f"{keys[0]} [{unit}]" if unit else keys[0]
        return _Sweep(name, abscissa, dict(zip(labels, amounts, strict=True)), None)
    words = [", ".join(map(str, each)) for each in values]
    places = {label: float(place) for place, label in enumerate(labels)}
    return _Sweep(name, ", ".join(keys), places, words)


def _measured(value: Any) -> tuple[float, str] | None:
    """A number with its unit, such as 5 or "5 deg"."""
    amount, _, unit = str(value).partition(" ")
    try:
        return float(amount), unit.strip()
    except ValueError:
        return None


def _draw(row: Row, sweep: _Sweep, found: Mapping[str, Look], lacking: str) -> Figure:
    shown = [m for m in _MEASURES if np.isfinite(numbers(row.table, m.column)).any()]
    height = -(-len(shown) // 3)
    places = np.array(list(sweep.places.values()))
    top = f"{row.title}: {_runs(row)}; bars are one standard error\n{lacking}"
    with sheet(top, [1.9] * height, 3, sharex=True) as axes:
        panels = dict(zip(shown, axes.flat, strict=False))
        for measure, panel in panels.items():
            for place, name in enumerate(row.estimators):
                aside = _DODGE * ((place + 0.5) / len(row.estimators) - 0.5) * np.ptp(places)
                _draw_measure(panel, measure, row.of(name), aside, found[name])
            if measure.expected is not None:
                panel.axhline(measure.expected, color=TRUTH, linewidth=0.6, zorder=1)
            panel.set_title(measure.label)
        _set_ranges(panels, row.table)
        for panel in axes.flat[len(shown) :]:
            panel.set_axis_off()
        for panel in axes.flat[max(len(shown) - 3, 0) : len(shown)]:
            panel.tick_params(labelbottom=True)
            panel.set_xlabel(sweep.abscissa)
            if sweep.words is not None:
                panel.set_xticks(places, sweep.words, rotation=20, ha="right")
        figure = axes[0, 0].figure
        add_legend(figure, row.estimators, found)
    return figure


def _runs(row: Row) -> str:
    counts = numbers(row.table, "runs")
    return counted(int(counts.min()), int(counts.max()), "run") + " each"


def _draw_measure(
    panel: Axes, measure: _Measure, rows: pd.DataFrame, aside: float, own: Look
) -> None:
    order = np.argsort(numbers(rows, "at"))
    bars = None if measure.bar is None else numbers(rows, measure.bar)[order] * measure.unit
    panel.errorbar(
        numbers(rows, "at")[order] + aside,
        np.minimum(_values(rows, measure)[order], 10 * LARGEST),
        yerr=None if bars is None else np.nan_to_num(bars),
        color=own.color,
        marker=own.marker,
        linestyle=own.linestyle,
        markersize=3.5,
        markeredgewidth=0.5,
        linewidth=0.8,
        elinewidth=0.7,
    )


def _values(rows: pd.DataFrame, measure: _Measure) -> Array:
    return numbers(rows, measure.column) * measure.unit


def _with_bars(rows: pd.DataFrame, measure: _Measure) -> Array:
    return ends(_values(rows, measure), numbers(rows, measure.bar or measure.column))


def _set_ranges(panels: Mapping[_Measure, Axes], table: pd.DataFrame) -> None:
    """Measures that are to be compared have one scale."""
    nees = np.concatenate([_with_bars(table, measure) for measure in _NEES])
    heading = np.nan_to_num(np.concatenate([_values(table, measure) for measure in _HEADING]))
    for measure, panel in panels.items():
        if measure in _NEES:
            scale(panel, nees, (2.5, 3.5), most=LARGEST)
        elif measure in _HEADING:
            panel.set_ylim(0.0, 1.08 * heading.max())
        else:
            low, high = panel.get_ylim()
            expected = measure.expected or 0.0
            panel.set_ylim(min(low, expected - _AROUND), max(high, expected + _AROUND))
            panel.yaxis.set_major_locator(MaxNLocator(5))
