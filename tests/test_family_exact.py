"""What theory says of each filter of the family, exactly; `family_laws` says which mistakes show.

That the laws can fail, and on what, is tested with the textbook's mistakes in
`test_family_textbook`.
"""

from __future__ import annotations

import numpy as np
import pytest
from family_laws import (
    ALL,
    CASES,
    LAWS,
    common_limit,
    gap,
    gauge,
    standing_still,
    turning,
)
from linear_case import known_headings
from problems import problem, scanner

from ekfslam.estimates import Linearizations
from ekfslam.filters.options import UPDATES
from ekfslam.registry import resolve

REFERENCE = resolve("ekf")


@pytest.mark.parametrize(("law", "name"), CASES)
def test_keeps_the_law(law, name):
    assert LAWS[law].measure(resolve(name), REFERENCE) <= LAWS[law].bound


@pytest.mark.parametrize(
    ("law", "name"),
    [(law, name) for law, each in LAWS.items() for name in each.broken_by if name in ALL],
)
def test_breaks_the_law_as_theory_says(law, name):
    assert LAWS[law].measure(resolve(name), REFERENCE) > 100 * LAWS[law].bound


def test_how_much_the_standard_filter_makes_of_nothing():
    """Standing still it halves the standard deviation of its heading, from 10 degrees."""
    moved, changed = standing_still(REFERENCE, scanner())
    assert 0.05 < moved < 1.0
    assert 0.3 < changed < 1.0
    assert gauge(REFERENCE, turning()) > 0.1


# Observability ----------------------------------------------------------------------------------


def test_the_standard_filter_believes_that_it_observes_the_heading():
    """Huang et al. 2010: of three directions that cannot be observed it keeps two.

    From the linear models that it tells; the others tell none and agree with the textbook, of which
    `test_family_textbook` finds all three.
    """
    _, linear = REFERENCE.linearizations(problem(scanner(), steps=25))
    ids = np.unique(linear.landmark[linear.landmark >= 0]).tolist()
    n, moved, rows = 3 + 2 * len(ids), np.eye(3), []
    for k in range(4, 24):
        moved = linear.motion_jacobian[0, k] @ moved
        for e in np.flatnonzero((linear.step == k) & (linear.event == Linearizations.OBSERVED)):
            H, at = np.zeros((2, n)), 3 + 2 * ids.index(linear.landmark[e])
            H[:, :3] = linear.jacobian[e, :2, :3] @ moved
            H[:, at : at + 2] = linear.jacobian[e, :2, 3:5]
            rows.append(H)
    values = np.linalg.svd(np.concatenate(rows), compute_uv=False)
    assert values[-3] > 1e-4 * values[0]
    assert values[-2] < 1e-12 * values[0]


# The limit --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL)
def test_the_map_in_the_limit(name):
    """Dissanayake et al. 2001: fully correlated, and as sure as the start, never surer."""
    apart, below, open_ = common_limit(resolve(name), 250)
    assert apart < 1e-11
    assert below > 0
    _, _, later = common_limit(resolve(name), 1000)
    assert 3.5 < open_ / later < 4.5  # as one over the number of looks


# Sequential and joint ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL)
def test_one_by_one_or_at_once_is_the_same_where_all_is_linear_and_only_there(name):
    for data, same in ((known_headings(), True), (turning(), False)):
        joint, sequential = (resolve(name, update=update).estimate(data) for update in UPDATES)
        assert (gap(sequential, joint) < 1e-9) == same
        apart = np.nanmax(np.abs(sequential.step_nis - joint.step_nis) / (1 + joint.step_nis))
        assert (apart < 1e-9) == same
