"""Rows of a campaign: the columns of its three tables, and how rows become a table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from ekfslam.evaluation import tables
from ekfslam.evaluation.run_metrics import RUN_METRICS
from ekfslam.evaluation.schema import REAL, TEXT, WHOLE

KEYS = ("scenario", "seed", "robot", "estimator", "series")


def _schema(
    lead: tuple[str, ...], source: Mapping[str, str], leave_out: Callable[[str], bool]
) -> dict[str, str]:
    """The keys, then the columns of another table but for some, then the versions."""
    keys = dict.fromkeys(("campaign", "scenario", "scenario_hash"), TEXT)
    keys |= {name: WHOLE if name == "seed" else TEXT for name in lead}
    rest = {k: dtype for k, dtype in source.items() if k != "dataset" and not leave_out(k)}
    return keys | rest | {"versions": TEXT}


SUMMARY, TRAJECTORIES = tables.SCHEMAS["summary"], tables.SCHEMAS["trajectories"]
ELSEWHERE = ("x_m", "y_m", "theta_rad", "time_step_s")  # columns of trajectories

SCHEMAS: Mapping[str, Mapping[str, str]] = {
    "runs": _schema(
        (*KEYS[1:], "status", "message"),
        {**SUMMARY, **RUN_METRICS},
        lambda name: name.startswith("time_"),
    ),
    "steps": _schema(
        KEYS[1:],
        TRAJECTORIES,
        lambda name: name in ELSEWHERE or name.startswith("true_"),
    ),
    "timings": _schema(
        ("seed", "estimator"),
        {name: dtype for name, dtype in SUMMARY.items() if name.startswith("time_")},
        lambda name: False,
    ),
}
"""Columns of each table of a campaign, in order, with their dtypes."""

COMPARABLE = tuple(
    name
    for name, dtype in SCHEMAS["runs"].items()
    if dtype == REAL and not name.startswith("effective_samples")
)
"""Columns of `runs` by which estimators can be compared: less is better, or there is a target."""

ARROW = {TEXT: pa.string(), WHOLE: pa.int64(), REAL: pa.float64()}


@cache
def arrow_schema(name: str) -> pa.Schema:
    """Of a table of `SCHEMAS`, with what pandas needs to give each column its dtype back."""
    schema = SCHEMAS[name]
    plain = pa.schema([(column, ARROW[dtype]) for column, dtype in schema.items()])
    empty = pd.DataFrame(columns=list(schema)).astype(dict(schema))
    return pa.Table.from_pandas(empty, schema=plain, preserve_index=False).schema


def table_of(name: str, parts: Iterable[Mapping[str, Any]], rows: int = 1) -> pa.Table:
    """Parts of so many rows each, stacked.

    Parameters
    ----------
    name : {"runs", "steps", "timings"}
    parts : iterable of mapping
        Scalars and arrays by column; what is not given, None, NaN or "" is empty.
    rows : int
        Of each part.
    """
    schema = arrow_schema(name)

    def array(value: Any, kind: pa.DataType) -> pa.Array:
        values = value if isinstance(value, np.ndarray) else [None if value == "" else value] * rows
        return pa.array(values, kind, from_pandas=True)

    def table(part: Mapping[str, Any]) -> pa.Table:
        arrays = [array(part.get(field.name), field.type) for field in schema]
        return pa.table(arrays, schema=schema)

    return stacked(name, [table(part) for part in parts])


def stacked(name: str, parts: Iterable[pa.Table]) -> pa.Table:
    """Tables of one kind, one below the other; none at all make an empty one."""
    return pa.concat_tables([arrow_schema(name).empty_table(), *parts])
