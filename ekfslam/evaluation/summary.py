"""The table `summary`: the scalars of an estimate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.estimates import Estimate, LandmarkEstimates
from ekfslam.evaluation.association import (
    AssociationScores,
    association_scores,
    count_landmarks,
)
from ekfslam.evaluation.consistency import gaps, validate
from ekfslam.evaluation.landmarks import MATCH_RADIUS, match_landmarks, true_positions
from ekfslam.evaluation.runs import Run, aligned_map, landmark_nees, quiet, row_keys, runs
from ekfslam.evaluation.schema import concat, filled
from ekfslam.evaluation.statistics import largest, mean, rmse, share_inside
from ekfslam.evaluation.trajectory import absolute_errors, relative_errors
from ekfslam.geometry import Array
from ekfslam.robots import Robot


def summary_rows(
    dataset: Dataset,
    estimate: Estimate,
    alignment: str = "none",
    rpe_distance: float = 10.0,
    reference: Estimate | None = None,
    match_radius: float = MATCH_RADIUS,
) -> pd.DataFrame:
    """Scalars of an estimate, one row per robot and series; without a series one without numbers.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
        With its status; `ekfslam.evaluation.judged` finds the diverged ones.
    alignment : {"none", "se2"}
        Motion applied to poses and landmarks before their errors, never before NEES.
    rpe_distance : float
        Length of the relative errors [m].
    reference : Estimate, optional
        The batch estimate of the same dataset, for the columns ``gap_`` and ``sigma_ratio_``.
    match_radius : float
        Distance [m] up to which a landmark is held against a true one, see `match_landmarks`.

    Returns
    -------
    DataFrame
        Columns of `SCHEMAS["summary"]`.

    Raises
    ------
    InputError
        If the estimate does not have the sizes of the dataset, or a distance is not positive.
    UnknownNameError
        For another alignment.
    """
    rows = summary_scalars(dataset, estimate, alignment, rpe_distance, reference, match_radius)
    return concat("summary", [filled("summary", row, 1) for row in rows])


@quiet
def summary_scalars(
    dataset: Dataset,
    estimate: Estimate,
    alignment: str = "none",
    rpe_distance: float = 10.0,
    reference: Estimate | None = None,
    match_radius: float = MATCH_RADIUS,
) -> list[dict[str, Any]]:
    """The rows of `summary_rows`, by column; what is undefined may be left out.

    Parameters and errors are those of `summary_rows`.
    """
    validate(dataset, estimate)
    shared = (
        {"association": estimate.association, "status": estimate.status}
        | {"message": estimate.message, "steps": dataset.poses}
        | _landmark_counts(dataset, estimate)
        | _times(estimate)
    )
    scores = association_scores(dataset, estimate)
    rows = [
        row_keys(dataset, estimate, run.robot)
        | shared
        | {"series": run.name, "alignment": _applied(dataset, alignment)}
        | {"message": _message(estimate, run)}
        | {"truth_poses": int(run.positions.sum())}
        | {"observations": int((dataset.observations.robot == run.robot).sum())}
        | _association_scalars(dataset, scores, run.robot)
        | _pose_scalars(run, rpe_distance)
        | _map_scalars(dataset, estimate, match_radius, run.motion)
        | (_online_scalars(estimate) if run.name == "online" else _graph_scalars(estimate))
        | _gap_scalars(dataset, estimate, run, reference)
        for run in runs(dataset, estimate, alignment)
    ]
    alone = {
        "truth_poses": sum(map(_true_positions, dataset.robots)),
        "observations": len(dataset.observations),
    }
    return rows or [row_keys(dataset, estimate) | shared | alone]


# Values of the columns --------------------------------------------------------------------------


def _true_positions(robot: Robot) -> int:
    """How many of its poses have a true position."""
    return 0 if robot.truth is None else int(np.isfinite(robot.truth[:, 0]).sum())


def _applied(dataset: Dataset, alignment: str) -> str:
    """Without a truth there is nothing to align with."""
    return alignment if any(map(_true_positions, dataset.robots)) else "none"


def _message(estimate: Estimate, run: Run) -> str:
    """What the estimator said, and at how many poses NEES had to be skipped."""
    # Of whole poses, or of positions where no heading is known.
    nees, known = run.nees, run.headings
    if not known.any():
        nees, known = run.nees_position, run.positions
    if run.series.covariances is not None:  # where it was not recovered, nothing was skipped
        known = known & np.isfinite(run.series.covariances).all(axis=(1, 2))
    skipped = 0 if run.series.covariances is None else int(np.isnan(nees[known]).sum())
    note = f"NEES skipped at {skipped} of {int(known.sum())} poses (singular covariance)"
    return "; ".join(filter(None, [estimate.message, note if skipped else ""]))


def _landmark_counts(dataset: Dataset, estimate: Estimate) -> dict[str, Any]:
    counts, estimated = count_landmarks(dataset, estimate), estimate.landmarks
    columns: dict[str, Any] = {
        f"landmarks_{name}": number for name, number in counts._asdict().items()
    }
    if estimated is not None:
        opened = estimated.undetermined
        columns["landmarks_estimated"] = len(estimated)
        columns["landmarks_undetermined"] = 0 if opened is None else len(opened)
    return columns


def _association_scalars(
    dataset: Dataset, scores: AssociationScores | None, robot: int
) -> dict[str, float]:
    if scores is None:
        return {}
    mine = scores.rows(dataset.observations.robot == robot)
    return {"association_precision": mine.precision, "association_recall": mine.recall}


def _map_scalars(
    dataset: Dataset, estimate: Estimate, radius: float, motion: Array
) -> dict[str, Any]:
    identity = match_landmarks(dataset, estimate, radius, motion)
    if estimate.landmarks is None:
        return {}
    scalars = _landmark_scalars(estimate.landmarks, true_positions(dataset, identity), motion)
    return {"landmarks_matched": int((identity >= 0).sum())} | scalars


def _pose_scalars(run: Run, rpe_distance: float) -> dict[str, float]:
    ate = absolute_errors(run.aligned, run.truth)
    # Left out is what has no truth; a pose that is not finite where it is known leaves it empty.
    position, heading = ate.position[run.positions], ate.heading[run.headings]
    rpe = relative_errors(run.series.poses, run.truth, rpe_distance)
    return {
        "ate_position_rmse_m": rmse(position),
        "ate_position_max_m": largest(position),
        "ate_heading_rmse_rad": rmse(heading),
        "rpe_position_rmse_m": rmse(rpe.position),
        "rpe_heading_rmse_rad": rmse(rpe.heading),
        "nees_pose_mean": mean(run.nees),
        "nees_pose_final": float(run.nees[run.last_heading]),
        "nees_pose_invariant_mean": mean(run.nees_invariant),
        "nees_pose_inside_95": share_inside(run.nees, 3),
        "nees_position_mean": mean(run.nees_position),
        "nees_position_inside_95": share_inside(run.nees_position, 2),
    }


def _landmark_scalars(
    landmarks: LandmarkEstimates, truth: Array, motion: Array
) -> dict[str, float]:
    """Errors and NEES of the landmarks whose true position (L, 2) is known."""
    matched = np.isfinite(truth).all(axis=1)
    if not matched.any():
        return {}
    error = (aligned_map(landmarks, motion) - truth)[matched]
    size = np.hypot(error[:, 0], error[:, 1])
    return {
        "landmark_rmse_m": rmse(size),
        "landmark_max_m": float(size.max()),
        "nees_landmark_mean": mean(landmark_nees(landmarks, truth)),
    }


def _online_scalars(estimate: Estimate) -> dict[str, float]:
    return _nis_scalars(estimate) | _sample_scalars(estimate)


def _sample_scalars(estimate: Estimate) -> dict[str, float]:
    """How many particles carried the weight."""
    samples = estimate.effective_samples
    if samples is None:
        return {}
    known = samples[np.isfinite(samples)]
    least = float(known.min()) if len(known) else float("nan")
    return {"effective_samples_mean": mean(known), "effective_samples_min": least}


def _nis_scalars(estimate: Estimate) -> dict[str, float]:
    if estimate.step_nis is None or estimate.step_dof is None:
        return {}
    rows = np.isfinite(estimate.step_nis) & (estimate.step_dof > 0)
    if not rows.any():
        return {}
    nis, dof = estimate.step_nis[rows], estimate.step_dof[rows]
    return {"nis_per_dof": float(nis.sum() / dof.sum()), "nis_inside_95": share_inside(nis, dof)}


def _graph_scalars(estimate: Estimate) -> dict[str, float]:
    scalars = {"graph_error": estimate.graph_error}
    if estimate.graph_dof > 0:
        scalars["graph_chi2_per_dof"] = 2.0 * estimate.graph_error / estimate.graph_dof
    return scalars


def _gap_scalars(
    dataset: Dataset, estimate: Estimate, run: Run, reference: Estimate | None
) -> dict[str, float]:
    if reference is None:
        return {}
    gap = gaps(dataset, estimate, run.series, reference, run.robot)
    return {
        "gap_final_position_m": gap.final_position,
        "gap_final_heading_rad": gap.final_heading,
        "gap_landmark_rmse_m": gap.landmark_rmse,
        "sigma_ratio_position": gap.sigma_ratio_position,
        "sigma_ratio_heading": gap.sigma_ratio_heading,
    }


def _times(estimate: Estimate) -> dict[str, float]:
    times = {"time_total_s": estimate.time_total, "time_marginals_s": estimate.time_marginals}
    if estimate.step_seconds is not None:
        median, p99 = np.percentile(estimate.step_seconds, [50, 99]) * 1e6
        times |= {
            "time_per_step_mean_us": float(np.mean(estimate.step_seconds) * 1e6),
            "time_per_step_median_us": float(median),
            "time_per_step_p99_us": float(p99),
        }
    return times
