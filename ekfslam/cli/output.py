"""What scripts read: one JSON document or one CSV table on standard output, and nothing else."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ekfslam import __version__

if TYPE_CHECKING:
    import pandas as pd


def check_output(as_json: bool, as_csv: bool) -> None:
    """Refuse two things at once.

    Raises
    ------
    InputError
        If both are asked for.
    """
    from ekfslam.errors import InputError

    if as_json and as_csv:
        raise InputError("--json and --csv are two kinds of output: give one of them")


def print_json(command: str, **content: Any) -> None:
    """Print a document, with the version and the command that it is of."""
    document = {"ekfslam": __version__, "command": command} | content
    print(json.dumps(plain(document), indent=2, allow_nan=False))


def print_csv(table: pd.DataFrame) -> None:
    """Print a table as the file of it would be."""
    table.to_csv(sys.stdout, index=False)


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows by column."""
    return table.to_dict("records")  # type: ignore[return-value]


def plain(value: Any) -> Any:
    """As JSON holds it: what is no finite number is null."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "item"):  # a number of NumPy's
        return plain(value.item())
    return value if isinstance(value, float) and math.isfinite(value) else None


def tell(words: str) -> None:
    """Say something that is no output, on standard error."""
    print(words, file=sys.stderr)


def told_files(files: Sequence[Path]) -> str:
    """What was written into a folder, in words."""
    return f"{len(files)} files in {files[0].parent}: {', '.join(path.name for path in files)}"
