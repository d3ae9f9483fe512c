"""The command `check`: the ladder."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from ekfslam.cli import completion
from ekfslam.cli.options import Json, Seed
from ekfslam.cli.output import print_json, records
from ekfslam.cli.printing import print_report


def check(
    estimator: Annotated[
        str,
        typer.Argument(help="A name, or module:Class.", autocompletion=completion.estimators),
    ],
    seed: Seed = 1,
    as_json: Json = False,
) -> None:
    """Climb the ladder of tests that a right estimator passes; exit status 1 if a rung fails.

    The last rungs ask whether a filter is consistent. The standard EKF is not: no failure.

    [bold]Examples[/bold]

      ekfslam check ekf

      ekfslam check mymodule:MyFilter

      ekfslam check mymodule:MyFilter --json > check.json
    """
    from ekfslam.validation import check as climb

    report = climb(estimator, seed=seed)
    if as_json:
        print_json(
            "check",
            estimator=report.estimator,
            passed=report.passed,
            consistent=report.consistent,
            rungs=records(report.table.assign(at_least=[rung.at_least for rung in report.rungs])),
            findings=[asdict(finding) for finding in report.findings],
        )
    else:
        print_report(report)
    raise typer.Exit(0 if report.passed else 1)
