"""Datasets as tables, made from pandas DataFrames: the schema, in one place.

A dataset is a header and up to five tables. Rows are in order; columns that are not marked "needed"
may be left out, and their cells may be blank where it says so. Lengths are in m, angles in rad
(counter-clockwise), times in s.

``controls``, needed: one row for each motion
    ============ =================================================================================
    robot        its name; needed if there are several
    step         1, 2, ...: the pose that the motion leads to; rows in order by default
    time         of that pose [s], increasing; by default the sum of the ``dt``, or 1 s a step
    of the       needed: ``dx, dy, dtheta`` of kind ``odometry`` (increments in the frame of the
    motion       pose before), and of others as in `ekfslam.models.motion`: ``v, omega, dt`` of
                 ``velocity``, ``l, r`` of ``wheel-increments``, ``dx, dalpha`` of ``advance-turn``
    noise        of each row instead of that of the motion model, see below
    ============ =================================================================================

``observations``: one row for each sighting, steps not decreasing
    ============== ===============================================================================
    robot          whose sensor it is; needed if there are several
    step           the pose from which it was made: 0 is the first pose, before any motion
    time           of the sighting [s]. Without ``step``, that of its pose: to the last digit, or
                   within the header's ``time_tolerance`` of one pose alone
    sensor         its name; needed if there are several
    of the sensor  needed, blank in the rows of others: ``range, bearing`` or ``x, y``, or one of a
                   bearing and a range alone
    landmark       identity, a whole number from 0 on; blank where it is not known
    noise          of each row instead of the sensor's, blank where it is the sensor's; see below
    observed_robot name of a robot that is seen instead of a landmark; blank otherwise
    descriptor     a number such as a trunk diameter; blank where there is none
    true_landmark  true identity, for evaluation alone; blank for clutter
    ============== ===============================================================================

``truth``, for evaluation alone: ``robot``, ``step`` (or ``time``), ``x``, ``y``, ``heading``
    Poses in the world; blank, or without a row, where they are not known. Robots without a row have
    no truth.

``landmarks``, for evaluation alone, and ``known_map``, which estimators may use
    ``id``, ``x``, ``y``.

Noise of a row is ``sigma_a`` for a value ``a``, or entries ``cov_a_b`` of the covariance for
values ``a`` and ``b``: ``sigma_range``, ``cov_x_y``. Entries off the diagonal that are left out are
zero, those below it the ones above.

The header has the keys of `from_tables` that are no tables; in a folder of CSV files it is
``dataset.toml``, see `ekfslam.datasets.table_files`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.datasets.sheets import Sheet
from ekfslam.datasets.table_rows import Controls, Header, Told, landmark_map, sightings, truths
from ekfslam.documents import call, filled, motion_model
from ekfslam.errors import InputError
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.robots import Prior, Robot

MODELS = ("motion", "prior", "sensors", "robots")  # keys of the header that hold tables
TABLES = ("controls", "observations", "truth", "landmarks", "known_map")


def from_tables(
    controls: pd.DataFrame,
    observations: pd.DataFrame | None = None,
    truth: pd.DataFrame | None = None,
    landmarks: pd.DataFrame | None = None,
    known_map: pd.DataFrame | None = None,
    **header: Any,
) -> Dataset:
    """A dataset from pandas DataFrames, or anything that ``pandas.DataFrame`` takes.

    Parameters
    ----------
    controls, observations, truth, landmarks, known_map : DataFrame
        The tables of this module, which says their columns. Only `controls` is needed.
    motion : MotionModel or mapping
        How controls move the robot; needed for one robot. A mapping has the keys of `MotionModel`,
        such as ``{"kind": "odometry", "sigmas": [0.02, 0.02, "0.5 deg"]}``; two noisy controls
        then have a slip of 1 mm a step unless it says else.
    prior : Prior or mapping, optional
        What is known of the first pose: ``{"mean": [0, 0, 0], "sigmas": [0.1, 0.1, "2 deg"]}``.
        Exactly the origin by default.
    sensors : sequence of Sensor or mapping
        With names of their own: ``[{"kind": "range-bearing", "sigmas": [0.1, "1 deg"]}]``.
    robots : sequence of mapping
        Of several robots instead of `motion` and `prior`: ``name``, ``motion`` and ``prior`` of
        each.
    name : str
    start_time : float
        Of the first pose, before the first motion [s]; needed if the controls have a time, 0 by
        default if not.
    time_tolerance : float
        How far the time of a sighting, or of a true pose, without a ``step`` may be from that of
        its pose [s]. 0 by default.
    provenance, seed, notes
        As of `Dataset`.

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        For a column or key that has no meaning or is missing, or a cell that cannot be used; names
        table, row and column.
    """
    given = dict(zip(TABLES, (controls, observations, truth, landmarks, known_map), strict=True))
    sheets = {name: _sheet(name, table) for name, table in given.items() if table is not None}
    return dataset_of(sheets, header, "from_tables")


def _sheet(name: str, table: Any) -> Sheet:
    try:
        return Sheet(name, pd.DataFrame(table))
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is no table: {error}; for files, ekfslam.load(folder)") from None


def dataset_of(sheets: Mapping[str, Sheet], header: Mapping[str, Any], where: str) -> Dataset:
    """A dataset from its header and sheets by name; `where` is what errors call the header."""
    header = _plain(header)
    rest = {key: value for key, value in header.items() if key not in MODELS}
    told = filled(Header, rest, where, also=MODELS)
    robots, sensors = _robots(header, where), _sensors(header, where)
    moved = Controls.of(sheets["controls"], robots, told, where)
    names = [robot.name for robot in robots]
    known = truths(sheets.get("truth"), names, moved.times, told.time_tolerance)
    seen = sheets.get("observations", Sheet("observations", pd.DataFrame({"step": []})))
    observations, true_landmark = sightings(seen, names, sensors, moved.times, told)
    built = [
        call(Robot, where, r.motion, controls, r.prior, truth, r.name, covariance)
        for r, controls, covariance, truth in zip(
            robots, moved.controls, moved.covariances, known, strict=True
        )
    ]
    try:
        return Dataset(
            told.name,
            tuple(built),
            moved.times,
            sensors,
            observations,
            landmark_map(sheets.get("known_map")),
            landmark_map(sheets.get("landmarks")),
            true_landmark,
            told.provenance,
            told.seed,
            told.notes,
        )
    except InputError as error:  # what is left to refuse is about observations, by row
        said = re.sub(r"row (\d+)", lambda row: seen.place(int(row[1])), str(error))
        seen.refuse(said)


def _plain(value: Any) -> Any:
    """Python's tuples and NumPy's numbers as TOML would have them; models stay what they are."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value


# The header -------------------------------------------------------------------------------------


def _robots(header: Mapping[str, Any], where: str) -> list[Told]:
    if "robots" not in header:
        return [_robot(header, where)]
    if given := [key for key in ("motion", "prior") if key in header]:
        raise InputError(f"{where}: give either robots or {' and '.join(given)}, not both")
    listed = header["robots"]
    if not (isinstance(listed, list) and listed and all(isinstance(r, dict) for r in listed)):
        raise InputError(f"{where}: robots must be one table each, with name, motion and prior")
    robots = []
    for number, table in enumerate(listed, start=1):
        here = f"{where}: [[robots]] {number}"
        for key in table:
            if key not in ("name", "motion", "prior"):
                raise InputError(f"{here}: unknown key {key!r}; known: name, motion, prior")
        robots.append(_robot(table, here, table.get("name", f"robot-{number}")))
    return _named(robots, where, "robots")


def _robot(table: Mapping[str, Any], where: str, name: str = "robot") -> Told:
    if "motion" not in table:
        raise InputError(
            f"{where}: motion is missing, such as kind = 'odometry' with sigmas of dx, dy, dtheta"
        )
    motion, prior = table["motion"], table.get("prior", {})
    if not isinstance(motion, MotionModel):
        motion = motion_model(_table(motion, f"{where}: [motion]"), f"{where}: [motion]")
    if not isinstance(prior, Prior):
        prior = filled(Prior, _table(prior, f"{where}: [prior]"), f"{where}: [prior]")
    return Told(str(name), motion, prior)


def _sensors(header: Mapping[str, Any], where: str) -> tuple[Sensor, ...]:
    listed = header.get("sensors", [])
    listed = listed if isinstance(listed, list) else [listed]
    sensors = []
    for number, each in enumerate(listed, start=1):
        here = f"{where}: [[sensors]] {number}"
        sensors.append(
            each if isinstance(each, Sensor) else filled(Sensor, _table(each, here), here)
        )
    return tuple(_named(sensors, where, "sensors"))


def _table(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{where} must be a table of keys and values, got {value!r}")
    return value


def _named(many: list[Any], where: str, what: str) -> list[Any]:
    names = [one.name for one in many]
    if len(set(names)) < len(names):
        raise InputError(f"{where}: {what} need names of their own, got {', '.join(names)}")
    return many
