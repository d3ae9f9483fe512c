"""The spatial index against a scan of all points."""

import numpy as np
import pytest

from ekfslam.association.index import CELLS_PER_POINT, build, near


def ask(grid, x, y, radius, count):
    out = np.full(count, -1)
    return out[: near(grid, x, y, radius, out)].tolist()


def scan(points, x, y, radius):
    return np.flatnonzero(np.sum((points - [x, y]) ** 2, axis=1) <= radius**2).tolist()


CLOUDS = {
    "square": lambda rng: rng.uniform(0, 50, (300, 2)),
    "around the origin": lambda rng: rng.normal(0, 20, (300, 2)),
    "all negative": lambda rng: rng.uniform(-90, -40, (300, 2)),
    "far away": lambda rng: rng.uniform([4e6, -5e5], [4.00005e6, -4.9995e5], (300, 2)),
    "a line": lambda rng: np.stack([rng.uniform(-500, 500, 300), np.full(300, 3.0)], axis=1),
    "one place": lambda rng: np.full((300, 2), -7.5),
    "a stray": lambda rng: np.concatenate([rng.uniform(0, 50, (299, 2)), [[1e12, -1e12]]]),
    "one point": lambda rng: np.array([[2.0, -3.0]]),
    "on the corners of cells": lambda rng: np.argwhere(np.ones((20, 15))) * 4.0 - 8.0,
}


@pytest.mark.parametrize("cell", [1e-300, 0.1, 4.0, 1e6])
@pytest.mark.parametrize("cloud", CLOUDS)
def test_against_a_scan(rng, cloud, cell):
    points = CLOUDS[cloud](rng)
    N = len(points)
    grid = build(points, N, cell)
    assert len(grid.starts) <= 3 * (CELLS_PER_POINT * N + 1)
    low, high = points[:-1].min(axis=0, initial=-9.0), points[:-1].max(axis=0, initial=9.0)
    for x, y in [*rng.uniform(low - 20, high + 20, (40, 2)), *points[:20]]:
        for radius in (0.0, 4.0, 30.0, 1e20, np.inf):
            assert ask(grid, x, y, radius, N) == scan(points, x, y, radius)


def test_radii_and_cells_give_something_and_not_all(rng):
    """The comparison above is not one of empty lists."""
    points = CLOUDS["square"](rng)
    grid = build(points, 300, 4.0)
    assert grid.columns == grid.lines == 13
    assert 5 < len(ask(grid, 25.0, 25.0, 8.0, 300)) < 60


def test_points_not_in_use_are_left_out(rng):
    points = rng.uniform(0, 50, (20, 2))
    points[12:] = np.nan
    grid = build(points, 12, 5.0)
    assert ask(grid, 25.0, 25.0, 100.0, 12) == list(range(12))


def test_an_empty_map():
    grid = build(np.empty((0, 2)), 0, 5.0)
    assert ask(grid, 1.0, 2.0, 100.0, 0) == []


def test_a_robot_that_is_nowhere_is_near_nothing(rng):
    grid = build(rng.uniform(0, 50, (20, 2)), 20, 5.0)
    assert ask(grid, np.nan, 3.0, 10.0, 20) == []
    assert ask(grid, np.inf, 3.0, 10.0, 20) == []
    assert ask(grid, 3.0, 3.0, np.nan, 20) == []


def test_a_wider_radius_makes_up_for_points_that_moved(rng):
    points = rng.uniform(0, 50, (300, 2))
    grid = build(points, 300, 5.0)
    moved = points + rng.uniform(-0.5, 0.5, (300, 2))
    slack = np.hypot(*(moved - points).T).max()
    missed = 0
    for x, y in rng.uniform(0, 50, (50, 2)):
        now = set(scan(moved, x, y, 6.0))
        assert now <= set(ask(grid, x, y, 6.0 + slack, 300))
        missed += len(now - set(ask(grid, x, y, 6.0, 300)))
    assert missed > 0


def test_the_grid_keeps_a_copy(rng):
    points = rng.uniform(0, 50, (30, 2))
    grid = build(points, 30, 5.0)
    before = ask(grid, 25.0, 25.0, 15.0, 30)
    points += 100.0
    assert before
    assert ask(grid, 25.0, 25.0, 15.0, 30) == before
