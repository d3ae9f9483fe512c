"""The family in the workbench: association, step by step, deletion, teams, and what it refuses."""

import numpy as np
import pytest
from problems import camera, problem, scanner

import ekfslam
from ekfslam.dataset import Prior
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.filters.family import EkfIdeal, EkfOc, Iekf
from ekfslam.filters.online import ONLINE
from ekfslam.filters.variants import ALONE, NAMES
from ekfslam.registry import resolve

TEAM = [name for code, name in enumerate(NAMES) if code not in ALONE]
ROUND_OFF = {"rtol": 0, "atol": 1e-9}


@pytest.fixture(scope="module")
def cloister():
    return ekfslam.simulate("cloister", seed=4, noise=0.5)


def same(ours, theirs):
    """Poses, covariances and map; landmarks are numbered in order of discovery by both."""
    np.testing.assert_allclose(ours.online.poses, theirs.online.poses, **ROUND_OFF)
    np.testing.assert_allclose(ours.online.covariances, theirs.online.covariances, **ROUND_OFF)
    np.testing.assert_allclose(ours.step_nis, theirs.step_nis, rtol=0, atol=1e-6)


@pytest.mark.parametrize("method", ["nearest", "joint", "maximum-likelihood"])
@pytest.mark.parametrize("name", [name for name in NAMES if name != "ekf-oc"])
def test_who_is_recognised_beyond_doubt_might_as_well_be_known(name, method, cloister):
    """The gates see the innovation in the covariance that the correction then uses."""
    found = resolve(name, association=method, accept=0.9999999, new=0.99999999).estimate(cloister)
    assert set(np.unique(found.innovations.decision)) == {0, 1}
    same(found, resolve(name).estimate(cloister))


def test_an_oc_filter_that_sees_all_knows_what_it_sees_next(cloister):
    found = EkfOc(association="nearest", accept=0.9999999, new=0.99999999).estimate(cloister)
    same(found, EkfOc().estimate(cloister))


@pytest.mark.parametrize("name", ONLINE)
def test_step_by_step_with_the_same_numbers(name, cloister):
    slam = ekfslam.EkfSlam(prior=cloister.prior, estimator=name)
    whole = resolve(name).estimate(cloister)
    for k, step in enumerate(cloister.steps()):
        slam.predict(step.increment, step.covariance)
        slam.observe(step.observations)
        np.testing.assert_allclose(slam.pose, whole.online.poses[k], **ROUND_OFF)
        np.testing.assert_allclose(
            slam.pose_covariance, whole.online.covariances[k], rtol=0, atol=1e-12
        )
    order = np.argsort(slam.landmarks.ids)
    np.testing.assert_array_equal(slam.landmarks.ids[order], whole.landmarks.ids)
    np.testing.assert_allclose(
        slam.landmarks.positions[order], whole.landmarks.positions, **ROUND_OFF
    )


@pytest.mark.parametrize("name", ONLINE)
def test_between_motion_and_look_the_pose_is_the_predicted_one(name, cloister):
    slam = ekfslam.EkfSlam(prior=Prior([1, 2, 0.5], np.diag([0.1, 0.2, 0.01])), estimator=name)
    slam.predict([0.5, 0.1, 0.3], np.diag([0.01, 0.02, 0.003]))
    plain = ekfslam.EkfSlam(prior=Prior([1, 2, 0.5], np.diag([0.1, 0.2, 0.01])))
    plain.predict([0.5, 0.1, 0.3], np.diag([0.01, 0.02, 0.003]))
    np.testing.assert_allclose(slam.pose, plain.pose, rtol=0, atol=1e-14)
    np.testing.assert_allclose(slam.pose_covariance, plain.pose_covariance, rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ONLINE)
def test_the_rest_is_as_if_a_deleted_landmark_were_never_used_again(name, cloister):
    """What a filter remembers of each landmark moves up with it."""
    steps = list(cloister.steps())
    gone = int(steps[3].observations.landmark[0])
    runs = [ekfslam.EkfSlam(prior=cloister.prior, estimator=name) for _ in range(2)]
    for k, step in enumerate(steps[:60]):
        seen = step.observations
        if k > 20:
            seen = type(seen)(*(column[seen.landmark != gone] for column in seen))
        for slam in runs:
            slam.predict(step.increment, step.covariance)
            slam.observe(seen)
        if k == 20:
            runs[1].delete(gone)
    np.testing.assert_allclose(runs[0].pose, runs[1].pose, **ROUND_OFF)
    kept, less = (slam.landmarks for slam in runs)
    rest = kept.ids != gone
    np.testing.assert_array_equal(kept.ids[rest], less.ids)
    np.testing.assert_allclose(kept.positions[rest], less.positions, **ROUND_OFF)
    np.testing.assert_allclose(kept.covariances[rest], less.covariances, **ROUND_OFF)


@pytest.mark.parametrize("name", TEAM)
def test_a_team_without_noise_is_where_it_truly_is(name):
    data = ekfslam.simulate("team", seed=1, draw=0.0)
    estimate = resolve(name).estimate(data)
    truth = np.array([robot.truth for robot in data.robots])
    np.testing.assert_allclose(estimate.online.poses, truth, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", [NAMES[code] for code in ALONE])
def test_one_robot_is_not_a_team(name):
    with pytest.raises(UnsupportedError, match=f"{name} is for a single robot, there are 3"):
        resolve(name).estimate(ekfslam.simulate("team", seed=1))


@pytest.mark.parametrize("name", NAMES[1:])
def test_what_they_do_not_take_is_said(name):
    with pytest.raises(UnsupportedError, match=f"{name} needs sensors that determine a point"):
        resolve(name).estimate(ekfslam.simulate("cloister-bearing", seed=1))
    with pytest.raises(UnsupportedError, match=f"{name} needs initiation 'mapped'"):
        resolve(name, initiation="infinite").estimate(problem(scanner()))


def test_a_robocentric_filter_has_no_place_for_what_is_tentative():
    data = problem(camera()).without_identities()
    with pytest.raises(UnsupportedError, match="confirm"):
        resolve("ekf-robocentric", confirm=2).estimate(data)


def test_the_ideal_filter_needs_the_truth():
    with pytest.raises(UnsupportedError, match="needs the truth"):
        EkfIdeal().estimate(ekfslam.load("victoria-park"))


@pytest.mark.parametrize("name", ["ekf-oc", "ekf-ideal", "gtsam-batch"])
def test_what_cannot_run_step_by_step(name):
    with pytest.raises(UnknownNameError, match="step by step"):
        ekfslam.EkfSlam(estimator=name)


@pytest.mark.parametrize(
    ("option", "value"),
    [("iterations", 0), ("iterations", 2.5), ("iterations", True), ("tolerance", -1.0)],
)
def test_options_of_the_iteration(option, value):
    with pytest.raises(InputError, match=option):
        Iekf(**{option: value})


def test_one_iteration_is_the_plain_filter(cloister):
    same(Iekf(iterations=1).estimate(cloister), resolve("ekf").estimate(cloister))
