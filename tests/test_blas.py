"""The two products of large maps against NumPy, compiled and not."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from ekfslam import blas
from ekfslam.compiled import compiled


@compiled
def square(P, W, m, n):
    blas.subtract_square(P, W, m, n)


@compiled
def product(out, A, B, m, k, n):
    blas.subtract_product(out, A, B, m, k, n)


@pytest.mark.parametrize("function", [square, blas.subtract_square], ids=["compiled", "python"])
@pytest.mark.parametrize(("m", "n"), [(0, 7), (1, 1), (3, 7), (12, 40), (40, 12)])
def test_a_square_is_taken_from_the_upper_triangle_alone(function, m, n, rng):
    P, W = rng.normal(size=(n + 3, n + 3)), rng.normal(size=(m + 2, n + 5))
    P[np.tril_indices(n + 3, -1)] = np.nan
    expected = P.copy()
    expected[:n, :n] -= np.triu(W[:m, :n].T @ W[:m, :n])
    function(P, W, m, n)
    np.testing.assert_allclose(P, expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("function", [product, blas.subtract_product], ids=["compiled", "python"])
@pytest.mark.parametrize(
    ("m", "k", "n"), [(0, 2, 3), (2, 0, 3), (1, 1, 1), (10, 7, 33), (2, 40, 5)]
)
def test_a_product_of_parts_of_arrays(function, m, k, n, rng):
    out, A, B = (rng.normal(size=s) for s in ((m + 1, n + 2), (m + 3, k + 1), (k + 2, n + 4)))
    expected = out.copy()
    expected[:m, :n] -= A[:m, :k] @ B[:k, :n]
    function(out, A, B, m, k, n)
    np.testing.assert_allclose(out, expected, rtol=1e-13, atol=1e-13)


def test_how_rows_lie_in_memory_does_not_change_a_bit(rng):
    """A filter that grows its storage, and one that need not, say the same."""
    n, m = 203, 20
    triangle, W = rng.normal(size=(n, n)), rng.normal(size=(m, n))
    results = []
    for room in (0, 1, 37):
        P, rows = np.zeros((n + room, n + room)), np.zeros((m, n + room))
        P[:n, :n], rows[:, :n] = triangle, W
        with blas.on_threads():
            square(P, rows, m, n)
        results.append(np.triu(P[:n, :n]))
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


def test_one_thread_is_one_thread_and_afterwards_as_before():
    def threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = threads()
    with blas.on_threads():
        assert set(threads()) == {1}
    with blas.on_threads(2):
        assert set(threads()) == {2}
    assert threads() == before
