"""DLR's discs on the floor: a reflected frame, compressed ranges, and ids by hand."""

from __future__ import annotations

import fuzz
import numpy as np
import pytest
from numpy.testing import assert_allclose

import ekfslam
from ekfslam import geometry as geo
from ekfslam.datasets import dlr
from ekfslam.errors import FileFormatError, InputError

SMALL = """# comment
#  STEP <image.ppm> <dX> ...
\x20
STEP image.0000  0.01 -0.15 0.02 1.6e-5 -2e-6 1.4e-5 2.1e-5 -4e-6 2.6e-4
LANDMARK_C -0.25 -3.0 0.93 0.0017 0.0002 0.0038 6
LANDMARK_C 0.4 -2.0 0.82 0.0017 -0.0002 0.0036 -1
LANDMARK_C 0.5 -1.5 0.82 0.0017 -0.0002 0.0036 -1
STEP image.0001 0 0 0 0 0 0 0 0 0
STEP image.0002 -0.02 0.01 -0.3 1e-5 0 1e-5 0 0 1e-4
LANDMARK_C 0.5 -1.5 0.66 0.0017 -0.0003 0.0036 20001
"""
AS_IT_IS = {"odometry_scale": 1.0, "range_line": (0.0, 1.0)}


@pytest.fixture
def write(tmp_path):
    """Writes the file, and returns its path."""

    def written(text=SMALL):
        (tmp_path / "map.circles").write_text(text, newline="")
        return tmp_path / "map.circles"

    return written


def test_the_file_is_read_in_our_frame(write):
    """X is right, Y is back, and dPhi turns X to Y: clockwise from above."""
    dataset = ekfslam.load("dlr", write(), noise="file", **AS_IT_IS)
    o = dataset.observations
    assert dataset.times.tolist() == [0, 1, 2, 3]
    assert_allclose(
        dataset.robot.controls, [[0.15, -0.01, -0.02], [0, 0, 0], [-0.01, 0.02, 0.3]], atol=1e-15
    )
    assert o.step.tolist() == [1, 3]
    assert o.landmark.tolist() == [6, 20001]
    assert_allclose(o.values, [[3.0, 0.25], [1.5, -0.5]])
    assert_allclose(o.covariance[0], [[0.0038, 0.0002], [0.0002, 0.0017]])
    # Two of three signs change: what is of two of them keeps its sign.
    assert_allclose(
        dataset.robot.increments.covariances[0],
        [[1.4e-5, -2e-6, -4e-6 * -1 * -1], [-2e-6, 1.6e-5, 2.1e-5], [-4e-6, 2.1e-5, 2.6e-4]],
    )
    assert [s.kind for s in dataset.sensors] == ["xy"]
    assert not dataset.prior.covariance.any()
    assert dataset.truth is None
    assert "3 steps, 4 sightings of 2 landmarks; 2 of them spurious, left out" in dataset.notes[0]


def test_spurious_sightings_can_be_kept_as_clutter(write):
    dataset = dlr.load(write(), spurious="keep")
    assert dataset.observations.landmark.tolist() == [6, -1, -1, 20001]
    assert dataset.true_landmark.tolist() == [6, -1, -1, 20001]
    assert len(ekfslam.estimate(dataset, "ekf(association=known)").landmarks.ids) == 2
    assert dataset.without_identities().true_landmark.tolist() == [6, -1, -1, 20001]


LINE = (0.16, 0.92)


def drive(rng, steps=40, scale=0.97):
    """A file of a drive without noise, with its true poses and discs."""
    discs = {7: (2.0, 1.0), 400: (4.0, -1.0), 23001: (6.0, 2.0)}
    moves = np.column_stack([rng.uniform(0.1, 0.2, steps), *rng.normal(0, 0.05, (2, steps))])
    path, lines = geo.integrate(np.zeros(3), moves), []
    for k, (x, y, turn) in enumerate(moves.tolist()):
        lines.append(f"STEP i.{k:04d} {-y / scale!r} {-x / scale!r} {-turn!r} 1 0 1 0 0 1")
        for name, point in discs.items():
            local = geo.to_frame(path[k + 1], point)
            distance = np.hypot(*local)
            ahead, left = (local * (LINE[0] + LINE[1] * distance) / distance).tolist()
            lines.append(f"LANDMARK_C {-left!r} {-ahead!r} 0.9 1 0 1 {name}")
    return "\r\n".join(lines), path, discs


def test_a_drive_without_noise_gives_path_and_discs_back(write, rng):
    text, path, discs = drive(rng)
    dataset = dlr.load(write(text), odometry_scale=0.97, range_line=LINE)
    found = geo.integrate(dataset.prior.mean, dataset.robot.increments.deltas)
    assert_allclose(geo.additive_error(path, found), 0, atol=1e-12)
    o = dataset.observations
    points, _, _ = dataset.sensors[0].locate(path[o.step], o.values)
    assert_allclose(points, [discs[name] for name in o.landmark.tolist()], atol=1e-12)
    estimate = ekfslam.estimate(dataset, "ekf")
    assert_allclose(geo.additive_error(path, estimate.online.poses), 0, atol=1e-9)


def test_covariances_of_the_file_follow_the_correction_of_range_and_scale(write):
    plain = dlr.load(write(), noise="file", **AS_IT_IS)
    other = dlr.load(write(), noise="file", odometry_scale=0.5, range_line=LINE)

    def corrected(point):
        distance = np.hypot(*point)
        return point * (distance - LINE[0]) / LINE[1] / distance

    h = 1e-6
    for k, point in enumerate(plain.observations.values):
        J = np.column_stack(
            [(corrected(point + d) - corrected(point - d)) / (2 * h) for d in h * np.eye(2)]
        )
        expected = J @ plain.observations.covariance[k] @ J.T
        assert_allclose(other.observations.covariance[k], expected, rtol=1e-6)
        assert_allclose(other.observations.values[k], corrected(point))
    half = np.array([0.5, 0.5, 1.0])
    expected = plain.robot.increments.covariances * np.outer(half, half)
    assert_allclose(other.robot.increments.covariances, expected)


def test_the_default_noise_lies_along_the_line_of_sight(write, rng):
    """Against draws of range and bearing, whose noise is small."""
    dataset = dlr.load(write(), sensor_sigmas=(0.003, 0.002), odometry_sigmas=(0.1, 0.2, 0.3))
    assert_allclose(dataset.robot.motion.covariance, np.diag([0.01, 0.04, 0.09]))
    for point, covariance in zip(
        dataset.observations.values, dataset.observations.covariance, strict=True
    ):
        distance = np.hypot(*point) + 0.003 * rng.normal(size=40_000)
        bearing = np.arctan2(point[1], point[0]) + 0.002 * rng.normal(size=40_000)
        drawn = np.cov([distance * np.cos(bearing), distance * np.sin(bearing)])
        scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
        assert (np.abs(drawn - covariance) < 5 * np.sqrt(2 / 40_000) * scale).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"noise": "mine"}, "noise must be 'default' or 'file', got 'mine'"),
        ({"spurious": True}, "spurious must be 'drop' or 'keep'"),
        ({"odometry_scale": 0}, "odometry_scale must be positive"),
        ({"range_line": (0.1,)}, "range_line"),
        ({"range_line": (0.1, -1)}, "slope of range_line must be positive"),
        ({"range_line": (np.nan, 1)}, "range_line must be 2 finite numbers"),
        ({"odometry_sigmas": (0.1, 0.1)}, "odometry_sigmas"),
        ({"sensor_sigmas": (0.1, -0.1)}, "sensor_sigmas must be standard deviations"),
    ],
)
def test_options_that_make_no_sense(write, options, said):
    with pytest.raises(InputError, match=said):
        dlr.load(write(), **options)


STEP = "STEP image.0003 0 -0.1 0 1 0 1 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# a comment\n", "holds no STEP"),
        ("LANDMARK_C 1 -1 0.9 1 0 1 6\n" + SMALL, "line 1: LANDMARK_C before any STEP"),
        (SMALL + "LANDMARK_C 1 -1 0.9 1 0 1 6 7\n", "line 11: LANDMARK_C has several ids"),
        (SMALL + "LANDMARK_C 1 -1 0.9 1 0 1\n", "line 11: 7 numbers of LANDMARK_C .*are 6"),
        (SMALL + "LANDMARK_C 1 -1 0.9 1 0 1 -2\n", "line 11: the id is not a number from -1 on"),
        (SMALL + "LANDMARK_C 1 -1 0.9 1 0 1 2.5\n", "line 11: the id is no whole number"),
        (SMALL + "LANDMARK_C 1 -1 1.9 1 0 1 2\n", "line 11: quality is not between"),
        (SMALL + "LANDMARK_C 1 -1 0.9 1 2 1 2\n", "line 11: the covariance is not positive"),
        (SMALL + "LANDMARK_C 0 -0.1 0.9 1 0 1 2\n", "line 11: nearer than the offset"),
        (SMALL + "LANDMARK_C 1 -1000 0.9 1 0 1 2\n", "line 11: are pX and pY in metres"),
        (SMALL + "LANDMARK_C 1 -1 0.9 1 0 1 20001\n", "line 11: the id is seen twice"),
        (SMALL + STEP.replace("3", "4"), "line 11: image 4 comes after image 2"),
        (SMALL + STEP.replace(" 1\n", "\n"), "line 11: 9 numbers of STEP .*are 8"),
        (SMALL + STEP.replace("-0.1", "many"), "line 11: dY of STEP is no number"),
        (SMALL + STEP.replace("-0.1", "-150"), "line 11: are dX and dY in metres"),
        (SMALL + STEP.replace("-0.1 0 ", "-0.1 30 "), "line 11: is dPhi in radians"),
        (SMALL + STEP.replace("1 0 1 0 0 1", "1 0 -1 0 0 1"), "line 11: the covariance is not"),
        (SMALL + "STEP\n", "line 11: 9 numbers of STEP .*are 0"),
        (SMALL + "LANDMARK 1\n", "line 11: unknown record 'LANDMARK'"),
    ],
)
def test_a_damaged_file_is_named(write, text, said):
    path = write(text)
    with pytest.raises(FileFormatError, match=said) as error:
        dlr.load(path)
    assert str(path) in str(error.value)


def test_a_drive_without_sightings_and_images_without_numbers(write):
    dataset = dlr.load(write("STEP a 0 -1 0 1 0 1 0 0 1\nSTEP a 0 -1 0 1 0 1 0 0 1\n"))
    assert dataset.poses == 3
    assert len(dataset.observations) == 0


def test_damage_is_told_or_loads_whole(tmp_path):
    def whole(dataset, files):
        text = files["map.circles"].decode("utf-8-sig").replace("\r", "\n")
        lines = [line.split("#")[0].split() for line in text.split("\n")]
        assert dataset.poses == 1 + sum(words[:1] == ["STEP"] for words in lines)
        sightings = sum(words[:1] == ["LANDMARK_C"] for words in lines)
        assert len(dataset.observations) == sightings

    def load(folder):
        return dlr.load(folder, spurious="keep")

    files = {"map.circles": SMALL.encode()}
    told = fuzz.check(load, tmp_path, files, 1000, 5, whole, ("empty",))
    assert min(told["refused"], told["loaded"]) > 100


def test_a_lost_step_shows_in_the_numbers_of_the_images(write):
    lines = [line for line in SMALL.splitlines() if "image.0001" not in line]
    with pytest.raises(FileFormatError, match="line 8: image 2 comes after image 0"):
        dlr.load(write("\n".join(lines)))


# The published file -------------------------------------------------------------------------------


def test_the_published_set(recorded_data):
    dataset = recorded_data("dlr", spurious="keep")
    assert dataset.poses == 3298
    assert len(dataset.observations) == 14745
    clutter = dataset.observations.landmark < 0
    assert clutter.sum() == 436
    assert len(np.unique(dataset.observations.landmark[~clutter])) == 576
    assert dataset.observations.landmark.max() == 23001
    assert len(recorded_data("dlr").observations) == 14745 - 436


def test_sightings_of_neighbouring_poses_agree_in_our_frame_alone(recorded_data):
    """Their headings turn from X to Y: with the other sign, or without the reflection of one of the
    two, a disc that is seen twice is in two places."""
    dataset = recorded_data("dlr", **AS_IT_IS)
    o, moves = dataset.observations, dataset.robot.controls

    def gap(moves, points):
        seen = {key: k for k, key in enumerate(zip(o.step, o.landmark, strict=True))}
        pairs = [(seen[s - 1, i], k) for (s, i), k in seen.items() if (s - 1, i) in seen]
        before, after = np.array(pairs).T
        back = geo.from_frame(moves[o.step[after] - 1], points[after])
        return np.median(np.hypot(*(back - points[before]).T))

    assert gap(moves, o.values) < 0.03
    assert gap(moves * [1, 1, -1], o.values) > 0.1
    assert gap(moves, o.values * [1, -1]) > 0.1


def test_ranges_are_compressed_as_stated(recorded_data):
    """Of a disc seen from afar and from near, the odometry in between tells how far it came."""
    plain, right = recorded_data("dlr", **AS_IT_IS), recorded_data("dlr")

    def slope(dataset):
        o, path = dataset.observations, geo.integrate(np.zeros(3), dataset.robot.controls)
        came, shorter = [], []
        for disc in np.unique(o.landmark):
            rows = np.flatnonzero(o.landmark == disc)
            for first, last in zip(rows[:-6], rows[6:], strict=True):
                if o.step[last] - o.step[first] == 6:
                    there = geo.from_frame(path[o.step[last]], o.values[last])
                    back = geo.to_frame(path[o.step[first]], there)
                    came.append(np.hypot(*back) - np.hypot(*o.values[last]))
                    shorter.append(np.hypot(*o.values[first]) - np.hypot(*o.values[last]))
        came, shorter = np.array(came), np.array(shorter)
        return np.median((shorter / came)[came > 0.5])

    assert slope(plain) < 0.93
    assert abs(slope(right) - 1) < 0.03


def test_all_estimators_close_its_loops(recorded_data):
    dataset = recorded_data("dlr")
    poses = {name: ekfslam.estimate(dataset, name).online.poses[-1] for name in ("ekf", "ekf-ri")}
    lost = geo.integrate(np.zeros(3), dataset.robot.controls)[-1]
    assert np.hypot(*(poses["ekf"] - poses["ekf-ri"])[:2]) < 0.1
    assert np.hypot(*(lost - poses["ekf"])[:2]) > 5
