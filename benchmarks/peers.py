"""The EKFs of other packages, on the state and the data of ours; each is optional.

They are given a complete map, and then each step's motion and observations, as the texts' filters
are. Their own classes do the work: what is here only hands them the data.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from textbook_filters import POSE, moved, stacked

from ekfslam.geometry import Array
from ekfslam.observations import Sightings


class RoboticsToolbox:
    """``roboticstoolbox.EKF`` of Corke, which takes one observation at a step.

    Its ``step`` asks a vehicle for the odometry and a sensor for a reading. Both are answered from
    the data here: the first observation of a step comes with the motion, the others with none. Map
    and pose are estimated, the Joseph form and the history are off. The models are the package's,
    but for that of the motion, which has two noises there and three here.
    """

    def __init__(self, mean: Array, covariance: Array) -> None:
        import roboticstoolbox as rtb

        class Told(rtb.Bicycle):
            """A vehicle that moves as it is told: by body increments."""

            def step(self, *args: Any, **options: Any) -> Array:
                return self.delta

            def f(self, x: Array, odo: Array, v: Any = None) -> Array:
                after = np.array(x)
                moved(after, odo)
                return after

            def Fx(self, x: Array, odo: Array) -> Array:
                return moved(np.array(x), odo)[0]

            def Fv(self, x: Array, odo: Array) -> Array:
                return moved(np.array(x), odo)[1]

        class Showing(rtb.RangeBearingSensor):
            """A sensor that reads what it is shown."""

            def reading(self) -> tuple[Array | None, int | None]:
                return self.shown

        self._robot = Told()
        landmarks = (len(mean) - POSE) // 2
        world = rtb.LandmarkMap(mean[POSE:].reshape(-1, 2).T.copy(), workspace=100)
        self._sensor = Showing(self._robot, world)
        self._ekf = rtb.EKF(
            robot=(self._robot, np.eye(2)),
            sensor=(self._sensor, np.eye(2)),
            P0=np.eye(POSE),
            joseph=False,
            animate=False,
            history=False,
        )
        self._ekf._x_est, self._ekf._P_est = mean.copy(), covariance.copy()
        self._ekf._landmarks = {index: [index, 1] for index in range(landmarks)}

    def step(self, delta: Array, Q: Array, seen: Sightings) -> None:
        """See `textbook_filters.Textbook.step`."""
        readings = list(zip(seen.values, seen.landmark.tolist(), seen.covariance, strict=True))
        self._robot.delta, self._ekf._V_est = delta, Q
        for value, landmark, noise in readings or [(None, None, None)]:
            self._sensor.shown, self._ekf._W_est = (value, landmark), noise
            self._ekf.step()
            self._robot.delta, self._ekf._V_est = np.zeros(POSE), np.zeros((POSE, POSE))

    @property
    def mean(self) -> Array:
        """Pose and landmarks."""
        return self._ekf._x_est

    @property
    def covariance(self) -> Array:
        """Of the mean."""
        return self._ekf._P_est


class FilterPy:
    """``filterpy.kalman.ExtendedKalmanFilter`` of Labbe, with all observations of a step at once.

    It is a filter for any state: its products are dense and its correction is the Joseph form.
    """

    def __init__(self, mean: Array, covariance: Array) -> None:
        from filterpy.kalman import ExtendedKalmanFilter

        class Odometry(ExtendedKalmanFilter):
            """Moves by a body increment; the documentation says to override this for that."""

            def predict_x(self, u: Array) -> None:
                moved(self.x, u)

        self._ekf = Odometry(len(mean), 2)
        self._ekf.x, self._ekf.P = mean.copy(), covariance.copy()
        self._ekf.Q = np.zeros_like(covariance)

    def step(self, delta: Array, Q: Array, seen: Sightings) -> None:
        """See `textbook_filters.Textbook.step`."""
        ekf = self._ekf
        ekf.F[:POSE, :POSE], G = moved(ekf.x.copy(), delta)
        ekf.Q[:POSE, :POSE] = G @ Q @ G.T
        ekf.predict(delta)
        if len(seen.landmark) == 0:
            return
        columns, H, innovation, R = stacked(ekf.x, seen.landmark, seen.values, seen.covariance)
        dense = np.zeros((len(H), len(ekf.x)))
        dense[:, columns] = H
        ekf.update(innovation, lambda x: dense, lambda x: np.zeros(len(H)), R)

    @property
    def mean(self) -> Array:
        """Pose and landmarks."""
        return self._ekf.x

    @property
    def covariance(self) -> Array:
        """Of the mean."""
        return self._ekf.P
