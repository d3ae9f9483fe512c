"""Figures of an option of an estimator: values against the option, the others as levels."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from drawn import runs_of, steps_of
from numpy.testing import assert_allclose

from ekfslam.evaluation.monte_carlo import summarise
from ekfslam.plots.options import lines_of, plot_options
from ekfslam.plots.style import LOOKS, look, looks

SEEDS = np.arange(10)
PARTICLES = (10, 100, 30)
NAMES = [f"fastslam2(particles={count}, seed=1)" for count in PARTICLES]


@pytest.fixture(scope="module")
def summary():
    rng = np.random.default_rng(3)
    steps, runs = [], []
    for name, error in zip([*NAMES, "ekf"], [0.3, 0.1, 0.2, 0.15], strict=True):
        columns = {"ate_position_rmse_m": error + 0.01 * rng.normal(size=10), "steps_skipped": 0}
        runs.append(runs_of(SEEDS, name, **columns))
        steps.append(steps_of(rng, SEEDS, estimator=name))
    return summarise(pd.concat(runs, ignore_index=True), pd.concat(steps, ignore_index=True))


def test_estimators_that_differ_in_one_number_make_a_line():
    lines = lines_of(["ekf", *NAMES, "ekf(confirm=1)", "ekf(confirm=2)", "ekf(association=joint)"])
    assert list(lines) == ["fastslam2(seed=1)"]
    assert lines["fastslam2(seed=1)"].option == "particles"
    assert list(lines["fastslam2(seed=1)"].names.values()) == [10.0, 100.0, 30.0]
    other = [name.replace("seed=1", "seed=2") for name in NAMES[:2]]
    assert len(lines_of([*NAMES, *other])) == 1  # two values make no figure


def test_the_line_goes_through_the_means_and_others_are_levels(summary):
    figure = plot_options(summary, looks([*NAMES, "ekf"]))["option"]
    panel = figure.axes[0]
    assert panel.get_title() == "position error, ATE [m]"
    assert panel.get_xlabel() == "particles"
    means = summary.set_index("estimator")["ate_position_rmse_m_mean"].astype(float)
    (line,) = [each for each in panel.lines if len(each.get_xdata()) == 3]
    assert_allclose(np.asarray(line.get_xdata(), float), [10, 30, 100])
    assert_allclose(
        np.asarray(line.get_ydata(), float), means[[NAMES[0], NAMES[2], NAMES[1]]].to_numpy()
    )
    levels = [each for each in panel.lines if each.get_color() == LOOKS["ekf"].color]
    assert_allclose(np.asarray(levels[0].get_ydata(), float), float(means["ekf"]))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "fastslam2(seed=1)",
        "ekf",
    ]


def test_without_an_option_there_is_no_figure(summary):
    assert plot_options(summary, looks(["ekf", "ekf-ri"])) == {}


def test_what_is_recovered_or_drawn_changes_no_look():
    assert look("gtsam-isam2(marginal_every=20)") == LOOKS["gtsam-isam2"]
    assert look("fastslam2(seed=4)") == LOOKS["fastslam2"]
    assert look("gtsam-fixed-lag(lag=9, marginals=False)") != LOOKS["gtsam-fixed-lag"]


def test_no_bar_ends_at_the_frame(summary):
    wide = summary.assign(ate_position_rmse_m_se=0.6 * summary["ate_position_rmse_m_mean"])
    for axes in plot_options(wide, looks([*NAMES, "ekf"]))["option"].axes:
        low, high = axes.get_ylim()
        for container in axes.containers:
            for ends in container.lines[2][0].get_segments():
                assert low < ends[:, 1].min() < ends[:, 1].max() < high
