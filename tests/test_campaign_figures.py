"""Figures of a campaign: what is drawn is what its tables say, and only what they have."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from campaigns import SMALL
from drawn import runs_of, steps_of
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from ekfslam.evaluation.monte_carlo import summarise
from ekfslam.evaluation.over_time import nees_over_time
from ekfslam.evaluation.paired import compare_pairs
from ekfslam.experiments import run_campaign
from ekfslam.plots import look, save
from ekfslam.plots.campaign import (
    POINTS,
    plot_campaign,
    plot_errors_over_time,
    plot_nees_over_time,
)
from ekfslam.plots.pairs import plot_pairs
from ekfslam.plots.run_means import plot_run_means
from ekfslam.plots.sheets import rows_of
from ekfslam.plots.style import LOOKS
from ekfslam.plots.sweeps import plot_sweeps

SEEDS = np.arange(30)
STEPS = np.arange(0, 100, 10)
SWEPT = {"1 deg": 1.0, "2 deg": 2.0, "8 deg": 8.0}
METRICS = ["nees_pose_mean_kept", "ate_position_rmse_m"]


def label(value):
    return f"sweep(prior.sigmas.2={value})"


def config_of(scenarios, estimators):
    return {
        "campaign": "trial",
        "scenarios": [
            {"label": name, "name": "loop", "swept": swept, "hash": ""}
            for name, swept in scenarios.items()
        ],
        "estimators": dict.fromkeys(estimators, ""),
    }


def figures_of(runs, steps, config):
    estimators = list(config["estimators"])
    pairs = compare_pairs(runs, METRICS, [(name, estimators[0]) for name in estimators[1:]])
    return plot_campaign(
        summary=summarise(runs, steps),
        over_time=nees_over_time(steps),
        runs=runs,
        pairs=pairs,
        config=config,
    )


def over_time(plot, steps):
    (figure,) = plot(nees_over_time(steps), "trial", LOOKS).values()
    return figure


def run_rows(rng, estimator, scenario, optimism, **columns):
    """Runs of an estimator whose NEES is so many times too large."""
    nees = optimism * rng.chisquare(3, len(SEEDS))
    given = {
        "nees_pose_mean_kept": nees,
        "nees_pose_invariant_mean_kept": 1.5 * nees,
        "ate_position_rmse_m": optimism * rng.uniform(0.1, 0.2, len(SEEDS)),
        "steps_skipped": 20,
        "nis_sum": 100.0,
        "nis_dof_sum": 100,
        "white_cross": 1.0,
        "white_before": 100.0,
        "white_after": 100.0,
        "white_terms": 100,
        "final_heading_error_rad": 0.1 * optimism,
        "final_heading_sigma_rad": 0.1,
    }
    return runs_of(SEEDS, estimator, scenario=scenario, **given | columns)


@pytest.fixture(scope="module")
def tables():
    """Runs and steps of three swept values: one estimator is consistent, one far from it."""
    rng = np.random.default_rng(20240901)
    kinds = [("ekf", 8.0), ("ekf-ri", 1.0)]
    runs = [
        run_rows(rng, name, label(value), optimism) for value in SWEPT for name, optimism in kinds
    ]
    steps = [
        steps_of(rng, SEEDS, STEPS, claimed=1 / optimism, estimator=name, scenario=label(value))
        for value in SWEPT
        for name, optimism in kinds
    ]
    return pd.concat(runs, ignore_index=True), pd.concat(steps, ignore_index=True)


@pytest.fixture(scope="module")
def config():
    return config_of({label(v): {"prior.sigmas.2": v} for v in SWEPT}, ["ekf", "ekf-ri"])


@pytest.fixture(scope="module")
def figures(tables, config):
    return figures_of(*tables, config)


def of(table, scenario, estimator="ekf"):
    return table[(table["scenario"] == scenario) & (table["estimator"] == estimator)]


def drawn(axes, estimator):
    """The line of an estimator."""
    color = look(estimator).color.lower()
    (line,) = [a for a in axes.lines if len(a.get_xdata()) > 2 and to_hex(a.get_color()) == color]
    return line


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]


# Over time ---------------------------------------------------------------------------------------


def test_mean_nees_is_drawn_against_the_interval_of_so_many_runs(tables, figures):
    figure = figures["nees-over-time"]
    assert titles(figure) == [f"{label(value)}: N = 30" for value in SWEPT]
    assert legend(figure) == ["ekf", "ekf-ri", "95 % interval of N runs"]
    for row, value in enumerate(SWEPT):
        for column, name in enumerate(["nees", "nees_invariant"]):
            axes = figure.axes[2 * row + column]
            for estimator in ("ekf", "ekf-ri"):
                rows = of(tables[1], label(value), estimator)
                expected = rows[rows["step"] >= 20].groupby("time_s")[name].mean()
                assert_allclose(drawn(axes, estimator).get_xdata(), expected.index)
                assert_allclose(drawn(axes, estimator).get_ydata(), expected)
            (band,) = [a for a in axes.collections if isinstance(a, PolyCollection)]
            heights = np.unique(band.get_paths()[0].vertices[:, 1])
            assert_allclose(heights, chi2.ppf([0.025, 0.975], 90) / 30)
            assert axes.get_ylim()[0] < heights[0] < heights[1] < axes.get_ylim()[1]


def test_estimators_that_failed_at_times_are_means_of_fewer_runs(tables):
    steps = tables[1]
    lacking = (steps["estimator"] == "ekf-ri") & (steps["seed"] < 10)
    figure = over_time(plot_nees_over_time, steps[~lacking])
    assert titles(figure)[0] == f"{label('1 deg')}: N = 20 to 30"
    (band,) = [a for a in figure.axes[0].collections if isinstance(a, PolyCollection)]
    low = band.get_paths()[0].vertices[:, 1].min()
    assert_allclose(low, chi2.ppf(0.025, 90) / 30)  # of those with most runs


@pytest.mark.parametrize(("factor", "scale"), [(1.0, "linear"), (100.0, "log")])
def test_nees_over_a_decade_has_a_logarithmic_axis(tables, factor, scale):
    consistent = of(tables[1], label("1 deg"), "ekf-ri")
    more = consistent.assign(estimator="ekf", nees=factor * consistent["nees"])
    figure = over_time(plot_nees_over_time, pd.concat([more, consistent], ignore_index=True))
    assert [axes.get_yscale() for axes in figure.axes] == [scale] * 2


def test_errors_stand_beside_what_is_claimed_on_one_scale(tables, figures):
    figure = figures["errors-over-time"]
    steps = tables[1][tables[1]["step"] >= 20]
    for row, value in enumerate(SWEPT):
        panels = figure.axes[4 * row : 4 * row + 4]
        for estimator in ("ekf", "ekf-ri"):
            rows = of(steps, label(value), estimator)
            squares = rows.assign(
                position=rows["error_x_m"] ** 2 + rows["error_y_m"] ** 2,
                claimed=rows["cov_xx"] + rows["cov_yy"],
                heading=np.degrees(1.0) ** 2 * rows["error_theta_rad"] ** 2,
                own=np.degrees(1.0) ** 2 * rows["cov_tt"],
            )
            means = squares.groupby("time_s")[["position", "claimed", "heading", "own"]].mean()
            for axes, name in zip(panels, means, strict=True):
                assert_allclose(drawn(axes, estimator).get_ydata(), np.sqrt(means[name]))
        for left, right in (panels[:2], panels[2:]):
            assert left.get_ylim() == right.get_ylim()
            assert left.get_ylim()[0] == 0
            highest = max(a.get_ydata().max() for p in (left, right) for a in p.lines)
            assert highest < left.get_ylim()[1] < 1.2 * highest
    labels = [axes.get_ylabel() for axes in figure.axes[:4]]
    assert labels == ["rms error [m]", "claimed σ [m]", "rms error [deg]", "claimed σ [deg]"]


def test_an_estimator_that_is_lost_is_cut_off_and_said_to_be(tables):
    fine = tables[1][tables[1]["scenario"] == label("1 deg")]
    lost = fine.copy()
    lost.loc[lost["estimator"] == "ekf", ["error_x_m", "error_y_m"]] *= 1e9
    panels = over_time(plot_errors_over_time, lost).axes
    before = over_time(plot_errors_over_time, fine).axes
    assert [text.get_text() for text in panels[0].texts] == ["1 cut off"]
    assert not panels[2].texts
    assert panels[0].get_ylim()[1] < 2 * before[0].get_ylim()[1]
    assert panels[2].get_ylim() == before[2].get_ylim()


def test_a_lost_filter_does_not_squash_the_nees_of_the_others_over_time(tables):
    fine = tables[1][(tables[1]["scenario"] == label("1 deg"))]
    lost = fine[fine["estimator"] == "ekf-ri"].assign(estimator="ekf")
    lost[["nees", "nees_invariant"]] = 1e9
    figure = over_time(plot_nees_over_time, pd.concat([fine[fine["estimator"] == "ekf-ri"], lost]))
    alone = over_time(plot_nees_over_time, fine[fine["estimator"] == "ekf-ri"])
    for (low, high), (own_low, own_high) in zip(
        *([axes.get_ylim() for axes in each.axes] for each in (figure, alone)), strict=True
    ):
        assert low == own_low
        assert own_high < high < 2 * own_high  # room for the words
    assert [text.get_text() for text in figure.axes[0].texts] == [
        "values above $10^{6}$ are cut off"
    ]
    assert not alone.axes[0].texts


@pytest.mark.parametrize("everywhere", [True, False])
def test_titles_say_who_failed_at_every_seed(tables, config, everywhere):
    runs, steps = tables
    mine = runs[runs["estimator"] == "ekf"].assign(estimator="mine")
    failed = everywhere | (mine["scenario"] == label("1 deg"))
    mine.loc[failed, "status"] = "failed"
    mine.loc[failed, [*METRICS, "nees_pose_invariant_mean_kept"]] = np.nan
    figures = plot_campaign(
        summary=summarise(pd.concat([runs, mine], ignore_index=True), steps),
        over_time=nees_over_time(steps),
        runs=pd.concat([runs, mine], ignore_index=True),
        pairs=compare_pairs(runs, METRICS, [("ekf-ri", "ekf")]),
        config=config | {"estimators": dict.fromkeys(["ekf", "ekf-ri", "mine"], "")},
    )
    where = "" if everywhere else f" on {label('1 deg')}"
    assert set(figures) == {"nees-over-time", "run-means", "errors-over-time", "pairs", "sweep"}
    for stem in figures:
        title = figures[stem].get_suptitle().replace("\n", " ")
        assert title.endswith(f" nothing to show of mine (failed{where})")


def test_long_runs_are_thinned_out_and_keep_their_ends():
    steps = steps_of(np.random.default_rng(3), SEEDS, np.arange(1000))
    times = drawn(over_time(plot_nees_over_time, steps).axes[0], "ekf").get_xdata()
    assert len(times) == POINTS
    assert times[[0, -1]].tolist() == [0.0, 499.5]


def test_coinciding_lines_have_markers_at_different_times():
    steps = steps_of(np.random.default_rng(4), SEEDS, np.arange(30))
    names = list(LOOKS)
    same = pd.concat([steps.assign(estimator=name) for name in names], ignore_index=True)
    axes = over_time(plot_nees_over_time, same).axes[0]
    places = []
    for name in names:
        first, every = drawn(axes, name).get_markevery()
        places += range(first, 30, every)
    assert len(places) == len(set(places)) >= len(names)


# Runs --------------------------------------------------------------------------------------------


def test_run_means_show_quartiles_median_mean_and_how_many_diverged(tables, figures):
    figure = figures["run-means"]
    runs = tables[0]
    assert titles(figure) == [f"{label(value)}: 30 runs" for value in SWEPT]
    for column, name in enumerate(["nees_pose_mean_kept", "nees_pose_invariant_mean_kept"]):
        axes = figure.axes[column]
        assert axes.get_xscale() == "log"
        for place, estimator in enumerate(["ekf", "ekf-ri"]):
            values = of(runs, label("1 deg"), estimator)[name].to_numpy()
            box = axes.patches[place]
            quartiles = np.quantile(values, [0.25, 0.75])
            assert_allclose([box.get_x(), box.get_x() + box.get_width()], quartiles)
            tails, median = axes.collections[2 * place : 2 * place + 2]
            ends = tails.get_segments()[0][:, 0]
            assert_allclose(ends, np.quantile(values, [0.05, 0.95]))
            assert_allclose(median.get_segments()[0][:, 0], np.median(values))
            beyond, mean = [
                a for a in axes.lines if to_hex(a.get_color()) == look(estimator).color.lower()
            ]
            assert_allclose(mean.get_xdata(), values.mean())
            assert_array_equal(beyond.get_xdata(), values[(values < ends[0]) | (values > ends[1])])
    counts = [(of(runs, label("1 deg"), name)["nees_pose_mean_kept"] > 20).sum() for name in LOOKS]
    said = [text.get_text() for text in figure.axes[1].texts]
    assert said == [f"{counts[0]} of 30", "0 of 30", "diverged"]
    assert 0 < counts[0] < 30


def test_a_run_without_a_finite_nees_is_counted_and_spoils_nothing(tables):
    runs = tables[0][tables[0]["scenario"] == label("1 deg")].copy()
    first = (runs["estimator"] == "ekf-ri") & (runs["seed"] == 3)
    runs.loc[first, ["nees_pose_mean_kept", "nees_pose_invariant_mean_kept"]] = np.nan
    runs.loc[first, "status"] = "diverged"
    second = (runs["estimator"] == "ekf-ri") & (runs["seed"] == 4)
    runs.loc[second, "nees_pose_mean_kept"] = 1e30
    (figure,) = plot_run_means(runs, summarise(runs), "trial", LOOKS).values()
    assert figure.axes[1].texts[1].get_text() == "2 of 30"
    assert figure.axes[0].get_xlim()[1] < 2e3
    assert figure.legends[0].get_texts()[-1].get_text() == "some above $10^{6}$"
    runs.loc[runs["estimator"] == "ekf-ri", "nees_pose_mean_kept"] = 1e30
    (figure,) = plot_run_means(runs, summarise(runs), "trial", LOOKS).values()
    assert figure.legends[0].get_texts()[-1].get_text() == "median above $10^{6}$"


# Pairs -------------------------------------------------------------------------------------------


def test_pairs_have_their_interval_and_are_filled_where_a_difference_is_seen(tables):
    runs = tables[0]
    alike = (runs["scenario"] == label("8 deg")) & (runs["estimator"] == "ekf-ri")
    ours = runs[(runs["scenario"] == label("8 deg")) & (runs["estimator"] == "ekf")]
    noise = np.random.default_rng(5).normal(0, 1e-3, len(SEEDS))
    runs = runs.copy()
    for metric in METRICS:
        runs.loc[alike, metric] = ours[metric].to_numpy() + noise
    pairs = compare_pairs(runs, METRICS, [("ekf-ri", "ekf")])
    (figure,) = plot_pairs(pairs, "trial", LOOKS).values()
    assert titles(figure) == [f"{label(value)}: 30 seeds" for value in SWEPT]
    assert [axes.get_xlabel() for axes in figure.axes[-2:]] == [
        "mean difference of\nnees_pose_mean_kept",
        "mean difference of\nate_position_rmse [m]",
    ]
    FigureCanvasAgg(figure).draw()
    left, right = (axes.xaxis.label.get_window_extent() for axes in figure.axes[-2:])
    assert left.x1 < right.x0
    assert figure.axes[0].get_yticklabels()[0].get_text() == "ekf-ri − ekf"
    seen = []
    for row, value in enumerate(SWEPT):
        for column, metric in enumerate(METRICS):
            axes = figure.axes[2 * row + column]
            mine = pairs[(pairs["scenario"] == label(value)) & (pairs["metric"] == metric)].iloc[0]
            (container,) = axes.containers
            assert_allclose(container.lines[0].get_xdata().astype(float), mine["mean_difference"])
            ends = container.lines[2][0].get_segments()[0][:, 0]
            mean, half = float(mine["mean_difference"]), float(mine["half_width"])
            assert_allclose(ends, [mean - half, mean + half])
            filled = to_hex(container.lines[0].get_markerfacecolor()) != "#ffffff"
            assert filled == pd.notna(mine["better"])
            seen.append(filled)
    assert set(seen) == {True, False}


def test_differences_over_decades_are_drawn_on_a_scale_that_shows_all(tables):
    wide = tables[0].copy()
    wide.loc[wide["scenario"] == label("8 deg"), "ate_position_rmse_m"] *= 1e4
    pairs = compare_pairs(wide, METRICS, [("ekf-ri", "ekf")])
    near, far = plot_pairs(pairs, "trial", LOOKS)["pairs"].axes[:2]
    assert (near.get_xscale(), far.get_xscale()) == ("linear", "symlog")
    FigureCanvasAgg(far.figure).draw()
    frame = far.get_window_extent()
    for container in far.containers:  # no mark at the edge is half of one
        mark = container.lines[0].get_window_extent()
        assert frame.x0 < mark.x0 - 3 < mark.x1 + 3 < frame.x1


def test_too_few_seeds_are_no_verdict(tables):
    few = tables[0][tables[0]["seed"] < 3]
    for runs, words in ((few, "too few seeds to tell"), (tables[0], "not seen")):
        pairs = compare_pairs(runs, METRICS, [("ekf-ri", "ekf")])
        (figure,) = plot_pairs(pairs, "trial", LOOKS).values()
        said = [text.get_text() for text in figure.legends[0].get_texts()]
        assert said[-1] == words
        assert (len(said) == 1) == (words != "not seen")


def test_a_series_that_competes_has_the_colour_of_its_estimator(tables):
    runs, steps = tables
    runs = runs[runs["scenario"] == label("1 deg")]
    steps = steps[steps["scenario"] == label("1 deg")]
    two = [
        table[table["estimator"] == "ekf"].assign(estimator="gtsam-isam2", series=series)
        for table in (runs, steps)
        for series in ("online", "smoothed")
    ]
    runs, steps = pd.concat([runs, *two[:2]]), pd.concat([steps, *two[2:]])
    names = ["ekf", "ekf-ri", "gtsam-isam2"]
    pairs = [("gtsam-isam2 (online)", "ekf-ri"), ("gtsam-isam2 (smoothed)", "ekf-ri")]
    figures = plot_campaign(
        summary=summarise(runs, steps),
        over_time=nees_over_time(steps.reset_index(drop=True)),
        runs=runs,
        pairs=compare_pairs(runs, METRICS, pairs),
        config=config_of({label("1 deg"): {}}, names),
    )
    for container in figures["pairs"].axes[0].containers:
        color = to_hex(container.lines[0].get_color())
        assert color == LOOKS["gtsam-isam2"].color.lower()
    # Online and smoothed are never mixed.
    expected = [f"{label('1 deg')}, {series}: N = 30" for series in ("online", "smoothed")]
    assert titles(figures["nees-over-time"]) == expected
    assert len(figures["nees-over-time"].axes[2].lines) == 1


# Sweeps ------------------------------------------------------------------------------------------


def test_a_sweep_is_drawn_against_its_value(tables, config, figures):
    figure = figures["sweep"]
    summary = summarise(*tables)
    assert figure.get_suptitle() == "sweep: 30 runs each; bars are one standard error"
    panels = {axes.get_title(): axes for axes in figure.axes}
    degrees = np.degrees(1.0)
    expected = {
        "mean NEES, (x, y, θ)": ("run_nees_pose_mean", 1.0),
        "mean NEES, invariant": ("run_nees_pose_invariant_mean", 1.0),
        "NIS per degree of freedom": ("nis_per_dof", 1.0),
        "final heading: rms error [deg]": ("final_heading_rms_rad", degrees),
        "final heading: claimed σ [deg]": ("final_heading_sigma_rms_rad", degrees),
        "correlation of innovations": ("white_rho", 1.0),
    }
    assert list(panels) == list(expected)
    for title, (column, unit) in expected.items():
        for container, name in zip(panels[title].containers, ["ekf", "ekf-ri"], strict=True):
            line = container.lines[0]
            assert to_hex(line.get_color()) == look(name).color.lower()
            assert_allclose(line.get_xdata(), list(SWEPT.values()), atol=0.03 * 7)
            rows = summary[summary["estimator"] == name]
            assert_allclose(line.get_ydata(), unit * rows[column].to_numpy(float))
    assert panels["mean NEES, invariant"].get_xlabel() == ""
    assert panels["final heading: claimed σ [deg]"].get_xlabel() == "prior.sigmas.2 [deg]"
    nees, invariant = (panels[f"mean NEES, {name}"] for name in ("(x, y, θ)", "invariant"))
    assert nees.get_ylim() == invariant.get_ylim()
    error, sigma = (figure.axes[3].get_ylim(), figure.axes[4].get_ylim())
    assert error == sigma
    bars = panels["mean NEES, (x, y, θ)"].containers[0].lines[2][0].get_segments()
    half = [0.5 * np.ptp(segment[:, 1]) for segment in bars]
    se = summary[summary["estimator"] == "ekf"]["run_nees_pose_se"].to_numpy(float)
    assert_allclose(half, se)


def test_values_that_are_no_numbers_are_set_out_in_their_order(tables):
    swept = {label(v): {"motion.sigmas": [0.1, n], "path.repeat": n} for n, v in enumerate(SWEPT)}
    labels = {f"sweep(motion.sigmas={n})": words for n, words in enumerate(swept.values())}
    renamed = dict(zip(swept, labels, strict=True))
    summary = summarise(tables[0].assign(scenario=tables[0]["scenario"].map(renamed)))
    axes = plot_sweeps(summary, config_of(labels, LOOKS), LOOKS)["sweep"].axes[-1]
    assert axes.get_xlabel() == "motion.sigmas, path.repeat"
    assert [text.get_text() for text in axes.get_xticklabels()] == [
        f"[0.1, {n}], {n}" for n in range(3)
    ]
    assert_allclose(axes.containers[0].lines[0].get_xdata(), [0, 1, 2], atol=0.06)


def test_what_was_not_swept_has_no_figure_of_a_sweep(tables):
    plain = config_of({label(value): {} for value in SWEPT}, LOOKS)
    assert plot_sweeps(summarise(tables[0]), plain, LOOKS) == {}


# All ---------------------------------------------------------------------------------------------


def test_an_estimator_has_one_colour_in_all_figures(tables):
    """Also one that is no estimator of the package and shares its own colour with another."""
    names = ["ekf", *(f"filter-{k}" for k in range(5))]
    assert len({look(name).color for name in names}) < len(names)
    rng = np.random.default_rng(6)
    runs = pd.concat([run_rows(rng, name, "loop", 2.0, steps_skipped=0) for name in names])
    # The first of them never gave a step, so that figures over time lack it.
    steps = pd.concat([steps_of(rng, SEEDS, STEPS, estimator=name) for name in names[2:]])
    figures = figures_of(runs, steps.reset_index(drop=True), config_of({"loop": {}}, names))
    forest = [to_hex(c.lines[0].get_color()) for c in figures["pairs"].axes[0].containers]
    boxes = [to_hex(p.get_facecolor()) for p in figures["run-means"].axes[0].patches]
    lines = [to_hex(a.get_color()) for a in figures["nees-over-time"].axes[0].lines]
    assert forest == boxes[1:]
    assert lines == boxes[2:]


def test_only_that_is_drawn_for_which_there_are_numbers(tables, config):
    """Runs without a truth have neither errors nor NEES, failed ones nothing at all."""
    runs, steps = tables
    blind = runs.assign(nees_pose_mean_kept=np.nan, nees_pose_invariant_mean_kept=np.nan)
    unknown = steps.assign(nees=np.nan, nees_invariant=np.nan)
    for name in ("error_x_m", "error_y_m", "error_theta_rad"):
        unknown[name] = np.nan
    assert set(figures_of(blind, unknown, config)) == {"pairs", "sweep"}
    failed = runs_of(SEEDS, "ekf", status="failed", robot=None, series=None)
    assert figures_of(failed, steps[:0], config_of({"loop": {}}, ["ekf"])) == {}


def test_many_scenarios_go_on_on_further_pages():
    rng = np.random.default_rng(7)
    names = [f"scenario {number}" for number in range(8)]
    runs = pd.concat(
        [run_rows(rng, e, name, 1.0) for name in names for e in ("ekf", "ekf-ri")],
        ignore_index=True,
    )
    steps = pd.concat(
        [
            steps_of(rng, SEEDS, STEPS, estimator=e, scenario=name)
            for name in names
            for e in ("ekf", "ekf-ri")
        ],
        ignore_index=True,
    )
    figures = figures_of(runs, steps, config_of({name: {} for name in names}, ["ekf", "ekf-ri"]))
    for stem in ("nees-over-time", "errors-over-time", "run-means", "pairs"):
        pages = [figures[key] for key in figures if key.startswith(stem)]
        shown = [title.partition(":")[0] for page in pages for title in titles(page)]
        assert shown == names
        assert all(page.get_size_inches()[1] < 9.5 for page in pages)
    assert "nees-over-time-2" in figures


def test_rows_are_told_apart_by_what_differs(tables):
    one = tables[1][tables[1]["scenario"] == label("1 deg")]
    assert [row.title for row in rows_of(one, "nees")] == [label("1 deg")]
    two = pd.concat([one.assign(robot="a"), one.assign(robot="b")])
    assert [row.title for row in rows_of(two, "nees")] == [f"{label('1 deg')}, {r}" for r in "ab"]


def test_files_are_small_and_the_same_each_time(figures, tmp_path):
    for stem, figure in figures.items():
        png, pdf = save(figure, tmp_path, stem)
        assert pdf.stat().st_size < 150_000
        assert pdf.read_bytes() == save(figure, tmp_path, "again")[1].read_bytes()
        assert b"/FontFile2" in pdf.read_bytes()
        assert png.stat().st_size < 1_000_000


def test_a_campaign_writes_its_figures_beside_its_tables(tmp_path):
    results = run_campaign(SMALL, tmp_path / "out")
    names = {path.name for path in results.save()}
    figures = {"nees-over-time", "run-means", "errors-over-time", "pairs", "sweep"}
    assert {name for name in names if name.endswith(".png")} == {f"{f}.png" for f in figures}
    assert {name for name in names if name.endswith(".pdf")} == {f"{f}.pdf" for f in figures}
    assert set(results.figures()) == figures


def test_a_filter_beyond_the_scale_is_an_arrow_at_the_edge_and_no_empty_row():
    from ekfslam.plots.run_means import _draw_box

    panel = Figure().add_subplot()
    for place, values in enumerate(([3.0] * 5, [1e8] * 5, [3.0] * 4 + [1e8])):
        _draw_box(panel, np.array(values), place, "#0072B2")
    arrows = [line for line in panel.lines if line.get_marker() == ">"]
    assert [line.get_ydata()[0] for line in arrows] == [1, 2]
    assert [line.get_markerfacecolor() for line in arrows] == ["#0072B2", "white"]
    assert 0.9 < arrows[0].get_xdata()[0] < 1
