"""The hot loops against geometry, the sensor models and dense algebra, compiled and as Python."""

import numpy as np
import pytest

from ekfslam import geometry as geo
from ekfslam.filters import kernels
from ekfslam.models.sensors import Sensor

SENSORS = [
    Sensor(kind, [[0.04, 0.006], [0.006, 0.01]], mount=mount)
    for kind in ("range-bearing", "xy")
    for mount in ([0, 0, 0], [0, 0, 2.5], [0.7, -0.3, -1.9])
]


@pytest.fixture(params=["compiled", "python"])
def kernel(request):
    """Finds a kernel by name, compiled or as the plain Python that it is made from."""

    def find(name):
        function = getattr(kernels, name)
        return function if request.param == "compiled" else getattr(function, "py_func", function)

    return find


def covariance(rng, n):
    """A well-conditioned covariance (n, n) with every entry different."""
    root = rng.normal(size=(n, n + 3))
    return root @ root.T / n


def stored(P, room=4):
    """The upper triangle in larger storage; NaN wherever nothing may be read."""
    n = len(P)
    storage = np.full((n + room, n + room), np.nan)
    storage[:n, :n][np.triu_indices(n)] = P[np.triu_indices(n)]
    return storage


def dense(storage, n):
    """The covariance that a triangle stands for."""
    upper = np.triu(storage[:n, :n])
    return upper + np.triu(upper, 1).T


def state(rng, landmarks, room=4):
    """A random map: mean, storage, dimension and covariance."""
    n = 3 + 2 * landmarks
    mean = np.full(n + room, np.nan)
    mean[:n] = rng.normal(size=n)
    P = covariance(rng, n)
    return mean, stored(P, room), n, P


def wide(H, offset, n):
    """A Jacobian (2, 5) with a column for every coordinate of the state."""
    full = np.zeros((2, n))
    full[:, :3], full[:, offset : offset + 2] = H[:, :3], H[:, 3:]
    return full


def close(actual, expected, scale=1.0):
    """Equal to round-off of a few dozen operations on numbers of the given size."""
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-13 * max(scale, 1.0))


# Models -----------------------------------------------------------------------------------------


def test_wrap_is_that_of_geometry_to_the_bit(kernel):
    edges = np.pi * np.arange(-5, 6)
    beside = np.concatenate([np.nextafter(edges, 99), np.nextafter(edges, -99)])
    angles = np.concatenate([edges, beside, np.linspace(-20, 20, 999), [np.nan]])
    np.testing.assert_array_equal([kernel("wrap")(a) for a in angles], geo.wrap(angles))


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: f"{s.kind} {s.mount}")
def test_expect_is_the_direct_model(kernel, sensor, rng):
    for _ in range(20):
        pose, landmark = rng.normal(size=3) * [5, 5, 3], rng.normal(size=2) * 10
        expected, H = np.full(2, np.nan), np.full((2, 5), np.nan)
        kernel("expect")(sensor.view.code, sensor.mount.copy(), pose, landmark, expected, H)
        value, wrt_pose, wrt_point = sensor.observe(pose, landmark)
        close(sensor.difference(expected, value), 0, 20)
        close(H, np.concatenate([wrt_pose, wrt_point], axis=1), 20 + np.abs(wrt_pose).max() ** 2)


@pytest.mark.parametrize("sensor", SENSORS[::3], ids=lambda s: s.kind)
def test_innovation_wraps_bearings_and_nothing_else(kernel, sensor):
    for value, expected in (([4.0, 3.1], [9.0, -3.1]), ([9.0, -3.1], [1.0, 3.1]), ([0, 7], [7, 0])):
        innovation = np.full(2, np.nan)
        value, expected = np.array(value, dtype=float), np.array(expected, dtype=float)
        kernel("innovate")(sensor.view.code, value, expected, innovation)
        np.testing.assert_array_equal(innovation, sensor.difference(value, expected))


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: f"{s.kind} {s.mount}")
def test_locate_is_the_inverse_model_with_mapped_noise(kernel, sensor, rng):
    for _ in range(20):
        pose, value = rng.normal(size=3) * [5, 5, 3], rng.normal(size=2) * [10, 2]
        point, G = np.full(2, np.nan), np.full((2, 5), np.nan)
        R = covariance(rng, 2)
        kernel("locate")(sensor.view.code, sensor.mount.copy(), pose, value, R, point, G)
        landmark, wrt_pose, wrt_value = sensor.locate(pose, value)
        close(point, landmark, 50)
        close(G[:, :3], wrt_pose, 50)
        close(G[:, 3:], wrt_value @ R @ wrt_value.T, 10 * np.abs(wrt_value).max() ** 2)
        np.testing.assert_array_equal(G[0, 4], G[1, 3])


# The four operations of the map -----------------------------------------------------------------


@pytest.mark.parametrize("landmarks", [0, 1, 4])
def test_move_is_the_dense_prediction(kernel, landmarks, rng):
    mean, storage, n, P = state(rng, landmarks)
    mean[2] = 3.0  # turns on through pi
    before, delta, Q = mean.copy(), np.array([0.8, -0.3, 0.4]), covariance(rng, 3)
    kernel("move")(mean, storage, n, delta, Q)
    F, G = np.eye(n), np.zeros((n, 3))
    F[:3, :3], G[:3] = geo.compose_jacobians(before[:3], delta)
    close(mean[:3], geo.compose(before[:3], delta))
    np.testing.assert_array_equal(mean[3:], before[3:])
    close(dense(storage, n), F @ P @ F.T + G @ Q @ G.T, 10)


@pytest.mark.parametrize("position", [0, 1, 3])
def test_project_reads_one_triangle(kernel, position, rng):
    _, storage, n, P = state(rng, 4)
    offset, H = 3 + 2 * position, rng.normal(size=(2, 5))
    rows = np.full((2, n + 1), np.nan)
    kernel("project")(storage, n, offset, H, rows)
    close(rows[:, :n], wide(H, offset, n) @ P, 10)
    assert np.isnan(rows[:, n]).all()
    other, G = 3 + 2 * (3 - position), rng.normal(size=(2, 5))
    expected = wide(H, offset, n) @ P @ wide(G, other, n).T
    product = [[kernel("times_transposed")(rows[a], other, G, b) for b in (0, 1)] for a in (0, 1)]
    close(product, expected, 50)


@pytest.mark.parametrize("m", [1, 2, 5, 8])
def test_cholesky_and_whiten(kernel, m, rng):
    S, rows = covariance(rng, m), rng.normal(size=(m, 7))
    factor, whitened = np.where(np.tril(np.ones((m, m))), S, np.nan), rows.copy()
    assert kernel("cholesky")(factor, m)
    L = np.linalg.cholesky(S)
    close(np.tril(factor), L, 10)
    kernel("whiten")(factor, whitened, m, 6)
    close(whitened[:, :6], np.linalg.solve(L, rows[:, :6]), 100)
    np.testing.assert_array_equal(whitened[:, 6], rows[:, 6])


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_cholesky_refuses_what_is_not_positive_definite(kernel, bad):
    S = np.diag([2.0, bad, 1.0])
    assert not kernel("cholesky")(S, 3)


@pytest.mark.parametrize("m", [2, 4, 6, 8, 10])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 8, 9, 33])
def test_downdate_for_every_remainder_of_the_unrolled_loops(kernel, n, m, rng):
    P, W = covariance(rng, n), rng.normal(size=(m + 1, n + 1))
    W[m], W[:, n] = np.nan, np.nan
    storage = stored(P)
    kernel("downdate")(storage, W, m, n)
    close(dense(storage, n), P - W[:m, :n].T @ W[:m, :n], 50)
    assert np.isnan(storage[np.tril_indices(n, -1)]).all()
    assert np.isnan(storage[n:]).all()
    assert np.isnan(storage[:, n:]).all()


@pytest.mark.parametrize("observed", [1, 3])
def test_correct_is_the_dense_update(kernel, observed, rng):
    mean, storage, n, P = state(rng, 4)
    mean[2] = np.pi - 1e-3
    before, m = mean.copy(), 2 * observed
    H = np.concatenate([wide(rng.normal(size=(2, 5)), 3 + 2 * i, n) for i in range(observed)])
    S = H @ P @ H.T + covariance(rng, m)
    z = rng.normal(size=m)
    K = P @ H.T @ np.linalg.inv(S)
    nis = kernel("correct")(mean, storage, n, H @ P, np.tril(S), z.copy(), m)
    after = before[:n] + K @ z
    after[2] = geo.wrap(after[2])
    close(mean[:n], after, 100)
    close(dense(storage, n), P - K @ S @ K.T, 100)
    close(nis, z @ np.linalg.solve(S, z), 100)


def test_correct_wraps_the_heading(kernel, rng):
    mean, storage, n, P = state(rng, 0)
    mean[2] = np.pi - 1e-3
    S = np.diag([P[2, 2] + 0.1, 1.0])
    rows = np.array([P[2], np.zeros(3)])
    kernel("correct")(mean, storage, n, rows, S.copy(), np.array([0.5, 0.0]), 2)
    gain = 0.5 * P[2, 2] / S[0, 0]
    close(mean[2], np.pi - 1e-3 + gain - 2 * np.pi, 10)


def test_a_refused_correction_leaves_the_map_alone(kernel, rng):
    mean, storage, n, _ = state(rng, 2)
    before, kept = mean.copy(), storage.copy()
    S = np.array([[1.0, 0.0], [2.0, 1.0]])  # eigenvalues 3 and -1
    assert np.isnan(kernel("correct")(mean, storage, n, rng.normal(size=(2, n)), S, np.ones(2), 2))
    np.testing.assert_array_equal(mean, before)
    np.testing.assert_array_equal(storage, kept)


@pytest.mark.parametrize("landmarks", [0, 1, 3])
def test_append_is_the_dense_extension(kernel, landmarks, rng):
    mean, storage, n, P = state(rng, landmarks)
    noise = covariance(rng, 2)
    G = np.concatenate([rng.normal(size=(2, 3)), noise], axis=1)
    kernel("append")(mean, storage, n, np.array([7.0, 8.0]), G)
    A = np.zeros((2, n))
    A[:, :3] = G[:, :3]
    np.testing.assert_array_equal(mean[n : n + 2], [7, 8])
    expected = np.block([[P, P @ A.T], [A @ P, A @ P @ A.T + noise]])
    close(dense(storage, n + 2), expected, 50)
    assert np.isnan(storage[np.tril_indices(n + 2, -1)]).all()


@pytest.mark.parametrize("position", [0, 1, 3])
def test_remove_is_the_marginal_to_the_bit(kernel, position, rng):
    mean, storage, n, P = state(rng, 4)
    keep = np.delete(np.arange(n), [3 + 2 * position, 4 + 2 * position])
    left = mean[keep].copy()
    kernel("remove")(mean, storage, n, 3 + 2 * position, 2)
    np.testing.assert_array_equal(mean[: n - 2], left)
    np.testing.assert_array_equal(dense(storage, n - 2), P[np.ix_(keep, keep)])


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: f"{s.kind} {s.mount}")
def test_distances_are_those_of_the_dense_innovation(kernel, sensor, rng):
    mean, storage, n, P = state(rng, 3)
    offsets, value = np.array([5, -1, 7, 3, 3]), np.array([2.0, 3.0])
    out = np.full(6, np.nan)
    arguments = sensor.view.code, sensor.mount.copy(), value, sensor.covariance.copy()
    kernel("distances")(mean, storage, offsets, 4, *arguments, out)
    for index, offset in enumerate(offsets[:4]):
        if offset < 0:
            assert out[index] == np.inf
            continue
        expected, wrt_pose, wrt_point = sensor.observe(mean[:3], mean[offset : offset + 2])
        H = wide(np.concatenate([wrt_pose, wrt_point], axis=1), offset, n)
        z = sensor.difference(value, expected)
        distance = z @ np.linalg.solve(H @ P @ H.T + sensor.covariance, z)
        np.testing.assert_allclose(out[index], distance, rtol=1e-10)
    assert np.isnan(out[4:]).all()  # beyond count
