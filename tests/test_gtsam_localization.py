"""Poses smoothed on a map that is held: against dense Gauss-Newton on the poses alone."""

from dataclasses import replace

import numpy as np
import pytest
from numerics import central_difference
from problems import DenseSmoother, camera, compass, first_steps, problem, scanner, sonar
from test_localization import on_its_map

from baselines.association import Association
from baselines.batch import GtsamBatch
from baselines.dead_reckoning import DeadReckoning
from baselines.fixed_lag import GtsamFixedLag
from baselines.isam2 import GtsamIsam2
from baselines.landmark_graph import LandmarkGraph
from baselines.localization import GtsamLocalization
from ekfslam import geometry as geo
from ekfslam.dataset import Observations
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.estimates import FAILED, OK, Decision
from ekfslam.filters.localization import EkfLocalization
from ekfslam.simulation import simulate

SENSORS = {
    "scanner": (scanner(),),
    "scanner displaced": (scanner(0.4, -0.2, 1.0),),
    "two scanners": (scanner(0.4, -0.2, 1.0), scanner(-0.3, 0.1, -2.0)),
    "camera": (camera(0.4, -0.2, 1.0),),
    "compass": (compass(0.4, -0.2, 1.0),),
    "sonar": (sonar(0.4, -0.2, 1.0),),
    "all": (scanner(), camera(0.1, 0.2, 0.3), compass(-0.3, 0.1, -2.0), sonar(0.4, -0.2, 1.0)),
}
# Drawn, over what is stated. gtsam's Jacobian of a motion takes 1 - cos of the heading's residual,
# which loses its digits near 1e-5 rad, and covariances with them up to 5e-6: residuals are larger.
NOISE = 1.0
EXACT = {"relative_tolerance": 1e-15}
EAGER = {"relinearize_threshold": 1e-9, "relinearize_skip": 1, "final_updates": 10}


class DensePoses(DenseSmoother):
    """Least squares over the poses, landmarks at their places."""

    def residuals(self, x):
        places = self.dataset.known_map.positions
        return super().residuals(np.concatenate([x, places.ravel()]))

    def covariances(self, poses):
        """Of each pose, linearised at these; zero for an exactly known start."""
        free = np.ones(poses.reshape(-1, 3).shape, dtype=bool)
        starts = [not robot.prior.covariance.any() for robot in self.dataset.robots]
        free[:: self.dataset.poses][starts] = False
        J = central_difference(self.residuals, poses.ravel(), step=1e-3)[:, free.ravel()]
        whole = np.zeros((poses.size, poses.size))
        whole[np.ix_(free.ravel(), free.ravel())] = np.linalg.inv(J.T @ J)
        at = 3 * np.arange(poses.size // 3)[:, None] + np.arange(3)
        return whole[at[:, :, None], at[:, None, :]]


def assert_solves(estimate, dataset):
    """Means to 1e-6; covariances to 1e-6 beside the largest entry of each pose's."""
    assert estimate.status == OK, estimate.message
    poses, dense = estimate.smoothed.poses, DensePoses(dataset)
    error = geo.additive_error(dense.solve(poses.ravel())[0].reshape(poses.shape), poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-6)
    expected = dense.covariances(poses)
    found = estimate.smoothed.covariances.reshape(expected.shape)
    scale = np.abs(expected).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(
        (found - expected) / np.where(scale > 0, scale, 1.0), 0, rtol=0, atol=1e-6
    )


@pytest.mark.parametrize("known_start", [False, True])
@pytest.mark.parametrize("name", SENSORS)
def test_batch_is_the_dense_optimum_with_its_covariances(name, known_start):
    dataset = on_its_map(problem(*SENSORS[name], known_start=known_start, noise=NOISE))
    estimate = GtsamLocalization(**EXACT).estimate(dataset)
    assert_solves(estimate, dataset)
    assert estimate.landmarks is None
    assert estimate.online is None


@pytest.mark.parametrize("known_start", [False, True])
@pytest.mark.parametrize("name", SENSORS)
def test_isam2_that_always_relinearises_is_the_dense_optimum(name, known_start):
    dataset = on_its_map(problem(*SENSORS[name], known_start=known_start, noise=NOISE))
    assert_solves(GtsamLocalization("isam2", **EAGER).estimate(dataset), dataset)


@pytest.mark.parametrize("method", ["batch", "isam2"])
def test_a_team_is_solved_robot_by_robot(method):
    """Robots that see robots would tie them together; those sightings are left out."""
    team = on_its_map(problem(scanner(0.4, -0.2, 1.0), robots=3, meet=(0,), noise=NOISE))
    o, met = team.observations, team.observed_robot >= 0
    estimate = GtsamLocalization(method, **EXACT, **EAGER).estimate(team)
    assert (estimate.innovations.decision[met] == Decision.REJECTED).all()
    columns = ("step", "values", "landmark", "sensor", "robot")
    seen = Observations(**{name: getattr(o, name)[~met] for name in columns})
    assert_solves(estimate, replace(team, observations=seen, true_landmark=None))


def test_the_online_series_of_isam2_is_the_optimum_of_what_was_seen_so_far():
    dataset = on_its_map(problem(scanner(0.4, -0.2, 1.0), noise=0.1))
    online = GtsamLocalization("isam2", **EAGER).estimate(dataset).online
    for k in (1, 4, 9):
        part = first_steps(dataset, k + 1)
        x, covariance = DensePoses(part).solve(online.poses[: k + 1].ravel())
        # One step of Gauss-Newton per update leaves what the next would still correct.
        error = geo.additive_error(x[-3:], online.poses[k])
        sigmas = np.sqrt(np.diag(covariance)[-3:])
        assert np.abs(error / sigmas).max() < 0.05
        ratio = online.covariances[k] / covariance[-3:, -3:]
        np.testing.assert_allclose(np.diag(ratio), 1, rtol=0, atol=0.02)


@pytest.mark.parametrize("name", SENSORS)
def test_the_error_of_the_graph_is_ours_wherever_it_is_evaluated(name, rng):
    dataset = on_its_map(problem(*SENSORS[name]))
    shown = Association.on(dataset.known_map, dataset.observations.landmark, "known")
    graphed, dense = LandmarkGraph(dataset, shown, held=dataset.known_map), DensePoses(dataset)
    rows = graphed.rows.tolist()
    for _ in range(5):
        poses = dataset.truth + 0.5 * rng.normal(size=dataset.truth.shape)
        values = graphed.values(poses[None], {}, rows)
        residuals = dense.residuals(poses.ravel())
        error = graphed.graph(rows).error(values)
        assert error == pytest.approx(0.5 * residuals @ residuals, rel=1e-10)
        read = geo.additive_error(graphed.poses_of(values)[0], poses)
        np.testing.assert_allclose(read, 0, rtol=0, atol=1e-12)
        assert len(graphed.map_of(values)[0]) == 0
    assert graphed.dof(rows) == len(residuals) - poses.size


@pytest.mark.parametrize("method", ["batch", "isam2"])
def test_a_world_far_away_does_not_spoil_it(method):
    """A stiff prior beside coordinates of 1e5 m would."""
    dataset = on_its_map(problem(scanner(0.4, -0.2, 1.0), noise=0.5))
    motion = np.array([1e5, -2e5, 2.0])
    smoother = GtsamLocalization(method, **EXACT, **EAGER)
    here, there = (smoother.estimate(d).smoothed for d in (dataset, dataset.moved(motion)))
    error = geo.additive_error(geo.compose(motion, here.poses), there.poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-6)
    turned = geo.congruence(geo.heading_block(motion[2]), here.covariances)
    np.testing.assert_allclose(turned, there.covariances, rtol=0, atol=1e-6 * turned.max())


# Beside the filter -------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["batch", "isam2"])
def test_filter_and_smoother_agree_where_the_noise_is_small(method):
    dataset = on_its_map(simulate("cloister", seed=1, noise=0.125))
    ekf, graph = EkfLocalization().estimate(dataset), GtsamLocalization(method).estimate(dataset)
    sigmas = np.sqrt(np.diagonal(ekf.online.covariances[-1]))
    apart = geo.additive_error(graph.smoothed.poses[-1], ekf.online.poses[-1])
    assert np.abs(apart / sigmas).max() < 0.1
    ratio = np.diagonal(graph.smoothed.covariances[-1]) / sigmas**2
    np.testing.assert_allclose(ratio, 1, rtol=0, atol=0.02)


def test_the_gap_between_filter_and_batch_is_of_second_order():
    gaps, scales = [], (1.0, 0.5, 0.25, 0.125)
    for scale in scales:
        squares = []
        for seed in range(4):
            dataset = on_its_map(simulate("cloister", seed=seed, noise=scale))
            ekf = EkfLocalization().estimate(dataset)
            batch = GtsamLocalization(marginals=False, initial=ekf).estimate(dataset)
            squares.append((ekf.online.poses[-1] - batch.smoothed.poses[-1])[:2] ** 2)
        gaps.append(np.sqrt(np.mean(squares)))
    exponent = np.polyfit(np.log(scales), np.log(gaps), 1)[0]
    assert 1.7 < exponent < 2.3


def test_the_residual_is_what_the_noise_says():
    dataset = on_its_map(simulate("park", seed=2))
    for method in ("batch", "isam2"):
        estimate = GtsamLocalization(method, marginals=False).estimate(dataset)
        ratio = 2 * estimate.graph_error / estimate.graph_dof
        assert abs(ratio - 1) < 4 * np.sqrt(2 / estimate.graph_dof)


def test_it_is_slam_without_its_uncertain_map():
    """Knowing the map exactly, it is surer than a smoother that has to find it."""
    dataset = on_its_map(simulate("cloister", seed=1))
    held, free = GtsamLocalization().estimate(dataset), GtsamBatch().estimate(dataset)
    variances = [np.diagonal(e.smoothed.covariances[1:], axis1=1, axis2=2) for e in (held, free)]
    assert (variances[0] < variances[1]).all()


@pytest.mark.parametrize("kind", [GtsamBatch, GtsamIsam2, EkfLocalization])
def test_who_makes_a_map_does_not_look_at_the_known_one(kind):
    """Of the same data with and without it; the filter that needs it is the check of the check."""
    dataset = replace(simulate("cloister", seed=1), known_map=None)
    knowing = on_its_map(dataset)
    if kind is EkfLocalization:
        with pytest.raises(UnsupportedError):
            kind().estimate(dataset)
        return
    one, other = kind().estimate(dataset), kind().estimate(knowing)
    np.testing.assert_array_equal(one.smoothed.poses, other.smoothed.poses)
    np.testing.assert_array_equal(one.landmarks.positions, other.landmarks.positions)


# Association, start, and what fails --------------------------------------------------------------


@pytest.mark.parametrize("method", ["batch", "isam2"])
def test_unknown_association_is_taken_from_the_filter(method):
    dataset = on_its_map(simulate("cloister", seed=1)).without_identities()
    ekf = EkfLocalization().estimate(dataset)
    estimate = GtsamLocalization(method).estimate(dataset)
    assert estimate.association == ekf.association == "nearest"
    np.testing.assert_array_equal(estimate.innovations.landmark, ekf.innovations.landmark)
    np.testing.assert_array_equal(
        estimate.innovations.decision == Decision.ACCEPTED, ekf.innovations.landmark >= 0
    )
    other = GtsamLocalization(method, initial="ekf-localization(association=nearest-position)")
    assert other.estimate(dataset).association == "nearest-position"


@pytest.mark.parametrize("method", ["batch", "isam2"])
def test_a_start_that_does_not_know_the_map_cannot_say_who_is_seen(method):
    """Who maps landmarks names them as found, and a name of the map may be among those."""
    dataset = on_its_map(simulate("cloister", seed=1)).without_identities()
    for initial, reason in (
        ("ekf", "ekf names landmarks of a map of its own"),
        ("fastslam2(particles=3)", "fastslam2 names landmarks of a map of its own"),
        ("dead-reckoning", "dead-reckoning made no associations"),
    ):
        with pytest.raises(UnsupportedError, match=reason):
            GtsamLocalization(method, initial=initial).estimate(dataset)


@pytest.mark.parametrize("method", ["batch", "isam2"])
def test_what_is_not_on_the_map_is_not_used(method):
    dataset = problem(scanner())
    part = on_its_map(dataset, [13, 5])
    inside = np.isin(dataset.observations.landmark, [13, 5])
    estimate = GtsamLocalization(method).estimate(part)
    expected = np.where(inside, Decision.ACCEPTED, Decision.REJECTED)
    np.testing.assert_array_equal(estimate.innovations.decision, expected)
    assert estimate.graph_dof == 2 * inside.sum()
    none = GtsamLocalization(method).estimate(on_its_map(dataset, []))
    dead = DeadReckoning().estimate(dataset).online
    error = geo.additive_error(none.smoothed.poses, dead.poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-9)


def test_a_floor_is_put_under_singular_noise_and_told():
    dataset = on_its_map(simulate("loop-15", seed=1))
    for method in ("batch", "isam2"):
        estimate = GtsamLocalization(method).estimate(dataset)
        assert estimate.status == OK
        assert "odometry noise floored at 0.0001 (m, rad) in 400 of 400 steps" in estimate.message


def test_a_robust_loss_holds_out_wrong_identities():
    dataset = on_its_map(simulate("cloister", seed=1))
    wrong = dataset.observations.landmark.copy()
    rng = np.random.default_rng(1)
    few = rng.choice(len(wrong), len(wrong) // 20, replace=False)
    wrong[few] = (wrong[few] + 7) % 36
    seen = replace(dataset.observations, landmark=wrong)
    _, kept = np.unique(np.column_stack([seen.step, wrong]), axis=0, return_index=True)
    kept.sort()
    columns = {n: getattr(seen, n)[kept] for n in ("step", "values", "landmark", "sensor")}
    damaged = replace(dataset, observations=Observations(**columns), true_landmark=None)
    start = EkfLocalization().estimate(dataset)
    off = {}
    for robust in (None, "cauchy"):
        smoother = GtsamLocalization(initial=start, robust=robust, marginals=False)
        off[robust] = np.linalg.norm(
            (smoother.estimate(damaged).smoothed.poses - dataset.truth)[:, :2]
        )
    assert off["cauchy"] < 0.5 * off[None]


def test_a_start_that_is_not_finite_fails_with_a_word():
    dataset = on_its_map(simulate("cloister", seed=1, noise=0.0))
    estimate = GtsamLocalization().estimate(dataset)
    assert estimate.status == FAILED
    assert estimate.message == "the start, ekf-localization, is not finite"


def test_without_a_map_it_does_not_apply():
    for method in ("batch", "isam2"):
        with pytest.raises(UnsupportedError, match="by hand has no known map"):
            GtsamLocalization(method).estimate(problem(scanner()))


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"method": "fixed-lag"}, InputError, "batch or isam2"),
        ({"robust": "huge"}, UnknownNameError, "huber"),
        ({"robust": True}, UnknownNameError, "huber"),
        ({"robust_scale": 2.0}, InputError, "needs a kernel"),
        ({"marginal_every": 0}, InputError, "marginal_every"),
        ({"relinearize_skip": 0}, InputError, "relinearize_skip must be a whole number from 1"),
        ({"relinearize_threshold": np.nan}, InputError, "relinearize_threshold must be finite"),
        ({"relative_tolerance": "tight"}, InputError, "relative_tolerance must be a number"),
        ({"max_iterations": 2.5}, InputError, "max_iterations must be a whole number from 1"),
        ({"max_iterations": 2**31}, InputError, "max_iterations must be a whole number"),
        ({"final_updates": -1}, InputError, "final_updates must be a whole number from 0"),
        ({"odometry_floor": -1e-4}, InputError, "odometry_floor must be finite and not negative"),
        ({"marginals": "no"}, InputError, "marginals must be True or False, got 'no'"),
    ],
)
def test_senseless_options_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        GtsamLocalization(**options)


@pytest.mark.parametrize(
    ("kind", "option"),
    [
        (GtsamBatch, "max_iterations"),
        (GtsamIsam2, "relinearize_skip"),  # by which gtsam divides
        (GtsamFixedLag, "relinearize_skip"),
        (GtsamFixedLag, "lag"),
    ],
)
def test_so_they_are_by_all_smoothers(kind, option):
    with pytest.raises(InputError, match=f"{option} must be a whole number from 1"):
        kind(**{option: 0})
