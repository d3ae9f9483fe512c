"""Estimators side by side: tables, statuses, files and figures."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import ekfslam
from ekfslam.dataset import Prior
from ekfslam.errors import FileFormatError, InputError, UnknownNameError, UnsupportedError
from ekfslam.estimates import Estimate, Innovations, Trajectory
from ekfslam.evaluation import tables
from ekfslam.experiments import compare
from ekfslam.filters.ekf import Ekf
from ekfslam.simulation import load_scenario, simulate

FOUR = ("ekf", "gtsam-batch", "gtsam-isam2", "dead-reckoning")
STEPS = 40

SUMMARY = """
    dataset seed robot estimator series association alignment status message steps truth_poses
    observations landmarks_true landmarks_estimated landmarks_undetermined landmarks_matched
    landmarks_missed landmarks_spurious landmarks_duplicate landmarks_merged association_precision
    association_recall ate_position_rmse_m ate_position_max_m ate_heading_rmse_rad
    rpe_position_rmse_m rpe_heading_rmse_rad landmark_rmse_m landmark_max_m nees_pose_mean
    nees_pose_final nees_pose_invariant_mean nees_pose_inside_95 nees_position_mean
    nees_position_inside_95 nees_landmark_mean nis_per_dof nis_inside_95 effective_samples_mean
    effective_samples_min graph_error graph_chi2_per_dof gap_final_position_m gap_final_heading_rad
    gap_landmark_rmse_m sigma_ratio_position sigma_ratio_heading time_total_s time_marginals_s
    time_per_step_mean_us time_per_step_median_us time_per_step_p99_us
"""


def short(name, seed=1, steps=STEPS):
    """The start of a scenario that comes with the package."""
    scenario = load_scenario(name)
    return simulate(replace(scenario, controls=scenario.controls[:steps]), seed=seed)


@pytest.fixture(scope="module")
def data():
    return short("cloister")


@pytest.fixture(scope="module")
def comparison(data):
    """Four estimators on a range-bearing and on an xy problem."""
    return compare([data, short("loop-15")], FOUR, rpe_distance=1.0)


@pytest.fixture(scope="module")
def plain(data):
    """Something small to save."""
    return compare(data, "dead-reckoning")


class Misbehaving:
    """An estimator that does what it is told, after a good estimate was made."""

    def __init__(self, act, name="misbehaving"):
        self.act, self.name, self.calls = act, name, 0

    def estimate(self, dataset):
        self.calls += 1
        return self.act(Ekf().estimate(dataset))


def raises(error):
    def act(_):
        raise error

    return act


def changed(**changes):
    return lambda good: replace(good, **{k: v(good) for k, v in changes.items()})


def only(table, **keys):
    """The rows in which columns have the given values."""
    for key, value in keys.items():
        table = table[table[key] == value]
    return table


# Tables -----------------------------------------------------------------------------------------


def test_the_map_of_those_who_know_it_shows_the_landmarks_that_they_know(data):
    (axes,) = compare(data, "ekf-localization").plot_map().axes
    (shown,) = [line for line in axes.lines if line.get_label() == "true landmark"]
    np.testing.assert_array_equal(np.column_stack(shown.get_data()), data.known_map.positions)


def test_the_tables_have_the_documented_columns(comparison):
    assert list(comparison.summary.columns) == SUMMARY.split()
    for name, schema in tables.SCHEMAS.items():
        table = getattr(comparison, name)
        assert dict(table.dtypes.astype(str)) == dict(schema)
        assert len(table)


def test_one_row_for_each_dataset_estimator_and_series(comparison):
    keys = comparison.summary[["dataset", "estimator", "series"]].to_numpy().tolist()
    series = [
        ["ekf", "online"],
        ["gtsam-batch", "smoothed"],
        ["gtsam-isam2", "online"],
        ["gtsam-isam2", "smoothed"],
        ["dead-reckoning", "online"],
    ]
    assert keys == [[name, *rest] for name in ("cloister", "loop-15") for rest in series]
    assert set(comparison.summary["status"]) == {"ok"}
    assert set(comparison.summary["seed"]) == {1}
    assert set(comparison.summary["steps"]) == {STEPS + 1}


def test_rows_of_the_long_tables(comparison):
    for name, data in comparison.datasets.items():
        trajectories = only(comparison.trajectories, dataset=name)
        assert len(trajectories) == 5 * data.poses
        for _, rows in trajectories.groupby(["estimator", "series"]):
            assert rows["step"].tolist() == list(range(data.poses))
        seen = len(np.unique(data.observations.landmark))
        assert len(only(comparison.landmarks, dataset=name)) == 4 * seen
        innovations = only(comparison.innovations, dataset=name, estimator="ekf")
        assert innovations["step"].tolist() == data.observations.step.tolist()


def test_the_summary_follows_from_the_trajectories(comparison):
    for _, row in comparison.summary.iterrows():
        keys = {key: row[key] for key in ("dataset", "estimator", "series")}
        rows = only(comparison.trajectories, **keys)
        truth = comparison.datasets[row["dataset"]].truth
        error = rows[["x_m", "y_m"]].to_numpy() - truth[:, :2]
        rmse = np.sqrt(np.mean(np.sum(error**2, axis=1)))
        assert row["ate_position_rmse_m"] == pytest.approx(rmse, rel=1e-12)
        best = only(comparison.trajectories, dataset=row["dataset"], estimator="gtsam-batch")
        gap = (rows[["x_m", "y_m"]].to_numpy() - best[["x_m", "y_m"]].to_numpy())[-1]
        assert row["gap_final_position_m"] == pytest.approx(np.hypot(*gap), abs=1e-12)


def test_the_batch_is_its_own_reference(comparison):
    batch = only(comparison.summary, estimator="gtsam-batch")
    assert (batch[["gap_final_position_m", "gap_final_heading_rad"]] == 0).all(axis=None)
    np.testing.assert_allclose(batch[["sigma_ratio_position", "sigma_ratio_heading"]], 1)
    assert batch["graph_chi2_per_dof"].between(0.8, 1.2).all()
    # On a short and easy problem the filter is next to the smoother; dead reckoning is not.
    ekf = only(comparison.summary, estimator="ekf")["gap_final_position_m"].to_numpy()
    chained = only(comparison.summary, estimator="dead-reckoning")["gap_final_position_m"]
    assert (5 * ekf < chained.to_numpy()).all()


def test_alignment_and_distance_reach_the_tables(data):
    free, aligned = (
        compare(data, "dead-reckoning", alignment=alignment, rpe_distance=distance).summary.iloc[0]
        for alignment, distance in (("none", 1.0), ("se2", 2.0))
    )
    assert (free["alignment"], aligned["alignment"]) == ("none", "se2")
    assert aligned["ate_position_rmse_m"] < 0.9 * free["ate_position_rmse_m"]
    assert aligned["rpe_position_rmse_m"] > 1.2 * free["rpe_position_rmse_m"]


TIMES = [
    "time_total_s",
    "time_marginals_s",
    "time_per_step_mean_us",
    "time_per_step_median_us",
    "time_per_step_p99_us",
]


def test_two_runs_give_the_same_tables_but_for_the_times(comparison):
    again = compare([short("cloister"), short("loop-15")], FOUR, rpe_distance=1.0)
    for name in tables.SCHEMAS:
        first, second = (
            getattr(c, name).drop(columns=[*TIMES, "time_step_s"], errors="ignore")
            for c in (comparison, again)
        )
        pd.testing.assert_frame_equal(first, second, check_exact=True)


# Failure is a row -------------------------------------------------------------------------------


def lying(column, value):
    """Innovations with one column replaced."""
    return lambda good: replace(good.innovations, **{column: value(good.innovations)})


WRONG = {
    "raises": (
        raises(RuntimeError("it\nbroke [here]")),
        "failed",
        r"RuntimeError: it broke \[here\]",
    ),
    "does not apply": (
        raises(UnsupportedError("needs two robots")),
        "skipped",
        "^needs two robots$",
    ),
    "nothing": (lambda _: None, "failed", "returned NoneType, not Estimate"),
    "an array": (lambda good: good.online.poses, "failed", "returned ndarray, not Estimate"),
    "nan": (
        changed(online=lambda e: Trajectory(e.online.poses * np.nan)),
        "diverged",
        "not finite",
    ),
    "short": (changed(online=lambda e: Trajectory(e.online.poses[:-1])), "failed", "shape"),
    "no trajectory": (changed(online=lambda e: e.online.poses), "failed", "Error"),
    "lost": (
        changed(online=lambda e: Trajectory(e.online.poses + 50, e.online.covariances)),
        "diverged",
        "of its sigmas",
    ),
    "no decision": (changed(innovations=lying("decision", lambda i: i.decision + 9)), "failed", ""),
    "lists": (changed(innovations=lambda e: Innovations([], [], [], [])), "failed", "Error"),
    "few times": (changed(step_seconds=lambda e: e.step_seconds[:3]), "failed", "shape"),
    "no number": (changed(time_total=lambda e: "soon"), "failed", "Error"),
    "no options": (changed(options=lambda e: None), "failed", "Error"),
    "no status": (changed(status=lambda e: "splendid"), "failed", "splendid"),
}


@pytest.mark.parametrize("what", WRONG)
@pytest.mark.parametrize("name", ["misbehaving", "gtsam-batch"])
def test_an_estimator_that_goes_wrong_is_a_row(what, name, tmp_path):
    """Also one that others are compared with; and the tables can be saved."""
    act, status, message = WRONG[what]
    data = short("cloister", steps=3)
    found = compare(data, [Misbehaving(act, name), "ekf", "dead-reckoning"])
    bad, *others = (row for _, row in found.summary.iterrows())
    assert (bad["estimator"], bad["status"]) == (name, status)
    assert "\n" not in bad["message"]
    assert pd.Series(bad["message"]).str.contains(message).all()
    assert [(row["estimator"], row["status"]) for row in others] == [
        ("ekf", "ok"),
        ("dead-reckoning", "ok"),
    ]
    found.save(tmp_path, figures=False)
    pd.testing.assert_frame_equal(
        tables.read_csv("summary", tmp_path / "summary.csv"), found.summary
    )


def test_a_real_divergence_is_found():
    """A filter that is sure of a wrong start is lost, and the figures are drawn all the same."""
    data = short("loop-15", steps=200)
    prior = Prior([30.0, 20.0, 0.5], 1e-8 * np.eye(3))
    lost = replace(data, robots=(replace(data.robot, prior=prior),))
    found = compare(lost, ["ekf", "gtsam-batch"])
    assert set(found.summary["status"]) == {"diverged"}
    assert found.plot_errors().axes


def test_an_interrupt_is_not_a_failure(data):
    with pytest.raises(KeyboardInterrupt):
        compare(data, Misbehaving(raises(KeyboardInterrupt())))


# What to run, and on what -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("datasets", "estimators", "options", "error", "message"),
    [
        ("cloister", "efk", {}, UnknownNameError, "did you mean ekf"),
        ("clojster", "ekf", {}, UnknownNameError, "did you mean cloister"),
        (["cloister", "nowhere.npz"], "ekf", {}, FileFormatError, "no such file"),
        ("cloister", "no_such_module:Thing", {}, InputError, "cannot load"),
        ("cloister", 3, {}, InputError, "is no estimator"),
        ("cloister", [], {}, InputError, "nothing to compare"),
        ([], "ekf", {}, InputError, "nothing to compare"),
        (["cloister", "cloister"], "ekf", {}, InputError, "same name"),
        ("cloister", ["ekf", "ekf"], {}, InputError, "two estimators are called ekf"),
        ("cloister", ["ekf", Ekf(update="sequential")], {}, InputError, "two estimators"),
        ("cloister", "ekf", {"alignment": "sim3"}, UnknownNameError, "alignment"),
        ("cloister", "ekf", {"rpe_distance": 0.0}, InputError, "rpe_distance"),
        ("cloister", "ekf", {"rpe_distance": float("nan")}, InputError, "rpe_distance"),
        ("cloister", "ekf", {"match_radius": -1.0}, InputError, "match_radius"),
        ("cloister", "ekf", {"path": "somewhere"}, InputError, "recorded"),
        ("cloister", "ekf", {"seed": -1}, InputError, "seed"),
    ],
)
def test_a_mistake_is_told_before_anything_runs(datasets, estimators, options, error, message):
    first = Misbehaving(lambda good: good)
    several = estimators if isinstance(estimators, list) else [estimators]
    with pytest.raises(error, match=message) as caught:
        compare(datasets, [first, *several] if several else [], **options)
    assert "\n" not in str(caught.value)
    assert first.calls == 0


def test_estimators_by_name_class_object_and_module(data, tmp_path, monkeypatch):
    (tmp_path / "of_the_user.py").write_text(
        "from ekfslam.filters.ekf import Ekf\nclass Mine(Ekf):\n    name = 'other'\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    found = compare(data, ["ekf", "of_the_user:Mine", Misbehaving(lambda good: good)])
    assert found.summary["estimator"].tolist() == ["ekf", "Mine", "misbehaving"]
    assert found.summary["ate_position_rmse_m"].nunique() == 1


def test_datasets_from_objects_names_and_files(data, tmp_path):
    data.save(tmp_path / "run.npz")
    from_file = compare(tmp_path / "run.npz", "dead-reckoning")
    pd.testing.assert_frame_equal(
        from_file.trajectories, compare(data, "dead-reckoning").trajectories
    )
    named = compare("loop-15", "dead-reckoning", seed=3)
    assert named.summary["seed"].tolist() == [3]
    other = compare("loop-15", "dead-reckoning", seed=4)
    assert named.summary["ate_position_rmse_m"][0] != other.summary["ate_position_rmse_m"][0]


def test_progress_is_told(data):
    told = []
    compare(data, ["ekf", "gtsam-isam2"], watch=lambda *news: told.append(news))
    assert {(dataset, name) for dataset, name, _, _ in told} == {
        ("cloister", "ekf"),
        ("cloister", "gtsam-isam2"),
    }
    for name in ("ekf", "gtsam-isam2"):
        done = [news[2] for news in told if news[1] == name]
        assert done[0] == 0
        assert done == sorted(done)
        assert {news[3] for news in told} == {data.poses}
        assert done[-1] <= data.poses


def test_the_facade(data):
    for _ in range(2):  # the first call imports what the second finds
        assert isinstance(ekfslam.estimate(data, "ekf", update="sequential"), Estimate)
    assert isinstance(ekfslam.load("loop-15"), ekfslam.Dataset)
    assert ekfslam.compare is compare
    assert all(hasattr(ekfslam, name) for name in ekfslam.__all__)
    assert set(ekfslam.__all__) <= set(dir(ekfslam))
    with pytest.raises(AttributeError, match="no attribute 'estimat'"):
        _ = ekfslam.estimat


def test_the_match_radius_reaches_summary_and_landmarks(data):
    """Landmarks whose identities are the filter's own; no error can exceed the radius."""
    own = Ekf(association="nearest")
    for radius in (0.02, 2.0):
        found = compare(data, own, match_radius=radius)
        errors = found.landmarks["error_m"].dropna()
        assert found.summary["landmarks_matched"][0] == len(errors)
        assert found.summary["landmark_max_m"][0] == errors.max() < radius
    assert len(errors) == found.summary["landmarks_estimated"][0] > 1


def test_withheld_identities_are_not_seen_but_scored(data):
    names = ["ekf", "ekf(association=joint)", "dead-reckoning"]
    found = compare([data, short("loop-15")], names, withhold_ids=True)
    assert found.config["ids_withheld"] is True
    methods = found.summary["association"].fillna("none").tolist()
    assert methods == ["nearest", "joint", "none"] * 2
    for dataset in found.datasets.values():
        assert not dataset.association_known
        assert (dataset.observations.landmark == -1).all()
    scores = only(found.summary, estimator="ekf(association=joint)")["association_precision"]
    assert scores.between(0.9, 1).all()
    plain = compare(data, "ekf")
    assert plain.config["ids_withheld"] is False
    assert plain.summary["association"].tolist() == ["known"]


def test_options_of_estimators_in_names(data):
    found = compare(data, ["ekf", " ekf(update=sequential,accept=0.9)"])
    name = "ekf(update=sequential, accept=0.9)"
    assert found.summary["estimator"].tolist() == ["ekf", name]
    assert found.config["estimators"][name]["update"] == "sequential"
    assert found.config["estimators"][name]["accept"] == 0.9
    assert found.estimates["cloister", name].estimator == name
    alone = ekfslam.estimate(data, "ekf", update="sequential", accept=0.9)
    np.testing.assert_array_equal(
        found.estimates["cloister", name].online.poses, alone.online.poses
    )


def test_options_of_recorded_sets_in_names():
    tight = "victoria-park(odometry_sigmas=(0.05, 0.05, 0.005))"
    found = compare([tight, "victoria-park"], "dead-reckoning")
    assert list(found.datasets) == [tight, "victoria-park"]
    sigmas = [np.sqrt(np.diag(d.robot.motion.covariance)) for d in found.datasets.values()]
    np.testing.assert_allclose(sigmas, [[0.05, 0.05, 0.005], [0.1, 0.1, 0.01]])
    assert ekfslam.load(tight).name == tight


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("victoria-park(noize=file)", "noize"),
        ("victoria-park(noise=mine)", "noise must be"),
        ("victoria-park(odometry_sigmas=1)", "odometry_sigmas must have shape"),
        ("victoria-park(sensor_sigmas=(1, -1))", "sensor_sigmas must be standard deviations"),
        ("victoria-park(path=here, path=there)", "given twice"),
        ("victoria-park(name=x)", "name"),
        ("victoria-park(noise=file", "bracket"),
    ],
)
def test_options_of_recorded_sets_that_make_no_sense(name, message):
    with pytest.raises(InputError, match=message) as caught:
        compare(name, "dead-reckoning")
    assert "\n" not in str(caught.value)


# Files ------------------------------------------------------------------------------------------

FILES = {*(f"{name}.csv" for name in tables.SCHEMAS), "config.json"}
FIGURES = {
    f"{dataset}-{figure}.{kind}"
    for dataset in ("cloister", "loop-15")
    for figure in ("map", "errors", "consistency", "times")
    for kind in ("png", "pdf")
}


def test_what_is_saved(comparison, tmp_path):
    folder = tmp_path / "deep" / "results"
    written = comparison.save(folder)
    assert {path.name for path in folder.iterdir()} == FILES | FIGURES
    assert {path.name for path in written} == FILES | FIGURES
    assert all(path.parent == folder and path.stat().st_size for path in written)
    assert [path.name for path in tmp_path.iterdir()] == ["deep"]
    for path in written:
        start = path.read_bytes()[:5]
        assert {".png": b"\x89PNG\r", ".pdf": b"%PDF-"}.get(path.suffix, start) == start
    for name in tables.SCHEMAS:
        table = tables.read_csv(name, folder / f"{name}.csv")
        pd.testing.assert_frame_equal(table, getattr(comparison, name), check_exact=True)


def test_saving_again_replaces_its_own_files_and_keeps_the_others(comparison, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "summary.csv").write_text("old")
    comparison.save(tmp_path, figures=False)
    comparison.save(tmp_path, figures=False)
    assert {path.name for path in tmp_path.iterdir()} == FILES | {"notes.txt"}
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert len(tables.read_csv("summary", tmp_path / "summary.csv")) == 10


def test_the_configuration_says_what_ran(data, tmp_path):
    subject = Ekf(update="sequential", accept=0.9)
    lengths = {"rpe_distance": 2.5, "match_radius": 0.5}
    found = compare(data, [subject, "gtsam-batch"], seed=7, alignment="se2", **lengths)
    found.save(tmp_path, figures=False)
    text = (tmp_path / "config.json").read_text()
    config = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert config == found.config
    assert config["seed"] == 7
    assert config["alignment"] == "se2"
    assert config["rpe_distance_m"] == 2.5
    assert config["match_radius_m"] == 0.5
    assert config["datasets"]["cloister"]["seed"] == 1
    assert "scenario cloister" in config["datasets"]["cloister"]["provenance"]
    assert config["estimators"]["ekf"]["update"] == "sequential"
    assert config["estimators"]["ekf"]["accept"] == 0.9
    assert config["estimators"]["gtsam-batch"]["initial"] == "ekf"
    assert config["versions"]["ekfslam"] == ekfslam.__version__
    assert config["versions"]["gtsam"].startswith("4.")


def failing(call, error):
    """A stand-in for `ekfslam.plots.save` that works until the given call."""
    from ekfslam.plots import save

    calls = iter(range(1000))

    def save_or_fail(*arguments):
        if next(calls) == call:
            raise error
        return save(*arguments)

    return save_or_fail


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (RuntimeError("cannot draw"), RuntimeError),
        (OSError(28, "No space left on device"), InputError),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ],
)
def test_a_failure_while_drawing_leaves_nothing(plain, tmp_path, monkeypatch, error, expected):
    monkeypatch.setattr("ekfslam.plots.save", failing(3, error))
    with pytest.raises(expected):
        plain.save(tmp_path / "new" / "folder")
    assert list(tmp_path.iterdir()) == []
    there = tmp_path / "there"
    there.mkdir()
    (there / "summary.csv").write_text("precious")
    monkeypatch.setattr("ekfslam.plots.save", failing(3, error))
    with pytest.raises(expected):
        plain.save(there)
    assert [path.name for path in there.iterdir()] == ["summary.csv"]
    assert (there / "summary.csv").read_text() == "precious"


def test_a_full_disk_is_one_line(plain, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pd.DataFrame, "to_csv", full)
    with pytest.raises(InputError, match=r"cannot write to .*No space left") as caught:
        plain.save(tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("inside", ["file", "file/folder"])
def test_a_file_in_the_way_is_kept(plain, tmp_path, inside):
    (tmp_path / "file").write_text("precious")
    with pytest.raises(InputError, match="cannot write to"):
        plain.save(tmp_path / inside)
    assert (tmp_path / "file").read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("name", ["a/b", "../../outside", "..", "spaced name"])
def test_a_dataset_name_is_no_way_out_of_the_folder(data, tmp_path, name):
    """Names may come from a file that somebody else wrote."""
    folder = tmp_path / "one" / "two"
    written = compare(replace(data, name=name), "dead-reckoning").save(folder)
    assert len(written) == len(FILES) + 8
    assert {path.parent for path in written} == {folder}
    assert set(folder.iterdir()) == set(written)
    everything = {p for p in tmp_path.rglob("*") if p.is_file()}
    assert everything == set(written)


# Figures and notebooks --------------------------------------------------------------------------


@pytest.mark.parametrize("figure", ["map", "errors", "consistency", "times"])
def test_figures_of_every_dataset(comparison, figure):
    from matplotlib.figure import Figure

    plot = getattr(comparison, f"plot_{figure}")
    titles = []
    for dataset in (None, "cloister", "loop-15"):
        drawn = plot(dataset)
        assert isinstance(drawn, Figure)
        assert drawn.axes
        assert drawn._repr_png_().startswith(b"\x89PNG")
        titles.append(drawn.get_suptitle() or drawn.axes[0].get_title())
    assert "cloister" in titles[0]
    assert titles[0] == titles[1]
    assert "loop-15" in titles[2]
    with pytest.raises(UnknownNameError, match="did you mean cloister"):
        plot("cloistr")


def test_each_of_several_robots_has_its_figures(tmp_path):
    team = load_scenario("team")
    plans = [replace(plan, controls=plan.controls[:20]) for plan in team.team]
    data = simulate(replace(team, controls=team.controls[:20], team=tuple(plans)))
    found = compare(data, "dead-reckoning")
    for plot in (found.plot_errors, found.plot_consistency):
        titles = [plot(robot=name).get_suptitle() for name in (None, "ada", "cid")]
        assert titles[0] == titles[1]
        assert "cid" in titles[2]
        with pytest.raises(UnknownNameError, match="robot of this table 'dora'"):
            plot("team", "dora")
    names = {path.name for path in found.save(tmp_path) if path.suffix == ".png"}
    assert names == {"team-map.png", "team-times.png"} | {
        f"team-{name}-{figure}.png"
        for name in ("ada", "bob", "cid")
        for figure in ("errors", "consistency")
    }


def test_a_notebook_shows_the_summary(comparison):
    html = comparison._repr_html_()
    assert html.count("<tr") == 1 + len(comparison.summary)
    for word in ("<table", "cloister", "gtsam-isam2", "smoothed", "ate_position_rmse_m"):
        assert word in html
    assert "NaN" not in html


def test_files_of_a_comparison_in_which_nobody_took_part(tmp_path):
    files = compare(["team"], ["ekf-ri"], seed=1).save(tmp_path)
    assert {path.name for path in files} >= {"summary.csv", "trajectories.csv", "team-map.png"}
