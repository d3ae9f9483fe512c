"""Figures against time: errors with their bands, consistency, time per step."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ekfslam.evaluation.statistics import chi2_interval
from ekfslam.geometry import Array
from ekfslam.plots.rows import (
    Series,
    check_one_run,
    isolated,
    numbers,
    of_robot,
    root,
    series_of,
    typical,
)
from ekfslam.plots.style import COLUMN, PAGE, QUIET, TRUTH, drawing, legend_columns
from ekfslam.plots.thinning import many, seen

SIGMAS = 3.0
PROBABILITY = 0.95

_ONE_SAMPLE = "errors along a run depend on each other: its NEES is worth almost one sample"
_ROOM = 4.0  # a series is in full view if it is no larger than this against the typical one
_ROWS = ("x error [m]", "y error [m]", "heading error [deg]")
_INTERVAL = "95 % interval"


class _Nees(NamedTuple):
    """A column of NEES, of what it is, and its degrees of freedom."""

    column: str
    what: str
    dof: int


_NEES = (_Nees("nees", "pose", 3), _Nees("nees_position", "position", 2))


def plot_errors(trajectories: pd.DataFrame, robot: str | None = None) -> Figure:
    """Errors of x, y and heading against time within the estimator's own 3-sigma band.

    A column per estimator and series; a row has one scale, and a series that would squash the
    others is cut off and says so. Lines break where the truth is not known, and where no true
    heading is known the band of the heading stands alone. Without any truth there is no error: then
    the standard deviations of position (root of the trace) and heading that the estimators claim
    are shown.

    Parameters
    ----------
    trajectories : DataFrame
        Rows of one dataset and seed.
    robot : str, optional
        Whose poses, where there are several robots; the first one by default.

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
    title = check_one_run(trajectories)
    trajectories, whose = of_robot(trajectories, robot)
    title += whose
    curves = [_error_curve(series) for series in series_of(trajectories)]
    curves = [curve for curve in curves if np.isfinite(curve.error).any()]
    return _errors(curves, title) if curves else _deviations(trajectories, title)


def plot_consistency(
    trajectories: pd.DataFrame, robot: str | None = None, notes: Iterable[str] = ()
) -> Figure:
    """NEES of the pose and NIS per degree of freedom against their 95 % intervals.

    The two-sided intervals are those of one sample: chi-square with 3 degrees of freedom for the
    NEES of a pose, and that of each step's own degrees of freedom for its NIS (Bar-Shalom et al.
    2001). Where no true heading is known it is the NEES of the position, with 2 degrees of freedom.
    Without a truth there is no NEES. The NIS of several robots is theirs together. Of particle
    filters the effective sample size is shown, too.

    Parameters
    ----------
    trajectories : DataFrame
        Rows of one dataset and seed.
    robot : str, optional
        Whose poses, where there are several robots; the first one by default.
    notes : iterable of str
        Notes of the dataset; those that speak of NEES are shown where NEES is.

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
    title = check_one_run(trajectories)
    trajectories, whose = of_robot(trajectories, robot)
    title += whose
    everything = list(series_of(trajectories))
    kind = next((kind for kind in _NEES if any(_has(kind.column, s) for s in everything)), _NEES[0])
    judged = [series for series in everything if _has(kind.column, series)]
    names = list(dict.fromkeys(series.name for series in judged))
    filters = [s for s in everything if np.isfinite(_nis_per_dof(s)[1]).any()]
    particles = [series for series in everything if _has("effective_samples", series)]
    panels = len(names) + len(filters) + bool(particles)
    if not panels:
        return _nothing(title, "no NEES and no NIS to show")
    with drawing(PAGE, 0.8 + 1.5 * panels) as figure:
        axes = figure.subplots(panels, sharex=True, squeeze=False)[:, 0]
        for panel, name in zip(axes, names, strict=False):
            _draw_nees(panel, kind, name, [series for series in judged if series.name == name])
        for panel, series in zip(axes[len(names) :], filters, strict=False):
            _draw_nis(panel, series)
        if particles:
            _draw_samples(axes[-1], particles)
        axes[-1].set_xlabel("time [s]")
        said = [_ONE_SAMPLE, *(note for note in notes if "NEES" in note)] if names else []
        _finish(figure, "\n".join([title, *(textwrap.fill(words, 105) for words in said)]), axes)
    return figure


def plot_times(trajectories: pd.DataFrame) -> Figure:
    """Time per step of each estimator that measures it, of several robots that of them all.

    Parameters
    ----------
    trajectories : DataFrame
        Rows of one dataset and seed.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If the table holds several runs or lacks columns.
    """
    title = check_one_run(trajectories)
    trajectories, _ = of_robot(trajectories, None)  # every robot's rows hold the same times
    timed = {series.estimator: series for series in series_of(trajectories)}
    curves = [(name, _times(series)) for name, series in timed.items()]
    curves = [(name, times) for name, times in curves if np.isfinite(times).any()]
    if not curves:
        return _nothing(title, "no time per step to show")
    with drawing(PAGE, COLUMN) as figure:
        axes = figure.add_subplot(xlabel="step", ylabel="time per step [µs]", yscale="log")
        for name, times in curves:
            color, marker, _ = timed[name].look
            axes.plot(
                numbers(timed[name].rows, "step"),
                times,
                color=color,
                marker=marker,
                linestyle="none",
                markersize=1.5,
                markeredgewidth=0.0,
                rasterized=many(len(times)),
                label=f"{name}: mean {np.nanmean(times):.3g} µs",
            )
        _finish(figure, title, [axes])
    return figure


# Errors -----------------------------------------------------------------------------------------


class _Curve(NamedTuple):
    """Error and standard deviation (n, 3) of x [m], y [m] and heading [deg]."""

    series: Series
    time: Array
    error: Array
    sigma: Array

    @property
    def reach(self) -> Array:
        """How far error or band go in each of the three."""
        both = np.abs(np.concatenate([self.error, SIGMAS * self.sigma]))
        return np.fmax.reduce(both, axis=0)


def _error_curve(series: Series) -> _Curve:
    rows = series.rows
    error = numbers(rows, "error_x_m", "error_y_m", "error_theta_rad")
    sigma = root(numbers(rows, "cov_xx", "cov_yy", "cov_tt"))
    error[:, 2], sigma[:, 2] = np.degrees(error[:, 2]), np.degrees(sigma[:, 2])
    return _Curve(series, numbers(rows, "time_s"), error, sigma)


def _errors(curves: list[_Curve], title: str) -> Figure:
    reaches = np.stack([curve.reach for curve in curves])
    limits = np.array([_limit(reach) for reach in reaches.T])
    with drawing(max(PAGE, 1.4 * len(curves)), 4.5) as figure:
        axes = figure.subplots(3, len(curves), sharex=True, sharey="row", squeeze=False)
        for column, curve, reach in zip(axes.T, curves, reaches, strict=True):
            column[0].set_title(curve.series.heading)
            for row, panel in enumerate(column):
                _draw_error(panel, curve, row, limits[row])
                if reach[row] > limits[row]:
                    _say(panel, "leaves the frame")
                if not np.isfinite(curve.error[:, row]).any():
                    _say(panel, "no true heading")
            column[-1].set_xlabel("time [s]")
        for panel, name, limit in zip(axes[:, 0], _ROWS, limits, strict=True):
            panel.set(ylabel=name, ylim=(-limit, limit))
        figure.suptitle(f"{title}: error and own ±3σ band")
    return figure


def _limit(reaches: Array) -> float:
    """Half the height of a row that shows every series but the extraordinary."""
    shown = reaches[reaches <= _ROOM * typical(list(reaches))]
    return 1.15 * float(shown.max(initial=1e-9))


def _draw_error(panel: Axes, curve: _Curve, row: int, limit: float) -> None:
    color = curve.series.look.color
    # Cut a little outside of the frame: a vector file would carry numbers of any size along.
    error = np.clip(curve.error[:, row], -9 * limit, 9 * limit)
    band = np.clip(SIGMAS * curve.sigma[:, row], 0.0, 9 * limit)
    shown = seen(error, band)
    time, error, band = curve.time[shown], error[shown], band[shown]
    panel.fill_between(time, -band, band, color=color, alpha=0.25, linewidth=0.0)
    panel.axhline(0.0, color=QUIET, linewidth=0.5)
    _draw_line(panel, time, error, color=color)


def _say(panel: Axes, words: str) -> None:
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


def _deviations(trajectories: pd.DataFrame, title: str) -> Figure:
    """Without a truth: what the estimators claim."""
    curves = [
        (series, _claimed(series))
        for series in series_of(trajectories)
        if np.isfinite(_claimed(series)).any()
    ]
    if not curves:
        return _nothing(title, "no errors and no covariances to show")
    names = list(dict.fromkeys(series.name for series, _ in curves))
    labels = ("own σ of position [m]", "own σ of heading [deg]")
    with drawing(PAGE, 4.5) as figure:
        axes = figure.subplots(2, len(names), sharex=True, sharey="row", squeeze=False)
        for column, name in zip(axes.T, names, strict=True):
            column[0].set_title(name)
            for row, panel in enumerate(column):
                shown = [(series, sigma[:, row]) for series, sigma in curves if series.name == name]
                _draw_lines(panel, shown)
            column[-1].set_xlabel("time [s]")
        for panel, label in zip(axes[:, 0], labels, strict=True):
            panel.set_ylabel(label)
            panel.set_yscale("log")
        _finish(figure, f"{title}: no truth, so no error; what the estimators claim", axes.flat)
    return figure


def _claimed(series: Series) -> Array:
    """Standard deviations of position [m] and heading [deg], (n, 2)."""
    xx, yy, tt = numbers(series.rows, "cov_xx", "cov_yy", "cov_tt").T
    sigma = np.column_stack([root(xx + yy), np.degrees(root(tt))])
    return np.where(sigma > 0.0, sigma, np.nan)  # an exactly known start has no logarithm


# Consistency ------------------------------------------------------------------------------------


def _nis_per_dof(series: Series) -> tuple[Array, Array, Array]:
    """Time, NIS per degree of freedom and the degrees of the steps that have both."""
    time, nis, dof = numbers(series.rows, "time_s", "nis", "nis_dof").T
    counts = np.isfinite(nis) & (dof > 0)
    return time[counts], nis[counts] / dof[counts], dof[counts]


def _has(column: str, series: Series) -> bool:
    return bool(np.isfinite(numbers(series.rows, column)).any())


def _draw_nees(panel: Axes, kind: _Nees, name: str, shown: Iterable[Series]) -> None:
    curves = [(series, numbers(series.rows, kind.column)) for series in shown]
    _draw_lines(panel, curves)
    low, high = chi2_interval(kind.dof, PROBABILITY)
    for bound in (low, high):
        panel.axhline(float(bound), color=TRUTH, linewidth=0.8, label=_INTERVAL, zorder=4)
    panel.set(title=f"NEES of the {kind.what}, {name}", ylabel="NEES")
    _scale(panel, np.concatenate([values for _, values in curves]), float(low), float(high))


def _draw_nis(panel: Axes, series: Series) -> None:
    time, nis, dof = _nis_per_dof(series)
    low, high = chi2_interval(dof, PROBABILITY)
    color, marker, _ = series.look
    dots: dict[str, Any] = {"linestyle": "none", "rasterized": many(len(time))}
    panel.plot(time, nis, color=color, marker=marker, markersize=2, markeredgewidth=0, **dots)
    # Dashes and no line: it would jump up and down with the number of landmarks in view.
    dots |= {"color": TRUTH, "marker": "_", "markersize": 3, "markeredgewidth": 0.6}
    for bound in (low / dof, high / dof):
        panel.plot(time, bound, label=_INTERVAL, **dots)
    panel.set(title=f"NIS per degree of freedom, {series.label}", ylabel="NIS / dof")
    _scale(panel, nis, float((low / dof).min()), float((high / dof).max()))


def _draw_samples(panel: Axes, shown: Iterable[Series]) -> None:
    _draw_lines(panel, [(series, numbers(series.rows, "effective_samples")) for series in shown])
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


# Shared -----------------------------------------------------------------------------------------


def _draw_lines(panel: Axes, curves: Iterable[tuple[Series, Array]]) -> None:
    for series, values in curves:
        color, _, linestyle = series.look
        shown = seen(values)
        time, values = numbers(series.rows, "time_s")[shown], values[shown]
        _draw_line(panel, time, values, color=color, linestyle=linestyle, label=series.estimator)


def _draw_line(panel: Axes, time: Array, values: Array, **look: Any) -> None:
    """A line that breaks where values are missing, with dots where it would not be seen."""
    panel.plot(time, values, linewidth=0.8, **look)
    alone = isolated(values)
    if alone.any():
        dots = {"linestyle": "none", "marker": ".", "markersize": 2, "color": look["color"]}
        panel.plot(time[alone], values[alone], **dots)


def _times(series: Series) -> Array:
    """Microseconds per step; NaN where the clock saw none."""
    times = 1e6 * numbers(series.rows, "time_step_s")
    return np.where(times > 0.0, times, np.nan)


def _finish(figure: Figure, title: str, axes: Iterable[Axes]) -> None:
    """Title, and one legend for all panels."""
    handles: dict[str, Artist] = {}
    for panel in axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    labels = sorted(handles, key=_INTERVAL.__eq__)  # estimators first
    figure.suptitle(title)
    figure.legend(
        [handles[label] for label in labels],
        labels,
        loc="outside lower center",
        ncols=legend_columns(labels, most=4),
        markerscale=2,
    )


def _nothing(title: str, message: str) -> Figure:
    with drawing(COLUMN, 1.0) as figure:
        figure.suptitle(title)
        figure.text(0.5, 0.4, message, ha="center")
    return figure
