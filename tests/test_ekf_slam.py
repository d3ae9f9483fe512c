"""The EKF-SLAM algorithm: against a textbook filter, least squares, invariances, itself online."""

import os
import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from simulated import past_points
from stepwise import assert_same_bits, online
from textbook import TextbookEkf, first_poses, two_sensors

from ekfslam import geometry as geo
from ekfslam.dataset import LandmarkMap, Observations, Prior, Sightings
from ekfslam.errors import InputError
from ekfslam.estimates import DIVERGED, Decision, Estimate
from ekfslam.filters import engine, gaussian_map
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.filters.online import EkfSlam
from ekfslam.filters.options import UPDATES
from ekfslam.models.sensors import Sensor
from ekfslam.observations import WIDTH
from ekfslam.simulation import load_scenario, simulate

TURN = np.array([50.0, -30.0, 2.0])


SCENARIOS = {
    "loop-15": lambda: load_scenario("loop-15"),
    "cloister": lambda: load_scenario("cloister"),
    "two-sensors": two_sensors,
}


def drawn(name):
    return simulate(SCENARIOS[name](), seed=1)


@cache
def textbook(name, update):
    """Estimate and linearisations of the textbook filter."""
    return TextbookEkf(update=update).linearizations(drawn(name))


def rows_of(estimate, ids):
    """Rows of the joint covariance for pose and landmarks in a given order."""
    where = {int(landmark): i for i, landmark in enumerate(estimate.landmarks.ids)}
    order = np.array([where[int(i)] for i in ids])
    return np.concatenate([np.arange(3), (3 + 2 * order[:, None] + np.arange(2)).reshape(-1)])


def assert_same_estimate(actual, expected, tolerance=0.0):
    """Equal trajectories, maps, joint covariances, decisions and innovations."""

    def close(a, b):
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)

    close(actual.online.poses[:, :2], expected.online.poses[:, :2])
    close(geo.wrap(actual.online.poses[:, 2] - expected.online.poses[:, 2]), 0)
    close(actual.online.covariances, expected.online.covariances)
    ids = expected.landmarks.ids
    assert set(actual.landmarks.ids) == set(ids)
    rows = rows_of(actual, ids)
    close(actual.joint_covariance[np.ix_(rows, rows)], expected.joint_covariance)
    close(actual.landmarks.positions[(rows[3::2] - 3) // 2], expected.landmarks.positions)
    np.testing.assert_array_equal(actual.innovations.decision, expected.innovations.decision)
    np.testing.assert_array_equal(actual.innovations.landmark, expected.innovations.landmark)
    close(actual.innovations.innovation, expected.innovations.innovation)
    close(actual.innovations.S, expected.innovations.S)


# Oracles ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("name", SCENARIOS)
def test_equals_the_textbook_filter(name, update):
    expected, _ = textbook(name, update)
    assert_same_estimate(Ekf(update=update).estimate(drawn(name)), expected, 1e-11)


@pytest.mark.parametrize("name", SCENARIOS)
def test_tells_the_linearisations_that_the_textbook_filter_uses(name):
    _, expected = textbook(name, "joint")
    _, actual = Ekf().linearizations(drawn(name))

    def difference(entry):
        return getattr(actual, entry) - getattr(expected, entry)

    for entry in ("event", "row", "robot", "step", "landmark", "target", "size", "rows"):
        np.testing.assert_array_equal(difference(entry), 0)
    for entry in ("point", "jacobian", "innovation", "noise"):
        np.testing.assert_allclose(difference(entry), 0, rtol=0, atol=1e-11)
    for entry in ("motion_from", "motion_to"):
        error = geo.additive_error(getattr(expected, entry), getattr(actual, entry))
        np.testing.assert_allclose(error, 0, rtol=0, atol=1e-11)
    for entry in ("motion_jacobian", "motion_noise"):
        a, b = getattr(actual, entry), getattr(expected, entry)
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-11)


# Laws -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("name", SCENARIOS)
def test_data_without_noise_return_the_truth(name, update):
    scenario = SCENARIOS[name]()
    dataset = simulate(replace(scenario, draw_prior=False), seed=1, draw=0.0)
    estimate = Ekf(update=update).estimate(dataset)
    error = geo.additive_error(dataset.truth, estimate.online.poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-12)
    true_map = dict(zip(dataset.true_map.ids.tolist(), dataset.true_map.positions, strict=True))
    truth = [true_map[int(i)] for i in estimate.landmarks.ids]
    np.testing.assert_allclose(estimate.landmarks.positions, truth, rtol=0, atol=1e-12)


@pytest.mark.parametrize("association", ["known", "nearest"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_moving_the_world_moves_the_answer(name, association):
    dataset = drawn(name)
    here, there = (Ekf(association).estimate(d) for d in (dataset, dataset.moved(TURN)))
    moved = geo.compose(TURN, here.online.poses)
    error = geo.additive_error(moved, there.online.poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-10)
    landmarks = geo.from_frame(TURN, here.landmarks.positions)
    np.testing.assert_allclose(landmarks, there.landmarks.positions, rtol=0, atol=1e-10)
    turn = np.eye(len(here.joint_covariance))
    turn[:3, :3] = geo.heading_block(TURN[2])
    for at in range(3, len(turn), 2):
        turn[at : at + 2, at : at + 2] = geo.rotation(TURN[2])
    joint = turn @ here.joint_covariance @ turn.T
    np.testing.assert_allclose(there.joint_covariance, joint, rtol=0, atol=1e-11)
    np.testing.assert_allclose(there.step_nis, here.step_nis, rtol=1e-8)


def test_bearings_that_jump_through_pi_are_as_good_as_others():
    """One scanner, described twice: facing back with bearings about 0, ahead about +-pi."""
    behind = two_sensors(
        landmarks=LandmarkMap([0, 1], [[-9.0, 0.02], [-9.0, -0.02]]),
        start=[0.0, 0.0, 0.0],
        controls=np.tile([0.1, 0.0, 0.0], (40, 1)),
        sensors=(Sensor("range-bearing", np.diag([0.01, 0.01]), mount=[0, 0, np.pi]),),
        prior=Prior(),
        draw_prior=False,
    )
    back = simulate(behind, seed=1)
    sensor = replace(back.sensors[0], mount=np.zeros(3))
    values = back.observations.values.copy()
    values[:, 1] = geo.wrap(values[:, 1] + np.pi)
    assert (values[:, 1] > 3).any()
    assert (values[:, 1] < -3).any()
    ahead = replace(back, sensors=(sensor,), observations=replace(back.observations, values=values))
    one, other = (Ekf().estimate(dataset) for dataset in (back, ahead))
    assert_same_estimate(one, other, 1e-12)


@pytest.mark.parametrize("name", SCENARIOS)
def test_no_estimate_knows_the_future(name):
    dataset = drawn(name)
    whole, part = Ekf().estimate(dataset), Ekf().estimate(first_poses(dataset, 31))
    np.testing.assert_array_equal(part.online.poses, whole.online.poses[:31])
    np.testing.assert_array_equal(part.online.covariances, whole.online.covariances[:31])


def test_the_measurement_that_creates_a_landmark_corrects_nothing():
    dataset = first_poses(drawn("two-sensors"), 1)
    rows = dataset.observations.sensor == 0  # what the first look sees for the first time
    look = replace(
        dataset,
        observations=Observations(
            dataset.observations.step[rows],
            dataset.observations.values[rows],
            dataset.observations.landmark[rows],
        ),
        true_landmark=None,
    )
    estimate = Ekf().estimate(look)
    np.testing.assert_array_equal(estimate.online.poses[0], dataset.prior.mean)
    np.testing.assert_array_equal(estimate.online.covariances[0], dataset.prior.covariance)
    assert (estimate.innovations.decision == Decision.NEW).all()
    assert estimate.step_dof.tolist() == [0]
    assert np.isnan(estimate.step_nis).all()
    sensor, values = dataset.sensors[0], look.observations.values
    points, wrt_pose, wrt_value = sensor.locate(dataset.prior.mean, values)
    np.testing.assert_allclose(estimate.landmarks.positions, points, rtol=0, atol=1e-13)
    mapped = geo.congruence(wrt_value, sensor.covariances(values))
    P, joint = dataset.prior.covariance, estimate.joint_covariance
    for i in range(len(values)):
        at = slice(3 + 2 * i, 5 + 2 * i)
        given_pose = joint[at, at] - joint[at, :3] @ np.linalg.solve(P, joint[:3, at])
        np.testing.assert_allclose(given_pose, mapped[i], rtol=0, atol=1e-13)
        np.testing.assert_allclose(joint[at, :3], wrt_pose[i] @ P, rtol=0, atol=1e-13)


def test_a_second_sensor_corrects_in_the_step_in_which_the_first_maps():
    dataset = first_poses(drawn("two-sensors"), 1)
    estimate = Ekf().estimate(dataset)
    decision = estimate.innovations.decision
    shared = np.isin(dataset.observations.landmark, dataset.observations.landmark[decision == 1])
    twice = np.unique(dataset.observations.landmark[shared], return_counts=True)[1] == 2
    assert twice.any()
    accepted = decision == Decision.ACCEPTED
    assert accepted.sum() == twice.sum()
    assert (dataset.observations.sensor[accepted] == 1).all()
    assert estimate.step_dof[0] == 2 * accepted.sum()


def test_sequential_nis_is_the_sum_of_its_parts():
    dataset = drawn("two-sensors")
    estimate = Ekf(update="sequential").estimate(dataset)
    z, S = estimate.innovations.innovation, estimate.innovations.S
    used = estimate.innovations.decision == Decision.ACCEPTED
    parts = np.einsum("mi,mi->m", z[used], np.linalg.solve(S[used], z[used, :, None])[..., 0])
    total = np.zeros(dataset.poses)
    np.add.at(total, dataset.observations.step[used], parts)
    seen = estimate.step_dof > 0
    np.testing.assert_allclose(estimate.step_nis[seen], total[seen], rtol=1e-12)
    counts = np.bincount(dataset.observations.step[used], minlength=dataset.poses)
    np.testing.assert_array_equal(estimate.step_dof, 2 * counts)


def test_nis_is_chi_square_distributed():
    """Innovations of a right filter: mean 1 per row, with deviation sqrt(2 / rows)."""
    estimates = [Ekf().estimate(simulate("loop-15", seed=seed)) for seed in range(10)]
    total = sum(np.nansum(e.step_nis) for e in estimates)
    rows = sum(e.step_dof.sum() for e in estimates)
    assert abs(total / rows - 1) < 4 * np.sqrt(2 / rows)


# Online, compiled and not, storage ----------------------------------------------------------------


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("association", ["known", "nearest"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_step_by_step_gives_the_same_bits(name, association, update):
    dataset = drawn(name)
    options = {"association": association, "update": update}
    assert_same_bits(Ekf(**options).estimate(dataset), dataset, **options)


@pytest.mark.parametrize("association", ["known", "nearest"])
def test_growing_storage_changes_no_bit(association, monkeypatch):
    dataset = drawn("cloister")
    roomy = Ekf(association).estimate(dataset)
    tiny = lambda priors, landmarks, late: GaussianMap(priors, 1, late)  # noqa: E731
    monkeypatch.setattr(engine, "GaussianMap", tiny)
    assert_same_estimate(Ekf(association).estimate(dataset), roomy)
    _, poses, covariances, _ = online(dataset, association=association)
    np.testing.assert_array_equal(poses[0], roomy.online.poses)
    np.testing.assert_array_equal(covariances[0], roomy.online.covariances)


def test_progress_is_told_and_changes_nothing():
    told = []
    dataset = drawn("loop-15")
    estimate = Ekf().estimate(dataset, progress=lambda done, of: told.append((done, of)))
    assert_same_estimate(estimate, Ekf().estimate(dataset))
    done = [k for k, _ in told]
    assert done == sorted(set(done))
    assert told[-1] == (401, 401)


PLAIN = """
import sys
from ekfslam.dataset import Dataset
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.ekf_slam import run
assert not hasattr(run, "py_func")
dataset = Dataset.load(sys.argv[1])
for association in ("known", "nearest"):
    for update in ("joint", "sequential"):
        estimate = Ekf(association, update=update).estimate(dataset)
        estimate.save(f"{sys.argv[2]}/{association}-{update}.npz")
"""


def test_plain_python_gives_the_same_numbers(tmp_path):
    dataset = first_poses(drawn("two-sensors"), 12)
    dataset.save(tmp_path / "dataset.npz")
    subprocess.run(
        [sys.executable, "-W", "error", "-c", PLAIN, tmp_path / "dataset.npz", tmp_path],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        check=True,
    )
    for association in ("known", "nearest"):
        for update in UPDATES:
            plain = Estimate.load(tmp_path / f"{association}-{update}.npz")
            assert_same_estimate(Ekf(association, update=update).estimate(dataset), plain, 1e-12)


# What cannot be used ----------------------------------------------------------------------------


def test_sightings_without_identity_are_rejected_where_association_is_known():
    dataset = drawn("two-sensors")
    observations = dataset.observations
    blank = np.where(observations.landmark == 13, -1, observations.landmark)
    some = replace(dataset, observations=replace(observations, landmark=blank))
    estimate = Ekf("known").estimate(some)
    unnamed = blank < 0
    assert (estimate.innovations.decision[unnamed] == Decision.REJECTED).all()
    assert (estimate.innovations.landmark[unnamed] == -1).all()
    assert 13 not in estimate.landmarks.ids
    without = replace(
        dataset,
        observations=Observations(
            *(getattr(observations, c)[~unnamed] for c in ("step", "values", "landmark", "sensor"))
        ),
        true_landmark=None,
    )
    left_out = Ekf().estimate(without)
    np.testing.assert_array_equal(estimate.online.poses, left_out.online.poses)
    np.testing.assert_array_equal(estimate.joint_covariance, left_out.joint_covariance)


def test_association_is_known_by_default_only_where_every_identity_is():
    dataset = first_poses(drawn("loop-15"), 5)
    assert Ekf().estimate(dataset).association == "known"
    assert Ekf().estimate(dataset.without_identities()).association == "nearest"


def test_a_dataset_without_sightings_is_dead_reckoning():
    dataset = drawn("two-sensors")
    blind = replace(dataset, observations=Observations([], np.zeros((0, 2))), true_landmark=None)
    for association in ("known", "nearest"):
        estimate = Ekf(association).estimate(blind)
        integrated = geo.integrate(dataset.prior.mean, dataset.robot.increments.deltas)
        error = geo.additive_error(integrated, estimate.online.poses)
        np.testing.assert_allclose(error, 0, rtol=0, atol=1e-12)
        assert len(estimate.landmarks) == 0
        np.testing.assert_array_equal(estimate.joint_covariance, estimate.online.covariances[-1])


@pytest.mark.parametrize("update", UPDATES)
def test_an_innovation_without_uncertainty_is_a_divergence_and_no_crash(update):
    """Data that claim to be exact: the second sighting of a landmark has S = 0."""
    dataset = simulate("loop-15", seed=1, noise=0.0)
    estimate = Ekf(update=update).estimate(dataset)
    assert estimate.status == DIVERGED
    assert estimate.message == "innovation covariance not positive definite at step 2"
    finite = np.isfinite(estimate.online.poses).all(axis=1)
    assert finite.tolist() == [True, True] + [False] * (dataset.poses - 2)
    with pytest.raises(InputError, match="not positive definite"):
        online(dataset, update=update)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"association": "jcbb"}, "association must be one of known, .*joint, got 'jcbb'"),
        ({"update": "all"}, "update must be one of joint, sequential, got 'all'"),
        ({"accept": 0.999, "new": 0.99}, "must not be below"),
        ({"new": 1.0}, "probability"),
    ],
)
def test_options_that_make_no_sense(options, said):
    for make in (Ekf, EkfSlam):
        with pytest.raises(InputError, match=said):
            make(**options)


def test_the_same_landmark_twice_in_one_look_is_refused_online():
    sensor = Sensor("xy", np.eye(2))
    seen = Sightings.of(sensor, [[1.0, 0.0], [2.0, 0.0]], [4, 4])
    with pytest.raises(InputError, match="twice"):
        EkfSlam().observe(seen)


@pytest.mark.parametrize(
    ("increment", "covariance"),
    [
        ([1.0, 2.0], np.eye(3)),
        ([1.0, 2.0, 3.0], np.eye(2)),
        ([np.nan, 0.0, 0.0], np.eye(3)),
        ([1.0, 0.0, 0.0], -np.eye(3)),
    ],
)
def test_a_motion_that_makes_no_sense_is_refused_online(increment, covariance):
    slam = EkfSlam()
    with pytest.raises(InputError, match=r"increment|covariance"):
        slam.predict(increment, covariance)
    np.testing.assert_array_equal(slam.pose, 0)


# What comes from outside online ------------------------------------------------------------------


def look(*values, landmark=None):
    sensor = Sensor("range-bearing", np.diag([0.01, 0.0001]))
    return Sightings.of(sensor, np.array(values, dtype=float), landmark)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"covariance": np.zeros((1, 2, 2))}, "covariance must have shape"),
        ({"mount": np.zeros((1, 3))}, "mount must have shape"),
        ({"kind": np.zeros(1, int)}, "kind must have shape"),
        ({"kind": np.array([0, 7])}, "no view"),
        ({"values": np.array([[1.0, np.nan], [1.0, 0.0]])}, "NaN"),
        ({"values": np.array([[-1.0, 0.0], [1.0, 0.0]])}, "negative range"),
        ({"covariance": np.stack([np.diag([1.0, -1.0])] * 2)}, "positive semi-definite"),
        ({"landmark": np.array([0, -5])}, "landmark"),
        ({"landmark": np.array([3, 3])}, "twice"),
    ],
)
def test_columns_that_make_no_sense_never_reach_the_compiled_code(change, said):
    slam = EkfSlam()
    with pytest.raises(InputError, match=said):
        slam.observe(look([1, 0], [2, 1], landmark=[0, 1])._replace(**change))
    assert len(slam.landmarks) == 0
    with pytest.raises(InputError, match="Sightings"):
        slam.observe([[1.0, 0.0]])


def test_what_failed_leaves_no_landmarks_behind():
    """New landmarks of a look that could not be used take no index, or the register runs over."""
    slam = EkfSlam(association="nearest")
    slam.observe(look([5, 0], [9, 0]))
    P = slam._engine.slam.arrays.covariance
    before = P.copy()
    P[:7, :7] = 0.01 * np.eye(7)
    P[3, 5] = P[4, 6] = 0.0101  # more than a covariance can hold: the joint S is indefinite
    seen = look([5, 0], [9, 0], *([40.0 + i, 1.0] for i in range(40)))
    for _ in range(5):
        with pytest.raises(InputError, match="positive definite"):
            slam.observe(seen._replace(covariance=np.zeros((42, 2, 2))))
        assert slam._engine.register.used[0] == 2
    slam._engine.slam.arrays.covariance[:7, :7] = before[:7, :7]
    slam.observe(look([5, 0], [30, 2]))
    assert len(slam.landmarks) == 3


@pytest.mark.parametrize("update", UPDATES)
def test_a_look_may_show_more_than_the_workspace_has_room_for(tmp_path, update):
    """Sixty landmarks at every step: first all new, then all at once in a correction."""
    grid = [[3.0 + 2 * i, 2.0 * j + 1] for i in range(6) for j in range(-5, 5)]
    path = tmp_path / "grid.toml"
    path.write_text(past_points("A grid ahead.", grid, steps=6, turn=0.02))
    dataset = simulate(load_scenario(path), seed=1)
    assert np.bincount(dataset.observations.step).max() > 2 * gaussian_map.AT_ONCE / WIDTH
    estimate, textbook = Ekf(update=update).estimate(dataset), TextbookEkf(update=update)
    expected = textbook.estimate(dataset)
    np.testing.assert_allclose(estimate.online.poses, expected.online.poses, atol=1e-9)
    np.testing.assert_allclose(estimate.joint_covariance, expected.joint_covariance, atol=1e-9)
    assert_same_bits(estimate, dataset, update=update)
