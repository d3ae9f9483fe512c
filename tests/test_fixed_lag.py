"""The fixed-lag smoother: iSAM2 that forgets, and loses nothing where the problem is linear."""

import numpy as np
import pytest
from problems import DenseSmoother, camera, compass, near, problem, scanner, sonar

import ekfslam
from baselines.fixed_lag import GtsamFixedLag
from baselines.isam2 import GtsamIsam2
from ekfslam import geometry as geo
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.estimates import FAILED, OK, Decision
from ekfslam.filters.ekf import Ekf
from ekfslam.registry import resolve
from ekfslam.simulation import simulate

NEVER = {"relinearize_threshold": 1e9}
EAGER = {"relinearize_threshold": 1e-9, "relinearize_skip": 1}

PROBLEMS = {
    "scanner": problem(scanner()),
    "scanners displaced": problem(scanner(0.4, -0.2, 1.0), scanner(-0.3, 0.1, -2.0)),
    "camera": problem(camera(0.4, -0.2, 1.0)),
    "known start": problem(scanner(0.4, -0.2, 1.0), known_start=True),
    "scanners that meet": problem(scanner(0.4, -0.2, 1.0), robots=3, meet=(0,)),
    "cameras that meet": problem(camera(), robots=2, meet=(0,)),
    "compass and scanner": problem(compass(0.4, -0.2, 1.0), scanner()),
}


def assert_equal(ours, theirs, sure):
    """Online series and map of two smoothers, with their covariances."""
    assert ours.status == theirs.status == OK, ours.message
    error = geo.additive_error(theirs.online.poses, ours.online.poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=sure)
    np.testing.assert_array_equal(ours.landmarks.ids, theirs.landmarks.ids)
    for mine, other in (
        (ours.landmarks.positions, theirs.landmarks.positions),
        (ours.online.covariances, theirs.online.covariances),
        (ours.landmarks.covariances, theirs.landmarks.covariances),
    ):
        np.testing.assert_allclose(mine, other, rtol=0, atol=sure)


@pytest.mark.parametrize("name", PROBLEMS)
def test_with_a_lag_as_long_as_the_run_it_is_isam2(name):
    dataset = PROBLEMS[name]
    for options in ({}, EAGER):
        long = GtsamFixedLag(lag=9, **options).estimate(dataset)
        assert_equal(long, GtsamIsam2(**options).estimate(dataset), 1e-7)


@pytest.mark.parametrize("lag", [1, 2, 5])
@pytest.mark.parametrize("name", PROBLEMS)
def test_if_nothing_is_linearised_anew_marginalisation_loses_nothing(name, lag):
    """The linear problem of iSAM2, of which poses that are gone have been eliminated."""
    dataset = PROBLEMS[name]
    short = GtsamFixedLag(lag=lag, **NEVER).estimate(dataset)
    assert_equal(short, GtsamIsam2(**NEVER).estimate(dataset), 1e-7)


def test_what_a_short_lag_loses_is_of_second_order():
    gaps, scales = [], (1.0, 0.5, 0.25, 0.125)
    for scale in scales:
        dataset = problem(scanner(), noise=scale)
        short, long = (GtsamFixedLag(lag=n, **EAGER).estimate(dataset) for n in (2, 9))
        gaps.append(np.linalg.norm(short.online.poses[-1] - long.online.poses[-1]))
    assert 1.7 < np.polyfit(np.log(scales), np.log(gaps), 1)[0] < 2.3


def test_a_lag_lies_between_the_filter_and_isam2():
    dataset = simulate("loop-15-rb", seed=3)
    full = GtsamIsam2(marginals=False).estimate(dataset).online.poses
    runs = [GtsamFixedLag(lag=n, marginals=False).estimate(dataset) for n in (1, 10, 100)]
    runs.insert(0, Ekf().estimate(dataset))
    gaps = [np.sqrt(np.mean((run.online.poses - full)[:, :2] ** 2)) for run in runs]
    assert gaps == sorted(gaps, reverse=True)


@pytest.mark.parametrize("lag", [1, 20])
def test_landmarks_stay_however_long_they_were_not_seen(lag):
    """And are known by their identity when the loop closes."""
    dataset = simulate("park", seed=1)
    estimate = GtsamFixedLag(lag=lag).estimate(dataset)
    step, landmark = dataset.observations.step, dataset.observations.landmark
    gone = [np.diff(np.unique(step[landmark == i])).max() for i in np.unique(landmark)]
    assert max(gone) > 5 * lag
    np.testing.assert_array_equal(estimate.landmarks.ids, np.unique(landmark))
    assert (estimate.innovations.decision == Decision.NEW).sum() == len(estimate.landmarks)
    error = geo.additive_error(dataset.truth, estimate.online.poses)[5:]
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(estimate.online.covariances[5:]), error)
    assert nees.mean() < 9  # a wrong return would be a hundred sigmas off


@pytest.mark.parametrize("sensor", [scanner(0.4, -0.2, 1.0), camera()])
@pytest.mark.parametrize("robots", [1, 2])
def test_the_joint_covariance_is_that_of_the_dense_optimum(sensor, robots):
    meet = (0,) if robots > 1 else ()
    dataset = problem(sensor, robots=robots, meet=meet, noise=1e-6)  # so all linearise at the truth
    estimate = GtsamFixedLag(lag=2).estimate(dataset)
    truth = near(dataset)
    x = np.concatenate([truth.online.poses.ravel(), truth.landmarks.positions.ravel()])
    covariance = DenseSmoother(dataset).solve(x)[1]
    final = 30 * np.arange(robots)[:, None] + 27 + np.arange(3)
    order = np.concatenate([final.ravel(), np.arange(30 * robots, len(x))])
    expected = covariance[np.ix_(order, order)]
    np.testing.assert_allclose(
        estimate.joint_covariance, expected, rtol=0, atol=1e-4 * np.abs(expected).max()
    )
    size = 3 * robots
    of_map = estimate.joint_covariance[size:, size:]
    np.testing.assert_array_equal(estimate.landmarks.covariance, of_map)
    for i, block in enumerate(estimate.landmarks.covariances):
        np.testing.assert_array_equal(block, of_map[2 * i : 2 * i + 2, 2 * i : 2 * i + 2])
    last = np.reshape(estimate.online.covariances, (robots, -1, 3, 3))[:, -1]
    for robot in range(robots):
        at = slice(3 * robot, 3 * robot + 3)
        np.testing.assert_allclose(
            estimate.joint_covariance[at, at], last[robot], rtol=0, atol=1e-9 * last.max()
        )


def test_there_is_an_online_series_and_no_other():
    estimate = GtsamFixedLag(lag=3).estimate(PROBLEMS["scanner"])
    assert list(estimate.series) == ["online"]
    assert np.isnan(estimate.graph_error)
    assert np.isfinite(estimate.step_seconds).all()
    assert estimate.options["lag"] == 3


# Sightings that wait ------------------------------------------------------------------------------


def test_what_waits_for_longer_than_the_lag_is_not_used():
    dataset = simulate("cloister-bearing", seed=2)
    long, short = (GtsamFixedLag(lag=n, marginals=False).estimate(dataset) for n in (30, 1))
    assert "waited for longer" not in long.message
    assert (long.innovations.decision != Decision.REJECTED).all()
    assert short.status == OK
    decision, landmark = short.innovations.decision, short.innovations.landmark
    step = dataset.observations.step
    lost = int(short.message.split("; ")[-1].split()[0])
    assert f"{lost} sightings waited for longer than the lag of 1: not used" in short.message
    inside = np.isin(dataset.observations.landmark, short.landmarks.ids)
    assert 0 < len(short.landmarks) < 36
    # Of landmarks that entered: what waited was at most a step old when they did.
    for i in short.landmarks.ids.tolist():
        rows = np.flatnonzero(dataset.observations.landmark == i)
        (new,) = rows[decision[rows] == Decision.NEW]
        waited = rows[(rows < new) & (decision[rows] == Decision.DELAYED)]
        assert (step[waited] >= step[new] - 1).all()
        early = rows[step[rows] < step[new] - 1]
        assert (decision[early] == Decision.REJECTED).all()
        assert (landmark[early] == -1).all()
    assert (decision[~inside] == Decision.REJECTED).all()
    assert lost <= (decision == Decision.REJECTED).sum()


@pytest.mark.parametrize("sensor", [compass(0.4, -0.2, 1.0), sonar(0.4, -0.2, 1.0)])
def test_partial_sightings_with_a_lag_as_long_as_the_run(sensor):
    dataset = problem(sensor)
    assert_equal(GtsamFixedLag(lag=9).estimate(dataset), GtsamIsam2().estimate(dataset), 1e-7)


# Options and failures -----------------------------------------------------------------------------


def test_covariances_of_the_newest_pose_at_chosen_steps_or_none():
    dataset = PROBLEMS["scanner"]
    some = GtsamFixedLag(lag=3, marginal_every=4).estimate(dataset).online.covariances
    assert np.flatnonzero(np.isfinite(some).all(axis=(1, 2))).tolist() == [0, 4, 8, 9]
    none = GtsamFixedLag(lag=3, marginals=False).estimate(dataset)
    assert none.online.covariances is none.landmarks.covariances is none.joint_covariance is None


@pytest.mark.parametrize("lag", [0, -3, 2.5, float("inf"), "ten"])
def test_a_lag_is_a_whole_number_of_steps(lag):
    with pytest.raises(InputError, match="lag must be a"):
        GtsamFixedLag(lag=lag)


def test_it_is_found_by_name_with_its_options():
    smoother = resolve("gtsam-fixed-lag(lag=7, robust=huber)")
    assert smoother == GtsamFixedLag(lag=7, robust="huber")
    with pytest.raises(UnknownNameError):
        GtsamFixedLag(robust="tukey")


def test_an_indeterminate_system_is_a_row_that_names_the_variable():
    estimate = GtsamFixedLag(odometry_floor=1e-12).estimate(simulate("loop-15", seed=1))
    assert estimate.status == FAILED
    assert estimate.message.startswith("indeterminate system near ")


def test_it_takes_part_in_a_comparison():
    comparison = ekfslam.compare(
        [simulate("cloister", seed=1)], ["ekf", "gtsam-batch", "gtsam-fixed-lag(lag=5)"]
    )
    row = comparison.summary.set_index("estimator").loc["gtsam-fixed-lag(lag=5)"]
    assert (row["status"], row["series"]) == ("ok", "online")
    assert np.isfinite(row["ate_position_rmse_m"])


def test_a_team_is_as_sure_as_isam2_says():
    """gtsam's tree says otherwise after poses of several robots have left it together."""
    data = ekfslam.simulate("team", seed=0)
    sure = resolve("gtsam-isam2", marginal_every=20).estimate(data)
    ours = resolve("gtsam-fixed-lag", marginal_every=20).estimate(data)
    known = np.isfinite(ours.online.covariances[0, :, 0, 0])
    known[0] = False  # one of them starts exactly
    both = [
        np.sqrt(each.online.covariances[:, known][:, :, [0, 1, 2], [0, 1, 2]])
        for each in (ours, sure)
    ]
    # They linearise at different times, which moves a standard deviation by a few percent.
    np.testing.assert_allclose(both[0], both[1], rtol=0.1)
    joint = ours.joint_covariance[:9, :9]
    np.testing.assert_allclose(joint[:3, :3], ours.online.covariances[0, -1], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("name", ["gtsam-isam2", "gtsam-fixed-lag"])
@pytest.mark.parametrize("scenario", ["hard-loop", "circle"])
def test_two_noisy_wheels_without_slip_leave_no_system_indeterminate(name, scenario):
    """Their floor stands beside noise a thousand times larger."""
    short = ekfslam.load_scenario(scenario, changes={"path.repeat": 400})
    data = ekfslam.simulate(short, seed=0)
    estimate = resolve(name, marginal_every=50).estimate(data)
    assert estimate.status == OK, estimate.message
    batch = resolve("gtsam-batch").estimate(data)
    gap = geo.additive_error(batch.smoothed.poses[-1], estimate.online.poses[-1])
    sigmas = np.sqrt(np.diagonal(batch.smoothed.covariances[-1]))
    assert (np.abs(gap) < sigmas).all()
