"""Global nearest neighbour, against all assignments tried one by one."""

from itertools import product

import numpy as np
import pytest

from ekfslam.association.assignment import global_nearest_neighbour
from ekfslam.association.nearest import AMBIGUOUS, NEW, nearest_neighbour

INF, NAN = np.inf, np.nan


def choose(distances, accept=9.0, new=25.0):
    m = len(distances)
    table = np.array(distances, dtype=float).reshape(m, -1)
    return global_nearest_neighbour(table, np.full(m, accept), np.full(m, new)).tolist()


@pytest.mark.parametrize(
    ("distances", "expected"),
    [
        pytest.param([[4, 1, 7]], [1], id="the nearest"),
        pytest.param([[10, 20]], [AMBIGUOUS], id="too far to accept, too near to be new"),
        pytest.param([[26, 30]], [NEW], id="far from all"),
        pytest.param([[9.1, 30]], [AMBIGUOUS], id="just beyond the gate"),
        pytest.param([[INF, 3]], [1], id="a pair out of the question"),
        pytest.param([[NAN, 3]], [1], id="a pair without a distance"),
        pytest.param([[INF, NAN]], [NEW], id="nothing in question"),
        pytest.param([[INF, INF], [INF, 3]], [NEW, 1], id="one of them in question"),
        pytest.param([[], []], [NEW, NEW], id="an empty map"),
        pytest.param([[1, 8], [2, 7]], [0, 1], id="the total decides, and both have one"),
        pytest.param([[1], [2], [3]], [0, AMBIGUOUS, AMBIGUOUS], id="more observations"),
        pytest.param([[1, INF], [2, INF]], [0, AMBIGUOUS], id="no other to take"),
        pytest.param([[1, 12], [2, 12]], [0, AMBIGUOUS], id="no match beyond the gate"),
        pytest.param([[1e300, 3], [2, 1e300]], [1, 0], id="beside a huge distance"),
        pytest.param([[1, 8.4], [1.5, 40]], [1, 0], id="one match more where it pays"),
        pytest.param([[1, 8.6], [1.9, 40]], [0, AMBIGUOUS], id="and not where it does not"),
    ],
)
def test_assignment_of_a_table(distances, expected):
    assert choose(distances) == expected


def test_no_observations():
    choice = global_nearest_neighbour(np.empty((0, 4)), np.empty(0), np.empty(0))
    assert choice.shape == (0,)
    assert np.issubdtype(choice.dtype, np.integer)


def brute_force(distances, accept):
    """Cheapest choice: a match costs its distance, none the accept gate."""
    m, C = distances.shape
    best, cheapest = None, INF
    for picks in product(range(-1, C), repeat=m):
        taken = [j for j in picks if j >= 0]
        if len(set(taken)) == len(taken):
            cost = sum(accept[i] if j < 0 else distances[i, j] for i, j in enumerate(picks))
            if cost < cheapest and all(
                j < 0 or d[j] <= a for j, d, a in zip(picks, distances, accept, strict=True)
            ):
                best, cheapest = picks, cost
    return best


def test_against_all_assignments(rng):
    differs = 0
    for _ in range(100):
        m, C = rng.integers(1, 5), rng.integers(1, 5)
        distances = rng.exponential(8.0, size=(m, C))
        distances[rng.random((m, C)) < 0.2] = INF
        accept = rng.uniform(4.0, 14.0, m)
        new = accept + 8.0
        choice = global_nearest_neighbour(distances, accept, new)
        expected = brute_force(distances, accept)
        apart = np.empty(m, dtype=int)
        nearest_neighbour(distances, accept, new, apart)
        differs += choice.tolist() != apart.tolist()
        for i, j in enumerate(choice):
            if expected[i] >= 0:
                assert j == expected[i]
            else:
                assert j == (NEW if distances[i].min() > new[i] else AMBIGUOUS)
    assert differs > 10  # deciding together is not deciding one by one
