"""The page on one's own filter: the filter in it is right."""

from __future__ import annotations

import numpy as np
import pytest
from pages import PAGES, blocks
from textbook import TextbookEkf

import ekfslam
from ekfslam.simulation import simulate

FILES = {block.file: block.text for block in blocks(PAGES["docs/your_own_filter.md"])}


@pytest.fixture
def mine():
    """The filter of the page."""
    names = {"__name__": "my_filter"}
    exec(compile(FILES["my_filter.py"], "my_filter.py", "exec"), names)
    return names["MyFilter"]


@pytest.mark.parametrize("scenario", ["cloister", "loop-15-rb"])
def test_the_filter_is_right(mine, scenario):
    """As another one that shares no line with it, and as the compiled one."""
    dataset = simulate(scenario, seed=2)
    found = ekfslam.estimate(dataset, mine)
    expected = TextbookEkf(update="sequential").estimate(dataset)
    close = {"rtol": 0, "atol": 1e-10}
    np.testing.assert_allclose(found.online.poses, expected.online.poses, **close)
    np.testing.assert_allclose(found.online.covariances, expected.online.covariances, **close)
    np.testing.assert_array_equal(found.landmarks.ids, expected.landmarks.ids)
    np.testing.assert_allclose(found.landmarks.positions, expected.landmarks.positions, **close)
    np.testing.assert_allclose(found.joint_covariance, expected.joint_covariance, **close)
    compiled = ekfslam.estimate(dataset, "ekf", update="sequential")
    np.testing.assert_array_equal(found.innovations.decision, compiled.innovations.decision)
    np.testing.assert_array_equal(found.step_dof, compiled.step_dof)
    np.testing.assert_allclose(found.step_nis, compiled.step_nis, rtol=1e-8)


def test_it_says_what_it_is_not_for(mine):
    table = ekfslam.compare(["loop-15", "two-sensors"], [mine]).summary
    assert table["status"].tolist() == ["skipped"] * 2
    assert table["message"][0].startswith("MyFilter is for range-bearing, but ")
