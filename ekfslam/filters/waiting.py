"""Ranges that wait: past poses stay in the state until they determine the landmark.

The delayed initiation of a landmark from partial observations, without an approximation beyond the
filter's own: a clone of the pose that a range was taken from keeps its correlations with all else.
"""

from __future__ import annotations

import math

import numpy as np

from ekfslam.compiled import compiled
from ekfslam.estimates import Decision, Linearizations
from ekfslam.filters.journal import record
from ekfslam.filters.kernels import append, correct, project, times_transposed
from ekfslam.filters.measure import POINT, POSE, expect, foresee, innovate, moved
from ekfslam.filters.upkeep import drop
from ekfslam.models.landmarks import fix

NEW, REJECTED, KEPT = int(Decision.NEW), int(Decision.REJECTED), int(Decision.DELAYED)
OBSERVED, CREATED = Linearizations.OBSERVED, Linearizations.CREATED
MOST = 40  # ranges that wait for one landmark; the oldest goes
APART = 0.05  # share of its range by which the sensor must have moved for the next one to wait


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
    if place < 0 or clone < 0:
        return
    log.decision[i] = KEPT
    waiting.row[place], waiting.index[place], waiting.clone[place] = i, index, clone
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
    """Whether the sensor has moved since the last range of this landmark that waits."""
    waiting = state.waiting
    here, there = np.empty(3), np.empty(3)
    sensor_frame(state, POSE * robot, mount, here)
    for w in range(waiting.row.size):
        if waiting.row[w] >= 0 and waiting.index[w] == index:
            sensor_frame(state, waiting.clones[waiting.clone[w]], waiting.mount[w], there)
            if math.hypot(here[0] - there[0], here[1] - there[1]) < APART * distance:
                return False
    return True


@compiled
def free_place(state, index):  # type: ignore[no-untyped-def]
    """A place among what waits, of the oldest if the landmark has `MOST`; -1 if there is none."""
    waiting = state.waiting
    free, count, oldest = -1, 0, -1
    for w in range(waiting.row.size):
        if waiting.row[w] < 0:
            free = w
        elif waiting.index[w] == index:
            count += 1
            step = waiting.step[waiting.clone[w]]
            if oldest < 0 or step < waiting.step[waiting.clone[oldest]]:
                oldest = w
    if count >= MOST:
        waiting.row[oldest] = -1
        free_clones(state)
        return oldest
    return free


@compiled
def clone_of(state, robot):  # type: ignore[no-untyped-def]
    """The clone of a robot's present pose, made if needed; -1 if there is no room."""
    waiting, slam, now = state.waiting, state.slam, state.clock[0]
    free = -1
    for c in range(waiting.clones.size):
        if waiting.clones[c] < 0:
            free = c
        elif waiting.step[c] == now and waiting.robot[c] == robot:
            return c
    if free >= 0:
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
        if waiting.row[w] >= 0 and waiting.index[w] == index:
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

    Two sightings from two past poses make the point exactly (the limit of an infinite prior,
    without its loss of digits); the others then correct it.
    """
    waiting, slam, register = state.waiting, state.slam, state.register
    places = waiting_for(state, index)
    m = places.size
    kinds, values = np.empty(m, np.int64), np.zeros((m, 2))
    frames, variances = np.empty((m, 3)), np.empty(m)
    for k in range(m):
        w = places[k]
        kinds[k], values[k, 0], variances[k] = (
            waiting.kind[w],
            waiting.value[w],
            waiting.variance[w],
        )
        sensor_frame(state, waiting.clones[waiting.clone[w]], waiting.mount[w], frames[k])
    determined, x, y, _, _, _ = fix(kinds, frames, values, variances)
    if not determined:
        return False
    point = np.array([x, y, 0.0, 0.0])
    H, z, expected = np.zeros((m, 2, 7)), np.zeros((m, 2)), np.zeros(2)
    for k in range(m):
        w = places[k]
        at = waiting.clones[waiting.clone[w]]
        pose = slam.mean[at : at + POSE]
        expect(kinds[k], POINT, waiting.mount[w], pose, point[:2], expected, H[k])
        innovate(kinds[k], values[k], expected, z[k])
    first, second, best = 0, 1, -1.0
    for k in range(m):
        for other in range(k):
            area = abs(H[k, 0, 3] * H[other, 0, 4] - H[k, 0, 4] * H[other, 0, 3])
            if area / math.sqrt(variances[k] * variances[other]) > best:
                best = area / math.sqrt(variances[k] * variances[other])
                first, second = other, k
    pair = np.array([first, second])
    determinant = H[first, 0, 3] * H[second, 0, 4] - H[first, 0, 4] * H[second, 0, 3]
    inverse = np.array(
        [
            [H[second, 0, 4] / determinant, -H[first, 0, 4] / determinant],
            [-H[second, 0, 3] / determinant, H[first, 0, 3] / determinant],
        ]
    )
    G, noise, poses = np.zeros((2, 4, POSE)), np.zeros((4, 4)), np.empty(2, np.int64)
    target = point.copy()
    for k in range(2):
        row = pair[k]
        poses[k] = waiting.clones[waiting.clone[places[row]]]
        for a in range(POINT):
            target[a] += inverse[a, k] * z[row, 0]
            for c in range(POSE):
                G[k, a, c] = -inverse[a, k] * H[row, 0, c]
            for b in range(POINT):
                noise[a, b] += inverse[a, k] * variances[row] * inverse[b, k]
    n = slam.size[0]
    # The landmark has no prior: the journal creates it without an equation of its own.
    robot, step = waiting.robot[waiting.clone[places[0]]], waiting.step[waiting.clone[places[0]]]
    here, row = slam.mean[:POSE], waiting.row[places[m - 1]]
    record(journal, CREATED, row, robot, step, index, -1, POINT, 0, here, point, H[0], z[0], noise)
    for k in range(m):
        w = places[k]
        clone = waiting.clone[w]
        at, R = waiting.clones[clone], np.array([[variances[k], 0.0], [0.0, 0.0]])
        past = slam.mean[at : at + POSE]
        robot, step, row = waiting.robot[clone], waiting.step[clone], waiting.row[w]
        record(journal, OBSERVED, row, robot, step, index, -1, POINT, 1, past, point, H[k], z[k], R)
    append(slam.mean, slam.covariance, n, poses, target, POINT, G, noise)
    slam.size[0] = n + POINT
    register.offsets[index], register.sizes[index], register.sightings[index] = n, POINT, m
    register.spread[index] = math.sqrt(slam.covariance[n, n] + slam.covariance[n + 1, n + 1])
    linear_correction(state, places, pair, point, H, z, variances, n, settings)
    for k in range(m):
        waiting.row[places[k]] = -1
    free_clones(state)
    return True


@compiled
def linear_correction(state, places, skip, point, H, z, variances, at, settings):  # type: ignore[no-untyped-def]
    """Correct jointly with all sightings that wait for a landmark but those that made it.

    All are linearised at one point: the innovation is moved from there to the present mean.
    """
    waiting, slam = state.waiting, state.slam
    n, m = slam.size[0], places.size - skip.size
    if m == 0:
        return
    rows, S, nu = np.empty((m, n)), np.empty((m, m)), np.empty(m)
    used = np.empty(m, np.int64)
    count = 0
    for k in range(places.size):
        if k != skip[0] and k != skip[1]:
            used[count] = k
            count += 1
    for p in range(m):
        k = used[p]
        pose = waiting.clones[waiting.clone[places[k]]]
        project(slam.covariance, n, pose, at, POINT, H[k], 1, rows[p : p + 1])
        nu[p] = z[k, 0]
        for a in range(POINT):
            nu[p] -= H[k, 0, 3 + a] * (slam.mean[at + a] - point[a])
        for q in range(p + 1):
            other = used[q]
            past = waiting.clones[waiting.clone[places[other]]]
            S[p, q] = times_transposed(rows[p], past, at, POINT, H[other], 0)
        S[p, p] += variances[k]
    correct(slam.mean, slam.covariance, n, rows, S, nu, m, settings.robots)


@compiled
def use_waiting(state, index, settings, journal):  # type: ignore[no-untyped-def]
    """A landmark is mapped by another view: what waited for it corrects it now."""
    waiting, slam = state.waiting, state.slam
    at, size, d = state.register.offsets[index], state.register.sizes[index], 1
    point, H, z, value = np.zeros(4), np.zeros((2, 7)), np.zeros(2), np.zeros(2)
    for w in waiting_for(state, index):
        clone = waiting.clone[w]
        pose, kind, n = waiting.clones[clone], waiting.kind[w], slam.size[0]
        past, there = slam.mean[pose : pose + POSE], slam.mean[at : at + size]
        value[0] = waiting.value[w]
        foresee(kind, size, waiting.mount[w], past, there, value, point, H, z)
        R = np.array([[waiting.variance[w], 0.0], [0.0, 0.0]])
        robot, step, row = waiting.robot[clone], waiting.step[clone], waiting.row[w]
        record(journal, OBSERVED, row, robot, step, index, -1, size, d, past, point, H, z, R)
        z[0] = moved(z, H, there, point, size, 0)
        rows, S = np.empty((d, n)), np.empty((d, d))
        project(slam.covariance, n, pose, at, size, H, d, rows)
        S[0, 0] = times_transposed(rows[0], pose, at, size, H, 0) + waiting.variance[w]
        correct(slam.mean, slam.covariance, n, rows, S, z, d, settings.robots)
        waiting.row[w] = -1
    free_clones(state)
