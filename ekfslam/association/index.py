"""A spatial index: which landmarks are near, without scanning the whole map.

A uniform grid over positions at one time. Landmarks move as the filter corrects them, so a caller
adds to the radius how far any may have moved since the grid was built, and builds anew when that
grows large.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekfslam.compiled import compiled

CELLS_PER_POINT = 4  # at most: a grid over a huge extent takes larger cells


class Grid(NamedTuple):
    """Points sorted by the cell of a grid that they lie in.

    Attributes
    ----------
    corner : (2,) ndarray
        Smallest x and y [m].
    cell : float
        Side of a cell [m].
    columns, lines : int
        Cells along x and along y.
    starts : (columns * lines + 1,) ndarray of int
        Points of cell c, which is at ``(c % columns, c // columns)``, are
        ``starts[c] : starts[c + 1]`` of the two arrays below.
    order : (N,) ndarray of int
        Index of each point as it was given.
    positions : (N, 2) ndarray
        Where it was [m].
    """

    corner: np.ndarray
    cell: float
    columns: int
    lines: int
    starts: np.ndarray
    order: np.ndarray
    positions: np.ndarray


@compiled
def build(positions: np.ndarray, count: int, cell: float) -> Grid:
    """Sort points into a grid, O(N).

    Parameters
    ----------
    positions : (>= count, 2) ndarray
        In the world [m], finite.
    count : int
        Points that are in use.
    cell : float
        Side of a cell [m], positive; best about the radius of the queries. It is enlarged where
        the extent would need more than a few cells per point.

    Returns
    -------
    Grid
        With a copy of the positions.
    """
    corner, extent = np.zeros(2), np.zeros(2)
    for a in range(2 if count > 0 else 0):
        low = high = positions[0, a]
        for i in range(count):
            low, high = min(low, positions[i, a]), max(high, positions[i, a])
        corner[a], extent[a] = low, high - low
    most = CELLS_PER_POINT * count + 1
    cell = max(cell, max(extent[0], extent[1]) / most)
    while (extent[0] / cell + 1.0) * (extent[1] / cell + 1.0) > 2.0 * most:
        cell *= 1.5
    columns, lines = int(extent[0] / cell) + 1, int(extent[1] / cell) + 1
    starts = np.zeros(columns * lines + 1, np.int64)
    where = np.empty(count, np.int64)
    for i in range(count):
        column = along(positions[i, 0] - corner[0], cell, columns)
        where[i] = column + columns * along(positions[i, 1] - corner[1], cell, lines)
        starts[where[i] + 1] += 1
    for c in range(columns * lines):
        starts[c + 1] += starts[c]
    order, sorted_positions = np.empty(count, np.int64), np.empty((count, 2))
    filled = starts[:-1].copy()
    for i in range(count):
        at = filled[where[i]]
        filled[where[i]] += 1
        order[at] = i
        sorted_positions[at, 0], sorted_positions[at, 1] = positions[i, 0], positions[i, 1]
    return Grid(corner, cell, columns, lines, starts, order, sorted_positions)


@compiled
def along(distance, cell, cells):  # type: ignore[no-untyped-def]
    """Cell at a distance from the corner along one axis, the nearest if there is none."""
    ratio = distance / cell
    if ratio >= cells:
        return cells - 1
    return int(ratio) if ratio > 0.0 else 0  # also for NaN


@compiled
def near(grid: Grid, x: float, y: float, radius: float, out: np.ndarray) -> int:
    """Points that were within a radius when the grid was built.

    With a radius of r + s, all points that are within r now if none has moved by more than s.

    Parameters
    ----------
    grid : Grid
    x, y : float
        Centre [m].
    radius : float
        [m], inclusive.
    out : (>= N,) ndarray of int
        Written: indices of the points, ascending.

    Returns
    -------
    int
        How many.
    """
    east, north = x - grid.corner[0], y - grid.corner[1]
    first = along(east - radius, grid.cell, grid.columns)
    last = along(east + radius, grid.cell, grid.columns)
    found = 0
    for line in range(
        along(north - radius, grid.cell, grid.lines),
        along(north + radius, grid.cell, grid.lines) + 1,
    ):
        row = line * grid.columns
        for at in range(grid.starts[row + first], grid.starts[row + last + 1]):
            dx, dy = grid.positions[at, 0] - x, grid.positions[at, 1] - y
            if dx * dx + dy * dy <= radius * radius:
                out[found] = grid.order[at]
                found += 1
    out[:found].sort()
    return found
