"""Worlds and waypoints that a scenario names by file, as those of Bailey's simulators."""

from __future__ import annotations

import os
from functools import cache

import fuzz
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

from ekfslam.errors import FileFormatError, InputError
from ekfslam.simulation import (
    describe_scenario,
    load_scenario,
    scenario_hash,
    scenarios,
    simulate,
)

LANDMARKS = np.array([[10.0, 3.5], [25.0, -4.0], [33.0, 12.25]])
WAYPOINTS = np.array([[0.0, 0.0], [20.0, 0.0], [30.0, 10.0]])
BAILEY = ("bailey-densemap", "bailey-linemap", "bailey-smallmap", "bailey-webmap")

SCENARIO = """
description = "A world of another."
observe_every = 8
[world]
kind = "points"
file = "map.mat"
source = "the library next door"
[path]
kind = "waypoints"
file = "map.mat"
start = [0, 0, 0]
speed = 3
time_step = 0.025
wheelbase = 4
max_steer = "30 deg"
steer_rate = "20 deg"
[motion]
kind = "car"
wheelbase = 4
sigmas = [0.3, "3 deg"]
[[sensors]]
kind = "range-bearing"
sigmas = [0.1, "1 deg"]
max_range = 30
"""


@pytest.fixture
def world(tmp_path, monkeypatch):
    """Write a scenario and, beside it, its file; returns what loads the scenario."""
    monkeypatch.delenv("EKFSLAM_DATA", raising=False)
    (tmp_path / "other.toml").write_text(SCENARIO)

    def load(arrays=None, changes=None):
        if arrays is not None:
            savemat(tmp_path / "map.mat", arrays)
        return load_scenario(tmp_path / "other.toml", changes)

    load.folder = tmp_path
    return load


def whole(**arrays):
    return {"lm": LANDMARKS.T, "wp": WAYPOINTS.T} | arrays


# What is read ----------------------------------------------------------------------------------


def test_a_file_stands_for_the_points_in_it(world):
    scenario = world(whole())
    spelt = SCENARIO.replace('source = "the library next door"\n', "")
    for points, key in ((LANDMARKS, "landmarks"), (WAYPOINTS, "waypoints")):
        spelt = spelt.replace('file = "map.mat"', f"{key} = {points.tolist()}", 1)
    (world.folder / "spelt.toml").write_text(spelt)
    assert_array_equal(scenario.landmarks.positions, LANDMARKS)
    assert scenario_hash(scenario) == scenario_hash(load_scenario(world.folder / "spelt.toml"))
    assert np.hypot(*(simulate(scenario).robot.truth[-1, :2] - WAYPOINTS[-1])) <= 1


def test_whole_numbers_and_a_single_point_are_points(world):
    scenario = world(whole(lm=np.array([[4], [7]], dtype=np.int16)))
    assert_array_equal(scenario.landmarks.positions, [[4, 7]])


def test_it_is_found_in_the_data_folder_where_it_is_not_beside_the_scenario(world, monkeypatch):
    data = world.folder / "data"
    data.mkdir()
    savemat(data / "map.mat", whole(lm=LANDMARKS.T + 1))
    monkeypatch.setenv("EKFSLAM_DATA", str(data))
    assert_array_equal(world().landmarks.positions, LANDMARKS + 1)
    assert_array_equal(world(whole()).landmarks.positions, LANDMARKS)


def test_robots_may_have_one_each(world):
    savemat(world.folder / "map.mat", whole())
    table = SCENARIO[SCENARIO.index("[path]") : SCENARIO.index("[[sensors]]")]
    robot = table.replace("[path]", "[robots.path]").replace("[motion]", "[robots.motion]")
    pair = SCENARIO.replace(
        table, "".join(f'[[robots]]\nname = "{name}"\n{robot}' for name in ("one", "two"))
    )
    (world.folder / "pair.toml").write_text(pair)
    scenario = load_scenario(world.folder / "pair.toml")
    assert_array_equal(scenario.team[0].controls, scenario.controls)


def test_other_values_can_be_changed(world):
    once, twice = (len(world(whole(), {"path.laps": laps}).controls) for laps in (1, 2))
    assert twice > once
    savemat(world.folder / "other.mat", {"lm": -LANDMARKS.T})
    scenario = world(whole(), {"world.file": "other.mat"})
    assert_array_equal(scenario.landmarks.positions, -LANDMARKS)


# What is refused -------------------------------------------------------------------------------


def test_a_file_that_is_not_here(world, monkeypatch):
    said = r"other\.toml: \[world\]: map\.mat is not here, not in .*; get it from the library next"
    with pytest.raises(FileFormatError, match=said):
        world()
    monkeypatch.setenv("EKFSLAM_DATA", "/nowhere")
    with pytest.raises(FileFormatError, match=r"or /nowhere; .* EKFSLAM_DATA"):
        world()


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"wp": WAYPOINTS.T}, r"\[world\]: .*map\.mat: has no array lm"),
        ({"lm": LANDMARKS.T}, r"\[path\]: .*map\.mat: has no array wp"),
        (whole(lm=np.zeros((3, 3))), r"lm must be numbers, 2 x n, got an array of shape \(3, 3\)"),
        (whole(wp=np.zeros((2, 0))), "wp is empty"),
        (whole(lm="posts"), "lm is no array of real numbers"),
        (whole(lm=LANDMARKS.T + 1j), "lm is no array of real numbers"),
        (whole(wp=np.array([[0, 1, np.nan], [0, 0, 0]])), "NaN or infinite .* column 3 of wp"),
        (whole(lm=np.array([[np.inf], [0]])), "NaN or infinite .* column 1 of lm"),
    ],
)
def test_arrays_that_are_no_points(world, arrays, said):
    with pytest.raises(FileFormatError, match=said):
        world(arrays)


def test_a_file_cut_off_anywhere_or_of_another_kind_is_refused(world):
    world(whole())
    file = world.folder / "map.mat"
    content = file.read_bytes()
    for length in range(0, len(content) - 8, 7):
        file.write_bytes(content[:length])
        with pytest.raises(FileFormatError, match=r"map\.mat: "):
            world()
    file.write_text("lm = [1 2; 3 4]")
    with pytest.raises(FileFormatError, match=r"map\.mat: cannot be read"):
        world()


@pytest.mark.parametrize("far", [1e6, 1e9, 1e308])
def test_waypoints_in_another_unit_do_not_take_forever(world, far):
    waypoints = np.array([[0.0, 0.0], [20.0, 0.0], [far, far]])
    with pytest.raises(InputError, match=r"waypoint 3 is .* m away: .* more than 1000000 steps"):
        world(whole(wp=waypoints.T))


def test_no_damage_breaks_the_reader(world, tmp_path):
    """The file is damaged, the scenario is not; its name is in what is told."""
    (tmp_path / "damaged").mkdir()
    (tmp_path / "of map.mat.toml").write_text(SCENARIO.replace("map.mat", "damaged/map.mat"))
    world(whole())
    files = {"map.mat": (tmp_path / "map.mat").read_bytes()}

    def load(folder):
        return simulate(load_scenario(tmp_path / "of map.mat.toml"))

    def every_point_arrives(dataset, damaged):
        assert len(dataset.true_map) == len(LANDMARKS)

    told = fuzz.check(
        load, tmp_path / "damaged", files, 1000, 4, every_point_arrives, ("missing", "empty")
    )
    assert told["refused"] > 300
    assert told["loaded"] > 50


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"world.landmarks": [[0, 0]]}, r"\[world\]: give either landmarks or file"),
        ({"path.waypoints": [[9, 0]]}, r"\[path\]: give either waypoints or file"),
        ({"world.kind": "circle"}, r"\[world\]: file is for the kind 'points'"),
        ({"path.kind": "controls"}, r"\[path\]: file is for the kind 'waypoints'"),
        ({"world.file": 3}, r"\[world\]: file and source must be text"),
        ({"path.source": 3}, r"\[path\]: file and source must be text"),
        ({"motion.file": "map.mat"}, r"\[motion\]: unknown key 'file'"),
    ],
)
def test_a_file_out_of_place(world, changes, said):
    with pytest.raises(InputError, match=said):
        world(whole(), changes)


def test_a_source_alone_means_nothing(world):
    (world.folder / "other.toml").write_text(SCENARIO.replace('file = "map.mat"', "", 1))
    with pytest.raises(InputError, match=r"\[world\]: unknown key 'source'"):
        world(whole())


# The worlds of Bailey's simulators -------------------------------------------------------------


def test_the_list_says_that_they_are_not_here(monkeypatch):
    monkeypatch.delenv("EKFSLAM_DATA", raising=False)
    assert set(BAILEY) <= set(scenarios())
    for name in BAILEY:
        line = describe_scenario(name)
        assert "[not here: " in line
        assert "OpenSLAM-org/openslam_bailey-slam" in line
        assert "\n" not in line
        with pytest.raises(FileFormatError, match="openslam_bailey-slam"):
            simulate(name)
    assert describe_scenario("park") == load_scenario("park").describe()


@cache
def bailey(name):
    file = f"bailey_webmap/example_{name.removeprefix('bailey-')}.mat"
    data = os.environ.get("EKFSLAM_DATA")
    if not (data and os.path.isfile(os.path.join(data, file))):
        pytest.skip(f"EKFSLAM_DATA names no folder with {file}")
    return load_scenario(name)


@pytest.mark.parametrize(
    ("name", "landmarks", "x", "y", "loop"),
    [
        ("bailey-webmap", 35, (-127.0, 98.6), (-96.3, 88.6), 634.9),
        ("bailey-densemap", 135, (-127.0, 104.0), (-96.3, 91.9), 634.9),
        ("bailey-linemap", 27, (10.7, 1040.6), (-21.7, 21.6), 1997.2),
        ("bailey-smallmap", 15, (-36.1, 41.1), (-37.5, 29.5), 226.4),
    ],
)
def test_the_real_worlds(name, landmarks, x, y, loop):
    scenario = bailey(name)
    positions = scenario.landmarks.positions
    assert len(positions) == landmarks
    assert_allclose([positions.min(axis=0), positions.max(axis=0)], np.transpose([x, y]), atol=0.06)
    # Two laps less the last side, along curves that cut corners by up to the turning circle.
    length = len(scenario.controls) * 3 * 0.025
    last = 998.6 if name == "bailey-linemap" else 0
    assert 2 * loop - last == pytest.approx(length, rel=0.1)


def test_the_settings_are_those_of_the_simulator():
    scenario, ours = bailey("bailey-webmap"), load_scenario("car-loop")
    assert scenario.motion == ours.motion
    assert scenario.sensors[0].to_dict() == ours.sensors[0].to_dict()
    assert scenario.observe_every * 0.025 == pytest.approx(0.2)
    assert np.abs(scenario.controls[:, 1]).max() <= np.deg2rad(30)
    assert not scenario.start.any()
