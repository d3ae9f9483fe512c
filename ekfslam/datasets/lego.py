"""A LEGO robot with a laser scanner among six cylinders (Brenner, SLAM lectures, 2012).

Four text files, in millimetres and milliseconds: ticks of the motors (``M``), scans (``S``),
positions by a camera above the arena (``P``), and the known cylinders (``L C``). The state is the
pose of the middle of the axle; the scanner stands 30 mm ahead of it.

What was measured on the log, and what is done about it
-------------------------------------------------------
Stamps. The lectures pair the streams by row. Their stamps are those of arrival: with everything
else fitted anew, the likelihood of the innovations on the known map is largest for scans stamped
0.375 s later than the motors (485 above pairing by row, in its logarithm). The reference is 0.15 s
later than the motors, as its fit to the smoothed path says, and to the odometry alone. So ticks and
reference are interpolated to the moment at which a scan was made. ``lags=None`` pairs by row; that
calls for a bearing noise of 0.035 rad and a p1 of 0.14.

Odometry and sensor. The same likelihood gives 0.338 mm per tick, p1 0.055 and p2 0.195, a slip of
3.5 mm a step, 20.5 mm and 0.0205 rad for a find, whose mean range is 111 mm short of the centre of
the cylinder; displacement and angle of the scanner are those of the lectures within its error. It
is flat in the width of the robot. Headings over the whole run say 167.5 mm, which turns as 173 mm
does with the 0.349 mm of the lectures. With these, a squared innovation has a mean of 2.00. The
constants of the lectures are 0.349 mm, 155 mm (173 mm fits this log), 90 mm, p1 0.35, p2 0.6,
200 mm and 15 degrees.

Reference. It shows the scanner, on too large a scale: true = c + 0.912 (reference - c), fitted to
the smoothed path on the known map, from which it then differs by 13 mm on average. Its positions
are moved to the axle by the heading of the odometry, whose drift of a few degrees is worth 2 mm.
There is no true heading.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.datasets.catalogue import files_of
from ekfslam.datasets.cylinders import centres, find_cylinders
from ekfslam.datasets.identities import identified
from ekfslam.datasets.options import delays, finite, positive, variances
from ekfslam.datasets.resampling import interpolated
from ekfslam.datasets.text import Table, lines_of, numbers
from ekfslam.errors import FileFormatError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations
from ekfslam.robots import LandmarkMap, Prior, Robot

MILLI = 1e-3  # the files are in millimetres and milliseconds
BEAMS, AHEAD, BEAM_ANGLE = 660, 330, 0.006135923151543
LEAST_RANGE = 0.02
TICK, WIDTH = 0.338e-3, 0.1675
PROPORTIONAL, SLIP = (0.055, 0.195), 3.5e-3
SENSOR_SIGMAS = (0.0205, 0.0205)
MOUNT = (0.03, 0.0, -0.06981317)
CYLINDER_OFFSET, JUMP = 0.111, 0.1
LAGS = (0.375, 0.15)
REFERENCE_SCALE, REFERENCE_CENTRE = 0.912, (1.241, 1.299)
START = (1.850, 1.897, np.deg2rad(213.0))
PRIOR_SIGMAS = (0.03, 0.03, 0.05)
NEAR, WINDOW, DRIFT = 0.2, 10, np.deg2rad(90.0)  # see `identified`
NOTES = (
    "The truth is the camera's, put to scale by a fit to this log: it is off by some 13 mm itself, "
    "more than the sigmas of localization; NEES of positions counts that as well.",
    "Scale, stamps, odometry and noise were measured on this very log.",
)
MOTORS = [
    f"{name} of the {motor} motor"
    for motor in ("left", "right", "third")
    for name in ("position", "tacho count", "acceleration", "speed")
]


class Log(NamedTuple):
    """What the files hold, in metres and seconds.

    Attributes
    ----------
    motor_times, scan_times, reference_times : (n,) ndarray
        The streams have stamps of their own.
    ticks : (n, 2) ndarray
        Of the left and the right motor, from the first row on.
    scans : (n, b) ndarray
    reference : (n, 2) ndarray
        As recorded: not yet in scale.
    cylinders : (c, 2) ndarray
    """

    motor_times: Array
    ticks: Array
    scan_times: Array
    scans: Array
    reference_times: Array
    reference: Array
    cylinders: Array


def load(
    path: str | Path | None = None,
    lags: Sequence[float] | None = LAGS,
    tick: float = TICK,
    width: float = WIDTH,
    proportional: tuple[float, float] = PROPORTIONAL,
    slip: float = SLIP,
    mount: Sequence[float] = MOUNT,
    cylinder_offset: float = CYLINDER_OFFSET,
    jump: float = JUMP,
    sensor_sigmas: Sequence[float] = SENSOR_SIGMAS,
    reference_scale: float = REFERENCE_SCALE,
    reference_centre: Sequence[float] = REFERENCE_CENTRE,
    start: Sequence[float] = START,
    prior_sigmas: Sequence[float] = PRIOR_SIGMAS,
) -> Dataset:
    """Load the log of the LEGO robot.

    Parameters
    ----------
    path : path, optional
        The folder of its files.
    lags : (2,) sequence of float or None
        How much later [s] than those of the motors the stamps of the scans and of the reference
        are. None pairs the three streams by the number of their rows, as the lectures do.
    tick : float
        Way of a wheel per tick [m].
    width : float
        Distance of the wheels [m].
    proportional : (float, float)
        p1 and p2 of the noise of a wheel's way, see `ekfslam.models.motion.MotionModel`.
    slip : float
        Standard deviation per step across [m].
    mount : (3,) sequence of float
        Pose of the scanner on the robot, whose origin is the middle of its axle [m, m, rad].
    cylinder_offset : float
        From the mean range of its beams to the centre of a cylinder [m].
    jump : float
        Derivative of a scan that is an edge, see `ekfslam.datasets.cylinders` [m].
    sensor_sigmas : (2,) sequence of float
        Standard deviations of range and bearing [m, rad].
    reference_scale, reference_centre : float, (2,) sequence of float
        The scanner is at ``centre + scale * (reference - centre)`` [m]; scale 1 leaves the
        reference as it was recorded.
    start : (3,) sequence of float
        First position in the reference as recorded, and heading [m, m, rad].
    prior_sigmas : (3,) sequence of float
        Standard deviations of the first pose [m, m, rad].

    Returns
    -------
    Dataset
        One robot; cylinders as range and bearing without identities; the six known ones as known
        and as true map; the truth of positions, without headings.

    Raises
    ------
    FileFormatError
        For a missing or malformed file; names file and line.
    InputError
        For an option that makes no sense.
    """
    scale = positive(reference_scale, "reference_scale")
    centre = finite(reference_centre, 2, "reference_centre")
    first, scanner = finite(start, 3, "start"), finite(mount, 3, "mount")
    variances((slip,), 1, "slip")
    log = read(path)
    ticks, reference = _paired(log, lags)
    wheels = positive(tick, "tick") * np.diff(ticks, axis=0)
    motion = MotionModel("wheel-increments", None, proportional, slip, width)
    # Headings that move positions from the scanner to the axle: good enough for so short a way.
    odometry = geo.integrate(first, motion.increment(wheels)[0])
    course = odometry.copy()
    arms = geo.from_frame(course, scanner[:2]) - course[:, :2]
    course[:, :2] = centre + scale * (reference - centre) - arms
    begin = np.append(centre + scale * (first[:2] - centre) - arms[0], geo.wrap(first[2]))
    found = find_cylinders(log.scans, jump, LEAST_RANGE)
    values = centres(found, positive(cylinder_offset, "cylinder_offset"), AHEAD, BEAM_ANGLE)
    laser = Sensor(
        "range-bearing",
        variances(sensor_sigmas, 2, "sensor_sigmas"),
        mount=scanner,
        field_of_view=BEAMS * BEAM_ANGLE,
        name="laser",
    )
    cylinders = LandmarkMap(np.arange(len(log.cylinders)), log.cylinders)
    points = laser.locate(np.zeros(3), values)[0]
    whereabouts = _filled(course, odometry)
    identities = identified(whereabouts, found.scan, points, log.cylinders, NEAR, WINDOW, DRIFT)
    return Dataset(
        name="lego",
        robots=(
            Robot(
                motion,
                wheels,
                Prior(begin, variances(prior_sigmas, 3, "prior_sigmas")),
                course * [1.0, 1.0, np.nan],
                "robot4",
            ),
        ),
        times=log.scan_times,
        sensors=(laser,),
        observations=Observations(step=found.scan, values=values),
        known_map=cylinders,
        true_map=cylinders,
        true_landmark=identities,
        provenance="robot4 of the course SLAM lectures, C. Brenner, ikg, Leibniz University "
        "Hannover, 2012",
        notes=(
            f"Read: {len(log.scans)} scans with {len(values)} cylinders in them, "
            f"{len(log.ticks)} rows of the motors, {len(log.reference)} reference positions, "
            f"{len(cylinders)} known cylinders.",
            *NOTES,
        ),
    )


def _filled(course: Array, odometry: Array) -> Array:
    """Where a true position is not known, odometry from the nearest step at which it is."""
    known = np.flatnonzero(np.isfinite(course[:, 0]))
    if not len(known):
        return odometry
    steps = np.arange(len(course))
    near = known[np.abs(known - steps[:, None]).argmin(axis=1)]
    filled = course.copy()
    filled[:, :2] = course[near, :2] + odometry[:, :2] - odometry[near, :2]
    return filled


def _paired(log: Log, lags: Sequence[float] | None) -> tuple[Array, Array]:
    """Ticks and reference positions at the moments of the scans, both (n, 2)."""
    if lags is None:
        return log.ticks, log.reference
    scan_lag, reference_lag = delays(lags, 2, "lags")
    moments = log.scan_times - scan_lag
    ticks = np.column_stack([np.interp(moments, log.motor_times, t) for t in log.ticks.T])
    known = np.column_stack([log.reference, np.full(len(log.reference), np.nan)])
    # Stamps are in milliseconds: what meets one should not miss it by a rounding.
    at, stamps = (np.round(t, 9) for t in (moments + reference_lag, log.reference_times))
    return ticks, interpolated(stamps, known, at)[:, :2]


# Files ---------------------------------------------------------------------------------------


def read(path: str | Path | None) -> Log:
    """The four files, after a look at how they hang together."""
    files = files_of("lego", path)
    motors = _records(files["robot4_motors.txt"], "M", ["time", *MOTORS])
    beams = [f"range {i}" for i in range(BEAMS)]
    scans = _records(files["robot4_scan.txt"], "S", ["time", "number of beams", *beams])
    reference = _records(files["robot4_reference.txt"], "P", ["time", "x", "y"])
    cylinders = _records(files["robot_arena_landmarks.txt"], "L C", ["x", "y", "diameter"])
    for other in (motors, reference):
        if len(other) != len(scans):
            raise FileFormatError(
                f"{other.path}: {len(other)} rows, but {len(scans)} in {scans.path.name}; the "
                "streams of this log are paired row by row"
            )
    # Two rows of the motors may share a stamp.
    motors.refuse(_steps(motors) < 0, "time goes back")
    for table in (scans, reference):
        table.refuse(_steps(table) <= 0, "time does not increase")
    for table in (motors, reference):
        apart = np.abs(table.values[:, 0] - scans.values[:, 0])
        said = f"time is more than a second from that of the same row of {scans.path.name}"
        table.refuse(apart > 1000, said)
    scans.refuse(scans.values[:, 1] != BEAMS, f"number of beams is not {BEAMS}")
    ranges = scans.values[:, 2:]
    scans.refuse(ranges.min(axis=1) < 0, "negative range")
    scans.refuse(ranges.max(axis=1) < 100, "no range reaches 100 mm; are they in millimetres?")
    scans.refuse(ranges.max(axis=1) > 1e5, "range over 100 m; are they in millimetres?")
    ticks = motors.values[:, [1, 5]]
    jumps = np.abs(np.diff(ticks, axis=0, prepend=ticks[:1])).max(axis=1)
    motors.refuse(jumps > 2000, "a motor turned by more than 2000 ticks since the row before")
    for table, columns in ((reference, [1, 2]), (cylinders, [0, 1])):
        reach = np.abs(table.values[:, columns]).max(axis=1)
        table.refuse(reach > 1e5, "position over 100 m away; is it in millimetres?")
        small = np.full(len(reach), bool((reach < 20).all()))
        table.refuse(small, "no position is 20 mm away; are they in millimetres?")
    cylinders.refuse(cylinders.values[:, 2] <= 0, "diameter is not positive")
    if len(cylinders) < 2:
        raise FileFormatError(f"{cylinders.path}: one cylinder alone makes no map")
    return Log(
        MILLI * motors.values[:, 0],
        ticks - ticks[0],
        MILLI * scans.values[:, 0],
        MILLI * ranges,
        MILLI * reference.values[:, 0],
        MILLI * reference.values[:, 1:],
        MILLI * cylinders.values[:, :2],
    )


def _steps(table: Table) -> Array:
    """Change of the time since the row before; 1 in the first row."""
    return np.append(1.0, np.diff(table.values[:, 0]))


def _records(path: Path, record: str, columns: Sequence[str]) -> Table:
    """A file in which every line is one kind of record."""
    mark = record.split()
    rows, lines = [], []
    for number, words in lines_of(path):
        if words[: len(mark)] != mark:
            raise FileFormatError(
                f"{path}, line {number}: {record} is wanted first, there is "
                f"{' '.join(words[: len(mark)])[:40]!r}"
            )
        rows.append(numbers(path, number, words[len(mark) :], columns, record))
        lines.append(number)
    if not rows:
        raise FileFormatError(f"{path}: holds no {record}")
    return Table(path, np.array(rows), np.array(lines))
