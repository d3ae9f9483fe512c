"""What the page says of a campaign: what was run, and what the runs say, in words."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd
from scipy.special import stdtrit

from ekfslam.estimates import OK
from ekfslam.evaluation.paired import FEWEST
from ekfslam.evaluation.statistics import chi2_interval, share_interval
from ekfslam.report.comparison import Finding, Group, by_side, called
from ekfslam.report.folder import CampaignFolder
from ekfslam.report.tables import Column, Table, complete, selected
from ekfslam.report.words import (
    counted,
    digits,
    interval,
    known,
    listed,
    percent,
    plus_minus,
    seeds_in_words,
)

COLUMNS = (
    Column("runs", "runs"),
    Column("diverged_share", "diverged", percent),
    Column("run_nees_pose_mean", "NEES (3), mean"),
    Column("run_nees_pose_se", "± s.e."),
    Column("run_nees_pose_median", "NEES, median"),
    Column("run_nees_pose_invariant_mean", "invariant NEES (3), mean"),
    Column("run_nees_pose_invariant_se", "± s.e."),
    Column("final_nees_pose_mean", "last NEES (3), mean"),
    Column("final_nees_low_95", "95 % from"),
    Column("final_nees_high_95", "to"),
    Column("nis_per_dof", "NIS/dof"),
    Column("nis_per_dof_sd", "± s.d."),
    Column("ate_position_rmse_m_mean", "ATE [m], mean"),
    Column("ate_position_rmse_m_se", "± s.e."),
    Column("landmark_rmse_m_mean", "landmarks [m], mean"),
    Column("landmark_rmse_m_se", "± s.e."),
    Column("effective_samples_mean", "effective samples"),
    Column("sigma_ratio_position_median", "sigma ratio, median"),
    Column("gap_final_position_m_median", "pose gap [m], median"),
    Column("graph_chi2_per_dof", "chi2/dof"),
    Column("time_total_s", "time [s], median"),
)
PAIRED = (
    Column("mean_difference", "a − b, mean"),
    Column("half_width", "± half width"),
    Column("share_a_less", "a less in", percent),
    Column("p_adjusted", "p adjusted"),
    Column("seeds", "seeds"),
    Column("missing", "without a pair"),
)


def what_ran(results: CampaignFolder) -> list[tuple[str, list[str]]]:
    """Terms and what is said of each."""
    config = results.config
    seeds = [int(seed) for seed in config["seeds"]]
    said = (
        [(str(config["campaign"]), [str(config["description"])])]
        if config.get("description")
        else []
    )
    said.append(("seeds", [f"{len(seeds)}: {seeds_in_words(seeds)}"]))
    for scenario in config["scenarios"]:
        words = [f"scenario {scenario['name']}, hash {scenario['hash']}"]
        words += [f"{key} = {value}" for key, value in scenario["swept"].items()]
        said.append((str(scenario["label"]), words))
    few = config.get("few_seeds", {})
    for name, text in config["estimators"].items():
        words = [str(text)] + ([f"first {few[name]} seeds only"] if name in few else [])
        said.append((str(name), words))
    metrics = config["metrics"]
    judged = [f"first {metrics['skip']} steps left out of averages along a run"]
    judged.append(f"diverged: lost, or a mean NEES above {digits(metrics['diverged_above'])}")
    if metrics.get("reference"):
        judged.append(f"gaps and ratios refer to {metrics['reference']}")
    return [*said, ("how runs are judged", judged)]


def overview(results: CampaignFolder) -> list[Table]:
    """A table per scenario of the statistics, and one of the pairs."""
    keys = ["scenario", "estimator"]
    times = results.timings.groupby(keys, sort=False)["time_total_s"].median()
    summary = results.summary.merge(times.reset_index(), on=keys, how="left")
    found = []
    for number, (name, rows) in enumerate(summary.groupby("scenario", sort=False)):
        apart = [key for key in ("series", "robot") if rows[key].nunique() > 1]
        lead = ["estimator", *apart]
        found.append(selected(f"summary-{number}", str(name), rows, lead, COLUMNS))
    if len(results.pairs):
        robots = ["robot"] if results.pairs["robot"].nunique() > 1 else []
        lead = ["scenario", *robots, "metric", "a", "b", "better"]
        first = results.pairs.iloc[0]
        caption = (
            "Estimators on the same seeds; intervals of each comparison alone "
            f"({percent(first['probability'])}), p adjusted for all"
        )
        found.append(selected("pairs", caption, results.pairs, lead, PAIRED))
    odd = _odd(results.runs)
    if len(odd):
        lead = ["scenario", "estimator", "status", "seeds", "message"]
        found.append(selected("odd", "Runs whose status is not ok", odd, lead, []))
    return found


def _odd(runs: pd.DataFrame) -> pd.DataFrame:
    """Runs that are not ok, a row for each kind of them."""
    odd = runs[runs["status"] != OK].drop_duplicates(["scenario", "estimator", "seed"])
    rows = []
    for names, some in odd.groupby(["scenario", "estimator", "status"], sort=False):
        first = some.iloc[0]
        message = str(first["message"]) if known(first["message"]) else ""
        if some["message"].nunique() > 1:
            message = f"seed {first['seed']}: {message}"
        seeds = seeds_in_words([int(seed) for seed in some["seed"]])
        rows.append([*names, seeds, message])
    return pd.DataFrame(rows, columns=["scenario", "estimator", "status", "seeds", "message"])


def everything(results: CampaignFolder) -> list[Table]:
    """All columns of the statistics and of the pairs."""
    found = [complete("summary-all", "All columns of the table summary", results.summary)]
    if len(results.pairs):
        found.append(complete("pairs-all", "All columns of the table pairs", results.pairs))
    return found


# Findings ----------------------------------------------------------------------------------------


def findings(results: CampaignFolder) -> list[Group]:
    """What the tables say, scenario by scenario."""
    found = []
    for name, rows in results.summary.groupby("scenario", sort=False):
        said = [*_counts(rows), *_diverged(rows), *_run_nees(rows), *_final_nees(rows)]
        said += [*_nis(rows), *_errors(rows)]
        pairs = results.pairs[results.pairs["scenario"] == name]
        found.append(Group(str(name), [*said, *_pairs(pairs)]))
    return found


def _counts(rows: pd.DataFrame) -> Iterator[Finding]:
    few, many = int(rows["runs"].min()), int(rows["runs"].max())
    yield Finding(f"{many} runs each." if few == many else f"{few} to {many} runs each.")
    once = rows.drop_duplicates("estimator")
    for word, verb in (("failed", "raised an error"), ("skipped", "did not apply")):
        some = once[once[word] > 0]
        if len(some):
            words = [
                f"{row['estimator']} at {counted(int(row[word]), 'seed')}"
                for _, row in some.iterrows()
            ]
            yield Finding(f"Without an estimate, since it {verb}: {listed(words)}.")


def _diverged(rows: pd.DataFrame) -> Iterator[Finding]:
    rows = rows[rows["runs"] > 0]
    items, none = [], dict[int, list[str]]()
    for _, row in rows.iterrows():
        count, runs = int(row["diverged"]), int(row["runs"])
        if count:
            low, high = share_interval(count, runs)
            shares = f"{percent(count / runs)}, {percent(low)} to {percent(high)}"
            items.append(f"{called(rows, row)}: {count} of {runs} ({shares})")
        else:
            none.setdefault(runs, []).append(called(rows, row))
    for runs, names in none.items():
        most = percent(share_interval(0, runs)[1])
        items.append(f"none of {runs} (at most {most}): {listed(names)}")
    if items:
        above = digits(rows.iloc[0]["diverged_above"])
        yield Finding(
            f"Diverged, which is lost or a mean NEES above {above}, with the exact 95 % interval "
            "of the share.",
            tuple(items),
        )


def _run_nees(rows: pd.DataFrame) -> Iterator[Finding]:
    some = rows[rows["run_nees_pose_se"].notna() & (rows["nees_runs"] > 1)]
    vague = "no interval, since it would reach below 0, which no NEES does: few runs make the mean"
    sides: dict[str, list[str]] = {"above 3": [], "3 is inside": [], "below 3": [], vague: []}
    for _, row in some.iterrows():
        mean, error = row["run_nees_pose_mean"], row["run_nees_pose_se"]
        reach = float(stdtrit(int(row["nees_runs"]) - 1, 0.975)) * error
        low, high = mean - reach, mean + reach
        told = f"{called(rows, row)} {plus_minus(mean, error)}"
        if low < 0:
            sides[vague].append(told)
            continue
        side = "above 3" if low > 3 else "below 3" if high < 3 else "3 is inside"
        sides[side].append(f"{told} {interval(low, high)}")
    if len(some):
        yield Finding(
            "Mean NEES of the pose along a run, expected 3: mean over the runs ± standard error, "
            "and the 95 % interval of Student's distribution, which is rough where few runs are "
            "far out. Diverged runs count. Above 3 is overconfident.",
            tuple(f"{side}: {listed(who)}" for side, who in sides.items() if who),
        )


def _final_nees(rows: pd.DataFrame) -> Iterator[Finding]:
    some = rows[rows["final_nees_pose_mean"].notna()]
    if len(some):
        names = ["final_nees_pose_mean", "final_nees_low_95", "final_nees_high_95"]
        placed = [
            (called(rows, row), *(float(row[n]) for n in names)) for _, row in some.iterrows()
        ]
        yield Finding(
            "NEES of the last pose, mean over the runs, by the 95 % chi-square interval of as many "
            "runs of a consistent estimator.",
            by_side(placed),  # type: ignore[arg-type]
        )


def _nis(rows: pd.DataFrame) -> Iterator[Finding]:
    placed = []
    for _, row in rows[rows["nis_per_dof"].notna() & (rows["nis_dof"] > 0)].iterrows():
        dof = float(row["nis_dof"])
        low, high = (float(bound) / dof for bound in chi2_interval(dof))
        placed.append((called(rows, row), float(row["nis_per_dof"]), low, high))
    if placed:
        yield Finding(
            "NIS per degree of freedom over all runs, by the 95 % interval that holds if the "
            "stated noise is the real one and innovations are white. It does not see an "
            "overconfident pose.",
            by_side(placed, 4),
        )


def _errors(rows: pd.DataFrame) -> Iterator[Finding]:
    some = rows[rows["ate_position_rmse_m_mean"].notna()]
    items = []
    for series, part in some.groupby("series", sort=False):
        words = []
        for _, row in part.sort_values("ate_position_rmse_m_mean", kind="stable").iterrows():
            error = plus_minus(row["ate_position_rmse_m_mean"], row["ate_position_rmse_m_se"])
            words.append(f"{called(part, row)} {error} m")
        items.append(f"{series}: {listed(words)}")
    if items:
        yield Finding(
            "Position error (ATE), mean over the runs ± standard error, from the least. Who is "
            "better is told by pairs on the same seeds alone.",
            tuple(items),
        )


def _pairs(pairs: pd.DataFrame) -> Iterator[Finding]:
    """Who is seen to be better: the table judges, this repeats its sentences."""
    several = pairs["robot"].nunique() > 1
    seen = pairs[pairs["better"].notna()]
    if len(seen):
        items = [f"{row['robot']}: " * several + str(row["verdict"]) for _, row in seen.iterrows()]
        yield Finding("On the same seeds it is seen that", tuple(items))
    told = pairs["seeds"] >= FEWEST
    yield from _unseen(
        "On the same seeds nobody is seen to be better between",
        pairs[pairs["better"].isna() & told],
    )
    yield from _unseen(
        f"Fewer than {FEWEST} seeds with a number of both, too few to tell", pairs[~told]
    )


def _unseen(words: str, pairs: pd.DataFrame) -> Iterator[Finding]:
    items = []
    for metric, some in pairs.groupby("metric", sort=False):
        names = [f"{row['a']} and {row['b']}" for _, row in some.iterrows()]
        items.append(f"{metric}: {listed(dict.fromkeys(names))}")
    if items:
        yield Finding(words, tuple(items))
