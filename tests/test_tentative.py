"""Tentative landmarks: seen often enough in time, or never known of."""

from __future__ import annotations

import numpy as np
import pytest

from ekfslam import EkfSlam
from ekfslam import geometry as geo
from ekfslam.dataset import Prior, Sightings
from ekfslam.estimates import Decision
from ekfslam.evaluation import association_scores, count_landmarks
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.engine import TENTATIVES
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import simulate

PRIOR = Prior([1.0, -2.0, 0.5], np.diag([0.01, 0.02, 0.001]))
SENSOR = Sensor("range-bearing", np.diag([0.01, 0.0004]), mount=[0.3, 0.1, 0.4])
XY = Sensor("xy", np.diag([0.01, 0.01]))
NEW, TENTATIVE, ACCEPTED = (int(Decision[n]) for n in ("NEW", "TENTATIVE", "ACCEPTED"))
STILL = np.zeros(3), np.zeros((3, 3))
EACH = ("nearest", "maximum-likelihood", "smallest-distance", "euclidean", "global", "joint")


def decisions(seen, confirm, within, sensor=XY, prior=None, **options):
    """What is made of a thing that stands still, at each step in which it is seen."""
    slam = EkfSlam(prior, association="nearest", confirm=confirm, within=within, **options)
    made = {}
    for step in range(max(seen) + 1):
        slam.predict(*STILL)
        if step in seen:
            made[step] = slam.observe(Sightings.of(sensor, [[4.0, 0.5]])).decision[0]
    return [made[step] for step in seen]


# n sightings in m steps ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seen", "confirm", "within", "expected"),
    [
        ([0, 1, 2, 3], 1, 5, [NEW, ACCEPTED, ACCEPTED, ACCEPTED]),
        ([0, 1, 2, 3], 3, 5, [TENTATIVE, TENTATIVE, NEW, ACCEPTED]),
        ([0, 2, 4, 5], 3, 5, [TENTATIVE, TENTATIVE, NEW, ACCEPTED]),
        ([7, 9, 11], 3, 5, [TENTATIVE, TENTATIVE, NEW]),
        # The third comes a step too late, and counts as the first of three others.
        ([0, 2, 5, 6, 7], 3, 5, [TENTATIVE, TENTATIVE, TENTATIVE, TENTATIVE, NEW]),
        ([0, 3, 6, 9, 12], 2, 3, 5 * [TENTATIVE]),
        ([0, 3, 5], 2, 3, [TENTATIVE, TENTATIVE, NEW]),
        ([0, 1], 2, 2, [TENTATIVE, NEW]),
    ],
)
def test_so_many_sightings_in_so_many_steps(seen, confirm, within, expected):
    assert decisions(seen, confirm, within) == expected
    assert decisions(seen, confirm, within, matching="one-by-one") == expected
    assert decisions(seen, confirm, within, SENSOR, PRIOR) == expected


@pytest.mark.parametrize("matching", ["scan", "one-by-one"])
def test_several_sightings_in_one_step_count_once(matching):
    """Of two looks at one instant; in the next step the second look sees what the first maps."""
    slam = EkfSlam(association="nearest", confirm=2, matching=matching)
    both = Sightings.of(XY, [[4.0, 0.5], [4.01, 0.49]])._replace(look=np.array([0, 1]))
    for expected in ([TENTATIVE, TENTATIVE], [NEW, ACCEPTED]):
        slam.predict(*STILL)
        assert slam.observe(both).decision.tolist() == expected
    assert len(slam.landmarks) == 1


def test_two_things_in_one_look_are_two_things():
    slam = EkfSlam(association="nearest", confirm=2)
    near = Sightings.of(XY, [[4.0, 0.5], [4.2, 0.5]])
    for expected in ([TENTATIVE, TENTATIVE], [NEW, NEW]):
        slam.predict(*STILL)
        assert slam.observe(near).decision.tolist() == expected
    assert len(slam.landmarks) == 2


@pytest.mark.parametrize(("apart", "same"), [(3.0, True), (3.1, False)])
def test_a_sighting_belongs_to_a_thing_inside_the_gate(apart, same):
    """Of 3.03 sigmas at 0.99, in the sum of both covariances."""
    options = {"accept": 0.99, "new": 0.9999}
    slam = EkfSlam(association="nearest", confirm=2, **options)
    for x in (4.0, 4.0 + apart * np.sqrt(0.02)):
        slam.predict(*STILL)
        met = slam.observe(Sightings.of(XY, [[x, 0.5]]))
    assert met.decision.tolist() == [NEW if same else TENTATIVE]


def test_an_uncertain_robot_finds_its_things_again():
    """The gate grows by what was known of the robot at both sightings."""
    options = {"association": "nearest", "confirm": 2}
    for sigma, expected in ((0.0, TENTATIVE), (0.5, NEW)):
        slam = EkfSlam(Prior(np.zeros(3), np.diag([sigma**2, sigma**2, 0])), **options)
        for x in (4.0, 5.0):
            slam.predict(*STILL)
            met = slam.observe(Sightings.of(XY, [[x, 0.5]]))
        assert met.decision.tolist() == [expected]


# The filter knows nothing of it -------------------------------------------------------------------


def drive(slam, clutter, steps=12):
    """Two landmarks, always seen, and something spurious in every look if wanted."""
    delta, poses, truth = np.array([0.3, 0.02, 0.1]), [], PRIOR.mean
    for k in range(steps):
        truth = geo.compose(truth, delta)
        slam.predict(delta, np.diag([4e-4, 1e-4, 1e-4]))
        points = [[6.0, 0.0], [3.0, 4.0]]
        if clutter:  # never twice in the same place
            points.insert(k % 3, [-3.0 - 2.0 * k, 2.0 - 3.0 * (k % 4)])
        values = SENSOR.observe(truth, np.array(points))[0]
        values[:, 0] += 0.05 * np.sin(k)
        slam.observe(Sightings.of(SENSOR, values))
        poses.append(slam.pose)
    return np.array(poses)


@pytest.mark.parametrize("association", EACH)
@pytest.mark.parametrize("matching", ["scan", "one-by-one"])
def test_what_is_not_confirmed_leaves_no_bit(association, matching):
    options = {"association": association, "matching": matching, "confirm": 3, "within": 4}
    with_clutter, without = EkfSlam(PRIOR, **options), EkfSlam(PRIOR, **options)
    np.testing.assert_array_equal(drive(with_clutter, True), drive(without, False))
    np.testing.assert_array_equal(with_clutter.pose_covariance, without.pose_covariance)
    assert len(without.landmarks) == 2
    for name in ("ids", "positions", "covariance"):
        both = (getattr(slam.landmarks, name) for slam in (with_clutter, without))
        np.testing.assert_array_equal(*both)


def test_only_the_sighting_that_confirms_is_used():
    """The landmark has its mapped error; what came before is no more than the reason."""
    slam, expected = EkfSlam(PRIOR, association="nearest", confirm=3), GaussianMap(PRIOR)
    delta, Q = np.array([0.3, 0.02, 0.1]), np.diag([4e-4, 1e-4, 1e-4])
    for value in ([4.0, 0.5], [3.75, 0.42], [3.5, 0.3]):
        slam.predict(delta, Q)
        expected.move(delta, Q)
        met = slam.observe(Sightings.of(SENSOR, [value]))
    assert met.decision.tolist() == [NEW]
    point, wrt_pose, wrt_value = SENSOR.locate(expected.mean[:3], value)
    expected.append(point, wrt_pose, wrt_value, SENSOR.covariance)
    np.testing.assert_allclose(slam.pose, expected.mean[:3], rtol=0, atol=1e-14)
    np.testing.assert_allclose(slam.landmarks.positions[0], point, rtol=0, atol=1e-13)
    np.testing.assert_allclose(slam.landmarks.covariance, expected.block(3, 2), rtol=0, atol=1e-15)


def test_tentative_sightings_meet_no_landmark_and_have_no_innovation():
    slam = EkfSlam(association="nearest", confirm=2)
    met = slam.observe(Sightings.of(XY, [[4.0, 0.5]]))
    assert met.landmark.tolist() == [-1]
    assert np.isnan(met.innovation).all()
    assert np.isnan(met.S).all()


def test_identities_from_outside_need_no_confirmation():
    dataset = simulate("loop-15", seed=1)
    plain, careful = Ekf().estimate(dataset), Ekf(confirm=3).estimate(dataset)
    np.testing.assert_array_equal(plain.online.poses, careful.online.poses)


def test_more_things_than_can_be_kept_in_mind_are_forgotten_and_not_a_crash(rng):
    slam = EkfSlam(association="nearest", confirm=2, within=2)
    crowd = np.column_stack([np.arange(TENTATIVES + 50.0), np.zeros(TENTATIVES + 50)])
    for shift in (0, 5000):
        for expected in (np.full(len(crowd), TENTATIVE), np.repeat([NEW, TENTATIVE], [256, 50])):
            slam.predict(*STILL)
            met = slam.observe(Sightings.of(XY, crowd + np.array([shift, 0.0])))
            np.testing.assert_array_equal(met.decision, expected)
        for _ in range(2):
            slam.predict(*STILL)
    assert len(slam.landmarks) == 2 * TENTATIVES


# Clutter ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_clutter_no_longer_becomes_landmarks_in_the_orchard(seed):
    """Some hundred spurious landmarks, as many as there are trees, and next to none."""
    dataset = simulate("orchard", seed=seed)
    eager, careful = Ekf().estimate(dataset), Ekf(confirm=3, within=8).estimate(dataset)
    clutter = int((dataset.true_landmark < 0).sum())
    counts = [count_landmarks(dataset, estimate) for estimate in (eager, careful)]
    assert counts[0].spurious > 0.8 * clutter > 60
    assert counts[1].spurious <= 2
    assert counts[1].missed == counts[1].duplicate == 0
    scores = association_scores(dataset, careful)
    assert scores.precision > 0.99
    assert scores.recall > 0.99
