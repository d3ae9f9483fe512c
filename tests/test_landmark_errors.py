"""Which estimated landmark is held against which true one."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, LandmarkMap, Observations, Robot
from ekfslam.errors import InputError
from ekfslam.estimates import Estimate, LandmarkEstimates
from ekfslam.evaluation import match_landmarks
from ekfslam.evaluation.landmarks import common_landmarks, map_ids, true_positions
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

IDS = [5, 1, 3, 7]
POSITIONS = np.array([[5.0, 50.0], [1.0, 10.0], [3.0, 30.0], [7.0, 70.0]])


def dataset_of(origin, landmark=None, **changes):
    """A robot that stands and sees landmarks 1, 3, 5 and 7 at (id, 10 id)."""
    count = len(origin)
    robot = Robot(MotionModel("odometry", covariance=np.eye(3)), np.zeros((count, 3)))
    data = Dataset(
        "stand",
        (robot,),
        np.arange(count + 1.0),
        (Sensor("xy", np.eye(2)),),
        Observations(np.arange(count), np.zeros((count, 2)), landmark),
        true_map=LandmarkMap(IDS, POSITIONS),
        true_landmark=origin,
    )
    return replace(data, **changes)


def estimate_of(positions, association="nearest", ids=None):
    positions = np.asarray(positions, dtype=float).reshape(-1, 2)
    ids = np.arange(len(positions)) if ids is None else np.array(ids)
    return Estimate("filter", "stand", association, landmarks=LandmarkEstimates(ids, positions))


def known(ids):
    """A map a kilometre off, with identities of the dataset's own."""
    return estimate_of(np.full((len(ids), 2), 1e3), "known", ids)


def matched(data, estimate, *arguments):
    return match_landmarks(data, estimate, *arguments).tolist()


# Known association -----------------------------------------------------------------------------


def test_known_identities_match_themselves_at_any_distance():
    data = dataset_of([1, 1, 3, 5], landmark=[1, 1, 3, 5])
    assert matched(data, known([5, 1, 9])) == [5, 1, -1]


def test_known_identities_match_without_any_truth():
    data = dataset_of([1, 1, 3, 5], landmark=[1, 1, 3, 5], true_map=None, true_landmark=None)
    assert matched(data, known([5, 1, 9])) == [5, 1, -1]


def test_a_landmark_of_the_map_that_was_never_seen_matches_itself():
    assert matched(dataset_of([1, 1], landmark=[1, 1]), known([1, 7])) == [1, 7]


def test_an_estimate_that_states_no_association_follows_the_dataset():
    estimate = replace(known([3]), association="")
    assert matched(dataset_of([1, 3], landmark=[1, 3]), estimate) == [3]
    assert matched(dataset_of([1, 3]), estimate) == [-1]
    assert matched(dataset_of([1, 3]), replace(estimate_of([3.1, 30.1]), association="")) == [3]


def test_identities_of_the_estimate_are_no_identities_of_the_dataset():
    # The dataset knows who is who, but the estimate was asked to find out itself.
    data = dataset_of([3, 1], landmark=[3, 1])
    assert matched(data, estimate_of([[3, 30], [1, 10]], ids=[1, 3])) == [3, 1]


# Assignment ------------------------------------------------------------------------------------


def cost_of(points, truth, radius):
    """Least cost of any assignment, by trying them all."""
    count, least = len(points), np.inf
    # As many places to be alone in as there are points.
    for places in permutations(range(len(truth) + count), count):
        cost = 0.0
        for point, place in zip(points, places, strict=True):
            apart = np.sum((point - truth[place]) ** 2) if place < len(truth) else np.inf
            cost += min(apart, radius**2)
        least = min(least, cost)
    return least


@pytest.mark.parametrize("radius", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("count", [1, 3, 4])
def test_the_assignment_costs_least_of_all(rng, radius, count):
    for _ in range(20):
        truth = rng.uniform(0, 3, (3, 2))
        points = rng.uniform(0, 3, (count, 2))
        data = dataset_of([10, 11, 12], true_map=LandmarkMap([10, 11, 12], truth))
        match = match_landmarks(data, estimate_of(points), radius)
        pairs = match >= 0
        apart = np.linalg.norm(points[pairs] - truth[match[pairs] - 10], axis=1)
        assert (apart < radius).all()
        assert len(set(match[pairs].tolist())) == pairs.sum()
        cost = np.sum(apart**2) + (~pairs).sum() * radius**2
        assert cost == pytest.approx(cost_of(points, truth, radius), rel=1e-12)


def test_the_nearest_is_not_taken_from_another_that_needs_it():
    """Both are nearest to landmark 1, but only one of them is within reach of landmark 3."""
    data = dataset_of([1, 3], true_map=LandmarkMap([1, 3], [[0, 0], [1, 0]]))
    assert matched(data, estimate_of([[0.4, 0.0], [-0.5, 0.0]])) == [3, 1]


def test_a_true_landmark_has_one_estimate_and_the_others_stand_alone():
    data = dataset_of([1, 3])
    assert matched(data, estimate_of([[1.2, 10], [1.1, 10], [3, 30], [2, 20]])) == [-1, 1, 3, -1]


@pytest.mark.parametrize(("radius", "found"), [(0.49, -1), (0.51, 3)])
def test_no_pair_is_farther_apart_than_the_radius(radius, found):
    assert matched(dataset_of([3]), estimate_of([3.3, 30.4]), radius) == [found]
    default = matched(dataset_of([3, 1]), estimate_of([[3.0, 30.99], [1.0, 11.01]]))
    assert default == [3, -1]


def test_positions_are_moved_before_they_are_held_against_the_truth():
    motion = [4.0, -2.0, 1.0]
    away = geo.to_frame(np.array(motion), POSITIONS)
    data = dataset_of([1, 3, 5, 7])
    assert matched(data, estimate_of(away)) == [-1] * 4
    assert matched(data, estimate_of(away), 1.0, motion) == IDS


def test_landmarks_that_were_never_observed_take_no_part():
    everything = estimate_of(POSITIONS)
    assert matched(dataset_of([1, 3, -1]), everything) == [-1, 1, 3, -1]
    # Beacons of a recorded set: who was seen is not known, so it may have been any of them.
    assert matched(dataset_of([1, 3], true_landmark=None), everything) == IDS


def test_without_a_true_map_nothing_is_matched():
    assert matched(dataset_of([1, 3], true_map=None), estimate_of(POSITIONS)) == [-1] * 4


def test_an_empty_map_and_no_map_match_nothing():
    assert matched(dataset_of([1]), estimate_of([])) == []
    assert matched(dataset_of([1]), Estimate("dead-reckoning", "stand")) == []
    assert matched(dataset_of([-1]), estimate_of([[1, 10]])) == [-1]  # nothing was observed


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_a_landmark_gone_wrong_stands_alone(bad):
    points = [[bad, 10.0], [3.0, 30.0], [5.0, bad]]
    assert matched(dataset_of([1, 3, 5]), estimate_of(points)) == [-1, 3, -1]


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf, "1"])
def test_a_radius_that_is_no_length_is_refused(radius):
    for estimate in (estimate_of([1, 10]), known([1]), Estimate("dead-reckoning", "stand")):
        with pytest.raises(InputError, match="match_radius"):
            match_landmarks(dataset_of([1], landmark=[1]), estimate, radius)


# Look-ups --------------------------------------------------------------------------------------


def test_true_positions_are_looked_up_by_identity():
    data = dataset_of([1])
    found = true_positions(data, [3, -1, 1, -1, 8])
    np.testing.assert_array_equal(found[[0, 2]], [[3, 30], [1, 10]])
    assert np.isnan(found[[1, 3, 4]]).all()
    assert np.isnan(true_positions(replace(data, true_map=None), [3])).all()


def test_common_landmarks_are_paired_by_identity():
    first = LandmarkEstimates(np.array([4, 9, 2]), np.zeros((3, 2)))
    second = LandmarkEstimates(np.array([2, 4, 5]), np.zeros((3, 2)))
    rows, others = common_landmarks(first, second)
    assert first.ids[rows].tolist() == second.ids[others].tolist() == [2, 4]


def test_a_map_holds_points_and_landmarks_of_open_distance():
    points = LandmarkEstimates(np.array([4, 9]), np.zeros((2, 2)))
    assert map_ids(points).tolist() == [4, 9]
    opened = replace(points, undetermined=np.array([7]), inverse_depth=np.zeros((1, 4)))
    assert map_ids(opened).tolist() == [4, 9, 7]
