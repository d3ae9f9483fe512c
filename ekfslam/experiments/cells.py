"""Cells of a campaign: what estimators make of one draw of a scenario, as rows of three tables.

A cell is a scenario, a seed and an estimator; those of one draw are worked on together, so that it
is simulated once and has one reference.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.estimates import FAILED, SKIPPED, Estimate
from ekfslam.evaluation import tables
from ekfslam.evaluation.run_metrics import RUN_METRICS, run_metrics
from ekfslam.evaluation.schema import REAL, TEXT, WHOLE
from ekfslam.experiments.compare import attempt
from ekfslam.experiments.files import versions
from ekfslam.registry import Estimator, estimator_name, resolve
from ekfslam.simulation import Scenario, simulate

KEYS = ("scenario", "seed", "robot", "estimator", "series")


def _schema(
    lead: tuple[str, ...], source: Mapping[str, str], leave_out: Callable[[str], bool]
) -> dict[str, str]:
    """The keys, then the columns of another table but for some, then the versions."""
    keys = dict.fromkeys(("campaign", "scenario", "scenario_hash"), TEXT)
    keys |= {name: WHOLE if name == "seed" else TEXT for name in lead}
    rest = {k: dtype for k, dtype in source.items() if k != "dataset" and not leave_out(k)}
    return keys | rest | {"versions": TEXT}


SUMMARY, TRAJECTORIES = tables.SCHEMAS["summary"], tables.SCHEMAS["trajectories"]
ELSEWHERE = ("x_m", "y_m", "theta_rad", "time_step_s")  # columns of trajectories

SCHEMAS: Mapping[str, Mapping[str, str]] = {
    "runs": _schema(
        (*KEYS[1:], "status", "message"),
        {**SUMMARY, **RUN_METRICS},
        lambda name: name.startswith("time_"),
    ),
    "steps": _schema(
        KEYS[1:],
        TRAJECTORIES,
        lambda name: name in ELSEWHERE or name.startswith("true_"),
    ),
    "timings": _schema(
        ("seed", "estimator"),
        {name: dtype for name, dtype in SUMMARY.items() if name.startswith("time_")},
        lambda name: False,
    ),
}
"""Columns of each table of a campaign, in order, with their dtypes."""

COMPARABLE = tuple(name for name, dtype in SCHEMAS["runs"].items() if dtype == REAL)
"""Columns of `runs` by which estimators can be compared."""


@dataclass(frozen=True)
class Metrics:
    """How runs are judged.

    Attributes
    ----------
    skip : int
        First steps that averages over a run leave out.
    every : int
        Which steps the table `steps` keeps: multiples of it, and the last one.
    steps : tuple of int, optional
        Those instead.
    reference : str, optional
        Estimator that gaps and sigma ratios refer to.
    diverged_above : float
        Mean pose NEES of a run above which it counts as diverged.
    """

    skip: int = 0
    every: int = 1
    steps: tuple[int, ...] | None = None
    reference: str | None = None
    diverged_above: float = 20.0

    def kept(self, poses: int) -> np.ndarray:
        """Steps of a run that the table `steps` keeps."""
        if self.steps is not None:
            return np.array(self.steps)
        return np.union1d(np.arange(0, poses, self.every), poses - 1)

    @property
    def digest(self) -> str:
        """Of what the rows of a cell depend on: cells of another one cannot be mixed in."""
        text = json.dumps([self.skip, self.every, self.steps, self.reference])
        return hashlib.sha256(text.encode()).hexdigest()[:8]


class Unit(NamedTuple):
    """Cells that share a draw.

    Attributes
    ----------
    campaign, label : str
        Columns ``campaign`` and ``scenario``.
    digest : str
        Column ``scenario_hash``.
    scenario : Scenario
    seed : int
    estimators : dict of str
        What they are called, and the text that they are made from.
    metrics : Metrics
    """

    campaign: str
    label: str
    digest: str
    scenario: Scenario
    seed: int
    estimators: Mapping[str, str]
    metrics: Metrics

    def __str__(self) -> str:
        return f"{self.label}, seed {self.seed}"

    def alone(self) -> list[Unit]:
        """A unit for each estimator."""
        return [self._replace(estimators={k: text}) for k, text in self.estimators.items()]


def work(unit: Unit) -> dict[str, pd.DataFrame]:
    """Run the cells of a unit.

    What an estimator raises is a row; so is what the simulation does.

    Returns
    -------
    dict of DataFrame
        Rows of the tables of `SCHEMAS`.

    Raises
    ------
    InputError, UnknownNameError
        For an estimator that cannot be made here.
    """
    subjects = {name: resolve(text) for name, text in unit.estimators.items()}
    referee = None if unit.metrics.reference is None else resolve(unit.metrics.reference)
    try:
        dataset = simulate(unit.scenario, seed=unit.seed)
        # Increments and columns belong to the data: no estimator's clock counts them.
        _ = dataset.moves, dataset.sightings, dataset.offsets
    except Exception as error:
        return failed(unit, f"{type(error).__name__}: {error}")
    parts, reference = [], None
    if referee is not None:
        name = estimator_name(str(unit.metrics.reference))
        reference = attempt(name, referee, dataset, lambda d, e: _tabulated(unit, d, e, e))
        if subjects.pop(name, None) is not None:
            parts.append(_tabulated(unit, dataset, reference, reference))
    parts += [_cell(unit, dataset, name, each, reference) for name, each in subjects.items()]
    stacked = {name: pd.concat([part[name] for part in parts]) for name in SCHEMAS}
    return {name: shaped(name, table.assign(**_keys(unit))) for name, table in stacked.items()}


def failed(unit: Unit, message: str) -> dict[str, pd.DataFrame]:
    """Rows that say why there is no estimate."""
    names = list(unit.estimators)
    keys: dict[str, Any] = _keys(unit) | {"seed": unit.seed, "estimator": names}
    rows = {"runs": pd.DataFrame(keys | {"status": FAILED, "message": " ".join(message.split())})}
    rows |= {"steps": pd.DataFrame(), "timings": pd.DataFrame(keys)}
    return {name: shaped(name, table) for name, table in rows.items()}


def shaped(name: str, table: pd.DataFrame) -> pd.DataFrame:
    """The columns of a table of `SCHEMAS`, in order and with their dtypes; empty where missing."""
    schema = SCHEMAS[name]
    return table.reindex(columns=list(schema)).astype(dict(schema))


def _cell(
    unit: Unit, dataset: Dataset, name: str, subject: Estimator, reference: Estimate | None
) -> dict[str, pd.DataFrame]:
    """Rows of one estimator."""
    made: dict[str, pd.DataFrame] = {}

    def tabulate(dataset: Dataset, estimate: Estimate) -> None:
        made.update(_tabulated(unit, dataset, estimate, reference))

    estimate = attempt(name, subject, dataset, tabulate)
    if estimate.status in (FAILED, SKIPPED):
        tabulate(dataset, estimate)
    return made


def _tabulated(
    unit: Unit, dataset: Dataset, estimate: Estimate, reference: Estimate | None
) -> dict[str, pd.DataFrame]:
    summary = tables.summary_rows(dataset, estimate, reference=reference)
    metrics = pd.DataFrame(run_metrics(dataset, estimate, reference, unit.metrics.skip))
    path = tables.trajectories(dataset, estimate)
    kept = path["step"].isin(unit.metrics.kept(dataset.poses))
    return {
        "runs": pd.concat([summary, metrics], axis=1),
        "steps": path[kept],
        "timings": summary.head(1),
    }


def _keys(unit: Unit) -> dict[str, str]:
    keys = {"campaign": unit.campaign, "scenario": unit.label, "scenario_hash": unit.digest}
    return keys | {"versions": versions_in_words()}


@cache
def versions_in_words() -> str:
    """What numbers may depend on: Python, machine and packages."""
    return ", ".join(f"{name} {v}" for name, v in versions().items() if name != "matplotlib")
