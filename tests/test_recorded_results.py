"""The stored table of recorded sets: it meets the bars, and the page shows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ekfslam.experiments.recorded import CASES, ESTIMATORS

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "datasets.md").read_text(encoding="utf-8")
TABLE = pd.read_csv(ROOT / "results" / "recorded" / "summary.csv")
ROBOTS = [f"mrclam{number}/robot{robot}" for number in (1, 2) for robot in range(1, 6)]
SHOWN = ("ekf", "ekf-ri", "gtsam-batch", "gtsam-isam2", "fastslam2", "ekf-localization")


def rows_of(dataset: str) -> pd.DataFrame:
    return TABLE[TABLE["dataset"] == dataset]


def best(dataset: str, estimator: str) -> pd.Series:
    """The row of an estimator: smoothed where there is one."""
    rows = rows_of(dataset)
    rows = rows[rows["estimator"] == estimator]
    return (
        rows[rows["series"] == "smoothed"].iloc[0]
        if "smoothed" in set(rows["series"])
        else (rows.iloc[0])
    )


def number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def page_row(dataset: str) -> str:
    """Position errors of a set, as estimated, and landmark errors after alignment."""
    cells = [f"`{dataset}`", number(best(dataset, "dead-reckoning")["ate_position_rmse_m"])]
    for name in SHOWN:
        row = best(dataset, name)
        if row["status"] == "skipped":
            cells.append("")
            continue
        path, points = row["ate_position_rmse_m"], row["aligned_landmark_rmse_m"]
        said = " / ".join(filter(None, (number(path), number(points))))
        cells.append(said if row["status"] == "ok" else f"{said} ({row['status']})")
    return f"| {' | '.join(cells)} |"


SINGLE = [
    case.source for case in CASES if case.dataset not in ("victoria-park", "mrclam1", "mrclam2")
]


@pytest.mark.parametrize("dataset", SINGLE)
def test_the_page_shows_the_stored_table(dataset):
    assert page_row(dataset) in PAGE


@pytest.mark.parametrize("dataset", ["mrclam2/robot1", "lego", "car-park", "city-trees"])
def test_so_does_the_readme(dataset):
    assert page_row(dataset) in (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_set_has_a_row_for_every_estimator():
    assert "ekfslam study recorded --data FOLDER --out results/recorded" in PAGE
    for case in CASES:
        assert set(rows_of(case.source)["estimator"]) == set(ESTIMATORS)
    assert not (TABLE["status"] == "failed").any()
    assert TABLE.loc[TABLE["status"] == "skipped", "message"].notna().all()


@pytest.mark.parametrize("dataset", ROBOTS)
def test_on_mrclam_filters_halve_the_error_of_dead_reckoning_and_maps_are_good(dataset):
    alone = best(dataset, "dead-reckoning")["ate_position_rmse_m"]
    for name in ("ekf", "ekf-ri"):
        assert best(dataset, name)["ate_position_rmse_m"] < 0.5 * alone
    for name in ("ekf", "gtsam-isam2", "gtsam-batch"):
        assert best(dataset, name)["aligned_landmark_rmse_m"] < 0.25


def test_the_lego_robot_is_found_on_its_map():
    """Mean error under 40 mm: the root mean square is above the mean."""
    assert best("lego", "ekf-localization")["ate_position_rmse_m"] < 0.04


def test_ten_thousand_poses_take_the_ekf_less_time_than_feeding_isam2():
    filtered, fed = best("city-trees", "ekf"), best("city-trees", "gtsam-isam2")
    assert filtered["status"] == fed["status"] == "ok"
    assert filtered["time_total_s"] < fed["time_total_s"]
    for name in ("gtsam-isam2", "gtsam-batch"):
        assert best("city-trees", name)["ate_position_rmse_m"] < 1.0
