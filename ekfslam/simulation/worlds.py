"""Worlds: where the landmarks are.

A world is a function of its parameters that returns positions (L, 2) [m]; its name and parameters
are the ``[world]`` table of a scenario. A random world is drawn from a seed of its own, so that a
scenario has one map whatever the seed of the run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ekfslam.errors import InputError
from ekfslam.geometry import TAU, Array
from ekfslam.simulation.blocks import BLOCK, FACADE, FARTHEST, LEAST_GAP, NEAREST, Blocks


def points(landmarks: Array) -> Array:
    """Landmarks as listed.

    Parameters
    ----------
    landmarks : (L, 2) array_like
        Positions [m].
    """
    return np.asarray(landmarks, dtype=float)


def circle(count: int, radius: float, centre: Array) -> Array:
    """Landmarks equally spaced on a circle, at the angles 2 pi i / count for i = 1 .. count.

    Parameters
    ----------
    count : int
    radius : float
        [m]
    centre : (2,) array_like
        [m]

    Raises
    ------
    InputError
        For a count below 1 or a centre that is no point.
    """
    _at_least("count", count, 1)
    angles = TAU * np.arange(1, count + 1) / count
    return _pair("centre", centre) + radius * np.column_stack([np.cos(angles), np.sin(angles)])


def cloister(x: Array, y: Array, n: int = 9) -> Array:
    """Two concentric squares of landmarks, like the columns around a cloister (Solà, C.3).

    The outer square has n rows and columns without its four corners, the inner one n - 2: in all
    4 (2 n - 5) landmarks.

    Parameters
    ----------
    x, y : (2,) array_like
        Limits of the cloister [m].
    n : int
        Rows and columns.

    Raises
    ------
    InputError
        For n below 3 or limits that are no pair.
    """
    _at_least("n", n, 3)
    limits = np.column_stack([_pair("x", x), _pair("y", y)])
    outer = np.arange(n - 2) - (n - 3) / 2
    inner = outer[:-1]
    north = np.concatenate(
        [
            np.column_stack([outer, np.full_like(outer, (n - 1) / 2)]),
            np.column_stack([inner, np.full_like(inner, (n - 3) / 2)]),
        ]
    )
    # A quarter turn (x, y) -> (-y, x) of the north side; the text calls it east.
    side = np.column_stack([-north[:, 1], north[:, 0]])
    unit = np.concatenate([north, side, -north, -side]) / (n - 1)
    return limits.mean(axis=0) + unit * (limits[1] - limits[0])


def scatter(count: int, x: Array, y: Array, min_distance: float, seed: int) -> Array:
    """Landmarks uniform in a rectangle, none nearer to another than `min_distance`.

    Darts are thrown one by one; one that falls too near an earlier one is thrown again.

    Parameters
    ----------
    count : int
    x, y : (2,) array_like
        Limits of the rectangle [m].
    min_distance : float
        [m]
    seed : int
        Of the map.

    Raises
    ------
    InputError
        If the rectangle is too small for so many.
    """
    _at_least("count", count, 1)
    _at_least("seed", seed, 0)
    limits = np.column_stack([_pair("x", x), _pair("y", y)])
    random = np.random.default_rng(seed)
    found = np.empty((0, 2))
    for _ in range(1000 * count):
        dart = random.uniform(limits[0], limits[1])
        if (np.hypot(*(found - dart).T) >= min_distance).all():
            found = np.vstack([found, dart])
        if len(found) == count:
            return found
    raise InputError(
        f"no room for {count} landmarks {min_distance:g} m apart; {len(found)} were placed"
    )


def streets(count: int, seed: int, block: float = BLOCK, facade: float = FACADE) -> Array:
    """Landmarks along both sides of the streets of a city, which grows with their number.

    The city is a rectangle of square blocks, the smallest that has room. Landmarks are spread
    evenly over all facades, each at random within its share of them and between 4.5 and 6 m from
    the middle of the street; none is within 8 m of a crossing along the street, nor nearer than
    2 m to another.

    Parameters
    ----------
    count : int
    seed : int
        Of the map.
    block : float
        Side of a block, from street to street [m].
    facade : float
        Least room for a landmark along the facades [m]; whole blocks make it somewhat more.

    Raises
    ------
    InputError
        For a count below 1, a negative seed, blocks below 20 m or a facade below 2 m.
    """
    city = Blocks.for_landmarks(count, block, facade)
    _at_least("seed", seed, 0)
    draws = np.random.default_rng(seed).random((count, 2))
    room = city.facades / count
    along = room * np.arange(count) + 0.5 * LEAST_GAP + (room - LEAST_GAP) * draws[:, 0]
    return city.beside(along, NEAREST + (FARTHEST - NEAREST) * draws[:, 1])


WORLDS: Mapping[str, Callable[..., Array]] = {
    "points": points,
    "circle": circle,
    "cloister": cloister,
    "scatter": scatter,
    "streets": streets,
}


def _at_least(name: str, value: int, least: int) -> None:
    if value < least:
        raise InputError(f"{name} must be at least {least}, got {value}")


def _pair(name: str, value: Array) -> Array:
    pair = np.asarray(value, dtype=float)
    if pair.shape != (2,) or not np.isfinite(pair).all():
        raise InputError(f"{name} must be two finite numbers")
    return pair
