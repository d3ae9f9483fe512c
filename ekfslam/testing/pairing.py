"""An estimator and what it is held against, on the same draws."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ekfslam.errors import InputError
from ekfslam.estimates import DIVERGED
from ekfslam.testing import metrics as of
from ekfslam.testing.failures import command, fail_for_lost
from ekfslam.testing.references import is_ours, read_reference, records_of, same
from ekfslam.testing.runs import Problem, name_of, problem_of, run, seeds_of
from ekfslam.testing.session import current
from ekfslam.testing.statistics import SAME, least_ratio

__tracebackhide__ = True  # a failed test shows the user's line

ZERO = 1e-9
"""Errors up to this are rounding: m, rad or nothing."""


class Pair(NamedTuple):
    """A metric of both on the seeds that both have numbers at.

    Attributes
    ----------
    problem : Problem
    metric : str
    baseline : str
        What the estimator is held against.
    now, stored : Series
        By seed; less is better.
    rewritable : bool
        Whether there is a reference to be rewritten.
    """

    problem: Problem
    metric: str
    baseline: str
    now: pd.Series
    stored: pd.Series
    rewritable: bool


def not_worse(pair: Pair, margin: float, level: float) -> dict[str, Any]:
    """The claim about a pair, with its numbers."""
    now, stored = pair.now.to_numpy(), pair.stored.to_numpy()
    equal = np.abs(now - stored) <= SAME * stored
    now = np.where(equal, stored, now)
    now, stored = (np.where(each <= ZERO, 0.0, each) for each in (now, stored))
    least = least_ratio(now, stored, level) if len(now) > 1 else _ratio(now, stored)
    return {
        "scenario": pair.problem.name,
        "what": pair.metric,
        "seeds": len(now),
        "stored": stored.mean(),
        "now": now.mean(),
        "change": _ratio(now, stored) - 1.0,
        "at_least": least - 1.0,
        "worse": int((now > stored).sum()),
        "better": int((now < stored).sum()),
        # What the order of terms does to a sum is no difference.
        "holds": bool(least <= (1.0 + margin) * (1.0 + 1e-12)),
    }


def _ratio(now: np.ndarray, stored: np.ndarray) -> float:
    if stored.sum() > 0:
        return float(now.sum() / stored.sum())
    return float("inf") if now.sum() > 0 else 1.0


def paired(
    estimator: Any,
    baseline: Any,
    scenario: Any,
    seeds: int | Iterable[int] | None,
    metrics: Sequence[str],
    series: str | None,
    robot: str | None,
) -> list[Pair]:
    """Every scenario and metric; a reference that is to be rewritten is noted first.

    Raises
    ------
    AssertionError
        If a run is lost that was not before.
    InputError, UnknownNameError, FileFormatError
        As `ekfslam.testing.assert_not_worse`.
    """
    path = _reference(baseline)
    if path is None:
        if scenario is None:
            raise InputError("say on which scenario: the baseline is an estimator")
        problem = problem_of(scenario)
        chosen = seeds_of(problem, seeds)
        stored = run(baseline, problem, chosen, of.needs_smoother(metrics))
        sides = [(problem, stored)]
        title = name_of(baseline)
    else:
        title = str(baseline)
        sides = list(_referred(path, title, estimator, scenario, seeds, metrics))
    rewritable = path is not None and is_ours(path)
    pairs: list[Pair] = []
    for problem, before in sides:
        chosen = [int(seed) for seed in before["seed"].unique()]
        now = run(estimator, problem, chosen, of.needs_smoother(metrics))
        if path is not None:
            _check_draws(now, before, title, _remedy(path))
        pairs += _pairs(problem, title, now, before, metrics, series, robot, rewritable)
    return pairs


def _pairs(
    problem: Problem,
    title: str,
    now: pd.DataFrame,
    before: pd.DataFrame,
    metrics: Sequence[str],
    series: str | None,
    robot: str | None,
    rewritable: bool,
) -> Iterator[Pair]:
    some = bool((before["status"] == DIVERGED).any())
    lost = of.not_ok(now)
    lost = lost[~lost["seed"].isin(of.not_ok(before)["seed"])]
    lost = lost[lost["status"] != DIVERGED] if some else lost
    fail_for_lost(lost, now["seed"].nunique(), f"; not so in {title}")
    sides = [of.of_series(rows, series, robot) for rows in (now, before)]
    numbers = {
        metric: [of.errors_of(_numbers(rows, metric), metric) for rows in sides]
        for metric in metrics
    }
    if some:
        numbers["diverged"] = [of.diverged(rows) for rows in sides]
    for metric, (ours, theirs) in numbers.items():
        both = pd.concat([ours, theirs], axis=1, join="inner", keys=["now", "stored"])
        both = both.loc[np.isfinite(both.to_numpy()).all(axis=1)]
        if both.empty:
            who = now["estimator"].iloc[0]
            raise InputError(f"{who} on {problem.name} and {title} share no number of {metric}")
        _check_kept(now, ours, theirs, metric, title)
        yield Pair(problem, metric, title, both["now"], both["stored"], rewritable)


def _check_kept(
    now: pd.DataFrame, ours: pd.Series, theirs: pd.Series, metric: str, title: str
) -> None:
    """Fail a run without a number that it had: no pair would ever tell.

    Raises
    ------
    AssertionError
    """
    had = theirs.index[np.isfinite(theirs)].difference(of.not_ok(now)["seed"])
    lacking = had[~np.isfinite(ours.reindex(had))]
    if len(lacking):
        who, where = now["estimator"].iloc[0], now["scenario"].iloc[0]
        raise AssertionError(
            f"{who} on {where}: no {metric} in {len(lacking)} of {len(had)} runs, first seed "
            f"{lacking[0]}, where {title} has one"
        )


def _numbers(rows: pd.DataFrame, metric: str) -> pd.Series:
    if metric not in rows:
        return pd.Series(np.nan, index=rows["seed"].unique())
    return rows[metric].astype(float).groupby(rows["seed"].to_numpy()).mean()


# References --------------------------------------------------------------------------------------


def _reference(baseline: Any) -> Path | None:
    """The file of a reference; an estimator has none."""
    if isinstance(baseline, Path) or (isinstance(baseline, str) and baseline.endswith(".csv")):
        return current().root / baseline
    return None


def _referred(
    path: Path,
    title: str,
    estimator: Any,
    scenario: Any,
    seeds: int | Iterable[int] | None,
    metrics: Sequence[str],
) -> Iterator[tuple[Problem, pd.DataFrame]]:
    """Each problem with the stored runs; or with those that will be, where it is rewritten."""
    name, updating = name_of(estimator), current().updating and is_ours(path)
    table = pd.DataFrame(columns=["estimator", "scenario", "seed"])
    if path.exists():
        table = read_reference(path)
    elif not updating:
        raise InputError(f"{title} is missing: {_remedy(path)}")
    table = table.loc[table["estimator"] == name]
    if scenario is None and table.empty:
        raise InputError(f"{title} has no runs of {name}: say on which scenario")
    wanted = [scenario] if scenario is not None else list(table["scenario"].unique())
    for problem in map(problem_of, wanted):
        before = table[table["scenario"] == problem.name]
        if seeds is None and len(before) and problem.simulated:
            chosen = sorted(int(seed) for seed in before["seed"].unique())
        else:
            chosen = seeds_of(problem, seeds)
        if updating:
            yield problem, _rewritten(path, estimator, problem, chosen, metrics)
        else:
            before = before[before["seed"].isin(chosen)]
            what = f"{title}: {name} on {problem.name}"
            _check_reference(before, what, chosen, metrics, _remedy(path))
            yield problem, before


def _remedy(path: Path) -> str:
    """What to do about a reference that does not have what it should."""
    if is_ours(path):
        return f"write it with\n  {command()}"
    return "it was not written by --ekfslam-update, which leaves it as it is"


def _rewritten(
    path: Path, estimator: Any, problem: Problem, seeds: list[int], metrics: Sequence[str]
) -> pd.DataFrame:
    """The runs of now, noted to be written when all tests have run."""
    rows = run(estimator, problem, seeds, of.needs_smoother(metrics))
    lost = of.not_ok(rows)
    fail_for_lost(lost[lost["status"] != DIVERGED], len(seeds), "; this is no reference")
    current().rewritten.setdefault(str(path), []).extend(records_of(rows, metrics))
    return rows


def _check_reference(
    before: pd.DataFrame, what: str, seeds: list[int], metrics: Sequence[str], remedy: str
) -> None:
    """Refuse a reference without what is asked for.

    Raises
    ------
    InputError
    """
    there = set(before["seed"])
    missing = [f"seed {seed}" for seed in seeds if seed not in there]
    lacking = [name for name in metrics if name not in before or before[name].isna().all()]
    said = [*missing[:1], *(["other seeds"] if len(missing) > 1 else []), *lacking]
    if said:
        raise InputError(f"{what} has no {', no '.join(said)}: {remedy}")


def _check_draws(now: pd.DataFrame, before: pd.DataFrame, title: str, remedy: str) -> None:
    """Refuse to pair runs on different draws.

    Raises
    ------
    InputError
    """
    if "draw" not in before:
        return
    draws = [rows.groupby("seed")["draw"].first() for rows in (now, before)]
    other = ~same(*draws) & draws[1].notna()
    if other.any():
        raise InputError(
            f"{title}: {other.sum()} draws of {now['scenario'].iloc[0]} are not those of now, "
            f"first seed {other.index[other][0]}; the scenario has changed, so that nothing can be "
            f"compared: {remedy}"
        )
