"""What the figures read from the tables: one run, its robots and series, columns as numbers."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from ekfslam.errors import InputError, UnknownNameError
from ekfslam.geometry import Array
from ekfslam.plots.style import Look, looks

# A diverged run can hold numbers whose squares overflow; no figure has room for them.
_LARGEST = 1e100


class Series(NamedTuple):
    """The rows of one series of one estimator."""

    estimator: str
    name: str
    rows: pd.DataFrame
    look: Look

    @property
    def heading(self) -> str:
        """How a narrow panel calls it."""
        return f"{textwrap.fill(self.estimator, 22, break_long_words=False)}\n{self.name}"

    @property
    def label(self) -> str:
        """How a legend calls it."""
        return f"{self.estimator} ({self.name})"

    @property
    def robots(self) -> list[pd.DataFrame]:
        """Its rows by robot, in order of appearance."""
        return [rows for _, rows in self.rows.groupby("robot", sort=False, dropna=False)]


def check_one_run(*tables: pd.DataFrame) -> str:
    """Check that tables are of one run; return what a title says of it.

    Raises
    ------
    InputError
        If they hold several datasets or seeds, or lack columns that tell whose rows they are.
    """
    keys = {"dataset": "string", "seed": "Int64"}
    for table in tables:
        missing = [key for key in (*keys, "robot", "estimator", "series") if key not in table]
        if missing:
            raise InputError(f"the table has no column {', '.join(missing)}")
    runs = pd.concat([table[list(keys)].astype(keys) for table in tables]).drop_duplicates()
    if len(runs) > 1:
        raise InputError("a figure shows one dataset and seed; select them in the tables")
    for dataset, seed in runs.itertuples(index=False):
        return str(dataset) if pd.isna(seed) else f"{dataset}, seed {int(seed)}"
    return ""


def of_robot(trajectories: pd.DataFrame, robot: str | None) -> tuple[pd.DataFrame, str]:
    """The rows of one robot of a run, and what a title says of it.

    Parameters
    ----------
    trajectories : DataFrame
    robot : str, optional
        Name; the first one by default.

    Returns
    -------
    DataFrame
    str
        Empty if there is only one.

    Raises
    ------
    UnknownNameError
        If the table holds no such robot.
    """
    names = list(trajectories["robot"].astype("string").unique())
    if robot is not None and robot not in names:
        raise UnknownNameError("robot of this table", robot, names)
    if len(names) < 2:
        return trajectories, ""
    chosen = names[0] if robot is None else robot
    return trajectories[trajectories["robot"] == chosen], f", {chosen}"


def series_of(table: pd.DataFrame, absent: Iterable[str] = ()) -> Iterator[Series]:
    """The series of a table in order of appearance.

    Parameters
    ----------
    table : DataFrame
    absent : iterable of str
        Estimators without a row, who have looks all the same: those of others do not depend on who
        has failed.
    """
    by_name = looks([*map(str, table["estimator"].unique()), *absent])
    for (estimator, name), rows in table.groupby(["estimator", "series"], sort=False):
        yield Series(str(estimator), str(name), rows, by_name[str(estimator)])


def final_series(table: pd.DataFrame, absent: Iterable[str] = ()) -> list[Series]:
    """Of each estimator the series that knows most: smoothed if there is one, else online."""
    best: dict[str, Series] = {}
    for series in series_of(table, absent):
        if series.estimator not in best or series.name == "smoothed":
            best[series.estimator] = series
    return list(best.values())


def numbers(rows: pd.DataFrame, *columns: str) -> Array:
    """Columns as an array (n,) or (n, columns); what is missing or out of all bounds is NaN.

    Raises
    ------
    InputError
        If the table lacks one of them.
    """
    missing = [name for name in columns if name not in rows]
    if missing:
        raise InputError(f"the table has no column {', '.join(missing)}")
    values = np.column_stack([rows[name].to_numpy(float, na_value=np.nan) for name in columns])
    values[~(np.abs(values) <= _LARGEST)] = np.nan
    return values[:, 0] if len(columns) == 1 else values


def isolated(values: Array) -> np.ndarray:
    """Which of a row of values are known beside others that are not: a line does not show them.

    Parameters
    ----------
    values : (n,) or (n, columns) ndarray
        NaN where not known; a row of several columns is known if all of it is.

    Returns
    -------
    (n,) ndarray of bool
    """
    known = np.isfinite(values)
    known = np.asarray(known.all(axis=1)) if values.ndim > 1 else known
    beside = np.concatenate([[False], known, [False]])
    return known & ~beside[:-2] & ~beside[2:]


def root(variance: Array) -> Array:
    """Standard deviations; NaN where a variance is negative."""
    return np.sqrt(np.where(variance >= 0.0, variance, np.nan))


def typical(sizes: list[float]) -> float:
    """Lower median of the sizes that are known, NaN for none: what a common scale is made for."""
    known = sorted(size for size in sizes if np.isfinite(size))
    return known[(len(known) - 1) // 2] if known else float("nan")
