"""Graph files with 2-D poses and landmarks (``.g2o``, ``.graph``, ``.pyfg``)."""

from __future__ import annotations

from pathlib import Path

from ekfslam.dataset import Dataset
from ekfslam.errors import UnsupportedError

SUFFIXES = (".g2o", ".graph", ".pyfg")


def load(path: str | Path) -> Dataset:
    """Read a graph file."""
    raise UnsupportedError(f"{path}: not yet")
