"""Figures of consistency against time: NEES and NIS of one run, with their intervals."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ekfslam.evaluation.statistics import chi2_interval
from ekfslam.geometry import Array
from ekfslam.plots.panels import FEW, INTERVAL, draw_lines, finish, nothing, say
from ekfslam.plots.rows import Series, check_one_run, numbers, of_robot, series_of, typical
from ekfslam.plots.style import COLUMN, PAGE, TRUTH, Key, drawing, titled, without
from ekfslam.plots.thinning import many

PROBABILITY = 0.95

_ONE_SAMPLE = "errors along a run depend on each other: its NEES is worth almost one sample"
_FAR = 100.0  # NEES is in full view if it is no larger than this against the typical series


class _Nees(NamedTuple):
    """A column of NEES, of what it is, and its degrees of freedom."""

    column: str
    what: str
    dof: int


_NEES = (_Nees("nees", "pose", 3), _Nees("nees_position", "position", 2))


def plot_consistency(
    trajectories: pd.DataFrame,
    robot: str | None = None,
    notes: Iterable[str] = (),
    absent: Mapping[str, str] | None = None,
    width: float = PAGE,
) -> Figure:
    """NEES of the pose and NIS per degree of freedom against their 95 % intervals.

    The two-sided intervals are those of one sample: chi-square with 3 degrees of freedom for the
    NEES of a pose, and that of each step's own degrees of freedom for its NIS (Bar-Shalom et al.
    2001). Where no true heading is known it is the NEES of the position, with 2 degrees of freedom.
    Without a truth there is no NEES. A series whose NEES would squash the others is cut off, and
    its panel says so. The NIS of several robots is theirs together. Of particle filters the
    effective sample size is shown, too.

    Parameters
    ----------
    trajectories : DataFrame
        Rows of one dataset and seed.
    robot : str, optional
        Whose poses, where there are several robots; the first one by default.
    notes : iterable of str
        Notes of the dataset; those that speak of NEES are shown where NEES is.
    absent : mapping of str to str, optional
        As for `plot_errors`.
    width : float
        Of the figure [in]: a page's by default, `ekfslam.plots.COLUMN` for one column of a paper.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If the table holds several runs or lacks columns.
    UnknownNameError
        If it holds no such robot.
    """
    title, absent = check_one_run(trajectories), absent or {}
    trajectories, whose = of_robot(trajectories, robot)
    title += whose
    everything = list(series_of(trajectories, absent))
    kind = next((kind for kind in _NEES if any(_has(kind.column, s) for s in everything)), _NEES[0])
    judged = [series for series in everything if _has(kind.column, series)]
    names = list(dict.fromkeys(series.name for series in judged))
    filters = [s for s in everything if np.isfinite(_nis_per_dof(s)[1]).any()]
    particles = [series for series in everything if _has("effective_samples", series)]
    if not (names or filters or particles):
        return nothing(title, "no NEES and no NIS to show")
    said = [_ONE_SAMPLE, *(note for note in notes if "NEES" in note)] if names else []
    heading = titled(width, title, *said, without(absent))
    abreast = 2 if len(filters) > 3 and width > COLUMN else 1  # or they would be a long strip
    drawn = [filters[i : i + abreast] for i in range(0, len(filters), abreast)]
    rows = len(names) + len(drawn) + bool(particles)
    key = Key.of([*(series.estimator for series in everything), INTERVAL], width, most=4)
    height = 1.5 * rows + key.height + 0.3 + 0.15 * heading.count("\n")
    with drawing(width, height) as figure:
        grid = figure.add_gridspec(rows, abreast)
        for row, name in enumerate(names):
            panel = figure.add_subplot(grid[row, :])
            _draw_nees(panel, kind, name, [series for series in judged if series.name == name])
        for row, some in enumerate(drawn, start=len(names)):
            for place, series in enumerate(some):
                which = place if len(some) == abreast else slice(None)
                panel = figure.add_subplot(grid[row, which])
                _draw_nis(panel, series, int(13 * width / len(some)))
        if particles:
            _draw_samples(figure.add_subplot(grid[-1, :]), particles)
        lowest = len(drawn[-1]) if drawn and not particles else 1
        for panel in figure.axes[1:]:
            panel.sharex(figure.axes[0])
        for panel in figure.axes[:-lowest]:
            panel.tick_params(labelbottom=False)
        for panel in figure.axes[-lowest:]:
            panel.set_xlabel("time [s]")
        finish(figure, heading, figure.axes)
    return figure


def _nis_per_dof(series: Series) -> tuple[Array, Array, Array]:
    """Time, NIS per degree of freedom and the degrees of the steps that have both."""
    time, nis, dof = numbers(series.rows, "time_s", "nis", "nis_dof").T
    counts = np.isfinite(nis) & (dof > 0)
    return time[counts], nis[counts] / dof[counts], dof[counts]


def _has(column: str, series: Series) -> bool:
    return bool(np.isfinite(numbers(series.rows, column)).any())


def _draw_nees(panel: Axes, kind: _Nees, name: str, shown: Iterable[Series]) -> None:
    curves = [(series, numbers(series.rows, kind.column)) for series in shown]
    low, high = chi2_interval(kind.dof, PROBABILITY)
    reaches = {series.estimator: float(np.nanmax(values)) for series, values in curves}
    limit = _FAR * max(typical(list(reaches.values())), float(high))
    draw_lines(panel, [(series, np.minimum(values, 9 * limit)) for series, values in curves])
    for bound in (low, high):
        panel.axhline(float(bound), color=TRUTH, linewidth=0.8, label=INTERVAL, zorder=4)
    panel.set(title=f"NEES of the {kind.what}, {name}", ylabel="NEES")
    inside = [values for _, values in curves if np.nanmax(values) <= limit]
    _scale(panel, np.concatenate(inside), float(low), float(high))
    cut = [estimator for estimator, reach in reaches.items() if reach > limit]
    if cut:
        say(panel, f"{', '.join(cut)}: leaves the frame")


def _draw_nis(panel: Axes, series: Series, letters: int) -> None:
    time, nis, dof = _nis_per_dof(series)
    low, high = chi2_interval(dof, PROBABILITY)
    color, marker, _ = series.look
    dots: dict[str, Any] = {"linestyle": "none", "rasterized": many(len(time))}
    size = 2 if len(time) > FEW else 3
    panel.plot(time, nis, color=color, marker=marker, markersize=size, markeredgewidth=0, **dots)
    # Dashes and no line: it would jump up and down with the number of landmarks in view.
    dots |= {"color": TRUTH, "marker": "_", "markersize": 3, "markeredgewidth": 0.6}
    for bound in (low / dof, high / dof):
        panel.plot(time, bound, label=INTERVAL, **dots)
    words = f"NIS per degree of freedom, {series.label}"
    panel.set(title=textwrap.fill(words, letters, break_long_words=False), ylabel="NIS / dof")
    _scale(panel, nis, float((low / dof).min()), float((high / dof).max()))


def _draw_samples(panel: Axes, shown: Iterable[Series]) -> None:
    draw_lines(panel, [(series, numbers(series.rows, "effective_samples")) for series in shown])
    panel.set(title="effective sample size", ylabel="particles")
    panel.set_ylim(bottom=0.0)


def _scale(panel: Axes, values: Array, low: float, high: float) -> None:
    """Logarithmic if the values span decades: the interval in view, but not the lowest per mille.

    Single samples close to zero would take half of the panel.
    """
    positive = values[values > 0]
    bottom, top = np.quantile(positive, [1e-3, 1.0]) if len(positive) else (low, high)
    if max(top, high) > 100 * bottom:
        panel.set_yscale("log")
        panel.set_ylim(0.5 * min(bottom, low), 2 * max(top, high))
