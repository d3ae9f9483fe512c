"""Initiation: how a landmark enters the map, from full and from partial observations.

Full observations are mapped with their error, or correct a landmark of infinite uncertainty: never
both, which would use the measurement twice. Bearings and ranges need a prior (Solà, 2.3.5), or wait
until they determine a point.
"""

from __future__ import annotations

import math

import numpy as np

from ekfslam.compiled import compiled, inlined
from ekfslam.estimates import Decision, Linearizations
from ekfslam.filters.delayed import clear
from ekfslam.filters.journal import record
from ekfslam.filters.kernels import append, correct, project, times_transposed
from ekfslam.filters.measure import (
    BANKED,
    INVERSE_DEPTH,
    POINT,
    POSE,
    expect,
    foresee,
    innovate,
    locate,
    locate_direction,
    placed,
    rows_of,
)
from ekfslam.filters.options import ALLOCATED, MAPPED, NAIVE
from ekfslam.filters.triangle import copy
from ekfslam.filters.variants import EKF, begin
from ekfslam.models.sensors import BEARING, RANGE, RANGE_BEARING

ACCEPTED, NEW = int(Decision.ACCEPTED), int(Decision.NEW)
OBSERVED, CREATED = Linearizations.OBSERVED, Linearizations.CREATED


@inlined
def extend(slam, register, sightings, first, last, settings, log):  # type: ignore[no-untyped-def]
    """Put what is seen for the first time into the map (Solà, 2.3.4 to 2.3.6; Ciatto, 3.7).

    The measurement that creates a landmark is used up by that: it corrects nothing. Landmarks that
    start in another way are left to `ekfslam.filters.partial`.
    """
    for i in range(first, last):
        if log.decision[i] == NEW and starts_as_point(sightings.kind[i], settings):
            start_point(slam, register, sightings, i, settings, log)


@inlined
def starts_as_point(kind, settings):  # type: ignore[no-untyped-def]
    """Whether one sighting makes a point, by its mapped error or with a naive prior."""
    if kind == BEARING:
        return not settings.inverse_depth
    if kind == RANGE:
        return settings.ranges == NAIVE
    return settings.initiation == MAPPED


@compiled
def enter(slam, register, index, robot, target, size, G, noise):  # type: ignore[no-untyped-def]
    """Append a landmark seen from the present pose of a robot."""
    n, poses = slam.size[0], np.array([POSE * robot])
    append(slam.mean, slam.covariance, n, poses, target, size, G, noise)
    clear(slam.late, 0, slam.held[0], n, n + size)  # its rows come from the poses', which are exact
    slam.size[0] = n + size
    register.offsets[index], register.sizes[index] = n, size
    register.sightings[index] = 1
    register.spread[index] = math.sqrt(slam.covariance[n, n] + slam.covariance[n + 1, n + 1])


# A point from one sighting -----------------------------------------------------------------------


@compiled
def start_point(slam, register, sightings, i, settings, log):  # type: ignore[no-untyped-def]
    """A point, from a full observation or from a partial one with a naive Gaussian prior.

    The naive priors, on the distance of a bearing and on the bearing of a range, are g(R, S, y, s)
    of Solà's Eqs. 39 to 44 like any other; the function is just not linear over what they allow.
    """
    target, G, noise = np.zeros(4), np.zeros((1, 4, 3)), np.zeros((4, 4))
    map_point(slam, sightings, i, settings, target, G, noise)
    enter(slam, register, log.landmark[i], sightings.robot[i], target, POINT, G, noise)


@compiled
def map_point(slam, sightings, i, settings, target, G, noise):  # type: ignore[no-untyped-def]
    """The point of a sighting, with its Jacobian and its covariance given the pose."""
    kind, value, R = sightings.kind[i], sightings.values[i].copy(), sightings.covariance[i].copy()
    if kind == BEARING:
        value[0], value[1] = settings.distance_mean, value[0]
        R[0, 0], R[1, 1] = settings.distance_variance, R[0, 0]
        kind = RANGE_BEARING
    elif kind == RANGE:
        value[1], R[1, 1] = 0.0, math.pi**2 / 3.0  # of a uniform bearing
        kind = RANGE_BEARING
    at = POSE * sightings.robot[i]
    here, mount = slam.mean[at : at + POSE], sightings.mount[i]
    locate(kind, mount, here, value, R, target, G[0], noise)
    if settings.variant != EKF:
        begin(settings.variant, slam, kind, mount, at, value, R, i, target, G[0], noise)


@compiled
def start_uninformed(state, sightings, i, settings, log, journal):  # type: ignore[no-untyped-def]
    """A point of infinite uncertainty, uncorrelated, corrected by its first measurement.

    Ciatto's first example of 3.7; or it stands in the state already (Principles of Robot Autonomy,
    17.1.2), with a mean that means nothing yet.
    """
    slam, register, index = state.slam, state.register, log.landmark[i]
    robot, mount, kind = sightings.robot[i], sightings.mount[i], sightings.kind[i]
    value, R = sightings.values[i], sightings.covariance[i]
    pose = slam.mean[POSE * robot : POSE * robot + POSE]
    target, G, noise = np.zeros(4), np.zeros((1, 4, 3)), np.zeros((4, 4))
    locate(kind, mount, pose, value, R, target, G[0], noise)
    G[:] = 0.0
    noise[:] = 0.0
    noise[0, 0] = noise[1, 1] = settings.variance
    if settings.initiation == ALLOCATED and register.offsets[index] >= 0:
        at = register.offsets[index]
        copy(target, POINT, slam.mean[at:])
        register.sightings[index] = 1
    else:
        enter(slam, register, index, robot, target, POINT, G, noise)
    created(state, i, robot, index, target, POINT, G, noise, journal)
    at, n, d = register.offsets[index], slam.size[0], rows_of(kind)
    expected, H, z = np.zeros(2), np.zeros((2, 7)), np.zeros(2)
    rows, S = np.empty((d, n)), np.empty((d, d))
    there = slam.mean[at : at + POINT]
    expect(kind, POINT, placed(mount, pose), there, expected, H)
    innovate(kind, value, expected, z)
    record(journal, OBSERVED, i, robot, state.clock[0], index, -1, POINT, d, pose, there, H, z, R)
    project(slam.covariance, n, POSE * robot, at, POINT, H, d, rows)
    for a in range(d):
        for b in range(d):
            S[a, b] = times_transposed(rows[a], POSE * robot, at, POINT, H, b) + R[a, b]
    correct(slam.mean, slam.covariance, n, rows, S, z, d, settings.poses)


@compiled
def start_direction(state, sightings, i, log, journal):  # type: ignore[no-untyped-def]
    """A bearing as (x0, y0, alpha, rho): the distance is anything from the minimum range on.

    Mean 1/(2 d_min) and standard deviation 1/(4 d_min) of rho put [0, 1/d_min] inside two sigmas.
    """
    robot = sightings.robot[i]
    pose = state.slam.mean[POSE * robot : POSE * robot + POSE]
    target, G, noise = np.zeros(4), np.zeros((1, 4, 3)), np.zeros((4, 4))
    nearest = sightings.limits[i, 0]
    locate_direction(
        sightings.mount[i],
        pose,
        sightings.values[i, 0],
        sightings.covariance[i, 0, 0],
        0.5 / nearest,
        (0.25 / nearest) ** 2,
        target,
        G[0],
        noise,
    )
    index = log.landmark[i]
    enter(state.slam, state.register, index, robot, target, INVERSE_DEPTH, G, noise)
    created(state, i, robot, index, target, INVERSE_DEPTH, G, noise, journal)


# For the journal ---------------------------------------------------------------------------------


@compiled
def created(state, i, robot, index, target, size, G, noise, journal):  # type: ignore[no-untyped-def]
    """Record how a landmark was made."""
    pose = state.slam.mean[POSE * robot : POSE * robot + POSE]
    none, step = np.zeros(4), state.clock[0]
    record(journal, CREATED, i, robot, step, index, -1, size, size, pose, target, G[0], none, noise)


@compiled
def note_points(state, sightings, first, last, settings, log, journal):  # type: ignore[no-untyped-def]
    """Record what `extend` is about to do."""
    for i in range(first, last):
        if log.decision[i] == NEW and starts_as_point(sightings.kind[i], settings):
            target, G, noise = np.zeros(4), np.zeros((1, 4, 3)), np.zeros((4, 4))
            map_point(state.slam, sightings, i, settings, target, G, noise)
            index = log.landmark[i]
            created(state, i, sightings.robot[i], index, target, POINT, G, noise, journal)


@compiled
def note_corrections(state, sightings, first, last, log, journal):  # type: ignore[no-untyped-def]
    """Record the linear models that a correction with these rows is about to use."""
    mean, register = state.slam.mean, state.register
    point, H, nu = np.empty(4), np.zeros((2, 7)), np.zeros(2)
    for i in range(first, last):
        index, robot, kind = log.landmark[i], sightings.robot[i], sightings.kind[i]
        if log.decision[i] != ACCEPTED or (index >= 0 and register.sizes[index] == BANKED):
            continue
        at, size = POSE * sightings.target[i], POSE
        if index >= 0:
            at, size = register.offsets[index], register.sizes[index]
        here, there, R = mean[POSE * robot :][:POSE], mean[at : at + size], sightings.covariance[i]
        mount, value, target = sightings.mount[i], sightings.values[i], sightings.target[i]
        if foresee(kind, size, placed(mount, here), there, value, point, H, nu):
            step, d = state.clock[0], rows_of(kind)
            record(journal, OBSERVED, i, robot, step, index, target, size, d, here, point, H, nu, R)
