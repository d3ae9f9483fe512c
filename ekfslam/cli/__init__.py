"""The command `ekfslam`: parses, calls, prints. Heavy imports wait until they are needed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from ekfslam.cli.campaigns import campaign, summary
from ekfslam.cli.printing import (
    print_large,
    print_list,
    print_partial_study,
    print_report,
    print_study,
    print_summary,
)
from ekfslam.cli.progress import progress
from ekfslam.cli.report import report

HELP = """Compare hand-written EKF-SLAM with GTSAM smoothers of the same landmark graph.

[bold]Examples[/bold]

  ekfslam compare                               [dim]park and Victoria Park[/dim]

  ekfslam compare cloister --out results/mine   [dim]tables, CSVs, figures[/dim]

  ekfslam compare park --estimators ekf,mymodule:MyFilter

  ekfslam compare park --withhold-ids --estimators "ekf(association=joint)"

  ekfslam check ekf                             [dim]right to round-off?[/dim]

  ekfslam simulate loop-15 --seed 7 --out run.npz

  ekfslam compare run.npz                       [dim]a dataset from a file[/dim]

  ekfslam datasets                              [dim]what is there to run on[/dim]

  ekfslam compare lego mrclam1/robot3 --data recorded

  ekfslam study association                     [dim]who tells trees apart in noise[/dim]

  ekfslam campaign my.toml --out results/mine   [dim]many seeds; goes on if stopped[/dim]
"""

app = typer.Typer(
    help=HELP,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

study = typer.Typer(
    help="Experiments with many seeds: tables with Monte-Carlo errors, and a figure.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)
app.add_typer(study, name="study")

Seed = Annotated[int, typer.Option(help="Seed of simulated data.", min=0)]


def main() -> None:
    """Run the command; a user's mistake is one line and exit status 2."""
    from ekfslam.errors import EkfslamError

    try:
        status = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except EkfslamError as error:
        _refuse(str(error))
    except MemoryError as error:
        _refuse(f"not enough memory: {error}")
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
    except Exception as error:
        if not hasattr(error, "format_message"):  # what the parser itself refuses has one
            raise
        _refuse(f"{error.format_message()} (ekfslam --help)")
    sys.exit(status or 0)


def _refuse(message: str) -> NoReturn:
    print(f"ekfslam: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


def _version(wanted: bool) -> None:
    if wanted:
        from ekfslam import __version__

        print(f"ekfslam {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Hold the options of the command itself."""


@app.command()
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


@app.command()
def check(
    estimator: Annotated[str, typer.Argument(help="A name, or module:Class.")],
    seed: Seed = 1,
) -> None:
    """Climb the ladder of tests that a right estimator passes; exit status 1 if a rung fails.

    The last rungs ask whether a filter is consistent. The standard EKF is not: no failure.

    [bold]Examples[/bold]

      ekfslam check ekf

      ekfslam check mymodule:MyFilter
    """
    from ekfslam.validation import check as climb

    report = climb(estimator, seed=seed)
    print_report(report)
    raise typer.Exit(0 if report.passed else 1)


@app.command()
def simulate(
    scenario: Annotated[str, typer.Argument(help="A name, or a .toml file.")],
    out: Annotated[Path, typer.Option(help="File (.npz), or a new folder for tables (CSV).")],
    seed: Seed = 0,
    noise: Annotated[float, typer.Option(help="Scale of all noise, stated and drawn.")] = 1.0,
    odometry_noise: Annotated[
        float, typer.Option(help="Scale of the odometry noise alone, stated and drawn.")
    ] = 1.0,
    g2o: Annotated[
        Path | None,
        typer.Option(help="Write it as a g2o graph, too.", show_default=False),
    ] = None,
) -> None:
    """Draw a dataset from a scenario into one file, or into a folder of CSV files.

    [bold]Example[/bold]

      ekfslam simulate park --seed 7 --out park-7.npz
      ekfslam simulate park --seed 7 --out park-7
      ekfslam simulate "city(world.count=5000, path.steps=10000)" --out city.npz
    """
    from ekfslam.datasets.table_files import write_tables
    from ekfslam.errors import InputError
    from ekfslam.experiments.sources import open_scenario
    from ekfslam.export import write_g2o
    from ekfslam.simulation import simulate as draw

    if out.suffix not in (".npz", ""):
        raise InputError(f"{out}: a dataset file ends in .npz, a folder of tables has no ending")
    for path in filter(None, (out, g2o)):
        if not path.parent.is_dir():
            raise InputError(f"cannot write {path}: there is no folder {path.parent}")
    drawn = open_scenario(scenario)
    dataset = draw(drawn, seed=seed, noise=noise, odometry_noise=odometry_noise)
    written = [str(out)]
    if g2o is not None:  # first: it can be refused for what the dataset holds
        write_g2o(dataset, g2o)
        written.append(str(g2o))
    if out.suffix:
        dataset.save(out)
    else:
        write_tables(dataset, out)
    print(
        f"{dataset.name}: {dataset.poses} poses, {len(dataset.observations)} observations "
        f"-> {', '.join(written)}"
    )


@app.command()
def datasets(
    name: Annotated[
        str | None,
        typer.Argument(help="Of a recorded set: tell all about it.", show_default=False),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(help="Where the files of recorded sets lie.", show_default=False),
    ] = None,
) -> None:
    """What there is to run on, and for recorded sets whether their files are here.

    Files are looked for in the folder of --data or of the environment variable EKFSLAM_DATA.

    [bold]Examples[/bold]

      ekfslam datasets

      ekfslam datasets mrclam1 --data recorded
    """
    from ekfslam.datasets import RECORDED, of_name
    from ekfslam.simulation import describe_scenario, scenarios

    if name is not None:
        recorded, _ = of_name(name)
        whole = name.partition("/")[0]
        print_list(recorded.told(whole, recorded.given(whole, data)))
        return
    rows = [(each, describe_scenario(each)) for each in scenarios()]
    for each, recorded in RECORDED.items():
        here = recorded.is_here(each, recorded.given(each, data))
        missing = "" if here else f" [not here: ekfslam datasets {each}]"
        rows.append((each, f"{recorded.description}{missing}"))
    print_list(rows)


@app.command()
def estimators() -> None:
    """What there is to compare; packages join by the entry-point group `ekfslam.estimators`."""
    from ekfslam import registry

    rows = []
    for name, point in registry.registered().items():
        try:
            doc = (point.load().__doc__ or "").strip().partition("\n")[0]
        except Exception as error:
            doc = f"cannot be loaded: {error}"
        joined = registry.origin(name)
        rows.append((name, f"{doc} ({point.value}{f' of {joined}' if joined else ''})"))
    print_list(rows)


app.command()(campaign)
app.command()(summary)
app.command()(report)
