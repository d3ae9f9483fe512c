"""What contradicts what in the observations of a dataset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ekfslam.checks import is_covariance
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.sensors import Sensor
from ekfslam.observations import FARTHEST, NO_LANDMARK, Observations
from ekfslam.robots import Robot


def check_observations(
    o: Observations, times: Array, sensors: Sequence[Sensor], robots: Sequence[Robot]
) -> None:
    """Refuse observations that contradict each other, or what they are of.

    Parameters
    ----------
    o : Observations
    times : (K + 1,) ndarray
        Of the poses [s].
    sensors : sequence of Sensor
    robots : sequence of Robot

    Raises
    ------
    InputError
        Names the column and the row.
    """
    _check_range(o.step, len(times), "step", "pose")
    _check_range(o.sensor, len(sensors), "sensor", "sensor")
    _check_range(o.robot, len(robots), "robot", "robot")
    if o.observed_robot is not None:
        _check_range(o.observed_robot, len(robots), "observed_robot", "robot", -1)
        for name, bad in (
            ("the robot itself", o.observed_robot == o.robot),
            ("a robot and a landmark", (o.observed_robot >= 0) & (o.landmark >= 0)),
        ):
            if bad.any():
                raise InputError(f"observations show {name} in row {np.flatnonzero(bad)[0]}")
    below = np.flatnonzero(o.landmark < NO_LANDMARK)
    if len(below):
        raise InputError(
            f"observations.landmark is {o.landmark[below[0]]} in row {below[0]}; "
            f"{NO_LANDMARK} stands for an unknown identity"
        )
    back = np.flatnonzero(np.diff(o.step) < 0)
    if len(back):
        raise InputError(f"observations.step goes back at row {back[0] + 1}; sort by step")
    for index, sensor in enumerate(sensors):
        mine = o.sensor == index
        if sensor.view.size == 1 and o.values[mine, 1].any():
            raise InputError(
                f"{sensor.name} reports one number: the second column of "
                "observations.values must be 0 in its rows"
            )
        if sensor.view.names[0] == "range":
            negative = np.flatnonzero(mine & (o.values[:, 0] < _least_range(o, sensor)))
            if len(negative):
                raise InputError(
                    f"negative range {o.values[negative[0], 0]} in row {negative[0]} "
                    f"of the observations of {sensor.name}"
                )
    if o.covariance is not None:
        bad = np.flatnonzero(~is_covariance(o.covariance))
        if len(bad):
            raise InputError(
                f"observations.covariance of row {bad[0]} is not positive semi-definite"
            )
    _check_twice(o, times, sensors)


def _least_range(o: Observations, sensor: Sensor) -> float:
    """What noise can make of a short range; a range alone has no direction to be behind."""
    if sensor.view.size == 1:
        return 0.0
    variance = sensor.covariances(np.zeros((1, 2)))[0, 0, 0]
    if o.covariance is not None:
        variance = o.covariance[:, 0, 0].max(initial=variance)
    return -FARTHEST * float(np.sqrt(variance))


def _check_range(column: np.ndarray, count: int, name: str, what: str, least: int = 0) -> None:
    bad = np.flatnonzero((column < least) | (column >= count))
    if len(bad):
        there = f"there are {count} {what}s" + (f" (0 to {count - 1})" if count else "")
        raise InputError(f"observations.{name} is {column[bad[0]]} in row {bad[0]}, but {there}")


def _check_twice(o: Observations, times: Array, sensors: Sequence[Sensor]) -> None:
    """One sensor cannot see the same landmark twice at the same instant."""
    seen = np.full(len(o), -1) if o.observed_robot is None else o.observed_robot
    known = np.flatnonzero((o.landmark >= 0) | (seen >= 0))
    _, instant = np.unique(times[o.step] if o.time is None else o.time, return_inverse=True)
    key = np.column_stack([o.robot, o.sensor, o.landmark, seen, o.step, instant])[known]
    _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        row = known[first[np.flatnonzero(count > 1)[0]]]
        what = f"landmark {o.landmark[row]}"
        if seen[row] >= 0:
            what = f"robot {seen[row]}"
        raise InputError(
            f"{what} is observed twice at the same instant by sensor "
            f"{sensors[o.sensor[row]].name} (step {o.step[row]}, row {row})"
        )
