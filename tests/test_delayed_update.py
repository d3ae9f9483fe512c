"""The delayed map update against the plain one: the same at every step, whatever is asked."""

import tracemalloc

import numpy as np
import pytest
from simulated import drawn
from stepwise import assert_same_bits

import ekfslam
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.filters import delayed, gaussian_map
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.family import EkfFej, EkfIdeal, EkfOc, EkfRi, EkfRobocentric, Iekf
from ekfslam.filters.online import EkfSlam

DELAYS = [1, 2, 7, 30]  # rows: fewer than a look has, or more than many have


def assert_same(one, other, tolerance=1e-9):
    """Two estimates agree: means, covariances, decisions, innovations."""
    np.testing.assert_array_equal(one.innovations.decision, other.innovations.decision)
    np.testing.assert_array_equal(one.innovations.landmark, other.innovations.landmark)
    np.testing.assert_array_equal(one.landmarks.ids, other.landmarks.ids)
    for pair in (
        (one.online.poses, other.online.poses),
        (one.online.covariances, other.online.covariances),
        (one.landmarks.positions, other.landmarks.positions),
        (one.landmarks.covariances, other.landmarks.covariances),
        (one.joint_covariance, other.joint_covariance),
        (one.innovations.innovation, other.innovations.innovation),
        (one.innovations.S, other.innovations.S),
        (one.step_nis, other.step_nis),
    ):
        np.testing.assert_allclose(*pair, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("update", ["joint", "sequential"])
@pytest.mark.parametrize("delay", DELAYS)
def test_a_delayed_update_is_the_plain_one(delay, update):
    dataset = drawn("park")
    plain = Ekf(update=update, delay=0).estimate(dataset)
    late = Ekf(update=update, delay=delay).estimate(dataset)
    assert_same(late, plain)
    # It was another path: rounding shows.
    assert (late.joint_covariance != plain.joint_covariance).any()


@pytest.mark.parametrize("estimator", [Iekf, EkfIdeal, EkfFej, EkfOc])
def test_filters_that_linearise_elsewhere_may_wait(estimator):
    dataset = drawn("loop-15")
    plain = estimator(delay=0).estimate(dataset)
    late = estimator(delay=20).estimate(dataset)
    assert_same(late, plain)
    assert (late.joint_covariance != plain.joint_covariance).any()


@pytest.mark.parametrize("estimator", [EkfRi, EkfRobocentric])
def test_filters_whose_motion_changes_the_map_do_not_wait(estimator):
    dataset = drawn("loop-15")
    plain, late = (estimator(delay=d).estimate(dataset) for d in (0, 20))
    assert_same(late, plain)


@pytest.mark.parametrize(
    "options",
    [
        {"association": "nearest"},
        {"association": "joint"},
        {"association": "global"},
        {"association": "mahalanobis-first"},
        {"association": "nearest", "matching": "one-by-one"},
        {"association": "nearest", "forget": 8},
        {"association": "nearest", "confirm": 2},
        {"known_gate": 0.9, "corrupt": 3},
    ],
    ids=str,
)
def test_recognition_and_deletion_see_the_map_as_it_is(options):
    dataset = drawn("park")
    plain = Ekf(**options, delay=0).estimate(dataset)
    assert_same(Ekf(**options, delay=30).estimate(dataset), plain)


@pytest.mark.parametrize(
    ("scenario", "options"),
    [
        ("cloister-bearing", {}),
        ("cloister-bearing", {"bearings": "naive"}),
        ("cloister-range", {}),
        ("cloister-range", {"ranges": "bank"}),
        ("two-sensors", {"initiation": "infinite"}),
        ("loop-15", {"initiation": "allocated"}),
        ("team", {}),
    ],
    ids=str,
)
def test_partial_views_and_teams(scenario, options):
    dataset = drawn(scenario)
    plain = Ekf(**options, delay=0).estimate(dataset)
    # Digits are lost whichever way it is done: with a variance for infinity, and in points that
    # ranges cut at a small angle.
    lossy = "initiation" in options or scenario == "cloister-range"
    tolerance = 1e-7 if lossy else 1e-9
    assert_same(Ekf(**options, delay=30).estimate(dataset), plain, tolerance)


def test_whatever_is_asked_at_any_step_is_exact():
    dataset = drawn("park")
    filters = [EkfSlam(dataset.prior, delay=delay) for delay in (0, 25)]
    asked = np.random.default_rng(3).random(dataset.poses) < 0.1
    for k, step in enumerate(dataset.steps()):
        for slam in filters:
            slam.predict(step.increment, step.covariance)
            slam.observe(step.observations)
        plain, late = filters
        np.testing.assert_allclose(late.pose, plain.pose, atol=1e-9)
        np.testing.assert_allclose(late.pose_covariance, plain.pose_covariance, atol=1e-9)
        if asked[k]:
            one, other = late.landmarks, plain.landmarks
            np.testing.assert_allclose(one.positions, other.positions, atol=1e-9)
            np.testing.assert_allclose(one.covariance, other.covariance, atol=1e-9)
        elif k % 5 == 0:  # one landmark, while corrections wait
            some = plain.landmarks.ids[:3].tolist()
            for landmark in some:
                for a, b in zip(late.landmark(landmark), plain.landmark(landmark), strict=True):
                    np.testing.assert_allclose(a, b, atol=1e-9)


def test_one_landmark_is_read_without_an_update_of_the_map():
    dataset = drawn("park")
    slam = EkfSlam(dataset.prior, delay=30)
    for step in list(dataset.steps())[:60]:
        slam.predict(step.increment, step.covariance)
        slam.observe(step.observations)
    arrays = slam._engine.slam.arrays
    held = int(arrays.held[0])
    assert held > 0
    slam.landmark(int(slam._names()[0]))
    assert arrays.held[0] == held


@pytest.mark.parametrize("estimator", ["ekf-ri", "ekf-robocentric"])
def test_one_landmark_of_a_filter_with_coordinates_of_its_own(estimator):
    dataset = drawn("loop-15")
    slam = EkfSlam(dataset.prior, estimator=estimator)
    for step in list(dataset.steps())[:30]:
        slam.predict(step.increment, step.covariance)
        slam.observe(step.observations)
    whole = slam.landmarks
    position, covariance = slam.landmark(int(whole.ids[2]))
    np.testing.assert_array_equal(position, whole.positions[2])
    np.testing.assert_array_equal(covariance, whole.covariances[2])


def test_a_large_map_waits_by_itself_and_a_small_one_does_not():
    small, large = drawn("loop-15"), ekfslam.simulate("park", seed=1)
    assert 3 + 2 * len(small.true_map) < delayed.FROM <= 3 + 2 * len(large.true_map)
    for dataset, waits in ((small, False), (large, True)):
        default, plain = Ekf().estimate(dataset), Ekf(delay=0).estimate(dataset)
        assert_same(default, plain)
        assert (default.joint_covariance != plain.joint_covariance).any() == waits


def test_step_by_step_is_the_same_to_the_bit():
    dataset = drawn("park")
    assert_same_bits(Ekf(delay=30).estimate(dataset), dataset, delay=30)


# The map by itself -------------------------------------------------------------------------------


@pytest.fixture
def maps():
    """A map of two robots and five landmarks with three corrections waiting, and the same settled.

    In both, room is left, and something stands there.
    """

    def one(settled):
        random = np.random.default_rng(7)
        slam = gaussian_map.GaussianMap([ekfslam.Prior()] * 2, landmarks=8, late=4)
        half, late = random.normal(size=(16, 16)), random.normal(size=(3, 16))
        slam.arrays.late[:] = slam.arrays.covariance[:] = random.normal()
        late[:, :6] = 0.0
        whole = half @ half.T + 20.0 * np.eye(16) + late.T @ late
        slam.arrays.size[0] = 16
        slam.arrays.mean[:16] = random.normal(size=16)
        slam.arrays.covariance[:16, :16] = np.triu(whole - late.T @ late * settled)
        if not settled:
            slam.arrays.late[:3, :16] = late
            slam.arrays.held[0] = 3
        return slam

    return one(False), one(True)


ACTIONS = {
    "nothing": lambda slam: None,
    "a motion": lambda slam: slam.move(np.array([1.0, 0.2, 0.1]), np.diag([0.1, 0.2, 0.03]), 1),
    "a correction": lambda slam: slam.correct(
        np.array([8, 12]),
        np.random.default_rng(1).normal(size=(2, 2, 5)),
        np.ones((2, 2)),
        np.tile(np.eye(2), (2, 1, 1)),
    ),
    "a new landmark": lambda slam: slam.append(
        np.zeros(2), np.arange(6.0).reshape(2, 3), np.eye(2), np.eye(2)
    ),
    "a function in its place": lambda slam: slam.replace(8, np.ones(1), np.array([[1.0, 2.0]])),
    "a deletion": lambda slam: slam.remove(8),
    "more room": lambda slam: slam.reserve(50),
}


@pytest.mark.parametrize("action", ACTIONS)
def test_what_waits_changes_nothing_that_is_done_to_a_map(action, maps):
    for slam in maps:
        ACTIONS[action](slam)
    late, plain = maps
    np.testing.assert_allclose(late.mean, plain.mean, rtol=1e-12)
    for offset, size in ((0, 6), (8, 2), (11, 4)):
        np.testing.assert_allclose(late.block(offset, size), plain.block(offset, size), rtol=1e-9)
    np.testing.assert_allclose(late.covariance, plain.covariance, rtol=1e-9, atol=1e-9)


def test_a_map_is_surrendered_in_the_order_that_is_asked_for(maps):
    order = np.array([0, 1, 2, 3, 4, 5, 14, 15, 8, 9])
    expected = maps[1].covariance[np.ix_(order, order)]
    for slam in maps:
        np.testing.assert_allclose(slam.surrendered(order), expected, rtol=1e-9, atol=1e-9)


def test_two_threads_say_the_same_but_for_rounding():
    dataset = drawn("park")
    one, two = Ekf().estimate(dataset), Ekf(threads=2).estimate(dataset)
    assert_same(two, one)
    with pytest.raises(InputError, match="threads must be a whole number from 1 on, got 0"):
        Ekf(threads=0)


# Memory ------------------------------------------------------------------------------------------


def test_a_filter_takes_no_more_memory_than_its_covariance():
    """The number of landmarks is known ahead: 1.3 times what the covariance takes."""
    scenario = ekfslam.load_scenario("city", {"world.count": 600, "path.steps": 900})
    dataset = ekfslam.simulate(scenario, seed=1)
    Ekf().warm_up(dataset)
    tracemalloc.start()
    estimate = Ekf().estimate(dataset)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    stored = 8 * len(estimate.joint_covariance) ** 2
    assert len(estimate.landmarks) > 500
    assert stored < peak < 1.3 * stored
    assert np.shares_memory(estimate.joint_covariance, estimate.landmarks.covariance)


def test_a_map_that_cannot_fit_is_refused_with_its_size():
    with pytest.raises(UnsupportedError, match=r"covariance of 3000001 landmarks needs 288 TB"):
        gaussian_map.GaussianMap(ekfslam.Prior(), landmarks=3_000_000)
    slam = gaussian_map.GaussianMap(ekfslam.Prior())
    with pytest.raises(UnsupportedError, match="take fewer landmarks"):
        slam.reserve(6_000_000)
    assert slam.size == 3


@pytest.mark.parametrize("value", [-1, 1.5, True, "many", 10**6])
def test_a_delay_that_makes_no_sense(value):
    with pytest.raises(InputError, match="delay"):
        Ekf(delay=value)
