"""References: per-seed numbers of an estimator, in a CSV file that reads well in a diff."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from ekfslam.errors import FileFormatError, InputError
from ekfslam.experiments.files import versions
from ekfslam.storage import atomic_write
from ekfslam.testing.session import Record

__tracebackhide__ = True  # a failed test shows the user's line

KEYS = ["scenario", "estimator", "series", "robot", "seed"]
NAMES = ["dataset", *KEYS[:-1]]  # text, whatever it looks like
LEAD = [*KEYS, "status", "draw"]
TITLE = "# Reference of ekfslam.testing, written by pytest --ekfslam-update"
VERSIONS = ("ekfslam", "python", "machine", "numpy", "gtsam")
DIGITS = 7


def read_reference(path: Path) -> pd.DataFrame:
    """Rows of a reference; also of a table `summary`, whose column ``dataset`` is the scenario.

    Raises
    ------
    FileFormatError
        If it is missing, or lacks a column without which nobody can tell whose row it is.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        table = pd.read_csv(
            path,
            skiprows=[at for at, line in enumerate(lines) if line.startswith("#")],
            dtype=dict.fromkeys(NAMES, str),
            keep_default_na=False,
            na_values=["", "nan", "NaN"],
        )
    except (OSError, ValueError) as error:
        raise FileFormatError(f"{path}: cannot be read as a reference ({error})") from None
    if "scenario" not in table:
        table = table.rename(columns={"dataset": "scenario"})
    missing = [name for name in [*KEYS, "status"] if name not in table]
    if missing:
        raise FileFormatError(f"{path}: is no reference, it has no column {', '.join(missing)}")
    return table.assign(seed=table["seed"].fillna(0).astype(int))


def records_of(rows: pd.DataFrame, metrics: Iterable[str]) -> list[Record]:
    """What a reference keeps of some runs, with the versions that they depend on."""
    found = versions()
    words = ", ".join(f"{name} {found[name]}" for name in VERSIONS)
    plain = rows.reindex(columns=[*LEAD, *metrics]).astype(object)
    plain = plain.where(plain.notna(), None)
    return [
        {str(key): _plain(value) for key, value in row.items()} | {"versions": words}
        for row in plain.to_dict("records")
    ]


def _plain(value: Any) -> Any:
    """A number of Python, which JSON knows, for one of NumPy."""
    return value.item() if hasattr(value, "item") else value


def rewrite(path: Path, records: Sequence[Record]) -> None:
    """Put records into a file of ours, which is made if needed; what they do not speak of stays.

    Raises
    ------
    InputError
        If the file cannot be written.
    FileFormatError
        If it cannot be read.
    """
    new = pd.DataFrame(records)
    said = dict(zip(_groups(new), new.pop("versions"), strict=True))
    if path.exists():
        said = _versions(path) | said
        new = _combined(new, _blanked(read_reference(path), records))
    new = _unique(new)
    metrics = sorted(name for name in new.columns if name not in LEAD)
    text = io.StringIO()
    lines = [TITLE, *(f"# {group}: {words}" for group, words in sorted(said.items()))]
    text.write("\n".join(lines) + "\n")
    new[[*LEAD, *metrics]].map(_digits).to_csv(text, index=False, lineterminator="\n")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from None
    with atomic_write(path) as stream:
        stream.write(text.getvalue().encode())


def is_ours(path: Path) -> bool:
    """Whether a file may be rewritten: it is not there yet, or says that it was written here."""
    if not path.exists():
        return True
    with path.open(encoding="utf-8", errors="replace") as stream:
        return stream.readline().rstrip() == TITLE


def _groups(rows: pd.DataFrame) -> list[str]:
    return [f"{e} on {s}" for e, s in zip(rows["estimator"], rows["scenario"], strict=True)]


def _versions(path: Path) -> dict[str, str]:
    """What a reference says of each estimator and scenario in it."""
    lines = path.read_text(encoding="utf-8").splitlines()[1:]
    said = (line.removeprefix("# ").rpartition(": ") for line in lines if line.startswith("# "))
    return {group: words for group, _, words in said}


def _unique(rows: pd.DataFrame) -> pd.DataFrame:
    """One row for each run, in order, from all that tests had to say of it."""
    return rows.groupby(KEYS, dropna=False, as_index=False).last()


def _named(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows whose names are text or None, so that those of a file are those of now."""
    names = rows[KEYS[:-1]].astype(object)
    return rows.assign(**dict(names.where(names.notna(), None)))


def _blanked(old: pd.DataFrame, records: Sequence[Record]) -> pd.DataFrame:
    """Old rows without what the records speak of, also where they have no number any more."""
    spoken: dict[Any, set[str]] = {}
    for row in records:
        names = set(row).intersection(old.columns).difference(LEAD)
        spoken.setdefault(tuple(row[key] for key in KEYS), set()).update(names)
    keys = _named(old)[KEYS].itertuples(index=False, name=None)
    for at, key in zip(old.index, keys, strict=True):
        old.loc[at, list(spoken.get(key, ()))] = None
    return old


def _combined(new: pd.DataFrame, old: pd.DataFrame) -> pd.DataFrame:
    """Rows of both, the new numbers over the old ones of the same run."""
    old, new = _named(old), _named(_unique(new))
    both = old.merge(new[[*KEYS, "draw"]], on=KEYS, how="left", suffixes=("", "_now"))
    # Of a run on another draw nothing stays.
    other = both["draw_now"].notna() & ~same(both["draw"], both["draw_now"])
    return pd.concat([old[~other.to_numpy()], new], ignore_index=True)


def same(draw: pd.Series, other: pd.Series) -> pd.Series:
    """Whether fingerprints of draws are equal but for rounding."""
    return (draw - other).abs() <= 1e-6 * other.abs()


def _digits(value: Any) -> Any:
    return f"{value:.{DIGITS}g}" if isinstance(value, float) and value == value else value
