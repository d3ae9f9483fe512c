"""Which estimated landmark is which true one, and the counts of missed and spurious ones."""

from dataclasses import replace

import numpy as np
import pytest

from ekfslam.dataset import Dataset, LandmarkMap, Observations, Robot
from ekfslam.estimates import Decision, Estimate, Innovations, LandmarkEstimates
from ekfslam.evaluation import match_landmarks
from ekfslam.evaluation.landmarks import common_landmarks, true_positions
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

ACCEPTED, NEW = Decision.ACCEPTED, Decision.NEW


def dataset_of(origin, landmark=None, **changes):
    """A robot that stands and sees landmarks; landmark 7 is in the map but never seen."""
    count = len(origin)
    robot = Robot(MotionModel("odometry", covariance=np.eye(3)), np.zeros((count, 3)))
    data = Dataset(
        "stand",
        (robot,),
        np.arange(count + 1.0),
        (Sensor("xy", np.eye(2)),),
        Observations(np.arange(count), np.zeros((count, 2)), landmark),
        true_map=LandmarkMap([5, 1, 3, 7], [[5, 50], [1, 10], [3, 30], [7, 70]]),
        true_landmark=origin,
    )
    return replace(data, **changes)


def estimate_of(ids, taken_for=None, decision=None, association="nearest"):
    innovations = None
    if taken_for is not None:
        count = len(taken_for)
        decision = [ACCEPTED] * count if decision is None else decision
        innovations = Innovations(
            np.array(decision),
            np.array(taken_for),
            np.full((count, 2), np.nan),
            np.full((count, 2, 2), np.nan),
        )
    landmarks = LandmarkEstimates(np.array(ids, dtype=int), np.zeros((len(ids), 2)))
    return Estimate("filter", "stand", association, landmarks=landmarks, innovations=innovations)


def counts(match):
    return match.true, match.missed, match.spurious


def test_known_identities_match_themselves():
    data = dataset_of([1, 1, 3, 5], landmark=[1, 1, 3, 5])
    match = match_landmarks(data, estimate_of([5, 1, 9], association="known"))
    assert match.true_landmark.tolist() == [5, 1, -1]
    assert counts(match) == (3, 1, 1)


def test_known_identities_count_without_any_truth():
    data = dataset_of([1, 1, 3, 5], landmark=[1, 1, 3, 5], true_map=None, true_landmark=None)
    match = match_landmarks(data, estimate_of([5, 1], association="known"))
    assert match.true_landmark.tolist() == [5, 1]
    assert counts(match) == (3, 1, 0)


def test_a_landmark_of_the_map_that_was_never_seen_is_not_spurious():
    data = dataset_of([1, 1], landmark=[1, 1])
    match = match_landmarks(data, estimate_of([1, 7], association="known"))
    assert match.true_landmark.tolist() == [1, 7]
    assert counts(match) == (1, 0, 0)


def test_an_estimate_that_states_no_association_follows_the_dataset():
    known = dataset_of([1, 3], landmark=[1, 3])
    assert match_landmarks(known, estimate_of([3], association="")).true_landmark.tolist() == [3]
    unknown = dataset_of([1, 3])
    match = match_landmarks(unknown, estimate_of([3], [3, -1], association=""))
    assert match.true_landmark.tolist() == [1]


def test_own_identities_are_matched_by_the_majority_of_sightings():
    data = dataset_of([3, 3, 1, 1, 1, 5])
    match = match_landmarks(data, estimate_of([0, 1], [0, 0, 0, 1, 1, 1]))
    assert match.true_landmark.tolist() == [3, 1]
    assert counts(match) == (3, 1, 0)


def test_identities_of_the_estimate_are_no_identities_of_the_dataset():
    # The dataset knows who is who, but the estimate was asked to find out itself.
    data = dataset_of([3, 1], landmark=[3, 1])
    assert match_landmarks(data, estimate_of([1, 3], [1, 3])).true_landmark.tolist() == [3, 1]


def test_of_equally_many_sightings_the_lowest_identity_wins():
    data = dataset_of([5, 3, 3, 5])
    assert match_landmarks(data, estimate_of([0], [0, 0, 0, 0])).true_landmark.tolist() == [3]


@pytest.mark.parametrize(("origin", "true"), [([-1, 3], 3), ([-1, -1, 3], -1)])
def test_clutter_wins_only_as_a_majority(origin, true):
    match = match_landmarks(dataset_of(origin), estimate_of([0], [0] * len(origin)))
    assert match.true_landmark.tolist() == [true]


def test_one_true_landmark_has_one_estimate_and_the_others_are_spurious():
    data = dataset_of([1, 1, 1, 1, 1, 3])
    match = match_landmarks(data, estimate_of([0, 4, 2, 9], [4, 0, 4, 0, 4, 2]))
    assert match.true_landmark.tolist() == [-1, 1, 3, -1]  # 9 was never sighted
    assert counts(match) == (2, 0, 2)
    even = match_landmarks(dataset_of([1, 1, 1, 1]), estimate_of([4, 2], [4, 4, 2, 2]))
    assert even.true_landmark.tolist() == [-1, 1]


def test_a_claim_is_weighed_by_sightings_of_the_landmark_claimed():
    # Landmark 0 has four sightings, two of them of 1; landmark 2 has three, all of 1.
    data = dataset_of([1, 1, 3, 5, 1, 1, 1])
    match = match_landmarks(data, estimate_of([0, 2], [0, 0, 0, 0, 2, 2, 2]))
    assert match.true_landmark.tolist() == [-1, 1]


def test_only_observations_that_were_used_speak():
    data = dataset_of([1, 3, 3, 3])
    decision = [NEW, Decision.REJECTED, Decision.AMBIGUOUS, ACCEPTED]
    match = match_landmarks(data, estimate_of([0, 1], [0, 0, 0, 6], decision))
    assert match.true_landmark.tolist() == [1, -1]  # 6 is not in the final map


def test_a_landmark_that_left_the_map_claims_nothing():
    data = dataset_of([1, 1, 1])
    match = match_landmarks(data, estimate_of([0], [6, 6, 0]))
    assert match.true_landmark.tolist() == [1]
    assert counts(match) == (1, 0, 0)


def test_without_the_origin_of_the_observations_nothing_is_matched():
    data = dataset_of([1, 3], true_landmark=None)
    match = match_landmarks(data, estimate_of([0, 1], [0, 1]))
    assert match.true_landmark.tolist() == [-1, -1]
    assert counts(match) == (None, None, None)


def test_without_assignments_or_map_only_the_true_ones_are_counted():
    data = dataset_of([1, 3])
    assert counts(match_landmarks(data, estimate_of([0, 1]))) == (2, None, None)
    no_map = Estimate("dead-reckoning", "stand")
    assert counts(match_landmarks(data, no_map)) == (2, None, None)


def test_an_empty_map_misses_everything():
    data = dataset_of([1, 3, -1])
    for association in ("known", "nearest"):
        match = match_landmarks(data, estimate_of([], [-1, -1, -1], association=association))
        assert counts(match) == (2, 2, 0)


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
