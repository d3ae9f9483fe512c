"""All tables of an estimate, for tests of what is in them."""

from __future__ import annotations

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
