"""Two estimators on the same seeds: who is better, by how much, and whether that is seen at all.

What the seeds have in common drops out of the differences, so that they tell more than two means
do. Of errors less is better. NEES, ratios and shares have a value that they should have, and the
better estimator is the one whose mean over the seeds is nearer to it: a single run of a consistent
filter is far from it as often as not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ekfslam.errors import InputError, UnknownNameError
from ekfslam.evaluation.campaign import GROUP, check_columns, check_distinct
from ekfslam.evaluation.resampling import ROUNDING, holm, mean_interval, sign_flip_p
from ekfslam.evaluation.schema import REAL, TEXT, WHOLE, schema_of
from ekfslam.geometry import Array

TARGETS: Mapping[str, float] = {
    "nees_pose_mean": 3.0,
    "nees_pose_final": 3.0,
    "nees_pose_invariant_mean": 3.0,
    "nees_pose_invariant_final": 3.0,
    "nees_pose_mean_kept": 3.0,
    "nees_pose_invariant_mean_kept": 3.0,
    "nees_position_mean_kept": 2.0,
    "nees_position_invariant_mean_kept": 2.0,
    "nees_heading_mean_kept": 1.0,
    "nees_landmark_mean": 2.0,
    "nees_position_mean": 2.0,
    "nees_pose_inside_95": 0.95,
    "nees_position_inside_95": 0.95,
    "nees_pose_inside_95_kept": 0.95,
    "nees_pose_invariant_inside_95_kept": 0.95,
    "nis_inside_95": 0.95,
    "nis_per_dof": 1.0,
    "graph_chi2_per_dof": 1.0,
    "sigma_ratio_position": 1.0,
    "sigma_ratio_heading": 1.0,
    "association_precision": 1.0,
    "association_recall": 1.0,
}
"""What the mean of a metric should be; of every other metric less is better."""

FEWEST = 6
"""Pairs without which nothing is concluded: of five, no two-sided sign test is below 5 %."""

PAIRS: Mapping[str, str] = schema_of(
    (TEXT, "scenario robot metric a b"),
    (REAL, "share_a_less"),
    (WHOLE, "seeds missing"),
    (REAL, "target mean_a mean_b mean_difference half_width probability median_difference"),
    (REAL, "p p_adjusted"),
    (WHOLE, "comparisons"),
    (TEXT, "better verdict"),
)
"""Columns of `compare_pairs`, in order, with their dtypes."""


class _Pair(NamedTuple):
    """One comparison: the numbers (n, 2) of both on the seeds that both have, in order of seed."""

    scenario: Any
    robot: Any
    metric: str
    a: str
    b: str
    values: Array
    missing: int

    @property
    def target(self) -> float | None:
        return TARGETS.get(self.metric)

    @property
    def differences(self) -> Array:
        """a - b (n,), zero where they differ by rounding."""
        a, b = self.values.T
        return np.where(np.abs(a - b) <= ROUNDING * np.abs(self.values).max(axis=1), 0.0, a - b)


def compare_pairs(
    runs: pd.DataFrame,
    metrics: str | Sequence[str],
    pairs: Sequence[tuple[str, str]] | None = None,
    baseline: str | None = None,
    probability: float = 0.95,
    resamples: int = 9999,
    seed: int = 0,
) -> pd.DataFrame:
    """Compare estimators, two at a time, on the seeds that both have.

    Effect size: the share of seeds on which a has less than b, ties counted half; 0.5 is no effect.
    It holds for any metric and no single run can dominate it. The interval is of the mean of
    a - b: symmetric bootstrap-t, see `ekfslam.evaluation.resampling`, of this comparison alone. The
    p value is that of the sign-flip test of the same mean. It was preferred to Wilcoxon's, which
    judges another quantity than the interval and can contradict it where differences are skewed.

    For a metric with a target (`TARGETS`) b is seen to be farther off than a if the means differ
    and their midpoint is on b's side of the target. Both must be seen, and p is the larger of the
    two: of the sign-flip test of a - b, and of the bootstrap-t test that (a + b) / 2 has the target
    as its mean. Less than that would call two estimators different that err on opposite sides.

    p values are adjusted for all rows of the table by Holm's method. Somebody is ``better`` if
    the adjusted p is at most ``1 - probability`` and the interval leaves zero out.

    Parameters
    ----------
    runs : DataFrame
        Runs of a campaign.
    metrics : str or sequence of str
        Columns of it.
    pairs : sequence of (str, str), optional
        Who is compared with whom: an estimator, or "estimator (series)" where it has several.
    baseline : str, optional
        Everyone is compared with this one. Without pairs and baseline, everyone with everyone.
    probability : float
        Of the intervals, in (0, 1); the level of the verdicts is ``1 - probability``.
    resamples : int
        Of intervals and tests; p is never below ``1 / (resamples + 1)``.
    seed : int
        Same seed, same table, in whatever order the runs are.

    Returns
    -------
    DataFrame
        Columns of `PAIRS`, a row per metric, scenario, robot and pair. Seeds where one of the two
        has no finite number, because it failed or diverged to NaN, are ``missing``. With fewer than
        `FEWEST` pairs there are differences but neither interval nor p.

    Raises
    ------
    InputError
        If a column is missing, a run is there twice, or a number makes no sense.
    UnknownNameError
        For a competitor that is not in the table.
    """
    metrics = [metrics] if isinstance(metrics, str) else list(metrics)
    check_columns(runs, [*GROUP, "seed", *metrics], "runs")
    if not 0.0 < probability < 1.0:
        raise InputError(f"probability must be in (0, 1), got {probability}")
    if resamples < 1 or seed < 0:
        raise InputError("resamples must be positive, and seed not negative")
    runs, names = _with_competitors(runs)
    chosen = _chosen(names, pairs, baseline)
    compared = [pair for metric in metrics for pair in _pairs(runs, metric, chosen)]
    inferred = _inferred(compared, probability, resamples, seed)
    adjusted = holm(np.array([p for _, p in inferred]))
    rows = [
        _row(pair, *inference, float(p), int(np.sum(~np.isnan(adjusted))), probability)
        for pair, inference, p in zip(compared, inferred, adjusted, strict=True)
    ]
    return pd.DataFrame(rows, columns=list(PAIRS)).astype(dict(PAIRS))


def _with_competitors(runs: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """The runs with a column of who competes, missing in rows without a series; and their names."""
    several = runs.groupby("estimator")["series"].transform("nunique") > 1
    names = runs["estimator"].astype("string")
    names = names.where(~several, names + " (" + runs["series"].astype("string") + ")")
    # One that never gave a series competes all the same, and has no numbers.
    never = runs.groupby("estimator")["series"].transform("count") == 0
    runs = runs.assign(competitor=names.where(runs["series"].notna() | never))
    check_distinct(
        runs[runs["competitor"].notna()], ["scenario", "robot", "competitor", "seed"], "runs"
    )
    return runs, list(runs["competitor"].dropna().unique())


def _chosen(
    names: list[str], pairs: Sequence[tuple[str, str]] | None, baseline: str | None
) -> list[tuple[str, str]]:
    if pairs is not None and baseline is not None:
        raise InputError("give pairs or a baseline, not both")
    if baseline is not None:
        chosen = [(name, baseline) for name in names if name != baseline]
    else:
        chosen = list(combinations(names, 2)) if pairs is None else [(a, b) for a, b in pairs]
    for name in [
        *dict.fromkeys(name for pair in chosen for name in pair),
        *filter(None, [baseline]),
    ]:
        if name not in names:
            raise UnknownNameError("competitor", name, names)
    if any(a == b for a, b in chosen):
        raise InputError("a competitor cannot be compared with itself")
    return chosen


def _pairs(runs: pd.DataFrame, metric: str, chosen: list[tuple[str, str]]) -> Iterator[_Pair]:
    for scenario, rows in runs.groupby("scenario", sort=False, dropna=False):
        # Rows without a robot's name are those of failures, and belong to every robot.
        robots = list(rows["robot"].dropna().unique()) or [pd.NA]
        seeds = {name: set(part["seed"]) for name, part in rows.groupby("estimator")}
        estimators = rows.dropna(subset="competitor").groupby("competitor")["estimator"].first()
        for robot in robots:
            mine = rows[(rows["robot"] == robot).fillna(True) & rows["competitor"].notna()]
            table = mine.pivot(index="seed", columns="competitor", values=metric).astype(float)
            table = table.where(np.isfinite(table))
            for a, b in chosen:
                if a not in estimators or b not in estimators:
                    continue
                both = table.reindex(columns=[a, b]).dropna()
                tried = seeds[estimators[a]] | seeds[estimators[b]]
                values = both.to_numpy()
                yield _Pair(scenario, robot, metric, a, b, values, len(tried) - len(both))


def _inferred(
    compared: list[_Pair], probability: float, resamples: int, seed: int
) -> list[tuple[float, float]]:
    """Half width and p of each comparison, NaN where there are too few pairs."""
    result = [(float("nan"), float("nan"))] * len(compared)
    sizes = np.array([len(pair.values) for pair in compared])
    for n in np.unique(sizes[sizes >= FEWEST]):
        at = np.flatnonzero(sizes == n)
        differences = np.column_stack([compared[i].differences for i in at])
        half_width, _ = mean_interval(differences, probability, resamples, seed)
        p = sign_flip_p(differences, resamples, seed)
        aimed = [k for k, i in enumerate(at) if compared[i].target is not None]
        if aimed:
            off = [compared[at[k]].values.mean(axis=1) - compared[at[k]].target for k in aimed]
            _, side = mean_interval(np.column_stack(off), probability, resamples, seed)
            # Two alike are no farther apart for lying on one side.
            p[aimed] = np.maximum(p[aimed], side)
        for i, width, value in zip(at, half_width, p, strict=True):
            result[i] = (float(width), float(value))
    return result


def _row(
    pair: _Pair,
    half_width: float,
    p: float,
    adjusted: float,
    comparisons: int,
    probability: float,
) -> dict[str, Any]:
    differences, count = pair.differences, len(pair.values)
    mean_a, mean_b = pair.values.mean(axis=0) if count else (float("nan"),) * 2
    mean = differences.mean() if count else float("nan")
    better = None
    if adjusted <= 1.0 - probability and abs(mean) > half_width:
        aim = pair.target
        off = (mean_a, mean_b) if aim is None else (abs(mean_a - aim), abs(mean_b - aim))
        better = pair.a if off[0] < off[1] else pair.b
    row = {
        "share_a_less": float(np.mean((differences < 0) + 0.5 * (differences == 0)))
        if count
        else float("nan"),
        "target": pair.target,
        "mean_a": mean_a,
        "mean_b": mean_b,
        "mean_difference": mean,
        "half_width": half_width if np.isfinite(half_width) else None,
        "probability": probability,
        "median_difference": float(np.median(differences)) if count else float("nan"),
        "p": p,
        "p_adjusted": adjusted,
        "comparisons": comparisons,
        "better": better,
    }
    row |= {"seeds": count, "missing": pair.missing}
    row |= {name: getattr(pair, name) for name in ("scenario", "robot", "metric", "a", "b")}
    return row | {"verdict": _verdict(pair, row)}


def _verdict(pair: _Pair, row: Mapping[str, Any]) -> str:
    """What the row says, in a sentence that needs no column beside it."""
    missing = f"; {pair.missing} seeds without a pair" if pair.missing else ""
    if not row["seeds"]:
        return f"no seed has a number of both on {pair.metric}{missing}"
    seeds = f"{row['seeds']} seeds{missing}"
    if row["seeds"] < FEWEST:
        return f"too few pairs to tell on {pair.metric}: {seeds}"
    if not pair.differences.any():
        return f"no difference seen on {pair.metric}: equal on every seed, {seeds}"
    width = row["half_width"]
    interval = "" if width is None else f" ± {width:.2g} ({100 * row['probability']:g} %)"
    adjusted = f"p {row['p_adjusted']:.2g} adjusted for {row['comparisons']} comparisons"
    better, mean, aim = row["better"], row["mean_difference"], pair.target
    if better is None:
        apart = aim is not None and width is not None and abs(mean) > width
        seen = f"neither seen nearer to {aim:g}" if apart else "no difference seen"
        return f"{seen} on {pair.metric}: {mean:.3g}{interval}, {seeds}, {adjusted}"
    worse = pair.b if better == pair.a else pair.a
    beats = f"{better} beats {worse} on {pair.metric}"
    if aim is not None:
        means = {pair.a: row["mean_a"], pair.b: row["mean_b"]}
        beats += f", {means[better]:.3g} against {means[worse]:.3g} and nearer to {aim:g},"
    return f"{beats} by {abs(mean):.3g}{interval}, {seeds}, {adjusted}"
