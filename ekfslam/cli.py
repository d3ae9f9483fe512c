"""The command `ekfslam`: parses, calls, prints. Heavy imports wait until they are needed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pandas as pd

    from ekfslam.validation import Report

HELP = """Compare hand-written EKF-SLAM with GTSAM smoothers of the same landmark graph.

[bold]Examples[/bold]

  ekfslam compare                               [dim]park and Victoria Park[/dim]

  ekfslam compare cloister --out results/mine   [dim]tables, CSVs, figures[/dim]

  ekfslam compare park --estimators ekf,mymodule:MyFilter

  ekfslam check ekf                             [dim]right to round-off?[/dim]

  ekfslam simulate loop-15 --seed 7 --out run.npz

  ekfslam compare run.npz                       [dim]a dataset from a file[/dim]
"""

app = typer.Typer(
    help=HELP,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

WIDE = 150  # columns that a table may take

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
        str, typer.Option(help="Names or module:Class, separated by commas.")
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
    figures: Annotated[bool, typer.Option(help="Whether to draw figures into --out.")] = True,
) -> None:
    """Estimators side by side on the same datasets: tables, CSVs and figures.

    Without arguments: the simulated park and the recorded Victoria Park.

    [bold]Example[/bold]

      ekfslam compare cloister victoria-park --seed 1 --out results/compare
    """
    from ekfslam.experiments.compare import DATASETS, check_folder
    from ekfslam.experiments.compare import compare as run

    if out is not None:
        check_folder(out)
    with _progress() as watch:
        comparison = run(
            datasets or list(DATASETS),
            [name.strip() for name in estimators.split(",") if name.strip()],
            seed=seed,
            alignment=align,
            rpe_distance=rpe_distance,
            path=data,
            watch=watch,
        )
    _print_summary(comparison.summary)
    if out is not None:
        files = comparison.save(out, figures=figures)
        print(f"{len(files)} files in {out}: {', '.join(path.name for path in files)}")


@app.command()
def check(
    estimator: Annotated[str, typer.Argument(help="A name, or module:Class.")],
    seed: Seed = 1,
) -> None:
    """Climb the ladder of tests that a right estimator passes; exit status 1 if a rung fails.

    [bold]Examples[/bold]

      ekfslam check ekf

      ekfslam check mymodule:MyFilter
    """
    from ekfslam.validation import check as climb

    report = climb(estimator, seed=seed)
    _print_report(report)
    raise typer.Exit(0 if report.passed else 1)


@app.command()
def simulate(
    scenario: Annotated[str, typer.Argument(help="A name, or a .toml file.")],
    out: Annotated[Path, typer.Option(help="File to write (.npz).")],
    seed: Seed = 0,
    noise: Annotated[float, typer.Option(help="Scale of all noise, stated and drawn.")] = 1.0,
    g2o: Annotated[
        Path | None,
        typer.Option(help="Write it as a g2o graph, too.", show_default=False),
    ] = None,
) -> None:
    """Draw a dataset from a scenario into one file.

    [bold]Example[/bold]

      ekfslam simulate park --seed 7 --out park-7.npz
    """
    from ekfslam.errors import InputError
    from ekfslam.export import write_g2o
    from ekfslam.simulation import simulate as draw

    if out.suffix != ".npz":
        raise InputError(f"{out}: a dataset file ends in .npz")
    for path in filter(None, (out, g2o)):
        if not path.parent.is_dir():
            raise InputError(f"cannot write {path}: there is no folder {path.parent}")
    dataset = draw(scenario, seed=seed, noise=noise)
    written = [str(out)]
    if g2o is not None:  # first: it can be refused for what the dataset holds
        write_g2o(dataset, g2o)
        written.append(str(g2o))
    dataset.save(out)
    print(
        f"{dataset.name}: {dataset.poses} poses, {len(dataset.observations)} observations "
        f"-> {', '.join(written)}"
    )


@app.command()
def datasets() -> None:
    """What there is to run on."""
    from ekfslam.datasets import RECORDED
    from ekfslam.simulation import load_scenario, scenarios

    rows = [(name, load_scenario(name).describe()) for name in scenarios()]
    rows += [(name, recorded.description) for name, recorded in RECORDED.items()]
    _print_list(rows)


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
        rows.append((name, f"{doc} ({point.value})"))
    _print_list(rows)


# Printing ---------------------------------------------------------------------------------------


def _console() -> Any:
    from shutil import get_terminal_size

    from rich.console import Console

    # Never cut a number off: a table that is wider than the terminal is for it to wrap.
    width = max(WIDE, get_terminal_size().columns) if sys.stdout.isatty() else WIDE
    return Console(width=width)


def _print_list(rows: list[tuple[str, str]]) -> None:
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for row in rows:
        table.add_row(*map(escape, row))
    _console().print(table)


Format = Callable[[float], str]


def _digits(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def _seconds(value: float) -> str:
    return f"{value:.3f}" if value < 100 else f"{value:.0f}"


SHOWN: tuple[tuple[str, str, Format], ...] = (
    ("ate_position_rmse_m", "ATE\n[m]", _digits),
    ("ate_heading_rmse_rad", "ATE\n[rad]", _digits),
    ("rpe_position_rmse_m", "RPE\n[m]", _digits),
    ("landmark_rmse_m", "landm.\n[m]", _digits),
    ("nees_pose_mean", "NEES\n(3)", _digits),
    ("nis_per_dof", "NIS\n/dof", _digits),
    ("graph_chi2_per_dof", "chi2\n/dof", _digits),
    ("gap_final_position_m", "pose gap\nto batch [m]", _digits),
    ("gap_landmark_rmse_m", "map gap\n[m]", _digits),
    ("sigma_ratio_position", "sigma\nratio", _digits),
    ("time_total_s", "time\n[s]", _seconds),
    ("time_per_step_median_us", "per step\n[us]", _digits),
)


def _print_summary(summary: pd.DataFrame) -> None:
    """Dataset by dataset, and a column only where it says something."""
    import pandas as pd
    from rich.markup import escape
    from rich.table import Table

    console = _console()
    groups: Any = summary.groupby(["dataset", "seed"], sort=False, dropna=False)
    for (name, seed), part in groups:
        first = part.iloc[0]
        title = f"{name}" + ("" if pd.isna(seed) else f", seed {seed}")
        title += f": {first['steps']} poses, {first['observations']} observations"
        title += (
            f", {first['landmarks_true']} landmarks" if pd.notna(first["landmarks_true"]) else ""
        )
        table = Table(title=escape(title), title_justify="left", title_style="bold", box=None)
        table.add_column("estimator", no_wrap=True)
        table.add_column("series", no_wrap=True)
        table.add_column("status", no_wrap=True)
        columns = [entry for entry in SHOWN if part[entry[0]].notna().any()]
        for _, heading, _ in columns:
            table.add_column(escape(heading), justify="right", no_wrap=True)
        for _, row in part.iterrows():
            cells = [_text(row[c], form) for c, _, form in columns]
            series = row["series"] if isinstance(row["series"], str) else ""
            table.add_row(escape(row["estimator"]), series, row["status"], *cells)
        console.print(table)
        for _, row in part.drop_duplicates("estimator").iterrows():
            if isinstance(row["message"], str) and row["message"]:
                console.print(escape(f"  {row['estimator']}: {row['message']}"), style="dim")
        console.print()


def _text(value: Any, form: Format) -> str:
    return "" if value != value else form(value)


def _print_report(report: Report) -> None:
    from rich.markup import escape
    from rich.table import Table

    console = _console()
    table = Table(title=escape(f"ladder for {report.estimator}"), title_justify="left", box=None)
    for heading in ("", "rung", "scenario", "outcome", "measured", "bound"):
        table.add_column(heading, no_wrap=True)
    table.add_column("where")
    style = {"pass": "green", "fail": "bold red", "does not apply": "dim"}
    for rung in report.rungs:
        measured = "" if rung.measured != rung.measured else f"{rung.measured:.2g}"
        table.add_row(
            str(rung.number),
            rung.name,
            rung.scenario,
            f"[{style[rung.outcome]}]{rung.outcome}[/]",
            measured,
            f"{'>=' if rung.at_least else '<='} {rung.bound:g}",
            escape(rung.detail),
        )
    console.print(table)
    print("passed" if report.passed else "FAILED")


@contextmanager
def _progress() -> Iterator[Callable[[str, str, int, int], None]]:
    """A progress bar on standard error, gone when the work is done."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    ) as bar:
        task = bar.add_task("", total=None)

        def watch(dataset: str, estimator: str, done: int, total: int) -> None:
            bar.update(task, description=f"{dataset}: {estimator}", completed=done, total=total)

        yield watch


if __name__ == "__main__":
    main()
