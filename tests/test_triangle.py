"""Parts of a triangle, and the whole of it in another order, against full matrices."""

import numpy as np
import pytest

from ekfslam.filters import triangle


def test_rows_of_a_triangle_and_back(rng):
    P = rng.normal(size=(12, 12))
    P = P + P.T
    stored = np.where(np.tri(12, k=-1) > 0, np.nan, P)
    which = np.array([7, 0, 11, 4])
    rows = np.empty((4, 12))
    triangle.read_rows(stored, 12, which, rows)
    np.testing.assert_array_equal(rows, P[which])
    other = rng.normal(size=(12, 12))
    other = other + other.T
    triangle.write_rows(stored, 12, which, other[which])
    expected = P.copy()
    expected[which], expected[:, which] = other[which], other[:, which]
    np.testing.assert_array_equal(np.triu(stored), np.triu(expected))


def test_two_rows_times_a_symmetric_matrix(rng):
    P = rng.normal(size=(9, 9))
    P = P + P.T
    w, rows = rng.normal(size=(2, 9)), np.zeros((2, 9))
    triangle.times_symmetric(np.where(np.tri(9, k=-1) > 0, np.nan, P), 9, w, rows)
    np.testing.assert_allclose(rows, w @ P, rtol=1e-13)


@pytest.mark.parametrize("n", [0, 1, 2, 63, 64, 65, 130])
def test_a_triangle_becomes_a_full_matrix_in_another_order(n, rng):
    """In place, and nothing beyond it is touched."""
    P = rng.normal(size=(n, n))
    P = P + P.T
    for order in (np.arange(n), np.arange(n)[::-1].copy(), rng.permutation(n)):
        storage = np.full((n + 3, n + 3), 7.0)
        storage[:n, :n] = np.where(np.tri(n, k=-1) > 0, np.nan, P)
        triangle.rearrange(storage, n, order)
        np.testing.assert_array_equal(storage[:n, :n], P[np.ix_(order, order)])
        assert (storage[n:] == 7.0).all()
        assert (storage[:, n:] == 7.0).all()


def test_a_triangle_is_copied_and_nothing_else(rng):
    P, out = rng.normal(size=(9, 9)), np.full((11, 11), np.nan)
    triangle.copy_triangle(P, 7, out)
    np.testing.assert_array_equal(np.triu(out[:7, :7]), np.triu(P[:7, :7]))
    assert np.isnan(out[np.tril_indices(11, -1)]).all()
    assert np.isnan(out[:, 7:]).all()
