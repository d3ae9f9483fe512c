"""A car among 15 reflective poles in a car park (ACFR; Nieto, Guivant and Nebot).

MATLAB arrays: a list of events, GPS (east, north), speed of the left rear wheel and steering every
25 ms, and laser scans with intensities, over 0 where the beam met a reflector; beacons surveyed to
2 cm.

Poses
-----
There is one for each scan, of the laser, 3.78 m ahead of the rear axle and 0.50 m left: there the
GPS has its antenna, so it is the truth of the position as it stands, and no heading is needed,
which it does not have. Speed and steering make arcs of the centre of the axle, at
``v / (1 - tan(steering) H / L)`` with H = 0.76 m and L = 2.83 m; put together from scan to scan,
they are taken to the laser, increment and covariance (see `ekfslam.datasets.car`), which is exact.
A unicycle at the laser would be wrong in every turn.

What was measured on the log, and what is done about it
-------------------------------------------------------
Reflectors are bright beams with gaps of at most three beams; 888 of 892 lie within 0.8 m of a
beacon, once the headings are found from the beacons around (`identified`), and the other four are
of something else.

Odometry. GPS is 8 % faster than the encoder (median) only before the wheel's way is taken to the
antenna: after that, the ratio is 0.99 to 1.01 at all steering angles but the largest, to the left,
where it is 1.04. So the scale is 1; 1.08 makes dead reckoning nine times worse, and even
localization on the known map is lost. Steering is 2 % and 0.006 rad short. Scans are stamped
0.048 s after the odometry and 0.015 s after the GPS.

Noise. The likelihood of the innovations on the known map is largest for 0.07 m/s and 0.045 rad
in each row, independent of the next one's, a further 5 mm along, 9 mm across and nothing in heading
per step; ranges 7 mm too short (the poles are round), with 16 mm and 0.0022 rad. Residuals have
tails, for which the default is 20 mm and 0.003 rad: squared innovations then have a mean of 1.3.

Start. The pose that lays the odometry of the first ten metres over the GPS has a heading of -129
degrees; the beacons say -127.6. The -112 degrees of the published filter are those of a moment
1.2 s later.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.datasets.car import LASER_AT, axle_moves, displaced, first_pose, fixed
from ekfslam.datasets.catalogue import files_of
from ekfslam.datasets.identities import identified
from ekfslam.datasets.options import delays, finite, finite_number, positive, variances
from ekfslam.errors import FileFormatError, InputError
from ekfslam.geometry import Array
from ekfslam.mat5 import read_arrays, refuse
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations
from ekfslam.robots import LandmarkMap, Prior, Robot

DATA, BEACONS = "data_set.mat", "beac_juan3.mat"
BEAMS, AHEAD, BEAM_ANGLE = 361, 180, np.deg2rad(0.5)
GAP = 3  # beams between two of one reflector
NO_RETURN = 82.0  # [m]; there is none beyond
SPEED_SCALE, STEERING = 1.0, (1.02, 0.006)
LAGS = (0.048, 0.015)
RANGE_BIAS = -0.007
CONTROL_SIGMAS = (0.07, 0.048)
STEP_SIGMAS = (0.006, 0.009, 0.0005)
SENSOR_SIGMAS = (0.02, 0.003)
PRIOR_SIGMAS = (0.05, 0.05, 0.04)
MAX_RANGE = 16.0
NEAR, WINDOW, DRIFT = 0.8, 10, np.deg2rad(90.0)  # see `identified`
NOTES = (
    "The truth is GPS at the laser, good to some centimetres, about the sigmas of localization; "
    "NEES of positions counts its errors as well. Its heading is unknown.",
    "Maps and paths of SLAM keep the error of the first heading: align them.",
)
SENSORS = {1: "TimeGPS", 2: "Time_VS", 3: "TimeLaser"}  # of the list of events
SHAPES: dict[str, tuple[int | None, int | None]] = {
    **dict.fromkeys(("Time", "Sensor", "Index"), (1, None)),
    **dict.fromkeys(("TimeGPS", "GPSLon", "GPSLat"), (1, None)),
    **dict.fromkeys(("Time_VS", "Velocity", "Steering", "TimeLaser"), (1, None)),
    **dict.fromkeys(("Laser", "Intensity"), (None, BEAMS)),
}


class Log(NamedTuple):
    """What the files hold.

    Attributes
    ----------
    fixes : (n, 3) ndarray
        Time [s], east, north [m].
    odometry : (n, 3) ndarray
        Time [s], speed of the left rear wheel [m/s], steering [rad].
    scans : (n,) ndarray
        Times [s].
    ranges, intensities : (n, 361) ndarray
    beacons : (b, 2) ndarray
        East, north [m].
    """

    fixes: Array
    odometry: Array
    scans: Array
    ranges: Array
    intensities: Array
    beacons: Array


def load(
    path: str | Path | None = None,
    speed_scale: float = SPEED_SCALE,
    steering: Sequence[float] = STEERING,
    lags: Sequence[float] = LAGS,
    range_bias: float = RANGE_BIAS,
    control_sigmas: Sequence[float] = CONTROL_SIGMAS,
    step_sigmas: Sequence[float] = STEP_SIGMAS,
    sensor_sigmas: Sequence[float] = SENSOR_SIGMAS,
    start: Sequence[float] | None = None,
    prior_sigmas: Sequence[float] = PRIOR_SIGMAS,
) -> Dataset:
    """Load the drive.

    Parameters
    ----------
    path : path, optional
        The folder of its files.
    speed_scale : float
        Factor on the recorded speed.
    steering : (2,) sequence of float
        The steering angle is ``steering[0] * recorded + steering[1]`` [rad].
    lags : (2,) sequence of float
        How much later [s] than those of the odometry and of the GPS the stamps of the scans are.
    range_bias : float
        Taken off the ranges [m].
    control_sigmas : (2,) sequence of float
        Standard deviations of speed and steering in a row of the odometry [m/s, rad].
    step_sigmas : (3,) sequence of float
        Further ones per step, along, across and in heading [m, m, rad].
    sensor_sigmas : (2,) sequence of float
        Of range and bearing [m, rad].
    start : (3,) sequence of float, optional
        First pose of the laser [m, m, rad]; by default the one that lays the odometry of the first
        ten metres over the GPS.
    prior_sigmas : (3,) sequence of float
        Standard deviations of the first pose [m, m, rad].

    Returns
    -------
    Dataset
        One robot, the laser's pose at each scan; reflectors as range and bearing without
        identities; the beacons as known and as true map; GPS as truth of the position.

    Raises
    ------
    FileFormatError
        For a missing or malformed file; names file, array and row.
    InputError
        For an option that makes no sense.
    """
    scale, bias = positive(speed_scale, "speed_scale"), finite_number(range_bias, "range_bias")
    factor, offset = finite(steering, 2, "steering")
    odometry_lag, fix_lag = delays(lags, 2, "lags")
    log = read(path)
    rows = log.odometry * [1.0, scale, factor] + [0.0, 0.0, offset]
    moments = log.scans - odometry_lag
    rows[0, 0] = min(rows[0, 0], moments[0])  # the first row holds before it, too
    noise = variances(control_sigmas, 2, "control_sigmas")
    moves = displaced(axle_moves(rows, moments, noise), np.array(LASER_AT))
    covariances = moves.covariances + variances(step_sigmas, 3, "step_sigmas")
    truth = fixed(log.fixes[:, 0], log.fixes[:, 1:], log.scans - fix_lag)
    first = first_pose(moves.deltas, truth) if start is None else finite(start, 3, "start")
    if first is None:
        raise InputError("lags leave no fixes for the first metres; give start")
    step, values = reflectors(log.ranges, log.intensities)
    values[:, 0] -= bias
    laser = Sensor(
        "range-bearing",
        variances(sensor_sigmas, 2, "sensor_sigmas"),
        max_range=MAX_RANGE,
        field_of_view=np.pi,
        name="laser",
    )
    course = np.column_stack([truth[:, :2], geo.integrate(first, moves.deltas)[:, 2]])
    points = laser.locate(np.zeros(3), values)[0]
    beacons = LandmarkMap(np.arange(len(log.beacons)), log.beacons)
    robot = Robot(
        MotionModel("odometry", covariances.mean(axis=0)),  # for show: each step has its own
        moves.deltas,
        Prior(first, variances(prior_sigmas, 3, "prior_sigmas")),
        truth,
        "car",
        covariances,
    )
    return Dataset(
        name="car-park",
        robots=(robot,),
        times=log.scans,
        sensors=(laser,),
        observations=Observations(step=step, values=values),
        known_map=beacons,
        true_map=beacons,
        true_landmark=identified(course, step, points, log.beacons, NEAR, WINDOW, DRIFT),
        provenance="Australian Centre for Field Robotics, University of Sydney; J. Nieto, "
        "J. Guivant and E. Nebot, SLAM summer schools 2002 to 2006",
        notes=(
            f"Read: {len(log.scans)} scans with {len(step)} reflectors, {len(log.odometry)} rows "
            f"of odometry, {len(log.fixes)} fixes, {len(log.beacons)} beacons.",
            *NOTES,
        ),
    )


def reflectors(ranges: Array, intensities: Array) -> tuple[np.ndarray, Array]:
    """Reflectors in scans: neighbouring beams that are bright, with gaps of at most three beams.

    Parameters
    ----------
    ranges, intensities : (n, 361) ndarray
        Over half a turn from right to left; an intensity over 0 is a reflector's.

    Returns
    -------
    (m,) ndarray of int
        Scan of each.
    (m, 2) ndarray
        Mean range [m] and bearing [rad] of its beams, 0 ahead.
    """
    scan, beam = np.nonzero(intensities > 0)
    starts = np.append(True, (np.diff(scan) != 0) | (np.diff(beam) > GAP))[: len(scan)]
    which = np.cumsum(starts) - 1
    count = np.bincount(which)
    mean_range = np.bincount(which, ranges[scan, beam]) / count
    mean_beam = np.bincount(which, beam) / count
    return scan[starts], np.column_stack([mean_range, (mean_beam - AHEAD) * BEAM_ANGLE])


# Files ---------------------------------------------------------------------------------------


def read(path: str | Path | None = None) -> Log:
    """The arrays of both files, after a look at how they hang together.

    Raises
    ------
    FileFormatError
        Names file, array and row.
    """
    files = files_of("car-park", path)
    file = files[DATA]
    arrays = read_arrays(file, SHAPES)
    ranges, intensities = arrays.pop("Laser"), arrays.pop("Intensity")
    rows = {name: array[0] for name, array in arrays.items()}
    fixes = _together(file, rows, ("TimeGPS", "GPSLon", "GPSLat"))
    odometry = _together(file, rows, ("Time_VS", "Velocity", "Steering"))
    scans = _together(file, rows, ("TimeLaser",))[:, 0]
    events = _together(file, rows, ("Time", "Sensor", "Index"))
    for name, array in (("Laser", ranges), ("Intensity", intensities)):
        if len(array) != len(scans):
            raise FileFormatError(
                f"{file}: {len(array)} rows of {name}, but {len(scans)} of TimeLaser"
            )
    for name in SENSORS.values():
        refuse(file, name, np.diff(rows[name], prepend=-np.inf) <= 0, "time does not increase")
    _check_events(file, events, rows)
    beyond = (ranges.min(axis=1) < 0) | (ranges.max(axis=1) > NO_RETURN)
    refuse(file, "Laser", beyond, f"range below 0 m or over {NO_RETURN:g} m")
    refuse(file, "Intensity", intensities.min(axis=1) < 0, "negative intensity")
    refuse(file, "Velocity", np.abs(odometry[:, 1]) > 50, "over 50 m/s: is it in m/s?")
    refuse(file, "Steering", np.abs(odometry[:, 2]) > 1.2, "over 1.2 rad: is it in radians?")
    for column, name in ((1, "GPSLon"), (2, "GPSLat")):
        refuse(file, name, np.abs(fixes[:, column]) > 1e4, "over 10 km: is it in metres?")
    beacons = read_arrays(files[BEACONS], {"estbeac": (None, 2)})["estbeac"]
    far = np.abs(beacons).max(axis=1, initial=0.0) > 1e4
    refuse(files[BEACONS], "estbeac", far, "over 10 km: is it in metres?")
    if len(beacons) < 2:
        raise FileFormatError(f"{files[BEACONS]}: estbeac needs two beacons or more")
    return Log(fixes, odometry, scans, ranges, intensities, beacons)


def _together(file: Path, rows: dict[str, Array], names: Sequence[str]) -> Array:
    """Columns that are of one length, and not empty."""
    lengths = [len(rows[name]) for name in names]
    if len(set(lengths)) > 1 or not lengths[0]:
        counted = ", ".join(f"{n} of {name}" for n, name in zip(lengths, names, strict=True))
        raise FileFormatError(f"{file}: as many entries are wanted of each, there are {counted}")
    return np.column_stack([rows[name] for name in names])


def _check_events(file: Path, events: Array, rows: dict[str, Array]) -> None:
    """The list of events must name every entry of every sensor in turn, with its time."""
    time, sensor, index = events.T
    refuse(file, "Sensor", ~np.isin(sensor, list(SENSORS)), "no sensor 1, 2 or 3")
    for code, name in SENSORS.items():
        at = np.flatnonzero(sensor == code)
        if len(at) != len(rows[name]):
            raise FileFormatError(
                f"{file}: {len(at)} events of sensor {code} in Sensor, but {len(rows[name])} "
                f"entries of {name}"
            )
        bad = np.zeros(len(time), dtype=bool)
        bad[at] = (index[at] != np.arange(1, len(at) + 1)) | (time[at] != rows[name])
        refuse(file, "Index", bad, f"not the next entry of {name}, with its time")
