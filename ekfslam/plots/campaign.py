"""Figures of a campaign from its tables, by the stem of their files; those over time are here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ekfslam.estimates import FAILED, SKIPPED
from ekfslam.plots.options import plot_options
from ekfslam.plots.pairs import plot_pairs
from ekfslam.plots.rows import numbers, typical
from ekfslam.plots.run_means import plot_run_means
from ekfslam.plots.sheets import (
    BAND,
    LARGEST,
    Row,
    add_legend,
    numbered,
    paged,
    rows_of,
    scale,
    sheet,
)
from ekfslam.plots.style import Look, looks, without
from ekfslam.plots.sweeps import plot_sweeps

POINTS = 250
"""Most steps that a line over time shows: more cannot be told apart, and would fill the file."""

_ROOM = 4.0  # an error is in full view if it is no larger than this against the typical one
_COORDINATES = ("(x, y, θ)", "invariant")


def plot_campaign(
    summary: pd.DataFrame,
    over_time: pd.DataFrame,
    runs: pd.DataFrame,
    pairs: pd.DataFrame,
    config: Mapping[str, Any],
) -> dict[str, Figure]:
    """All figures for which the tables of a campaign have numbers.

    Parameters
    ----------
    summary, over_time, runs, pairs : DataFrame
        As in `ekfslam.experiments.CampaignResults`.
    config : mapping
        What was run.

    Returns
    -------
    dict of Figure
        ``nees-over-time``, ``run-means``, ``errors-over-time``, ``pairs``, ``sweep``, ``option``;
        what does not fit on a page goes on in ``...-2`` and so on.
    """
    title = str(config["campaign"])
    found, lacking = looks(config["estimators"]), without(_absent(runs))
    kept = _without_first_steps(over_time, summary)
    return (
        plot_nees_over_time(kept, title, found, lacking)
        | plot_run_means(runs, summary, title, found, lacking)
        | plot_errors_over_time(kept, title, found, lacking)
        | plot_pairs(pairs, title, found, lacking)
        | plot_sweeps(summary, config, found, lacking)
        | plot_options(summary, found, lacking)
    )


def _absent(runs: pd.DataFrame) -> dict[str, str]:
    """Estimators that have no estimate at any seed of a scenario: why, and where if not in all."""
    listed = {}
    scenarios = runs["scenario"].nunique()
    for name, rows in runs.groupby("estimator", sort=False):
        nothing = rows["status"].isin([FAILED, SKIPPED]).groupby(rows["scenario"], sort=False).all()
        places = [str(place) for place in nothing.index[nothing]]
        if places:
            why = rows.loc[rows["scenario"].astype(str) == places[0], "status"].iloc[0]
            where = f" on {places[0]}" if len(places) == 1 else f" on {len(places)} scenarios"
            listed[str(name)] = f"{why}{where * (len(places) < scenarios)}"
    return listed


def _without_first_steps(over_time: pd.DataFrame, summary: pd.DataFrame) -> pd.DataFrame:
    """Without those that the campaign leaves out of its averages: covariances are singular."""
    group = ["scenario", "estimator", "series", "robot"]
    skipped = over_time[group].merge(summary[[*group, "steps_skipped"]], how="left", on=group)
    return over_time[numbers(over_time, "step") >= np.nan_to_num(numbers(skipped, "steps_skipped"))]


# Over time ---------------------------------------------------------------------------------------


def plot_nees_over_time(
    over_time: pd.DataFrame, title: str, found: Mapping[str, Look], lacking: str = ""
) -> dict[str, Figure]:
    """Mean NEES of the pose over the runs at each step, in both coordinates.

    The band is where it should be: the two-sided interval for the mean of N runs at one step,
    chi-square with 3 N degrees of freedom over N. The steps of a run depend on each other, so that
    a line that leaves the band leaves it for a while.

    Parameters
    ----------
    over_time : DataFrame
        Of `ekfslam.evaluation.nees_over_time`.
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
    columns = ("nees_mean", "nees_invariant_mean")
    rows = rows_of(over_time, *columns)
    height = _height(rows)

    def draw(page: list[Row]) -> Figure:
        top = f"{title}: NEES of the pose at each step, mean over the runs\n{lacking}"
        with sheet(top, [height] * len(page), 2, sharey="row") as axes:
            for row, panels in zip(page, axes, strict=True):
                band = max((row.of(name) for name in row.estimators), key=_total_runs)
                low, high = numbers(band, "nees_low", "nees_high").T
                inside = float(np.nanmin(low)), float(np.nanmax(high))
                values = numbers(row.table, *columns)
                for panel, column, name in zip(panels, columns, _COORDINATES, strict=True):
                    panel.fill_between(numbers(band, "time_s"), low, high, **BAND)
                    _draw_lines(panel, row, column, found)
                    panel.set_ylabel(f"NEES, {name}")
                scale(panels[0], values, inside, most=LARGEST)
                panels[0].set_title(f"{row.title}: N = {_counts(row)}", loc="left")
            _label_time(axes)
            percent = f"{100 * numbers(page[0].table, 'probability')[0]:g}"
            others = {f"{percent} % interval of N runs": Patch(**BAND)}
            add_legend(axes[0, 0].figure, _estimators(page), found, others)
        return axes[0, 0].figure

    return numbered("nees-over-time", map(draw, paged(rows, lambda row: height)))


def plot_errors_over_time(
    over_time: pd.DataFrame, title: str, found: Mapping[str, Look], lacking: str = ""
) -> dict[str, Figure]:
    """Root mean square errors over the runs at each step, and what the estimators claim.

    Errors are smaller than claims or larger: panels of a pair have one scale. An estimator that
    would squash the others is cut off.

    Parameters
    ----------
    over_time : DataFrame
        Of `ekfslam.evaluation.nees_over_time`.
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
    columns = ("rms_position_m", "sigma_position_m", "rms_heading_rad", "sigma_heading_rad")
    labels = ("rms error [m]", "claimed σ [m]", "rms error [deg]", "claimed σ [deg]")
    degrees = {name: np.degrees(numbers(over_time, name)) for name in columns[2:]}
    rows = rows_of(over_time.assign(**degrees), "rms_position_m", "rms_heading_rad")
    height = _height(rows)

    def draw(page: list[Row]) -> Figure:
        top = f"{title}: position and heading at each step, root mean squares over the runs"
        top += f"\n{lacking}"
        with sheet(top, [height] * len(page), 4) as axes:
            for row, panels in zip(page, axes, strict=True):
                for panel, column, label in zip(panels, columns, labels, strict=True):
                    _draw_lines(panel, row, column, found)
                    panel.set_ylabel(label)
                for pair, both in ((panels[:2], columns[:2]), (panels[2:], columns[2:])):
                    _share_limit(pair, row, both)
                panels[0].set_title(row.title, loc="left")
            _label_time(axes)
            add_legend(axes[0, 0].figure, _estimators(page), found)
        return axes[0, 0].figure

    return numbered("errors-over-time", map(draw, paged(rows, lambda row: height)))


def _share_limit(panels: Sequence[Axes], row: Row, columns: tuple[str, str]) -> None:
    """One scale from zero on, for all estimators but the extraordinary."""
    reaches = [_reach(row.of(name), columns) for name in row.estimators]
    shown = [reach for reach in reaches if reach <= _ROOM * typical(reaches)]
    limit = 1.08 * max(shown, default=1.0) or 1.0
    cut = sum(reach > limit for reach in reaches)
    for panel in panels:
        panel.set_ylim(0.0, limit)
    if cut:
        panels[0].text(
            0.04,
            0.96,
            f"{cut} cut off",
            transform=panels[0].transAxes,
            va="top",
            fontsize=6,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
        )


def _reach(rows: pd.DataFrame, columns: tuple[str, str]) -> float:
    values = numbers(rows, *columns)
    return float(np.nanmax(values)) if np.isfinite(values).any() else float("nan")


def _draw_lines(panel: Axes, row: Row, column: str, found: Mapping[str, Look]) -> None:
    """A thin line per estimator, with a few markers that tell those apart which coincide."""
    names = row.estimators
    for place, name in enumerate(names):
        rows = row.of(name)
        shown = np.linspace(0, len(rows) - 1, min(len(rows), POINTS)).round()
        rows, own = rows.iloc[shown.astype(int)], found[name]
        every = max(len(rows) // 4, len(names))
        panel.plot(
            numbers(rows, "time_s"),
            np.clip(numbers(rows, column), 0.0, 10 * LARGEST),
            color=own.color,
            marker=own.marker,
            linestyle=own.linestyle,
            linewidth=0.8,
            markersize=3,
            markeredgewidth=0.5,
            markevery=(every * place // len(names), every),
        )


def _height(rows: list[Row]) -> float:
    """Of each row of panels [in]."""
    return 2.0 if len(rows) < 3 else 1.3


def _label_time(axes: np.ndarray) -> None:
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")


def _estimators(page: list[Row]) -> list[str]:
    return [name for row in page for name in row.estimators]


def _total_runs(rows: pd.DataFrame) -> float:
    return float(np.nansum(numbers(rows, "nees_runs")))


def _counts(row: Row) -> str:
    """How many runs a mean is of; estimators that failed at times have less."""
    most = [int(np.nanmax(numbers(row.of(name), "nees_runs"))) for name in row.estimators]
    return f"{max(most)}" if min(most) == max(most) else f"{min(most)} to {max(most)}"
