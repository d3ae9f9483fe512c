"""Victoria Park as it came from the car (Guivant and Nebot 2001), the text release of 2003.

========================== ========================================================================
``DRS.txt``                time [s], speed of the left rear wheel [m/s], steering angle [rad];
                           every 25 ms
``GPS.txt``                time [s], north [m], east [m] of the first fix
``tree_observations.txt``  scan, time [s], range [m], bearing [rad], trunk diameter [m]: what the
                           tree finder that comes with the MATLAB release makes of the laser's scans
========================== ========================================================================

The clock of the tree observations is that of the MATLAB release, 20.967 s ahead of the text files.
Their bearing counts from the right, pi/2 is ahead. The steering of the two releases is calibrated
differently (text = 1.059 x MATLAB + 0.003 rad); the text's is taken: laid over the fixes of the
first 200 s, its dead reckoning is within 1.5 m (rms), the other one's within 9 m.

Poses
-----
There is a pose for each scan that has trees and falls into the span of the odometry, and it is the
pose of the laser, 3.78 m ahead of the rear axle and 0.50 m left: the antenna of the GPS is there,
too. No document says so, but the path of a point 3.9 m ahead and 0.6 m left of the axle fits the
fixes best (0.1 m and 0.05 m of standard error). x is east, y is north. Speed and steering hold
from their row to the next; the centre of the axle goes at ``v / (1 - tan(steering) H / L)`` along
an arc of curvature ``tan(steering) / L``, with H = 0.76 m from there to the wheel and L = 2.83 m
between the axles. Its increments are put together from scan to scan and taken to the point of the
laser.

Truth
-----
The GPS is the only one, of position alone: interpolated between fixes no farther apart than 0.5 s,
NaN elsewhere. It drops out under trees (gaps of up to 181 s, 15 stretches with fixes) and jumps, by
metres, between and within them: a smoothed path laid over it is off by 1.0 m (median), 4 m (one in
twenty). The first pose is that which lays the odometry of the first ten metres over the fixes; the
map of a smoother says that its heading is off by 0.02 rad.

Noise
-----
Smoothed by iSAM2 with the association of a filter, odometry errors are a walk of 0.02 m along, 0.03
to 0.04 m across and 0.005 to 0.006 rad per scan of 0.21 s; their mean, 0.01 m to the left and
0.0005 rad per scan, is left in. The default, 0.5 m/s and 0.08 rad in each row of 25 ms, taken as
independent, makes 0.04 m along and 0.006 rad at 3 m/s; a further 0.01 m, 0.02 m, 0.001 rad per step
stand for slip, and for a car that stands. Sightings of trees then spread by 0.10 m (robustly
0.06 m) and 0.005 rad (robustly 0.003 rad); 0.2 m and 0.015 rad are the default, since trunks are
seen from all sides and a scan takes time.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.datasets.car import LASER_AT, ROW, axle_moves, displaced, first_pose, fixed
from ekfslam.datasets.catalogue import RECORDED
from ekfslam.datasets.options import duration, finite, finite_number, positive, variances
from ekfslam.datasets.places import located, there
from ekfslam.datasets.text import Table, read_table, whole
from ekfslam.errors import FileFormatError, InputError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations
from ekfslam.robots import Prior, Robot

NAME = "victoria-park-raw"
TREES, LASER = "tree_observations.txt", "LASER.txt"
CLOCK = 20.967
CONTROL_SIGMAS = (0.5, 0.08)
SENSOR_SIGMAS = (0.2, 0.015)
STEP_SIGMAS = (0.01, 0.02, 0.001)
PRIOR_SIGMAS = (0.3, 0.3, 0.03)


class Files(NamedTuple):
    """The three tables."""

    odometry: Table
    fixes: Table
    trees: Table


def load(
    path: str | Path | None = None,
    step: float = 0.0,
    max_range: float = 30.0,
    max_diameter: float = 1.0,
    reference: Sequence[float] = LASER_AT,
    control_sigmas: Sequence[float] = CONTROL_SIGMAS,
    step_sigmas: Sequence[float] = STEP_SIGMAS,
    sensor_sigmas: Sequence[float] = SENSOR_SIGMAS,
    prior_sigmas: Sequence[float] = PRIOR_SIGMAS,
    clock: float = CLOCK,
) -> Dataset:
    """Load the run.

    Parameters
    ----------
    path : path, optional
        The folder of its files.
    step : float
        Least time between poses [s]: scans in between are left out. All scans by default.
    max_range, max_diameter : float
        Trees farther away or thicker [m] are left out.
    reference : (2,) sequence of float
        The point of the car whose pose is estimated, ahead of the rear axle and to the left [m];
        the laser by default. The truth is that of the GPS's antenna, which is there.
    control_sigmas : (2,) sequence of float
        Standard deviations of speed and steering in a row of the odometry [m/s, rad].
    step_sigmas : (3,) sequence of float
        Further ones per step, along, across and in heading [m, m, rad].
    sensor_sigmas : (2,) sequence of float
        Of range and bearing [m, rad].
    prior_sigmas : (3,) sequence of float
        Of the first pose [m, m, rad].
    clock : float
        What the clock of the tree observations is ahead [s].

    Returns
    -------
    Dataset
        One robot, association unknown, trunk diameters as descriptors, GPS as truth of the
        position.

    Raises
    ------
    FileFormatError
        For a missing or malformed file, with the line.
    InputError
        For an option that makes no sense.
    """
    duration(step, "step")
    positive(max_range, "max_range")
    positive(max_diameter, "max_diameter")
    at = finite(reference, 2, "reference")
    finite_number(clock, "clock")
    control_noise = variances(control_sigmas, 2, "control_sigmas")
    step_noise = variances(step_sigmas, 3, "step_sigmas")
    sensor_noise = variances(sensor_sigmas, 2, "sensor_sigmas")
    prior_noise = variances(prior_sigmas, 3, "prior_sigmas")
    odometry, fixes, trees = _read(path)
    start, end = odometry.values[0, 0], odometry.values[-1, 0] + ROW
    scanned = np.round(trees.values[:, 1] - clock, 6)
    scans = np.unique(scanned)
    times = thinned(scans[(scans >= start) & (scans <= end)], step)
    if not len(times):
        raise FileFormatError(
            f"{trees.path}: no scan falls into the time of {odometry.path.name}, {start:g} s to "
            f"{end:g} s, with a clock that is {clock:g} s ahead"
        )
    if len(times) < 2 <= len(scans) and step > 0:
        raise InputError(f"steps of {step:g} s leave one pose of {len(scans)} scans")
    moves = displaced(axle_moves(odometry.values, times, control_noise), at)
    covariances = moves.covariances + step_noise
    used = np.isin(scanned, times)
    near = (trees.values[:, 2] <= max_range) & (trees.values[:, 4] <= max_diameter)
    seen, seen_at = trees.values[used & near], scanned[used & near]
    truth = fixed(fixes.values[:, 0], fixes.values[:, [2, 1]], times)
    first = first_pose(moves.deltas, truth)
    if first is None:  # heading east from the first fix
        first = np.append(fixes.values[0, [2, 1]], 0.0)
    typical = covariances.mean(axis=0) if len(covariances) else step_noise
    robot = Robot(
        MotionModel("odometry", typical),  # every step has its own; this one is for show
        moves.deltas,
        Prior(first, prior_noise),
        truth if np.isfinite(truth).any() else None,
        "car",
        covariances,
    )
    return Dataset(
        name=NAME,
        robots=(robot,),
        times=times,
        sensors=(
            Sensor(
                "range-bearing",
                sensor_noise,
                mount=np.append(LASER_AT - at, 0.0),
                max_range=max_range,
                field_of_view=np.pi,
                name="laser",
            ),
        ),
        observations=Observations(
            step=np.searchsorted(times, seen_at),
            values=seen[:, 2:4] - [0.0, np.pi / 2],
            descriptor=seen[:, 4],
        ),
        provenance="Australian Centre for Field Robotics, University of Sydney; J. Guivant and "
        "E. Nebot, IEEE Trans. Robotics and Automation 17(3), 2001",
        notes=(
            f"Read: {len(odometry)} rows of odometry, {len(fixes)} fixes, {len(trees)} tree "
            f"observations in {len(scans)} scans; {len(scans) - len(times)} scans are before or "
            f"after the odometry or between steps, {(used & ~near).sum()} trees beyond "
            f"{max_range:g} m or thicker than {max_diameter:g} m.",
            "The truth is GPS, which drops out under trees and jumps by metres: position errors "
            "and NEES are also its own.",
        ),
    )


def thinned(times: Array, step: float) -> Array:
    """Those of increasing times that are at least a step after the one kept before."""
    kept: list[float] = []
    for time in times.tolist():
        if not kept or time >= kept[-1] + step:
            kept.append(time)
    return np.array(kept)


def _read(path: str | Path | None) -> Files:
    """The tables, after a look at what they hold."""
    folders = RECORDED[NAME].folders
    files = located(NAME, path, folders, ("DRS.txt", "GPS.txt"))
    detections = there(files["DRS.txt"], TREES)
    if detections is None:
        scans = there(files["DRS.txt"], LASER)
        besides = f"beside {scans.name} " if scans else ""
        raise FileFormatError(
            f"{files['DRS.txt'].parent} has no {TREES} (nor {TREES}.gz): {besides}there must be "
            f"the trees found in the scans, rows of scan, time [s, {CLOCK} s ahead], range [m], "
            "bearing [rad, 0 right, pi/2 ahead], diameter [m]"
        )
    odometry = read_table(files["DRS.txt"], ("time", "speed", "steering"), "%")
    fixes = read_table(files["GPS.txt"], ("time", "north", "east"), "%")
    trees = read_table(detections, ("scan", "time", "range", "bearing", "diameter"))
    for table in (odometry, fixes):
        late = np.diff(table.values[:, 0], prepend=-np.inf)
        table.refuse(late <= 0, "time does not increase")
    gaps = np.diff(odometry.values[:, 0], prepend=odometry.values[0, 0])
    odometry.refuse(gaps > 1.5 * ROW, f"rows are missing: they come every {1000 * ROW:g} ms")
    odometry.refuse(np.abs(odometry.values[:, 1]) > 50, "is the speed in metres per second?")
    odometry.refuse(np.abs(odometry.values[:, 2]) > 1.2, "is the steering angle in radians?")
    fixes.refuse(np.abs(fixes.values[:, 1:]).max(axis=1) > 1e4, "are north and east in metres?")
    number, time, distance, bearing, diameter = trees.values.T
    whole(trees, 0, "the scan")
    change, passed = np.diff(number, prepend=number[0]), np.diff(time, prepend=time[0])
    apart = (change < 0) | ((change > 0) & (passed <= 0)) | ((change == 0) & (passed != 0))
    trees.refuse(apart, "scan and time do not go on together, a time for each scan")
    trees.refuse((distance <= 0) | (distance > 100), "is the range in metres?")
    trees.refuse((bearing < -0.01) | (bearing > np.pi + 0.01), "is the bearing in radians?")
    trees.refuse((diameter < 0) | (diameter > 20), "is the diameter in metres?")
    return Files(odometry, fixes, trees)
