"""Brenner's LEGO robot: small logs in its format, damage to them, and the log itself."""

from __future__ import annotations

import gzip

import fuzz
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from ekfslam import geometry as geo
from ekfslam.datasets import lego, load_recorded
from ekfslam.datasets.identities import identified
from ekfslam.errors import FileFormatError, InputError
from ekfslam.filters.localization import EkfLocalization
from ekfslam.models.motion import MotionModel

CYLINDERS = np.array([[1.3, 1.9], [0.5, 0.7], [1.2, 0.75], [1.7, 1.05], [0.4, 1.45], [1.8, 0.2]])
STEP = 250  # ms
FILES = ("robot4_motors.txt", "robot4_scan.txt", "robot4_reference.txt")
MAP = "robot_arena_landmarks.txt"


def drive(rng, rows=12):
    """Ticks (rows, 2) from any start, the way they make, and the poses of the axle."""
    ticks = np.array([20795, 16067]) + np.cumsum(rng.integers(0, 130, (rows, 2)), axis=0)
    wheels = lego.TICK * np.diff(ticks, axis=0)
    motion = MotionModel("wheel-increments", None, (0.1, 0.1), 0.0, lego.WIDTH)
    start = np.array([1.5, 1.5, np.deg2rad(213.0)])
    return ticks, wheels, geo.integrate(start, motion.increment(wheels)[0])


def scan_of(pose):
    """Ranges [mm] to a wall, and to each cylinder 9 beams of its range less the offset."""
    ranges = np.full(lego.BEAMS, 2400.0)
    scanner = geo.compose(pose, lego.MOUNT)
    points = geo.to_frame(scanner, CYLINDERS)
    shown = []
    for point in points:
        beam = round(float(np.arctan2(point[1], point[0]) / lego.BEAM_ANGLE)) + lego.AHEAD
        distance = float(np.hypot(*point)) - lego.CYLINDER_OFFSET
        free = 20 < beam < lego.BEAMS - 20 and (ranges[beam - 15 : beam + 16] == 2400).all()
        if free and distance < 2.0:
            ranges[beam - 5 : beam + 6] = 1e3 * distance
            shown.append(point)
    return ranges, np.array(shown).reshape(-1, 2)


def recorded_reference(position):
    """Where the camera has a scanner [mm]."""
    centre = np.array(lego.REFERENCE_CENTRE)
    return 1e3 * (centre + (np.asarray(position) - centre) / lego.REFERENCE_SCALE)


def texts(ticks, poses, lags=(0.375, 0.15)):
    """The four files; stamps such that the moments of a row are one."""
    times = 1000 + STEP * np.arange(len(poses))
    motors = [
        f"M {time} {left!r} {left!r} 3000 0 {right!r} {right!r} 3000 0 0 0 6000 0"
        for time, (left, right) in zip(times, ticks.tolist(), strict=True)
    ]
    scans = [
        " ".join(map(str, ["S", time + round(1e3 * lags[0]), lego.BEAMS, *scan_of(pose)[0]]))
        for time, pose in zip(times, poses, strict=True)
    ]
    seen_from = recorded_reference(geo.from_frame(poses, np.array(lego.MOUNT[:2])))
    reference = [
        f"P {time + round(1e3 * lags[1])} {x!r} {y!r}"
        for time, (x, y) in zip(times, seen_from.tolist(), strict=True)
    ]
    cylinders = [f"L C {1e3 * x!r}\t{1e3 * y!r}\t55.0" for x, y in CYLINDERS.tolist()]
    contents = (motors, scans, reference, cylinders)
    return {
        name: "".join(f"{line}\n" for line in lines)
        for name, lines in zip((*FILES, MAP), contents, strict=True)
    }


def written(folder, contents):
    for name, text in contents.items():
        (folder / name).write_text(text)
    return folder


def start_of(poses):
    """The option that a drive from here needs."""
    scanner = geo.from_frame(poses[0], np.array(lego.MOUNT[:2]))
    return (*(1e-3 * recorded_reference(scanner)), np.deg2rad(213.0))


@pytest.fixture
def small(tmp_path, rng):
    """A drive, its poses and its files in a folder."""
    ticks, wheels, poses = drive(rng)
    return written(tmp_path, texts(ticks, poses)), wheels, poses


# A drive without noise comes back -----------------------------------------------------------------


def test_a_drive_without_noise_comes_back_as_the_truth(small):
    folder, wheels, poses = small
    dataset = load_recorded("lego", folder, start=start_of(poses))
    assert_allclose(dataset.robot.controls, wheels, atol=1e-12)
    assert_allclose(dataset.prior.mean, poses[0], atol=1e-12)
    assert_allclose(geo.integrate(poses[0], dataset.moves.deltas[0, 1:]), poses, atol=1e-12)
    assert_allclose(dataset.truth[:, :2], poses[:, :2], atol=1e-9)
    assert np.isnan(dataset.truth[:, 2]).all()
    assert_allclose(dataset.times, 1.375 + 1e-3 * STEP * np.arange(len(poses)))
    assert_allclose(dataset.known_map.positions, CYLINDERS)
    assert_allclose(dataset.true_map.positions, CYLINDERS)


def test_what_is_seen_are_the_cylinders_but_for_half_a_beam(small):
    folder, _, poses = small
    dataset = lego.load(folder, start=start_of(poses))
    expected = [scan_of(pose)[1] for pose in poses]
    assert_array_equal(
        np.bincount(dataset.observations.step, minlength=len(poses)), list(map(len, expected))
    )
    for k, points in enumerate(expected):
        values = dataset.observations.values[dataset.observations.step == k]
        bearing = np.arctan2(points[:, 1], points[:, 0])
        order = np.argsort(bearing)
        assert_allclose(values[:, 0], np.hypot(*points[order].T), atol=1e-9)
        assert_allclose(values[:, 1], bearing[order], atol=0.5 * lego.BEAM_ANGLE + 1e-9)
    poses_seen, identity = poses[dataset.observations.step], dataset.true_landmark
    assert (identity >= 0).all()
    there = dataset.sensors[0].locate(poses_seen, dataset.observations.values)[0]
    assert_allclose(there, CYLINDERS[identity], atol=2.0 * lego.BEAM_ANGLE)
    assert not dataset.association_known


def test_rows_are_paired_by_their_number_if_no_lags_are_given(tmp_path, rng):
    ticks, _, poses = drive(rng)
    contents = texts(ticks, poses, lags=(0.05, -0.02))
    dataset = lego.load(written(tmp_path, contents), lags=None, start=start_of(poses))
    assert_allclose(dataset.truth[:, :2], poses[:, :2], atol=1e-9)
    assert_allclose(geo.integrate(poses[0], dataset.moves.deltas[0, 1:]), poses, atol=1e-12)
    shifted = lego.load(tmp_path, start=start_of(poses))
    known = np.isfinite(shifted.truth[:, 0])
    assert np.abs((shifted.truth - poses)[known, :2]).max() > 0.005


def test_a_truth_before_the_first_stamp_is_not_known(small):
    folder, _, poses = small
    dataset = lego.load(folder, lags=(1.0, 0.15), start=start_of(poses))
    assert_array_equal(np.isnan(dataset.truth[:, 0]), np.arange(len(poses)) < 3)


def test_a_scale_of_one_leaves_the_reference_as_it_was(small):
    folder, _, poses = small
    kept = lego.load(folder, reference_scale=1.0, mount=(0.0, 0.0, 0.0))
    mended = lego.load(folder, mount=(0.0, 0.0, 0.0))
    centre, away = lego.REFERENCE_CENTRE, kept.truth[:, :2] - lego.REFERENCE_CENTRE
    assert_allclose(mended.truth[:, :2], centre + lego.REFERENCE_SCALE * away, atol=1e-12)
    scanner = geo.from_frame(poses, np.array(lego.MOUNT[:2]))
    assert_allclose(1e3 * kept.truth[:, :2], recorded_reference(scanner), atol=1e-9)


def test_options_reach_the_models(small):
    folder, _, _ = small
    dataset = lego.load(
        folder,
        proportional=(0.35, 0.6),
        slip=0.002,
        width=0.173,
        tick=2 * lego.TICK,
        sensor_sigmas=(0.2, 0.25),
        prior_sigmas=(0.1, 0.2, 0.3),
        cylinder_offset=lego.CYLINDER_OFFSET + 0.5,
    )
    default = lego.load(folder)
    motion = dataset.robot.motion
    assert (motion.proportional, motion.slip, motion.width) == ((0.35, 0.6), 0.002, 0.173)
    assert_allclose(dataset.robot.controls, 2 * default.robot.controls)
    assert_allclose(dataset.sensors[0].covariance, np.diag([0.04, 0.0625]))
    assert_allclose(dataset.prior.covariance, np.diag([0.01, 0.04, 0.09]))
    assert_allclose(
        dataset.observations.values - default.observations.values,
        np.tile([0.5, 0.0], (len(default.observations), 1)),
    )
    assert len(lego.load(folder, jump=5.0).observations) == 0


@pytest.mark.parametrize(
    "option",
    [
        {"lags": (0.1,)},
        {"lags": (np.nan, 0.0)},
        {"lags": (1e9, 0.0)},
        {"slip": 1e300},
        {"tick": 1e300},
        {"prior_sigmas": (1e300, 1.0, 1.0)},
        {"tick": 0.0},
        {"width": -1.0},
        {"slip": -0.1},
        {"mount": (0.0, 0.0)},
        {"sensor_sigmas": (-1.0, 0.1)},
        {"prior_sigmas": (0.1, 0.1)},
        {"reference_scale": 0.0},
        {"reference_centre": 1.0},
        {"start": "here"},
        {"cylinder_offset": np.inf},
        {"jump": 0},
    ],
)
def test_an_option_that_makes_no_sense_is_named(small, option):
    with pytest.raises(InputError, match=next(iter(option)).replace("_", ".")):
        lego.load(small[0], **option)


# Damage -------------------------------------------------------------------------------------------


def test_compressed_files_are_read(small):
    folder = small[0]
    plain = lego.load(folder)
    scan = folder / "robot4_scan.txt"
    (folder / "robot4_scan.txt.gz").write_bytes(gzip.compress(scan.read_bytes()))
    scan.unlink()
    assert_array_equal(lego.load(folder).observations.values, plain.observations.values)


@pytest.mark.parametrize(
    ("name", "line", "change", "said"),
    [
        ("robot4_motors.txt", 3, lambda w: [*w, "1"], "13 numbers of M are wanted"),
        ("robot4_motors.txt", 3, lambda w: ["X", *w[1:]], "M is wanted first, there is 'X'"),
        ("robot4_motors.txt", 4, lambda w: [w[0], "1000", *w[2:]], "time goes back"),
        ("robot4_motors.txt", 4, lambda w: [*w[:2], "900000", *w[3:]], "2000 ticks"),
        ("robot4_motors.txt", 12, lambda w: [w[0], "9000", *w[2:]], "more than a second"),
        ("robot4_scan.txt", 2, lambda w: w[:-1], "662 numbers of S are wanted"),
        ("robot4_scan.txt", 2, lambda w: [*w[:2], "661", *w[3:]], "number of beams is not 660"),
        ("robot4_scan.txt", 5, lambda w: [*w[:9], "-3", *w[10:]], "negative range"),
        ("robot4_scan.txt", 5, lambda w: [*w[:9], "nan", *w[10:]], "range 6 of S is nan"),
        ("robot4_scan.txt", 5, lambda w: [*w[:9], "1e6", *w[10:]], "millimetres"),
        ("robot4_scan.txt", 5, lambda w: [*w[:3], *["2.4"] * 660], "millimetres"),
        ("robot4_scan.txt", 2, lambda w: [w[0], "1375", *w[2:]], "time does not increase"),
        ("robot4_reference.txt", 7, lambda w: [*w[:2], "many", w[3]], "x of P is no number"),
        ("robot4_reference.txt", 7, lambda w: [*w[:2], "1e7", w[3]], "millimetres"),
        ("robot_arena_landmarks.txt", 2, lambda w: w[:4], "3 numbers of L C are wanted"),
        ("robot_arena_landmarks.txt", 2, lambda w: [*w[:4], "0"], "diameter"),
    ],
)
def test_a_damaged_line_is_named(small, name, line, change, said):
    path = small[0] / name
    lines = path.read_text().splitlines()
    lines[line - 1] = " ".join(change(lines[line - 1].split()))
    path.write_text("\n".join(lines))
    with pytest.raises(FileFormatError, match=rf"{name}, line {line}: .*{said}"):
        lego.load(small[0])


@pytest.mark.parametrize("name", ["robot4_reference.txt", "robot_arena_landmarks.txt"])
def test_metres_are_no_millimetres(small, name):
    path = small[0] / name
    shrunk = []
    for line in path.read_text().splitlines():
        words = line.split()
        shrunk.append(" ".join([*words[:2], *(str(1e-3 * float(word)) for word in words[2:])]))
    path.write_text("\n".join(shrunk))
    with pytest.raises(FileFormatError, match=rf"{name}, line 1: .*millimetres"):
        lego.load(small[0])


@pytest.mark.parametrize("name", FILES)
def test_a_stream_with_a_row_less_is_refused(small, name):
    path = small[0] / name
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    with pytest.raises(FileFormatError, match=r"\d+ rows, but \d+ in robot4_scan.txt"):
        lego.load(small[0])


def test_one_cylinder_makes_no_map(small):
    (small[0] / MAP).write_text("L C 1000 1000 55\n")
    with pytest.raises(FileFormatError, match="one cylinder alone"):
        lego.load(small[0])


def test_no_damage_breaks_the_loader(tmp_path, rng):
    ticks, _, poses = drive(rng, rows=3)
    files = {name: text.encode() for name, text in texts(ticks, poses).items()}

    def rows_arrive(dataset, damaged):
        kept = [line for line in damaged["robot4_scan.txt"].splitlines() if line.strip()]
        assert dataset.poses == len(kept) == len(poses)

    told = fuzz.check(
        lego.load,
        tmp_path,
        files,
        count=1000,
        seed=3,
        whole=rows_arrive,
        certain=("drop_column", "add_column", "empty"),
    )
    assert told["refused"] > 300
    assert told["loaded"] > 50


# Identities, for evaluation -----------------------------------------------------------------------


def test_identities_are_told_though_headings_drift(rng):
    landmarks = rng.uniform(-10, 10, (8, 2))
    truth = np.column_stack([rng.uniform(-5, 5, (60, 2)), rng.uniform(-3, 3, 60)])
    step = np.repeat(np.arange(60), 3)
    which = rng.permuted(np.tile(np.arange(8), (60, 1)), axis=1)[:, :3].ravel()
    points = geo.to_frame(truth[step], landmarks[which]) + rng.normal(0, 0.01, (180, 2))
    drifting = truth + np.column_stack([np.zeros((60, 2)), np.linspace(0, 1.0, 60)])
    found = identified(drifting, step, points, landmarks, 0.5, 4, 1.2)
    apart = np.linalg.norm(landmarks[:, None] - landmarks, axis=2) + 99 * np.eye(8)
    lonely = apart.min(axis=1)[which] > 1.5
    assert_array_equal(found[lonely], which[lonely])
    assert set(found[found != which]) <= {-1}
    alone = identified(drifting, step, points, landmarks, 0.5, 0, 1.2)
    assert np.mean(alone == which) > 0.6  # three sightings of one step nearly always suffice
    # Beyond what is looked for, there is nothing.
    assert np.mean(identified(drifting, step, points, landmarks, 0.5, 4, 0.1) == which) < 0.5


def test_what_is_in_doubt_has_no_identity():
    unknown = np.nan, np.nan, 0.0
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], unknown])
    landmarks = np.array([[1.0, 0.0], [1.0, 1.0], [9.0, 9.0]])
    cases = [
        (0, (1.0, 0.0), 0),
        (0, (1.1, 0.0), -1),  # the first landmark, too, but not as near
        (0, (5.0, 5.0), -1),  # near none
        (0, (1.0, 1.0), 1),
        (1, (1.0, 0.45), -1),  # between two
        (1, (1.0, 0.7), 1),
        (2, (1.0, 0.0), -1),  # from an unknown pose
    ]
    step, points, expected = map(np.array, zip(*cases, strict=True))
    assert_array_equal(identified(poses, step, points, landmarks, 0.6, 0, 0.0), expected)


# The log itself -----------------------------------------------------------------------------------


def test_the_whole_log_is_there(recorded_data):
    dataset = recorded_data("lego")
    assert dataset.poses == 278
    assert len(dataset.observations) == 895
    assert len(dataset.known_map) == 6
    assert set(dataset.true_landmark) == set(range(6))  # also of the steps without a true position
    assert np.isnan(dataset.truth[:, 0]).sum() <= 2
    assert_allclose(dataset.known_map.positions[0], [1.291, 1.881])


def test_localization_is_within_four_centimetres_and_its_noise_is_as_stated(recorded_data):
    dataset = recorded_data("lego")
    estimate = EkfLocalization().estimate(dataset)
    assert estimate.status == "ok"
    error = np.linalg.norm((estimate.online.poses - dataset.truth)[:, :2], axis=1)
    assert np.nanmean(error) < 0.02
    used = np.isfinite(estimate.innovations.innovation[:, 0])
    nu, S = estimate.innovations.innovation[used], estimate.innovations.S[used]
    nis = np.einsum("ni,ni->n", nu, np.linalg.solve(S, nu[..., None])[..., 0])
    # Mean 2 and variance 4 of chi-square with two degrees of freedom.
    assert nis.mean() == pytest.approx(2.0, abs=4 * 2 / np.sqrt(len(nis)))


def test_stamps_that_lag_are_worth_more_than_rows(recorded_data):
    rows = recorded_data(
        "lego", lags=None, proportional=(0.14, 0.17), sensor_sigmas=(0.0205, 0.035)
    )
    error = {}
    for name, dataset in (("stamps", recorded_data("lego")), ("rows", rows)):
        poses = EkfLocalization().estimate(dataset).online.poses
        error[name] = np.nanmean(np.linalg.norm((poses - dataset.truth)[:, :2], axis=1))
    assert error["stamps"] < 0.5 * error["rows"]


def test_the_scale_of_the_reference_is_an_error(recorded_data):
    raw = recorded_data("lego", reference_scale=1.0)
    poses = EkfLocalization().estimate(raw).online.poses
    assert np.nanmean(np.linalg.norm((poses - raw.truth)[:, :2], axis=1)) > 0.05
