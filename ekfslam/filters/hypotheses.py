"""A bank of bearing hypotheses: the undelayed initiation of a landmark from ranges."""

from __future__ import annotations

import math

import numpy as np

from ekfslam.compiled import compiled
from ekfslam.estimates import Decision
from ekfslam.filters.kernels import append, correct, project, times_transposed
from ekfslam.filters.measure import BANKED, POINT, POSE, expect, innovate, locate, placed, rows_of
from ekfslam.filters.upkeep import drop
from ekfslam.models.sensors import RANGE_BEARING

REJECTED = int(Decision.REJECTED)


@compiled
def start_bank(state, sightings, i, settings, log):  # type: ignore[no-untyped-def]
    """A range as a ring of points, each a hypothesis of the bearing, all equally likely."""
    slam, register, bank, index = state.slam, state.register, state.bank, log.landmark[i]
    robot, mount = sightings.robot[i], sightings.mount[i]
    pose = slam.mean[POSE * robot : POSE * robot + POSE].copy()
    count = settings.hypotheses
    width = 2.0 * math.pi / count
    target, G, noise = np.zeros(4), np.zeros((1, 4, 3)), np.zeros((4, 4))
    value = np.array([sightings.values[i, 0], 0.0])
    # Neighbours a standard deviation of half their distance away cover the ring without gaps.
    R = np.array([[sightings.covariance[i, 0, 0], 0.0], [0.0, (0.5 * width) ** 2]])
    for h in range(count):
        value[1] = -math.pi + (h + 0.5) * width
        locate(RANGE_BEARING, mount, pose, value, R, target, G[0], noise)
        n = slam.size[0]
        append(slam.mean, slam.covariance, n, np.array([POSE * robot]), target, POINT, G, noise)
        slam.size[0] = n + POINT
        bank.offsets[index, h], bank.weights[index, h] = n, 1.0 / count
    register.sizes[index], register.sightings[index] = BANKED, 1


@compiled
def update_bank(state, sightings, i, settings, log):  # type: ignore[no-untyped-def]
    """Weigh the hypotheses by a further sighting, prune, and correct with what is left.

    Together they may learn from the sighting only once: each is corrected with its noise divided
    by its weight, so that the informations add up to one (federated information sharing, Solà et
    al. 2005). When one is left, it is the landmark.
    """
    slam, bank, index = state.slam, state.bank, log.landmark[i]
    d = rows_of(sightings.kind[i])
    offsets, weights = bank.offsets[index], bank.weights[index]
    expected, H, z = np.zeros(2), np.zeros((2, 7)), np.zeros(2)
    before, total = weights.copy(), 0.0
    for h in range(settings.hypotheses):
        if offsets[h] < 0:
            continue
        rows, S = hypothesis(state, sightings, i, offsets[h], expected, H, z)
        if d == 1:
            s = S[0, 0] + sightings.covariance[i, 0, 0]
            likelihood = math.exp(-0.5 * z[0] * z[0] / s) / math.sqrt(s)
        else:
            S = S + sightings.covariance[i]
            determinant = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
            squared = S[1, 1] * z[0] ** 2 - 2.0 * S[0, 1] * z[0] * z[1] + S[0, 0] * z[1] ** 2
            likelihood = math.exp(-0.5 * squared / determinant) / math.sqrt(determinant)
        weights[h] *= likelihood
        total += weights[h]
    if not total > 0.0:  # no hypothesis explains it: an outlier
        log.decision[i] = REJECTED
        weights[:] = before
        return
    weights /= total
    prune(state, index, settings)
    for h in range(settings.hypotheses):
        if offsets[h] < 0 or weights[h] <= 0.0:
            continue
        rows, S = hypothesis(state, sightings, i, offsets[h], expected, H, z)
        for a in range(d):
            for b in range(d):
                S[a, b] += sightings.covariance[i, a, b] / weights[h]
        correct(slam.mean, slam.covariance, slam.size[0], rows, S, z, d, settings.poses)
    decided(state, index)


@compiled
def hypothesis(state, sightings, i, at, expected, H, z):  # type: ignore[no-untyped-def]
    """H P and H P H' of a sighting of one hypothesis, and its innovation."""
    slam = state.slam
    kind, pose, n = sightings.kind[i], POSE * sightings.robot[i], slam.size[0]
    d = rows_of(kind)
    sensor = placed(sightings.mount[i], slam.mean[pose : pose + POSE])
    expect(kind, POINT, sensor, slam.mean[at : at + POINT], expected, H)
    innovate(kind, sightings.values[i], expected, z)
    rows, S = np.empty((d, n)), np.empty((d, d))
    project(slam.covariance, n, pose, at, POINT, H, d, rows)
    for a in range(d):
        for b in range(d):
            S[a, b] = times_transposed(rows[a], pose, at, POINT, H, b)
    return rows, S


@compiled
def prune(state, index, settings):  # type: ignore[no-untyped-def]
    """Drop the unlikely hypotheses, and share their weight out."""
    offsets, weights = state.bank.offsets[index], state.bank.weights[index]
    least, total = settings.prune / settings.hypotheses, 0.0
    for h in range(settings.hypotheses):
        if offsets[h] >= 0 and weights[h] < least:
            at = offsets[h]
            offsets[h], weights[h] = -1, 0.0
            drop(state, at, POINT)
        total += weights[h]
    weights /= total


@compiled
def decided(state, index):  # type: ignore[no-untyped-def]
    """The last hypothesis of a bank is the landmark."""
    offsets = state.bank.offsets[index]
    alive, last = 0, -1
    for h in range(offsets.size):
        if offsets[h] >= 0:
            alive, last = alive + 1, h
    if alive == 1:
        register = state.register
        at, P = offsets[last], state.slam.covariance
        register.offsets[index], register.sizes[index] = at, POINT
        register.spread[index] = math.sqrt(P[at, at] + P[at + 1, at + 1])
        offsets[last] = -1
