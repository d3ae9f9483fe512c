"""A dataset as a g2o graph."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.models.sensors import Sensor
from ekfslam.storage import atomic_write


def write_g2o(dataset: Dataset, path: str | Path) -> None:
    """Write a dataset with known association as a g2o graph.

    ``VERTEX_SE2`` (dead-reckoned poses, numbered robot after robot), ``VERTEX_XY`` (landmarks
    back-projected from their first sighting; numbered after the poses, in order of identity),
    ``EDGE_SE2`` (increments), ``EDGE_SE2_XY`` and a ``FIX`` per robot.

    The conversion: g2o has no range-bearing edge that others read, so a measurement z becomes the
    point y(z) in the body frame, with noise ``D R D'``, D = dy/dz at the measurement; exact for xy
    sensors, first order for range and bearing. The information of a motion is that of
    its covariance in the frame of the first pose turned into that of the second, as g2o reads it.
    The priors are not written: the first pose of each robot is held fixed at its mean.

    Parameters
    ----------
    dataset : Dataset
    path : path

    Raises
    ------
    InputError
        If association is not known, or a noise is singular and has no information matrix.
    UnsupportedError
        If a sensor reports a bearing or a range alone, which makes no point, or robots see robots,
        for which there is no edge.
    """
    _check_sayable(dataset)
    o = dataset.observations
    deltas, covariances = (array[:, 1:] for array in dataset.moves)
    motions = _information(geo.additive_to_body(deltas, covariances), "odometry")
    poses = np.stack(
        [
            geo.integrate(robot.prior.mean, moves)
            for robot, moves in zip(dataset.robots, deltas, strict=True)
        ]
    )
    vertex = np.arange(poses.shape[0] * poses.shape[1]).reshape(poses.shape[:2])
    points, noises = _points(dataset)
    views = _information(noises, "observation")
    ids, first, number = np.unique(o.landmark, return_index=True, return_inverse=True)
    anchors = geo.from_frame(poses[o.robot[first], o.step[first]], points[first])
    lines = [
        f"VERTEX_SE2 {v} {_join(pose)}"
        for v, pose in zip(vertex.flat, poses.reshape(-1, 3), strict=True)
    ]
    lines += [
        f"VERTEX_XY {vertex.size + i} {_join(anchors[i])} # landmark {ids[i]}"
        for i in range(len(ids))
    ]
    upper = np.triu_indices(3)
    lines += [
        f"EDGE_SE2 {vertex[r, k]} {vertex[r, k + 1]} {_join(deltas[r, k])} "
        f"{_join(motions[r, k][upper])}"
        for r, k in np.ndindex(deltas.shape[:2])
    ]
    upper = np.triu_indices(2)
    lines += [
        f"EDGE_SE2_XY {v} {vertex.size + j} {_join(point)} {_join(view[upper])}"
        for v, j, point, view in zip(vertex[o.robot, o.step], number, points, views, strict=True)
    ]
    lines += [f"FIX {v}" for v in vertex[:, 0]]  # last: gtsam's reader stops there
    with atomic_write(path) as stream:
        stream.write(("\n".join(lines) + "\n").encode())


def _check_sayable(dataset: Dataset) -> None:
    """Refuse what g2o has no word for."""
    cannot = f"{dataset.name} cannot be written as g2o"
    if (dataset.observed_robot >= 0).any():
        raise UnsupportedError(f"{cannot}: robots see robots, and there is no edge for that")
    for index in np.unique(dataset.observations.sensor):
        sensor = dataset.sensors[index]
        if sensor.view.size == 1:
            raise UnsupportedError(f"{cannot}: a {sensor.kind} of {sensor.name} makes no point")
    if not dataset.association_known:
        raise InputError(f"{cannot}: association is not known")


def _points(dataset: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Measurements as points in the body frame (M, 2), with covariances (M, 2, 2)."""
    o, noise = dataset.observations, dataset.sightings.covariance
    points, covariances = np.empty((len(o), 2)), np.empty((len(o), 2, 2))
    for index, sensor in enumerate(dataset.sensors):
        rows = o.sensor == index
        if rows.any():
            points[rows], covariances[rows] = _in_body(sensor, o.values[rows], noise[rows])
    return points, covariances


def _in_body(
    sensor: Sensor, values: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    points, _, wrt_value = sensor.locate(np.zeros((len(values), 3)), values)
    return points, geo.congruence(wrt_value, noise)


def _information(covariances: np.ndarray, what: str) -> np.ndarray:
    """Inverse covariances, or an error that says what to do."""
    if covariances.size and np.linalg.eigvalsh(covariances)[..., 0].min() <= 1e-16:
        raise InputError(
            f"the {what} noise is singular and has no information matrix; state a lateral slip"
        )
    return np.linalg.inv(covariances)


def _join(values: np.ndarray) -> str:
    return " ".join(f"{value:.17g}" for value in np.asarray(values).tolist())
