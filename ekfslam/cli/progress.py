"""How long work takes still, on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

MEMORY = 900  # [s] of which the time left is made: the cells of a campaign are of unequal length


@contextmanager
def progress() -> Iterator[Callable[[str, str, int, int], None]]:
    """A progress bar with the time left, gone when the work is done."""
    import logging

    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    told = logging.getLogger("ekfslam").isEnabledFor(logging.INFO)  # line by line, with --verbose
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty() or told,
        speed_estimate_period=MEMORY,
    ) as bar:
        task = bar.add_task("", total=None)

        def watch(dataset: str, estimator: str, done: int, total: int) -> None:
            words = ": ".join(filter(None, [dataset, estimator])).replace("[", r"\[")
            bar.update(task, description=words, completed=done, total=total)

        yield watch
