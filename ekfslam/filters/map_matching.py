"""Localization on a known map as a compiled loop: move, match a look, correct in turn.

The filter of the notes on Brenner's lectures. Its state is a pose; landmarks are constants.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ekfslam.association.nearest import nearest_neighbour, nearest_within
from ekfslam.compiled import compiled, inlined, now
from ekfslam.estimates import Decision
from ekfslam.filters.ekf_slam import end_of_look
from ekfslam.filters.evidence import against
from ekfslam.filters.kernels import correct, move
from ekfslam.filters.measure import POINT, POSE, expect, innovate, locate, placed, rows_of
from ekfslam.filters.triangle import add_rows
from ekfslam.geometry import Array
from ekfslam.models.sensors import XY

ACCEPTED, REJECTED = int(Decision.ACCEPTED), int(Decision.REJECTED)
UNSURE = int(Decision.AMBIGUOUS)
KNOWN, NEAREST, NEAREST_POSITION = range(3)


class Matching(NamedTuple):
    """How sightings find their landmarks.

    Attributes
    ----------
    method : int
    gates : (3,) ndarray
        On squared Mahalanobis distances, by the numbers that a sighting reports.
    radius : float
        On distances in the world [m].
    """

    method: int
    gates: Array
    radius: float


@compiled
def localize(start, stop, deltas, Qs, offsets, sightings, places, mean, P, matching, log):  # type: ignore[no-untyped-def]
    """Steps from `start` to before `stop`; returns the step at which it stopped.

    Before `stop` it stops at an innovation covariance that is not positive definite.

    Parameters
    ----------
    start, stop : int
    deltas, Qs : (R, K + 1, 3) and (R, K + 1, 3, 3) ndarray
        Increments that lead to each pose.
    offsets : (K + 2,) ndarray of int
    sightings : Sightings
        With rows of `places` for identities, -1 for those that are not on the map.
    places : (L, 2) ndarray
        The map.
    mean, P : (R, 3) and (R, 3, 3) ndarray
        Pose of each robot, which localizes alone; upper triangles.
    matching : Matching
    log : Log
    """
    for k in range(start, stop):
        begin = now()
        for robot in range(mean.shape[0]):
            move(mean[robot], P[robot], POSE, 0, deltas[robot, k], Qs[robot, k])
        first, last = offsets[k], offsets[k + 1]
        log.nis[k] = 0.0
        while first < last:
            until, robot = end_of_look(sightings, first, last), sightings.robot[first]
            match(mean[robot], P[robot], places, sightings, first, until, matching, log)
            nis, dof = in_turn(mean[robot], P[robot], places, sightings, first, until, log)
            if np.isnan(nis):  # what failed leaves nothing behind
                log.decision[first:until], log.landmark[first:until] = REJECTED, -1
                return k
            log.nis[k] += nis
            log.dof[k] += dof
            first = until
        if log.dof[k] == 0:
            log.nis[k] = np.nan
        for robot in range(mean.shape[0]):
            log.poses[robot, k] = mean[robot]
            for i in range(POSE):
                for j in range(i, POSE):
                    log.covariances[robot, k, i, j] = P[robot, i, j]
                    log.covariances[robot, k, j, i] = P[robot, i, j]
        log.seconds[k] = now() - begin
    return stop


@inlined
def match(mean, P, places, sightings, first, last, matching, log):  # type: ignore[no-untyped-def]
    """Find the landmark of each row of a look, all of them at the same pose."""
    m = 0
    rows = np.empty(last - first, np.int64)
    for i in range(first, last):
        if sightings.target[i] >= 0:
            continue  # a robot, which is on no map
        if matching.method == KNOWN:
            if sightings.landmark[i] >= 0:
                log.decision[i], log.landmark[i] = ACCEPTED, sightings.landmark[i]
            continue
        rows[m] = i
        m += 1
    rows = rows[:m]
    choice = np.full(m, -1)
    if m > 0 and matching.method == NEAREST:
        gate = np.full(m, matching.gates[rows_of(sightings.kind[first])])
        distances = mahalanobis(mean, P, places, sightings, rows)
        nearest_neighbour(distances, gate, gate, choice)
    elif m > 0:
        nearest_within(euclidean(mean, places, sightings, rows), matching.radius, choice)
    for k in range(m):
        if choice[k] >= 0:
            log.decision[rows[k]], log.landmark[rows[k]] = ACCEPTED, choice[k]
        elif choice[k] < -1:
            log.decision[rows[k]] = UNSURE  # its landmark is nearer to another row


@inlined
def mahalanobis(mean, P, places, sightings, rows):  # type: ignore[no-untyped-def]
    """Squared Mahalanobis distances (m, L) of the innovations of a look with all landmarks."""
    distances = np.empty((rows.size, places.shape[0]))
    kind = sightings.kind[rows[0]]
    d, sensor = rows_of(kind), placed(sightings.mount[rows[0]], mean)
    expected, nu, H = np.empty(2), np.empty(2), np.empty((2, 7))
    HP, E = np.empty((2, POSE)), np.zeros((2, 2))
    for j in range(places.shape[0]):
        expect(kind, POINT, sensor, places[j], expected, H)
        through(P, H, d, HP, E)
        for k in range(rows.size):
            innovate(kind, sightings.values[rows[k]], expected, nu)
            distances[k, j] = against(nu, E, sightings.covariance[rows[k]], d)[0]
    return distances


@inlined
def euclidean(mean, places, sightings, rows):  # type: ignore[no-untyped-def]
    """Distances (m, L) of the back-projected points of a look from all landmarks [m]."""
    distances = np.empty((rows.size, places.shape[0]))
    point, G, noise = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
    for k in range(rows.size):
        i = rows[k]
        kind, mount = sightings.kind[i], sightings.mount[i]
        locate(kind, mount, mean, sightings.values[i], sightings.covariance[i], point, G, noise)
        for j in range(places.shape[0]):
            x, y = point[0] - places[j, 0], point[1] - places[j, 1]
            distances[k, j] = math.sqrt(x * x + y * y)
    return distances


@inlined
def in_turn(mean, P, places, sightings, first, last, log):  # type: ignore[no-untyped-def]
    """Correct with one row of a look after another, each linearised where the one before led.

    Expected measurements from before the first correction would count what they share twice.
    Returns the sum of the squared Mahalanobis norms of the innovations, NaN if a covariance was
    not positive definite, and how many numbers they have.
    """
    total, dof = 0.0, 0
    kind, mount = sightings.kind[first], sightings.mount[first]
    d = rows_of(kind)
    nu, H, HP, S = np.empty(2), np.empty((2, 7)), np.empty((2, POSE)), np.empty((2, 2))
    for i in range(first, last):
        if log.decision[i] != ACCEPTED:
            continue
        place, sensor = places[log.landmark[i]], placed(mount, mean)
        if kind != XY and place[0] == sensor[0] and place[1] == sensor[1]:
            log.decision[i], log.landmark[i] = REJECTED, -1  # it has no direction to differ in
            continue
        expect(kind, POINT, sensor, place, nu, H)
        innovate(kind, sightings.values[i], nu, nu)
        through(P, H, d, HP, S)
        S[:d, :d] += sightings.covariance[i, :d, :d]
        log.innovation[i, :d], log.S[i, :d, :d] = nu[:d], S[:d, :d]
        nis = correct(mean, P, POSE, HP, S, nu, d, 1)
        if np.isnan(nis):
            return np.nan, dof
        total += nis
        dof += d
    return total, dof


@compiled
def through(P, H, d, HP, S):  # type: ignore[no-untyped-def]
    """``H P`` and ``S = H P H'`` of one sighting.

    Parameters
    ----------
    P : (3, 3) ndarray
        Upper triangle.
    H : (>= d, >= 3) ndarray
        With respect to the pose.
    d : int
    HP : (>= d, 3), S : (>= d, >= d) ndarray
        Written.
    """
    for a in range(d):
        HP[a] = 0.0
        add_rows(P, POSE, 0, POSE, H[a], HP[a])
        for b in range(a + 1):
            S[a, b] = HP[a, 0] * H[b, 0] + HP[a, 1] * H[b, 1] + HP[a, 2] * H[b, 2]
            S[b, a] = S[a, b]
