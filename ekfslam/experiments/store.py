"""Where the rows of a campaign are kept: three Parquet datasets in one folder.

``runs/``, ``steps/`` and ``timings/`` hold a file for every unit of work, of the same name in each:
scenario, how runs are judged, seed, estimators. `pandas.read_parquet` reads each folder as one
table. A unit is done when its file in ``runs`` is there, which is written last; every file appears
whole or not at all, so that a campaign may end at any moment and nothing half done is ever read.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from ekfslam.errors import FileFormatError, InputError
from ekfslam.experiments.cells import Unit
from ekfslam.experiments.files import SCRATCH
from ekfslam.experiments.rows import SCHEMAS, arrow_schema
from ekfslam.storage import atomic_write

try:
    import fcntl
except ImportError:  # not so on Windows, where nothing keeps two campaigns apart
    fcntl = None  # type: ignore[assignment]

TABLES = ("steps", "timings", "runs")  # the one that says that a unit is done comes last
SUPERSEDED = "superseded"
FILE = "__filename"
_NAME = re.compile(r"[0-9a-f]+-[0-9a-f]+-\d+-[0-9a-f]+\.parquet")
_UNFINISHED = re.compile(rf"\.{_NAME.pattern}\.")
PANDAS = {pa.string(): pd.StringDtype(), pa.int64(): pd.Int64Dtype()}


def packed(tables: Mapping[str, pa.Table]) -> dict[str, bytes]:
    """Tables as Parquet files; the same rows give the same bytes."""
    return {name: _parquet(tables[name]) for name in TABLES}


def _parquet(table: pa.Table) -> bytes:
    stream = BytesIO()
    pq.write_table(table.combine_chunks(), stream, compression="zstd")
    return stream.getvalue()


class Store:
    """The folder of a campaign.

    Parameters
    ----------
    folder : path
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Keep other campaigns out of the folder, which is made if needed, and tidy it.

        What a campaign that was killed has left half done is removed.

        Raises
        ------
        InputError
            If another campaign is at work there, or the folder cannot be written to.
        """
        handle = None
        try:
            for name in TABLES:
                (self.folder / name).mkdir(parents=True, exist_ok=True)
            handle = os.open(self.folder / ".lock", os.O_CREAT | os.O_RDWR, 0o666)
            if fcntl is not None:  # the system releases it, however the process ends
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._tidy()
        except OSError as error:
            if handle is not None:
                os.close(handle)
            if isinstance(error, BlockingIOError):
                raise InputError(f"another campaign is at work in {self.folder}") from None
            raise InputError(f"cannot write to {self.folder}: {error.strerror}") from None
        try:
            yield
        finally:
            os.close(handle)

    def _tidy(self) -> None:
        for scratch in self.folder.glob(f"{SCRATCH}*"):
            shutil.rmtree(scratch, ignore_errors=True)
        done = set(self.names())
        for table in TABLES:
            for path in (self.folder / table).iterdir():
                ours = _NAME.fullmatch(path.name) or _UNFINISHED.match(path.name)
                if ours and path.name not in done:
                    path.unlink()

    def names(self) -> list[str]:
        """Files of the units that are done, in order."""
        place = self.folder / "runs"
        found = [path.name for path in place.iterdir()] if place.is_dir() else []
        return sorted(filter(_NAME.fullmatch, found))

    def add(self, name: str, files: Mapping[str, bytes]) -> None:
        """Keep the tables of a unit; it is done when this returns.

        Raises
        ------
        InputError
            If they cannot be written; then nothing of the unit is there.
        """
        try:
            for table in TABLES:
                with atomic_write(self.folder / table / name) as stream:
                    stream.write(files[table])
                _sync(self.folder / table)
        except InputError:
            for table in TABLES[:-1]:
                with suppress(OSError):
                    (self.folder / table / name).unlink(missing_ok=True)
            raise

    def set_aside(self, names: Collection[str]) -> None:
        """Move units out of the datasets into the folder ``superseded``."""
        for name in names:
            for table in reversed(TABLES):
                source, target = (self.folder / f / table / name for f in ("", SUPERSEDED))
                target.parent.mkdir(parents=True, exist_ok=True)
                if source.exists():
                    os.replace(source, target)

    def read(
        self, table: str, names: Collection[str], columns: Collection[str] | None = None
    ) -> pd.DataFrame:
        """Rows of some units, unit by unit.

        Parameters
        ----------
        table : {"runs", "steps", "timings"}
        names : collection of str
        columns : collection of str, optional
            Those of the table by default. `FILE` is the name of the file of a row.

        Raises
        ------
        FileFormatError
            For a file that is damaged.
        """
        columns = list(columns or SCHEMAS[table])
        paths = [str(self.folder / table / name) for name in names]
        try:
            dataset = ds.dataset(paths, schema=arrow_schema(table), format="parquet")
            found = dataset.to_table(columns=columns)
        except (pa.ArrowException, OSError) as error:
            text = " ".join(str(error).split())
            raise FileFormatError(
                f"{self.folder}: a file is damaged, remove it and its work is done again ({text})"
            ) from None
        frame = found.to_pandas(types_mapper=PANDAS.get)
        return frame.assign(**{FILE: frame[FILE].map(os.path.basename)}) if FILE in frame else frame


def _sync(folder: Path) -> None:
    """See to it that names in a folder outlast a loss of power, where the system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def unit_name(unit: Unit) -> str:
    """What the files of a unit are called."""
    estimators = hashlib.sha256("\n".join(sorted(unit.estimators)).encode()).hexdigest()[:8]
    return f"{unit.digest}-{unit.metrics.digest}-{unit.seed}-{estimators}.parquet"


class Identity(NamedTuple):
    """What the name of a file says of its rows: scenario, how runs are judged, and seed."""

    digest: str
    metrics: str
    seed: int


def identity(name: str) -> Identity:
    """Read the name of a file, as `unit_name` makes it."""
    digest, metrics, seed, _ = name.split("-")
    return Identity(digest, metrics, int(seed))
