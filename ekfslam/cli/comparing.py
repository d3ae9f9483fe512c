"""The command `compare`: estimators side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ekfslam.cli import completion
from ekfslam.cli.options import Csv, Data, Json, Seed
from ekfslam.cli.output import check_output, print_csv, print_json, records, tell, told_files
from ekfslam.cli.printing import large, print_summary
from ekfslam.cli.progress import progress

if TYPE_CHECKING:
    from ekfslam.experiments import Comparison

BAD = ("failed", "diverged")
Strict = Annotated[
    bool, typer.Option("--strict", help="Exit status 1 if any row is failed or diverged.")
]


def compare(
    datasets: Annotated[
        list[str] | None,
        typer.Argument(
            help="Scenarios, recorded sets, files of datasets.",
            show_default=False,
            autocompletion=completion.datasets,
        ),
    ] = None,
    estimators: Annotated[
        str,
        typer.Option(
            help="Names or module:Class, options in brackets, separated by commas.",
            autocompletion=completion.estimators,
        ),
    ] = "ekf,gtsam-batch,gtsam-isam2,dead-reckoning",
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for CSVs, configuration and figures.",
            show_default=False,
            autocompletion=completion.files,
        ),
    ] = None,
    align: Annotated[
        str,
        typer.Option(
            help="none, or se2: align position and heading before errors.",
            autocompletion=completion.alignments,
        ),
    ] = "none",
    rpe_distance: Annotated[float, typer.Option(help=r"Length of relative errors \[m].")] = 10.0,
    data: Data = None,
    match_radius: Annotated[
        float,
        typer.Option(help=r"How far from a true landmark one is held against it \[m]."),
    ] = 1.0,
    withhold_ids: Annotated[
        bool,
        typer.Option("--withhold-ids", help="Withhold from the estimators who was seen."),
    ] = False,
    figures: Annotated[bool, typer.Option(help="Whether to draw figures into --out.")] = True,
    tables: Annotated[
        str,
        typer.Option(
            help="csv, parquet, or auto: Parquet for more than 200,000 rows.",
            autocompletion=completion.forms,
        ),
    ] = "auto",
    every: Annotated[
        int, typer.Option(help="Of tables with rows for each step, write every so many.", min=1)
    ] = 1,
    as_json: Json = False,
    as_csv: Csv = False,
    strict: Strict = False,
) -> None:
    """Estimators side by side on the same datasets: tables, CSVs and figures.

    Without arguments: the simulated park and the recorded Victoria Park.
    An estimator that fails is a row. Ctrl-C keeps what is finished.

    [bold]Examples[/bold]

      ekfslam compare cloister victoria-park --seed 1 --out results/compare

      ekfslam compare orchard --estimators "ekf, ekf(association=joint, confirm=3)"

      ekfslam compare park --tables parquet --every 10 --out results/park

      ekfslam compare park --json | jq '.summary[].ate_position_rmse_m'

      ekfslam compare "city(world.count=1000)" --estimators "ekf-compressed, gtsam-isam2"
    """
    from ekfslam.experiments.attempts import Stopped
    from ekfslam.experiments.compare import DATASETS
    from ekfslam.experiments.compare import compare as run
    from ekfslam.experiments.files import COMPARISON, check_folder, check_form
    from ekfslam.registry import split

    check_output(as_json, as_csv)
    check_form(tables, every)
    if out is not None:
        check_folder(out, COMPARISON)
    stopped = None
    try:
        with progress() as watch:
            comparison = run(
                datasets or list(DATASETS),
                split(estimators),
                seed=seed,
                alignment=align,
                rpe_distance=rpe_distance,
                path=data,
                watch=watch,
                match_radius=match_radius,
                withhold_ids=withhold_ids,
            )
    except Stopped as stop:
        comparison, stopped = stop.found, stop
        tell(f"stopped: {stop.done} of {stop.total} estimates are finished, and told of")
    files: list[Path] = []
    try:  # files first: whoever reads the tables may close the pipe
        if out is not None and stopped and (out / "config.json").exists():
            tell(f"{out} holds earlier results, and is left as it was")
        elif out is not None:
            drawn = figures and not stopped
            with progress() as watch:
                files = comparison.save(out, figures=drawn, form=tables, every=every, watch=watch)
    finally:
        _show(comparison, as_json, as_csv, files)
    if files and not as_json:
        say = tell if as_csv else print
        say(told_files(files))
        if large(files) and tables == "auto":
            say(f"too large for CSV, so Parquet: {large(files)} (--tables csv, or --every N)")
    if stopped:
        raise stopped
    if strict and comparison.summary["status"].isin(BAD).any():
        raise typer.Exit(1)


def _show(comparison: Comparison, as_json: bool, as_csv: bool, files: list[Path]) -> None:
    notes = {name: dataset.notes for name, dataset in comparison.datasets.items()}
    if as_json:
        rows = records(comparison.summary)
        config = comparison.config
        print_json("compare", summary=rows, notes=notes, config=config, files=files)
    elif as_csv:
        print_csv(comparison.summary)
    else:
        print_summary(comparison.summary, notes)
