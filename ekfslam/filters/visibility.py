"""Which landmarks may be visible (the feasible observations of Solà, 2.4)."""

from __future__ import annotations

import math

import numpy as np

from ekfslam.association.index import build, near
from ekfslam.compiled import compiled
from ekfslam.filters.delayed import entry
from ekfslam.filters.kernels import wrap
from ekfslam.filters.measure import POINT, POSE
from ekfslam.filters.variants import INVARIANT, ROBOCENTRIC

SURE = 3.0  # sigmas
LARGE = 1000  # landmarks from which the spatial index pays


@compiled
def sighted(slam, at, pose, mount, invariant):  # type: ignore[no-untyped-def]
    """Where a sensor should see a point: range, bearing, and one sigma of its place [m].

    The sigma leaves correlations out, and so is cautious. Not so of right-invariant errors, which
    grow with the distance from the origin but are nearly the same for robot and landmark: their
    difference is the error of what is seen from the robot.

    Parameters
    ----------
    slam : MapArrays
    at, pose : int
        First coordinates of the point and of the robot's pose.
    mount : (3,) ndarray
    invariant : bool
        Whether P is of right-invariant errors.
    """
    mean, P, late, held = slam.mean, slam.covariance, slam.late, slam.held[0]
    own = entry(P, late, held, at, at) + entry(P, late, held, at + 1, at + 1)
    distance, bearing, sigma = seen_from(mean, P, pose, mount, mean[at], mean[at + 1], own)
    if invariant:
        variance = own + P[pose, pose] + P[pose + 1, pose + 1]
        variance -= 2.0 * (P[pose, at] + P[pose + 1, at + 1])
        sigma = math.sqrt(max(variance, 0.0))
    return distance, bearing, sigma


@compiled
def seen_from(mean, P, pose, mount, x, y, own):  # type: ignore[no-untyped-def]
    """`sighted` of any point (x, y), with the trace of its covariance."""
    c, s = math.cos(mean[pose + 2]), math.sin(mean[pose + 2])
    east = x - mean[pose] - c * mount[0] + s * mount[1]
    north = y - mean[pose + 1] - s * mount[0] - c * mount[1]
    distance = math.sqrt(east * east + north * north)
    bearing = wrap(math.atan2(north, east) - mean[pose + 2] - mount[2])
    return distance, bearing, uncertainty(P, pose, distance, own)


@compiled
def uncertainty(P, pose, distance, own):  # type: ignore[no-untyped-def]
    """Sigma of the place of a point in the view: its own, the robot's, and the heading's."""
    variance = own + P[pose, pose] + P[pose + 1, pose + 1]
    variance += distance * distance * P[pose + 2, pose + 2]
    return math.sqrt(max(variance, 0.0))


@compiled
def out_of_range(P, pose, distance, slack, limits):  # type: ignore[no-untyped-def]
    """Whether a point that is at least so far away cannot be in range.

    The slack grows with the distance by three sigmas of the heading: if these are a radian, what is
    farther may be more likely in view.
    """
    if SURE * math.sqrt(max(P[pose + 2, pose + 2], 0.0)) >= 1.0:
        return False
    return distance > limits[1] + slack


@compiled
def may_see(distance, bearing, slack, limits):  # type: ignore[no-untyped-def]
    """Whether a point is inside the view, or outside by no more than a length."""
    if distance < limits[0] - slack or distance > limits[1] + slack:
        return False
    return distance <= slack or abs(bearing) <= limits[2] + math.asin(slack / distance)


@compiled
def surely_sees(distance, bearing, slack, limits):  # type: ignore[no-untyped-def]
    """Whether a point is inside the view by more than a length all around."""
    if distance < limits[0] + slack or distance > limits[1] - slack or distance <= slack:
        return False
    return limits[2] >= math.pi or abs(bearing) + math.asin(slack / distance) < limits[2]


@compiled
def feasible(slam, register, robot, mount, limits, noise, variant):  # type: ignore[no-untyped-def]
    """Register indices of the landmarks that may be visible, ascending.

    Inside the view by three sigmas; all directions of open distance. Large maps are not scanned:
    a grid, sorted anew since corrections move everything, names those in range.

    Parameters
    ----------
    slam : MapArrays
    register : Register
    robot : int
    mount, limits : (3,) ndarray
        Of the sensor.
    noise : float
        Standard deviation of a sighting, as a length [m].
    variant : int
        Of `ekfslam.filters.variants`. Where the variance of a landmark grows, that is of
        right-invariant errors and in the frame of a robot, the grid, which rests on a bound, is
        not used.
    """
    mean, P, offsets, sizes = slam.mean, slam.covariance, register.offsets, register.sizes
    count, pose = register.used[0], POSE * robot
    invariant = variant == INVARIANT
    bounded = variant not in (INVARIANT, ROBOCENTRIC)
    if bounded and count >= LARGE and limits[1] < np.inf:
        some = in_range(slam, register, pose, mount, limits[1], noise)
    else:
        some = np.arange(count)
    found = np.empty(some.size, np.int64)
    n = 0
    for k in range(some.size):
        index = some[k]
        at = offsets[index]
        if at < 0:
            continue
        if sizes[index] == POINT:
            if not invariant:  # by a bound first: corrections that wait make no variance larger
                own = P[at, at] + P[at + 1, at + 1]
                distance, bearing, sigma = seen_from(
                    mean, P, pose, mount, mean[at], mean[at + 1], own
                )
                if not may_see(distance, bearing, SURE * (sigma + noise), limits):
                    continue
            if invariant or slam.held[0] > 0:
                distance, bearing, sigma = sighted(slam, at, pose, mount, invariant)
                if not may_see(distance, bearing, SURE * (sigma + noise), limits):
                    continue
        found[n] = index
        n += 1
    return found[:n]


@compiled
def in_range(slam, register, pose, mount, reach, noise):  # type: ignore[no-untyped-def]
    """Register indices of what may be in the range of a sensor, by a spatial index, ascending.

    No landmark's variance ever grows (Dissanayake et al. 2001), so the largest that any had when
    it was mapped bounds them all.
    """
    mean, P, offsets, sizes = slam.mean, slam.covariance, register.offsets, register.sizes
    count = register.used[0]
    positions, which = np.empty((count, 2)), np.empty(count, np.int64)
    others = np.empty(count, np.int64)
    points, rest, spread = 0, 0, 0.0
    for index in range(count):
        if offsets[index] < 0:
            continue
        if sizes[index] == POINT:
            at = offsets[index]
            positions[points, 0], positions[points, 1] = mean[at], mean[at + 1]
            which[points] = index
            spread = max(spread, register.spread[index])
            points += 1
        else:
            others[rest] = index
            rest += 1
    x, y, radius = around(mean, P, pose, mount, reach, noise, spread)
    hits = np.empty(points, np.int64)
    if radius < np.inf:
        grid = build(positions, points, max(radius, 1e-3))
        n = near(grid, x, y, radius, hits)
    else:
        n = points
        hits[:] = np.arange(points)
    found = np.empty(n + rest, np.int64)
    for k in range(n):
        found[k] = which[hits[k]]
    for k in range(rest):
        found[n + k] = others[k]
    if rest > 0:
        found.sort()
    return found


@compiled
def around(mean, P, pose, mount, reach, noise, spread):  # type: ignore[no-untyped-def]
    """Centre and radius of a circle that has all that may be in the range of a sensor.

    Parameters
    ----------
    mean, P
        Of the pose.
    pose : int
    mount : (3,) ndarray
    reach, noise : float
        Of the sensor [m].
    spread : float
        Bound on the sigma of any landmark [m].
    """
    c, s = math.cos(mean[pose + 2]), math.sin(mean[pose + 2])
    x = mean[pose] + c * mount[0] - s * mount[1]
    y = mean[pose + 1] + s * mount[0] + c * mount[1]
    own = P[pose, pose] + P[pose + 1, pose + 1]
    # A landmark at distance r is in range if r - 3 (sigma(r) + noise) <= reach; with the sigma of
    # the heading t, sigma(r) <= sqrt(spread^2 + own) + r t.
    share = 1.0 - SURE * math.sqrt(max(P[pose + 2, pose + 2], 0.0))
    if not share > 0.1:  # a heading that says nothing
        return x, y, np.inf
    return x, y, (reach + SURE * (math.sqrt(spread * spread + max(own, 0.0)) + noise)) / share
