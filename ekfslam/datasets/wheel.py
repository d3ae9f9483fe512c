"""Files that come inside the gtsam wheel, found without importing gtsam."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from ekfslam.errors import FileFormatError


def in_wheel(file: str, dataset: str) -> Path:
    """Where the gtsam wheel keeps a file.

    Raises
    ------
    FileFormatError
        If gtsam is not installed; names the dataset.
    """
    spec = find_spec("gtsam")
    if spec is None or spec.origin is None:
        raise FileFormatError(f"{dataset} comes with the gtsam package, which is not installed")
    return Path(spec.origin).parent / "Data" / file
