"""What happens to a landmark in the map: it is deleted, made a point, missed where it should be.

Deletion is marginalisation (Solà, Table 1): rows and columns go, what stands behind moves up, and
the memory is used again.
"""

from __future__ import annotations

import math

import numpy as np

from ekfslam.association.descriptors import running_mean
from ekfslam.compiled import compiled
from ekfslam.estimates import Decision, Linearizations
from ekfslam.filters.delayed import bring_up_to_date
from ekfslam.filters.kernels import remove, replace
from ekfslam.filters.measure import INVERSE_DEPTH, POINT, POSE, point_of
from ekfslam.filters.triangle import copy
from ekfslam.filters.variants import INVARIANT
from ekfslam.filters.visibility import SURE, sighted, surely_sees
from ekfslam.models.landmarks import linearity

ACCEPTED, NEW, REJECTED = int(Decision.ACCEPTED), int(Decision.NEW), int(Decision.REJECTED)
CONVERTED = Linearizations.CONVERTED


@compiled
def close_up(state, at, size):  # type: ignore[no-untyped-def]
    """Tell everyone that coordinates are gone: what stood behind them has moved up."""
    register, waiting, bank = state.register, state.waiting, state.bank
    for index in range(register.used[0]):
        if register.offsets[index] > at:
            register.offsets[index] -= size
    for clone in range(waiting.clones.size):
        if waiting.clones[clone] > at:
            waiting.clones[clone] -= size
    for index in range(bank.offsets.shape[0]):
        for h in range(bank.offsets.shape[1]):
            if bank.offsets[index, h] > at:
                bank.offsets[index, h] -= size


@compiled
def drop(state, at, size):  # type: ignore[no-untyped-def]
    """Marginalise coordinates of the map."""
    slam = state.slam
    bring_up_to_date(slam)
    n, points = slam.size[0], slam.points
    remove(slam.mean, slam.covariance, n, at, size)
    for column in (points.at, points.first):
        for j in range(at, n - size):
            column[j] = column[j + size]
    slam.size[0] -= size
    close_up(state, at, size)


@compiled
def delete(state, index):  # type: ignore[no-untyped-def]
    """Landmark deletion: the state is reduced, and the landmark forgotten."""
    register = state.register
    at, size = register.offsets[index], register.sizes[index]
    register.offsets[index] = -1
    register.sizes[index] = 0
    register.sightings[index] = register.evidence[index] = register.rejections[index] = 0
    register.descriptor[index] = 0.0
    drop(state, at, size)


@compiled
def to_points(state, sightings, first, last, settings, log, journal):  # type: ignore[no-untyped-def]
    """Inverse depths of a look that have become linear enough are made points (Civera et al. 2008).

    One that lies behind its sensor, for sure, is corrupted: it is deleted.
    """
    slam, register = state.slam, state.register
    mean, P = slam.mean, slam.covariance
    point, J = np.empty(POINT), np.empty((POINT, INVERSE_DEPTH))
    for i in range(first, last):
        index = log.landmark[i]
        if log.decision[i] != ACCEPTED or index < 0 or register.sizes[index] != INVERSE_DEPTH:
            continue
        bring_up_to_date(slam)
        at = register.offsets[index]
        variance = P[at + 3, at + 3]
        if mean[at + 3] + SURE * math.sqrt(max(variance, 0.0)) < 0.0:
            delete(state, index)
            continue
        pose, mount = mean[3 * sightings.robot[i] :], sightings.mount[i]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        x = pose[0] + c * mount[0] - s * mount[1]
        y = pose[1] + s * mount[0] + c * mount[1]
        direction = mean[at : at + INVERSE_DEPTH]
        x0, y0, alpha, rho = direction[0], direction[1], direction[2], direction[3]
        if linearity(x0, y0, alpha, rho, variance, x, y) >= settings.linearity:
            continue
        point_of(direction, point, J)
        if journal.used[0] < journal.event.size:
            e = journal.used[0]
            journal.used[0] = e + 1
            journal.event[e], journal.row[e], journal.target[e] = CONVERTED, -1, -1
            journal.robot[e], journal.step[e] = sightings.robot[i], state.clock[0]
            journal.landmark[e], journal.size[e], journal.rows[e] = index, INVERSE_DEPTH, POINT
            copy(direction, INVERSE_DEPTH, journal.point[e, POSE:])
            for a in range(POINT):
                copy(J[a], INVERSE_DEPTH, journal.jacobian[e, a, POSE:])
            copy(point, POINT, journal.innovation[e])
        replace(mean, P, slam.size[0], at, INVERSE_DEPTH, point, POINT, J)
        slam.size[0] -= INVERSE_DEPTH - POINT
        register.sizes[index] = POINT
        register.spread[index] = math.sqrt(P[at, at] + P[at + 1, at + 1])
        close_up(state, at, INVERSE_DEPTH - POINT)


@compiled
def upkeep(state, sightings, first, last, settings, log):  # type: ignore[no-untyped-def]
    """What a look means for landmarks besides its correction, where the options ask for it."""
    if settings.corrupt > 0:
        count_rejections(state, first, last, settings, log)
    if settings.descriptor_variance > 0.0:
        learn_descriptors(state, sightings, first, last, log)
    if settings.forget > 0:
        keep_evidence(state, sightings, first, last, settings, log)


@compiled
def learn_descriptors(state, sightings, first, last, log):  # type: ignore[no-untyped-def]
    """Running mean of the descriptors of each landmark."""
    for i in range(first, last):
        index = log.landmark[i]
        if index >= 0 and log.decision[i] != REJECTED:
            known = state.register.descriptor[index]
            known[0], known[1] = running_mean(known[0], int(known[1]), sightings.descriptor[i])


@compiled
def keep_evidence(state, sightings, first, last, settings, log):  # type: ignore[no-untyped-def]
    """Count looks in which a landmark was seen, less those in which it should have been.

    A miss counts only for a landmark that is inside the view by three sigmas all around. The count
    starts at 0 and never exceeds `forget`; at ``-forget`` the landmark is deleted.
    """
    register, slam = state.register, state.slam
    offsets, sizes, evidence = register.offsets, register.sizes, register.evidence
    pose, mount, limits = (
        3 * sightings.robot[first],
        sightings.mount[first],
        sightings.limits[first],
    )
    seen, invariant = np.zeros(register.used[0], np.bool_), settings.variant == INVARIANT
    for i in range(first, last):
        if log.landmark[i] >= 0 and log.decision[i] in (ACCEPTED, NEW):
            seen[log.landmark[i]] = True
    for index in range(seen.size):
        if offsets[index] < 0 or sizes[index] != POINT:
            continue
        if seen[index]:
            evidence[index] = min(evidence[index] + 1, settings.forget)
            continue
        distance, bearing, sigma = sighted(slam, offsets[index], pose, mount, invariant)
        if surely_sees(distance, bearing, SURE * sigma, limits):
            evidence[index] -= 1
            if evidence[index] <= -settings.forget:
                delete(state, index)


@compiled
def count_rejections(state, first, last, settings, log):  # type: ignore[no-untyped-def]
    """A landmark whose known identity the gate refuses again and again is corrupted: delete it."""
    register = state.register
    for i in range(first, last):
        index = log.landmark[i]
        if index < 0 or log.decision[i] != REJECTED or register.offsets[index] < 0:
            continue
        register.rejections[index] += 1
        if register.rejections[index] >= settings.corrupt:
            delete(state, index)
