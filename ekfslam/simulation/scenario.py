"""Scenarios: a world, a path, a motion model and sensors, by name or from a TOML file.

A scenario file::

    description = "A square of four landmarks."
    association = "known"         # or "unknown": observations carry no identity
    noise_on = "odometry"         # or "motion"
    time_step = 1.0               # [s]; not for motion models whose controls have a dt
    observe_start = false         # whether pose 0 observes too
    observe_every = 1             # observe at every so many poses
    new_landmarks_per_step = 1    # optional; see `Scenario`

    [world]                       # kind and parameters of a function in ekfslam.simulation.worlds
    kind = "points"
    landmarks = [[0, 0], [4, 0], [4, 4], [0, 4]]

    [path]                        # the same, of ekfslam.simulation.paths
    kind = "controls"
    start = [2, 0, 0]
    controls = [[0.1, "3 deg"]]
    repeat = 120

    [motion]                      # parameters of ekfslam.models.motion.MotionModel
    kind = "advance-turn"
    sigmas = [0.01, "1 deg"]
    slip = 0.001                  # the default for two noisy controls, 0 for three

    [[sensors]]                   # parameters of ekfslam.models.sensors.Sensor, one table each
    kind = "range-bearing"
    sigmas = [0.1, "1 deg"]
    max_range = 5.0

    [prior]                       # optional: an exactly known start is the default
    sigmas = [0.1, 0.1, "2 deg"]
    mean = [2, 0, 0]              # the true start by default
    draw = true                   # draw the mean of the prior about `mean`; false by default

Numbers are in SI units and radians; a string such as ``"3 deg"`` stands for an angle in degrees.
Wherever a ``covariance`` is asked for, standard deviations ``sigmas`` may be given instead; a
covariance itself takes no degrees.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.resources import files
from importlib.resources.abc import Traversable
from inspect import Parameter, signature
from os import PathLike
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_type_hints

import numpy as np

from ekfslam.dataset import LandmarkMap, Prior
from ekfslam.errors import EkfslamError, FileFormatError, InputError, UnknownNameError
from ekfslam.geometry import Array
from ekfslam.models.motion import KINDS, MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.simulation.paths import PATHS
from ekfslam.simulation.worlds import WORLDS

DEFAULT_SLIP = 1e-3  # [m] per step: two noisy controls alone make a singular covariance
_DEGREES = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*deg\s*")


@dataclass(frozen=True, eq=False)
class Scenario:
    """A SLAM problem to draw datasets from with `ekfslam.simulation.simulate`.

    Variants are made with `dataclasses.replace`.

    Parameters
    ----------
    name : str
    landmarks : LandmarkMap
        The world.
    start : (3,) array_like
        True first pose [m, m, rad].
    controls : (K, m) array_like
        Commands, in the columns of the motion model.
    motion : MotionModel
        With the noise and the slip that are both simulated and stated in the dataset.
    sensors : tuple of Sensor
        The same for the noise of measurements.
    description : str
    association : {"known", "unknown"}
        Whether observations carry the identity of their landmark.
    noise_on : {"odometry", "motion"}
        "odometry": the truth follows the command and the measured controls are perturbed;
        "motion": the truth is disturbed and the measured controls are the command. Lateral slip
        has no control that could measure it and disturbs the truth in both.
    time_step : float, optional
        Time from pose to pose [s], 1 by default. Motion models with a dt take theirs from it.
    prior : Prior, optional
        What the dataset states of the first pose; exactly the true start by default.
    draw_prior : bool
        Draw the prior's mean from a Gaussian with its covariance about its mean.
    observe_start : bool
        Whether pose 0 observes too; a step is otherwise a motion and then a look.
    observe_every : int
        Only the poses whose number is a multiple of it observe.
    new_landmarks_per_step : int, optional
        Drop the sightings of all but so many landmarks, picked at random, of those that have not
        been seen before: the policy of Solà's demo (C.3, with 1), made part of the data so that
        every estimator solves the same problem. Off by default.

    Raises
    ------
    InputError
        For values that make no sense; the message names them.
    """

    name: str
    landmarks: LandmarkMap
    start: Array
    controls: Array
    motion: MotionModel
    sensors: tuple[Sensor, ...]
    description: str = ""
    association: str = "known"
    noise_on: str = "odometry"
    time_step: float | None = None
    prior: Prior | None = None
    draw_prior: bool = False
    observe_start: bool = False
    observe_every: int = 1
    new_landmarks_per_step: int | None = None

    def __post_init__(self) -> None:
        for name, known in (
            ("association", ("known", "unknown")),
            ("noise_on", ("odometry", "motion")),
        ):
            if getattr(self, name) not in known:
                raise InputError(f"{name} must be {' or '.join(map(repr, known))}")
        if self.time_step is not None:
            if "dt" in self.motion.control_names:
                raise InputError(f"time_step is the dt of {self.motion.kind!r} controls; leave out")
            if not (np.isfinite(self.time_step) and self.time_step > 0):
                raise InputError(f"time_step must be positive, got {self.time_step}")
        if self.observe_every < 1:
            raise InputError(f"observe_every must be at least 1, got {self.observe_every}")
        if self.new_landmarks_per_step is not None and self.new_landmarks_per_step < 1:
            raise InputError(
                f"new_landmarks_per_step must be at least 1, got {self.new_landmarks_per_step}"
            )
        self._check_arrays()
        object.__setattr__(self, "sensors", tuple(self.sensors))

    def _check_arrays(self) -> None:
        names = self.motion.control_names
        start, controls = np.array(self.start, float), np.array(self.controls, float)
        if start.shape != (3,):
            raise InputError("start must be a pose (x, y, theta)")
        if controls.ndim != 2 or controls.shape[1] != len(names):
            raise InputError(f"controls of {self.motion.kind!r} need {', '.join(names)}")
        for name, array in (("start", start), ("controls", controls)):
            if not np.isfinite(array).all():
                raise InputError(f"{name} holds NaN or infinite values")
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def times(self) -> Array:
        """Times of the poses [s], (K + 1,)."""
        names = self.motion.control_names
        if "dt" in names:
            return np.concatenate([[0.0], np.cumsum(self.controls[:, names.index("dt")])])
        step = 1.0 if self.time_step is None else self.time_step
        return step * np.arange(len(self.controls) + 1, dtype=float)

    def describe(self) -> str:
        """What it is, in one line."""
        length = np.hypot(*self.motion.increment(self.controls)[0][:, :2].T).sum()
        facts = [
            f"{len(self.landmarks)} landmarks",
            f"{len(self.controls)} steps over {length:.0f} m",
            f"{self.motion.kind} motion",
            " and ".join(sensor.kind for sensor in self.sensors) or "no sensor",
            f"noise on the {self.noise_on}",
            f"association {self.association}",
        ]
        return f"{self.description} [{'; '.join(facts)}]".strip()


def scenarios() -> tuple[str, ...]:
    """Names of the scenarios that come with the package, sorted."""
    return tuple(sorted(_shipped()))


def load_scenario(scenario: str | PathLike[str]) -> Scenario:
    """The scenario of a name or of a TOML file.

    Parameters
    ----------
    scenario : str or path
        A name of `scenarios`, or a path that ends in ``.toml``; the scenario is then called after
        its file.

    Raises
    ------
    UnknownNameError
        For a name that no scenario carries; lists close ones.
    FileFormatError
        If the file is missing or no TOML; the message says the line.
    InputError
        For unknown or missing keys and values that make no sense; the message names the file,
        the table and the key.
    """
    shipped = _shipped()
    file: Path | Traversable
    if str(scenario) in shipped:
        file, where = shipped[str(scenario)], str(scenario)
    elif Path(scenario).suffix == ".toml":
        file, where = Path(scenario), str(scenario)
    else:
        raise UnknownNameError("scenario", str(scenario), shipped)
    try:
        document = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{where}: {error}") from None
    except OSError as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise FileFormatError(f"{where}: {reason}") from None
    return _build(Path(file.name).stem, document, where)


def _shipped() -> dict[str, Traversable]:
    folder = files("ekfslam.simulation") / "scenarios"
    return {Path(f.name).stem: f for f in folder.iterdir() if f.name.endswith(".toml")}


# From a TOML document to a scenario --------------------------------------------------------------
#
# The signature of what a table stands for says which keys it may hold, which it must, and of what
# type: nothing is said twice.

_TABLES = ("world", "path", "motion", "sensors", "prior")
_RESOLVED = ("name", "landmarks", "start", "controls", "draw_prior")  # made from the tables


def _build(name: str, document: dict[str, Any], where: str) -> Scenario:
    settings = {key: value for key, value in document.items() if key not in _TABLES}
    settings = _arguments(Scenario, settings, where, skip=(*_TABLES, *_RESOLVED), also=_TABLES)

    def section(key: str) -> tuple[dict[str, Any], str]:
        table = document.get(key)
        if table is None:
            raise InputError(f"{where}: the table [{key}] is missing")
        if not isinstance(table, dict):
            raise InputError(f"{where}: [{key}] must be a table, got {table!r}")
        return table, f"{where}: [{key}]"

    positions = _of_kind(WORLDS, *section("world"))
    path = _of_kind(PATHS, *section("path"))
    motion = _motion(*section("motion"))
    if path.motion not in (None, motion.kind):
        raise InputError(f"{where}: this path needs the motion kind {path.motion!r}")
    sensors = document.get("sensors", [])
    if not (isinstance(sensors, list) and sensors and all(isinstance(s, dict) for s in sensors)):
        raise InputError(f"{where}: at least one table [[sensors]] is needed")
    prior, draw_prior = None, False
    if "prior" in document:
        prior, draw_prior = _prior(path.start, *section("prior"))
    resolved = {
        "name": name,
        "landmarks": _call(LandmarkMap, where, ids=range(len(positions)), positions=positions),
        "start": path.start,
        "controls": path.controls,
        "motion": motion,
        "sensors": tuple(
            _filled(Sensor, table, f"{where}: [[sensors]] {number}")
            for number, table in enumerate(sensors, start=1)
        ),
        "prior": prior,
        "draw_prior": draw_prior,
    }
    return _call(Scenario, where, **resolved, **settings)


def _motion(table: dict[str, Any], where: str) -> MotionModel:
    kind = table.get("kind")
    if isinstance(kind, str) and kind in KINDS and KINDS[kind].noisy == 2:
        table = {"slip": DEFAULT_SLIP, **table}
    return _filled(MotionModel, table, where)


def _prior(start: Array, table: dict[str, Any], where: str) -> tuple[Prior, bool]:
    draw = table.get("draw", False)
    if not isinstance(draw, bool):
        raise InputError(f"{where}: draw must be true or false, got {draw!r}")
    rest = {"mean": start.tolist(), **{key: v for key, v in table.items() if key != "draw"}}
    return _filled(Prior, rest, where, also=("draw",)), draw


def _of_kind(kinds: Mapping[str, Callable[..., Any]], table: dict[str, Any], where: str) -> Any:
    """Call the function that the table's ``kind`` names with the rest of the table."""
    if "kind" not in table:
        raise InputError(f"{where}: missing key 'kind'; known: {', '.join(kinds)}")
    kind = _read(table["kind"], str, f"{where}: kind")
    if kind not in kinds:
        raise InputError(f"{where}: {UnknownNameError('kind', kind, kinds)}")
    rest = {key: value for key, value in table.items() if key != "kind"}
    return _filled(kinds[kind], rest, where, also=("kind",))


def _filled(
    target: Callable[..., Any], table: dict[str, Any], where: str, also: Collection[str] = ()
) -> Any:
    return _call(target, where, **_arguments(target, table, where, also=also))


def _call(target: Callable[..., Any], where: str, **arguments: Any) -> Any:
    """Call, and say in the error of a value that makes no sense where it was read."""
    try:
        return target(**arguments)
    except (EkfslamError, TypeError, ValueError) as error:
        raise InputError(f"{where}: {error}") from None


def _arguments(
    target: Callable[..., Any],
    table: dict[str, Any],
    where: str,
    skip: Collection[str] = (),
    also: Collection[str] = (),
) -> dict[str, Any]:
    """A table as arguments of `target`, checked against its signature.

    `skip` are parameters that no key may give, `also` further keys to propose for a misspelt one.
    """
    parameters = {k: p for k, p in signature(target).parameters.items() if k not in skip}
    shorthand = ("sigmas",) if "covariance" in parameters else ()
    for key in table:
        if key not in parameters and key not in shorthand:
            known = [*parameters, *shorthand, *also]
            close = get_close_matches(key, known, n=2)
            hint = f"did you mean {' or '.join(close)}?" if close else f"known: {', '.join(known)}"
            raise InputError(f"{where}: unknown key {key!r}; {hint}")
    if "sigmas" in table and "covariance" in table:
        raise InputError(f"{where}: give either covariance or sigmas")
    hints = get_type_hints(target)
    values = {k: _read(v, hints[k], f"{where}: {k}") for k, v in table.items() if k in parameters}
    if "sigmas" in table:
        sigmas = _read(table["sigmas"], Array, f"{where}: sigmas")
        if sigmas.ndim != 1:
            raise InputError(f"{where}: sigmas must be one number for each noisy value")
        if (sigmas < 0).any():
            raise InputError(f"{where}: sigmas must not be negative")
        values["covariance"] = np.diag(sigmas**2)
    for key, parameter in parameters.items():
        if parameter.default is Parameter.empty and key not in values:
            alternative = " or 'sigmas'" if key == "covariance" else ""
            raise InputError(f"{where}: missing key {key!r}{alternative}")
    return values


def _read(value: Any, hint: Any, where: str) -> Any:
    """A TOML value as the type of a parameter: text, flag, whole number, number or array."""
    allowed = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    if float in allowed:
        return _number(value, where)
    for kind, name in ((str, "text"), (bool, "true or false"), (int, "a whole number")):
        if kind in allowed:
            if type(value) is not kind:
                raise InputError(f"{where} must be {name}, got {value!r}")
            return value
    if not isinstance(value, list):
        raise InputError(f"{where} must be a list of numbers, got {value!r}")
    rows = _numbers(value, where)
    try:
        return np.array(rows)
    except ValueError:
        raise InputError(f"{where} has rows of different lengths") from None


def _numbers(value: Any, where: str) -> Any:
    return [_numbers(v, where) for v in value] if isinstance(value, list) else _number(value, where)


def _number(value: Any, where: str) -> float:
    # Degrees squared are not meant by a string in a covariance; it is refused like any other.
    degrees = isinstance(value, str) and not where.endswith(": covariance")
    if degrees and (angle := _DEGREES.fullmatch(value)):
        return float(np.deg2rad(float(angle[1])))
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where} must be a number (or an angle like '3 deg'), got {value!r}")
    return float(value)
