"""Scenario files of teams, partial sensors and outliers; the shipped scenarios of that kind."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from simulated import exact_values

from ekfslam.errors import InputError
from ekfslam.simulation import load_scenario, simulate
from ekfslam.simulation.paths import unguided

TEAM = """
description = "Two on their way."
clutter = 1
wrong_ids = 0.05
descriptor_sigma = 0.02
[world]
kind = "points"
landmarks = [[0, 0], [4, 0], [4, 4]]
descriptors = [0.2, 0.5]
[[robots]]
name = "ada"
[robots.path]
kind = "controls"
start = [2, 0, 0]
controls = [[0.1, "3 deg"]]
repeat = 20
[robots.motion]
kind = "advance-turn"
sigmas = [0.01, "1 deg"]
[[robots]]
name = "bob"
[robots.path]
kind = "controls"
start = [5, 0, 0]
controls = [[0.1, 0, 0]]
repeat = 20
[robots.motion]
kind = "odometry"
sigmas = [0.01, 0.02, 0.03]
[robots.prior]
sigmas = [0.1, 0.1, 0.1]
draw = true
[[sensors]]
kind = "range-bearing"
sigmas = [0.1, "1 deg"]
max_range = 5
mutual = true
[[sensors]]
kind = "bearing"
sigmas = ["2 deg"]
max_range = 9
every = 3
offset = 1
robots = ["bob"]
name = "camera"
"""

HELD = """
noise_on = "motion"
[world]
kind = "points"
landmarks = [[0, 0], [4, 0]]
[path]
kind = "unguided"
start = [2, 0, 0]
steps = 30
[motion]
kind = "none"
sigmas = [0.1, 0.1, "5 deg"]
[[sensors]]
kind = "range"
sigmas = [0.1]
"""


@pytest.fixture
def load(tmp_path):
    def _load(text):
        file = tmp_path / "team.toml"
        file.write_text(text)
        return load_scenario(file)

    return _load


# Files -----------------------------------------------------------------------------------------


def test_every_robot_and_every_setting_arrives(load):
    scenario = load(TEAM)
    ada, bob = scenario.robot_plans
    assert (ada.name, bob.name) == ("ada", "bob")
    assert (ada.motion.kind, bob.motion.kind) == ("advance-turn", "odometry")
    assert (ada.motion.slip, bob.motion.slip) == (0.001, 0)
    assert_array_equal(ada.start, scenario.start)
    assert_array_equal(bob.start, [5, 0, 0])
    assert_array_equal(bob.controls, [[0.1, 0, 0]] * 20)
    assert (ada.prior, ada.draw_prior, bob.draw_prior) == (None, False, True)
    assert_array_equal(bob.prior.mean, bob.start)
    laser, camera = scenario.sensor_plans
    assert (laser.mutual, laser.every, laser.offset, laser.robots) == (True, 1, 0, None)
    assert (camera.mutual, camera.every, camera.offset) == (False, 3, 1)
    assert camera.robots == ("bob",)
    assert_allclose(camera.covariance, [[np.deg2rad(2) ** 2]])
    assert (scenario.clutter, scenario.wrong_ids) == (1.0, 0.05)
    assert scenario.descriptor_sigma == 0.02
    assert_array_equal(scenario.descriptors, [0.2, 0.5, 0.2])  # the list starts again
    data = simulate(scenario, seed=1)
    assert [robot.name for robot in data.robots] == ["ada", "bob"]
    assert (data.observed_robot >= 0).any()


def test_a_hand_held_sensor_in_a_file(load):
    scenario = load(HELD)
    assert scenario.motion.slip == 0
    assert scenario.controls.shape == (30, 0)
    assert simulate(scenario).poses == 31
    with pytest.raises(InputError, match="this path needs the motion kind 'none'"):
        load(HELD.replace('"none"', '"odometry"'))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[[robots]]\nname", "[path]\n[[robots]]\nname", r"either \[\[robots\]\] or \[path\]"),
        ("[[sensors]]", "[prior]\n[[sensors]]", r"either \[\[robots\]\] or \[prior\], not both"),
        (
            'name = "ada"',
            'nane = "ada"',
            r"\[\[robots\]\] 1: unknown key 'nane'; did you mean name",
        ),
        ('name = "ada"', "name = 3", r"\[\[robots\]\] 1: name must be text"),
        ('name = "ada"', "start = [1, 2, 3]", r"\[\[robots\]\] 1: unknown key 'start'"),
        ('name = "ada"', 'name = "bob"', "robots need names of their own, got bob, bob"),
        (
            "[robots.path]",
            "[robots.pth]",
            r"\[\[robots\]\] 1: unknown key 'pth'; did you mean path",
        ),
        ("repeat = 20", "repeat = 10", "bob makes 20 and ada 10"),
        ("repeat = 20", "repeat = 0", r"\[\[robots\]\] 1: \[path\]: repeat must be at least 1"),
        ("start = [2, 0, 0]", "start = [2, 0]", r"\[\[robots\]\] 1: start must be a pose"),
        ('"advance-turn"', '"odometry"', r"\[\[robots\]\] 1: \[motion\]: covariance must have"),
        ("sigmas = [0.1, 0.1, 0.1]", "sigmas = [0.1]", r"\[\[robots\]\] 2: \[prior\]: prior cov"),
        ('robots = ["bob"]', 'robots = ["bop"]', "camera is of no robot 'bop'; known: ada, bob"),
        (
            'robots = ["bob"]',
            'robots = "bob"',
            r"\[\[sensors\]\] 2: robots must be a list of names",
        ),
        ('robots = ["bob"]', "robots = [1]", r"\[\[sensors\]\] 2: robots must be a list of names"),
        ("every = 3", "every = 1.5", r"\[\[sensors\]\] 2: every must be a whole number"),
        ("every = 3", "every = 0", r"\[\[sensors\]\] 2: every of camera must be at least 1"),
        ("mutual = true", "mutual = 1", r"\[\[sensors\]\] 1: mutual must be true or false"),
        ("mutual = true", "mutul = true", r"\[\[sensors\]\] 1: unknown key 'mutul'; .*mutual"),
        ('sigmas = ["2 deg"]', "sigmas = [1, 1]", r"covariance of camera must have shape \(1, 1\)"),
        ("max_range = 5", "", "clutter needs a max_range of sensor"),
        ("clutter = 1", 'clutter = "much"', "clutter must be a number"),
        ("wrong_ids = 0.05", "wrong_ids = 2", "wrong_ids must be a share"),
        ("[0.2, 0.5]", "[]", r"\[world\]: descriptors must be a list of numbers"),
        ("[0.2, 0.5]", "[[0.2], [0.5]]", r"\[world\]: descriptors must be a list of numbers"),
        ("descriptors = [0.2, 0.5]", "", "descriptor_sigma needs descriptors"),
        ("descriptors =", "descriptor =", r"\[world\]: unknown key 'descriptor'; .*descriptors"),
    ],
)
def test_a_mistake_in_a_file_is_named_with_file_table_and_key(load, old, new, message):
    assert old in TEAM
    with pytest.raises(InputError, match=message) as caught:
        load(TEAM.replace(old, new, 1))
    assert "team.toml: " in str(caught.value)
    assert "\n" not in str(caught.value)


def test_robots_that_are_no_tables(load):
    start = HELD.index("[path]"), HELD.index("[[sensors]]")
    without = HELD[: start[0]] + HELD[start[1] :]
    for robots in ("robots = []", "robots = 3", 'robots = ["ada"]'):
        with pytest.raises(InputError, match=r"at least one table \[\[robots\]\] is needed"):
            load(robots + without)


def test_a_path_without_controls_and_with_a_motion_that_has_some(load):
    with pytest.raises(InputError, match="set noise_on to 'motion'"):
        load(HELD.replace('noise_on = "motion"', ""))
    with pytest.raises(InputError, match="steps must be at least 1"):
        unguided([0, 0, 0], 0)


# The scenarios that come with the package ------------------------------------------------------


@pytest.mark.parametrize("name", ["cloister-bearing", "cloister-range"])
def test_partial_cloisters_are_the_demo_seen_by_half(name):
    scenario, demo = load_scenario(name), load_scenario("cloister")
    assert_array_equal(scenario.landmarks.positions, demo.landmarks.positions)
    assert_array_equal(scenario.controls, demo.controls)
    assert_array_equal(scenario.start, demo.start)
    assert_allclose(scenario.motion.covariance, demo.motion.covariance / 4)
    assert scenario.motion.slip == demo.motion.slip / 2
    (sensor,) = scenario.sensors
    sigma = np.deg2rad(0.5) if name == "cloister-bearing" else 0.1
    assert_allclose(sensor.covariance, [[sigma**2]])
    assert sensor.min_range == 0.5
    for seed in range(5):  # the minimum range hides nothing
        assert len(simulate(scenario, seed).observations) == 200 * 36


def test_two_sensors_look_at_different_times_in_different_directions():
    data = simulate("two-sensors", seed=1)
    laser, camera = data.sensors
    assert (laser.kind, camera.kind) == ("range-bearing", "bearing")
    assert camera.mount[2] - laser.mount[2] == pytest.approx(np.pi / 2)
    for sensor in data.sensors:
        assert np.isfinite(sensor.max_range)
        assert sensor.field_of_view < 2 * np.pi
    steps = [set(data.observations.step[data.observations.sensor == s].tolist()) for s in (0, 1)]
    assert steps[0] - steps[1]
    assert steps[1] - steps[0]
    assert steps[0] & steps[1]
    seen = [set(data.true_landmark[data.observations.sensor == s].tolist()) for s in (0, 1)]
    assert seen[0] & seen[1]
    assert len(data.observations) / len(steps[0] | steps[1]) > 3


def test_a_team_of_three_shares_landmarks_and_meets():
    data = simulate("team", seed=1)
    o = data.observations
    assert len(data.robots) == 3
    assert len({robot.motion.kind for robot in data.robots}) == 3
    seen = [set(data.true_landmark[o.robot == r].tolist()) - {-1} for r in range(3)]
    for one in range(3):
        for other in range(3):
            assert len(seen[one] & seen[other]) >= 5
            if one != other:
                assert ((o.robot == one) & (data.observed_robot == other)).any()
    apart = [
        np.linalg.norm(data.robots[a].truth[:, :2] - data.robots[b].truth[:, :2], axis=1).min()
        for a, b in ((0, 1), (0, 2), (1, 2))
    ]
    assert min(apart) > 1
    assert not data.robots[0].prior.covariance.any()
    for robot in data.robots[1:]:
        assert (np.diag(robot.prior.covariance) > 0).all()
        assert not np.array_equal(robot.prior.mean, robot.truth[0])


def test_hand_held_stays_among_its_landmarks():
    for seed in range(20):
        data = simulate("hand-held", seed)
        looks = np.bincount(data.observations.step, minlength=data.poses)[1:]
        assert looks.min() >= 2
        assert np.abs(data.truth[:, :2]).max() < 12
    assert data.robot.motion.kind == "none"
    assert data.times[1] == 0.1


def test_orchard_is_dense_and_cluttered_and_without_names():
    scenario = load_scenario("orchard")
    data = simulate(scenario, seed=1)
    positions = scenario.landmarks.positions
    gaps = np.linalg.norm(positions[:, None] - positions, axis=-1) + 9 * np.eye(len(positions))
    assert gaps.min() > 1.19  # rounded to centimetres
    assert np.median(gaps.min(axis=1)) < 1.6
    assert scenario.association == "unknown"
    assert (data.observations.landmark == -1).all()
    real = data.true_landmark >= 0
    assert 5 <= real.sum() / (data.poses - 1) <= 10
    assert (~real).sum() / (data.poses - 1) == pytest.approx(0.3, abs=0.15)
    assert 300 <= data.poses <= 500
    clearance = np.linalg.norm(positions[:, None] - data.truth[:, :2], axis=-1).min()
    assert clearance > 0.6 > 6 * np.sqrt(data.sensors[0].covariance[0, 0])
    # Each tree is seen again after a lap, which is 203 steps long.
    for tree in scenario.landmarks.ids:
        steps = data.observations.step[data.true_landmark == tree]
        assert steps.max() - steps.min() > 150


@pytest.mark.parametrize(
    "name", ["cloister-bearing", "cloister-range", "hand-held", "orchard", "team", "two-sensors"]
)
def test_noise_is_that_which_is_stated(name):
    """Mean normalised innovation of each sensor at the truth: its expectation is d."""
    data = simulate(name, seed=2)
    exact, rows = exact_values(data), data.sightings
    for index, sensor in enumerate(data.sensors):
        mine = (data.observations.sensor == index) & np.isfinite(exact[:, 0])
        size = sensor.view.size
        error = sensor.difference(rows.values[mine, :size], exact[mine, :size])
        weights = np.linalg.inv(rows.covariance[mine, :size, :size])
        squared = np.einsum("mi,mij,mj->m", error, weights, error)
        assert squared.mean() == pytest.approx(size, abs=5 * np.sqrt(2 * size / mine.sum()))


def test_descriptions_say_what_is_special():
    words = {
        "cloister-bearing": ["; bearing;"],
        "team": ["3 robots", "range-bearing of landmarks and robots", "steps over 60 m"],
        "two-sensors": ["range-bearing every 3 steps and bearing every 2 steps"],
        "hand-held": ["400 steps;", "unguided motion", "noise on the motion"],
        "orchard": ["clutter 0.3 per look", "association unknown"],
    }
    for name, parts in words.items():
        line = load_scenario(name).describe()
        for part in parts:
            assert part in line
    assert "robots" not in load_scenario("park").describe()


def test_the_description_of_a_team_of_outliers(load):
    line = load(TEAM).describe()
    for part in ("bearing of bob every 3 steps", "wrong identities 0.05", "descriptors"):
        assert part in line
