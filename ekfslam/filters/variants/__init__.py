"""The family of EKF-SLAM filters: one algorithm, and what each member does in its own way.

================ ========================= ========================== ================= ===========
filter           motion linearised         observations linearised    error coordinates frame
================ ========================= ========================== ================= ===========
ekf              estimate to prediction    prediction                 additive          world
iekf             estimate to prediction    again at each correction   additive          world
ekf-ideal        truth to truth            truth                      additive          world
ekf-fej          prediction to prediction  pose at its prediction,    additive          world
                                           landmark at its first
                                           estimate
ekf-oc           p* to prediction          prediction, and l*         additive          world
ekf-ri           nowhere                   prediction                 right-invariant   world
ekf-robocentric  estimate to prediction    prediction                 additive          robot
================ ========================= ========================== ================= ===========

The algorithm itself is `ekfslam.filters.ekf_slam`; the functions here are all that it asks of a
filter, and each goes to the module that the answer is written in.
"""

from __future__ import annotations

import numpy as np

from ekfslam.compiled import compiled, inlined, lean
from ekfslam.filters.kernels import shift
from ekfslam.filters.measure import POINT, POSE, expect, foresee, locate, placed
from ekfslam.filters.triangle import copy
from ekfslam.filters.variants import fej, ideal, oc, right_invariant, robocentric

NAMES = ("ekf", "iekf", "ekf-ideal", "ekf-fej", "ekf-oc", "ekf-ri", "ekf-robocentric")
EKF, ITERATED, IDEAL, FEJ, OC, INVARIANT, ROBOCENTRIC = range(len(NAMES))
ALONE = (OC, INVARIANT, ROBOCENTRIC)  # filters of one robot
AT_ESTIMATES = (EKF, ITERATED, ROBOCENTRIC)  # whose motion is that of the plain filter
OF_THEIR_OWN = (INVARIANT, ROBOCENTRIC)  # coordinates, which the world's are made from

_fej, _ideal, _oc, _invariant = fej.move, ideal.move, oc.move, right_invariant.move
_compose, _retract = robocentric.compose, right_invariant.retract
_invariant_pose_of, _robocentric_pose_of = right_invariant.pose_of, robocentric.pose_of


@compiled
def move_elsewhere(variant, slam, at, delta, Q, k, seen):  # type: ignore[no-untyped-def]
    """Move the robot whose pose stands at an offset, in step k, not linearised at the estimate.

    Parameters
    ----------
    seen : (N,) ndarray of int
        Offsets of the landmarks that are seen next, for ekf-oc.
    """
    mean, P, n, points = slam.mean, slam.covariance, slam.size[0], slam.points
    if variant == IDEAL:
        _ideal(mean, P, n, points.at, at, delta, Q, points.poses[at // POSE, k])
    elif variant == FEJ:
        _fej(mean, P, n, points.at, at, delta, Q)
    elif variant == OC:
        _oc(mean, P, n, points.at, points.first, at, delta, Q, seen)
    else:
        _invariant(mean, P, n, delta, Q)


@lean
def foresee_at(variant, mean, points, sensor, elsewhere, at, size, kind, value, point, H, nu):  # type: ignore[no-untyped-def]
    """`ekfslam.filters.measure.foresee`, the Jacobian where, and of the error that, a filter has.

    The innovation is at the latest estimate in all of them.

    Parameters
    ----------
    sensor, elsewhere : tuple
        Of `placed`, by the estimate of the pose and by its point of linearisation.
    at : int
        Offset of the target.
    point : (6,) ndarray
        Written, as by `foresee`; the last two are only worked with.
    """
    if not foresee(kind, size, sensor, mean[at : at + size], value, point, H, nu):
        return False
    if variant == INVARIANT:  # an error of the heading moves robot and landmark as one
        H[0, 2] = H[1, 2] = 0.0
    elif variant in (IDEAL, FEJ, OC):
        expect(kind, size, elsewhere, points[at : at + size], point[4:], H)
    return True


@compiled
def begin(variant, slam, kind, mount, pose, value, R, i, target, G, noise):  # type: ignore[no-untyped-def]
    """Choose the point of a new landmark, and its Jacobian and mapped noise by that.

    Parameters
    ----------
    pose : int
        Offset of the robot that sees it.
    value : (2,) ndarray
        What was measured; of the ideal filter written: what is seen from the truth.
    i : int
        Observation.
    target : (>= 2,) ndarray
        The landmark, from the latest estimate.
    G : (>= 2, 3) ndarray
        Derivative with respect to the pose, at the estimate; written.
    noise : (>= 2, >= 2) ndarray
        Mapped noise, at the estimate; written.
    """
    if variant == INVARIANT:
        G[0, 2] = G[1, 2] = 0.0
    elif variant in (IDEAL, FEJ, OC):
        n, points = slam.size[0], slam.points
        at = points.at
        copy(target, POINT, at[n:])
        copy(target, POINT, points.first[n:])
        if variant == OC:  # less all that moved the points before
            at[n] -= points.first[pose]
            at[n + 1] -= points.first[pose + 1]
        elif variant == IDEAL and not np.isnan(points.places[i, 0]):
            copy(points.places[i], POINT, at[n:])
            sensor, unused = placed(mount, at[pose : pose + POSE]), np.empty((2, 7))
            expect(kind, POINT, sensor, at[n : n + 2], value, unused)  # as if seen exactly
        elsewhere = np.empty(2)
        locate(kind, mount, at[pose : pose + POSE], value, R, elsewhere, G, noise)
        G[0, 2], G[1, 2] = at[pose + 1] - at[n + 1], at[n] - at[pose]


@inlined
def retract(variant, mean, step, n, poses):  # type: ignore[no-untyped-def]
    """Apply the step of a correction to the mean."""
    if variant == INVARIANT:
        _retract(mean, step, n)
    else:
        shift(mean, step, n, poses)


@compiled
def settle_pose(variant, slam, pose, covariance):  # type: ignore[no-untyped-def]
    """Pose (3,) and additive covariance (3, 3) of a filter in `OF_THEIR_OWN`; both written.

    The frame of a robocentric filter follows the robot. Both have the mean of the prior in `first`.
    """
    mean, P, first = slam.mean, slam.covariance, slam.points.first
    if variant == ROBOCENTRIC:
        _compose(mean, P, slam.size[0])
        _robocentric_pose_of(first, mean, P, pose, covariance)
    else:
        _invariant_pose_of(first, mean, P, pose, covariance)
