"""Landmarks seen by bearings or ranges alone: when they enter a graph, and what it then says."""

from dataclasses import replace

import numpy as np
import pytest
from problems import (
    DenseSmoother,
    assert_solves,
    compass,
    first_steps,
    gap,
    near,
    problem,
    rows_kept,
    scanner,
    sonar,
    stacked,
)

from baselines.association import Association
from baselines.batch import GtsamBatch
from baselines.dead_reckoning import DeadReckoning
from baselines.isam2 import GtsamIsam2
from baselines.landmark_graph import LandmarkGraph
from ekfslam import geometry as geo
from ekfslam.estimates import OK, Decision, LandmarkEstimates
from ekfslam.models.fix import fix
from ekfslam.simulation import simulate

SENSORS = {
    "compass": (compass(),),
    "compass turned": (compass(0, 0, 1.0),),
    "compass displaced": (compass(0.4, -0.2, 1.0),),
    "sonar": (sonar(),),
    "sonar displaced": (sonar(0.4, -0.2, 1.0),),
    "compass and sonar": (compass(0.4, -0.2, 1.0), sonar(-0.3, 0.2, 0.0)),
    "all three": (scanner(0.1, 0.2, 0.3), compass(0.4, -0.2, 1.0), sonar(-0.3, 0.2, 0.0)),
}
EAGER = GtsamIsam2(relinearize_threshold=1e-9, relinearize_skip=1, final_updates=10)


def batch(start, **options):
    return GtsamBatch(initial=start, relative_tolerance=1e-15, **options)


# The graph ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SENSORS)
def test_the_error_of_the_graph_is_ours_wherever_it_is_evaluated(name, rng):
    dataset = problem(*SENSORS[name])
    graphed, dense = LandmarkGraph(dataset, Association.known(dataset)), DenseSmoother(dataset)
    for _ in range(5):
        there = near(dataset, rng, 0.5)
        poses, points = there.online.poses, there.landmarks.positions
        places = dict(zip(there.landmarks.ids.tolist(), points, strict=True))
        values = graphed.values(poses[None], places, graphed.rows)
        residuals = dense.residuals(np.concatenate([poses.ravel(), points.ravel()]))
        expected = 0.5 * residuals @ residuals
        assert graphed.graph().error(values) == pytest.approx(expected, rel=1e-10)
    assert graphed.dof(graphed.rows) == len(residuals) - (3 * 10 + 2 * 5)


@pytest.mark.parametrize("name", SENSORS)
def test_batch_and_eager_isam2_are_the_dense_optimum_with_its_covariances(name):
    dataset = problem(*SENSORS[name])
    for smoother in (batch(near(dataset)), EAGER):
        estimate = smoother.estimate(dataset)
        assert_solves(estimate, dataset)
        assert estimate.landmarks.ids.tolist() == [3, 5, 8, 13, 21]
        assert "left out" not in estimate.message


@pytest.mark.parametrize("name", ["cloister-bearing", "cloister-range", "two-sensors"])
def test_the_residual_is_what_the_noise_says(name):
    """2 error / dof is 1 within its sampling error sqrt(2 / dof)."""
    estimate = GtsamBatch(marginals=False).estimate(simulate(name, seed=2))
    ratio = 2 * estimate.graph_error / estimate.graph_dof
    assert abs(ratio - 1) < 4 * np.sqrt(2 / estimate.graph_dof)


@pytest.mark.parametrize("name", ["cloister-bearing", "cloister-range"])
def test_without_noise_isam2_returns_the_truth(name):
    """No prior on a distance stands against it."""
    dataset = simulate(name, seed=1, draw=0.0)
    estimate = GtsamIsam2(marginals=False).estimate(dataset)
    for trajectory in estimate.series.values():
        error = geo.additive_error(dataset.truth, trajectory.poses)
        np.testing.assert_allclose(error, 0, rtol=0, atol=1e-9)
    truth = dict(zip(dataset.true_map.ids.tolist(), dataset.true_map.positions, strict=True))
    positions = np.array([truth[i] for i in estimate.landmarks.ids.tolist()])
    np.testing.assert_allclose(estimate.landmarks.positions, positions, rtol=0, atol=1e-9)


# What is never determined -------------------------------------------------------------------------


def rarely(seldom, sensors):
    """Landmarks that are seen but once, (landmark, sensor, step); and the same without them."""
    dataset = problem(*sensors)
    seen = dataset.observations
    often = ~np.isin(seen.landmark, [landmark for landmark, _, _ in seldom])
    keep = often.copy()
    for landmark, sensor, step in seldom:
        keep |= (seen.landmark == landmark) & (seen.sensor == sensor) & (seen.step == step)
    return rows_kept(dataset, keep), rows_kept(dataset, often)


@pytest.mark.parametrize(
    ("seldom", "sensors", "note"),
    [
        ([(8, 0, 4)], (compass(),), "1 of 5 landmarks never determined by bearings alone"),
        ([(8, 0, 4)], (sonar(),), "1 of 5 landmarks never determined by ranges alone"),
        (
            [(8, 0, 4), (13, 1, 6)],
            (compass(0.4, -0.2, 1.0), sonar()),
            "2 of 5 landmarks never determined by bearings and ranges alone",
        ),
    ],
)
def test_a_landmark_that_is_never_determined_is_left_out_and_told(seldom, sensors, note):
    dataset, without = rarely(seldom, sensors)
    start = near(dataset)  # which knows all landmarks, but not from these sightings
    for smoother in (batch(start), EAGER):
        estimate = smoother.estimate(dataset)
        assert_solves(estimate, without)
        assert estimate.message.endswith(f"{note}: left out")
        left = np.isin(dataset.observations.landmark, [landmark for landmark, _, _ in seldom])
        decision = estimate.innovations.decision
        assert (decision[left] == Decision.REJECTED).all()
        assert (decision[~left] != Decision.REJECTED).all()
        assert (estimate.innovations.landmark[left] == -1).all()
        assert estimate.graph_dof == len(without.observations) - 2 * len(estimate.landmarks)


def test_ranges_from_a_straight_path_leave_the_side_open():
    dataset = problem(sonar(), turn=0.0, noise=0.0)
    expected = DeadReckoning().estimate(dataset)
    for smoother in (batch(near(dataset)), EAGER):
        estimate = smoother.estimate(dataset)
        assert estimate.status == OK
        assert "5 of 5 landmarks never determined by ranges alone: left out" in estimate.message
        assert len(estimate.landmarks) == estimate.graph_dof == 0
        np.testing.assert_allclose(
            estimate.smoothed.covariances, expected.online.covariances, rtol=0, atol=1e-6
        )


def test_full_sightings_need_no_such_words():
    dataset = problem(scanner(0.4, -0.2, 1.0))
    for smoother in (batch(near(dataset), marginals=False), GtsamIsam2(marginals=False)):
        assert "enter" not in smoother.estimate(dataset).message


# When landmarks enter -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["compass displaced", "sonar"])
def test_isam2_keeps_sightings_back_until_they_determine_a_landmark(name):
    dataset = problem(*SENSORS[name])
    estimate = GtsamIsam2().estimate(dataset)
    seen, decision = dataset.observations, estimate.innovations.decision
    entered = {}
    for landmark in (3, 5, 8, 13, 21):
        rows = np.flatnonzero(seen.landmark == landmark)
        (new,) = np.flatnonzero(decision[rows] == Decision.NEW)
        assert new > 0
        assert (decision[rows[:new]] == Decision.DELAYED).all()
        assert (decision[rows[new + 1 :]] == Decision.ACCEPTED).all()
        entered[landmark] = int(seen.step[rows[new]])
    assert len(set(entered.values())) > 1
    for count in range(1, 11):
        part = GtsamIsam2().estimate(first_steps(dataset, count))
        inside = [landmark for landmark, step in entered.items() if step < count]
        assert part.landmarks.ids.tolist() == inside
        online = part.online.poses, part.online.covariances
        whole = estimate.online.poses[:count], estimate.online.covariances[:count]
        np.testing.assert_allclose(online[0], whole[0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(online[1], whole[1], rtol=0, atol=1e-14)


def test_batch_keeps_nothing_back():
    dataset = problem(compass())
    decision = batch(near(dataset)).estimate(dataset).innovations.decision
    _, first = np.unique(dataset.observations.landmark, return_index=True)
    assert set(np.flatnonzero(decision == Decision.NEW)) == set(first)
    assert (np.delete(decision, first) == Decision.ACCEPTED).all()


def test_a_range_and_bearing_lets_earlier_bearings_in():
    """From a displaced sensor: its pose back then enters together with the landmark."""
    dataset = problem(compass(0.4, -0.2, 1.0), scanner(-0.3, 0.1, -2.0))
    seen = dataset.observations
    early = (seen.sensor == 0) & (seen.step == 2)
    late = (seen.sensor == 1) & (seen.step >= 6)
    dataset = rows_kept(dataset, (seen.landmark != 8) | early | late)
    estimate = EAGER.estimate(dataset)
    assert_solves(estimate, dataset)
    rows = np.flatnonzero(dataset.observations.landmark == 8)
    assert estimate.innovations.decision[rows[:3]].tolist() == [
        Decision.DELAYED,
        Decision.NEW,
        Decision.ACCEPTED,
    ]
    assert_solves(batch(near(dataset)).estimate(dataset), dataset)


# The start of the batch ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["compass displaced", "sonar displaced", "all three"])
def test_what_the_start_does_not_know_is_put_where_its_sightings_say(name):
    dataset = problem(*SENSORS[name])
    start = near(dataset)
    few = LandmarkEstimates(start.landmarks.ids[:2], start.landmarks.positions[:2])
    whole, part = (batch(s).estimate(dataset) for s in (start, replace(start, landmarks=few)))
    assert gap(part, whole) < 1e-6
    assert part.landmarks.ids.tolist() == [3, 5, 8, 13, 21]


def test_the_batch_takes_the_associations_that_a_filter_kept_for_later():
    dataset = problem(compass())
    own = EAGER.estimate(dataset)
    assert (own.innovations.decision == Decision.DELAYED).any()
    start = replace(own, association="of its own", estimator="filter")
    estimate = batch(start).estimate(dataset)
    assert estimate.association == "of its own"
    assert_solves(estimate, dataset)
    np.testing.assert_allclose(stacked(estimate), stacked(own), rtol=0, atol=1e-6)


@pytest.mark.parametrize("seed", [0, 2])
def test_landmarks_enter_when_the_poses_as_isam2_knows_them_now_say_so(seed):
    """Two landmarks correct the poses; the others have bearings alone."""
    dataset = problem(scanner(), compass(0.4, -0.2, 1.0), seed=seed)
    seen = dataset.observations
    dataset = rows_kept(dataset, (seen.sensor == 0) == np.isin(seen.landmark, [3, 5]))
    seen, sightings = dataset.observations, dataset.sightings
    decision = GtsamIsam2(marginals=False).estimate(dataset).innovations.decision
    entered = {
        int(seen.landmark[row]): int(seen.step[row])
        for row in np.flatnonzero(decision == Decision.NEW)
    }
    for k in range(1, max(entered.values()) + 1):
        before = GtsamIsam2(marginals=False).estimate(first_steps(dataset, k)).smoothed.poses
        poses = np.vstack([before, geo.compose(before[-1], dataset.moves.deltas[0, k])])
        for landmark in (8, 13, 21):
            some = np.flatnonzero((seen.landmark == landmark) & (seen.step <= k))
            frames = geo.compose(poses[seen.step[some]], sightings.mount[some])
            noise = sightings.covariance[some, 0, 0]
            determined = fix(sightings.kind[some], frames, seen.values[some], noise)[0]
            if k <= entered[landmark]:
                assert determined == (k == entered[landmark])
