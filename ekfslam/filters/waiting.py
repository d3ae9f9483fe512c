"""Ranges that wait: past poses stay in the state until they determine the landmark.

The delayed initiation of a landmark from partial observations, without an approximation beyond the
filter's own: a clone of the pose that a range was taken from keeps its correlations with all else.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ekfslam.compiled import compiled
from ekfslam.estimates import Decision, Linearizations
from ekfslam.filters.delayed import bring_up_to_date
from ekfslam.filters.journal import record
from ekfslam.filters.kernels import append, correct, project, times_transposed
from ekfslam.filters.measure import POINT, POSE, expect, foresee, innovate, moved, placed
from ekfslam.filters.upkeep import drop
from ekfslam.geometry import Array
from ekfslam.models.fix import fix

NEW, REJECTED, KEPT = int(Decision.NEW), int(Decision.REJECTED), int(Decision.DELAYED)
OBSERVED, CREATED = Linearizations.OBSERVED, Linearizations.CREATED
MOST = 40  # ranges that wait for one landmark; the oldest goes
APART = 0.05  # share of its range by which the sensor must have moved for the next one to wait


class Seen(NamedTuple):
    """What waits for one landmark, oldest first, and its linear models.

    Attributes
    ----------
    kind, clone : (m,) ndarray of int
    frames : (m, 3) ndarray
        Poses of the sensors in the world.
    values : (m, 2), variances : (m,) ndarray
    H : (m, 2, 7), nu : (m, 2) ndarray
        Jacobians and innovations, one row of each.
    """

    kind: np.ndarray
    clone: np.ndarray
    frames: Array
    values: Array
    variances: Array
    H: Array
    nu: Array


@compiled
def wait(state, sightings, i, settings, log, journal):  # type: ignore[no-untyped-def]
    """Keep a range and the pose that it was taken from until they determine the landmark."""
    waiting, index = state.waiting, log.landmark[i]
    log.decision[i] = REJECTED
    robot, mount = sightings.robot[i], sightings.mount[i]
    if not moved_on(state, index, robot, mount, sightings.values[i, 0]):
        return
    place = free_place(state, index)
    clone = clone_of(state, robot)
    log.decision[i] = KEPT
    waiting.row[place], waiting.landmark[place], waiting.clone[place] = i, index, clone
    waiting.kind[place], waiting.mount[place] = sightings.kind[i], mount
    waiting.value[place] = sightings.values[i, 0]
    waiting.variance[place] = sightings.covariance[i, 0, 0]
    if settle_waiting(state, index, settings, journal):
        log.decision[i] = NEW


@compiled
def sensor_frame(state, pose, mount, frame):  # type: ignore[no-untyped-def]
    """Pose of a sensor in the world, from a pose in the state."""
    mean = state.slam.mean
    c, s = math.cos(mean[pose + 2]), math.sin(mean[pose + 2])
    frame[0] = mean[pose] + c * mount[0] - s * mount[1]
    frame[1] = mean[pose + 1] + s * mount[0] + c * mount[1]
    frame[2] = mean[pose + 2] + mount[2]


@compiled
def moved_on(state, index, robot, mount, distance):  # type: ignore[no-untyped-def]
    """Whether the sensor is elsewhere than it was for the ranges of this landmark that wait."""
    waiting = state.waiting
    here, there = np.empty(3), np.empty(3)
    sensor_frame(state, POSE * robot, mount, here)
    for w in range(waiting.row.size):
        if waiting.row[w] >= 0 and waiting.landmark[w] == index:
            sensor_frame(state, waiting.clones[waiting.clone[w]], waiting.mount[w], there)
            if math.hypot(here[0] - there[0], here[1] - there[1]) < APART * distance:
                return False
    return True


@compiled
def free_place(state, index):  # type: ignore[no-untyped-def]
    """A place among what waits: the oldest goes if the landmark has `MOST`, or all are taken."""
    waiting = state.waiting
    free, count, oldest, eldest = -1, 0, -1, -1
    for w in range(waiting.row.size):
        if waiting.row[w] < 0:
            free = w
            continue
        step = waiting.step[waiting.clone[w]]
        if eldest < 0 or step < waiting.step[waiting.clone[eldest]]:
            eldest = w
        if waiting.landmark[w] == index:
            count += 1
            if oldest < 0 or step < waiting.step[waiting.clone[oldest]]:
                oldest = w
    if count < MOST and free >= 0:
        return free
    place = oldest if count >= MOST else eldest
    waiting.row[place] = -1
    free_clones(state)
    return place


@compiled
def clone_of(state, robot):  # type: ignore[no-untyped-def]
    """The clone of a robot's present pose, made if needed.

    Where there is no room for one more, the oldest goes, with what waits for it: a landmark that a
    straight path does not determine must not keep all others out.
    """
    waiting, slam, now = state.waiting, state.slam, state.clock[0]
    free, oldest = -1, 0
    for c in range(waiting.clones.size):
        if waiting.clones[c] < 0:
            free = c
        elif waiting.step[c] == now and waiting.robot[c] == robot:
            return c
        elif waiting.clones[oldest] < 0 or waiting.step[c] < waiting.step[oldest]:
            oldest = c
    if free < 0:
        free = oldest
        for w in range(waiting.row.size):
            if waiting.clone[w] == oldest:
                waiting.row[w] = -1
        free_clones(state)
    n, pose = slam.size[0], POSE * robot
    G = np.zeros((1, POSE, POSE))
    G[0, 0, 0] = G[0, 1, 1] = G[0, 2, 2] = 1.0
    here, none = slam.mean[pose : pose + POSE].copy(), np.zeros((POSE, POSE))
    append(slam.mean, slam.covariance, n, np.array([pose]), here, POSE, G, none)
    slam.size[0] = n + POSE
    waiting.clones[free], waiting.step[free], waiting.robot[free] = n, now, robot
    return free


@compiled
def free_clones(state):  # type: ignore[no-untyped-def]
    """Marginalise the past poses that nothing waits for any more."""
    waiting = state.waiting
    needed = np.zeros(waiting.clones.size, np.bool_)
    for w in range(waiting.row.size):
        if waiting.row[w] >= 0:
            needed[waiting.clone[w]] = True
    for c in range(waiting.clones.size):
        if waiting.clones[c] >= 0 and not needed[c]:
            at = waiting.clones[c]
            waiting.clones[c] = -1
            drop(state, at, POSE)


@compiled
def waiting_for(state, index):  # type: ignore[no-untyped-def]
    """Places of what waits for a landmark, oldest first."""
    waiting = state.waiting
    places = np.empty(waiting.row.size, np.int64)
    count = 0
    for w in range(waiting.row.size):
        if waiting.row[w] >= 0 and waiting.landmark[w] == index:
            places[count] = w
            count += 1
    places = places[:count]
    steps = np.empty(count, np.int64)
    for k in range(count):
        steps[k] = waiting.step[waiting.clone[places[k]]]
    return places[np.argsort(steps, kind="mergesort")]


@compiled
def settle_waiting(state, index, settings, journal):  # type: ignore[no-untyped-def]
    """If what waits for a landmark determines it, put it into the map and use all of it.

    All is linearised at the fix. Two sightings make the point, exactly: the limit of an infinite
    prior without its loss of digits. The others then correct it.
    """
    waiting, register = state.waiting, state.register
    places = waiting_for(state, index)
    seen = Seen(
        waiting.kind[places],
        waiting.clone[places],
        np.empty((places.size, 3)),
        np.zeros((places.size, 2)),
        waiting.variance[places],
        np.zeros((places.size, 2, 7)),
        np.zeros((places.size, 2)),
    )
    for k in range(places.size):
        seen.values[k, 0] = waiting.value[places[k]]
        mount = waiting.mount[places[k]]
        sensor_frame(state, waiting.clones[seen.clone[k]], mount, seen.frames[k])
    determined, x, y, _, _, _ = fix(seen.kind, seen.frames, seen.values, seen.variances)
    if not determined:
        return False
    point = np.array([x, y])
    linearise(state, places, seen, point)
    note_waiting(state, index, places, seen, point, journal)
    pair = best_pair(seen)
    at = point_of_two(state, pair, seen, point)
    register.offsets[index], register.sizes[index] = at, POINT
    register.sightings[index] = places.size
    P = state.slam.covariance
    register.spread[index] = math.sqrt(P[at, at] + P[at + 1, at + 1])
    correct_by_the_others(state, pair, seen, point, at, settings)
    waiting.row[places] = -1
    free_clones(state)
    return True


@compiled
def linearise(state, places, seen, point):  # type: ignore[no-untyped-def]
    """Jacobians and innovations of what waits for a landmark, at a point."""
    waiting, mean, expected = state.waiting, state.slam.mean, np.zeros(2)
    for k in range(places.size):
        at, mount = waiting.clones[seen.clone[k]], waiting.mount[places[k]]
        sensor = placed(mount, mean[at : at + POSE])
        expect(seen.kind[k], POINT, sensor, point, expected, seen.H[k])
        innovate(seen.kind[k], seen.values[k], expected, seen.nu[k])


@compiled
def note_waiting(state, index, places, seen, point, journal):  # type: ignore[no-untyped-def]
    """Record a landmark without a prior, so created without an equation, and what determines it."""
    waiting, mean, R = state.waiting, state.slam.mean, np.zeros((2, 2))
    for k in range(-1, places.size):
        clone, row = seen.clone[max(k, 0)], waiting.row[places[k]]
        past = mean[waiting.clones[clone] :][:POSE]
        robot, step = waiting.robot[clone], waiting.step[clone]
        event, d = (CREATED, 0) if k < 0 else (OBSERVED, 1)
        R[0, 0], H, nu = seen.variances[k], seen.H[k], seen.nu[k]
        record(journal, event, row, robot, step, index, -1, POINT, d, past, point, H, nu, R)


@compiled
def best_pair(seen):  # type: ignore[no-untyped-def]
    """The two sightings whose lines of equal value cross best."""
    first, second, best = 0, 1, -1.0
    for k in range(seen.kind.size):
        for other in range(k):
            area = abs(crossing(seen, k, other))
            area /= math.sqrt(seen.variances[k] * seen.variances[other])
            if area > best:
                first, second, best = other, k, area
    return np.array([first, second])


@compiled
def crossing(seen, k, other):  # type: ignore[no-untyped-def]
    """Determinant of the derivatives of two values with respect to the point."""
    one, two = seen.H[k, 0], seen.H[other, 0]
    return one[3] * two[4] - one[4] * two[3]


@compiled
def point_of_two(state, pair, seen, point):  # type: ignore[no-untyped-def]
    """Append the point that two sightings make, with its correlations; returns where it stands.

    From ``nu_k = H_pose,k dx_k + H_point,k dl + v_k``, solved for dl.
    """
    waiting, slam = state.waiting, state.slam
    determinant = crossing(seen, pair[0], pair[1])
    G, noise, poses = np.zeros((2, POINT, POSE)), np.zeros((POINT, POINT)), np.empty(2, np.int64)
    target = point.copy()
    for k in range(2):
        row, other = pair[k], seen.H[pair[1 - k], 0]
        sign = 1.0 if k == 0 else -1.0
        column = np.array([sign * other[4], -sign * other[3]]) / determinant  # of the inverse
        poses[k] = waiting.clones[seen.clone[row]]
        for a in range(POINT):
            target[a] += column[a] * seen.nu[row, 0]
            for c in range(POSE):
                G[k, a, c] = -column[a] * seen.H[row, 0, c]
            for b in range(POINT):
                noise[a, b] += column[a] * seen.variances[row] * column[b]
    n = slam.size[0]
    append(slam.mean, slam.covariance, n, poses, target, POINT, G, noise)
    slam.size[0] = n + POINT
    return n


@compiled
def correct_by_the_others(state, pair, seen, point, at, settings):  # type: ignore[no-untyped-def]
    """Correct jointly with what waited for a landmark but did not make it."""
    waiting, slam = state.waiting, state.slam
    n, m = slam.size[0], seen.kind.size - 2
    if m == 0:
        return
    rows, S, nu = np.empty((m, n)), np.empty((m, m)), np.empty(m)
    used = np.empty(m, np.int64)
    p = 0
    for k in range(seen.kind.size):
        if k in (pair[0], pair[1]):
            continue
        used[p] = k
        pose = waiting.clones[seen.clone[k]]
        project(slam.covariance, n, pose, at, POINT, seen.H[k], 1, rows[p : p + 1])
        nu[p] = moved(seen.nu[k], seen.H[k], slam.mean[at : at + POINT], point, POINT, 0)
        for q in range(p + 1):
            past = waiting.clones[seen.clone[used[q]]]
            S[p, q] = times_transposed(rows[p], past, at, POINT, seen.H[used[q]], 0)
        S[p, p] += seen.variances[k]
        p += 1
    correct(slam.mean, slam.covariance, n, rows, S, nu, m, settings.poses)


@compiled
def use_waiting(state, index, settings, journal):  # type: ignore[no-untyped-def]
    """A landmark is mapped by another view: what waited for it corrects it now."""
    waiting, slam = state.waiting, state.slam
    at, size, d = state.register.offsets[index], state.register.sizes[index], 1
    point, H, z, value = np.zeros(4), np.zeros((2, 7)), np.zeros(2), np.zeros(2)
    for w in waiting_for(state, index):
        bring_up_to_date(slam)
        clone = waiting.clone[w]
        pose, kind, n = waiting.clones[clone], waiting.kind[w], slam.size[0]
        past, there = slam.mean[pose : pose + POSE], slam.mean[at : at + size]
        value[0] = waiting.value[w]
        foresee(kind, size, placed(waiting.mount[w], past), there, value, point, H, z)
        R = np.array([[waiting.variance[w], 0.0], [0.0, 0.0]])
        robot, step, row = waiting.robot[clone], waiting.step[clone], waiting.row[w]
        record(journal, OBSERVED, row, robot, step, index, -1, size, d, past, point, H, z, R)
        z[0] = moved(z, H, there, point, size, 0)
        rows, S = np.empty((d, n)), np.empty((d, d))
        project(slam.covariance, n, pose, at, size, H, d, rows)
        S[0, 0] = times_transposed(rows[0], pose, at, size, H, 0) + waiting.variance[w]
        correct(slam.mean, slam.covariance, n, rows, S, z, d, settings.poses)
        waiting.row[w] = -1
    free_clones(state)
