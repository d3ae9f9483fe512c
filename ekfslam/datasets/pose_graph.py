"""From the records of a graph to a dataset: a drive, and what was seen on the way.

A graph file says which poses there are and how they and the landmarks lie to each other. A dataset
says more, that the poses follow each other, and can say less: what ties poses together that do not
follow each other, a loop closure, or a prior of what is not a start, has no place in it.

Poses are in the order of their numbers. Each has a motion to the next; one that is written the
other way round is turned. Where there is none, the drive of another robot begins, if the file
says where it starts; else the file is damaged.

Frame of the noise
------------------
The noise of a motion from a to b is written in the frame of b by g2o, TORO and gtsam (body
tangent), in the frame of a by iSAM (added to the increment, as in `Robot.covariance`).
`ekfslam.export` turns one into the other by R(dtheta)'; here it is turned back.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.datasets.graph_parts import ROBOT, Graph, Vertices, repeated
from ekfslam.datasets.graph_sightings import sightings_of
from ekfslam.datasets.options import one_of
from ekfslam.errors import FileFormatError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.observations import Observations
from ekfslam.robots import LandmarkMap, Prior, Robot

EQUAL = 1e-9  # covariances that differ by no more, relative to their deviations, are one


class _Drives(NamedTuple):
    """Poses in order of travel, robot after robot, with the motions between them."""

    order: np.ndarray  # (R * (K + 1),) ids
    robots: int
    deltas: Array  # (R, K, 3)
    covariances: Array  # (R, K, 3, 3), in the frame of the first pose of each

    @property
    def starts(self) -> np.ndarray:
        """Ids of the first poses, (R,)."""
        return self.order.reshape(self.robots, -1)[:, 0]


def dataset_of(
    graph: Graph,
    name: str,
    robot: str = "robot",
    unsupported: str = "refuse",
    truth: bool = False,
    provenance: str = "",
) -> Dataset:
    """Make a dataset of a graph.

    Parameters
    ----------
    graph : Graph
    name : str
    robot : str
        What its robots are called.
    unsupported : {"refuse", "drop"}
        What to do with lines that a dataset has no place for; how many were dropped is noted.
    truth : bool
        Whether the values of poses and landmarks are the truth. Else they are what an optimiser
        is to start from, and only that of the first pose is used.

    Returns
    -------
    Dataset
        Association known. Times are those of the poses, or, if the file has none or always the
        same, the steps. The first pose is known exactly where the file fixes it or says nothing
        of it.

    Raises
    ------
    FileFormatError
        If the records do not hang together; names the line.
    InputError
        For an unknown option.
    """
    one_of(unsupported, ("refuse", "drop"), "unsupported")
    beyond = list(graph.beyond)
    drives = _drives(graph, beyond)
    times = _times(graph, drives)
    sensors, observations = sightings_of(graph, drives.order, drives.robots, times)
    priors, said = _priors(graph, drives, beyond)
    notes = [_counts(drives, observations), *said]
    if again := int(repeated(_said(observations)).sum()):
        notes.append(f"{again} sightings repeat another from the same pose to the last digit.")
    if beyond:
        line, what = min(beyond)
        if unsupported == "refuse":
            raise FileFormatError(
                f"{graph.path}, line {line}: {what}; a dataset has no place for that "
                "(unsupported=drop leaves such lines out)"
            )
        notes.append(f"{len(beyond)} lines were left out, first line {line}: {what}.")
    positions = _values(graph.landmarks)
    known = positions.keys() & set(graph.fixed.ids.tolist())
    if known:
        notes.append(f"{len(known)} landmarks are fixed: they are the known map.")
    motion, own = _motion_model(drives.covariances)
    poses = _values(graph.poses)
    robots = tuple(
        Robot(
            motion,
            drives.deltas[r],
            priors[r],
            np.array([poses[i] for i in chain.tolist()]) if truth and poses else None,
            robot,
            own[r] if own is not None else None,
        )
        for r, chain in enumerate(drives.order.reshape(drives.robots, -1))
    )
    return Dataset(
        name=name,
        robots=robots,
        times=np.arange(drives.deltas.shape[1] + 1.0) if times is None else times,
        sensors=sensors,
        observations=observations,
        known_map=_map(known, positions) if known else None,
        true_map=_map(positions, positions) if truth and positions else None,
        provenance=provenance or graph.path.name,
        notes=tuple(notes),
    )


def _counts(drives: _Drives, seen: Observations) -> str:
    """What was read, since a file that ends early cannot always be told from one that is whole."""
    of = "" if drives.robots == 1 else f" of {drives.robots} robots"
    return (
        f"Read: {len(drives.order)} poses{of}, {len(seen)} sightings of "
        f"{len(np.unique(seen.landmark))} landmarks."
    )


def _said(seen: Observations) -> np.ndarray:
    """What each sighting says, whatever the sensor that is made up for it."""
    time = seen.step if seen.time is None else seen.time
    return np.column_stack([seen.step, seen.robot, seen.landmark, time, seen.values])


# Poses --------------------------------------------------------------------------------------------


def _drives(graph: Graph, beyond: list[tuple[int, str]]) -> _Drives:
    """The motions that lead from each pose to the next; all others go beyond a dataset."""
    motions, named = graph.motions, graph.named
    if not len(motions.line):
        raise FileFormatError(f"{graph.path}: holds no odometry")
    graph.refuse(
        motions.line,
        np.abs(motions.values[:, 2]) > geo.TAU,
        lambda row: f"a turn of {motions.values[row, 2]:g} is none in radians",
    )
    order = np.unique(np.concatenate([motions.start, motions.end]))
    _check_poses(graph, order)
    a, b = np.searchsorted(order, motions.start), np.searchsorted(order, motions.end)
    gap = np.minimum(a, b)
    next_ = (np.abs(a - b) == 1) & (motions.start // ROBOT == motions.end // ROBOT)
    again = next_.copy()
    again[next_] = repeated(gap[next_])
    for row in np.flatnonzero(~next_ | again).tolist():
        what = "a second motion between" if again[row] else "a loop closure, a motion between"
        ends = f"pose {named(motions.start[row])} and pose {named(motions.end[row])}"
        beyond.append((int(motions.line[row]), f"{what} {ends}"))
    between = np.full(len(order) - 1, -1)
    rows = np.flatnonzero(next_ & ~again)
    between[gap[rows]] = rows
    robots = _robots(graph, order, np.flatnonzero(between < 0) + 1)
    between = between[between >= 0]
    deltas, covariances = _forward(graph, between, a[between] > b[between])
    shape = (robots, len(between) // robots)
    return _Drives(order, robots, deltas.reshape(*shape, 3), covariances.reshape(*shape, 3, 3))


def _check_poses(graph: Graph, order: np.ndarray) -> None:
    """If the file gives values of poses, it gives them of those that move, and no others."""
    motions, poses, named = graph.motions, graph.poses, graph.named
    if not len(poses.ids):
        return
    loose = ~np.isin(motions.start, poses.ids) | ~np.isin(motions.end, poses.ids)
    graph.refuse(
        motions.line,
        loose,
        lambda row: (
            f"of pose {named(motions.start[row])} or pose {named(motions.end[row])} there "
            "is no vertex"
        ),
    )
    graph.refuse(
        poses.line,
        ~np.isin(poses.ids, order),
        lambda row: f"pose {named(poses.ids[row])} has no odometry",
    )


def _robots(graph: Graph, order: np.ndarray, begins: np.ndarray) -> int:
    """How many robots there are; `begins` says where there is no motion from the pose before."""
    motions, named = graph.motions, graph.named
    first = order[begins]
    held = np.concatenate([graph.fixed.ids, graph.priors.start])
    another = first // ROBOT != order[begins - 1] // ROBOT
    for at in begins[~(np.isin(first, held) | another)][:1]:
        touching = (motions.start == order[at]) | (motions.end == order[at])
        raise FileFormatError(
            f"{graph.path}, line {motions.line[touching].min()}: the odometry chain breaks: it "
            f"goes on from pose {named(order[at])}, and no motion leads there from pose "
            f"{named(order[at - 1])}"
        )
    counts = np.diff(np.concatenate([[0], begins, [len(order)]]))
    if len(set(counts.tolist())) > 1:
        raise FileFormatError(
            f"{graph.path}: {len(counts)} robots have {', '.join(map(str, counts))} poses; those "
            "of a dataset share the times of their poses, and have equally many"
        )
    return len(counts)


def _forward(graph: Graph, rows: np.ndarray, turned: np.ndarray) -> tuple[Array, Array]:
    """Increments and covariances in the frame of the first pose, in the order of travel."""
    motions = graph.motions
    deltas = motions.values[rows]
    given = np.broadcast_to(motions.covariances, (len(motions.line), 3, 3))[rows]
    graph.refuse(
        motions.line[rows],
        np.sqrt(given[:, 2, 2]) > np.pi,
        lambda row: (
            f"the heading's standard deviation is {np.sqrt(given[row, 2, 2]):g} rad; is "
            "the noise a covariance, an information, or its square root?"
        ),
    )
    if graph.frame == "second":
        given = geo.body_to_additive(deltas, given)
    J = np.zeros((len(rows), 3, 3))
    J[:, :2] = geo.to_frame_jacobians(deltas, np.zeros(2))[0]
    J[:, 2, 2] = -1.0  # of the inverse
    back, behind = geo.inverse(deltas), geo.congruence(J, given)
    return (
        np.where(turned[:, None], back, deltas),
        np.where(turned[:, None, None], behind, given),
    )


def _times(graph: Graph, drives: _Drives) -> Array | None:
    """Times of the poses, if the file has them."""
    steps, time = len(drives.order) // drives.robots, graph.poses.time
    if time is None or not np.ptp(time):
        return None
    at = np.argsort(graph.poses.ids)
    times = time[at].reshape(drives.robots, steps)
    late = np.zeros(times.shape, dtype=bool)
    late[:, 1:] = np.diff(times, axis=1) <= 0
    late[1:] |= times[1:] != times[0]
    graph.refuse(
        graph.poses.line[at],
        late.ravel(),
        lambda row: (
            f"time {time[at[row]]:.17g} of pose {graph.named(drives.order[row])} does not "
            "come after that of the pose before, or is not that of the other robots"
        ),
    )
    return times[0]


def _priors(
    graph: Graph, drives: _Drives, beyond: list[tuple[int, str]]
) -> tuple[list[Prior], list[str]]:
    """Priors of the first poses, and what is to be said of them."""
    given, named = graph.priors, graph.named
    starts, held = drives.starts.tolist(), set(graph.fixed.ids.tolist())
    again = repeated(given.start)
    for row in np.flatnonzero(again | ~np.isin(given.start, starts)).tolist():
        beyond.append((int(given.line[row]), f"a prior of pose {named(given.start[row])}"))
    spread = given.covariances
    if graph.frame == "second":
        spread = geo.body_to_additive(given.values, spread)
    priors = {
        int(given.start[row]): Prior(given.values[row], spread[row])
        for row in np.flatnonzero(~again).tolist()
    }
    for line, one in zip(graph.fixed.line.tolist(), graph.fixed.ids.tolist(), strict=True):
        if one in starts or one in graph.landmarks.ids:
            continue
        if one not in drives.order:
            raise FileFormatError(f"{graph.path}, line {line}: there is no {named(one)} to fix")
        beyond.append((line, f"pose {named(one)} is fixed"))
    values = _values(graph.poses)
    exact = {one: Prior(values.get(one, np.zeros(3))) for one in starts}
    free = [one for one in starts if one not in held and one not in priors]
    notes = [
        f"The file does not say how well pose {named(one)} is known: it is held."
        for one in free[:1]
    ]
    return [exact[one] if one in held else priors.get(one, exact[one]) for one in starts], notes


# Small things -------------------------------------------------------------------------------------


def _motion_model(covariances: Array) -> tuple[MotionModel, Array | None]:
    """One noise if all are equal up to rounding, else one for each step."""
    one = covariances[0, 0]
    variances = np.diag(one)
    scale = np.sqrt(np.where(variances > 0, variances, 1.0))
    apart = np.abs(covariances - one) / (scale[:, None] * scale)
    return MotionModel("odometry", one), None if (apart <= EQUAL).all() else covariances


def _values(vertices: Vertices) -> dict[int, Array]:
    """Values by id."""
    return dict(zip(vertices.ids.tolist(), vertices.values, strict=True))


def _map(ids: Iterable[int], positions: dict[int, Array]) -> LandmarkMap:
    some = sorted(ids)
    return LandmarkMap(np.array(some), np.array([positions[one] for one in some]))
