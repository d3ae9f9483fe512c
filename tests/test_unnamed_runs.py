"""Whole runs without names: what the filter makes of the decisions of nearest neighbour."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from textbook import two_sensors

from ekfslam import EkfSlam
from ekfslam import geometry as geo
from ekfslam.dataset import LandmarkMap, Prior, Sightings
from ekfslam.estimates import Decision
from ekfslam.filters.ekf import Ekf
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import load_scenario, simulate

XY = Sensor("xy", np.diag([0.01, 0.01]))
GATES = {"accept": 0.99, "new": 0.9999}  # at 3.03 and 4.29 sigmas


def a_map(*points):
    """A robot that knows exactly where it is and has seen some landmarks once."""
    slam = EkfSlam(association="nearest", **GATES)
    slam.observe(Sightings.of(XY, points))
    return slam


def test_two_gates():
    """A landmark of variance 0.01 seen with variance 0.01: sigma of the innovation is 0.1414."""
    sigma = np.sqrt(0.02)
    met = a_map([4, 0], [0, 9], [9, 9]).observe(
        Sightings.of(XY, [[4 + 3.0 * sigma, 0], [0, 9 + 3.1 * sigma], [9 + 4.3 * sigma, 9]])
    )
    assert met.decision.tolist() == [Decision.ACCEPTED, Decision.AMBIGUOUS, Decision.NEW]
    assert met.landmark.tolist() == [0, -1, 3]
    np.testing.assert_allclose(met.innovation[0], [3.0 * sigma, 0], rtol=0, atol=1e-12)
    assert np.isnan(met.innovation[1:]).all()


def test_what_is_ambiguous_changes_nothing():
    slam = a_map([4, 0])
    before = slam.landmarks
    met = slam.observe(Sightings.of(XY, [[4.5, 0]]))
    assert met.decision.tolist() == [Decision.AMBIGUOUS]
    np.testing.assert_array_equal(slam.pose, 0)
    np.testing.assert_array_equal(slam.landmarks.positions, before.positions)
    np.testing.assert_array_equal(slam.landmarks.covariance, before.covariance)


def test_one_look_sees_a_landmark_once():
    met = a_map([4, 0]).observe(Sightings.of(XY, [[4.1, 0], [3.95, 0]]))
    assert met.decision.tolist() == [Decision.AMBIGUOUS, Decision.ACCEPTED]


def test_two_looks_may_see_the_same_landmark():
    look = Sightings.of(XY, [[4.1, 0], [3.95, 0]])
    met = a_map([4, 0]).observe(look._replace(look=np.array([0, 1])))
    assert met.decision.tolist() == [Decision.ACCEPTED, Decision.ACCEPTED]
    met = a_map([9, 9]).observe(look._replace(look=np.array([0, 1])))
    assert met.decision.tolist() == [Decision.NEW, Decision.ACCEPTED]
    assert met.landmark.tolist() == [1, 1]


def test_the_uncertainty_of_the_robot_widens_the_gate():
    """What is far from a landmark for a robot that knows its pose is near for one that does not."""
    far = Sightings.of(XY, [[4.8, 0]])
    assert a_map([4, 0]).observe(far).decision.tolist() == [Decision.NEW]
    slam = a_map([4, 0])
    slam.predict(np.zeros(3), np.diag([0.2, 0.2, 0.0]))
    assert slam.observe(far).decision.tolist() == [Decision.ACCEPTED]


def test_identities_are_not_looked_at():
    dataset = simulate("loop-15", seed=1)
    blank = np.full(len(dataset.observations), -1)
    hidden = replace(dataset, observations=replace(dataset.observations, landmark=blank))
    one, other = (Ekf("nearest").estimate(d) for d in (dataset, hidden))
    np.testing.assert_array_equal(one.innovations.landmark, other.innovations.landmark)
    np.testing.assert_array_equal(one.online.poses, other.online.poses)


@cache
def park(seed):
    """The park without names: the dataset, and estimates without and with them."""
    unnamed = simulate(replace(load_scenario("park"), association="unknown"), seed=seed)
    return unnamed, Ekf().estimate(unnamed), Ekf().estimate(simulate("park", seed=seed))


def ate(estimate, dataset):
    error = geo.additive_error(dataset.truth, estimate.online.poses)[:, :2]
    return np.sqrt(np.mean(np.sum(error**2, axis=1)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nearest_neighbour_makes_no_wrong_match_in_the_park(seed):
    dataset, estimate, named = park(seed)
    assert estimate.association == "nearest"
    decision, landmark = estimate.innovations.decision, estimate.innovations.landmark
    first = decision == Decision.NEW
    true_of = dict(zip(landmark[first], dataset.true_landmark[first], strict=True))
    assert len(set(true_of.values())) == len(true_of) == len(named.landmarks)  # each mapped once
    accepted = decision == Decision.ACCEPTED
    matched = np.array([true_of[i] for i in landmark[accepted]])
    np.testing.assert_array_equal(matched, dataset.true_landmark[accepted])  # precision 1
    assert accepted.sum() > 0.99 * (~first).sum()  # recall
    # What the gate leaves out is 1 in 1000 and moves the path by less than its own error.
    assert ate(estimate, dataset) == pytest.approx(ate(named, dataset), rel=0.1)


def test_two_sensors_build_one_map():
    """What the scanner maps the camera recognises, in the same step."""
    unnamed = simulate(two_sensors(association="unknown"), seed=1)
    estimate = Ekf().estimate(unnamed)
    seen = np.unique(unnamed.true_landmark)
    assert len(estimate.landmarks) == len(seen)


def test_bearings_are_compared_around_the_circle():
    """A landmark straight behind, whose bearing jumps from pi to -pi, is recognised."""
    ring = two_sensors(
        landmarks=LandmarkMap([0, 1], [[-9.0, 0.02], [-9.0, -6.0]]),
        start=[0.0, 0.0, 0.0],
        controls=np.tile([0.1, 0.0, 0.0], (40, 1)),
        sensors=(Sensor("range-bearing", np.diag([0.01, 1e-4])),),
        prior=Prior(),
        association="unknown",
    )
    dataset = simulate(ring, seed=1)
    bearings = dataset.observations.values[dataset.true_landmark == 0, 1]
    assert bearings.min() < -3 < 3 < bearings.max()
    assert len(Ekf().estimate(dataset).landmarks) == 2
