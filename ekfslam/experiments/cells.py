"""Cells of a campaign: what estimators make of one draw of a scenario, as rows of three tables.

A cell is a scenario, a seed and an estimator; those of one draw are worked on together, so that it
is simulated once and has one reference.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.estimates import FAILED, SKIPPED, Estimate
from ekfslam.evaluation import tables
from ekfslam.evaluation.run_metrics import run_metrics
from ekfslam.experiments.attempts import attempt
from ekfslam.experiments.files import versions
from ekfslam.experiments.rows import SCHEMAS, stacked, table_of
from ekfslam.registry import Estimator, estimator_name, origin, resolve
from ekfslam.simulation import Scenario, simulate

if TYPE_CHECKING:
    import pyarrow as pa


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


def work(unit: Unit) -> dict[str, pa.Table]:
    """Run the cells of a unit.

    What an estimator raises is a row; so is what the simulation does.

    Returns
    -------
    dict of pyarrow.Table
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
    return {name: stacked(name, [part[name] for part in parts]) for name in SCHEMAS}


def failed(unit: Unit, message: str) -> dict[str, pa.Table]:
    """Rows that say why there is no estimate."""
    shared = {"status": FAILED, "message": " ".join(message.split())}
    rows = [shared | {"estimator": name} | _keys(unit, name) for name in unit.estimators]
    parts = {"runs": rows, "steps": [], "timings": rows}
    return {name: table_of(name, some) for name, some in parts.items()}


def _cell(
    unit: Unit, dataset: Dataset, name: str, subject: Estimator, reference: Estimate | None
) -> dict[str, pa.Table]:
    """Rows of one estimator."""
    made: dict[str, pa.Table] = {}

    def tabulate(dataset: Dataset, estimate: Estimate) -> None:
        made.update(_tabulated(unit, dataset, estimate, reference))

    estimate = attempt(name, subject, dataset, tabulate)
    if estimate.status in (FAILED, SKIPPED):
        tabulate(dataset, estimate)
    return made


def _tabulated(
    unit: Unit, dataset: Dataset, estimate: Estimate, reference: Estimate | None
) -> dict[str, pa.Table]:
    summary = tables.summary_scalars(dataset, estimate, reference=reference)
    metrics = run_metrics(dataset, estimate, reference, unit.metrics.skip)
    kept = np.intersect1d(unit.metrics.kept(dataset.poses), np.arange(dataset.poses))
    paths = [
        {k: v[kept] if isinstance(v, np.ndarray) else v for k, v in columns.items()}
        for columns in tables.trajectory_columns(dataset, estimate)
    ]
    keys = _keys(unit, estimate.estimator)
    runs = [a | b | keys for a, b in zip(summary, metrics, strict=True)]
    return {
        "runs": table_of("runs", runs),
        "steps": table_of("steps", [path | keys for path in paths], len(kept)),
        "timings": table_of("timings", runs[:1]),
    }


def _keys(unit: Unit, estimator: str) -> dict[str, Any]:
    text = unit.estimators.get(estimator)  # none of a reference that is not in the campaign
    words = [versions_in_words(), origin(text) if text else ""]
    keys = {"campaign": unit.campaign, "scenario": unit.label, "scenario_hash": unit.digest}
    return keys | {"seed": unit.seed, "versions": ", ".join(filter(None, words))}


@cache
def versions_in_words() -> str:
    """What numbers may depend on: Python, machine and packages."""
    return ", ".join(f"{name} {v}" for name, v in versions().items() if name != "matplotlib")
