"""The compiled models against the vectorised ones and against numerical derivatives."""

import numpy as np
import pytest
from numerics import central_difference, subtract_angles

from ekfslam import geometry as geo
from ekfslam.filters import measure
from ekfslam.models.landmarks import inverse_depth, observe_inverse_depth, to_point
from ekfslam.models.sensors import VIEWS, Sensor
from ekfslam.observations import padded

FULL, PARTIAL = ("range-bearing", "xy"), ("bearing", "range")
MOUNTS = ([0, 0, 0], [0, 0, 2.5], [0.7, -0.3, -1.9])
NOISE = np.array([[0.04, 0.006], [0.006, 0.01]])
SENSORS = [
    Sensor(kind, NOISE[: VIEWS[kind].size, : VIEWS[kind].size], mount=mount)
    for kind in (*FULL, *PARTIAL)
    for mount in MOUNTS
]
TARGETS = {"point": 2, "robot": 3, "inverse depth": 4}
NUMERIC = {"rtol": 0, "atol": 1e-9}

of_all = pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: f"{s.kind} {s.mount}")
of_full = pytest.mark.parametrize("sensor", SENSORS[:6], ids=lambda s: f"{s.kind} {s.mount}")


@pytest.fixture(params=["compiled", "python"])
def kernel(request):
    """Finds a kernel by name, compiled or as the plain Python that it is made from."""

    def find(name):
        function = getattr(measure, name)
        return function if request.param == "compiled" else getattr(function, "py_func", function)

    return find


def close(actual, expected, scale=1.0):
    """Equal to round-off of a few dozen operations on numbers of the given size."""
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-13 * max(scale, 1.0))


def scene(rng, sensor, size):
    """A pose, and a target some metres away from the sensor; inverse depths also of far points."""
    pose = rng.normal(size=3) * [5, 5, 3]
    frame = geo.compose(pose, sensor.mount)
    angle, distance = rng.uniform(-np.pi, np.pi), rng.uniform(2, 9)
    point = frame[:2] + distance * np.array([np.cos(angle), np.sin(angle)])
    if size == 2:
        return pose, point
    if size == 3:
        return pose, np.array([*point, rng.uniform(-np.pi, np.pi)])
    start = point + rng.uniform(1, 5) * geo.rotation(rng.uniform(-np.pi, np.pi))[:, 0]
    ahead = point - start
    return pose, np.array([*start, np.arctan2(*ahead[::-1]), 1 / np.linalg.norm(ahead)])


def direct(sensor, pose, target):
    """Value and Jacobians of the vectorised direct model."""
    if len(target) == 4:
        return observe_inverse_depth(sensor, pose, target)
    value, wrt_pose, wrt_point = sensor.observe(pose, target[:2])
    return value, wrt_pose, np.pad(wrt_point, ((0, 0), (0, len(target) - 2)))


def expect(kernel, sensor, pose, target):
    """Value and Jacobian of the compiled direct model; what it does not write stays NaN."""
    expected, H = np.full(2, np.nan), np.full((2, 7), np.nan)
    placed = kernel("placed")(sensor.mount.copy(), pose)
    arguments = sensor.view.code, len(target), placed, target
    seen = kernel("expect")(*arguments, expected, H)
    d = sensor.view.size
    assert np.isnan(expected[d:]).all()
    assert np.isnan(H[d:]).all()
    assert np.isnan(H[:, 3 + len(target) :]).all()
    return expected[:d], H[:d, : 3 + len(target)], seen


@pytest.mark.parametrize("sensor", SENSORS[::3], ids=lambda s: s.kind)
def test_rows_of_a_view(kernel, sensor):
    assert kernel("rows_of")(sensor.view.code) == sensor.view.size


# Direct models ------------------------------------------------------------------------------------


@of_all
@pytest.mark.parametrize("size", TARGETS.values(), ids=TARGETS)
def test_expect_is_the_direct_model(kernel, size, sensor, rng):
    for _ in range(20):
        pose, target = scene(rng, sensor, size)
        value, H, seen = expect(kernel, sensor, pose, target)
        model, wrt_pose, wrt_target = direct(sensor, pose, target)
        assert seen
        close(sensor.difference(value, model), 0, 50)
        both = np.concatenate([wrt_pose, wrt_target], axis=1)
        close(H, both, 20 + np.abs(both).max() ** 2)


@of_all
@pytest.mark.parametrize("size", TARGETS.values(), ids=TARGETS)
def test_the_jacobian_of_expect_is_the_central_difference(kernel, size, sensor, rng):
    for _ in range(5):
        pose, target = scene(rng, sensor, size)

        def value(x, sensor=sensor):
            return expect(kernel, sensor, x[:3].copy(), x[3:].copy())[0]

        numeric = central_difference(
            value, np.concatenate([pose, target]), 2e-3, difference=sensor.difference
        )
        np.testing.assert_allclose(expect(kernel, sensor, pose, target)[1], numeric, **NUMERIC)


@pytest.mark.parametrize("kind", [*FULL, *PARTIAL])
@pytest.mark.parametrize("rho", [0.0, -0.2])
def test_at_infinity_and_beyond_there_is_a_bearing_and_nothing_else(kernel, kind, rho):
    sensor = SENSORS[3 * [*FULL, *PARTIAL].index(kind) + 2]
    pose, target = np.array([1.0, 2.0, 0.4]), np.array([0.5, 0.0, 1.0, rho])
    value, H, seen = expect(kernel, sensor, pose, target)
    assert seen == (kind == "bearing")
    if seen:
        model, wrt_pose, wrt_target = observe_inverse_depth(sensor, pose, target)
        close(value, model)
        close(H, np.concatenate([wrt_pose, wrt_target], axis=1))


def test_a_bearing_of_an_inverse_depth_passes_through_infinity_without_a_jump(kernel):
    sensor, pose = SENSORS[8], np.array([1.0, 2.0, 0.4])
    rhos = np.linspace(-0.01, 0.01, 2001)
    seen = [expect(kernel, sensor, pose, np.array([0.5, 0.0, 1.0, rho]))[0][0] for rho in rhos]
    assert np.abs(subtract_angles(seen[1:], seen[:-1])).max() < 1e-4


# Innovations --------------------------------------------------------------------------------------


@pytest.mark.parametrize("sensor", SENSORS[::3], ids=lambda s: s.kind)
def test_innovation_wraps_bearings_and_nothing_else(kernel, sensor):
    d = sensor.view.size
    for value, expected in (([4.0, 3.1], [9.0, -3.1]), ([9.0, -3.1], [1.0, 3.1]), ([0, 7], [7, 0])):
        innovation = np.full(2, np.nan)
        value, expected = np.array(value, dtype=float), np.array(expected, dtype=float)
        kernel("innovate")(sensor.view.code, value, expected, innovation)
        np.testing.assert_array_equal(innovation[:d], sensor.difference(value[:d], expected[:d]))
        assert np.isnan(innovation[d:]).all()


def foresee(kernel, sensor, pose, target, value):
    """Point of linearisation, Jacobian and innovation, and whether there was something to see."""
    size, d = len(target), sensor.view.size
    point, H, nu = np.full(4, np.nan), np.full((2, 7), np.nan), np.full(2, np.nan)
    placed = kernel("placed")(sensor.mount.copy(), pose)
    arguments = sensor.view.code, size, placed, target, padded(value)
    seen = kernel("foresee")(*arguments, point, H, nu)
    return point[:size], H[:d, : 3 + size], nu[:d], seen


@of_all
@pytest.mark.parametrize("size", TARGETS.values(), ids=TARGETS)
def test_foresee_linearises_at_its_point(kernel, size, sensor, rng):
    for _ in range(10):
        pose, target = scene(rng, sensor, size)
        value = direct(sensor, pose, target)[0] + rng.normal(size=sensor.view.size) * 0.1
        point, H, nu, seen = foresee(kernel, sensor, pose, target, value)
        model, wrt_pose, wrt_target = direct(sensor, pose, point)
        assert seen
        close(nu, sensor.difference(value, model), 50)
        both = np.concatenate([wrt_pose, wrt_target], axis=1)
        close(H, both, 20 + np.abs(both).max() ** 2)
        if size < 4 or sensor.kind == "bearing":
            np.testing.assert_array_equal(point, target)
            continue
        # The same ray, and on it the point nearest to what was measured.
        np.testing.assert_array_equal(point[:3], target[:3])
        there, ahead = to_point(point)[0], geo.rotation(point[2])[:, 0]
        eye = geo.compose(pose, sensor.mount)[:2]
        if sensor.kind == "range":  # that range, if it reaches the ray
            aside = geo.perpendicular(ahead) @ (point[:2] - eye)
            close(np.linalg.norm(there - eye), max(value[0], abs(aside)), 50)
        else:
            close(ahead @ (there - sensor.locate(pose, value)[0]), 0, 50)


@pytest.mark.parametrize("sensor", SENSORS[2::3], ids=lambda s: s.kind)
@pytest.mark.parametrize("rho", [1e-3, 0.0, -0.3])
def test_a_range_of_an_inverse_depth_is_linearised_there_whatever_rho_was(kernel, rho, sensor, rng):
    """Even where rho has no point; a bearing alone is linearised where it is."""
    pose, target = scene(rng, sensor, 4)
    value = direct(sensor, pose, target)[0]
    point, _, nu, seen = foresee(kernel, sensor, pose, np.array([*target[:3], rho]), value)
    assert seen
    if sensor.kind == "bearing":
        assert point[3] == rho
        return
    np.testing.assert_allclose(point[3], target[3], rtol=1e-9)
    close(nu, 0, 1e3)


@pytest.mark.parametrize("sensor", [SENSORS[2], SENSORS[5]], ids=lambda s: s.kind)
@pytest.mark.parametrize("distance", [6.0, 14.0])
def test_of_two_points_at_a_range_the_one_in_the_measured_direction_counts(
    kernel, distance, sensor
):
    """The ray passes the sensor 3 m aside, so that two of its points are 5 m away."""
    frame = np.array([10.0, -3.0, 0.7])
    pose = geo.compose(frame, geo.inverse(sensor.mount))
    value = sensor.observe(pose, [distance, 0.0])[0]
    for rho in (1 / 6, 1 / 14, 0.5):
        point, _, nu, _ = foresee(kernel, sensor, pose, np.array([0, 0, 0, rho]), value)
        np.testing.assert_allclose(point[3], 1 / distance, rtol=1e-12)
        close(nu, 0, 50)


@pytest.mark.parametrize(("rho", "distance"), [(0.5, 6), (0.16, 6), (0.08, 14), (-1.0, 14)])
def test_of_two_points_at_a_range_alone_the_one_nearer_to_the_present_counts(kernel, rho, distance):
    sensor, pose = SENSORS[9], np.array([10.0, -3.0, 0.7])
    point, _, _, _ = foresee(kernel, sensor, pose, np.array([0, 0, 0, rho]), np.array([5.0]))
    np.testing.assert_allclose(point[3], 1 / distance, rtol=1e-12)


def test_one_that_would_be_behind_the_start_is_no_choice(kernel):
    sensor, pose = SENSORS[9], np.array([1.0, -3.0, 0.7])
    for rho in (5.0, 0.2, 0.01):
        point, _, _, _ = foresee(kernel, sensor, pose, np.array([0, 0, 0, rho]), np.array([5.0]))
        np.testing.assert_allclose(point[3], 1 / 5, rtol=1e-12)


def test_a_range_that_does_not_reach_the_ray_is_linearised_where_it_comes_nearest(kernel):
    """The sensor is 3 m aside of the ray and measures 2 m."""
    sensor, pose = SENSORS[9], np.array([1.0, -3.0, 0.0])
    point, _, nu, seen = foresee(kernel, sensor, pose, np.array([-4, 0, 0, 0.1]), np.array([2.0]))
    assert seen
    np.testing.assert_allclose(to_point(point)[0], [1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(nu, [-1.0], atol=1e-12)


@pytest.mark.parametrize("size", TARGETS.values(), ids=TARGETS)
def test_moved_takes_an_innovation_from_the_point_to_the_target(kernel, size, rng):
    nu, H = rng.normal(size=2), rng.normal(size=(2, 7))
    target, point = rng.normal(size=(2, size))
    expected = nu - H[:, 3 : 3 + size] @ (target - point)
    close([kernel("moved")(nu, H, target, point, size, a) for a in (0, 1)], expected, 10)


# Inverse models -----------------------------------------------------------------------------------


@of_full
def test_locate_is_the_inverse_model_with_mapped_noise(kernel, sensor, rng):
    for _ in range(20):
        pose, value = rng.normal(size=3) * [5, 5, 3], rng.normal(size=2) * [10, 2]
        root = rng.normal(size=(2, 4))
        R = root @ root.T
        point, G, noise = np.full(3, np.nan), np.full((3, 3), np.nan), np.full((3, 3), np.nan)
        code, mount = sensor.view.code, sensor.mount.copy()
        kernel("locate")(code, mount, pose, value, R, point, G, noise)
        landmark, wrt_pose, wrt_value = sensor.locate(pose, value)
        close(point[:2], landmark, 50)
        close(G[:2], wrt_pose, 50)
        mapped = wrt_value @ R @ wrt_value.T
        close(noise[:2, :2], mapped, 10 * np.abs(mapped).max())
        assert noise[0, 1] == noise[1, 0]
        assert np.isnan(point[2])
        assert np.isnan(G[2]).all()
        assert np.isnan(noise[2]).all()


@of_full
def test_the_jacobian_of_locate_is_the_central_difference(kernel, sensor, rng):
    pose, value = rng.normal(size=3) * [5, 5, 3], np.array([4.0, 0.7])

    def located(x):
        point, G, noise = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
        code, mount = sensor.view.code, sensor.mount.copy()
        kernel("locate")(code, mount, x[:3].copy(), x[3:].copy(), NOISE, point, G, noise)
        return point, G, noise

    numeric = central_difference(lambda x: located(x)[0], np.concatenate([pose, value]))
    _, G, noise = located(np.concatenate([pose, value]))
    np.testing.assert_allclose(G, numeric[:, :3], **NUMERIC)
    np.testing.assert_allclose(noise, numeric[:, 3:] @ NOISE @ numeric[:, 3:].T, **NUMERIC)


def test_what_is_located_is_expected_again(kernel, rng):
    for sensor in SENSORS[:6]:
        pose, value = rng.normal(size=3), np.array([4.0, 0.7])
        point, G, noise = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
        code, mount = sensor.view.code, sensor.mount.copy()
        kernel("locate")(code, mount, pose, value, NOISE, point, G, noise)
        close(expect(kernel, sensor, pose, point)[0], value, 10)


BEARINGS = SENSORS[6:9]


def direction(kernel, sensor, pose, bearing, variance, rho, S):
    """What the compiled inverse model with a prior writes."""
    landmark, G, noise = np.full(4, np.nan), np.full((4, 3), np.nan), np.full((4, 4), np.nan)
    arguments = sensor.mount.copy(), pose, bearing, variance, rho, S
    kernel("locate_direction")(*arguments, landmark, G, noise)
    return landmark, G, noise


@pytest.mark.parametrize("sensor", BEARINGS, ids=lambda s: str(s.mount))
def test_locate_direction_is_the_inverse_model_with_a_prior(kernel, sensor, rng):
    """Of whose noise ``G_y R G_y' + G_s S G_s'`` is made."""
    for _ in range(20):
        pose, bearing = rng.normal(size=3) * [5, 5, 3], rng.uniform(-np.pi, np.pi)
        variance, rho, S = rng.uniform(0.1, 1, size=3)
        landmark, G, noise = direction(kernel, sensor, pose, bearing, variance, rho, S)
        model, wrt_pose, wrt_value, wrt_prior = inverse_depth(sensor, pose, [bearing], rho)
        close(landmark[[0, 1, 3]], model[[0, 1, 3]], 20)
        close(geo.wrap(landmark[2] - model[2]), 0, 20)
        assert -np.pi <= landmark[2] < np.pi
        close(G, wrt_pose, 20)
        mapped = variance * wrt_value @ wrt_value.T + S * wrt_prior @ wrt_prior.T
        close(noise, mapped)


@pytest.mark.parametrize("sensor", BEARINGS, ids=lambda s: str(s.mount))
def test_the_jacobian_of_a_direction_is_the_central_difference(kernel, sensor):
    x = np.array([1.0, -2.0, 0.3, 0.7, 0.4])  # pose, bearing, rho

    def landmark(x):
        return direction(kernel, sensor, x[:3].copy(), x[3], 0.04, x[4], 0.09)[0]

    numeric = central_difference(landmark, x)
    _, G, noise = direction(kernel, sensor, x[:3].copy(), x[3], 0.04, x[4], 0.09)
    np.testing.assert_allclose(G, numeric[:, :3], **NUMERIC)
    mapped = numeric[:, 3:] @ np.diag([0.04, 0.09]) @ numeric[:, 3:].T
    np.testing.assert_allclose(noise, mapped, **NUMERIC)


@pytest.mark.parametrize("sensor", BEARINGS, ids=lambda s: str(s.mount))
def test_what_starts_as_a_direction_is_seen_along_it(kernel, sensor, rng):
    """From where it was first seen, at any distance: it lies on its own ray (Solà, Eq. 51)."""
    pose = rng.normal(size=3)
    for rho in (0.0, 0.01, 2.0):
        landmark, _, _ = direction(kernel, sensor, pose, 0.8, 0.1, rho, 0.1)
        value, H, _ = expect(kernel, sensor, pose, landmark)
        close(value, 0.8, 10)
        np.testing.assert_allclose(H[0, 6], 0, atol=1e-12)  # of the distance it tells nothing


def point_of(kernel, landmark):
    point, J = np.full(2, np.nan), np.full((2, 4), np.nan)
    kernel("point_of")(landmark, point, J)
    return point, J


def test_point_of_an_inverse_depth(kernel, rng):
    for rho in (0.05, 0.5, 3.0):
        landmark = np.array([*rng.normal(size=3), rho])
        point, J = point_of(kernel, landmark)
        model, jacobian = to_point(landmark)
        close(point, model, 50)
        close(J, jacobian, 1e3)
        numeric = central_difference(lambda x: point_of(kernel, x)[0], landmark, rho / 200)
        np.testing.assert_allclose(J, numeric, rtol=1e-9, atol=1e-8)
