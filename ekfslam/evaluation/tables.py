"""The four tidy tables of an estimate: `summary`, `trajectories`, `landmarks`, `innovations`.

Columns are described in ``docs/tables.md``; their dtypes are in `ekfslam.evaluation.schema`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.estimates import Decision, Estimate, LandmarkEstimates, Trajectory
from ekfslam.evaluation.consistency import (
    gaps,
    pose_nees,
    pose_nees_invariant,
    squared_mahalanobis,
    validate,
)
from ekfslam.evaluation.landmarks import LandmarkMatch, match_landmarks, true_positions
from ekfslam.evaluation.schema import SCHEMAS, concat, filled, read_csv
from ekfslam.evaluation.statistics import mean, rmse, share_inside
from ekfslam.evaluation.trajectory import absolute_errors, alignment_motion, relative_errors
from ekfslam.geometry import Array

__all__ = [
    "SCHEMAS",
    "concat",
    "innovations",
    "landmarks",
    "read_csv",
    "summary_rows",
    "trajectories",
]

# A run that has gone wrong holds NaN, inf or numbers whose squares overflow: its errors are empty
# or infinite, which is the answer and no reason to warn.
_quiet = np.errstate(over="ignore", invalid="ignore", divide="ignore")


# The tables of one estimate ---------------------------------------------------------------------


@_quiet
def summary_rows(
    dataset: Dataset,
    estimate: Estimate,
    alignment: str = "none",
    rpe_distance: float = 10.0,
    reference: Estimate | None = None,
) -> pd.DataFrame:
    """Scalars of an estimate, one row per series; one row without numbers if it has no series.

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

    Returns
    -------
    DataFrame
        Columns of `SCHEMAS["summary"]`.

    Raises
    ------
    InputError
        If the estimate does not have the sizes of the dataset, or the distance is not positive.
    UnknownNameError
        For another alignment.
    """
    validate(dataset, estimate)
    match = match_landmarks(dataset, estimate)
    true_map = true_positions(dataset, match.true_landmark)
    shared = (
        _keys(dataset, estimate)
        | {"association": estimate.association, "status": estimate.status}
        | {"message": estimate.message}
        | {"steps": dataset.poses, "observations": len(dataset.observations)}
        | _landmark_counts(estimate, match)
        | _times(estimate)
    )
    rows = [
        shared
        | {"series": name, "alignment": _applied(dataset, alignment)}
        | {"message": _message(dataset, estimate, series)}
        | _pose_scalars(dataset, series, alignment, rpe_distance)
        | _landmark_scalars(estimate, true_map, _motion(dataset, series, alignment))
        | (_nis_scalars(estimate) if name == "online" else _graph_scalars(estimate))
        | _gap_scalars(dataset, estimate, series, reference)
        for name, series in _finite_series(estimate).items()
    ]
    return concat("summary", [filled("summary", row, 1) for row in rows or [shared]])


@_quiet
def trajectories(dataset: Dataset, estimate: Estimate, alignment: str = "none") -> pd.DataFrame:
    """Every pose of every series against the truth.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
    alignment : {"none", "se2"}
        Applied to the poses and errors shown; covariances and NEES are those of the estimate.

    Returns
    -------
    DataFrame
        Columns of `SCHEMAS["trajectories"]`.

    Raises
    ------
    InputError, UnknownNameError
        As `summary_rows`.
    """
    validate(dataset, estimate)
    truth = _truth(dataset)
    tables = []
    for name, series in _finite_series(estimate).items():
        poses = geo.compose(_motion(dataset, series, alignment), series.poses)
        error = geo.additive_error(truth, poses)
        nees, nees_invariant = _nees(dataset, series)
        columns: dict[str, Any] = {
            "series": name,
            "step": np.arange(dataset.poses),
            "time_s": dataset.times,
            "error_position_m": np.hypot(error[:, 0], error[:, 1]),
            "nees": nees,
            "nees_invariant": nees_invariant,
            "time_step_s": estimate.step_seconds,
        }
        columns |= _columns("x_m y_m theta_rad", poses)
        columns |= _columns("true_x_m true_y_m true_theta_rad", truth)
        columns |= _columns("error_x_m error_y_m error_theta_rad", error)
        columns |= _triangle("cov_xx cov_xy cov_xt cov_yy cov_yt cov_tt", series.covariances)
        if name == "online":
            columns |= {"nis": estimate.step_nis, "nis_dof": estimate.step_dof}
        tables.append(filled("trajectories", _keys(dataset, estimate) | columns, dataset.poses))
    return concat("trajectories", tables)


@_quiet
def landmarks(dataset: Dataset, estimate: Estimate, alignment: str = "none") -> pd.DataFrame:
    """The final map against the truth, once per series, aligned as that series is.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
    alignment : {"none", "se2"}
        Applied to positions and errors; covariances and NEES are those of the estimate.

    Returns
    -------
    DataFrame
        Columns of `SCHEMAS["landmarks"]`.

    Raises
    ------
    InputError, UnknownNameError
        As `summary_rows`.
    """
    validate(dataset, estimate)
    estimated = estimate.landmarks
    if estimated is None:
        return concat("landmarks", [])
    identity = match_landmarks(dataset, estimate).true_landmark
    truth = true_positions(dataset, identity)
    tables = []
    for name, series in _finite_series(estimate).items():
        positions = _map(estimated, _motion(dataset, series, alignment))
        error = positions - truth
        columns: dict[str, Any] = {
            "series": name,
            "landmark": _identities(estimated.ids),
            "true_landmark": _identities(identity),
            "error_m": np.hypot(error[:, 0], error[:, 1]),
            "nees": _landmark_nees(estimated, truth),
        }
        columns |= _columns("x_m y_m", positions)
        columns |= _columns("true_x_m true_y_m", truth)
        columns |= _columns("error_x_m error_y_m", error)
        columns |= _triangle("cov_xx cov_xy cov_yy", estimated.covariances)
        tables.append(filled("landmarks", _keys(dataset, estimate) | columns, len(estimated)))
    return concat("landmarks", tables)


@_quiet
def innovations(dataset: Dataset, estimate: Estimate) -> pd.DataFrame:
    """What the estimator made of each observation.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate

    Returns
    -------
    DataFrame
        Columns of `SCHEMAS["innovations"]`; no rows if the estimator kept none.

    Raises
    ------
    InputError
        If the estimate does not have the sizes of the dataset.
    """
    validate(dataset, estimate)
    met = estimate.innovations
    if met is None:
        return concat("innovations", [])
    names = np.array([decision.name.lower() for decision in Decision])
    sensors = np.array([sensor.name for sensor in dataset.sensors], dtype=object)
    nis = squared_mahalanobis(met.innovation, met.S)
    columns: dict[str, Any] = {
        "step": dataset.observations.step,
        "time_s": dataset.observation_times,
        "sensor": sensors[dataset.observations.sensor],
        "landmark": _identities(met.landmark),
        "decision": names[met.decision],
        "nis": nis,
        "dof": np.where(np.isnan(nis), np.nan, 2.0),
    }
    columns |= _columns("innovation_0 innovation_1", met.innovation)
    columns |= _triangle("S_00 S_01 S_11", met.S)
    table = filled("innovations", _keys(dataset, estimate) | columns, len(met))
    return concat("innovations", [table])


def _columns(names: str, values: Array) -> dict[str, Array]:
    return dict(zip(names.split(), values.T, strict=True))


def _triangle(names: str, matrices: Array | None) -> dict[str, Array]:
    """Upper triangles, row by row."""
    if matrices is None:
        return {}
    i, j = np.triu_indices(matrices.shape[-1])
    return _columns(names, matrices[:, i, j])


def _identities(ids: np.ndarray) -> Any:
    """Identities with the negative ones missing."""
    return pd.arrays.IntegerArray(ids.astype(np.int64), mask=ids < 0)


# Values of the columns --------------------------------------------------------------------------


def _keys(dataset: Dataset, estimate: Estimate) -> dict[str, Any]:
    return {
        "dataset": dataset.name,
        "seed": dataset.seed,
        "robot": dataset.robot.name,
        "estimator": estimate.estimator,
    }


def _finite_series(estimate: Estimate) -> dict[str, Trajectory]:
    """The series with poses that are not finite as NaN."""
    return {
        name: Trajectory(_nan_unless_finite(series.poses), series.covariances)
        for name, series in estimate.series.items()
    }


def _nan_unless_finite(rows: Array) -> Array:
    return np.where(np.isfinite(rows).all(axis=1, keepdims=True), rows, np.nan)


def _truth(dataset: Dataset) -> Array:
    return np.full((dataset.poses, 3), np.nan) if dataset.truth is None else dataset.truth


def _applied(dataset: Dataset, alignment: str) -> str:
    """Without a truth there is nothing to align with."""
    return "none" if dataset.truth is None else alignment


def _motion(dataset: Dataset, series: Trajectory, alignment: str) -> Array:
    return alignment_motion(series.poses, _truth(dataset), _applied(dataset, alignment))


def _map(landmarks: LandmarkEstimates, motion: Array) -> Array:
    return geo.from_frame(motion, _nan_unless_finite(landmarks.positions))


def _nees(dataset: Dataset, series: Trajectory) -> tuple[Array, Array]:
    if dataset.truth is None or series.covariances is None:
        skipped = np.full(dataset.poses, np.nan)
        return skipped, skipped
    arguments = series.poses, dataset.truth, series.covariances
    return pose_nees(*arguments), pose_nees_invariant(*arguments)


def _message(dataset: Dataset, estimate: Estimate, series: Trajectory) -> str:
    """What the estimator said, and at how many poses NEES had to be skipped."""
    if dataset.truth is None or series.covariances is None:
        return estimate.message
    skipped = int(np.isnan(_nees(dataset, series)[0]).sum())
    note = f"NEES skipped at {skipped} of {dataset.poses} poses (singular covariance)"
    return "; ".join(filter(None, [estimate.message, note if skipped else ""]))


def _landmark_nees(landmarks: LandmarkEstimates, truth: Array) -> Array:
    if landmarks.covariances is None:
        return np.full(len(landmarks), np.nan)
    return squared_mahalanobis(landmarks.positions - truth, landmarks.covariances)


def _landmark_counts(estimate: Estimate, match: LandmarkMatch) -> dict[str, Any]:
    return {
        "landmarks_true": match.true,
        "landmarks_estimated": None if estimate.landmarks is None else len(estimate.landmarks),
        "landmarks_missed": match.missed,
        "landmarks_spurious": match.spurious,
    }


def _pose_scalars(
    dataset: Dataset, series: Trajectory, alignment: str, rpe_distance: float
) -> dict[str, float]:
    truth = _truth(dataset)
    ate = absolute_errors(geo.compose(_motion(dataset, series, alignment), series.poses), truth)
    rpe = relative_errors(series.poses, truth, rpe_distance)
    nees, nees_invariant = _nees(dataset, series)
    return {
        "ate_position_rmse_m": rmse(ate.position),
        "ate_position_max_m": float(ate.position.max()),
        "ate_heading_rmse_rad": rmse(ate.heading),
        "rpe_position_rmse_m": rmse(rpe.position),
        "rpe_heading_rmse_rad": rmse(rpe.heading),
        "nees_pose_mean": mean(nees),
        "nees_pose_final": float(nees[-1]),
        "nees_pose_invariant_mean": mean(nees_invariant),
        "nees_pose_inside_95": share_inside(nees, 3),
    }


def _landmark_scalars(estimate: Estimate, truth: Array, motion: Array) -> dict[str, float]:
    landmarks = estimate.landmarks
    matched = np.isfinite(truth).all(axis=1)
    if landmarks is None or not matched.any():
        return {}
    error = (_map(landmarks, motion) - truth)[matched]
    size = np.hypot(error[:, 0], error[:, 1])
    return {
        "landmark_rmse_m": rmse(size),
        "landmark_max_m": float(size.max()),
        "nees_landmark_mean": mean(_landmark_nees(landmarks, truth)),
    }


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
    dataset: Dataset, estimate: Estimate, series: Trajectory, reference: Estimate | None
) -> dict[str, float]:
    if reference is None:
        return {}
    gap = gaps(dataset, estimate, series, reference)
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
        times |= {"time_per_step_median_us": float(median), "time_per_step_p99_us": float(p99)}
    return times
