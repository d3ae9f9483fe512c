"""One experiment: some datasets, many estimators, five tables, figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ekfslam.checks import checked_number
from ekfslam.dataset import Dataset
from ekfslam.datasets import RECORDED, is_recorded
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.estimates import FAILED, SKIPPED, Estimate
from ekfslam.evaluation import tables
from ekfslam.evaluation.landmarks import MATCH_RADIUS
from ekfslam.experiments.attempts import Watch, attempt, named
from ekfslam.experiments.files import versions
from ekfslam.experiments.saving import save_comparison
from ekfslam.experiments.sources import open_dataset
from ekfslam.registry import Estimator

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DATASETS = ("park", "victoria-park")
ESTIMATORS = ("ekf", "gtsam-batch", "gtsam-isam2", "dead-reckoning")
REFERENCE = "gtsam-batch"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Estimators side by side on the same datasets.

    Attributes
    ----------
    summary, trajectories, landmarks, innovations, association : DataFrame
        The tidy tables; columns in ``docs/tables.md``.
    datasets : dict
        The `Dataset` of each name.
    estimates : dict
        The `Estimate` of each (dataset, estimator).
    config : dict
        What was run, with versions and seed.
    """

    summary: pd.DataFrame
    trajectories: pd.DataFrame
    landmarks: pd.DataFrame
    innovations: pd.DataFrame
    association: pd.DataFrame
    datasets: Mapping[str, Dataset]
    estimates: Mapping[tuple[str, str], Estimate]
    config: Mapping[str, Any]

    def plot_map(self, dataset: str | None = None) -> Figure:
        """Map with trajectories, landmarks and 3-sigma ellipses.

        Parameters
        ----------
        dataset : str, optional
            Name; the first one by default.
        """
        from ekfslam.plots import plot_map

        name = self._name(dataset)
        return plot_map(self._of(self.trajectories, name), self._of(self.landmarks, name))

    def plot_errors(self, dataset: str | None = None, robot: str | None = None) -> Figure:
        """Error against time with the estimator's own 3-sigma band.

        Parameters
        ----------
        dataset : str, optional
            Name; the first one by default.
        robot : str, optional
            Name, where there are several; the first one by default.
        """
        from ekfslam.plots import plot_errors

        return plot_errors(self._of(self.trajectories, self._name(dataset)), robot)

    def plot_consistency(self, dataset: str | None = None, robot: str | None = None) -> Figure:
        """NEES and NIS against their chi-square intervals.

        Parameters
        ----------
        dataset, robot : str, optional
            As for `plot_errors`.
        """
        from ekfslam.plots import plot_consistency

        name = self._name(dataset)
        notes = self.datasets[name].notes
        return plot_consistency(self._of(self.trajectories, name), robot, notes)

    def plot_times(self, dataset: str | None = None) -> Figure:
        """Time per step."""
        from ekfslam.plots import plot_times

        return plot_times(self._of(self.trajectories, self._name(dataset)))

    def save(
        self,
        folder: str | Path,
        figures: bool = True,
        kept: Sequence[str] = tuple(tables.SCHEMAS),
        form: str = "auto",
        every: int = 1,
        watch: Watch | None = None,
    ) -> list[Path]:
        """Write tables (CSV or Parquet), configuration (JSON) and figures (PNG and PDF).

        The folder is made if needed. Files appear when all of them have been written; if anything
        goes wrong, none does. Of several robots each has figures of its errors and consistency. A
        table that was there in the other form goes.

        Parameters
        ----------
        folder : path
        figures : bool
            Drawn from all steps.
        kept : sequence of str
            Names of the tables; all by default.
        form : {"auto", "csv", "parquet"}
            Of the tables: "auto" is CSV for all but those of more than 200,000 rows.
        every : int
            Of the tables that have rows for each step, write those of every so many steps, from 0
            on, and of the last one; config.json then says so.
        watch : callable, optional
            Told of progress, file by file.

        Returns
        -------
        list of Path
            The files, in order.

        Raises
        ------
        InputError
            If the folder cannot be written to, or `every` is not a whole number from 1 on.
        UnknownNameError
            For another form.
        """
        return save_comparison(self, folder, figures, kept, form, every, watch)

    def _name(self, dataset: str | None) -> str:
        if dataset is None:
            return next(iter(self.datasets))
        if dataset not in self.datasets:
            raise UnknownNameError("dataset of this comparison", dataset, self.datasets)
        return dataset

    @staticmethod
    def _of(table: pd.DataFrame, dataset: str) -> pd.DataFrame:
        return table[table["dataset"] == dataset]

    def _repr_html_(self) -> str:
        notes = [f"{name}: {note}" for name, each in self.datasets.items() for note in each.notes]
        told = "".join(f"<p>{escape(note)}</p>\n" for note in notes)
        return f"{self.summary.to_html(index=False, na_rep='')}\n{told}"


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
    parts: dict[str, list[pd.DataFrame]] = {name: [] for name in tables.SCHEMAS}
    estimates: dict[tuple[str, str], Estimate] = {}
    for dataset in opened.values():
        # Increments and columns belong to the data: no estimator's clock counts them.
        _ = dataset.moves, dataset.sightings, dataset.offsets
        found = _run(
            subjects,
            dataset,
            watch,
            alignment=alignment,
            rpe_distance=rpe_distance,
            match_radius=match_radius,
        )
        for name, (estimate, made) in found.items():
            estimates[dataset.name, name] = estimate
            for table, rows in made.items():
                parts[table].append(rows)
    config = {
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
    stacked = {name: tables.concat(name, rows) for name, rows in parts.items()}
    return Comparison(**stacked, datasets=opened, estimates=estimates, config=config)


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
    subjects: Mapping[str, Estimator], dataset: Dataset, watch: Watch | None, **options: Any
) -> dict[str, tuple[Estimate, dict[str, pd.DataFrame]]]:
    """Estimates with their tables; first that of the reference, which all are held against."""
    found: dict[str, tuple[Estimate, dict[str, pd.DataFrame]]] = {}
    for name in sorted(subjects, key=lambda name: name != REFERENCE):
        reference = found[REFERENCE][0] if REFERENCE in found else None
        found[name] = _estimated(name, subjects[name], dataset, watch, reference, **options)
    return {name: found[name] for name in subjects}


def _estimated(
    name: str,
    subject: Estimator,
    dataset: Dataset,
    watch: Watch | None,
    reference: Estimate | None,
    alignment: str,
    **options: Any,
) -> tuple[Estimate, dict[str, pd.DataFrame]]:
    """An estimate with its tables, which are made once."""
    made: dict[str, pd.DataFrame] = {}

    def tabulate(dataset: Dataset, estimate: Estimate) -> None:
        best = estimate if name == REFERENCE else reference
        made.update(_tabulate(dataset, estimate, alignment, reference=best, **options))

    estimate = attempt(name, subject, dataset, tabulate, alignment, watch)
    if estimate.status in (FAILED, SKIPPED):
        tabulate(dataset, estimate)
    return estimate, made


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
    options = next(e.options for (_, estimator), e in estimates.items() if estimator == name)
    return {key: value if _plain(value) else str(value) for key, value in options.items()}


def _plain(value: Any) -> bool:
    return value is None or isinstance(value, str | int | float | bool)
