"""The map: trajectories, landmarks and their 3-sigma ellipses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from ekfslam import geometry as geo
from ekfslam.geometry import Array
from ekfslam.plots.rows import (
    Series,
    check_one_run,
    final_series,
    isolated,
    numbers,
    series_of,
    typical,
)
from ekfslam.plots.style import PAGE, TRUTH, Key, add_key, drawing, titled, without
from ekfslam.plots.thinning import MOST_ELLIPSES, largest, many

SIGMAS = 3.0
_TRUE = ("truth", "true landmark", "start", "end")
_ROOM = 1.25  # an estimate is in full view if it makes the map larger by no more than this
_REACH = 0.15  # ellipses are in full view if they reach out of it by no more than this share of it


_PLACES = (("true_x_m", "true_y_m"), ("x_m", "y_m"))


class _Content(NamedTuple):
    """What the map shows of an estimator."""

    series: Series
    paths: list[Array]  # one per robot
    landmarks: Array
    crowded: bool  # more landmarks than ellipses are shown
    contours: Array  # ellipses of the landmarks and the last poses, where there is a covariance


def plot_map(
    trajectories: pd.DataFrame,
    landmarks: pd.DataFrame,
    known: ArrayLike | None = None,
    absent: Mapping[str, str] | None = None,
    width: float = PAGE,
) -> Figure:
    """Map of a run: true and estimated paths, landmarks with 3-sigma ellipses.

    Each estimator is shown with the series that knows most, smoothed before online, and with the
    paths of all robots. The ellipses (98.9 % of a 2-D Gaussian) are those of the landmarks and of
    the last pose of each robot; of more than a thousand landmarks the largest thousand, which the
    title says, and smaller marks. A path breaks where it is not known, and a position that is known
    by itself is a dot. The frame holds the truth, or without one what most estimators agree on,
    every path and map that is not much larger, and ellipses at its edge; the legend says of whom a
    path or landmarks leave it. Of several robots each has its name where it starts.

    Parameters
    ----------
    trajectories, landmarks : DataFrame
        Rows of one dataset and seed.
    known : (L, 2) array_like, optional
        True landmarks [m]; by default those in the table.
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
        If the tables hold several runs or lack columns.
    """
    title, absent = check_one_run(trajectories, landmarks), absent or {}
    contents = [_content(series, landmarks) for series in final_series(trajectories, absent)]
    contents = [content for content in contents if content.paths]
    true_paths = _true_paths(trajectories)
    true_map = _true_map(landmarks) if known is None else np.asarray(known, float).reshape(-1, 2)
    truth = _finite(np.concatenate([*true_paths, true_map]))
    corners = frame(truth, [(np.concatenate(c.paths), c.landmarks) for c in contents])
    low, high = widened(corners, [each for content in contents for each in content.contours])
    heading = titled(width, _heading(title, contents), without(absent))
    extent = high - low
    key = Key.of([*(c.series.label for c in contents), *_TRUE], width, most=3)
    height = _height(extent, width) + key.height + 0.5 + 0.15 * heading.count("\n")
    with drawing(width, height) as figure:
        axes = figure.add_subplot(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        for content in contents:
            _draw(axes, content, (low, high))
        _draw_truth(axes, true_paths, true_map)
        ends = [(path, c.series.look.color) for c in contents for path in c.paths]
        _draw_ends(axes, ends + [(path, TRUTH) for path in true_paths])
        _name_robots(axes, trajectories)
        figure.suptitle(heading)
        handles, labels = axes.get_legend_handles_labels()
        add_key(figure, dict(zip(labels, handles, strict=True)), most=3)
    return figure


def _heading(title: str, contents: list[_Content]) -> str:
    if not contents:
        return "no estimate to show"
    crowded = any(content.crowded for content in contents)
    which = f" (the {MOST_ELLIPSES} largest of an estimator)" if crowded else ""
    return f"{title}: map with 3σ ellipses{which}"


# What there is to show --------------------------------------------------------------------------


def _finite(rows: Array) -> Array:
    return rows[np.isfinite(rows).all(axis=1)]


def _paths(series: Series, *columns: str) -> list[Array]:
    """The path of each robot, of those that have one; NaN where it is not known."""
    paths = [numbers(rows, *columns) for rows in series.robots]
    return [path for path in paths if np.isfinite(path).all(axis=1).any()]


def _true_paths(trajectories: pd.DataFrame) -> list[Array]:
    for series in series_of(trajectories):
        return _paths(series, "true_x_m", "true_y_m")
    return []


def _true_map(landmarks: pd.DataFrame) -> Array:
    return np.unique(_finite(numbers(landmarks, "true_x_m", "true_y_m")), axis=0)


def _content(series: Series, landmarks: pd.DataFrame) -> _Content:
    own = (landmarks["estimator"] == series.estimator) & (landmarks["series"] == series.name)
    columns = ("x_m", "y_m", "cov_xx", "cov_xy", "cov_yy")
    points = numbers(landmarks[own], *columns)
    last = [numbers(rows, *columns)[-1:] for rows in series.robots]
    shown = points[largest(_covariances(points))]
    gaussians = _finite(np.concatenate([shown, *last]))
    covariances = _covariances(gaussians)
    valid = _is_covariance(covariances)
    return _Content(
        series,
        _paths(series, "x_m", "y_m"),
        _finite(points[:, :2]),
        len(points) > len(shown),
        geo.ellipse(gaussians[valid, :2], covariances[valid], SIGMAS),
    )


def _covariances(gaussians: Array) -> Array:
    return gaussians[:, [2, 3, 3, 4]].reshape(-1, 2, 2)


def _is_covariance(matrices: Array) -> np.ndarray:
    """Which symmetric (n, 2, 2) are positive semi-definite, up to round-off."""
    xx, xy, yy = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    return (xx >= 0) & (yy >= 0) & (xy**2 <= xx * yy * (1 + 1e-9))


# The frame --------------------------------------------------------------------------------------


def frame(truth: Array, estimates: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Corners of a view: the truth and the estimates that are not much larger, with a margin.

    Parameters
    ----------
    truth : (n, 2) ndarray
        Places of all that is true; none if it is not known.
    estimates : sequence of (ndarray, ndarray)
        Places of the paths and of the landmarks of each, (n, 2).
    """
    boxes = [_finite(np.concatenate([truth, *parts])) for parts in estimates]
    # Where no truth says how large the world is, those do who have mapped it: dead reckoning has
    # nothing to hold on to.
    mappers = [b for b, (_, own) in zip(boxes, estimates, strict=True) if len(own)] or boxes
    reference = _diagonal(truth) if len(truth) else typical([_diagonal(box) for box in mappers])
    reference = max(reference, 1.0)
    points = np.concatenate([truth, *(b for b in boxes if _diagonal(b) <= _ROOM * reference)])
    if not len(points):
        return np.zeros(2), np.ones(2)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = max(0.04 * float((high - low).max()), 0.5)
    return low - margin, high + margin


def widened(corners: tuple[Array, Array], contours: Sequence[Array]) -> tuple[Array, Array]:
    """A view with room for the ellipses that are in it but for a part: none looks as if it ended.

    Parameters
    ----------
    corners : (ndarray, ndarray)
        Of the view.
    contours : sequence of (points, 2) ndarray
        Ellipses. Those that reach far out of the view do not count.
    """
    low, high = corners
    room, margin = _REACH * (high - low).max(), 0.01 * (high - low).max()
    near = [each for each in contours if not leaves(each, (low - room, high + room))]
    points = np.concatenate([np.zeros((0, 2)), *near])
    return (
        np.minimum(low, points.min(axis=0, initial=np.inf) - margin),
        np.maximum(high, points.max(axis=0, initial=-np.inf) + margin),
    )


def leaves(places: Array, corners: tuple[Array, Array]) -> bool:
    """Whether a view lacks any of the places (n, 2) of an estimate."""
    return bool(((places < corners[0]) | (places > corners[1])).any())


def _diagonal(points: Array) -> float:
    return float(np.hypot(*np.ptp(points, axis=0)))


def _height(extent: Array, width: float) -> float:
    """Height of axes of this extent in a figure of some width, without what is around them [in]."""
    beside = 0.5
    return float(np.clip((width - beside) * extent[1] / extent[0], 0.3 * width, width))


def _size(count: int, alone: float) -> float:
    """Of the marks of so many landmarks, of which a few have one size: they hide less when many."""
    return alone * (1.0 if count <= 200 else 0.7 if count <= MOST_ELLIPSES else 0.5)


# Artists ----------------------------------------------------------------------------------------


def _draw(axes: Axes, content: _Content, frame: tuple[Array, Array]) -> None:
    color, marker, linestyle = content.series.look
    beyond = leaves(np.concatenate([*content.paths, content.landmarks]), frame)
    label = content.series.label + (", leaves the frame" if beyond else "")
    _draw_paths(axes, content.paths, label, color=color, linestyle=linestyle, zorder=3)
    axes.plot(
        *content.landmarks.T,
        color=color,
        marker=marker,
        linestyle="none",
        markersize=_size(len(content.landmarks), 3.0),
        markerfacecolor="none",
        markeredgewidth=_size(len(content.landmarks), 0.7),
        zorder=4,
    )
    ellipses = LineCollection(
        list(content.contours),
        colors=color,
        linewidths=_size(len(content.landmarks), 0.7),  # dots and dashes are as short
        linestyles=linestyle,
        zorder=4,
    )
    axes.add_collection(ellipses, autolim=False)


def _draw_paths(axes: Axes, paths: list[Array], label: str, **appearance: Any) -> None:
    """The paths of all robots under one name in the legend."""
    dots = appearance | {"linestyle": "none", "marker": ".", "markersize": 2}
    for index, path in enumerate(paths):
        label = "" if index else label
        axes.plot(*path.T, label=label, rasterized=many(len(path)), **appearance)
        alone = isolated(path)
        if alone.any():
            axes.plot(*path[alone].T, **dots)


def _draw_truth(axes: Axes, paths: list[Array], landmarks: Array) -> None:
    _draw_paths(axes, paths, "truth", color=TRUTH, linewidth=0.5, zorder=5)
    if len(landmarks):
        axes.plot(
            *landmarks.T,
            color=TRUTH,
            marker="+",
            linestyle="none",
            markersize=_size(len(landmarks), 5.0),
            markeredgewidth=_size(len(landmarks), 0.7),
            label="true landmark",
            zorder=5,
        )


def _draw_ends(axes: Axes, paths: list[tuple[Array, str]]) -> None:
    """Mark where each path starts, for one robot the same place but for smoothing, and ends.

    Nothing marks the ends of what is known in between alone.
    """
    edge: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 0.5, "zorder": 6}
    starts = np.array([path[0] for path, _ in paths]).reshape(-1, 2)
    axes.plot(*starts.T, ">", color=TRUTH, markersize=5, label="start", **edge)
    for path, color in paths:
        axes.plot(*path[-1], "s", color=color, markersize=4, **edge)
    axes.plot([], [], "s", color=TRUTH, markersize=4, label="end", **edge)


def _name_robots(axes: Axes, trajectories: pd.DataFrame) -> None:
    """Where several robots start, by the truth or else by the first who says."""
    if trajectories["robot"].nunique() < 2:
        return
    for name, rows in trajectories.groupby("robot", sort=False):
        places = _finite(np.concatenate([numbers(rows, *c) for c in _PLACES]))
        if len(places):
            box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}
            look: dict[str, Any] = {"fontsize": 7, "bbox": box, "zorder": 6, "clip_on": True}
            beside: dict[str, Any] = {"xytext": (5, 4), "textcoords": "offset points"}
            axes.annotate(str(name), places[0], **beside, **look)
