"""The commands below `study`: experiments with many seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekfslam.cli import completion
from ekfslam.cli.options import Data, Workers
from ekfslam.cli.output import tell, told_files
from ekfslam.cli.printing import print_partial_study, print_study, print_summary
from ekfslam.cli.progress import progress

HELP = """Experiments with many seeds: tables with Monte-Carlo errors, and a figure.

[bold]Examples[/bold]

  ekfslam study association --seeds 50 --workers 2 --out results/mine

  ekfslam study recorded --data recorded
"""

study = typer.Typer(
    help=HELP,
    no_args_is_help=True,
    rich_markup_mode="rich",
)


@study.command()
def association(
    scenario: Annotated[
        str,
        typer.Option(help="A name, or a .toml file.", autocompletion=completion.scenarios),
    ] = "orchard",
    methods: Annotated[
        str | None,
        typer.Option(help="Separated by commas; all but one by default.", show_default=False),
    ] = None,
    scales: Annotated[
        str, typer.Option(help="Scales of the odometry noise, separated by commas.")
    ] = "1,2,3,4,6",
    seeds: Annotated[int, typer.Option(help="Number of draws at each scale.")] = 10,
    confirm: Annotated[int, typer.Option(help="Sightings that make a landmark.")] = 3,
    within: Annotated[int, typer.Option(help="Steps that they must fall into.")] = 8,
    workers: Workers = 1,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for CSVs, configuration and figure.", autocompletion=completion.files
        ),
    ] = Path("results/study-association"),
) -> None:
    """Methods of association on the same draws of a world with clutter, at increasing noise.

    [bold]Examples[/bold]

      ekfslam study association

      ekfslam study association --methods joint,nearest --seeds 50 --scales 3,4,5 --out results/mine
    """
    from ekfslam.errors import InputError
    from ekfslam.experiments import association_study
    from ekfslam.experiments.association import METHODS
    from ekfslam.experiments.attempts import Stopped
    from ekfslam.experiments.files import check_folder
    from ekfslam.registry import split

    check_folder(out, "study association")
    try:
        factors = [float(word) for word in split(scales)]
    except ValueError:
        raise InputError(f"--scales are numbers separated by commas, got {scales!r}") from None
    stopped = None
    try:
        with progress() as watch:
            found = association_study(
                scenario,
                METHODS if methods is None else split(methods),
                factors,
                seeds=seeds,
                confirm=confirm,
                within=within,
                workers=workers,
                watch=watch,
            )
    except Stopped as stop:
        found, stopped = stop.found, stop
        tell(f"stopped: {stop.done} of {stop.total} draws are finished, and told of")
    print_study(found)
    if stopped and (out / "config.json").exists():
        tell(f"{out} holds earlier results, and is left as it was")
    else:
        print(told_files(found.save(out)))
    if stopped:
        raise stopped


@study.command()
def partial(
    seeds: Annotated[int, typer.Option(help="Number of draws of each scenario.")] = 50,
    workers: Workers = 1,
    out: Annotated[
        Path,
        typer.Option(help="Folder for CSVs and configuration.", autocompletion=completion.files),
    ] = Path("results/study-partial"),
) -> None:
    """Ways to start a landmark from bearings and from ranges, in a cloister and on two plazas.

    [bold]Examples[/bold]

      ekfslam study partial --workers 2
    """
    from ekfslam.experiments import partial_study
    from ekfslam.experiments.files import check_folder

    check_folder(out, "study partial")
    try:
        with progress() as watch:
            found = partial_study(seeds, workers=workers, watch=watch)
    except KeyboardInterrupt:
        tell("stopped; nothing is written before all is done")
        raise
    print_partial_study(found)
    print(told_files(found.save(out)))


@study.command()
def recorded(
    datasets: Annotated[
        list[str] | None,
        typer.Argument(
            help="Some of the sets; all that are here by default.",
            show_default=False,
            autocompletion=completion.recorded,
        ),
    ] = None,
    estimators: Annotated[
        str | None,
        typer.Option(
            help="Separated by commas; all by default.",
            show_default=False,
            autocompletion=completion.estimators,
        ),
    ] = None,
    data: Data = None,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for CSVs, configuration and figures.", autocompletion=completion.files
        ),
    ] = Path("results/recorded"),
    workers: Workers = 1,
) -> None:
    """All estimators on all recorded sets; what cannot apply is a row that says why.

    [bold]Examples[/bold]

      ekfslam study recorded --data recorded

      ekfslam study recorded lego car-park --estimators ekf-localization,ekf --out results/mine
    """
    from ekfslam.experiments.recorded import ESTIMATORS, recorded_study
    from ekfslam.registry import split

    names = ESTIMATORS if estimators is None else split(estimators)
    try:
        with progress() as watch:
            found = recorded_study(out, datasets, names, path=data, workers=workers, watch=watch)
    except KeyboardInterrupt:
        tell(f"stopped; the tables of sets that were finished are in {out}")
        raise
    print_summary(found.summary, found.notes)
    for name, why in found.missing.items():
        print(f"not here: {name} ({why})")
    print(f"tables and figures in {out}")
