"""Landmarks of which one sighting does not say where they are (Solà, 2.3.5 and 2.3.6).

Inverse depth
    A bearing alone starts a landmark ``(x0, y0, alpha, rho)``: where the sensor was, in which
    direction it saw it, and one over the distance, which has a prior. Its point is
    ``(x0, y0) + (cos alpha, sin alpha) / rho`` (Eq. 48). Another sensor at s sees it along
    ``v = rho ((x0, y0) - s) + (cos alpha, sin alpha)`` (Eq. 51), linear in rho and harmless where
    rho passes through zero: the point then passes through infinity.

Fix
    Bearings or ranges from several places determine a point without a prior: see `fix`.
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
from ekfslam.models.sensors import BEARING, RANGE, Sensor

LINEAR = 0.1  # linearity index below which a landmark may become a point

# What `fix` asks for; its docstring says why.
MOST = 128  # sightings used
RIVAL = 13.8  # how much more any other minimum must cost: chi-square, two degrees, 0.999
SHARE = 0.25  # of the distance to the nearest sensor, for the worst standard deviation
GAUSSIAN = 2.0  # factor by which the cost may rise faster or slower than the covariance says

GRID = 72  # places tried along the circle of a range, or the ray of a bearing
ITERATIONS = 100
TINY = 1e-18  # instead of zero for a variance, or a distance squared


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


# Fix -------------------------------------------------------------------------------------------


@compiled
def _normal(kinds, frames, values, variances, x, y):  # type: ignore[no-untyped-def]
    """Whitened squared residuals at (x, y), their gradient halved, and J'J: c, gx, gy, a, b, d."""
    cost = gx = gy = xx = xy = yy = 0.0
    for i in range(len(kinds)):
        dx, dy = x - frames[i, 0], y - frames[i, 1]
        squared = max(dx * dx + dy * dy, TINY)
        if kinds[i] == RANGE:
            distance = math.sqrt(squared)
            error = values[i, 0] - distance
            jx, jy = dx / distance, dy / distance
        else:
            error = values[i, 0] + frames[i, 2] - math.atan2(dy, dx)
            error -= geo.TAU * math.floor(error / geo.TAU + 0.5)
            jx, jy = -dy / squared, dx / squared
        weight = 1.0 / max(variances[i], TINY)
        cost += weight * error * error
        gx += weight * jx * error
        gy += weight * jy * error
        xx += weight * jx * jx
        xy += weight * jx * jy
        yy += weight * jy * jy
    return cost, gx, gy, xx, xy, yy


@compiled
def _refined(kinds, frames, values, variances, x, y):  # type: ignore[no-untyped-def]
    """Minimum of the cost reached from (x, y) by damped Gauss-Newton steps: x, y, c, a, b, d."""
    cost, gx, gy, xx, xy, yy = _normal(kinds, frames, values, variances, x, y)
    damping = 1e-4
    for _ in range(ITERATIONS):
        a, d = xx + damping * (xx + yy), yy + damping * (xx + yy)
        determinant = a * d - xy * xy
        if not determinant > 0.0:
            break
        dx, dy = (d * gx - xy * gy) / determinant, (a * gy - xy * gx) / determinant
        trial = _normal(kinds, frames, values, variances, x + dx, y + dy)
        if not trial[0] <= cost:
            damping *= 10.0
            if damping > 1e8:
                break
            continue
        x, y, damping = x + dx, y + dy, 0.1 * damping
        cost, gx, gy, xx, xy, yy = trial
        # In standard deviations, and not small for being damped.
        if damping < 1.0 and xx * dx * dx + 2.0 * xy * dx * dy + yy * dy * dy < 1e-18:
            break
    return x, y, cost, xx, xy, yy


@compiled
def _places(kinds, frames, values, variances):  # type: ignore[no-untyped-def]
    """Where the landmark may be by one sighting alone, (g, 2), and whether the line is closed.

    The circle of the shortest range: on it, nothing changes faster than over the range itself, so
    the grid misses no minimum. Without a range, the ray of the last bearing, in steps that grow
    from a hundredth of the robot's way to a thousand times it.
    """
    shortest = -1
    for i in range(len(kinds)):
        if kinds[i] == RANGE and (shortest < 0 or values[i, 0] < values[shortest, 0]):
            shortest = i
    places = np.empty((GRID, 2))
    at = len(kinds) - 1 if shortest < 0 else shortest
    if shortest >= 0:
        radius = max(values[at, 0], math.sqrt(max(variances[at], TINY)))
        for k in range(GRID):
            angle = k * geo.TAU / GRID
            places[k, 0] = frames[at, 0] + radius * math.cos(angle)
            places[k, 1] = frames[at, 1] + radius * math.sin(angle)
        return places, True
    way = 0.0
    for i in range(len(kinds)):
        way = max(way, math.hypot(frames[i, 0] - frames[at, 0], frames[i, 1] - frames[at, 1]))
    angle = frames[at, 2] + values[at, 0]
    for k in range(GRID):
        distance = way * 10.0 ** (5.0 * k / (GRID - 1) - 2.0)
        places[k, 0] = frames[at, 0] + distance * math.cos(angle)
        places[k, 1] = frames[at, 1] + distance * math.sin(angle)
    return places, False


@compiled
def _minima(kinds, frames, values, variances):  # type: ignore[no-untyped-def]
    """All minima of the cost, rows (x, y, cost, information xx, xy, yy), and the least one."""
    places, closed = _places(kinds, frames, values, variances)
    costs = np.empty(GRID)
    for k in range(GRID):
        costs[k] = _normal(kinds, frames, values, variances, places[k, 0], places[k, 1])[0]
    minima = np.empty((GRID, 6))
    count = best = 0
    for k in range(GRID):
        before = costs[k - 1] if closed or k > 0 else math.inf
        after = costs[(k + 1) % GRID] if closed or k < GRID - 1 else -math.inf
        if costs[k] < before and costs[k] <= after:
            minima[count] = _refined(kinds, frames, values, variances, places[k, 0], places[k, 1])
            if minima[count, 2] < minima[best, 2]:
                best = count
            count += 1
    if closed and count > 0:
        # Along a noisy circle, a minimum and its mirror image can look like one.
        x, y = _mirrored(frames, minima[best, 0], minima[best, 1])
        minima[count] = _refined(kinds, frames, values, variances, x, y)
        if minima[count, 2] < minima[best, 2]:
            best = count
        count += 1
    return minima[:count], best


@compiled
def _mirrored(frames, x, y):  # type: ignore[no-untyped-def]
    """Mirror image of (x, y) in the straight line of best fit through the sensors."""
    mx, my = frames[:, 0].mean(), frames[:, 1].mean()
    xx = xy = yy = 0.0
    for i in range(len(frames)):
        dx, dy = frames[i, 0] - mx, frames[i, 1] - my
        xx += dx * dx
        xy += dx * dy
        yy += dy * dy
    twice = math.atan2(2.0 * xy, xx - yy)  # the angle of the line, doubled
    c, s = math.cos(twice), math.sin(twice)
    return mx + c * (x - mx) + s * (y - my), my + s * (x - mx) - c * (y - my)


@compiled
def _as_gaussian(kinds, frames, values, variances, x, y, xx, xy, yy, excess):  # type: ignore[no-untyped-def]
    """Whether the cost rises along the worst axis as the covariance (xx, xy, yy) says.

    It rises by the excess of the residuals faster.
    """
    cost = _normal(kinds, frames, values, variances, x, y)[0]
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    c, s = math.cos(angle), math.sin(angle)
    reach = 3.0 * math.sqrt(max(c * c * xx + 2.0 * c * s * xy + s * s * yy, 0.0))
    for side in (-reach, reach):
        there = _normal(kinds, frames, values, variances, x + side * c, y + side * s)
        if not 9.0 / GAUSSIAN < (there[0] - cost) / excess < 9.0 * GAUSSIAN:
            return False
    return True


@compiled
def fix(kinds, frames, values, variances):  # type: ignore[no-untyped-def]
    """Position of one landmark from bearings and ranges taken at several places.

    The least-squares optimum of the whitened residuals. One sighting leaves a line, the circle of
    a range or the ray of a bearing; every minimum of the cost along it starts damped Gauss-Newton
    steps, and so does the mirror image of the best one. The position is determined if a Gaussian
    describes what is known of it, so that a filter can go on from there:

    - It is the only one: every other minimum costs at least `RIVAL` more. Ranges along a straight
      path have a mirror image beyond it, and wait for the path to turn.
    - Three standard deviations along the worst axis cost between half and twice the 9 of a
      Gaussian. Without this, ranges with hardly any view from the side pass, of which one in ten
      is more than four standard deviations wrong.
    - The worst standard deviation is below `SHARE` of the distance to the nearest sensor, which
      keeps the next views, from wherever, near linear. So bearings wait for parallax: a point at
      infinity then costs some ``1 / SHARE^2`` more, and one behind a sensor more than that.

    Parameters
    ----------
    kinds : (n,) ndarray of int
        `BEARING` or `RANGE` of `ekfslam.models.sensors`, mixed as they come.
    frames : (n, 3) ndarray
        Poses of the sensors in the world, taken as exact.
    values : (n, 2) ndarray
        Bearing [rad] or range [m] in the first column.
    variances : (n,) ndarray
        Of the values.

    Returns
    -------
    determined : bool
        If not, the numbers are finite but mean nothing.
    x, y : float
        In the world [m].
    xx, xy, yy : float
        Covariance [m^2] by the noise of the values. Where the residuals are far larger than the
        noise explains (the poses drift, say), it is scaled to them, and so is `RIVAL`.

    Notes
    -----
    The work grows with n up to `MOST` sightings; of more, so many are taken, evenly spaced.
    """
    nothing = (False, 0.0, 0.0, 0.0, 0.0, 0.0)
    if len(kinds) < 2:
        return nothing
    used = min(len(kinds), MOST)
    keep = np.arange(used) * (len(kinds) - 1) // (used - 1)
    kinds, frames, values, variances = kinds[keep], frames[keep], values[keep], variances[keep]
    minima, best = _minima(kinds, frames, values, variances)
    if len(minima) == 0:
        return nothing
    x, y, cost, ixx, ixy, iyy = minima[best]  # with the information, the inverse covariance
    determinant = ixx * iyy - ixy * ixy
    if not determinant > 1e-12 * (ixx + iyy) ** 2:
        return nothing
    freedom = max(used - 2, 1)
    excess = cost / freedom if cost > freedom + 4.0 * math.sqrt(2.0 * freedom) else 1.0
    scale = excess / determinant
    xx, xy, yy = scale * iyy, -scale * ixy, scale * ixx
    rival = math.inf
    for k in range(len(minima)):
        dx, dy = minima[k, 0] - x, minima[k, 1] - y
        if ixx * dx * dx + 2.0 * ixy * dx * dy + iyy * dy * dy > 1e-4:
            rival = min(rival, minima[k, 2])
    nearest = np.hypot(frames[:, 0] - x, frames[:, 1] - y).min()
    worst = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
    determined = (
        rival - cost > RIVAL * excess
        and worst < (SHARE * nearest) ** 2
        and _as_gaussian(kinds, frames, values, variances, x, y, xx, xy, yy, excess)
    )
    return determined, x, y, xx, xy, yy
