"""A fix: where bearings or ranges from several places put a landmark, without a prior."""

from __future__ import annotations

import math

import numpy as np

from ekfslam import geometry as geo
from ekfslam.compiled import compiled
from ekfslam.models.sensors import RANGE

# What `fix` asks for; its docstring says why.
MOST = 128  # sightings used
RIVAL = 13.8  # how much more any other minimum must cost: chi-square, two degrees, 0.999
SHARE = 0.25  # of the distance to the nearest sensor, for the worst standard deviation
GAUSSIAN = 2.0  # factor by which the cost may rise faster or slower than the covariance says

GRID = 72  # places tried along the circle of a range, or the ray of a bearing
ITERATIONS = 100
TINY = 1e-18  # instead of zero for a variance, or a distance squared


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
