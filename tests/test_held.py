"""What a filter of a user's own holds and returns: read, copied, and refused in plain words."""

from __future__ import annotations

import numpy as np
import pytest
from own_filters import Reckoning, State, known

from ekfslam.errors import InputError, UnsupportedError
from ekfslam.estimates import Decision, Innovations, LandmarkEstimates
from ekfslam.registry import resolve
from ekfslam.simulation import simulate

# What a filter holds ------------------------------------------------------------------------------


def test_a_state_becomes_trajectory_map_and_joint_covariance(rng):
    root = rng.normal(size=(7, 7))
    joint = root @ root.T
    subject = State(mean=np.arange(7.0), ids=[4, 2], covariance=joint)
    estimate = resolve(subject).estimate(known())
    np.testing.assert_array_equal(estimate.joint_covariance, joint)
    np.testing.assert_array_equal(estimate.online.covariances[1], joint[:3, :3])
    mapped = estimate.landmarks
    np.testing.assert_array_equal(mapped.ids, [4, 2])
    np.testing.assert_array_equal(mapped.positions, [[3, 4], [5, 6]])
    np.testing.assert_array_equal(mapped.covariances, [joint[3:5, 3:5], joint[5:, 5:]])
    np.testing.assert_array_equal(mapped.covariance, joint[3:, 3:])
    joint[:] = 0  # of the filter's, no longer of the estimate's
    assert estimate.joint_covariance.any()


def test_a_state_without_covariance_has_a_map_all_the_same():
    estimate = resolve(State).estimate(known())
    np.testing.assert_array_equal(estimate.landmarks.ids, [4])
    np.testing.assert_array_equal(estimate.landmarks.positions, [[2.0, 0.1]])
    assert estimate.landmarks.covariances is None
    assert estimate.joint_covariance is None


@pytest.mark.parametrize(
    "landmarks",
    [
        {4: [1, 2], 2: [3, 4]},
        LandmarkEstimates(np.array([4, 2]), np.array([[1.0, 2.0], [3.0, 4.0]])),
    ],
)
def test_landmarks_beside_a_pose(landmarks):
    subject = Reckoning()
    subject.landmarks, subject.pose_covariance = landmarks, 2 * np.eye(3)
    estimate = resolve(subject).estimate(known())
    np.testing.assert_array_equal(estimate.landmarks.ids, [4, 2])
    np.testing.assert_array_equal(estimate.landmarks.positions, [[1, 2], [3, 4]])
    np.testing.assert_array_equal(estimate.online.covariances, np.tile(2 * np.eye(3), (3, 1, 1)))
    subject.ids = [4, 2]  # a filter's own list; there is no mean whose points it names
    np.testing.assert_array_equal(resolve(subject).estimate(known()).landmarks.ids, [4, 2])
    subject.landmarks = {}
    assert len(resolve(subject).estimate(known()).landmarks) == 0


@pytest.mark.parametrize(
    ("held", "message"),
    [
        ({"mean": [0, 0]}, r"State.mean at step 0 must have shape \(3 \+ 2 n,\), .* got \(2,\)"),
        ({"mean": np.zeros((3, 1))}, r"State.mean at step 0 must have shape \(n,\), got \(3, 1\)"),
        ({"mean": [0, np.nan, 0]}, "State.mean at step 0 holds NaN or infinite values"),
        ({"mean": "wrong"}, "State.mean at step 0 cannot be read as numbers"),
        ({"mean": lambda: [0, 0, 0]}, "State.mean at step 0 cannot be read as numbers"),
        ({"mean": np.zeros(5), "ids": None}, "State has no attribute ids at step 2"),
        ({"mean": np.zeros(5), "ids": [1, 2]}, r"State.ids at step 2 must have shape \(1,\)"),
        ({"mean": np.zeros(5), "ids": [0.5]}, "State.ids at step 2 must hold whole numbers"),
        ({"mean": np.zeros(5), "ids": {4: 0}}, "State.ids at step 2 cannot be read as numbers"),
        ({"mean": np.zeros(7), "ids": [4, 4]}, "State.ids at step 2 lists landmark 4 twice"),
        ({"covariance": np.eye(2)}, r"State.covariance at step 0 must have shape \(3, 3\)"),
        ({"covariance": [[1]]}, r"State.covariance at step 0 must have shape \(3, 3\)"),
        (
            {"covariance": np.full((3, 3), np.inf)},
            "State.covariance at step 0 holds NaN or infinite",
        ),
        ({"mean": None, "pose": np.zeros(2)}, r"State.pose at step 0 must have shape \(3,\)"),
        (
            {"mean": None, "pose": np.zeros(3), "pose_covariance": 3},
            r"State.pose_covariance at step 0 must have shape \(3, 3\)",
        ),
        ({"nis": "much"}, "State.nis at step 0 must be a number"),
    ],
)
def test_what_a_filter_holds_must_be_what_is_expected(held, message):
    subject = State(**held)
    with pytest.raises(InputError, match=message) as caught:
        resolve(subject).estimate(known())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("landmarks", "message"),
    [
        ([[1, 2]], "Reckoning.landmarks at step 2 must be LandmarkEstimates, or positions .* list"),
        ({4: [1, 2, 3]}, r"positions in Reckoning.landmarks at step 2 must have shape \(1, 2\)"),
        ({4: [1, 2], 5: [1]}, "positions in Reckoning.landmarks at step 2"),
        ({4: [np.nan, 1]}, "positions in Reckoning.landmarks at step 2 holds NaN"),
        ({"tree": [1, 2]}, "identities in Reckoning.landmarks at step 2 cannot be read"),
        (
            LandmarkEstimates(np.array([4, 4]), np.zeros((2, 2))),
            "Reckoning.landmarks at step 2 lists landmark 4 twice",
        ),
    ],
)
def test_landmarks_must_be_what_is_expected(landmarks, message):
    subject = Reckoning()
    subject.landmarks = landmarks
    with pytest.raises(InputError, match=message):
        resolve(subject).estimate(known())


def test_a_filter_without_any_state():
    class Blank(Reckoning):
        pose = None

        def __init__(self):
            pass

        def predict(self, increment, covariance):
            pass

    with pytest.raises(InputError, match=r"Blank holds no state at step 0: it needs an attribute"):
        resolve(Blank).estimate(known())


def test_a_filter_that_does_not_start_at_the_prior_says_so():
    dataset = simulate("cloister", seed=2)
    estimate = resolve(Reckoning()).estimate(dataset)
    assert estimate.message.startswith("starts at (0, 0, 0), not at the dataset's prior (0, -2, 0)")


def test_linearizations_are_passed_on():
    dataset = known()
    linear = resolve("ekf").linearizations(dataset)[1]
    subject = Reckoning()
    with pytest.raises(UnsupportedError, match="needs an attribute linearizations of the filter"):
        resolve(subject).linearizations(dataset)
    for held in (linear, lambda: linear):
        subject.linearizations = held
        estimate, found = resolve(subject).linearizations(dataset)
        np.testing.assert_array_equal(found.motion_to, linear.motion_to)
        np.testing.assert_allclose(estimate.online.poses, linear.motion_to[0])
    subject.linearizations = {}
    with pytest.raises(InputError, match=r"Reckoning.linearizations must be Linear.*, got dict"):
        resolve(subject).linearizations(dataset)


# Innovations --------------------------------------------------------------------------------------


def told(count, **changes):
    columns = {
        "decision": np.full(count, Decision.ACCEPTED),
        "landmark": np.full(count, 4),
        "innovation": np.tile([1.0, 2.0], (count, 1)),
        "S": np.tile(np.diag([2.0, 4.0]), (count, 1, 1)),
    }
    return Innovations(**columns | changes)


class Telling(Reckoning):
    """Tells of every step what a test has written down for it."""

    def __init__(self, *answers):
        super().__init__()
        self.answers = list(answers)

    def observe(self, observations):
        return self.answers.pop(0)


def test_innovations_are_kept_and_add_up():
    dataset = known(step=[1, 1, 2], values=[[2.0, 0.1]] * 3, landmark=[4, 5, 4])
    refused = told(1, decision=[Decision.REJECTED], innovation=[[9.0, 9.0]])
    for nothing in (None, told(0)):
        estimate = resolve(Telling(nothing, told(2), refused)).estimate(dataset)
        np.testing.assert_array_equal(estimate.innovations.decision, [0, 0, Decision.REJECTED])
        np.testing.assert_array_equal(estimate.innovations.innovation[:, 0], [1, 1, 9])
        np.testing.assert_array_equal(estimate.step_nis, [np.nan, 3.0, np.nan])
        np.testing.assert_array_equal(estimate.step_dof, [0, 4, 0])


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        (
            (None, np.eye(2), None),
            "Telling.observe must return Innovations or nothing, got ndarray",
        ),
        (
            (None, told(2), None),
            r"decision that Telling.observe returned at step 1 must have shape",
        ),
        ((None, told(1, S=np.eye(2)), None), "S that Telling.observe returned at step 1 must have"),
        (
            (None, told(1, decision=[7]), None),
            "decision .* at step 1 holds a number of no Decision",
        ),
    ],
)
def test_innovations_must_be_what_is_expected(answers, message):
    with pytest.raises(InputError, match=message):
        resolve(Telling(*answers)).estimate(known())


def test_innovations_are_told_always_or_never():
    dataset = known(step=[1, 2], values=[[2.0, 0.1]] * 2, landmark=[4, 4])
    with pytest.raises(InputError, match="returned nothing at step 2, but Innovations at others"):
        resolve(Telling(None, told(1), None)).estimate(dataset)
