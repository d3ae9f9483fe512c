"""The course world of Freiburg: motions that turn, drive and turn, and a map that is known."""

from __future__ import annotations

import math

import fuzz
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

import ekfslam
from ekfslam import geometry as geo
from ekfslam.datasets import freiburg_course
from ekfslam.errors import FileFormatError, InputError

WORLD = "1 2 1\n2 0 4\n5 10 5\n"
LOG = (
    "ODOMETRY 0.1 1.0 -0.2\nSENSOR 1 1.25 0.375\nSENSOR 2 -0.035 3.211\n"
    "ODOMETRY 0.0 0.5 0.3\nODOMETRY -0.4 0.25 0.0\nSENSOR 5 9.5 -1.5\n"
)


@pytest.fixture
def write(tmp_path):
    """Writes the files, and returns their folder."""

    def written(log=LOG, world=WORLD):
        for name, text in (("sensor_data.dat", log), ("world.dat", world)):
            (tmp_path / name).write_text(text, newline="")
        return tmp_path

    return written


def test_the_files_are_read_as_they_stand(write):
    dataset = ekfslam.load("freiburg-course", write())
    o = dataset.observations
    assert dataset.times.tolist() == [0, 1, 2, 3]
    assert o.step.tolist() == [1, 1, 3]
    assert o.landmark.tolist() == [1, 2, 5]
    assert_allclose(o.values, [[1.25, 0.375], [-0.035, 3.211 - 2 * np.pi], [9.5, -1.5]])
    assert_array_equal(dataset.known_map.ids, [1, 2, 5])
    assert_array_equal(dataset.true_map.positions, [[2, 1], [0, 4], [10, 5]])
    assert not dataset.prior.mean.any()
    assert not dataset.prior.covariance.any()
    assert dataset.truth is None
    assert "3 motions, 3 sightings, 3 landmarks" in dataset.notes[0]


def test_a_drive_without_noise_gives_its_path_back(write, rng):
    """Each motion by three increments, and what is seen from where it ends."""
    landmarks = {1: (2.0, 1.0), 2: (0.0, 4.0), 5: (10.0, 5.0)}
    pose, path, lines = np.zeros(3), [np.zeros(3)], []
    for turn, drive, again in rng.uniform([-1, 0, -1], [1, 2, 1], (30, 3)).tolist():
        for part in ((0, 0, turn), (drive, 0, 0), (0, 0, again)):
            pose = geo.compose(pose, part)
        path.append(pose)
        lines.append(f"ODOMETRY {turn!r} {drive!r} {again!r}")
        for name, point in landmarks.items():
            x, y = geo.to_frame(pose, point).tolist()
            lines.append(f"SENSOR {name} {math.hypot(x, y)!r} {math.atan2(y, x) % math.tau!r}")
    dataset = freiburg_course.load(write("\n".join(lines)))
    found = geo.integrate(dataset.prior.mean, dataset.robot.increments.deltas)
    assert_allclose(geo.additive_error(np.array(path), found), 0, atol=1e-12)
    o = dataset.observations
    points, _, _ = dataset.sensors[0].locate(found[o.step], o.values)
    assert_allclose(points, [landmarks[name] for name in o.landmark.tolist()], atol=1e-9)
    estimate = ekfslam.estimate(dataset, "ekf")
    assert_allclose(geo.additive_error(np.array(path), estimate.online.poses), 0, atol=1e-9)


def test_noise_of_turn_drive_turn_is_that_of_drawn_motions(rng):
    """The covariance to first order, against 40,000 draws of a noise that is small."""
    motions = np.array([[0.4, 1.5, -0.9], [-2.0, 0.3, 0.1], [0.0, 0.0, 0.2]])
    sigmas = np.array([0.004, 0.003, 0.002])
    stated = freiburg_course.turn_drive_turn(motions, np.diag(sigmas**2))
    for motion, delta, covariance in zip(motions, *stated, strict=True):
        turn, drive, again = (motion + sigmas * rng.normal(size=(40_000, 3))).T
        zero = np.zeros_like(turn)
        end = geo.compose(np.column_stack([zero, zero, turn]), np.column_stack([drive, zero, zero]))
        end = geo.compose(end, np.column_stack([zero, zero, again]))
        error = geo.additive_error(end, delta)
        assert_allclose(error.mean(axis=0), 0, atol=5e-5)
        scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance))) + 1e-12
        # Standard error of a sample covariance: sqrt(2 / n) of the variances at most; 1e-5 squared
        # is what the second order leaves of a drive that stands.
        gap = np.abs(np.cov(error.T) - covariance)
        assert (gap < 5 * np.sqrt(2 / 40_000) * scale + 1e-9).all()


def test_noise_can_be_stated(write):
    dataset = freiburg_course.load(write(), motion_sigmas=(0.1, 0.2, 0.3), sensor_sigmas=(0.4, 0.5))
    assert_allclose(dataset.sensors[0].covariance, np.diag([0.16, 0.25]))
    # The second motion does not turn first: along, across by the first turn, both turns.
    expected = [[0.04, 0, 0], [0, 0.25 * 0.01, 0.5 * 0.01], [0, 0.5 * 0.01, 0.01 + 0.09]]
    assert_allclose(dataset.robot.increments.covariances[1], expected, atol=1e-15)
    for options in ({"motion_sigmas": (1, 2)}, {"sensor_sigmas": (0.1, -0.1)}):
        with pytest.raises(InputError, match=next(iter(options))):
            freiburg_course.load(write(), **options)


def test_a_log_without_sightings(write):
    dataset = freiburg_course.load(write("ODOMETRY 0 1 0\n"))
    assert dataset.poses == 2
    assert len(dataset.observations) == 0


@pytest.mark.parametrize(
    ("log", "said"),
    [
        ("", "sensor_data.dat: is empty"),
        ("# nothing\n", "holds no ODOMETRY"),
        ("SENSOR 1 2 3\n" + LOG, "line 1: SENSOR before the first ODOMETRY"),
        (LOG + "ODOMETRY 1 2\n", r"line 7: 3 numbers of ODOMETRY .*there are 2"),
        (LOG + "SENSOR 1 2 3 4\n", r"line 7: 3 numbers of SENSOR .*there are 4"),
        (LOG + "SENSOR 1 far 3\n", "line 7: range of SENSOR is no number but 'far'"),
        (LOG + "SENSOR 1 nan 3\n", "line 7: range of SENSOR is nan"),
        (LOG + "SENSOR 1.5 2 3\n", "line 7: the id is no whole number"),
        (LOG + "SENSOR 3 2 3\n", "line 7: there is no such id in world.dat"),
        (LOG + "SENSOR 5 2 3\n", "line 7: the id is seen twice after one motion"),
        (LOG + "SENSOR 1 -2 3\n", "line 7: the range is below 6 sigmas"),
        (LOG + "SENSOR 1 2 90\n", "line 7: is the bearing in radians"),
        (LOG + "SENSOR 1 9000 1\n", "line 7: is the range in metres"),
        (LOG + "ODOMETRY 45 1 0\n", "line 7: more than a full turn"),
        (LOG + "ODOMETRY 0 9000 0\n", "line 7: is the drive in metres"),
        (LOG + "LASER 1 2 3\n", "line 7: unknown record 'LASER'"),
    ],
)
def test_a_damaged_log_is_named(write, log, said):
    with pytest.raises(FileFormatError, match=said) as error:
        freiburg_course.load(write(log))
    assert "sensor_data.dat" in str(error.value)


@pytest.mark.parametrize(
    ("world", "said"),
    [
        ("1 2\n", "line 1: 3 numbers are wanted"),
        (WORLD + "1 3 3\n", "line 4: the id has been there before"),
        (WORLD + "-1 3 3\n", "line 4: the id is not a number from 0 on"),
    ],
)
def test_a_damaged_world_is_named(write, world, said):
    with pytest.raises(FileFormatError, match=rf"world\.dat.*{said}"):
        freiburg_course.load(write(world=world))


def test_line_ends_of_any_kind(write):
    mixed = LOG.replace("\nODOMETRY", "\r\nODOMETRY", 1).replace("\nSENSOR 5", "\rSENSOR 5")
    plain, other = freiburg_course.load(write()), freiburg_course.load(write(mixed.rstrip()))
    assert_array_equal(plain.observations.values, other.observations.values)
    assert_array_equal(plain.robot.controls, other.robot.controls)


def test_damage_is_told_or_loads_whole(tmp_path):
    def whole(dataset, files):
        lines = files["sensor_data.dat"].decode().replace("\r", "\n").split("\n")
        assert len(dataset.observations) == sum("SENSOR" in line.split("#")[0] for line in lines)
        assert dataset.poses == 1 + sum("ODOMETRY" in line.split("#")[0] for line in lines)

    files = {"sensor_data.dat": LOG.encode(), "world.dat": WORLD.encode()}
    certain = ("drop_column", "add_column", "empty")
    told = fuzz.check(freiburg_course.load, tmp_path, files, 1000, 11, whole, certain)
    assert min(told["refused"], told["loaded"]) > 100


def test_the_published_set(recorded_data):
    dataset = recorded_data("freiburg-course")
    assert dataset.poses == 332
    assert len(dataset.observations) == 1212
    assert len(dataset.known_map) == 9
    assert np.bincount(dataset.observations.step)[1:].min() == 2
    assert np.bincount(dataset.observations.step).max() == 7
    assert dataset.observations.values[:, 0].min() == pytest.approx(-0.035, abs=5e-4)
    assert dataset.observations.values[:, 0].max() == pytest.approx(5.232, abs=5e-4)
    estimate = ekfslam.estimate(dataset, "ekf")
    rows = np.argsort(estimate.landmarks.ids)
    assert_array_equal(estimate.landmarks.ids[rows], dataset.true_map.ids)
    # The errors are those that the joint covariance of the map allows, once in a thousand runs.
    error = (estimate.landmarks.positions[rows] - dataset.true_map.positions).ravel()
    places = np.column_stack([2 * rows, 2 * rows + 1]).ravel()
    covariance = estimate.landmarks.covariance[np.ix_(places, places)]
    assert error @ np.linalg.solve(covariance, error) < chi2.ppf(0.999, len(error))
