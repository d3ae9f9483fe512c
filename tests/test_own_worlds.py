"""Worlds and paths of one's own: from arrays in Python, and from TOML files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numerics import assert_same_record
from numpy.testing import assert_allclose

import ekfslam
from ekfslam import geometry as geo
from ekfslam.errors import InputError
from ekfslam.simulation.paths import along, through

SQUARE = [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]]


def driven(path):
    return geo.integrate(path.start, path.controls)


def test_a_path_through_poses_passes_them(rng):
    poses = np.column_stack([rng.uniform(-9, 9, (30, 2)), rng.uniform(-3, 3, 30)])
    assert_allclose(geo.additive_error(poses, driven(through(poses))), 0, atol=1e-12)


@pytest.mark.parametrize("laps", [1, 2, 3])
@pytest.mark.parametrize("spacing", [0.25, 0.3, 3.0])
def test_a_path_along_points_has_steps_of_equal_length(laps, spacing):
    """Poses are where so much of the polygon has been walked, and head for its next corner."""
    corners = np.array(SQUARE * laps + SQUARE[:1] * (laps > 1))
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    walked = np.concatenate([[0.0], np.cumsum(lengths)])
    poses = driven(along(SQUARE, spacing, laps))
    assert len(poses) == int(walked[-1] / spacing + 1e-9) + 1
    travelled = spacing * np.arange(len(poses))
    for axis in (0, 1):
        expected = np.interp(travelled, walked, corners[:, axis])
        assert_allclose(poses[:, axis], expected, atol=1e-9)
    for heading, far in zip(poses[:, 2], travelled, strict=True):
        line = min(np.searchsorted(walked, far + 1e-9, side="right") - 1, len(lengths) - 1)
        way = corners[line + 1] - corners[line]
        assert abs(geo.wrap(heading - np.arctan2(way[1], way[0]))) < 1e-9


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0, 0]], 1.0), "points must be two at least"),
        (([[0, 0], [1, np.nan]], 1.0), "points must be two at least"),
        (([[0, 0], [1, 0], [1, 0]], 0.1), "point 2 and the one after it are the same"),
        (([[0, 0], [1, 0], [0, 0]], 0.1, 2), "point 3 and the one after it are the same"),
        ((SQUARE, 0.0), "spacing must be positive"),
        ((SQUARE, 99.0), "spacing must be positive and at most the way"),
        ((SQUARE, 1e-7), "more than 1000000 steps"),
        ((SQUARE, 1.0, 0), "laps must be at least 1"),
    ],
)
def test_paths_that_make_no_sense(arguments, message):
    with pytest.raises(InputError, match=message):
        along(*arguments)
    with pytest.raises(InputError, match="poses must be two at least"):
        through([[0, 0, 0]])


TOML = """
[world]
kind = "points"
landmarks = [[1, 2], [3, 4], [5, 1]]
[path]
kind = "points"
points = [[0, 0], [4, 0], [4, 3], [0, 3]]
spacing = 0.5
laps = 2
[motion]
kind = "odometry"
sigmas = [0.02, 0.01, 0.01]
[[sensors]]
kind = "range-bearing"
sigmas = [0.1, 0.02]
min_range = 0.7
"""


def scenario(**changes):
    path = along(SQUARE, 0.5, 2)
    made = ekfslam.Scenario(
        name="own",
        landmarks=ekfslam.LandmarkMap(range(3), [[1, 2], [3, 4], [5, 1]]),
        start=path.start,
        controls=path.controls,
        motion=ekfslam.MotionModel("odometry", np.diag([0.02, 0.01, 0.01]) ** 2),
        sensors=[ekfslam.Sensor("range-bearing", np.diag([0.1, 0.02]) ** 2, min_range=0.7)],
    )
    return replace(made, **changes)


def test_python_and_toml_make_the_same_world(tmp_path):
    (tmp_path / "own.toml").write_text(TOML)
    mine = ekfslam.simulate(scenario(), seed=6)
    assert_same_record(ekfslam.simulate(tmp_path / "own.toml", seed=6), mine)


def test_a_scenario_is_compared_as_it_is():
    summary = ekfslam.compare(scenario(), ["ekf"], seed=6).summary
    expected = ekfslam.compare(ekfslam.simulate(scenario(), seed=6), ["ekf"]).summary
    assert summary["ate_position_rmse_m"].tolist() == expected["ate_position_rmse_m"].tolist()
    assert summary["status"].tolist() == ["ok"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"landmarks": np.zeros((3, 2))}, "landmarks must be a LandmarkMap.*; got ndarray"),
        ({"motion": {"kind": "odometry"}}, "motion must be a MotionModel, got dict"),
        ({"sensors": ekfslam.Sensor("xy", np.eye(2))}, "sensors must be a list of Sensor"),
        ({"sensors": ["laser"]}, "sensors must be a list of Sensor"),
    ],
)
def test_a_scenario_says_what_it_wants(changes, message):
    with pytest.raises(InputError, match=message):
        scenario(**changes)
