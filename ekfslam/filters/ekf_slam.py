"""EKF-SLAM: predict, associate, correct, extend.

The filter of Smith and Cheeseman 1987 (Solà, section 2; Ciatto, Algorithm 1; Principles of Robot
Autonomy, 17.1) and its family, as one compiled loop; where they linearise, and what they take for
an error, is asked of `ekfslam.filters.variants`. `run` is the algorithm for identities that are
known and sightings that determine a point; the same parts with everything that needs more thought
are put together by `ekfslam.filters.engine`.
"""

from __future__ import annotations

import numpy as np

from ekfslam.compiled import compiled, inlined, lean, now
from ekfslam.estimates import Decision
from ekfslam.filters.delayed import delays, exact_rows, make_place, reduce_large
from ekfslam.filters.initiation import extend
from ekfslam.filters.kernels import downdate, move, project, solve, times_transposed
from ekfslam.filters.measure import BANKED, POINT, POSE, foresee, moved, placed, rows_of
from ekfslam.filters.options import KNOWN
from ekfslam.filters.recognition import by_identity
from ekfslam.filters.variants import (
    AT_ESTIMATES,
    OF_THEIR_OWN,
    ROBOCENTRIC,
    foresee_at,
    move_elsewhere,
    retract,
    settle_pose,
)
from ekfslam.filters.variants.iterated import foresee_again, iterate
from ekfslam.filters.variants.robocentric import compose
from ekfslam.observations import WIDTH

ACCEPTED, REJECTED = int(Decision.ACCEPTED), int(Decision.REJECTED)
DONE, GROW, INDEFINITE, LOOK = range(4)


@lean
def run(start, stop, deltas, Qs, offsets, sightings, slam, register, settings, log, other):  # type: ignore[no-untyped-def]
    """Steps from `start` to before `stop`; returns the step at which it stopped, and why.

    Why is `DONE`; `GROW` for a map that must grow first; `INDEFINITE` for an innovation covariance
    that is not positive definite; or `LOOK` for observations that need more than this loop offers,
    after the motion. `other` is None for the plain filter, so that nothing of its family is
    compiled with it.
    """
    for k in range(start, stop):
        begin = now()
        first, last = offsets[k], offsets[k + 1]
        if not has_room(slam, register, sightings, first, last, settings):
            return k, GROW
        if other is None or settings.variant in AT_ESTIMATES:
            predict(slam, deltas[:, k], Qs[:, k])
        else:
            moves = deltas[:, k], Qs[:, k]
            predict_elsewhere(slam, *moves, k, register, sightings, first, last, settings)
        log.nis[k] = 0.0
        if last > first and not settings.plain:
            return k, LOOK
        while first < last:  # for each robot, for each sensor (Solà, 2.4): a look
            until = end_of_look(sightings, first, last) if settings.scan else first + 1
            by_identity(register, sightings, first, until, settings, log)
            nis, dof = update(slam, register, sightings, first, until, settings, log, other)
            if np.isnan(nis):  # what failed leaves nothing behind
                log.decision[first:until], log.landmark[first:until] = REJECTED, -1
                return k, INDEFINITE
            log.nis[k] += nis
            log.dof[k] += dof
            extend(slam, register, sightings, first, until, settings, log)
            first = until
        write_step(slam, k, settings, log)
        if other is not None and settings.variant in OF_THEIR_OWN:
            settle_pose(settings.variant, slam, log.poses[0, k], log.covariances[0, k])
        log.seconds[k] = now() - begin
    return stop, DONE


@inlined
def has_room(slam, register, sightings, first, last, settings):  # type: ignore[no-untyped-def]
    """Whether map, register and workspace have room for a step with such observations."""
    # A step adds at most what its observations add, and a past pose of each robot.
    needed = slam.size[0] + settings.largest * (last - first) + POSE * settings.poses
    if min(needed, settings.most) > slam.mean.size:
        return False
    most = WIDTH * (last - first if settings.joint else 1)
    if most > slam.workspace.innovation.size and settings.plain:
        most = WIDTH * mapped_at_most(register, sightings, first, last)
    slam.workspace.wanted[0] = most
    if most > slam.workspace.innovation.size:
        return False
    return settings.method == KNOWN or register.used[0] + last - first <= register.offsets.size


@inlined
def mapped_at_most(register, sightings, first, last):  # type: ignore[no-untyped-def]
    """How many sightings of a step can correct at once: not what a single look shows newly."""
    if sightings.look[first] != sightings.look[last - 1]:
        return last - first
    count = 0
    for i in range(first, last):
        index = sightings.landmark[i]
        if sightings.target[i] >= 0 or (index >= 0 and register.offsets[index] >= 0):
            count += 1
    return count


@inlined
def write_step(slam, k, settings, log):  # type: ignore[no-untyped-def]
    """Note poses and covariances of a step."""
    mean, P, poses, covariances = slam.mean, slam.covariance, log.poses, log.covariances
    for robot in range(settings.robots):
        at = POSE * robot
        for i in range(POSE):
            poses[robot, k, i] = mean[at + i]
            for j in range(i, POSE):
                covariances[robot, k, i, j] = covariances[robot, k, j, i] = P[at + i, at + j]
    if log.dof[k] == 0:
        log.nis[k] = np.nan


@inlined
def predict(slam, deltas, Qs):  # type: ignore[no-untyped-def]
    """The robots move (Solà, 2.3.2; Ciatto, 3.3)."""
    for robot in range(deltas.shape[0]):
        at = POSE * robot
        move(slam.mean, slam.covariance, slam.size[0], at, deltas[robot], Qs[robot])


@compiled
def predict_elsewhere(slam, deltas, Qs, k, register, sightings, first, last, settings):  # type: ignore[no-untyped-def]
    """The robots move, not linearised at the estimate, before they see the rows first to last."""
    for robot in range(deltas.shape[0]):
        seen = mapped(register, sightings, first, last, settings)
        move_elsewhere(settings.variant, slam, POSE * robot, deltas[robot], Qs[robot], k, seen)


@compiled
def mapped(register, sightings, first, last, settings):  # type: ignore[no-untyped-def]
    """Offsets of the mapped landmarks that are seen next; of all, if it is not known which."""
    known, used = settings.method == KNOWN, register.used[0]
    next_ = np.full(used, not known)
    for i in range(first, last):
        if known and 0 <= sightings.landmark[i] < used:
            next_[sightings.landmark[i]] = True
    offsets = register.offsets[:used]
    return offsets[next_ & (offsets >= 0)]


@inlined
def end_of_look(sightings, first, last):  # type: ignore[no-untyped-def]
    """Row after the last of what one sensor saw at one instant."""
    end = first + 1
    while end < last and sightings.look[end] == sightings.look[first]:
        end += 1
    return end


@inlined
def update(slam, register, sightings, first, last, settings, log, other):  # type: ignore[no-untyped-def]
    """Correct with what is seen again, jointly or one after another (Solà, 2.3.3).

    Not with observations of a bank of hypotheses, which weighs for itself. The workspace must be
    large enough, see `has_room` and `widen` of the map. Returns the squared Mahalanobis norm of
    the innovations, NaN if their covariance was not positive definite, and how many rows they have.
    """
    accepted, sizes = 0, register.sizes
    for i in range(first, last):
        index = log.landmark[i]
        if log.decision[i] == ACCEPTED and (index < 0 or sizes[index] != BANKED):
            accepted += 1
    total, dof, start = 0.0, 0, first if accepted > 0 else last
    n, variant, workspace = slam.size[0], settings.variant, slam.workspace
    most = rows_of(sightings.kind[first]) * (accepted if settings.joint else 1)
    S, z, step, rows = workspace.S, workspace.innovation, workspace.step, workspace.rows
    large = n >= settings.delay_from
    waits = large and delays(slam, most, settings)
    while start < last:
        if waits:
            make_place(slam, most)
            rows = slam.late[slam.held[0] :]
        stop, m, nis = last if settings.joint else start + 1, 0, 0.0
        for iteration in range(settings.iterations):
            again = iteration > 0
            m = stack(
                slam,
                register,
                sightings,
                start,
                stop,
                again,
                rows,
                workspace,
                settings,
                log,
                other,
            )
            if m == 0:
                break
            nis = solve(rows, S, z, m, n, step)
            if np.isnan(nis):
                break
            if not again:
                total += nis
                dof += m
            if other is None or settings.iterations == 1:
                break
            if iterate(slam.mean, slam.points.at, step, n, again) < settings.tolerance:
                break
        if np.isnan(nis):
            total = np.nan
            break
        if m > 0:
            retract(variant, slam.mean, step, n, settings.poses)
            if large:
                reduce_large(slam, rows, m, POSE * settings.poses, waits)
            else:
                downdate(slam.covariance, rows, m, n)
        start = stop
    if other is not None and variant == ROBOCENTRIC:
        compose(slam.mean, slam.covariance, n)
    return total, dof


@inlined
def stack(  # type: ignore[no-untyped-def]
    slam, register, sightings, first, last, again, rows, workspace, settings, log, other
):
    """``H P``, ``S = H P H' + R`` (its lower triangle) and innovations of accepted observations.

    Parameters
    ----------
    first, last : int
        Rows of a look.
    rows : (m, >= n) ndarray
        Written: H P.
    other : None or bool
        None for the plain filter, see `run`.
    again : bool
        Whether this is not the first iteration of an iterated correction.

    Returns
    -------
    int
        How many numbers were observed.
    """
    # Taken from their tuples once: in the loop every access would count references.
    mean, P, n = slam.mean, slam.covariance, slam.size[0]
    offsets, own_sizes = register.offsets, register.sizes
    used, rejections = register.sightings, register.rejections
    values, R, target = sightings.values, sightings.covariance, sightings.target
    decision, landmark, innovation, spread = log.decision, log.landmark, log.innovation, log.S
    kind, mount, pose = sightings.kind[first], sightings.mount[first], POSE * sightings.robot[first]
    d, variant = rows_of(kind), settings.variant
    sensor = placed(mount, mean[pose : pose + POSE])
    S, z, H, point, nu = (
        workspace.S,
        workspace.innovation,
        workspace.H,
        workspace.one[:6],
        workspace.one[6:],
    )
    places, sizes, which = workspace.targets[0], workspace.targets[1], workspace.targets[2]
    m = 0
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
        h = H[m]
        value, seen = values[i], True
        if other is None:
            seen = foresee(kind, size, sensor, mean[at : at + size], value, point, h, nu)
        else:
            points = slam.points.at
            elsewhere = placed(mount, points[pose : pose + POSE])
            if again:
                foresee_again(kind, size, elsewhere, mean, points, pose, at, value, h, nu)
            else:
                seen = foresee_at(
                    variant, mean, points, sensor, elsewhere, at, size, kind, value, point, h, nu
                )
        if not seen:
            decision[i] = REJECTED  # an inverse depth that has no distance to compare with
            continue
        if size > POINT and not again:
            there = mean[at : at + size]
            for a in range(d):
                nu[a] = moved(nu, h, there, point, size, a)
        project(P, n, pose, at, size, h, d, rows[d * m : d * m + d])
        places[m], sizes[m], which[m] = at, size, i
        for a in range(d):
            z[d * m + a] = nu[a]
        if index >= 0 and not again:
            used[index] += 1
            rejections[index] = 0
        m += 1
    if n >= settings.delay_from and slam.held[0] > 0:
        exact_rows(slam.late, slam.held[0], n, H, places, sizes, m, d, rows)
    for k in range(m):
        i = which[k]
        for j in range(k + 1):
            before, place, width = H[j], places[j], sizes[j]
            for a in range(d):
                row = rows[d * k + a]
                for b in range(d):
                    entry = times_transposed(row, pose, place, width, before, b)
                    S[d * k + a, d * j + b] = entry
        for a in range(d):
            for b in range(d):
                S[d * k + a, d * k + b] += R[i, a, b]
        if not again:
            for a in range(d):
                innovation[i, a] = z[d * k + a]
                for b in range(d):
                    spread[i, a, b] = S[d * k + a, d * k + b]
    return d * m
