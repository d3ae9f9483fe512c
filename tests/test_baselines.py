"""GTSAM's smoothers against a dense Gauss-Newton on the same problem, and against each other."""

from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest
from problems import DenseSmoother, assert_solves, camera, gap, near, problem, scanner, stacked
from textbook import first_poses

from baselines import keys
from baselines.association import Association
from baselines.batch import GtsamBatch
from baselines.dead_reckoning import DeadReckoning
from baselines.isam2 import GtsamIsam2
from baselines.landmark_graph import LandmarkGraph
from ekfslam import geometry as geo
from ekfslam.dataset import Observations, Prior
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import (
    FAILED,
    OK,
    Decision,
    Estimate,
    Innovations,
    LandmarkEstimates,
    Trajectory,
)
from ekfslam.filters.ekf import Ekf
from ekfslam.simulation import load_scenario, simulate

SENSORS = {
    "scanner": (scanner(),),
    "scanner turned": (scanner(0, 0, 1.0),),
    "scanner displaced": (scanner(0.4, -0.2, 1.0),),
    "two scanners displaced": (scanner(0.4, -0.2, 1.0), scanner(-0.3, 0.1, -2.0)),
    "one turned, one displaced": (scanner(0, 0, 1.0), scanner(-0.3, 0.1, -2.0)),
    "camera": (camera(),),
    "camera turned": (camera(0, 0, 1.0),),
    "camera displaced": (camera(0.4, -0.2, 1.0),),
    "two cameras": (camera(0.4, -0.2, 1.0), camera(-0.3, 0.1, -2.0)),
}


# The graph ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("known_start", [False, True])
@pytest.mark.parametrize("name", SENSORS)
def test_the_error_of_the_graph_is_ours_wherever_it_is_evaluated(name, known_start, rng):
    dataset = problem(*SENSORS[name], known_start=known_start)
    graphed, dense = LandmarkGraph(dataset, Association.known(dataset)), DenseSmoother(dataset)
    graph, rows = graphed.graph(), graphed.rows
    assert graphed.landmarks_of(rows) == dense.ids.tolist() == [3, 5, 8, 13, 21]
    for _ in range(5):
        there = near(dataset, rng, 0.5)
        poses, points = there.online.poses, there.landmarks.positions
        places = dict(zip(there.landmarks.ids.tolist(), points, strict=True))
        values = graphed.values(poses[None], places, rows)
        residuals = dense.residuals(np.concatenate([poses.ravel(), points.ravel()]))
        assert graph.error(values) == pytest.approx(0.5 * residuals @ residuals, rel=1e-10)
        read = geo.additive_error(graphed.poses_of(values)[0], poses)
        np.testing.assert_allclose(read, 0, rtol=0, atol=1e-12)
        ids, positions = graphed.map_of(values)
        assert ids.tolist() == [3, 5, 8, 13, 21]
        np.testing.assert_array_equal(positions, points)
    exact = 3 if known_start else 0  # a known start is no unknown
    assert graphed.dof(rows) == len(residuals) - (3 * 10 + 2 * 5 - exact)


@pytest.mark.parametrize("name", SENSORS)
def test_batch_is_the_dense_optimum_with_its_covariances(name, rng):
    dataset = problem(*SENSORS[name])
    start = near(dataset, rng, 0.1)
    assert_solves(GtsamBatch(initial=start, relative_tolerance=1e-15).estimate(dataset), dataset)


@pytest.mark.parametrize("name", ["two scanners displaced", "two cameras"])
def test_a_known_start_stays_known(name):
    dataset = problem(*SENSORS[name], known_start=True)
    estimate = GtsamBatch(initial=near(dataset), relative_tolerance=1e-15).estimate(dataset)
    assert_solves(estimate, dataset)
    np.testing.assert_allclose(estimate.smoothed.poses[0], dataset.prior.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(estimate.smoothed.covariances[0], 0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["two scanners displaced", "camera displaced"])
def test_isam2_that_always_relinearises_is_the_dense_optimum(name):
    dataset = problem(*SENSORS[name])
    eager = GtsamIsam2(relinearize_threshold=1e-9, relinearize_skip=1, final_updates=10)
    assert_solves(eager.estimate(dataset), dataset)


def test_noise_given_with_each_sighting_is_used():
    dataset = problem(scanner())
    rows = len(dataset.observations)
    growing = np.linspace(0.5, 2.0, rows)[:, None, None] * dataset.sensors[0].covariance
    given = replace(dataset, observations=replace(dataset.observations, covariance=growing))
    graphed = LandmarkGraph(given, Association.known(given))
    places = dict(zip(dataset.true_map.ids.tolist(), dataset.true_map.positions, strict=True))
    values = graphed.values(dataset.truth[None], places, graphed.rows)
    x = np.concatenate([dataset.truth.ravel(), dataset.true_map.positions.ravel()])
    whitened = DenseSmoother(dataset).residuals(x)[-2 * rows :].reshape(-1, 2)
    errors = np.sum(whitened**2, axis=1) / growing[:, 0, 0] * dataset.sensors[0].covariance[0, 0]
    factors = graphed.seen(range(rows), [], [])
    np.testing.assert_allclose([f.error(values) for f in factors], errors / 2, rtol=1e-10)


def test_scanners_and_cameras_in_one_graph_are_not_supported():
    dataset = problem(scanner(), camera())
    for smoother in (GtsamBatch(initial=near(dataset)), GtsamIsam2()):
        with pytest.raises(UnsupportedError, match="mix xy sightings of landmarks with others"):
            smoother.estimate(dataset)


def test_messages_name_variables():
    assert keys.key_name(keys.pose_key(17)) == "pose 17"
    assert keys.key_name(keys.pose_key(17, 2)) == "pose 17 of robot 2"
    assert keys.key_name(keys.landmark_key(5)) == "landmark 5"
    assert keys.key_name(keys.sensor_key(17, 0, 1)) == "pose 17 of sensor 1"
    assert keys.key_name(keys.sensor_key(17, 2, 1)) == "pose 17 of sensor 1 of robot 2"
    assert keys.key_name(keys.seen_key(40)) == "point of observation 40"


# At the optimum -----------------------------------------------------------------------------------


@cache
def drawn(name, **options):
    return simulate(name, seed=1, **options)


@pytest.mark.parametrize("name", ["cloister", "park"])
def test_the_residual_is_what_the_noise_says(name):
    """2 error / dof is 1 within its sampling error sqrt(2 / dof)."""
    estimate = GtsamBatch(marginals=False).estimate(drawn(name))
    ratio = 2 * estimate.graph_error / estimate.graph_dof
    assert abs(ratio - 1) < 4 * np.sqrt(2 / estimate.graph_dof)


def test_batch_reaches_the_same_optimum_from_either_start():
    dataset = drawn("loop-15")
    one = GtsamBatch(marginals=False).estimate(dataset)
    other = GtsamBatch(initial=GtsamIsam2(marginals=False), marginals=False).estimate(dataset)
    assert other.graph_error == pytest.approx(one.graph_error, rel=1e-9)
    assert gap(other, one) < 1e-5
    assert "from ekf" in one.message
    assert "from gtsam-isam2" in other.message
    given = GtsamBatch(initial=Ekf().estimate(dataset), marginals=False).estimate(dataset)
    np.testing.assert_array_equal(stacked(given), stacked(one))


def test_the_gap_between_filter_and_batch_is_of_second_order():
    gaps, scales = [], (1.0, 0.5, 0.25, 0.125)
    for scale in scales:
        dataset = drawn("cloister", noise=scale)
        ekf, batch = (e.estimate(dataset) for e in (Ekf(), GtsamBatch(marginals=False)))
        final = ekf.online.poses[-1] - batch.smoothed.poses[-1]
        points = ekf.landmarks.positions - batch.landmarks.positions
        gaps.append(np.sqrt(np.mean(np.concatenate([final[:2], points.ravel()]) ** 2)))
    exponent = np.polyfit(np.log(scales), np.log(gaps), 1)[0]
    assert 1.8 < exponent < 2.2


def test_filter_and_batch_are_equally_sure_where_the_noise_is_small():
    dataset = drawn("cloister", noise=0.125)
    ekf, batch = Ekf().estimate(dataset), GtsamBatch().estimate(dataset)
    for ours, theirs in (
        (ekf.online.covariances[-1], batch.smoothed.covariances[-1]),
        (ekf.landmarks.covariances, batch.landmarks.covariances),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=0.02 * np.abs(theirs).max())


def test_a_floor_is_put_under_singular_noise_and_told():
    loop = GtsamBatch(marginals=False).estimate(drawn("loop-15"))
    assert "odometry noise floored at 0.0001 (m, rad) in 400 of 400 steps" in loop.message
    assert "floored" not in GtsamBatch(marginals=False).estimate(drawn("cloister")).message
    dataset = problem(scanner())
    unsure = Prior(dataset.prior.mean, np.diag([0, 0, 0.04]))
    dataset = replace(dataset, robots=(replace(dataset.robot, prior=unsure),))
    assert "prior noise floored" in GtsamBatch(marginals=False).estimate(dataset).message


# iSAM2 step by step -------------------------------------------------------------------------------


def test_the_online_series_of_isam2_knows_nothing_of_the_future():
    dataset = drawn("cloister")
    whole, part = (GtsamIsam2().estimate(d) for d in (dataset, first_poses(dataset, 41)))
    np.testing.assert_allclose(part.online.poses, whole.online.poses[:41], rtol=0, atol=1e-12)
    error = part.online.covariances - whole.online.covariances[:41]
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(whole.online.poses[-1], whole.smoothed.poses[-1], rtol=0, atol=1e-12)
    assert np.abs(whole.online.poses[40] - whole.smoothed.poses[40]).max() > 1e-4
    batch = GtsamBatch(marginals=False).estimate(dataset)
    assert gap(whole, batch) < 0.05


def test_the_options_of_isam2_reach_it():
    dataset = drawn("cloister")
    errors = [
        GtsamIsam2(marginals=False, **options).estimate(dataset).graph_error
        for options in (
            {"relinearize_threshold": 10.0},
            {},
            {"relinearize_skip": 1},
            {"relinearize_threshold": 1e-4, "relinearize_skip": 1, "final_updates": 5},
        )
    ]
    assert errors == sorted(errors, reverse=True)
    assert len(set(errors)) == 4
    best = GtsamBatch(marginals=False).estimate(dataset).graph_error
    assert errors[-1] == pytest.approx(best, rel=1e-9)


def test_covariances_are_left_out_on_request():
    dataset = problem(scanner())
    batch, isam2 = GtsamBatch(marginals=False), GtsamIsam2(marginals=False)
    for estimate in (batch.estimate(dataset), isam2.estimate(dataset)):
        for trajectory in estimate.series.values():
            assert trajectory.covariances is None
        assert estimate.landmarks.covariances is None


# Dead reckoning -----------------------------------------------------------------------------------


def test_dead_reckoning_is_the_prediction_alone():
    dataset = problem(scanner())
    estimate = DeadReckoning().estimate(dataset)
    pose, P = dataset.prior.mean, dataset.prior.covariance
    deltas, noise = dataset.robot.increments
    for k in range(dataset.poses):
        np.testing.assert_allclose(estimate.online.poses[k], pose, rtol=0, atol=1e-13)
        np.testing.assert_allclose(estimate.online.covariances[k], P, rtol=0, atol=1e-13)
        if k < len(deltas):
            F, G = geo.compose_jacobians(pose, deltas[k])
            pose, P = geo.compose(pose, deltas[k]), F @ P @ F.T + G @ noise[k] @ G.T
    assert estimate.landmarks is None
    assert estimate.smoothed is None


# Association --------------------------------------------------------------------------------------


def test_association_of_an_estimate_is_what_it_used():
    """Also what it kept for later, and robots; not landmarks that it deleted on the way."""
    decision = [
        *(Decision.NEW, Decision.ACCEPTED, Decision.REJECTED, Decision.AMBIGUOUS),
        *(Decision.TENTATIVE, Decision.DELAYED, Decision.NEW, Decision.ACCEPTED),
        *(Decision.NEW, Decision.ACCEPTED, Decision.REJECTED),
    ]
    landmark = np.array([4, 4, 5, 6, 7, 8, 9, 9, 10, -1, -1])  # the last two show robots
    nan = np.full(11, np.nan)
    met = Innovations(np.array(decision), landmark, nan, nan)
    final = LandmarkEstimates(np.array([4, 8]), np.zeros((2, 2)), undetermined=np.array([10]))
    start = Estimate("ekf", "b", association="nearest", innovations=met, landmarks=final)
    association = Association.of(start)
    assert association.landmark.tolist() == [4, 4, -1, -1, -1, 8, -1, -1, 10, -1, -1]
    assert association.robots.tolist() == 9 * [False] + [True, False]
    assert association.rows.tolist() == [0, 1, 5, 8, 9]
    assert association.name == "nearest"
    assert association.notes == ("landmarks not in the final map of ekf: 1 left out",)
    with pytest.raises(UnsupportedError, match="made no associations"):
        Association.of(DeadReckoning().estimate(drawn("cloister")))


def test_a_landmark_without_a_usable_sighting_is_not_in_the_graph():
    dataset = problem(scanner())
    blank = np.where(dataset.observations.landmark == 8, -1, dataset.observations.landmark)
    some = replace(dataset, observations=replace(dataset.observations, landmark=blank))
    named = Ekf(association="known")
    for estimate in (
        GtsamBatch(initial=named).estimate(some),
        GtsamIsam2(association=named).estimate(some),
    ):
        assert estimate.status == OK
        assert estimate.landmarks.ids.tolist() == [3, 5, 13, 21]
        assert estimate.graph_dof == 2 * (blank >= 0).sum() - 2 * 4
    graphed = LandmarkGraph(some, Association.known(some))
    assert graphed.rows.tolist() == np.flatnonzero(blank >= 0).tolist()


def test_without_names_both_smoothers_take_the_decisions_of_the_filter():
    unnamed = simulate(replace(load_scenario("park"), association="unknown"), seed=1)
    ekf = Ekf().estimate(unnamed)
    for smoother in (GtsamBatch(marginals=False), GtsamIsam2(marginals=False)):
        estimate = smoother.estimate(unnamed)
        assert estimate.association == "nearest"
        np.testing.assert_array_equal(estimate.landmarks.ids, ekf.landmarks.ids)
        used = np.isin(ekf.innovations.decision, [Decision.ACCEPTED, Decision.NEW]).sum()
        assert estimate.graph_dof == 2 * used - 2 * len(ekf.landmarks)


def test_a_start_with_names_of_its_own_brings_its_associations():
    """The filter numbers landmarks as it finds them, not as the dataset names them."""
    start = Ekf(association="nearest").estimate(drawn("park"))
    estimate = GtsamBatch(initial=start, marginals=False).estimate(drawn("park"))
    assert estimate.association == "nearest"
    np.testing.assert_array_equal(estimate.landmarks.ids, start.landmarks.ids)
    assert np.abs(estimate.landmarks.positions - start.landmarks.positions).max() < 1


def test_without_sightings_the_optimum_is_dead_reckoning():
    dataset = problem(scanner())
    blind = replace(dataset, observations=Observations([], np.zeros((0, 2))), true_landmark=None)
    expected = DeadReckoning().estimate(blind)
    for smoother in (GtsamBatch(), GtsamIsam2()):
        estimate = smoother.estimate(blind)
        assert estimate.status == OK
        np.testing.assert_allclose(
            estimate.smoothed.poses, expected.online.poses, rtol=0, atol=1e-6
        )
        error = estimate.smoothed.covariances - expected.online.covariances
        np.testing.assert_allclose(error, 0, rtol=0, atol=1e-6)
        assert len(estimate.landmarks) == 0
        assert estimate.graph_dof == 0


# Failure is a row ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "smoother", [GtsamBatch(odometry_floor=1e-9), GtsamIsam2(odometry_floor=1e-9)]
)
def test_an_indeterminate_system_is_a_row_that_names_the_variable(smoother):
    estimate = smoother.estimate(drawn("loop-15"))
    assert estimate.status == FAILED
    assert estimate.smoothed is None
    assert estimate.message.startswith("indeterminate system near ")
    assert estimate.message.split()[-2] in ("pose", "landmark")
    assert estimate.message.split()[-1].isdigit()


def test_another_failure_of_gtsam_is_a_row_in_its_words(monkeypatch):
    def fail(*_):
        raise RuntimeError("out of\n  patience")

    monkeypatch.setattr(gtsam, "LevenbergMarquardtOptimizer", fail)
    estimate = GtsamBatch().estimate(problem(scanner()))
    assert estimate.status == FAILED
    assert estimate.message == "out of patience"


def test_stopping_early_is_told():
    estimate = GtsamBatch(max_iterations=1, marginals=False).estimate(drawn("cloister"))
    assert estimate.status == OK
    assert estimate.message.startswith("stopped at the limit of iterations; 1 iterations from ekf")


def test_a_start_without_a_map_is_no_start():
    with pytest.raises(UnsupportedError, match="dead-reckoning offers nothing to start from"):
        GtsamBatch(initial=DeadReckoning()).estimate(problem(scanner()))


def test_a_start_that_diverged_is_a_failure():
    lost = Estimate("lost", "small", online=Trajectory(np.full((10, 3), np.nan)))
    estimate = GtsamBatch(initial=lost).estimate(problem(scanner()))
    assert (estimate.status, estimate.message) == (FAILED, "the start, lost, is not finite")
    assert estimate.smoothed is None


def test_a_smoother_says_which_association_it_took():
    data = replace(problem(scanner()), true_landmark=None)
    for estimator in (GtsamBatch(marginals=False), GtsamIsam2(marginals=False)):
        made = estimator.estimate(data).innovations
        np.testing.assert_array_equal(made.landmark, data.observations.landmark)
        first = np.unique(made.landmark, return_index=True)[1]
        assert set(np.flatnonzero(made.decision == Decision.NEW)) == set(first)
        assert np.isnan(made.innovation).all()
