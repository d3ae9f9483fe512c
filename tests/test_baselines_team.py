"""Several robots in one graph, and robots that see robots."""

from dataclasses import replace

import numpy as np
import pytest
from problems import (
    DenseSmoother,
    assert_solves,
    camera,
    compass,
    first_steps,
    near,
    problem,
    rows_kept,
    scanner,
    sonar,
    truths,
)

from baselines.association import Association
from baselines.batch import GtsamBatch
from baselines.dead_reckoning import DeadReckoning
from baselines.isam2 import GtsamIsam2
from baselines.landmark_graph import LandmarkGraph
from ekfslam import geometry as geo
from ekfslam.dataset import LandmarkMap
from ekfslam.estimates import OK, Decision, Innovations
from ekfslam.observations import Observations
from ekfslam.simulation import simulate

# Sensors, and which of them see robots.
TEAMS = {
    "scanners": ((scanner(),), (0,)),
    "scanners displaced": ((scanner(0.4, -0.2, 1.0),), (0,)),
    "compasses": ((scanner(), compass()), (1,)),
    "compasses displaced": ((scanner(), compass(0.4, -0.2, 1.0)), (1,)),
    "sonars": ((scanner(), sonar()), (1,)),
    "sonars displaced": ((scanner(), sonar(0.4, -0.2, 1.0)), (1,)),
    "who do not meet": ((scanner(),), ()),
}
CAMERAS = {
    "cameras": ((camera(0.4, -0.2, 1.0),), (0,)),
    "cameras on landmarks, scanners on robots": ((camera(), scanner(0.4, -0.2, 1.0)), (1,)),
    "scanners on landmarks, cameras on robots": ((scanner(), camera(0.4, -0.2, 1.0)), (1,)),
}
EAGER = GtsamIsam2(relinearize_threshold=1e-9, relinearize_skip=1, final_updates=10)


def team(name, robots=2, **options):
    sensors, meet = {**TEAMS, **CAMERAS}[name]
    dataset = problem(*sensors, robots=robots, meet=meet, **options)
    if "on landmarks" in name:  # else gtsam cannot mix them
        seen = dataset.observations
        dataset = rows_kept(dataset, (seen.sensor == 0) ^ (dataset.observed_robot >= 0))
        dataset = rows_kept(dataset, dataset.observations.sensor == (dataset.observed_robot >= 0))
    return dataset


def batch(start, **options):
    return GtsamBatch(initial=start, relative_tolerance=1e-15, **options)


# The optimum --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TEAMS)
def test_the_error_of_the_graph_is_ours_wherever_it_is_evaluated(name, rng):
    dataset = team(name, robots=3)
    graphed, dense = LandmarkGraph(dataset, Association.known(dataset)), DenseSmoother(dataset)
    for _ in range(3):
        there = near(dataset, rng, 0.5)
        poses, points = there.online.poses, there.landmarks.positions
        places = dict(zip(there.landmarks.ids.tolist(), points, strict=True))
        values = graphed.values(poses, places, graphed.rows)
        residuals = dense.residuals(np.concatenate([poses.ravel(), points.ravel()]))
        expected = 0.5 * residuals @ residuals
        assert graphed.graph().error(values) == pytest.approx(expected, rel=1e-10)
        read = geo.additive_error(graphed.poses_of(values), poses)
        np.testing.assert_allclose(read, 0, rtol=0, atol=1e-12)
    assert graphed.dof(graphed.rows) == len(residuals) - (3 * 30 + 2 * 5)


@pytest.mark.parametrize("known_start", [False, True])
@pytest.mark.parametrize("name", [*TEAMS, *CAMERAS])
def test_batch_and_eager_isam2_are_the_dense_optimum_with_its_covariances(name, known_start, rng):
    dataset = team(name, known_start=known_start)
    # The point through which a camera sees a robot makes the Hessian of Gauss and Newton another
    # one, by the share of the noise that is behind it.
    sure = 1e-4 if name in CAMERAS else 1e-7
    for smoother in (batch(near(dataset, rng, 0.05)), EAGER):
        estimate = smoother.estimate(dataset)
        assert estimate.smoothed.poses.shape == (2, 10, 3)
        assert_solves(estimate, dataset, sure)
        seen = DenseSmoother(dataset).residuals(
            np.concatenate([estimate.smoothed.poses.ravel(), estimate.landmarks.positions.ravel()])
        )
        assert estimate.graph_error == pytest.approx(0.5 * seen @ seen, rel=1e-9)


def test_three_robots_are_the_dense_optimum_too():
    dataset = team("scanners displaced", robots=3)
    assert_solves(batch(near(dataset)).estimate(dataset), dataset)


@pytest.mark.parametrize("seed", range(3))
def test_the_residual_is_what_the_noise_says(seed):
    estimate = GtsamBatch(marginals=False).estimate(simulate("team", seed=seed))
    ratio = 2 * estimate.graph_error / estimate.graph_dof
    assert abs(ratio - 1) < 4 * np.sqrt(2 / estimate.graph_dof)


# Symmetries ---------------------------------------------------------------------------------------


def test_robots_that_share_nothing_are_each_alone():
    ids = LandmarkMap([103, 105, 108], [[2, 3], [4, -1], [-2, 2]])
    one, other = problem(scanner(), seed=1), problem(scanner(), seed=2, landmarks=ids)
    columns = ("step", "values", "landmark")
    seen = one.observations, other.observations
    order = np.argsort(np.concatenate([s.step for s in seen]), kind="stable")
    joined = {c: np.concatenate([getattr(s, c) for s in seen])[order] for c in columns}
    robot = np.repeat([0, 1], [len(s) for s in seen])[order]
    both = replace(
        one,
        robots=(one.robot, other.robot),
        observations=Observations(**joined, robot=robot),
        true_landmark=joined["landmark"],
    )
    for make in (lambda start: batch(start, marginals=True), lambda start: EAGER):
        apart = [make(near(dataset)).estimate(dataset) for dataset in (one, other)]
        start = near(one)
        everywhere = replace(
            start,
            online=replace(start.online, poses=truths(both)),
            landmarks=replace(
                start.landmarks,
                ids=np.concatenate([start.landmarks.ids, ids.ids]),
                positions=np.concatenate([start.landmarks.positions, ids.positions]),
            ),
        )
        together = make(everywhere).estimate(both)
        for index, alone in enumerate(apart):
            mine = together.smoothed.of_robot(index)
            error = geo.additive_error(mine.poses, alone.smoothed.poses)
            np.testing.assert_allclose(error, 0, rtol=0, atol=1e-6)
            np.testing.assert_allclose(
                mine.covariances, alone.smoothed.covariances, rtol=0, atol=1e-7
            )
        points = np.concatenate([alone.landmarks.positions for alone in apart])
        np.testing.assert_allclose(together.landmarks.positions, points, rtol=0, atol=1e-6)
        assert together.graph_dof == sum(alone.graph_dof for alone in apart)


def test_it_does_not_matter_which_robot_is_the_first():
    dataset = team("scanners displaced")
    seen = dataset.observations
    swapped = replace(
        dataset,
        robots=dataset.robots[::-1],
        observations=replace(
            seen,
            robot=1 - seen.robot,
            observed_robot=np.where(seen.observed_robot >= 0, 1 - seen.observed_robot, -1),
        ),
    )
    for make in (lambda data: batch(near(data)), lambda data: EAGER):
        one, other = (make(data).estimate(data) for data in (dataset, swapped))
        error = geo.additive_error(one.smoothed.poses, other.smoothed.poses[::-1])
        np.testing.assert_allclose(error, 0, rtol=0, atol=1e-6)
        np.testing.assert_allclose(
            one.smoothed.covariances, other.smoothed.covariances[::-1], rtol=0, atol=1e-7
        )


def test_meeting_helps():
    """A sighting of another robot takes nothing away and tells something of both."""
    dataset = team("scanners")
    alone = rows_kept(dataset, dataset.observed_robot < 0)
    met, unmet = (batch(near(d)).estimate(d).smoothed.covariances for d in (dataset, alone))
    sizes = np.linalg.det(met[:, 1:]) / np.linalg.det(unmet[:, 1:])
    assert (sizes < 1).all()


# iSAM2 and dead reckoning step by step ------------------------------------------------------------


def test_the_online_series_of_isam2_knows_nothing_of_the_future():
    dataset = team("scanners displaced", robots=3)
    whole, part = (GtsamIsam2().estimate(d) for d in (dataset, first_steps(dataset, 6)))
    assert whole.online.poses.shape == (3, 10, 3)
    assert whole.online.covariances.shape == (3, 10, 3, 3)
    np.testing.assert_allclose(part.online.poses, whole.online.poses[:, :6], rtol=0, atol=1e-12)
    error = part.online.covariances - whole.online.covariances[:, :6]
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-14)
    last = geo.additive_error(whole.online.poses[:, -1], whole.smoothed.poses[:, -1])
    np.testing.assert_allclose(last, 0, rtol=0, atol=1e-12)
    assert (np.abs(whole.online.poses[:, 5] - whole.smoothed.poses[:, 5]) > 1e-6).any(axis=1).all()


def test_dead_reckoning_is_each_robot_alone():
    dataset = problem(scanner(), robots=3, meet=(0,))
    estimate = DeadReckoning().estimate(dataset)
    assert estimate.online.poses.shape == (3, 10, 3)
    for index, robot in enumerate(dataset.robots):
        mine = dataset.observations.robot == index
        one = rows_kept(dataset, mine & (dataset.observed_robot < 0))
        seen = replace(one.observations, robot=None, observed_robot=None)
        alone = DeadReckoning().estimate(replace(one, robots=(robot,), observations=seen))
        of_it = estimate.online.of_robot(index)
        np.testing.assert_array_equal(of_it.poses, alone.online.poses)
        np.testing.assert_array_equal(of_it.covariances, alone.online.covariances)


# Association --------------------------------------------------------------------------------------


def test_sightings_of_robots_are_accepted_and_of_no_landmark():
    dataset = team("scanners")
    for smoother in (batch(near(dataset)), GtsamIsam2()):
        made = smoother.estimate(dataset).innovations
        robots = dataset.observed_robot >= 0
        assert robots.any()
        assert (made.decision[robots] == Decision.ACCEPTED).all()
        np.testing.assert_array_equal(made.landmark, dataset.observations.landmark)


def test_sightings_of_robots_that_a_filter_rejected_are_not_used():
    dataset = team("scanners")
    robots = np.flatnonzero(dataset.observed_robot >= 0)
    decision = np.full(len(dataset.observations), Decision.ACCEPTED, dtype=np.int64)
    decision[robots[::2]] = Decision.REJECTED
    nan = np.full(len(decision), np.nan)
    met = Innovations(decision, dataset.observations.landmark, nan, nan)
    start = replace(near(dataset), association="gated", innovations=met)
    estimate = batch(start).estimate(dataset)
    assert estimate.status == OK
    assert_solves(estimate, rows_kept(dataset, decision == Decision.ACCEPTED))
    np.testing.assert_array_equal(estimate.innovations.decision[robots], decision[robots])
