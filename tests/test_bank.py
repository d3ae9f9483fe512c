"""A bank of bearing hypotheses: a landmark that is known by ranges, from the first one on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from stepwise import slam_of

from ekfslam import EkfSlam
from ekfslam import geometry as geo
from ekfslam.dataset import LandmarkMap, Prior, Sightings
from ekfslam.estimates import Decision
from ekfslam.evaluation import judged, pose_nees
from ekfslam.filters.ekf import Ekf
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import load_scenario, simulate

PRIOR = Prior([1.0, -2.0, 0.5], np.diag([0.01, 0.02, 0.001]))
SENSOR = Sensor("range", [[0.01]], mount=[0.3, 0.1, 0.4])
BEACON = np.array([5.0, 1.0])
NEW, ACCEPTED, REJECTED = (int(Decision[n]) for n in ("NEW", "ACCEPTED", "REJECTED"))


def few():
    """A cloister with every third of its columns."""
    whole = load_scenario("cloister-range")
    ids, positions = whole.landmarks.ids[::3], whole.landmarks.positions[::3]
    return replace(whole, landmarks=LandmarkMap(ids, positions))


def started(**options):
    """A robot that has had its first range of a beacon, and what the bank then holds."""
    slam = EkfSlam(PRIOR, ranges="bank", **options)
    value = SENSOR.observe(PRIOR.mean, BEACON)[0]
    assert slam.observe(Sightings.of(SENSOR, [value], [7])).decision.tolist() == [NEW]
    return slam, value[0]


def held(slam, index=0):
    """Places of the hypotheses of a landmark that are left, and their weights."""
    offsets, weights = (column[index] for column in slam._engine.bank)
    alive = offsets >= 0
    if alive.any():  # else the last one has become the landmark
        np.testing.assert_array_equal(weights[~alive], 0)
    return offsets[alive], weights[alive]


def turn(slam, truth, look=True, bias=0.0):
    """A step along a circle, with another range."""
    delta = np.array([0.4, 0.0, 0.2])
    truth = geo.compose(truth, delta)
    slam.predict(delta, np.diag([1e-5, 1e-5, 1e-6]))
    if look:
        value = SENSOR.observe(truth, BEACON)[0] + bias
        slam.observe(Sightings.of(SENSOR, [value], [7]))
    return truth


# The ring -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [3, 8, 16])
def test_the_first_range_is_a_ring_of_equal_hypotheses(count):
    """Evenly spaced about the sensor, each as wide along the ring as half of what is between."""
    slam, distance = started(hypotheses=count)
    offsets, weights = held(slam)
    np.testing.assert_allclose(weights, 1 / count, rtol=1e-15)
    np.testing.assert_array_equal(offsets, 3 + 2 * np.arange(count))
    P, frame = slam._engine.slam.covariance, geo.compose(PRIOR.mean, SENSOR.mount)
    points = np.array([slam._engine.slam.mean[at : at + 2] for at in offsets])
    local = geo.to_frame(frame, points)
    np.testing.assert_allclose(np.hypot(*local.T), distance, rtol=1e-13)
    around = np.sort(np.arctan2(*local.T[::-1]))
    np.testing.assert_allclose(np.diff(around), geo.TAU / count, rtol=1e-12)
    whole = Sensor("range-bearing", np.diag([0.01, (np.pi / count) ** 2]), mount=SENSOR.mount)
    for at, point in zip(offsets, points, strict=True):
        value = whole.observe(PRIOR.mean, point)[0]
        _, wrt_pose, wrt_value = whole.locate(PRIOR.mean, value)
        expected = geo.congruence(wrt_pose, PRIOR.covariance)
        expected = expected + geo.congruence(wrt_value, whole.covariance)
        np.testing.assert_allclose(P[at : at + 2, at : at + 2], expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(P[at : at + 2, :3], wrt_pose @ PRIOR.covariance, atol=1e-14)
    assert len(slam.landmarks) == 0
    assert slam._engine.undetermined == 1


def test_the_first_range_tells_nothing_of_the_robot():
    slam, _ = started()
    np.testing.assert_array_equal(slam.pose, PRIOR.mean)
    np.testing.assert_array_equal(slam.pose_covariance, PRIOR.covariance)


# Weights ------------------------------------------------------------------------------------------


def test_weights_sum_to_one_and_the_last_hypothesis_is_the_landmark():
    slam, _ = started()
    truth, left = PRIOR.mean, []
    for _ in range(60):
        truth = turn(slam, truth)
        offsets, weights = held(slam)
        if not len(offsets):
            break
        assert weights.sum() == pytest.approx(1, abs=1e-14)
        assert (weights >= Ekf.prune / Ekf.hypotheses).all()
        left.append(len(offsets))
        assert slam._engine.slam.size == 3 + 2 * len(offsets)
    assert left == sorted(left, reverse=True)
    assert left[0] > 2
    assert slam._engine.slam.size == 5  # what was pruned has left the state
    assert slam._engine.undetermined == 0
    assert slam.landmarks.ids.tolist() == [7]
    error = slam.landmarks.positions[0] - BEACON
    assert error @ np.linalg.solve(slam.landmarks.covariance, error) < 13.8
    assert np.linalg.norm(error) < 0.3


def test_the_first_weights_are_those_of_bayes():
    """Of the density of the second range under each hypothesis, by dense algebra."""
    slam, _ = started(prune=0.0)
    truth = turn(slam, PRIOR.mean, look=False)
    offsets, _ = held(slam)
    P, mean = slam._engine.slam.covariance, slam._engine.slam.mean.copy()
    value, likelihoods = SENSOR.observe(truth, BEACON)[0], []
    for at in offsets:
        where = np.r_[:3, at : at + 2]
        expected, wrt_pose, wrt_point = SENSOR.observe(mean[:3], mean[at : at + 2])
        H = np.concatenate([wrt_pose, wrt_point], axis=1)
        s = (H @ P[np.ix_(where, where)] @ H.T + SENSOR.covariance)[0, 0]
        likelihoods.append(np.exp(-0.5 * (value - expected)[0] ** 2 / s) / np.sqrt(s))
    slam.observe(Sightings.of(SENSOR, [value], [7]))
    offsets, weights = held(slam)
    assert len(offsets) == Ekf.hypotheses
    np.testing.assert_allclose(weights, likelihoods / np.sum(likelihoods), rtol=1e-10)


def test_together_they_learn_from_a_sighting_no_more_than_it_tells():
    """Federated information: the noise of each is divided by its weight.

    A range tells 1/R of where the robot is, in one direction, and that only if its beacon is known.
    """
    for options in ({"hypotheses": 4}, {}, {"prune": 0.0}):
        slam, _ = started(**options)
        truth = PRIOR.mean
        for _ in range(5):
            truth = turn(slam, truth, look=False)
            before = np.linalg.inv(slam.pose_covariance)
            if not len(held(slam)[0]):
                break
            value = SENSOR.observe(truth, BEACON)[0]
            slam.observe(Sightings.of(SENSOR, [value], [7]))
            gained = np.linalg.inv(slam.pose_covariance) - before
            assert np.linalg.eigvalsh(gained).min() > -1e-6 * np.trace(before)
            assert np.trace(gained[:2, :2]) <= 1 / 0.01


def test_a_range_that_no_hypothesis_explains_is_an_outlier_and_changes_nothing():
    slam, _ = started()
    truth = turn(slam, PRIOR.mean)
    offsets, weights = held(slam)
    before = slam.pose, slam._engine.slam.covariance
    met = slam.observe(Sightings.of(SENSOR, [[500.0]], [7]))
    assert met.decision.tolist() == [REJECTED]
    np.testing.assert_array_equal(slam.pose, before[0])
    np.testing.assert_array_equal(slam._engine.slam.covariance, before[1])
    np.testing.assert_array_equal(held(slam)[0], offsets)
    np.testing.assert_array_equal(held(slam)[1], weights)
    turn(slam, truth)


@pytest.mark.parametrize("kind", ["range-bearing", "xy", "bearing"])
def test_another_view_decides(kind):
    """A sighting that tells the direction leaves the right hypothesis, or its neighbour."""
    slam, _ = started()
    noise = {
        "range-bearing": np.diag([0.01, 1e-4]),
        "xy": np.diag([1e-4, 1e-4]),
        "bearing": [[1e-4]],
    }
    other = Sensor(kind, noise[kind], min_range=0.5)
    for _ in range(20):
        met = slam.observe(Sightings.of(other, [other.observe(PRIOR.mean, BEACON)[0]], [7]))
        assert met.decision.tolist() == [ACCEPTED]
    assert slam.landmarks.ids.tolist() == [7]
    np.testing.assert_allclose(slam.landmarks.positions[0], BEACON, atol=0.5)


def test_banks_of_many_landmarks_share_one_state():
    """Places stay right when hypotheses of other landmarks and whole landmarks leave the state."""
    dataset = simulate(few(), seed=4)
    slam = slam_of(dataset, ranges="bank")
    for step in dataset.steps():
        slam.predict(step.increment, step.covariance)
        slam.observe(step.observations)
        register, bank = slam._engine.register, slam._engine.bank
        hypotheses = bank.offsets[bank.offsets >= 0]
        points = register.offsets[register.offsets >= 0]
        places = np.sort(np.concatenate([hypotheses, points]))
        np.testing.assert_array_equal(places, 3 + 2 * np.arange(len(places)))
        assert slam._engine.slam.size == 3 + 2 * len(places)
        alive = bank.weights.sum(axis=1)
        np.testing.assert_allclose(alive[(bank.offsets >= 0).any(axis=1)], 1, atol=1e-12)


# Against waiting, and against a naive prior -------------------------------------------------------


@cache
def runs(ranges, seeds=8):
    """Final NEES, share of runs that diverge, and errors of the landmarks."""
    nees, lost, errors = [], 0, []
    for seed in range(seeds):
        dataset = simulate(few(), seed=seed)
        estimate = judged(dataset, Ekf(ranges=ranges).estimate(dataset))
        online = estimate.online
        nees.append(pose_nees(online.poses, dataset.truth, online.covariances)[-1])
        lost += estimate.status != "ok"
        order = np.searchsorted(dataset.true_map.ids, estimate.landmarks.ids)
        apart = estimate.landmarks.positions - dataset.true_map.positions[order]
        errors.extend(np.linalg.norm(apart, axis=1))
    return np.median(nees), lost / seeds, np.array(errors)


def test_a_naive_prior_on_the_bearing_fails_for_a_ring():
    """Solà, 2.3.5: nearly all runs are lost, and none knows it."""
    nees, lost, errors = runs("naive")
    assert lost > 0.5
    assert nees > 1000
    assert np.median(errors) > 1.0


def test_ranges_that_wait_are_consistent():
    nees, lost, errors = runs("delayed")
    assert lost == 0
    assert nees < 7.8  # of three degrees of freedom, in 95 of 100
    assert errors.max() < 0.6


def test_the_last_hypothesis_is_near_the_truth():
    """Less consistent than waiting, since wrong hypotheses have their share."""
    nees, lost, errors = runs("bank")
    assert lost == 0
    assert nees < 0.01 * runs("naive")[0]
    assert len(errors) > 0.9 * len(runs("delayed")[2])
    assert errors.max() < 1.0
