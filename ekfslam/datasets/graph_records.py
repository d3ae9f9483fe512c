"""Lines of a tag, ids, numbers and a noise, as text files of graphs have them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ekfslam.checks import is_covariance
from ekfslam.datasets.text import lines_of, numbers
from ekfslam.errors import FileFormatError
from ekfslam.geometry import Array

NOISES = ("covariance", "information", "square-root")
DIMENSION = {0: 0, 1: 1, 3: 2, 6: 3}  # of a matrix whose upper triangle has so many numbers
DEFINITE = 1e-12  # least eigenvalue of a correlation that is not zero
LARGEST = 1e8  # [m]: beyond any place on Earth, also in the northings of a map
VAGUEST = 1e10  # standard deviation [m or rad]


class Tag(NamedTuple):
    """What follows the first word of a line.

    Attributes
    ----------
    ids, values : tuple of str
        Names of the columns: what is spoken of, and what is said of it. Angles are ``theta`` and
        ``bearing`` [rad], all others are metres.
    noise : tuple of str
        Names of the upper triangle of a matrix, or none.
    timed : bool
        Whether the time [s] comes first.
    many : bool
        Whether any number of ids follows, and nothing else.
    """

    ids: tuple[str, ...]
    values: tuple[str, ...] = ()
    noise: tuple[str, ...] = ()
    timed: bool = False
    many: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns, in the order of the line."""
        return ("time",) * self.timed + self.ids + self.values + self.noise


def triangle(axes: Sequence[str]) -> tuple[str, ...]:
    """Names of an upper triangle, row by row: ``xx, xy, yy``."""
    return tuple(a + b for i, a in enumerate(axes) for b in axes[i:])


class Rows(NamedTuple):
    """Lines of one tag.

    Attributes
    ----------
    path : Path
    line : (n,) ndarray of int
    ids : (n, i) ndarray of int
    values : (n, v) ndarray
    noise : (n, m) ndarray
        As written.
    time : (n,) ndarray
        NaN if there is none.
    """

    path: Path
    line: np.ndarray
    ids: np.ndarray
    values: Array
    noise: Array
    time: Array

    def refuse(self, bad: np.ndarray, said: str) -> None:
        """Name the line of the first bad row, if there is one.

        Raises
        ------
        FileFormatError
        """
        for row in np.flatnonzero(bad)[:1]:
            raise FileFormatError(f"{self.path}, line {self.line[row]}: {said}")

    def covariances(self, noise: str, definite: bool = False, order: Sequence[int] = ()) -> Array:
        """Covariances from what was written of the noise.

        Parameters
        ----------
        noise : {"covariance", "information", "square-root"}
            What the numbers are the upper triangle of; the last: of R, with R'R the information.
        definite : bool
            Whether a covariance must be definite, too.
        order : sequence of int
            Columns of the triangle row by row, if they are not in that order.

        Returns
        -------
        (n, d, d) ndarray

        Raises
        ------
        FileFormatError
            If it is none; names the line.
        """
        written = self.noise[:, list(order)] if order else self.noise
        size = DIMENSION[written.shape[1]]
        rows, columns = np.triu_indices(size)
        given: Any = np.zeros((len(written), size, size))
        given[:, rows, columns] = written
        if noise == "square-root":
            bad = (np.einsum("nii->ni", given) <= 1 / VAGUEST).any(axis=1)
            self.refuse(bad, "the square root of the information has no positive diagonal")
            with np.errstate(all="ignore"):
                roots = np.linalg.inv(given)
                given = np.matmul(roots, np.swapaxes(roots, 1, 2))
        else:
            given[:, columns, rows] = written
            if noise == "information" or definite:
                self.refuse(~_definite(given), f"the {noise} is not positive definite")
            if noise == "information":
                given = np.linalg.inv(given)
        with np.errstate(invalid="ignore"):
            vague = ~(np.abs(given) <= VAGUEST**2)
        self.refuse(np.any(vague, axis=(1, 2)), f"a standard deviation above {VAGUEST:g}")
        given = 0.5 * (given + np.swapaxes(given, 1, 2))
        self.refuse(~is_covariance(given), "the covariance is not positive semi-definite")
        return given


def _definite(matrices: Array) -> np.ndarray:
    """Whether matrices are positive definite, judged as correlations."""
    variances = np.einsum("nii->ni", matrices)
    positive = (variances > VAGUEST**-2).all(axis=1)
    scale = np.sqrt(np.where(positive[:, None], variances, 1.0))
    with np.errstate(over="ignore"):
        correlations = matrices / scale[:, :, None] / scale[:, None, :]
    # A correlation above 1 is none, and too large a one is not for eigenvalues.
    fair = (np.abs(correlations) <= 2).all(axis=(1, 2))
    correlations[~fair] = 0.0
    return positive & fair & (np.linalg.eigvalsh(correlations).min(axis=1, initial=1) > DEFINITE)


def whole_number(word: str) -> int:
    """An id that is a number.

    Raises
    ------
    ValueError
    """
    if not (word.isascii() and word.isdigit() and len(word) <= 12):
        raise ValueError("whole numbers from 0 on")
    return int(word)


def read(
    path: Path,
    tags: Mapping[str, Tag],
    of: Callable[[str], str | None] = lambda tag: None,
    identity: Callable[[str], int] = whole_number,
) -> dict[str, Rows]:
    """Read a file of such lines.

    Parameters
    ----------
    path : Path
    tags : mapping of Tag
    of : callable
        What is to be said of an unknown tag, if anything.
    identity : callable
        From the word of an id to its number; raises ValueError with what it should be.

    Returns
    -------
    dict of Rows
        For every tag, also those that the file has not.

    Raises
    ------
    FileFormatError
        For a file that cannot be read, an unknown tag, or a line that is not what its tag says.
    """
    found: dict[str, list[tuple[int, list[int], list[float]]]] = {tag: [] for tag in tags}
    for line, (tag, *words) in lines_of(path):
        if tag not in tags:
            said = of(tag) or f"known are {', '.join(tags)}"
            raise FileFormatError(f"{path}, line {line}: unknown record {tag[:40]!r}; {said}")
        known = tags[tag]
        if known.many and words:
            found[tag] += [(line, [_identity(path, line, tag, identity, w)], []) for w in words]
            continue
        if len(words) != len(known.columns):
            raise FileFormatError(
                f"{path}, line {line}: {tag} needs {len(known.columns)} numbers, got {len(words)} "
                f"(wanted: {', '.join(known.columns)})"
            )
        first = int(known.timed)
        last = first + len(known.ids)
        ids = [_identity(path, line, tag, identity, word) for word in words[first:last]]
        rest = numbers(
            path,
            line,
            words[:first] + words[last:],
            known.columns[:first] + known.columns[last:],
            tag,
        )
        found[tag].append((line, ids, rest))
    return {tag: _rows(path, tags[tag], rows) for tag, rows in found.items()}


def _identity(path: Path, line: int, tag: str, identity: Callable[[str], int], word: str) -> int:
    try:
        return identity(word)
    except ValueError as error:
        raise FileFormatError(
            f"{path}, line {line}: ids of {tag} must be {error}, not {word[:40]!r}"
        ) from None


def _rows(path: Path, tag: Tag, found: list[tuple[int, list[int], list[float]]]) -> Rows:
    """Arrays of the lines of a tag, after a look at their size."""
    line = np.array([row[0] for row in found], dtype=np.int64)
    ids = np.array([row[1] for row in found], dtype=np.int64).reshape(len(found), len(tag.ids))
    width = tag.timed + len(tag.values) + len(tag.noise)
    table = np.array([row[2] for row in found], dtype=float).reshape(len(found), width)
    time = table[:, 0] if tag.timed else np.full(len(found), np.nan)
    values = table[:, tag.timed : tag.timed + len(tag.values)]
    rows = Rows(path, line, ids, values, table[:, tag.timed + len(tag.values) :], time)
    for column, name in enumerate(tag.values):
        if name not in ("theta", "bearing"):
            rows.refuse(np.abs(values[:, column]) > LARGEST, f"{name} is beyond {LARGEST:g} m")
    return rows
