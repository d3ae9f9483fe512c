"""The textbook of the family itself: Jacobians, laws, and that the laws find its mistakes."""

from __future__ import annotations

import numpy as np
import pytest
import textbook_family as book
from family_laws import CASES, LAWS, common_limit, turning
from family_mistakes import MISTAKES
from numerics import central_difference
from problems import camera, problem, scanner
from textbook import TextbookEkf

from ekfslam.dataset import Dataset
from ekfslam.simulation import simulate

SENSORS = {"range-bearing": scanner(0.3, -0.2, 0.5), "xy": camera(-0.4, 0.1, 2.8)}
REFERENCE = book.Textbook(book.Standard)


def subject(name: str) -> book.Textbook:
    kinds = book.FAMILY | {kind.__name__: kind for kind in MISTAKES}
    return book.Textbook(kinds[name])


# Jacobians --------------------------------------------------------------------------------------


def prepared(kind, sensor, rng, noise=0.0):
    """A filter in the middle of a run: landmarks 3 and 5 in the state, landmark 8 not yet."""
    dataset = problem(sensor, steps=2)
    slam = kind(dataset)
    slam.x = np.array([0.7, -0.4, 2.2, 2.0, 3.5, 4.1, -1.3])
    slam.at = {3: slice(3, 5), 5: slice(5, 7)}
    root = 0.3 * rng.normal(size=(7, 7))
    slam.P = noise * root @ root.T
    slam.lf = {3: slam.x[3:5], 5: slam.x[5:7]}
    slam.pm, slam.jacobians = slam.x[:3].copy(), [[]]
    return slam


def row_of(dataset: Dataset, landmark: int) -> int:
    return int(np.flatnonzero(dataset.observations.landmark == landmark)[0])


@pytest.mark.parametrize("kind", SENSORS)
def test_views_and_their_inverses(kind, rng):
    sensor = SENSORS[kind]
    for y in rng.normal(size=(5, 2)) * 4:
        z, D = book.view(sensor, y)
        point, Dz = book.back(sensor, z)
        np.testing.assert_allclose(point, y, atol=1e-12)
        numeric = central_difference(lambda x: book.view(sensor, x)[0], y, 1e-3)
        np.testing.assert_allclose(D, numeric, atol=1e-9)
        numeric = central_difference(lambda value: book.back(sensor, value)[0], z, 1e-3)
        np.testing.assert_allclose(Dz, numeric, atol=1e-9)
        np.testing.assert_allclose(D @ Dz, np.eye(2), atol=1e-12)
        np.testing.assert_allclose(z, sensor.observe(np.zeros(3), y)[0], atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 9e-5, 1.1e-4, 0.3, -2.0, 3.1])
def test_the_exponential_turns_and_comes_back(angle, rng):
    x, xi = rng.normal(size=7), rng.normal(size=7)
    xi[2] = angle
    np.testing.assert_allclose(book.invariant_error(book.retracted(xi, x), x), xi, atol=1e-12)
    half = book.retracted(xi / 2, book.retracted(xi / 2, x))
    np.testing.assert_allclose(half, book.retracted(xi, x), atol=1e-12)
    T = central_difference(lambda e: book.retracted(e, x), np.zeros(7), 1e-2)
    np.testing.assert_allclose(book.lever(x), T, atol=1e-9)


@pytest.mark.parametrize("kind", [book.Standard, book.FirstEstimates, book.RightInvariant])
def test_the_prediction(kind, rng):
    """F and the noise matrix, in the coordinates of the filter's own error."""
    delta, Q = np.array([0.8, 0.2, 0.9]), np.diag([0.1, 0.2, 0.05])
    start = prepared(kind, SENSORS["xy"], rng).x.copy()
    invariant = kind is book.RightInvariant

    def state(e):
        slam = prepared(kind, SENSORS["xy"], rng)
        slam.x = book.retracted(e[:7], start) if invariant else start + e[:7]
        slam.predict(delta + e[7:], np.zeros((3, 3)), [])
        return slam.x

    def difference(a, b):
        return book.invariant_error(a, b) if invariant else a - b

    end = state(np.zeros(10))
    numeric = central_difference(lambda e: difference(state(e), end), np.zeros(10), 1e-2)
    slam = prepared(kind, SENSORS["xy"], rng, noise=1.0)
    P = slam.P
    slam.predict(delta, Q, [])
    F, G = numeric[:, :7], numeric[:, 7:]
    np.testing.assert_allclose(slam.transitions[-1], F, atol=1e-9)
    np.testing.assert_allclose(slam.P, F @ P @ F.T + G @ Q @ G.T, atol=1e-9)


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("kind", [book.Standard, book.FirstEstimates, book.RightInvariant])
def test_sightings_and_new_landmarks(kind, sensor, rng):
    slam = prepared(kind, SENSORS[sensor], rng, noise=1.0)
    start, P = slam.x.copy(), slam.P
    invariant = kind is book.RightInvariant
    seen, new = row_of(slam.dataset, 5), row_of(slam.dataset, 8)

    def at(e):
        slam = prepared(kind, SENSORS[sensor], rng)
        slam.x = book.retracted(e, start) if invariant else start + e
        return slam

    numeric = central_difference(lambda e: at(e).expected(seen), np.zeros(7), 1e-3)
    np.testing.assert_allclose(slam.jacobian(seen), numeric, atol=1e-8)
    z, R = slam.dataset.observations.values[new], slam.dataset.sightings.covariance[new]

    def extended(e):
        point = at(e[:7]).x
        turn = book.rotation(point[2])
        l = point[:2] + turn @ book.back(SENSORS[sensor], z + e[7:])[0]
        return np.concatenate([point, l])

    def difference(a, b):
        return book.invariant_error(a, b) if invariant else a - b

    here = extended(np.zeros(9))
    numeric = central_difference(lambda e: difference(extended(e), here), np.zeros(9), 1e-3)
    A, N = numeric[:, :7], numeric[:, 7:]
    slam.extend(new)
    np.testing.assert_allclose(slam.x, here, atol=1e-12)
    np.testing.assert_allclose(slam.P, A @ P @ A.T + N @ R @ N.T, atol=1e-8)


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_robocentric_steps(sensor, rng):
    delta, Q = np.array([0.8, 0.2, 0.9]), np.diag([0.1, 0.2, 0.05])

    def at(e, noise=0.0):
        slam = prepared(book.Robocentric, SENSORS[sensor], np.random.default_rng(3), noise)
        slam.predict(delta, Q, [])
        slam.x = slam.x + e
        return slam

    slam = at(np.zeros(10), noise=1.0)
    seen = row_of(slam.dataset, 5)
    numeric = central_difference(lambda e: at(e).expected(seen), np.zeros(10), 1e-3)
    np.testing.assert_allclose(slam.jacobian(seen), numeric, atol=1e-8)

    def composed(e):
        slam = at(e)
        slam.settle()
        return slam.x

    F, P = central_difference(composed, np.zeros(10), 1e-3), slam.P
    slam.settle()
    np.testing.assert_allclose(slam.P, F @ P @ F.T, atol=1e-8)

    def world(e):
        moved = at(np.zeros(10))
        moved.settle()
        moved.x = moved.x + e
        return moved.world()[0]

    T = central_difference(world, np.zeros(7), 1e-3)
    np.testing.assert_allclose(slam.world()[1], T @ slam.P @ T.T, atol=1e-8)


# Observability ----------------------------------------------------------------------------------


def singular_values(name: str) -> np.ndarray:
    """Of the local observability matrix over twenty steps, all landmarks being mapped."""
    slam = book.FAMILY[name](problem(scanner(), steps=25))
    slam.run()
    rows, moved = [], np.eye(13)
    for k in range(4, 24):
        moved = slam.transitions[k] @ moved
        rows += [H @ moved for H in slam.jacobians[k]]
    return np.linalg.svd(np.concatenate(rows), compute_uv=False)


@pytest.mark.parametrize("name", ["ekf-ideal", "ekf-fej", "ekf-oc", "ekf-ri"])
def test_three_directions_cannot_be_observed(name):
    """Huang et al. 2010: position and heading of the whole."""
    values = singular_values(name)
    assert values[-3] < 1e-12 * values[0]
    assert values[-4] > 1e-4 * values[0]


@pytest.mark.parametrize("name", ["ekf", "iekf"])
def test_the_standard_filter_believes_that_it_observes_the_heading(name):
    values = singular_values(name)
    assert values[-3] > 1e-4 * values[0]
    assert values[-2] < 1e-12 * values[0]


# Laws -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("law", "name"), CASES)
def test_the_textbook_keeps_the_laws(law, name):
    assert LAWS[law].measure(subject(name), REFERENCE) <= LAWS[law].bound


@pytest.mark.parametrize(
    ("law", "name"), [(law, name) for law, each in LAWS.items() for name in each.broken_by]
)
def test_a_law_is_broken_by_those_who_should(law, name):
    assert LAWS[law].measure(subject(name), REFERENCE) > 100 * LAWS[law].bound


def test_every_mistake_breaks_a_law():
    found = {name for law in LAWS.values() for name in law.broken_by}
    assert found >= {kind.__name__ for kind in MISTAKES}


def test_the_map_in_the_limit():
    apart, below, open_ = common_limit(REFERENCE, 60)
    assert apart < 1e-12
    assert below > 0
    _, _, later = common_limit(REFERENCE, 240)
    assert later < open_ / 3


def test_the_standard_filter_is_that_of_the_other_textbook():
    for data in (simulate("loop-15", seed=1), turning()):
        ours, theirs = REFERENCE.estimate(data), TextbookEkf().estimate(data)
        off = ours.online.poses - theirs.online.poses
        off[:, 2] = np.angle(np.exp(1j * off[:, 2]))
        np.testing.assert_allclose(off, 0, atol=1e-11)
        np.testing.assert_allclose(ours.online.covariances, theirs.online.covariances, atol=1e-12)
