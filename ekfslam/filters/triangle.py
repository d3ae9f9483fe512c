"""How one triangle of a covariance is read, written and moved.

Inner loops run over slices from their start: the compiler then knows that no index is negative,
and vectorises them.
"""

from __future__ import annotations

import numpy as np

from ekfslam.compiled import compiled, inlined, lean


@lean
def add_rows(P, n, at, size, weights, out):  # type: ignore[no-untyped-def]
    """``out += weights' P[at : at + size, :n]``, O(n): what every operation reads of the triangle.

    Parameters
    ----------
    P : (capacity, capacity) ndarray
    n : int
        Dimension of the state.
    at, size : int
        First coordinate of a pose or landmark, and how many it has.
    weights : (>= size,) ndarray
    out : (>= n,) ndarray
        Added to, up to n.
    """
    stop = at + size
    for c in range(size):
        for d in range(size):
            out[at + d] += weights[c] * P[at + min(c, d), at + max(c, d)]
    tail = out[stop:n]
    if size == 2:
        w0, w1 = weights[0], weights[1]
        for j in range(at):  # above the diagonal its rows stand as columns
            out[j] += w0 * P[j, at] + w1 * P[j, at + 1]
        row0, row1 = P[at, stop:n], P[at + 1, stop:n]
        for j in range(tail.size):
            tail[j] += w0 * row0[j] + w1 * row1[j]
    elif size == 3:
        w0, w1, w2 = weights[0], weights[1], weights[2]
        for j in range(at):
            out[j] += w0 * P[j, at] + w1 * P[j, at + 1] + w2 * P[j, at + 2]
        row0, row1, row2 = P[at, stop:n], P[at + 1, stop:n], P[at + 2, stop:n]
        for j in range(tail.size):
            tail[j] += w0 * row0[j] + w1 * row1[j] + w2 * row2[j]
    else:
        for c in range(size):
            w0 = weights[c]
            for j in range(at):
                out[j] += w0 * P[j, at + c]
            row0 = P[at + c, stop:n]
            for j in range(tail.size):
                tail[j] += w0 * row0[j]


@lean
def add_both_rows(P, n, at, size, H, first, one, two):  # type: ignore[no-untyped-def]
    """`add_rows` with two weightings at once, for two or three coordinates.

    Parameters
    ----------
    P, n, at, size
        As for `add_rows`.
    H : (2, >= first + size) ndarray
        The weights begin at column `first`.
    first : int
    one, two : (>= n,) ndarray
        Added to, up to n.
    """
    stop = at + size
    for c in range(size):
        for e in range(size):
            entry = P[at + min(c, e), at + max(c, e)]
            one[at + e] += H[0, first + c] * entry
            two[at + e] += H[1, first + c] * entry
    tail_one, tail_two = one[stop:n], two[stop:n]
    u0, u1, v0, v1 = H[0, first], H[0, first + 1], H[1, first], H[1, first + 1]
    row0, row1 = P[at, stop:n], P[at + 1, stop:n]
    if size == 2:
        for j in range(at):
            x, y = P[j, at], P[j, at + 1]
            one[j] += u0 * x + u1 * y
            two[j] += v0 * x + v1 * y
        for j in range(tail_one.size):
            x, y = row0[j], row1[j]
            tail_one[j] += u0 * x + u1 * y
            tail_two[j] += v0 * x + v1 * y
    else:
        u2, v2, row2 = H[0, first + 2], H[1, first + 2], P[at + 2, stop:n]
        for j in range(at):
            x, y, z = P[j, at], P[j, at + 1], P[j, at + 2]
            one[j] += u0 * x + u1 * y + u2 * z
            two[j] += v0 * x + v1 * y + v2 * z
        for j in range(tail_one.size):
            x, y, z = row0[j], row1[j], row2[j]
            tail_one[j] += u0 * x + u1 * y + u2 * z
            tail_two[j] += v0 * x + v1 * y + v2 * z


@lean
def downdate(P, W, m, n):  # type: ignore[no-untyped-def]
    """``P -= W' W`` on the triangle: the map correction (Solà, Eq. 30), O(m n^2).

    Parameters
    ----------
    P : (>= n, >= n) ndarray
    W : (>= m, >= n) ndarray
        Rows enter four, then two at a time, to read and write P less often.

    Four rows of P are worked on together, so that W is read less often, and from up to three
    entries before the diagonal of the first, where nothing is read, so that they fill whole
    vectors. Every entry takes the same arithmetic wherever it stands.
    """
    for i in range(0, n - 3, 4):
        first = max(i - ((i - n) & 3), 0)
        p0, p1, p2, p3 = P[i, first:n], P[i + 1, first:n], P[i + 2, first:n], P[i + 3, first:n]
        k = 0
        while k + 4 <= m:
            w0, w1, w2, w3 = W[k, first:n], W[k + 1, first:n], W[k + 2, first:n], W[k + 3, first:n]
            a0, a1, a2, a3 = W[k, i], W[k + 1, i], W[k + 2, i], W[k + 3, i]
            b0, b1, b2, b3 = W[k, i + 1], W[k + 1, i + 1], W[k + 2, i + 1], W[k + 3, i + 1]
            c0, c1, c2, c3 = W[k, i + 2], W[k + 1, i + 2], W[k + 2, i + 2], W[k + 3, i + 2]
            d0, d1, d2, d3 = W[k, i + 3], W[k + 1, i + 3], W[k + 2, i + 3], W[k + 3, i + 3]
            for j in range(p0.size):
                x0, x1, x2, x3 = w0[j], w1[j], w2[j], w3[j]
                p0[j] -= a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                p1[j] -= b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3
                p2[j] -= c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3
                p3[j] -= d0 * x0 + d1 * x1 + d2 * x2 + d3 * x3
            k += 4
        while k + 2 <= m:
            w0, w1 = W[k, first:n], W[k + 1, first:n]
            a0, a1, b0, b1 = W[k, i], W[k + 1, i], W[k, i + 1], W[k + 1, i + 1]
            c0, c1, d0, d1 = W[k, i + 2], W[k + 1, i + 2], W[k, i + 3], W[k + 1, i + 3]
            for j in range(p0.size):
                x0, x1 = w0[j], w1[j]
                p0[j] -= a0 * x0 + a1 * x1
                p1[j] -= b0 * x0 + b1 * x1
                p2[j] -= c0 * x0 + c1 * x1
                p3[j] -= d0 * x0 + d1 * x1
            k += 2
        for row in range(i, i + 4 if k < m else i):
            downdate_row(P, W, k, m, n, row)
    for row in range(n - n % 4, n):
        downdate_row(P, W, 0, m, n, row)


@lean
def downdate_row(P, W, k, m, n, i):  # type: ignore[no-untyped-def]
    """`downdate` of one row of P by the rows of W from k on."""
    row = P[i, i:n]
    while k + 4 <= m:
        w0, w1, w2, w3 = W[k, i:n], W[k + 1, i:n], W[k + 2, i:n], W[k + 3, i:n]
        a0, a1, a2, a3 = w0[0], w1[0], w2[0], w3[0]
        for j in range(row.size):
            row[j] -= a0 * w0[j] + a1 * w1[j] + a2 * w2[j] + a3 * w3[j]
        k += 4
    while k + 2 <= m:
        w0, w1 = W[k, i:n], W[k + 1, i:n]
        a0, a1 = w0[0], w1[0]
        for j in range(row.size):
            row[j] -= a0 * w0[j] + a1 * w1[j]
        k += 2
    if k < m:
        last = W[k, i:n]
        factor = last[0]
        for j in range(row.size):
            row[j] -= factor * last[j]


@compiled
def read_rows(P, n, which, rows):  # type: ignore[no-untyped-def]
    """Whole rows of a triangle, (which.size, n)."""
    for k in range(which.size):
        at = which[k]
        for j in range(at):
            rows[k, j] = P[j, at]
        copy(P[at, at:n], n - at, rows[k, at:n])


@compiled
def write_rows(P, n, which, rows):  # type: ignore[no-untyped-def]
    """The opposite; where two rows meet, the later one stands."""
    for k in range(which.size):
        at = which[k]
        for j in range(at):
            P[j, at] = rows[k, j]
        copy(rows[k, at:n], n - at, P[at, at:n])


@compiled
def times_symmetric(P, n, w, rows):  # type: ignore[no-untyped-def]
    """``rows += w P`` of two rows, reading each entry of the triangle once."""
    for i in range(n):
        tail, a, b = P[i, i + 1 : n], w[0, i], w[1, i]
        left, right = w[0, i + 1 : n], w[1, i + 1 : n]
        down, up = rows[0, i + 1 : n], rows[1, i + 1 : n]
        first, second = a * P[i, i], b * P[i, i]
        for j in range(tail.size):
            first += left[j] * tail[j]
            second += right[j] * tail[j]
            down[j] += a * tail[j]
            up[j] += b * tail[j]
        rows[0, i] += first
        rows[1, i] += second


@inlined
def copy(source, n, out):  # type: ignore[no-untyped-def]
    """Copy n numbers; an assignment of slices takes another second to compile."""
    for j in range(n):
        out[j] = source[j]


@compiled
def copy_triangle(P, n, out):  # type: ignore[no-untyped-def]
    """Copy the triangle, and no memory that was never used."""
    for i in range(n):
        copy(P[i, i:n], n - i, out[i, i:n])


@compiled
def rearrange(P, n, order):  # type: ignore[no-untyped-def]
    """Make the triangle a full symmetric matrix, its coordinates in another order; in place.

    Parameters
    ----------
    P : (capacity, capacity) ndarray
    n : int
    order : (n,) ndarray of int
        Old coordinate of each new one: a permutation.
    """
    block = 64  # of rows and columns that the cache holds while they change places
    for first in range(0, n, block):
        for left in range(0, first + 1, block):
            for i in range(first, min(first + block, n)):
                for j in range(left, min(left + block, i)):
                    P[i, j] = P[j, i]
    kept = True
    for i in range(n):
        kept = kept and order[i] == i
    if kept:
        return
    row = np.empty(n)
    for i in range(n):
        copy(P[i], n, row)
        for j in range(n):
            P[i, j] = row[order[j]]
    placed = np.zeros(n, np.bool_)
    for start in range(n):  # along each cycle of the permutation
        if placed[start]:
            continue
        copy(P[start], n, row)
        at = start
        while order[at] != start:
            copy(P[order[at]], n, P[at])
            placed[at] = True
            at = order[at]
        copy(row, n, P[at])
        placed[at] = True
