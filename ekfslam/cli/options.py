"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekfslam.cli import completion

Seed = Annotated[int, typer.Option(help="Seed of simulated data.", min=0)]
Data = Annotated[
    Path | None,
    typer.Option(
        help="Where the files of recorded sets lie; by default EKFSLAM_DATA.",
        show_default=False,
        autocompletion=completion.files,
    ),
]
Workers = Annotated[int, typer.Option(help="Processes; the outcome is the same.")]
Figures = Annotated[bool, typer.Option(help="Whether to draw figures into the folder.")]
Json = Annotated[
    bool, typer.Option("--json", help="Print JSON and no tables; progress is on standard error.")
]
Csv = Annotated[bool, typer.Option("--csv", help="Print the summary as CSV and no tables.")]
