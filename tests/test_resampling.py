"""Odometry put together into steps, truth interpolated."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from ekfslam import geometry as geo
from ekfslam.datasets.resampling import composed, interpolated, nearest
from ekfslam.models.motion import Increments


def small_steps(rng, count=40):
    deltas = rng.normal(size=(count, 3)) * [0.3, 0.1, 0.4]
    roots = rng.normal(size=(count, 3, 3)) * 0.01
    return Increments(deltas, roots @ np.swapaxes(roots, 1, 2))


def one_by_one(moves, first, last):
    """Increment and covariance by composing pose after pose with the Jacobians of geometry."""
    pose, P = np.zeros(3), np.zeros((3, 3))
    for delta, Q in zip(moves.deltas[first:last], moves.covariances[first:last], strict=True):
        F, G = geo.compose_jacobians(pose, delta)
        pose, P = geo.compose(pose, delta), F @ P @ F.T + G @ Q @ G.T
    return pose, P


def test_a_step_is_its_small_steps_one_after_another(rng):
    moves, cuts = small_steps(rng), [2, 2, 9, 10, 31, 40]
    whole = composed(moves, np.array(cuts))
    for k, (first, last) in enumerate(pairwise(cuts)):
        pose, P = one_by_one(moves, first, last)
        assert_allclose(whole.deltas[k], pose, atol=1e-12)
        assert_allclose(whole.covariances[k], P, atol=1e-14)


def test_truth_between_two_poses_goes_straight_and_turns_the_short_way():
    times = np.array([0.0, 1.0, 3.0])
    known = np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -3.0], [1.0, 4.0, -3.0]])
    at = np.array([-0.1, 0.0, 0.25, 1.0, 2.0, 3.0, 3.1])
    half = 0.25 * (2 * np.pi - 6)
    nan = [np.nan] * 3
    expected = [nan, known[0], [0.25, 0.5, geo.wrap(3 + half)], known[1], [1, 3, -3], known[2], nan]
    assert_allclose(interpolated(times, known, at), expected, atol=1e-12)
    with_gap = interpolated(times, known, at, longest=1.5)
    assert np.isnan(with_gap[4]).all()
    assert_allclose(with_gap[[1, 2, 3, 5]], np.array(expected)[[1, 2, 3, 5]], atol=1e-12)


def test_positions_without_heading_stay_without():
    known = np.array([[0.0, 0.0, np.nan], [2.0, 0.0, np.nan]])
    found = interpolated(np.array([0.0, 1.0]), known, np.array([0.5]))
    assert_array_equal(found, [[1.0, 0.0, np.nan]])


@pytest.mark.parametrize(("at", "index"), [(-5.0, 0), (0.4, 0), (0.5, 0), (0.6, 1), (9.0, 2)])
def test_the_nearest_pose(at, index):
    assert nearest(np.array([0.0, 1.0, 2.0]), np.array([at])) == [index]
