"""A city's streets: a rectangle of square blocks, and a drive along all of its streets.

The world ``streets`` and the path ``tour`` of a scenario stand on the same blocks.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import count as counting
from typing import Any, NamedTuple

import numpy as np

from ekfslam.errors import InputError
from ekfslam.geometry import Array

CORNER = 8.0  # facades begin and end so far from a crossing [m]
NEAREST, FARTHEST = 4.5, 6.0  # facades from the middle of the street [m]
LEAST_GAP = 2.0  # between landmarks of one facade [m]
LEAST_BLOCK = 20.0  # [m]

BLOCK, FACADE = 60.0, 3.5  # [m], by default
UNITS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])  # of the headings east, north, west, south
LEFT, AHEAD, RIGHT = 1, 0, -1

_SHARED = ("count", "block", "facade")

Street = tuple[int, int, int]  # column and row of its first crossing; 0 to the east, 1 to the north


class Blocks(NamedTuple):
    """A rectangle of blocks with the origin in its lower left crossing.

    Attributes
    ----------
    columns, rows : int
        Blocks from west to east and from south to north.
    side : float
        Of a block, from the middle of a street to the middle of the next [m].
    """

    columns: int
    rows: int
    side: float

    @classmethod
    def for_landmarks(cls, count: int, block: float = BLOCK, facade: float = FACADE) -> Blocks:
        """The smallest city that has room, square or a column wider than it is high.

        Parameters
        ----------
        count : int
            Landmarks.
        block : float
            Side of a block [m].
        facade : float
            Room for a landmark, along the facades [m].

        Raises
        ------
        InputError
            For a count below 1, blocks below 20 m, or landmarks closer than 2 m.
        """
        if count < 1:
            raise InputError(f"count must be at least 1, got {count}")
        for name, value, least in (("block", block, LEAST_BLOCK), ("facade", facade, LEAST_GAP)):
            if not (np.isfinite(value) and value >= least):
                raise InputError(f"{name} must be at least {least:g} m, got {value}")
        cities = (cls((size + 1) // 2, size // 2, block) for size in counting(2))
        return next(city for city in cities if city.facades >= facade * count)

    @property
    def streets(self) -> list[Street]:
        """From a crossing to the next: those to the east row by row, then those to the north."""
        columns, rows = range(self.columns + 1), range(self.rows + 1)
        east = [(x, y, 0) for y in rows for x in columns[:-1]]
        return east + [(x, y, 1) for x in columns for y in rows[:-1]]

    @property
    def facade(self) -> float:
        """Length of the facade on a side of a street [m]."""
        return self.side - 2 * CORNER

    @property
    def facades(self) -> float:
        """Length of all facades [m]."""
        streets = self.columns * (self.rows + 1) + self.rows * (self.columns + 1)
        return 2 * streets * self.facade

    def beside(self, along: Array, setback: Array) -> Array:
        """Points (m, 2) of the facades [m]: left of a street, right of it, left of the next one.

        Parameters
        ----------
        along : (m,) ndarray
            From the first facade's begin on, as if all were one [m].
        setback : (m,) ndarray
            From the middle of the street [m].
        """
        facade = (along // self.facade).astype(int)
        streets = np.array(self.streets)[facade // 2]
        ahead, left = UNITS[streets[:, 2]], UNITS[streets[:, 2] + 1]
        forward = CORNER + along % self.facade
        across = np.where(facade % 2 == 0, setback, -setback)
        return self.side * streets[:, :2] + forward[:, None] * ahead + across[:, None] * left

    def drive(self) -> Iterator[int]:
        """Headings, street by street from the origin on, 0 to 3 from east to south, without end.

        The next street is always the nearest of those that have been driven least often: at a
        crossing rather the one to the left than the one to the right, and that rather than the one
        ahead. So it goes round blocks and through the city in zigzags, meets half of the crossings
        again after four streets and others after hundreds. Nobody turns round in a street.
        """
        driven = dict.fromkeys(self.streets, 0)
        crossing, heading = (0, 0), 3  # as if from the north, so that the first one leads east
        while True:
            for ahead in _way(crossing, heading, driven):
                heading = ahead
                street, crossing = _street(crossing, heading)
                driven[street] += 1
                yield heading

    def once(self) -> Iterator[int]:
        """The drive until every street has been driven."""
        left, crossing = set(self.streets), (0, 0)
        for heading in self.drive():
            street, crossing = _street(crossing, heading)
            left.discard(street)
            yield heading
            if not left:
                return


def _street(crossing: tuple[int, int], heading: int) -> tuple[Street, tuple[int, int]]:
    """The street that leaves a crossing, and the crossing at its other end."""
    x, y = crossing
    to = (x + int(UNITS[heading, 0]), y + int(UNITS[heading, 1]))
    return (*min(crossing, to), heading % 2), to


def _way(crossing: tuple[int, int], heading: int, driven: dict[Street, int]) -> tuple[int, ...]:
    """Headings to the nearest of the streets that have been driven least often, and along it."""
    least = min(driven.values())
    ways: deque[tuple[tuple[int, int], tuple[int, ...]]] = deque([(crossing, (heading,))])
    met = set()
    while True:
        crossing, way = ways.popleft()
        for turn in (LEFT, RIGHT, AHEAD):
            heading = (way[-1] + turn) % 4
            street, to = _street(crossing, heading)
            if driven.get(street) == least:
                return (*way[1:], heading)
            if street in driven and (to, heading) not in met:
                met.add((to, heading))
                ways.append((to, (*way, heading)))


def share(document: dict[str, Any], where: str) -> None:
    """Give each tour of a scenario's document the blocks of its world, in place.

    Parameters
    ----------
    document : dict
        As read from TOML.
    where : str
        What an error calls the document.

    Raises
    ------
    InputError
        For a tour in a world without streets, or one that states other blocks.
    """
    world, robots = document.get("world"), document.get("robots")
    for place in [document, *(robots if isinstance(robots, list) else [])]:
        path = place.get("path") if isinstance(place, dict) else None
        if not (isinstance(path, dict) and path.get("kind") == "tour"):
            continue
        if not (isinstance(world, dict) and world.get("kind") == "streets"):
            raise InputError(f"{where}: the path 'tour' needs a [world] of kind 'streets'")
        for key in _SHARED:
            if key in path and path[key] != world.get(key):
                raise InputError(
                    f"{where}: [path]: {key} {path[key]!r} is not that of [world]; leave it out"
                )
            if key in world:
                path[key] = world[key]
