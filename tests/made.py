"""Small datasets made by hand, for the tests of what a dataset refuses and of what it holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ekfslam.dataset import Dataset, Robot
from ekfslam.errors import InputError
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations

NOISE = np.diag([0.01, 0.0004])
MOTION = MotionModel("odometry", covariance=1e-4 * np.eye(3))


def make(times=(0.0, 1.0, 2.0), sensors=None, robots=None, **columns):
    """Two steps straight ahead and one sighting, unless told otherwise."""
    steps = len(times) - 1
    robot = Robot(MOTION, np.tile([1.0, 0.0, 0.0], (steps, 1)))
    columns = {"step": [1], "values": [[2.0, 0.1]], **columns}
    return Dataset(
        "made",
        (robot,) if robots is None else robots,
        times,
        (Sensor("range-bearing", NOISE, name="laser"),) if sensors is None else sensors,
        Observations(**columns),
    )


def twice(**columns):
    """Two sightings of landmark 4."""
    return make(
        **{"step": [1, 1], "values": [[2.0, 0.1], [2.1, 0.2]], "landmark": [4, 4]} | columns
    )


def pair(**columns):
    """Two robots, of which one sees a landmark and then the other robot, unless told otherwise."""
    robot = Robot(MOTION, np.tile([1.0, 0.0, 0.0], (2, 1)), name="one")
    seen = {
        "step": [1, 1],
        "values": [[2.0, 0.1], [1.0, -0.2]],
        "landmark": [4, -1],
        "observed_robot": [-1, 1],
    }
    return make(robots=(robot, replace(robot, name="other")), **{**seen, **columns})


def assert_refused(message, build, *arguments, **settings):
    with pytest.raises(InputError, match=message) as caught:
        build(*arguments, **settings)
    assert "\n" not in str(caught.value)
