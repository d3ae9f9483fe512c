"""Sensors: direct and inverse models, mounts, visibility, noise, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from numerics import assert_sampled, central_difference, subtract_last_angle
from numpy.testing import assert_allclose, assert_array_equal

from ekfslam import geometry as geo
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.models.sensors import BEARING, RANGE, RANGE_BEARING, VIEWS, XY, Sensor

NOISE = np.array([[0.04, 0.003], [0.003, 0.01]])
MOUNTS = {
    "centre": [0.0, 0.0, 0.0],
    "ahead": [0.8, 0.0, 0.0],
    "corner": [0.5, -0.4, 0.0],
    "turned": [0.5, -0.4, 2.3],
    "backwards": [-0.6, 0.1, np.pi],
}
FULL = ["range-bearing", "xy"]
PARTIAL = ["bearing", "range"]
each_kind = pytest.mark.parametrize("kind", VIEWS)
each_full_kind = pytest.mark.parametrize("kind", FULL)
each_partial_kind = pytest.mark.parametrize("kind", PARTIAL)
each_mount = pytest.mark.parametrize("mount", MOUNTS.values(), ids=MOUNTS)


def noise_of(kind):
    """As many rows and columns of NOISE as the kind reports numbers."""
    size = 1 if kind in PARTIAL else 2
    return NOISE[:size, :size]


def subtraction(kind):
    return subtract_last_angle if kind in ("range-bearing", "bearing") else np.subtract


def draw(rng, count):
    """Poses, and points between 1 and 9 m from them."""
    poses = np.column_stack([rng.uniform(-9, 9, (count, 2)), rng.uniform(-np.pi, np.pi, count)])
    direction, distance = rng.uniform(-np.pi, np.pi, count), rng.uniform(2.5, 9, count)
    offset = distance[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    return poses, poses[:, :2] + offset


# Models and Jacobians --------------------------------------------------------------------------


@each_kind
@each_mount
def test_direct_model_and_its_jacobians(kind, mount, rng):
    sensor = Sensor(kind, noise_of(kind), mount)
    for pose, point in zip(*draw(rng, 20), strict=True):
        _, wrt_pose, wrt_point = sensor.observe(pose, point)
        numeric_pose = central_difference(
            lambda x, point=point: sensor.observe(x, point)[0], pose, difference=subtraction(kind)
        )
        numeric_point = central_difference(
            lambda x, pose=pose: sensor.observe(pose, x)[0], point, difference=subtraction(kind)
        )
        assert_allclose(wrt_pose, numeric_pose, rtol=0, atol=1e-9)
        assert_allclose(wrt_point, numeric_point, rtol=0, atol=1e-9)


@each_full_kind
@each_mount
def test_inverse_model_and_its_jacobians(kind, mount, rng):
    sensor = Sensor(kind, noise_of(kind), mount)
    for pose, point in zip(*draw(rng, 20), strict=True):
        value = sensor.observe(pose, point)[0]
        located, wrt_pose, wrt_value = sensor.locate(pose, value)
        numeric_pose = central_difference(lambda x, value=value: sensor.locate(x, value)[0], pose)
        numeric_value = central_difference(lambda x, pose=pose: sensor.locate(pose, x)[0], value)
        assert_allclose(located, point, atol=1e-12)
        assert_allclose(wrt_pose, numeric_pose, rtol=0, atol=1e-9)
        assert_allclose(wrt_value, numeric_value, rtol=0, atol=1e-9)


@each_full_kind
@each_mount
def test_inverse_jacobians_are_those_of_the_implicit_function(kind, mount, rng):
    """h(x, g(x, y)) = y for all x and y, hence H_p G_y = I and H_x + H_p G_x = 0."""
    sensor = Sensor(kind, noise_of(kind), mount)
    poses, points = draw(rng, 100)
    values, wrt_pose, wrt_point = sensor.observe(poses, points)
    _, inverse_pose, inverse_value = sensor.locate(poses, values)
    assert_allclose(wrt_point @ inverse_value - np.eye(2), 0, atol=1e-12)
    assert_allclose(wrt_pose + wrt_point @ inverse_pose, 0, atol=1e-12)


@each_kind
@each_mount
def test_observation_does_not_change_when_the_world_is_moved(kind, mount, rng):
    sensor = Sensor(kind, noise_of(kind), mount)
    poses, points = draw(rng, 100)
    motion = np.array([3.0, -7.0, 2.0])
    moved = sensor.observe(geo.compose(motion, poses), geo.from_frame(motion, points))[0]
    difference = subtraction(kind)(moved, sensor.observe(poses, points)[0])
    assert_allclose(difference, 0, atol=1e-12)


def test_a_point_measured_by_hand():
    """Sensor at (2, 3) looking along world y; the point is 4 m ahead and 3 m to its left."""
    pose, mount, point = [1.0, 2.0, 0.0], [1.0, 1.0, np.pi / 2], [-1.0, 7.0]
    ranging = Sensor("range-bearing", NOISE, mount).observe(pose, point)[0]
    relative = Sensor("xy", NOISE, mount).observe(pose, point)[0]
    assert_allclose(ranging, [5.0, np.arctan2(3, 4)], atol=1e-15)
    assert_allclose(relative, [4.0, 3.0], atol=1e-15)
    for kind, expected in (("range", 5.0), ("bearing", np.arctan2(3, 4))):
        partial = Sensor(kind, noise_of(kind), mount).observe(pose, point)[0]
        assert_allclose(partial, [expected], atol=1e-15)


@each_mount
def test_partial_views_are_the_halves_of_range_and_bearing(mount, rng):
    """One row of the full view each: values, both Jacobians."""
    poses, points = draw(rng, 100)
    whole = Sensor("range-bearing", NOISE, mount).observe(poses, points)
    halves = [Sensor(kind, [[1.0]], mount).observe(poses, points) for kind in ("range", "bearing")]
    for full, ranges, bearings in zip(whole, *halves, strict=True):
        assert_allclose(np.concatenate([ranges, bearings], axis=1), full, rtol=0, atol=1e-14)


@each_partial_kind
def test_what_a_partial_view_does_not_tell_changes_nothing(kind, rng):
    """A bearing does not change along the ray, nor a range around the sensor."""
    sensor = Sensor(kind, noise_of(kind), MOUNTS["turned"])
    poses, points = draw(rng, 50)
    value, _, wrt_point = sensor.observe(poses, points)
    origin = geo.compose(poses, sensor.mount)[:, :2]
    ray = points - origin
    if kind == "bearing":
        blind, other = ray, origin + 3.0 * ray
    else:
        blind = np.column_stack([-ray[:, 1], ray[:, 0]])
        other = origin + blind
    assert_allclose(np.einsum("mij,mj->mi", wrt_point, blind), 0, atol=1e-12)
    difference = sensor.difference(sensor.observe(poses, other)[0], value)
    assert_allclose(difference, 0, atol=1e-12)


@each_partial_kind
def test_a_partial_view_has_no_inverse(kind):
    sensor = Sensor(kind, noise_of(kind), name="eye")
    with pytest.raises(UnsupportedError, match=f"one {kind} of eye does not determine a point"):
        sensor.locate(np.zeros(3), [1.0])


@each_kind
def test_direct_model_broadcasts_one_pose_over_points(kind, rng):
    sensor = Sensor(kind, noise_of(kind), MOUNTS["turned"])
    poses, points = draw(rng, 5)
    together = sensor.observe(poses[0], points)
    for k in range(5):
        for stacked, alone in zip(together, sensor.observe(poses[0], points[k]), strict=True):
            assert_allclose(stacked[k], alone, rtol=1e-14, atol=1e-15)


@each_full_kind
def test_inverse_model_broadcasts_one_pose_over_points(kind, rng):
    sensor = Sensor(kind, noise_of(kind), MOUNTS["turned"])
    poses, points = draw(rng, 5)
    together = sensor.observe(poses[0], points)
    back = sensor.locate(poses[0], together[0])
    for k in range(5):
        for stacked, alone in zip(back, sensor.locate(poses[0], together[0][k]), strict=True):
            assert_allclose(stacked[k], alone, rtol=1e-14, atol=1e-15)


@each_full_kind
@each_mount
def test_mapped_covariance_of_a_new_landmark(kind, mount, rng):
    """Drawn poses and measurements pushed through the inverse model."""
    sensor = Sensor(kind, noise_of(kind), mount)
    pose, point, count = np.array([1.0, 2.0, 0.6]), np.array([4.0, 5.0]), 100_000
    root = np.array([[2.0, 0, 0], [0.5, 1.5, 0], [0.3, -0.4, 1.0]]) * 1e-3
    noise = 1e-5 * NOISE
    value = sensor.observe(pose, point)[0]
    poses = pose + rng.normal(size=(count, 3)) @ root.T
    values = rng.multivariate_normal(value, noise, count)
    located, wrt_pose, wrt_value = sensor.locate(pose, value)
    covariance = geo.congruence(wrt_pose, root @ root.T) + geo.congruence(wrt_value, noise)
    assert_sampled(sensor.locate(poses, values)[0] - located, covariance)


@each_kind
def test_innovation_covariance(kind, rng):
    """Drawn poses and landmarks pushed through the direct model."""
    sensor = Sensor(kind, noise_of(kind), MOUNTS["turned"])
    pose, point, count = np.array([1.0, 2.0, 0.6]), np.array([4.0, 5.0]), 100_000
    poses = pose + 1e-3 * rng.normal(size=(count, 3))
    points = point + 2e-3 * rng.normal(size=(count, 2))
    value, wrt_pose, wrt_point = sensor.observe(pose, point)
    covariance = 1e-6 * wrt_pose @ wrt_pose.T + 4e-6 * wrt_point @ wrt_point.T
    drawn = sensor.observe(poses, points)[0]
    assert_sampled(sensor.difference(drawn, value), covariance)


# Differences -----------------------------------------------------------------------------------


def test_difference_wraps_the_bearing_and_nothing_else():
    values, expected = np.array([[9.0, 3.0], [1.0, -3.0]]), np.array([[1.0, -3.0], [9.0, 3.0]])
    turn = 2 * np.pi - 6.0
    assert_allclose(
        Sensor("range-bearing", NOISE).difference(values, expected), [[8, -turn], [-8, turn]]
    )
    assert_array_equal(Sensor("xy", NOISE).difference(values, expected), values - expected)
    bearings = Sensor("bearing", [[0.01]]).difference(values[:, 1:], expected[:, 1:])
    assert_allclose(bearings, [[-turn], [turn]])
    ranges = Sensor("range", [[0.01]]).difference(values[:, :1], expected[:, :1])
    assert_array_equal(ranges, [[8.0], [-8.0]])


def test_views_carry_the_codes_that_the_kernels_know():
    assert Sensor("range-bearing", NOISE).view.code == RANGE_BEARING
    assert Sensor("xy", NOISE).view.code == XY
    assert VIEWS["bearing"].code == BEARING
    assert VIEWS["range"].code == RANGE
    assert len({view.code for view in VIEWS.values()}) == len(VIEWS)


def test_views_say_how_many_numbers_they_report():
    assert {kind: view.size for kind, view in VIEWS.items()} == {
        "range-bearing": 2,
        "xy": 2,
        "bearing": 1,
        "range": 1,
    }


# Visibility ------------------------------------------------------------------------------------


@each_kind
def test_range_limits_are_inside(kind):
    sensor = Sensor(kind, noise_of(kind), min_range=1.0, max_range=4.0)
    distance = np.array([0.0, np.nextafter(1, 0), 1.0, 2.0, 4.0, np.nextafter(4, 9)])
    points = np.column_stack([distance, np.zeros(6)])
    assert_array_equal(sensor.sees(np.zeros(3), points), [False, False, True, True, True, False])


@each_kind
def test_field_of_view_is_the_whole_opening_angle(kind):
    sensor = Sensor(kind, noise_of(kind), field_of_view=np.deg2rad(60))
    bearing = np.deg2rad([-180, -90, -30.001, -29.999, 0, 29.999, 30.001, 90])
    points = 3 * np.column_stack([np.cos(bearing), np.sin(bearing)])
    seen = [False, False, False, True, True, True, False, False]
    assert_array_equal(sensor.sees(np.zeros(3), points), seen)


@each_kind
def test_an_open_sensor_sees_all_around(kind, rng):
    poses, points = draw(rng, 500)
    assert Sensor(kind, noise_of(kind)).sees(poses, points).all()
    assert Sensor(kind, noise_of(kind)).sees(np.zeros(3), [[-1.0, 0.0], [-1.0, -0.0]]).all()


def test_visibility_is_that_of_the_mounted_sensor():
    """A camera that looks back from the tail sees what is behind the tail."""
    camera = Sensor(
        "xy", NOISE, mount=[-1.0, 0.0, np.pi], max_range=2.0, field_of_view=np.deg2rad(90)
    )
    pose = [10.0, 0.0, np.pi / 2]
    points = [[10.0, -2.9], [10.0, -3.1], [10.0, 2.0], [11.0, -2.2], [11.5, -2.2]]
    assert_array_equal(camera.sees(pose, points), [True, False, False, True, False])


def test_limits_are_what_decides_on_visibility(rng):
    sensor = Sensor("bearing", [[0.01]], MOUNTS["turned"], 3.0, 6.0, 2.0)
    least, most, half = sensor.limits
    poses, points = draw(rng, 500)
    local = geo.to_frame(geo.compose(poses, sensor.mount), points)
    distance, bearing = np.hypot(*local.T), np.arctan2(local[:, 1], local[:, 0])
    inside = (least <= distance) & (distance <= most) & (np.abs(bearing) <= half)
    assert_array_equal(sensor.sees(poses, points), inside)
    assert 0 < inside.sum() < 500


# Noise -----------------------------------------------------------------------------------------


def test_range_noise_grows_with_the_range_alone():
    values = np.array([[2.0, 0.3], [5.0, -0.1], [0.0, 0.0]])
    covariances = Sensor("range-bearing", NOISE, range_growth=0.1).covariances(values)
    growth = np.zeros((3, 2, 2))
    growth[:, 0, 0] = [0.04, 0.25, 0.0]
    assert_allclose(covariances, NOISE + growth, rtol=1e-15)
    alone = Sensor("range", NOISE[:1, :1], range_growth=0.1).covariances(values[:, :1])
    assert_allclose(alone, (NOISE + growth)[:, :1, :1], rtol=1e-15)


@each_kind
def test_constant_noise_is_the_same_for_every_value(kind, rng):
    noise = noise_of(kind)
    covariances = Sensor(kind, noise).covariances(rng.normal(size=(4, len(noise))))
    assert_array_equal(covariances, np.broadcast_to(noise, (4, *noise.shape)))


# What is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"covariance": np.eye(3)}, r"covariance of eye must have shape \(2, 2\)"),
        ({"covariance": [[1, 2], [2, 1]]}, "positive semi-definite"),
        ({"covariance": [[1, 0.5], [0, 1]]}, "not symmetric"),
        ({"covariance": [[np.nan, 0], [0, 1]]}, "NaN or infinite"),
        ({"mount": [0, 0]}, "mount of eye must be three finite numbers"),
        ({"mount": [0, np.nan, 0]}, "mount of eye must be three finite numbers"),
        ({"min_range": -0.1}, "min_range <= max_range"),
        ({"min_range": 2, "max_range": 1}, "got 2 and 1"),
        ({"max_range": np.nan}, "min_range <= max_range"),
        ({"field_of_view": 0}, "field_of_view of eye"),
        ({"field_of_view": 7}, "field_of_view of eye"),
        ({"field_of_view": np.nan}, "field_of_view of eye"),
        ({"range_growth": -0.1}, "range_growth of eye must be non-negative"),
        ({"range_growth": np.inf}, "range_growth of eye must be non-negative"),
        ({"kind": "xy", "range_growth": 0.1}, "needs a range"),
        ({"kind": "bearing", "covariance": [[1]], "range_growth": 0.1}, "needs a range"),
        ({"kind": "bearing"}, r"covariance of eye must have shape \(1, 1\), got \(2, 2\)"),
        ({"kind": "range"}, r"covariance of eye must have shape \(1, 1\), got \(2, 2\)"),
        ({"kind": "range", "covariance": [[-1]]}, "positive semi-definite"),
    ],
)
def test_settings_that_make_no_sense(settings, message):
    defaults = {"kind": "range-bearing", "covariance": NOISE, "name": "eye"}
    with pytest.raises(InputError, match=message) as caught:
        Sensor(**{**defaults, **settings})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("settings", [{"mount": "ahead"}, {"max_range": "far"}, {"max_range": "5"}])
def test_settings_of_the_wrong_type(settings):
    with pytest.raises(InputError):
        Sensor("range-bearing", NOISE, **settings)


def test_unknown_kind_names_the_close_ones():
    with pytest.raises(UnknownNameError, match="did you mean range-bearing"):
        Sensor("range-bearings", NOISE)


def test_arrays_are_read_only_copies():
    noise, mount = NOISE.copy(), np.array([1.0, 2.0, 3.0])
    sensor = Sensor("xy", noise, mount)
    noise[0, 0] = mount[0] = 99.0
    assert sensor.covariance[0, 0] == NOISE[0, 0]
    assert sensor.mount[0] == 1.0
    for array in (sensor.covariance, sensor.mount):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_to_dict_makes_the_same_sensor_again():
    sensor = Sensor("range-bearing", NOISE, MOUNTS["turned"], 0.5, 30.0, 3.0, 0.02, "laser")
    again = Sensor(**sensor.to_dict())
    assert again.to_dict() == sensor.to_dict()
    assert_array_equal(again.covariance, sensor.covariance)
    assert_array_equal(again.mount, sensor.mount)


def test_two_sensors_can_be_compared():
    assert (Sensor("xy", NOISE) == Sensor("xy", NOISE)) in (True, False)
