"""Statistics over runs: intervals and their coverage, credibility, pooled numbers, counts."""

import numpy as np
import pandas as pd
import pytest
from drawn import runs_of, steps_of
from scipy.stats import chi2, t
from tabulated import documented

from ekfslam.errors import InputError
from ekfslam.evaluation import (
    chi2_interval,
    credibility,
    nees_over_time,
    runs_needed,
    summarise,
)
from ekfslam.evaluation.monte_carlo import STATISTICS
from ekfslam.evaluation.over_time import CREDIBILITY, OVER_TIME
from ekfslam.evaluation.paired import PAIRS
from ekfslam.evaluation.run_metrics import RUN_METRICS

GROUP = ["scenario", "estimator", "series", "robot"]


def numbers(seeds, value, **columns):
    """Runs with the same number in all columns that are not given."""
    table = runs_of(seeds, **columns)
    for name, dtype in table.dtypes.items():
        if str(dtype) == "float64" and table[name].isna().all():
            table[name] = value
    return table


def assert_same(one, other):
    """Two tables whose rows may be in another order, and numbers differ by rounding."""
    keys = [name for name in (*GROUP, "step") if name in one]
    one, other = (each.sort_values(keys).reset_index(drop=True) for each in (one, other))
    pd.testing.assert_frame_equal(one, other, check_exact=False, rtol=1e-10, atol=1e-12)


# Columns and documentation ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("heading", "schema"),
    [
        ("Metrics of a run", RUN_METRICS),
        ("Over time", OVER_TIME),
        ("Credibility", CREDIBILITY),
        ("Statistics", STATISTICS),
        ("Pairs", PAIRS),
    ],
)
def test_every_column_is_documented(heading, schema):
    assert documented("Campaign tables")[heading] == list(schema)


def test_tables_have_their_columns_and_dtypes(rng):
    runs, steps = numbers(range(8), 1.0), steps_of(rng, range(8))
    for table, schema in (
        (nees_over_time(steps), OVER_TIME),
        (credibility(steps), CREDIBILITY),
        (summarise(runs, steps), STATISTICS),
        (summarise(runs), STATISTICS),
        (nees_over_time(steps[:0]), OVER_TIME),
        (credibility(steps[:0]), CREDIBILITY),
        (summarise(runs[:0], steps[:0]), STATISTICS),
    ):
        assert dict(table.dtypes.astype(str)) == dict(schema)
        assert list(table) == list(schema)


# Over time --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "printed"), [(50, (2.36, 3.72)), (200, (2.67, 3.35)), (500, (2.79, 3.22))]
)
def test_the_interval_of_a_mean_over_runs_is_that_printed(rng, count, printed):
    table = nees_over_time(steps_of(rng, range(count), [4]))
    assert table["nees_runs"].tolist() == [count]
    np.testing.assert_allclose(table[["nees_low", "nees_high"]].iloc[0], printed, atol=5.1e-3)
    exact = chi2.ppf([0.025, 0.975], 3 * count) / count
    np.testing.assert_allclose(table[["nees_low", "nees_high"]].iloc[0], exact, rtol=1e-12)


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_the_interval_covers_what_it_says(rng, probability):
    """Two thousand times: independent draws, so the count is binomial."""
    times = 2000
    table = nees_over_time(steps_of(rng, range(15), range(times)), probability)
    inside = (table["nees_mean"] > table["nees_low"]) & (table["nees_mean"] < table["nees_high"])
    spread = np.sqrt(probability * (1 - probability) / times)
    assert inside.mean() == pytest.approx(probability, abs=4 * spread)
    assert (table["probability"] == probability).all()
    optimistic = nees_over_time(steps_of(rng, range(15), range(200), claimed=0.4), probability)
    assert (optimistic["nees_mean"] > optimistic["nees_high"]).mean() > 0.9


def test_numbers_over_time_are_those_of_loops(rng):
    steps = pd.concat(
        [
            steps_of(rng, range(6), [3, 9]),
            steps_of(rng, range(4), [3, 9], estimator="other", series="smoothed"),
            steps_of(rng, range(3), [9], scenario="far", robot="second"),
        ]
    )
    table = nees_over_time(steps)
    assert table["estimator"].tolist() == ["ekf", "ekf", "other", "other", "ekf"]
    assert table["step"].tolist() == [3, 9, 3, 9, 9]
    assert table["runs"].tolist() == [6, 6, 4, 4, 3]
    for _, row in table.iterrows():
        mine = steps[(steps[[*GROUP, "step"]] == row[[*GROUP, "step"]]).all(axis=1)]
        e = mine[["error_x_m", "error_y_m", "error_theta_rad"]].to_numpy()
        S = e.T @ e / len(e)
        names = ["mse_xx", "mse_xy", "mse_xt", "mse_yy", "mse_yt", "mse_tt"]
        np.testing.assert_allclose(row[names].astype(float), S[np.triu_indices(3)], rtol=1e-12)
        assert row["rms_position_m"] == pytest.approx(np.sqrt(S[0, 0] + S[1, 1]))
        assert row["rms_heading_rad"] == pytest.approx(np.sqrt(S[2, 2]))
        sigma = np.sqrt(np.mean(mine["cov_xx"] + mine["cov_yy"]))
        assert row["sigma_position_m"] == pytest.approx(sigma)
        assert row["sigma_heading_rad"] == pytest.approx(np.sqrt(mine["cov_tt"].mean()))
        assert row["nees_mean"] == pytest.approx(mine["nees"].mean())
        assert row["nees_invariant_mean"] == pytest.approx(1.1 * mine["nees"].mean())
        assert row["time_s"] == row["step"] / 2


def test_skipped_nees_does_not_count_as_a_run(rng):
    steps = steps_of(rng, range(10), [2, 5])
    steps.loc[(steps["step"] == 2) & (steps["seed"] < 4), "nees"] = np.nan
    steps.loc[(steps["step"] == 5), "nees"] = np.nan
    table = nees_over_time(steps)
    assert table["runs"].tolist() == [10, 10]
    assert table["nees_runs"].tolist() == [6, 0]
    assert table["nees_high"][0] == pytest.approx(chi2_interval(3, samples=6)[1])
    assert table.loc[1, ["nees_mean", "nees_low", "nees_high"]].isna().all()


@pytest.mark.parametrize("function", [nees_over_time, credibility])
def test_rows_may_come_in_any_order_but_not_twice(rng, function):
    steps = pd.concat([steps_of(rng, range(9)), steps_of(rng, range(9), estimator="other")])
    shuffled = steps.sample(frac=1, random_state=3)
    assert_same(function(steps), function(shuffled))
    with pytest.raises(InputError, match="steps holds a row twice: scenario loop, estimator ekf"):
        function(pd.concat([steps, steps[:1]]))
    with pytest.raises(InputError, match="steps lacks the columns error_y_m"):
        function(steps.drop(columns="error_y_m"))


# Credibility (Li and Zhao 2006) -----------------------------------------------------------------


def test_credibility_is_the_definition(rng):
    steps = steps_of(rng, range(12), [1, 2], claimed=0.5)
    steps.loc[3, "nees"] = np.nan
    table = credibility(steps)
    for at, (_, mine) in zip((0, 1), steps.groupby("step"), strict=True):
        e = mine[["error_x_m", "error_y_m", "error_theta_rad"]].to_numpy()
        S = sum(np.outer(each, each) for each in e) / len(e)
        gamma = []
        for each, (_, row) in zip(e, mine.iterrows(), strict=True):
            P = np.array(
                [
                    [row["cov_xx"], row["cov_xy"], row["cov_xt"]],
                    [row["cov_xy"], row["cov_yy"], row["cov_yt"]],
                    [row["cov_xt"], row["cov_yt"], row["cov_tt"]],
                ]
            )
            ratio = (each @ np.linalg.inv(P) @ each) / (each @ np.linalg.inv(S) @ each)
            if not np.isnan(row["nees"]):
                gamma.append(10 * np.log10(ratio))
        assert table["nci_db"][at] == pytest.approx(np.mean(np.abs(gamma)), rel=1e-9)
        assert table["inclination_db"][at] == pytest.approx(np.mean(gamma), rel=1e-9)
        assert table["runs"][at] == len(gamma)


@pytest.mark.parametrize("claimed", [0.25, 1.0, 4.0])
def test_a_covariance_that_is_off_by_a_factor_is_off_by_so_many_decibels(rng, claimed):
    """With many runs S is the true covariance, and every gamma is the factor in decibels."""
    table = credibility(steps_of(rng, range(4000), [1], claimed))
    expected = -10 * np.log10(claimed)
    # Each of the six numbers of S is off by sqrt(2 / 4000) or less.
    assert table["inclination_db"][0] == pytest.approx(expected, abs=0.3)
    assert table["nci_db"][0] == pytest.approx(abs(expected), abs=0.3)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_too_few_runs_for_a_covariance_give_no_credibility(rng, count):
    table = credibility(steps_of(rng, range(count)))
    assert table[["nci_db", "inclination_db"]].isna().all(axis=None) == (count < 3)


def test_an_error_of_nothing_is_left_out(rng):
    steps = steps_of(rng, range(8), [1])
    steps.loc[0, ["error_x_m", "error_y_m", "error_theta_rad", "nees"]] = 0.0
    assert credibility(steps)["runs"][0] == 7


# Statistics -------------------------------------------------------------------------------------


def test_means_medians_and_standard_errors_are_those_of_the_runs(rng):
    values = rng.gamma(1.5, 2.0, 30)
    runs = numbers(range(30), 1.0, nees_pose_mean_kept=values, gap_final_position_m=values)
    row = summarise(runs).iloc[0]
    assert row["run_nees_pose_mean"] == pytest.approx(values.mean())
    assert row["run_nees_pose_se"] == pytest.approx(values.std(ddof=1) / np.sqrt(30))
    assert row["run_nees_pose_median"] == pytest.approx(np.median(values))
    assert row["gap_final_position_m_median"] == pytest.approx(np.median(values))
    assert (row["run_nees_pose_invariant_mean"], row["run_nees_pose_invariant_se"]) == (1.0, 0.0)
    assert row["runs"] == row["nees_runs"] == 30


def test_the_standard_error_covers_the_mean_of_many_campaigns(rng):
    """Mean plus and minus t times its standard error, over 400 campaigns of 25 normal runs."""
    values, scenario = rng.normal(3.0, 0.5, 400 * 25), np.repeat(np.arange(400), 25)
    seeds = np.tile(np.arange(25), 400)
    table = numbers(seeds, 1.0, nees_pose_mean_kept=values, scenario=scenario.astype(str))
    table = summarise(table)
    reach = t.ppf(0.975, 24) * table["run_nees_pose_se"]
    covered = ((table["run_nees_pose_mean"] - 3.0).abs() < reach).mean()
    assert covered == pytest.approx(0.95, abs=4 * np.sqrt(0.05 * 0.95 / 400))


def test_a_single_run_has_no_standard_error():
    row = summarise(numbers([4], 2.5)).iloc[0]
    assert row["run_nees_pose_mean"] == 2.5
    assert np.isnan(row["run_nees_pose_se"])
    assert np.isnan(row["white_rho_se"])


def test_final_nees_has_the_interval_of_the_runs_that_have_one():
    final = np.full(20, 3.0)
    final[:5] = np.nan
    row = summarise(numbers(range(20), 1.0, nees_pose_final=final)).iloc[0]
    expected = chi2.ppf([0.025, 0.975], 45) / 15
    assert row["final_nees_runs"] == 15
    np.testing.assert_allclose(
        row[["final_nees_low_95", "final_nees_high_95"]].astype(float), expected, rtol=1e-12
    )


def test_diverged_runs_are_counted_by_status_and_by_nees_and_stay_in_the_means():
    status = ["ok", "diverged", "ok", "diverged", "ok"]
    nees = [3.0, 2.0, 25.0, 99.0, np.nan]
    runs = numbers(range(5), 1.0, status=status, nees_pose_mean_kept=nees)
    row = summarise(runs).iloc[0]
    counts = ["runs", "diverged", "diverged_by_status", "diverged_by_nees"]
    assert row[counts].tolist() == [5, 3, 2, 2]
    assert row["diverged_share"] == 0.6
    assert row["run_nees_pose_mean"] == pytest.approx(129 / 4)
    assert summarise(runs, diverged_above=30.0).iloc[0]["diverged_by_nees"] == 1
    with pytest.raises(InputError, match="diverged_above"):
        summarise(runs, diverged_above=0.0)


def test_failed_and_skipped_runs_are_counted_where_their_estimator_is():
    gone = {"series": None, "robot": None}
    runs = pd.concat(
        [
            numbers(range(3), 2.0),
            numbers(range(3), 4.0, series="smoothed"),
            runs_of([3, 4], status="failed", **gone),
            runs_of([5], status="skipped", **gone),
            runs_of([0, 1], "never", status="failed", **gone),
            runs_of([2], "never", status="skipped", **gone),
            numbers(range(6), 1.0, estimator="fine"),
        ]
    )
    table = summarise(runs).set_index(["estimator", "series"])
    counts = table[["runs", "failed", "skipped"]].to_numpy().tolist()
    assert counts == [[3, 2, 1], [3, 2, 1], [0, 2, 1], [6, 0, 0]]
    assert table.index[2][0] == "never"
    assert table["run_nees_pose_mean"].tolist()[:2] == [2.0, 4.0]
    assert table.iloc[2].filter(regex="mean|median|_se|rms|nis|white|graph|low|high").isna().all()
    only = summarise(runs[runs["estimator"] == "never"])
    assert only[["runs", "failed", "skipped"]].to_numpy().tolist() == [[0, 2, 1]]


def test_pooled_nis_and_graph_are_exact():
    """Not the mean of ratios: runs of unlike length weigh by their degrees of freedom."""
    runs = numbers(
        range(3),
        1.0,
        nis_sum=[10.0, 400.0, np.nan],
        nis_dof_sum=[20, 380, None],
        graph_error=[10.0, 100.0, 7.0],
        graph_dof=[30, 190, None],
    )
    row = summarise(runs).iloc[0]
    assert row["nis_per_dof"] == 410 / 400
    assert row["nis_dof"] == 400
    assert row["nis_per_dof_sd"] == np.sqrt(2 / 400)
    assert row["graph_chi2_per_dof"] == 220 / 220
    assert row["graph_chi2_per_dof_sd"] == np.sqrt(2 / 220)


def test_pooled_nis_scatters_as_it_says(rng):
    """Sums of chi-square numbers over 400 campaigns, in units of the stated deviation."""
    dof, scenario = rng.integers(50, 200, 2000), np.repeat(np.arange(400), 5).astype(str)
    columns = {"nis_dof_sum": dof, "nis_sum": rng.chisquare(dof), "scenario": scenario}
    runs = numbers(np.tile(np.arange(5), 400), 1.0, **columns)
    table = summarise(runs)
    z = (table["nis_per_dof"] - 1) / table["nis_per_dof_sd"]
    assert z.mean() == pytest.approx(0, abs=4 / np.sqrt(400))
    assert z.var() == pytest.approx(1, abs=4 * np.sqrt(2.5 / 400))


def white_runs(w, scenario):
    """Runs with sums of whiteness of a series of numbers (runs, terms)."""
    before, after = w[:, :-1], w[:, 1:]
    return numbers(
        np.arange(len(w)),
        1.0,
        scenario=scenario,
        white_cross=(before * after).sum(axis=1),
        white_before=(before**2).sum(axis=1),
        white_after=(after**2).sum(axis=1),
        white_terms=np.full(len(w), before.shape[1]),
    )


def test_whiteness_pools_runs_and_sees_correlation(rng):
    w = rng.normal(size=(20, 301))
    smoothed = (w[:, 1:] + 0.5 * w[:, :-1]) / np.sqrt(1.25)  # correlation 0.4 at lag 1
    table = summarise(pd.concat([white_runs(w, "a"), white_runs(smoothed, "b")]))
    white, coloured = table.iloc[0], table.iloc[1]
    expected = (w[:, 1:] * w[:, :-1]).sum()
    expected /= np.sqrt((w[:, 1:] ** 2).sum() * (w[:, :-1] ** 2).sum())
    assert white["white_rho"] == pytest.approx(expected, rel=1e-12)
    assert white["white_rho_sd"] == 1 / np.sqrt(20 * 300)
    assert abs(white["white_rho"]) < 4 * white["white_rho_sd"]
    assert coloured["white_rho"] == pytest.approx(0.4, abs=4 * coloured["white_rho_sd"])


@pytest.mark.parametrize("shape", [0.0, 1.0])
def test_the_standard_error_of_rho_holds_where_products_depend_on_each_other(rng, shape):
    """Every product twice: rho scatters by root two more than its terms say; the error knows.

    It knows, too, where rho is not zero.
    """
    campaigns, count = 400, 30
    w = rng.normal(size=(campaigns * count, 42))
    runs = white_runs(w[:, 1:] + shape * w[:, :-1], "")
    runs["scenario"] = np.repeat(np.arange(campaigns), count).astype(str)
    runs["white_terms"] = 80
    table = summarise(runs)
    variance = (count - 1) / (count - 3)  # of Student's t
    off = table["white_rho"] - shape / (1 + shape**2)
    z = off / table["white_rho_se"]
    assert z.var() == pytest.approx(variance, abs=4 * variance * np.sqrt(2.2 / campaigns))
    if not shape:
        told = table["white_rho"] / table["white_rho_sd"]
        assert told.var() == pytest.approx(2.0, abs=4 * 2.0 * np.sqrt(2.2 / campaigns))


def test_both_ways_to_form_an_rms_over_runs(rng):
    steps = steps_of(rng, range(10), [0, 4, 8])
    steps.loc[steps["step"] == 8, ["error_x_m", "error_theta_rad"]] *= 5.0
    kept = steps[steps["step"] >= 3]
    position, heading = (
        kept["error_x_m"] ** 2 + kept["error_y_m"] ** 2,
        kept["error_theta_rad"] ** 2,
    )
    runs = numbers(
        range(10),
        1.0,
        steps_skipped=np.full(10, 3),
        position_mse_kept_m2=position.groupby(kept["seed"]).mean().to_numpy(),
        heading_mse_kept_rad2=heading.groupby(kept["seed"]).mean().to_numpy(),
    )
    row = summarise(runs, steps).iloc[0]
    for square, name, unit in ((position, "position", "m"), (heading, "heading", "rad")):
        at_each = square.groupby(kept["step"]).mean()
        assert row[f"rms_{name}_{unit}"] == pytest.approx(np.sqrt(at_each.mean()))
        assert row[f"rms_{name}_time_mean_{unit}"] == pytest.approx(np.sqrt(at_each).mean())
    assert row["rms_position_time_mean_m"] < 0.95 * row["rms_position_m"]
    assert row["steps_skipped"] == 3


def test_roots_of_mean_squares_of_the_last_pose():
    runs = numbers(
        range(2), 1.0, final_heading_error_rad=[0.3, 0.4], final_heading_sigma_rad=[1, 7]
    )
    row = summarise(runs).iloc[0]
    assert row["final_heading_rms_rad"] == pytest.approx(np.sqrt(0.125))
    assert row["final_heading_sigma_rms_rad"] == pytest.approx(5.0)


def test_credibility_is_that_of_the_last_step(rng):
    steps = pd.concat(
        [steps_of(rng, range(12), [3, 30]), steps_of(rng, range(12), [3, 20], estimator="other")]
    )
    runs = pd.concat([numbers(range(12), 1.0), numbers(range(12), 1.0, estimator="other")])
    table, whole = summarise(runs, steps), credibility(steps)
    assert table["credibility_step"].tolist() == [30, 20]
    columns = ["nci_db", "inclination_db"]
    np.testing.assert_allclose(table[columns], whole[columns].iloc[[1, 3]], rtol=1e-12)


def test_runs_may_come_in_any_order_but_not_twice(rng):
    values = rng.normal(size=24)
    runs = pd.concat(
        [
            numbers(range(12), 1.0, nees_pose_mean_kept=values[:12]),
            numbers(range(12), 1.0, estimator="other", nees_pose_mean_kept=values[12:]),
        ]
    )
    steps = steps_of(rng, range(12))
    shuffled = summarise(runs.sample(frac=1, random_state=1), steps.sample(frac=1, random_state=2))
    assert_same(summarise(runs, steps), shuffled)
    with pytest.raises(InputError, match=r"runs holds a row twice: .* seed 3"):
        summarise(pd.concat([runs, runs[3:4]]))
    with pytest.raises(InputError, match="runs lacks the columns nis_sum, white_cross"):
        summarise(runs.drop(columns=["nis_sum", "white_cross"]))


def test_a_run_that_overflowed_does_not_warn():
    runs = numbers(
        range(3), 1.0, nees_pose_mean_kept=[1.0, np.inf, 1e300], final_heading_error_rad=1e200
    )
    row = summarise(runs).iloc[0]
    assert row["run_nees_pose_mean"] == row["final_heading_rms_rad"] == np.inf
    assert row["run_nees_pose_median"] == 1e300


# Number of runs ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("deviation", "half_width"), [(1.0, 0.5), (2.16, 0.2), (0.3, 1.0), (1, 1e-4)]
)
@pytest.mark.parametrize("probability", [0.8, 0.95])
def test_the_number_of_runs_is_the_smallest_that_is_enough(deviation, half_width, probability):
    pilot = 7.0 + deviation * np.sqrt(9 / 10) * np.array([1.0, -1.0] * 5)
    n = runs_needed(pilot, half_width, probability)

    def width(n):
        return t.ppf(0.5 + probability / 2, n - 1) * deviation / np.sqrt(n)

    assert width(n) <= half_width * (1 + 1e-12)
    assert n == 2 or width(n - 1) > half_width


def test_a_spread_of_two_needs_five_hundred_runs_for_a_fifth():
    """Run means of NEES that scatter by 2.16: a mean within 0.2 takes hundreds of runs."""
    assert 448 < runs_needed([3 - 2.16 / np.sqrt(2), 3 + 2.16 / np.sqrt(2)], 0.2) < 456


def test_intervals_of_the_number_of_runs_are_as_narrow_as_asked(rng):
    """Half of the campaigns of this size are narrower, and 95 % of them cover the mean."""
    n = runs_needed(rng.normal(size=4000), 0.3)
    draws = rng.normal(size=(3000, n))
    half = t.ppf(0.975, n - 1) * draws.std(axis=1, ddof=1) / np.sqrt(n)
    assert np.median(half) == pytest.approx(0.3, rel=0.05)
    covered = np.mean(np.abs(draws.mean(axis=1)) < half)
    assert covered == pytest.approx(0.95, abs=4 * np.sqrt(0.05 * 0.95 / 3000))


def test_pilots_that_tell_nothing_are_refused():
    assert runs_needed([1.0, np.nan, 1.0], 0.1) == 2
    for pilot in ([1.0], [1.0, np.nan], [1.0, np.inf], []):
        with pytest.raises(InputError, match="pilot"):
            runs_needed(pilot, 0.1)
    for width in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(InputError, match="half_width"):
            runs_needed([1.0, 2.0], width)
    with pytest.raises(InputError, match="probability"):
        runs_needed([1.0, 2.0], 0.1, 1.0)
