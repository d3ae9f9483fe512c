"""The least time that an update of the whole map can take on this machine."""

from __future__ import annotations

import time

import numpy as np
from scipy.linalg.blas import dsyrk

RANK = 256  # of the update: large enough for BLAS to be at its best
PER_OBSERVATION = 2  # of the rank: range and bearing


def update_limit(size: int) -> float:
    """Share of an observation in a symmetric rank-256 update of a triangle, ``C - A A'`` [us].

    An observation of two numbers takes a rank-2 update of the covariance, however late it is done;
    many of them at once cost BLAS the least.

    Parameters
    ----------
    size : int
        Coordinates of the state.
    """
    factor = np.asfortranarray(np.random.default_rng(0).normal(size=(size, RANK)))
    square = np.zeros((size, size), order="F")
    dsyrk(-1.0, factor, beta=1.0, c=square, overwrite_c=1)  # touches the pages
    least = np.inf
    for _ in range(3):
        begin = time.perf_counter()
        dsyrk(-1.0, factor, beta=1.0, c=square, overwrite_c=1)
        least = min(least, time.perf_counter() - begin)
    return 1e6 * least * PER_OBSERVATION / RANK
