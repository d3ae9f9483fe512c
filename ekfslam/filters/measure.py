"""Compiled direct and inverse models, for points, inverse depths and other robots.

The same models in vectorised form, which the tests compare with, are `ekfslam.models.sensors` and
`ekfslam.models.landmarks`.
"""

from __future__ import annotations

import math

from ekfslam.compiled import lean
from ekfslam.filters.kernels import wrap
from ekfslam.models.sensors import BEARING, RANGE, RANGE_BEARING

POSE, POINT, INVERSE_DEPTH = 3, 2, 4  # coordinates in the state
BANKED = -1  # stands for the size of a landmark that is still a bank of hypotheses


@lean
def rows_of(kind):  # type: ignore[no-untyped-def]
    """How many numbers a sighting of a kind reports."""
    return 1 if kind in (BEARING, RANGE) else 2


@lean
def placed(mount, pose):  # type: ignore[no-untyped-def]
    """Where a sensor is: x, y, cosine and sine of its heading, and its lever on the robot (x, y).

    The same for all that is seen in a look, of which there may be much.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    lever_x, lever_y = c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]
    if mount[2] != 0.0:
        c, s = math.cos(pose[2] + mount[2]), math.sin(pose[2] + mount[2])
    return pose[0] + lever_x, pose[1] + lever_y, c, s, lever_x, lever_y


@lean
def expect(kind, size, sensor, target, expected, H):  # type: ignore[no-untyped-def]
    """Direct model with Jacobian (Solà, Eqs. 24 and 25), by the chain rule over three frames.

    Parameters
    ----------
    kind : int
        Code of the view.
    size : int
        Coordinates of the target: 2 of a point, 4 of an inverse depth (x0, y0, alpha, rho), 3 of a
        robot's pose, of which the position is seen.
    sensor : tuple
        Of `placed`.
    target : (size,) ndarray
    expected : (2,) ndarray
        Written: h(pose, target), as many numbers as the view reports.
    H : (2, 7) ndarray
        Written: derivative with respect to (x, y, theta) and the target, up to column 3 + size.

    Returns
    -------
    bool
        False for a target without a place that the view could see: an inverse depth of which the
        distance is asked and which is not positive.
    """
    sensor_x, sensor_y, ca, sa, lever_x, lever_y = sensor
    x, y = target[0] - sensor_x, target[1] - sensor_y
    scale, along_x, along_y, inverse = 1.0, 0.0, 0.0, 1.0
    if size == INVERSE_DEPTH:
        along_x, along_y = math.cos(target[2]), math.sin(target[2])
        if kind == BEARING:  # of v = rho (p0 - s) + (cos, sin): linear in rho (Solà, Eq. 51)
            scale = target[3]
        elif target[3] <= 0.0:
            return False
        else:
            inverse = 1.0 / target[3]
    vx, vy = scale * x + inverse * along_x, scale * y + inverse * along_y
    u, w = ca * vx + sa * vy, ca * vy - sa * vx  # in the sensor
    r2 = u * u + w * w
    r = math.sqrt(r2)
    d00, d01, d10, d11 = 1.0, 0.0, 0.0, 1.0
    if kind == RANGE_BEARING:
        expected[0], expected[1] = r, math.atan2(w, u)
        d00, d01, d10, d11 = u / r, w / r, -w / r2, u / r2
    elif kind == BEARING:
        expected[0] = math.atan2(w, u)
        d00, d01 = -w / r2, u / r2
    elif kind == RANGE:
        expected[0] = r
        d00, d01 = u / r, w / r
    else:
        expected[0], expected[1] = u, w
    for a in range(rows_of(kind)):
        d0, d1 = (d00, d01) if a == 0 else (d10, d11)
        mx, my = d0 * ca - d1 * sa, d0 * sa + d1 * ca  # with respect to v
        row = H[a]
        row[0], row[1] = -scale * mx, -scale * my
        # The heading swings the sensor about the robot, and turns its frame.
        row[2] = scale * (mx * lever_y - my * lever_x) + d0 * w - d1 * u
        row[3], row[4] = scale * mx, scale * my
        if size == POSE:
            row[5] = 0.0
        elif size == INVERSE_DEPTH:
            row[5] = inverse * (my * along_x - mx * along_y)
            if kind == BEARING:
                row[6] = mx * x + my * y
            else:
                row[6] = -inverse * inverse * (mx * along_x + my * along_y)
    return True


@lean
def innovate(kind, value, expected, innovation):  # type: ignore[no-untyped-def]
    """Innovation ``value - expected``, the bearing wrapped (Solà, Eq. 26)."""
    innovation[0] = value[0] - expected[0]
    if kind == BEARING:
        innovation[0] = wrap(innovation[0])
        return
    if kind == RANGE:
        return
    innovation[1] = value[1] - expected[1]
    if kind == RANGE_BEARING:
        innovation[1] = wrap(innovation[1])


@lean
def along_the_ray(kind, sensor, target, value, point):  # type: ignore[no-untyped-def]
    """Where to linearise a sighting of an inverse depth that tells its range: at that range.

    A prior on rho holds distances that differ by far more than a range is linear over; where the
    range is measured, there is no need to linearise anywhere else along the ray. A full view tells
    the point of the ray that is next to what it saw; a range alone, of the two points that are so
    far away, the one nearer to the estimate.

    Parameters
    ----------
    kind, value
        The observation, of a view that reports a range or x and y.
    sensor : tuple
        Of `placed`.
    target : (4,) ndarray
        The inverse depth.
    point : (4,) ndarray
        Written: the same ray, with another rho.
    """
    x, y = sensor[0] - target[0], sensor[1] - target[1]  # of the sensor, from the ray's origin
    ca, sa = math.cos(target[2]), math.sin(target[2])
    distance = x * ca + y * sa
    if kind == RANGE:
        aside = distance * distance - x * x - y * y + value[0] * value[0]
        half = math.sqrt(max(aside, 0.0))
        near, far = distance - half, distance + half
        guess = 1.0 / target[3] if target[3] > 0.0 else far
        distance = near if near > 0.0 and abs(near - guess) < abs(far - guess) else far
    else:
        ahead, left = value[0], value[1]
        if kind == RANGE_BEARING:
            ahead, left = value[0] * math.cos(value[1]), value[0] * math.sin(value[1])
        c, s = sensor[2], sensor[3]  # the point seen, along the ray
        distance += (c * ahead - s * left) * ca + (s * ahead + c * left) * sa
    for c in range(3):
        point[c] = target[c]
    point[3] = 1.0 / max(distance, 1e-3)


@lean
def foresee(kind, size, sensor, target, value, point, H, innovation):  # type: ignore[no-untyped-def]
    """Innovation of a sighting, and the Jacobian and point that it is linearised at.

    Parameters
    ----------
    kind, size, sensor, target
        As for `expect`.
    value : (2,) ndarray
    point : (>= size,) ndarray
        Written: the target where it is linearised; elsewhere only `along_the_ray`.
    H : (2, 7) ndarray
        Written.
    innovation : (2,) ndarray
        Written: value minus what is expected at the point.

    Returns
    -------
    bool
        As `expect`.
    """
    for c in range(size):
        point[c] = target[c]
    if size == INVERSE_DEPTH and kind != BEARING:
        along_the_ray(kind, sensor, target, value, point)
    if not expect(kind, size, sensor, point[:size], innovation, H):
        return False
    innovate(kind, value, innovation, innovation)
    return True


@lean
def moved(innovation, H, target, point, size, a):  # type: ignore[no-untyped-def]
    """Row a of an innovation, moved from the point of linearisation to the target."""
    total = innovation[a]
    for c in range(size):
        total -= H[a, 3 + c] * (target[c] - point[c])
    return total


@lean
def locate(kind, mount, pose, value, R, landmark, G, noise):  # type: ignore[no-untyped-def]
    """Inverse model of a full view with Jacobian and mapped noise (Solà, Eqs. 32 to 35).

    A partial view that a prior completes to range and bearing is such a view, too.

    Parameters
    ----------
    kind, mount, pose
        As for `expect`.
    value : (2,) ndarray
        Measurement.
    R : (2, 2) ndarray
        Its noise.
    landmark : (>= 2,) ndarray
        Written: g(pose, value).
    G : (>= 2, 3) ndarray
        Written: derivative with respect to the pose.
    noise : (>= 2, >= 2) ndarray
        Written: the mapped noise ``G_y R G_y'``.
    """
    if kind == RANGE_BEARING:
        cb, sb = math.cos(value[1]), math.sin(value[1])
        x, y = value[0] * cb, value[0] * sb
        d00, d01, d10, d11 = cb, -y, sb, x
    else:
        x, y = value[0], value[1]
        d00, d01, d10, d11 = 1.0, 0.0, 0.0, 1.0
    cm, sm = math.cos(mount[2]), math.sin(mount[2])
    bx, by = mount[0] + cm * x - sm * y, mount[1] + sm * x + cm * y
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = c * bx - s * by, s * bx + c * by
    landmark[0], landmark[1] = pose[0] + dx, pose[1] + dy
    G[0, 0], G[0, 1], G[0, 2] = 1.0, 0.0, -dy
    G[1, 0], G[1, 1], G[1, 2] = 0.0, 1.0, dx
    ca, sa = c * cm - s * sm, s * cm + c * sm
    g00, g01 = ca * d00 - sa * d10, ca * d01 - sa * d11
    g10, g11 = sa * d00 + ca * d10, sa * d01 + ca * d11
    a0, a1 = g00 * R[0, 0] + g01 * R[1, 0], g00 * R[0, 1] + g01 * R[1, 1]
    b0, b1 = g10 * R[0, 0] + g11 * R[1, 0], g10 * R[0, 1] + g11 * R[1, 1]
    noise[0, 0], noise[1, 1] = a0 * g00 + a1 * g01, b0 * g10 + b1 * g11
    noise[0, 1] = noise[1, 0] = a0 * g10 + a1 * g11


@lean
def locate_direction(mount, pose, bearing, variance, rho, S, landmark, G, noise):  # type: ignore[no-untyped-def]
    """Inverse model of a bearing with a prior on the inverse depth (Solà, Eqs. 39 to 44 and 53).

    Parameters
    ----------
    mount, pose : (3,) ndarray
    bearing, variance : float
        Measurement and its noise.
    rho, S : float
        Mean and variance of the prior on the inverse depth.
    landmark : (4,) ndarray
        Written: (x0, y0, alpha, rho), the origin being the sensor's position.
    G : (4, 3) ndarray
        Written: derivative with respect to the pose.
    noise : (4, 4) ndarray
        Written: ``G_y R G_y' + G_s S G_s'``.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]
    landmark[0], landmark[1] = pose[0] + dx, pose[1] + dy
    landmark[2], landmark[3] = wrap(pose[2] + mount[2] + bearing), rho
    G[:] = 0.0
    G[0, 0], G[0, 2] = 1.0, -dy
    G[1, 1], G[1, 2] = 1.0, dx
    G[2, 2] = 1.0
    noise[:] = 0.0
    noise[2, 2], noise[3, 3] = variance, S


@lean
def point_of(landmark, point, J):  # type: ignore[no-untyped-def]
    """Point of an inverse depth with its derivative (Solà, Eq. 48).

    Parameters
    ----------
    landmark : (4,) ndarray
        With rho > 0.
    point : (2,) ndarray
        Written.
    J : (2, 4) ndarray
        Written.
    """
    c, s, depth = math.cos(landmark[2]), math.sin(landmark[2]), 1.0 / landmark[3]
    point[0], point[1] = landmark[0] + depth * c, landmark[1] + depth * s
    J[0, 0], J[0, 1], J[0, 2], J[0, 3] = 1.0, 0.0, -depth * s, -depth * depth * c
    J[1, 0], J[1, 1], J[1, 2], J[1, 3] = 0.0, 1.0, depth * c, -depth * depth * s
