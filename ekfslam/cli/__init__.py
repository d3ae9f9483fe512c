"""The command `ekfslam`: parses, calls, prints. Heavy imports wait until they are needed."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from ekfslam.cli.animate import animate
from ekfslam.cli.campaigns import campaign, summary
from ekfslam.cli.checking import check
from ekfslam.cli.comparing import compare
from ekfslam.cli.ending import ended
from ekfslam.cli.export import export
from ekfslam.cli.lists import datasets, estimators
from ekfslam.cli.report import report
from ekfslam.cli.simulating import simulate
from ekfslam.cli.studies import study

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

[bold]Exit status[/bold]

  0 done; 1 a check failed, or with --strict an estimator; 2 a mistake in what was asked for,
  3 an error of ekfslam itself; 130 Ctrl-C, 143 terminated, 141 the reader of a pipe went away.
"""

PACKAGES = ("gtsam", "numpy", "scipy", "numba")

app = typer.Typer(
    help=HELP,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.command()(compare)
app.command()(check)
app.command()(simulate)
app.command()(datasets)
app.command()(estimators)
app.command()(campaign)
app.command()(summary)
app.command()(report)
app.command()(animate)
app.command()(export)
app.add_typer(study, name="study")


def main() -> None:
    """Run the command; a user's mistake is one line and exit status 2."""
    sys.exit(ended(lambda: app(sys.argv[1:] or ["--help"], standalone_mode=False)))


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version
        from platform import python_version

        from ekfslam import __version__

        told = [f"Python {python_version()}"]
        for package in PACKAGES:
            try:
                told.append(f"{package} {version(package)}")
            except PackageNotFoundError:
                told.append(f"{package} not installed")
        print(f"ekfslam {__version__} ({', '.join(told)})")
        raise typer.Exit


def _log(context: typer.Context, times: int) -> None:
    """Show on standard error what the library logs; given twice, with tracebacks."""
    if not times:
        return
    import logging

    shown = logging.StreamHandler()
    shown.setFormatter(logging.Formatter("%(relativeCreated)6.0f ms  %(name)s: %(message)s"))
    logger = logging.getLogger("ekfslam")
    before = logger.level
    logger.addHandler(shown)
    logger.setLevel(logging.INFO if times == 1 else logging.DEBUG)

    def quiet() -> None:
        logger.removeHandler(shown)
        logger.setLevel(before)

    context.call_on_close(quiet)  # the command may be run from Python, and more than once


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Show the versions."),
    ] = False,
    verbose: Annotated[
        int,
        typer.Option(
            "--verbose",
            "-v",
            count=True,
            callback=_log,
            show_default=False,
            help="Tell what is done; twice: with the traceback of what fails.",
        ),
    ] = 0,
) -> None:
    """Hold the options of the command itself."""
