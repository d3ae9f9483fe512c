"""The command `compare`: estimators side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekfslam.cli.options import Seed
from ekfslam.cli.printing import print_large, print_summary
from ekfslam.cli.progress import progress


def compare(
    datasets: Annotated[
        list[str] | None,
        typer.Argument(help="Scenarios, recorded sets, .npz or .toml files.", show_default=False),
    ] = None,
    estimators: Annotated[
        str,
        typer.Option(help="Names or module:Class, options in brackets, separated by commas."),
    ] = "ekf,gtsam-batch,gtsam-isam2,dead-reckoning",
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for CSVs, configuration and figures.", show_default=False),
    ] = None,
    align: Annotated[
        str, typer.Option(help="none, or se2: align position and heading before errors.")
    ] = "none",
    rpe_distance: Annotated[float, typer.Option(help=r"Length of relative errors \[m].")] = 10.0,
    data: Annotated[
        Path | None,
        typer.Option(help="Where the files of a recorded set lie.", show_default=False),
    ] = None,
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
        typer.Option(help="csv, parquet, or auto: Parquet for more than 200,000 rows."),
    ] = "auto",
    every: Annotated[
        int, typer.Option(help="Of tables with rows for each step, write every so many.", min=1)
    ] = 1,
) -> None:
    """Estimators side by side on the same datasets: tables, CSVs and figures.

    Without arguments: the simulated park and the recorded Victoria Park.

    [bold]Examples[/bold]

      ekfslam compare cloister victoria-park --seed 1 --out results/compare

      ekfslam compare orchard --estimators "ekf, ekf(association=joint, confirm=3)"

      ekfslam compare park --tables parquet --every 10 --out results/park
      ekfslam compare "city(world.count=1000)" --estimators "ekf-compressed, gtsam-isam2"
    """
    from ekfslam.experiments.compare import DATASETS
    from ekfslam.experiments.compare import compare as run
    from ekfslam.experiments.files import check_folder, check_form
    from ekfslam.registry import split

    check_form(tables, every)
    if out is not None:
        check_folder(out)
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
    notes = {name: dataset.notes for name, dataset in comparison.datasets.items()}
    print_summary(comparison.summary, notes)
    if out is not None:
        with progress() as watch:
            files = comparison.save(out, figures=figures, form=tables, every=every, watch=watch)
        print(f"{len(files)} files in {out}: {', '.join(path.name for path in files)}")
        print_large(files, asked=tables != "auto")
