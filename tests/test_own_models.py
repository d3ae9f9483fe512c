"""Motion models from functions, and measurements of a sensor of one's own as those of a view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numerics import assert_same_record, assert_sampled
from numpy.testing import assert_allclose, assert_array_equal

import ekfslam
from ekfslam import geometry as geo
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.models.motion import KINDS, MotionModel
from ekfslam.own_models import OwnMotion, propagated

COMMANDED = [kind for kind in KINDS if kind != "none"]


def of_house(kind):
    needed = KINDS[kind].parameter
    size = KINDS[kind].noisy
    noise = np.diag([0.03, 0.01, 0.02][:size]) ** 2 + 1e-5
    return MotionModel(kind, noise, slip=0.002, **({needed: 0.7} if needed else {}))


def own(model, **changes):
    """A motion model of the house, given as functions."""
    settings = {
        "kind": f"my-{model.kind}",
        "covariance": model.covariance,
        "controls": model.control_names,
        "function": lambda u: model.increment([u])[0][0],
        "jacobian": lambda u: model.increment([u])[1][0],
        "slip": model.slip,
    }
    return OwnMotion(**settings | changes)


def turning(motion, steps=60):
    """A scenario of the park in which a robot makes this motion."""
    controls = np.tile([0.5, 0.02, 0.1][: len(motion.control_names)], (steps, 1))
    if motion.control_names[0] in ("l", "vl"):
        controls[:, 1] = 0.51
    scenario = ekfslam.load_scenario("park")
    return replace(scenario, motion=motion, controls=controls)


# A motion of one's own --------------------------------------------------------------------------


@pytest.mark.parametrize("noise_on", ["odometry", "motion"])
@pytest.mark.parametrize("kind", COMMANDED)
def test_a_kind_of_the_house_as_functions_gives_the_same_numbers(kind, noise_on):
    model = of_house(kind)
    house = replace(turning(model), noise_on=noise_on)
    mine = replace(house, motion=own(model))
    for settings in ({"seed": 4}, {"seed": 4, "noise": 0.5, "odometry_noise": 3.0}):
        expected, data = ekfslam.simulate(house, **settings), ekfslam.simulate(mine, **settings)
        assert_array_equal(data.times, expected.times)
        assert_same_record(data.observations, expected.observations)
        assert_array_equal(data.truth, expected.truth)
        assert_same_record(tuple(data.robot.increments), tuple(expected.robot.increments))


@pytest.mark.parametrize("name", ["ekf", "gtsam-batch", "fastslam2", "dead-reckoning"])
def test_estimators_give_the_same_numbers(name, tmp_path):
    model = of_house("velocity")
    house = turning(model)
    expected = ekfslam.estimate(ekfslam.simulate(house, seed=2), name)
    data = ekfslam.simulate(replace(house, motion=own(model)), seed=2)
    estimate = ekfslam.estimate(data, name)
    assert estimate.status == expected.status == "ok"
    assert_same_record(estimate.final_trajectory, expected.final_trajectory)
    data.save(tmp_path / "own.npz")
    stored = ekfslam.load(tmp_path / "own.npz")
    assert stored.robot.motion.kind == "odometry"
    assert_same_record(ekfslam.estimate(stored, name).final_trajectory, expected.final_trajectory)


def test_without_a_jacobian_central_differences_stand_in():
    model = of_house("velocity")
    controls = np.random.default_rng(3).uniform(-1, 1, (50, 3))
    exact = own(model).increments(controls)
    numeric = own(model, jacobian=None).increments(controls)
    assert_array_equal(numeric.deltas, exact.deltas)
    assert_allclose(numeric.covariances, exact.covariances, rtol=0, atol=1e-9)


def test_a_heading_that_wraps_has_a_slope():
    motion = OwnMotion(
        "spin", np.eye(1), controls=("turn",), function=lambda u: [0, 0, geo.wrap(u[0])]
    )
    _, jacobian = motion.increment([[np.pi], [-np.pi], [0.3]])
    assert_allclose(jacobian[:, 2, 0], 1.0, rtol=1e-9)


def test_noise_may_depend_on_the_control():
    model = MotionModel("wheel-increments", proportional=(0.1, 0.3), width=0.5, slip=1e-3)

    def noise(u):
        return model.control_covariances([u])[0]

    mine = own(model, covariance=noise)
    controls = np.random.default_rng(3).uniform(-1, 1, (20, 2))
    for factor in (1.0, 0.25):
        expected, scaled = model.scaled(factor), mine.scaled(factor)
        assert_allclose(
            scaled.increments(controls).covariances,
            expected.increments(controls).covariances,
            rtol=1e-14,
            atol=1e-18,
        )
    house = turning(model)
    expected = ekfslam.simulate(house, seed=1)
    data = ekfslam.simulate(replace(house, motion=mine), seed=1)
    assert_array_equal(data.truth, expected.truth)
    assert_array_equal(data.robot.controls, expected.robot.controls)


def test_a_dt_is_exact_and_gives_the_times():
    data = ekfslam.simulate(turning(own(of_house("velocity"))), seed=1)
    assert_array_equal(data.robot.controls[:, 2], 0.1)
    assert_allclose(np.diff(data.times), 0.1, rtol=1e-9)


def test_comparisons_take_it_and_say_what_it_was(tmp_path):
    data = ekfslam.simulate(turning(own(of_house("car"))), seed=1)
    comparison = ekfslam.compare(data, ["ekf"])
    assert comparison.summary["status"].tolist() == ["ok"]
    comparison.save(tmp_path, figures=False)
    assert '"kind": "my-car"' in (tmp_path / "config.json").read_text()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"controls": "v"}, "controls of 'my-velocity' must be their names"),
        ({"controls": ()}, "must be their names"),
        ({"controls": ("v", "v", "dt")}, "names of their own"),
        ({"controls": ("dt", "v", "omega")}, "dt comes last"),
        ({"function": None}, r"needs a function u -> \(dx, dy, dtheta\)"),
        ({"covariance": np.eye(3)}, r"covariance must have shape \(2, 2\)"),
        ({"covariance": -np.eye(2)}, "covariance is not positive semi-definite"),
        ({"slip": -1.0}, "slip must be a non-negative length"),
    ],
)
def test_models_that_make_no_sense(changes, message):
    with pytest.raises(InputError, match=message):
        own(of_house("velocity"), **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"function": lambda u: u[:2]}, r"function of .*'my-velocity' must .* \(3,\), got \(2,\)"),
        ({"function": lambda u: u * np.nan}, "function of .*'my-velocity' returns .*nan"),
        ({"jacobian": lambda u: np.eye(2)}, r"jacobian of .* must .* shape \(3, 3\)"),
        ({"covariance": lambda u: -np.eye(2)}, "covariance of .* is not positive semi-definite at"),
        ({"covariance": lambda u: np.eye(3)}, r"covariance of .* must .* shape \(2, 2\)"),
    ],
)
def test_functions_that_return_no_sense(changes, message):
    motion = own(of_house("velocity"), **changes)
    with pytest.raises(InputError, match=message):
        motion.increments([[1.0, 0.1, 0.5]])


# A sensor of one's own --------------------------------------------------------------------------

FOCAL, BASELINE = 400.0, 0.2


def back_project(seen):
    column, disparity = seen
    return BASELINE / disparity * np.array([FOCAL, -column])


def back_project_jacobian(seen):
    column, disparity = seen
    return BASELINE / disparity**2 * np.array([[0.0, -FOCAL], [-disparity, column]])


def stereo(scenario, sigma, seed):
    """A run seen by a stereo pair: column and disparity with a noise of so many pixels."""
    noise = np.diag([sigma, 1.5 * sigma]) ** 2
    pair = ekfslam.Sensor(
        "xy", np.eye(2), min_range=1.0, max_range=12.0, field_of_view=np.pi / 2, name="stereo"
    )
    data = ekfslam.simulate(replace(scenario, sensors=[pair]), seed=seed)
    seen = data.observations
    x, y = geo.to_frame(data.truth[seen.step], data.true_map.positions[seen.landmark]).T
    pixels = np.column_stack([-FOCAL * y / x, FOCAL * BASELINE / x])
    pixels += np.random.default_rng(seed).standard_normal(pixels.shape) * np.sqrt(np.diag(noise))
    values, covariance = propagated("xy", back_project, pixels, noise, back_project_jacobian)
    return replace(data, observations=replace(seen, values=values, covariance=covariance))


def test_stereo_is_consistent_on_a_known_map():
    """NIS per number is 1 and NEES 3 but for their spread, and what first order neglects."""
    park = ekfslam.load_scenario("park")
    rows = [
        ekfslam.compare(stereo(park, 0.25, seed), ["ekf-localization"]).summary.iloc[0]
        for seed in range(4)
    ]
    numbers = sum(2 * row["observations"] for row in rows)
    nis = np.mean([row["nis_per_dof"] for row in rows])
    # Beside the spread, the squared ratio of sigma and the least disparity, with its factor 3.
    assert abs(nis - 1) < 4 * np.sqrt(2 / numbers) + 3 * (1.5 * 0.25 * 12 / (FOCAL * BASELINE)) ** 2
    # One run's mean NEES spreads by 0.25 (poses are correlated over some 50 steps).
    assert abs(np.mean([row["nees_pose_mean"] for row in rows]) - 3) < 4 * 0.25 / np.sqrt(4)


def test_a_stated_noise_that_is_wrong_shows_in_the_nis():
    park = ekfslam.load_scenario("park")
    data = stereo(park, 0.25, 1)
    wrong = replace(data.observations, covariance=data.observations.covariance / 2)
    row = ekfslam.compare(replace(data, observations=wrong), ["ekf-localization"]).summary.iloc[0]
    assert row["nis_per_dof"] > 1.5


def test_propagated_noise_is_that_of_samples(rng):
    """To first order: with a noise of a thousandth of the disparity, the samples' covariance."""
    seen, noise = np.array([40.0, 20.0]), np.array([[4e-4, 1e-4], [1e-4, 9e-4]])
    drawn = rng.multivariate_normal(seen, noise, 20000)
    values, covariance = propagated("xy", back_project, seen[None], noise)
    mapped = np.array([back_project(each) for each in drawn])
    assert_sampled(mapped - values[0], covariance[0])


def test_jacobians_and_differences_propagate_the_same(rng):
    seen = np.column_stack([rng.uniform(-100, 100, 30), rng.uniform(8, 40, 30)])
    noise = np.array([np.diag(rng.uniform(0.1, 1, 2)) for _ in seen])
    exact = propagated("xy", back_project, seen, noise, back_project_jacobian)
    numeric = propagated("xy", back_project, seen, noise)
    assert_array_equal(numeric[0], exact[0])
    assert_allclose(numeric[1], exact[1], rtol=1e-7)
    one = propagated("xy", back_project, seen[3:4], noise[3])
    assert_array_equal(one[1][0], numeric[1][3])


def test_a_bearing_that_jumps_by_a_turn_has_a_slope():
    def function(seen):  # x and y, reported as range and bearing, here behind the sensor
        return [np.hypot(*seen), np.arctan2(seen[1], seen[0])]

    _, covariance = propagated("range-bearing", function, [[-2.0, 0.0]], np.eye(2))
    assert_allclose(covariance[0], np.diag([1.0, 0.25]), atol=1e-8)


def test_one_number_fits_the_columns_of_observations():
    values, covariance = propagated("range", lambda s: np.exp(s), [[0.0], [1.0]], [[0.01]])
    observations = ekfslam.Observations([0, 0], values, covariance=covariance)
    assert_allclose(observations.covariance[1], [[0.01 * np.exp(2), 0], [0, 0]], rtol=1e-8)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("xy", back_project, [1.0, 2.0], np.eye(2)), "values must have shape"),
        (("xy", back_project, [[1.0, np.nan]], np.eye(2)), "values holds NaN"),
        (("xy", back_project, [[1.0, 2.0]], np.eye(3)), r"covariance must have shape \(2, 2\)"),
        (("xy", back_project, [[1.0, 2.0]], -np.eye(2)), "not positive semi-definite in row 0"),
        (("xy", lambda s: s[:1], [[1.0, 2.0]], np.eye(2)), r"function must .* shape \(2,\)"),
        (("bearing", back_project, [[1.0, 2.0]], np.eye(2)), r"function must .* shape \(1,\)"),
    ],
)
def test_measurements_that_make_no_sense(arguments, message):
    with pytest.raises(InputError, match=message):
        propagated(*arguments)


def test_views_are_those_of_the_house():
    with pytest.raises(UnknownNameError, match="unknown sensor kind 'stereo'"):
        propagated("stereo", back_project, [[1.0, 2.0]], np.eye(2))
