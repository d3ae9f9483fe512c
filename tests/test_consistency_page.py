"""The page on consistency: its tables are those that the campaigns wrote, which meet the bars."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ekfslam.experiments.reading import load_campaign

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "consistency.md").read_text(encoding="utf-8")
CAMPAIGNS = ("hard-loop", "loop-15", "car-loop", "heading-sweep", "circle", "loop-15-rb")
STARTS = tuple(f"{angle} deg" for angle in ("0.1", "1", "2", "3", "5", "10"))
ISAM2 = "gtsam-isam2"
FAMILY = ("ekf", "iekf", "ekf-ideal", "ekf-fej", "ekf-oc", "ekf-ri", "ekf-robocentric")
CONSISTENT = ("ekf-fej", "ekf-oc", "ekf-ri")


def summary(name: str) -> pd.DataFrame:
    table = pd.read_csv(ROOT / "results" / name / "summary.csv")
    short = table["estimator"].str.replace(r"\(marginal_every=\d+\)", "", regex=True)
    names = short.where(table["series"] != "smoothed", short + " (all)")
    return table.set_index([table["scenario"], names])


def start(angle: str) -> str:
    return f"heading-sweep(prior.sigmas.2={angle})"


# The rows of the page --------------------------------------------------------------------------


def number(value: float, digits: int = 3) -> str:
    """Short, and empty where there is none."""
    if np.isnan(value):
        return ""
    if abs(value) >= 1e5:
        return f"{value:.1e}".replace("e+0", "e")
    return f"{value:.{digits}g}" if abs(value) < 100 else f"{value:.0f}"


def with_error(mean: float, error: float) -> str:
    return f"{number(mean)} ± {number(error, 2)}"


def in_degrees(value: float) -> str:
    return number(np.degrees(value))


def common_row(name: str, row: pd.Series) -> list[str]:
    return [
        f"`{name}`",
        f"{row['diverged_share']:.0%}".replace("%", " %"),
        with_error(row["run_nees_pose_mean"], row["run_nees_pose_se"]),
        number(row["run_nees_pose_median"]),
        with_error(row["run_nees_pose_invariant_mean"], row["run_nees_pose_invariant_se"]),
        f"{row['nis_per_dof']:.3f}" if row["nis_per_dof"] < 10 else number(row["nis_per_dof"]),
        f"{row['inclination_db']:.1f}",
        with_error(row["ate_position_rmse_m_mean"], row["ate_position_rmse_m_se"]),
    ]


def sweep_row(name: str, row: pd.Series) -> list[str]:
    return [
        f"`{name}`",
        with_error(row["run_nees_pose_mean"], row["run_nees_pose_se"]),
        with_error(row["run_nees_pose_invariant_mean"], row["run_nees_pose_invariant_se"]),
        with_error(row["final_nees_pose_mean"], row["final_nees_pose_se"]),
        in_degrees(row["final_heading_sigma_rms_rad"]),
        in_degrees(row["final_heading_rms_rad"]),
    ]


def circle_row(name: str, row: pd.Series) -> list[str]:
    return [
        f"`{name}`",
        in_degrees(row["rms_heading_rad"]),
        number(row["rms_position_m"]),
        with_error(row["run_nees_heading_mean"], row["run_nees_heading_se"]),
        with_error(row["run_nees_position_mean"] / 2, row["run_nees_position_se"] / 2),
    ]


def against_gtsam_row(name: str, row: pd.Series) -> list[str]:
    return [
        f"`{name}`",
        with_error(row["run_nees_pose_mean"], row["run_nees_pose_se"]),
        number(1000 * row["gap_final_position_m_median"]),
        in_degrees(row["gap_final_heading_rad_median"]),
        number(row["gap_final_mahalanobis2_median"], 2),
        number(row["sigma_ratio_position_median"]),
        number(row["sigma_ratio_heading_median"]),
    ]


def rows() -> list[str]:
    """All rows of the page that hold numbers of campaigns."""
    found: list[list[str]] = []
    for name, label in (
        ("hard-loop", "hard-loop"),
        ("loop-15", "loop-15"),
        ("loop-15", "loop-15 quiet"),
        ("car-loop", "car-loop"),
        ("car-loop", "car-loop quiet"),
    ):
        found += [common_row(key, row) for key, row in summary(name).loc[label].iterrows()]
    for angle in STARTS:
        table = summary("heading-sweep").loc[start(angle)]
        found += [[angle, *sweep_row(key, table.loc[key])] for key in ("ekf", "ekf-ri", ISAM2)]
    found += [circle_row(key, row) for key, row in summary("circle").loc["circle"].iterrows()]
    table = summary("loop-15-rb").loc["loop-15-rb"]
    found += [against_gtsam_row(key, row) for key, row in table.iterrows()]
    return [f"| {' | '.join(cells)} |" for cells in found]


@pytest.mark.parametrize("row", rows())
def test_the_page_holds_what_the_campaigns_found(row):
    assert row in PAGE


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_every_campaign_is_on_the_page_and_its_results_are_of_its_file(name):
    assert f"ekfslam campaign experiments/{name}.toml --out results/{name}" in PAGE
    campaign = load_campaign(ROOT / "experiments" / f"{name}.toml")
    table = summary(name)
    assert set(table["scenario"]) == {variant.label for variant in campaign.variants}
    assert set(table["estimator"]) == set(campaign.estimators)
    wanted = table["estimator"].map(lambda estimator: len(campaign.seeds_of(estimator)))
    assert (table["runs"] == wanted).all()
    assert not table[["failed", "skipped"]].to_numpy().any()
    stored = pd.read_json(ROOT / "results" / name / "config.json", typ="series")
    hashes = {entry["label"]: entry["hash"] for entry in stored["scenarios"]}
    assert hashes == {variant.label: variant.digest for variant in campaign.variants}


# The bars --------------------------------------------------------------------------------------


def pose_nees(name: str, label: str) -> pd.Series:
    return summary(name).loc[label, "run_nees_pose_mean"]


def test_on_the_hard_loop_the_invariant_filter_alone_stays_consistent():
    table = summary("hard-loop").loc["hard-loop"]
    assert 2.7 <= table.loc["ekf-ri", "run_nees_pose_mean"] <= 4.5
    assert table.loc["ekf-ri", "diverged_share"] <= 0.03
    assert table.loc["ekf", "run_nees_pose_mean"] >= 10 * table.loc["ekf-ri", "run_nees_pose_mean"]


def test_on_the_small_loop_only_the_standard_filters_are_overconfident():
    nees = pose_nees("loop-15", "loop-15")
    assert nees["ekf"] >= 1.4 * nees["ekf-ri"]
    for name in CONSISTENT:
        assert 2.6 <= nees[name] <= 3.8
    for name in (*CONSISTENT, "ekf-robocentric"):
        assert abs(nees[name] - nees["ekf-ideal"]) <= 0.20
    nis = summary("loop-15").loc["loop-15", "nis_per_dof"]
    assert nis[list(FAMILY)].between(0.98, 1.03).all()


@pytest.mark.parametrize("name", ["loop-15", "car-loop"])
def test_with_little_noise_all_filters_are_consistent(name):
    nees = pose_nees(name, f"{name} quiet")
    assert set(nees.index) > set(FAMILY)
    assert nees.between(2.6, 3.8).all()


def test_the_car_ends_where_the_standard_filter_does_not_believe_it_to_be():
    table = summary("car-loop").loc["car-loop"]
    assert table.loc["ekf", "run_nees_pose_mean"] - 3 > 5 * table.loc["ekf", "run_nees_pose_se"]
    for name in (*CONSISTENT, "ekf-ideal"):
        assert 2.6 <= table.loc[name, "run_nees_pose_mean"] <= 3.8


def test_an_uncertain_heading_makes_the_standard_filter_wrong_and_the_invariant_one_not():
    table = summary("heading-sweep")
    for angle in STARTS:
        invariant = table.loc[(start(angle), "ekf-ri")]
        off = abs(invariant["run_nees_pose_invariant_mean"] - 3)
        assert off < 4 * invariant["run_nees_pose_invariant_se"]
        sure, truly = invariant[["final_heading_sigma_rms_rad", "final_heading_rms_rad"]]
        assert 0.85 < sure / truly < 1.15
    worst = table.loc[(start("10 deg"), "ekf")]
    assert worst["run_nees_pose_invariant_mean"] > 15
    assert worst["final_heading_sigma_rms_rad"] < 0.5 * worst["final_heading_rms_rad"]


def test_the_circle_has_the_numbers_that_were_published():
    """Of the ukfm benchmark: rms within 20 %, NEES within 1.2 and, invariant, 0.25."""
    table = summary("circle").loc["circle"]
    heading, position = np.degrees(table["rms_heading_rad"]), table["rms_position_m"]
    of_heading, of_position = table["run_nees_heading_mean"], table["run_nees_position_mean"] / 2
    assert heading["ekf"] == pytest.approx(3.02, rel=0.2)
    assert position["ekf"] == pytest.approx(0.67, rel=0.2)
    assert heading["ekf-ri"] == pytest.approx(2.51, rel=0.2)
    assert position["ekf-ri"] == pytest.approx(0.55, rel=0.2)
    assert of_heading["ekf"] == pytest.approx(2.88, abs=1.2)
    assert of_position["ekf"] == pytest.approx(2.56, abs=1.2)
    assert of_heading["ekf-ri"] == pytest.approx(1.01, abs=0.25)
    assert of_position["ekf-ri"] == pytest.approx(1.17, abs=0.25)


def test_factors_carry_the_noise_that_was_drawn_and_filters_agree_with_them():
    table = summary("loop-15-rb").loc["loop-15-rb"]
    batch = table.loc["gtsam-batch (all)"]
    assert abs(batch["graph_chi2_per_dof"] - 1) < 4 * batch["graph_chi2_per_dof_sd"]
    for name in (*CONSISTENT, "ekf-ideal"):
        ratios = table.loc[name, ["sigma_ratio_position_median", "sigma_ratio_heading_median"]]
        assert ratios.between(0.98, 1.02).all()
        assert table.loc[name, "gap_final_mahalanobis2_median"] < 0.1
    assert table.loc["ekf", "sigma_ratio_heading_median"] < 0.8
