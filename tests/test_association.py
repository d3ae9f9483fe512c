"""Who saw whom: gates, descriptors, and the choice from a table of distances."""

import numpy as np
import pytest

from ekfslam.association.descriptors import descriptor_distance, running_mean
from ekfslam.association.gates import Gates, chi2_gate, quantiles
from ekfslam.association.nearest import (
    AMBIGUOUS,
    NEW,
    first_within,
    maximum_likelihood,
    nearest_neighbour,
    nearest_within,
    smallest_distance,
)
from ekfslam.errors import InputError

# Gates ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("probability", "dof", "squared"),
    [(0, 2, 0), (0.95, 2, 5.9915), (0.98889, 2, 9.0), (0.99, 2, 9.2103), (0.999, 2, 13.8155),
     (0.95, 3, 7.8147), (0.99, 3, 11.3449), (0.6827, 1, 1.0)],
)  # fmt: skip
def test_gates_are_chi_square_quantiles(probability, dof, squared):
    assert chi2_gate(probability, dof) == pytest.approx(squared, abs=1e-3)


def test_gates_near_one_keep_their_digits():
    # For two degrees of freedom the quantile is -2 log(1 - p).
    assert chi2_gate(0.999999, 2) == pytest.approx(-2 * np.log(1e-6), rel=1e-9)


@pytest.mark.parametrize("probability", [1.0, 1.5, -0.1, float("nan")])
def test_gates_are_probabilities(probability):
    with pytest.raises(InputError, match="probability"):
        chi2_gate(probability, 2)


def test_the_gate_for_new_landmarks_is_not_inside_the_other():
    Gates(0.99, 0.99)
    with pytest.raises(InputError, match="must not be below"):
        Gates(0.99, 0.98)


def test_joint_gates_are_tabulated_by_their_dimension():
    table = quantiles(0.99, 5)
    assert table.tolist() == [0.0, *(chi2_gate(0.99, dof) for dof in range(1, 6))]
    assert quantiles(0.99, 0).tolist() == [0.0]
    with pytest.raises(InputError, match="probability"):
        quantiles(1.0, 3)


# Descriptors ------------------------------------------------------------------------------------


def test_a_descriptor_adds_one_degree_of_freedom(rng):
    """The squared distance of a true match, on top of an innovation's two, is chi-square of 3."""
    values, spread, n = rng.normal(0.3, 0.05, 20_000), 0.05, 4
    means = rng.normal(0.3, spread / np.sqrt(n), values.size)
    variance = spread**2 * (1 + 1 / n)
    place = np.sum(rng.normal(size=(values.size, 2)) ** 2, axis=1)
    pairs = zip(values, means, strict=True)
    total = place + [descriptor_distance(value, mean, variance) for value, mean in pairs]
    for probability in (0.5, 0.95):
        inside = np.mean(total <= chi2_gate(probability, 3))
        sigma = np.sqrt(probability * (1 - probability) / values.size)
        assert inside == pytest.approx(probability, abs=4 * sigma)


def test_a_descriptor_two_sigmas_away():
    assert descriptor_distance(0.5, 0.3, 0.01) == pytest.approx(4.0)


@pytest.mark.parametrize(("value", "mean"), [(np.nan, 0.3), (0.3, np.nan), (np.nan, np.nan)])
def test_no_descriptor_says_nothing(value, mean):
    assert descriptor_distance(value, mean, 0.01) == 0.0


def test_the_mean_of_a_landmark_skips_what_is_missing(rng):
    values = rng.normal(0.3, 0.1, 30)
    values[::4] = np.nan
    mean, count = np.nan, 0
    for value in values:
        mean, count = running_mean(mean, count, value)
    assert count == np.isfinite(values).sum()
    assert mean == pytest.approx(np.nanmean(values), rel=1e-12)


# The choice from a table ------------------------------------------------------------------------

INF, NAN = np.inf, np.nan


@pytest.fixture(params=["compiled", "python"])
def decide(request):
    """Call a decision, compiled or not: distances first, gates as arrays, the choice returned."""

    def call(function, distances, *more):
        if request.param == "python":
            function = getattr(function, "py_func", function)
        out = np.full(len(distances), -9)
        function(np.array(distances, dtype=float).reshape(len(distances), -1), *more, out)
        return out.tolist()

    return call


@pytest.fixture
def choose(decide):
    """Nearest neighbour with the same gates for all observations."""

    def choice(distances, accept=9.0, new=25.0):
        m = len(distances)
        return decide(nearest_neighbour, distances, np.full(m, accept), np.full(m, new))

    return choice


@pytest.mark.parametrize(
    ("distances", "expected"),
    [
        pytest.param([[4, 1, 7]], [1], id="the nearest"),
        pytest.param([[4, 4]], [0], id="the first of two alike"),
        pytest.param([[10, 20]], [AMBIGUOUS], id="too far to accept, too near to be new"),
        pytest.param([[26, 30]], [NEW], id="far from all"),
        pytest.param([[9, 30]], [0], id="on the gate to accept"),
        pytest.param([[25, 30]], [AMBIGUOUS], id="on the gate for new ones"),
        pytest.param([[INF, 3]], [1], id="a pair out of the question"),
        pytest.param([[NAN, 3]], [1], id="a pair without a distance"),
        pytest.param([[INF, INF]], [NEW], id="nothing in question"),
        pytest.param([[NAN, NAN]], [NEW], id="no distance at all"),
        pytest.param([[], []], [NEW, NEW], id="an empty map"),
        pytest.param([[1, 8], [2, 7]], [0, AMBIGUOUS], id="claimed twice, nearer first"),
        pytest.param([[2, 7], [1, 8]], [AMBIGUOUS, 0], id="claimed twice, nearer last"),
        pytest.param([[2, 7], [2, 8]], [0, AMBIGUOUS], id="claimed twice alike"),
        pytest.param([[3], [1], [2]], [AMBIGUOUS, 0, AMBIGUOUS], id="claimed three times"),
        pytest.param([[1], [12]], [0, AMBIGUOUS], id="no claim from between the gates"),
        pytest.param([[1, 50], [50, 1]], [0, 1], id="no conflict"),
    ],
)
def test_choice_from_a_table(choose, distances, expected):
    assert choose(distances) == expected


def test_every_observation_has_gates_of_its_own(decide):
    """One number, two, and two with a descriptor: the same distance means three things."""
    accept = np.array([chi2_gate(0.99, dof) for dof in (1, 2, 3)])
    new = np.array([chi2_gate(0.999, dof) for dof in (1, 2, 3)])
    apart = [[11, INF, INF], [INF, 11, INF], [INF, INF, 11]]
    assert decide(nearest_neighbour, apart, accept, new) == [NEW, AMBIGUOUS, 2]


def test_choice_against_its_definition(choose, rng):
    for _ in range(50):
        table = rng.exponential(12.0, size=(6, 5))
        chosen = choose(table)
        for i, choice in enumerate(chosen):
            nearest, j = table[i].min(), int(table[i].argmin())
            rivals = [r for r in range(6) if table[r].argmin() == j and table[r].min() <= 9]
            if nearest > 25:
                assert choice == NEW
            elif nearest > 9 or min(rivals, key=lambda r: table[r, j]) != i:
                assert choice == AMBIGUOUS
            else:
                assert choice == j
        taken = [j for j in chosen if j >= 0]
        assert len(taken) == len(set(taken))


@pytest.mark.parametrize(
    ("function", "distances", "threshold", "expected"),
    [
        pytest.param(nearest_within, [[2, 0.5, 1]], 1.0, [1], id="the nearest"),
        pytest.param(first_within, [[2, 0.5, 0.1]], 1.0, [1], id="the first, not the nearest"),
        pytest.param(smallest_distance, [[30, 8, 9]], 20.0, [1], id="the smallest"),
        *(
            case
            for function in (nearest_within, first_within, smallest_distance)
            for case in (
                pytest.param(function, [[9, 4, 9]], 4.0, [1], id="on the threshold"),
                pytest.param(function, [[9, 4.1, 9]], 4.0, [NEW], id="beyond it"),
                pytest.param(function, [[9, 1], [9, 2]], 4.0, [1, 1], id="claimed twice"),
                pytest.param(function, [[NAN, 1]], 4.0, [1], id="a pair without a distance"),
                pytest.param(function, [[INF, NAN]], 4.0, [NEW], id="nothing in question"),
                pytest.param(function, [[], []], 4.0, [NEW, NEW], id="an empty map"),
            )
        ),
    ],
)
def test_one_threshold(decide, function, distances, threshold, expected):
    assert decide(function, distances, threshold) == expected


def test_the_notes_and_the_tutorial_differ_on_who_is_within(rng, decide):
    """Nearest within epsilon (notes on Brenner's lectures), first within D_min (Ciatto, 3.6)."""
    landmarks, points = rng.uniform(0, 10, (30, 2)), rng.uniform(0, 10, (40, 2))
    apart = np.linalg.norm(points[:, None] - landmarks, axis=2)
    near, first = (decide(f, apart, 1.5) for f in (nearest_within, first_within))
    for i in range(40):
        inside = np.flatnonzero(apart[i] <= 1.5)
        assert first[i] == (inside[0] if inside.size else NEW)
        assert near[i] == (inside[np.argmin(apart[i, inside])] if inside.size else NEW)
    assert near != first


def test_the_smallest_distance_is_that_of_the_listing(rng, decide):
    """Alg. 2: the argmin over the landmarks and one that is new, at a distance of alpha."""
    apart = rng.exponential(12.0, size=(50, 3))
    listing = np.argmin(np.hstack([apart, np.full((50, 1), 9.0)]), axis=1)
    expected = np.where(listing == 3, NEW, listing)
    assert decide(smallest_distance, apart, 9.0) == expected.tolist()
    assert len(set(expected)) == 4


# Maximum likelihood -----------------------------------------------------------------------------


def likeliest(decide, distances, logdets, accept=9.0, new=25.0):
    m = len(distances)
    logdets = np.array(logdets, dtype=float).reshape(m, -1)
    return decide(maximum_likelihood, distances, logdets, np.full(m, accept), np.full(m, new))


@pytest.mark.parametrize(
    ("distances", "logdets", "expected"),
    [
        pytest.param([[4, 1]], [[0, 0]], [1], id="alike: the nearest"),
        pytest.param([[4, 1]], [[-4, 0]], [0], id="the precise one though farther"),
        pytest.param([[10, 8]], [[-9, 0]], [1], id="not from outside the gate"),
        pytest.param([[9, 30]], [[0, -99]], [0], id="on the gate"),
        pytest.param([[10, 24]], [[0, -99]], [AMBIGUOUS], id="between the gates"),
        pytest.param([[26, 30]], [[0, -99]], [NEW], id="far from all"),
        pytest.param([[NAN, 1], [INF, 26]], [[-99, 0], [-99, 0]], [1, NEW], id="out of question"),
        pytest.param([[1], [2]], [[0], [-3]], [AMBIGUOUS, 0], id="claimed twice, likelier last"),
        pytest.param([[2], [1]], [[-3], [0]], [0, AMBIGUOUS], id="claimed twice, likelier first"),
        pytest.param([[], []], [[], []], [NEW, NEW], id="an empty map"),
    ],
)
def test_the_likeliest(decide, distances, logdets, expected):
    assert likeliest(decide, distances, logdets) == expected


def test_the_likeliest_is_right_more_often_than_the_nearest(rng, decide):
    """A vague landmark beside a precise one: the one of largest density is the Bayes choice."""
    sigmas, places = np.array([1.0, 0.1]), np.array([0.0, 0.7])
    truth = rng.integers(0, 2, 4000)
    seen = places[truth, None] * [1, 0] + sigmas[truth, None] * rng.normal(size=(4000, 2))
    apart = seen[:, None] - places[:, None] * [1, 0]
    squared = np.sum(apart**2, axis=2) / sigmas**2
    right = {"nearest": 0, "likeliest": 0}
    for row, true in zip(squared, truth, strict=True):
        right["nearest"] += decide(smallest_distance, [row], 1e9) == [true]
        right["likeliest"] += likeliest(decide, [row], [4 * np.log(sigmas)], 1e9, 1e9) == [true]
    density = np.exp(-squared / 2) / sigmas**2
    assert right["likeliest"] == np.sum(density.argmax(axis=1) == truth)
    assert right["likeliest"] > right["nearest"] + 4 * np.sqrt(4000) / 2
