"""Where the files of recorded sets are looked for, and what is said of them."""

from __future__ import annotations

import pytest

from ekfslam.datasets import RECORDED, is_recorded, load_recorded, of_name
from ekfslam.datasets.catalogue import files_of
from ekfslam.datasets.places import hint, located, there
from ekfslam.errors import FileFormatError, InputError, UnknownNameError

FILES = ("a.txt", "b.txt")
FOLDERS = ("of/one", "one")
PUBLISHED = [name for name, one in RECORDED.items() if one.published]
WHEEL = sorted(RECORDED.keys() - PUBLISHED)
each_published = pytest.mark.parametrize("name", PUBLISHED)


@pytest.fixture(autouse=True)
def without_variable(monkeypatch):
    monkeypatch.delenv("EKFSLAM_DATA", raising=False)


def put(folder, *names):
    """Files that hold their own path."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_text(str(folder / name))
    return folder


def find(path=None, files=FILES):
    return located("set", path, FOLDERS, files)


# Which file is taken ------------------------------------------------------------------------------


@pytest.mark.parametrize("inside", [".", *FOLDERS])
@pytest.mark.parametrize("how", ["path", "text", "variable"])
def test_files_lie_in_the_folder_or_in_one_of_the_set_in_it(tmp_path, monkeypatch, inside, how):
    folder = put(tmp_path / inside, *FILES)
    if how == "variable":
        monkeypatch.setenv("EKFSLAM_DATA", str(tmp_path))
    found = find({"path": tmp_path, "text": str(tmp_path), "variable": None}[how])
    assert found == {name: folder / name for name in FILES}


def test_a_path_goes_before_the_variable_also_if_nothing_is_there(tmp_path, monkeypatch):
    put(tmp_path / "variable", *FILES)
    given = put(tmp_path / "given", *FILES)
    monkeypatch.setenv("EKFSLAM_DATA", str(tmp_path / "variable"))
    assert find()["a.txt"].parent.name == "variable"
    assert find(given)["a.txt"].parent.name == "given"
    for path in ("typo", "empty"):
        (tmp_path / "empty").mkdir(exist_ok=True)
        with pytest.raises(FileFormatError, match=path):
            find(tmp_path / path)


def test_the_folder_itself_goes_before_those_in_it_and_these_in_their_order(tmp_path):
    for inside in (FOLDERS[1], FOLDERS[0], "."):
        folder = put(tmp_path / inside, *FILES)
        assert find(tmp_path)["a.txt"].parent == folder


def test_all_files_are_of_one_folder(tmp_path):
    put(tmp_path, "a.txt")
    whole = put(tmp_path / "one", *FILES)
    assert {path.parent for path in find(tmp_path).values()} == {whole}
    (whole / "a.txt").unlink()
    with pytest.raises(FileFormatError, match=r"has no b\.txt"):
        find(tmp_path)


def test_a_plain_file_goes_before_a_compressed_one_and_they_may_be_mixed(tmp_path):
    put(tmp_path, "a.txt", "a.txt.gz", "b.txt.gz")
    assert [path.name for path in find(tmp_path).values()] == ["a.txt", "b.txt.gz"]
    beside = find(tmp_path)["b.txt"]
    assert there(beside, "a.txt").name == "a.txt"
    (tmp_path / "a.txt").unlink()
    assert there(beside, "a.txt").name == "a.txt.gz"
    assert there(beside, "c.txt") is None


def test_a_set_of_one_file_may_be_named_by_it_whatever_its_name(tmp_path):
    put(tmp_path, "mine.gz")
    assert find(tmp_path / "mine.gz", ("a.txt",)) == {"a.txt": tmp_path / "mine.gz"}
    with pytest.raises(FileFormatError, match=r"mine\.gz is a file; give the folder of a\.txt, b"):
        find(tmp_path / "mine.gz")


def test_a_folder_is_no_file(tmp_path):
    put(tmp_path, "b.txt")
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(FileFormatError, match=r"has no a\.txt"):
        find(tmp_path)


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ((), r"has no a\.txt, b\.txt \(nor with \.gz\), itself or in of/one or one; ekfslam"),
        (("a.txt",), r"has no b\.txt \(nor with \.gz\); ekfslam datasets set tells where"),
    ],
)
def test_what_is_missing_is_named_and_where_it_was_looked_for(tmp_path, files, said):
    with pytest.raises(FileFormatError, match=said) as error:
        find(put(tmp_path, *files))
    assert str(error.value).startswith(f"set: {tmp_path} ")
    inside = put(tmp_path / "in" / "one", "b.txt").parent
    with pytest.raises(FileFormatError, match=r"in/one has no a\.txt"):
        find(inside)


def test_without_any_folder_both_ways_to_name_one_are_said(monkeypatch):
    for value in (None, ""):
        if value is not None:
            monkeypatch.setenv("EKFSLAM_DATA", value)
        with pytest.raises(FileFormatError, match=r"--data PATH, or .* EKFSLAM_DATA\); ekfslam"):
            find()


# The catalogue ------------------------------------------------------------------------------------


def test_names_and_parts():
    assert is_recorded("mrclam1/robot3")
    assert is_recorded("lego")
    assert not is_recorded("park")
    assert of_name("mrclam7/robot2") == (RECORDED["mrclam7"], "robot2")
    assert of_name("lego") == (RECORDED["lego"], "")
    for name, said in (
        ("mrclam10", "unknown recorded dataset 'mrclam10'; did you mean"),
        ("mrclam1/robot6", "unknown part of mrclam1 'robot6'"),
        ("mrclam1/", "unknown part of mrclam1 ''"),
    ):
        with pytest.raises(UnknownNameError, match=said):
            load_recorded(name)
    with pytest.raises(InputError, match="lego has no parts, so no lego/robot1"):
        load_recorded("lego/robot1")


@pytest.mark.parametrize("name", WHEEL)
def test_what_comes_with_gtsam_is_here_whatever_the_variable_says(name, monkeypatch):
    monkeypatch.setenv("EKFSLAM_DATA", "/nowhere")
    assert RECORDED[name].is_here(name)
    told = dict(RECORDED[name].told(name))
    assert told["here"].startswith("yes, in ")
    assert "gtsam package" in told["published"]
    assert "folder" not in told


@pytest.mark.parametrize("name", WHEEL)
def test_a_folder_for_several_sets_is_for_those_in_the_wheel_if_it_has_them(name, tmp_path):
    recorded = RECORDED[name]
    assert recorded.given(name, None) is None
    assert recorded.given(name, tmp_path) is None
    assert recorded.given(name, tmp_path / "typo") == tmp_path / "typo"
    put(tmp_path, *recorded.files)
    assert recorded.given(name, tmp_path) == tmp_path
    assert RECORDED["lego"].given("lego", tmp_path / "other") == tmp_path / "other"


@each_published
def test_a_set_that_is_not_here_tells_all_that_is_needed(name, tmp_path):
    recorded = RECORDED[name]
    assert not recorded.is_here(name, tmp_path)
    told = dict(recorded.told(name, tmp_path))
    assert told["here"].startswith(f"no: {tmp_path} has no {recorded.files[0]}")
    assert hint(name) not in told["here"]
    assert all(file in told["files"] for file in recorded.files)
    assert all(folder in told["folder"] for folder in recorded.folders)
    assert told["published"]
    with pytest.raises(FileFormatError, match=f"^{name}: .*; ekfslam datasets {name} tells where"):
        load_recorded(name, tmp_path)
    with pytest.raises(FileFormatError, match=f"^{name}: give the folder"):
        load_recorded(name)
    with pytest.raises(FileFormatError, match=f"^{name}: there is no file or folder .*typo"):
        load_recorded(name, tmp_path / "typo")


@each_published
def test_a_set_is_found_in_each_of_its_folders(name, tmp_path):
    recorded = RECORDED[name]
    for folder in recorded.folders:
        root = tmp_path / folder.replace("/", "-")
        put(root / folder, *(f"{file}.gz" for file in recorded.files))
        assert recorded.is_here(name, root)
        assert dict(recorded.told(name, root))["here"] == f"yes, in {root / folder}"
        assert set(files_of(name, root)) == set(recorded.files)


@pytest.mark.parametrize(
    ("name", "part_files"),
    [
        ("mrclam4/robot2", ("Robot2_Odometry.dat.gz", "Robot2_Measurement.dat")),
        ("city-trees/mc1", ("cityTrees10000_mc1.txt",)),
    ],
)
def test_which_parts_are_here_is_told(name, part_files, tmp_path):
    whole, _, part = name.partition("/")
    recorded = RECORDED[whole]
    put(tmp_path, *recorded.files)
    assert recorded.is_here(whole, tmp_path)
    assert not recorded.is_here(name, tmp_path)
    assert (
        f"; not here: {', '.join(recorded.parts)}" in dict(recorded.told(whole, tmp_path))["parts"]
    )
    put(tmp_path, *part_files)
    assert recorded.is_here(name, tmp_path)
    missing = dict(recorded.told(whole, tmp_path))["parts"].partition("; not here: ")[2]
    assert missing.split(", ") == [other for other in recorded.parts if other != part]


def test_an_option_that_a_loader_does_not_have_is_refused_before_files_are_read():
    with pytest.raises(InputError, match=r"lego: .*colour"):
        load_recorded("lego", colour="red")
