"""The five tidy tables of an estimate.

They are `summary`, `trajectories`, `landmarks`, `innovations` and `association`. Columns are
described in ``docs/tables.md``; their dtypes are in `ekfslam.evaluation.schema`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.estimates import Decision, Estimate
from ekfslam.evaluation.association import association_scores
from ekfslam.evaluation.consistency import squared_mahalanobis, validate
from ekfslam.evaluation.landmarks import MATCH_RADIUS, match_landmarks, true_positions
from ekfslam.evaluation.runs import aligned_map, landmark_nees, quiet, row_keys, runs
from ekfslam.evaluation.schema import SCHEMAS, concat, filled, read_csv, read_table
from ekfslam.evaluation.summary import summary_rows, summary_scalars
from ekfslam.evaluation.trajectory import frame_motion
from ekfslam.geometry import Array
from ekfslam.observations import WIDTH

__all__ = [
    "SCHEMAS",
    "association",
    "concat",
    "innovations",
    "landmarks",
    "read_csv",
    "read_table",
    "summary_rows",
    "summary_scalars",
    "trajectories",
    "trajectory_columns",
]


def trajectories(dataset: Dataset, estimate: Estimate, alignment: str = "none") -> pd.DataFrame:
    """Every pose of every robot and series against the truth.

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
    parts = trajectory_columns(dataset, estimate, alignment)
    return concat("trajectories", [filled("trajectories", part, dataset.poses) for part in parts])


@quiet
def trajectory_columns(
    dataset: Dataset, estimate: Estimate, alignment: str = "none"
) -> list[dict[str, Any]]:
    """The columns of `trajectories`, of each robot and series: scalars and (K + 1,) arrays.

    Parameters and errors are those of `trajectories`.
    """
    validate(dataset, estimate)
    parts = []
    for run in runs(dataset, estimate, alignment):
        error = geo.additive_error(run.truth, run.aligned)
        columns: dict[str, Any] = {
            "series": run.name,
            "step": np.arange(dataset.poses),
            "time_s": dataset.times,
            "error_position_m": np.hypot(error[:, 0], error[:, 1]),
            "nees": run.nees,
            "nees_invariant": run.nees_invariant,
            "nees_position": run.nees_position,
            "time_step_s": estimate.step_seconds,
        }
        columns |= _columns("x_m y_m theta_rad", run.aligned)
        columns |= _columns("true_x_m true_y_m true_theta_rad", run.truth)
        columns |= _columns("error_x_m error_y_m error_theta_rad", error)
        columns |= _triangle("cov_xx cov_xy cov_xt cov_yy cov_yt cov_tt", run.series.covariances)
        if run.name == "online":
            columns |= {"nis": estimate.step_nis, "nis_dof": estimate.step_dof}
            columns["effective_samples"] = estimate.effective_samples
        parts.append(row_keys(dataset, estimate, run.robot) | columns)
    return parts


@quiet
def landmarks(
    dataset: Dataset,
    estimate: Estimate,
    alignment: str = "none",
    match_radius: float = MATCH_RADIUS,
) -> pd.DataFrame:
    """The points of the final map against the truth, once per series, aligned as that series is.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate
    alignment : {"none", "se2"}
        Applied to positions and errors; covariances and NEES are those of the estimate.
    match_radius : float
        As in `summary_rows`.

    Returns
    -------
    DataFrame
        Columns of `SCHEMAS["landmarks"]`. The map of several robots belongs to none of them: the
        column `robot` is then empty.

    Raises
    ------
    InputError, UnknownNameError
        As `summary_rows`.
    """
    validate(dataset, estimate)
    estimated = estimate.landmarks
    if estimated is None:
        return concat("landmarks", [])
    tables = []
    for name, series in estimate.series.items():
        motion = frame_motion(dataset, series, alignment)
        identity = match_landmarks(dataset, estimate, match_radius, motion)
        truth = true_positions(dataset, identity)
        positions = aligned_map(estimated, motion)
        error = positions - truth
        columns: dict[str, Any] = {
            "series": name,
            "landmark": _identities(estimated.ids),
            "true_landmark": _identities(identity),
            "error_m": np.hypot(error[:, 0], error[:, 1]),
            "nees": landmark_nees(estimated, truth),
        }
        columns |= _columns("x_m y_m", positions)
        columns |= _columns("true_x_m true_y_m", truth)
        columns |= _columns("error_x_m error_y_m", error)
        columns |= _triangle("cov_xx cov_xy cov_yy", estimated.covariances)
        tables.append(filled("landmarks", row_keys(dataset, estimate) | columns, len(estimated)))
    return concat("landmarks", tables)


@quiet
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
    observed = dataset.observations
    size = np.array([s.view.size for s in dataset.sensors], dtype=np.int64)[observed.sensor]
    innovation, S = _without_padding(met.innovation, met.S, size)
    nis = np.full(len(met), np.nan)
    for width in np.unique(size):
        rows = size == width
        nis[rows] = squared_mahalanobis(innovation[rows, :width], S[rows, :width, :width])
    columns: dict[str, Any] = {
        "robot": _named([robot.name for robot in dataset.robots], observed.robot),
        "step": observed.step,
        "time_s": dataset.observation_times,
        "sensor": _named([sensor.name for sensor in dataset.sensors], observed.sensor),
        "observed_robot": _named([robot.name for robot in dataset.robots], dataset.observed_robot),
        "landmark": _identities(met.landmark),
        "decision": _named([decision.name.lower() for decision in Decision], met.decision),
        "nis": nis,
        "dof": np.where(np.isnan(nis), np.nan, size),
    }
    columns |= _columns("innovation_0 innovation_1", innovation)
    columns |= _triangle("S_00 S_01 S_11", S)
    table = filled("innovations", row_keys(dataset, estimate) | columns, len(met))
    return concat("innovations", [table])


def association(dataset: Dataset, estimate: Estimate) -> pd.DataFrame:
    """Associations against the truth, counted per robot and step.

    Parameters
    ----------
    dataset : Dataset
    estimate : Estimate

    Returns
    -------
    DataFrame
        Columns of `SCHEMAS["association"]`, see `ekfslam.evaluation.association`: a row for every
        step at which a robot observed landmarks or clutter; none if the origin of the observations
        is not known or the estimator kept no innovations.

    Raises
    ------
    InputError
        If the estimate does not have the sizes of the dataset.
    """
    validate(dataset, estimate)
    scores, met = association_scores(dataset, estimate), estimate.innovations
    if scores is None or met is None or not scores.scored.any():
        return concat("association", [])
    # Places are numbered robot by robot, and counted without being sorted.
    where = dataset.observations.robot * dataset.poses + dataset.observations.step
    places = len(dataset.robots) * dataset.poses
    place = np.flatnonzero(np.bincount(where[scores.scored], minlength=places))
    counted = {
        "observations": scores.scored,
        "mapped": scores.mapped,
        "accepted": scores.accepted,
        "correct": scores.correct,
        "false": scores.false,
        "missed": scores.missed,
        "new": scores.founded,
        "duplicates": scores.duplicates,
        "spurious": scores.spurious,
        "merges": scores.merging,
        "rejected": met.decision == Decision.REJECTED,
        "ambiguous": met.decision == Decision.AMBIGUOUS,
        "tentative": met.decision == Decision.TENTATIVE,
    }
    columns: dict[str, Any] = {
        name: np.bincount(where[flags & scores.scored], minlength=places)[place]
        for name, flags in counted.items()
    }
    robot, columns["step"] = np.divmod(place, dataset.poses)
    columns["robot"] = _named([robot.name for robot in dataset.robots], robot)
    return filled("association", row_keys(dataset, estimate) | columns, len(place))


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


def _named(names: list[str], index: np.ndarray) -> Any:
    """Names by index, with those of negative ones missing."""
    return pd.array([*names, None], dtype=pd.StringDtype())[index]


def _without_padding(innovation: Array, S: Array, size: np.ndarray) -> tuple[Array, Array]:
    """Innovations and their covariances, NaN in the rows and columns that no sensor reported."""
    padding = np.arange(WIDTH) >= size[:, None]
    if not padding.any():  # so nothing is copied
        return innovation, S
    either = padding[:, :, None] | padding[:, None, :]
    return np.where(padding, np.nan, innovation), np.where(either, np.nan, S)
