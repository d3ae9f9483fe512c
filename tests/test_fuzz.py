"""The damage that loaders are tested with: it is damage, it repeats, and it finds what is wrong."""

from __future__ import annotations

import time

import fuzz
import numpy as np
import pytest

from ekfslam.datasets import victoria_park
from ekfslam.errors import FileFormatError

FILES = {"one.txt": b"A 1 2.5\nB 2 -3e-2\n" * 4, "two.bin": b"\x00\x01\xff" * 9}
PARK = b"".join(
    b"ODOMETRY %d %d 1 0.5 0.25 0.01 0 0 0.02 0 0.03\nLANDMARK %d %d 3 4 0.4 0.1 0.5\n"
    % (k, k + 1, k + 1, 90 + k % 3)
    for k in range(6)
)


def test_the_same_seed_makes_the_same_damage_and_another_seed_another():
    first = list(fuzz.mutations(FILES, 200, 5))
    assert first == list(fuzz.mutations(FILES, 200, 5))
    assert first != list(fuzz.mutations(FILES, 200, 6))


def test_every_change_is_made_and_nearly_always_changes_something():
    found = list(fuzz.mutations(FILES, 3000, 1))
    assert len(found) == 3000
    kinds = {kind for said, _ in found for kind in said.partition(" of ")[0].split(", ")}
    assert kinds == {"missing", *(change.__name__ for change in (*fuzz.TEXT, *fuzz.BYTES))}
    assert np.mean([damaged != FILES for _, damaged in found]) > 0.9
    assert all(set(damaged) <= set(FILES) for _, damaged in found)
    for said, damaged in found:  # one file at a time, and what is no text is not damaged as text
        other = "one.txt" if said.endswith("two.bin") else "two.bin"
        assert damaged[other] == FILES[other]
        if said.endswith("two.bin"):
            assert not {c.__name__ for c in fuzz.TEXT} & set(said.partition(" of ")[0].split(", "))


def park(folder):
    return victoria_park.load(folder / "park.txt")


def complains(message):
    """A loader that is right but for what it says of one kind of damage."""

    def load(folder):
        try:
            return park(folder)
        except FileFormatError as error:
            raise message(error) from None

    return load


def shortened(dataset, files):
    """Each line of a sighting is one in the dataset."""
    lines = [line for line in files["park.txt"].split(b"\n") if line.startswith(b"LANDMARK")]
    assert len(dataset.observations) >= len(lines), "sightings are missing"


@pytest.mark.parametrize(
    ("load", "said"),
    [
        (complains(lambda error: ValueError(str(error))), "ValueError"),
        (complains(lambda error: FileFormatError(f"{error}\nand more")), "and more"),
        (complains(lambda error: FileFormatError("no good")), "no file is named"),
        (
            lambda folder: park(folder) if (folder / "park.txt").read_bytes() == PARK else 1,
            "mutation",
        ),
    ],
)
def test_a_loader_that_breaks_the_law_is_found(tmp_path, load, said):
    with pytest.raises(AssertionError, match=said):
        fuzz.check(load, tmp_path, {"park.txt": PARK}, count=100)


def test_what_must_be_whole_and_what_must_be_refused_is_asked_for(tmp_path):
    def lenient(folder):
        """Leaves out the lines that it does not understand."""
        path = folder / "park.txt"
        text = path.read_bytes() if path.exists() else b""
        lines = [line for line in text.split(b"\n") if len(line.split()) in (8, 12)]
        path.write_bytes(b"\n".join(lines))
        return park(folder)

    with pytest.raises(AssertionError, match="are missing"):
        fuzz.check(lenient, tmp_path, {"park.txt": PARK}, count=300, whole=shortened)
    with pytest.raises(AssertionError, match=r"drop_column of park\.txt: was not refused"):
        fuzz.check(lenient, tmp_path, {"park.txt": PARK}, count=300, certain=["drop_column"])


def test_a_hang_is_found():
    start = time.monotonic()
    with pytest.raises(fuzz.Hang), fuzz.limited(0.05):
        time.sleep(30)
    assert time.monotonic() - start < 20
    with fuzz.limited(20):
        pass


def test_victoria_park_obeys(tmp_path):
    told = fuzz.check(
        park,
        tmp_path,
        {"park.txt": PARK},
        count=1000,
        whole=shortened,
        certain=["drop_column", "add_column", "empty"],
    )
    assert told["refused"] > 300
    assert told["loaded"] > 100
