"""Blocks on the diagonal of the inverse of a sparse matrix: exact, and without the rest of it.

Takahashi's recursion (Takahashi et al. 1973; for least squares Golub and Plemmons 1980) needs of
the inverse only what has an entry in the Cholesky factor. Both are kept by supernodes, groups of
columns with (nearly) the same entries below them, so that the work is products of small dense
matrices. The block of a supernode has its own columns, and as rows first the same, then those
below: they belong to supernodes that are eliminated later.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array

from ekfslam.compiled import compiled
from ekfslam.geometry import Array

NARROW, WIDEST = 12, 64  # columns of a supernode that may have any, and only few, needless zeros
FEW = 1.3  # entries for each one that is needed
ROUND_OFF = 1e-13  # a pivot this small beside what it was before the elimination


class IndeterminateError(ValueError):
    """A matrix that is singular to working precision, and the variable where that shows."""

    def __init__(self, variable: int) -> None:
        super().__init__(f"variable {variable} is not determined")
        self.variable = variable


class Shape(NamedTuple):
    """Supernodes of a factor, in the order in which they are eliminated.

    Attributes
    ----------
    order : (n,) ndarray of int
        Columns of the matrix in the order of elimination, by which they are counted below.
    first : (s + 1,) ndarray of int
        First column of each supernode.
    owner : (n,) ndarray of int
        Supernode of each column.
    start : (s + 1,) ndarray of int
        Where the rows of each supernode begin in `rows`.
    rows : ndarray of int
    begin : (s + 1,) ndarray of int
        Where the entries of each supernode begin among all.
    """

    order: np.ndarray
    first: np.ndarray
    owner: np.ndarray
    start: np.ndarray
    rows: np.ndarray
    begin: np.ndarray


def diagonal_blocks(matrix: csc_array, sizes: np.ndarray, order: np.ndarray) -> Array:
    """Blocks of the inverse of a symmetric positive definite matrix, one for each variable.

    Parameters
    ----------
    matrix : (n, n) csc_array
    sizes : (v,) ndarray of int
        Coordinates of each variable; their sum is n.
    order : (v,) ndarray of int
        Variables in an order of elimination that leaves few entries.

    Returns
    -------
    (v, w, w) ndarray
        With w the largest size; what a smaller variable does not use is 0.

    Raises
    ------
    IndeterminateError
        If the matrix is singular to working precision.
    """
    first = np.concatenate([[0], np.cumsum(sizes)])
    blocks = np.zeros((len(sizes), sizes.max(initial=0), sizes.max(initial=0)))
    entries = matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64)
    shape = analysed(*entries, first, order.astype(np.int64))
    values = assembled(*entries, matrix.data, shape)
    failed = factorise(shape, values)
    if failed >= 0:
        raise IndeterminateError(int(np.searchsorted(first, failed, side="right") - 1))
    invert(shape, values)
    extract(shape, values, first, blocks)
    return blocks


@compiled
def analysed(
    indptr: np.ndarray, indices: np.ndarray, first: np.ndarray, order: np.ndarray
) -> Shape:
    """Find the supernodes of the factor of a matrix.

    Parameters
    ----------
    indptr, indices : ndarray of int
        Of the whole symmetric matrix by columns.
    first : (v + 1,) ndarray of int
        First column of each variable.
    order : (v,) ndarray of int
        Variables in the order of elimination.
    """
    count, columns = len(order), first[-1]
    variable = np.empty(columns, np.int64)  # of each column, in the order of elimination
    for j in range(count):
        variable[first[order[j]] : first[order[j] + 1]] = j
    sizes = first[order + 1] - first[order]

    # Entries below each variable: those of the matrix, and of the variables that hang from it.
    parent = np.full(count, -1)
    child, sibling = np.full(count, -1), np.full(count, -1)
    seen = np.full(count, -1)
    start = np.zeros(count + 1, np.int64)
    below = np.empty(4 * count + 16, np.int64)
    for j in range(count):
        end = start[j]
        if end + count > len(below):
            grown = np.empty(2 * len(below) + count, np.int64)
            grown[:end] = below[:end]
            below = grown
        for column in range(first[order[j]], first[order[j] + 1]):
            for entry in range(indptr[column], indptr[column + 1]):
                i = variable[indices[entry]]
                if i > j and seen[i] != j:
                    seen[i] = j
                    below[end] = i
                    end += 1
        other = child[j]
        while other >= 0:
            for entry in range(start[other], start[other + 1]):
                i = below[entry]
                if i > j and seen[i] != j:
                    seen[i] = j
                    below[end] = i
                    end += 1
            other = sibling[other]
        if end > start[j]:
            parent[j] = below[start[j] : end].min()
            sibling[j] = child[parent[j]]
            child[parent[j]] = j
        start[j + 1] = end

    # Supernodes: variables join the one that they hang from while that leaves few zeros.
    width, needed = sizes.copy(), np.empty(count, np.int64)
    height = np.empty(count, np.int64)
    for j in range(count):
        height[j] = sizes[below[start[j] : start[j + 1]]].sum()
        needed[j] = width[j] * (width[j] + 1) // 2 + width[j] * height[j]
    joins = np.zeros(count, np.bool_)
    for j in range(count):
        i = parent[j]
        if i >= 0:
            wide = width[i] + width[j]
            useful = needed[i] + needed[j]
            stored = wide * (wide + 1) // 2 + wide * height[i]
            if wide <= NARROW or (wide <= WIDEST and stored <= FEW * useful):
                joins[j], width[i], needed[i] = True, wide, useful
    nodes = count - joins.sum()
    node = np.empty(count, np.int64)  # of each variable
    last = np.empty(nodes, np.int64)  # variable of each supernode
    free = nodes
    for j in range(count - 1, -1, -1):
        if joins[j]:
            node[j] = node[parent[j]]
        else:
            free -= 1
            node[j], last[free] = free, j

    # Columns by supernode, then rows.
    node_first = np.zeros(nodes + 1, np.int64)
    row_start = np.zeros(nodes + 1, np.int64)
    begin = np.zeros(nodes + 1, np.int64)
    for s in range(nodes):
        f, m = width[last[s]], width[last[s]] + height[last[s]]
        node_first[s + 1] = node_first[s] + f
        row_start[s + 1], begin[s + 1] = row_start[s] + m, begin[s] + m * f
    ordered, owner = np.empty(columns, np.int64), np.empty(columns, np.int64)
    place = np.empty(count, np.int64)  # first column of each variable
    free_of = node_first[:-1].copy()
    for j in range(count):
        place[j] = free_of[node[j]]
        free_of[node[j]] += sizes[j]
        for i in range(sizes[j]):
            ordered[place[j] + i], owner[place[j] + i] = first[order[j]] + i, node[j]
    rows = np.empty(row_start[-1], np.int64)
    for s in range(nodes):
        end = row_start[s]
        for column in range(node_first[s], node_first[s + 1]):
            rows[end] = column
            end += 1
        for entry in range(start[last[s]], start[last[s] + 1]):
            j = below[entry]
            for i in range(sizes[j]):
                rows[end] = place[j] + i
                end += 1
        rows[row_start[s] : end].sort()
    return Shape(ordered, node_first, owner, row_start, rows, begin)


@compiled
def assembled(indptr: np.ndarray, indices: np.ndarray, data: Array, shape: Shape) -> Array:
    """The lower triangle of a matrix in blocks of the supernodes."""
    values = np.zeros(shape.begin[-1])
    place = np.empty(len(shape.order), np.int64)
    place[shape.order] = np.arange(len(place))
    at = np.empty(len(place), np.int64)
    for s in range(len(shape.first) - 1):
        width = locate(shape, s, at)
        for column in range(shape.first[s], shape.first[s + 1]):
            origin = shape.begin[s] + column - shape.first[s]
            for entry in range(indptr[shape.order[column]], indptr[shape.order[column] + 1]):
                row = place[indices[entry]]
                if row >= column:
                    values[origin + at[row] * width] = data[entry]
    return values


@compiled
def locate(shape: Shape, s: int, at: np.ndarray) -> int:
    """Note at which row of the block of a supernode each of its rows is; its number of columns."""
    for i in range(shape.start[s], shape.start[s + 1]):
        at[shape.rows[i]] = i - shape.start[s]
    return shape.first[s + 1] - shape.first[s]


@compiled
def factorise(shape: Shape, values: Array) -> int:
    """Cholesky factor L of the matrix, in place, as what its inverse is made from.

    Of each supernode the triangle becomes W, the inverse of its part of L, and what is below
    becomes Y = L W.

    Returns
    -------
    int
        Column of the matrix that is not determined, -1 if all are.
    """
    nodes, columns = len(shape.first) - 1, len(shape.order)
    at, before = np.empty(columns, np.int64), np.empty(columns)
    for column in range(columns):
        s = shape.owner[column]
        own = column - shape.first[s]
        width = shape.first[s + 1] - shape.first[s]
        before[column] = values[shape.begin[s] + own * (width + 1)]
    for s in range(nodes):
        f, m = shape.first[s + 1] - shape.first[s], shape.start[s + 1] - shape.start[s]
        block = values[shape.begin[s] : shape.begin[s + 1]].reshape(m, f)
        for j in range(f):
            pivot = block[j, j]
            for k in range(j):
                pivot -= block[j, k] ** 2
            if not pivot > ROUND_OFF * before[shape.first[s] + j]:
                return shape.order[shape.first[s] + j]
            block[j, j] = np.sqrt(pivot)
            for i in range(j + 1, f):
                entry = block[i, j]
                for k in range(j):
                    entry -= block[i, k] * block[j, k]
                block[i, j] = entry / block[j, j]
        for j in range(f):
            block[j, j] = 1 / block[j, j]
            for i in range(j + 1, f):
                entry = block[i, j] * block[j, j]
                for k in range(j + 1, i):
                    entry += block[i, k] * block[k, j]
                block[i, j] = -entry / block[i, i]
        if m == f:
            continue
        W = block[:f]
        L = np.dot(block[f:], W.T)
        block[f:] = np.dot(L, W)
        outer = np.dot(L, L.T)
        meet_later(shape, values, s, at, outer, False)
    return -1


@compiled
def meet_later(
    shape: Shape, values: Array, s: int, at: np.ndarray, below: Array, read: bool
) -> None:
    """Read what later supernodes hold of the rows below one, with each other, or subtract it there.

    Parameters
    ----------
    shape : Shape
    values : ndarray
        Entries of all supernodes.
    s : int
        The supernode.
    at : (n,) ndarray of int
        Written: scratch for `locate`.
    below : (r, r) ndarray
        Symmetric, of the r rows below it: written, or subtracted from the entries.
    read : bool
    """
    f = shape.first[s + 1] - shape.first[s]
    rows = shape.rows[shape.start[s] + f : shape.start[s + 1]]
    begin = 0
    while begin < len(rows):
        t = shape.owner[rows[begin]]
        width = locate(shape, t, at)
        end = begin
        while end < len(rows) and rows[end] < shape.first[t + 1]:
            end += 1
        for a in range(begin, len(rows)):
            origin = shape.begin[t] + at[rows[a]] * width - shape.first[t]
            for b in range(begin, min(a + 1, end)):
                if read:
                    below[a, b] = below[b, a] = values[origin + rows[b]]
                else:
                    values[origin + rows[b]] -= below[a, b]
        begin = end


@compiled
def invert(shape: Shape, values: Array) -> None:
    """From what `factorise` left, the entries of the inverse that have one in the factor."""
    at = np.empty(len(shape.order), np.int64)
    for s in range(len(shape.first) - 2, -1, -1):
        f, m = shape.first[s + 1] - shape.first[s], shape.start[s + 1] - shape.start[s]
        block = values[shape.begin[s] : shape.begin[s + 1]].reshape(m, f)
        W = block[:f]
        if m == f:
            block[:] = np.dot(W.T, W)
            continue
        known = np.empty((m - f, m - f))  # of the inverse: all rows below, with each other
        meet_later(shape, values, s, at, known, True)
        Y = block[f:].copy()
        cross = -np.dot(known, Y)
        block[:f] = np.dot(W.T, W) - np.dot(Y.T, cross)
        block[f:] = cross


@compiled
def extract(shape: Shape, values: Array, first: np.ndarray, blocks: Array) -> None:
    """Copy blocks of variables, whose first columns in the matrix are given."""
    place = np.empty(len(shape.order), np.int64)
    place[shape.order] = np.arange(len(place))
    for v in range(len(first) - 1):
        column, size = place[first[v]], first[v + 1] - first[v]
        s = shape.owner[column]
        width, own = shape.first[s + 1] - shape.first[s], column - shape.first[s]
        for i in range(size):
            for j in range(i + 1):
                entry = values[shape.begin[s] + (own + i) * width + own + j]
                blocks[v, i, j] = blocks[v, j, i] = entry
