"""The family where users take it: far away, step by step in any order, in teams, without data."""

from dataclasses import replace

import numpy as np
import pytest
from problems import START, camera, first_steps, problem, rows_kept, scanner
from scipy.optimize import least_squares

import ekfslam
from ekfslam.dataset import Prior
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Decision
from ekfslam.filters.arrays import Register
from ekfslam.filters.family import EkfIdeal, Iekf
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.filters.online import ONLINE
from ekfslam.filters.variants import ALONE, EKF, INVARIANT, NAMES, ROBOCENTRIC
from ekfslam.filters.visibility import LARGE, feasible
from ekfslam.models.sensors import Sensor
from ekfslam.registry import resolve
from ekfslam.robots import LandmarkMap


@pytest.mark.parametrize("name", NAMES)
def test_far_from_the_origin_of_the_world(name):
    """At coordinates of maps, numbers of which have 1e-9 m left."""
    here = problem(scanner(0.3, -0.2, 0.5), camera(-0.4, 0.1, 2.8), steps=30, seed=4)
    there = here.moved([5e6, -5e6, 0.0])
    near_by, far = resolve(name).estimate(here), resolve(name).estimate(there)
    assert far.status == "ok", far.message
    off = far.online.poses - near_by.online.poses - [5e6, -5e6, 0.0]
    np.testing.assert_allclose(off[:, :2], 0, atol=1e-7)
    np.testing.assert_allclose(far.online.covariances, near_by.online.covariances, atol=1e-8)
    np.testing.assert_allclose(far.joint_covariance, near_by.joint_covariance, atol=1e-8)
    off = far.landmarks.positions - near_by.landmarks.positions - [5e6, -5e6]
    np.testing.assert_allclose(off, 0, atol=1e-7)


@pytest.mark.parametrize("name", ONLINE)
def test_a_pose_that_is_read_changes_nothing(name):
    data = problem(scanner(0.3, -0.2, 0.5), steps=9, seed=3)
    silent, watched = (ekfslam.EkfSlam(data.prior, estimator=name) for _ in range(2))
    for step in data.steps():
        for slam in (silent, watched):
            slam.predict(step.increment, step.covariance)
            if slam is watched:
                _ = slam.pose, slam.pose_covariance, slam.landmarks
            slam.observe(step.observations)
    np.testing.assert_array_equal(silent.pose, watched.pose)
    np.testing.assert_array_equal(silent.pose_covariance, watched.pose_covariance)


@pytest.mark.parametrize("looks", [True, False])
@pytest.mark.parametrize("name", ONLINE)
def test_steps_in_which_nothing_is_seen(name, looks):
    """The same bits as over the dataset, whether the filter is told of looks that show nothing."""
    data = problem(scanner(0.3, -0.2, 0.5), steps=12, seed=3)
    data = rows_kept(data, data.observations.step % 4 == 1)
    slam, whole = ekfslam.EkfSlam(data.prior, estimator=name), resolve(name).estimate(data)
    for step in data.steps():
        slam.predict(step.increment, step.covariance)
        if looks or len(step.observations.values):
            slam.observe(step.observations)
    np.testing.assert_array_equal(slam.pose, whole.online.poses[-1])
    np.testing.assert_array_equal(slam.pose_covariance, whole.online.covariances[-1])


def test_noise_to_the_side_alone_is_not_lost():
    slam = ekfslam.EkfSlam(estimator="ekf-robocentric")
    noise = np.diag([0.0, 0.04, 0.0])
    slam.predict([0, 0, 0], noise)
    np.testing.assert_array_equal(slam.pose_covariance, noise)
    slam.predict([0, 0, 0], noise)
    np.testing.assert_array_equal(slam.pose_covariance, 2 * noise)


def test_robots_that_see_each_other_are_iterated_to_the_maximum_of_the_posterior():
    data = first_steps(problem(scanner(0.3, -0.2, 0.5), robots=3, meet=(0,), seed=3), 2)
    rows = data.observations
    looks = (rows.step == 0) & (rows.robot == 0) & (data.observed_robot >= 0)
    data = first_steps(rows_kept(data, looks), 2)
    found = Iekf(iterations=200, tolerance=1e-12).estimate(data).online.poses[:, 0]
    (sensor,) = data.sensors
    assert len(data.observations) == 2
    start = np.array([robot.prior.mean for robot in data.robots])
    whiten = np.linalg.inv(np.linalg.cholesky(START))

    def residuals(x):
        poses, parts = x.reshape(3, 3), []
        for pose, mean in zip(poses, start, strict=True):
            parts.append(whiten @ (pose - mean))
        for value, other in zip(data.observations.values, data.observed_robot, strict=True):
            expected = sensor.observe(poses[0], poses[other, :2])[0]
            root = np.linalg.cholesky(sensor.covariances(value))
            parts.append(np.linalg.solve(root, sensor.difference(value, expected)))
        return np.concatenate(parts)

    best = least_squares(residuals, start.reshape(-1), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(found.reshape(-1), best.x, atol=1e-6)


@pytest.mark.parametrize("name", [NAMES[code] for code in ALONE])
def test_filters_of_one_robot_say_so_before_they_are_warm(name):
    with pytest.raises(UnsupportedError, match="single robot"):
        resolve(name).warm_up(problem(scanner(), robots=2))


def test_the_ideal_filter_where_truly_nothing_is_there():
    data = problem(scanner(), steps=3)
    nothing = LandmarkMap(np.zeros(0, int), np.zeros((0, 2)))
    clutter = replace(data, true_map=nothing, true_landmark=np.full(len(data.observations), -1))
    assert EkfIdeal().estimate(clutter).status == "ok"


@pytest.mark.parametrize("variant", [INVARIANT, ROBOCENTRIC])
def test_landmarks_that_grow_uncertain_may_be_seen_from_afar(variant):
    """In the frame of the robot, and about an origin, a landmark's variance has no bound."""
    slam, register = GaussianMap(Prior(), LARGE), Register.of(LARGE)
    for index in range(LARGE):
        at = slam.append(np.array([0.0, 20.0 + index]), np.zeros((2, 3)), np.eye(2), 25 * np.eye(2))
        register.offsets[index], register.sizes[index], register.spread[index] = at, 2, 0.1
    register.used[0] = LARGE
    limits = np.array([0.0, 10.0, np.pi])
    arguments = slam.arrays, register, 0, np.zeros(3), limits, 0.0
    assert len(feasible(*arguments, EKF)) == 0  # a bound that it would keep
    assert len(feasible(*arguments, variant)) == 12  # 3 sqrt(50) m beyond its range


@pytest.mark.parametrize("known_gate", [None, 0.99])
@pytest.mark.parametrize("name", NAMES)
def test_a_look_that_fails_leaves_nothing_behind(name, known_gate):
    """Noise far below the round-off of the prior: the map is no covariance after one look."""
    data = problem(Sensor("xy", np.diag([1e-22, 1e-22])), steps=5, seed=1)
    prior = Prior(data.prior.mean, np.diag([1e4, 1e4, 0.1]))
    data = replace(data, robots=(replace(data.robot, prior=prior),))
    estimate = resolve(name, known_gate=known_gate).estimate(data)
    assert estimate.status == "diverged"
    assert estimate.message == "innovation covariance not positive definite at step 1"
    later = data.observations.step > 0
    assert (estimate.innovations.decision[later] == Decision.REJECTED).all()
    assert (estimate.innovations.landmark[later] == -1).all()
    assert np.isnan(estimate.step_nis).all()
    assert (estimate.step_dof == 0).all()
    assert np.isnan(estimate.online.poses[1:]).all()
