"""Bytes of MATLAB files: what scipy writes and reads is read alike, and damage is told."""

from __future__ import annotations

import gzip
import io
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.io import loadmat, savemat

from ekfslam.errors import FileFormatError
from ekfslam.mat5 import arrays_in, read_arrays


def written(arrays, **options):
    buffer = io.BytesIO()
    savemat(buffer, arrays, **options)
    return buffer.getvalue()


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize(
    "kind", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", ">f8", ">i2"]
)
def test_arrays_of_every_kind_are_read(rng, kind, compressed):
    arrays = {
        name: rng.integers(0, 120, shape).astype(kind)
        for name, shape in {"a": (3, 4), "longer_name": (1, 1), "c": (0, 2), "d": (2, 3, 4)}.items()
    }
    found = arrays_in(written(arrays, do_compression=compressed))
    assert found.keys() == arrays.keys()
    for name, array in arrays.items():
        assert_array_equal(found[name], array)
        assert found[name].dtype == np.dtype(kind).newbyteorder("=")


def test_values_are_kept_to_the_last_bit(rng):
    values = rng.normal(size=(50, 3)) * 10.0 ** rng.integers(-300, 300, (50, 3))
    values[0] = np.nan, np.inf, -np.inf
    assert_array_equal(arrays_in(written({"a": values}))["a"], values)


def test_what_is_no_array_of_real_numbers_is_named():
    content = written({
        "text": "hello", "cells": np.array([1, "a"], dtype=object), "real": np.eye(2),
        "complex": np.array([[1j]]), "struct": {"a": 1.0},
    })  # fmt: skip
    found = arrays_in(content)
    assert [name for name, array in found.items() if array is None] == [
        "text", "cells", "complex", "struct",
    ]  # fmt: skip
    assert_array_equal(found["real"], np.eye(2))


@pytest.mark.parametrize("file", ["Plaza1_.mat", "Plaza2_.mat"])
def test_files_by_matlab_are_read_as_scipy_reads_them(file):
    path = Path(find_spec("gtsam").origin).parent / "Data" / file
    expected = loadmat(path)
    found = arrays_in(path.read_bytes())
    assert set(found) == {name for name in expected if not name.startswith("__")}
    for name, array in found.items():
        assert_array_equal(array, expected[name])


def test_a_file_of_the_other_byte_order_is_read(tmp_path):
    def words(order, *numbers):
        return np.array(numbers, f"{order}u4").tobytes()

    def file(order):
        # A double array a = [1, 2], stored as bytes: flags, size, name and data.
        parts = (
            words(order, 6, 8, 6, 0) + words(order, 5, 8, 1, 2)
            + words(order, (1 << 16) + 1) + b"a\0\0\0" + words(order, (2 << 16) + 2) + b"\1\2\0\0"
        )  # fmt: skip
        mark = b"IM" if order == "<" else b"MI"
        header = b"MATLAB".ljust(124) + np.array([0x0100], f"{order}u2").tobytes() + mark
        return header + words(order, 14, len(parts)) + parts

    for order in "<>":
        assert_array_equal(arrays_in(file(order))["a"], [[1.0, 2.0]])
    path = tmp_path / "big.mat"
    path.write_bytes(file(">"))
    assert_array_equal(loadmat(path)["a"], [[1.0, 2.0]])


@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_cut_anywhere_within_an_array_is_refused(rng, compressed):
    content = written({"a": rng.normal(size=(4, 3)), "b": np.eye(2)}, do_compression=compressed)
    ends = {len(written({"a": np.zeros((4, 3))})), 128} if not compressed else {128}
    whole = 0
    for length in range(len(content)):
        try:
            found = arrays_in(content[:length])
        except ValueError:
            continue
        whole += 1
        assert compressed or length in ends
        assert set(found) < {"a", "b"}
    assert whole == 2


def test_damage_is_told_or_read_but_ends_nothing(rng):
    contents = [
        written({"a": rng.normal(size=(5, 4)), "b": np.arange(6), "text": "x"}, do_compression=c)
        for c in (False, True)
    ]
    told = []
    for number in range(4000):
        damaged = bytearray(contents[number % 2])
        for at in rng.integers(0, len(damaged), rng.integers(1, 4)):
            damaged[at] = rng.integers(256)
        try:
            arrays_in(bytes(damaged))
        except ValueError as error:
            told.append(str(error))
    assert len(told) > 1000
    assert all(len(said.splitlines()) == 1 for said in told)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "no MATLAB file"),
        (b"x" * 300, "no MATLAB file"),
        (b"MATLAB".ljust(124) + b"\x00\x02IM", "another version"),
        (b"MATLAB".ljust(124) + b"\x00\x01IM" + b"\0" * 8, "type 0 where a matrix"),
    ],
)
def test_what_is_no_such_file_is_refused(tmp_path, content, said):
    with pytest.raises(ValueError, match=said):
        arrays_in(content)
    path = tmp_path / "any.mat"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=rf"any\.mat: cannot be read .*{said}"):
        read_arrays(path, {"a": (None, 1)})


def test_arrays_that_are_wanted_are_checked(tmp_path):
    path = tmp_path / "some.mat"
    path.write_bytes(written({"a": np.eye(2), "text": "hello", "bad": [[1.0], [np.nan]]}))
    assert_array_equal(read_arrays(path, {"a": (2, None)})["a"], np.eye(2))
    for name, shape, said in (
        ("none", (1, 1), "has no array none"),
        ("text", (1, 1), "text is no array of real numbers"),
        ("a", (None, 3), "a must be numbers, n x 3, got an array of shape"),
        ("bad", (None, 1), "NaN or infinite value in row 2, column 1 of bad"),
    ):
        with pytest.raises(FileFormatError, match=said):
            read_arrays(path, {name: shape})
    packed = tmp_path / "some.mat.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert_array_equal(read_arrays(packed, {"a": (2, None)})["a"], np.eye(2))
    packed.write_bytes(packed.read_bytes()[:-9])
    with pytest.raises(FileFormatError, match=r"some\.mat\.gz: cannot be read"):
        read_arrays(packed, {"a": (2, None)})
    with pytest.raises(FileFormatError, match="no such file"):
        read_arrays(tmp_path / "missing.mat", {})
