"""What recognition decides on: innovations and distances at the state that a look begins with."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ekfslam.association.descriptors import descriptor_distance
from ekfslam.compiled import compiled
from ekfslam.filters.delayed import entry
from ekfslam.filters.measure import POINT, locate, moved, placed, rows_of
from ekfslam.filters.options import (
    EUCLIDEAN,
    EUCLIDEAN_FIRST,
    MAHALANOBIS_FIRST,
)
from ekfslam.filters.variants import INVARIANT, foresee_at
from ekfslam.filters.variants.right_invariant import additive
from ekfslam.filters.visibility import feasible
from ekfslam.geometry import Array


class Evidence(NamedTuple):
    """What a decision is made on: m observations of a look, C landmarks that may be visible.

    Attributes
    ----------
    candidates : (C,) ndarray of int
        Register indices, in the order of the map.
    rows : (m,) ndarray of int
        Observations.
    distances, logdets : (m, C) ndarray
        Squared Mahalanobis distance of each innovation, and log det S.
    points : (m, C) ndarray
        Distance of the back-projected point [m], or in sigmas of the landmark, unsquared; only for
        the methods that ask for it.
    accept, new : (m,) ndarray
        Gates.
    """

    candidates: np.ndarray
    rows: np.ndarray
    distances: Array
    logdets: Array
    points: Array
    accept: Array
    new: Array


@compiled
def cross(P, late, held, pose, at, size, H, other, other_size, G, d, out):  # type: ignore[no-untyped-def]
    """``H P G'`` of two observations from one pose, (d, d): only the coordinates that matter.

    Parameters
    ----------
    P, late, held
        The covariance, see `ekfslam.filters.delayed`.
    pose, at, other : int
        First coordinates of the pose and of the two targets.
    size, other_size : int
    H, G : (2, 7) ndarray
    d : int
    out : (>= d, >= d) ndarray
        Written.
    """
    out[:d, :d] = 0.0
    for j in range(3 + other_size):
        column = pose + j if j < 3 else other + j - 3
        for a in range(d):
            total = 0.0
            for i in range(3 + size):
                row = pose + i if i < 3 else at + i - 3
                total += H[a, i] * entry(P, late, held, row, column)
            for b in range(d):
                out[a, b] += total * G[b, j]


@compiled
def against(innovation, E, R, d):  # type: ignore[no-untyped-def]
    """Squared Mahalanobis distance of an innovation in S = E + R, and log det S; inf if not."""
    if d == 1:
        s = E[0, 0] + R[0, 0]
        if not s > 0.0:
            return np.inf, np.inf
        return innovation[0] * innovation[0] / s, math.log(s)
    s00, s01, s11 = E[0, 0] + R[0, 0], E[0, 1] + R[0, 1], E[1, 1] + R[1, 1]
    determinant = s00 * s11 - s01 * s01
    if not determinant > 0.0:
        return np.inf, np.inf
    a, b = innovation[0], innovation[1]
    squared = (s11 * a * a - 2.0 * s01 * a * b + s00 * b * b) / determinant
    return squared, math.log(determinant)


@compiled
def gather(state, sightings, first, last, settings):  # type: ignore[no-untyped-def]
    """Evidence of a look: candidates, and distances of every observation with each."""
    register, mean, P = state.register, state.slam.mean, state.slam.covariance
    points, variant = state.slam.points.at, settings.variant
    late, held = state.slam.late, state.slam.held[0]
    robot, mount, kind = sightings.robot[first], sightings.mount[first], sightings.kind[first]
    pose, d, limits = 3 * robot, rows_of(kind), sightings.limits[first]
    sensor = placed(mount, mean[pose : pose + 3])
    elsewhere = placed(mount, points[pose : pose + 3])
    rows = np.empty(last - first, np.int64)
    m, noise = 0, widest(sightings, first, last)
    for i in range(first, last):
        if sightings.target[i] < 0:
            rows[m] = i
            m += 1
    rows = rows[:m]
    candidates = feasible(state.slam, register, robot, mount, limits, noise, variant)
    count = candidates.size
    distances, logdets = np.full((m, count), np.inf), np.zeros((m, count))
    apart = np.full((m if uses_points(settings.method) else 0, count), np.inf)
    accept, new = np.empty(m), np.empty(m)
    point, H, nu, E = np.empty(6), np.empty((2, 7)), np.empty(2), np.empty((2, 2))
    described = settings.descriptor_variance > 0.0
    for k in range(m):
        more = 1 if described and not np.isnan(sightings.descriptor[rows[k]]) else 0
        accept[k], new[k] = settings.accept[d + more], settings.new[d + more]
    for j in range(count):
        index = candidates[j]
        at, size = register.offsets[index], register.sizes[index]
        there = mean[at : at + size]
        for k in range(m):
            i = rows[k]
            value, R = sightings.values[i], sightings.covariance[i]
            if not foresee_at(
                variant, mean, points, sensor, elsewhere, at, size, kind, value, point, H, nu
            ):
                continue
            if k == 0 or size > POINT:  # of a point it is the same for all of the look
                cross(P, late, held, pose, at, size, H, at, size, H, d, E)
            for a in range(d):
                nu[a] = moved(nu, H, there, point, size, a)
            distances[k, j], logdets[k, j] = against(nu, E, R, d)
            if described:
                known = register.descriptor[index]
                distances[k, j] += descriptor_distance(
                    sightings.descriptor[i],
                    known[0] if known[1] > 0 else np.nan,
                    settings.descriptor_variance * (1.0 + 1.0 / max(known[1], 1.0)),
                )
    if apart.shape[0] > 0:
        back_projected(state, sightings, rows, candidates, settings, apart)
    return Evidence(candidates, rows, distances, logdets, apart, accept, new)


@compiled
def uses_points(method):  # type: ignore[no-untyped-def]
    """Whether a method compares back-projected points."""
    return method in (EUCLIDEAN, EUCLIDEAN_FIRST, MAHALANOBIS_FIRST)


@compiled
def widest(sightings, first, last):  # type: ignore[no-untyped-def]
    """The largest `spread` of the landmarks in a look [m]."""
    noise = 0.0
    for i in range(first, last):
        if sightings.target[i] < 0:
            value, R = sightings.values[i], sightings.covariance[i]
            noise = max(noise, spread(sightings.kind[i], value, R))
    return noise


@compiled
def spread(kind, value, R):  # type: ignore[no-untyped-def]
    """Standard deviation of a sighting as a length [m], for the margin of what may be visible."""
    across = 0.0
    if rows_of(kind) == 2:
        across = R[1, 1] * (value[0] * value[0] if kind == 0 else 1.0)
        return math.sqrt(R[0, 0] + across)
    return math.sqrt(R[0, 0]) if kind == 3 else 0.0


@compiled
def back_projected(state, sightings, rows, candidates, settings, points):  # type: ignore[no-untyped-def]
    """Distances of the back-projected point: Euclidean, or in the landmark's own covariance.

    Ciatto, 3.6: the uncertainty of the robot and of the measurement is left out.
    """
    register, mean, P = state.register, state.slam.mean, state.slam.covariance
    late, held = state.slam.late, state.slam.held[0]
    where, G, noise = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
    apart, own = np.empty(2), np.empty((2, 2))
    for k in range(rows.size):
        i = rows[k]
        pose = 3 * sightings.robot[i]
        locate(
            sightings.kind[i],
            sightings.mount[i],
            mean[pose : pose + 3],
            sightings.values[i],
            sightings.covariance[i],
            where,
            G,
            noise,
        )
        for j in range(candidates.size):
            at = register.offsets[candidates[j]]
            apart[0], apart[1] = where[0] - mean[at], where[1] - mean[at + 1]
            if settings.method == MAHALANOBIS_FIRST:
                noise[:] = 0.0
                for a in range(2):
                    for b in range(2):
                        own[a, b] = entry(P, late, held, at + a, at + b)
                if settings.variant == INVARIANT:
                    additive(mean, P, at, POINT, own)
                squared, _ = against(apart, own, noise, 2)
                points[k, j] = math.sqrt(squared)
            else:
                points[k, j] = math.sqrt(apart[0] * apart[0] + apart[1] * apart[1])
