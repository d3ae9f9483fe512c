"""Landmarks of open distance: inverse depth, its models, prior and linearity index."""

from __future__ import annotations

import numpy as np
import pytest
from numerics import central_difference, subtract_angles
from numpy.testing import assert_allclose

from ekfslam import geometry as geo
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.models.landmarks import (
    depth_prior,
    inverse_depth,
    linearity,
    observe_inverse_depth,
    to_point,
)
from ekfslam.models.sensors import Sensor

MOUNTS = {"centre": [0.0, 0.0, 0.0], "ahead": [0.8, 0.0, 0.0], "turned": [0.5, -0.4, 2.3]}
SIZES = {"bearing": 1, "range": 1, "range-bearing": 2, "xy": 2}
each_kind = pytest.mark.parametrize("kind", SIZES)
each_mount = pytest.mark.parametrize("mount", MOUNTS.values(), ids=MOUNTS)


def sensor_of(kind, mount=(0.0, 0.0, 0.0)):
    return Sensor(kind, 0.01 * np.eye(SIZES[kind]), mount)


def subtraction(kind):
    """Difference of values whose last entry may be an angle."""
    angular = sensor_of(kind).view.angular

    def subtract(a, b):
        return np.where(angular, subtract_angles(a, b), np.subtract(a, b))

    return subtract


def draw(rng, count):
    """Poses, and landmarks whose points are between 1.5 and 9 m from where they were first seen."""
    poses = np.column_stack([rng.uniform(-9, 9, (count, 2)), rng.uniform(-np.pi, np.pi, count)])
    start = poses[:, :2] + rng.uniform(10, 15, (count, 2))
    alpha, rho = rng.uniform(-np.pi, np.pi, count), 1 / rng.uniform(1.5, 9, count)
    return poses, np.column_stack([start, alpha, rho])


# Inverse depth: direct model ----------------------------------------------------------------------


def test_a_point_by_hand():
    point, _ = to_point([1.0, 2.0, np.pi / 2, 0.25])
    assert_allclose(point, [1.0, 6.0], atol=1e-15)


def test_the_point_and_its_jacobian(rng):
    _, entries = draw(rng, 20)
    points, jacobians = to_point(entries)
    for k, landmark in enumerate(entries):
        assert_allclose(points[k], landmark[:2] + np.array(
            [np.cos(landmark[2]), np.sin(landmark[2])]) / landmark[3])  # fmt: skip
        numeric = central_difference(lambda x: to_point(x)[0], landmark, step=1e-3)
        assert_allclose(jacobians[k], numeric, rtol=0, atol=1e-7)


@pytest.mark.parametrize("rho", [0.0, -0.1, np.nan])
def test_what_is_at_infinity_has_no_point(rho):
    with pytest.raises(InputError, match=f"positive inverse depth has a point, got {rho}"):
        to_point([[0, 0, 0, 1.0], [0, 0, 0, rho]])


@each_kind
@each_mount
def test_an_inverse_depth_is_observed_as_its_point_is(kind, mount, rng):
    sensor = sensor_of(kind, mount)
    poses, entries = draw(rng, 100)
    points, wrt_landmark = to_point(entries)
    values, wrt_pose, wrt_entry = observe_inverse_depth(sensor, poses, entries)
    expected, expected_pose, wrt_point = sensor.observe(poses, points)
    assert values.shape == (100, SIZES[kind])
    assert_allclose(subtraction(kind)(values, expected), 0, atol=1e-12)
    assert_allclose(wrt_pose, expected_pose, atol=1e-12)
    assert_allclose(wrt_entry, wrt_point @ wrt_landmark, atol=1e-11)


@each_kind
@each_mount
def test_the_direct_model_has_the_jacobians_of_differences(kind, mount, rng):
    sensor, subtract = sensor_of(kind, mount), subtraction(kind)
    for pose, landmark in zip(*draw(rng, 20), strict=True):
        _, wrt_pose, wrt_landmark = observe_inverse_depth(sensor, pose, landmark)
        numeric_pose = central_difference(
            lambda x, y=landmark: observe_inverse_depth(sensor, x, y)[0], pose, difference=subtract
        )
        numeric_landmark = central_difference(
            lambda y, x=pose: observe_inverse_depth(sensor, x, y)[0],
            landmark,
            step=1e-3,
            difference=subtract,
        )
        assert_allclose(wrt_pose, numeric_pose, rtol=0, atol=1e-9)
        assert_allclose(wrt_landmark, numeric_landmark, rtol=0, atol=1e-7)


@each_mount
@pytest.mark.parametrize("rho", [0.0, -0.03])
def test_a_bearing_stays_smooth_where_rho_passes_through_zero(mount, rho, rng):
    """With the unscaled v, or an arctangent of one argument, it would jump by pi there."""
    sensor = sensor_of("bearing", mount)
    for pose, landmark in zip(*draw(rng, 20), strict=True):
        landmark = np.array([*landmark[:3], rho])
        value, wrt_pose, wrt_landmark = observe_inverse_depth(sensor, pose, landmark)
        if rho == 0:
            heading = geo.compose(pose, sensor.mount)[2]
            assert_allclose(subtract_angles(value[0], landmark[2] - heading), 0, atol=1e-14)
            assert_allclose(wrt_pose[0, :2], 0)  # a point at infinity has no parallax
        for wrt, numeric in (
            (wrt_pose, central_difference(
                lambda x, y=landmark: observe_inverse_depth(sensor, x, y)[0], pose,
                difference=subtract_angles)),
            (wrt_landmark, central_difference(
                lambda y, x=pose: observe_inverse_depth(sensor, x, y)[0], landmark, step=1e-3,
                difference=subtract_angles)),
        ):  # fmt: skip
            assert_allclose(wrt, numeric, rtol=0, atol=1e-7)


@pytest.mark.parametrize("kind", ["range", "range-bearing", "xy"])
def test_a_range_needs_a_positive_rho(kind):
    with pytest.raises(InputError, match="positive inverse depth"):
        observe_inverse_depth(sensor_of(kind), np.zeros(3), [1.0, 0.0, 0.0, -0.1])


@each_kind
def test_the_direct_model_broadcasts_and_does_not_know_where_the_world_is(kind, rng):
    sensor = sensor_of(kind, MOUNTS["turned"])
    poses, entries = draw(rng, 6)
    together = observe_inverse_depth(sensor, poses[0], entries)
    for k in range(6):
        alone = observe_inverse_depth(sensor, poses[0], entries[k])
        for stacked, one in zip(together, alone, strict=True):
            assert_allclose(stacked[k], one, rtol=1e-13, atol=1e-14)
    motion = np.array([3.0, -7.0, 2.0])
    moved = np.column_stack([geo.compose(motion, entries[:, :3]), entries[:, 3]])
    values = observe_inverse_depth(sensor, geo.compose(motion, poses), moved)[0]
    apart = subtraction(kind)(values, observe_inverse_depth(sensor, poses, entries)[0])
    assert_allclose(apart, 0, atol=1e-12)


# Inverse depth: inverse model ---------------------------------------------------------------------


@each_mount
def test_the_inverse_model_and_its_jacobians(mount, rng):
    sensor = sensor_of("bearing", mount)
    poses, entries = draw(rng, 20)
    values = rng.uniform(-np.pi, np.pi, (20, 1))
    made, wrt_pose, wrt_value, wrt_prior = inverse_depth(sensor, poses, values, entries[:, 3])
    assert (wrt_pose.shape, wrt_value.shape, wrt_prior.shape) == (
        (20, 4, 3), (20, 4, 1), (20, 4, 1))  # fmt: skip

    def subtract(a, b):
        apart = a - b
        return np.array([*apart[:2], subtract_angles(a[2], b[2]), apart[3]])

    for k in range(20):
        at = (poses[k], values[k], entries[k, 3:])
        assert_allclose(made[k, :3], geo.compose(geo.compose(poses[k], sensor.mount),
                                                 [0, 0, values[k, 0]]), atol=1e-14)  # fmt: skip
        assert made[k, 3] == entries[k, 3]
        for which, jacobian in enumerate((wrt_pose[k], wrt_value[k], wrt_prior[k])):

            def vary(x, which=which, at=at):
                pose, value, rho = (x if i == which else old for i, old in enumerate(at))
                return inverse_depth(sensor, pose, value, rho[0])[0]

            numeric = central_difference(vary, at[which], difference=subtract)
            assert_allclose(jacobian, numeric, rtol=0, atol=1e-9)


@each_mount
def test_a_new_landmark_is_seen_where_it_was_whatever_its_prior(mount, rng):
    """h(x, g(x, y, s)) = y, hence H_l G_y = 1, H_l G_s = 0 and H_x + H_l G_x = 0."""
    sensor = sensor_of("bearing", mount)
    poses, _ = draw(rng, 50)
    values, rho = rng.uniform(-np.pi, np.pi, (50, 1)), rng.normal(size=50)
    made, of_pose, of_value, of_prior = inverse_depth(sensor, poses, values, rho)
    seen, wrt_pose, wrt_landmark = observe_inverse_depth(sensor, poses, made)
    assert_allclose(subtract_angles(seen, values), 0, atol=1e-13)
    assert_allclose(wrt_landmark @ of_value, np.ones((50, 1, 1)), atol=1e-13)
    assert_allclose(wrt_landmark @ of_prior, np.zeros((50, 1, 1)), atol=1e-13)
    assert_allclose(wrt_pose + wrt_landmark @ of_pose, np.zeros((50, 1, 3)), atol=1e-13)


def test_one_prior_serves_many_bearings():
    made, *_ = inverse_depth(sensor_of("bearing"), np.zeros(3), [[0.1], [0.2]], 0.5)
    assert_allclose(made, [[0, 0, 0.1, 0.5], [0, 0, 0.2, 0.5]])


@pytest.mark.parametrize("kind", ["range", "range-bearing", "xy"])
def test_inverse_depth_starts_from_a_bearing(kind):
    with pytest.raises(UnsupportedError, match="starts from a bearing; sensor is " + kind):
        inverse_depth(sensor_of(kind), np.zeros(3), np.zeros(SIZES[kind]), 1.0)


def test_the_prior_reaches_from_infinity_to_the_least_distance():
    mean, variance = depth_prior(2.5)
    assert mean == pytest.approx(0.2)
    assert mean - 2 * np.sqrt(variance) == pytest.approx(0, abs=1e-15)
    assert mean + 2 * np.sqrt(variance) == pytest.approx(1 / 2.5)


@pytest.mark.parametrize("least", [0, -1.0, np.inf, np.nan])
def test_the_prior_needs_a_least_distance(least):
    with pytest.raises(InputError, match="state the sensor's min_range"):
        depth_prior(least)


# Linearity index ----------------------------------------------------------------------------------


def test_the_index_is_the_ratio_of_derivatives_over_two_sigmas(rng):
    """2 sigma_d |u''| / |u'| for the tangent u of the angle that distance makes (Civera et al.)."""
    for _ in range(20):
        x0, y0 = rng.uniform(-5, 5, 2)
        alpha, rho, sensor = rng.uniform(-3, 3), rng.uniform(0.1, 1), rng.uniform(-5, 5, 2)
        variance = rng.uniform(1e-4, 1e-2)
        direction = np.array([np.cos(alpha), np.sin(alpha)])
        start = np.array([x0, y0])
        sight = start + direction / rho - sensor

        def tangent(distance, start=start, direction=direction, sensor=sensor, sight=sight):
            v = start + distance[0] * direction - sensor
            return (sight[0] * v[1] - sight[1] * v[0]) / (sight @ v)

        at = np.array([1 / rho])
        step = 0.05 * min(1, np.linalg.norm(sight))
        first = central_difference(tangent, at, step)[0]
        second = central_difference(
            lambda d, f=tangent, step=step: central_difference(f, d, step)[0], at, step
        )[0]
        index = linearity(x0, y0, alpha, rho, variance, *sensor)
        assert index == pytest.approx(
            2 * np.sqrt(variance) / rho**2 * abs(second / first), rel=1e-6
        )


def test_the_index_in_closed_form():
    sigma, rho = 0.02, 0.5
    assert linearity(0, 0, 0, rho, sigma**2, 0, 0) == pytest.approx(4 * sigma / rho)
    assert linearity(0, 0, 0, rho, sigma**2, 2.0, 7.0) == pytest.approx(0, abs=1e-15)  # 90 degrees
    at_45 = 4 * sigma / rho**2 / np.hypot(2, 2) * np.sqrt(0.5)
    assert linearity(0, 0, 0, rho, sigma**2, 0, 2.0) == pytest.approx(at_45)
    for scale in (0.1, 30.0):  # of the unit of length
        same = linearity(0, 0, 0, rho / scale, (sigma / scale) ** 2, 0, 2.0 * scale)
        assert same == pytest.approx(at_45)


def test_what_has_no_point_is_never_linear():
    for landmark in ((0, 0, 0, 0.0), (0, 0, 0, -0.1)):
        assert linearity(*landmark, 1e-12, 5.0, 5.0) == np.inf
    assert linearity(0.0, 0.0, 0.0, 0.5, 1e-12, 2.0, 0.0) == np.inf  # on the spot
