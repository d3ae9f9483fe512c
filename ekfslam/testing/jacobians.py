"""Whether a Jacobian is the derivative that it says it is, and in words what it is instead.

Each entry is held against central differences of fourth order, whose own error is near 1e-10 for
numbers of the order of one. Angles are wrapped before they are differences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np

from ekfslam.checks import checked_array
from ekfslam.differences import STEP, central_differences
from ekfslam.errors import InputError
from ekfslam.geometry import Array, wrap
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor, View

TOLERANCE = 1e-6
POINTS = 20  # drawn where the user names none
JUMP = 1e4  # a slope beyond it is a jump of an angle by a turn, over a step
FACTORS = {
    2.0: "twice what it should be",
    0.5: "half of what it should be",
    180 / np.pi: "in degrees where radians are wanted",
    np.pi / 180: "in radians where degrees are wanted",
}
POSE, POINT, INCREMENT = ("x", "y", "theta"), ("px", "py"), ("dx", "dy", "dtheta")


class _Case(NamedTuple):
    """A Jacobian and the function that it should be the derivative of.

    `function` maps (n, d) to (n, m), and `jacobian` (n, d) to (n, m, d).
    """

    what: str
    function: Callable[[Array], Array]
    jacobian: Callable[[Array], Array]
    at: Array
    outputs: Sequence[str]
    inputs: Sequence[str]
    angular: np.ndarray


def check_jacobians(
    model: Any,
    jacobian: Any = None,
    at: Any = None,
    *,
    angles: Sequence[int] = (),
    tolerance: float = TOLERANCE,
) -> float:
    """Assert that Jacobians are the derivatives of their functions.

    Parameters
    ----------
    model : MotionModel, Sensor, View or callable
        A motion model is checked with respect to its controls; a sensor in what it reports
        (`project`), in the direct model with respect to pose and point (`observe`), and in the
        inverse one with respect to pose and value (`locate`). Of a plain function ``f(x)`` of
        (d,), giving (m,), the Jacobian comes second.
    jacobian : callable or (m, d) array_like, optional
        Of a plain function: ``J(x)``, or its value where `at` is one point.
    at : array_like, optional
        Where: controls (n, m) of a motion model, points (n, 2) in its frame of a view, pairs of
        poses and points ``((n, 3), (n, 2))`` of a sensor, which default to random ones; points (d,)
        or (n, d) of a plain function, which do not.
    angles : sequence of int
        Which outputs of a plain function are angles [rad].
    tolerance : float
        Largest deviation of an entry, relative to the largest entry at that place where that is
        above 1.

    Returns
    -------
    float
        The largest deviation, so measured.

    Raises
    ------
    AssertionError
        Names the entry that is farthest off, where that is, both numbers, and what it looks like:
        a transposed matrix, a wrong sign, rows or columns exchanged, an entry that is missing,
        degrees.
    InputError
        For something that cannot be checked.

    Examples
    --------
    >>> from math import cos, sin
    >>> check_jacobians(lambda u: [u[0] * cos(u[1]), u[0] * sin(u[1])],
    ...                 lambda u: [[cos(u[1]), -u[0] * sin(u[1])], [sin(u[1]), u[0] * cos(u[1])]],
    ...                 at=[2.0, 0.3]) < 1e-9
    True
    """
    if jacobian is None and not isinstance(model, MotionModel | Sensor | View):
        raise InputError("a plain function needs its Jacobian: check_jacobians(f, J, at=x)")
    if isinstance(model, MotionModel):
        cases = iter([_motion(model, at)])
    elif isinstance(model, Sensor):
        cases = _sensor(model, at)
    elif isinstance(model, View):
        cases = _view(model, at, "the view")
    else:
        cases = iter([_plain(model, jacobian, at, angles)])
    return max(_deviation(case, tolerance) for case in cases)


# What is checked --------------------------------------------------------------------------------


def _motion(model: MotionModel, at: Any) -> _Case:
    names = model.control_names
    if not names:
        raise InputError(f"motion model {model.kind!r} has no controls, so no Jacobian")
    controls = _random().uniform(-1.0, 1.0, (POINTS, len(names)))
    if at is None and "dt" in names:
        controls[:, names.index("dt")] = np.abs(controls[:, names.index("dt")]) + 0.1
    if at is not None:
        controls = _points(at, len(names), f"controls ({', '.join(names)})")
    return _Case(
        f"motion model {model.kind!r}",
        lambda u: model.increment(u)[0],
        lambda u: model.increment(u)[1],
        controls,
        INCREMENT,
        names,
        np.array([False, False, True]),
    )


def _sensor(sensor: Sensor, at: Any) -> Iterator[_Case]:
    if at is None:
        poses = _random().uniform(-3.0, 3.0, (POINTS, 3))
        points = poses[:, :2] + _away(POINTS)
    else:
        poses = _points(at[0], 3, "poses (x, y, theta)")
        points = _points(at[1], 2, "points (x, y)")
    both = np.hstack([poses, points])
    names, angular = sensor.view.names, np.array(sensor.view.angular)
    local = np.linalg.norm(points - poses[:, :2], axis=1)[:, None] * [[0.8, 0.6]]
    yield from _view(sensor.view, local, sensor.name)
    yield _Case(
        f"observe of {sensor.name}",
        lambda x: sensor.observe(x[:, :3], x[:, 3:])[0],
        lambda x: np.concatenate(sensor.observe(x[:, :3], x[:, 3:])[1:], axis=-1),
        both,
        names,
        (*POSE, *POINT),
        angular,
    )
    if sensor.view.back_project is not None:
        yield _Case(
            f"locate of {sensor.name}",
            lambda x: sensor.locate(x[:, :3], x[:, 3:])[0],
            lambda x: np.concatenate(sensor.locate(x[:, :3], x[:, 3:])[1:], axis=-1),
            np.hstack([poses, sensor.observe(poses, points)[0]]),
            POINT,
            (*POSE, *names),
            np.zeros(2, dtype=bool),
        )


def _view(view: View, at: Any, whose: str) -> Iterator[_Case]:
    points = _away(POINTS) if at is None else _points(at, 2, "points (x, y)")
    yield _Case(
        f"project of {whose}",
        view.project,
        view.project_jacobian,
        points,
        view.names,
        POINT,
        np.array(view.angular),
    )
    if view.back_project is not None and view.back_project_jacobian is not None:
        yield _Case(
            f"back_project of {whose}",
            view.back_project,
            view.back_project_jacobian,
            view.project(points),
            POINT,
            view.names,
            np.zeros(2, dtype=bool),
        )


def _plain(
    function: Callable[[Array], Any], jacobian: Any, at: Any, angles: Sequence[int]
) -> _Case:
    if not callable(function):
        raise InputError(f"check_jacobians takes a model or a function, got {function!r}")
    if at is None:
        raise InputError("at is missing: the points at which to compare")
    points = np.atleast_2d(np.array(at, dtype=float))
    points = _points(points, points.shape[1], "points")
    if not callable(jacobian) and len(points) != 1:
        raise InputError("a Jacobian that is an array is that of one point: give a function")
    name = getattr(function, "__name__", "the function")

    def each(call: Callable[[Array], Any], rows: Array) -> Array:
        return np.array([np.asarray(call(row.copy()), dtype=float) for row in rows])

    first = each(function, points)
    if first.ndim != 2:
        raise InputError(f"{name} must return numbers (m,), got shape {first.shape[1:]}")
    angular = np.zeros(first.shape[1], dtype=bool)
    angular[list(angles)] = True
    return _Case(
        "the function" if name == "<lambda>" else name,
        lambda x: each(function, x),
        (lambda x: each(jacobian, x)) if callable(jacobian) else lambda x: np.array([jacobian]),
        points,
        [f"f[{i}]" for i in range(first.shape[1])],
        [f"x[{i}]" for i in range(points.shape[1])],
        angular,
    )


def _points(value: Any, size: int, name: str) -> Array:
    points = checked_array(np.atleast_2d(np.array(value, dtype=float)), float, (None, size), name)
    if not len(points) or not np.isfinite(points).all():
        raise InputError(f"{name} must be finite numbers, one row at least")
    return points


def _random() -> np.random.Generator:
    return np.random.default_rng(7)


def _away(count: int) -> Array:
    """Points 1 to 5 m away, in all directions."""
    distance, bearing = _random().uniform([1.0, -np.pi], [5.0, np.pi], (count, 2)).T
    return np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing)])


# What is found ----------------------------------------------------------------------------------


def _deviation(case: _Case, tolerance: float) -> float:
    here = case.function(case.at)

    def away(moved: Array) -> Array:
        apart = case.function(moved) - here
        return np.where(case.angular, wrap(apart), apart)

    step = STEP * np.maximum(1.0, np.abs(case.at))
    numeric = central_differences(away, case.at, step)
    given = np.asarray(case.jacobian(case.at), dtype=float)
    if given.shape != numeric.shape:
        raise AssertionError(_misshapen(case, given, numeric, tolerance))
    off = np.abs(given - numeric) / _scale(numeric)
    off = np.where(np.isfinite(off), off, np.inf)
    largest = float(off.max())
    if largest > tolerance:
        raise AssertionError(_said(case, given, numeric, off, tolerance))
    return largest


def _scale(numeric: Array) -> Array:
    return np.maximum(1.0, np.abs(numeric).max(axis=(1, 2), keepdims=True))


def _close(a: Array, b: Array, tolerance: float) -> bool:
    return bool((np.abs(a - b) <= tolerance * _scale(b)).all())


def _misshapen(case: _Case, given: Array, numeric: Array, tolerance: float) -> str:
    wanted, got = numeric.shape[1:], given.shape[1:]
    said = f"{case.what}: the Jacobian has shape {got}, wanted {wanted}"
    said += f": a row for each of {', '.join(case.outputs)}, a column for each of "
    said += ", ".join(case.inputs)
    turned = got == wanted[::-1] and _close(np.swapaxes(given, 1, 2), numeric, tolerance)
    return said + ("; it is transposed" if turned else "")


def _said(case: _Case, given: Array, numeric: Array, off: Array, tolerance: float) -> str:
    """Which entry is farthest off, where, and what the matrix looks like."""
    place, row, column = (int(i) for i in np.unravel_index(np.argmax(off), off.shape))
    where = ", ".join(f"{n} = {v:.6g}" for n, v in zip(case.inputs, case.at[place], strict=True))
    wrong = np.asarray((off > tolerance).any(axis=0))
    entries = [f"[{i}, {j}]" for i, j in np.argwhere(wrong)]
    listed = ", ".join(entries) if len(entries) < wrong.size else "all"
    return "\n".join(
        [
            f"{case.what}: d {case.outputs[row]} / d {case.inputs[column]}, entry [{row}, "
            f"{column}], is {given[place, row, column]:.9g}; central differences give "
            f"{numeric[place, row, column]:.9g}",
            f"  at {where}",
            f"  entries that are off: {listed} of {wrong.size}",
            f"  {_diagnosis(case, given, numeric, wrong, tolerance)}",
        ]
    )


def _diagnosis(
    case: _Case, given: Array, numeric: Array, wrong: np.ndarray, tolerance: float
) -> str:
    """What a wrong matrix looks like, in words."""
    if not np.isfinite(given).all():
        return "it holds NaN or infinite values"
    jumps = np.flatnonzero((np.abs(numeric) > JUMP).any(axis=(0, 2)) & ~case.angular)
    if len(jumps):
        return (
            f"the function jumps there: if {case.outputs[jumps[0]]} is an angle, say "
            f"angles=[{jumps[0]}]"
        )
    rows, columns = numeric.shape[1:]
    if rows == columns and _close(np.swapaxes(given, 1, 2), numeric, tolerance):
        return "the matrix is transposed"
    for axis, size, what in ((1, rows, "rows"), (2, columns, "columns")):
        for order in permutations(range(size)) if 1 < size <= 5 else ():
            if _close(given, np.take(numeric, order, axis=axis), tolerance):
                return f"{what} are exchanged: they stand in the order {list(order)}"
    return _entries(given[:, wrong], numeric[:, wrong], tolerance)


def _entries(given: Array, numeric: Array, tolerance: float) -> str:
    """What the wrong entries, (n, e) of all places, have in common."""
    them = "the entry" if given.shape[1] == 1 else "each of these entries"
    given, numeric = given[:, None, :], numeric[:, None, :]
    if _close(given, -numeric, tolerance):
        return f"{them} has the wrong sign"
    if not given.any():
        return f"{them} is missing: zero everywhere"
    for factor, words in FACTORS.items():
        if _close(given, factor * numeric, tolerance):
            return f"{them} is {words}"
    return "not a sign, a transpose, an exchange or a factor: derive that entry again"
