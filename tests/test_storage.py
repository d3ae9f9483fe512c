"""Files of records: lossless, reproducible, whole or absent, and damage is always told."""

from __future__ import annotations

import gc
import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from numerics import assert_same_record

from ekfslam import dataset, estimates, storage
from ekfslam.dataset import Dataset, Robot
from ekfslam.errors import FileFormatError, InputError
from ekfslam.estimates import Estimate, Trajectory
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations


@pytest.fixture
def small_dataset():
    robot = Robot(MotionModel("odometry", covariance=np.eye(3)), np.zeros((1, 3)))
    sensor = Sensor("range-bearing", np.eye(2))
    observations = Observations([0, 1], [[1.0, 0.1], [2.0, 0.2]], time=[0.0, 1.5])
    return Dataset("small", (robot,), [0.0, 1.0], (sensor,), observations)


@pytest.fixture
def small_estimate():
    poses = np.arange(6.0).reshape(2, 3)
    return Estimate("filter", "small", online=Trajectory(poses, np.ones((2, 3, 3))))


@pytest.fixture(params=["dataset", "estimate"])
def record(request, small_dataset, small_estimate):
    return small_dataset if request.param == "dataset" else small_estimate


def saved(record, path):
    record.save(path)
    return path.read_bytes()


def assert_refused(kind, path, message=None):
    with pytest.raises(FileFormatError, match=message) as caught:
        kind.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def rewrite_header(path, change):
    """Save the arrays of a file again with a changed header, which is returned by `change`."""
    with np.load(path) as archive:
        arrays = dict(archive)
    header = change(json.loads(arrays.pop("header").tobytes()))
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez_compressed(path, **arrays)


# Without loss ----------------------------------------------------------------------------------


def test_every_field_of_a_dataset_survives_the_file_bit_for_bit(full_dataset, tmp_path):
    path = tmp_path / "full.npz"
    full_dataset.save(path)
    assert_same_record(Dataset.load(path), full_dataset)


def test_what_a_dataset_does_not_have_stays_missing(small_dataset, tmp_path):
    path = tmp_path / "small.npz"
    small_dataset.save(path)
    loaded = Dataset.load(path)
    assert_same_record(loaded, small_dataset)
    assert loaded.seed is None
    assert loaded.truth is None
    assert loaded.observations.covariance is None


def test_several_robots_survive_the_file(full_dataset, small_dataset, tmp_path):
    robots = (full_dataset.robot, replace(full_dataset.robot, name="second", truth=None))
    pair = replace(full_dataset, robots=robots)
    pair.save(tmp_path / "pair.npz")
    assert_same_record(Dataset.load(tmp_path / "pair.npz"), pair)


@pytest.mark.parametrize("kind", ["wheel-increments", "velocity", "car", "odometry"])
def test_every_motion_model_survives_the_file(kind, small_dataset, tmp_path):
    settings = {
        "wheel-increments": {"proportional": (0.1, 1 / 3), "width": 0.1},
        "velocity": {"covariance": [[0.1, 0.01], [0.01, 0.2]], "slip": 0.1},
        "car": {"covariance": np.diag([0.1, 0.3]), "wheelbase": 2.83},
        "odometry": {"covariance": np.diag([0.1, 0.2, 0.3])},
    }
    motion = MotionModel(kind, **settings[kind])
    robot = Robot(motion, np.ones((1, len(motion.control_names))))
    data = replace(small_dataset, robots=(robot,))
    data.save(tmp_path / "model.npz")
    assert_same_record(Dataset.load(tmp_path / "model.npz"), data)


def test_a_seed_of_numpy_can_be_saved(small_dataset, tmp_path):
    replace(small_dataset, seed=np.int64(3)).save(tmp_path / "seed.npz")
    assert Dataset.load(tmp_path / "seed.npz").seed == 3


def test_a_saved_record_loads_from_text_and_path(record, tmp_path):
    path = tmp_path / "record"  # no ending is forced on it
    record.save(str(path))
    assert_same_record(type(record).load(str(path)), type(record).load(path))
    assert [entry.name for entry in tmp_path.iterdir()] == ["record"]


# Reproducible ----------------------------------------------------------------------------------


def test_the_same_record_gives_the_same_bytes(record, tmp_path, monkeypatch):
    first = saved(record, tmp_path / "first.npz")
    monkeypatch.setattr("time.time", lambda: 2e9)
    monkeypatch.setattr("time.localtime", lambda *_: (2033, 5, 18, 3, 33, 20, 2, 138, 0))
    assert saved(record, tmp_path / "second.npz") == first
    again = type(record).load(tmp_path / "first.npz")
    assert saved(again, tmp_path / "third.npz") == first


# Damage ----------------------------------------------------------------------------------------


def test_a_missing_file_and_a_folder(record, tmp_path):
    assert_refused(type(record), tmp_path / "absent.npz", "no such file")
    assert_refused(type(record), tmp_path)


def test_a_file_cut_anywhere(record, tmp_path):
    path = tmp_path / "cut.npz"
    whole = saved(record, path)
    for length in [*range(0, len(whole), 7), len(whole) - 1]:
        path.write_bytes(whole[:length])
        assert_refused(type(record), path)


def test_a_flipped_bit_anywhere_is_told_or_does_no_harm(record, tmp_path):
    """A flip may hit bytes that mean nothing; then, and only then, the record is the same."""
    path, again = tmp_path / "flipped.npz", tmp_path / "again.npz"
    whole = saved(record, path)

    def outcome(place):
        damaged = bytearray(whole)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        try:
            loaded = type(record).load(path)
        except FileFormatError as error:
            return "told" if str(path) in str(error) else str(error)
        return "harmless" if saved(loaded, again) == whole else f"byte {place} changed it unnoticed"

    outcomes = [outcome(place) for place in range(len(whole))]
    assert set(outcomes) <= {"told", "harmless"}
    assert outcomes.count("told") > len(whole) / 3


def test_a_damaged_file_is_closed(record, tmp_path):
    """An open handle shows as a ResourceWarning when it is collected, which fails a test."""
    path = tmp_path / "cut.npz"
    path.write_bytes(saved(record, path)[:-30])
    assert_refused(type(record), path)
    gc.collect()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n",
        b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
        b"\x80\x04\x95",
        b"PK\x03\x04",
    ],
    ids=["empty", "text", "picture", "pickle", "start of an archive"],
)
def test_files_of_other_kinds(record, content, tmp_path):
    path = tmp_path / "foreign"
    path.write_bytes(content)
    assert_refused(type(record), path)


def foreign_archive(**arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def as_bytes(text):
    return np.frombuffer(text.encode(), dtype=np.uint8)


@pytest.mark.parametrize(
    "arrays",
    [
        {"x": np.zeros(3)},
        {"header": as_bytes("no json")},
        {"header": as_bytes("[1, 2]")},
        {"header": as_bytes("null")},
        {"header": as_bytes("{}")},
        {"header": as_bytes('{"format": "ekfslam-dataset"}')},
        {"header": np.array([255, 254], dtype=np.uint8)},
        {"header": np.array([{"pickled": 1}], dtype=object)},
    ],
    ids=["none", "text", "list", "null", "empty", "no version", "no text", "pickle"],
)
def test_archives_of_others(record, arrays, tmp_path):
    path = tmp_path / "foreign.npz"
    path.write_bytes(foreign_archive(**arrays))
    assert_refused(type(record), path)


def test_a_single_array_is_no_record(record, tmp_path):
    path = tmp_path / "array.npy"
    np.save(path, np.zeros(3))
    assert_refused(type(record), path)


def test_an_archive_of_something_else_is_no_record(record, tmp_path):
    path = tmp_path / "text.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "hello")
    assert_refused(type(record), path)


def test_the_other_record_is_not_this_one(small_dataset, small_estimate, tmp_path):
    small_dataset.save(tmp_path / "dataset.npz")
    small_estimate.save(tmp_path / "estimate.npz")
    assert_refused(Estimate, tmp_path / "dataset.npz", "holds ekfslam-dataset")
    assert_refused(Dataset, tmp_path / "estimate.npz", "holds ekfslam-estimate")


def test_a_newer_version_asks_for_a_newer_package(record, tmp_path):
    path = tmp_path / "newer.npz"
    record.save(path)
    newest = {Dataset: dataset.VERSION, Estimate: estimates.VERSION}[type(record)]
    rewrite_header(path, lambda header: {**header, "version": newest + 1})
    message = f"version {newest + 1}, newer than {newest}.* update ekfslam"
    assert_refused(type(record), path, message)


@pytest.mark.parametrize("version", ["1", None, 1.5, [1]])
def test_a_version_that_is_no_number(record, version, tmp_path):
    path = tmp_path / "odd.npz"
    record.save(path)
    rewrite_header(path, lambda header: {**header, "version": version})
    assert_refused(type(record), path)


def drop(name):
    return lambda header: {key: value for key, value in header.items() if key != name}


def change_motion(**settings):
    def change(header):
        motion = header["robots"][0]["motion"]
        return {**header, "robots": [{"name": "r", "motion": {**motion, **settings}}]}

    return change


@pytest.mark.parametrize(
    "change",
    [
        drop("robots"),
        drop("sensors"),
        drop("name"),
        lambda header: {**header, "robots": None},
        lambda header: {**header, "robots": [{}]},
        lambda header: {**header, "robots": header["robots"] * 2},
        lambda header: {**header, "robots": ["r"]},
        lambda header: {**header, "sensors": []},
        lambda header: {**header, "sensors": [{"kind": "xy"}]},
        lambda header: {**header, "sensors": [{"kind": "radar", "covariance": [[1, 0], [0, 1]]}]},
        change_motion(kind="hovercraft"),
        change_motion(surprise=1),
        change_motion(covariance="much"),
        change_motion(slip="much"),
        change_motion(slip=-1.0),
    ],
    ids=[
        "no robots",
        "no sensors",
        "no name",
        "robots null",
        "robot empty",
        "robot without arrays",
        "robot text",
        "sensor missing",
        "sensor without noise",
        "sensor unknown",
        "motion unknown",
        "motion surplus",
        "covariance text",
        "slip text",
        "slip negative",
    ],
)
def test_a_dataset_whose_header_contradicts_itself(small_dataset, change, tmp_path):
    path = tmp_path / "odd.npz"
    small_dataset.save(path)
    rewrite_header(path, change)
    assert_refused(Dataset, path)


@pytest.mark.parametrize(
    "change",
    [
        drop("estimator"),
        drop("parts"),
        lambda header: {**header, "parts": None},
        lambda header: {**header, "parts": ["online", "landmarks"]},
    ],
    ids=["no name", "no parts", "parts null", "part without arrays"],
)
def test_an_estimate_whose_header_contradicts_itself(small_estimate, change, tmp_path):
    path = tmp_path / "odd.npz"
    small_estimate.save(path)
    rewrite_header(path, change)
    assert_refused(Estimate, path)


@pytest.mark.parametrize(
    "name", ["times", "robot0.controls", "robot0.prior_mean", "observations.values"]
)
def test_a_dataset_without_one_of_its_arrays(small_dataset, name, tmp_path):
    path = tmp_path / "less.npz"
    small_dataset.save(path)
    with np.load(path) as archive:
        arrays = {key: archive[key] for key in archive if key != name}
    np.savez_compressed(path, **arrays)
    assert_refused(Dataset, path)


@pytest.mark.parametrize("name", ["observations.time", "observations.landmark"])
def test_an_optional_column_does_not_get_lost_in_silence(small_dataset, name, tmp_path):
    path = tmp_path / "less.npz"
    small_dataset.save(path)
    with np.load(path) as archive:
        arrays = {key: archive[key] for key in archive if key != name}
    np.savez_compressed(path, **arrays)
    assert_refused(Dataset, path)


def test_values_that_the_record_refuses_name_the_file(small_dataset, tmp_path):
    path = tmp_path / "bad.npz"
    small_dataset.save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays["times"] = np.array([1.0, 0.0])
    np.savez_compressed(path, **arrays)
    assert_refused(Dataset, path, "times must increase")


# Whole or absent -------------------------------------------------------------------------------


def fail_halfway(error):
    def write_array(stream, array, **_):
        stream.write(b"half a file")
        raise error

    return write_array


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), KeyboardInterrupt(), MemoryError()]
)
def test_a_failed_save_leaves_nothing_behind(record, error, tmp_path, monkeypatch):
    monkeypatch.setattr(storage.np.lib.format, "write_array", fail_halfway(error))
    with pytest.raises((OSError, InputError, KeyboardInterrupt, MemoryError)):
        record.save(tmp_path / "record.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_save_leaves_the_old_file(record, tmp_path, monkeypatch):
    path = tmp_path / "record.npz"
    before = saved(record, path)
    monkeypatch.setattr(storage.np.lib.format, "write_array", fail_halfway(KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        record.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_options_that_cannot_be_written_leave_nothing_behind(tmp_path):
    with pytest.raises((InputError, TypeError)):
        Estimate("f", "d", options={"callback": print}).save(tmp_path / "e.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_save_replaces_the_old_file(small_dataset, full_dataset, tmp_path):
    path = tmp_path / "record.npz"
    full_dataset.save(path)
    small_dataset.save(path)
    assert Dataset.load(path).name == "small"


def test_places_that_cannot_be_written(record, tmp_path):
    with pytest.raises(InputError, match=r"cannot write .*absent"):
        record.save(tmp_path / "absent" / "record.npz")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"cannot write .*folder"):
        record.save(tmp_path / "folder")
    assert [entry.name for entry in tmp_path.iterdir()] == ["folder"]


def test_the_file_has_the_permissions_of_any_new_file(record, tmp_path):
    record.save(tmp_path / "record.npz")
    (tmp_path / "plain").write_bytes(b"")
    modes = {(tmp_path / name).stat().st_mode for name in ("record.npz", "plain")}
    assert len(modes) == 1
