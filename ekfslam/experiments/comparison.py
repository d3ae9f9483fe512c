"""What a comparison found: its tables and figures, and the files that they become."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.errors import UnknownNameError
from ekfslam.estimates import FAILED, SKIPPED, Estimate
from ekfslam.evaluation import tables
from ekfslam.experiments.attempts import Watch
from ekfslam.experiments.files import check_form, stem, write_table, write_together

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = ("map", "times")
FIGURES_OF_A_ROBOT = ("errors", "consistency")
OF_STEPS = ("trajectories", "innovations", "association")
"""Tables that have rows for each step."""


class _File(NamedTuple):
    """A piece of work: what is written, of which dataset, and how."""

    dataset: str
    what: str
    write: Callable[[], None]


def without_estimate(summary: pd.DataFrame) -> dict[str, str]:
    """Estimators of which the rows of a dataset hold no estimate: why, by name."""
    once = summary.drop_duplicates("estimator").set_index("estimator")["status"]
    return {str(who): why for who, why in once.items() if why in (FAILED, SKIPPED)}


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

    def plot_map(self, dataset: str | None = None, **options: Any) -> Figure:
        """Map with trajectories, landmarks and 3-sigma ellipses.

        Where nobody maps landmarks, those of the known map are shown.

        Parameters
        ----------
        dataset : str, optional
            Name; the first one by default.
        **options
            Of `ekfslam.plots.plot_map`, such as the `width` of the figure [in].
        """
        from ekfslam.plots import plot_map

        name = self._name(dataset)
        options = {"absent": self._absent(name)} | options
        landmarks, known = self._of(self.landmarks, name), self.datasets[name].known_map
        if known is not None and landmarks.empty:
            options = {"known": known.positions} | options
        return plot_map(self._of(self.trajectories, name), landmarks, **options)

    def plot_errors(
        self, dataset: str | None = None, robot: str | None = None, **options: Any
    ) -> Figure:
        """Error against time with the estimator's own 3-sigma band.

        Parameters
        ----------
        dataset : str, optional
            Name; the first one by default.
        robot : str, optional
            Name, where there are several; the first one by default.
        **options
            Of `ekfslam.plots.plot_errors`.
        """
        from ekfslam.plots import plot_errors

        name = self._name(dataset)
        options = {"absent": self._absent(name)} | options
        return plot_errors(self._of(self.trajectories, name), robot, **options)

    def plot_consistency(
        self, dataset: str | None = None, robot: str | None = None, **options: Any
    ) -> Figure:
        """NEES and NIS against their chi-square intervals.

        Parameters
        ----------
        dataset, robot : str, optional
            As for `plot_errors`.
        **options
            Of `ekfslam.plots.plot_consistency`.
        """
        from ekfslam.plots import plot_consistency

        name = self._name(dataset)
        notes = self.datasets[name].notes
        options = {"absent": self._absent(name)} | options
        return plot_consistency(self._of(self.trajectories, name), robot, notes, **options)

    def plot_times(self, dataset: str | None = None, **options: Any) -> Figure:
        """Time per step; options are those of `ekfslam.plots.plot_times`."""
        from ekfslam.plots import plot_times

        name = self._name(dataset)
        options = {"absent": self._absent(name)} | options
        return plot_times(self._of(self.trajectories, name), **options)

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
        check_form(form, every)

        def write(place: Path) -> None:
            config = {**self.config, "files_every": every} if every > 1 else self.config
            (place / "config.json").write_text(json.dumps(config, indent=2) + "\n")
            work = [
                _File("", name, partial(_write, self, place, name, form, every)) for name in kept
            ]
            work += _drawings(self, place) if figures else []
            for done, file in enumerate(work):
                if watch is not None:
                    watch(file.dataset, file.what, done, len(work))
                file.write()

        written = write_together(folder, write)
        for path in written:
            if path.stem in kept:  # of an earlier state, and in the other form
                other = ".csv" if path.suffix == ".parquet" else ".parquet"
                path.with_suffix(other).unlink(missing_ok=True)
        return written

    def _name(self, dataset: str | None) -> str:
        if dataset is None:
            return next(iter(self.datasets))
        if dataset not in self.datasets:
            raise UnknownNameError("dataset of this comparison", dataset, self.datasets)
        return dataset

    def _absent(self, dataset: str) -> dict[str, str]:
        return without_estimate(self._of(self.summary, dataset))

    @staticmethod
    def _of(table: pd.DataFrame, dataset: str) -> pd.DataFrame:
        return table[table["dataset"] == dataset]

    def _repr_html_(self) -> str:
        notes = [f"{name}: {note}" for name, each in self.datasets.items() for note in each.notes]
        told = "".join(f"<p>{escape(note)}</p>\n" for note in notes)
        return f"{self.summary.to_html(index=False, na_rep='')}\n{told}"


def _write(comparison: Comparison, folder: Path, name: str, form: str, every: int) -> None:
    table = getattr(comparison, name)
    if name in OF_STEPS and every > 1:
        table = _thinned(table, every, {d.name: d.poses - 1 for d in comparison.datasets.values()})
    write_table(table, folder, name, form)


def _thinned(table: pd.DataFrame, every: int, last: dict[str, int]) -> pd.DataFrame:
    """Rows of every so many steps, and of the last one of each dataset."""
    ends = table["dataset"].map(last)
    return table[(table["step"] % every == 0) | (table["step"] == ends)]


def _drawings(comparison: Comparison, folder: Path) -> list[_File]:
    work = []
    for name, dataset in comparison.datasets.items():
        of_it = comparison.trajectories[comparison.trajectories["dataset"] == name]
        drawn_of = set(of_it["robot"])  # none, if all are skipped
        robots = [robot.name for robot in dataset.robots if robot.name in drawn_of]
        kinds: list[tuple[str, str | None]] = [(figure, None) for figure in FIGURES]
        kinds += [(figure, robot) for robot in robots for figure in FIGURES_OF_A_ROBOT]
        work += [_File(name, f, partial(_draw, comparison, folder, name, f, r)) for f, r in kinds]
    return work


def _draw(
    comparison: Comparison, folder: Path, dataset: str, figure: str, robot: str | None
) -> None:
    from ekfslam.plots import save

    whose = () if robot is None else (robot,)
    drawn = getattr(comparison, f"plot_{figure}")(dataset, *whose)
    several = len(comparison.datasets[dataset].robots) > 1
    save(drawn, folder, stem(dataset, *(whose if several else ()), figure))
