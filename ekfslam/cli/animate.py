"""The command `animate`: a run as a film."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekfslam.cli import completion
from ekfslam.cli.options import Data, Seed
from ekfslam.cli.output import tell
from ekfslam.cli.progress import progress


def animate(
    dataset: Annotated[
        str,
        typer.Argument(
            help="A scenario, a recorded set, or a file of a dataset.",
            autocompletion=completion.datasets,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            help="The film: .gif, or .mp4, which needs ffmpeg.", autocompletion=completion.files
        ),
    ],
    estimators: Annotated[
        str,
        typer.Option(
            help="Separated by commas. Measurements are drawn from the pose of the first.",
            autocompletion=completion.estimators,
        ),
    ] = "ekf",
    seed: Seed = 0,
    data: Data = None,
    every: Annotated[
        int | None,
        typer.Option(help="A picture every so many steps.", show_default=False, min=1),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(help="Length of the film instead; 10 by default.", show_default=False),
    ] = None,
    fps: Annotated[int, typer.Option(help="Pictures a second.")] = 12,
    width: Annotated[int, typer.Option(help="In pixels.")] = 800,
) -> None:
    """A film of a run: truth, paths, ellipses and measurements as they come.

    A picture shows what the estimators say of the run as far as its step, smoothers too: each runs
    once for every picture, on half of the data on average. Fewer pictures take less time.

    [bold]Examples[/bold]

      ekfslam animate cloister --out cloister.gif

      ekfslam animate park --estimators ekf,gtsam-batch --seconds 5 --out park.mp4

      ekfslam animate run.npz --estimators mymodule:MyFilter --every 10 --fps 20 --out run.gif
    """
    from ekfslam.experiments.film import animate as film
    from ekfslam.registry import split

    with progress() as watch:
        path = film(
            dataset,
            split(estimators),
            out,
            seed=seed,
            data=data,
            every=every,
            seconds=seconds,
            fps=fps,
            width=width,
            watch=watch,
            tell=tell,
        )
    print(f"{path}: {path.stat().st_size / 1e6:.2g} MB")
