"""Figures against time: errors with their bands, time per step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ekfslam.geometry import Array
from ekfslam.plots.panels import FEW, draw_line, draw_lines, finish, nothing, say
from ekfslam.plots.rows import (
    Series,
    check_one_run,
    numbers,
    of_robot,
    root,
    series_of,
    typical,
)
from ekfslam.plots.sheets import plain_numbers
from ekfslam.plots.style import PAGE, QUIET, Key, drawing, titled, without
from ekfslam.plots.thinning import many, seen

SIGMAS = 3.0
_NARROWEST = 0.95  # column of errors [in]
_ROOM = 4.0  # a series is in full view if it is no larger than this against the typical one
_ROWS = ("x error [m]", "y error [m]", "heading error [deg]")


def plot_errors(
    trajectories: pd.DataFrame,
    robot: str | None = None,
    absent: Mapping[str, str] | None = None,
    width: float = PAGE,
) -> Figure:
    """Errors of x, y and heading against time within the estimator's own 3-sigma band.

    A column per estimator and series, in several blocks if there are many; a row has one scale, and
    a series that would squash the others is cut off and says so. Lines break where the truth is not
    known, and where no true heading is known the band of the heading stands alone. Without any
    truth there is no error: then the standard deviations of position (root of the trace) and
    heading that the estimators claim are shown.

    Parameters
    ----------
    trajectories : DataFrame
        Rows of one dataset and seed.
    robot : str, optional
        Whose poses, where there are several robots; the first one by default.
    absent : mapping of str to str, optional
        Estimators of which there is nothing to show, and why; the title says so.
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
    curves = [_error_curve(series) for series in series_of(trajectories, absent)]
    curves = [curve for curve in curves if np.isfinite(curve.error).any()]
    if curves:
        heading = titled(width, f"{title}: error and own ±3σ band", without(absent))
        return _errors(curves, heading, width)
    heading = f"{title}: no truth, so no error; what the estimators claim"
    everything = list(series_of(trajectories, absent))
    return _deviations(everything, title, titled(width, heading, without(absent)), width)


def plot_times(
    trajectories: pd.DataFrame, absent: Mapping[str, str] | None = None, width: float = PAGE
) -> Figure:
    """Time per step of each estimator that measures it, of several robots that of them all.

    Parameters
    ----------
    trajectories : DataFrame
        Rows of one dataset and seed.
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
    """
    title, absent = check_one_run(trajectories), absent or {}
    trajectories, _ = of_robot(trajectories, None)  # every robot's rows hold the same times
    timed = {series.estimator: series for series in series_of(trajectories, absent)}
    curves = [(name, _times(series)) for name, series in timed.items()]
    curves = [(name, times) for name, times in curves if np.isfinite(times).any()]
    if not curves:
        return nothing(title, "no time per step to show")
    labels = {
        name: f"{name}: mean {_in_digits(float(np.nanmean(times)))} µs" for name, times in curves
    }
    key = Key.of(labels.values(), width, most=4)
    with drawing(width, max(0.35 * width, 2.0) + 0.6 + key.height) as figure:
        axes = figure.add_subplot(xlabel="step", ylabel="time per step [µs]", yscale="log")
        for name, times in curves:
            color, marker, _ = timed[name].look
            axes.plot(
                numbers(timed[name].rows, "step"),
                times,
                color=color,
                marker=marker,
                linestyle="none",
                markersize=1.5 if len(times) > FEW else 3.0,
                markeredgewidth=0.0,
                rasterized=many(len(times)),
                label=labels[name],
            )
        axes.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], integer=True))
        plain_numbers(axes.yaxis)
        finish(figure, titled(width, f"{title}: time of each step", without(absent)), [axes])
    return figure


def _in_digits(value: float) -> str:
    """Three digits, without an exponent."""
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


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


def _errors(curves: list[_Curve], heading: str, width: float) -> Figure:
    reaches = np.stack([curve.reach for curve in curves])
    limits = np.array([_limit(reach) for reach in reaches.T])
    blocks = -(-len(curves) // max(1, int((width - 0.4) / _NARROWEST)))
    columns = -(-len(curves) // blocks)
    height = (4.0 if blocks == 1 else 3.6) * blocks + 0.5 + 0.15 * heading.count("\n")
    with drawing(width, height) as figure:
        axes = figure.subplots(3 * blocks, columns, sharex=True, squeeze=False)
        panels = axes.reshape(blocks, 3, columns).transpose(0, 2, 1).reshape(-1, 3)
        for place, (column, curve, reach) in enumerate(zip(panels, curves, reaches, strict=False)):
            name = curve.series.heading
            longest = max(map(len, name.split("\n")))
            column[0].set_title(name, fontsize=min(8.0, 120.0 * width / columns / longest))
            for row, panel in enumerate(column):
                _draw_error(panel, curve, row, limits[row])
                panel.set_ylim(-limits[row], limits[row])
                panel.tick_params(labelleft=place % columns == 0, labelbottom=row == 2)
                if place % columns == 0:
                    panel.set_ylabel(_ROWS[row])
                if reach[row] > limits[row]:
                    say(panel, "leaves the frame")
                if not np.isfinite(curve.error[:, row]).any():
                    say(panel, "no true heading")
            column[-1].set_xlabel("time [s]")
        for panel in panels[len(curves) :].flat:
            panel.set_axis_off()
        figure.suptitle(heading)
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
    draw_line(panel, time, error, color=color)


def _deviations(everything: list[Series], title: str, heading: str, width: float) -> Figure:
    """Without a truth: what the estimators claim."""
    curves = [
        (series, _claimed(series)) for series in everything if np.isfinite(_claimed(series)).any()
    ]
    if not curves:
        return nothing(title, "no errors and no covariances to show")
    names = list(dict.fromkeys(series.name for series, _ in curves))
    labels = ("own σ of position [m]", "own σ of heading [deg]")
    key = Key.of({series.estimator: None for series, _ in curves}, width, most=4)
    with drawing(width, 3.9 + key.height + 0.15 * heading.count("\n")) as figure:
        axes = figure.subplots(2, len(names), sharex=True, sharey="row", squeeze=False)
        for column, name in zip(axes.T, names, strict=True):
            column[0].set_title(name)
            for row, panel in enumerate(column):
                shown = [(series, sigma[:, row]) for series, sigma in curves if series.name == name]
                draw_lines(panel, shown)
            column[-1].set_xlabel("time [s]")
        for panel, label in zip(axes[:, 0], labels, strict=True):
            panel.set_ylabel(label)
            panel.set_yscale("log")
            plain_numbers(panel.yaxis)
        finish(figure, heading, axes.flat)
    return figure


def _claimed(series: Series) -> Array:
    """Standard deviations of position [m] and heading [deg], (n, 2)."""
    xx, yy, tt = numbers(series.rows, "cov_xx", "cov_yy", "cov_tt").T
    sigma = np.column_stack([root(xx + yy), np.degrees(root(tt))])
    return np.where(sigma > 0.0, sigma, np.nan)  # an exactly known start has no logarithm


def _times(series: Series) -> Array:
    """Microseconds per step; NaN where the clock saw none."""
    times = 1e6 * numbers(series.rows, "time_step_s")
    return np.where(times > 0.0, times, np.nan)
