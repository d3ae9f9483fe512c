"""The map that steps through time: numbers for the page's script, thinned to what can be seen.

Positions are whole units of a frame that is 10,000 of them long, x to the right and y downwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ekfslam.experiments.comparison import without_estimate
from ekfslam.geometry import Array
from ekfslam.plots.rows import Series, final_series, numbers, series_of, typical
from ekfslam.plots.thinning import largest
from ekfslam.report.comparison import runs_of
from ekfslam.report.folder import ComparisonFolder

STOPS = 1000
"""Most steps that the slider stops at: as many as it has pixels."""

UNITS = 10_000
SIGMAS = 3.0
_ROOM = 1.25  # an estimate is in full view if it makes the map larger by no more than this
_FAR = 100 * UNITS  # beyond, a lost estimate is not drawn


class Map(NamedTuple):
    """The map of a run.

    Attributes
    ----------
    key : str
        Unique on the page.
    title : str
    notes : list of str
        What of the run is not in it.
    data : dict
        For the script, as JSON holds it.
    """

    key: str
    title: str
    notes: list[str]
    data: dict[str, Any]


class _Frame(NamedTuple):
    """Where the map lies in the world, and how many units a metre has."""

    low: Array
    high: Array
    unit: float

    def place(self, points: Array) -> Array:
        """Positions (n, 2) in metres as units; NaN where not known, or far out of all bounds."""
        x, y = points.T
        placed = np.column_stack([x - self.low[0], self.high[1] - y]) * self.unit
        placed[(np.abs(placed) > _FAR).any(axis=1)] = np.nan
        return placed


def maps_of(results: ComparisonFolder) -> list[Map]:
    """The map of every dataset of which poses are kept, in order."""
    found = []
    for number, run in enumerate(runs_of(results.trajectories)):
        landmarks, seen = (
            _of_run(table, run.rows) for table in (results.landmarks, results.innovations)
        )
        found.append(_map(f"map-{number}", run.title, run.rows, landmarks, seen, results))
    return [each for each in found if each.data["tracks"]]


def _of_run(table: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
    first = rows.iloc[0]
    own = table["dataset"] == first["dataset"]
    same = table["seed"].isna() if pd.isna(first["seed"]) else table["seed"] == first["seed"]
    return table[own & same]


def _map(
    key: str,
    title: str,
    rows: pd.DataFrame,
    landmarks: pd.DataFrame,
    seen: pd.DataFrame,
    results: ComparisonFolder,
) -> Map:
    stops = _stops(rows)
    runs = results.summary[results.summary["dataset"] == rows["dataset"].iloc[0]]
    absent = without_estimate(runs)
    final = final_series(rows, absent)
    best = {(series.estimator, series.name) for series in final}
    frame = _frame(rows, landmarks, final)
    tracks: list[dict[str, Any]] = []
    maps: list[dict[str, Any]] = []
    sightings: list[list[list[int]]] = []
    for series in series_of(rows, absent):
        shown = (series.estimator, series.name) in best
        own = landmarks[landmarks["estimator"] == series.estimator]
        own = own[own["series"] == series.name].dropna(subset=["x_m", "y_m"])
        layer = {"label": series.label, "color": series.look.color.lower()[1:], "on": shown}
        layer["dash"] = series.look.linestyle
        for part in series.robots:
            track = _track(part, stops, frame)
            if track is None:
                continue
            sightings.append(_sightings(seen, part, own, stops))
            several = rows["robot"].nunique() > 1
            whose = {"robot": str(part["robot"].iloc[0]) if several else ""}
            tracks.append(layer | whose | track | {"map": len(maps)})
        maps.append(layer | _landmarks(own, frame))
    data = {
        "size": [round(float(side)) for side in (frame.high - frame.low) * frame.unit],
        "origin": [float(frame.low[0]), float(frame.high[1])],
        "unit": frame.unit,
        "steps": stops.tolist(),
        "times": _rounded(_times(rows, stops), 3),
        "tracks": tracks,
        "maps": maps,
        "sightings": sightings if any(any(each) for each in sightings) else [],
        "truth": _truth(rows, stops, frame),
        "marks": _whole(frame.place(_true_map(landmarks))),
    }
    return Map(key, title, _notes(rows, stops, data, results), data)


def _stops(rows: pd.DataFrame) -> np.ndarray:
    """Steps that the slider stops at: all that are kept, or evenly spread ones with the last."""
    steps = np.unique(rows["step"].to_numpy(np.int64))
    every = -(-(len(steps) - 1) // (STOPS - 1)) if len(steps) > STOPS else 1
    return np.unique(np.append(steps[::every], steps[-1:]))


def _times(rows: pd.DataFrame, stops: np.ndarray) -> Array:
    first = rows.drop_duplicates("step").set_index("step")["time_s"]
    return first.reindex(stops).to_numpy(float)


def _notes(
    rows: pd.DataFrame, stops: np.ndarray, data: dict[str, Any], results: ComparisonFolder
) -> list[str]:
    notes = []
    count = int(rows["step"].max()) + 1
    if len(stops) < count:
        notes.append(f"{len(stops)} of {count} poses are shown, evenly spread, with the last one.")
    if not data["truth"]:
        notes.append("The tables hold no truth of the path.")
    if data["marks"]:
        notes.append("True landmarks are those that an estimate is held against.")
    if "landmarks" in results.missing:
        notes.append("The table landmarks is not kept, so that there is no map of landmarks.")
    if any(len(each["ellipses"]) // 5 < len(each["xy"]) // 2 for each in data["maps"]):
        notes.append("Of an estimator's landmarks the largest ellipses are shown, at most 1000.")
    if not data["sightings"]:
        why = "is not kept" if "innovations" in results.missing else "says of no landmark seen"
        notes.append(f"The table innovations {why}, so that there are no sightings.")
    return notes


# The frame ---------------------------------------------------------------------------------------


def _frame(rows: pd.DataFrame, landmarks: pd.DataFrame, final: Sequence[Series]) -> _Frame:
    """The truth and the estimates that are not much larger, with a margin."""
    known = numbers(rows, "true_x_m", "true_y_m")
    truth = _finite(np.concatenate([known, _true_map(landmarks)]))
    boxes = []
    for series in final:
        own = landmarks["estimator"] == series.estimator
        both = [numbers(table, "x_m", "y_m") for table in (series.rows, landmarks[own])]
        boxes.append((_finite(np.concatenate(both)), bool(own.any())))
    # Where no truth says how large the world is, those do who have mapped it.
    mapped = [box for box, maps in boxes if maps] or [box for box, _ in boxes]
    size = _diagonal(truth) if len(truth) else typical([_diagonal(box) for box in mapped])
    size = max(size, 1.0) if np.isfinite(size) else 1.0
    near = [box for box, _ in boxes if _diagonal(box) <= _ROOM * size]
    points = np.concatenate([truth, *near, np.empty((0, 2))])
    low, high = (
        (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.ones(2))
    )
    margin = max(0.04 * float((high - low).max()), 0.5)
    low, high = low - margin, high + margin
    return _Frame(low, high, UNITS / float((high - low).max()))


def _finite(points: Array) -> Array:
    return points[np.isfinite(points).all(axis=1)]


def _diagonal(points: Array) -> float:
    return float(np.hypot(*np.ptp(points, axis=0))) if len(points) else 0.0


def _true_map(landmarks: pd.DataFrame) -> Array:
    return np.unique(_finite(numbers(landmarks, "true_x_m", "true_y_m")), axis=0)


# What is drawn -----------------------------------------------------------------------------------


def _track(part: pd.DataFrame, stops: np.ndarray, frame: _Frame) -> dict[str, Any] | None:
    """The path of a robot with its ellipses and errors at the stops; None if none is known."""
    at = part.drop_duplicates("step").set_index("step").reindex(stops)
    xy = frame.place(numbers(at, "x_m", "y_m"))
    if not np.isfinite(xy).any():
        return None
    ellipses = _ellipses(numbers(at, "cov_xx", "cov_xy", "cov_yy"), frame)
    return {
        "xy": _whole(xy),
        "deg": _whole(-np.degrees(numbers(at, "theta_rad"))),
        "ellipses": _rounded(ellipses, 1) if np.isfinite(ellipses).any() else [],
        "error": _rounded(numbers(at, "error_position_m"), 3),
    }


def _truth(rows: pd.DataFrame, stops: np.ndarray, frame: _Frame) -> list[dict[str, Any]]:
    """The true path of each robot, as far as it is known."""
    found = []
    for _, part in rows.groupby("robot", sort=False, dropna=False):
        at = part.drop_duplicates("step").set_index("step").reindex(stops)
        xy = frame.place(numbers(at, "true_x_m", "true_y_m"))
        if np.isfinite(xy).any():
            found.append({"xy": _whole(xy)})
    return found


def _landmarks(own: pd.DataFrame, frame: _Frame) -> dict[str, Any]:
    points = frame.place(numbers(own, "x_m", "y_m"))
    covariances = numbers(own, "cov_xx", "cov_xy", "cov_yy")
    shown = largest(covariances[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
    drawn = np.column_stack([points, _ellipses(covariances, frame)])[shown]
    drawn = drawn[np.isfinite(drawn).all(axis=1)]
    return {"xy": _whole(points), "ellipses": _rounded(drawn, 1)}


def _ellipses(covariances: Array, frame: _Frame) -> Array:
    """Half axes of the 3-sigma ellipses [units] and angle of the first [deg, clockwise], (n, 3)."""
    result = np.full((len(covariances), 3), np.nan)
    xx, xy, yy = covariances.T
    good = np.isfinite(covariances).all(axis=1) & (xx >= 0) & (yy >= 0)
    good &= xy**2 <= xx * yy * (1 + 1e-9)
    directions, sizes, _ = np.linalg.svd(covariances[good][:, [0, 1, 1, 2]].reshape(-1, 2, 2))
    result[good, :2] = SIGMAS * np.sqrt(sizes) * frame.unit
    result[good, 2] = -np.degrees(np.arctan2(directions[:, 1, 0], directions[:, 0, 0]))
    return result


def _sightings(
    seen: pd.DataFrame, part: pd.DataFrame, own: pd.DataFrame, stops: np.ndarray
) -> list[list[int]]:
    """Landmarks of the final map that a robot saw since the stop before, by stop."""
    first = part.iloc[0]
    mine = seen[(seen["estimator"] == first["estimator"]) & (seen["robot"] == first["robot"])]
    mine = mine[mine["landmark"].notna()]
    place = {landmark: index for index, landmark in enumerate(own["landmark"])}
    found: list[dict[int, None]] = [{} for _ in stops]
    ats = np.searchsorted(stops, mine["step"].to_numpy(np.int64))
    for at, landmark in zip(ats, mine["landmark"], strict=True):
        if landmark in place and at < len(stops):
            found[at][place[landmark]] = None
    return [list(each) for each in found]


# JSON --------------------------------------------------------------------------------------------


def _whole(values: Array) -> list[int | None]:
    """Whole numbers row by row; None where not known."""
    return [None if value != value else round(value) for value in values.ravel().tolist()]


def _rounded(values: Array, places: int) -> list[float | None]:
    return [None if value != value else round(value, places) for value in values.ravel().tolist()]
