"""Statistics over runs at each time: NEES with its interval, errors, credibility.

The runs of a scenario are independent and, at one time, are judged by one chi-square interval.
Averages along time are not: see `ekfslam.evaluation.statistics.chi2_interval`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from ekfslam.evaluation.campaign import GROUP, check_columns, check_distinct, group_numbers
from ekfslam.evaluation.consistency import squared_mahalanobis
from ekfslam.evaluation.runs import quiet
from ekfslam.evaluation.schema import REAL, TEXT, WHOLE, schema_of
from ekfslam.evaluation.statistics import chi2_interval
from ekfslam.geometry import Array

_KEYS = ((TEXT, " ".join(GROUP)), (WHOLE, "step"), (REAL, "time_s"))
_ERRORS = ["error_x_m", "error_y_m", "error_theta_rad"]
_PAIRS = {"xx": (0, 0), "xy": (0, 1), "xt": (0, 2), "yy": (1, 1), "yt": (1, 2), "tt": (2, 2)}

OVER_TIME: Mapping[str, str] = schema_of(
    *_KEYS,
    (WHOLE, "runs nees_runs"),
    (REAL, "nees_mean nees_invariant_mean nees_low nees_high probability"),
    (REAL, "rms_position_m rms_heading_rad sigma_position_m sigma_heading_rad"),
    (REAL, "mse_xx mse_xy mse_xt mse_yy mse_yt mse_tt"),
)
"""Columns of `nees_over_time`, in order, with their dtypes."""

CREDIBILITY: Mapping[str, str] = schema_of(*_KEYS, (WHOLE, "runs"), (REAL, "nci_db inclination_db"))
"""Columns of `credibility`, in order, with their dtypes."""


@quiet
def nees_over_time(steps: pd.DataFrame, probability: float = 0.95) -> pd.DataFrame:
    """Mean NEES over the runs at each time, with the interval it should be in.

    N times the mean NEES of N runs at one time is chi-square with 3 N degrees of freedom if the
    estimator is consistent (Bar-Shalom et al. 2001, 5.4). Diverged runs count like others.

    Parameters
    ----------
    steps : DataFrame
        Steps of the runs of a campaign.
    probability : float
        Of the two-sided interval, in (0, 1).

    Returns
    -------
    DataFrame
        Columns of `OVER_TIME`: a row per scenario, estimator, series and robot, in order of
        appearance, and step.

    Raises
    ------
    InputError
        If a column is missing, a step of a run is there twice, or for another probability.
    """
    covariances = ["cov_xx", "cov_yy", "cov_tt"]
    keys, at, numbers = _at_each_time(steps, [*_ERRORS, *covariances, "nees", "nees_invariant"])
    errors = numbers[_ERRORS].to_numpy()
    numbers["variance"] = numbers["cov_xx"] + numbers["cov_yy"]
    for name, (i, j) in _PAIRS.items():
        numbers[name] = errors[:, i] * errors[:, j]
    groups = numbers.groupby(at)
    means, counted = groups.mean(), groups["nees"].count().to_numpy()
    low, high = chi2_interval(3.0 * np.maximum(counted, 1), probability)
    low, high = (
        np.where(counted > 0, bound / np.maximum(counted, 1), np.nan) for bound in (low, high)
    )
    columns = {
        "runs": groups.size(),
        "nees_runs": counted,
        "nees_mean": means["nees"],
        "nees_invariant_mean": means["nees_invariant"],
        "nees_low": low,
        "nees_high": high,
        "probability": probability,
        "rms_position_m": np.sqrt(means["xx"] + means["yy"]),
        "rms_heading_rad": np.sqrt(means["tt"]),
        "sigma_position_m": np.sqrt(means["variance"]),
        "sigma_heading_rad": np.sqrt(means["cov_tt"]),
    }
    columns |= {f"mse_{name}": means[name] for name in _PAIRS}
    return keys.assign(**columns)[list(OVER_TIME)].astype(dict(OVER_TIME))


@quiet
def credibility(steps: pd.DataFrame) -> pd.DataFrame:
    """How credible the covariances are at each time, in decibels (Li and Zhao 2006).

    With e the error of a run, P its covariance and S the mean of e e' over the runs at that time,

        gamma = 10 log10(e' P^-1 e / e' S^-1 e);

    the noncredibility index (NCI) is the mean of ``|gamma|`` over the runs, the inclination
    indicator the mean of gamma: positive where the estimator is optimistic. Ten runs or so make S
    mean something; of three or fewer it is singular and there is no number.

    Parameters
    ----------
    steps : DataFrame
        Steps of the runs of a campaign, not aligned.

    Returns
    -------
    DataFrame
        Columns of `CREDIBILITY`, rows as in `nees_over_time`. Runs whose NEES was skipped are in S
        alone.

    Raises
    ------
    InputError
        If a column is missing, or a step of a run is there twice.
    """
    keys, at, numbers = _at_each_time(steps, [*_ERRORS, "nees"])
    errors = numbers[_ERRORS].to_numpy()
    products = pd.DataFrame({name: errors[:, i] * errors[:, j] for name, (i, j) in _PAIRS.items()})
    means = products.groupby(at).mean()[["xx", "xy", "xt", "xy", "yy", "yt", "xt", "yt", "tt"]]
    information = _inverses(means.to_numpy().reshape(-1, 3, 3))[at]
    credible = np.einsum("ni,nij,nj->n", errors, information, errors)
    gamma = pd.Series(10.0 * np.log10(numbers["nees"].to_numpy() / credible))
    gamma = gamma.where(np.isfinite(gamma))
    columns = {
        "runs": gamma.groupby(at).count(),
        "nci_db": gamma.abs().groupby(at).mean(),
        "inclination_db": gamma.groupby(at).mean(),
    }
    return keys.assign(**columns)[list(CREDIBILITY)].astype(dict(CREDIBILITY))


def _inverses(matrices: Array) -> Array:
    """Inverses (n, 3, 3), NaN where `squared_mahalanobis` would skip a matrix."""
    result = np.full_like(matrices, np.nan)
    regular = ~np.isnan(squared_mahalanobis(np.zeros(3), matrices))
    result[regular] = np.linalg.inv(matrices[regular])
    return result


def _at_each_time(
    steps: pd.DataFrame, columns: list[str]
) -> tuple[pd.DataFrame, np.ndarray, pd.DataFrame]:
    """Keys of each group and time, in order; which of them a row is of; its numbers."""
    check_columns(steps, [*GROUP, "seed", "step", "time_s", *columns], "steps")
    steps = steps.reset_index(drop=True)
    place = pd.DataFrame(
        {"group": group_numbers(steps), "step": steps["step"].to_numpy(dtype=np.int64)}
    )
    if place.assign(seed=steps["seed"]).duplicated().any():
        check_distinct(steps, [*GROUP, "seed", "step"], "steps")
    firsts = place.drop_duplicates().sort_values(["group", "step"])
    keys = steps.loc[firsts.index, [*GROUP, "step", "time_s"]].reset_index(drop=True)
    at = place.groupby(["group", "step"]).ngroup().to_numpy()
    return keys, at, steps[columns].astype(float)
