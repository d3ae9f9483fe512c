"""Who is seen, by each particle for itself, and which landmarks it should have seen.

A sighting z shows the landmark that makes it likeliest, or something new: the likelihood of that
is a constant p0 (Montemerlo and Thrun 2003). Here p0 is what a landmark that is known exactly gives
to a sighting at the gate, so that with g the gate a landmark is taken if

    d^2 + ln det S - ln det R <= g,

and a particle's weight does not jump where its decision turns. For a landmark that is known well
this is the gate on the squared Mahalanobis distance; the vaguer one is, the less it may be off.
"""

from __future__ import annotations

import math

import numpy as np

from ekfslam.association.nearest import NEW, nearest_neighbour
from ekfslam.compiled import compiled
from ekfslam.filters.fastslam.gaussians import (
    distance,
    innovation,
    inverse,
    spread,
    toward,
    view,
    wider,
)
from ekfslam.filters.fastslam.particles import PAGE, own_page, remove_landmark
from ekfslam.filters.kernels import wrap
from ekfslam.filters.measure import placed
from ekfslam.filters.visibility import SURE, surely_sees
from ekfslam.models.sensors import RANGE_BEARING

REJECTED, UNDECIDED = -3, -4  # beside NEW and AMBIGUOUS of `ekfslam.association`


@compiled
def by_identity(sightings, first, last, place, used, choice):  # type: ignore[no-untyped-def]
    """Index that the landmark of each row has in every particle's map; known identities.

    Parameters
    ----------
    place : (L,) ndarray of int
        Index of each identity, negative if it is not mapped; changed by what is new.
    used : int
        Landmarks that are mapped.
    choice : (>= last - first,) ndarray of int
        Written: an index, `NEW`, or `REJECTED` without identity. A landmark that is new in the same
        step before has the index that it is going to have.
    """
    for i in range(first, last):
        code = sightings.landmark[i]
        if code < 0:
            choice[i - first] = REJECTED
        elif place[code] < 0:
            place[code], choice[i - first] = used, NEW
            used += 1
        else:
            choice[i - first] = place[code]


@compiled
def likeliest(sightings, first, last, maps, particle, pose, P, gate, logdets, choice):  # type: ignore[no-untyped-def]
    """Decide on the rows of a look that are `UNDECIDED`, by maximum likelihood.

    One sensor sees a landmark once in a look: of two claims the likelier stands, and the other is
    ambiguous; what a row has been decided to show is out of the question for the others.

    Parameters
    ----------
    pose, P : (3,) and (3, 3) ndarray
        Of the particle; P is zero where its pose has been drawn.
    gate : float
        On the squared Mahalanobis distance.
    logdets : (M,) ndarray
        ln det R of each row.
    choice : (last - first,) ndarray of int
        Changed: an index, `NEW` or `AMBIGUOUS`.
    """
    open_rows = np.empty(choice.size, np.int64)
    m, reach, sigmas = 0, 0.0, math.sqrt(gate)
    for k in range(choice.size):
        if choice[k] == UNDECIDED:
            open_rows[m] = first + k
            reach = max(reach, farthest(sightings, first + k, sigmas))
            m += 1
    if m == 0:
        return
    kind, count = sightings.kind[first], maps.used[particle]
    sensor = placed(sightings.mount[first], pose)
    gates = np.full(m, gate)
    claims, candidates, n = np.empty((m, count)), np.empty(count, np.int64), 0
    lever_x, lever_y = sensor[4], sensor[5]
    # Trace of the covariance of the sensor's place, which the heading swings.
    own = P[0, 0] + P[1, 1] + 2.0 * (lever_x * P[1, 2] - lever_y * P[0, 2])
    own += P[2, 2] * (lever_x * lever_x + lever_y * lever_y)
    for index in range(count):
        page, place = maps.table[particle, index // PAGE], index % PAGE
        g = maps.gaussians[page, place]
        dx, dy = g[0] - sensor[0], g[1] - sensor[1]
        # Its distance alone is off by more than the gate allows.
        far = reach + sigmas * math.sqrt(max(g[2] + g[4] + own, 0.0))
        if dx * dx + dy * dy > far * far or taken(choice, index):
            continue
        seen = view(kind, sensor, g[0], g[1])
        PH = toward(seen, P)
        for k in range(m):
            i = open_rows[k]
            nu = innovation(kind, sightings.values[i], seen)
            inverted = inverse(wider(spread(seen, g, sightings.covariance[i]), seen, PH))
            claims[k, n] = distance(nu, inverted) + math.log(inverted[3]) - logdets[i]
        candidates[n] = index
        n += 1
    found = np.empty(m, np.int64)
    nearest_neighbour(claims[:, :n], gates, gates, found)
    for k in range(m):
        choice[open_rows[k] - first] = candidates[found[k]] if found[k] >= 0 else found[k]


@compiled
def taken(choice, index):  # type: ignore[no-untyped-def]
    """Whether another row of the look shows a landmark."""
    found = False
    for k in range(choice.size):
        found |= choice[k] == index
    return found


@compiled
def farthest(sightings, i, sigmas):  # type: ignore[no-untyped-def]
    """How far from the sensor what a row shows may be, by so many sigmas of its noise [m]."""
    value, R = sightings.values[i], sightings.covariance[i]
    if sightings.kind[i] == RANGE_BEARING:
        return value[0] + sigmas * math.sqrt(R[0, 0])
    return math.hypot(value[0], value[1]) + sigmas * math.sqrt(R[0, 0] + R[1, 1])


@compiled
def keep_evidence(sightings, first, maps, particle, pose, choice):  # type: ignore[no-untyped-def]
    """Landmarks that a look should show and does not lose evidence (Montemerlo and Thrun 2003).

    Those inside the sensor's view by three sigmas all around. A sensor that states no maximum range
    says of nothing that it should be seen.

    Returns
    -------
    bool
        Whether a landmark has less than none left, and should go.
    """
    limits = sightings.limits[first]
    if not limits[1] < np.inf:
        return False
    x, y, c, s, _, _ = placed(sightings.mount[first], pose)
    heading, spent = math.atan2(s, c), False
    for index in range(maps.used[particle]):
        page, place = maps.table[particle, index // PAGE], index % PAGE
        g = maps.gaussians[page, place]
        dx, dy = g[0] - x, g[1] - y
        away = dx * dx + dy * dy
        if away >= limits[1] * limits[1]:
            continue
        slack = SURE * math.sqrt(max(g[2] + g[4], 0.0))
        bearing = wrap(math.atan2(dy, dx) - heading)
        if surely_sees(math.sqrt(away), bearing, slack, limits) and not taken(choice, index):
            own_page(maps, particle, index // PAGE)
            page = maps.table[particle, index // PAGE]
            maps.evidence[page, place] -= 1
            spent = spent or maps.evidence[page, place] < 0
    return spent


@compiled
def forget(maps, particle):  # type: ignore[no-untyped-def]
    """Landmarks without evidence go."""
    for index in range(maps.used[particle] - 1, -1, -1):
        if maps.evidence[maps.table[particle, index // PAGE], index % PAGE] < 0:
            remove_landmark(maps, particle, index)
