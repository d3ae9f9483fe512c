"""Campaigns to test with: small ones, and estimators that misbehave."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

from threadpoolctl import threadpool_info

from ekfslam.errors import UnsupportedError
from ekfslam.experiments import read_campaign
from ekfslam.registry import resolve

SMALL = {
    "name": "small",
    "seeds": 3,
    "estimators": ["ekf", "dead-reckoning"],
    "scenarios": [
        {
            "name": "loop-15",
            "set": {"path": {"repeat": 12}},
            "sweep": {"motion.sigmas": [[0.01, 0.02], [0.01, 0.06]]},
        }
    ],
    "metrics": {"skip": 3, "steps": {"every": 5}},
    "compare": {"baseline": "ekf"},
}
"""Two variants, three seeds, two estimators: twelve cells in six units."""

TABLES = ("runs", "summary", "nees_over_time", "pairs")


def tables(folder):
    """What a campaign says, as bytes: everything but the timings."""
    results = read_campaign(folder)
    texts = {name: getattr(results, name).to_csv(index=False) for name in TABLES}
    return texts | {"steps": results.steps.to_csv(index=False)}


def files(folder):
    """The Parquet files of a campaign with their bytes, but for the timings."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for table in ("runs", "steps")
        for path in sorted((Path(folder) / table).iterdir())
    }


class Deadly:
    """Dead reckoning that kills the process it runs in at one seed: the first time, or always.

    Who was run is told in the file runs.log of the working folder.
    """

    def __init__(self, seed=1, always=False):
        self.seed, self.always = seed, always

    def estimate(self, dataset):
        with open("runs.log", "a") as log:
            log.write(f"{dataset.seed}\n")
        if dataset.seed == self.seed and (self.always or _first("died")):
            os.kill(os.getpid(), signal.SIGKILL)
        return resolve("dead-reckoning").estimate(dataset)


def _first(flag):
    """Whether nobody asked before."""
    try:
        os.close(os.open(flag, os.O_CREAT | os.O_EXCL))
        return True
    except FileExistsError:
        return False


class Broken:
    """Raises at odd seeds."""

    def estimate(self, dataset):
        if dataset.seed % 2:
            raise RuntimeError("odd\nseeds")
        return resolve("dead-reckoning").estimate(dataset)


class Quitting:
    """Ends the process, as a script would."""

    def estimate(self, dataset):
        sys.exit("enough")


class Never:
    """Raises at every seed."""

    def estimate(self, dataset):
        raise RuntimeError("no")


class Refusing:
    """Does not apply."""

    def estimate(self, dataset):
        raise UnsupportedError("not for me")


class Nonsense:
    """Says of its time what is no number."""

    def estimate(self, dataset):
        return replace(resolve("dead-reckoning").estimate(dataset), time_total="soon")


class Threads:
    """Tells how many threads linear algebra may use."""

    def estimate(self, dataset):
        raise RuntimeError(str(max(pool["num_threads"] for pool in threadpool_info())))
