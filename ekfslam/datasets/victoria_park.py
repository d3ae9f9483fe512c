"""Victoria Park: a car with a laser drives among trees (Guivant and Nebot 2001).

The graph file ``victoria_park.txt`` comes inside the gtsam wheel. Its lines are
``ODOMETRY i j dx dy dtheta`` and ``LANDMARK i j x y``, each followed by the upper triangle of a
covariance: pose j, or landmark j, in the frame of pose i. Poses and landmarks are numbered
in one space, with gaps; gtsam's own reader drops the landmark lines.

Noise
-----
The covariances of the file do not describe its residuals (after smoothing, ranges spread by 0.23 m
and bearings by 0.034 rad, where the file says 0.63 m in x and y). The default is therefore a
round, cautious model, stated here and open to change: odometry 0.1 m, 0.1 m, 0.01 rad per step,
range 0.5 m, bearing 0.05 rad. ``noise="file"`` takes the covariances of the file as printed, with
landmarks as relative positions.

The file has no times: the time of a pose is its number in the order of travel, in steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.datasets.catalogue import files_of
from ekfslam.datasets.graph_parts import Edges, Graph, Seen
from ekfslam.datasets.graph_records import Rows, Tag, read, triangle
from ekfslam.datasets.options import one_of, variances
from ekfslam.datasets.pose_graph import dataset_of
from ekfslam.geometry import Array

ODOMETRY_SIGMAS = (0.1, 0.1, 0.01)
SENSOR_SIGMAS = (0.5, 0.05)
TAGS = {
    "ODOMETRY": Tag(("i", "j"), ("dx", "dy", "theta"), triangle(("x", "y", "t"))),
    "LANDMARK": Tag(("i", "j"), ("x", "y"), triangle(("x", "y"))),
}


def load(
    path: str | Path | None = None,
    noise: str = "default",
    odometry_sigmas: Sequence[float] = ODOMETRY_SIGMAS,
    sensor_sigmas: Sequence[float] = SENSOR_SIGMAS,
) -> Dataset:
    """Load Victoria Park.

    Parameters
    ----------
    path : path, optional
        The graph file; by default the one in the gtsam wheel.
    noise : {"default", "file"}
        Whose noise to state, see above.
    odometry_sigmas : (3,) sequence of float
        Standard deviations per step along, across and in heading [m, m, rad].
    sensor_sigmas : (2,) sequence of float
        Of range and bearing [m, rad].

    Returns
    -------
    Dataset
        One robot from the origin, association known, no truth. Sightings as range and bearing
        (converted from the file's x and y), or as x and y with ``noise="file"``.

    Raises
    ------
    FileFormatError
        For a missing or malformed file, with the line.
    InputError
        For another `noise`, or standard deviations that are none.
    """
    one_of(noise, ("default", "file"), "noise")
    path = files_of("victoria-park", path)["victoria_park.txt"]
    rows = read(path, TAGS)
    odometry, sightings = rows["ODOMETRY"], rows["LANDMARK"]
    values = sightings.values
    if noise == "file":
        kind, moved = "xy", odometry.covariances("covariance")
        changes = (odometry.noise != odometry.noise[:1]).any(axis=1)
        odometry.refuse(changes, "another odometry covariance than before")
        seen = sightings.covariances("covariance")
    else:
        kind, moved = "range-bearing", variances(odometry_sigmas, 3, "odometry_sigmas")
        seen = variances(sensor_sigmas, 2, "sensor_sigmas")
        values = np.column_stack(
            [np.hypot(values[:, 0], values[:, 1]), np.arctan2(values[:, 1], values[:, 0])]
        )
    graph = Graph(
        path,
        motions=_edges(odometry, odometry.values, moved),
        sightings=[Seen(kind, _edges(sightings, values, seen), name="laser")],
        frame="first",
    )
    dataset = dataset_of(
        graph,
        "victoria-park",
        "car",
        provenance=f"{path.name} of the gtsam package; J. Guivant and E. Nebot, IEEE Trans. "
        "Robotics and Automation 17(3), 2001",
    )
    return replace(dataset, notes=())


def _edges(rows: Rows, values: Array, covariances: Array) -> Edges:
    return Edges(rows.line, rows.ids[:, 0], rows.ids[:, 1], values, covariances)
