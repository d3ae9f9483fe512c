"""Joint compatibility branch and bound (Neira and Tardós 2001).

Innovations of one look share the robot's error, so pairs that are each plausible need not be so
together. Of all hypotheses, which give each observation a landmark of its own or none, take the
one with most pairs whose joint squared Mahalanobis distance is inside the chi-square quantile of
its dimension; among those with as many pairs, the one of smallest distance.

A pair more makes the distance grow and never shrink, by the squared norm of its innovation given
the pairs before. With the joint covariance S = L L', that is one step of forward substitution per
row: L grows row by row along a branch of the search, and rows that a branch shares stay.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ekfslam.association.nearest import unmatched
from ekfslam.compiled import compiled

NONE = -1  # no pair for an observation


class Pairs(NamedTuple):
    """Candidates of a look; the fields are the parameters of `joint_compatibility`."""

    row: np.ndarray
    column: np.ndarray
    innovations: np.ndarray
    rows: np.ndarray
    H_P_H: np.ndarray
    noise: np.ndarray


class Tree(NamedTuple):
    """In which order the search tries what: an observation that has candidates at each depth.

    Attributes
    ----------
    starts : (n + 1,), options : (K,) ndarray of int
        Pairs of the observation at a depth, nearest first: ``options[starts[depth] :
        starts[depth + 1]]``. Observations with fewest come first: they decide most.
    rows_left : (n + 1,) ndarray of int
        Rows that the observations from a depth on can add.
    """

    starts: np.ndarray
    options: np.ndarray
    rows_left: np.ndarray


class Factor(NamedTuple):
    """Cholesky factor of a hypothesis' innovation covariance, grown pair by pair.

    Attributes
    ----------
    entry : (2n,) ndarray of int
        Which entry of the innovations each row belongs to.
    L : (2n, 2n) ndarray
        Lower triangle.
    whitened : (2n,) ndarray
        ``L^-1 innovations``.
    """

    entry: np.ndarray
    L: np.ndarray
    whitened: np.ndarray


@compiled
def joint_compatibility(
    pair_row: np.ndarray,
    pair_column: np.ndarray,
    innovations: np.ndarray,
    rows: np.ndarray,
    H_P_H: np.ndarray,
    noise: np.ndarray,
    distances: np.ndarray,
    accept: np.ndarray,
    new: np.ndarray,
    quantiles: np.ndarray,
    limit: int,
    choice: np.ndarray,
) -> bool:
    """Choose landmarks for all observations of a look together.

    The search starts from the hypothesis of sequential compatibility, see `sequential`. When the
    limit is hit, the best hypothesis so far stands: at least as many pairs as that one, and no
    larger a distance if as many.

    Neira and Tardós drop a partial hypothesis that is outside its own quantile. A larger one that
    holds it can still be inside, so what they find depends on the order of the observations. Here
    a partial hypothesis is dropped when it is outside the quantile of the largest that it can
    grow to: a complete search finds the best in any order.

    Parameters
    ----------
    pair_row, pair_column : (K,) ndarray of int
        Observation and landmark of pair k, in any order.
    innovations : (2K,) ndarray
        Those of pair k are entries 2k and 2k + 1.
    rows : (K,) ndarray of int
        How many of the two count, 1 or 2.
    H_P_H : (2K, 2K) ndarray
        Joint covariance of the expected observations of all pairs, without the noise of the
        measurements. Only the lower triangle is read.
    noise : (m, 2, 2) ndarray
        Of the observations.
    distances : (m, C) ndarray
        Squared Mahalanobis distance of the innovation of observation i with landmark j.
    accept, new : (m,) ndarray
        Gates on it: a pair outside the first is not a candidate; an observation that is left
        without a landmark is new if its nearest is outside the second, else ambiguous.
    quantiles : (>= 2m + 1,) ndarray
        Gate on the joint squared distance by its degrees of freedom.
    limit : int
        Largest number of branches to try.
    choice : (m,) ndarray of int
        Written: index of the landmark, or `NEW`, or `AMBIGUOUS`.

    Returns
    -------
    bool
        Whether the search was complete; if not, the limit was hit.
    """
    pairs = Pairs(pair_row, pair_column, innovations, rows, H_P_H, noise)
    tree = plant(pairs, distances, accept)
    n = tree.starts.size - 1
    most = 2 * n
    factor = Factor(np.empty(most, np.int64), np.empty((most, most)), np.empty(most))
    taken = np.zeros(distances.shape[1], np.bool_)
    best = np.full(n, NONE)
    count, distance = sequential(pairs, tree, factor, quantiles, taken, best)
    taken[:] = False
    complete = search(pairs, tree, factor, quantiles, limit, taken, best, count, distance)
    for i in range(choice.size):
        choice[i] = unmatched(distances[i], new[i])
    for k in best:
        if k != NONE:
            choice[pair_row[k]] = pair_column[k]
    return complete


@compiled
def plant(pairs, distances, accept):  # type: ignore[no-untyped-def]
    """Order the pairs inside the accept gate for the search; returns a `Tree`."""
    sizes, apart = np.zeros(accept.size), np.full(pairs.row.size, np.inf)
    for k in range(pairs.row.size):
        i = pairs.row[k]
        distance = distances[i, pairs.column[k]]
        if distance <= accept[i] and distance < np.inf:
            sizes[i] += 1
            apart[k] = distance
    order = np.empty(accept.size, np.int64)
    n, last = 0, 0
    for i in range(accept.size):
        if sizes[i] > 0:
            insert(order, 0, n, i, sizes)
            n += 1
    starts, options = np.zeros(n + 1, np.int64), np.empty(pairs.row.size, np.int64)
    for depth in range(n):
        for k in range(pairs.row.size):
            if pairs.row[k] == order[depth] and apart[k] < np.inf:
                insert(options, starts[depth], last, k, apart)
                last += 1
        starts[depth + 1] = last
    rows_left = np.zeros(n + 1, np.int64)
    for depth in range(n - 1, -1, -1):
        rows_left[depth] = rows_left[depth + 1] + pairs.rows[options[starts[depth]]]
    return Tree(starts, options, rows_left)


@compiled
def insert(items, first, last, item, keys):  # type: ignore[no-untyped-def]
    """Put an item into ``items[first:last]``, sorted by ``keys[item]``, behind its equals."""
    while last > first and keys[items[last - 1]] > keys[item]:
        items[last] = items[last - 1]
        last -= 1
    items[last] = item


@compiled
def extend(pairs, factor, k, d):  # type: ignore[no-untyped-def]
    """Grow the factor from d rows by those of pair k, O(d^2).

    Returns
    -------
    float
        By how much the joint squared distance grows; infinite if the covariance is not positive
        definite.
    """
    i, grown = pairs.row[k], 0.0
    for a in range(pairs.rows[k]):
        at, entry = d + a, 2 * k + a
        factor.entry[at] = entry
        row = factor.L[at]
        pivot = pairs.H_P_H[entry, entry] + pairs.noise[i, a, a]
        residual = pairs.innovations[entry]
        for j in range(at):
            other = factor.entry[j]
            total = pairs.H_P_H[max(entry, other), min(entry, other)]
            if j >= d:
                total += pairs.noise[i, a, j - d]
            for l in range(j):
                total -= row[l] * factor.L[j, l]
            row[j] = total / factor.L[j, j]
            pivot -= row[j] * row[j]
            residual -= row[j] * factor.whitened[j]
        if not 0.0 < pivot < np.inf:
            return np.inf
        row[at] = math.sqrt(pivot)
        factor.whitened[at] = residual / row[at]
        grown += factor.whitened[at] * factor.whitened[at]
    return grown


@compiled
def sequential(pairs, tree, factor, quantiles, taken, hypothesis):  # type: ignore[no-untyped-def]
    """Sequential compatibility nearest neighbour (Neira and Tardós 2001).

    Each observation in turn, those with fewest candidates first, takes of the landmarks that are
    free the one that leaves the joint distance smallest, if the hypothesis stays compatible.

    Parameters
    ----------
    taken : (C,) ndarray of bool
        Written: landmarks that are in use.
    hypothesis : (n,) ndarray of int
        Written: the pair of each observation in the order of the tree, or `NONE`.

    Returns
    -------
    int
        Number of pairs.
    float
        Their joint squared distance.
    """
    count, d, distance = 0, 0, 0.0
    for depth in range(hypothesis.size):
        nearest, least = NONE, np.inf
        for k in tree.options[tree.starts[depth] : tree.starts[depth + 1]]:
            if not taken[pairs.column[k]]:
                grown = extend(pairs, factor, k, d)
                if grown < least:
                    nearest, least = k, grown
        if nearest != NONE and distance + least <= quantiles[d + pairs.rows[nearest]]:
            distance += extend(pairs, factor, nearest, d)  # again: others have overwritten its rows
            d += pairs.rows[nearest]
            count += 1
            taken[pairs.column[nearest]] = True
            hypothesis[depth] = nearest
    return count, distance


@compiled
def search(pairs, tree, factor, quantiles, limit, taken, best, count, distance):  # type: ignore[no-untyped-def]
    """Depth first through the tree; at a depth, every pair of an observation and then no pair.

    Parameters
    ----------
    taken : (C,) ndarray of bool
        All False.
    best : (n,) ndarray of int
        The hypothesis to beat; written.
    count, distance
        Its number of pairs, and its joint squared distance.

    Returns
    -------
    bool
        Whether the search was complete.
    """
    n = best.size
    tried = np.zeros(n, np.int64)  # branches tried at a depth
    held = np.full(n, NONE)  # the pair held there
    counts, dofs, sums = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n)  # of those above
    depth, branches = 0 if n > 0 else -1, 0
    while depth >= 0:
        if held[depth] != NONE:
            taken[pairs.column[held[depth]]] = False
            held[depth] = NONE
        option, last = tree.starts[depth] + tried[depth], tree.starts[depth + 1]
        if option > last:
            depth -= 1
            continue
        tried[depth] += 1
        branches += 1
        if branches > limit:
            return False
        pair = tree.options[option] if option < last else NONE
        paired, d, total, left = counts[depth], dofs[depth], sums[depth], n - depth - 1
        if pair != NONE:
            paired += 1
            if taken[pairs.column[pair]] or paired + left < count:
                continue
            total += extend(pairs, factor, pair, d)
            d += pairs.rows[pair]
        reach = paired + left
        if reach < count or (reach == count and total >= distance):
            continue
        if not total <= quantiles[d + tree.rows_left[depth + 1]]:
            continue
        if total <= quantiles[d] and (paired > count or (paired == count and total < distance)):
            count, distance = paired, total
            for at in range(n):  # nothing is held below
                best[at] = held[at]
            best[depth] = pair
        if left > 0:
            held[depth] = pair
            if pair != NONE:
                taken[pairs.column[pair]] = True
            depth += 1
            counts[depth], dofs[depth], sums[depth], tried[depth] = paired, d, total, 0
    return True
