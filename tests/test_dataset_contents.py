"""The dataset: what it derives, how it moves, and that nothing in it changes."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest
from made import MOTION, NOISE, assert_refused, make, pair, twice
from numerics import assert_same_record, subtract_last_angle
from numpy.testing import assert_allclose, assert_array_equal

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, Prior, Robot
from ekfslam.errors import UnsupportedError
from ekfslam.models.sensors import VIEWS, Sensor
from ekfslam.observations import Observations, Sightings

# What it derives -------------------------------------------------------------------------------


def test_defaults_of_the_columns():
    observations = make(step=[0, 2], values=[[1, 0], [2, 0]]).observations
    assert_array_equal(observations.landmark, [-1, -1])
    assert_array_equal(observations.sensor, [0, 0])
    assert_array_equal(observations.robot, [0, 0])
    for name in ("time", "covariance", "observed_robot", "descriptor"):
        assert getattr(observations, name) is None


def test_observation_times_are_those_of_the_steps_unless_given():
    times = [0.0, 0.4, 1.5]
    assert_array_equal(
        make(times=times, step=[1, 2], values=[[1, 0]] * 2).observation_times, [0.4, 1.5]
    )
    assert_array_equal(make(times=times, time=[0.45]).observation_times, [0.45])


def test_association_is_known_when_every_row_has_an_identity():
    assert make(landmark=[0]).association_known
    assert not make().association_known
    assert not twice(landmark=[4, -1]).association_known


def test_sightings_look_up_the_sensor_of_each_row():
    growing = Sensor("range-bearing", NOISE, mount=[0.1, 0.2, 0.3], range_growth=0.1)
    camera = Sensor("xy", 4 * NOISE, mount=[-0.1, 0.0, 3.0])
    columns = {
        "step": [0, 1, 1],
        "values": [[2.0, 0.1], [3.0, -4.0], [5.0, 0.2]],
        "sensor": [0, 1, 0],
        "landmark": [5, -1, 6],
    }
    sightings = make(sensors=(growing, camera), **columns).sightings
    assert_array_equal(sightings.kind, [growing.view.code, camera.view.code, growing.view.code])
    assert_array_equal(sightings.mount, [growing.mount, camera.mount, growing.mount])
    assert_array_equal(sightings.landmark, [5, -1, 6])
    expected = [NOISE + np.diag([0.04, 0]), 4 * NOISE, NOISE + np.diag([0.25, 0])]
    assert_allclose(sightings.covariance, expected, rtol=1e-15)


def test_covariance_of_a_row_goes_before_that_of_its_sensor():
    given = [[[2.0, 0.5], [0.5, 3.0]]]
    assert_array_equal(make(covariance=given).sightings.covariance, given)


def test_sightings_of_one_sensor_are_those_of_a_dataset():
    sensor = Sensor("range-bearing", NOISE, mount=[0.1, 0.2, 0.3], range_growth=0.1)
    values, landmark = [[2.0, 0.1], [5.0, 0.2]], [8, 9]
    data = make(sensors=(sensor,), step=[1, 1], values=values, landmark=landmark)
    alone = Sightings.of(sensor, values, landmark)
    for mine, theirs in zip(alone, data.sightings, strict=True):
        assert mine.dtype == theirs.dtype
        assert_array_equal(mine, theirs)
    assert_array_equal(Sightings.of(sensor, values).landmark, [-1, -1])
    assert_refused("values must have shape", Sightings.of, sensor, [1.0, 2.0])
    assert_refused("landmark must have shape", Sightings.of, sensor, values, [1])


@pytest.mark.parametrize("kind", VIEWS)
def test_sightings_of_robots_and_of_any_sensor_are_those_of_a_dataset(kind):
    size = 1 if kind in ("bearing", "range") else 2
    sensor = Sensor(kind, NOISE[:size, :size], [0.1, 0.2, 0.3], 0.5, 9.0, 3.0)
    values = np.array([[2.0, 0.1], [1.0, -0.2]])[:, :size]
    data = pair(sensors=(sensor,), values=values, robot=[0, 0], descriptor=[0.3, np.nan])
    alone = Sightings.of(sensor, values, [4, -1], 0, [-1, 1], [0.3, np.nan])
    for mine, theirs in zip(alone, data.sightings, strict=True):
        assert mine.dtype == theirs.dtype
        assert_array_equal(mine, theirs)
    for mine, theirs in zip(alone.checked(), alone, strict=True):
        assert_array_equal(mine, theirs)
    assert_array_equal(alone.limits, [[0.5, 9.0, 1.5]] * 2)
    if size == 1:
        assert_refused(r"values must have shape \(n, 1\)", Sightings.of, sensor, [[1.0, 0.0]])


def test_defaults_of_sightings():
    alone = Sightings.of(Sensor("xy", NOISE), [[1.0, 2.0]], robot=3)
    assert_array_equal(alone.robot, [3])
    assert_array_equal(alone.target, [-1])
    assert np.isnan(alone.descriptor).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": [9, 9]}, "kind holds a code of no view"),
        ({"values": [[-1.0, 0.0], [1.0, 0.0]]}, "negative range"),
        ({"values": [[1.0, 0.1], [1.0, 0.0]]}, "reports one number"),
        ({"robot": [-1, 0]}, "robot must not be negative"),
        ({"target": [-2, 1]}, "nor observed_robot below -1"),
        ({"target": [-1, 0]}, "a robot cannot see itself"),
        ({"target": [1, -1]}, "a robot and a landmark at once"),
        ({"landmark": [-2, -1]}, "landmark must not be below -1"),
        ({"landmark": [-1, -1], "target": [1, 1]}, "cannot see the same thing twice"),
        ({"covariance": [-np.eye(2), np.eye(2)]}, "not positive semi-definite"),
        ({"mount": np.full((2, 3), np.nan)}, "mount holds NaN"),
        ({"limits": [[0.0, 1.0], [0.0, 1.0]]}, r"limits must have shape \(2, 3\)"),
        ({"descriptor": [0.1]}, r"descriptor must have shape \(2,\)"),
    ],
)
def test_sightings_that_make_no_sense(changes, message):
    sensor = Sensor("range", [[0.01]])
    good = Sightings.of(sensor, [[2.0], [1.0]], [4, -1], 0, [-1, 1])
    assert len(good.checked().values) == 2
    assert_refused(message, good._replace(**changes).checked)


def test_robots_that_look_at_once_have_looks_of_their_own():
    columns = {
        "step": [1, 1, 1],
        "values": np.ones((3, 2)),
        "landmark": [4, 4, 5],
        "robot": [0, 1, 1],
        "observed_robot": [-1, -1, -1],
    }
    assert_array_equal(np.diff(pair(**columns).sightings.look) != 0, [True, False])


def test_a_look_is_what_one_sensor_sees_at_one_instant():
    sensors = (Sensor("xy", NOISE, name="left"), Sensor("xy", NOISE, name="right"))
    columns = {
        "step": [0, 0, 0, 1, 1, 1],
        "values": np.ones((6, 2)),
        "sensor": [0, 0, 1, 1, 1, 1],
        "time": [0.0, 0.0, 0.0, 1.0, 1.5, 1.5],
    }
    look = make(sensors=sensors, **columns).sightings.look
    # A new look begins with another sensor, another step, another time.
    assert_array_equal(np.diff(look) != 0, [False, True, True, True, False])


def test_steps_are_the_columns(full_dataset):
    steps = list(full_dataset.steps())
    robot, observations = full_dataset.robot, full_dataset.observations
    assert len(steps) == full_dataset.poses == len(robot.controls) + 1
    assert not steps[0].increment.any()
    assert not steps[0].covariance.any()
    assert_array_equal([step.increment for step in steps[1:]], robot.increments.deltas)
    assert_array_equal([step.covariance for step in steps[1:]], robot.increments.covariances)
    rows = np.repeat(np.arange(len(steps)), [len(step.observations.values) for step in steps])
    assert_array_equal(rows, observations.step)
    for column, whole in zip(
        zip(*(step.observations for step in steps), strict=True),
        full_dataset.sightings,
        strict=True,
    ):
        assert_array_equal(np.concatenate(column), whole)


def test_increments_are_those_of_the_motion_model(wheels):
    expected = wheels.motion.increments(wheels.controls)
    assert_array_equal(wheels.increments.deltas, expected.deltas)
    assert_array_equal(wheels.increments.covariances, expected.covariances)


@pytest.fixture
def team(wheels):
    """Two robots with different motions over the same four steps."""
    walker = Robot(MOTION, np.arange(12.0).reshape(4, 3), Prior([5, 6, 1]), name="walker")
    return Dataset(
        "team",
        (wheels, walker),
        np.arange(5.0),
        (Sensor("range-bearing", NOISE),),
        Observations(
            [0, 0, 3], [[1, 0]] * 3, [3, 3, -1], robot=[0, 1, 1], observed_robot=[-1, -1, 0]
        ),
    )


@pytest.mark.parametrize("attribute", ["robot", "prior", "truth"])
def test_what_one_robot_has_is_refused_for_several(team, attribute):
    with pytest.raises(UnsupportedError, match="team has 2 robots"):
        getattr(team, attribute)


def test_moves_and_steps_hold_all_robots(team):
    deltas, covariances = team.moves
    assert deltas.shape == (2, 5, 3)
    assert covariances.shape == (2, 5, 3, 3)
    assert not deltas[:, 0].any()
    assert not covariances[:, 0].any()
    for index, robot in enumerate(team.robots):
        assert_array_equal(deltas[index, 1:], robot.increments.deltas)
        assert_array_equal(covariances[index, 1:], robot.increments.covariances)
    for k, step in enumerate(team.steps()):
        assert_array_equal(step.increment, deltas[:, k])
        assert_array_equal(step.covariance, covariances[:, k])


def test_a_team_moves_together(team):
    g = np.array([50.0, -30.0, 2.0])
    moved = team.moved(g)
    for mine, theirs in zip(moved.robots, team.robots, strict=True):
        difference = subtract_last_angle(mine.prior.mean, geo.compose(g, theirs.prior.mean))
        assert_allclose(difference, 0, atol=1e-12)
    assert_same_record(moved.observations, team.observations)
    assert moved.robots[1].truth is None


def test_a_team_is_saved_without_loss(team, tmp_path):
    team.save(tmp_path / "team.npz")
    assert_same_record(Dataset.load(tmp_path / "team.npz"), team)


# Rigid motion ----------------------------------------------------------------------------------


def assert_same_world(one, other):
    for mine, theirs in zip(one.robots, other.robots, strict=True):
        assert_allclose(subtract_last_angle(mine.truth, theirs.truth), 0, atol=1e-12)
        assert_allclose(subtract_last_angle(mine.prior.mean, theirs.prior.mean), 0, atol=1e-12)
        assert_allclose(mine.prior.covariance, theirs.prior.covariance, atol=1e-15)
    for name in ("known_map", "true_map"):
        mine, theirs = getattr(one, name), getattr(other, name)
        assert_array_equal(mine.ids, theirs.ids)
        assert_allclose(mine.positions, theirs.positions, atol=1e-12)


def test_moved_is_a_group_action(full_dataset):
    g, h = np.array([50.0, -30.0, 2.0]), np.array([-7.0, 1.0, -1.3])
    assert_same_world(full_dataset.moved(g).moved(h), full_dataset.moved(geo.compose(h, g)))
    assert_same_world(full_dataset.moved(g).moved(geo.inverse(g)), full_dataset)
    assert_same_world(full_dataset.moved(np.zeros(3)), full_dataset)


def test_moved_moves_the_world_and_not_what_the_robot_felt(full_dataset):
    g = np.array([50.0, -30.0, 2.0])
    moved = full_dataset.moved(g)
    assert_allclose(moved.truth, geo.compose(g, full_dataset.truth), atol=1e-12)
    positions = geo.from_frame(g, full_dataset.true_map.positions)
    assert_allclose(moved.true_map.positions, positions, atol=1e-12)
    assert_same_record(moved.observations, full_dataset.observations)
    assert_same_record(moved.robot.controls, full_dataset.robot.controls)
    assert_same_record(moved.sensors, full_dataset.sensors)


def test_moved_turns_the_prior_covariance():
    """A prior that is long in x becomes long in y after a quarter turn."""
    prior = Prior(np.zeros(3), np.diag([4.0, 1.0, 0.1]))
    data = make(robots=(Robot(MOTION, np.zeros((2, 3)), prior),))
    turned = data.moved([0.0, 0.0, np.pi / 2]).prior.covariance
    assert_allclose(turned, np.diag([1.0, 4.0, 0.1]), atol=1e-15)


def test_moved_takes_a_singular_prior():
    """Known across a diagonal and unknown along it, then turned until it lies along an axis."""
    prior = Prior(np.zeros(3), [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    data = make(robots=(Robot(MOTION, np.zeros((2, 3)), prior),))
    for angle in np.pi / 4 * np.arange(-4, 4):
        turned = data.moved([0.0, 0.0, angle]).prior.covariance
        assert_allclose(np.linalg.eigvalsh(turned), [0, 0, 2], atol=1e-15)


def test_moved_keeps_what_is_unknown_unknown():
    moved = make().moved([1.0, 2.0, 3.0])
    assert moved.truth is None
    assert moved.known_map is None
    assert moved.true_map is None


# Immutability ----------------------------------------------------------------------------------


def arrays_of(record):
    for entry in fields(record):
        value = getattr(record, entry.name)
        if isinstance(value, np.ndarray):
            yield entry.name, value


def test_arrays_are_read_only(full_dataset):
    robot = full_dataset.robot
    records = [full_dataset, robot, robot.prior, full_dataset.observations, full_dataset.true_map]
    found = [pair for record in records for pair in arrays_of(record)]
    assert len(found) == 2 + 2 + 2 + 9 + 2
    for name, array in found:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        assert not array.flags.writeable, name


def test_arrays_are_copies():
    times, controls = np.arange(3.0), np.zeros((2, 3))
    data = make(times=times, robots=(Robot(MOTION, controls),))
    times[1] = controls[0, 0] = 99.0
    assert data.times[1] == 1.0
    assert data.robot.controls[0, 0] == 0.0


def test_attributes_cannot_be_set(full_dataset):
    for record in (full_dataset, full_dataset.robot, full_dataset.prior, full_dataset.observations):
        with pytest.raises(FrozenInstanceError):
            setattr(record, fields(record)[0].name, None)
