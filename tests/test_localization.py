"""Localization on a known map: laws, a dense textbook filter, and what becomes of the lost."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from problems import camera, compass, problem, scanner, sonar
from scipy.stats import chi2

from ekfslam import geometry as geo
from ekfslam.association.gates import chi2_gate
from ekfslam.dataset import Dataset, LandmarkMap, Observations, Prior, Robot
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.estimates import DIVERGED, OK, Decision
from ekfslam.evaluation import judged, tables
from ekfslam.evaluation.association import association_scores
from ekfslam.evaluation.consistency import pose_nees
from ekfslam.filters.localization import EkfLocalization
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import simulate

SENSORS = {
    "scanner": (scanner(0.4, -0.2, 1.0),),
    "camera": (camera(0.4, -0.2, 1.0),),
    "compass": (compass(0.4, -0.2, 1.0),),
    "sonar": (sonar(0.4, -0.2, 1.0),),
    "all": (scanner(), camera(0.1, 0.2, 0.3), compass(-0.3, 0.1, -2.0), sonar(0.4, -0.2, 1.0)),
}


def on_its_map(dataset, ids=None):
    """The same data with the true map known, or a part of it in some order."""
    there = dataset.true_map
    rows = np.arange(len(there)) if ids is None else np.searchsorted(there.ids, ids)
    return replace(dataset, known_map=LandmarkMap(there.ids[rows], there.positions[rows]))


def localized(dataset, **options):
    return EkfLocalization(**options).estimate(dataset)


def far_from(dataset, offset):
    """The same data with a start that is off by more than it says."""
    robot = dataset.robot
    prior = Prior(robot.prior.mean + offset, np.diag([0.01, 0.01, 1e-3]))
    return replace(dataset, robots=(replace(robot, prior=prior),))


def assert_same(one, other, atol=0.0):
    error = geo.additive_error(one.online.poses, other.online.poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=atol)
    np.testing.assert_allclose(one.online.covariances, other.online.covariances, rtol=0, atol=atol)
    np.testing.assert_array_equal(one.innovations.landmark, other.innovations.landmark)


# Against dense algebra ---------------------------------------------------------------------------


def textbook(dataset, association="known", accept=0.999):
    """The filter of the notes with full matrices, one robot."""
    prior, known = dataset.prior, dataset.known_map
    x, P = prior.mean.copy(), prior.covariance.copy()
    deltas, Qs = (part[0] for part in dataset.moves)
    seen, sightings = dataset.observations, dataset.sightings
    poses, covariances, landmark = [], [], np.full(len(seen), -1)
    for k in range(dataset.poses):
        F, into = geo.compose_jacobians(x, deltas[k])
        x, P = geo.compose(x, deltas[k]), F @ P @ F.T + into @ Qs[k] @ into.T
        rows = np.arange(dataset.offsets[k], dataset.offsets[k + 1])
        for look in np.unique(sightings.look[rows]):
            mine = rows[sightings.look[rows] == look]
            sensor = dataset.sensors[seen.sensor[mine[0]]]
            d = sensor.view.size
            noise = sensor.covariances(seen.values[mine, :d])

            def model(i, place, x=x, sensor=sensor, d=d):
                expected, H, _ = sensor.observe(x, place)
                return sensor.difference(seen.values[i, :d], expected), H

            if association == "known":
                for i in mine:
                    landmark[i] = seen.landmark[i] if seen.landmark[i] in known.ids else -1
            else:
                squared = np.empty((len(mine), len(known)))
                for (a, i), (b, place) in product(enumerate(mine), enumerate(known.positions)):
                    z, H = model(i, place)
                    squared[a, b] = z @ np.linalg.solve(H @ P @ H.T + noise[a], z)
                nearest = squared.argmin(axis=1)
                for a, b in enumerate(nearest):  # the nearer of two keeps the landmark
                    rivals = squared[nearest == b, b]
                    if squared[a, b] <= min(rivals.min(), chi2_gate(accept, d)):
                        landmark[mine[a]] = known.ids[b]
            for i, R in zip(mine, noise, strict=True):
                if landmark[i] < 0:
                    continue
                z, H = model(i, known.positions[known.ids == landmark[i]][0], x)
                S = H @ P @ H.T + R
                K = P @ H.T @ np.linalg.inv(S)
                x, P = x + K @ z, P - K @ S @ K.T
                x[2] = geo.wrap(x[2])
        poses.append(x)
        covariances.append(P)
    return np.array(poses), np.array(covariances), landmark


@pytest.mark.parametrize("association", ["known", "nearest"])
@pytest.mark.parametrize("name", SENSORS)
def test_it_is_the_textbook_filter(name, association):
    dataset = on_its_map(problem(*SENSORS[name], steps=20, noise=0.3))
    poses, covariances, landmark = textbook(dataset, association)
    estimate = localized(dataset, association=association)
    np.testing.assert_array_equal(estimate.innovations.landmark, landmark)
    error = geo.additive_error(estimate.online.poses, poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-10)
    np.testing.assert_allclose(estimate.online.covariances, covariances, rtol=0, atol=1e-11)
    assert estimate.landmarks is None


def test_it_is_the_textbook_filter_over_a_long_run():
    dataset = on_its_map(simulate("park", seed=3))
    poses, covariances, _ = textbook(dataset)
    estimate = localized(dataset)
    error = geo.additive_error(estimate.online.poses, poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-10)
    np.testing.assert_allclose(estimate.online.covariances, covariances, rtol=0, atol=1e-12)


def test_a_linear_problem_is_solved_as_least_squares_would():
    """With the heading known, x and y move and are seen linearly: one solve over all poses."""
    rng = np.random.default_rng(5)
    steps, slip = 12, np.diag([0.04, 0.01, 0.0])
    controls = np.column_stack([rng.normal(1, 0.2, (steps, 2)), rng.uniform(-1, 1, steps)])
    prior = Prior([0.3, -0.2, 0.5], [[0.2, 0.05, 0], [0.05, 0.1, 0], [0, 0, 0]])
    robot = Robot(MotionModel("odometry", covariance=slip), controls, prior)
    sensor, step = camera(0.4, -0.2, 0.3), np.repeat(np.arange(steps + 1), 2)
    values = rng.normal(0, 3, (len(step), 2))
    known = LandmarkMap([0, 1], [[3.0, 4.0], [-2.0, 1.0]])
    seen = Observations(step, values, np.tile([0, 1], steps + 1))
    data = Dataset("linear", (robot,), np.arange(steps + 1.0), (sensor,), seen, known)
    headings = geo.integrate(prior.mean, controls)[:, 2]

    def turn(angle):
        return geo.heading_block(angle)[:2, :2]

    rows, right = [], []

    def add(parts, value, covariance):
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        block = np.zeros((2, 2 * (steps + 1)))
        for pose, matrix in parts:
            block[:, 2 * pose : 2 * pose + 2] = matrix
        rows.append(root @ block)
        right.append(root @ value)

    add([(0, np.eye(2))], prior.mean[:2], prior.covariance[:2, :2])
    for k in range(steps):
        R = turn(headings[k])
        add(
            [(k, -np.eye(2)), (k + 1, np.eye(2))],
            R @ controls[k, :2],
            R @ slip[:2, :2] @ R.T,
        )
    for k, value, landmark in zip(step, values, seen.landmark, strict=True):
        mounted = turn(headings[k] + sensor.mount[2])
        place = known.positions[landmark] - turn(headings[k]) @ sensor.mount[:2]
        add([(k, mounted.T)], mounted.T @ place - value, sensor.covariance)
    A, b = np.concatenate(rows), np.concatenate(right)
    solution, covariance = np.linalg.lstsq(A, b, rcond=None)[0], np.linalg.inv(A.T @ A)
    estimate = localized(data)
    final = estimate.online
    np.testing.assert_allclose(final.poses[-1, :2], solution[-2:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        final.covariances[-1, :2, :2], covariance[-2:, -2:], rtol=0, atol=1e-13
    )
    # The squared innovations add up to what the least squares leave over.
    left = A @ solution - b
    assert np.nansum(estimate.step_nis) == pytest.approx(left @ left, rel=1e-11)
    assert estimate.step_dof.sum() == 2 * len(step) == len(b) - A.shape[1]


def test_expected_measurements_are_recomputed_after_each_correction():
    """The scalar trap: two unit measurements of a unit prior give 2/3; with stale ones 5/6."""
    prior = Prior([0.0, 0.0, 0.0], np.diag([1.0, 0, 0]))
    robot = Robot(MotionModel("odometry", covariance=np.eye(3)), np.zeros((0, 3)), prior)
    known = LandmarkMap([0, 1], [[4.0, 1.0], [6.0, -2.0]])
    values = known.positions - [1.0, 0.0]  # both say that the robot is at x = 1
    seen = Observations([0, 0], values, [0, 1])
    data = Dataset("scalar", (robot,), [0.0], (Sensor("xy", np.eye(2)),), seen, known)
    estimate = localized(data)
    stale = 0.5 + 1 / 3 * (1 - 0)
    assert stale == pytest.approx(0.833, abs=1e-3)
    assert estimate.online.poses[0, 0] == pytest.approx(2 / 3, rel=1e-14)
    assert estimate.online.covariances[0, 0, 0] == pytest.approx(1 / 3, rel=1e-14)
    np.testing.assert_allclose(estimate.innovations.innovation[:, 0], [-1.0, -0.5], rtol=1e-14)
    np.testing.assert_allclose(estimate.innovations.S[:, 0, 0], [2.0, 1.5], rtol=1e-14)


# Invariances -------------------------------------------------------------------------------------


@pytest.mark.parametrize("association", ["known", "nearest"])
@pytest.mark.parametrize("name", SENSORS)
def test_zero_noise_returns_the_truth(name, association):
    dataset = on_its_map(problem(*SENSORS[name], noise=0.0))
    estimate = localized(dataset, association=association)
    error = geo.additive_error(dataset.truth, estimate.online.poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(estimate.innovations.landmark, dataset.true_landmark)
    assert (estimate.status, estimate.message) == (OK, "")


@pytest.mark.parametrize("association", ["known", "nearest"])
def test_moving_the_world_moves_the_answer(association):
    dataset = on_its_map(problem(*SENSORS["all"], noise=0.3))
    motion = np.array([50.0, -30.0, 2.0])
    here = localized(dataset, association=association)
    there = localized(dataset.moved(motion), association=association)
    error = geo.additive_error(geo.compose(motion, here.online.poses), there.online.poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-11)
    turned = geo.congruence(geo.heading_block(motion[2]), here.online.covariances)
    np.testing.assert_allclose(turned, there.online.covariances, rtol=0, atol=1e-12)
    np.testing.assert_allclose(here.step_nis, there.step_nis, rtol=1e-8)


@pytest.mark.parametrize("association", ["known", "nearest", "nearest-position"])
def test_the_order_of_the_map_does_not_matter(association):
    dataset = on_its_map(problem(scanner(0.4, -0.2, 1.0)))
    shuffled = on_its_map(dataset, [13, 3, 21, 5, 8])
    assert shuffled.known_map.ids.tolist() == [13, 3, 21, 5, 8]
    assert_same(*(localized(d, association=association) for d in (dataset, shuffled)))


def test_a_team_localizes_robot_by_robot():
    dataset = on_its_map(problem(scanner(0.4, -0.2, 1.0), robots=3, meet=(0,)))
    team, met = localized(dataset), dataset.observed_robot >= 0
    assert team.online.poses.shape == (3, 10, 3)
    assert (team.innovations.decision[met] == Decision.REJECTED).all()
    assert (team.innovations.decision[~met] == Decision.ACCEPTED).all()
    nis = np.zeros(10)
    for index, robot in enumerate(dataset.robots):
        o = dataset.observations
        mine = (o.robot == index) & ~met
        seen = Observations(o.step[mine], o.values[mine], o.landmark[mine], o.sensor[mine])
        alone = localized(replace(dataset, robots=(robot,), observations=seen, true_landmark=None))
        np.testing.assert_array_equal(alone.online.poses, team.online.poses[index])
        np.testing.assert_array_equal(alone.online.covariances, team.online.covariances[index])
        nis += alone.step_nis
    np.testing.assert_allclose(team.step_nis, nis, rtol=1e-12)


def test_progress_changes_nothing():
    dataset, told = on_its_map(simulate("cloister", seed=1)), []
    whole = localized(dataset)
    parts = EkfLocalization().estimate(dataset, progress=lambda *at: told.append(at))
    assert_same(whole, parts)
    assert told[-1] == (dataset.poses, dataset.poses)
    assert len(told) > 50


# Who is seen -------------------------------------------------------------------------------------


def standing(known, values, prior=None, landmark=None, sensor=None):
    """A robot that has not moved, about to look at a map."""
    prior = Prior([0.0, 0.0, 0.0], np.diag([0.04, 0.04, 1e-4])) if prior is None else prior
    robot = Robot(MotionModel("odometry", covariance=np.eye(3)), np.zeros((0, 3)), prior)
    sensor = Sensor("xy", 0.01 * np.eye(2)) if sensor is None else sensor
    seen = Observations(np.zeros(len(values), dtype=int), values, landmark)
    return Dataset("standing", (robot,), [0.0], (sensor,), seen, known)


def test_identities_that_are_not_on_the_map_are_rejected():
    dataset = problem(scanner())
    part = localized(on_its_map(dataset, [13, 5]))
    inside = np.isin(dataset.observations.landmark, [13, 5])
    expected = np.where(inside, Decision.ACCEPTED, Decision.REJECTED)
    np.testing.assert_array_equal(part.innovations.decision, expected)
    assert (
        part.innovations.landmark.tolist()
        == np.where(inside, dataset.observations.landmark, -1).tolist()
    )
    assert (part.status, part.message) == (OK, "")  # they say nothing against the estimate
    none = localized(on_its_map(dataset, []))
    np.testing.assert_array_equal(none.step_dof, 0)
    assert np.isnan(none.step_nis).all()
    assert none.status == OK


def test_unknown_landmarks_are_left_unmatched():
    known = LandmarkMap([7, 9], [[3.0, 0.0], [0.0, 5.0]])
    data = standing(known, [[3.1, 0.1], [0.1, 4.9], [8.0, 8.0]])
    for association in ("nearest", "nearest-position"):
        met = localized(data, association=association).innovations
        assert met.landmark.tolist() == [7, 9, -1]
        assert met.decision.tolist() == [Decision.ACCEPTED, Decision.ACCEPTED, Decision.REJECTED]
        assert np.isnan(met.innovation[2]).all()


def test_a_landmark_is_seen_once_in_a_gated_look_and_as_often_as_they_like_in_the_notes():
    known = LandmarkMap([7, 9], [[3.0, 0.0], [0.0, 5.0]])
    data = standing(known, [[3.1, 0.1], [3.05, 0.0]])
    gated = localized(data, association="nearest").innovations
    assert gated.landmark.tolist() == [-1, 7]
    assert gated.decision.tolist() == [Decision.AMBIGUOUS, Decision.ACCEPTED]
    noted = localized(data, association="nearest-position").innovations
    assert noted.landmark.tolist() == [7, 7]


def test_a_whole_look_is_matched_before_it_corrects():
    """The first sighting moves the robot by 0.4 m; from there the second is nearest to another."""
    known = LandmarkMap([0, 1, 2], [[0.0, 9.0], [5.0, 0.0], [5.9, 0.0]])
    prior = Prior([0.0, 0.0, 0.0], np.diag([1.0, 1e-6, 1e-8]))
    values = [[-0.4, 9.0], [5.3, 0.0]]  # the robot is at x = 0.4 by the first
    exact = Sensor("xy", np.diag([0.01, 1.0]))
    for association in ("nearest", "nearest-position"):
        both = localized(standing(known, values, prior, sensor=exact), association=association)
        assert both.innovations.landmark.tolist() == [0, 1]
        moved = Prior([0.4, 0.0, 0.0], np.diag([0.01, 1e-6, 1e-8]))
        late = standing(known, values[1:], moved, sensor=exact)
        assert localized(late, association=association).innovations.landmark.tolist() == [2]


def test_the_radius_is_epsilon():
    known = LandmarkMap([4], [[3.0, 0.0]])
    for distance, found in ((0.49, 4), (0.51, -1)):
        data = standing(known, [[3.0, distance]])
        met = localized(data, association="nearest-position", radius=0.5).innovations
        assert met.landmark.tolist() == [found]


def test_the_gate_is_a_probability():
    known = LandmarkMap([4], [[3.0, 0.0]])
    prior = Prior(np.zeros(3), np.zeros((3, 3)))
    for accept in (0.5, 0.95, 0.999):
        edge = 0.1 * np.sqrt(chi2.ppf(accept, 2))
        for factor, found in ((0.999, 4), (1.001, -1)):
            data = standing(known, [[3.0, factor * edge]], prior)
            met = localized(data, association="nearest", accept=accept).innovations
            assert met.landmark.tolist() == [found]


def test_bearings_wrap():
    """Measured just below pi, expected just above -pi: a small innovation."""
    known = LandmarkMap([0], [[-5.0, -0.01]])
    data = standing(known, [[5.0, np.pi - 1e-3]], landmark=[0], sensor=scanner())
    innovation = localized(data).innovations.innovation[0, 1]
    assert innovation == pytest.approx(-1e-3 - np.arctan(0.01 / 5), rel=1e-9)


@pytest.mark.parametrize(
    ("sensor", "values"),
    [(scanner(), [[1, 0.1], [3, 0.3]]), (compass(), [[0.1], [0.3]]), (sonar(), [[0.3], [3]])],
)
def test_a_landmark_where_the_sensor_stands_is_rejected(sensor, values):
    known = LandmarkMap([0, 1], [[0.0, 0.0], [3.0, 1.0]])
    for association in ("known", "nearest"):
        data = standing(known, values, landmark=[0, 1], sensor=sensor)
        estimate = localized(data, association=association)
        assert estimate.status == OK
        assert np.isfinite(estimate.online.poses).all()
        assert 0 not in estimate.innovations.landmark


def test_noise_given_with_each_sighting_is_used():
    known = LandmarkMap([0], [[3.0, 0.0]])
    data = standing(known, [[3.5, 0.0]], landmark=[0])
    own = np.array([[[0.3, 0.1], [0.1, 0.2]]])
    data = replace(data, observations=replace(data.observations, covariance=own))
    _, H, _ = data.sensors[0].observe(data.prior.mean, known.positions[0])
    expected = H @ data.prior.covariance @ H.T + own[0]
    np.testing.assert_allclose(localized(data).innovations.S[0], expected, rtol=1e-14)


# Consistency -------------------------------------------------------------------------------------


def test_it_is_consistent():
    """Pose NEES over 100 draws at five steps, each sum chi-square with 300 degrees of freedom."""
    seeds, steps = 100, [10, 30, 60, 90, -1]
    nees, nis = np.empty((seeds, len(steps))), np.empty((seeds, 2))
    for seed in range(seeds):
        dataset = on_its_map(simulate("cloister", seed=seed))
        estimate = localized(dataset)
        run = estimate.online
        nees[seed] = pose_nees(run.poses, dataset.truth, run.covariances)[steps]
        nis[seed] = np.nansum(estimate.step_nis), estimate.step_dof.sum()
    chance = 1e-3 / len(steps)
    low, high = chi2.ppf([chance / 2, 1 - chance / 2], 3 * seeds) / seeds
    assert ((low < nees.mean(axis=0)) & (nees.mean(axis=0) < high)).all(), nees.mean(axis=0)
    squares, dof = nis.sum(axis=0)
    assert abs(squares / dof - 1) < 3.3 * np.sqrt(2 / dof)


# The lost ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("association", ["nearest", "nearest-position"])
@pytest.mark.parametrize(
    "offset", [(0, 0, 1.5), (0, 0, np.pi), (20, 10, 0), (-10, -10, 2), (200, 0, 0)]
)
def test_a_start_far_off_is_told_without_the_truth(offset, association):
    dataset = far_from(on_its_map(simulate("park", seed=1)), offset)
    estimate = localized(dataset, association=association)
    assert estimate.status == DIVERGED
    odd = np.sum(estimate.innovations.decision == Decision.REJECTED)
    assert estimate.message == (
        f"{odd} of {len(dataset.observations)} sightings match no landmark of the map: "
        "lost, or the start was far off"
    )
    assert judged(dataset, estimate) is estimate


def test_known_identities_pull_a_start_that_is_far_off_back():
    dataset = far_from(on_its_map(simulate("park", seed=1)), (20, 10, 2))
    estimate = judged(dataset, localized(dataset))
    assert (estimate.status, estimate.message) == (OK, "")
    assert np.linalg.norm((estimate.online.poses - dataset.truth)[-1, :2]) < 0.1


def test_a_run_too_short_to_come_back_is_told_by_its_innovations():
    data = simulate("park", seed=1)
    rows = data.observations.step < 2
    few = {name: getattr(data.observations, name)[rows] for name in ("step", "values", "landmark")}
    data = replace(data, observations=Observations(**few), true_landmark=None)
    estimate = localized(far_from(on_its_map(data), (20, 10, 2)))
    assert estimate.status == DIVERGED
    assert "do not fit their landmarks: lost, or the start was far off" in estimate.message


@pytest.mark.parametrize(("association", "left"), [("nearest", 480), ("known", 12)])
def test_one_who_got_lost_on_the_way_is_told_by_the_last_sightings(association, left):
    """A kidnapping: the truth jumps, the odometry knows nothing of it.

    With known identities the filter is back after some steps, so the run ends before that.
    """
    data = on_its_map(simulate("park", seed=1))
    jump, when = np.array([9.0, -6.0, 1.0]), data.poses - left
    truth = np.concatenate([data.truth[:when], geo.compose(data.truth[when:], jump)])
    sensor, looks = data.sensors[0], np.arange(1, data.poses)
    step, landmark = np.nonzero(sensor.sees(truth[looks, None], data.true_map.positions))
    values = sensor.observe(truth[looks[step]], data.true_map.positions[landmark])[0]
    observations = Observations(looks[step], values, data.true_map.ids[landmark])
    data = replace(data, observations=observations, true_landmark=None)
    estimate = localized(data, association=association)
    assert estimate.status == DIVERGED
    assert "lost, or the start was far off" in estimate.message
    odd = localized(data, association=association).innovations.landmark < 0
    assert not odd[looks[step] < when].any()  # until then all was well


@pytest.mark.parametrize("share", [0.4, 0.3, 0.1])
def test_a_map_of_a_part_of_the_world_is_no_failure(share):
    data = simulate("park", seed=1)
    rng = np.random.default_rng(1)
    part = on_its_map(data, np.sort(rng.choice(60, int(60 * share), replace=False)))
    estimate = judged(part, localized(part, association="nearest"))
    assert estimate.status == OK
    matched = estimate.innovations.landmark
    assert (matched[matched >= 0] == data.true_landmark[matched >= 0]).all()
    odd = np.sum(matched < 0)
    assert odd > len(matched) / 2
    assert f"{odd} of {len(matched)} sightings match no landmark of the map" in estimate.message
    assert "the map is a part of the world, or the robot was lost" in estimate.message


def test_a_covariance_that_is_not_positive_ends_the_run_with_a_word():
    data = simulate("cloister", seed=1, noise=0.0)
    estimate = localized(on_its_map(data))
    assert estimate.status == DIVERGED
    assert estimate.message == "innovation covariance not positive definite at step 1"
    assert np.isnan(estimate.online.poses[2:]).all()


# In the tables ------------------------------------------------------------------------------------


@pytest.mark.parametrize("association", ["known", "nearest"])
def test_a_given_map_is_not_scored_as_an_estimate(association):
    data = on_its_map(problem(scanner()), [13, 5])
    estimate = localized(data, association=association)
    assert not len(tables.landmarks(data, estimate))
    row = tables.summary_rows(data, estimate).iloc[0]
    assert row["status"] == "ok"
    assert np.isnan(row["landmark_rmse_m"])
    assert row["association_precision"] == 1.0
    scores = association_scores(data, estimate)
    np.testing.assert_array_equal(scores.mapped, np.isin(data.true_landmark, [13, 5]))


def test_landmarks_of_the_map_that_were_never_matched_are_missed():
    dataset = on_its_map(simulate("park", seed=1)).without_identities()
    scores = association_scores(dataset, localized(far_from(dataset, (200, 0, 0))))
    assert scores.mapped.all()
    assert scores.recall == 0.0


# What it refuses ---------------------------------------------------------------------------------


def test_without_a_map_it_does_not_apply():
    data = replace(problem(scanner()), known_map=None)
    with pytest.raises(UnsupportedError, match="by hand has no known map to localize on"):
        localized(data)


@pytest.mark.parametrize("sensor", [compass(), sonar()])
def test_nearest_position_needs_a_point(sensor):
    data = on_its_map(problem(sensor))
    with pytest.raises(UnsupportedError, match="'nearest-position' needs sensors that determine"):
        localized(data, association="nearest-position")


def test_the_default_association_is_what_the_data_allow():
    data = on_its_map(problem(scanner(), noise=0.3))
    assert localized(data).association == "known"
    hidden = localized(data.without_identities())
    assert hidden.association == "nearest"
    assert_same(hidden, localized(data, association="nearest"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"association": "joint"}, "known, nearest, nearest-position"),
        ({"accept": 1.0}, "probability"),
        ({"accept": 0}, "nothing pass"),
        ({"accept": "often"}, "gate"),
        ({"radius": 0}, "radius"),
        ({"radius": np.inf}, "radius"),
    ],
)
def test_senseless_options_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        EkfLocalization(**options)
