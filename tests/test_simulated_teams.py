"""Drawing what several robots, partial and mutual sensors and a hand-held one see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numerics import assert_same_record, assert_sampled, subtract_angles
from numpy.testing import assert_allclose, assert_array_equal
from simulated import exact_values, trio

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, LandmarkMap, Prior
from ekfslam.errors import InputError
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import RobotPlan, Scenario, SensorPlan, simulate

PERTURBATION = np.array([[4e-4, 1e-4, 0], [1e-4, 9e-4, -5e-5], [0, -5e-5, 1e-4]])


def alone(scenario: Scenario) -> Scenario:
    """The first robot without the others."""
    sensors = tuple(replace(s, mutual=False, robots=None) for s in scenario.sensors)
    return replace(scenario, team=(), sensors=sensors[:1])


def hand_held(steps: int, **changes) -> Scenario:
    """A sensor in somebody's hand amid four landmarks."""
    scenario = Scenario(
        name="held",
        landmarks=LandmarkMap(range(4), [[6, 0], [0, 6], [-6, 0], [0, -6]]),
        start=[0.0, 0.0, 3.0],
        controls=np.zeros((steps, 0)),
        motion=MotionModel("none", PERTURBATION),
        sensors=(Sensor("xy", 0.01 * np.eye(2)),),
        noise_on="motion",
    )
    return replace(scenario, **changes)


def rows_of(data: Dataset, **wanted: int) -> dict[tuple[int, ...], np.ndarray]:
    """Values of some rows by who saw whom, when and with what."""
    o = data.observations
    columns = {"step": o.step, "robot": o.robot, "sensor": o.sensor}
    columns |= {"landmark": data.true_landmark, "target": data.observed_robot}
    mask = np.ones(len(o), dtype=bool)
    for name, value in wanted.items():
        mask &= columns[name] == value
    keys = zip(*(column[mask].tolist() for column in columns.values()), strict=True)
    return dict(zip(keys, o.values[mask], strict=True))


def assert_contained(part: dict, whole: dict) -> None:
    assert 0 < len(part) <= len(whole)
    for key, value in part.items():
        assert_array_equal(value, whole[key], err_msg=str(key))


# Partial sensors -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["bearing", "range"])
def test_one_number_is_in_the_first_column_with_the_noise_that_is_stated(kind):
    sensor = Sensor(kind, [[0.0025]], mount=[0.5, -0.1, 2.0], min_range=1.0)
    data = simulate(replace(alone(trio(5000)), sensors=(sensor,)), seed=1)
    values = data.observations.values
    assert values.shape == (5000 * 9, 2)
    assert not values[:, 1].any()
    noise = sensor.difference(values[:, :1], exact_values(data)[:, :1])
    assert_sampled(noise, [[0.0025]])
    if kind == "bearing":
        assert (values[:, 0].min() >= -np.pi) & (values[:, 0].max() < np.pi)
        assert values[:, 0].max() - values[:, 0].min() > 6


def test_range_noise_of_a_beacon_grows_with_range():
    sensor = Sensor("range", [[0.0025]], range_growth=0.05, min_range=1.0)
    data = simulate(replace(alone(trio(5000)), sensors=(sensor,)), seed=1)
    exact = exact_values(data)[:, :1]
    sigma = np.sqrt(0.0025 + (0.05 * exact) ** 2)
    assert_sampled((data.observations.values[:, :1] - exact) / sigma, [[1.0]])
    assert exact.max() > 2 * exact.min()


def test_a_drawn_range_that_is_negative_is_refused():
    sensor = Sensor("range", [[100.0]], name="beacon")
    with pytest.raises(InputError, match=r"range of .* of beacon negative; raise its min_range"):
        simulate(replace(alone(trio()), sensors=(sensor,)))


# Several robots --------------------------------------------------------------------------------


def test_every_robot_has_its_own_record():
    scenario = trio()
    data = simulate(scenario, seed=1)
    assert [robot.name for robot in data.robots] == ["walker", "roller", "turner"]
    for robot, plan in zip(data.robots, scenario.robot_plans, strict=True):
        commanded = geo.integrate(plan.start, plan.motion.increment(plan.controls)[0])
        assert_allclose(robot.truth, commanded, atol=0.1)  # but for slip
        assert robot.motion == plan.motion
        assert_array_equal(robot.prior.mean, plan.start)
    for index, robot in enumerate(data.robots):
        others = [other.controls for i, other in enumerate(data.robots) if i != index]
        assert all(not np.array_equal(robot.controls, other) for other in others)


def test_the_first_robot_draws_what_it_draws_alone():
    team, one = simulate(trio(), seed=3), simulate(alone(trio()), seed=3)
    assert_same_record(team.robots[0], one.robot)
    mine = rows_of(team, robot=0, target=-1)
    assert len(mine) == len(one.observations)
    assert_contained(rows_of(one), mine)


def test_a_further_robot_changes_no_other_draw():
    whole, part = trio(), replace(trio(), team=trio().team[:1])
    three, two = simulate(whole, seed=3), simulate(part, seed=3)
    for mine, theirs in zip(two.robots, three.robots[:2], strict=True):
        assert_same_record(mine, theirs)
    seen = rows_of(three)
    assert_contained(rows_of(two), seen)
    assert len(seen) > len(rows_of(two))


def test_robots_draw_independently():
    plan = trio(20_000)
    same = [replace(plan.robot_plans[0], name=f"twin {i}") for i in (1, 2)]
    sensor = Sensor("xy", np.eye(2))
    far = LandmarkMap([0], [[1e3, 0]])
    data = simulate(replace(plan, team=same, sensors=(sensor,), landmarks=far), seed=4)
    controls = np.hstack([robot.controls - plan.controls for robot in data.robots])
    order = [data.observations.robot == robot for robot in range(3)]
    noise = (data.observations.values - exact_values(data)).reshape(-1, 2)
    seen = np.hstack([noise[mine] for mine in order])
    scale = np.tile([0.02, 0.03, 0.01], 3)
    assert_sampled(np.hstack([controls / scale, seen]), np.eye(9 + 6))


def test_no_number_is_drawn_twice():
    """Controls, landmarks, robots, descriptors, of every robot and sensor: streams of their own."""
    eye = SensorPlan("xy", np.eye(2), mutual=True)
    unit = MotionModel("odometry", np.eye(3))
    plans = [replace(p, motion=unit, controls=np.zeros((30, 3))) for p in trio(30).robot_plans]
    scenario = trio(
        motion=unit,
        controls=plans[0].controls,
        team=plans[1:],
        sensors=(eye, eye),
        descriptors=np.zeros(9),
        descriptor_sigma=1.0,
    )
    data = simulate(scenario, seed=1)
    noise = data.observations.values - exact_values(data)
    described = data.observations.descriptor
    controls = [robot.controls for robot in data.robots]
    drawn = np.concatenate([*controls, noise, described[data.true_landmark >= 0]], axis=None)
    assert len(drawn) == 3 * 30 * 3 + 3 * 2 * 30 * (9 * 3 + 2 * 2)
    assert len(np.unique(np.round(drawn, 10))) == len(drawn)


def test_priors_of_a_team_are_drawn_independently():
    prior = Prior(np.zeros(3), np.diag([0.04, 0.09, 0.01]))
    plans = [replace(p, prior=prior, draw_prior=True) for p in trio(1).robot_plans]
    scenario = replace(trio(1), prior=prior, draw_prior=True, team=plans[1:])
    means = [[r.prior.mean for r in simulate(scenario, seed=s).robots] for s in range(400)]
    assert_sampled(np.reshape(means, (400, 9)), np.kron(np.eye(3), prior.covariance))


def test_rows_are_in_order():
    data = simulate(trio(clutter=0.5), seed=1)
    o = data.observations
    what = np.where(data.true_landmark >= 0, 0, np.where(data.observed_robot >= 0, 1, 2))
    keys = np.column_stack([o.step, o.robot, o.sensor, what, data.observed_robot])
    keys = np.column_stack([keys, data.true_landmark]).tolist()
    assert keys == sorted(keys)
    assert set(what.tolist()) == {0, 1, 2}


def test_new_landmarks_are_new_to_the_whole_team():
    data = simulate(trio(new_landmarks_per_step=1), seed=1)
    everything = rows_of(simulate(trio(), seed=1))
    assert_contained(rows_of(data), everything)
    mapped: set[int] = set()
    for step in range(data.poses):
        here = data.observations.step == step
        seen = set(data.true_landmark[here].tolist()) - {-1}
        assert len(seen - mapped) <= 1
        mapped |= seen
    assert len(mapped) == 6


# Who carries what, and when it looks -----------------------------------------------------------


def test_a_sensor_is_carried_by_those_named_and_looks_at_its_own_rate():
    o = simulate(trio(), seed=1).observations
    camera = o.sensor == 1
    assert set(o.robot[camera].tolist()) == {1}
    assert set(o.robot[~camera].tolist()) == {0, 1, 2}
    assert sorted(set(o.step[camera].tolist())) == list(range(1, 41, 3))
    assert sorted(set(o.step[~camera].tolist())) == list(range(1, 41))


@pytest.mark.parametrize(
    ("plan", "settings", "expected"),
    [
        ({}, {}, [1, 2, 3, 4, 5, 6, 7, 8]),
        ({}, {"observe_start": True}, [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        ({"every": 3}, {}, [3, 6]),
        ({"every": 3}, {"observe_start": True}, [0, 3, 6]),
        ({"every": 3, "offset": 1}, {"observe_start": True}, [1, 4, 7]),
        ({"every": 3, "offset": 4}, {}, [4, 7]),
        ({"every": 3}, {"observe_every": 2}, [6]),
        ({"every": 3, "offset": 1}, {"observe_every": 2}, [4]),
    ],
)
def test_poses_at_which_a_sensor_looks(plan, settings, expected):
    sensor = SensorPlan("xy", np.eye(2), **plan)
    data = simulate(replace(alone(trio(8)), sensors=(sensor,), **settings))
    assert sorted(set(data.observations.step.tolist())) == expected


def test_a_slower_sensor_changes_no_other_draw():
    often = trio()
    seldom = replace(often, sensors=(replace(often.sensors[0], every=4), often.sensors[1]))
    part, whole = rows_of(simulate(seldom, seed=1)), rows_of(simulate(often, seed=1))
    assert_contained(part, whole)
    assert len(part) < len(whole)


# Robots that see robots ------------------------------------------------------------------------


def test_robots_see_robots_where_they_see_landmarks():
    """Every pair at every step by complex numbers: who is seen, and the noiseless value."""
    scenario = trio()
    data = simulate(scenario, seed=7, draw=0.0)
    scanner = scenario.sensors[0]
    dx, dy, turn = scanner.mount
    expected = {}
    for step in range(1, data.poses):
        for robot in range(3):
            x, y, heading = data.robots[robot].truth[step]
            origin = complex(x, y) + complex(dx, dy) * np.exp(1j * heading)
            for other in range(3):
                point = complex(*data.robots[other].truth[step, :2])
                seen = (point - origin) * np.exp(-1j * (heading + turn))
                if other != robot and 1 <= abs(seen) <= 9 and abs(np.angle(seen)) <= 2:
                    expected[step, robot, 0, -1, other] = (abs(seen), np.angle(seen))
    got = {key: value for key, value in rows_of(data).items() if key[-1] >= 0}
    assert got.keys() == expected.keys()
    assert 20 < len(got) < 240
    for key, value in got.items():
        assert_allclose(value, expected[key], atol=1e-12)
    mutual = data.observed_robot >= 0
    assert (data.observations.landmark[mutual] == -1).all()
    assert (data.true_landmark[mutual] == -1).all()
    assert data.association_known


def test_noise_of_what_robots_see_of_robots_is_that_of_the_sensor():
    data = simulate(trio(20_000), seed=2)
    mutual = data.observed_robot >= 0
    noise = (data.observations.values - exact_values(data))[mutual]
    noise[:, 1] = subtract_angles(noise[:, 1], 0.0)
    assert len(noise) > 20_000
    assert_sampled(noise, trio().sensors[0].covariance)


def test_seeing_robots_or_not_changes_no_other_draw():
    blind = trio()
    blind = replace(blind, sensors=(replace(blind.sensors[0], mutual=False), blind.sensors[1]))
    without, seeing = simulate(blind, seed=1), simulate(trio(), seed=1)
    assert without.observations.observed_robot is None
    assert_contained(rows_of(without), rows_of(seeing))
    assert len(without.observations) == (seeing.observed_robot < 0).sum()


# A hand-held sensor ----------------------------------------------------------------------------


def test_a_hand_held_sensor_moves_by_the_perturbation_alone(tmp_path):
    data = simulate(hand_held(20_000), seed=1)
    assert data.robot.controls.shape == (20_000, 0)
    increments = geo.between(data.truth[:-1], data.truth[1:])
    assert_sampled(increments, PERTURBATION)
    assert not data.robot.increments.deltas.any()
    assert_array_equal(data.robot.increments.covariances, np.tile(PERTURBATION, (20_000, 1, 1)))
    data.save(tmp_path / "held.npz")
    assert_same_record(Dataset.load(tmp_path / "held.npz"), data)


def test_noise_of_a_hand_held_sensor_is_scaled():
    full, half = simulate(hand_held(50), seed=1), simulate(hand_held(50), 1, odometry_noise=0.5)
    whole, part = (geo.between(d.truth[:-1], d.truth[1:]) for d in (full, half))
    assert_allclose(part, whole / 2, atol=1e-14)
    assert_allclose(half.robot.motion.covariance, PERTURBATION / 4)
    still = simulate(hand_held(50), seed=1, draw=0.0)
    assert_array_equal(still.truth, np.tile([0.0, 0.0, 3.0], (51, 1)))


def test_a_hand_held_sensor_has_a_time_step():
    data = simulate(hand_held(3, time_step=0.1))
    assert_allclose(data.times, [0.0, 0.1, 0.2, 0.3])


def test_a_hand_held_sensor_may_be_in_a_team():
    held = RobotPlan([0, 0, 0], np.zeros((40, 0)), MotionModel("none", PERTURBATION), name="held")
    data = simulate(trio(team=(held,), noise_on="motion", sensors=trio().sensors[:1]), seed=1)
    assert [robot.controls.shape for robot in data.robots] == [(40, 3), (40, 0)]
    assert data.moves.deltas.shape == (2, 41, 3)
    with pytest.raises(InputError, match=r"held has no control to measure .* noise_on to 'motion'"):
        trio(team=(held,), sensors=trio().sensors[:1])


# What is refused -------------------------------------------------------------------------------


def with_first_sensor(**changes):
    first, *rest = trio().sensors
    return trio(sensors=(replace(first, **changes), *rest))


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: trio(robot_name="roller"), "robots need names of their own, got roller, roller"),
        (lambda: trio(controls=np.zeros((3, 3))), "roller makes 40 and walker 3"),
        (lambda: trio(team=trio().team[1:]), "camera is of no robot 'roller'; known: turner"),
        (lambda: with_first_sensor(every=0), "every of scanner must be at least 1, got 0"),
        (lambda: with_first_sensor(offset=-1), "offset of scanner must be at least 0, got -1"),
        (lambda: with_first_sensor(max_range=0.0), "scanner needs 0 <= min_range"),
        (
            lambda: trio(team=(), sensors=trio().sensors[:1]),
            "mutual of scanner needs several robots",
        ),
    ],
)
def test_teams_that_make_no_sense(build, message):
    with pytest.raises(InputError, match=message):
        build()


def test_robots_share_the_times_of_their_poses():
    def rider(dt):
        motion = MotionModel("velocity", np.eye(2), slip=1e-3)
        return RobotPlan([0, 0, 0], np.tile([0.1, 0.1, dt], (40, 1)), motion, name="rider")

    sensors = trio().sensors[:1]
    assert_allclose(simulate(trio(team=(rider(0.5),), sensors=sensors)).times[:3], [0, 0.5, 1])
    with pytest.raises(InputError, match="time_step is the dt of 'velocity' controls"):
        trio(team=(rider(0.5),), sensors=sensors, time_step=0.5)
    other = replace(rider(0.25), name="other")
    with pytest.raises(InputError, match="the dt of other's controls differ"):
        trio(team=(rider(0.5), other), sensors=sensors)


def test_plans_of_sensors_can_be_compared():
    plan = trio().sensors[0]
    assert plan == replace(plan)
    assert plan != replace(plan, every=2)
    assert SensorPlan(**plan.to_dict()) == plan
    stated = plan.stated(1.0)
    assert type(stated) is Sensor
    assert stated.to_dict().items() <= plan.to_dict().items()
