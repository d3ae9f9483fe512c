"""Squared Mahalanobis norms of whole stacks, skipped where a covariance is singular."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from ekfslam.geometry import Array

SINGULAR = 1e-10
"""Reciprocal condition number of the correlation matrix up to which a covariance is singular."""

NEGLIGIBLE = 1e-14
"""A variance this small beside the largest one is a zero with rounding on it."""

REGULAR = 1e-3
"""Determinant of a correlation matrix above which it is far from singular, whatever its size."""


def squared_mahalanobis(errors: ArrayLike, covariances: ArrayLike) -> Array:
    """``e' P^-1 e``, skipped where P cannot be inverted in earnest.

    P is scaled to its correlation matrix, so units hardly matter. It is skipped if a value is not
    finite, a variance is not above `NEGLIGIBLE` times the largest, or the smallest eigenvalue of
    the correlation matrix is not above `SINGULAR` times the largest: the first steps after an
    exactly known start, or a motion noise of lower rank. Only the lower triangle counts. Of errors
    that share a covariance, by broadcasting, it is decomposed once.

    Parameters
    ----------
    errors : (..., d) array_like
    covariances : (..., d, d) array_like

    Returns
    -------
    (...) ndarray
        NaN where skipped; count those with ``np.isnan(...).sum()``.
    """
    errors, covariances = np.asarray(errors, dtype=float), np.asarray(covariances, dtype=float)
    axes = range(covariances.shape[-1])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        variances = [covariances[..., i, i] for i in axes]
        floor = NEGLIGIBLE * np.maximum.reduce(variances, initial=0.0)
        sound = np.logical_and.reduce([variance > floor for variance in variances])
        for i, j in product(axes, axes):
            sound = sound & np.isfinite(covariances[..., i, j])
        for i in axes:
            sound = sound & np.isfinite(errors[..., i])
        squares, determinant = _by_cholesky(errors, covariances)
    # The eigenvalues of a correlation matrix add up to d, so that none is above d, and all but the
    # smallest have a product of (d / (d - 1))^(d - 1) < e at most: the smallest is above det / e.
    settled = (determinant > REGULAR) & (squares < np.inf)
    result = np.where(sound & settled, squares, np.nan)
    if (rest := sound & ~settled).any():
        result[rest] = _by_eigenvalues(errors, covariances, rest)
    return result


def _by_cholesky(errors: Array, covariances: Array) -> tuple[Array, Array]:
    """``e' P^-1 e`` and the determinant of the correlation matrix; NaN where P is not positive.

    Entry by entry, each for all matrices at once, which costs far less than their eigenvalues.
    """
    squares, determinant = np.zeros(()), np.ones(())
    sigmas: list[Array] = []
    factor: list[list[Array]] = []
    white: list[Array] = []
    for i in range(covariances.shape[-1]):
        sigmas.append(np.sqrt(covariances[..., i, i]))
        row: list[Array] = []
        for j, other in enumerate(factor):
            correlation = covariances[..., i, j] / (sigmas[i] * sigmas[j])
            row.append((correlation - _inner(row, other)) / other[j])
        pivot = 1.0 - _inner(row, row)
        row.append(np.sqrt(pivot))
        white.append((errors[..., i] / sigmas[i] - _inner(row, white)) / row[i])
        factor.append(row)
        squares, determinant = squares + white[i] ** 2, determinant * pivot
    return squares, determinant


def _inner(row: list[Array], other: list[Array]) -> Array:
    """Sum of the products of what both have."""
    return sum((a * b for a, b in zip(row, other, strict=False)), start=np.zeros(()))


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def _by_eigenvalues(errors: Array, covariances: Array, which: np.ndarray) -> Array:
    """``e' P^-1 e`` where it is asked for, of covariances with variances; NaN where singular."""
    size = covariances.shape[-1]
    matrices = covariances.reshape(-1, size, size)
    number = np.broadcast_to(np.arange(len(matrices)).reshape(covariances.shape[:-2]), which.shape)
    asked = np.zeros(len(matrices), dtype=bool)
    asked[number[which]] = True
    sigmas = np.sqrt(np.diagonal(matrices[asked], axis1=-2, axis2=-1))
    correlation = matrices[asked] / (sigmas[:, :, None] * sigmas[:, None, :])
    eigenvalues, vectors = np.linalg.eigh(correlation)
    regular = eigenvalues[:, 0] > SINGULAR * eigenvalues[:, -1]
    # Errors that share a covariance come back to it.
    shared = (np.cumsum(asked) - 1)[number[which]]
    scaled = np.broadcast_to(errors, (*which.shape, size))[which] / sigmas[shared]
    components = np.einsum("nij,ni->nj", vectors[shared], scaled)
    squares = np.sum(components**2 / eigenvalues[shared], axis=-1)
    return np.where(regular[shared], squares, np.nan)
