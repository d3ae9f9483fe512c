"""What a scenario says of each robot and of each sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ekfslam.checks import frozen
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.robots import Prior


@dataclass(frozen=True, eq=False)
class RobotPlan:
    """A robot: where it starts, what it is commanded, how it moves.

    Parameters
    ----------
    start : (3,) array_like
        True first pose [m, m, rad].
    controls : (K, m) array_like
        Commands, in the columns of the motion model.
    motion : MotionModel
        With the noise and the slip that are both simulated and stated in the dataset.
    prior : Prior, optional
        What the dataset states of the first pose; exactly the true start by default.
    draw_prior : bool
        Draw the prior's mean from a Gaussian with its covariance about its mean.
    name : str

    Raises
    ------
    InputError
        For values that make no sense; the message names them.
    """

    start: Array
    controls: Array
    motion: MotionModel
    prior: Prior | None = None
    draw_prior: bool = False
    name: str = "robot"

    def __post_init__(self) -> None:
        names = self.motion.control_names
        start, controls = np.array(self.start, float), np.array(self.controls, float)
        if start.shape != (3,):
            raise InputError("start must be a pose (x, y, theta)")
        if controls.ndim != 2 or controls.shape[1] != len(names):
            columns = ", ".join(names) or "a row each and no column"
            raise InputError(f"controls of {self.motion.kind!r} need {columns}")
        for name, array in (("start", start), ("controls", controls)):
            if not np.isfinite(array).all():
                raise InputError(f"{name} holds NaN or infinite values")
            object.__setattr__(self, name, frozen(array))

    @property
    def times(self) -> Array | None:
        """Times of the poses [s], (K + 1,), where the controls have a dt."""
        names = self.motion.control_names
        if "dt" not in names:
            return None
        return np.concatenate([[0.0], np.cumsum(self.controls[:, names.index("dt")])])

    @property
    def length(self) -> float:
        """Length of the commanded path [m]."""
        return float(np.hypot(*self.motion.increment(self.controls)[0][:, :2].T).sum())


@dataclass(frozen=True, eq=False)
class SensorPlan(Sensor):
    """A sensor, who carries it, and when and at what it looks.

    Parameters
    ----------
    robots : tuple of str, optional
        Names of the robots that carry one, all by default.
    every, offset : int
        It looks at the poses ``offset``, ``offset + every``, and so on, of those at which the
        scenario lets look at all.
    mutual : bool
        Whether it sees the other robots, too: the origin of their body frame, where that is inside
        its range and field of view.

    The other parameters are those of `ekfslam.models.sensors.Sensor`.

    Raises
    ------
    InputError, UnknownNameError
        For a value that makes no sense; the message names it.
    """

    robots: tuple[str, ...] | None = None
    every: int = 1
    offset: int = 0
    mutual: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, least in (("every", 1), ("offset", 0)):
            if getattr(self, name) < least:
                raise InputError(
                    f"{name} of {self.name} must be at least {least}, got {getattr(self, name)}"
                )

    def carried_by(self, robot: RobotPlan) -> bool:
        """Whether a robot has one."""
        return self.robots is None or robot.name in self.robots

    def looks(self, steps: np.ndarray) -> np.ndarray:
        """Whether it looks at poses of these numbers, (...) of bool."""
        return (steps >= self.offset) & ((steps - self.offset) % self.every == 0)

    def stated(self, scale: float) -> Sensor:
        """The sensor as a dataset states it, with every standard deviation scaled."""
        return Sensor(
            self.kind,
            scale**2 * self.covariance,
            self.mount,
            self.min_range,
            self.max_range,
            self.field_of_view,
            scale * self.range_growth,
            self.name,
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for TOML and JSON."""
        names = ("robots", "every", "offset", "mutual")
        return super().to_dict() | {name: getattr(self, name) for name in names}
