"""What the statistics of a campaign share: the keys of its tables, and checks of what comes in.

A campaign has two tables of numbers: ``runs``, a row per scenario, seed, estimator, robot and
series, and ``steps``, with a row for each kept step of each of these. Both are described in
``docs/tables.md``.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from ekfslam.errors import InputError

GROUP = ["scenario", "estimator", "series", "robot"]
"""What is averaged over seeds: runs that agree in these differ in their seeds alone."""


def check_columns(table: pd.DataFrame, columns: Iterable[str], name: str) -> None:
    """Refuse a table that lacks columns, and say which."""
    missing = [column for column in columns if column not in table]
    if missing:
        raise InputError(f"{name} lacks the columns {', '.join(missing)}")


def check_distinct(table: pd.DataFrame, keys: list[str], name: str) -> None:
    """Refuse a table that holds a run twice: it would count as two."""
    twice = table.duplicated(keys)
    if twice.any():
        row = table.loc[twice, keys].iloc[0]
        said = ", ".join(f"{key} {value}" for key, value in row.items())
        raise InputError(f"{name} holds a row twice: {said}")


def group_numbers(table: pd.DataFrame, keys: list[str] = GROUP) -> np.ndarray:
    """Number of the group that each row belongs to, in order of appearance."""
    return table.groupby(keys, sort=False, dropna=False).ngroup().to_numpy()
