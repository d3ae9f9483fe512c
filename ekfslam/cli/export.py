"""The command `export`: runs for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekfslam.cli import completion
from ekfslam.cli.options import Data, Seed
from ekfslam.cli.output import tell
from ekfslam.cli.progress import progress


def export(
    dataset: Annotated[
        str,
        typer.Argument(
            help="A scenario, a recorded set, or a file of a dataset.",
            autocompletion=completion.datasets,
        ),
    ],
    tum: Annotated[
        Path | None,
        typer.Option(
            help="Folder for trajectories as TUM text, which evo reads.",
            show_default=False,
            autocompletion=completion.files,
        ),
    ] = None,
    g2o: Annotated[
        Path | None,
        typer.Option(
            help="File for the dataset as a g2o graph.",
            show_default=False,
            autocompletion=completion.files,
        ),
    ] = None,
    rerun: Annotated[
        Path | None,
        typer.Option(
            help=r'File (.rrd) for the viewer Rerun; needs pip install "ekfslam\[rerun]".',
            show_default=False,
            autocompletion=completion.files,
        ),
    ] = None,
    estimators: Annotated[
        str,
        typer.Option(help="Separated by commas.", autocompletion=completion.estimators),
    ] = "ekf",
    seed: Seed = 0,
    data: Data = None,
    every: Annotated[
        int | None,
        typer.Option(
            help="For Rerun: a moment every so many steps; 100 moments by default.",
            show_default=False,
            min=1,
        ),
    ] = None,
) -> None:
    """A run and what estimators say of it, in formats that other programs read.

    For Rerun each estimator runs once for every moment, on the run up to it.

    [bold]Examples[/bold]

      ekfslam export park --seed 1 --estimators ekf,gtsam-batch --tum trajectories

      evo_ape tum trajectories/park-truth.tum trajectories/park-ekf-online.tum

      ekfslam export run.npz --g2o run.g2o

      ekfslam export park --estimators ekf,gtsam-batch --rerun park.rrd
    """
    from ekfslam.experiments.exports import export as write
    from ekfslam.registry import split

    with progress() as watch:
        written = write(
            dataset,
            split(estimators),
            tum,
            g2o,
            rerun,
            every,
            seed=seed,
            data=data,
            watch=watch,
            tell=tell,
        )
    for path in written:
        print(path)
