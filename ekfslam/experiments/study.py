"""Studies: estimators on many draws of a scenario, at several scales of its odometry noise.

`sweep` runs them and gives one table, a row per run; `summarised` and `paired` make statistics of
it. What a study is made of beyond that, such as `ekfslam.experiments.association`, is which
estimators run, which columns count, and what is drawn.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd

from ekfslam.checks import checked_number
from ekfslam.errors import InputError
from ekfslam.estimates import DIVERGED, FAILED, SKIPPED
from ekfslam.evaluation import tables
from ekfslam.experiments.attempts import Stopped, Watch, attempt, named
from ekfslam.registry import Estimator
from ekfslam.simulation import Scenario, load_scenario, simulate

NOISE = "odometry_noise"

T = TypeVar("T")
R = TypeVar("R")


class Draw(NamedTuple):
    """One dataset of a study: a scenario at a scale of its odometry noise, and a seed."""

    scenario: Scenario
    odometry_noise: float
    seed: int


def sweep(
    scenario: str | Scenario,
    estimators: Sequence[Any],
    scales: Sequence[float] = (1.0,),
    seeds: int = 10,
    workers: int = 1,
    watch: Watch | None = None,
) -> pd.DataFrame:
    """Run every estimator on every draw.

    Parameters
    ----------
    scenario : str or Scenario
    estimators : sequence of str or object
        As for `ekfslam.compare`; with several workers they must pickle, as names always do.
    scales : sequence of float
        Of the odometry noise, stated and drawn.
    seeds : int
        How many; they are 0, 1, 2 and so on, the same at every scale.
    workers : int
        Processes. The table does not depend on them.
    watch : callable, optional
        Told of progress: (scenario, what was run, draws done, draws in all).

    Returns
    -------
    DataFrame
        Rows of the table `summary` with the column ``odometry_noise`` after the seed, without
        times, which belong to a machine. Estimators that fail or do not apply have rows, too.

    Raises
    ------
    UnknownNameError, InputError, FileFormatError
        For what cannot be found or makes no sense, before anything runs.
    Stopped
        For a `KeyboardInterrupt` once a draw is finished: it is one, and has the rows so far.
    """
    scenario = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    for count, what in ((seeds, "seeds"), (workers, "workers")):
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
            raise InputError(f"{what} must be a whole number from 1 on, got {count!r}")
    scales = [checked_number(scale, "a scale of noise") for scale in scales]
    if not (scales and len(set(scales)) == len(scales) and all(0 <= s < np.inf for s in scales)):
        raise InputError(f"scales must be different non-negative factors, got {scales}")
    subjects = named(estimators)
    if not subjects:
        raise InputError("nothing to study: give at least one estimator")
    draws = [Draw(scenario, scale, seed) for scale in scales for seed in range(seeds)]
    rows = []
    if watch is not None:
        watch(scenario.name, "", 0, len(draws))
    try:
        with mapped(workers, partial(_rows, subjects), draws) as results:
            for draw, part in zip(draws, results, strict=True):
                rows.append(part)
                if watch is not None:
                    done = f"noise {draw.odometry_noise:g}, seed {draw.seed}"
                    watch(scenario.name, done, len(rows), len(draws))
    except KeyboardInterrupt as stop:
        if not rows:
            raise
        raise Stopped(pd.concat(rows, ignore_index=True), len(rows), len(draws)) from stop
    return pd.concat(rows, ignore_index=True)


def _rows(subjects: Mapping[str, Estimator], draw: Draw) -> pd.DataFrame:
    """What the estimators make of one draw."""
    dataset = simulate(draw.scenario, seed=draw.seed, odometry_noise=draw.odometry_noise)
    estimates = [
        attempt(name, subject, dataset, tables.summary_rows) for name, subject in subjects.items()
    ]
    table = tables.concat("summary", [tables.summary_rows(dataset, each) for each in estimates])
    table.insert(list(table).index("seed") + 1, NOISE, float(draw.odometry_noise))
    return table[[name for name in table if not str(name).startswith("time_")]]


@contextmanager
def mapped(workers: int, task: Callable[[T], R], items: Sequence[T]) -> Iterator[Iterator[R]]:
    """What a task makes of each item, in their order, from this process or from several."""
    if workers == 1:
        yield map(task, items)
        return
    quiet = (signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that the workers are of
    with ProcessPoolExecutor(workers, get_context("spawn"), signal.signal, quiet) as pool:
        try:
            yield pool.map(task, items)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


# Statistics -------------------------------------------------------------------------------------


def summarised(
    runs: pd.DataFrame, by: Sequence[str], columns: Mapping[str, str], medians: Sequence[str] = ()
) -> pd.DataFrame:
    """Means over runs with their Monte-Carlo errors.

    Parameters
    ----------
    runs : DataFrame
        Rows of `sweep`.
    by : sequence of str
        Columns that tell groups apart.
    columns : mapping
        Column to average, and what its statistics are called.
    medians : sequence of str
        Those of the columns that get a median, too.

    Returns
    -------
    DataFrame
        A row per group in order of appearance: ``runs``, those that gave an estimate, diverged ones
        included; ``share_diverged``; of every column NAME_mean, NAME_se (the standard error of the
        mean: standard deviation of the runs over the root of their number; empty for a single run),
        and NAME_median. Runs without a number take no part.
    """
    rows = []
    for keys, group in runs.groupby(list(by), sort=False, dropna=False):
        estimated = group[~group["status"].isin([FAILED, SKIPPED])]
        row: dict[str, Any] = dict(zip(by, keys, strict=True)) | {"runs": len(estimated)}
        row["share_diverged"] = (estimated["status"] == DIVERGED).mean()
        for column, name in columns.items():
            values = estimated[column].astype(float).dropna()
            row[f"{name}_mean"] = values.mean()
            row[f"{name}_se"] = standard_error(values)
            if column in medians:
                row[f"{name}_median"] = values.median()
        rows.append(row)
    return pd.DataFrame(rows)


def paired(
    runs: pd.DataFrame, of: str, first: str, second: str, column: str, name: str
) -> pd.DataFrame:
    """Difference of two kinds of runs on the same draws, for each scale of noise.

    What the draws have in common drops out, so that this tells more than two means do.

    Parameters
    ----------
    runs : DataFrame
        Rows of `sweep`.
    of : str
        Column that tells the kinds apart.
    first, second : str
        Its two values.
    column : str
        What is compared, of which less is better.
    name : str
        What it is called.

    Returns
    -------
    DataFrame
        A row per scale: ``runs``, seeds at which both have a number; NAME_difference_mean and
        NAME_difference_se, of first minus second; ``share_better``, of the seeds at which the first
        has less.
    """
    rows = []
    for noise, group in runs.groupby(NOISE, sort=False):
        values = [group[group[of] == kind].set_index("seed")[column] for kind in (first, second)]
        difference = (values[0] - values[1]).astype(float).dropna()
        rows.append(
            {
                NOISE: noise,
                of: first,
                "against": second,
                "runs": len(difference),
                f"{name}_difference_mean": difference.mean(),
                f"{name}_difference_se": standard_error(difference),
                "share_better": (difference < 0).mean(),
            }
        )
    return pd.DataFrame(rows)


def standard_error(values: pd.Series) -> float:
    """Standard error of the mean of independent samples; NaN of fewer than two."""
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")
