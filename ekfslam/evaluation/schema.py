"""Columns and dtypes of the five tables, and tables as such: empty, stacked, read back.

Every column has one dtype, whatever is known: text is ``string``, whole numbers are ``Int64``,
both with a missing value; the rest is ``float64`` with NaN. Columns are described in
``docs/tables.md``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from ekfslam.errors import FileFormatError, UnknownNameError

TEXT, WHOLE, REAL = "string", "Int64", "float64"


def schema_of(*groups: tuple[str, str]) -> dict[str, str]:
    """Columns with their dtypes, from (dtype, names) in order."""
    return {name: dtype for dtype, names in groups for name in names.split()}


_RUN = ((TEXT, "dataset"), (WHOLE, "seed"), (TEXT, "robot estimator"))

SCHEMAS: Mapping[str, Mapping[str, str]] = {
    "summary": schema_of(
        *_RUN,
        (TEXT, "series association alignment status message"),
        (WHOLE, "steps truth_poses observations"),
        (WHOLE, "landmarks_true landmarks_estimated landmarks_undetermined landmarks_matched"),
        (WHOLE, "landmarks_missed landmarks_spurious landmarks_duplicate landmarks_merged"),
        (REAL, "association_precision association_recall"),
        (REAL, "ate_position_rmse_m ate_position_max_m ate_heading_rmse_rad"),
        (REAL, "rpe_position_rmse_m rpe_heading_rmse_rad"),
        (REAL, "landmark_rmse_m landmark_max_m"),
        (REAL, "nees_pose_mean nees_pose_final nees_pose_invariant_mean nees_pose_inside_95"),
        (REAL, "nees_position_mean nees_position_inside_95"),
        (REAL, "nees_landmark_mean nis_per_dof nis_inside_95"),
        (REAL, "effective_samples_mean effective_samples_min"),
        (REAL, "graph_error graph_chi2_per_dof"),
        (REAL, "gap_final_position_m gap_final_heading_rad gap_landmark_rmse_m"),
        (REAL, "sigma_ratio_position sigma_ratio_heading"),
        (REAL, "time_total_s time_marginals_s time_per_step_mean_us"),
        (REAL, "time_per_step_median_us time_per_step_p99_us"),
    ),
    "trajectories": schema_of(
        *_RUN,
        (TEXT, "series"),
        (WHOLE, "step"),
        (REAL, "time_s x_m y_m theta_rad cov_xx cov_xy cov_xt cov_yy cov_yt cov_tt"),
        (REAL, "true_x_m true_y_m true_theta_rad"),
        (REAL, "error_x_m error_y_m error_theta_rad error_position_m"),
        (REAL, "nees nees_invariant nees_position nis"),
        (WHOLE, "nis_dof"),
        (REAL, "effective_samples time_step_s"),
    ),
    "landmarks": schema_of(
        *_RUN,
        (TEXT, "series"),
        (WHOLE, "landmark true_landmark"),
        (REAL, "x_m y_m cov_xx cov_xy cov_yy true_x_m true_y_m"),
        (REAL, "error_x_m error_y_m error_m nees"),
    ),
    "innovations": schema_of(
        *_RUN,
        (WHOLE, "step"),
        (REAL, "time_s"),
        (TEXT, "sensor observed_robot"),
        (WHOLE, "landmark"),
        (TEXT, "decision"),
        (REAL, "innovation_0 innovation_1 S_00 S_01 S_11 nis"),
        (WHOLE, "dof"),
    ),
    "association": schema_of(
        *_RUN,
        (WHOLE, "step observations mapped accepted correct false missed new duplicates spurious"),
        (WHOLE, "merges rejected ambiguous tentative"),
    ),
}
"""Columns of each table, in order, with their dtypes."""


def concat(name: str, tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Stack tables of one kind; none at all make an empty table with every column.

    Parameters
    ----------
    name : {"summary", "trajectories", "landmarks", "innovations", "association"}
    tables : iterable of DataFrame

    Raises
    ------
    UnknownNameError
        For another name.
    """
    columns = list(_columns_of(name))
    parts = [table for table in tables if len(table)]
    if len(parts) < 2:  # nothing to stack, so nothing to copy
        return parts[0].reset_index(drop=True)[columns] if parts else filled(name, {}, 0)
    return pd.concat(parts, ignore_index=True)[columns]


def read_csv(name: str, path: str | Path) -> pd.DataFrame:
    """Read a table written by ``table.to_csv(path, index=False)``, without loss.

    Parameters
    ----------
    name : {"summary", "trajectories", "landmarks", "innovations", "association"}
    path : path

    Raises
    ------
    UnknownNameError
        For another name.
    FileFormatError
        If the file is missing or does not hold the columns of this table.
    """
    schema = _columns_of(name)
    try:
        # Through text, since not every reader of numbers in pandas is exact to the last bit.
        text = pd.read_csv(path, dtype=TEXT, keep_default_na=False, na_values=[""])
        if list(text.columns) != list(schema):
            raise FileFormatError(f"{path}: does not have the columns of {name}")
        return text.astype(dict(schema))
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{path}: cannot be read as {name} ({error})") from None


def read_table(name: str, path: str | Path) -> pd.DataFrame:
    """Read a table from a CSV or, if its name ends in ``.parquet``, a Parquet file, without loss.

    Parameters and errors are those of `read_csv`.
    """
    if Path(path).suffix != ".parquet":
        return read_csv(name, path)
    schema = _columns_of(name)
    try:
        table = pd.read_parquet(path)
        if list(table.columns) != list(schema):
            raise FileFormatError(f"{path}: does not have the columns of {name}")
        return table.astype(dict(schema))
    except (OSError, ValueError) as error:  # pyarrow's own errors are of these
        text = " ".join(str(error).split())
        raise FileFormatError(f"{path}: cannot be read as {name} ({text})") from None


def _columns_of(name: str) -> Mapping[str, str]:
    if name not in SCHEMAS:
        raise UnknownNameError("table", name, SCHEMAS)
    return SCHEMAS[name]


def filled(name: str, columns: Mapping[str, Any], rows: int) -> pd.DataFrame:
    """Columns of a schema from scalars and arrays; what is not given, None or "" is empty."""

    def series(column: str, dtype: Any) -> pd.Series:
        value = columns.get(column)
        empty = isinstance(value, str) and not value
        return pd.Series(None if empty else value, index=range(rows), dtype=dtype)

    made = {c: series(c, dtype) for c, dtype in _columns_of(name).items()}
    return pd.DataFrame(made, copy=False)  # they are copies already
