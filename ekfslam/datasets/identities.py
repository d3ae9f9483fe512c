"""Which landmark of a surveyed map each sighting shows, told from true positions; for evaluation.

A recorded truth may have no headings. Those of the odometry are near them but for a drift, which is
slow: within a window of steps it is one angle, the one with which the sightings fall on the map.
"""

from __future__ import annotations

import numpy as np

from ekfslam import geometry as geo
from ekfslam.geometry import Array
from ekfslam.observations import NO_LANDMARK


def identified(
    poses: Array,
    step: np.ndarray,
    points: Array,
    landmarks: Array,
    near: float,
    window: int,
    drift: float,
) -> np.ndarray:
    """Identities where there is no doubt, -1 elsewhere.

    There is none where a landmark is nearer than `near`, the next one more than twice as far, and
    no other sighting of the step is nearer to it.

    Parameters
    ----------
    poses : (K + 1, 3) ndarray
        True positions [m], NaN where they are not known, and headings that drift [rad].
    step : (m,) ndarray of int
        Pose of each sighting.
    points : (m, 2) ndarray
        What was seen, in the frame of the body [m].
    landmarks : (c, 2) ndarray
        At least two.
    near : float
        [m].
    window : int
        Steps before and after one in which the drift does not change.
    drift : float
        Largest drift that is looked for [rad], in steps of a degree.

    Returns
    -------
    (m,) ndarray of int
        Rows of `landmarks`.
    """
    turns = np.deg2rad(np.arange(-np.floor(np.rad2deg(drift)), np.rad2deg(drift) + 1e-9))
    away = np.array([_distances(poses, step, points, landmarks, turn) for turn in turns])
    misfit = np.minimum(np.nan_to_num(away.min(axis=2), nan=near), near)
    per_step = np.zeros((len(turns), len(poses) + 1))
    for row, of in zip(per_step, misfit, strict=True):
        row[1:] = np.bincount(step, of, len(poses))
    sums = np.cumsum(per_step, axis=1)
    first = np.clip(np.arange(len(poses)) - window, 0, None)
    last = np.clip(np.arange(len(poses)) + window + 1, None, len(poses))
    best = (sums[:, last] - sums[:, first]).argmin(axis=0)
    return _clear(step, away[best[step], np.arange(len(step))], near)


def _distances(
    poses: Array, step: np.ndarray, points: Array, landmarks: Array, turn: float
) -> Array:
    """From each sighting to each landmark, all headings turned by one angle."""
    seen = geo.from_frame(poses[step] + [0.0, 0.0, turn], points)
    return np.linalg.norm(seen[:, None] - landmarks, axis=2)


def _clear(step: np.ndarray, away: Array, near: float) -> np.ndarray:
    """Nearest landmarks, where there is no doubt, from distances (m, c)."""
    which = away.argmin(axis=1)
    least, following = np.sort(away, axis=1)[:, :2].T
    clear = np.flatnonzero((least < near) & (following > 2 * least))
    order = clear[np.lexsort([least[clear], which[clear], step[clear]])]
    _, first = np.unique(np.column_stack([step, which])[order], axis=0, return_index=True)
    identity = np.full(len(step), NO_LANDMARK)
    identity[order[first]] = which[order[first]]
    return identity
