"""Runs that assertions are about: a row per seed, robot and series, made once in a session."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.datasets import is_recorded
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.estimates import FAILED, SKIPPED, Estimate
from ekfslam.evaluation import run_metrics
from ekfslam.evaluation.tables import summary_scalars
from ekfslam.experiments.attempts import attempt, named
from ekfslam.experiments.compare import REFERENCE
from ekfslam.experiments.sources import open_dataset
from ekfslam.registry import Estimator, estimator_name, resolve
from ekfslam.simulation import Scenario, load_scenario, scenario_hash, scenarios, simulate
from ekfslam.testing.session import Record, current

__tracebackhide__ = True  # a failed test shows the user's line

SEEDS = 100
"""Draws of a scenario unless said otherwise; docs/pytest.md has what these can see."""


class Problem(NamedTuple):
    """What estimators are run on.

    Attributes
    ----------
    name : str
        As in tables.
    key : object
        Equal for the same problem.
    draw : callable
        Gives the dataset of a seed.
    simulated : bool
        Whether there are seeds at all.
    """

    name: str
    key: Any
    draw: Callable[[int], Dataset]
    simulated: bool


def problem_of(scenario: str | Path | Scenario | Dataset) -> Problem:
    """The problem of a scenario, a recorded set, a file or a dataset.

    Raises
    ------
    UnknownNameError, FileFormatError, InputError
        As `ekfslam.compare`.
    """
    if isinstance(scenario, Dataset):
        given = scenario
        return Problem(given.name, given, lambda seed: given, simulated=False)
    if not isinstance(scenario, Scenario):
        name = str(scenario).partition("(")[0].strip()
        if is_recorded(name) or not (name in scenarios() or name.endswith(".toml")):
            dataset = open_dataset(scenario)
            return Problem(dataset.name, str(scenario), lambda seed: dataset, simulated=False)
        scenario = load_scenario(str(scenario))
    drawn = scenario
    key: Any = drawn
    with suppress(UnsupportedError):  # with functions of its own, it is equal to itself alone
        key = (drawn.name, scenario_hash(drawn))
    return Problem(drawn.name, key, lambda seed: simulate(drawn, seed=seed), simulated=True)


def seeds_of(problem: Problem, seeds: int | Iterable[int] | None) -> list[int]:
    """Seeds in order: the first so many, or those that are given.

    Raises
    ------
    InputError
        For seeds that are none, are there twice, or are given for what is not drawn.
    """
    if not problem.simulated:
        if seeds is not None:
            raise InputError(f"{problem.name} is one dataset, which takes no seeds")
        return [0]
    if seeds is None:
        return list(range(SEEDS))
    if not isinstance(seeds, Iterable):
        seeds = range(_whole(seeds))
    given = [_whole(seed) for seed in seeds]
    if not given or len(set(given)) != len(given):
        raise InputError("seeds must be a number of them, or some that are all different")
    return given


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
        raise InputError(f"seeds must be whole numbers from 0 on, got {value!r}")
    return int(value)


def run(estimator: Any, problem: Problem, seeds: Iterable[int], gaps: bool = False) -> pd.DataFrame:
    """Scalars of an estimator on each draw; what was run in this session is not run again.

    Parameters
    ----------
    estimator : str or object
        As for `ekfslam.compare`.
    problem : Problem
    seeds : iterable of int
    gaps : bool
        Whether to run the batch smoother, too, for the distances from it.

    Returns
    -------
    DataFrame
        Columns of the table `summary` and of `ekfslam.evaluation.run_metrics`, ``scenario`` for
        ``dataset``, and ``draw``, by which a draw is known again.
    """
    kept, who = current().kept, _key(estimator)
    ((name, subject),) = named([estimator]).items()
    rows = []
    for seed in seeds:
        key = (who, problem.key, seed, gaps)
        found = kept.get(key) if who is not None else None
        if found is None:
            found = _run(name, subject, problem.draw(seed), gaps)
            found = [row | {"scenario": problem.name, "seed": seed} for row in found]
            if who is not None:
                kept[key] = found
        rows += found
    return pd.DataFrame(rows)


def _key(estimator: Any) -> Any:
    """What an estimator is known again by, or None: an object that changes is another one."""
    if isinstance(estimator, str):
        return estimator
    if isinstance(estimator, type):
        return estimator
    try:
        return type(estimator), pickle.dumps(estimator)
    except Exception:
        return None


def _run(name: str, subject: Estimator, dataset: Dataset, gaps: bool) -> list[Record]:
    # Increments and columns belong to the data: no estimator's clock counts them.
    _ = dataset.moves, dataset.sightings, dataset.offsets
    smoothed: Estimate | None = None
    if gaps and name != REFERENCE:
        smoothed = attempt(REFERENCE, resolve(REFERENCE), dataset, lambda d, e: None)
    made: list[Record] = []

    def tabulate(dataset: Dataset, estimate: Estimate) -> None:
        best = estimate if gaps and name == REFERENCE else smoothed
        scalars = summary_scalars(dataset, estimate, reference=best)
        metrics = run_metrics(dataset, estimate, best)
        made[:] = [a | b for a, b in zip(scalars, metrics, strict=True)]

    estimate = attempt(name, subject, dataset, tabulate)
    if estimate.status in (FAILED, SKIPPED):
        tabulate(dataset, estimate)
    return [row | {"draw": fingerprint(dataset)} for row in made]


def fingerprint(dataset: Dataset) -> float:
    """A number that another draw does not share and that rounding does not change."""
    numbers = [dataset.observations.values, *(robot.controls for robot in dataset.robots)]
    return float(sum(np.nansum(np.abs(each)) for each in numbers))


def name_of(estimator: Any) -> str:
    """How an estimator is called in tables and references."""
    return estimator_name(estimator)
