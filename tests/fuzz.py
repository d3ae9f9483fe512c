"""Damage done to files at random, and the law that no loader may break: it says so, or it loads.

Used by the test of each format::

    told = fuzz.check(load, tmp_path, files, count=1000, seed=7, whole=rows_arrive)

"""

from __future__ import annotations

import re
import signal
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.errors import EkfslamError

Files = dict[str, bytes]
NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
NUMBERS = (b"nan", b"inf", b"-inf", b"1e400", b"1e300", b"1e30", b"1e-300", b"-1", b"0", b"0.5")
WORDS = (b"many", b"", b"1,5", b"0x1f", b"--3", b"99999999999999999999", b"1_000")
CHARACTERS = b"0123456789.-+eE \t\n\r,;#:[]abcxyz\"'/"
NOISE = (b"\x00", b"\xff", b"\xfe", b"\xc3", b"\x80", b"\x1a", b"\x0c", b"\x1b")
ENDS = (b"\n", b"\r\n", b"\r")
SECONDS = 30  # that a case may take: far more than it should, since only a hang is meant


class Hang(BaseException):
    """A loader that does not come back; no `Exception`, so that nothing on the way catches it."""


# How a text is damaged: each takes its lines, without their ends, and gives what follows ----------


def _some(lines: list[bytes], rng: np.random.Generator) -> int:
    return int(rng.integers(len(lines)))


def delete_lines(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    at, many = _some(lines, rng), int(rng.integers(1, 4))
    return lines[:at] + lines[at + many :]


def duplicate_line(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    at, to = _some(lines, rng), _some(lines, rng)
    return [*lines[:to], lines[at], *lines[to:]]


def swap_lines(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    a, b, lines = _some(lines, rng), _some(lines, rng), list(lines)
    lines[a], lines[b] = lines[b], lines[a]
    return lines


def join_lines(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    at = _some(lines, rng)
    return [*lines[:at], b"".join(lines[at : at + 2]), *lines[at + 2 :]]


def blank_line(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    at = _some(lines, rng)
    return [*lines[:at], (b"", b"  \t")[rng.integers(2)], *lines[at:]]


def replace_number(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    return _with_number(lines, rng, lambda old: NUMBERS[rng.integers(len(NUMBERS))])


def replace_word(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    return _with_number(lines, rng, lambda old: WORDS[rng.integers(len(WORDS))])


def negate_number(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    return _with_number(lines, rng, lambda old: old[1:] if old[:1] == b"-" else b"-" + old)


def scale_number(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    factor = (1e-3, 1e3, 180 / np.pi, 1e6)[rng.integers(4)]
    return _with_number(lines, rng, lambda old: repr(factor * float(old)).encode())


def drop_column(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    def without(words: list[bytes]) -> list[bytes]:
        at = int(rng.integers(len(words)))
        return words[:at] + words[at + 1 :]

    return _with_words(lines, rng, without)


def add_column(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    def more(words: list[bytes]) -> list[bytes]:
        at = int(rng.integers(len(words) + 1))
        return [*words[:at], (b"0", b"1.5", b"7", b"-2")[rng.integers(4)], *words[at:]]

    return _with_words(lines, rng, more)


def _with_number(
    lines: list[bytes], rng: np.random.Generator, new: Callable[[bytes], bytes]
) -> list[bytes]:
    """One of the numbers of some line replaced."""
    at = _some(lines, rng)
    found = list(NUMBER.finditer(lines[at]))
    if not found:
        return lines
    one = found[rng.integers(len(found))]
    line = lines[at][: one.start()] + new(one.group()) + lines[at][one.end() :]
    return [*lines[:at], line, *lines[at + 1 :]]


def _with_words(
    lines: list[bytes], rng: np.random.Generator, new: Callable[[list[bytes]], list[bytes]]
) -> list[bytes]:
    """The words of some line replaced."""
    at = _some(lines, rng)
    words = lines[at].split()
    return [*lines[:at], b" ".join(new(words)), *lines[at + 1 :]] if words else lines


LINES = (
    delete_lines,
    duplicate_line,
    swap_lines,
    join_lines,
    blank_line,
    replace_number,
    replace_word,
    negate_number,
    scale_number,
    drop_column,
    add_column,
)


# How bytes are damaged, of text or not ------------------------------------------------------------


def cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: rng.integers(len(content) + 1)]


def behead(content: bytes, rng: np.random.Generator) -> bytes:
    return content[rng.integers(len(content) + 1) :]


def empty(content: bytes, rng: np.random.Generator) -> bytes:
    return (b"", b"\n", b" \r\n")[rng.integers(3)]


def change_character(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(content)))
    return content[:at] + _character(rng) + content[at + 1 :]


def insert_character(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(content) + 1))
    return content[:at] + _character(rng) + content[at:]


def delete_characters(content: bytes, rng: np.random.Generator) -> bytes:
    at, many = int(rng.integers(len(content))), int(rng.integers(1, 4))
    return content[:at] + content[at + many :]


def insert_noise(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(content) + 1))
    return content[:at] + NOISE[rng.integers(len(NOISE))] + content[at:]


def zero_block(content: bytes, rng: np.random.Generator) -> bytes:
    at, many = int(rng.integers(len(content))), int(rng.integers(1, 65))
    return content[:at] + b"\x00" * len(content[at : at + many]) + content[at + many :]


def _character(rng: np.random.Generator) -> bytes:
    return bytes([CHARACTERS[rng.integers(len(CHARACTERS))]])


BYTES = (
    cut,
    behead,
    empty,
    change_character,
    insert_character,
    delete_characters,
    insert_noise,
    zero_block,
)


def line_ends(content: bytes, rng: np.random.Generator) -> bytes:
    """Ends of another kind, of several kinds, or none after the last line."""
    lines = content.splitlines()
    kinds = (
        rng.integers(3, size=len(lines)) if rng.random() < 0.5 else [rng.integers(3)] * len(lines)
    )
    ends = [ENDS[kind] for kind in kinds]
    if ends and rng.random() < 0.3:
        ends[-1] = b""
    return b"".join(line + end for line, end in zip(lines, ends, strict=True))


def _on_lines(change: Callable[[list[bytes], np.random.Generator], list[bytes]]) -> Callable:
    def changed(content: bytes, rng: np.random.Generator) -> bytes:
        lines = content.splitlines()
        return b"".join(line + b"\n" for line in change(lines, rng)) if lines else content

    changed.__name__ = change.__name__
    return changed


TEXT = (*map(_on_lines, LINES), line_ends)


def is_text(content: bytes) -> bool:
    """Whether bytes are lines that can be damaged as such."""
    try:
        return "\x00" not in content.decode()
    except UnicodeDecodeError:
        return False


def mutations(files: Mapping[str, bytes], count: int, seed: int) -> Iterator[tuple[str, Files]]:
    """Files damaged at random, the same for the same seed.

    One file at a time, by one change or, in a quarter of the cases, by two; sometimes a file is
    missing. Files that are no text are damaged as bytes only.

    Yields
    ------
    description : str
        Which change was made to which file, as in ``drop_column of graph.g2o``.
    files : dict of bytes
        All of them, damaged or not.
    """
    rng = np.random.default_rng(seed)
    names = sorted(files)
    for _ in range(count):
        name = names[rng.integers(len(names))]
        content, made = files[name], []
        if rng.random() < 0.01:
            yield f"missing of {name}", {n: files[n] for n in names if n != name}
            continue
        kinds = (*TEXT, *BYTES) if is_text(content) else BYTES
        for _ in range(1 + (rng.random() < 0.25)):
            change = kinds[rng.integers(len(kinds))]
            if content:
                content = change(content, rng)
                made.append(change.__name__)
        yield f"{', '.join(made)} of {name}", {**files, name: content}


@contextmanager
def limited(seconds: float = SECONDS) -> Iterator[None]:
    """Raise `Hang` in what does not end in time."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: object) -> None:
        raise Hang(f"not back after {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def check(
    load: Callable[[Path], Dataset],
    folder: Path,
    files: Mapping[str, bytes],
    count: int = 1000,
    seed: int = 0,
    whole: Callable[[Dataset, Files], None] | None = None,
    certain: Collection[str] = (),
) -> Counter[str]:
    """Load damaged files: each gives an error of one line that names a file, or a dataset.

    Parameters
    ----------
    load : callable
        Takes the folder in which the files are.
    folder : path
        An empty one.
    files : mapping of bytes
        By name, valid.
    count, seed : int
    whole : callable, optional
        Takes what was loaded and the damaged files; asserts that the dataset is not shorter than
        the files say (that it has as many sightings as they have lines of them, say).
    certain : collection of str
        Names of changes that the format always shows, such as ``("drop_column", "empty")``: alone,
        they must be refused.

    Returns
    -------
    Counter
        How many were ``refused`` and how many ``loaded``: assert that both happened.
    """
    told: Counter[str] = Counter()
    _write(folder, files)
    assert isinstance(load(folder), Dataset)
    for number, (description, damaged) in enumerate(mutations(files, count, seed)):
        what = f"mutation {number} of seed {seed}: {description}"
        if all(damaged.get(name) == content for name, content in files.items()):
            continue
        _write(folder, damaged)
        try:
            with limited():
                loaded = load(folder)
        except EkfslamError as error:
            said = str(error)
            assert len(said.splitlines()) == 1, f"{what}: {said!r}"
            assert any(name in said for name in files), f"{what}: no file is named in {said!r}"
            told["refused"] += 1
            continue
        except BaseException as error:
            raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error
        assert isinstance(loaded, Dataset), what
        assert description.partition(" of ")[0] not in certain, f"{what}: was not refused"
        if whole is not None:
            try:
                whole(loaded, damaged)
            except AssertionError as error:
                raise AssertionError(f"{what}: {error}") from error
        told["loaded"] += 1
    return told


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    """These files and no others."""
    for old in folder.iterdir():
        old.unlink()
    for name, content in files.items():
        (folder / name).write_bytes(content)
