"""Large maps and long runs: what evaluation, files and figures make of them is bounded."""

from __future__ import annotations

import gc
import io
import json
import tracemalloc
import weakref
import zipfile
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numerics import assert_same_record
from scipy.optimize import linear_sum_assignment
from tabulated import all_tables

from ekfslam import estimates, storage
from ekfslam.dataset import Dataset, LandmarkMap, Robot
from ekfslam.errors import FileFormatError, InputError, UnknownNameError
from ekfslam.estimates import DIVERGED, OK, Estimate, Innovations, LandmarkEstimates, Trajectory
from ekfslam.evaluation import judged, match_landmarks, tables, verdict
from ekfslam.evaluation.tables import read_table
from ekfslam.experiments import compare, files
from ekfslam.experiments.comparison import OF_STEPS
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations
from ekfslam.plots import plot_consistency, plot_errors, plot_map, plot_times
from ekfslam.plots.thinning import MOST_ELLIPSES, MOST_POINTS, seen
from ekfslam.simulation import load_scenario, simulate

SIGMA = 0.05


def run_of(landmarks, poses=50, known=True, joint=False):
    """A run by hand: a walk, landmarks on a grid that are each seen once, truth plus noise."""
    rng = np.random.default_rng(1)
    side = int(np.ceil(np.sqrt(landmarks)))
    points = 4.0 * np.stack(np.divmod(np.arange(landmarks), side), axis=-1)
    truth = np.column_stack(
        [np.linspace(0, 4 * side, poses), np.sin(np.arange(poses)), poses * [0]]
    )
    robot = Robot(
        MotionModel("odometry", covariance=np.eye(3)), np.zeros((poses - 1, 3)), truth=truth
    )
    ids = np.arange(landmarks)
    dataset = Dataset(
        f"grid of {landmarks}",
        (robot,),
        np.arange(poses, dtype=float),
        (Sensor("xy", np.eye(2)),),
        Observations(np.sort(ids % poses), points, ids if known else None),
        true_map=LandmarkMap(ids, points),
        true_landmark=ids,
    )
    size = 3 + 2 * landmarks
    whole = None
    if joint:
        whole = np.full((size, size), 0.3 * SIGMA**2)
        whole.flat[:: size + 1] = SIGMA**2
    nothing = np.full((landmarks, 2), np.nan)
    estimate = Estimate(
        "made",
        dataset.name,
        "known" if known else "nearest",
        online=Trajectory(
            truth + rng.normal(0, SIGMA, truth.shape), np.tile(SIGMA**2 * np.eye(3), (poses, 1, 1))
        ),
        landmarks=LandmarkEstimates(
            ids,
            points + rng.normal(0, SIGMA, points.shape),
            SIGMA**2 * rng.uniform(0.5, 2.0, landmarks)[:, None, None] * np.eye(2),
            None if whole is None else whole[3:, 3:],
        ),
        joint_covariance=whole,
        innovations=Innovations(
            np.ones(landmarks, int), ids, nothing, np.full((*ids.shape, 2, 2), np.nan)
        ),
        step_nis=rng.chisquare(4, poses),
        step_dof=np.full(poses, 4),
        step_seconds=rng.uniform(1e-5, 2e-5, poses),
    )
    return dataset, estimate


# The joint covariance --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def large():
    """With a joint covariance above the limit."""
    dataset, estimate = run_of(verdict.JUDGED_WHOLE // 2 + 200, joint=True)
    assert len(estimate.joint_covariance) > verdict.JUDGED_WHOLE
    return dataset, estimate


def test_the_evaluation_makes_no_copy_of_a_large_joint_covariance(large):
    dataset, estimate = large
    one = replace(estimate, time_total=0.0)  # nothing of it has been computed
    tracemalloc.start()
    found = judged(dataset, one)
    made = all_tables(dataset, found)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.status == OK
    assert len(made["landmarks"]) == len(estimate.landmarks)
    # A strip of a hundred rows with what is made of it, and the tables; not a share of n^2.
    assert peak < 4 * 100 * 8 * len(estimate.joint_covariance) + 6e6
    assert peak < estimate.joint_covariance.nbytes / 2


def spoilt(covariance, *changes):
    """A copy with changed entries, symmetric."""
    covariance = covariance.copy()
    for i, j, value in changes:
        covariance[i, j] = covariance[j, i] = value
    return covariance


FAR = (7, verdict.JUDGED_WHOLE + 100)
FAULTS = {
    "a correlation above one": [(*FAR, 1.001 * SIGMA**2)],
    "a correlation below minus one": [(*FAR, -1.001 * SIGMA**2)],
    "a number that is none": [(*FAR, np.nan)],
    "an endless one": [(*FAR, np.inf)],
    "a negative variance": [(1500, 1500, -1e-9)],
    # Each pair could be; the three together have the eigenvalue 1 - 2 * 0.9.
    "neighbours": [(i, j, -0.9 * SIGMA**2) for i, j in ((40, 41), (41, 42), (40, 42))],
}


@pytest.mark.parametrize("changes", FAULTS.values(), ids=FAULTS)
def test_a_large_covariance_that_is_none_is_found_out(large, changes):
    dataset, estimate = large
    found = judged(
        dataset, replace(estimate, joint_covariance=spoilt(estimate.joint_covariance, *changes))
    )
    assert found.status == DIVERGED
    assert found.message == "joint covariance of final pose and map is not positive"


def test_a_large_covariance_that_was_not_computed_is_not_judged(large):
    dataset, estimate = large
    nothing = np.full_like(estimate.joint_covariance, np.nan)
    assert judged(dataset, replace(estimate, joint_covariance=nothing)).status == OK
    nothing[0, -1] = 1.0
    assert judged(dataset, replace(estimate, joint_covariance=nothing)).status == DIVERGED


def test_rounding_is_no_fault_of_a_large_covariance(large):
    dataset, estimate = large
    known = spoilt(estimate.joint_covariance, (*FAR, (1 + 1e-9) * SIGMA**2))
    known[:3] = known[:, :3] = 0.0  # the pose is exactly known
    assert judged(dataset, replace(estimate, joint_covariance=known)).status == OK


def test_nothing_outlives_an_estimate():
    dataset, estimate = run_of(20, joint=True)
    all_tables(dataset, judged(dataset, estimate))
    gone = weakref.ref(estimate)
    del estimate
    gc.collect()
    assert gone() is None


def test_tables_of_another_dataset_are_not_remembered():
    dataset, estimate = run_of(20)
    moved = dataset.moved([1.0, 2.0, 0.0])
    first = tables.trajectories(dataset, estimate)
    second = tables.trajectories(moved, estimate)
    assert (second["true_x_m"] - first["true_x_m"]).to_numpy() == pytest.approx(1.0)


# Landmarks held against true ones ---------------------------------------------------------------


def test_clusters_are_assigned_as_all_at_once(rng):
    """Against one assignment of everything, dense."""
    for _ in range(100):
        count, true, radius = rng.integers(1, 40), rng.integers(1, 40), rng.choice([0.3, 1, 2, 30])
        dataset, estimate = run_of(int(true), known=False)
        points, truth = rng.uniform(0, 10, (count, 2)), rng.uniform(0, 10, (true, 2))
        dataset = replace(dataset, true_map=LandmarkMap(np.arange(true), truth))
        mapped = LandmarkEstimates(np.arange(count), points)
        cost = np.minimum(np.sum((points[:, None] - truth) ** 2, axis=-1), radius**2)
        rows, columns = linear_sum_assignment(cost)
        expected = np.full(count, -1)
        near = cost[rows, columns] < radius**2
        expected[rows[near]] = columns[near]
        found = match_landmarks(dataset, replace(estimate, landmarks=mapped), float(radius))
        np.testing.assert_array_equal(found, expected)


def test_a_large_map_is_matched_without_all_pairs():
    dataset, estimate = run_of(4000, known=False)
    tracemalloc.start()
    found = match_landmarks(dataset, estimate)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    np.testing.assert_array_equal(found, np.arange(4000))
    assert peak < 8 * 4000**2 / 10  # a tenth of one matrix of costs


# Files of tables --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def comparison():
    parts = [load_scenario(name) for name in ("cloister", "loop-15")]
    short = [replace(each, controls=each.controls[:47]) for each in parts]
    return compare([simulate(each, seed=1) for each in short], ["ekf", "dead-reckoning"])


def of(comparison, name):
    return getattr(comparison, name)


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize("name", list(tables.SCHEMAS))
def test_both_forms_hold_every_digit(form, name, comparison, tmp_path):
    comparison.save(tmp_path, figures=False, form=form)
    assert sorted(p.suffix for p in tmp_path.iterdir()) == sorted([".json"] + [f".{form}"] * 5)
    back = read_table(name, tmp_path / f"{name}.{form}")
    pd.testing.assert_frame_equal(back, of(comparison, name), check_exact=True)


def test_a_large_table_is_parquet_and_what_it_takes_the_place_of_goes(
    comparison, tmp_path, monkeypatch
):
    comparison.save(tmp_path, figures=False)
    assert {p.suffix for p in tmp_path.iterdir()} == {".csv", ".json"}
    (tmp_path / "mine.csv").write_text("stays")
    rows = len(comparison.trajectories)
    small = {name for name in tables.SCHEMAS if len(of(comparison, name)) < rows}
    assert small
    monkeypatch.setattr(files, "CSV_ROWS", rows - 1)
    comparison.save(tmp_path, figures=False)
    names = {p.name for p in tmp_path.iterdir()}
    large = set(tables.SCHEMAS) - small
    expected = {f"{name}.csv" for name in small} | {f"{name}.parquet" for name in large}
    assert names == expected | {"config.json", "mine.csv"}
    monkeypatch.setattr(files, "CSV_ROWS", rows)  # as many are not more than as many
    comparison.save(tmp_path, figures=False)
    assert not [p for p in tmp_path.iterdir() if p.name == "trajectories.parquet"]


@pytest.mark.parametrize("every", [1, 10, 23, 1000])
def test_thinned_tables_hold_steps_of_the_whole_ones(every, comparison, tmp_path):
    comparison.save(tmp_path, figures=False, every=every)
    for name in tables.SCHEMAS:
        whole, kept = of(comparison, name), read_table(name, tmp_path / f"{name}.csv")
        if name in OF_STEPS:
            steps = whole["step"]  # 47 controls lead to pose 47
            whole = whole[[step % every == 0 or step == 47 for step in steps]]
        pd.testing.assert_frame_equal(kept, whole.reset_index(drop=True), check_exact=True)
    config = json.loads((tmp_path / "config.json").read_text())
    assert config.pop("files_every", 1) == every
    assert config == json.loads(json.dumps(comparison.config))


def test_what_says_nothing_of_a_form_is_refused(comparison, tmp_path):
    with pytest.raises(UnknownNameError, match="form of tables"):
        comparison.save(tmp_path, form="xlsx")
    for every in (0, -1, 2.0, True, "3"):
        with pytest.raises(InputError, match="every must be a whole number"):
            comparison.save(tmp_path, every=every)
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_no_such_table_is_refused(comparison, tmp_path):
    comparison.save(tmp_path, figures=False, form="parquet")
    with pytest.raises(FileFormatError, match="columns of landmarks"):
        read_table("landmarks", tmp_path / "summary.parquet")
    (tmp_path / "summary.parquet").write_bytes(b"PAR1 and no more")
    for path in (tmp_path / "summary.parquet", tmp_path / "missing.parquet"):
        with pytest.raises(FileFormatError, match=path.name):
            read_table("summary", path)


def test_the_command_thins_and_says_what_is_too_large(run_command, tmp_path, monkeypatch):
    words = ("compare", "circle", "--estimators", "dead-reckoning", "--no-figures", "--out")
    told = run_command(*words, tmp_path, "--tables", "parquet", "--every", "100")
    assert told.status == 0
    assert "too large" not in told.out
    whole = read_table("trajectories", tmp_path / "trajectories.parquet")
    assert whole["step"].diff().dropna().iloc[:-1].eq(100).all()
    monkeypatch.setattr(files, "CSV_ROWS", 100)
    told = run_command(*words, tmp_path)
    assert "too large for CSV, so Parquet: trajectories.parquet" in told.out
    assert run_command(*words, tmp_path, "--tables", "xlsx").status == 2
    assert run_command(*words, tmp_path, "--every", "0").status == 2


def test_progress_is_told_file_by_file(comparison, tmp_path):
    told = []
    comparison.save(tmp_path, figures=False, watch=lambda *words: told.append(words))
    assert told == [("", name, i, 5) for i, name in enumerate(tables.SCHEMAS)]


def test_tables_are_made_once(monkeypatch):
    scenario = load_scenario("loop-15")
    data = simulate(replace(scenario, controls=scenario.controls[:20]), seed=1)
    calls, made = [], tables.innovations
    monkeypatch.setattr(tables, "innovations", lambda d, e: calls.append(e.estimator) or made(d, e))
    compare(data, ["dead-reckoning", "gtsam-batch", "ekf"])
    assert calls == ["gtsam-batch", "dead-reckoning", "ekf"]  # the reference first


# Files of estimates -----------------------------------------------------------------------------


def small_limit(monkeypatch, limit):
    monkeypatch.setattr(storage, "LARGE", limit)
    monkeypatch.setattr(estimates, "LARGE", limit)


def entries(path):
    with zipfile.ZipFile(path) as archive:
        return {info.filename.removesuffix(".npy"): info for info in archive.infolist()}


def test_a_large_covariance_is_saved_once_and_as_it_is(monkeypatch, tmp_path):
    _, estimate = run_of(30, joint=True)
    small_limit(monkeypatch, estimate.landmarks.covariance.nbytes)
    estimate.save(tmp_path / "large.npz")
    held = entries(tmp_path / "large.npz")
    assert "landmarks.covariance" not in held
    stored = {name for name, info in held.items() if info.compress_type == zipfile.ZIP_STORED}
    assert stored == {"joint_covariance"}
    back = Estimate.load(tmp_path / "large.npz")
    assert_same_record(back, estimate)
    assert np.shares_memory(back.landmarks.covariance, back.joint_covariance)
    with np.load(tmp_path / "large.npz") as archive:  # any reader of NumPy's files reads it
        np.testing.assert_array_equal(archive["joint_covariance"], estimate.joint_covariance)


def test_landmarks_of_open_distance_come_after_the_map(monkeypatch, tmp_path):
    _, estimate = run_of(30, joint=True)
    joint = np.arange(71.0**2).reshape(71, 71)  # one of them has four coordinates
    mapped = replace(
        estimate.landmarks,
        covariance=joint[3:63, 3:63],
        undetermined=np.array([77, 78]),
        inverse_depth=np.ones((2, 4)),
    )
    estimate = replace(estimate, joint_covariance=joint, landmarks=mapped)
    small_limit(monkeypatch, 1000)
    estimate.save(tmp_path / "open.npz")
    assert "landmarks.covariance" not in entries(tmp_path / "open.npz")
    assert_same_record(Estimate.load(tmp_path / "open.npz"), estimate)


def test_a_covariance_of_its_own_is_saved(monkeypatch, tmp_path):
    """A copy may differ from the block by a digit, and one of other rows does."""
    _, estimate = run_of(30, joint=True)
    small_limit(monkeypatch, 1000)
    for other in (estimate.joint_covariance[3:, 3:].copy(), estimate.joint_covariance[:60, :60]):
        mapped = replace(estimate.landmarks, covariance=other)
        replace(estimate, landmarks=mapped).save(tmp_path / "own.npz")
        assert "landmarks.covariance" in entries(tmp_path / "own.npz")
        assert_same_record(Estimate.load(tmp_path / "own.npz"), replace(estimate, landmarks=mapped))


def test_an_estimate_that_is_not_large_is_of_the_first_version(tmp_path):
    """Whoever has an older package reads it."""
    _, estimate = run_of(30, joint=True)
    estimate.save(tmp_path / "small.npz")
    with np.load(tmp_path / "small.npz") as archive:
        assert json.loads(archive["header"].tobytes())["version"] == 1
        arrays = dict(archive)
    plain = io.BytesIO()
    np.savez_compressed(plain, **arrays)
    assert plain.getvalue() == (tmp_path / "small.npz").read_bytes()


# Figures ----------------------------------------------------------------------------------------


def size_of(figure):
    stream = io.BytesIO()
    figure.savefig(stream, format="pdf", dpi=100)
    return len(stream.getvalue())


@pytest.mark.parametrize("count", [MOST_ELLIPSES, MOST_ELLIPSES + 500])
def test_a_map_shows_no_more_ellipses_than_can_be_told_apart(count):
    dataset, estimate = run_of(count)
    found = tables.landmarks(dataset, estimate)
    figure = plot_map(tables.trajectories(dataset, estimate), found)
    (axes,) = figure.axes
    (contours,) = axes.collections
    assert len(contours.get_segments()) == MOST_ELLIPSES + 1  # and that of the robot
    size = np.sort(found["cov_xx"] + found["cov_yy"])[-MOST_ELLIPSES:]
    drawn = [np.sum(np.ptp(each, axis=0) ** 2) / 36 for each in contours.get_segments()[:-1]]
    np.testing.assert_allclose(np.sort(drawn), size, rtol=0.01)
    said = f"(the {MOST_ELLIPSES} largest of an estimator)" in figure.get_suptitle()
    assert said == (count > MOST_ELLIPSES)
    assert len(axes.lines) < 10  # however many landmarks
    assert max(len(line.get_xdata()) for line in axes.lines) == count


def test_figures_of_a_long_run_are_no_larger_than_what_is_seen():
    short, long = (
        tables.trajectories(*run_of(20, poses)) for poses in (MOST_POINTS, 3 * MOST_POINTS)
    )
    for plot in (plot_errors, plot_consistency, plot_times):
        assert size_of(plot(long)) < size_of(plot(short)), plot.__name__
    nothing = tables.landmarks(*run_of(20))
    assert size_of(plot_map(long, nothing)) < 3e5
    panels = [*plot_errors(long).axes, *plot_consistency(long).axes]
    lines = [line for panel in panels for line in panel.lines if not line.get_rasterized()]
    assert max(len(line.get_xdata()) for line in lines) < MOST_POINTS


def test_few_points_are_all_seen(rng):
    values = rng.normal(size=MOST_POINTS)
    np.testing.assert_array_equal(seen(values), np.arange(MOST_POINTS))


@pytest.mark.parametrize("count", [MOST_POINTS + 1, 50_001, 123_456])
def test_what_is_seen_of_a_long_line(count, rng):
    """Its ends, and of each short stretch what is lowest and highest, and that it breaks."""
    first, second = rng.normal(size=(2, count)).cumsum(axis=1)
    first[rng.integers(0, count, 100)] = np.nan
    first[3000:9000] = np.nan
    kept = seen(first, second)
    assert len(kept) < MOST_POINTS
    assert (np.diff(kept) > 0).all()
    assert kept[0] == 0
    assert kept[-1] == count - 1
    stretch = -(-count // 1000)  # twice as long as any that only some points are kept of
    for start in range(0, count - stretch, stretch // 2):
        here = kept[(kept >= start) & (kept < start + stretch)]
        inner = slice(start + stretch // 2, start + stretch // 2 + 1)
        assert len(here)
        for curve in (first, second):
            if np.isfinite(curve[inner]).any():
                assert np.nanmin(curve[here]) <= curve[inner] <= np.nanmax(curve[here])
    for i in np.flatnonzero(np.isnan(first)):  # a break close to every one that there is
        near = kept[np.abs(kept - i) < stretch]
        assert np.isnan(first[near]).any()
