"""The local map of the compressed filter (Guivant and Nebot 2001), and the way home from it.

While only landmarks of an area A are seen, the rest B of the map changes by what A carries to it:

    P_AB = Phi P_AB(0),   P_BB = P_BB(0) - P_BA(0) Psi P_AB(0),   x_B = x_B(0) + P_BA(0) theta

where Phi starts as the identity, Psi and theta as zero, and every motion and correction changes
them as it changes A. They need no equations of their own: they are what the filter makes of further
coordinates c, one for each of A, with cov(a, c) = Phi, cov(c, c) = -Psi and mean theta, that are
never observed. So the local map is an ordinary map of (a, c), and the filter runs on it as it is.

A landmark of B enters A when it is seen: as far as A is concerned it is ``x(0) + P(0) c`` plus an
error of its own, which is landmark initialization, with the carried coordinates for the pose; from
then on it carries, too, by coordinates that start as its copy. Thus an area is what has been seen
since the last way home, whatever the path.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpstrf

from ekfslam.blas import subtract_square
from ekfslam.compiled import compiled, now
from ekfslam.filters.ekf_slam import DONE, GROW, run
from ekfslam.filters.measure import POINT, POSE
from ekfslam.filters.options import KNOWN
from ekfslam.filters.triangle import times_symmetric
from ekfslam.filters.visibility import SURE, may_see, out_of_range, seen_from, uncertainty
from ekfslam.geometry import Array

LEAVE = 4  # beside DONE, GROW, INDEFINITE and LOOK: the area is full
EACH = 2 * POINT  # local coordinates of a landmark: its own, and those it carries


class Area(NamedTuple):
    """What ties a local map to the whole one.

    Attributes
    ----------
    home : (capacity,) ndarray of int
        By register index, where a landmark stands in the whole map; -1 for one that does not yet.
    carried : (most,) ndarray of int
        Local coordinates c, in the order in which they came.
    origin : (most,) ndarray of int
        Coordinate of the whole map that each is of.
    carrying : (1,) ndarray of int
        How many there are.
    full : (1,) ndarray of int
        Local coordinates beyond which nothing more is brought in; grows with the largest look.
    """

    home: np.ndarray
    carried: np.ndarray
    origin: np.ndarray
    carrying: np.ndarray
    full: np.ndarray


@compiled
def run_locally(  # type: ignore[no-untyped-def]
    start,
    stop,
    deltas,
    Qs,
    offsets,
    sightings,
    slam,
    register,
    whole,
    area,
    settings,
    log,
    other,
):
    """`ekfslam.filters.ekf_slam.run` on the local map; stops for `LEAVE` before a step, too."""
    for k in range(start, stop):
        begin, first, last = now(), offsets[k], offsets[k + 1]
        if settings.method == KNOWN:
            missing = beyond(sightings, first, last, register, area)
            size, poses = slam.size[0] + EACH * missing.size, POSE * settings.robots
            if not fits(size, area, slam.size[0] == 2 * poses):
                return k, LEAVE
            if size + POINT * (last - first) + poses > slam.mean.size:
                return k, GROW
            for index in missing:
                bring_in(index, slam, register, whole, area)
        before = now() - begin
        _, why = run(k, k + 1, deltas, Qs, offsets, sightings, slam, register, settings, log, other)
        if why != DONE:
            return k, why
        log.seconds[k] += before
    return stop, DONE


@compiled
def fits(size, area, empty):  # type: ignore[no-untyped-def]
    """Whether a look that needs a local map of some size can be taken before the way home.

    New landmarks do not count before they are there: they enter whichever map there is. A look that
    is too large for an empty area makes it larger, or every look like it would ask for the way
    home.
    """
    if empty and size > area.full[0]:
        area.full[0] = 2 * size
    return size <= area.full[0]


@compiled
def beyond(sightings, first, last, register, area):  # type: ignore[no-untyped-def]
    """Landmarks that are seen and stand in the whole map alone, by register index."""
    missing, count = np.empty(last - first, np.int64), 0
    for i in range(first, last):
        index = sightings.landmark[i]
        if index < 0 or register.offsets[index] >= 0 or area.home[index] < 0:
            continue
        if not (missing[:count] == index).any():
            missing[count] = index
            count += 1
    return missing[:count]


class Survey(NamedTuple):
    """What is known of the landmarks of the whole map since the last way home.

    Attributes
    ----------
    which : (N,) ndarray of int
        Their register indices.
    positions : (N, 2) ndarray
        As the whole map has them [m].
    variances : (N,) ndarray
        Trace of the covariance of each [m^2].
    anchor : int
        Register index of a landmark in the area, near to the robot.
    apart : (N,) ndarray
        Sigma of the position of each relative to the anchor [m].
    """

    which: np.ndarray
    positions: Array
    variances: Array
    anchor: int
    apart: Array


@compiled
def within_reach(survey, moved, slam, register, whole, area, robot, mount, limits, noise):  # type: ignore[no-untyped-def]
    """Landmarks beyond the area that may be visible, by register index: none is left out.

    Corrections move a landmark with the anchor, which is known, and relative to it. With w of all
    whitened innovations since the last way home, the latter is a product of w with something whose
    square is what the variance of (landmark - anchor) has lost: by the inequality of Cauchy and
    Schwarz no more than its sigma then times ``|w|``. Where that leaves a landmark out of view it
    is out of view; of the others the place is computed as it is now. Their variance at the last way
    home is no smaller than now.

    Parameters
    ----------
    survey : Survey
    moved : float
        Sum of the NIS of all corrections since the last way home.
    robot : int
    mount, limits : (3,) ndarray
        Of the sensor.
    noise : float
        Standard deviation of a sighting, as a length [m].
    """
    mean, P, pose, most = slam.mean, slam.covariance, POSE * robot, math.sqrt(moved)
    w, found, n = np.zeros((POINT, slam.size[0])), np.empty(survey.which.size, np.int64), 0
    anchor = area.home[survey.anchor]
    x = mean[register.offsets[survey.anchor]] - whole.mean[anchor]
    y = mean[register.offsets[survey.anchor] + 1] - whole.mean[anchor + 1]
    for k in range(survey.which.size):
        index, own, apart = survey.which[k], survey.variances[k], survey.apart[k]
        if register.offsets[index] >= 0:
            continue
        here = survey.positions[k, 0] + x, survey.positions[k, 1] + y
        # Nearer to the sensor than this it cannot be; the farther, the less likely is it in view.
        distance, _, _ = seen_from(mean, P, pose, mount, here[0], here[1], own)
        distance = max(distance - most * apart, 0.0) if apart > 0.0 else distance
        sigma = uncertainty(P, pose, distance, own)
        if out_of_range(P, pose, distance, SURE * (sigma + noise), limits):
            continue
        at = area.home[index]
        for a in range(POINT):
            ties(index, whole, area, w[a], a)
        now_x = whole.mean[at] + w[0] @ mean[: slam.size[0]]
        now_y = whole.mean[at + 1] + w[1] @ mean[: slam.size[0]]
        distance, bearing, sigma = seen_from(mean, P, pose, mount, now_x, now_y, own)
        if may_see(distance, bearing, SURE * (sigma + noise), limits):
            found[n] = index
            n += 1
    return found[:n]


@compiled
def ties(index, whole, area, w, coordinate):  # type: ignore[no-untyped-def]
    """Write P(0) between a coordinate of a landmark beyond and what is carried, to where that is.

    Parameters
    ----------
    w : (local size,) ndarray
        Written where there are carried coordinates.
    coordinate : int
        0 for x, 1 for y.
    """
    P, at = whole.covariance, area.home[index] + coordinate
    for j in range(area.carrying[0]):
        origin = area.origin[j]
        w[area.carried[j]] = P[at, origin] if at <= origin else P[origin, at]


@compiled
def as_it_is(index, slam, whole, area):  # type: ignore[no-untyped-def]
    """A landmark beyond the area, as it is now, O(n^2) locally.

    Returns
    -------
    (2,) ndarray, (2, 2) ndarray, (2, n) ndarray
        Mean, covariance, and covariance with the local coordinates.
    """
    n, at = slam.size[0], area.home[index]
    w, rows = np.zeros((POINT, n)), np.zeros((POINT, n))
    place, own = np.empty(POINT), np.empty((POINT, POINT))
    for a in range(POINT):
        ties(index, whole, area, w[a], a)
    times_symmetric(slam.covariance, n, w, rows)
    for a in range(POINT):
        place[a] = whole.mean[at + a] + w[a] @ slam.mean[:n]
        for b in range(a, POINT):
            own[a, b] = own[b, a] = whole.covariance[at + a, at + b] + rows[a] @ w[b]
    return place, own, rows


@compiled
def bring_in(index, slam, register, whole, area):  # type: ignore[no-untyped-def]
    """A landmark of the whole map enters the local one, and carries from now on."""
    n, at = slam.size[0], area.home[index]
    mean, P = slam.mean, slam.covariance
    place, own, rows = as_it_is(index, slam, whole, area)
    for a in range(POINT):
        mean[n + a], mean[n + POINT + a] = place[a], 0.0
        for b in range(a, POINT):
            P[n + a, n + b] = own[a, b]
        for b in range(POINT):
            P[n + a, n + POINT + b] = 1.0 if a == b else 0.0
            P[n + POINT + a, n + POINT + b] = 0.0
    for j in range(n):
        P[j, n], P[j, n + 1], P[j, n + 2], P[j, n + 3] = rows[0, j], rows[1, j], 0.0, 0.0
    slam.size[0] = n + EACH
    register.offsets[index] = n
    carry(area, n + POINT, at, POINT)


@compiled
def carry(area, local, origin, size):  # type: ignore[no-untyped-def]
    """Note coordinates that are carried."""
    count = area.carrying[0]
    for c in range(size):
        area.carried[count + c], area.origin[count + c] = local + c, origin + c
    area.carrying[0] = count + size


# The way home ------------------------------------------------------------------------------------


@compiled
def reduce_rest(P, n, W):  # type: ignore[no-untyped-def]
    """``P -= W' W`` on the triangle."""
    subtract_square(P, W, W.shape[0], n)


def square_root(psi: Array) -> Array:
    """C (c, r) with ``C C' = psi``, r its numerical rank.

    Parameters
    ----------
    psi : (c, c) ndarray
        Positive semidefinite up to rounding: of coordinates that nothing was seen of, it is zero.
    """
    scale = np.sqrt(np.maximum(np.diag(psi), 0.0))
    seen = np.flatnonzero(scale > 0.0)
    root = np.zeros((len(psi), len(seen)))
    if not len(seen):
        return root
    unit = psi[np.ix_(seen, seen)] / np.outer(scale[seen], scale[seen])
    factor, pivots, rank, _ = dpstrf(unit, lower=1)
    lower = np.tril(factor)[:, :rank]
    root[seen[pivots - 1], :rank] = scale[seen[pivots - 1], None] * lower
    return root[:, :rank]
