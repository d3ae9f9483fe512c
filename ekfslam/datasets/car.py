"""The car of the Australian Centre for Field Robotics: its measures, odometry and first pose.

A utility car with an encoder on the left rear wheel, a steering sensor, both every 25 ms, and a
laser at the left of the front bumper with the antenna of the GPS above it.
"""

from __future__ import annotations

import numpy as np

from ekfslam import geometry as geo
from ekfslam.datasets.resampling import composed, interpolated
from ekfslam.geometry import Array
from ekfslam.models.motion import Increments, MotionModel

WHEELBASE = 2.83
WHEEL_OFFSET = 0.76  # of the encoder from the centre of the axle, to the left
LASER_AT = (3.78, 0.50)  # ahead of the rear axle and left of its centre
ROW = 0.025  # [s] between rows of the odometry
LONGEST_GAP = 0.5  # [s] between fixes, to be bridged
FIRST_METRES = 10.0  # of the way, that the first pose is from


def axle_moves(rows: Array, times: Array, noise: Array) -> Increments:
    """Increments of the centre of the rear axle between times.

    Parameters
    ----------
    rows : (n, 3) ndarray
        Time [s], speed of the left rear wheel [m/s], steering [rad]; each holds until the next.
    times : (K + 1,) ndarray
        Increasing, none before the first row.
    noise : (2, 2) ndarray
        Of speed and steering in a row of 25 ms, independent of the next row's; over other times
        its density is the same.

    Returns
    -------
    Increments
        K of them.
    """
    inside = (rows[:, 0] > times[0]) & (rows[:, 0] < times[-1])
    grid = np.union1d(rows[inside, 0], times)
    held = rows[np.searchsorted(rows[:, 0], grid[:-1], side="right") - 1]
    speed, tangent = held[:, 1], np.tan(held[:, 2])
    slope = 1 + tangent**2
    share = WHEEL_OFFSET / WHEELBASE
    centre = speed / (1 - share * tangent)
    J = np.empty((len(held), 2, 2))
    J[:, 0, 0] = 1 / (1 - share * tangent)
    J[:, 0, 1] = share * slope * centre * J[:, 0, 0]
    J[:, 1, 0] = J[:, 0, 0] * tangent / WHEELBASE
    J[:, 1, 1] = (J[:, 0, 1] * tangent + centre * slope) / WHEELBASE
    lasting = np.diff(grid)
    covariances = geo.congruence(J, noise) * (ROW / lasting)[:, None, None]
    controls = np.column_stack([centre, centre * tangent / WHEELBASE, lasting])
    model = MotionModel("velocity", np.zeros((2, 2)))
    return composed(model.increments(controls, covariances), np.searchsorted(grid, times))


def displaced(moves: Increments, point: Array) -> Increments:
    """Increments of a point of the body instead of its origin.

    With m the point, a delta becomes ``m^-1 delta m``.

    Parameters
    ----------
    moves : Increments
    point : (2,) ndarray
        In the body frame [m].
    """
    mount = np.append(point, 0.0)
    J, _ = geo.compose_jacobians(moves.deltas, mount)
    deltas = geo.between(mount, geo.compose(moves.deltas, mount))
    return Increments(deltas, geo.congruence(J, moves.covariances))


def fixed(times: Array, positions: Array, at: Array) -> Array:
    """Poses (K + 1, 3) from fixes, which have no heading; NaN in gaps of over half a second.

    Parameters
    ----------
    times : (n,) ndarray
    positions : (n, 2) ndarray
    at : (K + 1,) ndarray
        Times wanted.
    """
    headless = np.column_stack([positions, np.full(len(positions), np.nan)])
    return interpolated(times, headless, at, LONGEST_GAP)


def first_pose(deltas: Array, truth: Array) -> Array | None:
    """Pose that lays the odometry of the first ten metres over what is known of the truth.

    None if that is less than two positions.
    """
    path = geo.integrate(np.zeros(3), deltas)
    way = np.cumsum(np.append(0.0, np.hypot(deltas[:, 0], deltas[:, 1])))
    first = (way <= FIRST_METRES) & np.isfinite(truth[:, 0])
    if first.sum() < 2:
        return None
    return geo.compose(geo.align(path[first, :2], truth[first, :2]), path[0])
