"""The page on FastSLAM: its tables are those that the campaigns wrote."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ekfslam.experiments.reading import load_campaign

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "fastslam.md").read_text(encoding="utf-8")
CAMPAIGNS = ("particles", "particles-or-not")


def summary(name: str) -> pd.DataFrame:
    return pd.read_csv(ROOT / "results" / name / "summary.csv")


def number(value: float, digits: int = 3) -> str:
    if np.isnan(value):
        return ""
    if abs(value) >= 1e5:
        return re.sub(r"e\+0?", "e", f"{value:.1e}")
    return f"{value:.{digits}g}" if abs(value) < 100 else f"{value:.0f}"


def with_error(row: pd.Series, name: str) -> str:
    mean = number(row[f"{name}_mean"])
    return f"{mean} ± {number(row[f'{name}_se'], 2)}" if mean else ""


def rows(name: str) -> list[str]:
    """The table of a campaign, line by line."""
    found = []
    table = summary(name)
    for _, row in table[table["series"] == "online"].iterrows():
        cells = [
            row["scenario"],
            "`" + re.sub(r"\(marginal_every=\d+\)", "", row["estimator"]) + "`",
            with_error(row, "ate_position_rmse_m"),
            with_error(row, "landmark_rmse_m"),
            number(row["run_nees_pose_median"]),
            number(row["effective_samples_mean"]),
        ]
        found.append(f"| {' | '.join(cells)} |")
    return found


@pytest.mark.parametrize("row", [row for name in CAMPAIGNS for row in rows(name)])
def test_the_page_holds_what_the_campaigns_found(row):
    assert row in PAGE


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_results_are_of_the_campaign_in_its_file(name):
    assert f"ekfslam campaign experiments/{name}.toml --out results/{name}" in PAGE
    campaign, table = load_campaign(ROOT / "experiments" / f"{name}.toml"), summary(name)
    assert set(table["scenario"]) == {variant.label for variant in campaign.variants}
    assert set(table["estimator"]) == set(campaign.estimators)
    assert (table["runs"] == len(campaign.seeds)).all()
    assert not table[["failed", "skipped"]].to_numpy().any()


def test_particles_beat_the_ekf_where_odometry_has_two_peaks_and_nowhere_else():
    pairs = pd.read_csv(ROOT / "results" / "particles-or-not" / "pairs.csv")
    of = pairs[
        pairs["a"].str.startswith("fastslam2")
        & pairs["a"].str.endswith("(online)")
        & (pairs["metric"] == "ate_position_rmse_m")
    ].set_index("scenario")
    reach = of["half_width"] / of["mean_difference"].abs()
    assert of["mean_difference"]["spin"] < 0
    assert reach["spin"] < 1
    assert (reach[["heavy-tails", "twins"]] > 1).all()
