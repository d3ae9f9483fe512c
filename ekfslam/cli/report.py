"""The command of the report: a folder of results as one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekfslam.cli import completion


def report(
    results: Annotated[
        Path,
        typer.Argument(
            help="Folder of a comparison or a campaign.", autocompletion=completion.files
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The page; report.html in the folder by default.",
            show_default=False,
            autocompletion=completion.files,
        ),
    ] = None,
) -> None:
    """One HTML page of a comparison or campaign: findings, maps, tables, figures, configuration.

    It holds everything itself, loads nothing and opens from disk. Only the folder is read.

    [bold]Examples[/bold]

      ekfslam report results/compare

      ekfslam report results/loop-15 --out loop-15.html
    """
    from ekfslam.report import write_report

    path = write_report(results, out)
    print(f"{path}: {path.stat().st_size / 1e6:.2g} MB")
