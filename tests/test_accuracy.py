"""Accuracy regressions against the stored tables of `results/reference/`.

`make reference` rewrites those of four estimators that must not move; `pytest --ekfslam-update`
that of the filters which must not become worse, over so many draws that a tenth is seen.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import reference

from ekfslam.testing import assert_accuracy, assert_consistent, assert_not_worse

SEEDS_RUN = 3
ERRORS = [
    "ate_position_rmse_m",
    "ate_heading_rmse_rad",
    "rpe_position_rmse_m",
    "landmark_rmse_m",
]
KEYS = ["robot", "estimator", "series"]
METRICS = [
    "ate_position_rmse_m",
    "ate_heading_rmse_rad",
    "rpe_position_rmse_m",
    "rpe_heading_rmse_rad",
    "landmark_rmse_m",
    "nees_pose_mean",
    "nees_landmark_mean",
    "association_precision",
    "association_recall",
    "nis_per_dof",
    "graph_chi2_per_dof",
    "gap_final_position_m",
    "gap_landmark_rmse_m",
    "sigma_ratio_position",
    "sigma_ratio_heading",
]


def stored(name: str) -> pd.DataFrame:
    return pd.read_csv(reference.FOLDER / f"{name}.csv")


@pytest.mark.parametrize("scenario", reference.SCENARIOS)
def test_simulated_accuracy_has_not_moved(scenario):
    """On the same seeds, no metric moves by more than the stored table knows its mean.

    The bound is the standard error of the metric's mean over the stored seeds: its Monte-Carlo
    spread between runs, divided by the square root of their number. Draws being equal, a change
    that touches no result moves nothing.
    """
    table = stored("simulated")
    table = table[table["dataset"] == scenario]
    groups = table.groupby(KEYS)[METRICS]
    bound = groups.std() / np.sqrt(reference.SEEDS)
    now = pd.concat([reference.simulated(scenario, seed) for seed in range(SEEDS_RUN)])
    now = now.groupby(KEYS)[METRICS].mean()
    before = table[table["seed"] < SEEDS_RUN].groupby(KEYS)[METRICS].mean()
    assert list(now.index) == list(before.index)
    assert (now.isna() == before.isna()).all(axis=None)
    moved = (now - before).abs() > bound + 1e-9
    assert not moved.any(axis=None), (now - before).where(moved).stack()


def test_statuses_are_as_stored():
    table = stored("simulated")
    assert (table["status"] == "ok").all()
    assert table.groupby(["dataset", "seed"]).ngroups == len(reference.SCENARIOS) * reference.SEEDS


def test_victoria_park_has_not_moved():
    """One recorded run has no Monte-Carlo spread: the bound is a thousandth of each figure.

    That is room for the round-off of other machines, which the optimisers amplify.
    """
    before, now = stored("victoria-park"), reference.recorded()
    assert (now[KEYS].to_numpy() == before[KEYS].to_numpy()).all()
    assert (now["status"] == "ok").all()
    for metric in METRICS:
        np.testing.assert_allclose(
            now[metric].to_numpy(float), before[metric].to_numpy(float), rtol=1e-3, atol=1e-6
        )


@pytest.mark.parametrize("scenario", reference.SCENARIOS)
def test_the_filter_is_no_worse_on_any_scenario(scenario):
    """On all stored seeds, where the test above runs three of them."""
    stored = reference.FOLDER / "simulated.csv"
    assert_not_worse("ekf", stored, scenario, metric=ERRORS)


@pytest.mark.parametrize("estimator", ["ekf", "ekf-fej", "ekf-ri"])
def test_filters_are_no_worse(estimator):
    assert_not_worse(estimator, reference.FOLDER / "loop-15.csv", "loop-15", metric=ERRORS)


def test_the_invariant_filter_is_as_good_as_it_says():
    assert_consistent("ekf-ri", "loop-15")


def test_the_filter_is_near_the_smoother():
    assert_accuracy(
        "ekf", "cloister", seeds=10, gap_final_position_m=0.1, nis_per_dof=1.02, nis_inside_95=0.94
    )
