"""Logs of MRCLAM brought to the steps of a dataset: the run's time, moves, and sightings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.datasets.mrclam_files import ROBOTS, UNKNOWN, Log
from ekfslam.datasets.resampling import composed, interpolated, nearest
from ekfslam.errors import FileFormatError
from ekfslam.geometry import Array
from ekfslam.models.motion import Increments, MotionModel
from ekfslam.observations import NO_LANDMARK, Observations
from ekfslam.robots import LandmarkMap, Prior, Robot

AT_REST = 0.1  # of the standard deviations that is left when told to stand
LONGEST_GAP = 0.5  # [s] between two rows of truth that is bridged; in set 1 it is 0.08 s at most
SAME_END = 1.0  # [s] by which the truth may end before the commands, and end the run


class Sighted(NamedTuple):
    """Sightings of one robot, as columns in order of time, and how many were left out why."""

    step: np.ndarray
    time: Array
    values: Array
    landmark: np.ndarray
    observed_robot: np.ndarray
    left_out: dict[str, int]

    def without(self, bad: np.ndarray, why: str) -> Sighted:
        """The same without some of them."""
        left_out = self.left_out | ({why: int(bad.sum())} if bad.any() else {})
        step, time, values, landmark, observed_robot = (column[~bad] for column in self[:5])
        return Sighted(step, time, values, landmark, observed_robot, left_out)


def truth_at(log: Log, times: Array, step: float) -> Array:
    """True poses (K + 1, 3) at some times, NaN where not known.

    A pose takes what is known of an instant within half a step if the truth is sparse, and is
    interpolated over gaps of up to `LONGEST_GAP` otherwise.
    """
    if not len(log.truth):
        return np.full((len(times), 3), np.nan)
    stamps, poses = log.truth[:, 0], log.truth[:, 1:]
    if not log.sparse:
        return interpolated(stamps, poses, times, LONGEST_GAP)
    instant = nearest(stamps, times)
    near = np.abs(stamps[instant] - times) <= 0.5 * step
    return np.where(near[:, None], poses[instant], np.nan)


def span(logs: Sequence[Log], step: float) -> tuple[float, float]:
    """When the run starts and ends: see `ekfslam.datasets.mrclam.load`.

    Raises
    ------
    FileFormatError
        If the robots have no time in common, or the truth is never known of all.
    """
    names = ", ".join(log.timed for log in logs)
    start = max(log.commands[0, 0] for log in logs)
    ends = []
    for log in logs:
        end = log.commands[-1, 0]
        if len(log.truth) and not log.sparse and 0 < end - log.truth[-1, 0] < SAME_END:
            end = log.truth[-1, 0]
        ends.append(end)
    end = min(ends)
    true = [log for log in logs if len(log.truth)]
    if true:
        fewest = min(true, key=lambda log: len(log.truth))
        instants = np.union1d(start, fewest.truth[:, 0])
        instants = instants[(instants >= start) & (instants < end)]
        known = [np.isfinite(truth_at(log, instants, step)[:, 0]) for log in true]
        instants = instants[np.all(known, axis=0)]
        if not len(instants):
            raise FileFormatError(
                f"{names}: no time at which the truth is known and commands are there for all "
                f"of them, which is from {start:.3f} to {end:.3f}"
            )
        start = float(instants[0])
    if end - start < step:
        raise FileFormatError(
            f"{names}: no step of {step:g} s is in the time that all have in common, from "
            f"{start:.3f} to {end:.3f}"
        )
    return start, end


def moves_of(log: Log, times: Array, rates: Array) -> Increments:
    """Increments from pose to pose: commands hold until the next, along exact arcs.

    Parameters
    ----------
    log : Log
        With the stamps at which commands reach the wheels.
    times : (K + 1,) ndarray
    rates : (3, 3) ndarray
        Covariance of a second of driving; it grows with time.
    """
    stamps = log.commands[:, 0]
    edges = np.union1d(times, stamps[(stamps > times[0]) & (stamps < times[-1])])
    # The last of several commands of one stamp holds; before the first there is none.
    held = np.searchsorted(stamps, edges[:-1], side="right") - 1
    told = np.where((held >= 0)[:, None], log.commands[held, 1:], 0.0)
    dt = np.diff(edges)
    noiseless = MotionModel("velocity", np.zeros((2, 2)))
    deltas = noiseless.increments(np.column_stack([told, dt])).deltas
    share = np.where(told.any(axis=1), 1.0, AT_REST**2) * dt
    pieces = Increments(deltas, share[:, None, None] * rates)
    return composed(pieces, np.searchsorted(edges, times))


def robot_of(log: Log, times: Array, rates: Array, prior: Array) -> Robot:
    """The robot of a log.

    Parameters
    ----------
    log : Log
    times : (K + 1,) ndarray
    rates : (3, 3) ndarray
        As of `moves_of`.
    prior : (3, 3) ndarray
        Covariance of the first pose, whose mean is the true one, or zero if there is no truth.
    """
    step = times[1] - times[0]
    moves = moves_of(log, times, rates)
    truth = truth_at(log, times, step) if len(log.truth) else None
    start = np.zeros(3) if truth is None else truth[0]
    return Robot(
        MotionModel("odometry", step * rates),
        moves.deltas,
        Prior(start, prior),
        truth,
        log.name,
        moves.covariances,
    )


def sighted(log: Log, times: Array, team: Mapping[int, int], every: float) -> Sighted:
    """What a robot saw of landmarks and of the team, each sighting at the nearest pose.

    Parameters
    ----------
    log : Log
        With the times at which the images were taken.
    times : (K + 1,) ndarray
    team : mapping
        Index of each robot that may be seen.
    every : float
        Time from one sighting of something to the next [s].
    """
    half = 0.5 * (times[1] - times[0])
    is_robot = np.isin(log.subject, ROBOTS)
    others = [robot for robot in team if robot != log.robot]
    index = np.full(max(*ROBOTS, int(log.subject.max())) + 1, NO_LANDMARK)
    index[list(team)] = list(team.values())
    columns = Sighted(
        nearest(times, log.time),
        log.time,
        log.values,
        np.where(is_robot, NO_LANDMARK, log.subject),
        index[log.subject],
        {},
    )
    once = np.unique(np.column_stack([log.time, log.subject]), axis=0, return_index=True)[1]
    reasons = {
        "of an unknown barcode or its own": np.isin(log.subject, (UNKNOWN, log.robot)),
        "of robots that are not there": is_robot & ~np.isin(log.subject, others),
        "before or after the run": (log.time < times[0] - half) | (log.time > times[-1] + half),
        "repeated at one instant": ~np.isin(np.arange(len(log.time)), once),
    }
    left = np.arange(len(log.time))
    for why, bad in reasons.items():
        columns, left = columns.without(bad[left], why), left[~bad[left]]
    crowded = _first_within(columns.time, log.subject[left], every) != np.arange(len(left))
    return columns.without(crowded, f"less than {every:g} s after the last of the same")


def misread(seen: Sighted, truths: Sequence[Array], who: int, landmarks: LandmarkMap) -> Array:
    """How far bearings are from where the truth has what was seen [rad], 0 where it is not known.

    Parameters
    ----------
    seen : Sighted
    truths : sequence of (K + 1, 3) ndarray
        Of all robots.
    who : int
        Index of the robot that saw.
    landmarks : LandmarkMap
    """
    order = np.argsort(landmarks.ids)
    row = order[np.minimum(np.searchsorted(landmarks.ids[order], seen.landmark), len(order) - 1)]
    points = landmarks.positions[row]
    shown = seen.observed_robot >= 0
    points[shown] = np.array(truths)[seen.observed_robot[shown], seen.step[shown], :2]
    at = geo.to_frame(truths[who][seen.step], points)
    away = np.abs(geo.wrap(seen.values[:, 1] - np.arctan2(at[:, 1], at[:, 0])))
    return np.nan_to_num(away)


def counts_together(seen: Sighted, within: float) -> np.ndarray:
    """How many sightings of the same thing come within some time [s] of the first of them, (m,)."""
    things = np.where(
        seen.observed_robot >= 0, NO_LANDMARK - 1 - seen.observed_robot, seen.landmark
    )
    first = _first_within(seen.time, things, within)
    return np.bincount(first, minlength=len(first))[first]


def together(columns: Sequence[Sighted], covariances: Sequence[Array]) -> Observations:
    """Sightings of several robots, each by a sensor of its own, in order of time."""
    robot = np.repeat(np.arange(len(columns)), [len(one.time) for one in columns])
    step, time, values, landmark, observed = (
        np.concatenate([one[i] for one in columns]) for i in range(5)
    )
    order = np.lexsort((robot, time))
    return Observations(
        step=step[order],
        values=values[order],
        landmark=landmark[order],
        sensor=robot[order],
        robot=robot[order],
        time=time[order],
        covariance=np.concatenate(covariances)[order],
        observed_robot=observed[order] if len(columns) > 1 else None,
    )


def _first_within(time: Array, things: np.ndarray, within: float) -> np.ndarray:
    """Row of the first of each run of sightings of one thing that takes less than some time."""
    open_row: dict[int, int] = {}
    first = np.empty(len(time), dtype=np.int64)
    stamps = time.tolist()
    for row, thing in enumerate(things.tolist()):
        since = open_row.get(thing)
        if since is None or stamps[row] - stamps[since] >= within:
            since = open_row[thing] = row
        first[row] = since
    return first
