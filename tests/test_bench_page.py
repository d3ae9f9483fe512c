"""The pages on speed show the numbers that the benchmark wrote, and name all that it measures."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from contenders import FAMILY, in_the_city, on_the_ring
from map_size import LIMIT
from page import BEGIN, END, SHORT, by_size, digits, ratios, replaced, tables
from ratios import COLUMNS, alone, at_least

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "speed.md").read_text("utf-8")


@pytest.mark.parametrize("name", ["docs/speed.md", "README.md"])
def test_the_pages_show_what_was_measured(name):
    text = (ROOT / name).read_text("utf-8")
    assert replaced(text, tables(ROOT)[name]) == text, "run make bench, or benchmarks/page.py"


def test_the_page_names_every_part_and_every_line():
    source = (ROOT / "benchmarks" / "run.py").read_text("utf-8")
    parts = re.findall(r'^    "([a-z-]+)": ', source, re.MULTILINE)
    assert len(parts) == 10
    for part in parts:
        assert f"`{part}`" in PAGE or f"PART={part}`" in PAGE, part
    lines = {c.name for c in [*on_the_ring(20), *in_the_city(2000)]} | {LIMIT}
    for name in lines - {"ekf", *FAMILY}:
        assert f"| {name} |" in PAGE or f"| `{name}` |" in PAGE, name


def test_the_stored_table_has_the_columns_that_are_written():
    speed = pd.read_csv(ROOT / "results" / "bench" / "speed.csv")
    assert list(speed.columns) == COLUMNS
    assert not speed.duplicated("what").any()


def test_what_stands_between_the_marks_is_replaced():
    page = f"before\n{BEGIN}\nold\n{END}\nafter"
    assert replaced(page, "new") == f"before\n{BEGIN}\n\nnew\n\n{END}\nafter"
    with pytest.raises(ValueError, match="lacks"):
        replaced(f"no end {BEGIN}", "new")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0123456, "0.0123"), (17.03, "17"), (176.5, "176"), (2152.0, "2150"), (98765.0, "98800"),
     (np.nan, "")],
)  # fmt: skip
def test_numbers_have_three_digits(value, text):
    assert digits(value) == text


def test_a_size_has_its_observation_and_its_prediction():
    rows = [
        ("ring", "ekf", 20, 1.234, 0.5, ""),
        ("ring", "ekf", 100, 2.0, 0.6, ""),
        ("ring", "filterpy", 20, np.nan, np.nan, "not installed"),
        ("ring", LIMIT, 100, 1.5, np.nan, ""),
    ]
    names = ["problem", "estimator", "landmarks", "us_per_observation", "us_per_prediction", "note"]
    lines = by_size(pd.DataFrame(rows, columns=names))
    assert lines[:5] == [
        "| any five landmarks a step [µs] | 20 landmarks | 100 landmarks |",
        "|---|---:|---:|",
        "| ekf | 1.23, 0.5 | 2, 0.6 |",
        "| filterpy | not installed |  |",
        f"| {LIMIT} |  | 1.5 |",
    ]


def test_a_row_says_whether_its_bar_holds():
    rows = [["p", *at_least("a, b", 1.0, 3.0, "s", 4)], ["p", *alone("c", 2.0, "MB")]]
    table = pd.DataFrame(rows, columns=COLUMNS)
    assert ratios(table)[2:] == [
        "| a, b | 1 s | 3 s | 3 | >= 4 | no |",
        "| c | 2 MB |  |  |  |  |",
    ]
    assert (
        ratios(pd.DataFrame(rows, columns=COLUMNS), bounds=False)[2] == "| a, b | 1 s | 3 s | 3 |"
    )


def test_the_readme_picks_rows_that_there_are():
    """Of parts other than map-size, whose rows stand from its next run on."""
    speed = pd.read_csv(ROOT / "results" / "bench" / "speed.csv")
    assert {what for what in SHORT if not what.startswith(("ring", "city"))} <= set(speed.what)
