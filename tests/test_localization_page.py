"""The page on localization: its table is that of its campaign."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from far_starts import rows_of

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "localization.md").read_text(encoding="utf-8")


def rows() -> list[str]:
    """The table, line by line: position errors, and the mean NEES along a run."""
    found = []
    for _, row in pd.read_csv(ROOT / "results" / "known-map" / "summary.csv").iterrows():
        columns = "ate_position_rmse_m", "run_nees_pose"
        cells = [f"{row[f'{name}_mean']:.3g} ± {row[f'{name}_se']:.2g}" for name in columns]
        words = [row["scenario"], f"`{row['estimator']}`", row["series"], *cells]
        found.append(f"| {' | '.join(words)} |")
    return found


@pytest.mark.parametrize("row", rows())
def test_the_page_holds_what_the_campaign_found(row):
    assert row in PAGE


def test_the_page_says_what_made_it():
    assert "ekfslam campaign experiments/known-map.toml --out results/known-map" in PAGE


STARTS = pd.read_csv(ROOT / "results" / "far-starts.csv")


def test_the_page_tells_who_came_back():
    back = STARTS.pivot(index="start", columns="association", values="back")
    for start, counts in back.iterrows():
        assert f"| {start} | {counts['nearest']} | {counts['nearest-position']} |" in PAGE
    assert STARTS["runs"].sum() == STARTS["right"].sum() == 320


@pytest.mark.parametrize(("start", "method"), [("1 m", "nearest"), ("5 m", "nearest-position")])
def test_a_stored_count_is_made_again(start, method):
    stored = STARTS[(STARTS["start"] == start) & (STARTS["association"] == method)]
    assert rows_of(start, method) == stored.iloc[0].to_dict()
