"""Variants of a scenario: its file with some values changed, and what tells two apart."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from ekfslam.errors import InputError, UnsupportedError
from ekfslam.robots import Prior
from ekfslam.simulation.scenario import Scenario

# Each pair says the same thing in two ways; the one that is set replaces the other.
_EITHER = {"sigmas": "covariance", "covariance": "sigmas"}
_WORDS = ("name", "description")
_LATER = ("mixture",)  # settings that count where they are set, so that older digests hold
_OF_ROBOTS = ("start", "controls", "motion", "prior", "draw_prior", "robot_name", "team")


def change(document: dict[str, Any], changes: Mapping[str, Any], where: str) -> None:
    """Set values of a scenario's document, in place.

    Parameters
    ----------
    document : dict
        As read from TOML.
    changes : mapping of str to value
        By dotted key, with the numbers of list items from 0: ``motion.sigmas``,
        ``sensors.0.max_range``, ``prior.sigmas.2``. Tables that are missing are made; a
        `covariance` gives way to `sigmas` and the other way round.
    where : str
        What an error calls the document.

    Raises
    ------
    InputError
        For a key that leads through a value or to no item of a list; the message names it. Keys
        that a scenario does not know are found when the document is read.
    """
    for key, value in changes.items():
        *path, last = key.split(".")
        place: Any = document
        for name in path:
            if isinstance(place, dict):
                place = place.setdefault(name, {})
            else:
                place = place[_item(place, name, key, where)]
        if not isinstance(place, dict):
            place[_item(place, last, key, where)] = _plain(value)
            continue
        place.pop(_EITHER.get(last), None)
        place[last] = _plain(value)


def _item(place: Any, name: str, key: str, where: str) -> int:
    if not isinstance(place, list):
        raise InputError(f"{where}: {key!r} cannot be set: {name!r} is inside a value")
    if not (name.isascii() and name.isdigit() and int(name) < len(place)):
        known = f"items 0 to {len(place) - 1}" if place else "no item"
        raise InputError(f"{where}: {key!r} cannot be set: no item {name!r}, there are {known}")
    return int(name)


def _plain(value: Any) -> Any:
    """A value as TOML would give it."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def scenario_hash(scenario: Scenario) -> str:
    """What tells two scenarios apart: the same digest if they state the same problem.

    It depends on every setting and number from which datasets are drawn, and neither on the
    scenario's name and description nor on how it was written down: a default that is spelt out,
    an angle in degrees, or a path given by its controls change nothing.

    Parameters
    ----------
    scenario : Scenario

    Returns
    -------
    str
        64 hexadecimal digits (SHA-256).

    Raises
    ------
    UnsupportedError
        For a motion model of one's own: nothing says whether two functions are the same.
    """
    skipped: tuple[str, ...] = (*_WORDS, *_OF_ROBOTS, "sensors", "time_step")
    if scenario.known_map == 1:  # came later, and older digests hold
        skipped = (*skipped, "known_map")
    settings = {f.name: getattr(scenario, f.name) for f in fields(Scenario)}
    contents = {name: value for name, value in settings.items() if name not in skipped} | {
        "robots": [
            replace(plan, prior=plan.prior or Prior(plan.start)) for plan in scenario.robot_plans
        ],
        "sensors": scenario.sensor_plans,
        "times": scenario.times,
    }
    text = json.dumps(_canonical(contents), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _canonical(value: Any) -> Any:
    """Plain values in which equal things are written alike."""
    if isinstance(value, np.ndarray):
        numbers = np.ascontiguousarray(value, dtype="<f8") + 0.0  # no negative zeros
        return [list(value.shape), hashlib.sha256(numbers.tobytes()).hexdigest()]
    if is_dataclass(value):
        settings = {f.name: getattr(value, f.name) for f in fields(value)}
        unset = [name for name in _LATER if settings.get(name, 0) is None]
        return {n: _canonical(setting) for n, setting in settings.items() if n not in unset}
    if isinstance(value, Mapping):
        return {name: _canonical(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_canonical(item) for item in value]
    if value is None or isinstance(value, str | bool):
        return value
    if callable(value):
        raise UnsupportedError("a motion model of one's own has no digest: it is a function")
    return float(value) + 0.0
