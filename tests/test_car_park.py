"""The car park: small logs in its format, damage to them, and the log itself."""

from __future__ import annotations

import fuzz
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

from ekfslam import geometry as geo
from ekfslam.datasets import car, car_park, load_recorded
from ekfslam.errors import FileFormatError, InputError
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.localization import EkfLocalization

BEACONS = np.array([[4.0, 9.0], [9.0, 2.0], [-3.0, 5.0], [8.0, 12.0], [1.0, 14.0], [-6.0, 11.0]])
START = np.array([1.0, 2.0, 1.1])  # of the laser
SCANS = 16
ROW, SCAN = 0.025, 0.2  # [s]
BEGIN = 100.0


def driven(speed, steering, at):
    """Poses of the laser at some times, by small straight pieces of the path of the axle.

    An independent way: the middle of the axle goes at the wheel's speed plus that of its arm.
    """
    fine = 200
    wheelbase, wheel = 2.83, 0.76
    dt = ROW / fine
    times = BEGIN + dt * np.arange(len(speed) * fine + 1)
    rate = np.repeat(speed * np.tan(steering) / (wheelbase - wheel * np.tan(steering)), fine)
    middle = np.repeat(speed, fine) + wheel * rate
    axle = geo.compose(START, geo.inverse([*car.LASER_AT, 0.0]))
    heading = axle[2] + np.append(0.0, np.cumsum(rate * dt))
    half = heading[:-1] + 0.5 * rate * dt
    x = axle[0] + np.append(0.0, np.cumsum(middle * np.cos(half) * dt))
    y = axle[1] + np.append(0.0, np.cumsum(middle * np.sin(half) * dt))
    path = np.column_stack([np.interp(at, times, column) for column in (x, y, heading)])
    return geo.compose(path, np.array([*car.LASER_AT, 0.0]))


def scan_of(pose, beacons=BEACONS):
    """Ranges and intensities of three beams on each beacon ahead; bearings to half a beam."""
    ranges, bright = np.full(car_park.BEAMS, 81.91), np.zeros(car_park.BEAMS)
    seen = []
    for number, point in enumerate(geo.to_frame(pose, beacons)):
        beam = round(float(np.arctan2(point[1], point[0]) / car_park.BEAM_ANGLE)) + 180
        if not 1 <= beam < car_park.BEAMS - 1 or bright[max(beam - 6, 0) : beam + 7].any():
            continue
        ranges[beam - 1 : beam + 2] = np.hypot(*point) + car_park.RANGE_BIAS
        bright[beam - 1 : beam + 2] = 16384
        seen.append((beam, number))
    return ranges, bright, [number for _, number in sorted(seen)]


def arrays_of(rng, scans=SCANS, lags=(0.0, 0.0), beacons=BEACONS):
    """Arrays of both files, and the poses of the laser at the scans."""
    times = BEGIN + 0.1 + SCAN * np.arange(scans)
    rows = round((times[-1] - BEGIN) / ROW) + 20
    steering = 0.4 * np.sin(0.05 * np.arange(rows)) + rng.uniform(-0.02, 0.02, rows)
    speed = 1.5 + rng.uniform(-0.2, 0.2, rows)
    # From the first scan on, so that the first pose is START.
    shift = np.arange(rows) * ROW + BEGIN < times[0] - 1e-9
    speed[shift] = 0.0
    poses = driven(speed, steering, times)
    looked = [scan_of(pose, beacons) for pose in poses]
    stamps = {
        "TimeGPS": times - lags[1] + lags[0],
        "Time_VS": BEGIN + ROW * np.arange(rows),
        "TimeLaser": times + lags[0],
    }
    time = np.concatenate(list(stamps.values()))
    order = np.argsort(time, kind="stable")
    lengths = [len(each) for each in stamps.values()]
    factor, offset = car_park.STEERING
    data = {
        **stamps,
        "Time": time[order],
        "Sensor": np.repeat([1, 2, 3], lengths)[order].astype(np.uint8),
        "Index": np.concatenate([np.arange(1, n + 1) for n in lengths])[order].astype(np.uint16),
        "GPSLon": poses[:, 0],
        "GPSLat": poses[:, 1],
        "Velocity": speed / car_park.SPEED_SCALE,
        "Steering": (steering - offset) / factor,
        "Laser": np.array([ranges for ranges, _, _ in looked]),
        "Intensity": np.array([bright for _, bright, _ in looked]).astype(np.uint16),
    }
    return data, poses, [seen for _, _, seen in looked]


def written(folder, data, beacons=BEACONS):
    savemat(folder / car_park.DATA, {name: np.atleast_2d(array) for name, array in data.items()})
    savemat(folder / car_park.BEACONS, {"estbeac": beacons})
    return folder


@pytest.fixture
def small(tmp_path, rng):
    """A drive in a folder, its arrays, poses and what is seen."""
    data, poses, seen = arrays_of(rng, lags=car_park.LAGS)
    return written(tmp_path, data), data, poses, seen


# A drive without noise comes back -----------------------------------------------------------------


def test_a_drive_without_noise_comes_back_as_the_truth(small):
    folder, data, poses, _ = small
    dataset = load_recorded("car-park", folder, start=START)
    assert dataset.poses == SCANS
    assert_allclose(dataset.truth[:, :2], poses[:, :2], atol=1e-9)
    assert np.isnan(dataset.truth[:, 2]).all()
    assert_array_equal(dataset.times, data["TimeLaser"])
    # The oracle goes by straight pieces of a 200th of a row.
    assert_allclose(geo.integrate(START, dataset.moves.deltas[0, 1:]), poses, atol=1e-7)
    assert np.ptp(poses[:, 2]) > 0.2
    assert_allclose(dataset.known_map.positions, BEACONS)
    assert_allclose(dataset.true_map.positions, BEACONS)


def test_the_first_pose_is_laid_over_the_gps(small):
    folder, _, poses, _ = small
    dataset = car_park.load(folder)
    assert_allclose(dataset.prior.mean, poses[0], atol=1e-7)
    assert_allclose(dataset.prior.covariance, np.diag(np.square(car_park.PRIOR_SIGMAS)))


def test_what_is_seen_are_the_beacons_but_for_half_a_beam(small):
    folder, _, poses, seen = small
    dataset = car_park.load(folder)
    o = dataset.observations
    assert_array_equal(o.step, np.repeat(np.arange(SCANS), list(map(len, seen))))
    assert_array_equal(dataset.true_landmark, np.concatenate(seen))
    expected, _, _ = dataset.sensors[0].observe(poses[o.step], BEACONS[dataset.true_landmark])
    assert_allclose(o.values[:, 0], expected[:, 0], atol=1e-9)
    half = 0.5 * car_park.BEAM_ANGLE + 1e-9
    assert np.abs(geo.wrap(o.values[:, 1] - expected[:, 1])).max() <= half
    assert not dataset.association_known


def test_a_reflector_that_is_no_beacon_has_no_identity(tmp_path, rng):
    data, _, seen = arrays_of(rng, lags=car_park.LAGS)
    dataset = car_park.load(written(tmp_path, data, np.delete(BEACONS, 0, axis=0)))
    expected = np.concatenate(seen)
    assert (expected == 0).any()
    assert_array_equal(dataset.true_landmark, expected - 1)


def test_lags_move_odometry_and_truth(tmp_path, rng):
    data, poses, _ = arrays_of(rng)
    none = car_park.load(written(tmp_path, data), lags=(0.0, 0.0), start=START)
    assert_allclose(geo.integrate(START, none.moves.deltas[0, 1:]), poses, atol=1e-7)
    assert_allclose(none.truth[:, :2], poses[:, :2], atol=1e-9)
    # A truth half a scan older lies half way back.
    older = car_park.load(tmp_path, lags=(0.0, SCAN / 2), start=START)
    middle = 0.5 * (poses[1:, :2] + poses[:-1, :2])
    assert_allclose(older.truth[1:, :2], middle, atol=1e-9)
    assert np.isnan(older.truth[0]).all()
    # A scan that is older by a row has the odometry of one row before.
    late = car_park.load(tmp_path, lags=(ROW, 0.0), start=START)
    ends = driven(
        np.append(0.0, data["Velocity"])[:-1],
        np.append(0.0, data["Steering"] * car_park.STEERING[0] + car_park.STEERING[1])[:-1],
        data["TimeLaser"],
    )
    assert_allclose(geo.integrate(ends[0], late.moves.deltas[0, 1:]), ends, atol=1e-7)


def test_noise_of_steps_is_that_of_the_rows_moved_to_the_laser(small, rng):
    """Against a Monte Carlo of noisy rows."""
    folder, data, _, _ = small
    sigmas = (0.1, 0.05)
    dataset = car_park.load(folder, control_sigmas=sigmas, step_sigmas=(0.0, 0.0, 0.0))
    draws = []
    for _ in range(400):
        noisy = dict(data)
        noisy["Velocity"] = data["Velocity"] + rng.normal(0, sigmas[0], len(data["Velocity"]))
        turned = rng.normal(0, sigmas[1] / car_park.STEERING[0], len(data["Steering"]))
        noisy["Steering"] = data["Steering"] + turned
        log = log_of(noisy)
        rows = log.odometry * [1, 1, car_park.STEERING[0]] + [0, 0, car_park.STEERING[1]]
        moves = car.axle_moves(rows, log.scans - car_park.LAGS[0], np.zeros((2, 2)))
        draws.append(car.displaced(moves, np.array(car.LASER_AT)).deltas)
    k = 5
    sample = np.cov(np.array(draws)[:, k].T)
    scale = np.sqrt(np.diag(dataset.moves.covariances[0, k + 1]))
    difference = (sample - dataset.moves.covariances[0, k + 1]) / np.outer(scale, scale)
    # A sample covariance of 400 draws spreads by up to sqrt(2 / 400).
    assert np.abs(difference).max() < 4.5 * np.sqrt(2 / 400)


def log_of(data):
    odometry = np.column_stack([data["Time_VS"], data["Velocity"], data["Steering"]])
    fixes = np.column_stack([data["TimeGPS"], data["GPSLon"], data["GPSLat"]])
    return car_park.Log(
        fixes, odometry, data["TimeLaser"], data["Laser"], data["Intensity"], BEACONS
    )


def test_options_reach_the_models(small):
    folder = small[0]
    default = car_park.load(folder, start=START)
    changed = car_park.load(
        folder,
        start=START,
        range_bias=car_park.RANGE_BIAS + 0.5,
        sensor_sigmas=(0.1, 0.2),
        prior_sigmas=(0.1, 0.2, 0.3),
        step_sigmas=np.add(car_park.STEP_SIGMAS, 0.1),
        speed_scale=2 * car_park.SPEED_SCALE,
    )
    assert_allclose(
        changed.observations.values - default.observations.values,
        np.tile([-0.5, 0.0], (len(default.observations), 1)),
    )
    assert_allclose(changed.sensors[0].covariance, np.diag([0.01, 0.04]))
    assert_allclose(changed.prior.covariance, np.diag([0.01, 0.04, 0.09]))
    assert (np.diagonal(changed.robot.covariance, axis1=1, axis2=2) > 0.01).all()
    assert_allclose(changed.moves.deltas[0, :, 2], 2 * default.moves.deltas[0, :, 2])


@pytest.mark.parametrize(
    "option",
    [
        {"speed_scale": 0.0},
        {"steering": (1.0,)},
        {"lags": (np.nan, 0.0)},
        {"lags": (1e9, 0.0)},
        {"range_bias": 1e300},
        {"start": (1e300, 0.0, 0.0)},
        {"range_bias": np.inf},
        {"control_sigmas": (-0.1, 0.1)},
        {"step_sigmas": (0.1, 0.1)},
        {"sensor_sigmas": "none"},
        {"start": (0.0, 0.0)},
        {"prior_sigmas": (0.1, 0.1)},
        {"lags": (0.0, 1e3)},
    ],
)
def test_an_option_that_makes_no_sense_is_named(small, option):
    with pytest.raises(InputError, match=next(iter(option))):
        car_park.load(small[0], **option)


# Reflectors ---------------------------------------------------------------------------------------


def test_reflectors_are_bright_beams_with_small_gaps():
    ranges, bright = np.full((3, 361), 81.91), np.zeros((3, 361))
    for scan, beams in ((0, [10, 11, 14]), (0, [18]), (2, [0]), (2, [180, 183, 186]), (2, [360])):
        bright[scan, beams] = 8192
        ranges[scan, beams] = 5.0 + 0.1 * np.arange(len(beams))
    step, values = car_park.reflectors(ranges, bright)
    assert_array_equal(step, [0, 0, 2, 2, 2])
    assert_allclose(values[:, 0], [5.1, 5.0, 5.0, 5.1, 5.0])
    degrees = np.array([35.0 / 6, 9.0, 0.0, 91.5, 180.0]) - 90
    assert_allclose(values[:, 1], np.deg2rad(degrees), atol=1e-12)
    step, values = car_park.reflectors(ranges, np.zeros((3, 361)))
    assert step.shape == (0,)
    assert values.shape == (0, 2)


# Damage -------------------------------------------------------------------------------------------


def replaced(name, index, value):
    def change(data):
        array = np.array(data[name], dtype=float)
        array[index] = value
        return {**data, name: array}

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: {k: v for k, v in d.items() if k != "Laser"}, "has no array Laser"),
        (lambda d: {**d, "Laser": d["Laser"][:, :-1]}, "Laser must be numbers, n x 361"),
        (lambda d: {**d, "Intensity": d["Intensity"][:-1]}, "15 rows of Intensity, but 16 of"),
        (lambda d: {**d, "GPSLat": d["GPSLat"][:-1]}, "16 of TimeGPS, .*15 of GPSLat"),
        (replaced("Steering", 3, np.nan), "NaN or infinite value in row 1, column 4 of Steering"),
        (replaced("Steering", 3, 20.0), "radians.* in row 4 of Steering"),
        (replaced("Velocity", 5, 1e3), "m/s.* in row 6 of Velocity"),
        (replaced("GPSLon", 2, 1e7), "metres.* in row 3 of GPSLon"),
        (replaced("TimeLaser", 2, BEGIN), "does not increase in row 3 of TimeLaser"),
        (replaced("TimeLaser", 2, BEGIN + 0.61), "next entry of TimeLaser.* in row .* of Index"),
        (replaced("Index", 7, 99), "in row 8 of Index"),
        (replaced("Sensor", 7, 4), "no sensor 1, 2 or 3 in row 8 of Sensor"),
        (replaced("Laser", (4, 7), 8191.0), "82 m in row 5 of Laser"),
        (replaced("Laser", (4, 7), -1.0), "below 0 m.* in row 5 of Laser"),
        (replaced("Intensity", (4, 7), -1.0), "negative intensity in row 5"),
    ],
)
def test_a_damaged_array_is_named(small, change, said):
    folder, data, _, _ = small
    written(folder, change(data))
    with pytest.raises(FileFormatError, match=rf"data_set\.mat: .*{said}"):
        car_park.load(folder)


def test_scans_left_out_everywhere_but_in_the_events_are_missed(small):
    folder, data, _, _ = small
    shorter = {name: data[name][:-1] for name in ("TimeLaser", "Laser", "Intensity")}
    written(folder, {**data, **shorter})
    with pytest.raises(FileFormatError, match="16 events of sensor 3 in Sensor, but 15 entries"):
        car_park.load(folder)


@pytest.mark.parametrize(
    ("beacons", "said"),
    [
        (BEACONS[:1], "two beacons"),
        (1e6 * BEACONS, "metres"),
        (BEACONS.T, "n x 2"),
        (BEACONS * [1, np.nan], "NaN"),
    ],
)
def test_damaged_beacons_are_named(small, beacons, said):
    folder, data, _, _ = small
    written(folder, data, beacons)
    with pytest.raises(FileFormatError, match=rf"beac_juan3\.mat: .*{said}"):
        car_park.load(folder)


def test_no_damage_breaks_the_loader(tmp_path, rng):
    (tmp_path / "made").mkdir()
    (tmp_path / "damaged").mkdir()
    data, _, _ = arrays_of(rng, scans=4)
    folder = written(tmp_path / "made", data)
    files = {name: (folder / name).read_bytes() for name in (car_park.DATA, car_park.BEACONS)}

    def scans_arrive(dataset, damaged):
        assert dataset.poses == 4

    told = fuzz.check(
        car_park.load,
        tmp_path / "damaged",
        files,
        count=1000,
        seed=5,
        whole=scans_arrive,
        certain=("empty", "missing"),
    )
    assert told["refused"] > 300
    assert told["loaded"] > 50


# The log itself -----------------------------------------------------------------------------------


def test_the_whole_log_is_there(recorded_data):
    dataset = recorded_data("car-park")
    assert dataset.poses == 586
    assert len(dataset.observations) == 892
    assert len(dataset.known_map) == 15
    assert set(dataset.true_landmark) == set(range(-1, 15))
    assert np.sum(dataset.true_landmark < 0) == 4
    assert np.isfinite(dataset.truth[:, :2]).all()
    way = np.hypot(*np.diff(dataset.truth[:, :2], axis=0).T).sum()
    assert way == pytest.approx(228, abs=2)


def test_localization_is_as_good_as_the_noise_says(recorded_data):
    dataset = recorded_data("car-park")
    estimate = EkfLocalization().estimate(dataset)
    assert estimate.status == "ok"
    error = np.linalg.norm((estimate.online.poses - dataset.truth)[:, :2], axis=1)
    assert error.mean() < 0.05
    used = np.isfinite(estimate.innovations.innovation[:, 0])
    nu, S = estimate.innovations.innovation[used], estimate.innovations.S[used]
    nis = np.einsum("ni,ni->n", nu, np.linalg.solve(S, nu[..., None])[..., 0])
    assert 1.0 < nis.mean() < 2.0  # stated with a margin, for tails


def test_the_encoder_is_not_slow(recorded_data):
    """Dead reckoning with the factor 1.08, that GPS against encoder suggests, is far worse."""
    off = {}
    for scale in (1.0, 1.08):
        dataset = recorded_data("car-park", speed_scale=scale)
        path = geo.integrate(dataset.prior.mean, dataset.moves.deltas[0, 1:])
        off[scale] = np.linalg.norm((path - dataset.truth)[:, :2], axis=1).mean()
    assert off[1.0] < 1.0
    assert off[1.08] > 5 * off[1.0]


def test_confirmed_landmarks_are_the_beacons(recorded_data):
    dataset = recorded_data("car-park")
    landmarks = Ekf(association="nearest", confirm=3).estimate(dataset).landmarks.positions
    assert len(landmarks) == 15
    beacons = dataset.true_map.positions
    nearest = np.linalg.norm(landmarks[:, None] - beacons, axis=2).argmin(axis=1)
    assert len(set(nearest)) == 15
    fitted = geo.from_frame(geo.align(landmarks, beacons[nearest]), landmarks)
    assert np.sqrt(np.mean(np.sum((fitted - beacons[nearest]) ** 2, axis=1))) < 0.06
