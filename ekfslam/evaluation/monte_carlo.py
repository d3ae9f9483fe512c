"""Statistics over the runs of a campaign, and how many runs they need.

NEES along one run is almost one sample, so that an average over runs and steps has no chi-square
interval: it is given with its standard error from the spread of the run means. The NEES of one step
over the runs has one, and so have NIS and whiteness, which are pooled over all steps of all runs.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ekfslam.errors import InputError
from ekfslam.estimates import DIVERGED, FAILED, SKIPPED
from ekfslam.evaluation.campaign import GROUP, check_columns, check_distinct, group_numbers
from ekfslam.evaluation.over_time import credibility, nees_over_time
from ekfslam.evaluation.resampling import student_runs
from ekfslam.evaluation.runs import quiet
from ekfslam.evaluation.schema import REAL, TEXT, WHOLE, schema_of
from ekfslam.evaluation.statistics import chi2_interval

MEANS = {
    "run_nees_pose": "nees_pose_mean_kept",
    "run_nees_pose_invariant": "nees_pose_invariant_mean_kept",
    "run_nees_position": "nees_position_mean_kept",
    "run_nees_position_invariant": "nees_position_invariant_mean_kept",
    "run_nees_heading": "nees_heading_mean_kept",
    "run_inside_95": "nees_pose_inside_95_kept",
    "run_inside_95_invariant": "nees_pose_invariant_inside_95_kept",
    "final_nees_pose": "nees_pose_final",
    "final_nees_pose_invariant": "nees_pose_invariant_final",
    "ate_position_rmse_m": "ate_position_rmse_m",
    "ate_heading_rmse_rad": "ate_heading_rmse_rad",
    "landmark_rmse_m": "landmark_rmse_m",
    "effective_samples": "effective_samples_mean",
}
"""Columns of the runs that are averaged over them: NAME_mean with its standard error NAME_se."""

MEDIANS = {
    "run_nees_pose": "nees_pose_mean_kept",
    "run_nees_pose_invariant": "nees_pose_invariant_mean_kept",
    "sigma_ratio_position": "sigma_ratio_position",
    "sigma_ratio_heading": "sigma_ratio_heading",
    "gap_final_position_m": "gap_final_position_m",
    "gap_final_heading_rad": "gap_final_heading_rad",
    "gap_final_mahalanobis2": "gap_final_mahalanobis2",
    "gap_landmark_rmse_m": "gap_landmark_rmse_m",
}
"""Columns of the runs of which the median is taken: NAME_median."""

ROOTS = {
    "final_position_rms_m": "final_position_error_m",
    "final_position_sigma_rms_m": "final_position_sigma_m",
    "final_heading_rms_rad": "final_heading_error_rad",
    "final_heading_sigma_rms_rad": "final_heading_sigma_rad",
}
"""Columns of the runs of which the root of the mean square over them is taken."""

SQUARES = {"rms_position_m": "position_mse_kept_m2", "rms_heading_rad": "heading_mse_kept_rad2"}
"""Columns of the runs that are mean squares already, of whose mean the root is taken."""

POOLED = [
    *("nis_sum", "nis_dof_sum", "white_cross", "white_before", "white_after", "white_terms"),
    *("graph_error", "graph_dof"),
]
"""Columns of the runs that add up."""


def _both(name: str) -> str:
    return f"{name}_mean {name}_se"


STATISTICS: Mapping[str, str] = schema_of(
    (TEXT, " ".join(GROUP)),
    (WHOLE, "runs failed skipped steps_skipped"),
    (WHOLE, "diverged diverged_by_status diverged_by_nees"),
    (REAL, "diverged_share diverged_above"),
    (WHOLE, "nees_runs"),
    (REAL, f"{_both('run_nees_pose')} run_nees_pose_median"),
    (REAL, f"{_both('run_nees_pose_invariant')} run_nees_pose_invariant_median"),
    (REAL, f"{_both('run_nees_position')} {_both('run_nees_position_invariant')}"),
    (REAL, f"{_both('run_nees_heading')} {_both('run_inside_95')}"),
    (REAL, _both("run_inside_95_invariant")),
    (WHOLE, "final_nees_runs"),
    (REAL, f"{_both('final_nees_pose')} {_both('final_nees_pose_invariant')}"),
    (REAL, "final_nees_low_95 final_nees_high_95"),
    (REAL, "nis_per_dof nis_per_dof_sd"),
    (WHOLE, "nis_dof"),
    (REAL, "white_rho white_rho_sd white_rho_se"),
    (WHOLE, "white_terms"),
    (REAL, "rms_position_m rms_heading_rad"),
    (REAL, "rms_position_time_mean_m rms_heading_time_mean_rad"),
    (REAL, f"{' '.join(ROOTS)} {_both('ate_position_rmse_m')} {_both('ate_heading_rmse_rad')}"),
    (REAL, f"{_both('landmark_rmse_m')} {_both('effective_samples')}"),
    (REAL, " ".join(f"{name}_median" for name in list(MEDIANS)[2:])),
    (REAL, "graph_chi2_per_dof graph_chi2_per_dof_sd"),
    (WHOLE, "graph_dof credibility_step"),
    (REAL, "nci_db inclination_db"),
)
"""Columns of `summarise`, in order, with their dtypes."""


@quiet
def summarise(
    runs: pd.DataFrame, steps: pd.DataFrame | None = None, diverged_above: float = 20.0
) -> pd.DataFrame:
    """Statistics over the runs of each scenario, estimator, series and robot.

    A run is counted as diverged if its status is ``diverged`` (the final position is lost, or a
    number is not one, see `ekfslam.evaluation.judged`) or if its mean NEES is above
    `diverged_above`. Diverged runs are in every mean and median all the same, as far as they have
    numbers: leaving them out would flatter the estimator. That is why medians stand by the means.

    Parameters
    ----------
    runs : DataFrame
        Runs of a campaign.
    steps : DataFrame, optional
        Steps of them, for the columns that need them: ``rms_..._time_mean_...`` and credibility.
    diverged_above : float
        Mean of the NEES of the pose in (x, y, theta) over the kept steps of a run.

    Returns
    -------
    DataFrame
        Columns of `STATISTICS`, rows in order of appearance. Runs that failed or were skipped are
        counted in the rows of their estimator, and have one without numbers if it has no other.

    Raises
    ------
    InputError
        If a column is missing, a run is there twice, or `diverged_above` is not a positive number.
    """
    named = [column for each in (MEANS, MEDIANS, ROOTS, SQUARES) for column in each.values()]
    numeric = list(dict.fromkeys([*named, *POOLED, "steps_skipped"]))
    check_columns(runs, [*GROUP, "seed", "status", *numeric], "runs")
    if not diverged_above > 0:
        raise InputError(f"diverged_above must be a positive NEES, got {diverged_above}")
    check_distinct(runs, [*GROUP, "seed"], "runs")
    gave = ~runs["status"].isin([FAILED, SKIPPED])
    some = gave.groupby([runs["scenario"], runs["estimator"]]).transform("any")
    rows = runs[gave | ~some]
    at = group_numbers(rows)
    keys = rows[GROUP].loc[~pd.Series(at, rows.index).duplicated()].reset_index(drop=True)
    numbers = rows[numeric].astype(float).reset_index(drop=True)
    table = keys.assign(
        **_counts(rows, at, numbers, diverged_above),
        **_over_runs(numbers, at),
        **_pooled(numbers, at),
        diverged_above=diverged_above,
        failed=_without_numbers(runs[runs["status"] == FAILED], keys),
        skipped=_without_numbers(runs[runs["status"] == SKIPPED], keys),
    )
    if steps is not None:
        table = table.merge(_time_means(steps, table), on=GROUP, how="left")
        table = table.merge(_final_credibility(steps), on=GROUP, how="left")
    return table.reindex(columns=list(STATISTICS)).astype(dict(STATISTICS))


def _counts(
    rows: pd.DataFrame, at: np.ndarray, numbers: pd.DataFrame, diverged_above: float
) -> dict[str, pd.Series]:
    by_status = (rows["status"] == DIVERGED).reset_index(drop=True).astype(bool)
    by_nees = numbers["nees_pose_mean_kept"] > diverged_above
    gave = ~rows["status"].isin([FAILED, SKIPPED]).reset_index(drop=True)
    counts = pd.DataFrame(
        {
            "runs": gave,
            "diverged": by_status | by_nees,
            "diverged_by_status": by_status,
            "diverged_by_nees": by_nees,
        }
    )
    columns = dict(counts.groupby(at).sum())
    columns["diverged_share"] = columns["diverged"] / columns["runs"].where(columns["runs"] > 0)
    columns["steps_skipped"] = numbers["steps_skipped"].groupby(at).max()
    return columns


def _over_runs(numbers: pd.DataFrame, at: np.ndarray) -> dict[str, pd.Series]:
    """Means with their standard errors, medians, roots of mean squares."""
    groups, squares = numbers.groupby(at), numbers.pow(2).groupby(at)
    means, counts, medians = groups.mean(), groups.count(), groups.median()
    # Of a single run there is no spread, and no standard error.
    errors = groups.std(ddof=1) / counts.pow(0.5)
    columns = {f"{name}_mean": means[column] for name, column in MEANS.items()}
    columns |= {f"{name}_se": errors[column] for name, column in MEANS.items()}
    columns |= {f"{name}_median": medians[column] for name, column in MEDIANS.items()}
    columns |= {name: np.sqrt(squares[column].mean()) for name, column in ROOTS.items()}
    columns |= {name: np.sqrt(means[column]) for name, column in SQUARES.items()}
    columns["nees_runs"] = counts["nees_pose_mean_kept"]
    columns["final_nees_runs"] = final = counts["nees_pose_final"]
    some = final.where(final > 0)
    low, high = chi2_interval(3.0 * some.fillna(1))
    columns |= {"final_nees_low_95": low / some, "final_nees_high_95": high / some}
    return columns


def _pooled(numbers: pd.DataFrame, at: np.ndarray) -> dict[str, pd.Series]:
    """NIS, whiteness and the residual of the graph over all runs, with what they scatter."""
    pooled = numbers[POOLED]
    # The error of a graph whose degrees of freedom are not known has nothing to be held against.
    pooled = pooled.assign(graph_error=pooled["graph_error"].where(pooled["graph_dof"] > 0))
    totals = pooled.groupby(at).sum()
    dof, terms, graph = (
        totals[name].where(totals[name] > 0) for name in ("nis_dof_sum", "white_terms", "graph_dof")
    )
    root = np.sqrt(totals["white_before"] * totals["white_after"])
    rho: pd.Series = (totals["white_cross"] / root).where(terms > 0)
    # How the sums of one run move rho, to first order: what rho scatters by between runs.
    whole = totals.assign(root=root, rho=rho).loc[at].reset_index(drop=True)
    before, after = (pooled[name] / whole[name] for name in ("white_before", "white_after"))
    moves = pooled["white_cross"] / whole["root"] - 0.5 * whole["rho"] * (before + after)
    squares, count = moves.pow(2).groupby(at).sum(), moves.groupby(at).count()
    several = count.where(count > 1)
    return {
        "nis_per_dof": totals["nis_sum"] / dof,
        "nis_per_dof_sd": np.sqrt(2.0 / dof),
        "nis_dof": dof,
        "white_rho": rho,
        "white_rho_sd": 1.0 / np.sqrt(terms),
        "white_rho_se": np.sqrt(squares * several / (several - 1)),
        "white_terms": terms,
        "graph_chi2_per_dof": 2.0 * totals["graph_error"] / graph,
        "graph_chi2_per_dof_sd": np.sqrt(2.0 / graph),
        "graph_dof": graph,
    }


def _without_numbers(runs: pd.DataFrame, keys: pd.DataFrame) -> np.ndarray:
    """Seeds of each key's scenario and estimator at which there was no estimate."""
    seeds = runs.groupby(["scenario", "estimator"])["seed"].nunique()
    names = pd.MultiIndex.from_frame(keys[["scenario", "estimator"]])
    return seeds.reindex(names, fill_value=0).to_numpy()


def _time_means(steps: pd.DataFrame, table: pd.DataFrame) -> pd.DataFrame:
    """Plain means over the kept steps of what is a root mean square over the runs at each."""
    over_time = nees_over_time(steps).merge(table[[*GROUP, "steps_skipped"]], on=GROUP)
    kept = over_time[over_time["step"] >= over_time["steps_skipped"]]
    means = kept.groupby(GROUP, dropna=False)[["rms_position_m", "rms_heading_rad"]].mean()
    names = ["rms_position_time_mean_m", "rms_heading_time_mean_rad"]
    return means.set_axis(names, axis="columns").reset_index()


def _final_credibility(steps: pd.DataFrame) -> pd.DataFrame:
    """Credibility at the last of the steps of each group."""
    check_columns(steps, [*GROUP, "step"], "steps")
    last = steps.groupby(GROUP, dropna=False)["step"].transform("max")
    final = credibility(steps[steps["step"] == last]).rename(columns={"step": "credibility_step"})
    return final.drop(columns=["runs", "time_s"])


def runs_needed(pilot: ArrayLike, half_width: float, probability: float = 0.95) -> int:
    """Runs that a mean needs for an interval of a given width, from those of a pilot.

    The smallest n with ``t(n - 1) s / sqrt(n) <= half_width``, where s is the standard deviation of
    the pilot and t the two-sided quantile of Student's distribution, which depends on n itself. The
    pilot's s is taken as the truth: with few pilot runs, or a heavy tail of which they hold
    nothing, more runs are needed.

    Parameters
    ----------
    pilot : (m,) array_like
        One number per run, such as its mean NEES, or per seed, such as the difference of two
        estimators; NaN for a run without one.
    half_width : float
        y of the wanted mean ± y.
    probability : float
        Of the interval, in (0, 1).

    Returns
    -------
    int
        At least 2.

    Raises
    ------
    InputError
        If the pilot has fewer than two numbers or one that is infinite, the width is not positive,
        or for another probability.
    """
    values = np.asarray(pilot, dtype=float).ravel()
    values = values[~np.isnan(values)]
    if len(values) < 2 or not np.isfinite(values).all():
        raise InputError("a pilot must have at least two numbers, all of them finite")
    if not 0.0 < half_width < np.inf:
        raise InputError(f"half_width must be positive, got {half_width}")
    if not 0.0 < probability < 1.0:
        raise InputError(f"probability must be in (0, 1), got {probability}")
    return student_runs(float(values.std(ddof=1)), half_width, probability)
