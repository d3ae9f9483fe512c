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
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ekfslam.checks import checked_array, is_covariance
from ekfslam.dataset import Dataset, Observations, Prior, Robot
from ekfslam.datasets.catalogue import files_of
from ekfslam.errors import FileFormatError, InputError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

ODOMETRY_SIGMAS = (0.1, 0.1, 0.01)
SENSOR_SIGMAS = (0.5, 0.05)
FIELDS = {"ODOMETRY": 11, "LANDMARK": 7}


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
    if noise not in ("default", "file"):
        raise InputError(f"noise must be 'default' or 'file', got {noise!r}")
    path = files_of("victoria-park", path)["victoria_park.txt"]
    odometry, sightings = _read(path)
    step = _steps(path, odometry, sightings)
    values, covariance = sightings.values, None
    if noise == "file":
        odometry_covariance = _covariances(path, odometry, 3)[0]
        changes = (odometry.covariances != odometry.covariances[0]).any(axis=1)
        _refuse(path, odometry, changes, "another odometry covariance than before")
        covariance = _covariances(path, sightings, 2)
        # Every sighting has its own; the sensor's is for show.
        sensor = Sensor("xy", covariance[0] if len(covariance) else np.zeros((2, 2)), name="laser")
    else:
        odometry_covariance = _variances(odometry_sigmas, 3, "odometry_sigmas")
        sensor = Sensor(
            "range-bearing", _variances(sensor_sigmas, 2, "sensor_sigmas"), name="laser"
        )
        values = np.column_stack(
            [np.hypot(values[:, 0], values[:, 1]), np.arctan2(values[:, 1], values[:, 0])]
        )
    motion = MotionModel("odometry", odometry_covariance)
    by_step = np.argsort(step, kind="stable")
    return Dataset(
        name="victoria-park",
        robots=(Robot(motion, odometry.values, Prior(), name="car"),),
        times=np.arange(len(odometry.end) + 1, dtype=float),
        sensors=(sensor,),
        observations=Observations(
            step=step[by_step],
            values=values[by_step],
            landmark=sightings.end[by_step],
            covariance=None if covariance is None else covariance[by_step],
        ),
        provenance=f"{path.name} of the gtsam package; J. Guivant and E. Nebot, IEEE Trans. "
        "Robotics and Automation 17(3), 2001",
    )


def _variances(sigmas: Sequence[float], count: int, name: str) -> Array:
    """Covariance from standard deviations."""
    array = checked_array(sigmas, float, (count,), name)
    if not (np.isfinite(array) & (array >= 0)).all():
        raise InputError(f"{name} must be standard deviations, got {sigmas!r}")
    return np.diag(array**2)


class _Records(NamedTuple):
    """Records of one kind: line in the file, ids of both ends, values, upper triangles."""

    line: np.ndarray
    start: np.ndarray
    end: np.ndarray
    values: Array
    covariances: Array

    @classmethod
    def of(cls, rows: list[list[float]], fields: int, values: int) -> _Records:
        """Records from rows of the line number and the numbers of the line."""
        table = np.array(rows).reshape(-1, 1 + fields)
        line, start, end = table[:, :3].astype(np.int64).T
        return cls(line, start, end, table[:, 3 : 3 + values], table[:, 3 + values :])


def _refuse(path: Path, records: _Records, bad: np.ndarray, what: str) -> None:
    """Name the line of the first bad record, if there is one; `what` may ask for its ids."""
    for row in np.flatnonzero(bad)[:1]:
        said = what.format(start=records.start[row], end=records.end[row])
        raise FileFormatError(f"{path}, line {records.line[row]}: {said}")


def _repeated(keys: np.ndarray) -> np.ndarray:
    """Whether each row has been there before."""
    _, first = np.unique(keys, axis=0, return_index=True)
    return ~np.isin(np.arange(len(keys)), first)


def _steps(path: Path, odometry: _Records, sightings: _Records) -> np.ndarray:
    """Step of each sighting, after a look at how the records hang together."""
    order = np.append(odometry.start[:1], odometry.end)
    breaks = odometry.start != order[:-1]
    _refuse(path, odometry, breaks, "the odometry chain breaks: it goes on from pose {start}")
    _refuse(path, odometry, _repeated(order)[1:], "pose {end} is reached twice")
    step_of = {pose: step for step, pose in enumerate(order.tolist())}
    step = np.array([step_of.get(pose, -1) for pose in sightings.start.tolist()], dtype=np.int64)
    _refuse(path, sightings, step < 0, "LANDMARK seen from pose {start}, which has no odometry")
    twice = _repeated(np.column_stack([step, sightings.end]))
    _refuse(path, sightings, twice, "landmark {end} is seen twice from pose {start}")
    return step


def _covariances(path: Path, records: _Records, size: int) -> Array:
    """Covariances from their upper triangles, row by row."""
    matrices = np.zeros((len(records.line), size, size))
    rows, columns = np.triu_indices(size)
    matrices[:, rows, columns] = matrices[:, columns, rows] = records.covariances
    bad = ~is_covariance(matrices)
    _refuse(path, records, bad, "the covariance is not positive semi-definite")
    return matrices


def _read(path: Path) -> tuple[_Records, _Records]:
    """Odometry and sightings, both in the order of the file."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: cannot be read ({error})") from None
    rows: dict[str, list[list[float]]] = {name: [] for name in FIELDS}
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        if words[0] not in rows:
            raise FileFormatError(f"{path}, line {number}: unknown record {words[0]!r}")
        rows[words[0]].append([number, *_numbers(path, number, words)])
    if not rows["ODOMETRY"]:
        raise FileFormatError(f"{path}: holds no odometry")
    return _Records.of(rows["ODOMETRY"], 11, 3), _Records.of(rows["LANDMARK"], 7, 2)


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
    if any(v != int(v) or not 0 <= v < 1 << 53 for v in values[:2]):
        raise FileFormatError(f"{path}, line {number}: ids of {words[0]} must be whole numbers")
    return values
