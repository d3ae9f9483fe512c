"""BLAS from compiled code: the two products that work on a large map.

Both take what a filter has, rows of a larger array, so that nothing is copied. Uncompiled they are
NumPy.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

import numpy as np
from threadpoolctl import ThreadpoolController

from ekfslam.compiled import library_function, overload

_dsyrk = library_function("scipy.linalg.cython_blas", "dsyrk", 10)
_dgemm = library_function("scipy.linalg.cython_blas", "dgemm", 13)
# C's rows are Fortran's columns, so the upper triangle here is the lower one there.
_LOWER, _AS_IT_IS = (np.array([ord(letter)], dtype=np.int8) for letter in "LN")
_MINUS, _ONE = np.array([-1.0]), np.array([1.0])


def subtract_square(P, W, m, n):  # type: ignore[no-untyped-def]
    """``P -= W' W`` on the upper triangle: a symmetric rank-m update, m n^2 flops.

    Parameters
    ----------
    P : (>= n, >= n) ndarray
        C-contiguous, as is W; what lies below its diagonal is not touched.
    W : (>= m, >= n) ndarray
    m, n : int
    """
    rows = W[:m, :n]
    P[:n, :n] -= np.triu(rows.T @ rows)


def subtract_product(out, A, B, m, k, n):  # type: ignore[no-untyped-def]
    """``out -= A B``, 2 m k n flops.

    Parameters
    ----------
    out : (>= m, >= n) ndarray
        C-contiguous, as are A and B.
    A : (>= m, >= k) ndarray
    B : (>= k, >= n) ndarray
    m, k, n : int
    """
    out[:m, :n] -= A[:m, :k] @ B[:k, :n]


@overload(subtract_square)
def _subtract_square(P, W, m, n):  # type: ignore[no-untyped-def]
    def update(P, W, m, n):  # type: ignore[no-untyped-def]
        if m == 0:
            return
        size = np.array([n, m, W.strides[0] // 8, P.strides[0] // 8], np.int32)
        at = size.ctypes.data
        _dsyrk(
            _LOWER.ctypes.data,
            _AS_IT_IS.ctypes.data,
            at,
            at + 4,
            _MINUS.ctypes.data,
            W.ctypes.data,
            at + 8,
            _ONE.ctypes.data,
            P.ctypes.data,
            at + 12,
        )
        size[0] = 0  # so that it lives until here

    return update


@overload(subtract_product)
def _subtract_product(out, A, B, m, k, n):  # type: ignore[no-untyped-def]
    def update(out, A, B, m, k, n):  # type: ignore[no-untyped-def]
        if m == 0 or k == 0:
            return
        strides = B.strides[0] // 8, A.strides[0] // 8, out.strides[0] // 8
        size = np.array([n, m, k, strides[0], strides[1], strides[2]], np.int32)
        at = size.ctypes.data
        _dgemm(
            _AS_IT_IS.ctypes.data,
            _AS_IT_IS.ctypes.data,
            at,
            at + 4,
            at + 8,
            _MINUS.ctypes.data,
            B.ctypes.data,
            at + 12,
            A.ctypes.data,
            at + 16,
            _ONE.ctypes.data,
            out.ctypes.data,
            at + 20,
        )
        size[0] = 0  # so that it lives until here

    return update


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


def on_threads(count: int = 1) -> AbstractContextManager:
    """While inside, BLAS works on so many threads.

    On one, the default, workers do not take each other's cores, and the last bit of a sum does not
    depend on how many cores there are.
    """
    return _controller().limit(limits=count, user_api="blas")
