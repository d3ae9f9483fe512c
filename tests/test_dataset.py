"""The dataset: what it refuses, and what it takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made import MOTION, NOISE, assert_refused, make, pair, twice
from numpy.testing import assert_allclose, assert_array_equal

from ekfslam.dataset import Dataset, LandmarkMap, Prior, Robot
from ekfslam.errors import InputError
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Sightings

# What is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite(bad):
    assert_refused("observations.values .* row 1", make, step=[0, 1], values=[[1, 0], [bad, 0]])
    assert_refused("observations.time .* row 0", make, time=[bad])
    assert_refused("observations.covariance .* row 0", make, covariance=[[[1, bad], [bad, 1]]])
    assert_refused("times .* row 2", make, times=[0.0, 1.0, bad])
    assert_refused("controls of r .* row 1", Robot, MOTION, [[0, 0, 0], [0, bad, 0]], name="r")
    truth = [[0.0, 0.0, 0.0], [0.0, bad, 0.0]]
    assert_refused("truth of r .* row 1", Robot, MOTION, [[0, 0, 0]], truth=truth, name="r")
    assert_refused("prior mean", Prior, [0.0, bad, 0.0])
    assert_refused("prior covariance", Prior, np.zeros(3), np.diag([1.0, bad, 1.0]))
    assert_refused("landmark positions .* row 1", LandmarkMap, [1, 2], [[0, 0], [bad, 0]])
    sensor = Sensor("xy", NOISE)
    assert_refused("values .* row 0", Sightings.of, sensor, [[bad, 0.0]])


@pytest.mark.parametrize(
    "covariance", [[[1.0, 2.0], [2.0, 1.0]], [[-1e-6, 0.0], [0.0, 1.0]], [[1.0, 0.5], [0.0, 1.0]]]
)
def test_covariances_of_rows_that_are_not_positive_semi_definite(covariance):
    assert_refused(
        "observations.covariance of row 1 is not positive semi-definite",
        make,
        step=[0, 1],
        values=[[1, 0], [1, 0]],
        covariance=[NOISE, covariance],
    )


def test_prior_covariance_that_is_not_positive_semi_definite():
    assert_refused("prior covariance", Prior, np.zeros(3), np.diag([1.0, -1.0, 1.0]))
    assert_refused("prior covariance", Prior, np.zeros(3), np.eye(2))


def test_singular_covariances_are_taken():
    assert make(covariance=[np.zeros((2, 2))]).observations.covariance.any() == np.False_
    assert not Prior().covariance.any()


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("step", 3, r"observations.step is 3 in row 1, but there are 3 poses \(0 to 2\)"),
        ("step", -1, "observations.step is -1"),
        ("sensor", 1, "observations.sensor is 1 in row 1, but there are 1 sensors"),
        ("sensor", -1, "observations.sensor is -1"),
        ("robot", 1, "observations.robot is 1 in row 1, but there are 1 robots"),
        ("observed_robot", 1, "observations.observed_robot is 1 in row 1"),
    ],
)
def test_indices_of_what_does_not_exist(column, value, message):
    columns = {"step": [0, 1], "values": [[1, 0], [2, 0]], column: [0, value]}
    if column == "observed_robot":
        columns[column] = [-1, value]
    assert_refused(message, make, **columns)


def test_the_last_pose_has_observations_too():
    assert len(make(step=[2]).observations) == 1


@pytest.mark.parametrize("times", [[0.0, 1.0, 1.0], [0.0, 2.0, 1.0]])
def test_times_that_do_not_increase(times):
    assert_refused(r"times must increase: times\[2\]", make, times=times)


def test_times_and_controls_that_do_not_match():
    robot = Robot(MOTION, np.zeros((5, 3)), name="rover")
    assert_refused("5 controls of rover make 6 poses, but there are 3 times", make, robots=(robot,))


def test_observations_out_of_order():
    assert_refused("goes back at row 1", make, step=[1, 0], values=[[1, 0], [1, 0]])


def test_noise_may_take_a_short_range_below_zero():
    sigma = np.sqrt(NOISE[0][0])
    values = [[1.0, 0.0], [-5.9 * sigma, 0.0]]
    assert_array_equal(make(step=[0, 1], values=values).observations.values, values)
    values[1][0] = -6.1 * sigma
    assert_refused("negative range", make, step=[0, 1], values=values)


def test_truth_may_be_known_in_part():
    nan = np.nan
    truth = [[0.0, 0.0, 0.0], [1.0, 0.0, nan], [nan, nan, nan]]
    robot = Robot(MOTION, np.zeros((2, 3)), truth=truth)
    assert not robot.truth_known
    assert Robot(MOTION, np.zeros((2, 3)), truth=np.zeros((3, 3))).truth_known
    for bad in ([0.0, nan, 0.0], [nan, nan, 0.0], [np.inf, 0.0, 0.0]):
        with pytest.raises(InputError, match="truth of robot holds no pose in row 1"):
            Robot(MOTION, np.zeros((2, 3)), truth=[truth[0], bad, truth[2]])


def test_each_control_may_have_its_own_noise(tmp_path):
    noise = np.array([np.diag([1.0, 2.0, 3.0]), np.diag([4.0, 5.0, 6.0])])
    robot = Robot(MOTION, np.zeros((2, 3)), covariance=noise)
    assert_array_equal(robot.increments.covariances, noise)
    dataset = make(robots=(robot,))
    dataset.save(tmp_path / "own.npz")
    assert_array_equal(Dataset.load(tmp_path / "own.npz").robot.covariance, noise)
    with pytest.raises(
        InputError, match="covariance of robot is not positive semi-definite in row"
    ):
        Robot(MOTION, np.zeros((2, 3)), covariance=noise * [[[1.0]], [[-1.0]]])


def test_negative_range():
    assert_refused(
        r"negative range -0.7 in row 1 of the observations of laser",
        make,
        step=[0, 1],
        values=[[1.0, 0.0], [-0.7, 0.0]],
    )


def test_a_negative_coordinate_is_no_range():
    sensors = (Sensor("range-bearing", NOISE), Sensor("xy", NOISE))
    data = make(sensors=sensors, sensor=[1], values=[[-0.5, -1.0]])
    assert_array_equal(data.observations.values, [[-0.5, -1.0]])


def test_same_landmark_twice_at_the_same_instant():
    assert_refused("landmark 4 is observed twice .* sensor laser .step 1", twice)
    assert_refused("landmark 4 is observed twice", twice, time=[1.5, 1.5])


@pytest.mark.parametrize(
    "columns",
    [
        {"time": [1.0, 1.5]},
        {"step": [0, 1]},
        {"landmark": [4, 5]},
        {"landmark": [-1, -1]},
        {"landmark": [2**53, 2**53 + 1]},
    ],
    ids=["other time", "other step", "other landmark", "no identity", "huge identities"],
)
def test_what_is_not_twice(columns):
    assert len(twice(**columns).observations) == 2


def test_two_sensors_may_see_the_same_landmark_at_once():
    sensors = (Sensor("range-bearing", NOISE, name="a"), Sensor("range-bearing", NOISE, name="b"))
    assert len(twice(sensors=sensors, sensor=[0, 1]).observations) == 2


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"values": [1.0, 2.0]}, r"observations.values must have shape \(1, 2\), got \(2,\)"),
        ({"values": [[1.0, 2.0, 3.0]]}, "observations.values must have shape"),
        ({"step": [[1]]}, "observations.step must have shape"),
        ({"landmark": [1, 2]}, "observations.landmark must have shape"),
        ({"covariance": [[1.0, 2.0]]}, "observations.covariance must have shape"),
        ({"time": [0.0, 1.0]}, "observations.time must have shape"),
        ({"descriptor": [1.0, 2.0]}, "observations.descriptor must have shape"),
        ({"values": [["far", "left"]]}, "observations.values cannot be read as numbers"),
        ({"step": [None]}, "observations.step cannot be read as numbers"),
        ({"step": [np.nan]}, "observations.step"),
    ],
)
def test_columns_of_the_wrong_shape_or_type(columns, message):
    assert_refused(message, make, **columns)


@pytest.mark.parametrize("column", ["step", "landmark", "sensor", "robot", "observed_robot"])
@pytest.mark.parametrize("value", [0.7, 10**30])
def test_whole_numbers_are_not_rounded(column, value):
    assert_refused(f"observations.{column}", make, **{column: [value]})


def test_shapes_of_the_other_parts():
    assert_refused("landmark positions must have shape", LandmarkMap, [1, 2], [[0.0, 0.0]])
    assert_refused("distinct", LandmarkMap, [1, 1], np.zeros((2, 2)))
    assert_refused("not negative", LandmarkMap, [-1, 1], np.zeros((2, 2)))
    assert_refused("landmark ids", LandmarkMap, [0.5], np.zeros((1, 2)))
    assert_refused("prior mean must have shape", Prior, [0.0, 0.0])
    assert_refused("controls of robot must have shape", Robot, MOTION, np.zeros((2, 2)))
    assert_refused(
        r"truth of robot must have shape \(3, 3\)", Robot, MOTION, np.zeros((2, 3)), truth=np.eye(2)
    )
    assert_refused("true_landmark must have shape", replace, make(), true_landmark=[1, 2])
    assert_refused("at least one robot", make, robots=())


def test_an_observation_without_a_sensor():
    assert_refused("observations.sensor is 0 in row 0", make, sensors=())


def test_a_dataset_may_hold_no_observations():
    data = make(step=[], values=np.zeros((0, 2)))
    assert len(data.sightings.values) == 0
    assert [len(step.observations.values) for step in data.steps()] == [0, 0, 0]


# Sensors that report one number ----------------------------------------------------------------


def test_one_number_is_padded():
    bearings = Sensor("bearing", [[0.01]])
    data = make(sensors=(bearings,), values=[[0.3]])
    assert_array_equal(data.observations.values, [[0.3, 0.0]])
    assert_array_equal(data.sightings.covariance, [[[0.01, 0.0], [0.0, 0.0]]])
    assert_array_equal(data.sightings.kind, [bearings.view.code])
    assert_array_equal(make(sensors=(bearings,), values=[[0.3, 0.0]]).sightings.values, [[0.3, 0]])
    none = make(sensors=(bearings,), step=[], values=np.zeros((0, 1)))
    assert none.observations.values.shape == (0, 2)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_one_number_that_is_not_finite(bad):
    bearings = Sensor("bearing", [[0.01]])
    assert_refused("observations.values .* row 0", make, sensors=(bearings,), values=[[bad]])


@pytest.mark.parametrize("kind", ["bearing", "range"])
def test_a_second_number_of_a_sensor_that_reports_one(kind):
    sensors = (Sensor("xy", NOISE), Sensor(kind, [[0.01]], name="eye"))
    columns = {"step": [0, 1], "values": [[1.0, 2.0], [1.0, 0.1]], "sensor": [0, 1]}
    assert_refused("eye reports one number: the second column", make, sensors=sensors, **columns)


def test_a_range_alone_is_not_negative_and_a_bearing_may_be():
    columns = {"step": [0, 1], "values": [[1.0], [-0.5]]}
    beacon = Sensor("range", [[0.01]], name="beacon")
    message = "negative range -0.5 in row 1 of the observations of beacon"
    assert_refused(message, make, sensors=(beacon,), **columns)
    assert len(make(sensors=(Sensor("bearing", [[0.01]]),), **columns).observations) == 2


def test_range_noise_of_a_single_number_grows_with_it():
    beacon = Sensor("range", [[0.01]], range_growth=0.1)
    data = make(sensors=(beacon,), values=[[2.0]])
    assert_allclose(data.sightings.covariance, [[[0.05, 0.0], [0.0, 0.0]]], rtol=1e-15)


# Robots that see robots ------------------------------------------------------------------------


def test_a_row_shows_a_landmark_or_a_robot():
    data = pair()
    assert data.association_known
    assert_array_equal(data.observed_robot, [-1, 1])
    assert_array_equal(data.sightings.target, [-1, 1])
    assert_array_equal(data.sightings.robot, [0, 0])
    assert_array_equal(make().observed_robot, [-1])
    assert not pair(observed_robot=[-1, -1]).association_known


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"robot": [0, 1]}, "observations show the robot itself in row 1"),
        ({"landmark": [4, 5]}, "observations show a robot and a landmark in row 1"),
        ({"observed_robot": [-1, 2]}, "observations.observed_robot is 2 in row 1, but there are 2"),
        ({"observed_robot": [-2, 1]}, "observations.observed_robot is -2 in row 0"),
        (
            {"observed_robot": [1, 1], "landmark": [-1, -1]},
            "robot 1 is observed twice at the same instant by sensor laser",
        ),
    ],
)
def test_rows_that_show_what_they_cannot(columns, message):
    assert_refused(message, pair, **columns)


@pytest.mark.parametrize(
    "columns",
    [
        {"observed_robot": [1, 0], "robot": [0, 1], "landmark": [-1, -1]},
        {"observed_robot": [1, 1], "landmark": [-1, -1], "time": [1.0, 1.5]},
        {"observed_robot": [-1, -1], "landmark": [4, 4], "robot": [0, 1]},
    ],
    ids=["one another", "other time", "two robots see one landmark"],
)
def test_what_several_robots_may_see(columns):
    assert len(pair(**columns).observations) == 2
