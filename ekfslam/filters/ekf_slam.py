"""EKF-SLAM: predict, associate, correct, extend.

The standard filter with Jacobians at the estimate (Smith and Cheeseman 1987; Solà, section 2;
Ciatto, Algorithm 1; Principles of Robot Autonomy, 17.1), as one compiled loop. `run` is the
algorithm; `ekfslam.filters.ekf` calls it over a dataset, or its parts step by step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekfslam.association.nearest import AMBIGUOUS, nearest_neighbour
from ekfslam.compiled import compiled, now
from ekfslam.estimates import Decision
from ekfslam.filters.gaussian_map import POINT, POSE
from ekfslam.filters.kernels import (
    append,
    correct,
    distances,
    expect,
    innovate,
    locate,
    move,
    project,
    times_transposed,
)
from ekfslam.geometry import Array

ACCEPTED, NEW = int(Decision.ACCEPTED), int(Decision.NEW)
REJECTED, UNSURE = int(Decision.REJECTED), int(Decision.AMBIGUOUS)


class Settings(NamedTuple):
    """Options as the compiled loop reads them; gates on the squared distance."""

    nearest: bool
    joint: bool
    accept: float
    new: float


class Register(NamedTuple):
    """Landmarks by index: identity known from outside, or order of discovery.

    Attributes
    ----------
    offsets : (capacity,) ndarray of int
        Where each stands in the state, -1 for not mapped.
    used : (1,) ndarray of int
        Indices in use.
    """

    offsets: np.ndarray
    used: np.ndarray


class Log(NamedTuple):
    """What the loop writes down: per pose, and per observation.

    Attributes
    ----------
    poses : (K + 1, 3), covariances : (K + 1, 3, 3), nis, seconds : (K + 1,), dof : (K + 1,) of int
    decision, landmark : (M,) of int
        The landmark by its index in the register, -1 for none.
    innovation : (M, 2), S : (M, 2, 2), H : (M, 2, 5), point : (M, 5)
        Linearised at `point` = (pose, landmark); for a new landmark H holds the derivative of its
        position with respect to the pose, and the noise that it adds.
    """

    poses: Array
    covariances: Array
    nis: Array
    dof: np.ndarray
    seconds: Array
    decision: np.ndarray
    landmark: np.ndarray
    innovation: Array
    S: Array
    H: Array
    point: Array


# The algorithm ----------------------------------------------------------------------------------


@compiled
def run(start, stop, deltas, Qs, offsets, sightings, slam, register, settings, log):  # type: ignore[no-untyped-def]
    """Steps from `start` to before `stop`; returns the step at which it had to stop, and why.

    Why is 0 for done, 1 for a map that must grow first, 2 for an innovation covariance that is
    not positive definite.
    """
    for k in range(start, stop):
        begin = now()
        first, last = offsets[k], offsets[k + 1]
        most = POSE + POINT * register.offsets.size
        if min(slam.size[0] + POINT * (last - first), most) > slam.mean.size:
            return k, 1
        predict(slam, deltas[k], Qs[k])
        nis, dof = observe(slam, register, sightings, first, last, settings, log)
        if np.isnan(nis):
            return k, 2
        log.poses[k] = slam.mean[:POSE]
        for i in range(POSE):
            for j in range(i, POSE):
                log.covariances[k, i, j] = log.covariances[k, j, i] = slam.covariance[i, j]
        log.nis[k] = nis if dof > 0 else np.nan
        log.dof[k] = dof
        log.seconds[k] = now() - begin
    return stop, 0


@compiled
def predict(slam, delta, Q):  # type: ignore[no-untyped-def]
    """The robot moves (Solà, 2.3.2; Ciatto, 3.3)."""
    move(slam.mean, slam.covariance, slam.size[0], delta, Q)


@compiled
def observe(slam, register, sightings, first, last, settings, log):  # type: ignore[no-untyped-def]
    """Look by look, all that one sensor saw at one instant (Solà, 2.4): associate, correct, extend.

    Returns the squared Mahalanobis norm of the innovations, and how many rows they have.
    """
    total, rows = 0.0, 0
    while first < last:
        end = first + 1
        while end < last and sightings.look[end] == sightings.look[first]:
            end += 1
        used = register.used[0]
        associate(slam, register, sightings, first, end, settings, log)
        nis, dof = update(slam, register, sightings, first, end, settings, log)
        if np.isnan(nis):
            register.used[0] = used  # the new landmarks of this look will not be mapped
            return nis, rows
        extend(slam, register, sightings, first, end, log)
        total += nis
        rows += dof
        first = end
    return total, rows


@compiled
def associate(slam, register, sightings, first, last, settings, log):  # type: ignore[no-untyped-def]
    """Who is seen: all observations of the look at the predicted pose (Ciatto, 3.6)."""
    if settings.nearest:
        count = register.used[0]
        table = np.empty((last - first, count))
        for i in range(first, last):
            distances(
                slam.mean,
                slam.covariance,
                register.offsets,
                count,
                sightings.kind[i],
                sightings.mount[i],
                sightings.values[i],
                sightings.covariance[i],
                table[i - first],
            )
        nearest_neighbour(table, settings.accept, settings.new, log.landmark[first:last])
    else:
        log.landmark[first:last] = sightings.landmark[first:last]
    for i in range(first, last):
        index = log.landmark[i]
        if settings.nearest and index == AMBIGUOUS:
            log.decision[i], log.landmark[i] = UNSURE, -1
        elif settings.nearest and index < 0:
            log.decision[i], log.landmark[i] = NEW, register.used[0]
            register.used[0] += 1
        elif index < 0:
            log.decision[i] = REJECTED  # association is known, and this one has no identity
        elif register.offsets[index] < 0:
            log.decision[i] = NEW
        else:
            log.decision[i] = ACCEPTED


@compiled
def update(slam, register, sightings, first, last, settings, log):  # type: ignore[no-untyped-def]
    """Correct with the landmarks seen again, jointly or one after another (Solà, 2.3.3).

    Returns the squared Mahalanobis norm of the innovations, and how many rows they have.
    """
    accepted = 0
    for i in range(first, last):
        if log.decision[i] == ACCEPTED:
            accepted += 1
    if accepted == 0:
        return 0.0, 0
    n, P = slam.size[0], slam.covariance
    together = accepted if settings.joint else 1
    rows = np.empty((2 * together, n))
    S = np.empty((2 * together, 2 * together))
    z = np.empty(2 * together)
    expected = np.empty(2)
    which = np.empty(together, np.int64)
    total, m = 0.0, 0
    for i in range(first, last):
        if log.decision[i] != ACCEPTED:
            continue
        at = register.offsets[log.landmark[i]]
        log.point[i, :POSE] = slam.mean[:POSE]
        log.point[i, POSE:] = slam.mean[at : at + POINT]
        kind, H = sightings.kind[i], log.H[i]
        expect(kind, sightings.mount[i], slam.mean[:POSE], slam.mean[at : at + POINT], expected, H)
        innovate(kind, sightings.values[i], expected, log.innovation[i])
        project(P, n, at, H, rows[2 * m : 2 * m + 2])
        which[m] = i
        for j in range(m + 1):  # S = H P H' + R, lower triangle of blocks
            other = which[j]
            column = register.offsets[log.landmark[other]]
            for a in range(2):
                for b in range(2):
                    S[2 * m + a, 2 * j + b] = times_transposed(
                        rows[2 * m + a], column, log.H[other], b
                    )
        for a in range(2):
            z[2 * m + a] = log.innovation[i, a]
            for b in range(2):
                S[2 * m + a, 2 * m + b] += sightings.covariance[i, a, b]
                log.S[i, a, b] = S[2 * m + a, 2 * m + b]
        m += 1
        if m == together:
            total += correct(slam.mean, P, n, rows, S, z, 2 * m)
            m = 0
    return total, 2 * accepted


@compiled
def extend(slam, register, sightings, first, last, log):  # type: ignore[no-untyped-def]
    """Put the landmarks seen for the first time into the map (Solà, 2.3.4; Ciatto, 3.7).

    The measurement that creates a landmark is used up by that: it corrects nothing.
    """
    for i in range(first, last):
        if log.decision[i] == NEW:
            log.point[i, :POSE] = slam.mean[:POSE]
            locate(
                sightings.kind[i],
                sightings.mount[i],
                slam.mean[:POSE],
                sightings.values[i],
                sightings.covariance[i],
                log.point[i, POSE:],
                log.H[i],
            )
            n = slam.size[0]
            append(slam.mean, slam.covariance, n, log.point[i, POSE:], log.H[i])
            register.offsets[log.landmark[i]] = n
            slam.size[0] = n + POINT
