"""The commands of campaigns: run one, or show what one has found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ekfslam.cli import completion
from ekfslam.cli.options import Csv, Figures, Json, Workers
from ekfslam.cli.output import check_output, print_csv, print_json, records, tell, told_files
from ekfslam.cli.printing import print_campaign
from ekfslam.cli.progress import progress

if TYPE_CHECKING:
    from ekfslam.experiments import CampaignResults

Strict = Annotated[bool, typer.Option("--strict", help="Exit status 1 if any run has failed.")]


def campaign(
    file: Annotated[
        Path,
        typer.Argument(help="The campaign, a .toml file.", autocompletion=completion.files),
    ],
    out: Annotated[
        Path,
        typer.Option(
            help="Folder of the results; what is there is not redone.",
            autocompletion=completion.files,
        ),
    ],
    workers: Workers = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Address of a Dask cluster to run on instead.", show_default=False),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(help="How many, instead of what the file says.", show_default=False),
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Run cells again that failed before.")
    ] = False,
    figures: Figures = True,
    as_json: Json = False,
    as_csv: Csv = False,
    strict: Strict = False,
) -> None:
    """Scenarios × seeds × estimators: Parquet tables, statistics, CSVs and figures.

    Stopped at any moment it goes on where it was when it is given again; seeds and estimators that
    are added run alone.

    [bold]Examples[/bold]

      ekfslam campaign experiments/loop-15.toml --out results/loop-15 --workers 2

      ekfslam campaign mine.toml --out results/mine --seeds 10
    """
    from ekfslam.experiments import run_campaign

    check_output(as_json, as_csv)
    try:
        with progress() as watch:
            results = run_campaign(
                file,
                out,
                workers=workers,
                scheduler=scheduler,
                seeds=seeds,
                retry_failed=retry_failed,
                watch=watch,
                tell=tell,
            )
    except KeyboardInterrupt:
        tell("stopped; what was done stays, run it again to go on")
        raise
    _show("campaign", results, figures, as_json, as_csv, strict)


def _show(
    command: str,
    results: CampaignResults,
    figures: bool,
    as_json: bool,
    as_csv: bool,
    strict: bool,
) -> None:
    files = results.save(figures=figures)  # first: whoever reads the tables may close the pipe
    if as_json:
        print_json(
            command,
            cells=dict(zip(("done", "all"), results.cells, strict=True)),
            summary=records(results.summary),
            pairs=records(results.pairs),
            config=results.config,
            files=files,
        )
    elif as_csv:
        print_csv(results.summary)
        tell(told_files(files))
    else:
        print_campaign(results)
        print(told_files(files))
    if strict and (results.runs["status"] == "failed").any():
        raise typer.Exit(1)


def summary(
    folder: Annotated[
        Path, typer.Argument(help="The folder of a campaign.", autocompletion=completion.files)
    ],
    figures: Figures = True,
    as_json: Json = False,
    as_csv: Csv = False,
    strict: Strict = False,
) -> None:
    """Statistics and figures of a campaign, finished or not, from what is in its folder.

    [bold]Examples[/bold]

      ekfslam summary results/mine

      ekfslam summary results/mine --no-figures --csv > summary.csv
    """
    from ekfslam.experiments import read_campaign

    check_output(as_json, as_csv)
    _show("summary", read_campaign(folder), figures, as_json, as_csv, strict)
