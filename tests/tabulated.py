"""All tables of an estimate, for tests of what is in them."""

from __future__ import annotations

import re
from pathlib import Path

import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.estimates import Estimate
from ekfslam.evaluation import tables
from ekfslam.evaluation.tables import SCHEMAS


def all_tables(
    dataset: Dataset, estimate: Estimate, alignment: str = "none"
) -> dict[str, pd.DataFrame]:
    """By name; the estimate is its own reference."""
    return {
        "summary": tables.summary_rows(dataset, estimate, alignment, reference=estimate),
        "trajectories": tables.trajectories(dataset, estimate, alignment),
        "landmarks": tables.landmarks(dataset, estimate, alignment),
        "innovations": tables.innovations(dataset, estimate),
        "association": tables.association(dataset, estimate),
    }


def assert_schema(name: str, table: pd.DataFrame) -> None:
    """Assert that a table has its columns, in order, with their dtypes."""
    assert list(table.columns) == list(SCHEMAS[name])
    assert [str(dtype) for dtype in table.dtypes] == list(SCHEMAS[name].values())


def documented(section: str) -> dict[str, list[str]]:
    """Columns that a section of the page on tables describes, by subsection."""
    page = (Path(__file__).parents[1] / "docs" / "tables.md").read_text(encoding="utf-8")
    part = re.split(rf"^## {section}$", page, flags=re.MULTILINE)[1]
    part = re.split(r"^## ", part, flags=re.MULTILINE)[0]
    return {
        text.split("\n", 1)[0].strip(): re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
        for text in re.split(r"^### ", part, flags=re.MULTILINE)[1:]
    }
