"""What the compiled loop works on: the map, who is in it, what waits outside, and what it logs.

Plain tuples of arrays, since compiled code takes those; Python makes and enlarges them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekfslam.geometry import Array


class Points(NamedTuple):
    """Where the family of filters linearises, if not at the estimate; see `variants`.

    Attributes
    ----------
    at : (capacity,) ndarray
        Point of every coordinate of the state.
    first : (capacity,) ndarray
        What a variant remembers of them.
    poses : (R, K + 1, 3) ndarray
        True poses, for the ideal filter alone.
    places : (M, 2) ndarray
        True position of what each observation shows, NaN where it is nothing; likewise.
    """

    at: Array
    first: Array
    poses: Array
    places: Array

    @classmethod
    def of(cls, capacity: int) -> Points:
        """Points of nothing yet, and no truth."""
        none = np.zeros((0, 0, 3)), np.zeros((0, 2))
        return cls(np.zeros(capacity), np.zeros(capacity), *none)


class Workspace(NamedTuple):
    """What a correction writes to and nobody reads after it; see `ekfslam.filters.ekf_slam.update`.

    Attributes
    ----------
    rows : (m, capacity) ndarray
        H P, then W, where they do not wait.
    S : (m, m), innovation : (m,), step : (capacity,) ndarray
    H : (m, 2, 7) ndarray
        Of each observation, with respect to pose and target.
    targets : (3, m) ndarray of int
        Offset and size of each target, and its row among the observations.
    one : (8,) ndarray
        Of one observation: where it is linearised (6,), and its innovation (2,).
    wanted : (1,) ndarray of int
        Rows that a step wants for which there is no room.
    """

    rows: Array
    S: Array
    innovation: Array
    step: Array
    H: Array
    targets: np.ndarray
    one: Array
    wanted: np.ndarray

    @classmethod
    def of(cls, rows: int, capacity: int) -> Workspace:
        """Room for corrections of so many rows."""
        return cls(
            np.empty((rows, capacity)),
            np.empty((rows, rows)),
            np.empty(rows),
            np.empty(capacity),
            np.empty((rows, 2, 7)),
            np.empty((3, rows), dtype=np.int64),
            np.empty(8),
            np.zeros(1, dtype=np.int64),
        )


class MapArrays(NamedTuple):
    """The Gaussian map.

    Attributes
    ----------
    mean : (capacity,) ndarray
    covariance : (capacity, capacity) ndarray
        Its upper triangle up to `size` is the covariance, in the error coordinates of the filter,
        less what waits.
    size : (1,) ndarray of int
        Dimension of the state.
    points : Points
    late : (rows, capacity) ndarray
        U of `ekfslam.filters.delayed`; without rows, nothing ever waits.
    held : (1,) ndarray of int
        How many of its rows do.
    workspace : Workspace
    """

    mean: Array
    covariance: Array
    size: np.ndarray
    points: Points
    late: Array
    held: np.ndarray
    workspace: Workspace


class Register(NamedTuple):
    """Landmarks by index: identity known from outside, or order of discovery.

    Attributes
    ----------
    offsets : (capacity,) ndarray of int
        Where each stands in the state, -1 for not mapped.
    sizes : (capacity,) ndarray of int
        Its coordinates: 2 of a point, 4 of an inverse depth.
    sightings : (capacity,) ndarray of int
        How often it has been used since it was mapped.
    evidence : (capacity,) ndarray of int
        Looks in which it was seen less those in which it should have been, see `upkeep`.
    rejections : (capacity,) ndarray of int
        Sightings in a row that the gate of known identities refused.
    spread : (capacity,) ndarray
        Its sigma [m] when it became a point.
    descriptor : (capacity, 2) ndarray
        Mean of its descriptor, and how many readings are in it.
    used : (1,) ndarray of int
        Indices in use.
    """

    offsets: np.ndarray
    sizes: np.ndarray
    sightings: np.ndarray
    evidence: np.ndarray
    rejections: np.ndarray
    spread: Array
    descriptor: Array
    used: np.ndarray

    @classmethod
    def of(cls, capacity: int) -> Register:
        """A register without landmarks."""
        whole = [np.zeros(capacity, dtype=np.int64) for _ in range(5)]
        whole[0] -= 1
        used = np.zeros(1, dtype=np.int64)
        return cls._make([*whole, np.zeros(capacity), np.zeros((capacity, 2)), used])

    def grown(self, capacity: int) -> Register:
        """The same landmarks with more room."""
        missing = capacity - len(self.offsets)
        if missing <= 0:
            return self
        more = Register.of(missing)
        columns = [np.concatenate(pair) for pair in zip(self[:-1], more[:-1], strict=True)]
        return Register._make([*columns, self.used])


class Tentative(NamedTuple):
    """Things seen that are not yet landmarks; the filter knows nothing of them.

    Attributes
    ----------
    position : (T, 2) ndarray
        Where each was seen last [m].
    covariance : (T, 2, 2) ndarray
        Of that.
    sightings : (T,) ndarray of int
        How many, 0 for a free place.
    born, seen : (T,) ndarray of int
        Step of the first, and of the last.
    """

    position: Array
    covariance: Array
    sightings: np.ndarray
    born: np.ndarray
    seen: np.ndarray

    @classmethod
    def of(cls, places: int) -> Tentative:
        """Nothing tentative yet."""
        whole = [np.zeros(places, dtype=np.int64) for _ in range(3)]
        return cls(np.zeros((places, 2)), np.zeros((places, 2, 2)), *whole)


class Waiting(NamedTuple):
    """Ranges of landmarks that they do not determine yet, and the past poses they were seen from.

    A past pose stays in the state as a clone until nothing that waits needs it any more.

    Attributes
    ----------
    row, landmark, clone : (W,) ndarray of int
        Observation, register index of its landmark, and clone; row -1 is a free place.
    kind : (W,) ndarray of int
    mount : (W, 3) ndarray
    value, variance : (W,) ndarray
        What was seen.
    clones : (C,) ndarray of int
        Where each clone stands in the state, -1 for a free place.
    step, robot : (C,) ndarray of int
        Whose pose of which step it is.
    """

    row: np.ndarray
    landmark: np.ndarray
    clone: np.ndarray
    kind: np.ndarray
    mount: Array
    value: Array
    variance: Array
    clones: np.ndarray
    step: np.ndarray
    robot: np.ndarray

    @classmethod
    def of(cls, rows: int, clones: int) -> Waiting:
        """Nothing waits."""
        whole = [np.full(rows, -1, dtype=np.int64) for _ in range(4)]
        past = [np.full(clones, -1, dtype=np.int64) for _ in range(3)]
        return cls._make([*whole, np.zeros((rows, 3)), np.zeros(rows), np.zeros(rows), *past])


class Bank(NamedTuple):
    """Bearing hypotheses of landmarks that are known by ranges alone.

    Attributes
    ----------
    offsets : (N, B) ndarray of int
        Where the hypotheses of each landmark stand in the state, -1 for none.
    weights : (N, B) ndarray
        Their probabilities.
    """

    offsets: np.ndarray
    weights: Array

    @classmethod
    def of(cls, landmarks: int, hypotheses: int) -> Bank:
        """No hypotheses yet."""
        shape = (landmarks, hypotheses)
        return cls(np.full(shape, -1, dtype=np.int64), np.zeros(shape))


class State(NamedTuple):
    """All that the filter holds between two steps.

    Attributes
    ----------
    slam : MapArrays
    register : Register
    tentative : Tentative
    waiting : Waiting
    bank : Bank
    clock : (1,) ndarray of int
        Present step.
    """

    slam: MapArrays
    register: Register
    tentative: Tentative
    waiting: Waiting
    bank: Bank
    clock: np.ndarray


class Log(NamedTuple):
    """What the loop writes down: per pose, and per observation.

    Attributes
    ----------
    poses : (R, K + 1, 3), covariances : (R, K + 1, 3, 3)
    nis, seconds : (K + 1,), dof : (K + 1,) of int
    decision, landmark : (M,) of int
        The landmark by its index in the register, -1 for none.
    innovation : (M, 2), S : (M, 2, 2)
    """

    poses: Array
    covariances: Array
    nis: Array
    dof: np.ndarray
    seconds: Array
    decision: np.ndarray
    landmark: np.ndarray
    innovation: Array
    S: Array

    @classmethod
    def of(cls, robots: int, steps: int, rows: int, refused: int) -> Log:
        """An empty log; observations count as `refused` until something else is said of them."""
        return cls(
            np.full((robots, steps, 3), np.nan),
            np.full((robots, steps, 3, 3), np.nan),
            np.full(steps, np.nan),
            np.zeros(steps, dtype=np.int64),
            np.full(steps, np.nan),
            np.full(rows, refused, dtype=np.int64),
            np.full(rows, -1, dtype=np.int64),
            np.full((rows, 2), np.nan),
            np.full((rows, 2, 2), np.nan),
        )


class Journal(NamedTuple):
    """Every linear model that was used; columns as in `ekfslam.estimates.Linearizations`.

    The landmark is a register index. A journal without room is not written.
    """

    event: np.ndarray
    row: np.ndarray
    robot: np.ndarray
    step: np.ndarray
    landmark: np.ndarray
    target: np.ndarray
    size: np.ndarray
    rows: np.ndarray
    point: Array
    jacobian: Array
    innovation: Array
    noise: Array
    used: np.ndarray

    @classmethod
    def of(cls, events: int) -> Journal:
        """An empty journal."""
        whole = [np.full(events, -1, dtype=np.int64) for _ in range(8)]
        shapes = ((events, 7), (events, 4, 7), (events, 4), (events, 4, 4))
        models = [np.zeros(shape) for shape in shapes]
        return cls._make([*whole, *models, np.zeros(1, dtype=np.int64)])
