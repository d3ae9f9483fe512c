"""What statistics over runs need of each run, beyond the table `summary`.

Sums are kept where numbers of several runs are pooled, so that the pooled ones are exact. Columns
are described in ``docs/tables.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.estimates import Estimate
from ekfslam.evaluation.consistency import squared_mahalanobis, validate
from ekfslam.evaluation.runs import Run, quiet, runs
from ekfslam.evaluation.schema import REAL, WHOLE, schema_of
from ekfslam.evaluation.statistics import mean, share_inside
from ekfslam.evaluation.whiteness import whiteness
from ekfslam.geometry import Array

RUN_METRICS: Mapping[str, str] = schema_of(
    (WHOLE, "steps_skipped"),
    (REAL, "nees_pose_mean_kept nees_pose_invariant_mean_kept"),
    (REAL, "nees_position_mean_kept nees_position_invariant_mean_kept nees_heading_mean_kept"),
    (REAL, "nees_pose_inside_95_kept nees_pose_invariant_inside_95_kept"),
    (REAL, "nees_pose_invariant_final"),
    (REAL, "position_mse_kept_m2 heading_mse_kept_rad2"),
    (REAL, "final_position_error_m final_position_sigma_m"),
    (REAL, "final_heading_error_rad final_heading_sigma_rad"),
    (REAL, "nis_sum"),
    (WHOLE, "nis_dof_sum"),
    (REAL, "white_cross white_before white_after"),
    (WHOLE, "white_terms graph_dof"),
    (REAL, "gap_final_mahalanobis2"),
)
"""Columns of a row, in order, with their dtypes."""


@quiet
def run_metrics(
    dataset: Dataset, estimate: Estimate, reference: Estimate | None = None, skip: int = 0
) -> list[dict[str, Any]]:
    """Scalars of one run for statistics over runs: a row per robot and series.

    Nothing is aligned.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
    reference : Estimate, optional
        A smoother's estimate of the same dataset, for the column ``gap_final_mahalanobis2``.
    skip : int
        Poses at the start that are left out of the columns ``_kept``, such as those of an exactly
        known start, where NEES means nothing yet.

    Returns
    -------
    list of dict
        In the order of `ekfslam.evaluation.tables.summary_rows`, one without numbers if there is no
        series. Every row has the columns of `RUN_METRICS`; what is undefined is None.

    Raises
    ------
    InputError
        If the estimate does not have the sizes of the dataset, or nothing is left after `skip`.
    """
    validate(dataset, estimate)
    if isinstance(skip, bool) or not isinstance(skip, int | np.integer):
        raise InputError(f"skip must be a whole number of poses, got {skip!r}")
    if not 0 <= skip < dataset.poses:
        raise InputError(f"skip must be from 0 to {dataset.poses - 1}, got {skip}")
    empty: dict[str, Any] = dict.fromkeys(RUN_METRICS)
    rows = [
        empty
        | {"steps_skipped": int(skip)}
        | _nees_scalars(run, skip)
        | _error_scalars(run, skip)
        | _gap_scalars(run, reference)
        | (_online_scalars(dataset, estimate, run) if run.name == "online" else _graph(estimate))
        for run in runs(dataset, estimate, "none")
    ]
    return [_without_nan(row) for row in rows] or [empty]


def _without_nan(row: dict[str, Any]) -> dict[str, Any]:
    return {name: None if value != value else value for name, value in row.items()}


def _nees_scalars(run: Run, skip: int) -> dict[str, float]:
    if run.series.covariances is None or not run.positions.any():
        return {}
    pose, invariant = run.nees[skip:], run.nees_invariant[skip:]
    covariances = run.series.covariances[skip:]
    error, xi = run.error[skip:], run.error_invariant[skip:]
    turned = geo.additive_to_invariant(run.series.poses[skip:], covariances)
    return {
        "nees_pose_mean_kept": mean(pose),
        "nees_pose_invariant_mean_kept": mean(invariant),
        "nees_position_mean_kept": mean(run.nees_position[skip:]),
        "nees_position_invariant_mean_kept": mean(_nees(xi, turned, slice(0, 2))),
        "nees_heading_mean_kept": mean(_nees(error, covariances, slice(2, 3))),
        "nees_pose_inside_95_kept": share_inside(pose, 3),
        "nees_pose_invariant_inside_95_kept": share_inside(invariant, 3),
        "nees_pose_invariant_final": float(run.nees_invariant[run.last_heading]),
    }


def _nees(errors: Array, covariances: Array, part: slice) -> Array:
    """NEES of some coordinates alone, in their marginal covariance."""
    return squared_mahalanobis(errors[:, part], covariances[:, part, part])


def _error_scalars(run: Run, skip: int) -> dict[str, float]:
    square = run.error**2
    position, heading = square[:, :2].sum(axis=1), square[:, 2]
    kept = np.arange(len(square)) >= skip
    scalars = {
        "position_mse_kept_m2": _mean(position[kept & run.positions]),
        "heading_mse_kept_rad2": _mean(heading[kept & run.headings]),
        "final_position_error_m": float(np.sqrt(position[run.last_position])),
        "final_heading_error_rad": float(np.sqrt(heading[run.last_heading])),
    }
    if run.series.covariances is not None:
        where = run.series.covariances[[run.last_position, run.last_heading]]
        scalars["final_position_sigma_m"] = float(np.sqrt(where[0, 0, 0] + where[0, 1, 1]))
        scalars["final_heading_sigma_rad"] = float(np.sqrt(where[1, 2, 2]))
    return scalars


def _mean(values: Array) -> float:
    """NaN if one of them is NaN or there are none."""
    return float(values.mean()) if len(values) else float("nan")


def _gap_scalars(run: Run, reference: Estimate | None) -> dict[str, float]:
    final = None if reference is None else reference.final_trajectory
    if final is None:
        return {}
    best = final.of_robot(run.robot)
    if best.covariances is None:
        return {}
    gap = geo.additive_error(best.poses[-1], run.series.poses[-1])
    return {"gap_final_mahalanobis2": float(squared_mahalanobis(gap, best.covariances[-1]))}


def _online_scalars(dataset: Dataset, estimate: Estimate, run: Run) -> dict[str, float]:
    scalars: dict[str, float] = {}
    if estimate.step_nis is not None and estimate.step_dof is not None:
        steps = np.isfinite(estimate.step_nis) & (estimate.step_dof > 0)
        scalars["nis_sum"] = float(estimate.step_nis[steps].sum())
        scalars["nis_dof_sum"] = int(estimate.step_dof[steps].sum())
    if (sums := whiteness(dataset, estimate, run.robot)) is not None:
        scalars |= {f"white_{name}": value for name, value in sums._asdict().items()}
    return scalars


def _graph(estimate: Estimate) -> dict[str, float]:
    return {"graph_dof": estimate.graph_dof} if estimate.graph_dof > 0 else {}
