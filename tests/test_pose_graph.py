"""From records to a dataset: order of travel, frames of noise, and what a dataset cannot say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numerics import central_difference

from ekfslam import geometry as geo
from ekfslam.datasets.graph_parts import ROBOT, Edges, Graph, Seen, Vertices
from ekfslam.datasets.pose_graph import dataset_of
from ekfslam.errors import FileFormatError, InputError

PATH = Path("graph.txt")
FULL = np.array([[4e-4, 1e-4, 2e-5], [1e-4, 9e-4, -3e-5], [2e-5, -3e-5, 1e-4]])
MOVES = np.array([[1.0, 0.1, 0.8], [0.5, -0.2, -1.9], [0.7, 0.0, 3.0]])
POINTS = np.array([[3.0, 4.0], [1.0, -2.0], [2.0, 0.5]])


def motions(ends, values=None, covariances=FULL, first=1):
    """Motions between pairs of poses, one per line."""
    start, end = np.array(ends).T
    values = MOVES[: len(start)] if values is None else np.array(values, dtype=float)
    return Edges(np.arange(first, first + len(start)), start, end, values, covariances)


def sightings(ends, values=POINTS, kind="xy", covariances=None, first=11, **columns):
    start, end = np.array(ends).T
    values = np.array(values, dtype=float)[: len(start)]
    size = values.shape[1]
    spread = 0.01 * np.eye(size) if covariances is None else np.array(covariances)
    edges = Edges(np.arange(first, first + len(start)), start, end, values, spread, **columns)
    return Seen(kind, edges, name=kind)


CHAIN = motions([(0, 2), (2, 5), (5, 6)])
SEEN = sightings([(5, 9), (0, 7), (2, 9)])


def graph(**changes):
    return Graph(
        **{"path": PATH, "motions": CHAIN, "sightings": [SEEN], "frame": "first"} | changes
    )


def made(**changes):
    options = {name: changes.pop(name) for name in ("unsupported", "truth") if name in changes}
    return dataset_of(graph(**changes), "made", **options)


def refused(said, **changes):
    with pytest.raises(FileFormatError, match=said) as error:
        made(**changes)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith("graph.txt")


# Order and frames ---------------------------------------------------------------------------------


def test_poses_are_in_the_order_of_their_numbers_and_sightings_in_that_of_poses():
    data = made()
    np.testing.assert_array_equal(data.robot.controls, MOVES)
    np.testing.assert_array_equal(data.times, range(4))
    np.testing.assert_array_equal(data.observations.step, [0, 1, 2])
    np.testing.assert_array_equal(data.observations.landmark, [7, 9, 9])
    np.testing.assert_array_equal(data.observations.values, POINTS[[1, 2, 0]])
    np.testing.assert_array_equal(data.prior.covariance, 0)
    assert data.truth is None
    assert data.true_map is None
    assert data.notes[0] == "Read: 4 poses, 3 sightings of 2 landmarks."


def test_the_order_of_the_lines_does_not_matter(rng):
    data = made()
    for _ in range(5):
        a, b = rng.permutation(3), rng.permutation(3)
        mixed = made(
            motions=Edges(CHAIN.line, CHAIN.start[a], CHAIN.end[a], MOVES[a], FULL),
            sightings=[sightings(np.array([(5, 9), (0, 7), (2, 9)])[b], POINTS[b])],
        )
        np.testing.assert_array_equal(mixed.robot.controls, data.robot.controls)
        np.testing.assert_array_equal(mixed.observations.values, data.observations.values)


def test_equal_noise_is_that_of_the_model_and_other_noise_that_of_each_step():
    assert made().robot.covariance is None
    np.testing.assert_array_equal(made().robot.motion.covariance, FULL)
    many = FULL * np.array([1.0, 1.0, 2.0])[:, None, None]
    data = made(motions=CHAIN._replace(covariances=many))
    np.testing.assert_array_equal(data.robot.covariance, many)
    np.testing.assert_array_equal(data.robot.increments.covariances, many)
    hair = FULL * np.array([1.0, 1 + 1e-12, 1 - 1e-12])[:, None, None]
    assert made(motions=CHAIN._replace(covariances=hair)).robot.covariance is None


def test_noise_in_the_frame_of_the_second_pose_is_turned_into_that_of_the_first():
    data = made(frame="second")
    for move, found in zip(MOVES, data.robot.increments.covariances, strict=True):
        c, s = np.cos(move[2]), np.sin(move[2])
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        np.testing.assert_allclose(found, R @ FULL @ R.T, rtol=0, atol=1e-18)
        np.testing.assert_allclose(geo.additive_to_body(move, found), FULL, rtol=0, atol=1e-18)


@pytest.mark.parametrize("frame", ["first", "second"])
def test_a_motion_written_the_other_way_round_is_turned(frame):
    """Its noise goes through the derivative of the inverse."""
    one = made(motions=motions([(3, 4)], covariances=FULL), sightings=[sightings([(3, 1)])])
    at, back = MOVES[0], geo.inverse(MOVES[0])
    J = central_difference(geo.inverse, at)
    noise = J @ FULL @ J.T  # of the way back, in the frame of where it starts
    if frame == "second":
        noise = geo.additive_to_body(back, noise)
    two = made(
        motions=motions([(4, 3)], [back], covariances=noise),
        sightings=[sightings([(3, 1)])],
        frame=frame,
    )
    np.testing.assert_allclose(two.robot.controls, one.robot.controls, rtol=0, atol=1e-15)
    found, known = two.robot.increments.covariances, one.robot.increments.covariances
    np.testing.assert_allclose(found, known, rtol=0, atol=1e-12)


# Sensors ------------------------------------------------------------------------------------------


def test_each_kind_of_sighting_has_a_sensor():
    data = made(
        sightings=[
            SEEN,
            sightings([(2, 9), (5, 7)], [[2.0], [3.0]], "range"),
            sightings([(2, 9)], [[0.3]], "bearing", covariances=[[[0.04]]]),
        ]
    )
    assert [sensor.kind for sensor in data.sensors] == ["xy", "range", "bearing"]
    np.testing.assert_array_equal(data.observations.sensor, [0, 0, 1, 2, 0, 1])
    np.testing.assert_array_equal(data.observations.values[3], [0.3, 0])
    np.testing.assert_array_equal(data.sightings.covariance[3], [[0.04, 0], [0, 0]])
    np.testing.assert_array_equal(data.sightings.covariance[0], 0.01 * np.eye(2))


def test_a_landmark_seen_again_from_a_pose_is_seen_by_another_sensor():
    seen = sightings([(2, 9), (2, 9), (2, 7), (2, 9)], np.arange(8.0).reshape(4, 2))
    data = made(sightings=[seen, sightings([(2, 9)], [[4.0]], "range")])
    assert [sensor.kind for sensor in data.sensors] == ["xy", "xy", "xy", "range"]
    assert len({sensor.name for sensor in data.sensors}) == 4
    np.testing.assert_array_equal(data.observations.values[:, 0], [0, 4, 2, 6, 4])
    np.testing.assert_array_equal(data.observations.sensor, [0, 0, 1, 2, 3])


def test_bearings_are_wrapped():
    data = made(sightings=[sightings([(2, 9), (5, 9)], [[4.0], [-0.5]], "bearing")])
    np.testing.assert_allclose(data.observations.values[:, 0], [4 - 2 * np.pi, -0.5], atol=1e-15)


def test_times_are_used_if_they_are_there():
    poses = Vertices(np.arange(4) + 30, np.array([0, 2, 5, 6]), np.zeros((4, 3)))
    seen = sightings([(2, 9), (2, 9), (5, 9)], time=np.array([1.5, 1.2, 3.0]))
    for still in (poses, poses._replace(time=np.zeros(4))):
        data = made(sightings=[seen], poses=still)
        np.testing.assert_array_equal(data.times, range(4))
        assert data.observations.time is None
        assert len(data.sensors) == 2
    data = made(sightings=[seen], poses=poses._replace(time=np.array([0.0, 1.0, 3.0, 7.0])))
    assert len(data.sensors) == 1
    np.testing.assert_array_equal(data.times, [0, 1, 3, 7])
    np.testing.assert_array_equal(data.observations.time, [1.2, 1.5, 3.0])
    np.testing.assert_array_equal(data.observations.values, POINTS[[1, 0, 2]])
    late = poses._replace(time=np.array([0.0, 1.0, 0.5, 7.0]))
    refused("line 32: time 0.5 of pose 5 does not come after", poses=late)


# Where it starts ----------------------------------------------------------------------------------

PLACES = Vertices(
    np.arange(4) + 30,
    np.array([6, 5, 2, 0]),
    np.array([[6, 0, 0], [5, 0, 0], [2, 0, 0], [1, 2, 3.0]]),
)
TREES = Vertices(np.arange(2) + 50, np.array([9, 7]), np.array([[4.0, 5.0], [6.0, 7.0]]))


def ids(*numbers, first=70):
    return Vertices(np.arange(first, first + len(numbers)), np.array(numbers), np.zeros((0, 0)))


def prior(pose, covariance=FULL, line=60):
    one = np.array([pose])
    return Edges(np.array([line]), one, one, np.array([[1.5, 2.5, 0.5]]), covariance[None])


def test_the_first_pose_is_held_fixed_known_or_said_to_be_held():
    silent = made(poses=PLACES)
    np.testing.assert_array_equal(silent.prior.mean, [1, 2, 3])
    np.testing.assert_array_equal(silent.prior.covariance, 0)
    assert "does not say how well pose 0 is known" in silent.notes[1]
    fixed = made(poses=PLACES, fixed=ids(0))
    np.testing.assert_array_equal(fixed.prior.mean, [1, 2, 3])
    assert len(fixed.notes) == 1
    known = made(poses=PLACES, priors=prior(0))
    np.testing.assert_array_equal(known.prior.mean, [1.5, 2.5, 0.5])
    np.testing.assert_array_equal(known.prior.covariance, FULL)
    turned = made(poses=PLACES, priors=prior(0), frame="second")
    np.testing.assert_allclose(
        turned.prior.covariance, geo.body_to_additive([0, 0, 0.5], FULL), rtol=0, atol=1e-18
    )
    both = made(poses=PLACES, priors=prior(0), fixed=ids(0))
    np.testing.assert_array_equal(both.prior.mean, [1, 2, 3])
    np.testing.assert_array_equal(made().prior.mean, 0)


def test_values_are_the_truth_if_that_is_said():
    data = made(poses=PLACES, landmarks=TREES, truth=True)
    np.testing.assert_array_equal(data.truth, PLACES.values[::-1])
    np.testing.assert_array_equal(data.true_map.ids, [7, 9])
    np.testing.assert_array_equal(data.true_map.positions, [[6, 7], [4, 5]])
    assert made(poses=PLACES, landmarks=TREES).true_map is None


def test_landmarks_that_are_fixed_are_the_known_map():
    data = made(poses=PLACES, landmarks=TREES, fixed=ids(0, 9))
    np.testing.assert_array_equal(data.known_map.ids, [9])
    np.testing.assert_array_equal(data.known_map.positions, [[4, 5]])
    assert data.notes[-1] == "1 landmarks are fixed: they are the known map."


def test_robots_are_those_whose_start_is_known():
    """Two chains, numbered on, as our own export writes them."""
    two = motions([(0, 1), (1, 2), (4, 5), (5, 6)], np.concatenate([MOVES[:2], MOVES[:2]]))
    seen = sightings([(1, 9), (6, 9), (4, 7)])
    refused(r"line 3: the odometry chain breaks: .*pose 4", motions=two, sightings=[seen])
    data = made(motions=two, sightings=[seen], fixed=ids(4))
    assert len(data.robots) == 2
    np.testing.assert_array_equal(data.robots[1].controls, MOVES[:2])
    np.testing.assert_array_equal(data.observations.step, [0, 1, 2])
    np.testing.assert_array_equal(data.observations.robot, [1, 0, 1])
    known = made(motions=two, sightings=[seen], priors=prior(4))
    np.testing.assert_array_equal(known.robots[1].prior.covariance, FULL)
    three = motions([(0, 1), (4, 5), (5, 6)])
    refused("2 robots have 2, 3 poses", motions=three, sightings=[seen], fixed=ids(4))


def test_robots_may_be_told_apart_by_their_numbers():
    two = motions([(ROBOT, ROBOT + 1), (2 * ROBOT, 2 * ROBOT + 1), (ROBOT + 1, 2 * ROBOT)])
    seen = sightings([(2 * ROBOT, 9)])
    refused("a loop closure", motions=two, sightings=[seen])
    data = made(motions=two, sightings=[seen], unsupported="drop")
    assert len(data.robots) == 2
    assert "1 lines were left out, first line 3: a loop closure" in data.notes[-1]


# What a dataset cannot say ------------------------------------------------------------------------

LOOP = motions([(0, 2), (6, 0), (2, 5), (5, 6)], MOVES[[0, 0, 1, 2]])


@pytest.mark.parametrize(
    ("said", "changes"),
    [
        ("line 2: a loop closure, a motion between pose 6 and pose 0", {"motions": LOOP}),
        ("line 60: a prior of pose 5", {"priors": prior(5)}),
        ("line 71: pose 2 is fixed", {"fixed": ids(0, 2)}),
        ("line 90: a thing", {"beyond": [(91, "a thing"), (90, "a thing")]}),
    ],
)
def test_what_has_no_place_is_refused_or_counted(said, changes):
    refused(f"{said}; a dataset has no place", **changes)
    data = made(**changes, unsupported="drop")
    np.testing.assert_array_equal(data.robot.controls, MOVES)
    assert said in data.notes[-1]
    assert data.notes[-1].startswith(f"{len(changes.get('beyond', [1]))} lines were left out")
    with pytest.raises(InputError, match="unsupported must be 'refuse' or 'drop'"):
        made(unsupported="keep")


@pytest.mark.parametrize(
    ("said", "changes"),
    [
        ("graph.txt: holds no odometry", {"motions": motions(np.zeros((0, 2), int), [])}),
        ("line 2: the odometry chain breaks", {"motions": motions([(0, 2), (5, 6)])}),
        (
            "line 3: a second motion between pose 2 and pose 0",
            {"motions": motions([(0, 2), (2, 5), (2, 0)])},
        ),
        ("line 1: a turn of 90 is none in radians", {"motions": motions([(0, 2)], [[1, 0, 90]])}),
        (
            "line 2: the heading's standard deviation is 10 rad",
            {"motions": CHAIN._replace(covariances=np.array([FULL, 1e6 * FULL, FULL]))},
        ),
        ("line 12: landmark 9 is seen from pose 3", {"sightings": [sightings([(0, 9), (3, 9)])]}),
        (
            "line 12: landmark 9 is seen twice from pose 0, with the same values",
            {"sightings": [sightings([(0, 9), (0, 9)], POINTS[[1, 1]])]},
        ),
        ("line 11: a negative range", {"sightings": [sightings([(0, 9)], [[-1.0]], "range")]}),
        (
            "line 11: a bearing of 30 is none",
            {"sightings": [sightings([(0, 9)], [[2.0, 30.0]], "range-bearing")]},
        ),
        ("line 1: of pose 0 or pose 2 there is no vertex", {"poses": ids(2, 5, 6)}),
        ("line 74: pose 8 has no odometry", {"poses": ids(0, 2, 5, 6, 8)}),
        ("line 11: of landmark 9 there is no vertex", {"landmarks": ids(7)}),
        ("line 70: there is no 4 to fix", {"fixed": ids(4)}),
    ],
)
def test_what_does_not_hang_together_is_named(said, changes):
    refused(said, **changes)
