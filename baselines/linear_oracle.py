"""The linear oracle: a filter's own linear models, solved in one go by GTSAM.

A Kalman filter is an exact solver of linear Gaussian problems. So the Gaussian factor graph made of
a filter's own linearisations must give back its final poses, map and joint covariance to round-off;
any slip in the bookkeeping of the filter shows.

Noise may be singular: of a start that is known, of a motion with two control noises, of a landmark
in inverse depth, whose first two coordinates are the sensor's. gtsam takes that as constraints, but
drops what is below 1e-9 when it eliminates them, which leaves an answer right to 1e-7 or so. Here
such quantities are linear forms of regular unknowns.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import gtsam
import numpy as np
from gtsam import noiseModel
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from ekfslam import geometry as geo
from ekfslam.checks import check_fits
from ekfslam.estimates import Linearizations
from ekfslam.geometry import Array
from ekfslam.robots import Prior

NEGLIGIBLE = 1e-15  # a variance this small beside the largest is none
REGULAR = 1e-3  # a standard deviation this large beside the largest is good to divide by
POSES, LANDMARKS = 1 << 40, 1 << 41  # first keys; poses in order of time
TERMS = 3  # that gtsam takes in one factor from Python
AT_ONCE = 256  # columns of the covariance


class OracleSolution(NamedTuple):
    """What the linear problem says: final poses, and every landmark that ever was.

    An identity whose landmark was deleted and made again stands for the last one.

    Attributes
    ----------
    poses : (R, 3) ndarray
        Final poses.
    ids : (L,) ndarray of int
        Of points.
    positions : (L, 2) ndarray
    undetermined : (U,) ndarray of int
        Identities of landmarks in inverse depth.
    inverse_depth : (U, 4) ndarray
    covariance : (3 R + 2 L + 4 U, 3 R + 2 L + 4 U) ndarray
        Joint, additive, in the order of the fields above.
    """

    poses: Array
    ids: np.ndarray
    positions: Array
    undetermined: np.ndarray
    inverse_depth: Array
    covariance: Array


class _Form(NamedTuple):
    """A pose or a landmark as a linear form ``anchor + sum matrix x`` of unknowns x."""

    anchor: Array
    terms: dict[int, Array]  # matrices by key


class _Problem:
    """The linear problem as a graph."""

    def __init__(self) -> None:
        self._graph = gtsam.GaussianFactorGraph()
        self._widths: dict[int, int] = {}

    def add(self, terms: dict[int, Array], right: Array, axes: Array, sigmas: Array) -> None:
        """Add ``sum A x = right + noise``, whitened along the axes of the noise.

        Where there are too many terms, some are lumped into one that has half of the variance to
        itself, which is the same when it is eliminated.
        """
        while len(terms) > TERMS:
            key, sigmas = len(self._widths), sigmas / np.sqrt(2)
            lump = {**dict(list(terms.items())[1 - TERMS :]), key: -np.eye(len(right))}
            self.add(lump, np.zeros(len(right)), axes, sigmas)
            terms = {**dict(list(terms.items())[: 1 - TERMS]), key: np.eye(len(right))}
        arguments = [part for key, A in terms.items() for part in (key, axes.T @ A)]
        model = noiseModel.Diagonal.Sigmas(sigmas)
        self._graph.add(gtsam.JacobianFactor(*arguments, axes.T @ right, model))
        self._widths.update({key: A.shape[1] for key, A in terms.items()})

    def add_prior(self, key: int, width: int) -> None:
        """Add an unknown of independent standard normal coordinates, if it has any."""
        if width:
            self.add({key: np.eye(width)}, np.zeros(width), np.eye(width), np.ones(width))

    def solve(self, asked: Sequence[_Form]) -> tuple[Array, Array]:
        """Values of some forms, and their joint covariance.

        gtsam eliminates all unknowns to ``R x = d`` with a sparse R; the covariance
        ``W (R' R)^-1 W'`` of what is asked for, W x, is solved for some columns at a time.

        Raises
        ------
        UnsupportedError
            If it does not fit into memory.
        """
        size = sum(len(form.anchor) for form in asked)
        check_fits(
            8 * size**2, f"the joint covariance of {size} coordinates from the linear oracle"
        )
        R, d, first = self._eliminated()
        # R itself, made ready; the stubs do not know that it solves the transpose, too.
        factor: Any = splu(R, permc_spec="NATURAL", diag_pivot_thresh=0.0)
        terms = [
            (row, first[key], A)
            for row, form in zip(_starts(len(f.anchor) for f in asked), asked, strict=True)
            for key, A in form.terms.items()
        ]
        wanted = _sparse(terms, (size, len(d))).tocsr()
        anchors = np.concatenate([form.anchor for form in asked])
        covariance = np.empty((size, size))
        for begin in range(0, size, AT_ONCE):
            own, later = slice(begin, begin + AT_ONCE), slice(begin, None)
            root = factor.solve(wanted[own].toarray().T, "T")
            columns = wanted[later] @ factor.solve(root)
            symmetric = columns[: columns.shape[1]]
            symmetric[:] = 0.5 * (symmetric + symmetric.T)
            covariance[later, own], covariance[own, later] = columns, columns.T
        return anchors + wanted @ factor.solve(d), covariance

    def _eliminated(self) -> tuple[csc_array, Array, dict[int, int]]:
        """R, d, and the first column of each unknown, in an order that leaves few entries."""
        ordering = gtsam.Ordering.ColamdGaussianFactorGraph(self._graph)
        keys = [ordering.at(i) for i in range(ordering.size())]
        first = dict(zip(keys, _starts(self._widths[key] for key in keys), strict=True))
        net = self._graph.eliminateSequential(ordering, gtsam.EliminateQR)
        count = sum(self._widths.values())
        terms, d = [], np.empty(count)
        for conditional in map(net.at, range(net.size())):
            own, *others = conditional.keys()
            parts, ends = conditional.S(), _starts(self._widths[key] for key in others)
            terms.append((first[own], first[own], conditional.R()))
            for key, at in zip(others, ends, strict=True):
                terms.append((first[own], first[key], parts[:, at : at + self._widths[key]]))
            d[first[own] : first[own] + self._widths[own]] = conditional.d()
        return _sparse(terms, (count, count)), d, first


def _starts(lengths: Iterable[int]) -> list[int]:
    """Where parts of some lengths begin, one after the other."""
    return [0, *accumulate(lengths)][:-1]


def _sparse(terms: Sequence[tuple[int, int, Array]], shape: tuple[int, int]) -> csc_array:
    """A matrix of blocks, with their first row and column."""
    sizes = np.array([A.shape for _, _, A in terms])
    counts = sizes.prod(axis=1)
    row, column, width = (
        np.repeat(v, counts) for v in (*np.array([t[:2] for t in terms]).T, sizes[:, 1])
    )
    inside = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    entries = np.concatenate([A.ravel() for _, _, A in terms])
    return csc_array((entries, (row + inside // width, column + inside % width)), shape=shape)


def solve(priors: Sequence[Prior], linear: Linearizations) -> OracleSolution:
    """Solve the linear problem of a filter.

    Parameters
    ----------
    priors : sequence of Prior
        Of the first pose of each robot.
    linear : Linearizations
        As the filter gives them.

    Returns
    -------
    OracleSolution
    """
    problem = _Problem()
    poses = [_chain(problem, prior, robot, linear) for robot, prior in enumerate(priors)]
    landmarks: dict[int, _Form] = {}
    for i in range(len(linear.event)):
        rows, size = int(linear.rows[i]), int(linear.size[i])
        target, identity, k = int(linear.target[i]), int(linear.landmark[i]), int(linear.step[i])
        H, H_target = linear.jacobian[i, :rows, :3], linear.jacobian[i, :rows, 3 : 3 + size]
        innovation, noise = linear.innovation[i, :rows], linear.noise[i, :rows, :rows]
        point = linear.point[i, 3 : 3 + size]
        pose = _through(H, poses[int(linear.robot[i])][k], linear.point[i, :3])
        if linear.event[i] == Linearizations.CREATED:
            landmarks[identity] = _created(problem, LANDMARKS + i, point, pose, noise)
        elif linear.event[i] == Linearizations.CONVERTED:
            old = _through(H_target, landmarks[identity], point)
            landmarks[identity] = _Form(innovation + old.anchor, old.terms)
        else:
            seen = poses[target][k] if target >= 0 else landmarks[identity]
            other = _through(H_target, seen, point)
            right = innovation - pose.anchor - other.anchor
            problem.add(_sum(pose.terms, other.terms), right, *_axes(noise))
    points = {i: form for i, form in landmarks.items() if len(form.anchor) == 2}
    rays = {i: form for i, form in landmarks.items() if len(form.anchor) == 4}
    final = [chain[-1] for chain in poses]
    values, covariance = problem.solve([*final, *points.values(), *rays.values()])
    last, positions, depths = np.split(values, np.cumsum([3 * len(final), 2 * len(points)]))
    last, depths = last.reshape(-1, 3), depths.reshape(-1, 4)
    last[:, 2], depths[:, 2] = geo.wrap(last[:, 2]), geo.wrap(depths[:, 2])
    ids, undetermined = (np.array(list(kind), dtype=np.int64) for kind in (points, rays))
    return OracleSolution(last, ids, positions.reshape(-1, 2), undetermined, depths, covariance)


# Poses ------------------------------------------------------------------------------------------


def _chain(problem: _Problem, prior: Prior, robot: int, linear: Linearizations) -> list[_Form]:
    """Poses of one robot, from its prior through its motions.

    A pose whose noise since the last unknown pose is regular becomes an unknown itself. Until then
    poses are forms of the noises of their motions; when the next unknown pose comes, those are
    exchanged for it and for what it leaves open of them.
    """
    before, after = linear.motion_from[robot], linear.motion_to[robot]
    jacobian, noise = linear.motion_jacobian[robot], linear.motion_noise[robot].copy()
    noise[0] += geo.congruence(jacobian[0], prior.covariance)
    poses: list[_Form] = []
    pose = _Form(prior.mean, {})
    first, noises = 0, {}  # of the poses, and of the noises, since the last unknown pose
    for k in range(len(after)):
        pose = _through(jacobian[k], pose, before[k])
        pose = _Form(after[k] + pose.anchor, pose.terms)
        # Keys of one step: its pose, the noise of its motion, what is left open of noises.
        key = POSES + 3 * (k * len(linear.motion_to) + robot)
        axes, sigmas = _axes(noise[k])
        if len(sigmas):
            pose.terms[key + 1] = axes * sigmas
            noises[key + 1] = len(sigmas)
        since = np.concatenate([np.zeros((3, 0)), *(pose.terms[n] for n in noises)], axis=1)
        U, S, V = np.linalg.svd(since)
        if len(S) == 3 and S[2] > REGULAR * S[0]:
            # since n = pose - what led to it, so n = into (pose - ...) + V[3:]' open
            led = _Form(pose.anchor, {n: A for n, A in pose.terms.items() if n not in noises})
            pose = _Form(after[k], {key: np.eye(3)})
            ahead = _difference(pose, led)
            problem.add(ahead.terms, -ahead.anchor, U, S)
            problem.add_prior(key + 2, len(V) - 3)
            ends = np.cumsum([0, *noises.values()])
            for j, n in enumerate(noises):
                rows = slice(ends[j], ends[j + 1])
                into = _through(V[:3, rows].T @ (U / S).T, ahead, np.zeros(3))
                whole = {**into.terms, key + 2: V[3:, rows].T} if len(V) > 3 else into.terms
                for i in range(first, k):
                    poses[i] = _replaced(poses[i], n, _Form(into.anchor, whole))
            first, noises = k, {}
        poses.append(pose)
    for n, width in noises.items():
        problem.add_prior(n, width)
    return poses


def _axes(covariance: Array) -> tuple[Array, Array]:
    """Axes along which there is noise, as columns, and its standard deviations."""
    variances, axes = np.linalg.eigh(covariance)
    noisy = variances > NEGLIGIBLE * variances[-1]
    return axes[:, noisy], np.sqrt(variances[noisy])


# Linear forms -----------------------------------------------------------------------------------


def _through(matrix: Array, form: _Form, point: Array) -> _Form:
    """``matrix (form - point)``, with angles wrapped in the difference."""
    off = _off(form.anchor, point)
    return _Form(matrix @ off, {key: matrix @ A for key, A in form.terms.items()})


def _off(anchor: Array, point: Array) -> Array:
    """``anchor - point``; a pose and an inverse depth have an angle in the third place."""
    difference = anchor - point
    difference[2:3] = geo.wrap(difference[2:3])
    return difference


def _difference(form: _Form, other: _Form) -> _Form:
    opposite = {key: -A for key, A in other.terms.items()}
    return _Form(_off(form.anchor, other.anchor), _sum(form.terms, opposite))


def _replaced(form: _Form, key: int, by: _Form) -> _Form:
    """A form with another one in the place of an unknown."""
    if key not in form.terms:
        return form
    A = form.terms[key]
    others = {k: B for k, B in form.terms.items() if k != key}
    terms = _sum(others, {k: A @ B for k, B in by.terms.items()})
    return _Form(form.anchor + A @ by.anchor, terms)


def _sum(*parts: dict[int, Array]) -> dict[int, Array]:
    """Terms of a sum."""
    total: dict[int, Array] = {}
    for part in parts:
        for key, A in part.items():
            total[key] = total[key] + A if key in total else A
    return total


def _created(problem: _Problem, key: int, point: Array, pose: _Form, noise: Array) -> _Form:
    """A landmark ``point + G (pose - its point) + v``, with `pose` the middle term.

    It is an unknown itself if v is regular, or if there is no such equation; else what there is of
    v is the unknown.
    """
    landmark = _Form(point, {key: np.eye(len(point))})
    if not len(noise):
        return landmark
    axes, sigmas = _axes(noise)
    if len(sigmas) == len(point):
        off = {k: -A for k, A in pose.terms.items()}
        problem.add(_sum(landmark.terms, off), pose.anchor, axes, sigmas)
        return landmark
    problem.add_prior(key, len(sigmas))
    own = {key: axes * sigmas} if len(sigmas) else {}
    return _Form(point + pose.anchor, _sum(pose.terms, own))
