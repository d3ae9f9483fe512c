"""Victoria Park from the car's own log: the drive of an axle, taken to the laser in front of it."""

from __future__ import annotations

import fuzz
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import ekfslam
from ekfslam import geometry as geo
from ekfslam.datasets import car, victoria_park_raw
from ekfslam.errors import FileFormatError, InputError

MS = 1e-3
AHEAD, LEFT, WHEEL, BASE = 3.78, 0.5, 0.76, 2.83
CLOCK = 20.967
NAMES = ("DRS.txt", "GPS.txt", "tree_observations.txt")


def rows(*columns):
    return "".join(" ".join(map(repr, row)) + "\n" for row in zip(*columns, strict=True))


class Drive:
    """A car among trees, moved in steps of a millisecond, and what it writes."""

    TREES = np.array([[8.0, 3.0], [10.0, -4.0], [18.0, 6.0], [22.0, -1.0], [15.0, 14.0]])
    START = np.array([3.0, -2.0, 0.4])

    def __init__(self, rng, seconds=6.0):
        count = round(seconds / 0.025)
        self.times = np.round(1.0 + 0.025 * np.arange(count), 6)
        centre = 2.0 + np.sin(np.arange(count) / 40)
        self.steering = 0.4 * np.sin(np.arange(count) / 30) + 0.02 * rng.normal(size=count)
        turning = centre * np.tan(self.steering) / BASE
        self.speed = centre - WHEEL * turning  # of the wheel to the left of the axle's centre
        pose, path = self.START.copy(), [self.START.copy()]
        for v, w in np.repeat(np.column_stack([centre, turning]), 25, axis=0):
            middle = pose[2] + 0.5 * MS * w
            pose = pose + MS * np.array([v * np.cos(middle), v * np.sin(middle), w])
            path.append(pose)
        self.path = geo.compose(np.array(path), [AHEAD, LEFT, 0.0])
        self.scans = np.round(np.arange(0.852, 1.0 + seconds + 0.5, 0.214), 6)
        inside = (self.scans >= 1.0) & (self.scans <= 1.0 + seconds)
        self.at = self.scans[inside]
        self.poses = self.path[np.round((self.at - 1.0) / MS).astype(int)]

    def files(self):
        seen = []
        for number, time in enumerate(self.scans.tolist()):
            k = np.clip(round((time - 1.0) / MS), 0, len(self.path) - 1)
            for which, point in enumerate(self.TREES):
                x, y = geo.to_frame(self.path[k], point).tolist()
                bearing = float(np.arctan2(y, x) + np.pi / 2)  # from the right
                if 0 <= bearing <= np.pi:
                    distance, diameter = float(np.hypot(x, y)), 0.1 + 0.2 * which
                    seen.append((number, time + CLOCK, distance, bearing, diameter))
        fixes = [self.at, self.poses[:, 1], self.poses[:, 0]]  # north, then east
        texts = (
            rows(self.times.tolist(), self.speed.tolist(), self.steering.tolist()),
            rows(*(column.tolist() for column in fixes)),
            "# scan time range bearing diameter\n" + rows(*zip(*seen, strict=True)),
        )
        return dict(zip(NAMES, texts, strict=True))


@pytest.fixture(scope="module")
def drive():
    return Drive(np.random.default_rng(8))


@pytest.fixture
def write(tmp_path, drive):
    """Writes the files of the drive with changes (None: left out), and returns their folder."""

    def written(**changes):
        files = drive.files() | {f"{name}.txt": text for name, text in changes.items()}
        for name, text in files.items():
            if text is not None:
                (tmp_path / name).write_text(text, newline="")
        return tmp_path

    return written


# What a drive without noise gives back ------------------------------------------------------------


def test_the_odometry_is_that_of_the_laser_between_its_scans(write, drive):
    dataset = ekfslam.load("victoria-park-raw", write(), max_diameter=9)
    assert_allclose(dataset.times, drive.at, atol=1e-9)
    # A step of the midpoint rule is off by v w^2 h^3 / 24, below 1e-10 m here.
    found = geo.integrate(dataset.prior.mean, dataset.robot.increments.deltas)
    assert_allclose(geo.additive_error(drive.poses, found), 0, atol=1e-6)
    assert_allclose(dataset.truth[:, :2], drive.poses[:, :2], atol=1e-9)
    assert np.isnan(dataset.truth[:, 2]).all()


def test_trees_stand_where_they_are_seen(write, drive):
    dataset = ekfslam.load("victoria-park-raw", write(), max_diameter=9)
    o = dataset.observations
    points, _, _ = dataset.sensors[0].locate(drive.poses[o.step], o.values)
    which = np.round((o.descriptor - 0.1) / 0.2).astype(int)
    assert_allclose(points, drive.TREES[which], atol=1e-6)
    assert (o.landmark == -1).all()
    assert dataset.sensors[0].sees(drive.poses[o.step], points).all()
    estimate = ekfslam.estimate(dataset, "ekf(association=nearest)")
    assert_allclose(geo.additive_error(drive.poses, estimate.online.poses), 0, atol=1e-5)
    assert len(estimate.landmarks.ids) == len(drive.TREES)


def test_the_axle_may_be_the_point_that_is_estimated(write, drive):
    dataset = victoria_park_raw.load(write(), reference=(0, 0), max_diameter=9)
    axle = geo.compose(drive.poses, geo.inverse([AHEAD, LEFT, 0.0]))
    found = geo.integrate(axle[0], dataset.robot.increments.deltas)
    assert_allclose(geo.additive_error(axle, found), 0, atol=1e-6)
    assert_allclose(dataset.sensors[0].mount, [AHEAD, LEFT, 0])
    o = dataset.observations
    points, _, _ = dataset.sensors[0].locate(axle[o.step], o.values)
    which = np.round((o.descriptor - 0.1) / 0.2).astype(int)
    assert_allclose(points, drive.TREES[which], atol=1e-6)


def test_poses_can_be_fewer(write, drive):
    dataset = victoria_park_raw.load(write(), step=0.5, max_diameter=9)
    assert_allclose(dataset.times, drive.at[::3], atol=1e-9)  # 3 x 0.214 s
    found = geo.integrate(dataset.prior.mean, dataset.robot.increments.deltas)
    assert_allclose(geo.additive_error(drive.poses[::3], found), 0, atol=1e-6)
    all_of_them = victoria_park_raw.load(write(), max_diameter=9).observations
    kept = all_of_them.step % 3 == 0
    assert_array_equal(dataset.observations.values, all_of_them.values[kept])
    assert_array_equal(dataset.observations.step, all_of_them.step[kept] // 3)


def test_trees_far_away_or_thick_are_left_out(write):
    everything = victoria_park_raw.load(write(), max_diameter=9).observations
    some = victoria_park_raw.load(write(), max_range=9, max_diameter=0.6).observations
    expected = (everything.values[:, 0] <= 9) & (everything.descriptor <= 0.6)
    assert 0 < expected.sum() < len(expected)
    assert_array_equal(some.values, everything.values[expected])


# Noise --------------------------------------------------------------------------------------------


def test_noise_of_a_step_is_that_of_drawn_rows(rng):
    """Noise of 0.1 m/s and 0.02 rad in each of 12 rows, 4,000 times; at the laser."""
    times = np.round(0.025 * np.arange(13), 6)
    logged = np.column_stack([times, np.full(13, 3.0), np.linspace(-0.3, 0.4, 13)])
    sigmas = np.array([0.1, 0.02])
    at = np.array([AHEAD, LEFT])

    def move(logged, noise):
        ends = times[[0, 12]]
        return car.displaced(car.axle_moves(logged, ends, noise), at)

    stated = move(logged, np.diag(sigmas**2))
    drawn = []
    for _ in range(4000):
        noisy = logged.copy()
        noisy[:, 1:] += sigmas * rng.normal(size=(13, 2))
        drawn.append(move(noisy, np.zeros((2, 2))).deltas[0])
    error = geo.additive_error(np.array(drawn), stated.deltas[0])
    scale = np.sqrt(np.outer(np.diag(stated.covariances[0]), np.diag(stated.covariances[0])))
    gap = np.abs(np.cov(error.T) - stated.covariances[0])
    assert (gap < 5 * np.sqrt(2 / 4000) * scale).all()


def test_noise_does_not_depend_on_where_a_row_is_cut():
    """Rows of one speed straight on: cut into scans or not, the variances add up to the same."""
    times = np.round(0.025 * np.arange(41), 6)
    logged = np.column_stack([times, np.full(41, 2.0), np.zeros(41)])
    noise = np.diag([0.25, 0.0])
    whole = car.axle_moves(logged, np.array([0.0, 1.0]), noise)
    parts = car.axle_moves(logged, np.array([0.0, 0.011, 0.4, 0.777, 1.0]), noise)
    assert whole.covariances[0, 0, 0] == pytest.approx(40 * 0.25 * 0.025**2)
    assert parts.covariances[:, 0, 0].sum() == pytest.approx(whole.covariances[0, 0, 0])


def test_noise_can_be_stated(write):
    base = victoria_park_raw.load(write(), step_sigmas=(0, 0, 0))
    other = victoria_park_raw.load(
        write(),
        step_sigmas=(0.1, 0.2, 0.3),
        sensor_sigmas=(0.4, 0.5),
        prior_sigmas=(0.6, 0.7, 0.8),
    )
    apart = other.robot.increments.covariances - base.robot.increments.covariances
    assert_allclose(apart, np.broadcast_to(np.diag([0.01, 0.04, 0.09]), apart.shape), atol=1e-12)
    assert_allclose(other.sensors[0].covariance, np.diag([0.16, 0.25]))
    assert_allclose(other.prior.covariance, np.diag([0.36, 0.49, 0.64]))


def test_a_clock_that_is_not_ahead_finds_other_poses(write, drive):
    later = victoria_park_raw.load(write(), clock=CLOCK - 1.0)
    assert_allclose(later.times[0], drive.scans[0] + 1.0)
    with pytest.raises(FileFormatError, match=r"no scan falls into the time of DRS\.txt, 1 s"):
        victoria_park_raw.load(write(), clock=0.0)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"step": -1}, "step must be a time in seconds"),
        ({"step": 1e4}, "steps of 10000 s leave one pose"),
        ({"max_range": 0}, "max_range must be positive"),
        ({"max_diameter": np.nan}, "max_diameter must be positive"),
        ({"reference": (1, 2, 3)}, "reference must have shape"),
        ({"clock": np.inf}, "clock must be finite"),
        ({"control_sigmas": (1,)}, "control_sigmas"),
        ({"sensor_sigmas": (1, -1)}, "sensor_sigmas must be standard deviations"),
    ],
)
def test_options_that_make_no_sense(write, options, said):
    with pytest.raises(InputError, match=said):
        victoria_park_raw.load(write(), **options)


# Truth --------------------------------------------------------------------------------------------


def test_between_fixes_far_apart_nothing_is_known(write, drive):
    fixes = drive.files()["GPS.txt"].splitlines(keepends=True)
    dataset = victoria_park_raw.load(write(GPS="".join(fixes[:8] + fixes[16:])), step=0.1)
    known = np.isfinite(dataset.truth[:, 0])
    assert_array_equal(np.flatnonzero(~known), np.arange(8, 16))
    assert dataset.robot.truth_known is False


def test_without_a_fix_in_its_time_it_starts_at_the_first_one_heading_east(write):
    dataset = victoria_park_raw.load(write(GPS="900.0 7.0 5.0\n"))
    assert dataset.truth is None
    assert_array_equal(dataset.prior.mean, [5, 7, 0])


# Damage -------------------------------------------------------------------------------------------


def changed(files, name, line, column, value):
    """A file with one number replaced; lines count from 1."""
    lines = files[name].splitlines()
    words = lines[line - 1].split()
    words[column] = value
    lines[line - 1] = " ".join(words)
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("name", "line", "column", "value", "said"),
    [
        ("DRS", 5, 0, "0.5", "line 5: time does not increase"),
        ("DRS", 5, 1, "fast", "line 5: speed is no number but 'fast'"),
        ("DRS", 5, 1, "nan", "line 5: speed is nan"),
        ("DRS", 5, 1, "3000", "line 5: is the speed in metres per second"),
        ("DRS", 5, 2, "23", "line 5: is the steering angle in radians"),
        ("DRS", 5, 2, "0.1 7", "line 5: 3 numbers are wanted"),
        ("GPS", 4, 0, "0.5", "line 4: time does not increase"),
        ("GPS", 4, 2, "-337000", "line 4: are north and east in metres"),
        ("tree_observations", 9, 0, "0.5", "line 9: the scan is no whole number"),
        ("tree_observations", 3, 0, "99", "line 3: scan and time do not go on together"),
        ("tree_observations", 9, 0, "0", "line 9: scan and time do not go on together"),
        ("tree_observations", 9, 1, "22.1", "line 9: scan and time do not go on together"),
        ("tree_observations", 9, 2, "-3", "line 9: is the range in metres"),
        ("tree_observations", 9, 2, "3000", "line 9: is the range in metres"),
        ("tree_observations", 9, 3, "90", "line 9: is the bearing in radians"),
        ("tree_observations", 9, 4, "35", "line 9: is the diameter in metres"),
    ],
)
def test_a_damaged_file_is_named(write, drive, name, line, column, value, said):
    text = changed(drive.files(), f"{name}.txt", line, column, value)
    with pytest.raises(FileFormatError, match=rf"{name}\.txt, {said}"):
        victoria_park_raw.load(write(**{name: text}))


def test_lost_rows_of_the_odometry_show_in_its_times(write, drive):
    lines = drive.files()["DRS.txt"].splitlines(keepends=True)
    with pytest.raises(FileFormatError, match="line 10: rows are missing: they come every 25 ms"):
        victoria_park_raw.load(write(DRS="".join(lines[:9] + lines[10:])))


def test_without_detections_it_says_what_is_needed(write, tmp_path):
    folder = write(tree_observations=None)
    with pytest.raises(FileFormatError, match=r"has no tree_observations\.txt .*: there must be"):
        victoria_park_raw.load(folder)
    (folder / "LASER.txt").write_text("1.0 2.0")
    with pytest.raises(FileFormatError, match=r"beside LASER\.txt there must be the trees found"):
        victoria_park_raw.load(folder)


def test_damage_is_told_or_loads_whole(tmp_path):
    files = {
        name: text.encode() for name, text in Drive(np.random.default_rng(3), 0.4).files().items()
    }

    def whole(dataset, files):
        for name, said in zip(
            NAMES, ("rows of odometry", "fixes", "tree observations"), strict=True
        ):
            text = files[name].decode("utf-8-sig").replace("\r", "\n")
            comment = "#" if name == NAMES[2] else "%"
            count = sum(bool(line.split(comment)[0].strip()) for line in text.split("\n"))
            assert f"{count} {said}" in dataset.notes[0]

    told = fuzz.check(
        victoria_park_raw.load, tmp_path, files, 1000, 2, whole, ("drop_column", "empty")
    )
    assert min(told["refused"], told["loaded"]) > 100


# The published files ------------------------------------------------------------------------------


def test_the_published_set(recorded_data):
    dataset = recorded_data("victoria-park-raw")
    assert (
        "61763 rows of odometry, 948 fixes, 52974 tree observations in 7230 scans"
        in (dataset.notes[0])
    )
    assert dataset.poses == 7230 - 21
    assert len(dataset.observations) == 36600
    assert np.isfinite(dataset.truth[:, 0]).sum() > 800
    everything = recorded_data("victoria-park-raw", max_range=80, max_diameter=9)
    assert everything.observations.values[:, 0].max() <= 75.4
    assert dataset.observations.descriptor.max() <= 1.0


def test_the_first_ten_metres_tell_the_heading(recorded_data):
    dataset = recorded_data("victoria-park-raw")
    path = geo.integrate(dataset.prior.mean, dataset.robot.increments.deltas)
    known = np.flatnonzero(np.isfinite(dataset.truth[:, 0]))
    first = known[dataset.times[known] < 9]
    assert len(first) > 30
    assert np.hypot(*(path[first, :2] - dataset.truth[first, :2]).T).max() < 0.3


def test_the_antenna_is_where_the_laser_is(recorded_data):
    """Of points of the car, one near the laser has the path that fits the fixes best."""

    def misfit(reference):
        dataset = recorded_data("victoria-park-raw", reference=reference)
        path = geo.integrate(np.zeros(3), dataset.robot.increments.deltas)
        known = np.flatnonzero(np.isfinite(dataset.truth[:, 0]))
        gaps = np.flatnonzero(np.diff(dataset.times[known]) > 0.5) + 1
        left = []
        for part in np.split(known, gaps):
            for window in np.split(part, np.arange(35, len(part), 35)):
                if len(window) > 15:
                    a, b = path[window, :2], dataset.truth[window, :2]
                    left.append(np.hypot(*(geo.from_frame(geo.align(a, b), a) - b).T))
        return np.mean(np.minimum(np.concatenate(left), 0.5))

    here = misfit((3.78, 0.5))
    for other in ((1.8, 0.5), (5.8, 0.5), (3.78, -1.0), (3.78, 2.0), (0, 0)):
        assert misfit(other) > here


def test_filters_follow_it_to_the_end(recorded_data):
    """Against the GPS, in its own frame: the invariant filter keeps the heading of the start, the
    standard one loses it; dead reckoning is off by tens of metres."""
    dataset = recorded_data("victoria-park-raw")
    known = np.isfinite(dataset.truth[:, 0])
    truth = dataset.truth[known, :2]

    def errors(poses):
        mine = poses[known, :2]
        moved = geo.from_frame(geo.align(mine, truth), mine)
        return [np.sqrt(((xy - truth) ** 2).sum(axis=1).mean()) for xy in (mine, moved)]

    lost = errors(geo.integrate(dataset.prior.mean, dataset.robot.increments.deltas))
    waiting = {"association": "nearest", "confirm": 3, "within": 8}
    plain, invariant = (
        errors(ekfslam.estimate(dataset, name, **waiting).online.poses)
        for name in ("ekf", "ekf-ri")
    )
    assert lost[1] > 30
    assert max(plain[1], invariant[1]) < 2.5
    assert invariant[0] < 5 < plain[0] < 15
