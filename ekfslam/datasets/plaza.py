"""Plaza 1 and 2: a mower measures ranges to four radio beacons (Djugash, Hamner and Roth 2009).

The files ``Plaza1_.mat`` and ``Plaza2_.mat`` come inside the gtsam wheel. Their arrays: ``GT``
(time, x, y, heading: the truth), ``DR`` (time, distance and heading change since the row before;
row k ends at row k + 1 of GT), ``TD`` (time, sender, beacon, range) and ``TL`` (beacon, x, y).

What was measured on them, against the truth at the time of each range, and what is done about it
---------------------------------------------------------------------------------------------------
Ranges are 7 % too long: the line of least squares is 0.03 + 1.0694 r and 0.01 + 1.0696 r. They are
multiplied by `RANGE_SCALE`; what is left is white and Gaussian, 0.51 m and 0.53 m. The antenna is
where the truth is, to 5 cm, so the sensor has no mount.

Ranges have times of their own. Each is attached to the pose nearest in time and keeps its time;
interpolating the truth instead takes half a percent off its spread (0.540 m for 0.543 m in Plaza 1,
0.561 m for 0.566 m in Plaza 2). The log of Plaza 1 twice steps back, by 50 s and 64 s, and both
copies are good: ranges are sorted by time, and of two of one beacon with one stamp (twice), the
first is taken.

Odometry is an advance, then a turn: the lateral error per step is 0.0149 m then, 0.0153 m along an
arc and 0.0167 m with the turn first (0.0113, 0.0124, 0.0143 m in Plaza 2). Over 5 to 25 s its error
grows like a random walk of 0.02 m to 0.03 m per step along and across. The heading changes of
Plaza 1 are those of the truth; the gyro of Plaza 2 drifts by -5.37 mrad/s, which is taken out, and
leaves 0.0014 rad per step. `gyro_bias=0` keeps the drift: a filter whose noise has a mean of zero
is not consistent then, nor with ranges that are too long (`range_scale=1`).

The heading of the truth of Plaza 2 points backwards, and is turned. In both sets the course lies
to the right of the heading, by 0.018 rad and 0.01 rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.datasets.catalogue import files_of
from ekfslam.datasets.options import finite_number, positive, variances
from ekfslam.errors import FileFormatError, InputError
from ekfslam.geometry import Array
from ekfslam.mat5 import read_arrays, refuse
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations
from ekfslam.robots import LandmarkMap, Prior, Robot

RANGE_SCALE = 1 / 1.0695
ODOMETRY_SIGMAS = (0.02, 0.02, 0.002)
PRIOR_SIGMAS = (0.05, 0.05, 0.02)
COLUMNS = {"GT": 4, "DR": 3, "TD": 4, "TL": 3}
BEYOND = 1.0  # [s] that a range may be before the first pose, or after the last
LARGEST = (  # array, columns, and how large these may be in which unit
    ("GT", (1, 2), 1e4, "metres"),
    ("GT", (3,), 7.0, "radians"),
    ("DR", (1,), 100.0, "metres"),
    ("DR", (2,), 3.2, "radians"),
    ("TD", (3,), 1e3, "metres"),
    ("TL", (1, 2), 1e4, "metres"),
)


class Measured(NamedTuple):
    """What is particular to one of the sets: see the module's text."""

    heading: float  # to add to that of the truth
    gyro_bias: float
    range_sigma: float


MEASURED = {1: Measured(0.0, 0.0, 0.51), 2: Measured(np.pi, -5.37e-3, 0.53)}


def load(
    number: int,
    path: str | Path | None = None,
    range_scale: float = RANGE_SCALE,
    range_sigma: float | None = None,
    odometry_sigmas: Sequence[float] = ODOMETRY_SIGMAS,
    gyro_bias: float | None = None,
    prior_sigmas: Sequence[float] = PRIOR_SIGMAS,
) -> Dataset:
    """Load Plaza 1 or 2.

    Parameters
    ----------
    number : {1, 2}
    path : path, optional
        The file or its folder; by default the one in the gtsam wheel.
    range_scale : float
        Factor on the recorded ranges; 1 leaves them as they are.
    range_sigma : float, optional
        Standard deviation of a range [m]; as measured by default.
    odometry_sigmas : (3,) sequence of float
        Standard deviations per step along, across and in heading [m, m, rad].
    gyro_bias : float, optional
        Rate [rad/s] to take off the recorded heading changes; as measured by default.
    prior_sigmas : (3,) sequence of float
        Standard deviations of the first pose, whose mean is the true one [m, m, rad].

    Returns
    -------
    Dataset
        One robot with its truth, ranges of known beacons, and their surveyed map.

    Raises
    ------
    FileFormatError
        For a missing or malformed file; names the array.
    InputError
        For an option that makes no sense.
    """
    if number not in tuple(MEASURED):
        raise InputError(f"there are Plaza 1 and 2, not {number!r}")
    measured = MEASURED[number]
    drift = finite_number(measured.gyro_bias if gyro_bias is None else gyro_bias, "gyro_bias")
    sigma = positive(measured.range_sigma if range_sigma is None else range_sigma, "range_sigma")
    scale = positive(range_scale, "range_scale")
    along, across, turn = np.diag(variances(odometry_sigmas, 3, "odometry_sigmas"))
    prior_noise = variances(prior_sigmas, 3, "prior_sigmas")
    name = f"plaza{int(number)}"
    path = files_of(name, path)[f"Plaza{number}_.mat"]
    arrays = _read(path)
    times = arrays["GT"][:, 0]
    truth = arrays["GT"][:, 1:] + [0, 0, measured.heading]
    truth[:, 2] = geo.wrap(truth[:, 2])
    advance, change = arrays["DR"][:, 1:].T
    controls = np.column_stack([advance, change - drift * np.diff(times)])
    motion = MotionModel("advance-turn", np.diag([along, turn]), slip=np.sqrt(across))
    prior = Prior(truth[0], prior_noise)
    ranges = _by_time(arrays["TD"])
    beacons = arrays["TL"][:, 0].astype(np.int64)
    surveyed = LandmarkMap(beacons, arrays["TL"][:, 1:])
    seen = ranges[:, 2].astype(np.int64)
    return Dataset(
        name=name,
        robots=(Robot(motion, controls, prior, truth, "mower"),),
        times=times,
        sensors=(Sensor("range", np.array([[sigma**2]]), name="radio"),),
        observations=Observations(
            step=np.searchsorted(0.5 * (times[1:] + times[:-1]), ranges[:, 0]),
            values=scale * ranges[:, 3:],
            landmark=seen,
            time=ranges[:, 0],
        ),
        known_map=surveyed,
        true_map=surveyed,
        true_landmark=seen,
        provenance=f"{path.name} of the gtsam package; J. Djugash, B. Hamner and S. Roth, "
        "Journal of Field Robotics 26(9), 2009",
        notes=(
            f"Read: {len(truth)} poses, {len(arrays['TD'])} ranges of {len(beacons)} beacons; "
            f"{len(arrays['TD']) - len(ranges)} ranges repeat another's beacon and time.",
        ),
    )


def _by_time(ranges: Array) -> Array:
    """Ranges in the order of time; of one beacon, one at a time."""
    _, first = np.unique(ranges[:, [0, 2]], axis=0, return_index=True)
    return ranges[first]


def _read(path: Path) -> dict[str, Array]:
    """The arrays of a file, after a look at how they hang together."""
    arrays = read_arrays(path, {name: (None, columns) for name, columns in COLUMNS.items()})
    truth, odometry, ranges, beacons = arrays.values()
    if not len(truth):
        raise FileFormatError(f"{path}: GT is empty")
    refuse(path, "GT", np.diff(truth[:, 0], prepend=-np.inf) <= 0, "time does not increase")
    if len(odometry) != len(truth) - 1:
        raise FileFormatError(
            f"{path}: {len(truth)} rows of GT need one row of DR less, got {len(odometry)}"
        )
    apart = odometry[:, 0] != truth[1:, 0]
    refuse(path, "DR", apart, "time is not that of the next row of GT")
    outside = (ranges[:, 0] < truth[0, 0] - BEYOND) | (ranges[:, 0] > truth[-1, 0] + BEYOND)
    refuse(path, "TD", outside, "time is not within that of GT")
    refuse(path, "TD", ranges[:, 3] < 0, "negative range")
    for name, ids in (("TD", ranges[:, 2]), ("TL", beacons[:, 0])):
        bad = (ids != np.floor(ids)) | (ids < 0) | (ids > 2**53)
        refuse(path, name, bad, "beacon id that is not a whole number")
    if len(np.unique(beacons[:, 0])) < len(beacons):
        raise FileFormatError(f"{path}: TL has a beacon twice")
    refuse(path, "TD", ~np.isin(ranges[:, 2], beacons[:, 0]), "beacon that TL does not have")
    for name, columns, most, unit in LARGEST:
        largest = np.abs(arrays[name][:, columns]).max(axis=1)
        refuse(path, name, largest > most, f"is this in {unit}?")
    return arrays
