"""The study of association: its methods on the same draws of a dense world with clutter."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from ekfslam.errors import InputError
from ekfslam.experiments.attempts import Stopped, Watch
from ekfslam.experiments.files import versions, write_together
from ekfslam.experiments.study import NOISE, paired, summarised, sweep
from ekfslam.simulation import Scenario, load_scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KNOWN = "known"
METHODS = (
    KNOWN,
    "joint",
    "nearest",
    "global",
    "maximum-likelihood",
    "smallest-distance",
    "euclidean",
    "mahalanobis-first",
)
SCALES = (1.0, 2.0, 3.0, 4.0, 6.0)
RIVALS = ("joint", "nearest")

COLUMNS = {
    "association_precision": "precision",
    "association_recall": "recall",
    "ate_position_rmse_m": "ate_m",
    "nees_pose_mean": "nees",
    "landmarks_missed": "missed",
    "landmarks_spurious": "spurious",
    "landmarks_duplicate": "duplicate",
}
MEDIANS = ("ate_position_rmse_m", "nees_pose_mean")
KEPT = (
    f"dataset seed {NOISE} method estimator status message observations landmarks_true "
    "landmarks_estimated landmarks_missed landmarks_spurious landmarks_duplicate landmarks_merged "
    "association_precision association_recall ate_position_rmse_m ate_heading_rmse_rad "
    "landmark_rmse_m nees_pose_mean nees_pose_final nis_per_dof"
).split()


@dataclass(frozen=True, eq=False)
class AssociationStudy:
    """What the study found; columns are described in ``docs/association.md``.

    Attributes
    ----------
    runs : DataFrame
        A row per scale of noise, seed and method.
    summary : DataFrame
        A row per scale and method: means over the seeds, with their standard errors.
    paired : DataFrame
        A row per scale: the ATE of "joint" minus that of "nearest" on the same draws; no rows
        without the two of them.
    config : dict
        What was run, with versions.
    """

    runs: pd.DataFrame
    summary: pd.DataFrame
    paired: pd.DataFrame
    config: dict[str, Any]

    def plot(self) -> Figure:
        """Precision, recall, ATE and NEES against noise, with Monte-Carlo errors."""
        from ekfslam.plots import plot_study

        scenario, seeds = self.config["scenario"], self.config["seeds"]
        return plot_study(self.summary, f"{scenario}: mean of {seeds} seeds ± its standard error")

    def save(self, folder: str | Path) -> list[Path]:
        """Write tables (CSV), configuration (JSON) and figure (PNG and PDF), or nothing.

        Returns
        -------
        list of Path
            The files, in order.

        Raises
        ------
        InputError
            If the folder cannot be written to.
        """
        return write_together(folder, self._write)

    def _write(self, folder: Path) -> None:
        from ekfslam.plots import save

        for name in ("runs", "summary", "paired"):
            getattr(self, name).to_csv(folder / f"{name}.csv", index=False)
        (folder / "config.json").write_text(json.dumps(self.config, indent=2) + "\n")
        save(self.plot(), folder, "association")


def association_study(
    scenario: str | Scenario = "orchard",
    methods: Sequence[str] = METHODS,
    scales: Sequence[float] = SCALES,
    seeds: int = 10,
    confirm: int = 3,
    within: int = 8,
    workers: int = 1,
    watch: Watch | None = None,
) -> AssociationStudy:
    """Run the EKF with several methods of association at increasing odometry noise.

    Parameters
    ----------
    scenario : str or Scenario
        Of one robot.
    methods : sequence of str
        Of ``ekfslam.association``. "known" takes the identities and rejects clutter, which has
        none: what the others are measured against.
    scales : sequence of float
        Of the odometry noise, stated and drawn.
    seeds : int
        How many draws at each scale; every method gets the same ones.
    confirm, within : int
        Of tentative landmarks, see `ekfslam.Ekf`; "known" has no use for them.
    workers : int
        Processes; the outcome does not depend on them.
    watch : callable, optional
        As for `sweep`.

    Returns
    -------
    AssociationStudy

    Raises
    ------
    UnknownNameError, InputError, FileFormatError
        As `sweep`; and for a method that there is not, or a scenario of several robots.
    Stopped
        As `sweep`, with the study of the draws that are finished.
    """
    scenario = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    if len(scenario.robot_plans) > 1:
        raise InputError(f"{scenario.name} has several robots; this study is for one")
    # Methods that do not ask for identities do not see them, so that one dataset serves them all.
    scenario = replace(scenario, association="known")
    waiting = f"confirm={confirm}, within={within}"
    estimators = {
        f"ekf(association={m}" + (")" if m == KNOWN else f", {waiting})"): m for m in methods
    }
    if len(estimators) < len(methods):
        raise InputError(f"a method is given twice in {', '.join(methods)}")
    stopped = None
    try:
        runs = sweep(scenario, list(estimators), scales, seeds, workers, watch)
    except Stopped as stop:
        runs, stopped = stop.found, stop
    runs["method"] = runs["estimator"].map(estimators)
    runs = runs[KEPT]
    summary = summarised(runs, ["dataset", NOISE, "method"], COLUMNS, MEDIANS)
    both = set(RIVALS) <= set(methods)
    config = {
        "study": "association",
        "scenario": scenario.name,
        "methods": list(methods),
        "scales": [float(scale) for scale in scales],
        "seeds": seeds,
        "confirm": confirm,
        "within": within,
        "versions": versions(),
    }
    if stopped:
        config["draws_done"] = stopped.done
    compared = runs if both else runs.iloc[:0]
    study = AssociationStudy(
        runs, summary, paired(compared, "method", *RIVALS, MEDIANS[0], "ate_m"), config
    )
    if stopped:
        raise Stopped(study, stopped.done, stopped.total) from stopped
    return study
