"""Assertions about an estimator over many draws, with the statistics that each can bear.

Each makes claims and fails only if the data contradict one. If all claims are true, the chance of
that is at most ``alpha``, the false-alarm rate, which the claims of one call share in equal parts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.simulation import Scenario
from ekfslam.testing import metrics as of
from ekfslam.testing.failures import fail, fail_for_lost
from ekfslam.testing.findings import Finding, percent, short
from ekfslam.testing.pairing import Pair, not_worse, paired
from ekfslam.testing.runs import name_of, problem_of, run, seeds_of
from ekfslam.testing.statistics import expected_interval, least_mean

__tracebackhide__ = True  # a failed test shows the user's line

POSE = 3
"""Degrees of freedom of a pose: what its mean NEES should be."""

ROUNDING = 1e-12
"""Share of a bound by which a mean may be beyond it, so that a number holds against itself."""

_Scenario = str | Path | Scenario | Dataset


def assert_accuracy(
    estimator: Any,
    scenario: _Scenario,
    seeds: int | Iterable[int] | None = None,
    *,
    alpha: float = 0.01,
    series: str | None = None,
    robot: str | None = None,
    **bounds: float,
) -> Finding:
    """Claim that the means of metrics over the draws of a scenario are within bounds.

    A bound says the most that the mean may be; of precision, recall and shares inside an interval
    the least. It is contradicted if the lower (upper) confidence bound of the mean by Student's t
    is beyond it: a mean that is beyond it by chance is no failure. Of a single run, such as a
    recorded one, there is no spread, and the number itself is held against the bound. A run that
    diverges, fails or is skipped fails the assertion.

    Parameters
    ----------
    estimator : str or object
        As for `ekfslam.compare`.
    scenario : str, path, Scenario or Dataset
        As for `ekfslam.compare`; one.
    seeds : int or iterable of int, optional
        The first so many draws, or those of these seeds; 100 by default.
    alpha : float
        False-alarm rate of the call, in (0, 0.5).
    series : {"online", "smoothed"}, optional
        For an estimator that has both.
    robot : str, optional
        Of several; by default a run counts with the mean over its robots.
    **bounds
        By column of the table `summary`, such as ``ate_position_rmse_m=0.3``.

    Returns
    -------
    Finding

    Raises
    ------
    AssertionError
        If the data contradict a bound.
    InputError, UnknownNameError, FileFormatError
        For what cannot be found, or a metric that there is not.
    """
    if not bounds:
        raise InputError("give at least one bound, such as ate_position_rmse_m=0.3")
    of.check_metrics(bounds)
    level = _level(alpha, len(bounds))
    problem = problem_of(scenario)
    rows = run(estimator, problem, seeds_of(problem, seeds), of.needs_smoother(bounds))
    fail_for_lost(of.not_ok(rows), rows["seed"].nunique())
    rows = of.of_series(rows, series, robot)
    claims, by_seed = [], []
    for metric, bound in bounds.items():
        values = of.per_seed(rows, metric)
        claims.append(bounded(values.to_numpy(), metric, float(bound), level))
        ranked = values.sort_values(ascending=metric in of.MORE, kind="stable")
        by_seed.append(_by_seed(metric, ranked, claim=float(bound)))
    table = pd.DataFrame(claims)
    table.insert(0, "scenario", problem.name)
    headline = _accuracy_in_words(name_of(estimator), table, alpha)
    seeds_table = pd.concat(by_seed, ignore_index=True).assign(scenario=problem.name)
    finding = Finding(headline, table, seeds_table)
    fail(finding, estimator, problem)
    return finding


def bounded(values: np.ndarray, metric: str, bound: float, level: float) -> dict[str, Any]:
    """The claim that the mean of values (n,) is within a bound, with its numbers."""
    sign = -1.0 if metric in of.MORE else 1.0
    sure = sign * least_mean(sign * values, level) if len(values) > 1 else float(values[0])
    return {
        "what": metric,
        "runs": len(values),
        "mean": values.mean(),
        "bound": bound,
        "least" if sign > 0 else "most": sure,
        "median": float(np.median(values)),
        "holds": bool(sign * (sure - bound) <= ROUNDING * abs(bound)),
    }


def _accuracy_in_words(name: str, claims: pd.DataFrame, alpha: float) -> str:
    broken = claims[~claims["holds"]]
    runs, scenario = claims["runs"].iloc[0], claims["scenario"].iloc[0]
    if broken.empty:
        what = ", ".join(claims["what"])
        return f"{name} on {scenario}: nothing contradicts the bounds of {what}; {runs} runs"
    row = broken.iloc[0]
    more = row["what"] in of.MORE
    side = "below" if more else "above"
    said = f"{name} on {scenario}: mean {row['what']} {row['mean']:.3g} is {side} {row['bound']:g}"
    if runs == 1:
        return f"{said}; one run, which has no spread"
    sure = f"at most {row['most']:.3g}" if more else f"at least {row['least']:.3g}"
    return f"{said}, {sure} {_rest(runs, 'runs', alpha, len(claims))}"


def assert_consistent(
    estimator: Any,
    scenario: _Scenario,
    seeds: int | Iterable[int] | None = None,
    *,
    margin: float = 0.1,
    alpha: float = 0.01,
    series: str | None = None,
    robot: str | None = None,
) -> Finding:
    """Claim that an estimator is as good as it says it is: NEES of the final pose, and NIS.

    NEES is judged at one time, over the runs, since the errors along one run depend on each other;
    NIS is pooled over all steps of all runs, where the estimator states it. The mean of either over
    its degrees of freedom must be 1, give or take the margin and its chi-square interval. That
    supposes normal errors: where they have heavier tails, the margin has to make up for it.

    Parameters
    ----------
    estimator, scenario, seeds, alpha, series, robot
        As for `assert_accuracy`. Each robot is a claim of its own; there must be several draws.
    margin : float
        Share by which the true means may be off: no filter is quite consistent where its models are
        not linear.

    Returns
    -------
    Finding

    Raises
    ------
    AssertionError
        If the data contradict a claim, or a run is lost.
    InputError, UnknownNameError, FileFormatError
        As `assert_accuracy`; and if there is no truth or no covariance to hold it against.
    """
    if not 0.0 <= margin < 1.0:
        raise InputError(f"margin must be a share in [0, 1), got {margin}")
    problem = problem_of(scenario)
    chosen = seeds_of(problem, seeds)
    if len(chosen) < 2:
        raise InputError("one run says nothing of consistency: give several seeds")
    rows = run(estimator, problem, chosen)
    fail_for_lost(of.not_ok(rows), rows["seed"].nunique())
    rows = of.of_series(rows, series, robot)
    asked = _consistency(rows)
    level = _level(alpha, len(asked))
    claims = []
    for what, (values, dof, expected) in asked.items():
        low, high = expected_interval(float(dof.sum()), margin, level)
        mean = float(values.sum() / dof.sum())
        claims.append(
            {"scenario": problem.name, "what": what, "runs": len(values), "mean": mean * expected}
            | {"expected": expected, "low": low * expected, "high": high * expected}
            | {"holds": low <= mean <= high}
        )
    by_seed = [
        _by_seed(what, (v / d * expected).sort_values(ascending=False), claim=expected)
        for what, (v, d, expected) in asked.items()
    ]
    table = pd.DataFrame(claims)
    seeds_table = pd.concat(by_seed, ignore_index=True).assign(scenario=problem.name)
    headline = _consistency_in_words(name_of(estimator), table, alpha)
    finding = Finding(headline, table, seeds_table)
    fail(finding, estimator, problem)
    return finding


def _consistency(rows: pd.DataFrame) -> dict[str, tuple[pd.Series, pd.Series, float]]:
    """What is asked: values and degrees of freedom of each run, and what the mean should be."""
    asked = {}
    robots = [part for _, part in rows.groupby("robot", sort=False, dropna=False)]
    for part in robots:
        name = "NEES of the final pose"
        name += f" of {part['robot'].iloc[0]}" if len(robots) > 1 else ""
        values = of.per_seed(part, "nees_pose_final")
        asked[name] = (values, pd.Series(float(POSE), values.index), float(POSE))
    if "nis_dof_sum" in rows and rows["nis_dof_sum"].sum() > 0:  # 0 if all was rejected
        sums, dof = of.per_seed(rows, "nis_sum"), of.per_seed(rows, "nis_dof_sum")
        asked["NIS per dof"] = (sums, dof, 1.0)
    return asked


def _consistency_in_words(name: str, claims: pd.DataFrame, alpha: float) -> str:
    broken = claims[~claims["holds"]]
    scenario, runs = claims["scenario"].iloc[0], claims["runs"].iloc[0]
    if broken.empty:
        return f"{name} on {scenario}: nothing contradicts its covariances; {runs} runs"
    row = broken.iloc[0]
    over = row["mean"] > row["high"]
    return (
        f"{name} on {scenario} is {'over' if over else 'under'}confident: mean {row['what']} "
        f"{row['mean']:.3g} is {'above' if over else 'below'} {row['low']:.3g} to "
        f"{row['high']:.3g}, where {row['expected']:g} is expected; {runs} runs, "
        f"{_rate(alpha, len(claims))}"
    )


def assert_not_worse(
    estimator: Any,
    baseline: str | Path | Any,
    scenario: _Scenario | None = None,
    seeds: int | Iterable[int] | None = None,
    *,
    metric: str | Sequence[str] = "ate_position_rmse_m",
    margin: float = 0.01,
    alpha: float = 0.01,
    series: str | None = None,
    robot: str | None = None,
) -> Finding:
    """Claim that the means of metrics are not above those of a reference on the same draws.

    Differences are taken seed by seed, so that what the draws have in common drops out. The claim
    is contradicted if the lower bound of the ratio of the means,
    `ekfslam.testing.statistics.least_ratio`, is above ``1 + margin``. Equal numbers on every seed
    never are. A run that fails where the reference did not fails the assertion, and so does one
    that diverges, unless the reference has such runs: then how often it happens is a claim, too. So
    does a run without a number that the reference has, such as the error of a map that is gone.

    Parameters
    ----------
    estimator, alpha, series, robot
        As for `assert_accuracy`.
    baseline : path, str or object
        A reference, ``.csv``, relative to the root of the tests, which ``pytest --ekfslam-update``
        writes, or the table `summary` of some draws, which it leaves as it is; or another
        estimator, which is run on the same draws.
    scenario : str, path, Scenario or Dataset, optional
        By default every one that the reference has of this estimator.
    seeds : int or iterable of int, optional
        By default those of the reference; of a new one 100.
    metric : str or sequence of str
        Errors, of which less is better. Of precision and recall, what is missing from 1 counts.
    margin : float
        Share that the mean may be worse by.

    Returns
    -------
    Finding

    Raises
    ------
    AssertionError
        If the data contradict a claim, or a run is lost.
    InputError, UnknownNameError, FileFormatError
        As `assert_accuracy`; for a reference without these draws, seeds or metrics, with the
        command that writes them; and if the seeds are too few to contradict anything.
    """
    names = of.listed(metric)
    of.check_metrics(names)
    of.check_errors(names)
    if not 0.0 <= margin < np.inf:
        raise InputError(f"margin must be a share from 0 on, got {margin}")
    pairs = paired(estimator, baseline, scenario, seeds, names, series, robot)
    level = _level(alpha, len(pairs))
    table = pd.DataFrame([not_worse(pair, margin, level) for pair in pairs])
    parts = [
        _by_seed(
            pair.metric,
            pair.now.loc[(pair.now - pair.stored).sort_values(ascending=False).index],
            stored=pair.stored,
        ).assign(scenario=pair.problem.name)
        for pair in pairs
    ]
    name, other = name_of(estimator), pairs[0].baseline
    headline = _worse_in_words(name, other, table, margin, alpha)
    finding = Finding(headline, table, pd.concat(parts, ignore_index=True))
    broken: list[Pair] = [p for p, holds in zip(pairs, table["holds"], strict=True) if not holds]
    if broken:
        fail(finding, estimator, broken[0].problem, rewritable=pairs[0].rewritable)
    return finding


def _worse_in_words(
    name: str, other: str, claims: pd.DataFrame, margin: float, alpha: float
) -> str:
    broken = claims[~claims["holds"]]
    scenarios = ", ".join(claims["scenario"].unique())
    if broken.empty:
        return f"{name} on {scenarios}: nothing says that it is worse than {other}"
    row = broken.iloc[0]
    said = (
        f"{name} on {row['scenario']} is worse than {other}: mean {row['what']} "
        f"{short(row['now'])} against {short(row['stored'])}"
    )
    if np.isfinite(row["change"]):
        said += f", {percent(row['change'], sign=True)}"
    if row["seeds"] == 1:
        return f"{said}; one run, which has no spread, margin {percent(margin)}"
    if np.isfinite(row["at_least"]):
        said += f", at least {percent(row['at_least'], sign=True)}"
    said += f", margin {percent(margin)}"
    return f"{said} {_rest(row['seeds'], 'seeds', alpha, len(claims))}"


# What they share -------------------------------------------------------------------------------


def _level(alpha: float, claims: int) -> float:
    """Of each claim (Bonferroni)."""
    if not 0.0 < alpha < 0.5:
        raise InputError(f"alpha must be in (0, 0.5), got {alpha}")
    return alpha / claims


def _rest(count: int, what: str, alpha: float, claims: int) -> str:
    sure = f"({percent(1.0 - _level(alpha, claims))} confidence)"
    return f"{sure}; {count} {what}, {_rate(alpha, claims)}"


def _rate(alpha: float, claims: int) -> str:
    return f"false-alarm rate {percent(alpha)}" + (f" of {claims} claims" if claims > 1 else "")


def _by_seed(what: str, now: pd.Series, **others: Any) -> pd.DataFrame:
    """Numbers of each seed in the order that they come in."""
    return pd.DataFrame({"what": what, "seed": now.index, "now": now.to_numpy()}).assign(
        **{
            k: v.loc[now.index].to_numpy() if isinstance(v, pd.Series) else v
            for k, v in others.items()
        }
    )
