"""What association without identities must reach, and the table that says what it reached."""

from __future__ import annotations

import pandas as pd
import pytest
from bars import FILE, GATES, METHODS, RECORDED, SEEDS, TIGHT, VICTORIA, park, recorded

KEYS = ["dataset", "estimator", "runs", "quantity"]


@pytest.fixture(scope="module")
def stored():
    return pd.read_csv(FILE)


def test_the_park_without_identities():
    rows = list(park(3))
    assert len(rows) == 5 * len(METHODS)
    assert [row for row in rows if not row["met"]] == []


@pytest.mark.parametrize("dataset", [VICTORIA, TIGHT])
def test_victoria_park_without_identities_is_as_stored(stored, dataset):
    """Every decision depends on those before it: another one would show in all of these."""
    name = f"ekf(association=nearest, {GATES})"
    rows = pd.DataFrame(recorded(dataset, name))
    there = stored[(stored["dataset"] == dataset) & (stored["estimator"] == name)]
    assert rows[KEYS].to_numpy().tolist() == there[KEYS].to_numpy().tolist()
    assert rows["value"].to_numpy() == pytest.approx(there["value"].to_numpy(), rel=1e-3)


def test_the_stored_table_says_what_was_met(stored):
    assert len(stored) == 5 * len(METHODS) + 4 * len(RECORDED) + 1
    simulated = stored[stored["dataset"] == "park"]
    assert set(simulated["runs"]) == {SEEDS}
    assert simulated["met"].astype(bool).all()
    barred = stored.dropna(subset="met")
    assert not barred[barred["dataset"] == VICTORIA]["met"].astype(bool).any()
    assert barred[barred["dataset"] == TIGHT]["met"].astype(bool).all()
    for _, row in barred.iterrows():
        inside = not (row["value"] < row["low"] or row["value"] > row["high"])
        assert bool(row["met"]) is inside
