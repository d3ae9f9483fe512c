"""What statistics over runs need of each run: each number against what it is made of."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, Observations, Robot
from ekfslam.errors import InputError
from ekfslam.estimates import Decision, Estimate, Innovations, LandmarkEstimates, Trajectory
from ekfslam.evaluation import run_metrics
from ekfslam.evaluation.run_metrics import RUN_METRICS
from ekfslam.evaluation.tables import summary_rows
from ekfslam.evaluation.whiteness import whitened, whiteness
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

COUNT = 40
SKIP = 7
LOW, HIGH = chi2.ppf([0.025, 0.975], 3)


def covariances_of(rng, count, scale=0.3):
    factors = scale * rng.normal(size=(count, 3, 3))
    return factors @ np.swapaxes(factors, 1, 2) + 1e-3 * np.eye(3)


@pytest.fixture
def dataset():
    """Along a curve, some metres from the origin."""
    increments = np.tile([0.5, 0.0, 0.1], (COUNT - 1, 1))
    truth = geo.integrate([8.0, -6.0, 1.0], increments)
    motion = MotionModel("odometry", covariance=1e-4 * np.eye(3))
    return Dataset(
        "curve",
        (Robot(motion, increments, truth=truth),),
        np.arange(COUNT) * 0.5,
        (Sensor("xy", np.eye(2), name="camera"),),
        Observations([], np.zeros((0, 2))),
        seed=4,
    )


@pytest.fixture
def estimate(dataset, rng):
    """Both series, off by draws of their own covariances; the start is exactly known."""

    def drawn(scale):
        covariances = covariances_of(rng, COUNT, scale)
        errors = np.array([rng.multivariate_normal(np.zeros(3), each) for each in covariances])
        covariances[0], errors[0] = 0.0, 0.0
        return Trajectory(dataset.truth + errors, covariances)

    nis, dof = np.full(COUNT, np.nan), np.zeros(COUNT, dtype=int)
    nis[3:], dof[3:] = rng.chisquare(4, COUNT - 3), 4
    return Estimate(
        "both",
        "curve",
        "known",
        drawn(0.3),
        drawn(0.1),
        step_nis=nis,
        step_dof=dof,
        graph_error=30.0,
        graph_dof=55,
    )


def by_hand(run, truth, part, invariant=False):
    """Mean NEES of some coordinates over the kept steps, with inverses."""
    values = []
    for pose, true, P in zip(run.poses[SKIP:], truth[SKIP:], run.covariances[SKIP:], strict=True):
        error = pose - true
        error[2] = np.arctan2(np.sin(error[2]), np.cos(error[2]))
        if invariant:
            turn, angle = geo.rotation(-error[2]), -error[2]
            V = np.array([[np.sin(angle), np.cos(angle) - 1], [1 - np.cos(angle), np.sin(angle)]])
            xi = np.linalg.solve(V / angle, true[:2] - turn @ pose[:2])
            error = np.array([*xi, angle])
            T = np.array([[1, 0, -pose[1]], [0, 1, pose[0]], [0, 0, 1.0]])
            P = np.linalg.inv(T) @ P @ np.linalg.inv(T).T
        e, C = error[part], P[np.ix_(part, part)]
        values.append(e @ np.linalg.inv(C) @ e)
    return np.array(values)


@pytest.mark.parametrize("name", ["online", "smoothed"])
def test_nees_by_coordinates_is_that_of_the_inverses(dataset, estimate, name):
    row = dict(zip(estimate.series, run_metrics(dataset, estimate, skip=SKIP), strict=True))[name]
    series, truth = estimate.series[name], dataset.truth
    pose, invariant = by_hand(series, truth, [0, 1, 2]), by_hand(series, truth, [0, 1, 2], True)
    expected = {
        "nees_pose_mean_kept": pose.mean(),
        "nees_pose_invariant_mean_kept": invariant.mean(),
        "nees_pose_invariant_final": invariant[-1],
        "nees_position_mean_kept": by_hand(series, truth, [0, 1]).mean(),
        "nees_position_invariant_mean_kept": by_hand(series, truth, [0, 1], True).mean(),
        "nees_heading_mean_kept": by_hand(series, truth, [2]).mean(),
        "nees_pose_inside_95_kept": np.mean((pose > LOW) & (pose < HIGH)),
        "nees_pose_invariant_inside_95_kept": np.mean((invariant > LOW) & (invariant < HIGH)),
    }
    for column, value in expected.items():
        assert row[column] == pytest.approx(value, rel=1e-8), column
    # The heading alone is the same in both coordinates.
    assert by_hand(series, truth, [2], True).mean() == pytest.approx(row["nees_heading_mean_kept"])


def test_errors_and_sigmas(dataset, estimate):
    row = run_metrics(dataset, estimate, skip=SKIP)[0]
    error = geo.additive_error(dataset.truth, estimate.online.poses)
    final = estimate.online.covariances[-1]
    expected = {
        "steps_skipped": SKIP,
        "position_mse_kept_m2": np.mean(np.linalg.norm(error[SKIP:, :2], axis=1) ** 2),
        "heading_mse_kept_rad2": np.mean(error[SKIP:, 2] ** 2),
        "final_position_error_m": np.linalg.norm(error[-1, :2]),
        "final_heading_error_rad": abs(error[-1, 2]),
        "final_position_sigma_m": np.sqrt(final[0, 0] + final[1, 1]),
        "final_heading_sigma_rad": np.sqrt(final[2, 2]),
    }
    for column, value in expected.items():
        assert row[column] == pytest.approx(value, rel=1e-12), column


def test_without_a_skip_the_numbers_are_those_of_the_summary(dataset, estimate):
    rows = run_metrics(dataset, estimate)
    summary = summary_rows(dataset, estimate)
    assert len(rows) == len(summary) == 2
    for row, (_, whole) in zip(rows, summary.iterrows(), strict=True):
        assert row["nees_pose_mean_kept"] == whole["nees_pose_mean"]
        assert row["nees_pose_invariant_mean_kept"] == whole["nees_pose_invariant_mean"]
        assert row["nees_pose_inside_95_kept"] == whole["nees_pose_inside_95"]
        rms = np.sqrt(row["position_mse_kept_m2"])
        assert rms == pytest.approx(whole["ate_position_rmse_m"], rel=1e-12)
    online, smoothed = rows
    ratio = online["nis_sum"] / online["nis_dof_sum"]
    assert ratio == pytest.approx(summary["nis_per_dof"][0], rel=1e-15)
    assert online["nis_dof_sum"] == 4 * (COUNT - 3)
    assert smoothed["nis_sum"] is None
    assert (online["graph_dof"], smoothed["graph_dof"]) == (None, 55)


def test_the_distance_to_the_reference_is_in_its_covariance(dataset, estimate, rng):
    P = covariances_of(rng, COUNT)
    away = np.array([0.2, -0.1, 2 * np.pi + 0.05])  # a turn more is no distance
    reference = Estimate("batch", "curve", smoothed=Trajectory(estimate.online.poses - away, P))
    row = run_metrics(dataset, estimate, reference)[0]
    gap = np.array([0.2, -0.1, 0.05])
    expected = gap @ np.linalg.solve(P[-1], gap)
    assert row["gap_final_mahalanobis2"] == pytest.approx(expected, rel=1e-9)
    itself = Estimate("batch", "curve", smoothed=estimate.smoothed)
    assert run_metrics(dataset, estimate, itself)[1]["gap_final_mahalanobis2"] == 0.0
    for empty in (
        None,
        Estimate("b", "curve"),
        Estimate("b", "curve", smoothed=Trajectory(P[:, 0])),
    ):
        assert run_metrics(dataset, estimate, empty)[0]["gap_final_mahalanobis2"] is None


# Empty numbers ----------------------------------------------------------------------------------


def test_every_row_has_every_column_and_an_estimate_without_series_has_one(dataset, estimate):
    failed = Estimate("gone", "curve", status="failed", message="no reason")
    bare = Estimate("bare", "curve", online=Trajectory(dataset.truth))
    without = replace(dataset, robots=(replace(dataset.robot, truth=None),))
    for data in (dataset, without):
        for record in (failed, bare, estimate):
            rows = run_metrics(data, record)
            assert len(rows) == len(summary_rows(data, record))
            assert all(list(row) == list(RUN_METRICS) for row in rows)
            assert not any(value != value for row in rows for value in row.values())
    assert set(run_metrics(dataset, failed)[0].values()) == {None}
    assert {k for k, v in run_metrics(without, bare)[0].items() if v is not None} == {
        "steps_skipped"
    }
    blind = run_metrics(without, estimate)[0]
    assert blind["nees_pose_mean_kept"] is blind["final_position_error_m"] is None
    assert blind["final_position_sigma_m"] > 0


def test_a_pose_that_is_none_leaves_errors_empty_and_overflow_does_not_warn(dataset, estimate):
    poses = estimate.online.poses.copy()
    poses[20] = np.nan
    lost = replace(estimate, online=replace(estimate.online, poses=poses))
    row = run_metrics(dataset, lost, skip=SKIP)[0]
    assert row["position_mse_kept_m2"] is None
    assert row["nees_pose_mean_kept"] > 0
    huge = replace(estimate, online=replace(estimate.online, poses=1e200 * poses))
    assert run_metrics(dataset, huge)[0]["final_position_error_m"] == np.inf


@pytest.mark.parametrize("skip", [-1, COUNT, 1.5, True, "5"])
def test_a_skip_that_leaves_nothing_is_refused(dataset, estimate, skip):
    with pytest.raises(InputError, match="skip"):
        run_metrics(dataset, estimate, skip=skip)


def test_an_estimate_of_another_size_is_refused(dataset, estimate):
    with pytest.raises(InputError, match="step_nis"):
        run_metrics(dataset, replace(estimate, step_nis=np.zeros(3)))


def test_rows_of_several_robots_are_in_the_order_of_the_summary(dataset, estimate):
    aside = dataset.truth + np.array([0.0, 10.0, 0.0])
    team = replace(dataset, robots=(dataset.robot, replace(dataset.robot, truth=aside)))
    poses = np.stack([estimate.online.poses, aside + np.array([0.3, 0.4, -0.2])])
    covariances = np.stack([estimate.online.covariances, estimate.smoothed.covariances])
    pair = Estimate("pair", "curve", "known", Trajectory(poses, covariances))
    rows, summary = run_metrics(team, pair), summary_rows(team, pair)
    means = [row["nees_pose_mean_kept"] for row in rows]
    np.testing.assert_array_equal(means, summary["nees_pose_mean"])
    assert means[0] == run_metrics(dataset, estimate)[0]["nees_pose_mean_kept"]
    assert rows[1]["final_position_error_m"] == pytest.approx(0.5)
    assert rows[1]["final_heading_error_rad"] == pytest.approx(0.2)


# Whiteness --------------------------------------------------------------------------------------


def seen(dataset, rows, sensors=None, robots=None):
    """The dataset with observations (step, landmark) and further columns."""
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    sensors = dataset.sensors if sensors is None else sensors
    robots = dataset.robots if robots is None else robots
    observations = Observations(values=np.ones((len(rows), 2)), **columns)
    return replace(dataset, observations=observations, sensors=sensors, robots=robots)


def met(innovation, S, landmark, decision=None):
    count = len(landmark)
    decision = np.full(count, Decision.ACCEPTED) if decision is None else np.asarray(decision)
    record = Innovations(decision, np.asarray(landmark), np.asarray(innovation), np.asarray(S))
    return Estimate("filter", "curve", "known", innovations=record)


def drawn(rng, dataset, correlation=0.0, landmarks=6):
    """Innovations of landmarks at every step, of covariances of their own, an AR(1) in time."""
    rows = [{"step": k, "landmark": m} for k in range(COUNT) for m in range(landmarks)]
    factors = rng.normal(size=(len(rows), 2, 2)) + 2 * np.eye(2)
    white = rng.normal(size=(COUNT, landmarks, 2))
    for k in range(1, COUNT):
        white[k] = correlation * white[k - 1] + np.sqrt(1 - correlation**2) * white[k]
    innovation = np.einsum(
        "nij,nj->ni", np.linalg.cholesky(factors @ factors.mT), white.reshape(-1, 2)
    )
    landmark = [row["landmark"] for row in rows]
    return seen(dataset, rows), met(innovation, factors @ factors.mT, landmark), white


def test_whitening_has_the_identity_for_covariance_and_keeps_nis(rng):
    factors = rng.normal(size=(50, 2, 2))
    S = factors @ factors.mT + 0.1 * np.eye(2)
    nu = rng.normal(size=(50, 2))
    white = whitened(nu, S, np.full(50, 2))
    expected = [np.linalg.solve(np.linalg.cholesky(s), v) for s, v in zip(S, nu, strict=True)]
    np.testing.assert_allclose(white, expected, rtol=1e-9)
    one = whitened(nu, S, np.full(50, 1))
    np.testing.assert_allclose(one[:, 0], nu[:, 0] / np.sqrt(S[:, 0, 0]), rtol=1e-15)
    assert not one[:, 1].any()
    assert np.isnan(whitened(nu[:1], -S[:1], np.array([2]))).any()


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_sums_are_those_of_the_pairs_and_see_correlation(rng, dataset, correlation):
    data, estimate, white = drawn(rng, dataset, correlation)
    sums = whiteness(data, estimate)
    before, after = white[:-1], white[1:]
    expected = [np.sum(before * after), np.sum(before**2), np.sum(after**2), before.size]
    np.testing.assert_allclose(sums, expected, rtol=1e-9)
    rho, sd = sums.cross / np.sqrt(sums.before * sums.after), 1 / np.sqrt(sums.terms)
    assert abs(rho - correlation) < 4 * sd
    assert (rho > 10 * sd) == (correlation > 0)


def test_rho_of_white_innovations_scatters_as_it_should(rng, dataset):
    """Over 200 runs the variance of rho is 1 / terms within four of its own sigmas."""
    rhos = []
    for _ in range(200):
        data, estimate, _ = drawn(rng, dataset)
        sums = whiteness(data, estimate)
        rhos.append(sums.cross / np.sqrt(sums.before * sums.after) * np.sqrt(sums.terms))
    assert np.var(rhos) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 200))
    assert np.mean(rhos) == pytest.approx(0.0, abs=4 / np.sqrt(200))


def test_pairs_are_of_one_landmark_one_sensor_and_neighbouring_looks(dataset):
    sensors = (Sensor("xy", np.eye(2), name="a"), Sensor("bearing", [[1.0]], name="b"))
    rows = [
        {"step": 1, "landmark": 1, "sensor": 0},
        {"step": 1, "landmark": 2, "sensor": 0},
        {"step": 3, "landmark": 1, "sensor": 0},  # the sensor's next look: a pair with the first
        {"step": 3, "landmark": 1, "sensor": 1},  # the other sensor's first
        {"step": 5, "landmark": 2, "sensor": 0},  # landmark 2 missed a look: no pair
        {"step": 5, "landmark": 1, "sensor": 0},  # a pair, but it was rejected
        {"step": 6, "landmark": 1, "sensor": 1},  # a pair of bearings
    ]
    columns = [row | {"values": None} for row in rows]
    values = np.array([[1.0, 0.0 if row["sensor"] else 1.0] for row in rows])
    observations = Observations(
        [row["step"] for row in columns],
        values,
        [row["landmark"] for row in columns],
        [row["sensor"] for row in columns],
    )
    data = replace(dataset, observations=observations, sensors=sensors)
    nu = np.array([[1.0, 2], [9, 9], [3, 5], [7, np.nan], [9, 9], [9, 9], [-2, np.nan]])
    decision = np.full(7, Decision.ACCEPTED)
    decision[5] = Decision.REJECTED
    estimate = met(nu, np.tile(4.0 * np.eye(2), (7, 1, 1)), [1, 2, 1, 1, 2, 1, 1], decision)
    sums = whiteness(data, estimate)
    expected = [(1 * 3 + 2 * 5 - 7 * 2) / 4, (1 + 4 + 49) / 4, (9 + 25 + 4) / 4, 3]
    np.testing.assert_allclose(sums, expected, rtol=1e-15)


def test_whiteness_is_of_the_robot_that_is_asked_for(dataset):
    rows = [
        {"step": k, "landmark": -1 if other else 4, "robot": r, "observed_robot": other - 1}
        for k in (1, 2)
        for r, other in ((0, 0), (0, 2), (1, 0))
    ]
    data = seen(dataset, rows, robots=(dataset.robot, dataset.robot))
    nu = np.array([[1.0, 0], [0, 2], [3, 0], [1, 0], [0, 5], [4, 0]])
    S = np.tile(np.eye(2), (6, 1, 1))
    estimate = met(nu, S, [-1 if row["observed_robot"] >= 0 else 4 for row in rows])
    # Robot 0 saw the landmark and the other robot, robot 1 the landmark.
    np.testing.assert_allclose(whiteness(data, estimate, 0), [11, 5, 26, 4])
    np.testing.assert_allclose(whiteness(data, estimate, 1), [12, 9, 16, 2])
    assert whiteness(data, replace(estimate, innovations=None)) is None


def test_sums_of_whiteness_are_in_the_online_row(rng, dataset, estimate):
    data, seen_by, _ = drawn(rng, dataset)
    record = replace(estimate, innovations=seen_by.innovations)
    online, smoothed = run_metrics(data, record)
    sums = whiteness(data, seen_by)
    assert [online[f"white_{name}"] for name in sums._fields] == list(sums)
    assert smoothed["white_terms"] is None
    none = replace(
        record, innovations=None, landmarks=LandmarkEstimates(np.array([1]), np.ones((1, 2)))
    )
    assert run_metrics(data, none)[0]["white_cross"] is None
