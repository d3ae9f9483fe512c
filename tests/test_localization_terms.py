"""The notes on Brenner's lectures, written out: every term of theirs is the package's own."""

import numpy as np
import pytest
from numerics import central_difference

from ekfslam import geometry as geo
from ekfslam.filters.kernels import move
from ekfslam.filters.map_matching import through
from ekfslam.filters.measure import POINT, expect, locate, placed
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import RANGE_BEARING, Sensor

W, P1, P2 = 0.155, 0.35, 0.6
POSES = [(0.0, 0.0, 0.0), (1.2, -0.7, 2.9), (-3.0, 4.0, -1.1), (10.0, 20.0, np.pi - 1e-3)]
TURNS = [(0.11, 0.14), (0.14, 0.11), (-0.2, 0.05), (0.0, 0.1), (0.3, 0.301), (0.5, -0.5)]
STRAIGHT = [(0.1, 0.1), (-0.2, -0.2), (0.0, 0.0)]
LANDMARKS = [(5.0, 1.0), (-2.0, 0.5), (1.0, -4.0)]


# As the notes have them --------------------------------------------------------------------------


def g(x, l, r):
    theta, alpha = x[2], (r - l) / W
    if l == r:
        return np.array([x[0] + l * np.cos(theta), x[1] + l * np.sin(theta), theta])
    R = l / alpha + W / 2
    return np.array(
        [
            x[0] + R * (np.sin(theta + alpha) - np.sin(theta)),
            x[1] + R * (-np.cos(theta + alpha) + np.cos(theta)),
            theta + alpha,
        ]
    )


def G(x, l, r):
    theta, alpha = x[2], (r - l) / W
    if l == r:
        return np.array([[1, 0, -l * np.sin(theta)], [0, 1, l * np.cos(theta)], [0, 0, 1]])
    R = l / alpha + W / 2
    return np.array(
        [
            [1, 0, R * (np.cos(theta + alpha) - np.cos(theta))],
            [0, 1, R * (np.sin(theta + alpha) - np.sin(theta))],
            [0, 0, 1],
        ]
    )


def V(x, l, r):
    theta = x[2]
    if l == r:
        c, s, q = np.cos(theta), np.sin(theta), l / W
        return np.array(
            [
                [0.5 * (c + q * s), 0.5 * (c - q * s)],
                [0.5 * (s - q * c), 0.5 * (s + q * c)],
                [-1 / W, 1 / W],
            ]
        )
    later = theta + (r - l) / W
    A, B, C = W * r / (r - l) ** 2, W * l / (r - l) ** 2, (r + l) / (2 * (r - l))
    sines, cosines = np.sin(later) - np.sin(theta), -np.cos(later) + np.cos(theta)
    return np.array(
        [
            [A * sines - C * np.cos(later), -B * sines + C * np.cos(later)],
            [A * cosines - C * np.sin(later), -B * cosines + C * np.sin(later)],
            [-1 / W, 1 / W],
        ]
    )


def sigma_control(l, r):
    turn = (P2 * (l - r)) ** 2
    return np.diag([(P1 * l) ** 2 + turn, (P1 * r) ** 2 + turn])


def scanner_of(x, sd):
    return x[0] + sd * np.cos(x[2]), x[1] + sd * np.sin(x[2])


def h(x, landmark, sd):
    xl, yl = scanner_of(x, sd)
    dx, dy = landmark[0] - xl, landmark[1] - yl
    return np.array([np.sqrt(dx**2 + dy**2), np.arctan2(dy, dx) - x[2]])


def H(x, landmark, sd):
    xl, yl = scanner_of(x, sd)
    dx, dy, c, s = landmark[0] - xl, landmark[1] - yl, np.cos(x[2]), np.sin(x[2])
    q = dx**2 + dy**2
    root = np.sqrt(q)
    return np.array(
        [
            [-dx / root, -dy / root, sd / root * (dx * s - dy * c)],
            [dy / q, -dx / q, -sd / q * (dx * c + dy * s) - 1],
        ]
    )


# As the package composes them --------------------------------------------------------------------


def wheels(proportional=(P1, P2)):
    return MotionModel("wheel-increments", proportional=proportional, width=W)


@pytest.mark.parametrize("control", TURNS + STRAIGHT)
@pytest.mark.parametrize("pose", POSES)
def test_motion_is_the_notes_motion(pose, control):
    x = np.array(pose)
    deltas, jacobians = wheels().increment([control])
    moved = geo.compose(x, deltas[0])
    by_pose, by_delta = geo.compose_jacobians(x, deltas[0])
    # Their V divides differences of sines by (r - l)^2, so it is exact to eps W l / (r - l)^2.
    l, r = control
    sure = max(1e-12, 4 * np.finfo(float).eps * W / (r - l) ** 2) if l != r else 1e-12
    np.testing.assert_allclose(geo.additive_error(moved, g(x, l, r)), 0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(by_pose, G(x, l, r), rtol=0, atol=1e-12)
    np.testing.assert_allclose(by_delta @ jacobians[0], V(x, l, r), rtol=0, atol=sure)
    numeric = central_difference(lambda pose: g(pose, l, r), x)
    np.testing.assert_allclose(numeric, G(x, l, r), rtol=0, atol=1e-9)
    if l != r:  # differences of the notes' own g stay off its singularity
        numeric = central_difference(lambda u: g(x, *u), [l, r], step=abs(r - l) / 8)
        np.testing.assert_allclose(numeric, V(x, l, r), rtol=0, atol=1e-6)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("l", [0.1, -0.2, 0.0])
def test_straight_on_is_the_limit_of_turns(pose, l):
    """The limits of the notes at l = r are where the package is for wheels that hardly differ."""
    x, tiny = np.array(pose), 1e-10
    deltas, jacobians = wheels().increment([(l, l + tiny)])
    by_pose, by_delta = geo.compose_jacobians(x, deltas[0])
    np.testing.assert_allclose(geo.compose(x, deltas[0])[:2], g(x, l, l)[:2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(by_pose, G(x, l, l), rtol=0, atol=1e-9)
    np.testing.assert_allclose(by_delta @ jacobians[0], V(x, l, l), rtol=0, atol=1e-8)


@pytest.mark.parametrize("control", TURNS + STRAIGHT)
@pytest.mark.parametrize("pose", POSES)
def test_prediction_is_the_notes_prediction(pose, control):
    """``G Sigma G' + V Sigma_control V'`` by the compiled kernel, which keeps one triangle."""
    x, (l, r) = np.array(pose), control
    Sigma = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])
    deltas, Q = wheels().increments([control])
    mean, P = x.copy(), np.triu(Sigma)
    move(mean, P, 3, 0, deltas[0], Q[0])
    by_pose, by_control = G(x, l, r), V(x, l, r)
    expected = by_pose @ Sigma @ by_pose.T + by_control @ sigma_control(l, r) @ by_control.T
    assert geo.wrap(mean[2] - g(x, l, r)[2]) == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(mean[:2], g(x, l, r)[:2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.triu(P), np.triu(expected), rtol=0, atol=1e-11)


@pytest.mark.parametrize("sd", [0.0, 0.03, -0.4])
@pytest.mark.parametrize("landmark", LANDMARKS)
@pytest.mark.parametrize("pose", POSES)
def test_measurement_is_the_notes_measurement(pose, landmark, sd):
    x, point = np.array(pose), np.array(landmark)
    sensor = Sensor("range-bearing", np.eye(2), mount=[sd, 0.0, 0.0])
    value, by_pose, _ = sensor.observe(x, point)
    expected, compiled = np.empty(2), np.empty((2, 7))
    expect(RANGE_BEARING, POINT, placed(sensor.mount, x), point, expected, compiled)
    for ours in (value, expected):
        np.testing.assert_allclose(sensor.difference(ours, h(x, point, sd)), 0, rtol=0, atol=1e-12)
    for ours in (by_pose, compiled[:, :3]):
        np.testing.assert_allclose(ours, H(x, point, sd), rtol=0, atol=1e-12)
    numeric = central_difference(lambda x: h(x, point, sd), x, difference=sensor.difference)
    np.testing.assert_allclose(numeric, H(x, point, sd), rtol=0, atol=1e-9)


@pytest.mark.parametrize("sd", [0.0, 0.03])
@pytest.mark.parametrize("pose", POSES)
def test_detected_landmarks_lie_where_the_notes_put_them(pose, sd):
    x, (D, phi) = np.array(pose), (2.5, 0.7)
    xl, yl = scanner_of(x, sd)
    point, by_pose, noise = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
    value, mount = np.array([D, phi]), np.array([sd, 0.0, 0.0])
    locate(RANGE_BEARING, mount, x, value, np.eye(2), point, by_pose, noise)
    expected = [xl + D * np.cos(x[2] + phi), yl + D * np.sin(x[2] + phi)]
    np.testing.assert_allclose(point, expected, rtol=0, atol=1e-12)


def test_the_innovation_covariance_is_dense_algebra(rng):
    A = rng.normal(size=(3, 3))
    P, jacobian = A @ A.T, rng.normal(size=(2, 7))
    for d in (1, 2):
        HP, S = np.full((2, 3), np.nan), np.full((2, 2), np.nan)
        through(np.triu(P), jacobian, d, HP, S)
        dense = jacobian[:d, :3]
        np.testing.assert_allclose(HP[:d], dense @ P, rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(S[:d, :d], dense @ P @ dense.T, rtol=1e-13, atol=1e-13)
