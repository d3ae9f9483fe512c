"""The journal of linear models, which the linear oracle rebuilds the answer from."""

from __future__ import annotations

from ekfslam.compiled import compiled
from ekfslam.filters.triangle import copy


@compiled
def record(  # type: ignore[no-untyped-def]
    journal, event, row, robot, step, landmark, target, size, d, pose, state, H, innovation, noise
):
    """Write one event down, if the journal has room; see `ekfslam.estimates.Linearizations`.

    Parameters
    ----------
    event, row, robot, step, landmark, target : int
    size, d : int
        Coordinates of the target, rows of the equation.
    pose : (3,) ndarray
    state : (>= size,) ndarray
        Of the target.
    H : (>= d, >= 3 + size) ndarray, or (>= d, 3) for a new landmark
    innovation : (>= d,) ndarray
    noise : (>= d, >= d) ndarray
    """
    e = journal.used[0]
    if e >= journal.event.size:
        return
    journal.used[0] = e + 1
    journal.event[e], journal.row[e], journal.robot[e], journal.step[e] = event, row, robot, step
    journal.landmark[e], journal.target[e] = landmark, target
    journal.size[e], journal.rows[e] = size, d
    copy(pose, 3, journal.point[e])
    copy(state, size, journal.point[e, 3:])
    for a in range(d):
        journal.innovation[e, a] = innovation[a]
        for c in range(min(3 + size, H.shape[1])):
            journal.jacobian[e, a, c] = H[a, c]
        for b in range(d):
            journal.noise[e, a, b] = noise[a, b]
