"""The sightings of a graph as those of a dataset, in order of step."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ekfslam import geometry as geo
from ekfslam.datasets.graph_parts import Edges, Graph, Seen, repeated, some
from ekfslam.geometry import Array
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations, padded


def sightings_of(
    graph: Graph, order: np.ndarray, robots: int, times: Array | None
) -> tuple[tuple[Sensor, ...], Observations]:
    """Sensors, and their sightings in order of step.

    A sensor sees a landmark once at an instant. What a file has more often, from one pose and
    without other times, is of as many sensors as it takes.

    Parameters
    ----------
    graph : Graph
    order : (R * (K + 1),) ndarray
        Ids of the poses, robot after robot.
    robots : int
        R.
    times : (K + 1,) ndarray, optional
        Times of the poses, if the file has them; then sightings have theirs.

    Raises
    ------
    FileFormatError
        For a sighting that no sensor can report, or, where the graph has no repeats, one that is
        repeated to the last digit; names the line.
    """
    steps = len(order) // robots
    sensors, columns = [], []
    told = [one for seen in graph.sightings for one in _told_apart(graph, seen, order, times)]
    per_row = any(seen.edges.covariances.ndim == 3 for seen in told)
    for index, seen in enumerate(told):
        edges = seen.edges
        at = np.searchsorted(order, edges.start)
        size = edges.values.shape[1]
        noise = np.broadcast_to(edges.covariances, (len(at), size, size))
        # Where each sighting has its own, the sensor's is for show.
        one = noise[0] if len(at) else np.zeros((size, size))
        one = edges.covariances if edges.covariances.ndim == 2 else one
        sensors.append(Sensor(seen.kind, one, mount=np.array(seen.mount), name=seen.name))
        columns.append(
            (
                at % steps,
                padded(_wrapped(seen)),
                edges.end,
                np.full(len(at), index),
                at // steps,
                _instants(edges, at % steps, times),
                padded(noise, axes=2),
            )
        )
    step, values, landmark, sensor, robot, time, noise = (
        np.concatenate(column) for column in zip(*columns, strict=True)
    )
    by_step = np.lexsort([time, step])
    return tuple(sensors), Observations(
        step[by_step],
        values[by_step],
        landmark[by_step],
        sensor[by_step],
        robot[by_step],
        None if times is None else time[by_step],
        noise[by_step] if per_row else None,
    )


def _instants(edges: Edges, step: np.ndarray, times: Array | None) -> Array:
    """Times of sightings; the steps if there are none."""
    if times is None:
        return step.astype(float)
    return times[step] if edges.time is None else edges.time


def _wrapped(seen: Seen) -> Array:
    """Values, with bearings in [-pi, pi)."""
    values = seen.edges.values.copy()
    if "bearing" in seen.kind:
        values[:, -1] = geo.wrap(values[:, -1])
    return values


def _told_apart(graph: Graph, seen: Seen, order: np.ndarray, times: Array | None) -> Iterator[Seen]:
    """Sightings of a sensor, each landmark once at an instant, after a look at them."""
    edges = seen.edges
    at = np.minimum(np.searchsorted(order, edges.start), len(order) - 1)
    _check(graph, seen, order[at] != edges.start)
    instants = _instants(edges, at % (len(times) if times is not None else len(order)), times)
    keys = np.column_stack([at, edges.end, np.unique(instants, return_inverse=True)[1]])
    graph.refuse(
        edges.line,
        repeated(np.column_stack([keys, edges.values])) & (not graph.repeats),
        lambda row: (
            f"landmark {edges.end[row]} is seen twice from pose "
            f"{graph.named(edges.start[row])}, with the same values"
        ),
    )
    left = np.arange(len(edges.line))
    while True:  # all that are seen for the first time, then for the second time, and so on
        again = repeated(keys[left])
        yield seen._replace(edges=some(edges, left[~again]))
        left = left[again]
        if not len(left):
            return


def _check(graph: Graph, seen: Seen, absent: np.ndarray) -> None:
    """Refuse what no sensor can report."""
    edges, named = seen.edges, graph.named
    graph.refuse(
        edges.line,
        absent,
        lambda row: (
            f"landmark {edges.end[row]} is seen from pose {named(edges.start[row])}, "
            "which has no odometry"
        ),
    )
    if len(graph.landmarks.ids):
        graph.refuse(
            edges.line,
            ~np.isin(edges.end, graph.landmarks.ids),
            lambda row: f"of landmark {edges.end[row]} there is no vertex",
        )
    if "range" in seen.kind:
        graph.refuse(edges.line, edges.values[:, 0] < 0, lambda row: "a negative range")
    if "bearing" in seen.kind:
        graph.refuse(
            edges.line,
            np.abs(edges.values[:, -1]) > geo.TAU,
            lambda row: f"a bearing of {edges.values[row, -1]:g} is none in radians",
        )
