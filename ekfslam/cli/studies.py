"""The commands below `study`: experiments with many seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekfslam.cli.printing import print_partial_study, print_study, print_summary
from ekfslam.cli.progress import progress

study = typer.Typer(
    help="Experiments with many seeds: tables with Monte-Carlo errors, and a figure.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)


@study.callback()
def _studies() -> None:
    """Experiments with many seeds: tables with Monte-Carlo errors, and a figure."""


@study.command()
def association(
    scenario: Annotated[str, typer.Option(help="A name, or a .toml file.")] = "orchard",
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
    workers: Annotated[int, typer.Option(help="Processes; the outcome is the same.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder for CSVs, configuration and figure.")] = Path(
        "results/study-association"
    ),
) -> None:
    """Methods of association on the same draws of a world with clutter, at increasing noise.

    [bold]Examples[/bold]

      ekfslam study association

      ekfslam study association --methods joint,nearest --seeds 50 --scales 3,4,5 --out results/mine
    """
    from ekfslam.errors import InputError
    from ekfslam.experiments import association_study
    from ekfslam.experiments.association import METHODS
    from ekfslam.experiments.files import check_folder
    from ekfslam.registry import split

    check_folder(out)
    try:
        factors = [float(word) for word in split(scales)]
    except ValueError:
        raise InputError(f"--scales are numbers separated by commas, got {scales!r}") from None
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
    print_study(found)
    files = found.save(out)
    print(f"{len(files)} files in {out}: {', '.join(path.name for path in files)}")


@study.command()
def partial(
    seeds: Annotated[int, typer.Option(help="Number of draws of each scenario.")] = 50,
    workers: Annotated[int, typer.Option(help="Processes; the outcome is the same.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder for CSVs and configuration.")] = Path(
        "results/study-partial"
    ),
) -> None:
    """Ways to start a landmark from bearings and from ranges, in a cloister and on two plazas.

    [bold]Example[/bold]

      ekfslam study partial --workers 2
    """
    from ekfslam.experiments import partial_study
    from ekfslam.experiments.files import check_folder

    check_folder(out)
    with progress() as watch:
        found = partial_study(seeds, workers=workers, watch=watch)
    print_partial_study(found)
    files = found.save(out)
    print(f"{len(files)} files in {out}: {', '.join(path.name for path in files)}")


@study.command()
def recorded(
    datasets: Annotated[
        list[str] | None,
        typer.Argument(help="Some of the sets; all that are here by default.", show_default=False),
    ] = None,
    estimators: Annotated[
        str | None,
        typer.Option(help="Separated by commas; all by default.", show_default=False),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of the recorded sets.", show_default=False),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for CSVs, configuration and figures.")] = Path(
        "results/recorded"
    ),
    workers: Annotated[int, typer.Option(help="Processes; the outcome is the same.")] = 1,
) -> None:
    """All estimators on all recorded sets; what cannot apply is a row that says why.

    [bold]Examples[/bold]

      ekfslam study recorded --data recorded

      ekfslam study recorded lego car-park --estimators ekf-localization,ekf --out results/mine
    """
    from ekfslam.experiments.recorded import ESTIMATORS, recorded_study
    from ekfslam.registry import split

    names = ESTIMATORS if estimators is None else split(estimators)
    with progress() as watch:
        found = recorded_study(out, datasets, names, path=data, workers=workers, watch=watch)
    print_summary(found.summary, found.notes)
    for name, why in found.missing.items():
        print(f"not here: {name} ({why})")
    print(f"tables and figures in {out}")
