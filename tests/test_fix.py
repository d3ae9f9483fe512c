"""Fixes of landmarks from bearings and ranges: exact, unambiguous, with the right covariance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numerics import assert_sampled, subtract_angles
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares

from ekfslam import geometry as geo
from ekfslam.models.fix import MOST, RIVAL, SHARE, fix
from ekfslam.models.sensors import BEARING, RANGE

each_kind = pytest.mark.parametrize("kind", [BEARING, RANGE], ids=["bearing", "range"])
SIGMA = {BEARING: 0.01, RANGE: 0.1}


class Case(NamedTuple):
    """What `fix` takes."""

    kinds: np.ndarray
    frames: np.ndarray
    values: np.ndarray
    variances: np.ndarray

    def rows(self, which):
        return Case(*(column[which] for column in self))


class Fix(NamedTuple):
    """What `fix` returns."""

    determined: bool
    position: np.ndarray
    covariance: np.ndarray


def fixed(sightings):
    determined, x, y, xx, xy, yy = fix(*sightings)
    assert np.isfinite([x, y, xx, xy, yy]).all()
    return Fix(determined, np.array([x, y]), np.array([[xx, xy], [xy, yy]]))


def sightings(kinds, frames, point, rng=None, sigmas=None):
    """Sightings of a point from sensor poses, with noise if a generator is given."""
    frames = np.asarray(frames, dtype=float)
    kinds = np.broadcast_to(kinds, len(frames)).astype(np.int64)
    if sigmas is None:
        sigmas = np.vectorize(SIGMA.get)(kinds)
    sigmas = np.broadcast_to(sigmas, len(frames)).astype(float)
    dx, dy = (np.asarray(point) - frames[:, :2]).T
    exact = np.where(kinds == RANGE, np.hypot(dx, dy), np.arctan2(dy, dx) - frames[:, 2])
    value = exact if rng is None else exact + sigmas * rng.normal(size=len(frames))
    value = np.where(kinds == RANGE, np.abs(value), subtract_angles(value, 0))
    return Case(kinds, frames, np.column_stack([value, np.zeros_like(value)]), sigmas**2)


def path(turns, step=0.5):
    """Poses of a robot that turns and advances."""
    turns = np.asarray(turns, dtype=float)
    increments = np.column_stack([np.full_like(turns, step), np.zeros_like(turns), turns])
    return geo.integrate(np.zeros(3), increments)


STRAIGHT = path(np.zeros(20))
ARC = path(np.full(20, 0.1))
ASIDE = np.array([6.0, 5.0])


def residuals(case, point):
    """Whitened residuals at a point, or at points (m, 1, 2)."""
    dx, dy = np.moveaxis(np.asarray(point) - case.frames[:, :2], -1, 0)
    ranges = case.values[:, 0] - np.hypot(dx, dy)
    bearings = subtract_angles(case.values[:, 0] + case.frames[:, 2], np.arctan2(dy, dx))
    return np.where(case.kinds == RANGE, ranges, bearings) / np.sqrt(case.variances)


def cost_of(case, points):
    """Their sum of squares at points (m, 2)."""
    return np.sum(residuals(case, points[:, None]) ** 2, axis=1)


# Exactness ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kinds", [[BEARING], [RANGE], [BEARING, RANGE]], ids=str)
def test_without_noise_the_landmark_is_found_exactly(kinds, rng):
    found = 0
    for _ in range(100):
        frames = path(rng.normal(0, 0.3, rng.integers(5, 40)), rng.uniform(0.1, 3))
        nearby = frames[rng.integers(len(frames)), :2]
        point = nearby + np.ptp(frames[:, 0]) * rng.uniform(0.2, 1) * rng.choice([-1, 1], 2)
        result = fixed(sightings(rng.choice(kinds, len(frames)), frames, point))
        if result.determined:
            assert_allclose(result.position, point, rtol=0, atol=1e-8)
            found += 1
    assert found > 80


def test_two_bearings_meet_in_closed_form():
    """From (0, 0) along 45 degrees, and from (2, 0) along world y."""
    case = Case(
        np.array([BEARING, BEARING]),
        np.array([[0.0, 0.0, 0.3], [2.0, 0.0, -2.0]]),
        np.array([[np.pi / 4 - 0.3, 0.0], [np.pi / 2 + 2.0, 0.0]]),
        np.full(2, 1e-4),
    )
    result = fixed(case)
    assert result.determined
    assert_allclose(result.position, [2.0, 2.0], atol=1e-12)
    # Across each ray the standard deviation is distance times noise; x is across the second.
    assert result.covariance[0, 0] == pytest.approx(4 * 1e-4)
    across = np.array([1.0, -1.0]) / np.sqrt(2)
    assert across @ result.covariance @ across == pytest.approx(8 * 1e-4)


def test_a_range_and_a_bearing_of_one_place_are_enough():
    frame = np.array([[1.0, 2.0, 0.5]] * 2)
    result = fixed(sightings([RANGE, BEARING], frame, [4.0, 6.0]))
    assert result.determined
    assert_allclose(result.position, [4.0, 6.0], atol=1e-12)
    along = np.array([3.0, 4.0]) / 5
    across = np.array([-4.0, 3.0]) / 5
    assert along @ result.covariance @ along == pytest.approx(SIGMA[RANGE] ** 2)
    assert across @ result.covariance @ across == pytest.approx((5 * SIGMA[BEARING]) ** 2)
    assert along @ result.covariance @ across == pytest.approx(0, abs=1e-15)


@each_kind
def test_the_optimum_is_the_least_of_all(kind, rng):
    """Against all minima of a fine polar grid: the best one, and no rival near its cost."""
    determined = 0
    for _ in range(60):
        frames = path(rng.normal(0, rng.choice([0.05, 0.5]), rng.integers(2, 15)), 1.0)
        reach = np.hypot(*(frames[-1, :2] - frames[0, :2]))
        point = frames[-1, :2] + reach * rng.choice([0.3, 1, 3]) * rng.normal(size=2)
        distance = np.hypot(*(point - frames[-1, :2]))
        sigma = rng.choice([0.01, 0.05]) * (distance if kind == RANGE else 1)
        case = sightings(kind, frames, point, rng, sigma)
        result = fixed(case)
        if not result.determined:
            continue
        determined += 1
        radius = np.geomspace(0.02 * reach, 20 * reach, 150)
        angle = np.linspace(0, geo.TAU, 180, endpoint=False)
        middle = frames[:, :2].mean(axis=0)
        grid = middle + radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        cost = cost_of(case, grid.reshape(-1, 2))
        best = cost_of(case, result.position[None])[0]
        assert best <= cost.min() + 1e-9
        apart = grid.reshape(-1, 2) - result.position
        nees = np.einsum("ni,ij,nj->n", apart, np.linalg.inv(result.covariance), apart)
        # What costs little lies around the optimum, and nowhere else.
        assert (nees[cost < best + 4] < 4 * 2).all()
        neighbours = np.stack(
            [np.roll(cost.reshape(150, 180), shift, axis) for axis in (0, 1) for shift in (1, -1)]
        )
        valley = (cost.reshape(150, 180) < neighbours).all(axis=0).ravel()
        valley &= (cost < best + RIVAL) & (nees > 25)
        assert not valley[:-180].any()
    assert determined > 10


@each_kind
def test_a_fix_does_not_know_where_the_world_is(kind, rng):
    case = sightings(kind, ARC, ASIDE, rng)
    here = fixed(case)
    assert here.determined
    for motion in ([3.0, -7.0, 2.0], [5e5, 4e6, -1.0]):
        there = fixed(case._replace(frames=geo.compose(motion, case.frames)))
        assert there.determined
        assert_allclose(there.position, geo.from_frame(motion, here.position), rtol=0, atol=1e-6)
        turned = geo.congruence(geo.rotation(motion[2]), here.covariance)
        assert_allclose(there.covariance, turned, rtol=1e-6, atol=1e-12)


@each_kind
def test_the_order_of_sightings_does_not_matter(kind, rng):
    case = sightings(kind, ARC, ASIDE, rng)
    here, there = fixed(case), fixed(case.rows(rng.permutation(len(case.kinds))))
    assert here.determined
    assert there.determined
    assert_allclose(there.position, here.position, atol=1e-7)
    assert_allclose(there.covariance, here.covariance, rtol=1e-5)


# When to wait -------------------------------------------------------------------------------------


def test_ranges_from_a_straight_path_have_a_mirror_image(rng):
    """However many and however exact they are; one step aside resolves it."""
    for noise in (None, rng):
        case = sightings(RANGE, STRAIGHT, ASIDE, noise)
        assert not any(fixed(case.rows(slice(n))).determined for n in range(len(STRAIGHT) + 1))
    turned = np.concatenate([STRAIGHT, path(np.full(6, 0.4), 1.0) + STRAIGHT[-1]])
    result = fixed(sightings(RANGE, turned, ASIDE, rng))
    assert result.determined
    error = result.position - ASIDE
    assert error @ np.linalg.solve(result.covariance, error) < 13.8


def test_a_turn_decides_as_soon_as_the_mirror_image_costs_enough():
    """A last range from aside, whose residual at the mirror image is known in closed form."""
    line = np.column_stack([np.linspace(0, 10, 11), np.zeros((11, 2))])
    mirrored = ASIDE * [1, -1]
    for aside, resolved in ((0.05, False), (1.0, True)):
        case = sightings(RANGE, [*line, [5.0, aside, 0.0]], ASIDE)
        rival = cost_of(case, mirrored[None])[0]
        assert (rival > 1.2 * RIVAL) if resolved else (rival < RIVAL)
        assert fixed(case).determined is resolved


@pytest.mark.parametrize("seed", [1070, 1224, 1445, 1504, 1848])
def test_a_short_circle_does_not_hide_the_mirror_image(seed):
    """Draws whose shortest range is so short that the two minima look like one along its circle."""
    rng = np.random.default_rng(seed)
    frames = path(rng.normal(0, 0.3, 15), 1.0)
    angle = rng.uniform(-np.pi, np.pi)
    point = frames[-1, :2] + 15 * np.array([np.cos(angle), np.sin(angle)])
    case = sightings(RANGE, frames, point, rng, 0.75)
    angles = np.linspace(0, geo.TAU, 12)
    around = frames[-1, :2] + 15 * np.column_stack([np.cos(angles), np.sin(angles)])
    minima = np.array([least_squares(lambda x: residuals(case, x), at).x for at in around])
    cost = cost_of(case, minima)
    apart = np.hypot(*(minima - minima[cost.argmin()]).T)
    assert cost[apart > 3].min() < cost.min() + RIVAL
    assert not fixed(case).determined


def test_bearings_wait_for_parallax():
    """Straight at the landmark there is none; past it, more than five sigmas are needed."""
    assert not fixed(sightings(BEARING, STRAIGHT, [40.0, 0.0])).determined
    for parallax, enough in ((4.0, False), (30.0, True)):
        baseline = 10 * np.tan(parallax * SIGMA[BEARING])
        frames = np.array([[0.0, 0.0, np.pi / 2], [baseline, 0.0, np.pi / 2]])
        assert fixed(sightings(BEARING, frames, [0.0, 10.0])).determined is enough


@each_kind
@pytest.mark.parametrize("count", [2, 10, 300])
def test_one_place_is_not_enough(kind, count, rng):
    frames = np.tile([1.0, 2.0, 0.5], (count, 1))
    assert not fixed(sightings(kind, frames, ASIDE)).determined
    assert not fixed(sightings(kind, frames, ASIDE, rng)).determined


@each_kind
@pytest.mark.parametrize("count", [0, 1])
def test_one_sighting_is_not_enough(kind, count):
    assert fix(*sightings(kind, ARC, ASIDE).rows(slice(count))) == (False, 0, 0, 0, 0, 0)


def test_two_ranges_are_never_enough(rng):
    for _ in range(200):
        frames = rng.uniform(-5, 5, (2, 3))
        assert not fixed(sightings(RANGE, frames, rng.uniform(-5, 5, 2))).determined


def test_bearings_that_meet_behind_the_sensors_fix_nothing():
    case = sightings(BEARING, ARC, ASIDE)
    behind = case._replace(values=subtract_angles(case.values + np.array([np.pi, 0]), 0))
    assert fixed(case).determined
    assert not fixed(behind).determined


@each_kind
def test_noise_makes_it_wait(kind):
    """The same draws, scaled: the number of sightings until it is determined."""
    waits = np.zeros((3, 40))
    for seed in range(40):
        for row, scale in enumerate((0.3, 1.0, 3.0)):
            rng = np.random.default_rng(seed)
            frames = path(0.1 * np.sin(0.15 * np.arange(150) + rng.uniform(0, 6)))
            point = frames[30, :2] + rng.uniform(3, 8) * rng.choice([-1, 1], 2)
            case = sightings(kind, frames, point, rng, scale * SIGMA[kind])
            waits[row, seed] = next(
                (n for n in range(2, 151) if fixed(case.rows(slice(n))).determined), 151
            )
    assert (np.diff(waits.mean(axis=1)) > 2).all()


# Covariance ---------------------------------------------------------------------------------------


@each_kind
def test_the_covariance_is_that_of_drawn_noise(kind, rng):
    exact = sightings(kind, ARC, ASIDE, sigmas=0.1 * SIGMA[kind])
    expected = fixed(exact)
    errors = []
    for _ in range(4000):
        drawn = exact.values + np.sqrt(exact.variances)[:, None] * rng.normal(size=(21, 1)) * [1, 0]
        result = fixed(exact._replace(values=drawn))
        assert result.determined
        errors.append(result.position - ASIDE)
    assert_sampled(np.array(errors), expected.covariance)


@each_kind
def test_what_is_determined_is_where_it_says(kind):
    """At the first moment that it is determined, for paths and landmarks drawn at random.

    Stopping at the first such moment favours lucky noise, so a little more than chi-square is due:
    0.1 % lie beyond 13.8. Without the test of the Gaussian, one range fix in ten did.
    """
    nees = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        frames = path(0.15 * np.sin(rng.uniform(0.05, 0.2) * np.arange(100) + rng.uniform(0, 6)))
        point = frames[rng.integers(40), :2] + rng.uniform(1.5, 9) * rng.choice([-1, 1], 2)
        case = sightings(kind, frames, point, rng)
        for n in range(2, 101):
            result = fixed(case.rows(slice(n)))
            if result.determined:
                error = result.position - point
                nees.append(error @ np.linalg.solve(result.covariance, error))
                nearest = np.hypot(*(result.position - frames[:n, :2]).T).min()
                assert np.linalg.eigvalsh(result.covariance)[1] < (SHARE * nearest) ** 2
                break
    assert len(nees) > 380
    assert np.mean(np.array(nees) > 13.8) < 0.02
    assert np.mean(nees) == pytest.approx(2, abs=5 * 2 / np.sqrt(len(nees)))


@each_kind
def test_residuals_beyond_the_noise_widen_the_covariance(kind, rng):
    case = sightings(kind, ARC, ASIDE, rng, 5 * SIGMA[kind] / 10)
    honest = fixed(case)
    bold = fixed(case._replace(variances=case.variances / 25))
    assert honest.determined
    assert bold.determined
    assert_allclose(bold.position, honest.position, atol=1e-7)
    scale = cost_of(case, honest.position[None])[0] / (len(ARC) - 2)
    assert 0.3 < scale < 2  # the noise is as large as honestly stated
    assert_allclose(bold.covariance, scale * honest.covariance, rtol=1e-5)


def test_understated_noise_does_not_decide_between_images(rng):
    """The mirror image costs more in proportion as all residuals do; that is no evidence."""
    line = np.column_stack([np.linspace(0, 10, 41), np.zeros((41, 2))])
    line[20, 1] = 0.05
    costly = 0
    for _ in range(20):
        honest = sightings(RANGE, line, ASIDE, rng, 0.1)
        bold = honest._replace(variances=honest.variances / 100)
        best = fixed(bold)
        own, mirrored = cost_of(bold, best.position * [[1, 1], [1, -1]])
        costly += mirrored - own > 2 * RIVAL
        assert not best.determined
        assert not fixed(honest).determined
    assert costly > 10


# What comes from outside --------------------------------------------------------------------------


def test_of_many_sightings_some_are_used(rng):
    many = 7 * MOST
    case = sightings(RANGE, path(np.full(many, 0.02), 0.1), ASIDE, rng)
    keep = np.arange(MOST) * many // (MOST - 1)
    assert keep[-1] == many
    whole, part = fix(*case), fix(*case.rows(keep))
    assert whole[0]
    assert_array_equal(whole, part)


def test_exact_sightings_are_no_trouble():
    """Variances of zero, and a range of zero."""
    case = sightings(RANGE, ARC, ASIDE)
    result = fixed(case._replace(variances=np.zeros(21)))
    assert result.determined
    assert_allclose(result.position, ASIDE, atol=1e-9)
    assert not fixed(sightings(RANGE, STRAIGHT, [5.0, 0.0])).determined


def test_nonsense_gives_numbers(rng):
    """Values that belong to no point, at any scale, from places that may coincide."""
    for _ in range(2000):
        count = rng.integers(0, 8)
        scale = 10.0 ** rng.integers(-6, 7)
        frames = scale * rng.integers(-2, 3, (count, 3)).astype(float)
        case = Case(
            rng.choice([BEARING, RANGE], count),
            frames,
            np.abs(scale * rng.integers(0, 3, (count, 2))) * 1.0,
            rng.choice([0.0, 1e-8, 1.0, 1e6], count),
        )
        fixed(case)


def test_read_only_columns_are_fine(rng):
    case = sightings(RANGE, ARC, ASIDE, rng)
    expected = fix(*case)
    for column in case:
        column.flags.writeable = False
    assert fix(*case) == expected


@each_kind
def test_compiled_and_plain_python_agree(kind, rng):
    case = sightings(kind, ARC, ASIDE, rng)
    assert_allclose(fix(*case), fix.py_func(*case), rtol=1e-9)
