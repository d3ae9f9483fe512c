"""EKF-SLAM: predict, associate, correct, extend, forget.

The standard filter with Jacobians at the estimate (Smith and Cheeseman 1987; Solà, section 2;
Ciatto, Algorithm 1; Principles of Robot Autonomy, 17.1), as one compiled loop. `run` is the
algorithm; `ekfslam.filters.ekf` calls it over a dataset, or its parts step by step.
"""

from __future__ import annotations

import numpy as np

from ekfslam.compiled import compiled, now
from ekfslam.estimates import Decision, Linearizations
from ekfslam.filters.initiation import extend, starts_as_point
from ekfslam.filters.journal import record
from ekfslam.filters.kernels import correct, move, project, times_transposed
from ekfslam.filters.measure import BANKED, POINT, POSE, foresee, moved, rows_of
from ekfslam.filters.options import KNOWN
from ekfslam.filters.recognition import by_identity

ACCEPTED, NEW, REJECTED = int(Decision.ACCEPTED), int(Decision.NEW), int(Decision.REJECTED)
OBSERVED = Linearizations.OBSERVED
DONE, GROW, INDEFINITE, LOOK, PARTIAL = range(5)


@compiled
def run(start, row, stop, deltas, Qs, offsets, sightings, state, settings, log, journal):  # type: ignore[no-untyped-def]
    """Steps from `start` to before `stop`; returns the step and row at which it stopped, and why.

    Why is `DONE`; `GROW` for a map that must grow first; `INDEFINITE` for an innovation covariance
    that is not positive definite; or what `ekfslam.filters.engine` has to do for the look at that
    row: all of it (`LOOK`), or what is left of it (`PARTIAL`). A row that is not -1 is where to go
    on within `start`.
    """
    for k in range(start, stop):
        begin = now()
        first, last = offsets[k], offsets[k + 1]
        if row >= 0:
            first = row
        elif has_room(state, last - first, settings):
            predict(state, k, deltas[:, k], Qs[:, k])
            log.nis[k], log.seconds[k] = 0.0, 0.0
        else:
            return k, -1, GROW
        at, why = observe(state, sightings, first, last, k, settings, log, journal)
        if why != DONE:
            log.seconds[k] += now() - begin
            return k, at, why
        write_step(state, k, settings, log)
        log.seconds[k] += now() - begin
        row = -1
    return stop, -1, DONE


@compiled
def has_room(state, rows, settings):  # type: ignore[no-untyped-def]
    """Whether the map and the register have room for a step with so many observations."""
    slam, register = state.slam, state.register
    # A step adds at most what its observations add, and a past pose of each robot.
    needed = slam.size[0] + settings.largest * rows + POSE * settings.robots
    if min(needed, settings.most) > slam.mean.size:
        return False
    return settings.method == KNOWN or register.used[0] + rows <= register.offsets.size


@compiled
def write_step(state, k, settings, log):  # type: ignore[no-untyped-def]
    """Note poses and covariances of a step."""
    slam = state.slam
    for robot in range(settings.robots):
        at = POSE * robot
        log.poses[robot, k] = slam.mean[at : at + POSE]
        for i in range(POSE):
            for j in range(i, POSE):
                value = slam.covariance[at + i, at + j]
                log.covariances[robot, k, i, j] = log.covariances[robot, k, j, i] = value
    if log.dof[k] == 0:
        log.nis[k] = np.nan


@compiled
def predict(state, step, deltas, Qs):  # type: ignore[no-untyped-def]
    """The robots move (Solà, 2.3.2; Ciatto, 3.3)."""
    slam = state.slam
    state.clock[0] = step
    for robot in range(deltas.shape[0]):
        at = POSE * robot
        move(slam.mean, slam.covariance, slam.size[0], at, deltas[robot], Qs[robot])


@compiled
def observe(state, sightings, first, last, k, settings, log, journal):  # type: ignore[no-untyped-def]
    """For each robot, each sensor, each observation (Solà, 2.4): associate, correct, extend.

    It goes look by look: what one sensor saw at one instant. Returns the row that it came to, and
    why it stopped there, as `run` does; what the innovations of step k add up to is in the log.
    """
    while first < last:
        if not settings.plain:
            return first, LOOK
        until = end_of_look(sightings, first, last) if settings.scan else first + 1
        by_identity(state, sightings, first, until, settings, log)
        why = use(state, sightings, first, until, k, settings, log, journal)
        if why != DONE:
            return first, why
        first = until
    return last, DONE


@compiled
def end_of_look(sightings, first, last):  # type: ignore[no-untyped-def]
    """Row after the last of a look."""
    end = first + 1
    while end < last and sightings.look[end] == sightings.look[first]:
        end += 1
    return end


@compiled
def use(state, sightings, first, last, k, settings, log, journal):  # type: ignore[no-untyped-def]
    """Correct with what is mapped, extend by what is new (Ciatto, Algorithm 1).

    Returns `DONE`, `INDEFINITE`, or `PARTIAL` if there is more to do for this look.
    """
    nis, dof = update(state, sightings, first, last, settings, log, journal)
    if np.isnan(nis):
        return INDEFINITE
    log.nis[k] += nis
    log.dof[k] += dof
    extend(state, sightings, first, last, settings, log, journal)
    # What is not yet a point, or does not start as one, is seen to apart from this loop.
    for i in range(first, last):
        index = log.landmark[i]
        if index < 0:
            continue
        if log.decision[i] == NEW:
            if state.waiting.row.size > 0 or not starts_as_point(sightings.kind[i], settings):
                return PARTIAL
        elif state.register.sizes[index] == BANKED or state.register.sizes[index] > POINT:
            return PARTIAL
    return DONE


@compiled
def update(state, sightings, first, last, settings, log, journal):  # type: ignore[no-untyped-def]
    """Correct with what is seen again, jointly or one after another (Solà, 2.3.3).

    Returns the squared Mahalanobis norm of the innovations, and how many rows they have.
    """
    accepted = 0
    for i in range(first, last):
        index = log.landmark[i]
        if log.decision[i] == ACCEPTED and (index < 0 or state.register.sizes[index] != BANKED):
            accepted += 1
    if accepted == 0:
        return 0.0, 0
    register, slam = state.register, state.slam
    n, P, mean = slam.size[0], slam.covariance, slam.mean
    robot, kind, mount = sightings.robot[first], sightings.kind[first], sightings.mount[first]
    pose, d = POSE * robot, rows_of(kind)
    together = accepted if settings.joint else 1
    rows = np.empty((d * together, n))
    S, z = np.empty((d * together, d * together)), np.empty(d * together)
    H, point = np.empty((together, 2, 7)), np.empty(4)
    places, sizes = np.empty(together, np.int64), np.empty(together, np.int64)
    total, dof, m, left = 0.0, 0, 0, accepted
    for i in range(first, last):
        if log.decision[i] != ACCEPTED:
            continue
        index = log.landmark[i]
        if index >= 0:
            at, size = register.offsets[index], register.sizes[index]
        else:  # another robot
            at, size = POSE * sightings.target[i], POSE
        if size == BANKED:
            continue
        left -= 1
        here, there, nu = mean[pose : pose + POSE], mean[at : at + size], log.innovation[i]
        if foresee(kind, size, mount, here, there, sightings.values[i], point, H[m], nu):
            record(
                journal,
                OBSERVED,
                i,
                robot,
                state.clock[0],
                index,
                sightings.target[i],
                size,
                d,
                here,
                point,
                H[m],
                nu,
                sightings.covariance[i],
            )
            if size > POINT:
                for a in range(d):
                    nu[a] = moved(nu, H[m], there, point, size, a)
            project(P, n, pose, at, size, H[m], d, rows[d * m : d * m + d])
            places[m], sizes[m] = at, size
            for j in range(m + 1):  # S = H P H' + R, lower triangle of blocks
                for a in range(d):
                    for b in range(d):
                        S[d * m + a, d * j + b] = times_transposed(
                            rows[d * m + a], pose, places[j], sizes[j], H[j], b
                        )
            for a in range(d):
                z[d * m + a] = log.innovation[i, a]
                for b in range(d):
                    S[d * m + a, d * m + b] += sightings.covariance[i, a, b]
                    log.S[i, a, b] = S[d * m + a, d * m + b]
            if index >= 0:
                register.sightings[index] += 1
                register.rejections[index] = 0
            m += 1
        else:  # an inverse depth that has no distance to compare with
            log.decision[i] = REJECTED
        if m == together or (left == 0 and m > 0):
            total += correct(mean, P, n, rows, S, z, d * m, settings.robots)
            dof += d * m
            m = 0
    return total, dof
