"""FastSLAM: sample, weigh, map, resample.

The particle filter over paths with one small EKF for each landmark of each particle (Principles of
Robot Autonomy, Alg. 3; Montemerlo et al. 2002, 2003), as one compiled loop. `run` is the algorithm;
the functions below it are its lines, in their order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekfslam.association.nearest import NEW
from ekfslam.compiled import compiled, inlined, now
from ekfslam.filters.ekf_slam import end_of_look
from ekfslam.filters.fastslam.gaussians import (
    LOG_TAU,
    correct_landmark,
    correct_pose,
    distance,
    drawn,
    innovation,
    inverse,
    log_likelihood,
    moments,
    spread,
    square_root,
    toward,
    turned,
    view,
    wider,
)
from ekfslam.filters.fastslam.particles import (
    PAGE,
    add_landmark,
    lengthen,
    normalise,
    own_page,
    resample,
)
from ekfslam.filters.fastslam.recognition import (
    UNDECIDED,
    by_identity,
    forget,
    keep_evidence,
    likeliest,
)
from ekfslam.filters.kernels import advance, wrap
from ekfslam.filters.measure import POSE, locate, placed
from ekfslam.geometry import Array
from ekfslam.models.sensors import RANGE_BEARING


class Settings(NamedTuple):
    """Options as the compiled loop reads them.

    Attributes
    ----------
    known : bool
        Whether identities are known.
    informed : bool
        Whether the proposal knows the step's sightings: FastSLAM 2.0.
    least : float
        Effective number of samples below which particles are resampled.
    gate : float
        Of a match, on the squared Mahalanobis distance.
    evidence : bool
        Whether landmarks that are missed are forgotten.
    """

    known: bool
    informed: bool
    least: float
    gate: float
    evidence: bool


class Motion(NamedTuple):
    """The components of the motion's noise.

    Attributes
    ----------
    cumulative : (C,) ndarray
        Sums of the weights up to and with each.
    deltas : (C, K + 1, 3), covariances : (C, K + 1, 3, 3) ndarray
        Increment that leads to each pose, zero for the first.
    """

    cumulative: Array
    deltas: Array
    covariances: Array


class Draws(NamedTuple):
    """Random numbers for the steps of a block.

    Attributes
    ----------
    first : int
        Its first step.
    normals : (n, N, 3) ndarray
    component : (n, N) ndarray
        Uniform; (n, 0) if there is one component.
    resampling : (n,) ndarray
        Uniform.
    """

    first: int
    normals: Array
    component: Array
    resampling: Array


class Log(NamedTuple):
    """What the loop writes down: per pose, and per observation.

    Attributes
    ----------
    poses : (K + 1, 3), covariances : (K + 1, 3, 3)
    effective, nis, seconds : (K + 1,), dof : (K + 1,) of int
    innovation : (M, 2), S : (M, 2, 2)
    choice : (M, N) ndarray of int
        What each particle took each row for: the name of a landmark, or a negative code. (M, 0) if
        identities are known, and nothing is to be decided.
    degenerate : (2,) ndarray of int
        Steps in which no particle explained what was seen, and the first of them.
    """

    poses: Array
    covariances: Array
    effective: Array
    nis: Array
    seconds: Array
    dof: np.ndarray
    innovation: Array
    S: Array
    choice: np.ndarray
    degenerate: np.ndarray

    @classmethod
    def of(cls, steps: int, rows: int, deciders: int) -> Log:
        """An empty log."""
        return cls(
            np.full((steps, 3), np.nan),
            np.full((steps, 3, 3), np.nan),
            np.full(steps, np.nan),
            np.full(steps, np.nan),
            np.full(steps, np.nan),
            np.zeros(steps, dtype=np.int64),
            np.full((rows, 2), np.nan),
            np.full((rows, 2, 2), np.nan),
            np.empty((rows, deciders), dtype=np.int32),
            np.zeros(2, dtype=np.int64),
        )


class Scratch(NamedTuple):
    """Work space of a step, by particle and by row.

    Attributes
    ----------
    before : (N, m) ndarray
        Log weight of a particle before it met the row; minus infinity if it took the row for no
        landmark that it has.
    nu : (N, m, 2), S : (N, m, 3) ndarray
        Innovation there and its covariance (00, 01, 11).
    choice : (m,) ndarray of int
        What the present particle takes the row for: an index into its map, or a negative code.
    fused : (m,) ndarray of bool
        Whether the proposal has used the row, and the weight counts it.
    """

    before: Array
    nu: Array
    S: Array
    choice: np.ndarray
    fused: np.ndarray

    @classmethod
    def of(cls, particles: int, rows: int) -> Scratch:
        """Space for steps with up to so many rows."""
        return cls(
            np.empty((particles, rows)),
            np.empty((particles, rows, 2)),
            np.empty((particles, rows, 3)),
            np.empty(rows, dtype=np.int64),
            np.empty(rows, dtype=np.bool_),
        )


@compiled
def run(  # type: ignore[no-untyped-def]
    start, stop, draws, settings, motion, offsets, sightings, logdets, place, cloud, maps, paths,
    log, scratch,
):  # fmt: skip
    """Steps from `start` to before `stop`; returns the step it came to.

    It stops early where the maps must have more room first.
    """
    particles, components = cloud.weights.size, motion.cumulative.size
    roots = np.zeros((components, POSE, POSE))
    mean, P, L = np.empty(POSE), np.zeros((POSE, POSE)), np.zeros((POSE, POSE))
    body, sure = np.zeros((POSE, POSE)), np.zeros((POSE, POSE))
    room = np.empty(2), np.empty((2, 3)), np.empty((2, 2))  # of a landmark that is new
    for k in range(start, stop):
        begin = now()
        first, last, at = offsets[k], offsets[k + 1], k - draws.first
        rows = last - first
        if maps.used.max() + rows > maps.table.shape[1] * PAGE:
            return k
        if k > 0 and log.effective[k - 1] < settings.least:
            resample(cloud, maps, paths, draws.resampling[at])
        for c in range(components):
            square_root(motion.covariances[c, k], roots[c])
        if settings.known:
            by_identity(sightings, first, last, place, maps.used[0], scratch.choice)
        scratch.before[:, :rows] = -np.inf
        scratch.fused[:rows] = False
        for i in range(particles):
            c = component(motion.cumulative, draws.component, at, i)
            pose, normals = cloud.poses[i], draws.normals[at, i]
            if not settings.known:
                scratch.choice[:rows] = UNDECIDED
            mean[:], heading, root = pose, pose[2], roots[c]
            advance(mean, 0, motion.deltas[c, k])
            if settings.informed and rows > 0:  # x ~ p(x | pose, u, z); else p(x | pose, u)
                turned(motion.covariances[c, k], heading, P)
                propose(i, mean, P, first, last, sightings, logdets, cloud, maps, settings, scratch)
                turned(P, -heading, body)
                square_root(body, L)
                root = L
            drawn(mean, heading, root, normals, pose)
            observe(
                i, pose, sure, first, last, sightings, logdets, cloud, maps, settings, log,
                scratch, room,
            )  # fmt: skip
        effective, usable = normalise(cloud.log_weights, cloud.weights)
        if not usable:
            log.degenerate[1] = k if log.degenerate[0] == 0 else log.degenerate[1]
            log.degenerate[0] += 1
        log.effective[k] = effective
        lengthen(paths, cloud)
        moments(cloud.poses, cloud.weights, log.poses[k], log.covariances[k])
        write_rows(k, first, last, sightings, log, scratch)
        log.seconds[k] = now() - begin
    return stop


@compiled
def component(cumulative, uniforms, at, i):  # type: ignore[no-untyped-def]
    """Component of the motion's noise that a particle draws."""
    c = 0
    if cumulative.size > 1:
        while c < cumulative.size - 1 and uniforms[at, i] >= cumulative[c]:
            c += 1
    return c


@inlined
def propose(i, mean, P, base, last, sightings, logdets, cloud, maps, settings, scratch):  # type: ignore[no-untyped-def]
    """The motion fused with what is seen of mapped landmarks, one sighting after another.

    Changes mean and covariance P of the pose that is going to be drawn. The weight is the
    likelihood of the sightings before that, so S has the spread of pose, landmark and measurement.
    The landmarks are left as they are: each serves once in a step, and a second sighting, in
    another look, is left to `observe`, which knows the landmark better by then. So is one that
    cannot be linearised at the mean.
    """
    # Taken from their tuples once: in the loop every access would count references.
    values, Rs, kinds, mounts = (
        sightings.values, sightings.covariance, sightings.kind, sightings.mount
    )  # fmt: skip
    table, gaussians, count = maps.table, maps.gaussians, maps.used[i]
    choice, fused, weight = scratch.choice, scratch.fused, cloud.log_weights[i]
    before, nus, Ss = scratch.before[i], scratch.nu[i], scratch.S[i]
    first = base
    while first < last:
        end = end_of_look(sightings, first, last)
        kind, mount = kinds[first], mounts[first]
        if not settings.known:
            mine = choice[first - base : end - base]
            likeliest(sightings, first, end, maps, i, mean, P, settings.gate, logdets, mine)
        for row in range(first, end):
            r = row - base
            index = choice[r]
            fused[r] = 0 <= index < count and not served(fused, choice, r, index)
            if not fused[r]:
                continue
            g = gaussians[table[i, index // PAGE], index % PAGE]
            seen = view(kind, placed(mount, mean), g[0], g[1])
            nu, PH = innovation(kind, values[row], seen), toward(seen, P)
            S = wider(spread(seen, g, Rs[row]), seen, PH)
            inverted = inverse(S)
            if not inverted[3] > 0.0:  # as of a landmark right at the sensor, in no direction
                fused[r] = False
                continue
            before[r] = weight
            nus[r, 0], nus[r, 1] = nu
            Ss[r, 0], Ss[r, 1], Ss[r, 2] = S
            weight += log_likelihood(nu, inverted)
            correct_pose(mean, P, PH, nu, inverted)
        first = end
    cloud.log_weights[i] = weight


@compiled
def served(fused, choice, r, index):  # type: ignore[no-untyped-def]
    """Whether an earlier row of the step has fused a landmark."""
    found = False
    for other in range(r):
        found |= fused[other] and choice[other] == index
    return found


@inlined
def observe(  # type: ignore[no-untyped-def]
    i, pose, sure, base, last, sightings, logdets, cloud, maps, settings, log, scratch, room
):
    """All that a particle sees from its pose: weigh, correct its landmarks, map new ones.

    A measurement that maps a landmark does not correct it, too. It weighs the same in all particles
    where identities are known, and so nothing; where they are not, as much as a sighting at the
    gate of a landmark that is known exactly. What the proposal has used is weighed already.
    """
    values, Rs, kinds, mounts = (
        sightings.values, sightings.covariance, sightings.kind, sightings.mount
    )  # fmt: skip
    table, owners, gaussians, evidence = maps.table, maps.owners, maps.gaussians, maps.evidence
    choice, fused, weight = scratch.choice, scratch.fused, cloud.log_weights[i]
    before, nus, Ss, known = scratch.before[i], scratch.nu[i], scratch.S[i], settings.known
    first, spent = base, False
    while first < last:
        end = end_of_look(sightings, first, last)
        kind, mount = kinds[first], mounts[first]
        sensor = placed(mount, pose)
        if not known:
            mine = choice[first - base : end - base]
            retry(mine)
            likeliest(sightings, first, end, maps, i, pose, sure, settings.gate, logdets, mine)
        for row in range(first, end):
            r = row - base
            index = choice[r]
            if index >= 0:
                page, slot = np.int64(table[i, index // PAGE]), index % PAGE
                if owners[page] > 1:
                    page = own_page(maps, i, index // PAGE)
                g = gaussians[page, slot]
                seen = view(kind, sensor, g[0], g[1])
                nu, S = innovation(kind, values[row], seen), spread(seen, g, Rs[row])
                inverted = inverse(S)
                if not fused[r]:
                    before[r] = weight
                    nus[r, 0], nus[r, 1] = nu
                    Ss[r, 0], Ss[r, 1], Ss[r, 2] = S
                    weight += log_likelihood(nu, inverted)
                correct_landmark(seen, g, nu, inverted)
                evidence[page, slot] += 1
                if not known:
                    log.choice[row, i] = maps.names[page, slot]
            elif index == NEW:
                name = sightings.landmark[row] if known else row
                page, slot = add_landmark(maps, i, name)
                spot, G, noise = room
                locate(kind, mount, pose, values[row], Rs[row], spot, G, noise)
                g = gaussians[page, slot]
                g[0], g[1] = spot[0], spot[1]
                g[2], g[3], g[4] = noise[0, 0], noise[0, 1], noise[1, 1]
                if not known:
                    log.choice[row, i], choice[r] = name, maps.used[i] - 1
            elif not known:
                log.choice[row, i] = index
            if not known and index < 0:
                weight -= 0.5 * (settings.gate + logdets[row]) + LOG_TAU
        if settings.evidence and keep_evidence(sightings, first, maps, i, pose, mine):
            spent = True
        first = end
    if spent:
        forget(maps, i)
    cloud.log_weights[i] = weight


@compiled
def retry(choice):  # type: ignore[no-untyped-def]
    """What the proposal found no landmark for is decided again at the pose that was drawn."""
    for r in range(choice.size):
        if choice[r] < 0:
            choice[r] = UNDECIDED


@inlined
def write_rows(k, base, last, sightings, log, scratch):  # type: ignore[no-untyped-def]
    """Innovations of the whole set of particles, and their NIS.

    What the particles expect of a row is a mixture, weighted with what they weigh after the rows
    before it: mean and covariance, within and between them, of those that took it for a landmark.
    """
    before, nus, Ss, m = scratch.before, scratch.nu, scratch.S, last - base
    most, heaviest = np.full(m, -np.inf), np.zeros(m, np.int64)
    for i in range(before.shape[0]):
        for r in range(m):
            if before[i, r] > most[r]:
                most[r], heaviest[r] = before[i, r], i
    total, mean, second = np.zeros(m), np.zeros((m, 2)), np.zeros((m, 3))
    for i in range(before.shape[0]):
        for r in range(m):
            if not before[i, r] > -np.inf:
                continue
            origin = heaviest[r]
            w = np.exp(before[i, r] - most[r])
            a, b = nus[i, r, 0] - nus[origin, r, 0], nus[i, r, 1] - nus[origin, r, 1]
            b = wrap(b) if sightings.kind[base + r] == RANGE_BEARING else b
            total[r] += w
            mean[r, 0] += w * a
            mean[r, 1] += w * b
            second[r, 0] += w * (Ss[i, r, 0] + a * a)
            second[r, 1] += w * (Ss[i, r, 1] + a * b)
            second[r, 2] += w * (Ss[i, r, 2] + b * b)
    log.nis[k] = 0.0
    for r in range(m):
        if total[r] > 0.0:
            a, b, origin, row = mean[r, 0] / total[r], mean[r, 1] / total[r], heaviest[r], base + r
            S = (
                second[r, 0] / total[r] - a * a,
                second[r, 1] / total[r] - a * b,
                second[r, 2] / total[r] - b * b,
            )
            nu = nus[origin, r, 0] + a, nus[origin, r, 1] + b
            if sightings.kind[row] == RANGE_BEARING:
                nu = nu[0], wrap(nu[1])
            log.innovation[row, 0], log.innovation[row, 1] = nu
            log.S[row, 0, 0], log.S[row, 1, 1] = S[0], S[2]
            log.S[row, 0, 1] = log.S[row, 1, 0] = S[1]
            log.nis[k] += distance(nu, inverse(S))
            log.dof[k] += 2
    if log.dof[k] == 0:
        log.nis[k] = np.nan
