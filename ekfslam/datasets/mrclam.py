"""MRCLAM 1 to 9: five robots among fifteen landmarks (Leung and others 2011).

Five iRobot Create with a forward camera that reads barcodes, on the landmarks and on each other, in
15 m x 8 m; their poses by motion capture. The files, ``N`` being 1 to 5, with ``#`` for comments:

============================ ==================================================================
``Barcodes.dat``             subject, barcode; 1 to 5 are the robots, the others landmarks
``Landmark_Groundtruth.dat`` subject, x, y [m], their standard deviations [m]
``RobotN_Odometry.dat``      time [s], forward velocity [m/s], angular velocity [rad/s]
``RobotN_Measurement.dat``   time [s], barcode (its header says subject), range [m], bearing [rad]
``RobotN_Groundtruth.dat``   time [s], x, y [m], heading [rad]
============================ ==================================================================

Instead of the last one there may be ``RobotN_Groundtruth_sparse.dat``: single instants at which the
pose is known, optionally with a count in a fifth column; a pose takes one within half a step.

What was measured on sets 1 and 2 against the truth, and what is done about it
--------------------------------------------------------------------------------
The figures are of nine robots: all but the fifth of set 1, which has no truth of its own. Defaults
were chosen on these sets, and hold for the others as far as the same robots behave the same; that
sightings count together, rather than each for itself, and for how long, was also chosen by the
errors of the EKF's maps here, so those errors are no test of it.

The landmarks 11 and 17 of set 1 are swapped in the published file: every sighting of one points
to where the other is listed. If the file has the published positions they are swapped back; a file
``Landmark_Groundtruth.corrected.dat`` beside it is read instead.

Commands, not wheels, are logged. They hold until the next, and reach the wheels late: over 0.2 s
the heading changes are explained best by a lag of 0.16 to 0.20 s, over 1 s by 0.20 to 0.28 s.
Robots are slower than told, v by 0.895 to 0.920 and omega by 0.904 to 0.949 (`SCALES`; 0.91 and
0.93 where not measured). With lag and scale undone, what is left of the turn is white from 0.2 s to
20 s: 0.024 to 0.039 rad per root of a second. Along it is 0.006, 0.010, 0.015 and 0.021 m per root
of a second over 0.2, 1, 5 and 20 s, as the scale wanders; 0.015 is taken. Across it is 0.001 to
0.003 m up to 1 s. Told to stand, a robot stands: a tenth of the noise is left then.

Images are stamped late: bearings spread least with stamps 0.02 to 0.04 s earlier. The commands, at
65 Hz, are put together along exact arcs into steps, and a sighting is attached to the nearest pose
with its time kept. To the spread of bearings (0.009 to 0.014 rad; robot 1 0.030) steps of 0.1 s add
1 to 12 %, steps of 0.2 s 3 to 38 %, and steps of 0.5 s double it: at 0.2 s it is 0.012 to 0.017 rad
(robot 1 0.031), and 0.015 (0.03) is taken.

Ranges spread by 0.04 r, and 0.07 m at 1.5 m; the variance is ``0.05^2 + (0.04 r)^2``. Their bias is
a few centimetres, other for each robot, and not taken off unless `range_bias` says so (on average
-0.012 r). **Range errors are not white**: those of one landmark correlate by 0.94 within a second,
and by 0.3 to 0.5 after five. So sightings of one thing by one robot within five seconds count as
one: each has the covariance times their number (`correlated`). Nothing is left out, and errors of a
filter come nearer to what it claims (mean NEES of a pose, EKF over ten robots: 7.0 for 19.4); the
NIS, of each sighting alone, is small then. `every=5` leaves one sighting in five seconds instead,
and the NIS is 1.0 per degree of freedom.

Barcodes are misread now and then, up to nine times in a run: the bearing is off by more than
`misread_beyond` from where the truth has what was read, mostly by much more. One such sighting
spoils a filter that is told whom it saw. Since association is given, they are left out where the
truth is known; ``misread_beyond=3.2`` leaves them in, for estimators with gates or robust losses.
Barcodes that are in no table, and a robot's own, are left out too; the notes count all of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.datasets.catalogue import files_of
from ekfslam.datasets.mrclam_files import (
    BARCODES,
    LANDMARKS,
    ROBOTS,
    UNKNOWN,
    Log,
    Who,
    missing_of,
    read_landmarks,
    read_log,
    read_who,
)
from ekfslam.datasets.mrclam_steps import (
    Sighted,
    counts_together,
    misread,
    robot_of,
    sighted,
    span,
    together,
    truth_at,
)
from ekfslam.datasets.options import delays, duration, finite, positive, variances
from ekfslam.errors import FileFormatError, InputError, UnknownNameError
from ekfslam.models.sensors import Sensor
from ekfslam.robots import Robot

STEP = 0.2
LAG = 0.2
IMAGE_SHIFT = -0.03
SCALE = (0.91, 0.93)
SCALES: Mapping[tuple[int, int], tuple[float, float]] = {  # of set and robot: v and omega
    (1, 1): (0.918, 0.936),
    (1, 2): (0.895, 0.917),
    (1, 3): (0.908, 0.936),
    (1, 4): (0.911, 0.925),
    (2, 1): (0.920, 0.941),
    (2, 2): (0.904, 0.949),
    (2, 3): (0.920, 0.945),
    (2, 4): (0.909, 0.904),
    (2, 5): (0.905, 0.927),
}
ODOMETRY_SIGMAS = (0.015, 0.002, 0.033)
RANGE_SIGMA, RANGE_GROWTH = 0.05, 0.04
BEARING_SIGMA, BEARING_SIGMAS = 0.015, {1: 0.03}  # by robot, where another
PRIOR_SIGMAS = (0.01, 0.01, 0.01)
MAX_RANGE, FIELD_OF_VIEW = 10.0, 1.2  # 9.61 m and 0.591 rad to a side are the most in sets 1 and 2
MISREAD = 0.25
LARGEST_BIAS = (10.0, 1.0)  # of a range: a and b
ROUNDING = 1e-6  # of a step, by which the last pose may be late
FINEST = 0.01  # [s] that a step has at least; commands come every 0.015 s
CORRELATED_FOR = 5.0
CORRELATED = (
    "errors of range are correlated, by 0.94 within a second and 0.3 to 0.5 after five: who takes "
    "them for white is over-confident, and the NEES too large"
)
COUNTED = "; sightings of one thing within {:g} s count as one, which makes the NIS small"


def load(
    number: int,
    path: str | Path | None = None,
    part: str | None = None,
    step: float = STEP,
    lag: float = LAG,
    image_shift: float = IMAGE_SHIFT,
    v_scale: float | None = None,
    w_scale: float | None = None,
    odometry_sigmas: Sequence[float] = ODOMETRY_SIGMAS,
    range_sigma: float = RANGE_SIGMA,
    range_growth: float = RANGE_GROWTH,
    range_bias: Sequence[float] = (0.0, 0.0),
    bearing_sigma: float | None = None,
    correlated: float = CORRELATED_FOR,
    every: float = 0.0,
    misread_beyond: float = MISREAD,
    prior_sigmas: Sequence[float] = PRIOR_SIGMAS,
) -> Dataset:
    """Load a set of MRCLAM: a robot, or the team of all whose files are there.

    The run starts when the truth is first known, and all robots have been told something; it ends
    with the commands, or with the truth if that ends within a second of them. A robot without truth
    starts at zero, and has no place in a team.

    Parameters
    ----------
    number : int
        1 to 9.
    path : path, optional
        Folder of the set, or of several sets; by default that of EKFSLAM_DATA.
    part : str, optional
        ``robot1`` to ``robot5``: this one alone, without the robots that it saw.
    step : float
        Time from pose to pose [s].
    lag : float
        By which commands reach the wheels late [s].
    image_shift : float
        To add to the stamps of sightings [s].
    v_scale, w_scale : float, optional
        True by commanded velocities; as measured by default.
    odometry_sigmas : (3,) sequence of float
        Standard deviations along, across and in heading over one second [m, m, rad]; the noise is
        white, so that its variance grows with time.
    range_sigma, range_growth : float
        The variance of a range r is ``range_sigma^2 + (range_growth r)^2``.
    range_bias : (2,) sequence of float
        a [m] and b of a range that is too long by ``a + b r``; r is the true one.
    bearing_sigma : float, optional
        [rad]; 0.03 for robot 1 and 0.015 for the others by default.
    correlated : float
        A robot's sightings of one thing within so many seconds count as one: each one's covariance
        is multiplied by their number; 0 takes each for itself [s].
    every : float
        Of each landmark or robot, a robot's sighting is left out that comes less than this after
        the last one kept [s].
    misread_beyond : float
        A sighting whose bearing is further than this from where the truth has what it shows is of a
        misread barcode, and left out [rad]; pi keeps all.
    prior_sigmas : (3,) sequence of float
        Standard deviations of the first pose, whose mean is the true one [m, m, rad].

    Returns
    -------
    Dataset
        Times in seconds from the first pose; landmarks are called by their subjects. The map is
        known and true; the notes tell what was read and left out.

    Raises
    ------
    FileFormatError
        For a missing or malformed file; names file and line.
    InputError, UnknownNameError
        For an option or part that makes no sense.
    """
    if number not in range(1, 10):
        raise InputError(f"there are MRCLAM 1 to 9, not {number!r}")
    if part is not None and part not in [f"robot{robot}" for robot in ROBOTS]:
        raise UnknownNameError("part of MRCLAM", part, [f"robot{robot}" for robot in ROBOTS])
    _check(step, every, correlated, misread_beyond, v_scale, w_scale)
    delays((lag, image_shift), 2, "lag and image_shift")
    if not (np.abs(finite(range_bias, 2, "range_bias")) < LARGEST_BIAS).all():
        raise InputError(f"range_bias must be below 10 m and 1, got {range_bias!r}")
    rates = variances(odometry_sigmas, 3, "odometry_sigmas")
    prior = variances(prior_sigmas, 3, "prior_sigmas")

    name = f"mrclam{int(number)}"
    files = files_of(name, path)
    who = read_who(files[BARCODES])
    landmarks, said = read_landmarks(files[LANDMARKS], who, number)
    logs, absent = _logs(files[BARCODES], part, who)
    corrected = []
    for log in logs:
        measured = SCALES.get((number, log.robot), SCALE)
        scales = (v_scale or measured[0], w_scale or measured[1])
        corrected.append(_corrected(log, lag, image_shift, scales, range_bias))
    start, end = span(corrected, step)
    times = step * np.arange(1.0 + np.floor((end - start) / step + ROUNDING))
    corrected = [log.since(start) for log in corrected]
    robots = tuple(robot_of(log, times, rates, prior) for log in corrected)
    team = {log.robot: index for index, log in enumerate(logs)}
    seen = [sighted(log, times, team, every) for log in corrected]
    truths = [truth_at(log, times, step) for log in corrected]
    for i, one in enumerate(seen):
        wrong = misread(one, truths, i, landmarks) > misread_beyond
        seen[i] = one.without(wrong, "misread, as the truth has it")
    cameras = tuple(_camera(log, range_sigma, range_growth, bearing_sigma) for log in logs)
    noise = [
        camera.covariances(one.values) * counts_together(one, correlated)[:, None, None]
        for camera, one in zip(cameras, seen, strict=True)
    ]
    observations = together(seen, noise)
    caution = CORRELATED + COUNTED.format(correlated) * (correlated > 0)
    counts = [_counts(*each) for each in zip(logs, seen, robots, strict=True)]
    return Dataset(
        name=name if part is None else f"{name}/{part}",
        robots=robots,
        times=times,
        sensors=cameras,
        observations=observations,
        known_map=landmarks if len(logs[0].truth) else None,
        true_map=landmarks,
        true_landmark=observations.landmark,
        provenance=f"{files[BARCODES].parent.name}, from {start:.3f} on (Unix time); K. Leung, "
        "Y. Halpern, T. Barfoot and H. Liu, International Journal of Robotics Research 30(8), 2011",
        notes=(caution, *(note for note in (said, absent) if note), *counts),
    )


def _check(
    step: float,
    every: float,
    correlated: float,
    misread_beyond: float,
    v_scale: float | None,
    w_scale: float | None,
) -> None:
    """Refuse options that make no sense."""
    if positive(step, "step") < FINEST:
        raise InputError(f"step must be {FINEST} s at least, got {step}")
    duration(every, "every")
    duration(correlated, "correlated")
    positive(misread_beyond, "misread_beyond")
    for option, scale in (("v_scale", v_scale), ("w_scale", w_scale)):
        if scale is not None:
            positive(scale, option)


def _logs(beside: Path, part: str | None, who: Who) -> tuple[list[Log], str]:
    """The logs of those who take part, and a word on those who do not."""
    wanted = [robot for robot in ROBOTS if part in (None, f"robot{robot}")]
    found = {robot: read_log(beside, robot, who) for robot in wanted}
    logs = [log for log in found.values() if log]
    if not logs:
        files = missing_of(beside, wanted[0])
        others = "" if part else ", nor those of another robot"
        raise FileFormatError(f"{beside.parent}: has no {files} (nor with .gz){others}")
    absent = [f"robot{i} (no {missing_of(beside, i)})" for i in wanted if not found[i]]
    if part is None:
        placed = [log for log in logs if len(log.truth)]
        if not placed:
            raise FileFormatError(
                f"{beside.parent}: has no truth of any robot, so that nobody knows where they "
                "start; take one of them, such as robot1"
            )
        absent += [f"{log.name} (no truth to start from)" for log in logs if log not in placed]
        logs = placed
    return logs, f"not in the team: {', '.join(absent)}" if absent else ""


def _corrected(
    log: Log, lag: float, image_shift: float, scale: Sequence[float], bias: Sequence[float]
) -> Log:
    """A log with its clocks, the scale of its commands and the bias of its ranges put right."""
    commands = log.commands * [1.0, *scale] + [lag, 0.0, 0.0]
    values = (log.values - [bias[0], 0.0]) / [1.0 + bias[1], 1.0]
    return log._replace(commands=commands, time=log.time + image_shift, values=values)


def _camera(log: Log, range_sigma: float, growth: float, bearing_sigma: float | None) -> Sensor:
    """The camera of a robot."""
    bearing = BEARING_SIGMAS.get(log.robot, BEARING_SIGMA)
    sigmas = (range_sigma, bearing if bearing_sigma is None else bearing_sigma)
    return Sensor(
        "range-bearing",
        variances(sigmas, 2, "range_sigma and bearing_sigma"),
        max_range=MAX_RANGE,
        field_of_view=FIELD_OF_VIEW,
        range_growth=growth,
        name=f"camera{log.robot}",
    )


def _counts(log: Log, seen: Sighted, robot: Robot) -> str:
    """What was read of a robot, and what was left out."""
    robots = np.isin(log.subject, ROBOTS).sum()
    unknown = (log.subject == UNKNOWN).sum()
    left = "".join(f"; {count} {reason}" for reason, count in seen.left_out.items())
    known = 0 if robot.truth is None else np.isfinite(robot.truth[:, 0]).sum()
    return (
        f"{log.name}: {len(log.commands)} commands and {len(log.time)} sightings read "
        f"({len(log.time) - robots - unknown} of landmarks, {robots} of robots, {unknown} of "
        f"unknown barcodes); {len(seen.time)} used{', left out' * bool(left)}{left[1:]}; "
        f"the truth is known of {known} of {len(robot.controls) + 1} poses"
    )
