"""The linear oracle against filters right and wrong, and the filter where all is linear anyway."""

from dataclasses import replace

import numpy as np
import pytest
from textbook import TextbookEkf, two_sensors

from baselines.linear_oracle import solve
from ekfslam import geometry as geo
from ekfslam.dataset import Prior
from ekfslam.filters.ekf import UPDATES, Ekf
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import load_scenario, simulate


def drawn(name, seed=1):
    return simulate(two_sensors() if name == "two-sensors" else load_scenario(name), seed=seed)


def deviations(dataset, estimate, linear):
    """Largest differences to the oracle: of means, and of the joint covariance (relative)."""
    solution = solve(dataset.prior, linear)
    where = {int(landmark): i for i, landmark in enumerate(estimate.landmarks.ids)}
    order = np.array([where[int(i)] for i in solution.ids])
    rows = np.concatenate([np.arange(3), (3 + 2 * order[:, None] + np.arange(2)).reshape(-1)])
    pose = geo.additive_error(solution.pose, estimate.online.poses[-1])
    points = estimate.landmarks.positions[order] - solution.positions
    covariance = estimate.joint_covariance[np.ix_(rows, rows)] - solution.covariance
    means = max(np.abs(pose).max(), np.abs(points).max())
    return means, np.abs(covariance).max() / np.abs(solution.covariance).max()


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("name", ["cloister", "loop-15", "two-sensors"])
def test_gives_the_final_state_of_the_filter_to_round_off(name, update):
    dataset = drawn(name)
    means, covariance = deviations(dataset, *Ekf(update=update).linearizations(dataset))
    assert means < 1e-11
    assert covariance < 1e-11


def test_gives_the_final_state_of_the_textbook_filter_too():
    dataset = drawn("loop-15")
    assert max(deviations(dataset, *TextbookEkf().linearizations(dataset))) < 1e-11


@pytest.mark.parametrize("name", ["cloister", "loop-15"])
def test_a_landmark_that_knows_nothing_of_the_robot_shows(name):
    dataset = drawn(name)
    means, covariance = deviations(
        dataset, *TextbookEkf("no-cross-covariance").linearizations(dataset)
    )
    assert means > 1e-3
    assert covariance > 0.1


def test_a_jacobian_that_was_not_used_shows():
    dataset = drawn("loop-15")
    estimate, linear = Ekf().linearizations(dataset)
    swapped = linear.jacobian.copy()
    at = np.flatnonzero(~linear.new)[100]
    swapped[at, :, 2] *= -1
    means, covariance = deviations(dataset, estimate, replace(linear, jacobian=swapped))
    assert means > 1e-6
    assert covariance > 1e-6


def test_what_a_filter_believes_wrongly_is_hidden_from_it():
    """The oracle checks the bookkeeping; a wrong noise shows only against the true model."""
    dataset = drawn("loop-15")
    assert max(deviations(dataset, *TextbookEkf("wrong-noise").linearizations(dataset))) < 1e-10


# The linear case --------------------------------------------------------------------------------


def known_headings(seed=3):
    """Smith and Cheeseman's problem made linear: exact headings, relative positions."""
    scenario = two_sensors(
        motion=MotionModel("odometry", covariance=np.diag([4e-3, 2e-3, 0.0])),
        sensors=(Sensor("xy", [[0.04, 0.01], [0.01, 0.02]], mount=[0.5, 0.1, 0.2], max_range=9.0),),
        prior=Prior([0.0, -3.0, 3.0], np.diag([0.04, 0.09, 0.0])),
        controls=np.tile([0.3, 0.02, 0.1], (40, 1)),
    )
    return simulate(scenario, seed=seed)


def least_squares(dataset):
    """Positions of all poses and landmarks where headings are known: one dense linear problem."""
    poses, ids = dataset.poses, np.unique(dataset.observations.landmark)
    size = 2 * (poses + len(ids))
    headings = dataset.prior.mean[2] + np.concatenate([[0], np.cumsum(dataset.robot.controls.T[2])])
    blocks, rights = [], []

    def add(terms, right, covariance):
        row = np.zeros((2, size))
        for at, matrix in terms:
            row[:, 2 * at : 2 * at + 2] = matrix
        whitener = np.linalg.inv(np.linalg.cholesky(covariance))
        blocks.append(whitener @ row)
        rights.append(whitener @ right)

    add([(0, np.eye(2))], dataset.prior.mean[:2], dataset.prior.covariance[:2, :2])
    deltas, noise = dataset.robot.increments
    for k in range(poses - 1):
        R = geo.rotation(headings[k])
        add(
            [(k, -np.eye(2)), (k + 1, np.eye(2))],
            R @ deltas[k, :2],
            R @ noise[k, :2, :2] @ R.T,
        )
    sensor, seen = dataset.sensors[0], dataset.observations
    for k, value, landmark in zip(seen.step, seen.values, seen.landmark, strict=True):
        at = poses + int(np.searchsorted(ids, landmark))
        C = geo.rotation(headings[k] + sensor.mount[2]).T
        lever = geo.rotation(sensor.mount[2]).T @ sensor.mount[:2]
        add([(k, -C), (at, C)], value + lever, sensor.covariance)
    A, b = np.concatenate(blocks), np.concatenate(rights)
    covariance = np.linalg.inv(A.T @ A)
    return ids, (covariance @ A.T @ b).reshape(-1, 2), covariance


@pytest.mark.parametrize("update", UPDATES)
def test_the_linear_case_is_batch_least_squares(update):
    dataset = known_headings()
    ids, solution, covariance = least_squares(dataset)
    estimate = Ekf(update=update).estimate(dataset)
    last = dataset.poses - 1
    np.testing.assert_allclose(estimate.online.poses[-1, :2], solution[last], rtol=0, atol=1e-11)
    np.testing.assert_array_equal(estimate.landmarks.ids, ids)
    positions = estimate.landmarks.positions
    np.testing.assert_allclose(positions, solution[last + 1 :], rtol=0, atol=1e-11)
    known = np.delete(np.arange(len(estimate.joint_covariance)), 2)
    marginal = covariance[2 * last :, 2 * last :]
    joint = estimate.joint_covariance[np.ix_(known, known)]
    np.testing.assert_allclose(joint, marginal, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(estimate.joint_covariance[2], 0)  # the heading stays known


def test_joint_and_sequential_agree_in_the_linear_case_and_only_there():
    joint, sequential = (Ekf(update=update).estimate(known_headings()) for update in UPDATES)
    difference = joint.online.poses - sequential.online.poses
    np.testing.assert_allclose(difference, 0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(joint.joint_covariance, sequential.joint_covariance, atol=1e-13)
    np.testing.assert_allclose(joint.step_nis, sequential.step_nis, rtol=1e-9)
    bent = [Ekf(update=update).estimate(drawn("two-sensors")).online.poses for update in UPDATES]
    assert np.abs(bent[0] - bent[1]).max() > 1e-6
