"""MRCLAM: the published layout of any of the nine sets, and damage to its files."""

from __future__ import annotations

import gzip
import re

import fuzz
import numpy as np
import pytest
from mrclam_made import (
    EPOCH,
    TRUE_PLACES,
    drive,
    load,
    sightings_of,
    told,
    write,
    write_robot,
    write_set,
    write_world,
)
from numpy.testing import assert_array_equal

from ekfslam.datasets import RECORDED, load_recorded, mrclam
from ekfslam.errors import FileFormatError, InputError, UnknownNameError


@pytest.fixture
def folder(tmp_path, rng):
    """Set 1 with one robot, number 3."""
    return write_set(tmp_path, rng)


# The layout ---------------------------------------------------------------------------------------


NUMBERS = range(1, 10)


@pytest.fixture(scope="module")
def team_files(tmp_path_factory):
    """Set 2 or higher with all five robots, all files plain."""
    folder, rng = tmp_path_factory.mktemp("team"), np.random.default_rng(5)
    write_world(folder, TRUE_PLACES)
    for robot in range(1, 6):
        commands, start = drive(rng, seconds=4.0, still=0.2), (0.1 * robot, -0.3, 0.2)
        sightings = sightings_of(commands, start, (6, 7, 11, 17), 0.3)
        write_robot(folder, robot, commands, sightings, start)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def put(folder, files, packed=False):
    """Write files, which may be compressed, into a new folder."""
    folder.mkdir(parents=True)
    for name, content in files.items():
        path = folder / (name + ".gz" * packed)
        path.write_bytes(gzip.compress(content) if packed else content)
    return folder


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("number", NUMBERS)
def test_any_of_the_nine_is_loaded_in_the_published_layout(team_files, tmp_path, number, packed):
    folders = RECORDED[f"mrclam{number}"].folders
    assert f"MRCLAM_Dataset{number}" in folders
    for k, name in enumerate(folders):
        root = tmp_path / str(k)
        put(root / name, team_files, packed)
        dataset = load_recorded(f"mrclam{number}", root)
        assert dataset.name == f"mrclam{number}"
        assert [robot.name for robot in dataset.robots] == [f"robot{i}" for i in range(1, 6)]
        assert all(robot.truth_known for robot in dataset.robots)
        assert sorted(dataset.true_map.ids) == [6, 7, 11, 17]
    whole = dataset.observations
    for i in range(1, 6):
        one = load_recorded(f"mrclam{number}/robot{i}", root / name)
        assert one.name == f"mrclam{number}/robot{i}"
        used = min(np.sum(whole.robot == i - 1), len(one.observations))
        assert abs(np.sum(whole.robot == i - 1) - len(one.observations)) <= 2
        assert used > 5


def test_plain_and_compressed_files_may_be_mixed_and_the_plain_one_counts(team_files, tmp_path):
    folder = put(tmp_path / "set", team_files)
    path = folder / "Robot4_Odometry.dat"
    (folder / "Robot4_Odometry.dat.gz").write_bytes(gzip.compress(path.read_bytes()))
    path.unlink()
    mixed = mrclam.load(4, folder)
    assert_array_equal(mixed.robots[3].controls, load_from(team_files, tmp_path).robots[3].controls)
    (folder / "Barcodes.dat.gz").write_bytes(b"not used")
    assert len(mrclam.load(4, folder).observations) == len(mixed.observations)


def load_from(files, tmp_path, number=4, part=None):
    return mrclam.load(number, put(tmp_path / "again", files), part)


@pytest.mark.parametrize("number", NUMBERS)
def test_a_robot_without_truth_runs_alone_and_not_in_the_team(team_files, tmp_path, number):
    files = {name: text for name, text in team_files.items() if name != "Robot2_Groundtruth.dat"}
    folder = put(tmp_path / "set", files)
    alone, team = mrclam.load(number, folder, "robot2"), mrclam.load(number, folder)
    assert alone.truth is None
    assert len(alone.observations) > 5
    assert [robot.name for robot in team.robots] == ["robot1", "robot3", "robot4", "robot5"]
    assert told(team, "not in the team: robot2 (no truth to start from)")


@pytest.mark.parametrize(
    ("gone", "said"),
    [
        (("Odometry", "Measurement"), r"Robot2_Odometry\.dat and Robot2_Measurement\.dat"),
        (("Odometry",), r"Robot2_Odometry\.dat"),
        (("Measurement",), r"Robot2_Measurement\.dat"),
    ],
)
def test_files_of_a_robot_that_are_not_there_are_named(team_files, tmp_path, gone, said):
    left = {n: t for n, t in team_files.items() if n not in [f"Robot2_{k}.dat" for k in gone]}
    root = tmp_path / "all"
    folder = put(root / "MRCLAM_Dataset7", left)
    with pytest.raises(FileFormatError, match=rf"MRCLAM_Dataset7: has no {said} \(nor with .gz\)$"):
        load_recorded("mrclam7/robot2", root)
    team = load_recorded("mrclam7", root)
    assert len(team.robots) == 4
    assert any(re.search(rf"not in the team: robot2 \(no {said}\)", note) for note in team.notes)
    for path in folder.glob("Robot*"):
        path.unlink()
    said = r"no Robot1_Odometry\.dat and Robot1_Measurement\.dat .*, nor those of another robot"
    with pytest.raises(FileFormatError, match=said):
        load_recorded("mrclam7", root)
    (folder / "Barcodes.dat").unlink()
    with pytest.raises(FileFormatError, match=r"mrclam7: .*MRCLAM_Dataset7 has no Barcodes\.dat"):
        load_recorded("mrclam7", root)
    with pytest.raises(UnknownNameError, match="robot6"):
        load_recorded("mrclam7/robot6", root)


def test_the_folder_of_one_set_is_not_taken_for_another(team_files, tmp_path, monkeypatch):
    folder = put(tmp_path / "MRCLAM_Dataset2", team_files)
    assert len(load_recorded("mrclam2", folder).robots) == 5
    with pytest.raises(FileFormatError, match="Dataset2 is a folder of mrclam2, not of mrclam7"):
        load_recorded("mrclam7", folder)
    monkeypatch.setenv("EKFSLAM_DATA", str(folder))
    assert [name for name, one in RECORDED.items() if one.is_here(name)
            and name.startswith("mrclam")] == ["mrclam2"]  # fmt: skip


def test_the_folder_is_found_by_the_variable(folder, tmp_path_factory, monkeypatch):
    root = tmp_path_factory.mktemp("all")
    (root / "MRCLAM_Dataset7").symlink_to(folder)
    monkeypatch.setenv("EKFSLAM_DATA", str(root))
    dataset = load_recorded("mrclam7/robot3", misread_beyond=4.0)
    assert dataset.name == "mrclam7/robot3"
    assert len(dataset.observations) > 40


# Damage -------------------------------------------------------------------------------------------


def column(k, factor, add=0.0):
    def damage(rows):
        rows[:, k] = rows[:, k] * factor + add
        return rows

    return damage


def one(row, k, value):
    def damage(rows):
        rows[row, k] = value
        return rows

    return damage


DAMAGES = [
    ("Robot3_Odometry.dat", column(0, 1000), r"line 3: time \[s\] .* milliseconds"),
    ("Robot3_Odometry.dat", column(0, 1000, -1000 * EPOCH), r"line 4: .*milliseconds"),
    ("Robot3_Odometry.dat", column(1, 1000), r"line \d+: forward velocity"),
    ("Robot3_Odometry.dat", column(2, 57.3), r"line \d+: angular velocity .* degrees"),
    (
        "Robot3_Odometry.dat",
        lambda rows: rows[:300],
        r"Measurement.dat, line \d+: stamp is outside",
    ),
    ("Robot3_Odometry.dat", one(50, 0, EPOCH - 99), r"line 53: time goes back"),
    ("Robot3_Odometry.dat", one(-1, 0, EPOCH + 999), r"no command for more than 60 s"),
    ("Robot3_Odometry.dat", one(5, 1, np.nan), r"line 8: forward velocity \[m/s\] is nan"),
    ("Robot3_Odometry.dat", lambda rows: rows[:, :2], r"line 3: 3 numbers are wanted"),
    ("Robot3_Odometry.dat", lambda rows: rows[:0], "holds no row"),
    ("Robot3_Measurement.dat", column(0, 1.0, 500.0), r"line 3: stamp is outside"),
    ("Robot3_Measurement.dat", column(1, 1.0, 0.5), r"line 3: barcode is no whole number"),
    ("Robot3_Measurement.dat", column(2, 1000), r"line 3: range \[m\] .* millimetres"),
    ("Robot3_Measurement.dat", column(3, 57.3), r"line \d+: bearing \[rad\] .* degrees"),
    ("Robot3_Measurement.dat", one(7, 2, -1.0), r"line 10: range must be positive"),
    ("Robot3_Measurement.dat", one(7, 0, EPOCH - 5), r"line 10: time goes back"),
    ("Robot3_Groundtruth.dat", column(1, 1000), r"line \d+: x \[m\] .* millimetres"),
    ("Robot3_Groundtruth.dat", column(3, 57.3), r"line \d+: heading \[rad\] .* degrees"),
    ("Robot3_Groundtruth.dat", column(0, 1.0, 1e4), r"line 3: .* nothing in common"),
    ("Robot3_Groundtruth.dat", lambda rows: rows[::-1], r"line 66: time goes back"),
    ("Landmark_Groundtruth.dat", lambda rows: rows[:-1], r"line 5: .* none of subject 17"),
    ("Landmark_Groundtruth.dat", one(0, 0, 7), r"line 4: this landmark is there already"),
    ("Landmark_Groundtruth.dat", one(1, 0, 8), r"line 4: this landmark has no barcode"),
    ("Landmark_Groundtruth.dat", one(1, 4, -1), r"line 4: a standard deviation is negative"),
    ("Barcodes.dat", one(1, 1, 5), r"line 4: this barcode is another subject's"),
    ("Barcodes.dat", one(1, 0, 1), r"line 4: this subject has a barcode"),
    ("Barcodes.dat", one(1, 0, 0), r"line 4: subjects are numbered from 1"),
    ("Barcodes.dat", lambda rows: rows[:-1], r"Landmark_Groundtruth.dat, line 6: .* no barcode"),
]


@pytest.mark.parametrize(("name", "damage", "said"), DAMAGES)
def test_damage_is_told_with_file_and_line(folder, name, damage, said):
    rows = np.loadtxt(folder / name)
    write(folder, name, damage(rows))
    with pytest.raises(FileFormatError, match=said):
        load(folder)


def test_a_file_that_is_cut_short_or_empty_is_told(folder):
    path = folder / "Robot3_Measurement.dat"
    text = path.read_bytes()
    path.write_bytes(text[: text.rindex(b"\t")])
    last = text.count(b"\n")
    with pytest.raises(FileFormatError, match=rf"line {last}: 4 numbers are wanted"):
        load(folder)
    path.write_bytes(text.replace(b"\n", b"\r\n", 20))
    assert len(load(folder).observations) == last - 2
    path.write_bytes(b"")
    with pytest.raises(FileFormatError, match="is empty"):
        load(folder)
    path.unlink()
    packed = gzip.compress(text)
    (folder / "Robot3_Measurement.dat.gz").write_bytes(packed[: len(packed) // 2])
    with pytest.raises(FileFormatError, match="cannot be read"):
        load(folder)


def test_robots_whose_times_do_not_meet_make_no_team(folder, rng):
    commands = drive(rng)
    commands[:, 0] += 100
    write_robot(folder, 1, commands, sightings_of(commands, (0, 0, 0)), (0, 0, 0))
    said = r"Robot1_Odometry\.dat, .*, Robot3_Groundtruth\.dat: no time"
    with pytest.raises(FileFormatError, match=said):
        load(folder, None)


@pytest.mark.parametrize(
    "options",
    [
        {"step": 0.0},
        {"step": 0.001},
        {"step": "1"},
        {"lag": np.nan},
        {"lag": 20.0},
        {"image_shift": np.inf},
        {"v_scale": 0.0},
        {"w_scale": -1.0},
        {"odometry_sigmas": (1.0, 2.0)},
        {"range_bias": (0.0, 1.0)},
        {"range_bias": 0.01},
        {"range_sigma": 1e300},
        {"part": 3},
        {"range_sigma": -1.0},
        {"every": -1.0},
        {"correlated": np.nan},
        {"misread_beyond": 0.0},
        {"prior_sigmas": (0.1, 0.1, -0.1)},
        {"part": "robot6"},
    ],
)
def test_options_that_make_no_sense_are_refused(folder, options):
    with pytest.raises((InputError, UnknownNameError)):
        load(folder, **options)


def test_there_are_nine_sets(folder):
    with pytest.raises(InputError, match="1 to 9"):
        mrclam.load(10, folder)


def test_no_damage_breaks_the_loader(tmp_path, rng):
    """Of all kinds of files, a robot with full truth and one with sparse truth."""
    made = tmp_path / "made"
    write_world(made)
    for robot, start in ((1, (0.0, 0.0, 0.1)), (3, (0.5, 1.0, -0.2))):
        commands = drive(rng, seconds=2.5, still=0.1)
        poses = write_robot(
            made, robot, commands, sightings_of(commands, start, seconds=0.1), start
        )
        if robot == 3:
            (made / "Robot3_Groundtruth.dat").unlink()
            counted = np.column_stack([poses, np.full(len(poses), 3)])[40::10]
            write(made, "Robot3_Groundtruth_sparse.dat", counted)
    files = {path.name: path.read_bytes() for path in made.iterdir()}
    assert len(files) == 8
    (tmp_path / "damaged").mkdir()

    def rows(content):
        lines = content.decode("utf-8-sig").replace("\r", "\n").split("\n")
        return sum(bool(line.partition("#")[0].strip()) for line in lines)

    def everything_is_read(dataset, damaged):
        for robot in dataset.robots:
            name = robot.name.capitalize()
            commands, seen = (
                rows(damaged[f"{name}_{kind}.dat"]) for kind in ("Odometry", "Measurement")
            )
            assert told(dataset, f"{robot.name}: {commands} commands and {seen} sightings read")
        for robot in {"robot1", "robot3"} - {robot.name for robot in dataset.robots}:
            assert told(dataset, f"{robot} (no ")

    result = fuzz.check(
        lambda folder: mrclam.load(1, folder, misread_beyond=4.0),
        tmp_path / "damaged", files, 1000, 17, everything_is_read, ("empty",),
    )  # fmt: skip
    assert result["refused"] > 300
    assert result["loaded"] > 100
