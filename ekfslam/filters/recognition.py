"""Recognition: who is seen (Ciatto, 3.6), from innovations at the state that the look begins with.

The decisions themselves are in `ekfslam.association` and know no filter; what they decide on is in
`ekfslam.filters.evidence`, and what follows from what they decided is here.
"""

from __future__ import annotations

import numpy as np

from ekfslam.association.joint import joint_compatibility
from ekfslam.association.nearest import (
    AMBIGUOUS,
    first_within,
    maximum_likelihood,
    nearest_neighbour,
    nearest_within,
    smallest_distance,
)
from ekfslam.compiled import compiled, inlined
from ekfslam.estimates import Decision
from ekfslam.filters.evidence import against, cross, gather
from ekfslam.filters.measure import BANKED, POINT, locate, moved, placed, rows_of
from ekfslam.filters.options import (
    ALLOCATED,
    EUCLIDEAN,
    EUCLIDEAN_FIRST,
    KNOWN,
    MAHALANOBIS_FIRST,
    MAXIMUM_LIKELIHOOD,
    NEAREST,
    SMALLEST_DISTANCE,
)
from ekfslam.filters.variants import INVARIANT, foresee_at
from ekfslam.filters.variants.right_invariant import additive

ACCEPTED, NEW = int(Decision.ACCEPTED), int(Decision.NEW)
REJECTED, UNSURE = int(Decision.REJECTED), int(Decision.AMBIGUOUS)
TENTATIVE = int(Decision.TENTATIVE)


# Identities known from outside -------------------------------------------------------------------


@inlined
def by_identity(register, sightings, first, last, settings, log):  # type: ignore[no-untyped-def]
    """Take the identities of the data."""
    for i in range(first, last):
        index = sightings.landmark[i]
        log.landmark[i] = index
        if sightings.target[i] >= 0:
            log.decision[i] = ACCEPTED
            continue
        if index < 0:
            log.decision[i] = REJECTED  # association is known, and this one has no identity
            continue
        register.used[0] = max(register.used[0], index + 1)
        mapped = register.offsets[index] >= 0
        if settings.initiation == ALLOCATED and register.sightings[index] == 0:
            mapped = False
        log.decision[i] = ACCEPTED if mapped or register.sizes[index] == BANKED else NEW


# Identities found --------------------------------------------------------------------------------


@compiled
def recognise(state, sightings, first, last, settings, log):  # type: ignore[no-untyped-def]
    """Who is seen in a look: identities that pass the gate, or what the method decides."""
    if settings.method == KNOWN:
        by_identity(state.register, sightings, first, last, settings, log)
        for i in range(first, last):
            index = log.landmark[i]
            if log.decision[i] == ACCEPTED and index >= 0 and settings.known[1] > 0.0:
                verify(state, sightings, i, settings, log)
        return
    robots_seen(sightings, first, last, log)
    evidence = gather(state, sightings, first, last, settings)
    choice = np.empty(evidence.rows.size, np.int64)
    decide(evidence, settings, choice)
    settle(state, sightings, evidence, choice, settings, log)


@compiled
def verify(state, sightings, i, settings, log):  # type: ignore[no-untyped-def]
    """Individual compatibility (Solà, C.3) of a sighting whose identity is known."""
    slam, register = state.slam, state.register
    index, kind, pose = log.landmark[i], sightings.kind[i], 3 * sightings.robot[i]
    if register.offsets[index] < 0:  # a bank weighs for itself
        return
    at, size, d = register.offsets[index], register.sizes[index], rows_of(kind)
    point, H, S = np.empty(6), np.empty((2, 7)), np.empty((2, 2))
    mean, points, there = slam.mean, slam.points.at, slam.mean[at : at + size]
    value, mount, nu = sightings.values[i], sightings.mount[i], log.innovation[i]
    sensor = placed(mount, mean[pose : pose + 3])
    elsewhere, variant = placed(mount, points[pose : pose + 3]), settings.variant
    if not foresee_at(
        variant, mean, points, sensor, elsewhere, at, size, kind, value, point, H, nu
    ):
        log.decision[i] = REJECTED
        return
    for a in range(d):
        nu[a] = moved(nu, H, there, point, size, a)
    P, late, held = slam.covariance, slam.late, slam.held[0]
    cross(P, late, held, pose, at, size, H, at, size, H, d, S)
    distance, _ = against(nu, S, sightings.covariance[i], d)
    log.S[i, :d, :d] = S[:d, :d] + sightings.covariance[i, :d, :d]
    if not distance <= settings.known[d]:
        log.decision[i] = REJECTED


@compiled
def decide(evidence, settings, choice):  # type: ignore[no-untyped-def]
    """Ask the method for its decision; the global ones are asked from Python instead."""
    distances, accept, new = evidence.distances, evidence.accept, evidence.new
    if settings.method == NEAREST:
        nearest_neighbour(distances, accept, new, choice)
    elif settings.method == EUCLIDEAN:
        nearest_within(evidence.points, settings.threshold, choice)
    elif settings.method in (EUCLIDEAN_FIRST, MAHALANOBIS_FIRST):
        first_within(evidence.points, settings.threshold, choice)
    elif settings.method == SMALLEST_DISTANCE:
        # One alpha for a look, by the rows of its observations.
        smallest_distance(distances, accept[0] if accept.size > 0 else 0.0, choice)
    elif settings.method == MAXIMUM_LIKELIHOOD:
        maximum_likelihood(distances, evidence.logdets, accept, new, choice)


@compiled
def decide_jointly(state, sightings, evidence, settings, choice):  # type: ignore[no-untyped-def]
    """Lay out the individually compatible pairs, and search (Neira and Tardós 2001).

    Returns whether the search was complete.
    """
    register, mean, P = state.register, state.slam.mean, state.slam.covariance
    points, variant = state.slam.points.at, settings.variant
    late, held = state.slam.late, state.slam.held[0]
    distances, candidates, rows = evidence.distances, evidence.candidates, evidence.rows
    m = rows.size
    if m == 0:
        return True
    kind, pose = sightings.kind[rows[0]], 3 * sightings.robot[rows[0]]
    mount, d = sightings.mount[rows[0]], rows_of(kind)
    sensor = placed(mount, mean[pose : pose + 3])
    elsewhere = placed(mount, points[pose : pose + 3])
    pairs = 0
    for k in range(m):
        for j in range(candidates.size):
            pairs += distances[k, j] <= evidence.accept[k]
    row, column = np.empty(pairs, np.int64), np.empty(pairs, np.int64)
    innovations = np.zeros(2 * pairs)
    H, point, pairs = np.empty((pairs, 2, 7)), np.empty(6), 0
    for k in range(m):
        for j in range(candidates.size):
            if distances[k, j] <= evidence.accept[k]:
                i, at = rows[k], register.offsets[candidates[j]]
                size = register.sizes[candidates[j]]
                there, h = mean[at : at + size], H[pairs]
                nu, value = innovations[2 * pairs : 2 * pairs + 2], sightings.values[i]
                foresee_at(
                    variant, mean, points, sensor, elsewhere, at, size, kind, value, point, h, nu
                )
                for a in range(d):
                    nu[a] = moved(nu, H[pairs], there, point, size, a)
                row[pairs], column[pairs] = k, j
                pairs += 1
    joint, block = np.zeros((2 * pairs, 2 * pairs)), np.empty((2, 2))
    for p in range(pairs):
        one = candidates[column[p]]
        for q in range(p + 1):
            two = candidates[column[q]]
            cross(
                P,
                late,
                held,
                pose,
                register.offsets[one],
                register.sizes[one],
                H[p],
                register.offsets[two],
                register.sizes[two],
                H[q],
                d,
                block,
            )
            for a in range(d):
                for b in range(d):
                    joint[2 * p + a, 2 * q + b] = joint[2 * q + b, 2 * p + a] = block[a, b]
    noise = np.empty((m, 2, 2))
    for k in range(m):
        noise[k] = sightings.covariance[rows[k]]
    return joint_compatibility(
        row,
        column,
        innovations,
        np.full(pairs, d),
        joint,
        noise,
        distances,
        evidence.accept,
        evidence.new,
        settings.compatible,
        settings.limit,
        choice,
    )


@compiled
def settle(state, sightings, evidence, choice, settings, log):  # type: ignore[no-untyped-def]
    """Write the decisions of a look down; what is new gets an index, or stays tentative."""
    register = state.register
    for k in range(evidence.rows.size):
        i = evidence.rows[k]
        if choice[k] >= 0:
            log.decision[i], log.landmark[i] = ACCEPTED, evidence.candidates[choice[k]]
        elif choice[k] == AMBIGUOUS:
            log.decision[i], log.landmark[i] = UNSURE, -1
        elif settings.confirm > 1 and not confirmed(state, sightings, i, settings):
            log.decision[i], log.landmark[i] = TENTATIVE, -1
        else:
            log.decision[i], log.landmark[i] = NEW, register.used[0]
            register.used[0] += 1


@inlined
def robots_seen(sightings, first, last, log):  # type: ignore[no-untyped-def]
    """Sightings of robots know whom they show."""
    for i in range(first, last):
        if sightings.target[i] >= 0:
            log.decision[i], log.landmark[i] = ACCEPTED, -1


@compiled
def confirmed(state, sightings, i, settings):  # type: ignore[no-untyped-def]
    """Whether a new thing has now been seen often enough; if not, it is kept in mind.

    A sighting belongs to the nearest tentative thing inside the gate of `accept`, in the sum of
    both covariances: they share the robot's uncertainty, so this is cautious. Only the last
    sighting, the one that confirms, makes the landmark.
    """
    mean, P = state.slam.mean, state.slam.covariance
    things, now = state.tentative, state.clock[0]
    pose = 3 * sightings.robot[i]
    where, G, noise = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
    here, mount = mean[pose : pose + 3], sightings.mount[i]
    value, R = sightings.values[i], sightings.covariance[i]
    locate(sightings.kind[i], mount, here, value, R, where, G, noise)
    block = np.empty((3, 3))
    if settings.variant == INVARIANT:
        additive(mean, P, 0, 3, block)
    else:
        for j in range(3):
            for k in range(3):
                block[j, k] = P[pose + min(j, k), pose + max(j, k)]
    for a in range(POINT):
        for b in range(POINT):
            for j in range(3):
                for k in range(3):
                    noise[a, b] += G[a, j] * block[j, k] * G[b, k]
    apart = np.empty(2)
    best, nearest, free = -1, settings.accept[2], -1
    for t in range(things.sightings.size):
        if things.sightings[t] > 0 and now - things.born[t] >= settings.within:
            things.sightings[t] = 0  # not seen often enough in time
        if things.sightings[t] == 0:
            free = t if free < 0 else free
            continue
        apart[0], apart[1] = where[0] - things.position[t, 0], where[1] - things.position[t, 1]
        squared, _ = against(apart, things.covariance[t], noise, POINT)
        if squared <= nearest and things.seen[t] != now:  # once a step
            best, nearest = t, squared
    if best < 0:
        if free >= 0:
            things.sightings[free], things.born[free], things.seen[free] = 1, now, now
            things.position[free], things.covariance[free] = where, noise
        return False
    things.sightings[best] += 1
    things.seen[best] = now
    things.position[best], things.covariance[best] = where, noise
    if things.sightings[best] < settings.confirm:
        return False
    things.sightings[best] = 0
    return True
