"""Records in formats that other programs read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.estimates import Trajectory
from ekfslam.models.sensors import Sensor
from ekfslam.storage import atomic_write


def write_g2o(dataset: Dataset, path: str | Path) -> None:
    """Write a dataset with known association as a g2o graph.

    ``VERTEX_SE2`` (dead-reckoned poses), ``VERTEX_XY`` (landmarks back-projected from their first
    sighting; numbered after the poses, in order of identity), ``FIX 0``, ``EDGE_SE2`` (increments)
    and ``EDGE_SE2_XY``.

    The conversion: g2o has no range-bearing edge that others read, so a measurement z becomes the
    point y(z) in the body frame, with noise ``D R D'``, D = dy/dz at the measurement; exact for xy
    sensors, first order for range and bearing. The information of a motion is that of
    its covariance in the frame of the first pose turned into that of the second, as g2o reads it.
    The prior is not written: the first pose is held fixed at its mean.

    Parameters
    ----------
    dataset : Dataset
    path : path

    Raises
    ------
    InputError
        If association is not known, or a noise is singular and has no information matrix.
    """
    if not dataset.association_known:
        raise InputError(f"{dataset.name} cannot be written as g2o: association is not known")
    deltas, covariances = dataset.robot.increments
    poses = geo.integrate(dataset.prior.mean, deltas)
    motion = _information(geo.additive_to_body(deltas, covariances), "odometry")
    points, noises = _points(dataset)
    views = _information(noises, "observation")
    ids, first, number = np.unique(
        dataset.observations.landmark, return_index=True, return_inverse=True
    )
    step = dataset.observations.step
    anchors = geo.from_frame(poses[step[first]], points[first])
    lines = [f"VERTEX_SE2 {k} {_join(pose)}" for k, pose in enumerate(poses)]
    lines += [
        f"VERTEX_XY {len(poses) + i} {_join(anchors[i])} # landmark {ids[i]}"
        for i in range(len(ids))
    ]
    upper = np.triu_indices(3)
    lines += [
        f"EDGE_SE2 {k} {k + 1} {_join(deltas[k])} {_join(motion[k][upper])}"
        for k in range(len(deltas))
    ]
    upper = np.triu_indices(2)
    lines += [
        f"EDGE_SE2_XY {k} {len(poses) + j} {_join(point)} {_join(view[upper])}"
        for k, j, point, view in zip(step, number, points, views, strict=True)
    ]
    lines.append("FIX 0")  # last: gtsam's reader stops at it
    with atomic_write(path) as stream:
        stream.write(("\n".join(lines) + "\n").encode())


def write_tum(trajectory: Trajectory, times: np.ndarray, path: str | Path) -> None:
    """Write a trajectory as TUM text for evo: ``t x y z qx qy qz qw``, planar.

    Parameters
    ----------
    trajectory : Trajectory
    times : (K + 1,) ndarray
        [s].
    path : path

    Raises
    ------
    InputError
        If there is not one time for each pose.
    """
    if len(times) != len(trajectory.poses):
        raise InputError(f"{len(times)} times for {len(trajectory.poses)} poses")
    x, y, theta = trajectory.poses.T
    zero = np.zeros_like(x)
    rows = np.column_stack([times, x, y, zero, zero, zero, np.sin(theta / 2), np.cos(theta / 2)])
    with atomic_write(path) as stream:
        np.savetxt(stream, rows, fmt="%.17g")


def _points(dataset: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Measurements as points in the body frame (M, 2), with covariances (M, 2, 2)."""
    o, noise = dataset.observations, dataset.sightings.covariance
    points, covariances = np.empty((len(o), 2)), np.empty((len(o), 2, 2))
    for index, sensor in enumerate(dataset.sensors):
        rows = o.sensor == index
        points[rows], covariances[rows] = _in_body(sensor, o.values[rows], noise[rows])
    return points, covariances


def _in_body(
    sensor: Sensor, values: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    points, _, wrt_value = sensor.locate(np.zeros((len(values), 3)), values)
    return points, geo.congruence(wrt_value, noise)


def _information(covariances: np.ndarray, what: str) -> np.ndarray:
    """Inverse covariances, or an error that says what to do."""
    if len(covariances) and np.linalg.eigvalsh(covariances)[:, 0].min() <= 1e-16:
        raise InputError(
            f"the {what} noise is singular and has no information matrix; state a lateral slip"
        )
    return np.linalg.inv(covariances)


def _join(values: np.ndarray) -> str:
    return " ".join(f"{value:.17g}" for value in np.asarray(values).tolist())
