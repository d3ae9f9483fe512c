"""What the command tells people: results as tables, with what there is to say of them."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from ekfslam.cli.columns import (
    ASSOCIATED,
    BEACONS,
    COMPARED,
    MEASURED,
    OVER_RUNS,
    PAIRED,
    SPREAD,
    STARTED,
    STUDIED,
    Column,
    plus_minus,
)
from ekfslam.cli.tables import WIDE, console, known, needed, print_table, terminal_width

if TYPE_CHECKING:
    import pandas as pd

    from ekfslam.experiments import AssociationStudy, CampaignResults, PartialStudy
    from ekfslam.validation import Finding, Report
    from ekfslam.validation.ladder import Rung


def large(files: Iterable[Path]) -> str:
    """Which tables are Parquet."""
    return ", ".join(path.name for path in files if path.suffix == ".parquet")


def print_list(rows: list[tuple[str, str]]) -> None:
    """Names with what they are: in a pipe each on one line."""
    if terminal_width() is None:
        widest = max(len(name) for name, _ in rows)
        for name, what in rows:
            print(f"{name:<{widest}}  {what}")
        return
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for row in rows:
        table.add_row(*map(escape, row))
    console().print(table)


def print_summary(summary: pd.DataFrame, notes: Mapping[str, Sequence[str]] | None = None) -> None:
    """Dataset by dataset, with its notes, and a column only where it says something."""
    import pandas as pd

    out = console()
    # The position alone is judged where the whole pose cannot be.
    alone = summary["nees_position_mean"].where(summary["nees_pose_mean"].isna())
    summary = summary.assign(nees_position_mean=alone)
    groups: Any = summary.groupby(["dataset", "seed"], sort=False, dropna=False)
    for (name, seed), part in groups:
        who = ["robot"] if part["robot"].nunique() > 1 else []
        lead = ["estimator", *who, "series", "status"]
        print_table(part, lead, MEASURED, _title(name, seed, part))
        for _, row in part.drop_duplicates("estimator").iterrows():
            if isinstance(row["message"], str) and row["message"]:
                told = escape(f"  {row['estimator']}: {row['message']}")
                out.print(told, style="dim", soft_wrap=True)
        for note in (notes or {}).get(name, ()):
            out.print(Padding(escape(note), (0, 0, 0, 2)), style="dim")
        once = part.drop_duplicates(["estimator", *who])
        # Who localizes on a map that is given decides, too, and estimates no landmark.
        told = once[["landmarks_estimated", "association_precision"]].notna().any(axis=1)
        if _associated(part) and told.any():
            once = once[told]
            once = once.assign(
                landmarks_undetermined=once["landmarks_undetermined"].replace(0, pd.NA)
            )
            lead = ["estimator", *who, "association"]
            print_table(once, lead, ASSOCIATED, "who was taken for whom")
        out.print()


STYLES = {"pass": "green", "fail": "bold red", "inconsistent": "yellow", "does not apply": "dim"}


def print_report(report: Report) -> None:
    """The rungs of the ladder, and what is wrong; details below them in a narrow terminal."""
    narrow = (terminal_width() or WIDE) < WIDE
    table = Table(title=escape(f"ladder for {report.estimator}"), title_justify="left", box=None)
    for heading in ("", "rung", "scenario", "outcome", "measured", "bound"):
        table.add_column(heading, no_wrap=not (narrow and heading == "rung"))
    if not narrow:
        table.add_column("where")
    rungs = _said_once(report.rungs)
    for rung in rungs:
        measured = "" if rung.measured != rung.measured else f"{rung.measured:.2g}"
        table.add_row(
            str(rung.number),
            rung.name,
            rung.scenario,
            f"[{STYLES[rung.outcome]}]{rung.outcome}[/]",
            measured,
            f"{'>=' if rung.at_least else '<='} {rung.bound:g}",
            *(() if narrow else (escape(rung.detail),)),
        )
    console(terminal_width() or needed(table)).print(table)
    if narrow:
        console().print()
    for rung in rungs if narrow else ():
        if rung.detail:
            text = f"{rung.number} {rung.scenario}: {rung.detail}"
            print(textwrap.fill(text, terminal_width() or WIDE, subsequent_indent="  "))
    if report.findings:
        _print_findings(report.findings)
    if report.consistent:
        print("consistent")
    elif any(rung.outcome == "inconsistent" for rung in report.rungs):
        print("not consistent, which is no failure")
    print("passed" if report.passed else "FAILED")


def _said_once(rungs: Sequence[Rung]) -> list[Rung]:
    """The rungs, with what a filter raised written out the first time alone."""
    said: set[str] = set()
    shown = []
    for rung in rungs:
        again = rung.detail in said and rung.detail.startswith("raised ")
        shown.append(replace(rung, detail="raised the same") if again else rung)
        said.add(rung.detail)
    return shown


def _print_findings(findings: Sequence[Finding]) -> None:
    """What is wrong, in words, in lines that fit a narrow terminal."""
    print("\nwhat is wrong, most likely")
    for number, finding in enumerate(findings, start=1):
        lines = {f"{number}. {finding.stage}": finding.says, **finding.details}
        for indent, (heading, text) in enumerate(lines.items()):
            first = ("   " if indent else "") + f"{heading}: "
            print(
                textwrap.fill(
                    text,
                    80,
                    initial_indent=first,
                    subsequent_indent=5 * " ",
                    break_on_hyphens=False,
                )
            )
    print()


def print_study(study: AssociationStudy) -> None:
    """Noise by noise, the methods below each other; then the two rivals draw by draw."""
    out = console()
    config = study.config
    title = f"{config['scenario']}: the same {config['seeds']} draws for each method, by noise"
    shown = study.summary.assign(
        ate=[plus_minus(*pair) for pair in _pairs(study.summary, "ate_m_mean", "ate_m_se")]
    )
    print_table(shown, ["odometry_noise", "method"], STUDIED, title, apart="odometry_noise")
    odd = study.runs[study.runs["status"].isin(["failed", "skipped"])].drop_duplicates("method")
    for _, row in odd.iterrows():
        out.print(escape(f"  {row['method']}: {row['status']}: {row['message']}"), style="dim")
    out.print()
    if len(study.paired):
        first = study.paired.iloc[0]
        rivals = f"{first['method']} minus {first['against']} on the same draws"
        names = "ate_m_difference_mean", "ate_m_difference_se"
        shown = study.paired.assign(
            ate=[plus_minus(*pair) for pair in _pairs(study.paired, *names)]
        )
        print_table(shown, ["odometry_noise"], PAIRED, rivals)
        out.print()


def print_partial_study(study: PartialStudy) -> None:
    """Scenario by scenario, then the recorded sets, ways to start landmarks below each other."""
    out = console()
    title = f"partial observations: the same {study.config['seeds']} draws for each estimator"
    shown = study.summary.assign(
        ate=[plus_minus(*pair) for pair in _pairs(study.summary, "ate_m_mean", "ate_m_se")],
        nees=[
            plus_minus(*pair) for pair in _pairs(study.summary, "nees_final_mean", "nees_final_se")
        ],
    )
    print_table(shown, ["dataset", "estimator"], STARTED, title, apart="dataset")
    out.print()
    if len(study.recorded):
        lead = ["dataset", "estimator", "series", "status"]
        title = "recorded ranges: beacons after the path is aligned with the truth"
        print_table(study.recorded, lead, BEACONS, title, apart="dataset")
        out.print()


def print_campaign(results: CampaignResults) -> None:
    """Scenario by scenario the estimators below each other, then who beats whom."""
    out = console()
    done, cells = results.cells
    if done < cells:
        out.print(f"{done} of {cells} cells are done; this is what they say", style="bold")
    summary = results.summary
    columns: dict[str, Any] = {
        name: [plus_minus(*pair) or None for pair in _pairs(summary, *names)]
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
        print_table(part, ["estimator", *apart], OVER_RUNS, str(name))
        runs = results.runs[results.runs["scenario"] == name]
        without = runs[runs["status"].isin(["failed", "skipped"])]
        for estimator, rows in without.groupby("estimator", sort=False):
            first = rows.iloc[0]
            text = f"  {estimator}: {first['status']} at {len(rows)} seeds: {first['message']}"
            out.print(escape(text), style="dim")
        out.print()
        _print_pairs(out, results.pairs[results.pairs["scenario"] == name])


def _print_pairs(out: Console, pairs: pd.DataFrame) -> None:
    """Who beats whom on the same seeds, metric by metric, effect size first."""
    met = pairs[pairs["seeds"] > 0]
    if len(met):
        first = met.iloc[0]
        names = "mean_difference", "half_width"
        percent = f"a − b\nmean ± ({100 * first['probability']:g} %)"
        shown = met.assign(
            difference=[plus_minus(*pair) for pair in _pairs(met, *names)],
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
        print_table(shown, lead, columns, title, apart="metric")
    strangers = pairs[pairs["seeds"] == 0].groupby(["a", "b"], sort=False)["metric"]
    for (a, b), metrics in strangers:
        text = f"  {a}, {b}: no seed has a number of both on {', '.join(metrics.unique())}"
        out.print(escape(text), style="dim", soft_wrap=True)
    if len(pairs):
        out.print()


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
    title = f"{name}, seed {seed}" if known(seed) else name
    title += f": {first['steps']} poses, {of_robots['observations'].sum()} observations"
    there = first["landmarks_true"]
    title += f", {there} landmarks" if known(there) else ""
    return title + (f", true positions of {true} of {poses} poses" if 0 < true < poses else "")


def _pairs(rows: pd.DataFrame, *names: str) -> Iterable[tuple[float, ...]]:
    return rows[list(names)].itertuples(index=False)
