"""Figures of an option of an estimator: what it reaches against the option's value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ekfslam.errors import InputError
from ekfslam.plots.rows import numbers
from ekfslam.plots.sheets import (
    LARGEST,
    Row,
    add_legend,
    counted,
    ends,
    label_decades,
    numbered,
    rows_of,
    scale,
    sheet,
)
from ekfslam.plots.style import LOOKS, TRUTH, Look
from ekfslam.registry import parse

FEWEST = 3  # values that make a line worth a figure


class _Measure(NamedTuple):
    """A column of the summary that has a panel."""

    column: str
    bar: str
    label: str
    expected: float | None = None


_MEASURES = (
    _Measure("ate_position_rmse_m_mean", "ate_position_rmse_m_se", "position error, ATE [m]"),
    _Measure("landmark_rmse_m_mean", "landmark_rmse_m_se", "landmark error, rms [m]"),
    _Measure("run_nees_pose_mean", "run_nees_pose_se", "mean NEES, (x, y, θ)", 3.0),
    _Measure("effective_samples_mean", "effective_samples_se", "effective samples, mean"),
)


class _Line(NamedTuple):
    """An estimator with one of its options at several values."""

    option: str
    names: dict[str, float]  # values, by the estimator's name


def plot_options(
    summary: pd.DataFrame, found: Mapping[str, Look], lacking: str = ""
) -> dict[str, Figure]:
    """What estimators reach against a number among their options, beside those without it.

    A figure per scenario, series and robot, of the online series where there are two. Bars are one
    standard error over the runs. An estimator without the option is a level with its error as a
    band.

    Parameters
    ----------
    summary : DataFrame
        Of `ekfslam.evaluation.summarise`.
    found : dict of Look
        Looks of the estimators by name.
    lacking : str
        What the title says of estimators that are not in the figure.

    Returns
    -------
    dict of Figure
        ``option``, ``option-2`` and so on; none if no estimator has an option at three values.
    """
    lines = lines_of(list(found))
    if not lines:
        return {}
    figures = []
    for row in rows_of(summary, *(measure.column for measure in _MEASURES)):
        drawn = {title: line for title, line in lines.items() if _among(line, row)}
        if drawn:
            figures.append(_draw(row, drawn, found, lacking))
    return numbered("option", figures)


def lines_of(estimators: list[str]) -> dict[str, _Line]:
    """Estimators that differ in one number among their options, by their name without it."""
    lines: dict[tuple[str, str], _Line] = {}
    for name in estimators:
        for option, value, title in _numbers_of(name):
            lines.setdefault((title, option), _Line(option, {})).names[name] = value
    return {title: line for (title, _), line in lines.items() if len(line.names) >= FEWEST}


def _numbers_of(name: str) -> Iterator[tuple[str, float, str]]:
    """Options of an estimator that are numbers, and its name without each."""
    try:
        call = parse(name)
    except InputError:  # what an object calls itself need not read as a name with options
        return
    for option, value in call.options.items():
        if isinstance(value, int | float) and not isinstance(value, bool):
            words = {key: word for key, word in call.words.items() if key != option}
            yield option, float(value), str(call._replace(words=words))


def _among(line: _Line, row: Row) -> bool:
    return len(set(line.names).intersection(row.estimators)) >= FEWEST


def _draw(row: Row, lines: Mapping[str, _Line], found: Mapping[str, Look], lacking: str) -> Figure:
    shown = [m for m in _MEASURES if np.isfinite(numbers(row.table, m.column)).any()]
    values = np.concatenate([list(line.names.values()) for line in lines.values()])
    in_lines = {name for line in lines.values() for name in line.names}
    levels = [name for name in row.estimators if name not in in_lines]
    own = {title: LOOKS.get(title) or found[next(iter(n.names))] for title, n in lines.items()}
    counts = numbers(row.table, "runs")
    runs = counted(int(counts.min()), int(counts.max()), "run") + " each"
    top = f"{row.title}: {runs}; bars are one standard error\n{lacking}"
    with sheet(top, [2.3], len(shown)) as axes:
        for measure, panel in zip(shown, axes[0], strict=True):
            for title, line in lines.items():
                _draw_line(panel, measure, row, line, own[title])
            for name in levels:
                _draw_level(panel, measure, row.of(name), found[name])
            if measure.expected is not None:
                panel.axhline(measure.expected, color=TRUTH, linewidth=0.6, zorder=1)
            panel.set(title=measure.label, xscale="log", xlabel=next(iter(lines.values())).option)
            label_decades(panel.xaxis, values.max() / values.min())
            known = numbers(row.table, measure.column)
            inside = (2.5, 3.5) if measure.expected else (np.nanmin(known), np.nanmax(known))
            scale(panel, ends(known, numbers(row.table, measure.bar)), inside, most=LARGEST)
        figure = axes[0, 0].figure
        add_legend(figure, [*lines, *levels], own | {name: found[name] for name in levels})
    return figure


def _draw_line(panel: Axes, measure: _Measure, row: Row, line: _Line, own: Look) -> None:
    names = sorted(set(line.names).intersection(row.estimators), key=line.names.__getitem__)
    rows = pd.concat([row.of(name).iloc[:1] for name in names])
    panel.errorbar(
        np.array([line.names[name] for name in names]),
        np.minimum(numbers(rows, measure.column), 10 * LARGEST),
        yerr=np.nan_to_num(numbers(rows, measure.bar)),
        color=own.color,
        marker=own.marker,
        linestyle=own.linestyle,
        markersize=3.5,
        markeredgewidth=0.5,
        linewidth=0.9,
        elinewidth=0.7,
    )


def _draw_level(panel: Axes, measure: _Measure, rows: pd.DataFrame, own: Look) -> None:
    value, error = numbers(rows, measure.column)[0], numbers(rows, measure.bar)[0]
    if np.isfinite(value):
        panel.axhline(value, color=own.color, linestyle=own.linestyle, linewidth=0.9)
        band = np.nan_to_num(error)
        panel.axhspan(value - band, value + band, color=own.color, alpha=0.15, linewidth=0.0)
