"""One experiment: some datasets, many estimators, five tables, figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from ekfslam.checks import checked_number
from ekfslam.dataset import Dataset
from ekfslam.datasets import RECORDED, is_recorded
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.estimates import FAILED, SKIPPED, Estimate
from ekfslam.evaluation import tables
from ekfslam.evaluation.landmarks import MATCH_RADIUS
from ekfslam.experiments.attempts import Stopped, Watch, attempt, named
from ekfslam.experiments.comparison import Comparison
from ekfslam.experiments.files import versions
from ekfslam.experiments.sources import open_dataset
from ekfslam.registry import Estimator

DATASETS = ("park", "victoria-park")
ESTIMATORS = ("ekf", "gtsam-batch", "gtsam-isam2", "dead-reckoning")
REFERENCE = "gtsam-batch"


def compare(
    datasets: str | Dataset | Sequence[str | Dataset] = DATASETS,
    estimators: str | Any | Sequence[str | Any] = ESTIMATORS,
    seed: int = 0,
    alignment: str = "none",
    rpe_distance: float = 10.0,
    path: str | Path | None = None,
    watch: Watch | None = None,
    match_radius: float = MATCH_RADIUS,
    withhold_ids: bool = False,
) -> Comparison:
    """Run estimators on datasets and tabulate them side by side.

    An estimator that raises, or does not apply, is a row with its status; the others finish.

    Parameters
    ----------
    datasets : str, Dataset or a sequence of them
        Scenarios, recorded sets, files; see `ekfslam.experiments.sources.open_dataset`.
    estimators : str, object or a sequence of them
        Registered names, ``module:Class``, either with options as in
        ``ekf(association=joint, confirm=3)``, or objects with ``estimate(dataset)``.
    seed : int
        Of the simulated datasets.
    alignment : {"none", "se2"}
        Rigid motion applied before errors are taken; none is right where the start is known.
    rpe_distance : float
        Length of the relative errors [m].
    path : path, optional
        Files of a recorded set.
    watch : callable, optional
        Told of progress.
    match_radius : float
        Where association is not known: distance [m] up to which a landmark is held against a true
        one.
    withhold_ids : bool
        Whether to withhold from the estimators who was seen; the scores of association keep it.

    Returns
    -------
    Comparison

    Raises
    ------
    UnknownNameError, InputError, FileFormatError
        For anything that cannot be found or read, before anything runs.
    Stopped
        For a `KeyboardInterrupt` once an estimate is finished: it is one, and has the comparison
        as far as it came.
    """
    if alignment not in ("none", "se2"):
        raise UnknownNameError("alignment", alignment, ["none", "se2"])
    for name, length in (("rpe_distance", rpe_distance), ("match_radius", match_radius)):
        if not 0 < checked_number(length, name) < np.inf:
            raise InputError(f"{name} must be a positive length [m], got {length}")
    subjects = named(_listed(estimators))
    listed = _listed(datasets)
    recorded = [str(each).partition("(")[0] for each in listed if not isinstance(each, Dataset)]
    if path is not None and not any(map(is_recorded, recorded)):
        raise InputError("a path is for recorded datasets, and there is none among these")
    sources = [_opened(source, seed, path) for source in listed]
    if withhold_ids:
        sources = [source.without_identities() for source in sources]
    opened = {dataset.name: dataset for dataset in sources}
    if len(opened) != len(sources):
        raise InputError("two datasets have the same name; the tables could not tell them apart")
    options = {"alignment": alignment, "rpe_distance": rpe_distance, "match_radius": match_radius}
    found: dict[tuple[str, str], _Found] = {}
    total = len(opened) * len(subjects)
    stopped = None
    try:
        for dataset in opened.values():
            # Increments and columns belong to the data: no estimator's clock counts them.
            _ = dataset.moves, dataset.sightings, dataset.offsets
            _run(subjects, dataset, watch, found, **options)
    except KeyboardInterrupt as interrupt:
        if not found:
            raise
        stopped = interrupt
    order = [(dataset, name) for dataset in opened for name in subjects]
    found = {cell: found[cell] for cell in order if cell in found}
    estimates = {cell: each.estimate for cell, each in found.items()}
    opened = {name: dataset for name, dataset in opened.items() if name in {d for d, _ in found}}
    config: dict[str, Any] = {
        "datasets": {name: _described(dataset) for name, dataset in opened.items()},
        "estimators": {name: _options(estimates, name) for name in subjects},
        "seed": seed,
        "alignment": alignment,
        "rpe_distance_m": rpe_distance,
        "match_radius_m": match_radius,
        "ids_withheld": withhold_ids,
        "path": None if path is None else str(path),
        "versions": versions(),
    }
    if stopped:
        config["unfinished"] = [list(cell) for cell in order if cell not in found]
    stacked = {
        table: tables.concat(table, [each.tables[table] for each in found.values()])
        for table in tables.SCHEMAS
    }
    comparison = Comparison(**stacked, datasets=opened, estimates=estimates, config=config)
    if stopped:
        raise Stopped(comparison, len(found), total) from stopped
    return comparison


class _Found(NamedTuple):
    """An estimate with its five tables."""

    estimate: Estimate
    tables: dict[str, pd.DataFrame]


def _opened(source: Any, seed: int, path: str | Path | None) -> Dataset:
    """A dataset; the path is for those that are recorded."""
    name = str(source).partition("(")[0].partition("/")[0].strip()
    given = RECORDED[name].given(name, path) if name in RECORDED else None
    return open_dataset(source, seed, given)


def _listed(value: Any) -> list[Any]:
    single = isinstance(value, str) or not isinstance(value, Iterable)
    items = [value] if single else list(value)
    if not items:
        raise InputError("nothing to compare: give at least one dataset and one estimator")
    return items


def _run(
    subjects: Mapping[str, Estimator],
    dataset: Dataset,
    watch: Watch | None,
    found: dict[tuple[str, str], _Found],
    **options: Any,
) -> None:
    """Add what is found; first that of the reference, which all are held against."""
    for name in sorted(subjects, key=lambda name: name != REFERENCE):
        best = found.get((dataset.name, REFERENCE))
        reference = best.estimate if best else None
        made = _estimated(name, subjects[name], dataset, watch, reference, **options)
        found[dataset.name, name] = made


def _estimated(
    name: str,
    subject: Estimator,
    dataset: Dataset,
    watch: Watch | None,
    reference: Estimate | None,
    alignment: str,
    **options: Any,
) -> _Found:
    """An estimate with its tables, which are made once."""
    made: dict[str, pd.DataFrame] = {}

    def tabulate(dataset: Dataset, estimate: Estimate) -> None:
        best = estimate if name == REFERENCE else reference
        made.update(_tabulate(dataset, estimate, alignment, reference=best, **options))

    estimate = attempt(name, subject, dataset, tabulate, alignment, watch)
    if estimate.status in (FAILED, SKIPPED):
        tabulate(dataset, estimate)
    return _Found(estimate, made)


def _tabulate(
    dataset: Dataset,
    estimate: Estimate,
    alignment: str = "none",
    rpe_distance: float = 10.0,
    reference: Estimate | None = None,
    match_radius: float = MATCH_RADIUS,
) -> dict[str, pd.DataFrame]:
    """The five tables of one estimate."""
    return {
        "summary": tables.summary_rows(
            dataset, estimate, alignment, rpe_distance, reference, match_radius
        ),
        "trajectories": tables.trajectories(dataset, estimate, alignment),
        "landmarks": tables.landmarks(dataset, estimate, alignment, match_radius),
        "innovations": tables.innovations(dataset, estimate),
        "association": tables.association(dataset, estimate),
    }


def _described(dataset: Dataset) -> dict[str, Any]:
    """Where a dataset comes from, and the models and noise that it states."""
    return {
        "provenance": dataset.provenance,
        "notes": list(dataset.notes),
        "seed": dataset.seed,
        "motion": [robot.motion.to_dict() for robot in dataset.robots],
        "sensors": [  # JSON has no infinity: a range without limit is left out
            {key: value for key, value in sensor.to_dict().items() if value != float("inf")}
            for sensor in dataset.sensors
        ],
    }


def _options(estimates: Mapping[tuple[str, str], Estimate], name: str) -> dict[str, Any]:
    """Options of an estimator as JSON can hold them; none of one that has not run."""
    of_it = (e.options for (_, estimator), e in estimates.items() if estimator == name)
    options = next(of_it, {})
    return {key: value if _plain(value) else str(value) for key, value in options.items()}


def _plain(value: Any) -> bool:
    return value is None or isinstance(value, str | int | float | bool)
