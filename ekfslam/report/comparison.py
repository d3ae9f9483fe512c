"""What the page says of a comparison: who ran on what, and what was found, in words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import pandas as pd

from ekfslam.estimates import OK
from ekfslam.evaluation.statistics import chi2_interval
from ekfslam.experiments.compare import REFERENCE
from ekfslam.report.folder import ComparisonFolder
from ekfslam.report.tables import Column, Table, complete, selected
from ekfslam.report.words import digits, interval, known, listed, rounded

COLUMNS = (
    Column("ate_position_rmse_m", "ATE [m]"),
    Column("ate_heading_rmse_rad", "ATE [rad]"),
    Column("rpe_position_rmse_m", "RPE [m]"),
    Column("landmark_rmse_m", "landmarks [m]"),
    Column("nees_pose_mean", "NEES (3)"),
    Column("nees_position_mean", "NEES of position (2)"),
    Column("nis_per_dof", "NIS/dof"),
    Column("effective_samples_mean", "effective samples"),
    Column("graph_chi2_per_dof", "chi2/dof"),
    Column("gap_final_position_m", "pose gap to batch [m]"),
    Column("gap_landmark_rmse_m", "map gap to batch [m]"),
    Column("sigma_ratio_position", "sigma ratio to batch"),
    Column("association_precision", "precision"),
    Column("association_recall", "recall"),
    Column("time_total_s", "time [s]"),
    Column("time_per_step_mean_us", "per step [µs]"),
)


class Finding(NamedTuple):
    """A sentence, and what stands in a list below it."""

    text: str
    items: tuple[str, ...] = ()


class Group(NamedTuple):
    """Findings of one dataset or scenario."""

    title: str
    findings: list[Finding]


class Run(NamedTuple):
    """The rows of a dataset, with the title of what they are of."""

    title: str
    rows: pd.DataFrame
    robots: bool  # whether several

    def who(self, row: Any) -> str:
        """What a row is called in a sentence."""
        return called(self.rows, row)


def called(rows: pd.DataFrame, row: Any) -> str:
    """An estimator, with series and robot where it has several of them."""
    own = rows[rows["estimator"] == row["estimator"]]
    words = [str(row[n]) for n in ("series", "robot") if own[n].nunique() > 1 and known(row[n])]
    return f"{row['estimator']} ({', '.join(words)})" if words else str(row["estimator"])


def runs_of(table: pd.DataFrame) -> Iterator[Run]:
    """The rows of each dataset and seed of a table, in order."""
    groups: Any = table.groupby(["dataset", "seed"], sort=False, dropna=False)
    for (name, seed), rows in groups:
        title = f"{name}, seed {seed}" if known(seed) else str(name)
        yield Run(title, rows, rows["robot"].nunique() > 1)


# What ran ----------------------------------------------------------------------------------------


def what_ran(results: ComparisonFolder) -> list[tuple[str, list[str]]]:
    """Terms and what is said of each: datasets, then estimators with their options."""
    said = [(run.title, _of_dataset(run, results)) for run in runs_of(results.summary)]
    for name, options in results.config["estimators"].items():
        words = [f"{key}={value}" for key, value in dict(options or {}).items()]
        said.append((str(name), [f"options: {', '.join(words)}" if words else "no options"]))
    return said


def _of_dataset(run: Run, results: ComparisonFolder) -> list[str]:
    first = run.rows.iloc[0]
    robots = run.rows[run.rows["estimator"] == first["estimator"]].drop_duplicates("robot")
    size = f"{first['steps']} poses, {robots['observations'].sum()} observations"
    if run.robots:
        size = f"{len(robots)} robots of {size}"
    if known(first["landmarks_true"]):
        size += f", {first['landmarks_true']} true landmarks seen"
    about = results.config["datasets"].get(first["dataset"], {})
    notes = [str(note) for note in about.get("notes", ())]
    return [size, *filter(None, [str(about.get("provenance", ""))]), *notes]


def overview(results: ComparisonFolder) -> list[Table]:
    """A table per dataset, of what is read most."""
    found = []
    for number, run in enumerate(runs_of(results.summary)):
        lead = ["estimator", *(["robot"] if run.robots else []), "series", "status"]
        last = ["message"] if run.rows["message"].notna().any() else []
        # The position alone is judged where the whole pose cannot be.
        alone = run.rows["nees_position_mean"].where(run.rows["nees_pose_mean"].isna())
        rows = run.rows.assign(nees_position_mean=alone)
        found.append(selected(f"summary-{number}", run.title, rows, lead, COLUMNS, last))
    return found


def everything(results: ComparisonFolder) -> list[Table]:
    """All columns of the summary."""
    return [complete("summary-all", "All columns of the table summary", results.summary)]


# Findings ----------------------------------------------------------------------------------------


def findings(results: ComparisonFolder) -> list[Group]:
    """What the tables say, dataset by dataset."""
    found = []
    for run in runs_of(results.summary):
        said = [*_statuses(run), *_errors(run), *_nees(run), *_sums(run, results)]
        found.append(Group(run.title, [*said, *_association(run), *_gaps(run)]))
    return found


def _statuses(run: Run) -> Iterator[Finding]:
    once = run.rows.drop_duplicates("estimator")
    odd = once[once["status"] != OK]
    if not len(odd):
        yield Finding(f"All estimators finished with the status ok: {listed(once['estimator'])}.")
    for _, row in odd.iterrows():
        message = f": {row['message']}" if known(row["message"]) else ""
        yield Finding(f"{row['estimator']} is {row['status']}{message}.")


def _errors(run: Run) -> Iterator[Finding]:
    judged = run.rows[run.rows["ate_position_rmse_m"].notna()]
    if not len(judged):
        yield Finding("No position has both an estimate and a truth, so that no error can be told.")
        return
    items = []
    for series, rows in judged.groupby("series", sort=False):
        ordered = rows.sort_values("ate_position_rmse_m", kind="stable")
        words = [
            f"{_name(run, row)} {digits(row['ate_position_rmse_m'])} m"
            for _, row in ordered.iterrows()
        ]
        items.append(f"{series}: {listed(words)}")
    yield Finding(
        "Root mean square position error (ATE), from the least. One run: the order may be another "
        "on the next, and a campaign tells how surely.",
        tuple(items),
    )


def _name(run: Run, row: Any) -> str:
    words = [str(row["robot"])] if run.robots else []
    words += [str(row["status"])] if row["status"] != OK else []
    return f"{row['estimator']} ({', '.join(words)})" if words else str(row["estimator"])


def _nees(run: Run) -> Iterator[Finding]:
    last = run.rows[run.rows["nees_pose_final"].notna()]
    if len(last):
        low, high = (float(bound) for bound in chi2_interval(3.0))
        placed = [(run.who(row), row["nees_pose_final"], low, high) for _, row in last.iterrows()]
        text = "NEES of the last pose, a single sample, by the 95 % interval of a consistent one."
        yield Finding(text, by_side(placed))
    for column, what, expected in (
        ("nees_pose_mean", "pose", 3),
        ("nees_position_mean", "position", 2),
    ):
        rows = run.rows[run.rows[column].notna()]
        if what == "position":  # alone where the whole pose cannot be judged
            rows = rows[rows["nees_pose_mean"].isna()]
        if len(rows):
            words = [f"{run.who(row)} {digits(row[column])}" for _, row in rows.iterrows()]
            yield Finding(
                f"Mean NEES of the {what} along the run, expected {expected}: {listed(words)}. "
                "A run is worth almost one sample: these have no interval and are no verdict."
            )


def _sums(run: Run, results: ComparisonFolder) -> Iterator[Finding]:
    """What adds up over independent terms, and so has a narrow interval."""
    rows = [row for _, row in run.rows.iterrows()]
    nis = [(row, _nis_dof(row, results)) for row in rows if known(row["nis_per_dof"])]
    yield from _against_one(run, nis, "nis_per_dof", "NIS per degree of freedom")
    graphs = [
        (row, 2.0 * row["graph_error"] / row["graph_chi2_per_dof"])
        for row in rows
        if known(row["graph_chi2_per_dof"]) and row["graph_chi2_per_dof"] > 0
    ]
    yield from _against_one(run, graphs, "graph_chi2_per_dof", "Residual of the graph, chi2/dof")


def _nis_dof(row: Any, results: ComparisonFolder) -> float:
    """Degrees of freedom of all innovations; NaN if not all of them are kept."""
    steps = results.trajectories
    if results.every > 1 or not len(steps):
        return float("nan")
    own = steps["nis"].notna()
    for key in ("dataset", "robot", "estimator", "series"):
        own &= (steps[key] == row[key]).fillna(False).astype(bool)
    return float(steps["nis_dof"][own].sum())


def _against_one(
    run: Run, rows: list[tuple[Any, float]], column: str, what: str
) -> Iterator[Finding]:
    judged = [(row, dof) for row, dof in rows if dof > 0]
    if judged:
        placed = [
            (run.who(row), row[column], *(float(bound) / dof for bound in chi2_interval(dof)))
            for row, dof in judged
        ]
        yield Finding(
            f"{what}, by the 95 % interval that holds if the stated noise is the real one.",
            by_side(placed, 4),
        )
    elif rows:
        words = [f"{run.who(row)} {digits(row[column])}" for row, _ in rows]
        yield Finding(
            f"{what}, expected 1: {listed(words)}. Without the table of all steps there is no "
            "interval."
        )


def _association(run: Run) -> Iterator[Finding]:
    rows = run.rows.drop_duplicates(["estimator", "robot"])
    decided = rows["association"].notna() & (rows["association"] != "known")
    for _, row in rows[decided & rows["association_precision"].notna()].iterrows():
        words = [f"precision {row['association_precision']:.4f}"]
        if known(row["association_recall"]):
            words.append(f"recall {row['association_recall']:.4f}")
        how = row["association"]
        yield Finding(f"{_name(run, row)} decided itself who was seen ({how}): {listed(words)}.")


def _gaps(run: Run) -> Iterator[Finding]:
    rows = run.rows[run.rows["gap_final_position_m"].notna()]
    items = []
    for _, row in rows[rows["estimator"] != REFERENCE].iterrows():
        words = [f"its last position is {digits(row['gap_final_position_m'])} m away"]
        if known(row["gap_landmark_rmse_m"]):
            words.append(f"its landmarks {digits(row['gap_landmark_rmse_m'])} m (rms)")
        if known(row["sigma_ratio_position"]):
            ratio = digits(row["sigma_ratio_position"])
            words.append(f"its sigma of the last position is {ratio} times that of {REFERENCE}")
        items.append(f"{run.who(row)}: {listed(words)}")
    if items:
        yield Finding(f"Against {REFERENCE} on the same data, which needs no truth.", tuple(items))


def by_side(placed: Iterable[tuple[str, float, float, float]], figures: int = 3) -> tuple[str, ...]:
    """Who lies inside an interval, who above and who below.

    Parameters
    ----------
    placed : iterable of (name, value, low, high)
    figures : int
        Significant ones.
    """
    placed = list(placed)
    intervals = {interval(low, high, figures) for _, _, low, high in placed}
    sides: dict[str, list[str]] = {"inside": [], "above": [], "below": []}
    for name, value, low, high in placed:
        side = "above" if value > high else "below" if value < low else "inside"
        own = f" {interval(low, high, figures)}" if len(intervals) > 1 else ""
        sides[side].append(f"{name} {rounded(value, figures)}{own}")
    shared = f" {intervals.pop()}" if len(intervals) == 1 else ""
    return tuple(f"{side}{shared}: {listed(who)}" for side, who in sides.items() if who)
