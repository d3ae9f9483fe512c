"""The operations on one triangle of the covariance against dense algebra; compiled and not."""

import numpy as np
import pytest

from ekfslam import geometry as geo
from ekfslam.filters import kernels

ROBOTS = [1, 3]
SIZES = [2, 3, 4]


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


def state(rng, landmarks, robots=1, room=4):
    """A random map: mean, storage, dimension and covariance."""
    n = 3 * robots + 2 * landmarks
    mean = np.full(n + room, np.nan)
    mean[:n] = rng.normal(size=n)
    P = covariance(rng, n)
    return mean, stored(P, room), n, P


def wide(H, pose, at, n):
    """A Jacobian of (pose, target) with a column for every coordinate of the state."""
    full = np.zeros((len(H), n))
    full[:, pose : pose + 3] += H[:, :3]
    full[:, at : at + H.shape[1] - 3] += H[:, 3:]
    return full


def close(actual, expected, scale=1.0):
    """Equal to round-off of a few dozen operations on numbers of the given size."""
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-13 * max(scale, 1.0))


def assert_nothing_below(storage, n):
    """Below the diagonal, and outside of the state, nothing was written."""
    assert np.isnan(storage[:n, :n][np.tril_indices(n, -1)]).all()
    assert np.isnan(storage[n:]).all()
    assert np.isnan(storage[:, n:]).all()


def test_wrap_is_that_of_geometry_to_the_bit(kernel):
    edges = np.pi * np.arange(-5, 6)
    beside = np.concatenate([np.nextafter(edges, 99), np.nextafter(edges, -99)])
    angles = np.concatenate([edges, beside, np.linspace(-20, 20, 999), [np.nan]])
    np.testing.assert_array_equal([kernel("wrap")(a) for a in angles], geo.wrap(angles))


# Robot motion -------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 2, 3, 4, 5])
def test_add_rows_reads_one_triangle_at_any_offset(kernel, size, rng):
    n = 11
    P = covariance(rng, n)
    storage = stored(P)
    for at in range(n - size + 1):
        weights, start = rng.normal(size=size), rng.normal(size=n)
        out = np.append(start, np.nan)
        kernel("add_rows")(storage, n, at, size, weights, out)
        close(out[:n], start + weights @ P[at : at + size], 10)
        assert np.isnan(out[n])


@pytest.mark.parametrize("landmarks", [0, 1, 4])
@pytest.mark.parametrize("robots", ROBOTS)
def test_move_is_the_dense_prediction(kernel, landmarks, robots, rng):
    for robot in range(robots):
        mean, storage, n, P = state(rng, landmarks, robots)
        at = slice(3 * robot, 3 * robot + 3)
        mean[3 * robot + 2] = 3.0  # turns on through pi
        before, delta, Q = mean.copy(), np.array([0.8, -0.3, 0.4]), covariance(rng, 3)
        kernel("move")(mean, storage, n, 3 * robot, delta, Q)
        F, G = np.eye(n), np.zeros((n, 3))
        F[at, at], G[at] = geo.compose_jacobians(before[at], delta)
        close(mean[at], geo.compose(before[at], delta))
        others = np.delete(np.arange(n), np.arange(n)[at])
        np.testing.assert_array_equal(mean[others], before[others])
        close(dense(storage, n), F @ P @ F.T + G @ Q @ G.T, 10)
        assert_nothing_below(storage, n)


# Map correction -----------------------------------------------------------------------------------


@pytest.mark.parametrize("d", [1, 2])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("pose", "at"), [(0, 3), (0, 9), (6, 0), (3, 7), (9, 5), (3, 9)])
def test_project_reads_one_triangle(kernel, pose, at, size, d, rng):
    n = 13
    P = covariance(rng, n)
    storage, H = stored(P), rng.normal(size=(d, 3 + size))
    rows = np.full((d, n + 1), np.nan)
    kernel("project")(storage, n, pose, at, size, H, d, rows)
    expected = wide(H, pose, at, n) @ P
    close(rows[:, :n], expected, 10)
    assert np.isnan(rows[:, n]).all()
    G = rng.normal(size=(2, 5))
    other = wide(G, pose, 7, n)
    product = [
        [kernel("times_transposed")(rows[a], pose, 7, 2, G, b) for b in (0, 1)] for a in range(d)
    ]
    close(product, expected @ other.T, 50)


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


@pytest.mark.parametrize("m", [1, 2, 3, 4, 5, 6, 7, 8, 11])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 8, 9, 33])
def test_downdate_for_every_remainder_of_the_unrolled_loops(kernel, n, m, rng):
    P, W = covariance(rng, n), rng.normal(size=(m + 1, n + 1))
    W[m], W[:, n] = np.nan, np.nan
    storage = stored(P)
    kernel("downdate")(storage, W, m, n)
    close(dense(storage, n), P - W[:m, :n].T @ W[:m, :n], 50)
    assert_nothing_below(storage, n)


@pytest.mark.parametrize("rows", [1, 2, 6])
@pytest.mark.parametrize("robots", ROBOTS)
def test_correct_is_the_dense_update(kernel, rows, robots, rng):
    mean, storage, n, P = state(rng, 4, robots)
    before, H = mean.copy(), rng.normal(size=(rows, n))
    S = H @ P @ H.T + covariance(rng, rows)
    z = rng.normal(size=rows)
    K = P @ H.T @ np.linalg.inv(S)
    nis = kernel("correct")(mean, storage, n, H @ P, np.tril(S), z.copy(), rows, robots)
    after = before[:n] + K @ z
    headings = 3 * np.arange(robots) + 2
    after[headings] = geo.wrap(after[headings])
    close(mean[:n], after, 100)
    close(dense(storage, n), P - K @ S @ K.T, 100)
    close(nis, z @ np.linalg.solve(S, z), 100)
    assert_nothing_below(storage, n)


@pytest.mark.parametrize("robots", ROBOTS)
def test_correct_wraps_every_heading_and_nothing_else(kernel, robots, rng):
    """Gains of one: each coordinate rises by a half, those beyond pi included."""
    mean, storage, n, _ = state(rng, 1, robots)
    mean[:n] = np.pi - 1e-3
    S, row = np.array([[1.0]]), np.full((1, n), 1.0)
    kernel("correct")(mean, storage, n, row, S, np.array([0.5]), 1, robots)
    wrapped = np.isin(np.arange(n), 3 * np.arange(robots) + 2)
    expected = np.where(wrapped, -np.pi, np.pi) - 1e-3 + 0.5
    close(mean[:n], expected)


def test_a_refused_correction_leaves_the_map_alone(kernel, rng):
    mean, storage, n, _ = state(rng, 2)
    before, kept = mean.copy(), storage.copy()
    S = np.array([[1.0, 0.0], [2.0, 1.0]])  # eigenvalues 3 and -1
    rows = rng.normal(size=(2, n))
    assert np.isnan(kernel("correct")(mean, storage, n, rows, S, np.ones(2), 2, 1))
    np.testing.assert_array_equal(mean, before)
    np.testing.assert_array_equal(storage, kept)


# Landmark initialization and deletion -------------------------------------------------------------


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("robots", "poses"), [(1, [0]), (3, [6]), (3, [3, 0]), (1, [5, 0])])
@pytest.mark.parametrize("landmarks", [0, 2])
def test_append_is_the_dense_extension(kernel, landmarks, robots, poses, size, rng):
    """From one pose, or from two: of two robots, or one of them past."""
    if 3 * robots + 2 * landmarks < max(poses) + 3:
        landmarks += 3
    mean, storage, n, P = state(rng, landmarks, robots)
    noise, G = covariance(rng, size), rng.normal(size=(len(poses), size, 3))
    new = rng.normal(size=size)
    kernel("append")(mean, storage, n, np.array(poses), new, size, G, noise)
    A = np.zeros((size, n))
    for pose, block in zip(poses, G, strict=True):
        A[:, pose : pose + 3] += block
    np.testing.assert_array_equal(mean[n : n + size], new)
    expected = np.block([[P, P @ A.T], [A @ P, A @ P @ A.T + noise]])
    close(dense(storage, n + size), expected, 50)
    assert_nothing_below(storage, n + size)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("robots", ROBOTS)
def test_remove_is_the_marginal_to_the_bit(kernel, robots, size, rng):
    n = 3 * robots + 8
    for at in range(3 * robots, n - size + 1):
        mean, storage, n, P = state(rng, 4, robots)
        keep = np.delete(np.arange(n), at + np.arange(size))
        left = mean[keep].copy()
        kernel("remove")(mean, storage, n, at, size)
        np.testing.assert_array_equal(mean[: n - size], left)
        np.testing.assert_array_equal(dense(storage, n - size), P[np.ix_(keep, keep)])


@pytest.mark.parametrize(("size", "new_size"), [(4, 2), (4, 3), (2, 2), (4, 4)])
@pytest.mark.parametrize("robots", ROBOTS)
def test_replace_is_the_dense_congruence(kernel, robots, size, new_size, rng):
    """What stands before, between and behind keeps its place but for the room that is gone."""
    for at in range(3 * robots, 3 * robots + 8 - size + 1):
        mean, storage, n, P = state(rng, 4, robots)
        before, J, new = mean[:n].copy(), rng.normal(size=(new_size, size)), rng.normal(size=4)
        kernel("replace")(mean, storage, n, at, size, new[:new_size], new_size, J)
        T = np.eye(n)
        T[at : at + new_size] = 0.0
        T[at : at + new_size, at : at + size] = J
        keep = np.delete(np.arange(n), np.arange(at + new_size, at + size))
        before[at : at + new_size] = new[:new_size]
        left = len(keep)
        np.testing.assert_array_equal(mean[:left], before[keep])
        close(dense(storage, left), (T @ P @ T.T)[np.ix_(keep, keep)], 50)
