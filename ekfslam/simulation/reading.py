"""Scenarios by name or from a TOML file; `ekfslam.simulation.scenario` describes the format."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from importlib.resources import files
from importlib.resources.abc import Traversable
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ekfslam.documents import arguments, call, filled, motion_model, read, section, tables
from ekfslam.errors import FileFormatError, InputError, UnknownNameError
from ekfslam.geometry import Array
from ekfslam.registry import parse
from ekfslam.robots import LandmarkMap, Prior
from ekfslam.simulation.blocks import share
from ekfslam.simulation.paths import PATHS
from ekfslam.simulation.plans import RobotPlan, SensorPlan
from ekfslam.simulation.scenario import Scenario
from ekfslam.simulation.variants import change
from ekfslam.simulation.world_files import fill_in
from ekfslam.simulation.worlds import WORLDS


def scenarios() -> tuple[str, ...]:
    """Names of the scenarios that come with the package, sorted.

    The worlds of some are files of others, which may not be here: see `describe_scenario`.
    """
    return tuple(sorted(_shipped()))


def describe_scenario(name: str) -> str:
    """What a scenario that comes with the package is, in one line, or why it is not here.

    Parameters
    ----------
    name : str
        One of `scenarios`.

    Raises
    ------
    UnknownNameError
        For a name that no scenario carries.
    """
    try:
        return load_scenario(name).describe()
    except FileFormatError as error:  # of the world's file: the scenario's own is sound
        text = _shipped()[name].read_text(encoding="utf-8")
        return f"{tomllib.loads(text)['description']} [not here: {error}]"


def load_scenario(
    scenario: str | PathLike[str], changes: Mapping[str, Any] | None = None
) -> Scenario:
    """The scenario of a name or of a TOML file, as it is or with some values changed.

    Parameters
    ----------
    scenario : str or path
        A name of `scenarios`, or a path that ends in ``.toml``; the scenario is then called after
        its file. Values to set may follow a str, as in
        ``city(world.count=5000, path.steps=10000)``, and become part of the scenario's name.
    changes : mapping of str to value, optional
        Values of the file to set before it is read, by dotted key, with the numbers of list items
        from 0: ``{"motion.sigmas": [0.1, 0.1], "sensors.0.max_range": 8.0, "path.repeat": 100}``.
        A table that the file does not have is made: ``{"prior.sigmas": [0.1, 0.1, "5 deg"]}``. A
        `covariance` gives way to `sigmas` and the other way round.

    Raises
    ------
    UnknownNameError
        For a name that no scenario carries; lists close ones.
    FileFormatError
        If the file is missing or no TOML; the message says the line. Or if that of its world is
        missing or damaged; the message says where to get it.
    InputError
        For unknown or missing keys, of the file or of `changes`, and values that make no sense;
        the message names the file, the table and the key. And for brackets that cannot be read.
    """
    if isinstance(scenario, str) and "(" in scenario and not scenario.endswith(".toml"):
        named = parse(scenario)
        changed = load_scenario(named.name, named.options | dict(changes or {}))
        return replace(changed, name=str(named))
    shipped = _shipped()
    file: Path | Traversable
    folder, where = None, str(scenario)
    if where in shipped:
        file = shipped[where]
    elif Path(scenario).suffix == ".toml":
        file = Path(scenario)
        folder = file.parent
    else:
        raise UnknownNameError("scenario", where, shipped)
    try:
        document = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{where}: {error}") from None
    except OSError as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise FileFormatError(f"{where}: {reason}") from None
    change(document, changes or {}, where)
    fill_in(document, folder, where)
    share(document, where)
    return _build(Path(file.name).stem, document, where)


def _shipped() -> dict[str, Traversable]:
    folder = files("ekfslam.simulation") / "scenarios"
    return {Path(f.name).stem: f for f in folder.iterdir() if f.name.endswith(".toml")}


# From a TOML document to a scenario --------------------------------------------------------------

_ROBOT = ("path", "motion", "prior")  # the tables of a robot
_TABLES = ("world", "sensors", "robots", *_ROBOT)
_OF_ROBOT = ("start", "controls", "draw_prior")  # made from its tables
_RESOLVED = ("name", "landmarks", "descriptors", "robot_name", "team", *_OF_ROBOT)


def _build(name: str, document: dict[str, Any], where: str) -> Scenario:
    settings = {key: value for key, value in document.items() if key not in _TABLES}
    settings = arguments(Scenario, settings, where, skip=(*_TABLES, *_RESOLVED), also=_TABLES)
    landmarks, descriptors = _world(*section(document, "world", where))
    first, *team = _robots(document, where)
    sensors = tables(document, "sensors", where)
    resolved = {
        "name": name,
        "landmarks": landmarks,
        "descriptors": descriptors,
        "start": first.start,
        "controls": first.controls,
        "motion": first.motion,
        "prior": first.prior,
        "draw_prior": first.draw_prior,
        "robot_name": first.name,
        "team": tuple(team),
        "sensors": tuple(
            filled(SensorPlan, table, f"{where}: [[sensors]] {number}")
            for number, table in enumerate(sensors, start=1)
        ),
    }
    return call(Scenario, where, **resolved, **settings)


def _world(table: dict[str, Any], where: str) -> tuple[LandmarkMap, Array | None]:
    rest = {key: value for key, value in table.items() if key != "descriptors"}
    positions = _of_kind(WORLDS, rest, where, also=("descriptors",))
    landmarks = call(LandmarkMap, where, ids=range(len(positions)), positions=positions)
    if "descriptors" not in table:
        return landmarks, None
    descriptors = read(table["descriptors"], Array, f"{where}: descriptors")
    if descriptors.ndim != 1 or not len(descriptors):
        raise InputError(f"{where}: descriptors must be a list of numbers")
    return landmarks, np.resize(descriptors, len(landmarks))


def _robots(document: dict[str, Any], where: str) -> list[RobotPlan]:
    if "robots" not in document:
        return [_robot({key: document[key] for key in _ROBOT if key in document}, where)]
    if given := [f"[{key}]" for key in _ROBOT if key in document]:
        raise InputError(f"{where}: give either [[robots]] or {' and '.join(given)}, not both")
    return [
        _robot(table, f"{where}: [[robots]] {number}")
        for number, table in enumerate(tables(document, "robots", where), start=1)
    ]


def _robot(table: dict[str, Any], where: str) -> RobotPlan:
    settings = {key: value for key, value in table.items() if key not in _ROBOT}
    settings = arguments(RobotPlan, settings, where, skip=(*_ROBOT, *_OF_ROBOT), also=_ROBOT)
    path = _of_kind(PATHS, *section(table, "path", where))
    motion = motion_model(*section(table, "motion", where))
    if path.motion not in (None, motion.kind):
        raise InputError(f"{where}: this path needs the motion kind {path.motion!r}")
    if path.wheelbase not in (None, motion.wheelbase):
        raise InputError(f"{where}: path and motion need the same wheelbase")
    prior, draw_prior = None, False
    if "prior" in table:
        prior, draw_prior = _prior(path.start, *section(table, "prior", where))
    plan = (path.start, path.controls, motion, prior, draw_prior)
    return call(RobotPlan, where, *plan, **settings)


def _prior(start: Array, table: dict[str, Any], where: str) -> tuple[Prior, bool]:
    draw = table.get("draw", False)
    if not isinstance(draw, bool):
        raise InputError(f"{where}: draw must be true or false, got {draw!r}")
    rest = {"mean": start.tolist(), **{key: v for key, v in table.items() if key != "draw"}}
    return filled(Prior, rest, where, also=("draw",)), draw


def _of_kind(
    kinds: Mapping[str, Callable[..., Any]],
    table: dict[str, Any],
    where: str,
    also: Collection[str] = (),
) -> Any:
    """Call the function that the table's ``kind`` names with the rest of the table."""
    if "kind" not in table:
        raise InputError(f"{where}: missing key 'kind'; known: {', '.join(kinds)}")
    kind = read(table["kind"], str, f"{where}: kind")
    if kind not in kinds:
        raise InputError(f"{where}: {UnknownNameError('kind', kind, kinds)}")
    rest = {key: value for key, value in table.items() if key != "kind"}
    return filled(kinds[kind], rest, where, also=("kind", *also))
