"""How a full observation starts a landmark: by its mapped error, or from infinity; never both."""

from dataclasses import replace

import numpy as np
import pytest
from textbook import two_sensors

from ekfslam import EkfSlam
from ekfslam.dataset import Observations, Prior, Sightings
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.evaluation import squared_mahalanobis
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import simulate

PRIOR = Prior([1.0, -2.0, 0.5], [[0.04, 0.01, 0], [0.01, 0.09, 0.01], [0, 0.01, 0.01]])
SENSOR = Sensor("range-bearing", [[0.01, 0.001], [0.001, 0.0004]], mount=[0.3, 0.1, 0.4])
VALUE = np.array([4.0, 0.7])
EPS = np.finfo(float).eps


def joint(estimate):
    """Joint covariance, landmarks in the order of their identities."""
    order = np.argsort(estimate.landmarks.ids)
    points = estimate.joint_covariance.shape[0] - 2 * len(order)
    where = points + 2 * order[:, None] + np.arange(2)
    rows = np.concatenate([np.arange(points), where.reshape(-1)])
    return estimate.joint_covariance[np.ix_(rows, rows)]


def assert_close(one, other, tolerance):
    """The same run but for so much, of which covariances relative to the largest."""
    np.testing.assert_allclose(one.online.poses, other.online.poses, rtol=0, atol=tolerance)
    positions = [
        estimate.landmarks.positions[np.argsort(estimate.landmarks.ids)]
        for estimate in (one, other)
    ]
    np.testing.assert_allclose(*positions, rtol=0, atol=tolerance)
    expected = joint(other)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(joint(one), expected, rtol=0, atol=tolerance * scale)
    np.testing.assert_array_equal(one.innovations.decision, other.innovations.decision)


# What stands for infinity -------------------------------------------------------------------------


def first_sighting(**options):
    """Joint covariance of pose and landmark after the first sighting, and the landmark."""
    slam = EkfSlam(PRIOR, **options)
    slam.observe(Sightings.of(SENSOR, [VALUE], [5]))
    np.testing.assert_array_equal(slam.pose, PRIOR.mean)
    return slam._engine.landmarks(np.array([5]))[1], slam.landmarks.positions[0]


def test_an_infinite_uncertainty_equals_the_mapped_error_but_for_a_numerical_loss():
    """Of the variance chosen: a prior's bias falls with it, round-off grows with it.

    ======== =================== ======= =================
    variance relative difference of that the prior
    ======== =================== ======= =================
    1e2      2e-3                all     ``P_l P_l' / v``
    1e4      2e-5                all
    1e6      2e-7                most
    1e8      2e-7                1 %     the rest is loss
    1e10     1e-5                none    of digits, eps v
    1e12     1e-3                none
    1e14     1e-1                none
    ======== =================== ======= =================
    """
    mapped, position = first_sighting()
    scale = np.abs(mapped).max()
    differences = {}
    for exponent in range(2, 15):
        variance = 10.0**exponent
        infinite, start = first_sighting(initiation="infinite", variance=variance)
        np.testing.assert_allclose(start, position, rtol=0, atol=1e-12)
        differences[exponent] = np.abs(infinite - mapped).max() / scale
    # An independent prior of variance v on the landmark takes P_l P_l' / v off the covariance.
    bias = np.abs(mapped[:, 3:] @ mapped[3:]).max() / scale
    for exponent in range(2, 6):
        prior = bias * 10.0**-exponent
        assert differences[exponent] == pytest.approx(prior, rel=0.02)
    for exponent in range(9, 15):
        # A difference of two numbers near v is known to eps v, up to the few roundings of each.
        assert 0.01 * EPS * 10**exponent < differences[exponent] < 10 * EPS * 10**exponent / scale
    assert differences[6] < 1e-6
    assert differences[14] > 1e-2


@pytest.mark.parametrize("name", ["loop-15", "cloister", "team"])
def test_whole_runs_are_the_same_from_infinity(name):
    dataset = simulate(name, seed=1)
    mapped, infinite = (Ekf(initiation=i).estimate(dataset) for i in ("mapped", "infinite"))
    assert_close(infinite, mapped, 1e-5)
    poses = [estimate.online.poses for estimate in (mapped, infinite)]
    assert (poses[0] != poses[1]).any()


@pytest.mark.parametrize("variance", [1e2, 1e6])
@pytest.mark.parametrize("name", ["loop-15", "cloister", "team"])
def test_landmarks_that_stand_there_from_the_start_are_those_that_come_in_from_infinity(
    name, variance
):
    """Principles of Robot Autonomy, 17.1.2, has all N of them in the state: the rest is order."""
    dataset = simulate(name, seed=1)
    options = {"variance": variance}
    infinite = Ekf(initiation="infinite", **options).estimate(dataset)
    allocated = Ekf(initiation="allocated", **options).estimate(dataset)
    assert_close(allocated, infinite, max(1e-9, 100 * EPS * variance))


def test_landmarks_that_were_never_seen_are_not_in_the_map():
    dataset = simulate(two_sensors(), seed=1)
    early = dataset.observations.step < 1
    seen = np.unique(dataset.observations.landmark[early])
    columns = ("step", "values", "landmark", "sensor")
    few = replace(
        dataset,
        observations=Observations(
            **{c: getattr(dataset.observations, c)[early] for c in columns},
        ),
        true_landmark=None,
    )
    estimate = Ekf(initiation="allocated").estimate(few)
    assert set(estimate.landmarks.ids) == set(seen)
    assert len(estimate.joint_covariance) == 3 + 2 * len(seen)
    engine_sees_all = Ekf(initiation="allocated").estimate(dataset)
    np.testing.assert_allclose(
        engine_sees_all.online.covariances[0], estimate.online.covariances[0], rtol=0, atol=1e-9
    )


def test_what_cannot_be_allocated():
    with pytest.raises(UnsupportedError, match="know all identities beforehand"):
        EkfSlam(initiation="allocated")
    with pytest.raises(InputError, match="initiation 'allocated' needs association 'known'"):
        Ekf("nearest", initiation="allocated")
    for name in ("two-sensors", "cloister-bearing", "cloister-range"):
        with pytest.raises(UnsupportedError, match="'allocated' needs sensors that determine a"):
            Ekf(initiation="allocated").estimate(simulate(name, seed=1))


def test_one_that_was_deleted_comes_in_again_from_infinity():
    """Wrong identities shake some landmarks until they are deleted; where they stood is gone."""
    dataset = simulate("loop-15", seed=1)
    landmark = dataset.observations.landmark.copy()
    rows = np.flatnonzero(landmark == landmark[0])[1:4]
    values = dataset.observations.values.copy()
    values[rows] += 5.0
    shaken = replace(dataset, observations=replace(dataset.observations, values=values))
    options = {"known_gate": 0.9999, "corrupt": 3}
    estimates = [Ekf(initiation=i, **options).estimate(shaken) for i in ("infinite", "allocated")]
    assert (estimates[0].innovations.decision == 1).sum() == len(estimates[0].landmarks) + 1
    assert_close(estimates[1], estimates[0], 1e-8)


# Never both ---------------------------------------------------------------------------------------


def mapped_once(pose=PRIOR, value=VALUE):
    """A map with one landmark, by its mapped error."""
    slam = GaussianMap(pose)
    point, wrt_pose, wrt_value = SENSOR.locate(slam.mean[:3], value)
    at = slam.append(point, wrt_pose, wrt_value, SENSOR.covariance)
    return slam, at


def used_again(slam, at, value=VALUE):
    """Correct with the measurement that has made the landmark, as printed algorithms do."""
    expected, wrt_pose, wrt_point = SENSOR.observe(slam.mean[:3], slam.mean[at : at + 2])
    H = np.concatenate([wrt_pose, wrt_point], axis=1)[None]
    innovation = SENSOR.difference(value, expected)[None]
    slam.correct(np.array([at]), H, innovation, SENSOR.covariance[None])


def given_pose(P):
    """Covariance of the landmark given the pose."""
    return P[3:, 3:] - P[3:, :3] @ np.linalg.solve(P[:3, :3], P[:3, 3:])


def test_a_measurement_used_twice_halves_the_covariance_given_the_pose():
    """Ciatto's Algorithm 1, and Algorithms 1 and 2 of Principles of Robot Autonomy, to the letter.

    The mean does not move, and neither does what is known of the pose.
    """
    slam, at = mapped_once()
    before, mean = slam.covariance, slam.mean.copy()
    used_again(slam, at)
    after = slam.covariance
    np.testing.assert_allclose(slam.mean, mean, rtol=0, atol=1e-14)
    np.testing.assert_allclose(given_pose(after), given_pose(before) / 2, rtol=1e-10)
    np.testing.assert_allclose(after[:3, :3], before[:3, :3], rtol=0, atol=1e-14)


def test_a_measurement_used_twice_makes_overconfident(rng):
    """The mean NEES of a landmark is 2 for what is right, and 4 for what is counted twice."""
    exactly, draws = Prior(PRIOR.mean), 400
    truth = SENSOR.locate(PRIOR.mean, VALUE)[0]
    noise = rng.multivariate_normal([0, 0], 0.01 * SENSOR.covariance, draws)
    precise = replace(SENSOR, covariance=0.01 * SENSOR.covariance)  # so that all is near linear
    once, twice = [], []
    for error in noise:
        slam, at = GaussianMap(exactly), 3
        point, wrt_pose, wrt_value = precise.locate(slam.mean[:3], VALUE + error)
        slam.append(point, wrt_pose, wrt_value, precise.covariance)
        once.append(squared_mahalanobis(slam.mean[3:] - truth, slam.block(3, 2)))
        expected, wrt_pose, wrt_point = precise.observe(slam.mean[:3], slam.mean[at:])
        H = np.concatenate([wrt_pose, wrt_point], axis=1)[None]
        innovation = precise.difference(VALUE + error, expected)[None]
        slam.correct(np.array([at]), H, innovation, precise.covariance[None])
        twice.append(squared_mahalanobis(slam.mean[3:] - truth, slam.block(3, 2)))
    spread = np.sqrt(4 / draws)  # of a mean of chi-squares of two degrees of freedom
    assert np.mean(once) == pytest.approx(2, abs=4 * spread)
    assert np.mean(twice) == pytest.approx(4, abs=8 * spread)


def test_the_filter_never_does():
    """Nor does a second look at once, of the same sensor, count as the first."""
    for options in ({}, {"initiation": "infinite"}):
        once, _ = first_sighting(**options)
        slam, at = mapped_once()
        np.testing.assert_allclose(once, slam.covariance, rtol=0, atol=1e-6)
        used_again(slam, at)
        assert np.abs(once - slam.covariance).max() > 1e-3
