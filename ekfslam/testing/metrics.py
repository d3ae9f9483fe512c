"""Metrics that assertions take: columns of the table `summary` and of the runs of a campaign."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

from ekfslam.errors import InputError, UnknownNameError
from ekfslam.estimates import DIVERGED, OK
from ekfslam.evaluation.paired import TARGETS
from ekfslam.evaluation.run_metrics import RUN_METRICS
from ekfslam.evaluation.schema import REAL
from ekfslam.evaluation.tables import SCHEMAS

__tracebackhide__ = True  # a failed test shows the user's line

METRICS = tuple(
    name
    for name, dtype in {**SCHEMAS["summary"], **RUN_METRICS}.items()
    if (dtype == REAL or name.startswith("landmarks_"))
    and not name.startswith(("time_", "white_", "nis_sum"))
)
"""What can be asserted. Times are those of a machine, and sums mean nothing for one run."""

SHARES = ("association_precision", "association_recall")
"""Of which 1 is best: what is missing from it is the error."""

MORE = (
    *SHARES,
    *("landmarks_matched", "effective_samples_mean", "effective_samples_min"),
    *(name for name in METRICS if "inside_95" in name),
)
"""Of which a bound says the least; of all others the most."""

_STARTS = ("ate_", "rpe_", "landmark_", "gap_", "graph_error")
_WRONG = ("missed", "spurious", "duplicate", "merged")
ERRORS = (
    *SHARES,
    *(name for name in METRICS if name.startswith(_STARTS)),
    *(name for name in METRICS if "_mse_" in name or "_error_" in name),
    *(f"landmarks_{name}" for name in _WRONG),
)
"""Of which less is better."""


def check_metrics(names: Iterable[str]) -> None:
    """Refuse a metric that there is not.

    Raises
    ------
    UnknownNameError
    """
    for name in names:
        if name not in METRICS:
            raise UnknownNameError("metric", name, METRICS)


def check_errors(names: Iterable[str]) -> None:
    """Refuse a metric of which less is not better.

    Raises
    ------
    InputError
        For a NEES, which has a value that it should have, or a count of which more is better.
    """
    for name in names:
        if name not in ERRORS:
            aim = f"; it should be {TARGETS[name]:g}" if name in TARGETS else ""
            raise InputError(
                f"{name} is no error, of which less is better{aim}: "
                "use assert_consistent or assert_accuracy"
            )


def needs_smoother(names: Iterable[str]) -> bool:
    """Whether a metric is a distance from the batch smoother."""
    return any(name.startswith(("gap_", "sigma_ratio_")) for name in names)


def errors_of(values: pd.Series, metric: str) -> pd.Series:
    """Values of which less is better and zero is best."""
    return 1.0 - values if metric in SHARES else values


def of_series(rows: pd.DataFrame, series: str | None, robot: str | None) -> pd.DataFrame:
    """Rows of one series, and of one robot if it is named.

    Raises
    ------
    InputError
        If there are several series and none is chosen.
    UnknownNameError
        For a series or robot that is not there.
    """
    for column, wanted in (("series", series), ("robot", robot)):
        known = [str(name) for name in rows[column].dropna().unique()]
        if wanted is not None and wanted not in known:
            raise UnknownNameError(column, wanted, known)
        if column == "series" and wanted is None and len(known) > 1:
            who = rows["estimator"].iloc[0]
            raise InputError(f"{who} has the series {' and '.join(known)}: say series=...")
        if wanted is not None:
            rows = rows[(rows[column] == wanted) | rows[column].isna()]
    return rows


def per_seed(rows: pd.DataFrame, metric: str) -> pd.Series:
    """A number for each seed, in order: the mean over the robots.

    Raises
    ------
    InputError
        If a run that gave an estimate does not have this metric.
    """
    if metric not in rows:
        values = pd.Series(np.nan, index=sorted(rows["seed"].unique()))
    else:
        values = rows[metric].astype(float).groupby(rows["seed"].to_numpy()).mean()
    if not np.isfinite(values).all():
        lost = values.index[~np.isfinite(values)]
        raise InputError(
            f"{rows['estimator'].iloc[0]} on {rows['scenario'].iloc[0]} has no {metric}"
            + ("" if len(lost) == len(values) else f" at seed {lost[0]}")
        )
    return values


def not_ok(rows: pd.DataFrame) -> pd.DataFrame:
    """Runs that diverged, failed or were skipped, one row for each."""
    return rows[rows["status"] != OK].drop_duplicates("seed")


def in_words(lost: pd.DataFrame, runs: int) -> str:
    """Which runs are not what they should be, and why the first one is not."""
    first = lost.iloc[0]
    counts = ", ".join(f"{n} {status}" for status, n in lost["status"].value_counts().items())
    why = f" ({first['message']})" if first["message"] else ""
    return (
        f"{first['estimator']} on {first['scenario']}: {counts} of {runs} "
        f"{'run' if runs == 1 else 'runs'}, first seed {first['seed']}{why}"
    )


def diverged(rows: pd.DataFrame) -> pd.Series:
    """1 for each seed whose run diverged, otherwise 0."""
    return (rows["status"] == DIVERGED).astype(float).groupby(rows["seed"].to_numpy()).max()


def listed(metric: str | Sequence[str]) -> list[str]:
    """Metrics as a list, each once."""
    return list(dict.fromkeys([metric] if isinstance(metric, str) else metric))
