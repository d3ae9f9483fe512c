"""Landmarks of which one sighting does not say where they are (Solà, 2.3.5 and 2.3.6).

Inverse depth
    A bearing alone starts a landmark ``(x0, y0, alpha, rho)``: where the sensor was, in which
    direction it saw it, and one over the distance, which has a prior. Its point is
    ``(x0, y0) + (cos alpha, sin alpha) / rho`` (Eq. 48). Another sensor at s sees it along
    ``v = rho ((x0, y0) - s) + (cos alpha, sin alpha)`` (Eq. 51), linear in rho and harmless where
    rho passes through zero: the point then passes through infinity.

Bearings or ranges from several places determine a point without a prior: see
`ekfslam.models.fix`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ekfslam import geometry as geo
from ekfslam.checks import checked_number
from ekfslam.compiled import compiled
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.geometry import Array
from ekfslam.models.sensors import BEARING, Sensor

LINEAR = 0.1  # linearity index below which a landmark may become a point


# Inverse depth ---------------------------------------------------------------------------------


def to_point(landmarks: Any) -> tuple[Array, Array]:
    """Points of inverse-depth landmarks (Solà, Eq. 48), with the Jacobian.

    Parameters
    ----------
    landmarks : (..., 4) array_like
        (x0, y0, alpha, rho) [m, m, rad, 1/m].

    Returns
    -------
    points : (..., 2) ndarray
        In the world [m].
    wrt_landmark : (..., 2, 4) ndarray

    Raises
    ------
    InputError
        For a rho that is not positive: the landmark is at infinity, or behind its sensor.
    """
    landmarks = np.asarray(landmarks, dtype=float)
    rho = landmarks[..., 3:]
    if not (rho > 0).all():
        raise InputError(f"only a positive inverse depth has a point, got {rho.min()}")
    direction = _direction(landmarks)
    jacobian = np.zeros((*landmarks.shape[:-1], 2, 4))
    jacobian[..., 0, 0] = jacobian[..., 1, 1] = 1.0
    jacobian[..., 2] = geo.perpendicular(direction) / rho
    jacobian[..., 3] = -direction / rho**2
    return landmarks[..., :2] + direction / rho, jacobian


def _direction(landmarks: Array) -> Array:
    return np.stack([np.cos(landmarks[..., 2]), np.sin(landmarks[..., 2])], axis=-1)


def observe_inverse_depth(sensor: Sensor, poses: Any, landmarks: Any) -> tuple[Array, Array, Array]:
    """Direct model of inverse-depth landmarks (Solà, Eqs. 50 to 52), with Jacobians.

    A bearing is that of the scaled v of Eq. 51, by the arctangent of two arguments: Eq. 52 as
    printed jumps by pi. What reports a range goes through the point.

    Parameters
    ----------
    sensor : Sensor
    poses : (..., 3) array_like
        Robot poses in the world.
    landmarks : (..., 4) array_like
        (x0, y0, alpha, rho) [m, m, rad, 1/m].

    Returns
    -------
    values : (..., d) ndarray
    wrt_pose : (..., d, 3) ndarray
    wrt_landmark : (..., d, 4) ndarray

    Raises
    ------
    InputError
        If the sensor reports more than a bearing, and a rho is not positive.
    """
    poses, landmarks = np.asarray(poses, dtype=float), np.asarray(landmarks, dtype=float)
    if sensor.view.code != BEARING:
        points, point_wrt_landmark = to_point(landmarks)
        values, wrt_pose, wrt_point = sensor.observe(poses, points)
        return values, wrt_pose, wrt_point @ point_wrt_landmark
    frame = geo.compose(poses, sensor.mount)
    frame_wrt_pose, _ = geo.compose_jacobians(poses, sensor.mount)
    rho, direction = landmarks[..., 3:], _direction(landmarks)
    start = landmarks[..., :2] - frame[..., :2]
    v = rho * start + direction
    bearing = geo.wrap(np.arctan2(v[..., 1], v[..., 0]) - frame[..., 2])
    gradient = geo.perpendicular(v) / np.sum(v * v, axis=-1, keepdims=True)
    scaled = gradient * rho
    wrt_frame = np.concatenate([-scaled, np.full_like(rho, -1.0)], axis=-1)
    along = [
        np.sum(gradient * other, axis=-1, keepdims=True)
        for other in (geo.perpendicular(direction), start)
    ]
    wrt_landmark = np.concatenate([scaled, *along], axis=-1)
    return (
        bearing[..., None],
        wrt_frame[..., None, :] @ frame_wrt_pose,
        wrt_landmark[..., None, :],
    )


def inverse_depth(
    sensor: Sensor, poses: Any, values: Any, rho: Any
) -> tuple[Array, Array, Array, Array]:
    """Inverse model g(R, S, y, s) of a bearing, with the prior s = rho (Solà, Eqs. 39 and 53).

    Parameters
    ----------
    sensor : Sensor
        Of kind bearing.
    poses : (..., 3) array_like
        Robot poses in the world.
    values : (..., 1) array_like
        Bearings [rad].
    rho : (...) array_like
        Inverse depth, of the prior [1/m]; see `depth_prior`.

    Returns
    -------
    landmarks : (..., 4) ndarray
        (x0, y0, alpha, rho) [m, m, rad, 1/m].
    wrt_pose : (..., 4, 3) ndarray
    wrt_value : (..., 4, 1) ndarray
    wrt_prior : (..., 4, 1) ndarray

    Raises
    ------
    UnsupportedError
        For a sensor of another kind.
    """
    if sensor.view.code != BEARING:
        raise UnsupportedError(
            f"inverse depth starts from a bearing; {sensor.name} is {sensor.kind}"
        )
    poses, values = np.asarray(poses, dtype=float), np.asarray(values, dtype=float)
    frame = geo.compose(poses, sensor.mount)
    frame_wrt_pose, _ = geo.compose_jacobians(poses, sensor.mount)
    alpha = geo.wrap(frame[..., 2:] + values)
    shape = alpha.shape[:-1]
    rho = np.broadcast_to(np.asarray(rho, dtype=float), shape)
    wrt_pose = np.zeros((*shape, 4, 3))
    wrt_pose[..., :3, :] = frame_wrt_pose
    columns = np.broadcast_to(np.eye(4), (*shape, 4, 4))
    position = np.broadcast_to(frame[..., :2], (*shape, 2))
    landmarks = np.concatenate([position, alpha, rho[..., None]], axis=-1)
    return landmarks, wrt_pose, columns[..., 2:3], columns[..., 3:]


def depth_prior(min_range: float) -> tuple[float, float]:
    """Prior of the inverse depth for distances from `min_range` to infinity (Solà, Eq. 47).

    Mean ``1 / (2 min_range)`` and standard deviation ``1 / (4 min_range)``: two standard
    deviations reach from 0 to ``1 / min_range``.

    Parameters
    ----------
    min_range : float
        Least distance [m] at which the sensor sees a point.

    Returns
    -------
    mean, variance : float
        [1/m, 1/m^2]

    Raises
    ------
    InputError
        If it is not positive and finite.
    """
    if not 0 < checked_number(min_range, "min_range") < math.inf:
        raise InputError(
            f"inverse depth needs a least distance, got {min_range}: state the sensor's min_range"
        )
    mean = 0.5 / min_range
    return mean, (0.5 * mean) ** 2


@compiled
def linearity(x0, y0, alpha, rho, variance, x, y):  # type: ignore[no-untyped-def]
    """Linearity index L_d of an inverse-depth landmark (Civera, Davison and Montiel 2008).

    ``L_d = 4 sigma_d / d_1 |cos a|`` with ``sigma_d = sigma_rho / rho^2``, d_1 the distance from
    the sensor to the point, and a the parallax between the present and the first line of sight.
    It is small where a bearing is as good as linear in the distance; below `LINEAR`, their
    threshold, the landmark may become a point (`to_point`).

    Parameters
    ----------
    x0, y0, alpha, rho : float
        The landmark [m, m, rad, 1/m].
    variance : float
        Of rho.
    x, y : float
        Where the sensor is now, in the world [m].

    Returns
    -------
    float
        Infinite where rho is not positive, or the sensor is at the point.
    """
    if rho <= 0.0:
        return math.inf
    c, s = math.cos(alpha), math.sin(alpha)
    dx, dy = x0 + c / rho - x, y0 + s / rho - y
    squared = dx * dx + dy * dy
    if squared == 0.0:
        return math.inf
    return 4.0 * math.sqrt(variance) / (rho * rho) * abs(c * dx + s * dy) / squared
