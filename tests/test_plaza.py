"""Plaza 1 and 2: the files, what is measured on them, and the estimators' beacons."""

from __future__ import annotations

from functools import cache

import fuzz
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

import ekfslam
from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.datasets import load_recorded, plaza
from ekfslam.errors import FileFormatError, InputError

NAMES = ("plaza1", "plaza2")
each_set = pytest.mark.parametrize("name", NAMES)


@cache
def real(name):
    return load_recorded(name)


@cache
def recorded(name):
    """As the file has it: no scale, no bias taken off."""
    return load_recorded(name, range_scale=1.0, gyro_bias=0.0)


# What is there ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "poses", "ranges"), [("plaza1", 9658, 3527), ("plaza2", 4091, 1816)]
)
def test_the_whole_set_is_there(name, poses, ranges):
    dataset = real(name)
    assert dataset.name == name
    assert dataset.poses == poses
    assert len(dataset.observations) == ranges
    assert sorted(dataset.true_map.ids) == [0, 1, 5, 6]
    assert set(dataset.observations.landmark) == {0, 1, 5, 6}
    assert_array_equal(dataset.true_landmark, dataset.observations.landmark)
    assert [s.kind for s in dataset.sensors] == ["range"]
    assert dataset.truth.shape == (poses, 3)
    assert_array_equal(dataset.prior.mean, dataset.truth[0])
    assert_allclose(np.sqrt(np.diag(dataset.prior.covariance)), plaza.PRIOR_SIGMAS)


def test_beacons_lie_where_they_were_surveyed():
    where = {name: dict(zip(real(name).true_map.ids.tolist(), real(name).true_map.positions,
                            strict=True)) for name in NAMES}  # fmt: skip
    assert_allclose(where["plaza1"][5], [-17.66, 59.01], atol=0.005)
    assert_allclose(where["plaza2"][5], [1.71, -5.81], atol=0.005)


@each_set
def test_a_range_belongs_to_the_nearest_pose_and_keeps_its_time(name):
    dataset = real(name)
    time, step = dataset.observations.time, dataset.observations.step
    assert (np.diff(time) >= 0).all()
    away = np.abs(time - dataset.times[step])
    for neighbour in (np.maximum(step - 1, 0), np.minimum(step + 1, dataset.poses - 1)):
        assert (away <= np.abs(time - dataset.times[neighbour])).all()
    assert away.max() < 0.18


# What was measured --------------------------------------------------------------------------------


def true_ranges(dataset):
    """Distances from the interpolated truth to the beacon of each range."""
    time, truth = dataset.observations.time, dataset.truth
    at = np.column_stack([np.interp(time, dataset.times, truth[:, k]) for k in (0, 1)])
    order = np.argsort(dataset.true_map.ids)
    which = order[np.searchsorted(dataset.true_map.ids[order], dataset.observations.landmark)]
    return np.hypot(*(dataset.true_map.positions[which] - at).T)


@each_set
def test_ranges_are_too_long_by_their_scale_alone(name):
    dataset = recorded(name)
    distance, value = true_ranges(dataset), dataset.observations.values[:, 0]
    (slope, offset), covariance = np.polyfit(distance, value, 1, cov=True)
    assert abs(slope - 1 / plaza.RANGE_SCALE) < 3 * np.sqrt(covariance[0, 0])
    assert abs(offset) < 3 * np.sqrt(covariance[1, 1])
    assert abs(slope - 1) > 50 * np.sqrt(covariance[0, 0])


@each_set
def test_range_noise_is_white_and_as_stated(name):
    dataset = real(name)
    expected = dataset.sensors[0].observe(
        dataset.truth[dataset.observations.step], positions_of(dataset)
    )[0]
    error = (dataset.observations.values[:, :1] - expected)[:, 0]
    sigma, count = np.sqrt(dataset.sensors[0].covariance[0, 0]), len(error)
    assert error.std() == pytest.approx(sigma, abs=2 * sigma / np.sqrt(2 * count))
    assert abs(error.mean()) < 4 * sigma / np.sqrt(count)
    kurtosis = np.mean((error - error.mean()) ** 4) / error.var() ** 2
    assert kurtosis == pytest.approx(3, abs=4 * np.sqrt(24 / count))
    for beacon in dataset.true_map.ids:
        own = error[dataset.observations.landmark == beacon]
        correlation = np.corrcoef(own[1:], own[:-1])[0, 1]
        assert abs(correlation) < 3 / np.sqrt(len(own))


def positions_of(dataset):
    order = np.argsort(dataset.true_map.ids)
    which = order[np.searchsorted(dataset.true_map.ids[order], dataset.observations.landmark)]
    return dataset.true_map.positions[which]


@each_set
def test_interpolation_would_gain_next_to_nothing(name):
    dataset = recorded(name)
    value = plaza.RANGE_SCALE * dataset.observations.values[:, 0]
    nearest = np.hypot(*(positions_of(dataset) - dataset.truth[dataset.observations.step, :2]).T)
    ratio = (value - true_ranges(dataset)).std() / (value - nearest).std()
    assert 0.99 < ratio < 1


def test_heading_changes_are_those_of_the_truth_up_to_the_drift_of_the_gyro():
    def gap(dataset):
        turned = np.diff(np.unwrap(dataset.truth[:, 2]))
        return dataset.robot.controls[:, 1] - turned

    assert np.abs(gap(real("plaza1"))).max() < 1e-12
    raw, corrected = recorded("plaza2"), real("plaza2")
    span = raw.times[-1] - raw.times[0]
    assert gap(raw).sum() / span == pytest.approx(-5.37e-3, abs=1e-5)
    assert abs(gap(corrected).sum() / span) < 1e-5
    over = np.array([gap(corrected)[k : k + 50].sum() for k in range(0, 4000, 50)])
    assert over.std() / np.sqrt(50) < 1.2 * plaza.ODOMETRY_SIGMAS[2]


@each_set
def test_heading_is_that_of_the_course(name):
    """The truth of Plaza 2 points backwards in the file."""
    dataset = real(name)
    moved = np.diff(dataset.truth[:, :2], axis=0)
    fast = np.hypot(*moved.T) > 0.1
    course = np.arctan2(moved[:, 1], moved[:, 0])
    assert abs(np.median(geo.wrap(course - dataset.truth[:-1, 2])[fast])) < 0.02


@each_set
def test_odometry_errors_are_as_stated(name):
    """An advance and then a turn fits best; over 25 to 100 steps the errors are those of a walk."""
    dataset = real(name)
    truth, (advance, turn) = dataset.truth, dataset.robot.controls.T
    moves = geo.between(truth[:-1], truth[1:])[:, :2]
    fast = advance > 0.05
    spread = {
        "advance first": moves[fast, 1],
        "arc": (moves[:, 1] - 0.5 * advance * turn)[fast],
        "turn first": (moves[:, 1] - advance * np.sin(turn))[fast],
    }
    ordered = [value.std() for value in spread.values()]
    assert ordered == sorted(ordered)
    assert dataset.robot.motion.kind == "advance-turn"
    path = geo.integrate(truth[0], dataset.robot.increments.deltas)
    for steps in (25, 50, 100):
        start = np.arange(0, len(truth) - steps, steps)
        error = geo.additive_error(
            geo.between(truth[start], truth[start + steps]),
            geo.between(path[start], path[start + steps]),
        )
        walk = error[:, :2].std(axis=0) / np.sqrt(steps)
        assert (walk > 0.7 * 0.02).all()
        assert (walk < 1.7 * 0.02).all()


# Options ------------------------------------------------------------------------------------------


def test_what_was_measured_can_be_overridden():
    plain = recorded("plaza2")
    other = ekfslam.load(
        "plaza2",
        range_scale=0.5,
        range_sigma=0.7,
        odometry_sigmas=(0.1, 0.2, 0.3),
        gyro_bias=0.01,
        prior_sigmas=(0, 0, 0),
    )
    assert_allclose(other.observations.values, 0.5 * plain.observations.values)
    assert_allclose(other.sensors[0].covariance, [[0.49]])
    assert_allclose(other.robot.motion.covariance, np.diag([0.01, 0.09]))
    assert other.robot.motion.slip == 0.2
    rate = (plain.robot.controls - other.robot.controls) / np.diff(plain.times)[:, None]
    assert_allclose(rate, np.broadcast_to([0, 0.01], rate.shape), atol=1e-12)
    assert_array_equal(other.prior.covariance, 0)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"range_scale": 0}, "range_scale must be positive and finite, got 0"),
        ({"range_scale": "short"}, "range_scale must be a number"),
        ({"range_sigma": 1e300}, r"range_sigma must be below 1e\+12"),
        ({"range_sigma": -1.0}, "range_sigma must be positive and finite"),
        ({"gyro_bias": np.nan}, "gyro_bias must be finite"),
        ({"odometry_sigmas": (0.1, 0.1)}, r"odometry_sigmas must have shape \(3,\)"),
        ({"odometry_sigmas": "small"}, "odometry_sigmas cannot be read as numbers"),
        ({"prior_sigmas": (0.1, -0.1, 0)}, "prior_sigmas must be standard deviations"),
        ({"noise": "file"}, "plaza1: .*noise"),
        ({"number": 2}, "plaza1: .*number"),
    ],
)
def test_options_that_make_no_sense(options, said):
    with pytest.raises(InputError, match=said):
        ekfslam.load("plaza1", **options)


def test_there_is_no_third():
    with pytest.raises(InputError, match="there are Plaza 1 and 2, not 3"):
        plaza.load(3)


# Files of the same format, by hand ----------------------------------------------------------------

SMALL = {
    "GT": [[10.0, 1, 2, 0.5], [10.2, 1, 2, 0.5], [10.4, 2, 2, 0.6], [10.6, 3, 2, 0.7]],
    "DR": [[10.2, 0, 0], [10.4, 1, 0.1], [10.6, 1, 0.1]],
    "TD": [[10.05, 2, 4, 3], [10.31, 2, 9, 5], [10.2, 2, 4, 4], [10.2, 2, 4, 4.5], [10.2, 2, 9, 6]],
    "TL": [[4, 1, 5], [9, 4, 4]],
}


@pytest.fixture
def write(tmp_path):
    """Writes the small file with changes, and returns its path."""

    def written(name="Plaza1_.mat", **changes):
        content = {**SMALL, **changes}
        arrays = {key: np.array(a) for key, a in content.items() if a is not None}
        savemat(tmp_path / name, arrays, appendmat=False)
        return tmp_path / name

    return written


def test_ranges_are_sorted_and_of_two_at_once_the_first_is_taken(write):
    dataset = plaza.load(1, write(), range_scale=1.0)
    assert dataset.observations.time.tolist() == [10.05, 10.2, 10.2, 10.31]
    assert dataset.observations.step.tolist() == [0, 1, 1, 2]
    assert dataset.observations.landmark.tolist() == [4, 4, 9, 9]
    assert dataset.observations.values[:, 0].tolist() == [3, 4, 6, 5]
    assert dataset.times.tolist() == [10.0, 10.2, 10.4, 10.6]
    assert_array_equal(dataset.robot.controls, [[0, 0], [1, 0.1], [1, 0.1]])
    assert_allclose(dataset.truth, np.array(SMALL["GT"])[:, 1:])


def test_a_folder_will_do_and_the_second_set_is_turned(write):
    folder = write("Plaza2_.mat").parent
    dataset = load_recorded("plaza2", folder, gyro_bias=0.1)
    assert_allclose(dataset.truth[:, 2], np.array([0.5, 0.5, 0.6, 0.7]) - np.pi)
    assert_allclose(dataset.robot.controls[:, 1], [-0.02, 0.08, 0.08], atol=1e-12)
    with pytest.raises(FileFormatError, match=r"has no Plaza1_\.mat"):
        load_recorded("plaza1", folder)


def test_a_drive_without_ranges(write):
    dataset = plaza.load(1, write(TD=np.zeros((0, 4))))
    assert dataset.poses == 4
    assert len(dataset.observations) == 0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        *(({name: None}, f"has no array {name}") for name in SMALL),
        ({"GT": np.zeros((3, 3))}, r"GT must be numbers, n x 4, got an array of shape \(3, 3\)"),
        ({"GT": np.zeros((0, 4))}, "GT is empty"),
        ({"TL": ["abc"]}, "TL is no array of real numbers"),
        ({"TD": [[10.1, 2, 4, np.nan]]}, "NaN or infinite value in row 1, column 4 of TD"),
        ({"GT": np.array(SMALL["GT"])[[0, 2, 1, 3]]}, "time does not increase in row 3 of GT"),
        ({"DR": SMALL["DR"][:2]}, "4 rows of GT need one row of DR less, got 2"),
        ({"DR": np.add(SMALL["DR"], [[0], [0.01], [0]])}, "next row of GT in row 2 of DR"),
        ({"TD": [[10.1, 2, 4, 3], [10.2, 2, 4, -3]]}, "negative range in row 2 of TD"),
        ({"TD": [[10.1, 2, 4.5, 3]]}, "not a whole number in row 1 of TD"),
        ({"TL": [[4, 1, 5], [-9, 4, 4]]}, "not a whole number in row 2 of TL"),
        ({"TL": [[4, 1, 5], [4, 4, 4]]}, "TL has a beacon twice"),
        ({"TL": SMALL["TL"][:1]}, "beacon that TL does not have in row 2 of TD"),
        ({"TD": [[10.1, 2, 4, 3], [99.0, 2, 4, 3]]}, "not within that of GT in row 2 of TD"),
        ({"TD": [[10.1, 2, 4, 3000]]}, r"is this in metres\? in row 1 of TD"),
        ({"GT": np.array(SMALL["GT"]) * [1, 1, 1, 57.3]}, r"in radians\? in row 1 of GT"),
        ({"GT": np.array(SMALL["GT"]) * [1, 1e4, 1, 1]}, r"in metres\? in row 3 of GT"),
        ({"DR": np.array(SMALL["DR"]) * [1, 1, 57.3]}, r"in radians\? in row 2 of DR"),
    ],
)
def test_a_malformed_file_is_named(write, changes, said):
    path = write(**changes)
    with pytest.raises(FileFormatError, match=said) as error:
        plaza.load(1, path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_that_is_none(tmp_path):
    for content in (b"", b"no matlab file, but long enough to look at" * 9):
        (tmp_path / "Plaza1_.mat").write_bytes(content)
        with pytest.raises(FileFormatError, match="cannot be read") as error:
            plaza.load(1, tmp_path)
        assert "\n" not in str(error.value)
    with pytest.raises(FileFormatError, match="no file or folder"):
        plaza.load(1, tmp_path / "none.mat")


@pytest.mark.parametrize("compressed", [False, True])
def test_no_damage_breaks_the_loader(write, tmp_path, compressed):
    arrays = {key: np.array(a, dtype=float) for key, a in SMALL.items()}
    savemat(tmp_path / "Plaza1_.mat", arrays, do_compression=compressed)
    files = {"Plaza1_.mat": (tmp_path / "Plaza1_.mat").read_bytes()}

    def everything_arrives(dataset, damaged):
        assert dataset.poses == 4
        assert "Read: 4 poses, 5 ranges of 2 beacons; " in dataset.notes[0]
        assert f"; {5 - len(dataset.observations)} ranges repeat" in dataset.notes[0]

    told = fuzz.check(
        lambda folder: plaza.load(1, folder), tmp_path, files, 1000, 3, everything_arrives,
        ("missing", "empty"),
    )  # fmt: skip
    assert told["refused"] > 300
    assert told["loaded"] > (0 if compressed else 50)


def test_a_set_is_saved_without_loss(tmp_path):
    real("plaza2").save(tmp_path / "plaza.npz")
    loaded = Dataset.load(tmp_path / "plaza.npz")
    assert_array_equal(loaded.observations.values, real("plaza2").observations.values)
    assert loaded.sensors == real("plaza2").sensors


# The estimators -----------------------------------------------------------------------------------


def beacon_errors(dataset, estimate):
    """Distances of the beacons from their true places, after the best rigid motion."""
    truth = dict(zip(dataset.true_map.ids.tolist(), dataset.true_map.positions, strict=True))
    assert set(estimate.landmarks.ids.tolist()) == set(truth)
    placed = np.array([truth[i] for i in estimate.landmarks.ids.tolist()])
    motion = geo.align(estimate.landmarks.positions, placed)
    return np.hypot(*(geo.from_frame(motion, estimate.landmarks.positions) - placed).T)


@each_set
def test_the_beacons_are_found_to_decimetres(name):
    """With ranges to 0.5 m; left 7 % too long, they put the beacons metres off."""
    dataset, long = real(name), load_recorded(name, range_scale=1.0)
    for estimator in ("ekf", "gtsam-batch"):
        assert beacon_errors(dataset, ekfslam.estimate(dataset, estimator)).max() < 0.2
    assert beacon_errors(long, ekfslam.estimate(long, "ekf")).max() > 2


def test_isam2_finds_the_beacons_too():
    dataset = real("plaza2")
    estimate = ekfslam.estimate(dataset, "gtsam-isam2", marginals=False)
    assert beacon_errors(dataset, estimate).max() < 0.2


@each_set
def test_the_path_is_better_than_dead_reckoning_and_the_filter_knows_how_good(name):
    dataset = real(name)
    estimate = ekfslam.estimate(dataset, "ekf")
    error = geo.additive_error(dataset.truth, estimate.online.poses)
    deduced = geo.integrate(dataset.truth[0], dataset.robot.increments.deltas)
    off = geo.additive_error(dataset.truth, deduced)
    assert np.mean(error[:, :2] ** 2) < 0.25 * np.mean(off[:, :2] ** 2)
    solved = np.linalg.solve(estimate.online.covariances[1:], error[1:, :, None])
    nees = np.einsum("ki,kij->k", error[1:], solved)
    assert 1 < nees.mean() < 4  # one run, whose errors hang together: the order is all it can show
