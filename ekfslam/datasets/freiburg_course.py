"""Freiburg course: a small simulated world of a course exercise (Stachniss, Robot Mapping).

``sensor_data.dat`` holds ``ODOMETRY rot1 trans rot2`` [rad, m, rad], a motion of a turn, a drive
and a turn, each followed by the ``SENSOR id range bearing`` [m, rad] rows of what is seen after it;
``world.dat`` holds ``id x y`` [m] of the nine landmarks, which is the truth. There is no true path
and no time: the time of a pose is its number. The start is the origin, exactly.

Some bearings lie outside of (-pi, pi] and are wrapped. One range is negative (-0.035 m): what noise
makes of a landmark that is driven over. It is kept; the range of a correction may be negative.

Noise
-----
The files state none. Smoothed with the known map, ranges spread by 0.093 m, bearings by 0.047 rad,
the drive by 0.005 m and the turns by 0.003 rad each (slightly low, since poses were fitted); these
are the defaults. The exercise itself suggests a standard deviation of 0.1 m and 0.1 rad for the
observations.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ekfslam import geometry as geo
from ekfslam.checks import checked_array
from ekfslam.dataset import Dataset
from ekfslam.datasets.catalogue import files_of
from ekfslam.datasets.options import variances
from ekfslam.datasets.pose_graph import repeated
from ekfslam.datasets.text import Table, lines_of, numbers, read_table, whole
from ekfslam.errors import FileFormatError
from ekfslam.geometry import Array
from ekfslam.models.motion import Increments, MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import FARTHEST, Observations
from ekfslam.robots import LandmarkMap, Prior, Robot

MOTION_SIGMAS = (0.003, 0.005, 0.003)
SENSOR_SIGMAS = (0.093, 0.047)
RECORDS = {"ODOMETRY": ("rot1", "trans", "rot2"), "SENSOR": ("id", "range", "bearing")}
FARTHEST_SEEN = 1000.0  # [m]: beyond, and for motions, numbers are hardly metres


def load(
    path: str | Path | None = None,
    motion_sigmas: Sequence[float] = MOTION_SIGMAS,
    sensor_sigmas: Sequence[float] = SENSOR_SIGMAS,
) -> Dataset:
    """Load the set of the course.

    Parameters
    ----------
    path : path, optional
        The folder of its files.
    motion_sigmas : (3,) sequence of float
        Standard deviations of first turn, drive and second turn of a motion [rad, m, rad].
    sensor_sigmas : (2,) sequence of float
        Of range and bearing [m, rad].

    Returns
    -------
    Dataset
        One robot from the origin, association and map known, no true path.

    Raises
    ------
    FileFormatError
        For a missing or malformed file, with the line.
    InputError
        For standard deviations that are none.
    """
    motion_noise = variances(motion_sigmas, 3, "motion_sigmas")
    sensor_noise = variances(sensor_sigmas, 2, "sensor_sigmas")
    files = files_of("freiburg-course", path)
    world = _read_world(files["world.dat"])
    motions, seen, step = _read_log(files["sensor_data.dat"])
    landmark = whole(seen, 0, "the id")
    seen.refuse(~np.isin(landmark, world.ids), f"there is no such id in {files['world.dat'].name}")
    least = -FARTHEST * float(np.sqrt(sensor_noise[0, 0]))
    seen.refuse(seen.values[:, 1] < least, f"the range is below {FARTHEST:g} sigmas of its noise")
    deltas, covariances = turn_drive_turn(motions.values, motion_noise)
    values = seen.values[:, 1:].copy()
    values[:, 1] = geo.wrap(values[:, 1])
    motion = MotionModel("odometry", covariances.mean(axis=0))  # for show: each motion has its own
    return Dataset(
        name="freiburg-course",
        robots=(Robot(motion, deltas, Prior(), covariance=covariances),),
        times=np.arange(len(motions) + 1, dtype=float),
        sensors=(Sensor("range-bearing", sensor_noise),),
        observations=Observations(step=step, values=values, landmark=landmark),
        known_map=world,
        true_map=world,
        true_landmark=landmark,
        provenance="course Robot Mapping (C. Stachniss and others), University of Freiburg, EKF "
        "SLAM exercise",
        notes=(
            f"Read: {len(motions)} motions, {len(seen)} sightings, {len(world)} landmarks. "
            "There is no true path; the landmarks' truth is known.",
        ),
    )


def turn_drive_turn(motions: Array, covariance: Array) -> Increments:
    """Increments of motions that turn, drive and turn, to first order in their noise.

    The increment is ``(d cos a, d sin a, a + b)`` of first turn a, drive d and second turn b, and
    its covariance ``J Sigma J'`` with ``J = [-d sin a, cos a, 0; d cos a, sin a, 0; 1, 0, 1]``
    (Thrun, Burgard and Fox 2005, odometry motion model).

    Parameters
    ----------
    motions : (K, 3) array_like
        First turn, drive, second turn [rad, m, rad].
    covariance : (3, 3) or (K, 3, 3) array_like
        Of those three.
    """
    motions = checked_array(motions, float, (None, 3), "motions")
    first, drive, second = motions.T
    cosine, sine = np.cos(first), np.sin(first)
    J = np.zeros((len(motions), 3, 3))
    J[:, 0, 0], J[:, 0, 1] = -drive * sine, cosine
    J[:, 1, 0], J[:, 1, 1] = drive * cosine, sine
    J[:, 2, 0] = J[:, 2, 2] = 1.0
    deltas = np.column_stack([drive * cosine, drive * sine, first + second])
    return Increments(deltas, geo.congruence(J, covariance))


def _read_world(path: Path) -> LandmarkMap:
    """The true landmarks."""
    table = read_table(path, ("id", "x", "y"))
    ids = whole(table, 0, "the id")
    table.refuse(repeated(ids), "the id has been there before")
    return LandmarkMap(ids, table.values[:, 1:])


def _read_log(path: Path) -> tuple[Table, Table, np.ndarray]:
    """Motions, sightings, and the step of each sighting."""
    rows: dict[str, list[list[float]]] = {name: [] for name in RECORDS}
    lines: dict[str, list[int]] = {name: [] for name in RECORDS}
    step = []
    for number, (name, *words) in lines_of(path):
        if name not in RECORDS:
            raise FileFormatError(
                f"{path}, line {number}: unknown record {name[:40]!r}; known are ODOMETRY, SENSOR"
            )
        if name == "SENSOR":
            step.append(len(rows["ODOMETRY"]))
        rows[name].append(numbers(path, number, words, RECORDS[name], name))
        lines[name].append(number)
    motions, seen = (
        Table(path, np.array(rows[name]).reshape(-1, 3), np.array(lines[name], dtype=int))
        for name in RECORDS
    )
    if not len(motions):
        raise FileFormatError(f"{path}: holds no ODOMETRY")
    taken_at = np.array(step, dtype=np.int64)
    seen.refuse(taken_at == 0, "SENSOR before the first ODOMETRY")
    turns = np.abs(motions.values[:, [0, 2]]).max(axis=1)
    motions.refuse(turns > geo.TAU, "more than a full turn: are the turns in radians?")
    motions.refuse(np.abs(motions.values[:, 1]) > FARTHEST_SEEN, "is the drive in metres?")
    seen.refuse(np.abs(seen.values[:, 2]) > geo.TAU, "is the bearing in radians?")
    seen.refuse(np.abs(seen.values[:, 1]) > FARTHEST_SEEN, "is the range in metres?")
    keys = np.column_stack([taken_at, seen.values[:, 0]])
    seen.refuse(repeated(keys), "the id is seen twice after one motion")
    return motions, seen, taken_at
