"""The figure of times against the size of the map."""

from __future__ import annotations

from typing import Any

import pandas as pd

from ekfslam.plots.style import PAGE, QUIET, Look, Picture, drawing, looks

LIMIT = "limit of the update"
OTHERS = {  # who is no estimator of the registry
    "textbook, sequential": Look(QUIET, "d", ":"),
    "textbook, joint": Look(QUIET, "p", "-"),
    "textbook, dense": Look(QUIET, "H", "--"),
    "roboticstoolbox": Look("#CC6677", ">", "-"),
    "filterpy": Look("#117733", "<", "--"),
}
FAMILY = ("ekf", "iekf", "ekf-ideal", "ekf-fej", "ekf-oc", "ekf-ri", "ekf-robocentric")


def draw(table: pd.DataFrame) -> Picture:
    """Four panels on logarithmic axes: two problems, the family, and predictions.

    Parameters
    ----------
    table : DataFrame
        As ``results/bench/map-size.csv``.
    """
    ring, local = (table[table.problem == problem] for problem in ("ring", "city"))
    family = ring.estimator.isin(FAMILY)
    others = ~family | (ring.estimator == "ekf")
    panels = [
        ("any five landmarks a step", ring[others], "us_per_observation"),
        ("a tour of the city", local, "us_per_observation"),
        ("the family", ring[family], "us_per_observation"),
        ("a step that sees nothing", ring[others], "us_per_prediction"),
    ]
    shown = OTHERS | looks(name for name in table.estimator if name not in {LIMIT, *OTHERS})
    with drawing(PAGE, 5.8) as figure:
        axes = figure.subplots(2, 2).ravel()
        for letter, ax, (title, rows, column) in zip("abcd", axes, panels, strict=True):
            _panel(ax, rows, column, shown)
            ax.set_title(f"({letter}) {title}")
            per = "observation" if column == "us_per_observation" else "prediction"
            ax.set_ylabel(f"time per {per} [µs]")
            ax.set_xlabel("landmarks in the map")
        handles = {
            label: handle
            for ax in axes
            for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
        }
        figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4)
    return figure


def _panel(ax: Any, rows: pd.DataFrame, column: str, shown: dict[str, Any]) -> None:
    """One line for each estimator, and the limit."""
    ax.set_xscale("log")
    ax.set_yscale("log")
    for estimator, own in rows.dropna(subset=column).groupby("estimator", sort=False):
        if estimator == LIMIT:
            ax.plot(own.landmarks, own[column], color="black", linestyle=":", label=estimator)
            continue
        look = shown[estimator]
        ax.plot(
            own.landmarks, own[column], color=look.color, linestyle=look.linestyle,
            marker=look.marker, markersize=3.5, label=estimator,
        )  # fmt: skip
    sizes = sorted(rows.landmarks.unique())
    ax.set_xticks(sizes, [str(size) for size in sizes], minor=False)
    ax.minorticks_off()
