"""A log brought to the steps of a dataset: odometry put together, truth interpolated."""

from __future__ import annotations

import numpy as np

from ekfslam import geometry as geo
from ekfslam.geometry import Array
from ekfslam.models.motion import Increments


def composed(moves: Increments, cuts: np.ndarray) -> Increments:
    """Small increments put together into those of steps.

    The covariance is that of the step's increment in the frame of its first pose, to first order:
    a small increment's noise moves what comes after it along.

    Parameters
    ----------
    moves : Increments
        Of n small steps.
    cuts : (K + 1,) ndarray of int
        Not decreasing: step k is made of the small steps from cuts[k] to before cuts[k + 1], and
        is zero, without noise, if there is none.

    Returns
    -------
    Increments
        Of K steps.
    """
    cuts = np.asarray(cuts)
    chain = geo.integrate(np.zeros(3), moves.deltas)
    first, last = cuts[:-1], cuts[1:]
    deltas = geo.between(chain[first], chain[last])
    rows = np.arange(cuts[0], cuts[-1])
    step = np.repeat(np.arange(len(first)), last - first)
    # What is left to go after a small step, in the frame of the step's first pose, turns with it.
    turned = geo.wrap(chain[rows, 2] - chain[first[step], 2])
    after = geo.to_frame(chain[first[step]], chain[rows + 1, :2])
    left = deltas[step, :2] - after
    J = np.zeros((len(rows), 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = np.cos(turned)
    J[:, 1, 0] = np.sin(turned)
    J[:, 0, 1] = -J[:, 1, 0]
    J[:, 0, 2], J[:, 1, 2], J[:, 2, 2] = -left[:, 1], left[:, 0], 1.0
    covariances = np.zeros((len(first), 3, 3))
    np.add.at(covariances, step, geo.congruence(J, moves.covariances[rows]))
    return Increments(deltas, covariances)


def interpolated(times: Array, known: Array, at: Array, longest: float = np.inf) -> Array:
    """Truth at the times of poses: linear between neighbours, headings on the circle.

    Parameters
    ----------
    times : (n,) ndarray
        Increasing [s].
    known : (n, 3) ndarray
        Poses; the heading may be NaN throughout.
    at : (K + 1,) ndarray
        Times wanted [s].
    longest : float
        Longest gap [s] that is bridged: further apart, only the neighbours' own times are known.

    Returns
    -------
    (K + 1, 3) ndarray
        NaN where it is not known.
    """
    poses = np.full((len(at), 3), np.nan)
    j = np.clip(np.searchsorted(times, at, side="right"), 1, max(len(times) - 1, 1))
    inside = (at >= times[0]) & (at <= times[-1])
    if len(times) == 1:
        poses[at == times[0]] = known[0]
        return poses
    gap = times[j] - times[j - 1]
    exact = (at == times[j]) | (at == times[j - 1])
    use = inside & ((gap <= longest) | exact)
    share = ((at - times[j - 1]) / gap)[:, None]
    change = known[j] - known[j - 1]
    change[:, 2] = geo.wrap(change[:, 2])
    poses[use] = (known[j - 1] + share * change)[use]
    poses[:, 2] = geo.wrap(poses[:, 2])
    return poses


def nearest(times: Array, at: Array) -> np.ndarray:
    """Index of the time nearest to each of some others; the earlier one of two.

    Parameters
    ----------
    times : (n,) ndarray
        Increasing.
    at : (m,) ndarray
    """
    return np.searchsorted(0.5 * (times[1:] + times[:-1]), at)
