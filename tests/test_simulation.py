"""Drawing datasets from scenarios: determinism, scaling, statistics, policies."""

import tracemalloc
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from simulated import exact_values

from ekfslam import geometry as geo
from ekfslam.dataset import LandmarkMap, Prior
from ekfslam.errors import InputError
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import Scenario, describe_scenario, load_scenario, scenarios, simulate
from ekfslam.simulation.draws import shaped

# Scenarios whose files are here.
HERE = [name for name in scenarios() if "[not here" not in describe_scenario(name)]
CORRELATED = np.array([[4e-4, 3e-4, 0], [3e-4, 9e-4, -1e-4], [0, -1e-4, 1e-4]])


def two_sensors(steps: int = 60, **changes) -> Scenario:
    """A robot with a scanner ahead of the axle and a camera that looks back over its shoulder."""
    scenario = Scenario(
        name="two-sensors",
        landmarks=LandmarkMap(
            range(8), [[6, 0], [5, 4], [0, 7], [-4, 5], [-6, 0], [-5, -5], [0, -6], [4, -5]]
        ),
        start=[0.0, -3.0, 0.3],
        controls=np.tile([0.3, 0.02, 0.1], (steps, 1)),
        motion=MotionModel("odometry", covariance=CORRELATED),
        sensors=(
            Sensor(
                "range-bearing",
                [[0.01, 0.001], [0.001, 0.0004]],
                mount=[0.5, 0.1, 0.2],
                max_range=8.0,
                field_of_view=np.pi,
                range_growth=0.01,
                name="scanner",
            ),
            Sensor(
                "xy",
                [[0.04, 0.01], [0.01, 0.02]],
                mount=[-0.4, 0.0, 2.8],
                min_range=2.0,
                name="camera",
            ),
        ),
        prior=Prior([0.0, -3.0, 0.3], np.diag([0.04, 0.09, 0.01])),
        draw_prior=True,
        observe_start=True,
    )
    return replace(scenario, **changes)


def long_run(steps: int, **changes) -> Scenario:
    """Small circles around a single landmark, for statistics."""
    values = {
        "landmarks": LandmarkMap([0], [[6.0, 0.0]]),
        "controls": np.tile([0.1, 0.02, 0.1], (steps, 1)),
        "sensors": (Sensor("xy", [[0.04, 0.01], [0.01, 0.02]]),),
    }
    return two_sensors(**{**values, **changes})


def deviations(dataset, scenario):
    """Everything that was drawn, as differences to what would have been without noise."""
    rows = dataset.observations
    exact = exact_values(dataset)
    noise = np.empty_like(rows.values)
    for index, sensor in enumerate(dataset.sensors):
        mine = rows.sensor == index
        noise[mine] = sensor.difference(rows.values[mine], exact[mine])
    increments = geo.between(dataset.truth[:-1], dataset.truth[1:])
    commanded = scenario.motion.increment(scenario.controls)[0]
    return {
        "controls": dataset.robot.controls - scenario.controls,
        "increments": increments - commanded,
        "observations": noise,
        "prior": dataset.prior.mean - scenario.prior.mean,
    }


def assert_covariance(samples, expected):
    """Sample covariance about zero within 5 standard errors, entry by entry (Wishart)."""
    count = len(samples)
    variance = np.outer(np.diag(expected), np.diag(expected)) + expected**2
    error = samples.T @ samples / count - expected
    assert (np.abs(error) <= 5 * np.sqrt(variance / count) + 1e-15).all()
    assert (np.abs(samples.mean(axis=0)) <= 5 * np.sqrt(np.diag(expected) / count) + 1e-12).all()


# Determinism -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", HERE)
def test_same_seed_same_bytes_and_another_seed_another_draw(name, tmp_path):
    simulate(name, seed=3).save(tmp_path / "a.npz")
    simulate(name, seed=3).save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    one, other = simulate(name, seed=3), simulate(name, seed=4)
    for mine, theirs in zip(one.robots, other.robots, strict=True):
        driven = [np.concatenate([r.controls, r.truth[1:]], axis=1) for r in (mine, theirs)]
        assert not np.array_equal(*driven)
    assert not np.array_equal(one.observations.values, other.observations.values)
    np.testing.assert_array_equal(one.true_map.positions, other.true_map.positions)


@pytest.mark.parametrize(
    ("name", "count", "sums"),
    [
        ("park", 6614, [0.5150510058882105, 38.161794091638725, -62.71808609554233, -437.23898703]),
        (
            "cloister",
            7200,
            [0.08649533024299264, 4.603799053772342, -14.0746247539, -178.887501044],
        ),
        (
            "loop-15",
            2674,
            [1.4221390230247033, 10.042193492752435, -25.835349787285626, -5.17603924],
        ),
    ],
)
def test_the_first_scenarios_draw_what_they_always_drew(name, count, sums):
    """Published results rest on these: sums with weights cos 0, cos 1, ... over each array."""
    data = simulate(name, seed=1)
    arrays = (data.robot.controls, data.truth, data.observations.values, data.observations.step)
    weighted = [np.cos(np.arange(array.size)) @ array.ravel() for array in arrays]
    assert len(data.observations) == count
    np.testing.assert_allclose(weighted, sums, rtol=1e-9)
    assert data.observations.observed_robot is None
    assert data.observations.descriptor is None


def test_memory_chunks_do_not_change_the_draw(monkeypatch):
    scenario = two_sensors(descriptors=np.arange(8.0), descriptor_sigma=0.1)
    whole = simulate(scenario, seed=5)
    module = import_module("ekfslam.simulation.sightings")
    monkeypatch.setattr(module, "PAIRS_AT_ONCE", 17)
    chunked = simulate(scenario, seed=5)
    for name in ("values", "descriptor"):
        np.testing.assert_array_equal(
            getattr(whole.observations, name), getattr(chunked.observations, name)
        )
    np.testing.assert_array_equal(whole.true_landmark, chunked.true_landmark)


def test_a_further_sensor_changes_no_other_draw():
    both = two_sensors()
    one = replace(both, sensors=both.sensors[:1])
    a, b = simulate(one, seed=2), simulate(both, seed=2)
    np.testing.assert_array_equal(a.robot.controls, b.robot.controls)
    np.testing.assert_array_equal(a.prior.mean, b.prior.mean)
    first = b.observations.sensor == 0
    np.testing.assert_array_equal(a.observations.values, b.observations.values[first])


def test_a_shorter_sight_changes_no_other_draw():
    both = two_sensors()
    near = replace(both.sensors[0], max_range=5.0)
    a, b = simulate(replace(both, sensors=(near,)), seed=2), simulate(both, seed=2)
    kept = {(s, i): v for s, i, v in _rows(b, sensor=0)}
    assert 0 < len(a.observations) < len(kept)
    for step, landmark, value in _rows(a, sensor=0):
        np.testing.assert_array_equal(value, kept[step, landmark])


def _rows(dataset, sensor):
    rows = dataset.observations
    for k in np.flatnonzero(rows.sensor == sensor):
        yield int(rows.step[k]), int(dataset.true_landmark[k]), rows.values[k]


# Scaling one draw ------------------------------------------------------------------------------


def test_half_the_noise_is_half_of_every_deviation_and_of_every_stated_sigma():
    # The scanner's range noise grows with range, and here noise is on the odometry: the truth and
    # with it the exact values are the same for both.
    scenario = two_sensors()
    full, half = simulate(scenario, seed=1), simulate(scenario, seed=1, noise=0.5)
    np.testing.assert_array_equal(full.truth, half.truth)
    whole, part = deviations(full, scenario), deviations(half, scenario)
    for name in ("controls", "observations", "prior"):
        assert np.abs(whole[name]).max() > 1e-3
        np.testing.assert_allclose(part[name], whole[name] / 2, atol=1e-14)
    np.testing.assert_allclose(half.robot.motion.covariance, CORRELATED / 4)
    np.testing.assert_allclose(half.prior.covariance, full.prior.covariance / 4)
    for small, large in zip(half.sensors, full.sensors, strict=True):
        np.testing.assert_allclose(small.covariance, large.covariance / 4)
        assert small.range_growth == large.range_growth / 2


def test_scaled_slip_and_motion_noise_disturb_the_truth_in_proportion():
    scenario = two_sensors(
        noise_on="motion", motion=MotionModel("odometry", CORRELATED, slip=0.05), draw_prior=False
    )
    full, half = simulate(scenario, seed=1), simulate(scenario, seed=1, noise=0.5)
    whole, part = deviations(full, scenario), deviations(half, scenario)
    assert half.robot.motion.slip == 0.025
    np.testing.assert_allclose(part["increments"], whole["increments"] / 2, atol=1e-13)


def test_scaled_proportional_noise():
    motion = MotionModel("wheel-increments", proportional=(0.1, 0.2), width=0.5)
    scenario = two_sensors(motion=motion, controls=np.tile([0.1, 0.15], (50, 1)))
    full, half = simulate(scenario, seed=1), simulate(scenario, seed=1, noise=0.5)
    assert half.robot.motion.proportional == (0.05, 0.1)
    np.testing.assert_allclose(
        half.robot.controls - scenario.controls,
        (full.robot.controls - scenario.controls) / 2,
        atol=1e-15,
    )


@pytest.mark.parametrize("name", HERE)
def test_nothing_drawn_is_the_truth_that_still_states_its_noise(name):
    data, noisy = simulate(name, draw=0.0), simulate(name)
    for robot, loud in zip(data.robots, noisy.robots, strict=True):
        integrated = geo.integrate(robot.prior.mean, robot.increments.deltas)
        np.testing.assert_allclose(integrated, robot.truth, atol=1e-12)
        np.testing.assert_array_equal(robot.motion.covariance, loud.motion.covariance)
        np.testing.assert_array_equal(robot.prior.covariance, loud.prior.covariance)
        assert robot.motion.covariance.any()
    exact = exact_values(data)
    shown = np.isfinite(exact).all(axis=1)
    assert shown.mean() > 0.9  # the rest is clutter
    np.testing.assert_allclose(data.observations.values[shown], exact[shown], atol=1e-12)
    for quiet, loud in zip(data.sensors, noisy.sensors, strict=True):
        np.testing.assert_array_equal(quiet.covariance, loud.covariance)


@pytest.mark.parametrize("noise_on", ["odometry", "motion"])
def test_odometry_noise_scales_controls_and_slip_alone(noise_on):
    motion = MotionModel("odometry", CORRELATED, slip=0.05)
    scenario = two_sensors(motion=motion, noise_on=noise_on)
    full, half = simulate(scenario, seed=1), simulate(scenario, seed=1, odometry_noise=0.5)
    whole, part = deviations(full, scenario), deviations(half, scenario)
    for name in ("controls", "increments"):
        np.testing.assert_allclose(part[name], whole[name] / 2, atol=1e-13)
    np.testing.assert_array_equal(half.prior.mean, full.prior.mean)
    np.testing.assert_allclose(half.robot.motion.covariance, CORRELATED / 4)
    assert half.robot.motion.slip == 0.025
    assert half.sensors == full.sensors
    assert "odometry noise 0.5" in half.provenance
    assert "odometry noise" not in full.provenance


def test_odometry_noise_leaves_what_is_seen_from_an_undisturbed_path():
    full, double = simulate(two_sensors(), seed=1), simulate(two_sensors(), 1, odometry_noise=2.0)
    np.testing.assert_array_equal(full.truth, double.truth)
    np.testing.assert_array_equal(full.observations.values, double.observations.values)
    assert not np.array_equal(full.robot.controls, double.robot.controls)


def test_odometry_noise_multiplies_noise():
    scenario = two_sensors(motion=MotionModel("odometry", CORRELATED, slip=0.05))
    both = simulate(scenario, seed=1, noise=0.5, odometry_noise=2.0)
    half, full = simulate(scenario, seed=1, noise=0.5), simulate(scenario, seed=1)
    np.testing.assert_array_equal(both.robot.controls, full.robot.controls)
    assert both.robot.motion == full.robot.motion
    assert both.sensors == half.sensors


def test_draw_scales_what_is_drawn_alone():
    scenario = two_sensors()
    once, twice = simulate(scenario, seed=9), simulate(scenario, seed=9, draw=2.0)
    whole, double = deviations(once, scenario), deviations(twice, scenario)
    for name in ("controls", "observations", "prior"):
        np.testing.assert_allclose(double[name], 2 * whole[name], atol=1e-13)
    np.testing.assert_array_equal(once.prior.covariance, twice.prior.covariance)


# Statistics ------------------------------------------------------------------------------------


def test_control_noise_has_the_stated_covariance():
    scenario = long_run(20_000)
    data = simulate(scenario, seed=11)
    assert_covariance(data.robot.controls - scenario.controls, CORRELATED)


@pytest.mark.parametrize("noise_on", ["odometry", "motion"])
def test_slip_has_the_stated_sigma_along_the_body_y_axis(noise_on):
    motion = MotionModel("odometry", np.zeros((3, 3)), slip=0.05)
    scenario = long_run(5_000, motion=motion, noise_on=noise_on)
    slips = deviations(simulate(scenario, seed=12), scenario)["increments"]
    assert np.abs(slips[:, [0, 2]]).max() < 1e-10
    assert_covariance(slips[:, 1:2], np.array([[0.05**2]]))


@pytest.mark.parametrize("noise_on", ["odometry", "motion"])
def test_error_of_the_increments_has_the_covariance_that_the_dataset_states(noise_on):
    # What an estimator sees: true minus measured increment, against Robot.increments. The noise is
    # small, so that the Jacobian at the measured control is that at the true one to 1e-3.
    motion = MotionModel("velocity", np.diag([1e-6, 4e-6]), slip=1e-3)
    controls = np.tile([0.25, 0.6, 1.0], (20_000, 1))
    scenario = long_run(1, motion=motion, controls=controls, noise_on=noise_on)
    data = simulate(scenario, seed=13)
    stated = data.robot.increments
    errors = geo.between(data.truth[:-1], data.truth[1:]) - stated.deltas
    assert_covariance(errors, stated.covariances.mean(axis=0))


def test_measurement_noise_has_the_stated_covariance():
    scenario = long_run(20_000)
    data = simulate(scenario, seed=14)
    assert_covariance(deviations(data, scenario)["observations"], scenario.sensors[0].covariance)


def test_range_noise_grows_with_range():
    sensor = Sensor("range-bearing", np.diag([0.01, 0.0004]), range_growth=0.05)
    landmarks = LandmarkMap([0, 1], [[9.0, 0.0], [50.0, 0.0]])
    scenario = long_run(10_000, sensors=(sensor,), landmarks=landmarks)
    data = simulate(scenario, seed=15)
    noise = deviations(data, scenario)["observations"]
    sigma = np.sqrt(0.01 + (0.05 * exact_values(data)[:, 0]) ** 2)
    for landmark in (0, 1):
        mine = data.true_landmark == landmark
        whitened = np.column_stack([noise[mine, 0] / sigma[mine], noise[mine, 1] / 0.02])
        assert_covariance(whitened, np.eye(2))


def test_streams_are_independent():
    scenario = long_run(20_000, motion=MotionModel("odometry", np.eye(3) * 1e-6, slip=1e-3))
    scenario = replace(scenario, sensors=(Sensor("xy", np.eye(2)), Sensor("xy", np.eye(2))))
    parts = deviations(simulate(scenario, seed=16), scenario)
    first, second = (parts["observations"][k::2][1:] for k in (0, 1))
    joint = np.column_stack(
        [parts["controls"] * 1e3, parts["increments"][:, 1] * 1e3, first, second]
    )
    assert_covariance(joint, np.eye(8))


def test_prior_mean_is_drawn_from_the_prior():
    scenario = two_sensors(steps=1)
    draws = [deviations(simulate(scenario, seed=s), scenario)["prior"] for s in range(500)]
    assert_covariance(np.array(draws), scenario.prior.covariance)


def test_prior_is_the_exact_start_by_default_and_is_not_drawn_unasked():
    known = simulate(two_sensors(prior=None, draw_prior=False))
    np.testing.assert_array_equal(known.prior.mean, known.truth[0])
    assert not known.prior.covariance.any()
    stated = simulate(two_sensors(draw_prior=False))
    np.testing.assert_array_equal(stated.prior.mean, stated.truth[0])
    assert stated.prior.covariance.any()


def test_drawn_heading_is_wrapped():
    prior = Prior([0, -3, np.pi - 1e-3], np.diag([0, 0, 0.04]))
    headings = [simulate(two_sensors(1, prior=prior), seed=s).prior.mean[2] for s in range(20)]
    assert min(headings) < -2
    assert all(-np.pi <= heading < np.pi for heading in headings)


@pytest.mark.parametrize("covariance", [CORRELATED, np.diag([1.0, 0, 0]), np.zeros((3, 3))])
def test_shaping_is_a_square_root(covariance):
    root = shaped(np.broadcast_to(covariance, (3, 3, 3)), np.eye(3))
    np.testing.assert_allclose(root @ root.T, covariance, atol=1e-15)
    np.testing.assert_allclose(root, root.T, atol=1e-15)


# Where the noise goes --------------------------------------------------------------------------


def test_noise_on_odometry_leaves_the_truth_at_the_command():
    scenario = two_sensors()
    data = simulate(scenario, seed=1)
    np.testing.assert_allclose(
        data.truth, geo.integrate(scenario.start, scenario.controls), atol=1e-13
    )
    np.testing.assert_array_equal(data.truth, simulate(scenario, seed=2).truth)
    assert (np.abs(data.robot.controls - scenario.controls) > 0).all()


def test_noise_on_motion_leaves_the_measured_controls_at_the_command():
    scenario = two_sensors(noise_on="motion")
    data = simulate(scenario, seed=1)
    np.testing.assert_array_equal(data.robot.controls, scenario.controls)
    disturbed = deviations(data, scenario)["increments"]
    assert (np.abs(disturbed).max(axis=0) > 1e-3).all()
    # It is the same draw that perturbs the measured odometry in the other mode.
    perturbed = deviations(simulate(two_sensors(), seed=1), scenario)["controls"]
    np.testing.assert_allclose(disturbed, perturbed, atol=1e-13)


def test_an_exact_dt_stays_exact():
    data = simulate("loop-15")
    assert (data.robot.controls[:, 2] == 1.0).all()


# What is seen ----------------------------------------------------------------------------------


def test_two_mounted_sensors_see_what_they_should():
    scenario = two_sensors()
    data = simulate(scenario, seed=7, draw=0.0)
    rows = data.observations
    expected = [
        (step, number, landmark)
        for step, (x, y, heading) in enumerate(data.truth)
        for number, (dx, dy, turn, least, most, opening) in enumerate(
            [(0.5, 0.1, 0.2, 0, 8, np.pi), (-0.4, 0, 2.8, 2, np.inf, 2 * np.pi)]
        )
        for landmark, (lx, ly) in enumerate(data.true_map.positions)
        if _complex_view(x, y, heading, dx, dy, turn, lx, ly, least, most, opening) is not None
    ]
    got = list(zip(rows.step, rows.sensor, data.true_landmark, strict=True))
    assert got == expected
    assert {0, 1} == set(rows.sensor.tolist())
    for k, (step, number, landmark) in enumerate(expected):
        mount = scenario.sensors[number].mount
        seen = _complex_view(*data.truth[step], *mount, *data.true_map.positions[landmark])
        value = (abs(seen), np.angle(seen)) if number == 0 else (seen.real, seen.imag)
        np.testing.assert_allclose(rows.values[k], value, atol=1e-12)


def _complex_view(x, y, heading, dx, dy, turn, lx, ly, least=0, most=np.inf, opening=2 * np.pi):
    """A landmark in a mounted sensor's frame by complex numbers; None if it is not seen."""
    sensor = complex(x, y) + complex(dx, dy) * np.exp(1j * heading)
    seen = (complex(lx, ly) - sensor) * np.exp(-1j * (heading + turn))
    inside = least <= abs(seen) <= most and abs(np.angle(seen)) <= opening / 2
    return seen if inside else None


@pytest.mark.parametrize("far", [0.0, 1e6])
def test_landmarks_at_the_edge_of_the_range_are_seen_as_the_sensor_says(far):
    # Ahead, beside and behind, where a square about the sensor touches the circle that it sees.
    edge = [[far + 5 * np.cos(a), far + 5 * np.sin(a)] for a in np.linspace(0, 2 * np.pi, 17)]
    sensor = Sensor("xy", np.eye(2), max_range=5.0)
    scenario = two_sensors(
        landmarks=LandmarkMap(range(17), edge),
        start=[far, far, 0.0],
        controls=np.tile([0.0, 0.0, np.pi / 8], (64, 1)),
        sensors=(sensor,),
    )
    data = simulate(scenario, seed=1)
    seen = sensor.sees(data.truth[:, None], data.true_map.positions)
    seen[0] &= scenario.observe_start
    assert 0.1 < seen.mean() < 1
    step, landmark = np.nonzero(seen)
    np.testing.assert_array_equal(data.observations.step, step)
    np.testing.assert_array_equal(data.true_landmark, landmark)


def test_no_table_of_all_poses_and_landmarks_is_held():
    changes = {"world.descriptors": [0.2, 0.5], "descriptor_sigma": 0.1}
    scenario = load_scenario("city", changes)
    tracemalloc.start()
    data = simulate(scenario)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * data.poses * len(data.true_map)  # of one number for each pair


def test_visibility_is_decided_on_the_truth_not_on_the_noisy_values():
    data = simulate("park", seed=1, noise=3.0)
    exact = exact_values(data)
    assert exact[:, 0].max() <= 10.0
    assert data.observations.values[:, 0].max() > 10.0
    quiet = simulate("park", seed=1, draw=0.0)
    np.testing.assert_array_equal(quiet.true_landmark, data.true_landmark)


def test_bearings_are_wrapped():
    bearings = simulate("cloister").observations.values[:, 1]
    assert bearings.min() >= -np.pi
    assert bearings.max() < np.pi
    assert bearings.max() - bearings.min() > 6  # some are near the cut


def test_poses_that_observe():
    def observed(**changes):
        return sorted(set(simulate(two_sensors(10, **changes)).observations.step.tolist()))

    assert observed() == list(range(11))
    assert observed(observe_start=False) == list(range(1, 11))
    assert observed(observe_every=4) == [0, 4, 8]
    assert observed(observe_every=4, observe_start=False) == [4, 8]


def test_unknown_association_hides_the_identities_and_nothing_else():
    known, unknown = (simulate(two_sensors(association=a), seed=1) for a in ("known", "unknown"))
    assert known.association_known
    assert (unknown.observations.landmark == -1).all()
    np.testing.assert_array_equal(known.observations.landmark, known.true_landmark)
    np.testing.assert_array_equal(unknown.true_landmark, known.true_landmark)
    np.testing.assert_array_equal(unknown.observations.values, known.observations.values)


def test_identities_are_those_of_the_map():
    landmarks = LandmarkMap([7, 3], [[6.0, 0.0], [0.0, 7.0]])
    data = simulate(two_sensors(landmarks=landmarks))
    assert set(data.true_landmark.tolist()) == {3, 7}


@pytest.mark.parametrize("limit", [1, 3])
def test_new_landmarks_come_a_few_at_a_time(limit):
    everything = simulate(load_scenario("cloister"), seed=4)
    slow = simulate(replace(load_scenario("cloister"), new_landmarks_per_step=limit), seed=4)
    rows = {(s, i): v for s, i, v in _rows(everything, 0)}
    mapped: set[int] = set()
    for step in range(1, 201):
        seen = set(slow.true_landmark[slow.observations.step == step].tolist())
        # All 36 are in view, so every mapped one is seen and `limit` join until none is left.
        assert mapped <= seen
        assert len(seen - mapped) == min(limit, 36 - len(mapped))
        mapped |= seen
    # What is kept is what was there: the policy drops rows and draws nothing anew.
    for step, landmark, value in _rows(slow, 0):
        np.testing.assert_array_equal(value, rows[step, landmark])
    np.testing.assert_array_equal(slow.robot.controls, everything.robot.controls)


def test_new_landmarks_are_picked_at_random():
    scenario = replace(load_scenario("cloister"), new_landmarks_per_step=1)
    firsts = {int(simulate(scenario, seed=s).true_landmark[0]) for s in range(20)}
    assert len(firsts) > 5  # 20 draws of 36 hold 5 or fewer distinct ones once in 1e11


def test_both_sensors_may_see_a_new_landmark():
    scenario = two_sensors(new_landmarks_per_step=1)
    data = simulate(scenario, seed=1)
    allowed: set[int] = set()
    both = 0
    for step in range(61):
        rows = data.observations.step == step
        seen = data.true_landmark[rows].tolist()
        fresh = set(seen) - allowed
        assert len(fresh) <= 1
        both += any(seen.count(landmark) == 2 for landmark in fresh)
        allowed |= fresh
    assert both > 0


# Records and errors ----------------------------------------------------------------------------


def test_dataset_says_where_it_comes_from():
    data = simulate("cloister", seed=42, noise=0.5)
    assert data.name == "cloister"
    assert data.seed == 42
    assert "cloister" in data.provenance
    assert "42" in data.provenance
    assert "0.5" in data.provenance


def test_a_world_that_is_never_seen_makes_a_dataset_without_observations():
    far = LandmarkMap([0], [[500.0, 0.0]])
    scenario = two_sensors(landmarks=far, sensors=(Sensor("xy", np.eye(2), max_range=5.0),))
    for limit in (None, 1):
        assert len(simulate(replace(scenario, new_landmarks_per_step=limit)).observations) == 0


def test_a_negative_range_is_an_error_that_says_what_to_do():
    near = LandmarkMap([0], [[0.0, -2.99]])
    sensor = Sensor("range-bearing", np.diag([1.0, 0.01]), name="scanner")
    with pytest.raises(InputError, match=r"range of .* of scanner negative; raise its min_range"):
        simulate(two_sensors(landmarks=near, sensors=(sensor,)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": -1}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"noise": -1.0}, "noise"),
        ({"noise": float("nan")}, "noise"),
        ({"draw": float("inf")}, "draw"),
        ({"odometry_noise": -1.0}, "odometry_noise"),
    ],
)
def test_senseless_arguments_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        simulate("cloister", **arguments)
