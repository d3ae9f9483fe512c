"""Squared Mahalanobis norms of whole stacks against the eigenvalues of each matrix alone."""

import itertools

import numpy as np
import pytest

from ekfslam.evaluation import squared_mahalanobis
from ekfslam.mahalanobis import NEGLIGIBLE, REGULAR, SINGULAR

EPS = np.finfo(float).eps


@np.errstate(all="ignore")
def by_definition(error, covariance):
    """One norm by the eigenvalues of its correlation matrix, and the condition number of that."""
    variances = np.diagonal(covariance)
    if not (np.isfinite(covariance).all() and np.isfinite(error).all()):
        return np.nan, np.inf
    if not (variances > NEGLIGIBLE * max(variances.max(), 0.0)).all():
        return np.nan, np.inf
    sigmas = np.sqrt(variances)
    eigenvalues, vectors = np.linalg.eigh(covariance / np.outer(sigmas, sigmas), UPLO="L")
    if not eigenvalues[0] > SINGULAR * eigenvalues[-1]:
        return np.nan, np.inf
    square = np.sum((vectors.T @ (error / sigmas)) ** 2 / eigenvalues)
    return square, eigenvalues[-1] / eigenvalues[0]


def assert_as_defined(errors, covariances):
    """The same are skipped; the others differ by rounding: 1e-12, or what the condition allows."""
    found = squared_mahalanobis(errors, covariances)
    shape = np.broadcast_shapes(errors.shape[:-1], covariances.shape[:-2])
    size = errors.shape[-1]
    assert found.shape == shape
    pairs = zip(
        np.broadcast_to(errors, (*shape, size)).reshape(-1, size),
        np.broadcast_to(covariances, (*shape, size, size)).reshape(-1, size, size),
        strict=True,
    )
    expected, condition = np.array([by_definition(*pair) for pair in pairs]).T
    found = found.ravel()
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    kept = ~np.isnan(expected)
    # Within the reach of the fast path 1e-12; beyond, the same eigenvalues but for rounding.
    allowed = np.maximum(1e-12, 8 * size * EPS * condition[kept])
    assert (np.abs(found[kept] - expected[kept]) <= allowed * expected[kept]).all()
    return kept


def correlated(rng, count, size, smallest):
    """Covariances with eigenvalues log-uniform from `smallest` to 1, units over ten decades."""
    bases = np.linalg.qr(rng.normal(size=(count, size, size)))[0]
    eigenvalues = 10.0 ** rng.uniform(np.log10(smallest), 0, size=(count, 1, size))
    matrices = (bases * eigenvalues) @ np.swapaxes(bases, 1, 2)
    units = 10.0 ** rng.uniform(-3, 3, size=(count, size))
    return matrices * units[:, :, None] * units[:, None, :], units


@pytest.mark.parametrize("size", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("smallest", [0.3, 1e-2, 1e-5, 1e-12])
def test_norms_of_a_stack_are_those_of_each_matrix(rng, size, smallest):
    covariances, units = correlated(rng, 400, size, smallest)
    kept = assert_as_defined(rng.normal(size=(400, size)) * units, covariances)
    assert kept.sum() > 50


@pytest.mark.parametrize("size", [2, 3, 6, 20])
def test_what_is_far_from_singular_is_not_decomposed(rng, size, monkeypatch):
    factors = rng.normal(size=(500, size, size**2 // 2 + 2))
    covariances = factors @ np.swapaxes(factors, 1, 2)
    sigmas = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    correlations = covariances / (sigmas[:, :, None] * sigmas[:, None, :])
    far = np.linalg.det(correlations) > 1.001 * REGULAR
    eigenvalues = np.linalg.eigvalsh(correlations[far])
    # The certain bound: so far from singular that rounding decides nothing.
    assert (eigenvalues[:, 0] > 1e4 * SINGULAR * eigenvalues[:, -1]).all()
    decomposed = counted(monkeypatch)
    assert not np.isnan(squared_mahalanobis(np.ones(size), covariances[far])).any()
    assert not decomposed
    assert far.sum() > 100


def test_the_decision_at_the_threshold_is_that_of_the_eigenvalues(rng):
    """Of 1 - r and 1 + r, where they are within rounding of the bound and far from it."""
    gap = 2 * SINGULAR / (1 + SINGULAR)
    gaps = np.concatenate(
        [gap * (1 + np.linspace(-1e-5, 1e-5, 401)), np.logspace(-14, -1, 200), [0.0, -1e-9]]
    )
    pairs = np.tile(np.eye(2), (len(gaps), 1, 1))
    pairs[:, 0, 1] = pairs[:, 1, 0] = (1 - gaps) * np.resize([1, -1], len(gaps))
    kept = assert_as_defined(rng.normal(size=(len(gaps), 2)), pairs)
    assert 0 < kept[:401].sum() < 401
    triples = np.tile(np.eye(3), (len(gaps), 1, 1))
    triples[:, ::2, ::2] = pairs
    kept = assert_as_defined(rng.normal(size=(len(gaps), 3)), triples)
    assert 0 < kept[:401].sum() < 401


def test_each_fault_is_skipped_alone(rng):
    """Faulty ones between sound ones, of each kind and at each place."""
    sound = correlated(rng, 1, 3, 0.1)[0][0]
    stack = [sound]
    for i, j in itertools.product(range(3), range(3)):
        for value in (np.nan, np.inf, -np.inf):
            stack += [sound.copy(), sound]
            stack[-2][i, j] = value
    for i in range(3):
        largest = sound.diagonal().max()
        for variance in (0.0, -1.0, 0.5 * NEGLIGIBLE * largest, 1e-300):
            stack += [sound.copy(), sound]
            stack[-2][i, i] = variance
    ones = np.ones((3, 3))
    stack += [np.zeros((3, 3)), ones, -np.eye(3), np.full((3, 3), np.nan)]
    stack.append(2 * ones - np.eye(3))  # eigenvalues 5, -1, -1: the determinant is positive
    stack.append(np.eye(3) - 0.6 * (ones - np.eye(3)))  # 1.6, 1.6, -0.2: leading minors are not
    stack.append(np.array([[1.0, 2, 0], [2, 1, 0], [0, 0, 1]]))
    kept = assert_as_defined(rng.normal(size=(len(stack), 3)), np.array(stack))
    assert kept.sum() == 1 + 27 + 12


def test_errors_that_are_none_are_skipped_and_huge_ones_are_not(rng):
    covariances = np.tile(correlated(rng, 1, 3, 0.1)[0], (4, 1, 1))
    errors = rng.normal(size=(4, 3))
    errors[0, 1], errors[1, 2], errors[2, 0] = np.nan, np.inf, -np.inf
    assert assert_as_defined(errors, covariances).tolist() == [False, False, False, True]
    # The squares of what is huge overflow, in the end or on the way.
    assert squared_mahalanobis([1e200, 0.0], np.eye(2)) == np.inf
    pair = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    huge = np.array([1.5e308, -1.5e308, 1.0])
    assert squared_mahalanobis(huge, pair) == by_definition(huge, pair)[0] == np.inf


def test_the_lower_triangle_counts(rng):
    covariances = correlated(rng, 50, 3, 1e-3)[0]
    errors = rng.normal(size=(50, 3))
    expected = squared_mahalanobis(errors, covariances)
    upper = np.triu_indices(3, 1)
    covariances[:, upper[0], upper[1]] = 1e9
    np.testing.assert_array_equal(squared_mahalanobis(errors, covariances), expected)


@pytest.mark.parametrize("smallest", [0.1, 1e-7])
@pytest.mark.parametrize(
    ("left", "right"),
    [((), ()), ((), (5,)), ((6,), ()), ((2, 5), (5,)), ((4, 1), (5,)), ((4,), (5, 1))],
)
def test_errors_and_covariances_broadcast(rng, left, right, smallest):
    covariances = correlated(rng, int(np.prod(right)), 3, smallest)[0].reshape(*right, 3, 3)
    assert assert_as_defined(rng.normal(size=(*left, 3)), covariances).all()


def test_no_errors_have_no_norms():
    assert squared_mahalanobis(np.empty((0, 3)), np.empty((0, 3, 3))).shape == (0,)


def test_errors_that_share_a_covariance_have_it_decomposed_once(rng, monkeypatch):
    covariances = np.tile(np.eye(3), (5, 1, 1))
    covariances[1::2, 0, 1] = covariances[1::2, 1, 0] = 1 - 1e-7  # two that are near singular
    decomposed = counted(monkeypatch)
    squared_mahalanobis(rng.normal(size=(40, 5, 3)), covariances)
    assert decomposed == [2]


def counted(monkeypatch):
    """How many matrices each call of eigh decomposes from now on."""
    eigh, numbers = np.linalg.eigh, []

    def counting(matrices, *others):
        numbers.append(len(matrices))
        return eigh(matrices, *others)

    monkeypatch.setattr(np.linalg, "eigh", counting)
    return numbers
