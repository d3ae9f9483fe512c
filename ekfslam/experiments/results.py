"""What a campaign found: its tables, statistics of them, and files beside them."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ekfslam.errors import FileFormatError, InputError
from ekfslam.evaluation.monte_carlo import summarise
from ekfslam.evaluation.over_time import nees_over_time
from ekfslam.evaluation.paired import PAIRS, compare_pairs
from ekfslam.experiments.files import write_together
from ekfslam.experiments.rows import SCHEMAS
from ekfslam.experiments.store import Store, identity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = ("nees-over-time", "run-means", "errors-over-time", "pairs", "sweep", "option")
EXPORTS = ("runs", "summary", "nees_over_time", "pairs", "timings")
# The same text for each of a million steps stays on disk.
LEFT_OUT = {"runs": (), "steps": ("campaign", "versions"), "timings": ()}


@dataclass(frozen=True, eq=False)
class CampaignResults:
    """Results of a campaign, whether it is finished or not.

    Tables are in the order of the campaign's scenarios, then by seed, then in the order of its
    estimators; whoever did the work, they are the same. Columns are described in
    ``docs/tables.md``.

    Attributes
    ----------
    folder : Path
        Where they are kept.
    config : dict
        What was run, with versions.
    """

    folder: Path
    config: Mapping[str, Any]

    @cached_property
    def runs(self) -> pd.DataFrame:
        """A row per scenario, seed, estimator, robot and series."""
        return self._read("runs")

    @cached_property
    def steps(self) -> pd.DataFrame:
        """Errors, covariances and NEES at chosen steps of each run."""
        return self._read("steps")

    @cached_property
    def timings(self) -> pd.DataFrame:
        """What depends on the machine: a row per scenario, seed and estimator."""
        return self._read("timings")

    @cached_property
    def summary(self) -> pd.DataFrame:
        """Statistics over the runs, see `ekfslam.evaluation.monte_carlo.summarise`."""
        return summarise(self.runs, self.steps, self.config["metrics"]["diverged_above"])

    @cached_property
    def nees_over_time(self) -> pd.DataFrame:
        """Mean NEES at each kept step, see `ekfslam.evaluation.over_time.nees_over_time`."""
        return nees_over_time(self.steps)

    @cached_property
    def pairs(self) -> pd.DataFrame:
        """Estimators compared on the same seeds, see `ekfslam.evaluation.paired.compare_pairs`.

        Of an estimator with several series each is compared.
        """
        series = self.runs.groupby("estimator")["series"].unique()
        of = {name: _competitors(str(name), some) for name, some in series.items()}
        wanted = self.config["compare"]["pairs"]
        pairs = [(a, b) for x, y in wanted for a in of.get(x, ()) for b in of.get(y, ())]
        if not pairs:
            return pd.DataFrame(columns=list(PAIRS)).astype(dict(PAIRS))
        return compare_pairs(self.runs, self.config["compare"]["metrics"], pairs)

    @property
    def cells(self) -> tuple[int, int]:
        """How many cells are done, and how many there are in all."""
        done = self.runs.drop_duplicates(["scenario", "seed", "estimator"])
        of_each = sum(len(self._seeds_of(name)) for name in self.config["estimators"])
        return len(done), len(self.config["scenarios"]) * of_each

    def figures(self) -> dict[str, Figure]:
        """Figures by the stem of their files."""
        from ekfslam.plots.campaign import plot_campaign

        return plot_campaign(
            summary=self.summary,
            over_time=self.nees_over_time,
            runs=self.runs,
            pairs=self.pairs,
            config=self.config,
        )

    def save(self, figures: bool = True) -> list[Path]:
        """Write the tables as CSV, and figures as PNG and PDF, beside the Parquet files.

        Files appear when all of them have been written; if anything goes wrong, none does. Figures
        of an earlier state that there are no more go.

        Parameters
        ----------
        figures : bool

        Returns
        -------
        list of Path
            The files, in order.

        Raises
        ------
        InputError
            If the folder cannot be written to, or if it has tables of runs that it does not keep
            any more: these would be lost.
        """
        if not self.cells[0] and _holds_rows(self.folder / "summary.csv"):
            raise InputError(
                f"{self.folder}: its tables are of runs that are not here, and would be lost; "
                f"ekfslam report {self.folder} shows them, ekfslam campaign makes the runs anew"
            )
        written = write_together(self.folder, lambda place: self._write(place, figures))
        if figures:  # of an earlier state, and not of this one
            for path in set(filter(_is_figure, self.folder.iterdir())).difference(written):
                path.unlink()
        return written

    def _write(self, folder: Path, figures: bool) -> None:
        for name in EXPORTS:
            getattr(self, name).to_csv(folder / f"{name}.csv", index=False)
        if figures:
            from ekfslam.plots import save

            for stem, figure in self.figures().items():
                save(figure, folder, stem)

    def _read(self, table: str) -> pd.DataFrame:
        """Rows of the cells that the campaign wants, in its order."""
        metrics, seeds = self.config["metrics"]["digest"], set(self.config["seeds"])
        label_of = {each["hash"]: each["label"] for each in self.config["scenarios"]}
        store = Store(self.folder)
        names = []
        for name in store.names():
            digest, judged, seed = identity(name)
            if digest in label_of and judged == metrics and seed in seeds:
                names.append(name)
        columns = [name for name in SCHEMAS[table] if name not in LEFT_OUT[table]]
        rows = store.read(table, names, columns)
        rows["scenario"] = rows["scenario_hash"].map(label_of).astype("string")
        order = [
            _places(rows["estimator"], self.config["estimators"]),
            rows["seed"].to_numpy(dtype=np.int64),
            _places(rows["scenario_hash"], label_of),
        ]
        wanted = np.lexsort(order)
        wanted = wanted[(self._stated(rows) & (order[0] >= 0))[wanted]]
        return rows.iloc[wanted].reset_index(drop=True)

    def _seeds_of(self, estimator: str) -> list[int]:
        """Seeds that the campaign wants of an estimator."""
        return self.config["seeds"][: self.config.get("few_seeds", {}).get(estimator)]

    def _stated(self, rows: pd.DataFrame) -> np.ndarray:
        """Whether each row is of a seed that the campaign wants of its estimator."""
        stated = np.ones(len(rows), dtype=bool)
        for name in self.config.get("few_seeds", {}):
            of_it = (rows["estimator"] == name).to_numpy(dtype=bool)
            stated &= ~of_it | rows["seed"].isin(self._seeds_of(name)).to_numpy(dtype=bool)
        return stated

    def _repr_html_(self) -> str:
        return self.summary.to_html(index=False, na_rep="")


def _holds_rows(path: Path) -> bool:
    """Whether a CSV is there and has more than its header."""
    return path.exists() and len(path.read_bytes().splitlines()) > 1


def read_campaign(folder: str | Path) -> CampaignResults:
    """Results of a campaign that has been run, or is being run.

    Parameters
    ----------
    folder : path
        What ``--out`` named.

    Raises
    ------
    FileFormatError
        If no campaign is kept there.
    """
    path = Path(folder) / "config.json"
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
        _ = [config[key] for key in ("scenarios", "seeds", "estimators", "metrics", "compare")]
    except FileNotFoundError:
        raise FileFormatError(f"{folder}: no campaign is kept here, there is no {path}") from None
    except (OSError, ValueError, LookupError, TypeError):
        raise FileFormatError(f"{path}: damaged, or not of a campaign") from None
    return CampaignResults(Path(folder), config)


def _is_figure(path: Path) -> bool:
    return re.fullmatch(rf"({'|'.join(FIGURES)})(-\d+)?\.(png|pdf)", path.name) is not None


def _competitors(estimator: str, series: Collection[Any]) -> list[str]:
    """What an estimator is called where each of its series competes."""
    known = [name for name in series if isinstance(name, str)]
    return [f"{estimator} ({name})" for name in known] if len(known) > 1 else [estimator]


def _places(values: pd.Series, order: Collection[str]) -> np.ndarray:
    """Where each value stands in an order; -1 if it does not."""
    return values.map({name: place for place, name in enumerate(order)}).fillna(-1).to_numpy(int)
