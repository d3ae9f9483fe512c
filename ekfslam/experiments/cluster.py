"""Units of work in this process, on a cluster of this machine, or on one that is there: Dask.

Wherever a unit runs it gives the same bytes: what it needs comes with it, and libraries of linear
algebra keep to one thread, so that workers do not fight over the cores either.
"""

from __future__ import annotations

import logging
import os
import signal
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

from threadpoolctl import threadpool_limits

from ekfslam.errors import EkfslamError, InputError
from ekfslam.experiments.cells import Unit, failed, work
from ekfslam.experiments.store import packed
from ekfslam.registry import resolve

if TYPE_CHECKING:
    from distributed import Client

logger = logging.getLogger(__name__)

Done = tuple[Unit, dict[str, bytes]]

LIVES = 3  # workers that a unit may take with it before it is given up
AHEAD = 3  # tasks per thread that the scheduler knows of: none has to wait for this process
LONG = 1.0  # [s] that a task may take: units that are shorter share one, or the cluster is busier
TOGETHER = 16  # with handing out tasks than with work; but no more than so many
PATIENCE = "10s"  # for a scheduler to answer
SETTINGS = {
    "distributed.scheduler.allowed-failures": LIVES - 1,
    "distributed.scheduler.worker-saturation": 1.0,  # a worker has one task, and loses no other
    "distributed.worker.multiprocessing-method": "spawn",
    # What nobody looks at here takes time from the work: a profile of it, and of the machine.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "10s",
    # A worker that dies is started again. This is for machines that vanish: a worker that is not
    # back after it, since it has died once more, would be given up for good.
    "distributed.deploy.lost-worker-timeout": "10000h",
}


def run_units(
    units: Sequence[Unit], workers: int = 1, scheduler: str | None = None
) -> Iterator[Done]:
    """Work on units, which come back as they finish, with their tables as files.

    What was being worked on when a worker died runs again. Units that have taken `LIVES` workers
    with them are tried one by one, a single one is split into its estimators; an estimator that
    does so alone gives a row that says so.

    Parameters
    ----------
    units : sequence of Unit
    workers : int
        Processes on this machine; 1 is this process.
    scheduler : str, optional
        Address of a Dask cluster to use instead.

    Raises
    ------
    InputError
        If there is no scheduler at that address, it is lost, or its workers lack a module.
    """
    if not units:
        return
    if scheduler is None and workers == 1:
        for unit in units:
            yield unit, alone(unit)
        return
    with _connected(min(workers, len(units)), scheduler) as client:
        yield from _finished(client, units)


def alone(unit: Unit) -> dict[str, bytes]:
    """The tables of a unit as files, made with one thread."""
    _load(tuple(unit.estimators.values()))
    with threadpool_limits(1):
        return packed(work(unit))


@cache
def _load(estimators: tuple[str, ...]) -> None:
    """Load the libraries whose threads are to be told, where the work is done."""
    for text in estimators:
        try:
            resolve(text)
        except EkfslamError as error:  # as one that can travel back from a worker
            raise InputError(str(error)) from None


@contextmanager
def _connected(workers: int, scheduler: str | None) -> Iterator[Client]:
    """A client of a new cluster, which goes when it does, or of one that is there."""
    import dask  # takes a moment
    from distributed import Client, LocalCluster
    from distributed.comm import resolve_address

    with ExitStack() as stack:
        stack.enter_context(dask.config.set(SETTINGS))
        cluster: Any = scheduler
        if scheduler is None:
            stack.enter_context(_environment_kept())
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    memory_limit=0,  # a matter for the system: nothing is kept on workers
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                    preload=__name__,
                )
            )
        try:
            if scheduler is not None:  # no client of an address that is none can be closed
                resolve_address(scheduler)
            client = Client(cluster, set_as_default=False, timeout=PATIENCE)
        except (OSError, ValueError) as error:
            raise InputError(f"no Dask scheduler at {scheduler}: {error}") from None
        yield stack.enter_context(client)


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C to the process that the workers are of; Dask calls this on each of them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _environment_kept() -> Iterator[None]:
    """Undo what a cluster sets for its workers in the environment of this process."""
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


def together(units: Sequence[Unit]) -> tuple[list[dict[str, bytes]], float]:
    """The files of some units, and the time that one took [s]."""
    begin = time.perf_counter()
    files = [alone(unit) for unit in units]
    return files, (time.perf_counter() - begin) / len(units)


def _finished(client: Client, units: Sequence[Unit]) -> Iterator[Done]:
    from distributed import KilledWorker, as_completed
    from distributed.client import FutureCancelledError

    waiting = deque(units)
    suspects: deque[Unit] = deque()  # that killed workers with others: one by one
    running: dict[Any, list[Unit]] = {}
    finished = as_completed(loop=client.loop)

    def hand_out(share: int) -> None:
        threads = max(1, sum(client.nthreads().values()))
        while (waiting or suspects) and len(running) < AHEAD * threads:
            fair = -(-len(waiting) // (AHEAD * threads))  # at the end all are busy equally long
            some = [suspects.popleft()] if suspects else _taken(waiting, min(share, fair))
            future = client.submit(together, some, pure=False)
            running[future.key] = some
            finished.add(future)

    hand_out(1)
    share = 1
    for future in finished:
        some = running.pop(future.key)
        done: list[Done] = []
        try:
            files, each = future.result()
            done = list(zip(some, files, strict=True))
            share = max(1, min(TOGETHER, int(LONG / each)))
        except KilledWorker:
            (unit, *others) = some
            logger.warning("workers died, %d of them, at %s and %d more", LIVES, unit, len(others))
            if others:
                suspects.extend(some)
            elif len(unit.estimators) > 1:
                suspects.extend(unit.alone())
            else:
                died = failed(unit, "the worker died, each time that it ran")
                done = [(unit, packed(died))]
        except FutureCancelledError:
            raise InputError("the connection to the Dask scheduler is lost") from None
        except ImportError as error:
            raise InputError(f"a worker cannot run {some[0]}: {error}") from None
        hand_out(share)
        yield from done


def _taken(waiting: deque[Unit], count: int) -> list[Unit]:
    """The next units, at least one."""
    return [waiting.popleft() for _ in range(max(1, count))]
