"""Cylinders in scans: known ones come back, and nothing else does."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from ekfslam.datasets.cylinders import centres, derivatives, find_cylinders
from ekfslam.errors import InputError

BEAMS, AHEAD, ANGLE = 400, 200, 0.006


def plain(scan, jump, least):
    """The loop of the lectures: an independent implementation of it, for one scan."""
    found, inside, rays, depths = [], False, [], []
    for i in range(1, len(scan) - 1):
        valid = scan[i - 1] >= least and scan[i + 1] >= least
        slope = 0.5 * (scan[i + 1] - scan[i - 1]) if valid else 0.0
        if slope < -jump:
            inside, rays, depths = True, [], []
        elif slope > jump:
            if inside and rays:
                found.append((np.mean(rays), np.mean(depths), len(rays)))
            inside = False
        elif inside and scan[i] >= least:
            rays.append(i)
            depths.append(scan[i])
    return np.array(found).reshape(-1, 3)


def traced(cylinders, radius, wall=3.0):
    """Ranges from the origin to round cylinders before a wall all around."""
    bearing = (np.arange(BEAMS) - AHEAD) * ANGLE
    ranges = np.full(BEAMS, wall)
    for distance, direction in cylinders:
        across = distance * np.sin(bearing - direction)
        along = distance * np.cos(bearing - direction)
        hit = (np.abs(across) < radius) & (along > 0)
        surface = along - np.sqrt(np.maximum(radius**2 - across**2, 0.0))
        ranges = np.where(hit, np.minimum(ranges, surface), ranges)
    return ranges


def test_known_cylinders_come_back_where_they_stand(rng):
    radius = 0.05
    distances = rng.uniform(0.6, 1.8, (50, 4))
    directions = np.array([-0.9, -0.3, 0.4, 1.0]) + rng.uniform(-0.1, 0.1, (50, 4))
    scans = [traced(zip(*pair, strict=True), radius) for pair in zip(distances, directions,
                                                                     strict=True)]  # fmt: skip
    found = find_cylinders(scans, 0.1)
    assert_array_equal(found.scan, np.repeat(np.arange(50), 4))
    values = centres(found, 0.0, AHEAD, ANGLE)
    # The edges fall between beams: the mean of the beams is off by half a beam at most.
    assert_allclose(values[:, 1], directions.ravel(), atol=0.5 * ANGLE)
    # A surface is between one radius and none before the centre.
    short = distances.ravel() - values[:, 0]
    assert (short > 0.5 * radius).all()
    assert (short <= radius + 1e-12).all()
    # The two beams at the sides are left out.
    width = 2 * np.arcsin(radius / distances.ravel()) / ANGLE
    assert (np.abs(found.beams - (width - 2)) <= 1).all()


def test_it_is_the_loop_of_the_lectures(rng):
    scans = rng.choice([0.0, 0.5, 0.55, 1.0, 2.0], (60, 80), p=[0.1, 0.3, 0.2, 0.2, 0.2])
    found = find_cylinders(scans, 0.1, least=0.02)
    expected = [plain(scan, 0.1, 0.02) for scan in scans]
    assert len(found.scan) > 100
    assert_array_equal(found.scan, np.repeat(np.arange(60), [len(rows) for rows in expected]))
    together = np.concatenate(expected)
    assert_allclose(found.beam, together[:, 0], rtol=1e-12)
    assert_allclose(found.range, together[:, 1], rtol=1e-12)
    assert_array_equal(found.beams, together[:, 2])


@pytest.mark.parametrize(
    "scan",
    [
        [2.0] * 12,  # a wall
        [2.0] * 5 + [1.0] * 7,  # a fall alone: a corner
        [1.0] * 5 + [2.0] * 7,  # a rise alone
        [2.0] * 4 + [1.0] * 2 + [2.0] * 6,  # its two beams are both edges
        np.linspace(3.0, 1.0, 12),  # slanted, but no jump: 0.18 a beam
        [2.0] * 4 + [0.0] * 4 + [2.0] * 4,  # no return
        [],
        [2.0],
    ],
)
def test_what_is_no_cylinder_is_not_found(scan):
    found = find_cylinders([scan], 0.2, least=0.02)
    assert all(len(column) == 0 for column in found)


def test_a_fall_and_a_rise_of_different_scans_make_no_cylinder():
    scans = [[2.0] * 2 + [1.0] * 6, [1.0] * 6 + [2.0] * 2]
    assert len(find_cylinders(scans, 0.2).scan) == 0
    assert len(find_cylinders([scans[0] + scans[1]], 0.2).scan) == 1


def test_beams_without_return_are_in_no_mean():
    scan = [2.0] * 4 + [1.0, 1.0, 1.1, 0.0, 1.3, 1.0, 1.0] + [2.0] * 4
    found = find_cylinders([scan], 0.3, least=0.02)
    assert_allclose(found.range, [np.mean([1.0, 1.1, 1.3, 1.0])])
    assert_allclose(found.beam, [np.mean([5, 6, 8, 9])])
    assert_array_equal(found.beams, [4])


def test_scans_count_backwards_as_forwards(rng):
    scans = np.array([traced([(1.0, 0.2), (1.5, -0.6)], 0.06) for _ in range(3)])
    there, back = find_cylinders(scans, 0.1), find_cylinders(scans[:, ::-1], 0.1)
    assert_allclose(back.range, there.range[[1, 0, 3, 2, 5, 4]])
    assert_allclose(BEAMS - 1 - back.beam, there.beam[[1, 0, 3, 2, 5, 4]])


def test_a_scale_of_the_ranges_is_one_of_what_is_found(rng):
    scans = traced([(1.0, 0.2), (1.5, -0.6)], 0.06)[None]
    metres, millimetres = find_cylinders(scans, 0.1), find_cylinders(1e3 * scans, 100.0)
    assert_allclose(millimetres.range, 1e3 * metres.range)
    assert_array_equal(millimetres.beam, metres.beam)


def test_derivatives_are_central_differences():
    scan = np.array([[1.0, 2.0, 4.0, 0.0, 3.0, 3.0]])
    assert_allclose(derivatives(scan, 0.02), [[0.0, 1.5, 0.0, -0.5, 0.0, 0.0]])


@pytest.mark.parametrize("jump", [0.0, -1.0, np.nan, np.inf, "much"])
def test_a_jump_must_be_one(jump):
    with pytest.raises(InputError, match="jump"):
        find_cylinders([[1.0, 2.0]], jump)


def test_scans_must_be_rows():
    with pytest.raises(InputError, match="ranges"):
        find_cylinders([1.0, 2.0], 0.1)
