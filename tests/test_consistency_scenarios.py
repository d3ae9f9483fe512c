"""The scenarios on which consistency is judged: their numbers, and what can be relied on."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.models.motion import MotionModel
from ekfslam.simulation import load_scenario, simulate
from ekfslam.simulation.paths import steered

NAMES = ("car-loop", "circle", "hard-loop", "heading-sweep", "loop-15", "loop-15-rb")


@cache
def drawn(name: str, seed: int = 0) -> Dataset:
    return simulate(name, seed=seed)


def from_the_robot(data: Dataset) -> np.ndarray:
    """True points in the robot's frame (K + 1, L, 2), without the package's geometry."""
    x, y, heading = data.robots[0].truth.T
    away = data.true_map.positions - np.column_stack([x, y])[:, None]
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    return np.stack(
        [c * away[..., 0] + s * away[..., 1], -s * away[..., 0] + c * away[..., 1]], axis=-1
    )


def wheels(s: float) -> np.ndarray:
    """Standard deviations of v and omega of two wheels half a metre apart, of s each."""
    return np.array([s / np.sqrt(2), 2 * np.sqrt(2) * s])


# The numbers -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "kind", "sigmas", "steps", "command"),
    [
        ("hard-loop", "velocity-euler", wheels(0.0125), 2500, [0.25, 0.025, 1]),
        ("loop-15", "velocity-euler", wheels(0.02), 400, [0.25, 0.075, 1]),
        ("heading-sweep", "velocity-euler", wheels(0.005), 170, [0.25, 0.075, 1]),
        ("circle", "velocity-euler", wheels(0.05 * 0.25), 2500, [0.25, np.deg2rad(1.5), 1]),
        ("loop-15-rb", "odometry", np.insert(wheels(0.02), 1, 0.002), 400, [0.25, 0, 0.075]),
        ("car-loop", "car", [0.3, np.deg2rad(3)], None, None),
    ],
)
def test_commands_and_their_noise(name, kind, sigmas, steps, command):
    scenario = load_scenario(name)
    assert scenario.motion.kind == kind
    assert_allclose(scenario.motion.covariance, np.diag(np.square(sigmas)), rtol=1e-12)
    assert scenario.motion.slip == 0
    assert (scenario.noise_on, scenario.association) == ("odometry", "known")
    if command is not None:
        assert_allclose(scenario.controls, np.tile(command, (steps, 1)), rtol=1e-12)
        assert not scenario.start.any()


@pytest.mark.parametrize(
    ("name", "kind", "sigmas", "ranges", "every"),
    [
        ("hard-loop", "xy", [0.1, 0.1], (0.5, 5), 1),
        ("loop-15", "xy", [0.1, 0.1], (0.5, 5), 1),
        ("heading-sweep", "range-bearing", [0.1, np.deg2rad(1)], (0.5, 5), 1),
        ("circle", "xy", [0.1, 0.1], (1, 5), 1),
        ("loop-15-rb", "range-bearing", [0.1, np.deg2rad(3)], (0.5, 5), 1),
        ("car-loop", "range-bearing", [0.1, np.deg2rad(1)], (0, 30), 8),
    ],
)
def test_sensors_see_what_is_in_range_and_nothing_else(name, kind, sigmas, ranges, every):
    data = drawn(name)
    (sensor,) = data.sensors
    assert sensor.kind == kind
    assert_allclose(sensor.covariance, np.diag(np.square(sigmas)), rtol=1e-12)
    points = from_the_robot(data)
    distance = np.hypot(points[..., 0], points[..., 1])
    seen = (distance >= ranges[0]) & (distance <= ranges[1])
    if name == "car-loop":
        seen &= points[..., 0] > 0
    looking = np.arange(data.poses) % every == 0
    looking[0] = False
    expected = np.argwhere(seen & looking[:, None])
    assert_array_equal(np.column_stack([data.observations.step, data.true_landmark]), expected)


@pytest.mark.parametrize(
    ("name", "sigmas"),
    [
        ("hard-loop", [1e-4, 1e-4, 1e-4]),
        ("heading-sweep", [0.05, 0.05, np.deg2rad(5)]),
        ("loop-15", [0, 0, 0]),
        ("loop-15-rb", [0, 0, 0]),
        ("circle", [0, 0, 0]),
        ("car-loop", [0, 0, 0]),
    ],
)
def test_what_is_known_of_the_start(name, sigmas):
    assert_allclose(
        drawn(name).prior.covariance, np.diag(np.square(sigmas)), rtol=1e-12, atol=1e-300
    )


def test_rings_of_landmarks():
    angle = 2 * np.pi * np.arange(1, 16) / 15
    ring = [0.1251, 3.3318] + 4.3333 * np.column_stack([np.cos(angle), np.sin(angle)])
    for name in ("loop-15", "loop-15-rb", "heading-sweep"):
        assert_allclose(drawn(name).true_map.positions, ring, atol=1e-12)
    radius = 0.25 / np.deg2rad(1.5)
    positions = drawn("circle").true_map.positions
    assert len(positions) == 20
    assert_allclose(np.hypot(positions[:, 0], positions[:, 1] - radius), radius + 3, rtol=1e-12)
    gaps = np.hypot(*(positions - np.roll(positions, 1, axis=0)).T)
    assert_allclose(gaps, 2 * (radius + 3) * np.sin(np.pi / 20), rtol=1e-12)


def test_the_hard_map_is_drawn_by_its_rule():
    positions = drawn("hard-loop").true_map.positions
    assert len(positions) == 20
    radii = np.hypot(positions[:, 0], positions[:, 1] - 10)
    outer, inner = radii[radii > 10], radii[radii < 10]
    assert outer.min() >= 10.49
    assert outer.max() <= 15.01
    assert inner.min() >= 4.99
    assert inner.max() <= 9.51
    # Each side is as likely: between 4 and 16 of 20, with a probability of 0.997.
    assert 4 <= len(outer) <= 16
    # Every landmark comes into sight, and stretches of the path have none.
    data = drawn("hard-loop")
    assert len(np.unique(data.true_landmark)) == 20
    in_sight = np.bincount(data.observations.step, minlength=data.poses)[1:252]
    assert in_sight.mean() == pytest.approx(2.7, abs=0.1)
    assert (in_sight == 0).mean() == pytest.approx(0.11, abs=0.01)


@pytest.mark.parametrize(("name", "turn"), [("hard-loop", 0.025), ("loop-15", 0.075)])
def test_a_lap_of_a_circle_is_as_long_as_it_should_be(name, turn):
    """After n steps of a turn each, the pose is back if n is 2 pi over the turn."""
    truth = drawn(name).robots[0].truth
    lap = 2 * np.pi / turn
    # Half a step of each of two roundings to whole steps, at most.
    distance = np.hypot(*truth[round(lap), :2])
    assert distance <= 0.25 / 2 + 1e-9
    radius = 0.25 / 2 / np.sin(turn / 2)
    centre = [0.125, 0.125 / np.tan(turn / 2)]
    assert_allclose(np.hypot(*(truth[:, :2] - centre).T), radius, rtol=1e-9)


def test_the_negative_control_is_a_matter_of_two_numbers():
    quiet = load_scenario("loop-15", {"motion.sigmas": wheels(0.005)})
    assert_allclose(quiet.motion.covariance, np.diag([0.005**2 / 2, 8 * 0.005**2]), rtol=1e-12)
    assert_allclose(
        quiet.motion.covariance, load_scenario("heading-sweep").motion.covariance, rtol=1e-12
    )
    gentle = load_scenario("car-loop", {"motion.sigmas": [0.1, "0.5 deg"]})
    assert_allclose(gentle.motion.covariance, np.diag([0.1, np.deg2rad(0.5)]) ** 2, rtol=1e-12)


def test_loop_15_rb_has_the_noise_of_loop_15_in_a_step():
    """A step of 1 s: the Euler increment's covariance, and 2 mm across."""
    wheeled, stepped = drawn("loop-15").robots[0], drawn("loop-15-rb").robots[0]
    expected = wheeled.increments.covariances + np.diag([0, 0.002**2, 0])
    assert_allclose(stepped.increments.covariances, expected, atol=1e-18)
    assert_allclose(stepped.truth, wheeled.truth, atol=1e-12)


# What can be relied on -------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_only_the_noise_depends_on_the_seed(name):
    one, other = drawn(name), drawn(name, seed=1)
    assert_array_equal(one.robots[0].truth, other.robots[0].truth)
    assert_array_equal(one.observations.step, other.observations.step)
    assert_array_equal(one.true_landmark, other.true_landmark)
    assert (one.robots[0].controls[:, 0] != other.robots[0].controls[:, 0]).all()
    assert (one.observations.values != other.observations.values).all()


@pytest.mark.parametrize("name", NAMES)
def test_measured_controls_are_off_by_the_stated_noise(name):
    scenario, robot = load_scenario(name), drawn(name).robots[0]
    noisy = robot.motion.noisy_controls
    errors = (robot.controls - scenario.controls)[:, :noisy]
    squares = (errors**2 / np.diag(robot.motion.covariance)).sum(axis=0)
    # Five standard deviations of a chi-square over its degrees of freedom.
    assert_allclose(squares / len(errors), 1, atol=5 * np.sqrt(2 / len(errors)))
    assert_array_equal(robot.controls[:, noisy:], scenario.controls[:, noisy:])
    increments = robot.motion.increment(scenario.controls)[0]
    assert_allclose(geo.integrate(scenario.start, increments), robot.truth, atol=1e-12)


@pytest.mark.parametrize("name", ["car-loop", "heading-sweep", "loop-15-rb"])
def test_no_noise_turns_a_range_negative(name):
    """The nearest sighting is nine standard deviations away, and none of a million reaches it."""
    data = drawn(name)
    points = from_the_robot(data)[data.observations.step, data.true_landmark]
    assert np.hypot(*points.T).min() > 9 * 0.1


def test_the_start_is_drawn_from_the_prior():
    few = load_scenario("heading-sweep", {"path.repeat": 1})
    starts = np.array([simulate(few, seed=seed).prior.mean for seed in range(500)])
    scaled = starts / [0.05, 0.05, np.deg2rad(5)]
    # Sample moments of independent standard normals, at five standard deviations.
    assert_allclose(scaled.mean(axis=0), 0, atol=5 / np.sqrt(500))
    moments = scaled.T @ scaled / 500
    assert_allclose(np.diag(moments), 1, atol=5 * np.sqrt(2 / 500))
    assert_allclose(moments[np.triu_indices(3, 1)], 0, atol=5 / np.sqrt(500))


# The car ---------------------------------------------------------------------------------------


def test_the_car_drives_by_its_waypoints_two_laps_of_650_metres():
    scenario, data = load_scenario("car-loop"), drawn("car-loop")
    truth, controls = data.robots[0].truth, scenario.controls
    assert controls[:, 0].tolist() == [3.0] * len(controls)
    assert controls[:, 2].tolist() == [0.025] * len(controls)
    assert 600 < len(controls) * 3 * 0.025 / 2 < 700
    assert np.abs(controls[:, 1]).max() <= np.deg2rad(30) + 1e-12
    assert np.abs(np.diff(controls[:, 1], prepend=0)).max() <= np.deg2rad(20) * 0.025 + 1e-12
    # The second lap comes back to where the first one was, and the run ends at its start.
    half = len(controls) // 2
    first, second = truth[:half, :2], truth[half::40, :2]
    nearest = np.hypot(*(second[:, None] - first[::4]).transpose(2, 0, 1)).min(axis=1)
    assert nearest.max() < 1.0
    assert np.hypot(*truth[-1, :2]) < 1.0
    # The two noises of a car, B diag(sV^2, sG^2) B', at the straight stretches.
    straight = np.flatnonzero(np.abs(data.robots[0].controls[:, 1]) < 1e-3)
    speed = data.robots[0].controls[straight, 0]
    covariances = data.robots[0].increments.covariances[straight]
    assert_allclose(covariances[:, 0, 0], (0.025 * 0.3) ** 2, rtol=1e-3)
    turning = 0.025 * np.deg2rad(3) * speed / 4
    assert_allclose(covariances[:, 2, 2], turning**2, rtol=1e-3)


def test_the_car_sees_about_one_landmark_in_the_half_plane_ahead():
    data = drawn("car-loop")
    assert len(data.true_map) == 34
    assert len(np.unique(data.true_landmark)) == 34
    looks = (data.poses - 1) // 8
    assert len(data.observations) / looks == pytest.approx(1.1, abs=0.1)
    assert (np.abs(data.observations.values[:, 1]) < np.pi / 2 + 5 * np.deg2rad(1)).all()


CAR = {"speed": 3.0, "time_step": 0.1, "wheelbase": 4.0, "max_steer": 0.5, "steer_rate": 0.4}


def follow(path) -> np.ndarray:
    motion = MotionModel("car", covariance=np.eye(2), wheelbase=4.0)
    return geo.integrate(path.start, motion.increment(path.controls)[0])


def test_a_car_with_the_waypoint_ahead_drives_straight_until_it_is_reached():
    path = steered([1, 2, np.pi / 2], [[1, 12]], **CAR)
    assert_allclose(path.controls[:, 1], 0, atol=1e-12)
    # Nine metres to within a metre of it, in steps of 0.3 m.
    assert len(path.controls) == 30
    assert (path.motion, path.wheelbase) == ("car", 4.0)


def test_the_wheels_turn_towards_the_waypoint_as_fast_and_as_far_as_they_may():
    path = steered([0, 0, 0], [[0, 30], [-20, -30]], laps=2, radius=2.0, **CAR)
    poses = follow(path)
    targets = np.array([[0, 30], [-20, -30], [0, 30], [-20, -30]], dtype=float)
    reached = 0
    steer = 0.0
    for pose, (_, gamma, _) in zip(poses, path.controls, strict=False):
        while np.hypot(*(targets[reached] - pose[:2])) <= 2.0:
            reached += 1
        away = targets[reached] - pose[:2]
        ahead = np.angle(np.exp(1j * (np.arctan2(away[1], away[0]) - pose[2])))
        turned = np.angle(np.exp(1j * (ahead - steer)))
        expected = np.clip(steer + np.clip(turned, -0.04, 0.04), -0.5, 0.5)
        assert gamma == pytest.approx(expected, abs=1e-9)
        steer = gamma
    assert reached == 3
    assert np.hypot(*(targets[3] - poses[-1, :2])) <= 2.0
    assert np.abs(path.controls[:, 1]).max() == 0.5


def test_a_waypoint_inside_the_turning_circle_is_refused():
    with pytest.raises(InputError, match=r"waypoint 2 cannot be reached: the car turns on 8\.34 m"):
        steered([0, 0, 0], [[20, 0], [21, 7]], **CAR)


@pytest.mark.parametrize(
    "wrong",
    [
        {"start": [0, 0]},
        {"waypoints": [20, 0]},
        {"waypoints": [[20, 0, 1]]},
        {"waypoints": np.empty((0, 2))},
        {"speed": 0.0},
        {"time_step": -0.1},
        {"wheelbase": np.inf},
        {"max_steer": 2.0},
        {"steer_rate": 0.0},
        {"radius": 0.0},
        {"laps": 0},
    ],
)
def test_impossible_cars_are_refused(wrong):
    arguments = {"start": [0, 0, 0], "waypoints": [[20, 0]]} | CAR | wrong
    with pytest.raises(InputError):
        steered(**arguments)


def test_a_path_for_another_car_is_refused():
    with pytest.raises(InputError, match="car-loop: path and motion need the same wheelbase"):
        load_scenario("car-loop", {"motion.wheelbase": 3.0})
    changes = {"motion.wheelbase": 3.0, "path.wheelbase": 3.0}
    assert load_scenario("car-loop", changes).motion.wheelbase == 3.0
