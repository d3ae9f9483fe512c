"""Sightings as flat columns: as a dataset holds them, and as an estimator reads them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ekfslam.checks import check_finite, checked_array, is_covariance
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.sensors import BEARING, RANGE, RANGE_BEARING, VIEWS, Sensor

NO_LANDMARK = -1
FARTHEST = 6.0  # sigmas that noise may take a short range below zero
WIDTH = 2  # columns of values: the most that a sensor reports


@dataclass(frozen=True, eq=False)
class Observations:
    """Sightings as flat columns, one row each, in order of step.

    Parameters
    ----------
    step : (M,) array_like of int
        Pose at which the sighting was made, not decreasing.
    values : (M, 2) array_like
        What the sensor reports, in the order of its kind. A sensor that reports one number has it
        in the first column and 0 in the second; where all do, (M, 1) may be given.
    landmark : (M,) array_like of int, optional
        Identity of the landmark, -1 where not known (the default).
    sensor, robot : (M,) array_like of int, optional
        Indices into the dataset's sensors and robots; 0 by default.
    time : (M,) array_like, optional
        [s]; the step's time by default.
    covariance : (M, 2, 2) array_like, optional
        Noise of each row, where the set gives it; the sensor's by default. Of a single number it is
        ``[[variance, 0], [0, 0]]``.
    observed_robot : (M,) array_like of int, optional
        Robot seen instead of a landmark, -1 for none.
    descriptor : (M,) array_like, optional
        Such as a trunk diameter [m]; NaN where missing.
    """

    step: np.ndarray
    values: Array
    landmark: np.ndarray = None  # type: ignore[assignment]
    sensor: np.ndarray = None  # type: ignore[assignment]
    robot: np.ndarray = None  # type: ignore[assignment]
    time: Array | None = None
    covariance: Array | None = None
    observed_robot: np.ndarray | None = None
    descriptor: Array | None = None

    def __post_init__(self) -> None:
        step = checked_array(self.step, np.int64, (None,), "observations.step")
        count = len(step)
        if np.shape(self.values) == (count, 1):
            object.__setattr__(self, "values", padded(np.asarray(self.values)))
        columns: dict[str, tuple[Any, Any, tuple[int | None, ...]]] = {
            "step": (step, np.int64, (count,)),
            "values": (self.values, float, (count, 2)),
            "landmark": (_default(self.landmark, count, NO_LANDMARK), np.int64, (count,)),
            "sensor": (_default(self.sensor, count, 0), np.int64, (count,)),
            "robot": (_default(self.robot, count, 0), np.int64, (count,)),
        }
        optional: dict[str, tuple[Any, tuple[int | None, ...]]] = {
            "time": (float, (count,)),
            "covariance": (float, (count, 2, 2)),
            "observed_robot": (np.int64, (count,)),
            "descriptor": (float, (count,)),
        }
        for name, (dtype, shape) in optional.items():
            if getattr(self, name) is not None:
                columns[name] = (getattr(self, name), dtype, shape)
        for name, (value, dtype, shape) in columns.items():
            object.__setattr__(
                self, name, checked_array(value, dtype, shape, f"observations.{name}")
            )
        for name in ("values", "time", "covariance"):
            if getattr(self, name) is not None:
                check_finite(getattr(self, name), f"observations.{name}")

    def __len__(self) -> int:
        return len(self.step)


def padded(array: Array, axes: int = 1) -> Array:
    """An array whose last `axes` axes are made `WIDTH` long with zeros."""
    missing = WIDTH - array.shape[-1]
    return np.pad(array, [(0, 0)] * (array.ndim - axes) + [(0, missing)] * axes)


def _default(column: Any, count: int, value: int) -> Any:
    return np.full(count, value) if column is None else column


class Sightings(NamedTuple):
    """Observations as an estimator reads them: what the sensors say has been looked up.

    Attributes
    ----------
    kind : (m,) ndarray of int
        Code of the view, `ekfslam.models.sensors.VIEWS`.
    mount : (m, 3) ndarray
        Pose of the sensor on the body.
    values : (m, 2) ndarray
    covariance : (m, 2, 2) ndarray
        Noise of each measurement.
    landmark : (m,) ndarray of int
        Identity, -1 where not known.
    look : (m,) ndarray of int
        Equal in neighbouring rows that one sensor saw at one instant: a landmark is in a look at
        most once.
    robot : (m,) ndarray of int
        Which robot's sensor it is.
    target : (m,) ndarray of int
        Robot that is seen instead of a landmark, -1 for none.
    limits : (m, 3) ndarray
        Of the sensor: minimum range, maximum range [m], half the field of view [rad].
    descriptor : (m,) ndarray
        NaN where there is none.
    """

    kind: np.ndarray
    mount: Array
    values: Array
    covariance: Array
    landmark: np.ndarray
    look: np.ndarray
    robot: np.ndarray
    target: np.ndarray
    limits: Array
    descriptor: Array

    @classmethod
    def of(
        cls,
        sensor: Sensor,
        values: Any,
        landmark: Any = None,
        robot: int = 0,
        observed_robot: Any = None,
        descriptor: Any = None,
    ) -> Sightings:
        """Sightings of one sensor, for use step by step.

        Parameters
        ----------
        sensor : Sensor
        values : (m, d) array_like
            d numbers each, as the sensor reports them.
        landmark : (m,) array_like of int, optional
            Identities, -1 where not known (the default).
        robot : int
            Whose sensor it is.
        observed_robot : (m,) array_like of int, optional
            Robots that are seen instead of landmarks, -1 for none.
        descriptor : (m,) array_like, optional
        """
        values = checked_array(values, float, (None, sensor.view.size), "values")
        check_finite(values, "values")
        count = len(values)
        columns = {
            name: checked_array(_default(column, count, NO_LANDMARK), np.int64, (count,), name)
            for name, column in (("landmark", landmark), ("observed_robot", observed_robot))
        }
        described = np.full(count, np.nan) if descriptor is None else descriptor
        return cls(
            np.full(count, sensor.view.code),
            np.broadcast_to(sensor.mount, (count, 3)).copy(),
            padded(values),
            padded(sensor.covariances(values), axes=2),
            columns["landmark"],
            np.zeros(count, dtype=np.int64),
            np.full(count, robot),
            columns["observed_robot"],
            np.broadcast_to(sensor.limits, (count, 3)).copy(),
            checked_array(described, float, (count,), "descriptor"),
        )

    def checked(self) -> Sightings:
        """Private contiguous copies of the columns, after a look at what they hold.

        Raises
        ------
        InputError
            If a column has the wrong shape or a value that makes no sense; names it.
        """
        count = len(self.values)
        kind = checked_array(self.kind, np.int64, (count,), "kind")
        mount = checked_array(self.mount, float, (count, 3), "mount")
        values = checked_array(self.values, float, (count, 2), "values")
        covariance = checked_array(self.covariance, float, (count, 2, 2), "covariance")
        landmark = checked_array(self.landmark, np.int64, (count,), "landmark")
        look = checked_array(self.look, np.int64, (count,), "look")
        robot = checked_array(self.robot, np.int64, (count,), "robot")
        target = checked_array(self.target, np.int64, (count,), "observed_robot")
        limits = checked_array(self.limits, float, (count, 3), "limits")
        descriptor = checked_array(self.descriptor, float, (count,), "descriptor")
        for name, column in (("mount", mount), ("values", values), ("covariance", covariance)):
            check_finite(column, name)
        if not np.isin(kind, [view.code for view in VIEWS.values()]).all():
            raise InputError("kind holds a code of no view")
        least = np.where(kind == RANGE, 0.0, -FARTHEST * np.sqrt(np.abs(covariance[:, 0, 0])))
        if (np.isin(kind, [RANGE_BEARING, RANGE]) & (values[:, 0] < least)).any():
            raise InputError("values hold a negative range")
        if (np.isin(kind, [BEARING, RANGE]) & (values[:, 1] != 0)).any():
            raise InputError("values of a sensor that reports one number hold 0 in the second")
        if (robot < 0).any() or (target < NO_LANDMARK).any():
            raise InputError("robot must not be negative, nor observed_robot below -1")
        if (target == robot).any():
            raise InputError("a robot cannot see itself")
        if ((target >= 0) & (landmark >= 0)).any():
            raise InputError("a sighting shows a robot and a landmark at once")
        if (landmark < NO_LANDMARK).any():
            raise InputError(f"landmark must not be below {NO_LANDMARK}, which stands for unknown")
        if not is_covariance(covariance).all():
            raise InputError("covariance holds a matrix that is not positive semi-definite")
        same = np.column_stack([kind, mount, robot, limits])
        together = np.diff(look) == 0
        if (same[1:] != same[:-1])[together].any():
            raise InputError(
                "rows of one look must be of one sensor of one robot: observe them one after "
                "another, or give each sensor a look of its own"
            )
        known = (landmark >= 0) | (target >= 0)
        pairs = np.column_stack([landmark, target, look])[known]
        if len(np.unique(pairs, axis=0)) < len(pairs):
            raise InputError("one sensor cannot see the same thing twice at the same instant")
        first = (kind, mount, values, covariance, landmark, look)
        columns = (*first, robot, target, limits, descriptor)
        return Sightings(*(column.copy() for column in columns))

    def rows(self, start: int, stop: int) -> Sightings:
        """The rows from start to before stop, as views."""
        return Sightings(*(column[start:stop] for column in self))
