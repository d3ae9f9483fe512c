"""The study of partial observations: how bearings and ranges start a landmark, compared."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ekfslam.evaluation import judged, tables
from ekfslam.experiments.attempts import Watch, attempt, named
from ekfslam.experiments.files import versions, write_together
from ekfslam.experiments.sources import open_dataset
from ekfslam.experiments.study import summarised, sweep

CASES: Mapping[str, tuple[str, ...]] = {
    "cloister-bearing": (
        "ekf",
        "ekf(linearity=0.1)",
        "ekf(bearings=naive)",
        "gtsam-batch",
    ),
    "cloister-range": (
        "ekf",
        "ekf(ranges=bank)",
        "ekf(ranges=naive)",
        "gtsam-batch",
    ),
}
"""Estimators of each simulated scenario."""

RECORDED = ("plaza1", "plaza2")
ON_RECORDED = ("ekf", "ekf(ranges=bank)", "gtsam-batch", "gtsam-isam2")
COLUMNS = {
    "nees_pose_final": "nees_final",
    "ate_position_rmse_m": "ate_m",
    "landmark_rmse_m": "landmark_m",
    "landmarks_estimated": "landmarks",
}
MEDIANS = ("nees_pose_final", "ate_position_rmse_m")
KEPT = [
    "dataset",
    "seed",
    "estimator",
    "series",
    "status",
    "message",
    "landmarks_true",
    "landmarks_estimated",
    "landmarks_undetermined",
    "ate_position_rmse_m",
    "landmark_rmse_m",
    "landmark_max_m",
    "nees_pose_mean",
    "nees_pose_final",
    "nis_per_dof",
]


@dataclass(frozen=True, eq=False)
class PartialStudy:
    """What the study found; columns are described in ``docs/partial.md``.

    Attributes
    ----------
    runs : DataFrame
        A row per scenario, seed and estimator.
    summary : DataFrame
        A row per scenario and estimator: means over the seeds, with their standard errors.
    recorded : DataFrame
        A row per recorded set, estimator and series: path error as estimated, beacons after the
        path is aligned with the truth.
    config : dict
        What was run, with versions.
    """

    runs: pd.DataFrame
    summary: pd.DataFrame
    recorded: pd.DataFrame
    config: dict[str, Any]

    def save(self, folder: str | Path) -> list[Path]:
        """Write tables (CSV) and configuration (JSON), or nothing.

        Raises
        ------
        InputError
            If the folder cannot be written to.
        """
        return write_together(folder, self._write)

    def _write(self, folder: Path) -> None:
        for name in ("runs", "summary", "recorded"):
            getattr(self, name).to_csv(folder / f"{name}.csv", index=False)
        (folder / "config.json").write_text(json.dumps(self.config, indent=2) + "\n")


def partial_study(
    seeds: int = 50,
    recorded: Sequence[str] = RECORDED,
    workers: int = 1,
    watch: Watch | None = None,
) -> PartialStudy:
    """Compare ways to start a landmark from bearings and from ranges.

    Parameters
    ----------
    seeds : int
        Draws of each scenario.
    recorded : sequence of str
        Recorded sets of ranges.
    workers : int
        Processes for the draws; the outcome does not depend on them.
    watch : callable, optional
        As for `ekfslam.experiments.study.sweep`.

    Returns
    -------
    PartialStudy

    Raises
    ------
    UnknownNameError, InputError, FileFormatError
        For what cannot be found or makes no sense.
    """
    runs = pd.concat(
        [
            sweep(scenario, estimators, seeds=seeds, workers=workers, watch=watch)
            for scenario, estimators in CASES.items()
        ],
        ignore_index=True,
    )[KEPT]
    config = {
        "study": "partial",
        "cases": {scenario: list(estimators) for scenario, estimators in CASES.items()},
        "seeds": seeds,
        "recorded": list(recorded),
        "on_recorded": list(ON_RECORDED),
        "versions": versions(),
    }
    summary = summarised(runs, ["dataset", "estimator"], COLUMNS, MEDIANS)
    return PartialStudy(runs, summary, _on_recorded(recorded, watch), config)


def _on_recorded(names: Sequence[str], watch: Watch | None) -> pd.DataFrame:
    """Rows of the summary for recorded sets; errors of beacons with the path aligned."""
    rows = []
    for name in names:
        dataset = open_dataset(name)
        for label, subject in named(ON_RECORDED).items():
            if watch is not None:
                watch(name, label, 0, dataset.poses)
            estimate = attempt(label, subject, dataset, tables.summary_rows)
            estimate = judged(dataset, estimate)
            plain = tables.summary_rows(dataset, estimate)[KEPT]
            aligned = tables.summary_rows(dataset, estimate, alignment="se2")
            for column in ("ate_position_rmse_m", "landmark_rmse_m", "landmark_max_m"):
                plain[f"aligned_{column}"] = aligned[column].to_numpy()
            rows.append(plain)
    return pd.concat(rows, ignore_index=True) if rows else pd.DataFrame(columns=KEPT)
