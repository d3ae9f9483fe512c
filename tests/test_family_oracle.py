"""The compiled filters against the family's textbook, number by number."""

from __future__ import annotations

import numpy as np
import pytest
from family_laws import by_identity, turning
from numerics import subtract_angles
from problems import camera, problem, scanner
from textbook import two_sensors
from textbook_family import FAMILY, Textbook

from ekfslam.registry import resolve
from ekfslam.simulation import simulate

DATASETS = {
    # Known start, noise in two of three directions, landmarks that come and go.
    "loop-15": lambda: simulate("loop-15", seed=2),
    # Fields of view, noise that grows with the range, a start that is not known.
    "two sensors": lambda: simulate(two_sensors(), seed=1),
    # Prior and turns so large that linearisation points are far apart.
    "hard": lambda: turning(steps=30, seed=5),
    "hard, range-bearing": lambda: turning(scanner(0.3, -0.2, 0.5), steps=30, seed=6),
    "hard, xy": lambda: turning(camera(-0.4, 0.1, 2.8), steps=30, seed=7),
    "all at once": lambda: problem(scanner(), camera(0.2, 0.0, 1.0), steps=20, seed=8),
}


def assert_close(actual, expected, rtol=1e-9):
    """Beside the largest entry; NaN in the same places."""
    scale = np.nanmax(np.abs(expected), initial=0.0)
    np.testing.assert_allclose(actual, expected, rtol=0, atol=rtol * scale)


@pytest.mark.parametrize("dataset", DATASETS)
@pytest.mark.parametrize("name", FAMILY)
def test_agrees_with_the_textbook_to_round_off(name, dataset):
    data = DATASETS[dataset]()
    ours, book = resolve(name).estimate(data), Textbook(FAMILY[name]).estimate(data)
    assert ours.status == "ok"
    assert_close(ours.online.poses[:, :2], book.online.poses[:, :2])
    turned = subtract_angles(ours.online.poses[:, 2], book.online.poses[:, 2])
    np.testing.assert_allclose(turned, 0, atol=1e-9)
    assert_close(ours.online.covariances, book.online.covariances)
    for mine, theirs in zip(by_identity(ours), by_identity(book), strict=True):
        mine, theirs = np.delete(mine, 2, axis=0), np.delete(theirs, 2, axis=0)
        assert_close(mine, theirs)
    assert_close(ours.landmarks.covariance, ours.joint_covariance[3:, 3:])
    for column in ("decision", "landmark"):
        mine, theirs = getattr(ours.innovations, column), getattr(book.innovations, column)
        np.testing.assert_array_equal(mine, theirs)
    for column in ("innovation", "S"):
        assert_close(getattr(ours.innovations, column), getattr(book.innovations, column))
    assert_close(ours.step_nis, book.step_nis)
    np.testing.assert_array_equal(ours.step_dof, book.step_dof)


def test_no_two_filters_of_the_family_agree_where_it_is_hard():
    """Else the comparison would not tell one from another."""
    data = DATASETS["hard"]()
    poses = [resolve(name).estimate(data).online.poses for name in FAMILY]
    for i, one in enumerate(poses):
        for other in poses[:i]:
            assert np.abs(one - other).max() > 1e-3
