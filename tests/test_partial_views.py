"""Bearings and ranges: how they start a landmark, how an inverse depth becomes a point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from problems import compass, problem, rows_kept, scanner, sonar
from stepwise import assert_same_bits, slam_of

import ekfslam
from ekfslam import EkfSlam
from ekfslam import geometry as geo
from ekfslam.dataset import Prior, Sightings
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Decision
from ekfslam.evaluation import association_scores, count_landmarks
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.models.landmarks import depth_prior, inverse_depth, linearity, to_point
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import simulate

PRIOR = Prior([1.0, -2.0, 0.5], [[0.04, 0.01, 0], [0.01, 0.09, 0.01], [0, 0.01, 0.01]])
CAMERA = Sensor("bearing", [[0.0004]], mount=[0.3, 0.1, 0.4], min_range=0.8)
SONAR = Sensor("range", [[0.01]], mount=[0.3, 0.1, 0.4])
NEW, ACCEPTED, REJECTED = (int(Decision[name]) for name in ("NEW", "ACCEPTED", "REJECTED"))


def joint(slam):
    """The map with the joint covariance of poses and landmarks."""
    return slam._engine.landmarks(slam._names())


# Partial initiation with a prior ------------------------------------------------------------------


def started_by(sensor, value, landmark, wrt_pose, wrt_value, wrt_prior, S, **options):
    """Compare the first sighting with the one operation of the map, g(R, S, y, s)."""
    slam, expected = EkfSlam(PRIOR, **options), GaussianMap(PRIOR)
    met = slam.observe(Sightings.of(sensor, [[value]], [7]))
    noise = sensor.covariance
    expected.append(landmark, wrt_pose, wrt_value, noise, wrt_prior, np.array([[S]]))
    assert met.decision.tolist() == [NEW]
    landmarks, covariance = joint(slam)
    np.testing.assert_allclose(covariance, expected.covariance, rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(slam.pose, PRIOR.mean)
    return landmarks


def test_a_bearing_starts_an_inverse_depth_with_its_prior():
    """Solà, Eqs. 46 and 47: from d_min = 0.8 m on, rho is 0.625 +- 0.3125."""
    mean, variance = depth_prior(0.8)
    assert (mean, variance) == (0.625, 0.3125**2)
    landmark, *jacobians = inverse_depth(CAMERA, PRIOR.mean, [0.7], mean)
    landmarks = started_by(CAMERA, 0.7, landmark, *jacobians, variance)
    assert landmarks.undetermined.tolist() == [7]
    np.testing.assert_allclose(landmarks.inverse_depth[0], landmark, rtol=0, atol=1e-14)
    assert len(landmarks) == 0


@pytest.mark.parametrize("sensor", [CAMERA, SONAR], ids=lambda sensor: sensor.kind)
def test_a_naive_prior_is_a_measurement_of_what_is_missing(sensor):
    """Of the distance, 6 +- 2 m; of the bearing, ahead with the variance of a uniform one."""
    whole = replace(sensor, kind="range-bearing", covariance=np.eye(2))
    if sensor is CAMERA:
        value, number, S, options = [6.0, 0.7], 0.7, 4.0, {"bearings": "naive"}
    else:
        value, number, S, options = [6.0, 0.0], 6.0, np.pi**2 / 3, {"ranges": "naive"}
    point, wrt_pose, wrt_both = whole.locate(PRIOR.mean, value)
    known, missing = (1, 0) if sensor is CAMERA else (0, 1)
    parts = wrt_both[:, known : known + 1], wrt_both[:, missing : missing + 1]
    options["naive_distance"] = (6.0, 2.0)
    landmarks = started_by(sensor, number, point, wrt_pose, *parts, S, **options)
    np.testing.assert_allclose(landmarks.positions[0], point, rtol=0, atol=1e-14)


def test_each_sensor_has_its_own_least_distance():
    slam = EkfSlam()
    for landmark, least in enumerate((0.5, 2.0, 8.0)):
        sensor = replace(CAMERA, min_range=least)
        slam.observe(Sightings.of(sensor, [[0.3]], [landmark]))
    landmarks, covariance = joint(slam)
    np.testing.assert_allclose(landmarks.inverse_depth[:, 3], [1.0, 0.25, 0.0625], rtol=1e-15)
    sigmas = np.sqrt(np.diag(covariance))[[6, 10, 14]]
    np.testing.assert_allclose(sigmas, [0.5, 0.125, 0.03125], rtol=1e-15)


# Conversion ---------------------------------------------------------------------------------------


def converted(name):
    """A filter that has just converted, and one like it that has not, at the same step."""
    dataset = simulate(name, seed=1)
    slam, twin = slam_of(dataset), slam_of(dataset, linearity=1e-12)
    for step in dataset.steps():
        for each in (slam, twin):
            each.predict(step.increment, step.covariance)
            each.observe(step.observations)
        before, after = (each.landmarks.undetermined for each in (twin, slam))
        after = np.zeros(0, int) if after is None else after
        if before is not None and len(before) > len(after):
            return slam, twin, np.setdiff1d(before, after)
    raise AssertionError("nothing was converted")


@pytest.mark.parametrize("name", ["cloister-bearing", "two-sensors"])
def test_a_conversion_carries_the_covariance_with_it(name):
    """``P' = J P J'`` with all that it is correlated with, and the mean by Eq. 48."""
    slam, twin, ids = converted(name)
    (points, P), (rays, Q) = joint(slam), joint(twin)
    order = [list(rays.undetermined).index(i) for i in ids]
    expected, J = to_point(rays.inverse_depth[order])
    at = [list(points.ids).index(i) for i in ids]
    np.testing.assert_allclose(points.positions[at], expected, rtol=0, atol=1e-11)
    first = 3 + 2 * len(rays)
    T = np.zeros((3 + 2 * len(ids), len(Q)))
    T[:3, :3] = np.eye(3)
    for k, ray in enumerate(order):
        T[3 + 2 * k : 5 + 2 * k, first + 4 * ray : first + 4 * ray + 4] = J[k]
    rows = np.concatenate([np.arange(3), *(3 + 2 * i + np.arange(2) for i in at)])
    tolerance = 1e-11 * np.abs(P).max()
    np.testing.assert_allclose(P[np.ix_(rows, rows)], T @ Q @ T.T, rtol=0, atol=tolerance)
    np.testing.assert_allclose(slam.pose, twin.pose, rtol=0, atol=1e-13)


def test_one_becomes_a_point_as_soon_as_it_is_linear_enough():
    """At the step at which the index, of the twin that keeps it, passes the threshold."""
    dataset = simulate("cloister-bearing", seed=1)
    slam, twin = slam_of(dataset, linearity=0.1), slam_of(dataset, linearity=1e-12)
    seen = 0
    for step in list(dataset.steps())[:12]:
        for each in (slam, twin):
            each.predict(step.increment, step.covariance)
            each.observe(step.observations)
        if len(slam.landmarks):  # from here on the two filters differ
            break
        seen += 1
    assert seen > 1
    rays, Q = joint(twin)
    variances = np.diag(Q)[3 + 4 * np.arange(len(rays.undetermined)) + 3]
    pose = twin.pose
    index = np.array(
        [
            linearity(*ray, variance, pose[0], pose[1])
            for ray, variance in zip(rays.inverse_depth, variances, strict=True)
        ]
    )
    now = np.isin(rays.undetermined, step.observations.landmark)
    np.testing.assert_array_equal(
        np.sort(slam.landmarks.ids), np.sort(rays.undetermined[now & (index < 0.1)])
    )


def test_one_that_is_surely_behind_its_sensor_is_dropped():
    """Bearings that cross behind: a wrong identity, of which nothing is left in the map."""
    slam = EkfSlam(Prior(), bearings="inverse-depth")
    sensor = Sensor("bearing", [[1e-6]], min_range=0.5)
    look = [Sightings.of(sensor, [[angle]], [7]) for angle in (np.pi / 2, np.pi / 2 + 0.2)]
    slam.observe(look[0])  # straight to the left
    decisions = []
    for _ in range(6):  # and farther and farther back, the more the robot moves on
        slam.predict([-0.5, 0.0, 0.0], np.diag([1e-8, 1e-8, 1e-10]))
        decisions += slam.observe(look[1]).decision.tolist()
        if slam.landmarks.undetermined is None:
            break
    assert slam.landmarks.undetermined is None
    assert len(slam.landmarks) == 0
    assert slam._engine.slam.size == 3
    assert decisions[-1] == ACCEPTED
    assert slam.observe(look[0]).decision.tolist() == [NEW]


# What an estimate says ----------------------------------------------------------------------------


def test_undetermined_landmarks_come_last_in_the_joint_covariance():
    dataset = simulate("two-sensors", seed=1)
    short = rows_kept(dataset, dataset.observations.step < 8)
    estimate = Ekf().estimate(short)
    points, rays = estimate.landmarks, estimate.landmarks.undetermined
    assert len(points) > 0
    assert len(rays) > 0
    assert set(points.ids).isdisjoint(rays)
    joint_covariance = estimate.joint_covariance
    assert len(joint_covariance) == 3 + 2 * len(points) + 4 * len(rays)
    np.testing.assert_array_equal(
        joint_covariance[3 : 3 + 2 * len(points), 3 : 3 + 2 * len(points)], points.covariance
    )
    # The first seen direction is where the camera was.
    first = np.flatnonzero(short.observations.landmark == rays[0])[0]
    pose = estimate.online.poses[short.observations.step[first]]
    start = geo.compose(pose, dataset.sensors[1].mount)[:2]
    at = 3 + 2 * len(points)
    error = points.inverse_depth[0, :2] - start
    assert np.abs(error).max() < 5 * np.sqrt(np.diag(joint_covariance)[at : at + 2].max()) + 0.05
    assert estimate.message == f"{len(rays)} landmarks not determined"


# Bearings without identities ----------------------------------------------------------------------


@pytest.mark.parametrize("association", ["nearest", "joint"])
def test_bearings_can_be_told_apart_where_directions_differ(association):
    dataset = simulate("cloister-bearing", seed=1)
    apart = rows_kept(dataset, np.isin(dataset.observations.landmark, [0, 8, 17, 26, 33]))
    estimate = Ekf(association).estimate(apart.without_identities())
    scores = association_scores(apart, estimate)
    assert scores.precision > 0.98
    assert scores.recall > 0.98
    counts = count_landmarks(apart, estimate)
    assert counts.missed == 0
    assert counts.duplicate + counts.spurious <= 1


# What cannot work ---------------------------------------------------------------------------------

LEAST = "the prior on the inverse depth of a bearing needs the sensor's min_range: state it"
POINTS = "needs sensors that determine a point"
CANNOT = [
    *(
        (name, {"association": method}, f"association '{method}' {POINTS}")
        for name in ("cloister-bearing", "two-sensors")
        for method in ("euclidean", "euclidean-first", "mahalanobis-first")
    ),
    *(
        ("cloister-range", {"association": method}, "ranges alone need association 'known'")
        for method in ("nearest", "global", "joint", "maximum-likelihood")
    ),
    ("cloister-bearing", {"association": "nearest", "confirm": 2}, f"confirm {POINTS}"),
    ("cloister-range", {"confirm": 3}, f"confirm {POINTS}"),
    ("cloister-bearing", {"initiation": "allocated"}, f"initiation 'allocated' {POINTS}"),
    ("no least distance", {}, LEAST),
    ("no identities", {}, "ranges alone need association 'known'"),
]


def unfit(name):
    if name == "no identities":
        return simulate("cloister-range", seed=1).without_identities()
    if name == "no least distance":
        dataset = simulate("cloister-bearing", seed=1)
        return replace(dataset, sensors=(replace(dataset.sensors[0], min_range=0.0),))
    return simulate(name, seed=1)


@pytest.mark.parametrize(("name", "options", "said"), CANNOT)
def test_what_cannot_work_says_why_and_is_a_row_of_a_comparison(name, options, said):
    dataset, subject = unfit(name), Ekf(**options)
    with pytest.raises(UnsupportedError) as caught:
        subject.estimate(dataset)
    assert str(caught.value) == said
    summary = ekfslam.compare(dataset, subject).summary
    assert summary["status"].tolist() == ["skipped"]
    assert said in summary["message"].iloc[0]


def test_and_step_by_step_it_says_so_before_anything_is_used():
    for sensor, options, said in (
        (replace(CAMERA, min_range=0.0), {}, LEAST),
        (SONAR, {"association": "nearest"}, "ranges alone"),
        (CAMERA, {"association": "euclidean"}, POINTS),
        (CAMERA, {"association": "nearest", "confirm": 2}, "confirm"),
    ):
        slam = EkfSlam(PRIOR, **options)
        with pytest.raises(UnsupportedError, match=said):
            slam.observe(Sightings.of(sensor, [[1.0]], [7]))
        np.testing.assert_array_equal(slam.pose, PRIOR.mean)
        assert slam._engine.undetermined == 0


def test_a_prior_that_is_not_used_need_not_be_there():
    dataset = unfit("no least distance")
    assert Ekf(bearings="naive").estimate(dataset).status == "ok"


@pytest.mark.parametrize("partial", [compass(), sonar()], ids=lambda sensor: sensor.kind)
def test_robots_can_be_seen_by_what_would_not_do_for_landmarks(partial):
    """Robots have a pose and are known; so no prior is asked for, nor identities of landmarks."""
    dataset = problem(scanner(), partial, robots=2, meet=(1,), steps=6)
    seen = dataset.observations
    only = rows_kept(dataset, (seen.sensor == 0) | (dataset.observed_robot >= 0))
    for association in ("known", "nearest", "euclidean"):
        given = only if association == "known" else only.without_identities()
        decision = Ekf(association).estimate(given).innovations.decision
        assert (decision[only.observed_robot >= 0] == ACCEPTED).all()
    assert_same_bits(Ekf("nearest").estimate(given), given, association="nearest")
