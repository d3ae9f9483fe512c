"""Sensors as views of a point in their own frame.

A sensor is mounted on the body (mount pose), reports something of a point in its frame (range and
bearing, x and y, bearing alone, or range alone), sees part of the plane, and has noise. The direct
and the inverse model and all Jacobians follow by the chain rule from `ekfslam.geometry`.

Range-bearing and xy are full observations: they determine a point. Bearing and range are partial
ones (Solà, 2.3.5), with no inverse without a prior; see `ekfslam.models.landmarks`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.checks import checked_array, checked_covariance, checked_number
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.geometry import Array


def _polar(point: Array) -> Array:
    return np.stack(
        [np.hypot(point[..., 0], point[..., 1]), np.arctan2(point[..., 1], point[..., 0])], axis=-1
    )


def _polar_jacobian(point: Array) -> Array:
    """d(range, bearing) / d point = [x/r, y/r; -y/r^2, x/r^2] (Solà, C.1.2)."""
    x, y = point[..., 0], point[..., 1]
    r = np.hypot(x, y)
    return np.stack(
        [np.stack([x / r, y / r], axis=-1), np.stack([-y / r**2, x / r**2], axis=-1)], axis=-2
    )


def _rectangular(value: Array) -> Array:
    r, b = value[..., 0], value[..., 1]
    return np.stack([r * np.cos(b), r * np.sin(b)], axis=-1)


def _rectangular_jacobian(value: Array) -> Array:
    """d point / d(range, bearing) = [cos b, -r sin b; sin b, r cos b] (Solà, C.1.3)."""
    r, b = value[..., 0], value[..., 1]
    c, s = np.cos(b), np.sin(b)
    return np.stack([np.stack([c, -r * s], axis=-1), np.stack([s, r * c], axis=-1)], axis=-2)


def _identity_jacobian(value: Array) -> Array:
    return np.broadcast_to(np.eye(2), (*value.shape[:-1], 2, 2))


class View(NamedTuple):
    """What a kind of sensor reports of a point in its frame, with its inverse and Jacobians.

    A partial view has no inverse.
    """

    code: int  # how the compiled kernels name it
    names: tuple[str, ...]
    angular: tuple[bool, ...]
    project: Callable[[Array], Array]
    project_jacobian: Callable[[Array], Array]
    back_project: Callable[[Array], Array] | None = None
    back_project_jacobian: Callable[[Array], Array] | None = None

    @property
    def size(self) -> int:
        """Numbers that a sighting reports: 2 of a full view, 1 of a partial one."""
        return len(self.names)


RANGE_BEARING, XY, BEARING, RANGE = 0, 1, 2, 3

VIEWS: Mapping[str, View] = {
    "range-bearing": View(
        RANGE_BEARING,
        ("range", "bearing"),
        (False, True),
        _polar,
        _polar_jacobian,
        _rectangular,
        _rectangular_jacobian,
    ),
    "xy": View(
        XY,
        ("x", "y"),
        (False, False),
        np.asarray,
        _identity_jacobian,
        np.asarray,
        _identity_jacobian,
    ),
    "bearing": View(
        BEARING,
        ("bearing",),
        (True,),
        lambda point: _polar(point)[..., 1:],
        lambda point: _polar_jacobian(point)[..., 1:, :],
    ),
    "range": View(
        RANGE,
        ("range",),
        (False,),
        lambda point: _polar(point)[..., :1],
        lambda point: _polar_jacobian(point)[..., :1, :],
    ),
}


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor on the body.

    Parameters
    ----------
    kind : {"range-bearing", "xy", "bearing", "range"}
        What it reports of a point: (range [m], bearing [rad] counter-clockwise from its x axis),
        (x, y) [m] in its frame, (bearing,) or (range,). In docstrings d is the number of values:
        2, or 1 for a partial view.
    covariance : (d, d) array_like
        Noise of one measurement, correlated or not, in the units of the values squared.
    mount : (3,) array_like
        Pose of the sensor in the body frame (dx, dy, heading) [m, m, rad].
    min_range, max_range : float
        Distances [m] between which it sees a point.
    field_of_view : float
        Total opening angle [rad], centred on its x axis; 2 pi sees all around.
    range_growth : float
        Further standard deviation of the range per metre of range (of sensors that report one):
        ``var(r) = covariance[0, 0] + (range_growth r)^2``.
    name : str

    Raises
    ------
    InputError, UnknownNameError
        For a value that makes no sense; the message names it.
    """

    kind: str
    covariance: Array
    mount: Array = field(default_factory=lambda: np.zeros(3))
    min_range: float = 0.0
    max_range: float = float("inf")
    field_of_view: float = geo.TAU
    range_growth: float = 0.0
    name: str = "sensor"

    def __post_init__(self) -> None:
        if self.kind not in VIEWS:
            raise UnknownNameError("sensor kind", self.kind, VIEWS)
        object.__setattr__(
            self,
            "covariance",
            checked_covariance(self.covariance, self.view.size, f"covariance of {self.name}"),
        )
        mount = checked_array(self.mount, float, (None,), f"mount of {self.name}")
        if mount.shape != (3,) or not np.isfinite(mount).all():
            raise InputError(f"mount of {self.name} must be three finite numbers (dx, dy, heading)")
        object.__setattr__(self, "mount", mount)
        for name in ("min_range", "max_range", "field_of_view", "range_growth"):
            checked_number(getattr(self, name), f"{name} of {self.name}")
        if not 0 <= self.min_range <= self.max_range:
            raise InputError(
                f"{self.name} needs 0 <= min_range <= max_range, "
                f"got {self.min_range} and {self.max_range}"
            )
        if not 0 < self.field_of_view <= geo.TAU + 1e-12:
            raise InputError(f"field_of_view of {self.name} must be in (0, 2 pi] [rad]")
        if not 0 <= self.range_growth < np.inf:
            raise InputError(f"range_growth of {self.name} must be non-negative")
        if self.range_growth > 0 and "range" not in self.view.names:
            raise InputError(f"range_growth of {self.name} needs a range, not {self.kind!r}")

    @property
    def view(self) -> View:
        """What it reports of a point."""
        return VIEWS[self.kind]

    @property
    def limits(self) -> tuple[float, float, float]:
        """Where it sees: minimum and maximum range [m], half the field of view [rad]."""
        return self.min_range, self.max_range, 0.5 * self.field_of_view

    def observe(self, poses: Any, points: Any) -> tuple[Array, Array, Array]:
        """Direct model h(R, S, L) with Jacobians (Solà, Eqs. 24 and 63; Ciatto, 2.3).

        Parameters
        ----------
        poses : (..., 3) array_like
            Robot poses in the world.
        points : (..., 2) array_like
            Landmarks in the world [m].

        Returns
        -------
        values : (..., d) ndarray
        wrt_pose : (..., d, 3) ndarray
        wrt_point : (..., d, 2) ndarray
        """
        poses = np.asarray(poses, dtype=float)
        frame = geo.compose(poses, self.mount)
        frame_wrt_pose, _ = geo.compose_jacobians(poses, self.mount)
        local = geo.to_frame(frame, points)
        local_wrt_frame, local_wrt_point = geo.to_frame_jacobians(frame, points)
        view = self.view.project_jacobian(local)
        return (
            self.view.project(local),
            view @ local_wrt_frame @ frame_wrt_pose,
            view @ local_wrt_point,
        )

    def locate(self, poses: Any, values: Any) -> tuple[Array, Array, Array]:
        """Inverse model g(R, S, y) with Jacobians (Solà, Eqs. 31 to 34; Ciatto, Eq. 2.3).

        Parameters
        ----------
        poses : (..., 3) array_like
        values : (..., 2) array_like
            Measurements.

        Returns
        -------
        points : (..., 2) ndarray
            Landmarks in the world [m].
        wrt_pose : (..., 2, 3) ndarray
        wrt_value : (..., 2, 2) ndarray

        Raises
        ------
        UnsupportedError
            For a partial view, which does not determine a point.
        """
        back_project, back_project_jacobian = (
            self.view.back_project,
            self.view.back_project_jacobian,
        )
        if back_project is None or back_project_jacobian is None:
            raise UnsupportedError(f"one {self.kind} of {self.name} does not determine a point")
        poses, values = np.asarray(poses, dtype=float), np.asarray(values, dtype=float)
        frame = geo.compose(poses, self.mount)
        frame_wrt_pose, _ = geo.compose_jacobians(poses, self.mount)
        local = back_project(values)
        point_wrt_frame, point_wrt_local = geo.from_frame_jacobians(frame, local)
        return (
            geo.from_frame(frame, local),
            point_wrt_frame @ frame_wrt_pose,
            point_wrt_local @ back_project_jacobian(values),
        )

    def difference(self, values: Any, expected: Any) -> Array:
        """Innovation ``values - expected`` with angles wrapped, (..., d)."""
        innovation = np.asarray(values, dtype=float) - np.asarray(expected, dtype=float)
        return np.where(self.view.angular, geo.wrap(innovation), innovation)

    def covariances(self, values: Any) -> Array:
        """Noise of measurements, (..., d, d); a growing range noise is taken at the value's range.

        Parameters
        ----------
        values : (..., d) array_like
        """
        values = np.asarray(values, dtype=float)
        noise = np.broadcast_to(
            self.covariance, (*values.shape[:-1], *self.covariance.shape)
        ).copy()
        if self.range_growth:
            noise[..., 0, 0] += (self.range_growth * values[..., 0]) ** 2
        return noise

    def sees(self, poses: Any, points: Any) -> np.ndarray:
        """Whether points are inside range and field of view, (...) of bool.

        Parameters
        ----------
        poses : (..., 3) array_like
        points : (..., 2) array_like
        """
        local = geo.to_frame(geo.compose(poses, self.mount), points)
        distance, bearing = _polar(local)[..., 0], _polar(local)[..., 1]
        return (
            (distance >= self.min_range)
            & (distance <= self.max_range)
            & (np.abs(bearing) <= 0.5 * self.field_of_view)
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for TOML and JSON."""
        return {
            "kind": self.kind,
            "covariance": self.covariance.tolist(),
            "mount": self.mount.tolist(),
            "min_range": self.min_range,
            "max_range": self.max_range,
            "field_of_view": self.field_of_view,
            "range_growth": self.range_growth,
            "name": self.name,
        }

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sensor) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash((self.kind, self.name))
