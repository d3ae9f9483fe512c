"""Trajectories as TUM text, which evo reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ekfslam.errors import InputError
from ekfslam.estimates import Trajectory
from ekfslam.storage import atomic_write


def write_tum(
    trajectory: Trajectory, times: np.ndarray, path: str | Path, robot: int | None = None
) -> None:
    """Write the trajectory of one robot as TUM text for evo: ``t x y z qx qy qz qw``, planar.

    Parameters
    ----------
    trajectory : Trajectory
    times : (K + 1,) ndarray
        [s].
    path : path
    robot : int, optional
        Whose poses, where there are several robots; each has a file of its own.

    Raises
    ------
    InputError
        If there is not one time for each pose, or several robots and no such one among them.
    """
    count = 1 if trajectory.poses.ndim == 2 else len(trajectory.poses)
    if robot is None and count > 1:
        raise InputError(f"a file holds one robot of {count}; say which by `robot`")
    if robot is not None and not 0 <= robot < count:
        raise InputError(f"robot is {robot}, but there are {count} (0 to {count - 1})")
    poses = trajectory.of_robot(robot or 0).poses
    if len(times) != len(poses):
        raise InputError(f"{len(times)} times for {len(poses)} poses")
    x, y, theta = poses.T
    zero = np.zeros_like(x)
    rows = np.column_stack([times, x, y, zero, zero, zero, np.sin(theta / 2), np.cos(theta / 2)])
    with atomic_write(path) as stream:
        np.savetxt(stream, rows, fmt="%.17g")
