"""Absolute and relative errors of trajectories in SE(2), and their alignment with the truth.

The truth may be known in part: NaN of a whole pose, or of its heading alone. What needs the part
that is not known is NaN or left out, as each function says.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.estimates import Trajectory
from ekfslam.geometry import Array

ALIGNMENTS = ("none", "se2")


class PoseErrors(NamedTuple):
    """Sizes of pose errors.

    Attributes
    ----------
    position : (N,) ndarray
        Norm of the position error [m]; NaN where there is none.
    heading : (N,) ndarray
        Size of the wrapped heading error [rad], in [0, pi]; NaN likewise.
    """

    position: Array
    heading: Array


def alignment_motion(poses: ArrayLike, truth: ArrayLike, alignment: str = "none") -> Array:
    """Rigid motion that brings an estimate into the frame of the truth.

    Parameters
    ----------
    poses, truth : (N, 3) array_like
        Estimated and true poses; estimates that are not finite take no part, nor do poses whose
        true position is not known. Headings of the truth are not needed.
    alignment : {"none", "se2"}
        "none" is the identity, right where the start is known. "se2" is the motion that minimises
        the sum of squared distances between positions; headings follow it. Of a single position it
        is a shift.

    Returns
    -------
    (3,) ndarray
        A pose g: apply it with ``geometry.compose(g, poses)``, and to landmarks with
        ``geometry.from_frame(g, positions)``.

    Raises
    ------
    UnknownNameError
        For another alignment.
    """
    if alignment not in ALIGNMENTS:
        raise UnknownNameError("alignment", alignment, ALIGNMENTS)
    poses, truth = _pair(poses, truth)
    finite = np.isfinite(poses).all(axis=1) & np.isfinite(truth[:, 0])
    if alignment == "none" or not finite.any():
        return np.zeros(3)
    return geo.align(poses[finite, :2], truth[finite, :2])


def frame_motion(dataset: Dataset, series: Trajectory, alignment: str = "none") -> Array:
    """Rigid motion that brings a series into the frame of the truth: one for all robots.

    Robots and landmarks share one frame, so one motion, found from the positions of all robots
    whose truth is known, moves them all.

    Parameters
    ----------
    dataset : Dataset
    series : Trajectory
        Of all robots; poses that are not finite take no part.
    alignment : {"none", "se2"}

    Returns
    -------
    (3,) ndarray
        As `alignment_motion`; the identity if no truth is known.

    Raises
    ------
    UnknownNameError
        For another alignment.
    """
    none = np.empty((0, 3))
    known = [(r, robot.truth) for r, robot in enumerate(dataset.robots) if robot.truth is not None]
    poses = np.concatenate([none, *(series.of_robot(r).poses for r, _ in known)])
    return alignment_motion(poses, np.concatenate([none, *(t for _, t in known)]), alignment)


def absolute_errors(poses: ArrayLike, truth: ArrayLike) -> PoseErrors:
    """Absolute trajectory error (ATE) of every pose.

    Parameters
    ----------
    poses, truth : (N, 3) array_like
        Estimated (and aligned, where wanted) and true poses.

    Returns
    -------
    PoseErrors
        One per pose: of the position where that is known, of the heading where it is.
    """
    poses, truth = _pair(poses, truth)
    return _sizes(geo.additive_error(truth, poses))


def path_length(poses: ArrayLike) -> Array:
    """Length travelled until each pose [m]: the sum of the straight steps before it.

    A gap counts as the straight line between the known positions on either side of it, which is
    the least that was travelled; what came before the first known position does not count.

    Parameters
    ----------
    poses : (N, 2 or more) array_like
        Rows that start with a position [m], NaN where it is not known.

    Returns
    -------
    (N,) ndarray
        NaN where the position is not known.
    """
    poses = np.asarray(poses, dtype=float)
    known = np.isfinite(poses[:, :2]).all(axis=1)
    length = np.full(len(poses), np.nan)
    steps = np.diff(poses[known, :2], axis=0)
    length[known] = np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))[: known.sum()]
    return length


def relative_errors(
    poses: ArrayLike, truth: ArrayLike, distance: float | None = None
) -> PoseErrors:
    """Relative pose error (RPE) over one step or over a distance.

    The error of a pair (i, j) is ``(T_i^-1 T_j)^-1 (E_i^-1 E_j)`` with the true poses T and the
    estimated poses E (Sturm et al. 2012, "A benchmark for the evaluation of RGB-D SLAM systems",
    Eq. 1). No rigid motion of either trajectory changes it.

    Both poses of a pair must be known with their headings: without them there is no relative pose,
    nor a relative position that no rigid motion changes. The path across a gap is as in
    `path_length`, and a pair that a gap longer than the distance makes longer is left out.

    Parameters
    ----------
    poses, truth : (N, 3) array_like
    distance : float, optional
        Length [m]: each pose i is paired with the first pose j to which the true path from i is at
        least that long, less one part in 1e9 so that a whole number of equal steps reaches it.
        Poses without such a j are left out. By default every pose is paired with the next one.

    Returns
    -------
    PoseErrors
        One per pair, in the order of i; none if the whole path is shorter than the distance.

    Raises
    ------
    InputError
        If the distance is not positive.
    """
    poses, truth = _pair(poses, truth)
    i, j = _pairs(truth, distance)
    true_motion = geo.between(truth[i], truth[j])
    return _sizes(geo.between(true_motion, geo.between(poses[i], poses[j])))


def _pairs(truth: Array, distance: float | None) -> tuple[np.ndarray, np.ndarray]:
    known = np.flatnonzero(np.isfinite(truth).all(axis=1))
    if distance is None:
        neighbours = np.flatnonzero(np.diff(known) == 1)
        return known[neighbours], known[neighbours + 1]
    if not 0.0 < distance < np.inf:
        raise InputError(f"the distance of relative errors must be positive, got {distance}")
    travelled = path_length(truth)[known]
    end = np.searchsorted(travelled, travelled + distance * (1.0 - 1e-9))
    start = np.flatnonzero(end < len(known))
    end = end[start]
    gap = (known[end] - known[end - 1] > 1) & (travelled[end] - travelled[end - 1] > distance)
    return known[start[~gap]], known[end[~gap]]


def _pair(poses: ArrayLike, truth: ArrayLike) -> tuple[Array, Array]:
    poses, truth = np.asarray(poses, dtype=float), np.asarray(truth, dtype=float)
    if poses.shape != truth.shape or poses.ndim != 2 or poses.shape[1] != 3:
        raise InputError(f"poses {poses.shape} and truth {truth.shape} must both be (N, 3)")
    return poses, truth


def _sizes(errors: Array) -> PoseErrors:
    return PoseErrors(np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2]))
