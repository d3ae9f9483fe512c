"""What gates make of sightings with a wrong identity, and of clutter."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ekfslam import EkfSlam
from ekfslam.dataset import Prior, Sightings
from ekfslam.estimates import Decision
from ekfslam.evaluation import association_scores, count_landmarks, tables
from ekfslam.filters.ekf import Ekf
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import load_scenario, simulate

SHARE = 0.05
GATE = {"known_gate": 0.999}
LEAST = {"park": 300, "loop-15": 100, "team": 150}
NEW, ACCEPTED, REJECTED = (Decision[name] for name in ("NEW", "ACCEPTED", "REJECTED"))


@cache
def drawn(name, seed, **changes):
    return simulate(replace(load_scenario(name), **changes), seed=seed)


def mistaken(dataset):
    return (dataset.observations.landmark != dataset.true_landmark) & (dataset.observed_robot < 0)


def ate(estimate, dataset):
    truth = np.array([robot.truth for robot in dataset.robots])
    apart = estimate.online.poses.reshape(truth.shape)[..., :2] - truth[..., :2]
    return np.sqrt(np.mean(np.sum(apart**2, axis=-1)))


# One sighting -------------------------------------------------------------------------------------

XY = Sensor("xy", np.diag([0.01, 0.01]))
BEARING = Sensor("bearing", [[0.0001]], min_range=0.5)
RANGE = Sensor("range", [[0.01]])


@pytest.mark.parametrize(("sigmas", "decision"), [(2.9, ACCEPTED), (3.1, REJECTED)])
@pytest.mark.parametrize(
    ("sensor", "direction", "gate"),
    [(XY, [0.6, 0.8], 0.98889), (BEARING, [1.0], 0.9973), (RANGE, [1.0], 0.9973)],
    ids=lambda part: getattr(part, "kind", ""),
)
def test_the_gate_is_a_probability_for_one_number_and_for_two(
    sensor, direction, gate, sigmas, decision
):
    """Three sigmas in each case, of an innovation with the robot's and the landmark's share."""
    slam = EkfSlam(Prior(np.zeros(3), np.diag([0.02, 0.02, 0.0])), known_gate=gate)
    slam.observe(Sightings.of(XY, [[10.0, 0.0]], [7]))
    slam.predict([0.0, 0.0, 0.0], np.diag([0.03, 0.03, 0.0]))
    P = slam._engine.landmarks(np.array([7]))[1]
    value, wrt_pose, wrt_point = sensor.observe(slam.pose, slam.landmarks.positions[0])
    H = np.concatenate([wrt_pose, wrt_point], axis=1)
    S = H @ P @ H.T + sensor.covariance
    error = sigmas * np.linalg.cholesky(S) @ direction
    before = slam.pose, slam.landmarks.covariance
    met = slam.observe(Sightings.of(sensor, [value + error], [7]))
    assert met.decision.tolist() == [decision]
    assert met.landmark.tolist() == [7]
    d = sensor.view.size
    # What was met is told of what was refused, too.
    np.testing.assert_allclose(met.innovation[0, :d], error, rtol=0, atol=1e-12)
    np.testing.assert_allclose(met.S[0, :d, :d], S, rtol=0, atol=1e-13)
    if decision == REJECTED:
        np.testing.assert_array_equal(slam.pose, before[0])
        np.testing.assert_array_equal(slam.landmarks.covariance, before[1])


def test_a_gate_that_lets_everything_through_changes_nothing():
    for name in ("loop-15", "team", "two-sensors", "cloister-range"):
        dataset = simulate(name, seed=1)
        plain, gated = Ekf().estimate(dataset), Ekf(known_gate=1 - 1e-16).estimate(dataset)
        np.testing.assert_array_equal(gated.online.poses, plain.online.poses)
        np.testing.assert_array_equal(gated.joint_covariance, plain.joint_covariance)


def test_a_gate_refuses_so_many_true_matches_as_it_says():
    """With the share that falls outside of a right gate: NIS is chi-square distributed."""
    rejected = rows = 0
    for seed in range(4):
        decision = Ekf(known_gate=0.95).estimate(drawn("loop-15", seed)).innovations.decision
        rejected += (decision == REJECTED).sum()
        rows += (decision != NEW).sum()
    # Innovations of one filter are white; the deviation is that of as many throws of a coin.
    assert rejected / rows == pytest.approx(0.05, abs=5 * np.sqrt(0.05 * 0.95 / rows))


# Wrong identities ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", ["park", "loop-15", "team"])
def test_wrong_identities_are_rejected_and_the_way_is_that_without_them(name, seed):
    """What is founded under a wrong identity is deleted when its own sightings are refused."""
    clean, wrong = drawn(name, seed), drawn(name, seed, wrong_ids=SHARE)
    bad = mistaken(wrong)
    assert bad.sum() > LEAST[name]
    trusting = Ekf().estimate(wrong)
    gated = Ekf(**GATE, corrupt=3).estimate(wrong)
    decision = gated.innovations.decision
    assert (decision[bad] == ACCEPTED).sum() <= 0.02 * bad.sum()
    assert (decision[bad] == REJECTED).sum() > 0.8 * bad.sum()
    good = ~bad & (wrong.observed_robot < 0)
    assert (decision[good] == REJECTED).sum() < 0.03 * good.sum()
    # Of two runs that use other rows, errors differ as those of two runs do.
    best = ate(Ekf().estimate(clean), clean)
    assert ate(gated, wrong) < 1.5 * best + 0.05
    assert ate(trusting, wrong) > 10 * best


def test_without_deletion_a_wrong_founding_refuses_what_comes_after():
    wrong = drawn("loop-15", 2, wrong_ids=SHARE)
    good = ~mistaken(wrong)
    refused = [
        (Ekf(**GATE, corrupt=corrupt).estimate(wrong).innovations.decision[good] == REJECTED).sum()
        for corrupt in (0, 3)
    ]
    assert refused[0] > 10 * refused[1]


def test_the_counts_are_in_the_table_of_innovations():
    wrong = drawn("loop-15", 0, wrong_ids=SHARE)
    estimate = Ekf(**GATE, corrupt=3).estimate(wrong)
    listed = tables.innovations(wrong, estimate)["decision"].value_counts()
    decision = estimate.innovations.decision
    for name in ("accepted", "new", "rejected"):
        assert listed[name] == (decision == Decision[name.upper()]).sum()
    scores = association_scores(wrong, estimate)
    assert scores.precision > 0.99


# Clutter ------------------------------------------------------------------------------------------


def test_clutter_without_identity_is_never_used_where_identities_are_known():
    plain, cluttered = drawn("loop-15", 1), drawn("loop-15", 1, clutter=0.5)
    clutter = cluttered.true_landmark < 0
    assert clutter.sum() > 100
    estimate = Ekf("known").estimate(cluttered)
    assert (estimate.innovations.decision[clutter] == REJECTED).all()
    assert (estimate.innovations.landmark[clutter] == -1).all()
    np.testing.assert_array_equal(estimate.online.poses, Ekf().estimate(plain).online.poses)


@pytest.mark.parametrize("association", ["nearest", "maximum-likelihood", "global", "joint"])
def test_clutter_is_hardly_ever_taken_for_a_landmark(association):
    cluttered = drawn("park", 1, clutter=0.3, association="unknown")
    estimate = Ekf(association, confirm=3, within=8).estimate(cluttered)
    scores, clutter = association_scores(cluttered, estimate), cluttered.true_landmark < 0
    assert clutter.sum() > 100
    assert scores.accepted[clutter].mean() < 0.05
    assert scores.precision > 0.99
    assert scores.recall > 0.95
    assert count_landmarks(cluttered, estimate).spurious <= 2
    assert ate(estimate, cluttered) < 1.0
