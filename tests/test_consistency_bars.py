"""What the filters reach on the small loop; what the stored campaigns say of the others."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import ekfslam
from ekfslam.evaluation.consistency import pose_nees

FAMILY = ("ekf", "iekf", "ekf-ideal", "ekf-fej", "ekf-oc", "ekf-ri", "ekf-robocentric")
RUNS, SKIPPED = 100, 5  # the covariance of the first poses is singular


@cache
def small_loops() -> dict[str, np.ndarray]:
    """Mean pose NEES, sum of NIS and its degrees of freedom of every run, by filter."""
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in FAMILY}
    for seed in range(RUNS):
        data = ekfslam.simulate("loop-15", seed=seed)
        for name in FAMILY:
            estimate = ekfslam.estimate(data, name)
            online = estimate.online
            nees = pose_nees(online.poses, data.robots[0].truth, online.covariances)
            nis = np.nansum(estimate.step_nis), np.nansum(estimate.step_dof)
            found[name].append((nees[SKIPPED:].mean(), *nis))
    return {name: np.array(rows) for name, rows in found.items()}


def test_the_standard_filter_is_overconfident_on_the_small_loop():
    loops = small_loops()
    assert loops["ekf"][:, 0].mean() >= 1.4 * loops["ekf-ri"][:, 0].mean()
    # Iterating finds the mode better and keeps what is wrong with the covariance.
    assert loops["iekf"][:, 0].mean() >= 1.4 * loops["ekf-ri"][:, 0].mean()


@pytest.mark.parametrize("name", ["ekf-fej", "ekf-oc", "ekf-ri", "ekf-robocentric"])
def test_the_others_are_as_good_as_knowing_where_to_linearise(name):
    loops = small_loops()
    assert abs(loops[name][:, 0].mean() - loops["ekf-ideal"][:, 0].mean()) <= 0.20


@pytest.mark.parametrize("name", FAMILY)
def test_nis_does_not_see_it(name):
    _, nis, dof = small_loops()[name].sum(axis=0)
    assert 0.98 <= nis / dof <= 1.03
