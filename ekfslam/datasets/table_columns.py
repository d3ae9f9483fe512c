"""Datasets put into the tables of `ekfslam.datasets.tables`, without loss."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.datasets.table_rows import control_columns, noisy_columns
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import VIEWS
from ekfslam.robots import LandmarkMap, Prior

VALUES = tuple(dict.fromkeys(name for view in VIEWS.values() for name in view.names))


class Tables(NamedTuple):
    """A dataset as tables; ``from_tables(*tables[1:], **tables.header)`` is the dataset again.

    Attributes
    ----------
    header : dict
        Plain values, the keys of `ekfslam.from_tables` that are no tables.
    controls, observations : DataFrame
    truth, landmarks, known_map : DataFrame or None
        What the dataset has.
    """

    header: dict[str, Any]
    controls: pd.DataFrame
    observations: pd.DataFrame
    truth: pd.DataFrame | None
    landmarks: pd.DataFrame | None
    known_map: pd.DataFrame | None


def to_tables(dataset: Dataset) -> Tables:
    """A dataset as pandas DataFrames and a header, without loss.

    Parameters
    ----------
    dataset : Dataset

    Returns
    -------
    Tables

    Raises
    ------
    InputError
        For two robots or sensors of one name.
    """
    for what, many in (("robots", dataset.robots), ("sensors", dataset.sensors)):
        names = [one.name for one in many]
        if len(set(names)) < len(names):
            raise InputError(f"{what} need names of their own, got {', '.join(names)}")
    return Tables(
        _header(dataset),
        _controls(dataset),
        _observations(dataset),
        _truth(dataset),
        _map(dataset.true_map),
        _map(dataset.known_map),
    )


def _header(dataset: Dataset) -> dict[str, Any]:
    header: dict[str, Any] = {"name": dataset.name, "provenance": dataset.provenance}
    if dataset.seed is not None:
        header["seed"] = int(dataset.seed)
    if dataset.notes:
        header["notes"] = list(dataset.notes)
    header["start_time"] = float(dataset.times[0])
    robots = [
        {"name": r.name, "motion": _motion(r.saved.motion), "prior": _prior(r.prior)}
        for r in dataset.robots
    ]
    if len(robots) == 1 and robots[0]["name"] == "robot":
        header |= {key: robots[0][key] for key in ("motion", "prior")}
    else:
        header["robots"] = robots
    if dataset.sensors:
        header["sensors"] = [sensor.to_dict() for sensor in dataset.sensors]
    return header


def _motion(motion: MotionModel) -> dict[str, Any]:
    return {k: list(v) if isinstance(v, tuple) else v for k, v in motion.to_dict().items()}


def _prior(prior: Prior) -> dict[str, Any]:
    return {"mean": prior.mean.tolist(), "covariance": prior.covariance.tolist()}


def _controls(dataset: Dataset) -> pd.DataFrame:
    parts = []
    for robot in (robot.saved for robot in dataset.robots):
        steps = len(robot.controls)
        columns: dict[str, Any] = {"robot": [robot.name] * steps} if dataset.robots[1:] else {}
        columns |= {"step": np.arange(1, steps + 1), "time": dataset.times[1:]}
        columns |= dict(zip(control_columns(robot.motion), robot.controls.T, strict=True))
        if robot.covariance is not None:
            columns |= _noise(robot.covariance, noisy_columns(robot.motion))
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)


def _observations(dataset: Dataset) -> pd.DataFrame:
    o = dataset.observations
    columns: dict[str, Any] = {}
    if dataset.robots[1:]:
        columns["robot"] = [dataset.robots[robot].name for robot in o.robot]
    columns["step"] = o.step
    if o.time is not None:
        columns["time"] = o.time
    if len(dataset.sensors) > 1:
        columns["sensor"] = [dataset.sensors[sensor].name for sensor in o.sensor]
    columns["landmark"] = _identities(o.landmark)
    if o.observed_robot is not None:
        columns["observed_robot"] = [
            dataset.robots[robot].name if robot >= 0 else None for robot in o.observed_robot
        ]
    reported = dict.fromkeys(name for sensor in dataset.sensors for name in sensor.view.names)
    columns |= {name: np.full(len(o), np.nan) for name in VALUES if name in reported}
    for number, sensor in enumerate(dataset.sensors):
        rows, size = o.sensor == number, sensor.view.size
        for name, value in zip(sensor.view.names, o.values.T, strict=False):
            columns[name][rows] = value[rows]
        if o.covariance is not None:
            noise = o.covariance[rows]
            if noise[:, size:].any() or noise[:, :, size:].any():
                raise InputError(
                    f"{sensor.name} reports one number, but a covariance of its rows has two"
                )
            for name, entry in _noise(noise[:, :size, :size], sensor.view.names).items():
                columns.setdefault(name, np.full(len(o), np.nan))[rows] = entry
    if o.descriptor is not None:
        columns["descriptor"] = o.descriptor
    if dataset.true_landmark is not None:
        columns["true_landmark"] = _identities(dataset.true_landmark)
    return pd.DataFrame(columns)


def _identities(landmark: np.ndarray) -> Any:
    """Identities, blank where they are not known."""
    return pd.arrays.IntegerArray(landmark.copy(), landmark < 0)


def _noise(covariances: Array, names: tuple[str, ...]) -> dict[str, Array]:
    """Columns of covariances; entries that the others say are left out."""
    columns = {}
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            entry, above = covariances[:, i, j], covariances[:, j, i]
            if i == j or (i < j and (entry.any() or above.any())) or (entry != above).any():
                columns[f"cov_{a}_{b}"] = entry
    return columns


def _truth(dataset: Dataset) -> pd.DataFrame | None:
    parts = []
    for robot in dataset.robots:
        if robot.truth is not None:
            columns: dict[str, Any] = {"robot": robot.name} if dataset.robots[1:] else {}
            columns["step"] = np.arange(dataset.poses)
            columns |= dict(zip(("x", "y", "heading"), robot.truth.T, strict=True))
            parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True) if parts else None


def _map(landmarks: LandmarkMap | None) -> pd.DataFrame | None:
    if landmarks is None:
        return None
    x, y = landmarks.positions.T
    return pd.DataFrame({"id": landmarks.ids, "x": x, "y": y})
