"""EKF-SLAM: predict, associate, correct, extend.

The standard filter with Jacobians at the estimate (Smith and Cheeseman 1987; Solà, section 2;
Ciatto, Algorithm 1; Principles of Robot Autonomy, 17.1), as one compiled loop. `run` is the
algorithm for identities that are known and sightings that determine a point; the same parts with
everything that needs more thought are put together by `ekfslam.filters.engine`.
"""

from __future__ import annotations

import numpy as np

from ekfslam.compiled import compiled, inlined, now
from ekfslam.estimates import Decision
from ekfslam.filters.initiation import extend
from ekfslam.filters.kernels import correct, move, project, times_transposed
from ekfslam.filters.measure import BANKED, POINT, POSE, foresee, moved, rows_of
from ekfslam.filters.options import KNOWN
from ekfslam.filters.recognition import by_identity

ACCEPTED, REJECTED = int(Decision.ACCEPTED), int(Decision.REJECTED)
DONE, GROW, INDEFINITE, LOOK = range(4)


@compiled
def run(start, stop, deltas, Qs, offsets, sightings, slam, register, settings, log):  # type: ignore[no-untyped-def]
    """Steps from `start` to before `stop`; returns the step at which it stopped, and why.

    Why is `DONE`; `GROW` for a map that must grow first; `INDEFINITE` for an innovation covariance
    that is not positive definite; or `LOOK` for observations that need more than this loop offers,
    after the motion.
    """
    for k in range(start, stop):
        begin = now()
        first, last = offsets[k], offsets[k + 1]
        if not has_room(slam, register, last - first, settings):
            return k, GROW
        predict(slam, deltas[:, k], Qs[:, k])
        log.nis[k] = 0.0
        if last > first and not settings.plain:
            return k, LOOK
        while first < last:  # for each robot, for each sensor (Solà, 2.4): a look
            until = end_of_look(sightings, first, last) if settings.scan else first + 1
            by_identity(register, sightings, first, until, settings, log)
            nis, dof = update(slam, register, sightings, first, until, settings, log)
            if np.isnan(nis):
                return k, INDEFINITE
            log.nis[k] += nis
            log.dof[k] += dof
            extend(slam, register, sightings, first, until, settings, log)
            first = until
        write_step(slam, k, settings, log)
        log.seconds[k] = now() - begin
    return stop, DONE


@inlined
def has_room(slam, register, rows, settings):  # type: ignore[no-untyped-def]
    """Whether the map and the register have room for a step with so many observations."""
    # A step adds at most what its observations add, and a past pose of each robot.
    needed = slam.size[0] + settings.largest * rows + POSE * settings.robots
    if min(needed, settings.most) > slam.mean.size:
        return False
    return settings.method == KNOWN or register.used[0] + rows <= register.offsets.size


@inlined
def write_step(slam, k, settings, log):  # type: ignore[no-untyped-def]
    """Note poses and covariances of a step."""
    for robot in range(settings.robots):
        at = POSE * robot
        log.poses[robot, k] = slam.mean[at : at + POSE]
        for i in range(POSE):
            for j in range(i, POSE):
                value = slam.covariance[at + i, at + j]
                log.covariances[robot, k, i, j] = log.covariances[robot, k, j, i] = value
    if log.dof[k] == 0:
        log.nis[k] = np.nan


@inlined
def predict(slam, deltas, Qs):  # type: ignore[no-untyped-def]
    """The robots move (Solà, 2.3.2; Ciatto, 3.3)."""
    for robot in range(deltas.shape[0]):
        at = POSE * robot
        move(slam.mean, slam.covariance, slam.size[0], at, deltas[robot], Qs[robot])


@inlined
def end_of_look(sightings, first, last):  # type: ignore[no-untyped-def]
    """Row after the last of what one sensor saw at one instant."""
    end = first + 1
    while end < last and sightings.look[end] == sightings.look[first]:
        end += 1
    return end


@inlined
def update(slam, register, sightings, first, last, settings, log):  # type: ignore[no-untyped-def]
    """Correct with what is seen again, jointly or one after another (Solà, 2.3.3).

    Returns the squared Mahalanobis norm of the innovations, NaN if their covariance was not
    positive definite, and how many rows they have.
    """
    accepted, sizes = 0, register.sizes
    for i in range(first, last):
        index = log.landmark[i]
        if log.decision[i] == ACCEPTED and (index < 0 or sizes[index] != BANKED):
            accepted += 1
    total, dof = 0.0, 0
    if accepted > 0:
        joint, robots = settings.joint, settings.robots
        total, dof = correct_mapped(
            slam, register, sightings, first, last, accepted, joint, robots, log
        )
    return total, dof


@inlined
def correct_mapped(slam, register, sightings, first, last, accepted, joint, robots, log):  # type: ignore[no-untyped-def]
    """Correct with the accepted observations of a look, but not those of a bank of hypotheses."""
    # Taken from their tuples once: in the loop every access would count references.
    mean, P, n = slam.mean, slam.covariance, slam.size[0]
    offsets, own_sizes = register.offsets, register.sizes
    used, rejections = register.sightings, register.rejections
    values, R, target = sightings.values, sightings.covariance, sightings.target
    decision, landmark, innovation, spread = log.decision, log.landmark, log.innovation, log.S
    kind, mount, pose = sightings.kind[first], sightings.mount[first], POSE * sightings.robot[first]
    d, together = rows_of(kind), accepted if joint else 1
    rows = np.empty((d * together, n))
    S, z = np.empty((d * together, d * together)), np.empty(d * together)
    H, point = np.empty((together, 2, 7)), np.empty(4)
    places, sizes = np.empty(together, np.int64), np.empty(together, np.int64)
    total, dof, m, left = 0.0, 0, 0, accepted
    for i in range(first, last):
        if decision[i] != ACCEPTED:
            continue
        index = landmark[i]
        if index >= 0:
            at, size = offsets[index], own_sizes[index]
        else:  # another robot
            at, size = POSE * target[i], POSE
        if size == BANKED:
            continue
        left -= 1
        here, there, nu, h = mean[pose : pose + POSE], mean[at : at + size], innovation[i], H[m]
        if foresee(kind, size, mount, here, there, values[i], point, h, nu):
            if size > POINT:
                for a in range(d):
                    nu[a] = moved(nu, h, there, point, size, a)
            project(P, n, pose, at, size, h, d, rows[d * m : d * m + d])
            places[m], sizes[m] = at, size
            for j in range(m + 1):  # S = H P H' + R, lower triangle of blocks
                other, place, width = H[j], places[j], sizes[j]
                for a in range(d):
                    row = rows[d * m + a]
                    for b in range(d):
                        entry = times_transposed(row, pose, place, width, other, b)
                        S[d * m + a, d * j + b] = entry
            for a in range(d):
                z[d * m + a] = nu[a]
                for b in range(d):
                    S[d * m + a, d * m + b] += R[i, a, b]
                    spread[i, a, b] = S[d * m + a, d * m + b]
            if index >= 0:
                used[index] += 1
                rejections[index] = 0
            m += 1
        else:  # an inverse depth that has no distance to compare with
            decision[i] = REJECTED
        if m == together or (left == 0 and m > 0):
            total += correct(mean, P, n, rows, S, z, d * m, robots)
            dof += d * m
            m = 0
    return total, dof
