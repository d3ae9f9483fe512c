"""The columns of the tables that the command prints, and how their numbers are written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple


class Column(NamedTuple):
    """A column of a table, its heading, and how its numbers are written."""

    name: str
    heading: str
    form: Callable[[Any], str]


def digits(value: float) -> str:
    """Three digits, or all before the point of a large number."""
    if abs(value) < 1000 or abs(value) >= 1e6:
        return f"{value:.3g}"
    return f"{value:.0f}"


def seconds(value: float) -> str:
    """Seconds, to the millisecond if they are few."""
    return f"{value:.3f}" if value < 100 else f"{value:.0f}"


def share(value: float) -> str:
    """A share of one."""
    return f"{value:.4f}"


def percent(value: float) -> str:
    """A share in percent."""
    return f"{100 * value:.0f} %"


def plus_minus(mean: float, error: float) -> str:
    """A mean with its error, if it has one; empty without a mean."""
    return digits(mean) + (f" ± {error:.2g}" if error == error else "") if mean == mean else ""


MEASURED = (
    Column("ate_position_rmse_m", "ATE\n[m]", digits),
    Column("ate_heading_rmse_rad", "ATE\n[rad]", digits),
    Column("rpe_position_rmse_m", "RPE\n[m]", digits),
    Column("landmark_rmse_m", "landm.\n[m]", digits),
    Column("nees_pose_mean", "NEES\n(3)", digits),
    Column("nees_position_mean", "NEES\npos. (2)", digits),
    Column("nis_per_dof", "NIS\n/dof", digits),
    Column("effective_samples_mean", "eff.\nsamples", digits),
    Column("graph_chi2_per_dof", "chi2\n/dof", digits),
    Column("gap_final_position_m", "pose gap\nto batch [m]", digits),
    Column("gap_landmark_rmse_m", "map gap\n[m]", digits),
    Column("sigma_ratio_position", "sigma\nratio", digits),
    Column("time_total_s", "time\n[s]", seconds),
    Column("time_per_step_mean_us", "per step\n[us]", digits),
)
ASSOCIATED = (
    Column("association_precision", "precision", share),
    Column("association_recall", "recall", share),
    Column("landmarks_estimated", "in map", str),
    Column("landmarks_undetermined", "of open\ndistance", str),
    Column("landmarks_missed", "missed", str),
    Column("landmarks_spurious", "spurious", str),
    Column("landmarks_duplicate", "duplicate", str),
    Column("landmarks_merged", "merged", str),
)
STUDIED = (
    Column("precision_mean", "precision", share),
    Column("recall_mean", "recall", share),
    Column("ate", "ATE [m]\nmean ± s.e.", str),
    Column("ate_m_median", "ATE [m]\nmedian", digits),
    Column("nees_mean", "NEES (3)\nmean", digits),
    Column("nees_median", "NEES (3)\nmedian", digits),
    Column("share_diverged", "diverged", percent),
)
PAIRED = (
    Column("ate", "ATE [m]\nmean ± s.e.", str),
    Column("share_better", "less in", percent),
    Column("runs", "draws", str),
)
SPREAD = {
    "nees": ("run_nees_pose_mean", "run_nees_pose_se"),
    "invariant": ("run_nees_pose_invariant_mean", "run_nees_pose_invariant_se"),
    "nis": ("nis_per_dof", "nis_per_dof_sd"),
    "ate": ("ate_position_rmse_m_mean", "ate_position_rmse_m_se"),
    "samples": ("effective_samples_mean", "effective_samples_se"),
}
OVER_RUNS = (
    Column("runs", "runs", str),
    Column("diverged_share", "diverged", percent),
    Column("nees", "NEES (3)\nmean ± s.e.", str),
    Column("run_nees_pose_median", "NEES (3)\nmedian", digits),
    Column("invariant", "inv. NEES (3)\nmean ± s.e.", str),
    Column("final_nees_pose_mean", "final\nNEES (3)", digits),
    Column("interval", "95 % of it, if\nconsistent", str),
    Column("nis", "NIS/dof\n± s.d.", str),
    Column("ate", "ATE [m]\nmean ± s.e.", str),
    Column("samples", "eff. samples\nmean ± s.e.", str),
    Column("sigma_ratio_position_median", "sigma ratio\nmedian", digits),
    Column("gap_final_position_m_median", "pose gap [m]\nmedian", digits),
    Column("graph_chi2_per_dof", "chi2\n/dof", digits),
    Column("seconds", "time [s]\nmedian", seconds),
)
COMPARED = (
    Column("share_a_less", "a less\nin", percent),
    Column("p_adjusted", "p\nadjusted", lambda p: f"{p:.2g}"),
)
STARTED = (
    Column("share_diverged", "diverged", percent),
    Column("nees", "final NEES (3)\nmean ± s.e.", str),
    Column("nees_final_median", "median", digits),
    Column("ate", "ATE [m]\nmean ± s.e.", str),
    Column("landmark_m_mean", "landm.\n[m]", digits),
    Column("landmarks_mean", "landm.\nfound", digits),
)

BEACONS = (
    Column("ate_position_rmse_m", "ATE\n[m]", digits),
    Column("aligned_landmark_rmse_m", "beacons\nrms [m]", digits),
    Column("aligned_landmark_max_m", "largest\n[m]", digits),
    Column("nees_pose_mean", "NEES\n(3)", digits),
    Column("nis_per_dof", "NIS\n/dof", digits),
)
