"""City trees: the graph, its truth, further draws, and damage."""

from __future__ import annotations

import gzip
import os
from dataclasses import replace
from functools import cache

import fuzz
import numpy as np
import pytest

from ekfslam import geometry as geo
from ekfslam.datasets import load_recorded
from ekfslam.errors import FileFormatError, UnknownNameError
from ekfslam.filters.ekf import Ekf

TURNS = [-3.14159, 1.5708, 0, -1.5708, 0, 1.5708]
PLACES = {3: (2.5, 2.5), 0: (-2.5, 2.5), 1: (2.5, 2.5)}
GRAPH, TRUTH = "cityTrees10000.txt", "cityTrees10000_groundtruth.txt"


def drawn(seed=None):
    """A small graph in the format, without noise or with a draw of it."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(6, 3)) * [0.02, 0.02, 0.01] if seed is not None else np.zeros((6, 3))
    pose, lines = np.zeros(3), []
    for k, turn in enumerate(TURNS):
        move = np.array([1.0, 0.0, turn])
        dx, dy, dtheta = move + noise[k]
        lines.append(f"EDGE2 {k} {k + 1} {dx:g} {dy:g} {dtheta:g} 50 0 0 50 0 100")
        pose = geo.compose(pose, [1.0, 0.0, np.pi / 2 * np.round(turn / (np.pi / 2))])
        for tree in (0, 3) if k % 2 else (1,):
            x, y = geo.to_frame(pose, PLACES[tree])
            if seed is not None:
                x, y = [x, y] + 0.1 * rng.normal(size=2)
            lines.append(f"LANDMARK {k + 1} {tree} {x:g} {y:g} 10 0 10")
    return "\n".join(lines) + "\n"


def files():
    """Those of a folder, by name."""
    packed = gzip.compress(drawn(5).encode(), mtime=0)
    texts = {GRAPH: drawn(1), TRUTH: drawn()}
    return {name: text.encode() for name, text in texts.items()} | {
        "cityTrees10000_mc0.txt.gz": packed
    }


@pytest.fixture
def folder(tmp_path):
    for name, content in files().items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def test_a_small_city(folder):
    data = load_recorded("city-trees", folder)
    assert data.name == "city-trees"
    assert data.poses == 7
    assert data.notes == ("Read: 7 poses, 9 sightings of 3 landmarks.",)
    np.testing.assert_allclose(data.robot.motion.covariance, np.diag([4e-4, 4e-4, 1e-4]))
    assert data.robot.covariance is None
    np.testing.assert_allclose(data.sightings.covariance, np.tile(0.01 * np.eye(2), (9, 1, 1)))
    np.testing.assert_array_equal(data.prior.mean, 0)
    np.testing.assert_array_equal(data.prior.covariance, 0)
    np.testing.assert_array_equal(data.true_landmark, data.observations.landmark)
    assert data.observations.landmark.min() == 0  # a tree, and pose 0 is another thing
    turns = np.cumsum(np.pi / 2 * np.array([-2, 1, 0, -1, 0, 1]))
    np.testing.assert_allclose(
        np.exp(1j * data.truth[1:, 2]), np.exp(1j * turns), rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(data.truth[-1, :2], [-2, -2], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(data.true_map.ids, [0, 1, 3])
    np.testing.assert_allclose(
        data.true_map.positions, [PLACES[tree] for tree in (0, 1, 3)], rtol=0, atol=1e-5
    )


def test_a_further_draw_is_beside_the_graph(folder):
    first, second = (load_recorded(name, folder) for name in ("city-trees", "city-trees/mc0"))
    assert second.name == "city-trees/mc0"
    assert "cityTrees10000_mc0.txt.gz" in second.provenance
    assert not np.array_equal(first.robot.controls, second.robot.controls)
    np.testing.assert_array_equal(first.truth, second.truth)
    with pytest.raises(FileFormatError, match=r"has no cityTrees10000_mc1\.txt \(nor"):
        load_recorded("city-trees/mc1", folder)
    with pytest.raises(UnknownNameError, match="mc12"):
        load_recorded("city-trees/mc12", folder)
    (folder / TRUTH).unlink()
    with pytest.raises(FileFormatError, match="has no cityTrees10000_groundtruth"):
        load_recorded("city-trees", folder)


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        (GRAPH, "LANDMARK 2 3", "LANDMARK 2 1", r"\.txt, line 5: another sighting than in line 5"),
        (TRUTH, "EDGE2 5 6", "EDGE2 5 7", r"10000\.txt, line 13: another motion than in line 13"),
        (TRUTH, "LANDMARK 4 0 ", "LANDMARK 4 0 1", r"groundtruth\.txt, line 9: landmark 0 is"),
        (GRAPH, "EDGE2 0 1", "ODOMETRY 0", "line 1: ODOMETRY needs 11 numbers, got 10"),
        (GRAPH, "50 0 0 50 0 100\nLANDMARK 2", "0 0 0 50 0 100\nLANDMARK 2", "line 3: the square"),
    ],
)
def test_a_file_that_is_not_right_is_named(folder, name, old, new, said):
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=said):
        load_recorded("city-trees", folder)


def test_a_graph_that_ends_early_is_not_that_of_the_truth(folder):
    text = (folder / GRAPH).read_text()
    lines = text.splitlines(keepends=True)
    for cut in range(1, len(lines)):
        (folder / GRAPH).write_text("".join(lines[:-cut]))
        with pytest.raises(FileFormatError, match="cityTrees10000"):
            load_recorded("city-trees", folder)


def test_random_damage_is_named_or_harmless(tmp_path):
    def whole(dataset, damaged):
        assert dataset.poses == 7
        assert len(dataset.observations) == 9

    told = fuzz.check(
        lambda folder: load_recorded("city-trees", folder),
        tmp_path,
        {name: content for name, content in files().items() if name in (GRAPH, TRUTH)},
        count=1000,
        seed=3,
        whole=whole,
        certain=["empty", "missing"],
    )
    assert told["refused"] > 300
    assert told["loaded"] > 100


# The published files ------------------------------------------------------------------------------


@cache
def city(part=""):
    return load_recorded(f"city-trees{part}")


published = pytest.mark.skipif(
    "EKFSLAM_DATA" not in os.environ, reason="EKFSLAM_DATA names no folder"
)


@published
@pytest.mark.parametrize("part", ["", "/mc0", "/mc4"])
def test_the_noise_is_what_the_file_says(part):
    """Normalised squares of all errors against chi-square, four deviations wide."""
    data = city(part)
    assert (data.poses, len(data.observations), len(data.true_map)) == (10000, 4443, 100)
    moves = geo.between(data.truth[:-1], data.truth[1:])
    motion = geo.additive_error(data.robot.controls, moves) / [0.02, 0.02, 0.01]
    at = np.searchsorted(data.true_map.ids, data.observations.landmark)
    places = geo.to_frame(data.truth[data.observations.step], data.true_map.positions[at])
    seen = (data.observations.values - places) / 0.1
    for errors in (motion, seen):
        n = errors.size
        assert abs((errors**2).sum() - n) < 4 * np.sqrt(2 * n)
        assert abs(errors.sum()) < 4 * np.sqrt(n)


@published
def test_trees_stand_at_half_metres_and_some_in_one_place():
    places = city().true_map.positions
    np.testing.assert_allclose(2 * places, np.round(2 * places), rtol=0, atol=1e-9)
    assert len(np.unique(np.round(places, 3), axis=0)) == 92


@published
def test_the_filter_runs_to_the_end():
    data = city()
    estimate = Ekf().estimate(data)
    assert estimate.status == "ok"
    assert len(estimate.landmarks) == 100
    start = Ekf().estimate(replace(data, robots=(replace(data.robot, truth=None),)))
    np.testing.assert_array_equal(estimate.online.poses, start.online.poses)
