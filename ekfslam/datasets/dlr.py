"""DLR: a robot in an office sees discs on the floor, associated by hand (Kurlbaum and Frese 2009).

``map.circles`` holds, after comments, ``STEP image dX dY dPhi cXX cXY cYY cXPhi cYPhi cPhiPhi``, a
motion and its covariance in that order, each followed by ``LANDMARK_C pX pY quality cXX cXY cYY
id`` of what the camera then sees, in the frame of the robot. Metres and radians, no times: the time
of a pose is its number. No truth but the association. Ids have gaps; -1 is a spurious sighting.

Frame
-----
By the file, -Y is ahead and X is right. Seen from above that frame is left-handed, and the
sightings of neighbouring poses agree only with headings that turn X to Y, which is clockwise. So
``(x, y, theta) = (-Y, -X, -Phi)`` is the motion in a frame with x ahead, y left and angles
counter-clockwise; covariances follow. Without the reflection the map is the mirror image.

Noise
-----
Ranges are compressed: against a path smoothed with them they are `RANGE_LINE` = 0.16 m + 0.92 r.
That is undone by default, which takes the median squared Mahalanobis distance of a sighting (with
the covariances of the file) from 0.65 to 0.22. The scale of the whole is a matter of choice: with
distances of the odometry times 0.97 the smoother leaves no mean error of a step; with the ranges as
they are it finds the odometry 3 % too long.

What smoothing leaves then: of ranges 0.07 m (robustly 0.03 m; from 0.02 m near to 0.07 m far), of
bearings 0.04 rad (robustly 0.004 rad): one sighting in 80 is a gross error. Of odometry a walk of
4 mm along, 2 mm across and 8 mrad per step, with a drift of the heading by 0.55 mrad per step
clockwise, which is left in. The default is a round, cautious model: 0.06 m along the line of sight,
0.015 rad; 5 mm, 5 mm, 10 mrad per step. ``noise="file"`` takes the covariances of the file, which
are pessimistic for most sightings and know nothing of the gross errors.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.checks import is_covariance
from ekfslam.dataset import Dataset
from ekfslam.datasets.catalogue import files_of
from ekfslam.datasets.options import finite, one_of, positive, variances
from ekfslam.datasets.pose_graph import repeated
from ekfslam.datasets.text import Line, Table, lines_of, numbers, whole
from ekfslam.errors import FileFormatError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import NO_LANDMARK, Observations
from ekfslam.robots import Prior, Robot

ODOMETRY_SCALE = 0.97
RANGE_LINE = (0.16, 0.92)
ODOMETRY_SIGMAS = (0.005, 0.005, 0.01)
SENSOR_SIGMAS = (0.06, 0.015)
STEP = ("dX", "dY", "dPhi", "cXX", "cXY", "cYY", "cXPhi", "cYPhi", "cPhiPhi")
LANDMARK = ("pX", "pY", "quality", "cXX", "cXY", "cYY", "id")
POINT = np.array([[0.0, -1.0], [-1.0, 0.0]])  # of the file's frame in ours
POSE = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FARTHEST_SEEN = 100.0  # [m]: a camera that looks at the floor sees no farther


def load(
    path: str | Path | None = None,
    noise: str = "default",
    spurious: str = "drop",
    odometry_scale: float = ODOMETRY_SCALE,
    range_line: Sequence[float] = RANGE_LINE,
    odometry_sigmas: Sequence[float] = ODOMETRY_SIGMAS,
    sensor_sigmas: Sequence[float] = SENSOR_SIGMAS,
) -> Dataset:
    """Load the set.

    Parameters
    ----------
    path : path, optional
        The file or its folder.
    noise : {"default", "file"}
        Whose noise to state, see above.
    spurious : {"drop", "keep"}
        What becomes of sightings of no landmark: kept, they are clutter, without identity.
    odometry_scale : float
        Factor on the recorded distances of steps; 1 leaves them as they are.
    range_line : (2,) sequence of float
        Offset [m] and slope of recorded ranges over true ones; (0, 1) leaves them as they are.
    odometry_sigmas : (3,) sequence of float
        Standard deviations per step along, across and in heading [m, m, rad].
    sensor_sigmas : (2,) sequence of float
        Of a sighting, along the line of sight [m] and in bearing [rad].

    Returns
    -------
    Dataset
        One robot from the origin, sightings as x and y with a covariance each, association known,
        no truth.

    Raises
    ------
    FileFormatError
        For a missing or malformed file, with the line.
    InputError
        For an option that makes no sense.
    """
    one_of(noise, ("default", "file"), "noise")
    one_of(spurious, ("drop", "keep"), "spurious")
    scale = np.diag([positive(odometry_scale, "odometry_scale")] * 2 + [1.0])
    odometry_noise = variances(odometry_sigmas, 3, "odometry_sigmas")
    sensor_noise = variances(sensor_sigmas, 2, "sensor_sigmas")
    line = finite(range_line, 2, "range_line")
    positive(line[1], "the slope of range_line")
    path = files_of("dlr", path)["map.circles"]
    steps, seen, step = _read(path)
    landmark = whole(seen, 6, "the id", least=NO_LANDMARK)
    _check_twice(seen, step, landmark)
    stated = geo.congruence(scale, _covariances(steps, steps.values[:, 3:], POSE))
    covariances = _covariances(seen, seen.values[:, 3:6], POINT)
    points, J = _uncompressed(seen, seen.values[:, :2] @ POINT.T, line)
    covariances = geo.congruence(J, covariances)
    if noise == "file":
        odometry_noise = stated.mean(axis=0)
    else:
        covariances = along_sight(points, sensor_noise)
    typical = covariances.mean(axis=0) if len(covariances) else sensor_noise
    clutter = landmark == NO_LANDMARK
    kept = ~clutter if spurious == "drop" else np.full(len(landmark), True)
    robot = Robot(
        MotionModel("odometry", odometry_noise),
        steps.values[:, :3] @ POSE.T @ scale,
        Prior(),
        covariance=stated if noise == "file" else None,
    )
    return Dataset(
        name="dlr",
        robots=(robot,),
        times=np.arange(len(steps) + 1, dtype=float),
        # Every sighting has its own covariance; the sensor's is for show.
        sensors=(Sensor("xy", typical, name="camera"),),
        observations=Observations(
            step=step[kept],
            values=points[kept],
            landmark=landmark[kept],
            covariance=covariances[kept],
        ),
        true_landmark=landmark[kept],
        provenance="J. Kurlbaum and U. Frese, A Benchmark Data Set for Data Association, "
        "University of Bremen (SFB/TR 8), 2009",
        notes=(
            f"Read: {len(steps)} steps, {len(seen)} sightings of "
            f"{len(np.unique(landmark[~clutter]))} landmarks; {clutter.sum()} of them spurious"
            f"{', left out' if spurious == 'drop' else ''}.",
            "There is no truth: the association was made by hand, the noise was measured on what "
            "smoothing leaves.",
        ),
    )


def along_sight(points: Array, noise: Array) -> Array:
    """Covariances in x and y of points that were seen with a noise in range and bearing.

    Parameters
    ----------
    points : (m, 2) ndarray
        In the frame of the sensor [m].
    noise : (2, 2) array_like
        Of range and bearing.

    Returns
    -------
    (m, 2, 2) ndarray
        ``J noise J'`` with J the derivative of the point by range and bearing.
    """
    distance = np.hypot(points[:, 0], points[:, 1])
    direction = points / np.where(distance > 0, distance, 1.0)[:, None]
    return geo.congruence(np.stack([direction, geo.perpendicular(points)], axis=-1), noise)


def _uncompressed(seen: Table, points: Array, line: Array) -> tuple[Array, Array]:
    """Points at their true ranges, and the derivative of that by the point."""
    recorded = np.hypot(points[:, 0], points[:, 1])
    true = (recorded - line[0]) / line[1]
    seen.refuse((true <= 0) | (recorded == 0), "nearer than the offset of range_line")
    stretch = (true / recorded)[:, None]
    outwards = points / recorded[:, None]
    along = (1 / line[1] - stretch)[..., None] * outwards[:, :, None] * outwards[:, None, :]
    return points * stretch, stretch[..., None] * np.eye(2) + along


class _Rows(NamedTuple):
    """Rows of one kind while they are read."""

    values: list[list[float]]
    lines: list[int]

    def add(self, path: Path, line: Line, words: Sequence[str], columns: Sequence[str]) -> None:
        self.values.append(numbers(path, line.number, words, columns, line.words[0]))
        self.lines.append(line.number)

    def table(self, path: Path, columns: Sequence[str]) -> Table:
        values = np.array(self.values).reshape(-1, len(columns))
        return Table(path, values, np.array(self.lines, dtype=int))


def _read(path: Path) -> tuple[Table, Table, np.ndarray]:
    """Steps, sightings, and the step of each sighting."""
    steps, seen = _Rows([], []), _Rows([], [])
    step, before = [], None
    for line in lines_of(path):
        name, *words = line.words
        if name == "STEP":
            image = _number_of(words[0]) if words else None
            if before is not None and image is not None and image != before + 1:
                raise FileFormatError(
                    f"{path}, line {line.number}: image {image} comes after image {before}"
                )
            before = image
            steps.add(path, line, words[1:], STEP)
        elif name == "LANDMARK_C":
            if len(words) > len(LANDMARK):
                said = "LANDMARK_C has several ids (or other numbers too many); one is wanted"
                raise FileFormatError(f"{path}, line {line.number}: {said}")
            if not steps.lines:
                raise FileFormatError(f"{path}, line {line.number}: LANDMARK_C before any STEP")
            seen.add(path, line, words, LANDMARK)
            step.append(len(steps.lines))
        else:
            said = f"unknown record {name[:40]!r}; known are STEP, LANDMARK_C"
            raise FileFormatError(f"{path}, line {line.number}: {said}")
    if not steps.lines:
        raise FileFormatError(f"{path}: holds no STEP")
    motions, sightings = steps.table(path, STEP), seen.table(path, LANDMARK)
    motions.refuse(np.abs(motions.values[:, 2]) > np.pi, "is dPhi in radians?")
    motions.refuse(_size(motions) > FARTHEST_SEEN, "are dX and dY in metres?")
    sightings.refuse(_size(sightings) > FARTHEST_SEEN, "are pX and pY in metres?")
    quality = sightings.values[:, 2]
    sightings.refuse((quality < 0) | (quality > 1), "quality is not between 0 and 1")
    return motions, sightings, np.array(step, dtype=np.int64)


def _number_of(image: str) -> int | None:
    """The number that ends the name of an image, if one does."""
    found = re.search(r"(\d{1,15})$", image)
    return int(found[1]) if found else None


def _size(table: Table) -> Array:
    return np.hypot(table.values[:, 0], table.values[:, 1])


def _check_twice(seen: Table, step: np.ndarray, landmark: np.ndarray) -> None:
    keys = np.column_stack([step, landmark])
    seen.refuse(repeated(keys) & (landmark >= 0), "the id is seen twice after one step")


def _covariances(table: Table, columns: Array, frame: Array) -> Array:
    """Covariances from columns in the order xx, xy, yy, xt, yt, tt, in our frame."""
    size = len(frame)
    matrices = np.zeros((len(columns), size, size))
    where = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)][: columns.shape[1]]
    for (row, column), values in zip(where, columns.T, strict=True):
        matrices[:, row, column] = matrices[:, column, row] = values
    table.refuse(~is_covariance(matrices), "the covariance is not positive semi-definite")
    return geo.congruence(frame, matrices)
