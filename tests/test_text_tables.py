"""Text files of numbers: what is read, whatever its line ends, and what is refused, by its line."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from ekfslam.datasets.text import lines_of, numbers, read_table, read_text, whole
from ekfslam.errors import FileFormatError

COLUMNS = ("time", "x")
ROWS = [[0.5, -3.0], [1.5, 4e-3], [2.5, 7.0]]
TEXT = b"0.5 -3\n1.5 4e-3\n2.5 +7.\n"


@pytest.fixture
def table(tmp_path):
    """Writes a file and reads it."""

    def read(content, name="log.txt", **options):
        (tmp_path / name).write_bytes(content)
        return read_table(tmp_path / name, COLUMNS, **options)

    read.folder = tmp_path
    return read


# What is read -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "lines"),
    [
        (TEXT, [1, 2, 3]),
        (TEXT.rstrip(), [1, 2, 3]),
        (b"\xef\xbb\xbf" + TEXT, [1, 2, 3]),
        (TEXT.replace(b"\n", b"\r\n"), [1, 2, 3]),
        (TEXT.replace(b"\n", b"\r"), [1, 2, 3]),
        (TEXT.replace(b"\n", b"\r\n", 1).replace(b"e-3\n", b"e-3\r"), [1, 2, 3]),
        (TEXT.replace(b" ", b"\t \t"), [1, 2, 3]),
        (b"# time x\n\n" + TEXT.replace(b"4e-3", b"4e-3 # a remark 7"), [3, 4, 5]),
        (b"#\xc3\xa9\n \t\n" + TEXT + b"\n\n# end", [3, 4, 5]),
    ],
)
@pytest.mark.parametrize("packed", [False, True])
def test_rows_are_read_with_their_lines(table, content, lines, packed):
    found = table(gzip.compress(content) if packed else content, "log.txt" + ".gz" * packed)
    assert_array_equal(found.values, ROWS)
    assert_array_equal(found.lines, lines)
    assert len(found) == 3
    some = found.rows(found.values[:, 0] > 1)
    assert_array_equal(some.values, ROWS[1:])
    assert_array_equal(some.lines, lines[1:])


def test_another_mark_of_comments(table):
    assert_array_equal(table(b"% 1 2\n" + TEXT, comment="%").values, ROWS)
    with pytest.raises(FileFormatError, match="line 1: 2 numbers are wanted"):
        table(b"# 1 2\n" + TEXT, comment="%")


def test_numbers_are_read_to_the_last_bit(table, rng):
    values = rng.normal(size=(200, 2)) * 10.0 ** rng.integers(-300, 300, (200, 2))
    text = "\n".join(" ".join(map(repr, row)) for row in values.tolist())
    assert_array_equal(table(text.encode()).values, values)
    assert table(b"1e-400 1e308\n").values.tolist() == [[0.0, 1e308]]


def test_lines_keep_their_numbers_and_words(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text("# first\nA 1 # and so on\n\n  B 2 x\n")
    assert list(lines_of(path)) == [(2, ["A", "1"]), (4, ["B", "2", "x"])]


# What is refused ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b" \r\n\t\n", "is empty"),
        (b"\xef\xbb\xbf", "is empty"),
        (b"# nothing\n", "holds no row of time, x"),
        (TEXT.replace(b" 4e-3", b""), r"line 2: 2 numbers are wanted \(time, x\), there are 1"),
        (TEXT.replace(b"4e-3", b"4e-3 9"), r"line 2: 2 numbers .* there are 3"),
        (TEXT.replace(b"1.5 ", b"1.5"), r"line 2: 2 numbers .* there are 1"),
        (TEXT.replace(b"\n", b" "), r"line 1: 2 numbers .* there are 6"),
        (b"# one\n\n" + TEXT.replace(b"+7.", b""), "line 5: 2 numbers"),
        (TEXT.replace(b"4e-3", b"4,3"), "line 2: x is no number but '4,3'"),
        (TEXT.replace(b"4e-3", b"0x1f"), "line 2: x is no number but '0x1f'"),
        (TEXT.replace(b"4e-3", b"1_000"), "line 2: x is no number but '1_000'"),
        (TEXT.replace(b"4e-3", b"a" * 1000), f"line 2: x is no number but '{'a' * 40}'$"),
        (TEXT.replace(b"4e-3", b"4\x003"), r"line 2: x is no number but '4\\x003'"),
        (TEXT.replace(b"4e-3", b"\x00"), "line 2: x is no number"),
        (TEXT + b"\x00\x00\x00", "line 4: 2 numbers"),
        (TEXT.replace(b"4e-3", b"nan"), "line 2: x is nan"),
        (TEXT.replace(b"1.5", b"-inf"), "line 2: time is -inf"),
        (TEXT.replace(b"1.5", b"1e400"), "line 2: time is 1e400"),
        (TEXT.replace(b"1.5", b"9" * 400), "line 2: time is 9{40}$"),
        (b"\xff" + TEXT, "cannot be read .*utf-8"),
        (TEXT.decode().encode("utf-16"), "cannot be read .*utf-8"),
        (TEXT + b"# caf\xe9\n", "cannot be read .*utf-8"),
    ],
)
@pytest.mark.parametrize("packed", [False, True])
def test_what_is_no_table_is_refused_by_its_line(table, content, said, packed):
    name = "log.txt" + ".gz" * packed
    with pytest.raises(FileFormatError, match=said) as error:
        table(gzip.compress(content) if packed else content, name)
    assert str(error.value).startswith(str(table.folder / name))
    assert len(str(error.value).splitlines()) == 1


def test_a_packed_file_that_is_damaged_is_refused_and_never_shortened(table):
    packed = gzip.compress(TEXT * 50)
    for length in range(len(packed)):
        with pytest.raises(FileFormatError, match=r"log\.txt\.gz: (cannot be read|is empty)"):
            table(packed[:length], "log.txt.gz")
    flipped = bytearray(packed)
    flipped[-6] ^= 1  # of the checksum
    for content in (bytes(flipped), packed + b"more", TEXT):
        with pytest.raises(FileFormatError, match="cannot be read"):
            table(content, "log.txt.gz")
    with pytest.raises(FileFormatError, match="cannot be read"):
        table(packed, "log.txt")  # packed, but not called so
    assert len(table(packed, "log.txt.gz")) == 150


def test_what_is_no_file_is_refused(tmp_path):
    for path, said in ((tmp_path / "none.txt", "no such file"), (tmp_path, "cannot be read")):
        with pytest.raises(FileFormatError, match=said):
            read_text(path)


# What is asked of a table -------------------------------------------------------------------------


def test_the_first_bad_row_is_named_by_its_line(table):
    found = table(b"# one\n" + TEXT)
    with pytest.raises(FileFormatError, match=r"log\.txt, line 3: is this so\?"):
        found.refuse(np.array([False, True, True]), "is this so?")
    found.refuse(np.zeros(3, dtype=bool), "never")


@pytest.mark.parametrize(
    ("word", "said"),
    [
        (b"2.5", "line 2: barcode is no whole number"),
        (b"-1", "line 2: barcode is not a number from 0 on"),
        (b"1e300", "line 2: barcode is not a number from 0 on"),
    ],
)
def test_whole_numbers(table, word, said):
    assert whole(table(b"3 0\n9007199254740992 0\n"), 0, "barcode").tolist() == [3, 2**53]
    with pytest.raises(FileFormatError, match=said):
        whole(table(b"3 0\n" + word + b" 0\n"), 0, "barcode")
    with pytest.raises(FileFormatError, match="line 1: barcode is not a number from 4 on"):
        whole(table(b"3 0\n"), 0, "barcode", least=4)


def test_numbers_of_a_record_are_named_with_it(tmp_path):
    assert numbers(tmp_path, 3, ["1", "2"], COLUMNS, "EDGE") == [1.0, 2.0]
    for words, said in ((["1"], "2 numbers of EDGE are wanted"), (["1", "x"], "x of EDGE is no")):
        with pytest.raises(FileFormatError, match=said):
            numbers(tmp_path, 3, words, COLUMNS, "EDGE")
