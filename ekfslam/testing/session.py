"""What the assertions share while tests run; imports nothing that takes time."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Record = dict[str, Any]
"""A row of a reference, of plain values, so that it can travel between processes."""


def _temporary() -> Path:
    return Path(tempfile.mkdtemp(prefix="ekfslam-"))


@dataclass
class Session:
    """A session of tests, or the script that asserts without one.

    Attributes
    ----------
    updating : bool
        Whether references are rewritten rather than compared with.
    place : callable
        Gives the folder of figures, which exists.
    root : Path
        What relative paths of references start from.
    test : str
        The test that runs now, as on pytest's command line; empty in a script.
    kept : dict
        Rows of the runs made so far: two assertions about the same run do not run it twice.
    rewritten : dict
        Rows of references to be written at the end, by file.
    """

    updating: bool = False
    place: Callable[[], Path] = _temporary
    root: Path = field(default_factory=Path)
    test: str = ""
    kept: dict[Any, list[Record]] = field(default_factory=dict)
    rewritten: dict[str, list[Record]] = field(default_factory=dict)

    @property
    def figures(self) -> Path:
        """Folder of the figures of the test that runs now; made when asked for."""
        folder = self.place() / re.sub(r"[^\w.=-]+", "-", self.test).strip("-")[-120:]
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def forget(self) -> None:
        """Run again what is asked for next, such as after code was patched."""
        self.kept.clear()


_sessions = [Session()]
"""The script's, and above it those of pytest, one in another where a plugin is tested."""


def current() -> Session:
    """The session that is running."""
    return _sessions[-1]


def enter(session: Session) -> None:
    """Begin a session."""
    _sessions.append(session)


def leave(session: Session) -> None:
    """End a session."""
    _sessions.remove(session)
