"""A run at a moment: its first steps as a run of their own, and what is seen as lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import ekfslam
from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.moments import sight_lines, until
from ekfslam.observations import Observations
from ekfslam.robots import Robot


@pytest.fixture(scope="module")
def data():
    return ekfslam.simulate("cloister", seed=3)


@pytest.mark.parametrize("step", [0, 1, 57, 200])
def test_an_online_filter_says_of_the_first_steps_what_it_said_then(data, step):
    """A law of every filter: what comes later changes nothing of what was known before."""
    part = until(data, step)
    whole, short = ekfslam.estimate(data, "ekf"), ekfslam.estimate(part, "ekf")
    assert_array_equal(short.online.poses, whole.online.poses[: step + 1])
    assert_array_equal(short.online.covariances, whole.online.covariances[: step + 1])
    slam = ekfslam.EkfSlam(prior=data.prior)
    for k, entry in enumerate(data.steps()):
        slam.predict(entry.increment, entry.covariance)
        slam.observe(entry.observations)
        if k == step:
            break
    order = np.argsort(slam.landmarks.ids)
    assert_array_equal(np.sort(short.landmarks.ids), slam.landmarks.ids[order])
    mine = np.argsort(short.landmarks.ids)
    for name in ("positions", "covariances"):
        ours, theirs = getattr(short.landmarks, name), getattr(slam.landmarks, name)
        assert_allclose(ours[mine], theirs[order], rtol=0, atol=1e-12)


def test_every_column_is_cut_at_the_step():
    data = ekfslam.simulate("team", seed=1)
    part = until(data, 40)
    assert part.poses == 41
    assert_array_equal(part.times, data.times[:41])
    rows = data.observations.step <= 40
    for name in ("step", "values", "landmark", "sensor", "robot"):
        column = getattr(data.observations, name)
        assert_array_equal(getattr(part.observations, name), column[rows])
    for robot, whole in zip(part.robots, data.robots, strict=True):
        assert_array_equal(robot.truth, whole.truth[:41])
        assert_array_equal(robot.controls, whole.controls[:40])
    assert (part.observations.step == 40).any()


def test_the_last_step_is_the_whole_run(data):
    part = until(data, data.poses - 1)
    assert_array_equal(part.observations.values, data.observations.values)
    assert part.poses == data.poses


@pytest.mark.parametrize("step", [-1, 201])
def test_a_step_that_there_is_not(data, step):
    with pytest.raises(InputError, match=f"no step {step}: cloister has 0 to 200"):
        until(data, step)


# Lines ------------------------------------------------------------------------------------------

MOUNT = np.array([0.4, -0.3, 0.7])
POSE = np.array([[2.0, -1.0, 2.5]])
POINT = np.array([3.7, 2.2])


def seen(kind, size, **limits):
    """A sighting of the point without noise, from the pose."""
    sensor = Sensor(kind, 0.01 * np.eye(size), mount=MOUNT, **limits)
    value = sensor.observe(POSE[0], POINT)[0]
    robot = Robot(MotionModel("odometry", 0.01 * np.eye(3)), np.zeros((1, 3)))
    observations = Observations([1], np.atleast_2d(value), [0])
    return Dataset("one", (robot,), np.arange(2.0), (sensor,), observations)


@pytest.mark.parametrize(("kind", "size"), [("range-bearing", 2), ("xy", 2)])
def test_a_full_view_is_a_line_from_the_sensor_to_the_point(kind, size):
    (line,) = sight_lines(seen(kind, size), 1, POSE, far=50.0)
    assert_allclose(line, [geo.compose(POSE[0], MOUNT)[:2], POINT], atol=1e-12)


def test_a_bearing_is_a_ray_through_the_point():
    (ray,) = sight_lines(seen("bearing", 1), 1, POSE, far=50.0)
    along = ray[1] - ray[0]
    assert np.hypot(*along) == pytest.approx(50.0)
    toward = POINT - ray[0]
    assert_allclose(along / np.hypot(*along), toward / np.hypot(*toward), atol=1e-12)
    (short,) = sight_lines(seen("bearing", 1, max_range=7.0), 1, POSE, far=50.0)
    assert np.hypot(*(short[1] - short[0])) == pytest.approx(7.0)


def test_a_range_is_a_circle_on_which_the_point_is():
    (circle,) = sight_lines(seen("range", 1), 1, POSE, far=50.0)
    center = geo.compose(POSE[0], MOUNT)[:2]
    distance = np.hypot(*(POINT - center))
    assert_allclose(np.hypot(*(circle - center).T), distance, rtol=1e-12)
    assert_allclose(circle[0], circle[-1], atol=1e-12)


def test_each_robot_looks_from_its_own_pose():
    data = ekfslam.simulate("team", seed=1)
    poses = np.stack([robot.truth[40] for robot in data.robots])
    lines = sight_lines(data, 40, poses, far=50.0)
    rows = np.flatnonzero(data.observations.step == 40)
    assert len(lines) == len(rows) > 3
    for row, line in zip(rows, lines, strict=True):
        own = data.robots[data.observations.robot[row]].truth[40]
        mount = data.sensors[data.observations.sensor[row]].mount
        assert_allclose(line[0], geo.compose(own, mount)[:2], atol=1e-12)
    nothing = replace(data, observations=Observations([], np.zeros((0, 2))), true_landmark=None)
    assert sight_lines(nothing, 40, poses, far=50.0) == []
