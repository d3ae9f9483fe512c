"""The commands of campaigns: run one, or show what one has found."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ekfslam.cli.printing import print_campaign
from ekfslam.cli.progress import progress

if TYPE_CHECKING:
    from ekfslam.experiments import CampaignResults

Figures = Annotated[bool, typer.Option(help="Whether to draw figures, too.")]


def campaign(
    file: Annotated[Path, typer.Argument(help="The campaign, a .toml file.")],
    out: Annotated[Path, typer.Option(help="Folder of the results; what is there is not redone.")],
    workers: Annotated[int, typer.Option(help="Processes; the results are the same.")] = 1,
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
) -> None:
    """Scenarios × seeds × estimators: Parquet tables, statistics, CSVs and figures.

    Stopped at any moment it goes on where it was when it is given again; seeds and estimators that
    are added run alone.

    [bold]Examples[/bold]

      ekfslam campaign experiments/loop-15.toml --out results/loop-15 --workers 2

      ekfslam campaign mine.toml --out results/mine --seeds 10
    """
    from ekfslam.experiments import run_campaign

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
                tell=_tell,
            )
    except KeyboardInterrupt:
        _tell("stopped; what was done stays, run it again to go on")
        raise
    _show(results, out, figures)


def _show(results: CampaignResults, folder: Path, figures: bool) -> None:
    files = results.save(figures=figures)  # first: whoever reads the tables may close the pipe
    print_campaign(results)
    print(f"{len(files)} files in {folder}: {', '.join(path.name for path in files)}")


def _tell(words: str) -> None:
    print(words, file=sys.stderr)


def summary(
    folder: Annotated[Path, typer.Argument(help="The folder of a campaign.")],
    figures: Figures = True,
) -> None:
    """Statistics and figures of a campaign, finished or not, from what is in its folder.

    [bold]Example[/bold]

      ekfslam summary results/loop-15
    """
    from ekfslam.experiments import read_campaign

    results = read_campaign(folder)
    _show(results, folder, figures)
