"""Particles, their maps and paths, against copies that share nothing; resampling and weights."""

from __future__ import annotations

import numpy as np
import pytest

from ekfslam.filters.fastslam.particles import (
    PAGE,
    Cloud,
    Maps,
    Paths,
    add_landmark,
    lengthen,
    normalise,
    own_page,
    remove_landmark,
    resample,
    systematic,
)
from ekfslam.filters.fastslam.summary import look_back, particle_of_each_step

PARTICLES = 7


def written(maps, particle, index, value):
    page = own_page(maps, particle, index // PAGE)
    maps.gaussians[page, index % PAGE] = value


def contents(maps, particle):
    """Landmarks of a particle, in order: name, evidence, numbers."""
    index = np.arange(maps.used[particle])
    at = maps.table[particle, index // PAGE], index % PAGE
    gaussians, names = maps.landmarks(particle)
    return [
        (int(n), int(e), g.tolist())
        for n, e, g in zip(names, maps.evidence[at], gaussians, strict=True)
    ]


def assert_sound(maps):
    """Every page has as many owners as entries of the table name it; what is free has none."""
    entries = maps.table[maps.table >= 0]
    named, owners = np.unique(entries, return_counts=True)
    np.testing.assert_array_equal(maps.owners[named], owners)
    free = maps.free[: maps.marks[0]]
    assert len(np.unique(free)) == len(free)
    assert not set(free.tolist()) & set(named.tolist())
    assert len(free) + len(named) == maps.marks[1]


def resampled(maps, paths, cloud, rng):
    """Resample, and tell which particle each was, by the poses."""
    cloud.poses[:] = np.arange(PARTICLES)[:, None]
    cloud.weights[:] = rng.dirichlet(np.full(PARTICLES, 0.3))
    resample(cloud, maps, paths, rng.random())
    return cloud.poses[:, 0].astype(int)


@pytest.mark.parametrize("seed", range(4))
def test_shared_maps_are_what_copies_would_be(seed):
    """Any order of mapping, correcting, forgetting, growing and resampling."""
    rng = np.random.default_rng(seed)
    maps, paths, cloud = (
        Maps.of(PARTICLES, 20),
        Paths.of(PARTICLES, 400),
        Cloud.of(np.zeros((7, 3))),
    )
    lengthen(paths, cloud)
    copies = [[] for _ in range(PARTICLES)]
    for step in range(300):
        i, value = int(rng.integers(PARTICLES)), rng.normal(size=5)
        event = rng.choice(["add", "write", "remove", "resample"], p=[0.45, 0.25, 0.15, 0.15])
        if event == "resample":
            sources = resampled(maps, paths, cloud, rng)
            copies = [list(copies[source]) for source in sources]
        elif event == "add":
            if maps.used.max() + 1 > maps.room:
                maps = maps.grown(2 * maps.room)
            page, place = add_landmark(maps, i, step)
            maps.gaussians[page, place] = value
            copies[i].append((step, 1, value.tolist()))
        elif copies[i]:
            index = int(rng.integers(len(copies[i])))
            if event == "write":
                written(maps, i, index, value)
                copies[i][index] = (*copies[i][index][:2], value.tolist())
            else:
                remove_landmark(maps, i, index)
                copies[i][index] = copies[i][-1]
                copies[i].pop()
        assert [contents(maps, p) for p in range(PARTICLES)] == copies
        assert_sound(maps)
    assert maps.room > 20


def test_a_resampled_particle_shares_no_state_that_can_change():
    maps, paths, cloud = Maps.of(3, 8), Paths.of(3, 9), Cloud.of(np.zeros((3, 3)))
    lengthen(paths, cloud)
    add_landmark(maps, 1, 5)
    written(maps, 1, 0, 1.0)
    cloud.weights[:] = [0.0, 1.0, 0.0]
    resample(cloud, maps, paths, 0.5)
    assert len(set(maps.table[:, 0].tolist())) == 1  # no copy so far
    before = contents(maps, 0), contents(maps, 2)
    written(maps, 1, 0, 2.0)
    cloud.poses[1] = 9.0
    assert (contents(maps, 0), contents(maps, 2)) == before
    assert contents(maps, 1)[0][2] == [2.0] * 5
    assert not cloud.poses[[0, 2]].any()


def test_paths_are_those_that_were_taken():
    """Against whole histories that are copied at every resampling; and memory is used again."""
    rng = np.random.default_rng(3)
    steps = 200
    maps, paths = Maps.of(PARTICLES, 1), Paths.of(PARTICLES, steps)
    cloud, histories = Cloud.of(np.zeros((PARTICLES, 3))), [[] for _ in range(PARTICLES)]
    for step in range(steps):
        if step % 3 == 2:
            histories = [list(histories[s]) for s in resampled(maps, paths, cloud, rng)]
        cloud.poses[:] = rng.uniform(-1, 1, size=cloud.poses.shape)
        lengthen(paths, cloud)
        for i, history in enumerate(histories):
            history.append((i, cloud.poses[i].copy()))
    weights = rng.dirichlet(np.ones(PARTICLES))
    means, covariances = np.empty((steps, 3)), np.empty((steps, 3, 3))
    look_back(paths, cloud.nodes, weights, means, covariances)
    taken = np.array([[pose for _, pose in history] for history in histories])
    expected = np.einsum("i,ikc->kc", weights, taken)
    np.testing.assert_allclose(means[:, :2], expected[:, :2], atol=1e-15)
    apart = taken[..., :2] - expected[:, :2]
    spread = np.einsum("i,ika,ikb->kab", weights, apart, apart)
    np.testing.assert_allclose(covariances[:, :2, :2], spread, atol=1e-15)
    for i, history in enumerate(histories):
        line = particle_of_each_step(paths, int(cloud.nodes[i]), steps)
        assert line.tolist() == [who for who, _ in history]
    assert paths.marks[1] < steps + 20 * PARTICLES  # of 7 x 200


@pytest.mark.parametrize("count", [1, 2, 10, 257])
def test_resampling_is_unbiased_and_of_low_variance(count, rng):
    for alpha in (0.05, 1.0, 50.0):
        weights = rng.dirichlet(np.full(count, alpha))
        counts, total = np.empty(count, np.int64), np.zeros(count)
        draws = 1000
        for u in (np.arange(draws) + 0.5) / draws:
            systematic(weights, u, counts)
            assert counts.sum() == count
            assert (np.abs(counts - count * weights) < 1 + 1e-9).all()
            total += counts
        # On a grid of u, each boundary of a share falls between two neighbours: off by one each.
        np.testing.assert_allclose(total / draws, count * weights, atol=2.01 / draws)


def test_a_particle_without_weight_is_never_drawn():
    counts = np.empty(4, np.int64)
    for u in (0.0, 0.999999999):
        systematic(np.array([0.0, 0.6, 0.4 - 1e-12, 0.0]), u, counts)
        assert counts[[0, 3]].tolist() == [0, 0]
        assert counts.sum() == 4


def test_weights_are_normalised_in_logarithms():
    log_weights, weights = np.array([-2000.0, -2000.0 + np.log(3), -np.inf, np.nan]), np.empty(4)
    effective, usable = normalise(log_weights, weights)
    np.testing.assert_allclose(weights, [0.25, 0.75, 0, 0], rtol=1e-12)
    np.testing.assert_allclose(np.exp(log_weights), weights, rtol=1e-12)
    assert usable
    assert effective == pytest.approx(1 / (0.25**2 + 0.75**2))


@pytest.mark.parametrize("bad", [-np.inf, np.nan, np.inf])
def test_weights_that_say_nothing_are_made_equal(bad):
    log_weights, weights = np.full(5, bad), np.empty(5)
    effective, usable = normalise(log_weights, weights)
    assert not usable
    np.testing.assert_allclose(weights, 0.2)
    np.testing.assert_allclose(log_weights, np.log(0.2))
    assert effective == pytest.approx(5)
