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
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ekfslam.dataset import Dataset, Observations, Prior, Robot
from ekfslam.errors import FileFormatError, InputError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

ODOMETRY_SIGMAS = (0.1, 0.1, 0.01)
SENSOR_SIGMAS = (0.5, 0.05)
FIELDS = {"ODOMETRY": 11, "LANDMARK": 7}


def default_path() -> Path:
    """Where the gtsam wheel keeps the file (gtsam itself is not imported)."""
    spec = find_spec("gtsam")
    if spec is None or spec.origin is None:
        raise FileFormatError("victoria-park comes with the gtsam package, which is not installed")
    return Path(spec.origin).parent / "Data" / "victoria_park.txt"


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
        For another `noise`.
    """
    if noise not in ("default", "file"):
        raise InputError(f"noise must be 'default' or 'file', got {noise!r}")
    path = default_path() if path is None else Path(path)
    odometry, sightings = _read(path)
    order = np.concatenate([odometry[:1, 0], odometry[:, 1]]).astype(np.int64)
    step_of = {int(pose): step for step, pose in enumerate(order)}
    increments = odometry[:, 2:5]
    values = sightings[:, 2:4]
    rows = len(values)
    step = np.empty(rows, dtype=np.int64)
    for row, pose in enumerate(sightings[:, 0].astype(np.int64)):
        if int(pose) not in step_of:
            raise FileFormatError(f"{path}: LANDMARK seen from pose {pose}, which has no odometry")
        step[row] = step_of[int(pose)]
    covariance = None
    if noise == "file":
        odometry_covariance = _upper(odometry[0, 5:])
        if np.abs(odometry[:, 5:] - odometry[0, 5:]).max() > 0:
            raise FileFormatError(f"{path}: the odometry covariance changes along the file")
        sensor = Sensor("xy", _upper(sightings[0, 4:]), name="laser")
        covariance = np.array([_upper(row) for row in sightings[:, 4:]])
    else:
        odometry_covariance = np.diag(np.square(odometry_sigmas))
        sensor = Sensor("range-bearing", np.diag(np.square(sensor_sigmas)), name="laser")
        values = np.column_stack(
            [np.hypot(values[:, 0], values[:, 1]), np.arctan2(values[:, 1], values[:, 0])]
        )
    by_step = np.argsort(step, kind="stable")
    return Dataset(
        name="victoria-park",
        robots=(
            Robot(MotionModel("odometry", odometry_covariance), increments, Prior(), name="car"),
        ),
        times=np.arange(len(order), dtype=float),
        sensors=(sensor,),
        observations=Observations(
            step=step[by_step],
            values=values[by_step],
            landmark=sightings[by_step, 1].astype(np.int64),
            covariance=None if covariance is None else covariance[by_step],
        ),
        provenance=f"{path.name} of the gtsam package; J. Guivant and E. Nebot, IEEE Trans. "
        "Robotics and Automation 17(3), 2001",
    )


def _upper(entries: Array) -> Array:
    """Symmetric matrix from its upper triangle, row by row."""
    size = {3: 2, 6: 3}[len(entries)]
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = entries
    return matrix + np.triu(matrix, 1).T


def _read(path: Path) -> tuple[Array, Array]:
    """Odometry (K, 11) and sightings (M, 7), both in the order of the file."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: cannot be read ({error})") from None
    rows: dict[str, list[list[float]]] = {"ODOMETRY": [], "LANDMARK": []}
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        rows_of = rows.get(words[0])
        if rows_of is None:
            raise FileFormatError(f"{path}, line {number}: unknown record {words[0]!r}")
        rows_of.append(_numbers(path, number, words))
    if not rows["ODOMETRY"]:
        raise FileFormatError(f"{path}: holds no odometry")
    odometry = np.array(rows["ODOMETRY"])
    broken = np.flatnonzero(odometry[1:, 0] != odometry[:-1, 1])
    if len(broken):
        raise FileFormatError(
            f"{path}: the odometry chain breaks after pose {odometry[broken[0], 1]:.0f}"
        )
    return odometry, np.array(rows["LANDMARK"]).reshape(-1, 7)


def _numbers(path: Path, number: int, words: list[Any]) -> list[float]:
    """The numbers of one line, all finite, as many as its record has, ids whole."""
    want = FIELDS[words[0]]
    try:
        values = [float(word) for word in words[1:]]
    except ValueError:
        raise FileFormatError(f"{path}, line {number}: not a number in {words[0]}") from None
    if len(values) != want:
        raise FileFormatError(
            f"{path}, line {number}: {words[0]} needs {want} numbers, got {len(values)}"
        )
    if not np.isfinite(values).all():
        raise FileFormatError(f"{path}, line {number}: NaN or infinite value in {words[0]}")
    if any(v != int(v) or v < 0 for v in values[:2]):
        raise FileFormatError(f"{path}, line {number}: ids of {words[0]} must be whole numbers")
    return values
