"""Models that are not in the house: a motion of one's own, and a sensor that is joined to a view.

A motion model of one's own says what body increment a control commands; all else, noise, slip,
simulation, estimation, is as of the kinds in `ekfslam.models.motion`. A sensor that reports
something else of a point in its frame is joined to one of the views of `ekfslam.models.sensors` by
mapping what it reports to what the view does, with the covariance to first order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ekfslam.checks import (
    check_finite,
    checked_array,
    checked_covariance,
    checked_number,
    is_covariance,
)
from ekfslam.differences import central_differences
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.geometry import Array, congruence, wrap
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import VIEWS
from ekfslam.observations import padded

EXACT = "dt"  # the control that carries no noise
HEADING = (False, False, True)  # which numbers of an increment are angles


@dataclass(frozen=True, eq=False)
class OwnMotion(MotionModel):
    """A motion model from a function.

    Parameters
    ----------
    kind : str
        What it is called.
    covariance : (n, n) array_like or callable
        Of the n noisy controls, in their units squared; or a function of a control ``u -> (n, n)``,
        for noise that grows with speed.
    controls : sequence of str
        Names of the m controls. All are noisy but for one called ``dt``, a time [s], which comes
        last and gives a scenario its times.
    function : callable
        ``u -> delta``: the body increment (3,) [m, m, rad] of a control (m,), in the frame of the
        pose that it starts from.
    jacobian : callable, optional
        ``u -> d delta / d u``, (3, m). Central differences of `function` by default, which agree
        with it to some 1e-9.
    slip : float
        As of `MotionModel` [m].

    Raises
    ------
    InputError
        For values that make no sense, here or where a function returns them; names them.

    Notes
    -----
    The functions are called once for each control of a run. Files hold no functions: a dataset is
    saved with the increments that they make and the covariances of these, so that it loads as one
    of kind ``odometry`` with the same estimates. Such a robot cannot have a `mixture`, which would
    be lost there.
    """

    kind: str
    covariance: Any
    controls: Sequence[str] = ()
    function: Callable[[Array], Any] = None  # type: ignore[assignment]
    jacobian: Callable[[Array], Any] | None = None
    slip: float = 0.0
    proportional: None = field(init=False, default=None)
    width: None = field(init=False, default=None)
    wheelbase: None = field(init=False, default=None)
    mixture: None = field(init=False, default=None)

    def __post_init__(self) -> None:
        if isinstance(self.controls, str) or not self.controls:
            raise InputError(
                f"controls of {self.kind!r} must be their names, got {self.controls!r}"
            )
        object.__setattr__(self, "controls", tuple(self.controls))
        if len(set(self.controls)) < len(self.controls):
            raise InputError(f"controls of {self.kind!r} need names of their own")
        if EXACT in self.controls[:-1] or self.controls == (EXACT,):
            raise InputError(f"controls of {self.kind!r}: dt comes last, after noisy ones")
        if not callable(self.function):
            raise InputError(f"motion model {self.kind!r} needs a function u -> (dx, dy, dtheta)")
        if not 0 <= checked_number(self.slip, "slip") < np.inf:
            raise InputError(f"slip must be a non-negative length [m], got {self.slip}")
        if not callable(self.covariance):
            checked = checked_covariance(self.covariance, self.noises, "covariance")
            object.__setattr__(self, "covariance", checked)

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the columns of a control."""
        return tuple(self.controls)

    @property
    def noises(self) -> int:
        """How many controls carry noise."""
        return len(self.controls) - (self.controls[-1] == EXACT)

    @property
    def noisy_controls(self) -> int:
        """How many of the first control columns carry noise."""
        return self.noises

    def increment(self, controls: Any) -> tuple[Array, Array]:
        """Body increments (K, 3) and their Jacobians (K, 3, m); see `MotionModel.increment`."""
        controls, whose = self._checked(controls), f"of motion model {self.kind!r}"

        def increments(rows: Array) -> Array:
            return _each(self.function, rows, (3,), f"function {whose}")

        if self.jacobian is None:
            return increments(controls), _slopes(increments, controls, HEADING)
        shape = (3, len(self.controls))
        return increments(controls), _each(self.jacobian, controls, shape, f"jacobian {whose}")

    def control_covariances(self, controls: Any) -> Array:
        """Covariance of the noisy controls, (K, n, n)."""
        if not callable(self.covariance):
            return super().control_covariances(controls)
        controls, name = self._checked(controls), f"covariance of motion model {self.kind!r}"
        noise = _each(self.covariance, controls, (self.noises, self.noises), name)
        for row in np.flatnonzero(~is_covariance(noise))[:1]:
            raise InputError(f"{name} is not positive semi-definite at {controls[row].tolist()}")
        return noise

    def scaled(self, factor: float) -> OwnMotion:
        """The same model with every standard deviation of its noise scaled."""
        noise = self.covariance
        return replace(
            self,
            slip=factor * self.slip,
            covariance=(lambda u: factor**2 * np.asarray(noise(u)))
            if callable(noise)
            else factor**2 * noise,
        )

    def to_dict(self) -> dict[str, Any]:
        """What there is to say of it in plain values: functions by name."""
        noise = self.covariance
        return {
            "kind": self.kind,
            "slip": self.slip,
            "controls": list(self.controls),
            "function": getattr(self.function, "__qualname__", repr(self.function)),
            "covariance": getattr(noise, "__qualname__", repr(noise))
            if callable(noise)
            else noise.tolist(),
        }

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, OwnMotion)
            and self.to_dict() == other.to_dict()
            and (self.function, self.jacobian) == (other.function, other.jacobian)
        )

    def __hash__(self) -> int:
        return hash(self.kind)


def propagated(
    kind: str,
    function: Callable[[Array], Any],
    values: Any,
    covariance: Any,
    jacobian: Callable[[Array], Any] | None = None,
) -> tuple[Array, Array]:
    """Measurements of a sensor of one's own as those of a view, with their covariance ``J R J'``.

    To first order: that the mapped noise is skewed, and its mean off by the second order, is
    neglected. Whether that is good enough is measured by the NIS of a simulation.

    Parameters
    ----------
    kind : {"range-bearing", "xy", "bearing", "range"}
        Of the view, as of `Sensor`.
    function : callable
        Maps what the sensor reports, (m,), to what the view does, (d,), in its units.
    values : (n, m) array_like
        Measurements.
    covariance : (m, m) or (n, m, m) array_like
        Their noise R.
    jacobian : callable, optional
        Derivative of the function at a measurement, (d, m); central differences by default.

    Returns
    -------
    values : (n, d) ndarray
        For the column `values` of `Observations`.
    covariances : (n, 2, 2) ndarray
        For its column `covariance`; zeros beyond d.

    Raises
    ------
    UnknownNameError
        For an unknown kind.
    InputError
        For arrays of the wrong shape, or a function that returns such; names it.
    """
    if kind not in VIEWS:
        raise UnknownNameError("sensor kind", kind, VIEWS)
    view = VIEWS[kind]
    values = checked_array(values, float, (None, None), "values")
    check_finite(values, "values")
    count, size = values.shape
    given = np.shape(covariance)
    if given not in ((size, size), (count, size, size)):
        raise InputError(
            f"covariance must have shape ({size}, {size}) or ({count}, {size}, {size}), got {given}"
        )
    noise = np.array(covariance, dtype=float).reshape(-1, size, size)
    check_finite(noise, "covariance")
    for row in np.flatnonzero(~is_covariance(noise))[:1]:
        raise InputError(f"covariance is not positive semi-definite in row {row}")

    def mapped(rows: Array) -> Array:
        return _each(function, rows, (view.size,), "function")

    if jacobian is None:
        slopes = _slopes(mapped, values, view.angular)
    else:
        slopes = _each(jacobian, values, (view.size, size), "jacobian")
    return mapped(values), padded(congruence(slopes, noise), axes=2)


def _each(
    function: Callable[[Array], Any], rows: Array, shape: tuple[int, ...], name: str
) -> Array:
    """A function of one row for each of many."""
    made = np.empty((len(rows), *shape))
    for number, row in enumerate(rows):
        value = np.asarray(function(row.copy()), dtype=float)
        if value.shape != shape:
            raise InputError(f"{name} must return an array of shape {shape}, got {value.shape}")
        if not np.isfinite(value).all():
            raise InputError(f"{name} returns {value.tolist()} at {row.tolist()}")
        made[number] = value
    return made


def _slopes(mapped: Callable[[Array], Array], rows: Array, angular: Sequence[bool]) -> Array:
    """Derivative at each row by central differences, angles wrapped."""
    here = mapped(rows)

    def away(moved: Array) -> Array:
        apart = mapped(moved) - here
        return np.where(angular, wrap(apart), apart)

    return central_differences(away, rows)
