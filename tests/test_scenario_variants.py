"""Scenarios with values changed, and the digest that tells scenarios apart."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from ekfslam.errors import InputError
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.robots import LandmarkMap, Prior
from ekfslam.simulation import (
    Scenario,
    describe_scenario,
    load_scenario,
    scenario_hash,
    scenarios,
    simulate,
)

# Changes ---------------------------------------------------------------------------------------


def test_values_of_the_file_are_replaced():
    changes = {
        "motion.sigmas": [0.1, 0.2],
        "path.repeat": 7,
        "sensors.0.sigmas": (0.3, 0.4),
        "sensors.0.max_range": np.float64(8),
        "clutter": 0.5,
        "world.centre": np.array([1.0, 2.0]),
    }
    scenario = load_scenario("loop-15", changes)
    np.testing.assert_allclose(scenario.motion.covariance, np.diag([0.01, 0.04]))
    assert len(scenario.controls) == 7
    (sensor,) = scenario.sensors
    np.testing.assert_allclose(sensor.covariance, np.diag([0.09, 0.16]))
    assert (sensor.min_range, sensor.max_range) == (0.5, 8.0)
    assert scenario.clutter == 0.5
    np.testing.assert_allclose(scenario.landmarks.positions.mean(axis=0), [1, 2], atol=1e-12)
    assert scenario.name == "loop-15"
    assert changes["sensors.0.sigmas"] == (0.3, 0.4)


def test_a_table_that_is_missing_is_made():
    scenario = load_scenario("loop-15", {"prior.sigmas": [0.1, 0.2, "3 deg"], "prior.draw": True})
    sigmas = [0.1, 0.2, np.deg2rad(3)]
    np.testing.assert_allclose(np.sqrt(np.diag(scenario.prior.covariance)), sigmas)
    assert scenario.prior.mean.tolist() == [0, 0, 0]
    assert scenario.draw_prior
    whole = load_scenario("loop-15", {"prior": {"sigmas": (0.1, 0.2, "3 deg"), "draw": True}})
    assert scenario_hash(whole) == scenario_hash(scenario)


def test_items_of_lists_and_robots_are_reached_by_number():
    team = load_scenario("team", {"robots.1.motion.sigmas.0": 0.5})
    as_shipped = load_scenario("team")
    first, second = team.robot_plans[:2]
    expected = as_shipped.robot_plans[1].motion.covariance.copy()
    expected[0, 0] = 0.25
    np.testing.assert_allclose(second.motion.covariance, expected)
    np.testing.assert_array_equal(
        first.motion.covariance, as_shipped.robot_plans[0].motion.covariance
    )


def test_covariance_and_sigmas_replace_each_other(tmp_path):
    changes = {"motion.covariance": [[0.04, 0.01], [0.01, 0.09]]}
    assert load_scenario("loop-15", changes).motion.covariance.tolist() == [
        [0.04, 0.01],
        [0.01, 0.09],
    ]
    again = changes | {"motion.sigmas": [0.2, 0.3]}
    np.testing.assert_allclose(load_scenario("loop-15", again).motion.covariance[1, 0], 0)


def test_nothing_changed_is_the_scenario_itself():
    as_shipped = load_scenario("loop-15")
    assert scenario_hash(load_scenario("loop-15", {})) == scenario_hash(as_shipped)
    assert scenario_hash(load_scenario("loop-15")) == scenario_hash(as_shipped)


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("motion.sigma", r"loop-15: \[motion\]: unknown key 'sigma'; did you mean sigmas"),
        ("moton.sigmas", r"loop-15: unknown key 'moton'; did you mean motion"),
        ("cluter", r"loop-15: unknown key 'cluter'; did you mean clutter"),
        ("", r"loop-15: unknown key ''"),
        ("sensors.1.sigmas", r"loop-15: 'sensors\.1\.sigmas' .* no item '1', .* items 0 to 0"),
        ("sensors.-1.sigmas", r"loop-15: 'sensors\.-1\.sigmas' .* no item '-1'"),
        ("sensors.front.sigmas", r"loop-15: 'sensors\.front\.sigmas' .* no item 'front'"),
        ("sensors.²", r"loop-15: 'sensors\.²' .* no item '²'"),
        ("sensors.0.sigmas.2", r"'sensors\.0\.sigmas\.2' .* no item '2', .* items 0 to 1"),
        ("motion.kind.x", r"loop-15: 'motion\.kind\.x' .* 'x' is inside a value"),
        ("path.repeat.first.second", r"'path\.repeat\.first\.second' .* 'first' is inside a value"),
        ("motion.wheelbase", r"loop-15: \[motion\]: .*takes no wheelbase"),
        ("sensors.0", r"at least one table \[\[sensors\]\]"),
    ],
)
def test_a_change_of_nothing_is_named(key, message):
    with pytest.raises(InputError, match=message) as caught:
        load_scenario("loop-15", {key: 0.5})
    assert "\n" not in str(caught.value)


def test_the_value_of_a_change_is_checked_like_the_files():
    with pytest.raises(InputError, match=r"loop-15: \[path\]: repeat must be a whole number"):
        load_scenario("loop-15", {"path.repeat": 1.5})
    with pytest.raises(InputError, match=r"loop-15: \[motion\]: sigmas must be a list of numbers"):
        load_scenario("loop-15", {"motion.sigmas": 0.1})


# The digest ------------------------------------------------------------------------------------


def test_every_shipped_scenario_has_a_digest_of_its_own():
    here = [name for name in scenarios() if "[not here" not in describe_scenario(name)]
    digests = {scenario_hash(load_scenario(name)) for name in here}
    assert len(digests) == len(here) >= 17
    assert all(len(digest) == 64 for digest in digests)


def small(**settings) -> Scenario:
    defaults = {
        "name": "small",
        "landmarks": LandmarkMap(range(2), [[1.0, 2.0], [3.0, 0.0]]),
        "start": [1.0, 0.0, 0.5],
        "controls": [[0.1, 0.0, 0.2]] * 3,
        "motion": MotionModel("odometry", covariance=np.diag([0.1, 0.2, 0.3])),
        "sensors": (Sensor("xy", np.eye(2)),),
    }
    return Scenario(**(defaults | settings))


SAME = {
    "name": "other",
    "description": "In other words.",
    "start": np.array([1, -0.0, 0.5]),
    "time_step": 1.0,
    "prior": Prior([1.0, 0.0, 0.5]),
    "clutter": 0,
}


@pytest.mark.parametrize("name", SAME)
def test_words_and_spelling_do_not_change_the_digest(name):
    assert scenario_hash(small(**{name: SAME[name]})) == scenario_hash(small())


OTHER = {
    "landmarks": LandmarkMap(range(2), [[1.0, 2.0], [3.0, 1e-9]]),
    "start": [1.0, 0.0, 0.5 + 1e-12],
    "controls": [[0.1, 0.0, 0.2]] * 4,
    "motion": MotionModel("odometry", covariance=np.diag([0.1, 0.2, 0.3]), slip=1e-3),
    "sensors": (Sensor("xy", np.eye(2), max_range=5.0),),
    "association": "unknown",
    "noise_on": "motion",
    "time_step": 2.0,
    "prior": Prior([1.0, 0.0, 0.5], 1e-8 * np.eye(3)),
    "draw_prior": True,
    "observe_start": True,
    "observe_every": 2,
    "new_landmarks_per_step": 1,
    "team": (replace(small().robot_plans[0], name="second"),),
    "robot_name": "first",
    "clutter": 0.1,
    "wrong_ids": 0.1,
    "descriptors": [0.1, 0.2],
    "descriptor_sigma": 0.1,
    "known_map": 0.5,
}


@pytest.mark.parametrize("name", OTHER)
def test_every_number_changes_the_digest(name):
    settings = {name: OTHER[name]}
    finite = {"sensors": (Sensor("xy", np.eye(2), max_range=9.0),)}
    base = {"descriptor_sigma": {"descriptors": [1.0, 2.0]}, "clutter": finite}.get(name, {})
    assert scenario_hash(small(**(base | settings))) != scenario_hash(small(**base))


def test_every_field_is_in_the_digest():
    names = {f.name for f in fields(Scenario)}
    assert names == set(OTHER) | {"name", "description"}


def test_equal_digests_draw_equal_data():
    variant = load_scenario("loop-15", {"path.repeat": 20})
    spelt = replace(
        load_scenario("loop-15"),
        name="spelt",
        controls=[[0.25, 0.075, 1.0]] * 20,
        prior=Prior(np.zeros(3)),
    )
    assert scenario_hash(variant) == scenario_hash(spelt)
    one, other = simulate(variant, seed=3), simulate(spelt, seed=3)
    np.testing.assert_array_equal(one.observations.values, other.observations.values)
    np.testing.assert_array_equal(one.robots[0].controls, other.robots[0].controls)
