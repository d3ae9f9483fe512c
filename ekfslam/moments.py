"""A run at a moment: what has happened so far, and what is seen, as lines to draw."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations

_TURN = np.linspace(0.0, geo.TAU, 64)


def until(dataset: Dataset, step: int) -> Dataset:
    """The run as far as one step, as if the robot had stopped there.

    What an estimator says of it is what it knows at that step, whatever estimator it is.

    Parameters
    ----------
    dataset : Dataset
    step : int
        The last one that is kept, from 0 on.

    Raises
    ------
    InputError
        If there is no such step.
    """
    if not 0 <= step < dataset.poses:
        raise InputError(f"there is no step {step}: {dataset.name} has 0 to {dataset.poses - 1}")
    rows = slice(int(dataset.offsets[step + 1]))

    def cut(array: Any, kept: slice) -> Any:
        return None if array is None else array[kept]

    columns = [field.name for field in fields(Observations)]
    observed = {name: cut(getattr(dataset.observations, name), rows) for name in columns}
    moved, passed = slice(step), slice(step + 1)
    robots = [
        replace(
            robot,
            controls=robot.controls[moved],
            covariance=cut(robot.covariance, moved),
            truth=cut(robot.truth, passed),
        )
        for robot in dataset.robots
    ]
    return replace(
        dataset,
        robots=tuple(robots),
        times=dataset.times[passed],
        observations=replace(dataset.observations, **observed),
        true_landmark=cut(dataset.true_landmark, rows),
    )


def sight_lines(dataset: Dataset, step: int, poses: Array, far: float) -> list[Array]:
    """What is seen at a step as lines in the world, as measured from given poses.

    A range and a bearing, or a relative position, is a line from the sensor to the point; a bearing
    alone is a ray, as long as the sensor sees; a range alone is a circle.

    Parameters
    ----------
    dataset : Dataset
    step : int
    poses : (R, 3) array_like
        Of the robots at that step.
    far : float
        Length of a ray where nothing limits it [m].

    Returns
    -------
    list of (n, 2) ndarray
        A line for each observation, in their order.
    """
    o, poses = dataset.observations, np.asarray(poses, dtype=float)
    rows = range(*dataset.offsets[step : step + 2].tolist())
    return [
        _line(dataset.sensors[o.sensor[row]], poses[o.robot[row]], o.values[row], far)
        for row in rows
    ]


def _line(sensor: Sensor, pose: Array, value: Array, far: float) -> Array:
    origin = geo.compose(pose, sensor.mount)
    if sensor.view.size == 2:
        end = sensor.locate(pose, value)[0]
    elif sensor.view.names == ("range",):
        circle = value[0] * np.column_stack([np.cos(_TURN), np.sin(_TURN)])
        return origin[:2] + circle
    else:
        length = min(sensor.max_range, far)
        end = geo.from_frame(origin, length * np.array([np.cos(value[0]), np.sin(value[0])]))
    return np.stack([origin[:2], end])
