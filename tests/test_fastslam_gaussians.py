"""The small Gaussians of FastSLAM against dense algebra, the vectorised models and integrals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ekfslam import geometry as geo
from ekfslam.filters.fastslam.gaussians import (
    correct_landmark,
    correct_pose,
    innovation,
    inverse,
    log_likelihood,
    moments,
    spread,
    square_root,
    toward,
    turned,
    view,
    wider,
)
from ekfslam.filters.measure import placed
from ekfslam.models.sensors import Sensor

R = np.array([[0.02, 0.004], [0.004, 0.01]])
SENSORS = [
    Sensor(kind, R, mount=mount)
    for kind in ("range-bearing", "xy")
    for mount in ([0, 0, 0], [0.4, -0.3, 0.9])
]
POSE, POINT = np.array([1.0, -2.0, 2.5]), np.array([-1.5, 0.7])
P = np.array([[0.03, 0.004, -0.006], [0.004, 0.02, 0.002], [-0.006, 0.002, 0.004]])
SIGMA = np.array([[0.05, -0.02], [-0.02, 0.04]])
G = np.array([*POINT, 0.05, -0.02, 0.04])


def seen_by(sensor):
    """The scalar view, and the same from the vectorised model."""
    seen = view(sensor.view.code, placed(sensor.mount, POSE), *POINT)
    return seen, sensor.observe(POSE, POINT)


def full(S):
    return np.array([[S[0], S[1]], [S[1], S[2]]])


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_view_is_the_sensor_model(sensor):
    seen, (value, wrt_pose, wrt_point) = seen_by(sensor)
    np.testing.assert_allclose([seen.first, seen.second], value, atol=1e-14)
    Hm = [[seen.xx, seen.xy], [seen.yx, seen.yy]]
    np.testing.assert_allclose(Hm, wrt_point, atol=1e-14)
    turns = [[seen.x_turn], [seen.y_turn]]
    np.testing.assert_allclose(np.hstack([-np.array(Hm), turns]), wrt_pose, atol=1e-14)
    z = value + np.array([0.1, 4.0])
    nu = innovation(sensor.view.code, z, seen)
    np.testing.assert_allclose(nu, sensor.difference(z, value), atol=1e-14)


@pytest.mark.parametrize("sensor", SENSORS)
def test_corrections_are_dense_algebra(sensor):
    seen, (_, Hx, Hm) = seen_by(sensor)
    nu = np.array([0.11, -0.07])
    S = spread(seen, G, R)
    np.testing.assert_allclose(full(S), Hm @ SIGMA @ Hm.T + R, atol=1e-15)
    K = SIGMA @ Hm.T @ np.linalg.inv(full(S))
    g = G.copy()
    correct_landmark(seen, g, nu, inverse(S))
    np.testing.assert_allclose(g[:2], POINT + K @ nu, atol=1e-14)
    np.testing.assert_allclose(full(g[2:]), SIGMA - K @ full(S) @ K.T, atol=1e-15)
    PH = toward(seen, P)
    np.testing.assert_allclose(np.reshape(PH, (2, 3)).T, P @ Hx.T, atol=1e-15)
    S = wider(S, seen, PH)
    np.testing.assert_allclose(full(S), Hx @ P @ Hx.T + Hm @ SIGMA @ Hm.T + R, atol=1e-15)
    K = P @ Hx.T @ np.linalg.inv(full(S))
    mean, covariance = POSE.copy(), P.copy()
    correct_pose(mean, covariance, PH, nu, inverse(S))
    np.testing.assert_allclose(mean, POSE + K @ nu, atol=1e-14)
    np.testing.assert_allclose(covariance, P - K @ full(S) @ K.T, atol=1e-15)


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_weight_is_the_integral_over_the_landmark(sensor):
    """Of p(z | x, m) p(m) dm, by brute force: the exponent has S^-1, not Q^-1 as Alg. 3 prints.

    The views of angles are all but linear over a landmark of 0.03 m that is 2.7 m away.
    """
    small = SIGMA / 50
    g = np.array([*POINT, small[0, 0], small[0, 1], small[1, 1]])
    fine = np.diag([1e-3, 4e-4])
    seen, (value, _, _) = seen_by(sensor)
    z = value + np.array([0.05, -0.04])
    nu = np.array(innovation(sensor.view.code, z, seen))
    S = spread(seen, g, fine)
    weight = np.exp(log_likelihood(nu, inverse(S)))
    side = np.linspace(-6, 6, 301)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    points = POINT + grid @ np.linalg.cholesky(small).T
    errors = sensor.difference(z, sensor.observe(POSE, points)[0])
    density = multivariate_normal(cov=np.eye(2)).pdf(grid)
    integrand = multivariate_normal(cov=fine).pdf(errors) * density
    integral = integrand.sum() * (side[1] - side[0]) ** 2
    assert weight == pytest.approx(integral, rel=0.02)
    printed = np.exp(-0.5 * nu @ np.linalg.inv(fine) @ nu) / np.sqrt(
        np.linalg.det(2 * np.pi * full(S))
    )
    assert abs(printed - integral) > 0.2 * integral


def test_the_weight_before_the_pose_is_drawn_is_the_integral_over_pose_and_landmark(rng):
    """FastSLAM 2.0, where all is linear: heading exact, relative positions."""
    sensor, flat = SENSORS[3], P.copy()
    flat[2] = flat[:, 2] = 0.0
    seen, (value, _, _) = seen_by(sensor)
    z = value + np.array([0.2, -0.1])
    S = wider(spread(seen, G, R), seen, toward(seen, flat))
    weight = np.exp(log_likelihood(innovation(1, z, seen), inverse(S)))
    draws = 200_000
    poses = POSE + rng.multivariate_normal(np.zeros(3), flat, draws)
    points = POINT + rng.multivariate_normal(np.zeros(2), SIGMA, draws)
    likelihoods = multivariate_normal(cov=R).pdf(z - sensor.observe(poses, points)[0])
    error = likelihoods.std() / np.sqrt(draws)
    assert abs(weight - likelihoods.mean()) < 4 * error
    assert error < 0.01 * weight


def test_what_is_not_positive_definite_changes_nothing():
    seen, _ = seen_by(SENSORS[0])
    for S in ((0.0, 0.0, 0.0), (1.0, 2.0, 1.0), (-1.0, 0.0, -1.0), (np.nan, 0.0, 1.0)):
        assert log_likelihood((0.1, 0.1), inverse(S)) == -np.inf
        g = G.copy()
        correct_landmark(seen, g, (0.1, 0.1), inverse(S))
        np.testing.assert_array_equal(g, G)


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
def test_the_square_root_of_a_singular_covariance(rank, rng):
    """J Sigma_u J' of few control noises, also in a world that is turned."""
    for _ in range(50):
        J = rng.normal(size=(3, max(rank, 1))) * 10.0 ** rng.uniform(-4, 1, size=(3, 1))
        Q = J @ J.T if rank else np.zeros((3, 3))
        C, L = np.empty((3, 3)), np.empty((3, 3))
        turned(Q, 0.7, C)
        B = geo.heading_block(0.7)
        scale = np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
        np.testing.assert_allclose(C, B @ Q @ B.T, atol=1e-14 * scale.max())
        square_root(Q, L)
        # A pivot lost to rounding is 1e-7 sigmas.
        assert (np.abs(L @ L.T - Q) <= 1e-7 * scale).all()
        assert not np.triu(L, 1).any()


def test_the_mean_of_headings_is_that_of_directions():
    poses = np.array([[0.0, 0.0, np.pi - 0.1], [2.0, 4.0, -np.pi + 0.1]])
    mean, covariance = np.empty(3), np.empty((3, 3))
    moments(poses, np.array([0.5, 0.5]), mean, covariance)
    np.testing.assert_allclose(mean, [1.0, 2.0, -np.pi], atol=1e-14)
    np.testing.assert_allclose(covariance, np.outer([1, 2, 0.1], [1, 2, 0.1]), atol=1e-14)
