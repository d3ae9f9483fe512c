"""Studies: every estimator on the same draws, statistics by hand, files that never change."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import ekfslam
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.evaluation import judged, tables
from ekfslam.experiments import association_study
from ekfslam.experiments.association import COLUMNS, METHODS
from ekfslam.experiments.study import paired, standard_error, summarised, sweep
from ekfslam.simulation import load_scenario, simulate


def orchard(steps=40):
    """The start of the world of the study."""
    scenario = load_scenario("orchard")
    return replace(scenario, controls=scenario.controls[:steps])


@pytest.fixture(scope="module")
def study():
    return association_study(orchard(), scales=(1.0, 4.0), seeds=3)


# The sweep --------------------------------------------------------------------------------------


class Refusing:
    """Does not apply, or raises."""

    def __init__(self, error, name):
        self.error, self.name = error, name

    def estimate(self, dataset):
        raise self.error


def test_a_row_for_every_draw_and_estimator_in_order():
    scenario = orchard(10)
    runs = sweep(scenario, ["ekf", "dead-reckoning"], scales=(2.0, 0.5), seeds=2)
    keys = runs[["odometry_noise", "seed", "estimator"]].to_numpy().tolist()
    assert keys == [
        [scale, seed, name]
        for scale in (2.0, 0.5)
        for seed in (0, 1)
        for name in ("ekf", "dead-reckoning")
    ]
    expected = [name for name in tables.SCHEMAS["summary"] if not name.startswith("time_")]
    assert list(runs) == [*expected[:2], "odometry_noise", *expected[2:]]


def test_a_row_is_what_one_run_gives():
    scenario = orchard(30)
    runs = sweep(scenario, ["ekf(association=joint, confirm=2)"], scales=(3.0,), seeds=3)
    data = simulate(scenario, seed=2, odometry_noise=3.0)
    estimate = ekfslam.estimate(data, "ekf", association="joint", confirm=2)
    expected = tables.summary_rows(data, judged(data, estimate)).iloc[0]
    for name in ("ate_position_rmse_m", "nees_pose_mean", "association_precision"):
        assert runs.iloc[2][name] == expected[name]
    assert runs.iloc[2]["estimator"] == "ekf(association=joint, confirm=2)"


def test_failures_are_rows():
    broken = [Refusing(RuntimeError("no"), "broken"), Refusing(UnsupportedError("why"), "odd")]
    runs = sweep(orchard(5), [*broken, "dead-reckoning"], seeds=2)
    assert runs["status"].tolist() == ["failed", "skipped", "ok"] * 2
    assert [text.partition(" (")[0] for text in runs["message"][:2]] == ["RuntimeError: no", "why"]


def test_several_processes_give_the_same_table():
    told = []
    alone, together = (
        sweep(
            orchard(5),
            ["dead-reckoning"],
            scales=(1, 2),
            seeds=2,
            workers=workers,
            watch=lambda *news: told.append(news),
        )
        for workers in (1, 2)
    )
    pd.testing.assert_frame_equal(alone, together, check_exact=True)
    assert alone.to_csv() == together.to_csv()
    assert [news[2:] for news in told] == [(done, 4) for done in range(5)] * 2
    assert told[1][:2] == ("orchard", "noise 1, seed 0")


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"estimators": []}, InputError, "nothing to study"),
        ({"estimators": ["efk"]}, UnknownNameError, "did you mean ekf"),
        ({"estimators": ["ekf(confirm=0)"]}, InputError, "confirm must be"),
        ({"estimators": ["ekf", "ekf()"]}, InputError, "two estimators are called ekf"),
        ({"scenario": "orchart"}, UnknownNameError, "did you mean orchard"),
        ({"scales": []}, InputError, "scales must be"),
        ({"scales": [1, 1.0]}, InputError, "scales must be different"),
        ({"scales": [-1]}, InputError, "non-negative"),
        ({"scales": [float("nan")]}, InputError, "scales must be"),
        ({"scales": [float("inf")]}, InputError, "scales must be"),
        ({"scales": ["1"]}, InputError, "scale of noise must be a number"),
        ({"seeds": 0}, InputError, "seeds must be a whole number from 1 on"),
        ({"seeds": 2.5}, InputError, "seeds must be"),
        ({"seeds": True}, InputError, "seeds must be"),
        ({"workers": 0}, InputError, "workers must be"),
    ],
)
def test_a_mistake_is_told_before_anything_runs(change, error, message):
    ran = []
    options = {"scenario": orchard(5), "estimators": ["ekf"], "scales": [1], "seeds": 1} | change
    with pytest.raises(error, match=message):
        sweep(**options, watch=lambda *news: ran.append(news))
    assert not ran


# Statistics -------------------------------------------------------------------------------------


def table(**columns):
    return pd.DataFrame({"status": "ok", "odometry_noise": 1.0} | columns)


def test_means_and_their_errors_by_hand():
    runs = table(
        kind=["a", "b", "a", "a", "a"],
        status=["ok", "ok", "diverged", "failed", "ok"],
        x=[1.0, 7.0, 4.0, 100.0, 10.0],
        y=[1.0, np.nan, np.nan, 3.0, 5.0],
    )
    first, second = (
        row for _, row in summarised(runs, ["kind"], {"x": "ex", "y": "why"}, ["x"]).iterrows()
    )
    assert (first["kind"], first["runs"], first["share_diverged"]) == ("a", 3, 1 / 3)
    assert first["ex_mean"] == 5.0
    assert first["ex_median"] == 4.0
    # Deviations -4, -1, 5: variance 42 / 2 of a run, a third of that of the mean.
    assert_allclose(first["ex_se"], np.sqrt(21 / 3))
    assert_allclose([first["why_mean"], first["why_se"]], [3.0, 2.0])
    assert (second["kind"], second["runs"], second["ex_mean"]) == ("b", 1, 7.0)
    assert np.isnan(second["ex_se"])
    assert np.isnan(second["why_mean"])


def test_the_standard_error_is_the_spread_of_means():
    means = np.random.default_rng(1).exponential(size=(4000, 20))
    claimed = np.mean([standard_error(pd.Series(row)) for row in means])
    # The root of an unbiased variance is a little small: by the variance of the variance, which
    # for the exponential (kurtosis 9) is (9 - 17/19) / 20 of the square: some 5 %.
    assert_allclose(claimed, means.mean(axis=1).std(), rtol=0.08)


def test_pairs_by_hand_and_what_draws_share_drops_out():
    seeds = [0, 1, 2, 3]
    shared = np.array([100.0, -50.0, 3.0, 8.0])
    a = table(kind="a", seed=seeds, x=shared + np.array([1.0, 2.0, 3.0, np.nan]))
    b = table(kind="b", seed=seeds[::-1], x=(shared + 2.5)[::-1])
    row = paired(pd.concat([a, b]), "kind", "a", "b", "x", "x_m").iloc[0]
    assert (row["kind"], row["against"], row["runs"]) == ("a", "b", 3)
    assert_allclose(row["x_m_difference_mean"], -0.5)
    assert_allclose(row["x_m_difference_se"], 1 / np.sqrt(3))
    assert_allclose(row["share_better"], 2 / 3)


def test_pairs_of_nothing_are_no_rows():
    assert not len(paired(table(kind=["a"], seed=[0], x=[1.0])[:0], "kind", "a", "b", "x", "x"))


# The study of association -----------------------------------------------------------------------


def test_the_tables_of_the_study(study):
    assert len(study.runs) == 2 * 3 * len(METHODS)
    assert study.summary[["odometry_noise", "method"]].to_numpy().tolist() == [
        [scale, method] for scale in (1.0, 4.0) for method in METHODS
    ]
    assert set(study.summary["runs"]) == {3}
    statistics = {f"{name}_{kind}" for name in COLUMNS.values() for kind in ("mean", "se")}
    assert set(study.summary) == statistics | {
        *("dataset", "odometry_noise", "method", "runs", "share_diverged"),
        *("ate_m_median", "nees_median"),
    }
    rows = study.runs[(study.runs["method"] == "joint") & (study.runs["odometry_noise"] == 4)]
    row = study.summary[
        (study.summary["method"] == "joint") & (study.summary["odometry_noise"] == 4)
    ].iloc[0]
    assert row["precision_mean"] == rows["association_precision"].mean()
    assert row["ate_m_median"] == rows["ate_position_rmse_m"].median()
    assert row["nees_mean"] == rows["nees_pose_mean"].mean()
    assert study.paired["odometry_noise"].tolist() == [1.0, 4.0]
    assert set(study.paired["method"] + study.paired["against"]) == {"jointnearest"}


def test_known_association_is_right_and_clutter_has_no_part_in_it(study):
    known = study.runs[study.runs["method"] == "known"]
    assert set(known["association_precision"]) == {1.0}
    assert set(known["association_recall"]) == {1.0}
    assert set(known["landmarks_spurious"]) == {0}
    others = study.runs[study.runs["method"] == "euclidean"]
    assert (others["association_precision"] < 1).any()


def test_methods_do_not_look_at_the_identities(study):
    """One dataset serves them all: it carries identities for the known association."""
    data = simulate(orchard(), seed=1, odometry_noise=4.0)
    assert not data.association_known
    for method in ("nearest", "joint", "euclidean"):
        estimate = ekfslam.estimate(data, "ekf", association=method, confirm=3, within=8)
        alone = tables.summary_rows(data, judged(data, estimate)).iloc[0]
        rows = study.runs[(study.runs["method"] == method) & (study.runs["seed"] == 1)]
        row = rows[rows["odometry_noise"] == 4.0].iloc[0]
        for name in ("ate_position_rmse_m", "association_precision", "association_recall"):
            assert row[name] == alone[name]


def test_the_study_twice_is_the_same_to_the_byte(tmp_path):
    studies = [association_study(orchard(15), ["joint", "nearest"], (2.0,), 2) for _ in range(2)]
    first, second = (each.save(tmp_path / str(k)) for k, each in enumerate(studies))
    assert [path.name for path in first] == [
        *("association.pdf", "association.png", "config.json"),
        *("paired.csv", "runs.csv", "summary.csv"),
    ]
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()
    for name in ("runs", "summary", "paired"):
        read = pd.read_csv(tmp_path / "0" / f"{name}.csv", dtype="string")
        expected = getattr(studies[0], name)
        assert list(read) == list(expected)
        numeric = expected.select_dtypes("float64")
        assert_array_equal(read[list(numeric)].astype("float64"), numeric)
    config = json.loads((tmp_path / "0" / "config.json").read_text())
    assert config == studies[0].config
    assert config["methods"] == ["joint", "nearest"]
    assert (config["confirm"], config["within"], config["seeds"]) == (3, 8, 2)


def test_options_of_tentative_landmarks_reach_the_filter():
    found = association_study(orchard(20), ["nearest"], (1.0,), seeds=1, confirm=2, within=4)
    assert found.runs["estimator"].tolist() == ["ekf(association=nearest, confirm=2, within=4)"]
    assert not len(found.paired)
    assert found.plot().axes


def test_what_the_study_refuses():
    with pytest.raises(InputError, match="team has several robots; this study is for one"):
        association_study("team")
    with pytest.raises(InputError, match="association must be one of known, nearest"):
        association_study(methods=["jiont"])
    with pytest.raises(InputError, match="a method is given twice in joint, joint"):
        association_study(methods=["joint", "joint"])
    with pytest.raises(InputError, match="confirm"):
        association_study(methods=["joint"], confirm=9, within=8)


def test_a_method_that_does_not_apply_is_a_row_without_numbers():
    scenario = load_scenario("cloister-bearing")
    short = replace(scenario, controls=scenario.controls[:5])
    found = association_study(short, ["nearest", "euclidean"], (1.0,), 1, confirm=1)
    assert found.runs["status"].tolist() == ["ok", "skipped"]
    assert found.summary["runs"].tolist() == [1, 0]
    assert np.isnan(found.summary["precision_mean"][1])
    assert found.plot().axes


# The figure -------------------------------------------------------------------------------------


def test_the_figure_shows_the_summary(study):
    from ekfslam.plots.style import METHODS as LOOKS

    figure = study.plot()
    panels = {axes.get_title(): axes for axes in figure.axes}
    assert len(panels) == 6
    for title, column in (
        ("precision", "precision"),
        ("recall", "recall"),
        ("ATE [m]", "ate_m"),
        ("NEES of the pose, mean", "nees"),
    ):
        containers = {c.get_label(): c for c in panels[title].containers}
        assert list(containers) == list(METHODS)
        for method in METHODS:
            rows = study.summary[study.summary["method"] == method]
            line, _, (bars,) = containers[method]
            assert_allclose(line.get_ydata(), rows[f"{column}_mean"])
            assert line.get_color() == LOOKS[method].color
            heights = [np.ptp(segment[:, 1]) / 2 for segment in bars.get_segments()]
            assert_allclose(heights, rows[f"{column}_se"], atol=1e-12)
    ticks = [label.get_text() for label in figure.axes[-1].get_xticklabels()]
    assert ticks == ["1", "4"]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [*METHODS, "expected: 3"]
