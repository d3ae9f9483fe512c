"""Files of a comparison: its tables, whole or thinned, its configuration and its figures."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pandas as pd

from ekfslam.experiments.attempts import Watch
from ekfslam.experiments.files import check_form, write_table, write_together

if TYPE_CHECKING:
    from ekfslam.experiments.compare import Comparison

FIGURES = ("map", "times")
FIGURES_OF_A_ROBOT = ("errors", "consistency")
OF_STEPS = ("trajectories", "innovations", "association")
"""Tables that have rows for each step."""


class _File(NamedTuple):
    """A piece of work: what is written, of which dataset, and how."""

    dataset: str
    what: str
    write: Callable[[], None]


def save_comparison(
    comparison: Comparison,
    folder: str | Path,
    figures: bool,
    kept: Sequence[str],
    form: str,
    every: int,
    watch: Watch | None,
) -> list[Path]:
    """Write tables, configuration and figures; `Comparison.save` says what of each."""
    check_form(form, every)

    def write(place: Path) -> None:
        config = {**comparison.config, "files_every": every} if every > 1 else comparison.config
        (place / "config.json").write_text(json.dumps(config, indent=2) + "\n")
        work = [
            _File("", name, partial(_write, comparison, place, name, form, every)) for name in kept
        ]
        work += _drawings(comparison, place) if figures else []
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
    save(drawn, folder, _stem(dataset, *(whose if several else ()), figure))


def _stem(*words: str) -> str:
    """Name of a file; names may come from a file that somebody else wrote."""
    return "-".join(re.sub(r"[^\w.-]+", "-", word).strip(".-") or "dataset" for word in words)
