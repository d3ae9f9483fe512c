"""The command `ekfslam`: parses, calls, prints. Heavy imports wait until they are needed."""

from __future__ import annotations

import sys
from typing import Annotated, NoReturn

import typer

from ekfslam.cli.campaigns import campaign, summary
from ekfslam.cli.checking import check
from ekfslam.cli.comparing import compare
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
"""

app = typer.Typer(
    help=HELP,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for command in (compare, check, simulate, datasets, estimators, campaign, summary, report):
    app.command()(command)
app.add_typer(study, name="study")


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
