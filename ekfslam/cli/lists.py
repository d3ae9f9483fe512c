"""The commands that list what there is: datasets and estimators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekfslam.cli.printing import print_list


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
