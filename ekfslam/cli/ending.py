"""How a command ends: its exit status, one line for a user's mistake, signals, closed pipes."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import typer

DONE, NEGATIVE, MISTAKE, FAULT = 0, 1, 2, 3
INTERRUPTED, CLOSED, TERMINATED = 130, 141, 143  # as a shell counts them: 128 and the signal
ASK = "an error that is nobody's input: please report it with the lines above"


def ended(run: Callable[[], Any]) -> int:
    """The exit status of what is run; what it raises is said on standard error.

    Parameters
    ----------
    run : callable
        Returns a status, or None for that of work that is done.
    """
    try:
        with _terminable() as terminated:
            try:
                status = run() or DONE
            except (KeyboardInterrupt, typer.Abort):
                status = INTERRUPTED
        if status == INTERRUPTED and terminated:
            status = TERMINATED
    except SystemExit as stop:  # the parser has seen that nobody reads on
        closed = isinstance(stop.__context__, BrokenPipeError)
        status = CLOSED if closed else int(stop.code or DONE)
    except BrokenPipeError:
        status = CLOSED
    except Exception as error:
        status = _told(error)
    return _flushed(status)


def _told(error: Exception) -> int:
    """Say what went wrong: in a line, if the user can mend it."""
    from ekfslam.errors import EkfslamError

    if isinstance(error, EkfslamError):
        return refused(str(error))
    if isinstance(error, MemoryError):
        return refused(f"not enough memory: {error}")
    if isinstance(error, OSError):
        return _unwritten(error)
    if hasattr(error, "format_message"):  # what the parser itself refuses
        asked = getattr(getattr(error, "ctx", None), "command_path", "ekfslam")
        said = error.format_message()  # nothing where it has shown the help instead
        return refused(f"{said} ({asked} --help)") if said else MISTAKE
    traceback.print_exception(error)
    print(f"ekfslam: {ASK}", file=sys.stderr)
    return FAULT


def refused(message: str) -> int:
    """Say in one line what the user can mend."""
    print(f"ekfslam: {' '.join(message.split())}", file=sys.stderr)
    return MISTAKE


def _unwritten(error: OSError) -> int:
    """Say what the system refuses; of standard output it does not say the name."""
    where = error.filename or "cannot write to standard output"
    return refused(f"{where}: {error.strerror or error}")


@contextmanager
def _terminable() -> Iterator[list[int]]:
    """Take SIGTERM as Ctrl-C, so that the same is left behind; a list that is not empty then."""
    taken: list[int] = []

    def stop(number: int, _: Any) -> None:
        taken.append(number)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield taken
    finally:
        signal.signal(signal.SIGTERM, before)


def _flushed(status: int) -> int:
    """Write what is written still, where a full disk or a closed pipe shows."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        status = CLOSED
    except OSError as error:
        status = status if status == MISTAKE else _unwritten(error)  # once is enough
    else:
        return status
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python complains at exit
    return status
