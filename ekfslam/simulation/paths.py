"""Paths: where the robot is told to go.

A path is a function of its parameters that returns the start pose and the commanded controls; its
name and parameters are the ``[path]`` table of a scenario.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import islice
from math import atan2, cos, hypot, pi, remainder, sin
from typing import NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.errors import InputError
from ekfslam.geometry import TAU, Array
from ekfslam.simulation.blocks import BLOCK, FACADE, UNITS, Blocks

CHORDS_PER_LAP = 200_000  # arc length of a lap of park is then right to some 1e-9 m
MOST_STEPS = 1_000_000  # of a run whose length is worked out: more is a mistake in a unit
TURNING = 6.0  # radius of the turns of a tour [m]: no nearer to a facade than the street is


class Path(NamedTuple):
    """A commanded run.

    Attributes
    ----------
    start : (3,) ndarray
        True first pose [m, m, rad].
    controls : (K, m) ndarray
        Commands, in the columns of the motion model.
    motion : str or None
        The one kind of motion model that the controls are for; None if they are as given.
    wheelbase : float or None
        Of the car that they steer [m]; None if they steer none.
    """

    start: Array
    controls: Array
    motion: str | None = None
    wheelbase: float | None = None


def repeated(start: Array, controls: Array, repeat: int = 1) -> Path:
    """A list of controls, over and over.

    Parameters
    ----------
    start : (3,) array_like
    controls : (n, m) array_like
        In the columns of the motion model.
    repeat : int
        How many times the whole list is commanded.

    Raises
    ------
    InputError
        If `controls` is no table or `repeat` is below 1.
    """
    controls = np.asarray(controls, dtype=float)
    if controls.ndim != 2:
        raise InputError("controls must be a list of controls, each a list of numbers")
    if repeat < 1:
        raise InputError(f"repeat must be at least 1, got {repeat}")
    return Path(np.asarray(start, dtype=float), np.tile(controls, (repeat, 1)))


def through(poses: Array) -> Path:
    """From one pose to the next, as listed.

    Parameters
    ----------
    poses : (K + 1, 3) array_like
        In the world [m, m, rad], the start first.

    Returns
    -------
    Path
        Controls are the increments between successive poses, for the motion model ``odometry``.

    Raises
    ------
    InputError
        If they are not two poses at least.
    """
    poses = np.asarray(poses, dtype=float)
    if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) < 2:
        raise InputError("poses must be two at least, each (x, y, theta)")
    return Path(poses[0], geo.between(poses[:-1], poses[1:]), "odometry")


def along(points: Array, spacing: float, laps: int = 1) -> Path:
    """Along straight lines from point to point, in steps of equal length.

    The robot heads for the next point; at a corner it turns within a step. What is left of the last
    line and shorter than a step is not driven.

    Parameters
    ----------
    points : (n, 2) array_like
        [m]
    spacing : float
        Length of a step along the lines [m].
    laps : int
        More than one return to the first point, and go round again.

    Returns
    -------
    Path
        Controls are the increments between successive poses, for the motion model ``odometry``.

    Raises
    ------
    InputError
        For points that are no list of at least two, two in a row that are the same, a spacing that
        is not positive or longer than the way, and laps below 1.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise InputError("points must be two at least, each (x, y)")
    if laps < 1:
        raise InputError(f"laps must be at least 1, got {laps}")
    corners = np.concatenate([np.tile(points, (laps, 1)), points[: int(laps > 1)]])
    lines = np.diff(corners, axis=0)
    lengths = np.hypot(*lines.T)
    for number in np.flatnonzero(lengths == 0)[:1] % len(points):
        raise InputError(f"point {number + 1} and the one after it are the same")
    if not 0 < spacing <= lengths.sum():
        raise InputError(f"spacing must be positive and at most the way, got {spacing}")
    steps = lengths.sum() / spacing
    if steps > MOST_STEPS:
        raise InputError(f"a spacing of {spacing:g} m makes more than {MOST_STEPS} steps")
    travelled = spacing * np.arange(int(steps * (1 + 1e-12)) + 1)
    ends = np.cumsum(lengths)
    line = np.minimum(np.searchsorted(ends, travelled, side="right"), len(lines) - 1)
    within = (travelled - (ends - lengths)[line]) / lengths[line]
    position = corners[line] + within[:, None] * lines[line]
    return through(np.column_stack([position, np.arctan2(lines[line, 1], lines[line, 0])]))


def figure_eight(centre: Array, amplitude: Array, spacing: float, laps: float = 1.0) -> Path:
    """The curve ``x = cx + ax cos t, y = cy + ay sin 2t``, in steps of equal arc length.

    Headings are tangent to the curve. The run starts at t = 0 and has
    ``floor(laps * length / spacing)`` poses, so the last one does not come back onto the first.

    Parameters
    ----------
    centre, amplitude : (2,) array_like
        (cx, cy) and (ax, ay) [m].
    spacing : float
        Arc length of a step [m].
    laps : float

    Returns
    -------
    Path
        Controls are the increments between successive poses, for the motion model ``odometry``.

    Raises
    ------
    InputError
        For amplitudes, spacing or laps that are not positive, or laps shorter than a step.
    """
    centre, amplitude = np.asarray(centre, dtype=float), np.asarray(amplitude, dtype=float)
    if centre.shape != (2,) or amplitude.shape != (2,) or not np.isfinite(centre).all():
        raise InputError("centre and amplitude must be two finite numbers each")
    positive = np.array([*amplitude, spacing, laps])
    if not (np.isfinite(positive).all() and (positive > 0).all()):
        raise InputError("amplitude, spacing and laps must be positive")

    def position(t: Array) -> Array:
        return centre + amplitude * np.column_stack([np.cos(t), np.sin(2 * t)])

    t = np.linspace(0.0, TAU, CHORDS_PER_LAP + 1)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(position(t), axis=0).T))])
    travelled = spacing * np.arange(int(laps * length[-1] / spacing))
    if len(travelled) < 2:
        raise InputError(f"a step of {spacing:g} m does not fit into {laps * length[-1]:.3g} m")
    t = np.interp(travelled % length[-1], length, t)
    tangent = amplitude * np.column_stack([-np.sin(t), 2 * np.cos(2 * t)])
    poses = np.column_stack([position(t), np.arctan2(tangent[:, 1], tangent[:, 0])])
    return Path(poses[0], geo.between(poses[:-1], poses[1:]), "odometry")


def unguided(start: Array, steps: int) -> Path:
    """No command at all, for the motion model ``none``: the path is what the noise makes of it.

    Parameters
    ----------
    start : (3,) array_like
    steps : int

    Raises
    ------
    InputError
        If `steps` is below 1.
    """
    if steps < 1:
        raise InputError(f"steps must be at least 1, got {steps}")
    return Path(np.asarray(start, dtype=float), np.zeros((steps, 0)), "none")


def steered(
    start: Array,
    waypoints: Array,
    speed: float,
    time_step: float,
    wheelbase: float,
    max_steer: float,
    steer_rate: float,
    radius: float = 1.0,
    laps: int = 1,
) -> Path:
    """A car that steers for one waypoint after the other (Bailey et al. 2006).

    The wheels turn towards the waypoint from where the car truly is, as fast and as far as they
    may. A waypoint is reached within `radius`; after the last one a lap begins anew with the
    first, and the run ends at the last waypoint of the last lap.

    Parameters
    ----------
    start : (3,) array_like
        The wheels point straight ahead.
    waypoints : (n, 2) array_like
        [m]
    speed : float
        Of the front wheels [m/s].
    time_step : float
        Of a control [s].
    wheelbase : float
        [m], the same as of the motion model.
    max_steer, steer_rate : float
        Largest angle of the wheels [rad] and how fast it changes [rad/s].
    radius : float
        [m]
    laps : int

    Returns
    -------
    Path
        Controls (V, gamma, dt) for the motion model ``car``.

    Raises
    ------
    InputError
        For values that are not positive, waypoints that are no list of points, a waypoint that the
        car circles without reaching it, and one that is more than a million steps away.
    """
    start, waypoints = np.asarray(start, dtype=float), np.asarray(waypoints, dtype=float)
    if start.shape != (3,) or waypoints.ndim != 2 or waypoints.shape[1] != 2 or not len(waypoints):
        raise InputError("start must be a pose (x, y, theta) and waypoints a list of points (x, y)")
    positive = np.array([speed, time_step, wheelbase, max_steer, steer_rate, radius, laps])
    if not (np.isfinite(positive).all() and (positive > 0).all() and max_steer < pi / 2):
        raise InputError(
            "speed, time_step, wheelbase, steer_rate, radius and laps must be positive, "
            "and max_steer an angle up to 90 deg"
        )
    x, y, heading = start.tolist()
    step, turning, steer = speed * time_step, wheelbase / sin(max_steer), 0.0
    angles: list[float] = []
    for number, (to_x, to_y) in enumerate(waypoints.tolist() * laps):
        away = hypot(to_x - x, to_y - y)
        if len(angles) + away / step > MOST_STEPS:
            raise InputError(
                f"waypoint {number % len(waypoints) + 1} is {away:.3g} m away: with steps of "
                f"{step:.3g} m the run takes more than {MOST_STEPS} steps"
            )
        patience = int(10 * (away + turning) / step)
        while hypot(to_x - x, to_y - y) > radius:
            wanted = remainder(atan2(to_y - y, to_x - x) - heading - steer, 2 * pi)
            most = steer_rate * time_step
            steer += min(max(wanted, -most), most)
            steer = min(max(steer, -max_steer), max_steer)
            angles.append(steer)
            x += step * cos(heading + steer)
            y += step * sin(heading + steer)
            heading += step * sin(steer) / wheelbase
            patience -= 1
            if not patience:
                raise InputError(
                    f"waypoint {number % len(waypoints) + 1} cannot be reached: the car turns on "
                    f"{turning:.3g} m at best and passes it by more than {radius:g} m"
                )
    gamma = np.array(angles)
    controls = np.column_stack([np.full_like(gamma, speed), gamma, np.full_like(gamma, time_step)])
    return Path(start, controls, "car", wheelbase)


def tour(
    count: int,
    spacing: float,
    steps: int | None = None,
    block: float = BLOCK,
    facade: float = FACADE,
) -> Path:
    """A drive along all streets of the city of the world ``streets``, in steps of equal length.

    It starts at the lower left crossing and takes the nearest of the streets that have been driven
    least often; see `Blocks.drive`. Turns are arcs.

    Parameters
    ----------
    count : int
        Landmarks of the world. In a scenario, this and the blocks are those of its ``[world]``.
    spacing : float
        Arc length of a step [m].
    steps : int, optional
        As many as it takes to drive every street once by default. A run that is longer drives them
        again.
    block, facade : float
        As of the world [m].

    Returns
    -------
    Path
        Controls are the increments between successive poses, for the motion model ``odometry``.

    Raises
    ------
    InputError
        For a spacing that is not positive or longer than a block, steps below 1 or above a million,
        and blocks that the world refuses.
    """
    city = Blocks.for_landmarks(count, block, facade)
    if not 0 < spacing <= block:
        raise InputError(f"spacing must be positive and at most a block, got {spacing}")
    if steps is None:
        headings = list(city.once())
    elif 1 <= steps <= MOST_STEPS:
        shortest = block - (2 - pi / 2) * TURNING  # way of a street with a turn at each end
        enough = int(steps * spacing / shortest) + 1
        headings = list(islice(city.drive(), enough + 1))  # one more for the turn into it
    else:
        raise InputError(f"steps must be from 1 to {MOST_STEPS}, got {steps}")
    starts, curvatures, lengths = _lines_and_arcs(city, headings)
    ends = np.cumsum(lengths)
    if steps is None:
        steps = int(ends[-1] / spacing)
        if steps > MOST_STEPS:
            raise InputError(f"a spacing of {spacing:g} m makes more than {MOST_STEPS} steps")
    travelled = spacing * np.arange(steps + 1)
    piece = np.minimum(np.searchsorted(ends, travelled), len(ends) - 1)
    within = travelled - (ends - lengths)[piece]
    along = np.column_stack([within, np.zeros_like(within), curvatures[piece] * within])
    poses = geo.compose(starts[piece], geo.exp(along))
    return Path(poses[0], geo.between(poses[:-1], poses[1:]), "odometry")


def _lines_and_arcs(city: Blocks, headings: list[int]) -> tuple[Array, Array, Array]:
    """A drive as a line and an arc for each street: start poses, curvatures [1/m], lengths [m]."""
    heading = np.array(headings)
    unit = UNITS[heading]
    turn = (np.diff(heading, append=heading[-1]) + 1) % 4 - 1
    crossing = city.side * np.cumsum(unit, axis=0)
    after = TURNING * np.abs(turn)
    before = np.concatenate([[0.0], after[:-1]])
    line = city.side - before - after
    theta = geo.wrap(0.5 * pi * heading)
    starts = [
        np.column_stack([crossing - away[:, None] * unit, theta]) for away in (line + after, after)
    ]
    curvatures = [np.zeros(len(heading)), turn / TURNING]
    lengths = [line, 0.5 * pi * after]
    return (
        np.stack(starts, axis=1).reshape(-1, 3),
        np.stack(curvatures, axis=1).ravel(),
        np.stack(lengths, axis=1).ravel(),
    )


PATHS: Mapping[str, Callable[..., Path]] = {
    "controls": repeated,
    "poses": through,
    "points": along,
    "figure-eight": figure_eight,
    "waypoints": steered,
    "unguided": unguided,
    "tour": tour,
}
