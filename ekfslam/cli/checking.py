"""The command `check`: the ladder."""

from __future__ import annotations

from typing import Annotated

import typer

from ekfslam.cli.options import Seed
from ekfslam.cli.printing import print_report


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
