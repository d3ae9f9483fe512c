"""What the command prints: tables of which every number is readable in a terminal."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table

if TYPE_CHECKING:
    import pandas as pd

    from ekfslam.experiments import AssociationStudy, CampaignResults, PartialStudy
    from ekfslam.validation import Finding, Report

WIDE = 150  # columns that a table may take


def print_large(files: Iterable[Path], asked: bool) -> None:
    """Which tables are Parquet since they are large, unless that was asked for."""
    large = [path.name for path in files if path.suffix == ".parquet"]
    if large and not asked:
        print(f"too large for CSV, so Parquet: {', '.join(large)} (--tables csv, or --every N)")


def print_list(rows: list[tuple[str, str]]) -> None:
    """Names with what they are."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for row in rows:
        table.add_row(*map(escape, row))
    _console().print(table)


def print_summary(summary: pd.DataFrame, notes: Mapping[str, Sequence[str]] | None = None) -> None:
    """Dataset by dataset, with its notes, and a column only where it says something."""
    import pandas as pd

    console = _console()
    # The position alone is judged where the whole pose cannot be.
    alone = summary["nees_position_mean"].where(summary["nees_pose_mean"].isna())
    summary = summary.assign(nees_position_mean=alone)
    groups: Any = summary.groupby(["dataset", "seed"], sort=False, dropna=False)
    for (name, seed), part in groups:
        who = ["robot"] if part["robot"].nunique() > 1 else []
        lead = ["estimator", *who, "series", "status"]
        _print(_table(part, lead, MEASURED, _title(name, seed, part)))
        for _, row in part.drop_duplicates("estimator").iterrows():
            if isinstance(row["message"], str) and row["message"]:
                console.print(escape(f"  {row['estimator']}: {row['message']}"), style="dim")
        for note in (notes or {}).get(name, ()):
            console.print(Padding(escape(note), (0, 0, 0, 2)), style="dim")
        once = part.drop_duplicates(["estimator", *who])
        # Who localizes on a map that is given decides, too, and estimates no landmark.
        told = once[["landmarks_estimated", "association_precision"]].notna().any(axis=1)
        if _associated(part) and told.any():
            once = once[told]
            once = once.assign(
                landmarks_undetermined=once["landmarks_undetermined"].replace(0, pd.NA)
            )
            lead = ["estimator", *who, "association"]
            _print(_table(once, lead, ASSOCIATED, "who was taken for whom"))
        console.print()


def print_report(report: Report) -> None:
    """The rungs of the ladder."""
    console = _console()
    table = Table(title=escape(f"ladder for {report.estimator}"), title_justify="left", box=None)
    for heading in ("", "rung", "scenario", "outcome", "measured", "bound"):
        table.add_column(heading, no_wrap=True)
    table.add_column("where")
    style = {
        "pass": "green",
        "fail": "bold red",
        "inconsistent": "yellow",
        "does not apply": "dim",
    }
    for rung in report.rungs:
        measured = "" if rung.measured != rung.measured else f"{rung.measured:.2g}"
        table.add_row(
            str(rung.number),
            rung.name,
            rung.scenario,
            f"[{style[rung.outcome]}]{rung.outcome}[/]",
            measured,
            f"{'>=' if rung.at_least else '<='} {rung.bound:g}",
            escape(rung.detail),
        )
    console.print(table)
    if report.findings:
        _print_findings(report.findings)
    if report.consistent is not None:
        print("consistent" if report.consistent else "not consistent, which is no failure")
    print("passed" if report.passed else "FAILED")


def _print_findings(findings: Sequence[Finding]) -> None:
    """What is wrong, in words, in lines that fit a narrow terminal."""
    print("\nwhat is wrong, most likely")
    for number, finding in enumerate(findings, start=1):
        lines = {f"{number}. {finding.stage}": finding.says, **finding.details}
        for indent, (heading, text) in enumerate(lines.items()):
            first = ("   " if indent else "") + f"{heading}: "
            print(textwrap.fill(text, 80, initial_indent=first, subsequent_indent=5 * " "))
    print()


def print_study(study: AssociationStudy) -> None:
    """Noise by noise, the methods below each other; then the two rivals draw by draw."""
    console = _console()
    config = study.config
    title = f"{config['scenario']}: the same {config['seeds']} draws for each method, by noise"
    shown = study.summary.assign(
        ate=[_plus_minus(*pair) for pair in _pairs(study.summary, "ate_m_mean", "ate_m_se")]
    )
    table = _table(shown, ["odometry_noise", "method"], STUDIED, title, apart="odometry_noise")
    _print(table)
    odd = study.runs[study.runs["status"].isin(["failed", "skipped"])].drop_duplicates("method")
    for _, row in odd.iterrows():
        console.print(escape(f"  {row['method']}: {row['status']}: {row['message']}"), style="dim")
    console.print()
    if len(study.paired):
        first = study.paired.iloc[0]
        rivals = f"{first['method']} minus {first['against']} on the same draws"
        names = "ate_m_difference_mean", "ate_m_difference_se"
        shown = study.paired.assign(
            ate=[_plus_minus(*pair) for pair in _pairs(study.paired, *names)]
        )
        _print(_table(shown, ["odometry_noise"], PAIRED, rivals))
        console.print()


def print_partial_study(study: PartialStudy) -> None:
    """Scenario by scenario, then the recorded sets, ways to start landmarks below each other."""
    console = _console()
    title = f"partial observations: the same {study.config['seeds']} draws for each estimator"
    shown = study.summary.assign(
        ate=[_plus_minus(*pair) for pair in _pairs(study.summary, "ate_m_mean", "ate_m_se")],
        nees=[
            _plus_minus(*pair) for pair in _pairs(study.summary, "nees_final_mean", "nees_final_se")
        ],
    )
    _print(_table(shown, ["dataset", "estimator"], STARTED, title, apart="dataset"))
    console.print()
    if len(study.recorded):
        lead = ["dataset", "estimator", "series", "status"]
        title = "recorded ranges: beacons after the path is aligned with the truth"
        _print(_table(study.recorded, lead, BEACONS, title, apart="dataset"))
        console.print()


def print_campaign(results: CampaignResults) -> None:
    """Scenario by scenario the estimators below each other, then who beats whom."""
    console = _console()
    done, cells = results.cells
    if done < cells:
        console.print(f"{done} of {cells} cells are done; this is what they say", style="bold")
    summary = results.summary
    columns: dict[str, Any] = {
        name: [_plus_minus(*pair) or None for pair in _pairs(summary, *names)]
        for name, names in SPREAD.items()
    }
    columns["interval"] = [
        f"[{low:.3g}, {high:.3g}]" if low == low else None
        for low, high in _pairs(summary, "final_nees_low_95", "final_nees_high_95")
    ]
    keys = ["scenario", "estimator"]
    times = results.timings.groupby(keys, sort=False)["time_total_s"].median()
    shown = summary.assign(**columns)
    shown = shown.merge(times.rename("seconds").reset_index(), on=keys, how="left")
    for name, part in shown.groupby("scenario", sort=False):
        apart = [key for key in ("series", "robot") if part[key].nunique() > 1]
        _print(_table(part, ["estimator", *apart], OVER_RUNS, str(name)))
        runs = results.runs[results.runs["scenario"] == name]
        without = runs[runs["status"].isin(["failed", "skipped"])]
        for estimator, rows in without.groupby("estimator", sort=False):
            first = rows.iloc[0]
            text = f"  {estimator}: {first['status']} at {len(rows)} seeds: {first['message']}"
            console.print(escape(text), style="dim")
        console.print()
        _print_pairs(console, results.pairs[results.pairs["scenario"] == name])


def _print_pairs(console: Console, pairs: pd.DataFrame) -> None:
    """Who beats whom on the same seeds, metric by metric, effect size first."""
    met = pairs[pairs["seeds"] > 0]
    if len(met):
        first = met.iloc[0]
        names = "mean_difference", "half_width"
        percent = f"a − b\nmean ± ({100 * first['probability']:g} %)"
        shown = met.assign(
            difference=[_plus_minus(*pair) for pair in _pairs(met, *names)],
            missing=met["missing"].where(met["missing"] > 0),
            seen=[row["verdict"].partition(f" on {row['metric']}")[0] for _, row in met.iterrows()],
        )
        columns = [
            *COMPARED,
            Column("seeds", "seeds", str),
            Column("missing", "without\na pair", str),
        ]
        columns.insert(1, Column("difference", percent, str))
        robots = ["robot"] if met["robot"].nunique() > 1 else []
        lead = ["metric", *robots, "a", "b", "seen"]
        many = first["comparisons"]
        title = "on the same seeds"
        title += f"; intervals of each alone, p adjusted for {many} comparisons" if many else ""
        _print(_table(shown, lead, columns, title, apart="metric"))
    strangers = pairs[pairs["seeds"] == 0].groupby(["a", "b"], sort=False)["metric"]
    for (a, b), metrics in strangers:
        text = f"  {a}, {b}: no seed has a number of both on {', '.join(metrics.unique())}"
        console.print(escape(text), style="dim", soft_wrap=True)
    if len(pairs):
        console.print()


# Columns ----------------------------------------------------------------------------------------


class Column(NamedTuple):
    """A column of a table, its heading, and how its numbers are written."""

    name: str
    heading: str
    form: Callable[[Any], str]


def _digits(value: float) -> str:
    if abs(value) < 1000 or abs(value) >= 1e6:
        return f"{value:.3g}"
    return f"{value:.0f}"


def _seconds(value: float) -> str:
    return f"{value:.3f}" if value < 100 else f"{value:.0f}"


def _share(value: float) -> str:
    return f"{value:.4f}"


def _percent(value: float) -> str:
    return f"{100 * value:.0f} %"


def _plus_minus(mean: float, error: float) -> str:
    return _digits(mean) + (f" ± {error:.2g}" if error == error else "") if mean == mean else ""


MEASURED = (
    Column("ate_position_rmse_m", "ATE\n[m]", _digits),
    Column("ate_heading_rmse_rad", "ATE\n[rad]", _digits),
    Column("rpe_position_rmse_m", "RPE\n[m]", _digits),
    Column("landmark_rmse_m", "landm.\n[m]", _digits),
    Column("nees_pose_mean", "NEES\n(3)", _digits),
    Column("nees_position_mean", "NEES\npos. (2)", _digits),
    Column("nis_per_dof", "NIS\n/dof", _digits),
    Column("effective_samples_mean", "eff.\nsamples", _digits),
    Column("graph_chi2_per_dof", "chi2\n/dof", _digits),
    Column("gap_final_position_m", "pose gap\nto batch [m]", _digits),
    Column("gap_landmark_rmse_m", "map gap\n[m]", _digits),
    Column("sigma_ratio_position", "sigma\nratio", _digits),
    Column("time_total_s", "time\n[s]", _seconds),
    Column("time_per_step_mean_us", "per step\n[us]", _digits),
)
ASSOCIATED = (
    Column("association_precision", "precision", _share),
    Column("association_recall", "recall", _share),
    Column("landmarks_estimated", "in map", str),
    Column("landmarks_undetermined", "of open\ndistance", str),
    Column("landmarks_missed", "missed", str),
    Column("landmarks_spurious", "spurious", str),
    Column("landmarks_duplicate", "duplicate", str),
    Column("landmarks_merged", "merged", str),
)
STUDIED = (
    Column("precision_mean", "precision", _share),
    Column("recall_mean", "recall", _share),
    Column("ate", "ATE [m]\nmean ± s.e.", str),
    Column("ate_m_median", "ATE [m]\nmedian", _digits),
    Column("nees_mean", "NEES (3)\nmean", _digits),
    Column("nees_median", "NEES (3)\nmedian", _digits),
    Column("share_diverged", "diverged", _percent),
)
PAIRED = (
    Column("ate", "ATE [m]\nmean ± s.e.", str),
    Column("share_better", "less in", _percent),
    Column("runs", "draws", str),
)
SPREAD = {
    "nees": ("run_nees_pose_mean", "run_nees_pose_se"),
    "invariant": ("run_nees_pose_invariant_mean", "run_nees_pose_invariant_se"),
    "nis": ("nis_per_dof", "nis_per_dof_sd"),
    "ate": ("ate_position_rmse_m_mean", "ate_position_rmse_m_se"),
    "samples": ("effective_samples_mean", "effective_samples_se"),
}
OVER_RUNS = (
    Column("runs", "runs", str),
    Column("diverged_share", "diverged", _percent),
    Column("nees", "NEES (3)\nmean ± s.e.", str),
    Column("run_nees_pose_median", "NEES (3)\nmedian", _digits),
    Column("invariant", "inv. NEES (3)\nmean ± s.e.", str),
    Column("final_nees_pose_mean", "final\nNEES (3)", _digits),
    Column("interval", "95 % of it, if\nconsistent", str),
    Column("nis", "NIS/dof\n± s.d.", str),
    Column("ate", "ATE [m]\nmean ± s.e.", str),
    Column("samples", "eff. samples\nmean ± s.e.", str),
    Column("sigma_ratio_position_median", "sigma ratio\nmedian", _digits),
    Column("gap_final_position_m_median", "pose gap [m]\nmedian", _digits),
    Column("graph_chi2_per_dof", "chi2\n/dof", _digits),
    Column("seconds", "time [s]\nmedian", _seconds),
)
COMPARED = (
    Column("share_a_less", "a less\nin", _percent),
    Column("p_adjusted", "p\nadjusted", lambda p: f"{p:.2g}"),
)
HEADINGS = {"odometry_noise": "noise"}


STARTED = (
    Column("share_diverged", "diverged", _percent),
    Column("nees", "final NEES (3)\nmean ± s.e.", str),
    Column("nees_final_median", "median", _digits),
    Column("ate", "ATE [m]\nmean ± s.e.", str),
    Column("landmark_m_mean", "landm.\n[m]", _digits),
    Column("landmarks_mean", "landm.\nfound", _digits),
)

BEACONS = (
    Column("ate_position_rmse_m", "ATE\n[m]", _digits),
    Column("aligned_landmark_rmse_m", "beacons\nrms [m]", _digits),
    Column("aligned_landmark_max_m", "largest\n[m]", _digits),
    Column("nees_pose_mean", "NEES\n(3)", _digits),
    Column("nis_per_dof", "NIS\n/dof", _digits),
)


def _associated(part: pd.DataFrame) -> bool:
    """Whether it says something who was taken for whom."""
    if (part["association"].dropna() != "known").any():
        return True
    counts = ("undetermined", "missed", "spurious", "duplicate", "merged")
    wrong = any((part[f"landmarks_{count}"].fillna(0) > 0).any() for count in counts)
    return wrong or bool((part["association_precision"] < 1).any())


def _title(name: str, seed: Any, part: pd.DataFrame) -> str:
    first = part.iloc[0]
    of_robots = part[part["estimator"] == first["estimator"]].drop_duplicates("robot")
    poses, true = first["steps"] * len(of_robots), of_robots["truth_poses"].sum()
    title = f"{name}, seed {seed}" if _known(seed) else name
    title += f": {first['steps']} poses, {of_robots['observations'].sum()} observations"
    there = first["landmarks_true"]
    title += f", {there} landmarks" if _known(there) else ""
    return title + (f", true positions of {true} of {poses} poses" if 0 < true < poses else "")


# Tables -----------------------------------------------------------------------------------------


def _table(
    rows: pd.DataFrame,
    lead: list[str],
    columns: Iterable[Column],
    title: str,
    apart: str | None = None,
) -> Table:
    """Some columns of text or keys, and those of the numbers that are known in any row.

    Rows of different values of the column `apart` are kept apart.
    """
    table = Table(title=escape(title), title_justify="left", title_style="bold", box=None)
    for name in lead:
        table.add_column(escape(HEADINGS.get(name, name)), no_wrap=True)
    shown = [column for column in columns if rows[column.name].notna().any()]
    for column in shown:
        table.add_column(escape(column.heading), justify="right", no_wrap=True)
    before = None
    for _, row in rows.iterrows():
        if apart is not None and before is not None and row[apart] != before:
            table.add_row()
        before = None if apart is None else row[apart]
        words = [escape(_word(row[name])) for name in lead]
        table.add_row(*words, *(_text(row[c.name], c.form) for c in shown))
    return table


def _pairs(rows: pd.DataFrame, *names: str) -> Iterable[tuple[float, ...]]:
    return rows[list(names)].itertuples(index=False)


def _known(value: Any) -> bool:
    import pandas as pd

    return not pd.isna(value)


def _word(value: Any) -> str:
    if isinstance(value, float):
        return "" if value != value else f"{value:g}"
    return str(value) if _known(value) else ""


def _text(value: Any, form: Callable[[Any], str]) -> str:
    return form(value) if _known(value) else ""


def _console(needed: int = 0) -> Console:
    # Never cut a number off: a table that is wider than the terminal is for it to wrap.
    width = max(WIDE, get_terminal_size().columns) if sys.stdout.isatty() else WIDE
    return Console(width=max(width, needed))


def _print(table: Table) -> None:
    """Print a table as wide as it is: long names of estimators cost no number."""
    console = _console()
    endless = console.options.update(width=10_000)
    _console(Measurement.get(console, endless, table).maximum).print(table)
