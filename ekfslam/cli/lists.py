"""The commands that list what there is: datasets and estimators."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ekfslam.cli import completion
from ekfslam.cli.docstrings import options_of, summary
from ekfslam.cli.options import Data, Json
from ekfslam.cli.output import print_json
from ekfslam.cli.printing import print_list


def datasets(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Of a recorded set: tell all about it.",
            show_default=False,
            autocompletion=completion.recorded,
        ),
    ] = None,
    data: Data = None,
    as_json: Json = False,
) -> None:
    """What there is to run on, and for recorded sets whether their files are here.

    Files are looked for in the folder of --data or of the environment variable EKFSLAM_DATA.

    [bold]Examples[/bold]

      ekfslam datasets

      ekfslam datasets mrclam1 --data recorded

      ekfslam datasets --json | jq -r '.datasets[] | select(.here) | .name'
    """
    if name is not None:
        _about(name, data, as_json)
        return
    listed = [*_scenarios(), *_recorded(data)]
    if as_json:
        print_json("datasets", datasets=listed)
        return
    rows = []
    for each in listed:
        missing = "" if each["here"] else f" [not here: {each['missing']}]"
        rows.append((each["name"], f"{each['description']}{missing}"))
    print_list(rows)


def _about(name: str, data: Any, as_json: bool) -> None:
    """All about a recorded set."""
    from ekfslam.datasets import of_name

    recorded, _ = of_name(name)
    whole = name.partition("/")[0]
    path = recorded.given(whole, data)
    told = recorded.told(whole, path)
    if as_json:
        about = {heading.replace(" ", "_"): text for heading, text in told}
        here = recorded.is_here(name, path)
        print_json("datasets", name=name, is_here=here, parts=recorded.parts, about=about)
    else:
        print_list(told)


def _scenarios() -> list[dict[str, Any]]:
    from ekfslam.simulation import describe_scenario, scenarios

    rows = []
    for name in scenarios():
        description, absent, why = describe_scenario(name).partition(" [not here: ")
        row = {"name": name, "kind": "scenario", "description": description, "here": not absent}
        rows.append(row | {"missing": why.removesuffix("]")})
    return rows


def _recorded(data: Any) -> list[dict[str, Any]]:
    from ekfslam.datasets import RECORDED

    rows = []
    for name, recorded in RECORDED.items():
        here = recorded.is_here(name, recorded.given(name, data))
        row = {"name": name, "kind": "recorded", "description": recorded.description, "here": here}
        rows.append(row | {"missing": "" if here else f"ekfslam datasets {name}"})
    return rows


def estimators(
    name: Annotated[
        str | None,
        typer.Argument(
            help="One, or module:attribute: tell its options.",
            show_default=False,
            autocompletion=completion.estimators,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """What there is to compare; packages join by the entry-point group `ekfslam.estimators`.

    [bold]Examples[/bold]

      ekfslam estimators

      ekfslam estimators gtsam-batch

      ekfslam compare park --estimators "ekf, ekf-ri, gtsam-batch(initial=ekf-ri)"

      ekfslam estimators --json
    """
    from ekfslam import registry

    if name is not None:
        _options(name, as_json)
        return
    listed = []
    for name, point in registry.registered().items():
        try:
            doc, error = summary(point.load()), ""
        except Exception as failure:
            doc, error = "", str(failure)
        row = {"name": name, "description": doc, "place": point.value, "error": error}
        listed.append(row | {"package": registry.origin(name)})
    if as_json:
        print_json("estimators", estimators=listed)
        return
    rows = []
    for each in listed:
        doc = f"cannot be loaded: {each['error']}" if each["error"] else each["description"]
        joined = f" of {each['package']}" if each["package"] else ""
        rows.append((each["name"], f"{doc} ({each['place']}{joined})"))
    print_list(rows)


def _options(name: str, as_json: bool) -> None:
    """All options of an estimator."""
    from ekfslam.registry import named, parse

    name = parse(name).name
    maker = named(name)
    told = options_of(maker) if callable(maker) else []
    if as_json:
        options = [{"defaults": each.defaults, "text": each.text} for each in told]
        print_json("estimators", name=name, description=summary(maker), options=options)
        return
    rows = [(name, summary(maker))]
    for defaults, text in told:
        words = [f"{option}={value}" if value else option for option, value in defaults.items()]
        rows.append((", ".join(words), text))
    print_list(rows)
