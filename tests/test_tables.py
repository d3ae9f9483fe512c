"""The five tables: columns and dtypes, what is in them and what is left empty, CSV and docs."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tabulated import all_tables, assert_schema

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, LandmarkMap, Observations, Prior, Robot
from ekfslam.errors import FileFormatError, InputError, UnknownNameError
from ekfslam.estimates import Decision, Estimate, Innovations, LandmarkEstimates, Trajectory
from ekfslam.evaluation import relative_errors, tables
from ekfslam.evaluation.tables import SCHEMAS
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

COUNT = 61
SUMMARY = [
    "dataset",
    "seed",
    "robot",
    "estimator",
    "series",
    "association",
    "alignment",
    "status",
    "message",
    "steps",
    "truth_poses",
    "observations",
    "landmarks_true",
    "landmarks_estimated",
    "landmarks_undetermined",
    "landmarks_matched",
    "landmarks_missed",
    "landmarks_spurious",
    "landmarks_duplicate",
    "landmarks_merged",
    "association_precision",
    "association_recall",
    "ate_position_rmse_m",
    "ate_position_max_m",
    "ate_heading_rmse_rad",
    "rpe_position_rmse_m",
    "rpe_heading_rmse_rad",
    "landmark_rmse_m",
    "landmark_max_m",
    "nees_pose_mean",
    "nees_pose_final",
    "nees_pose_invariant_mean",
    "nees_pose_inside_95",
    "nees_position_mean",
    "nees_position_inside_95",
    "nees_landmark_mean",
    "nis_per_dof",
    "nis_inside_95",
    "effective_samples_mean",
    "effective_samples_min",
    "graph_error",
    "graph_chi2_per_dof",
    "gap_final_position_m",
    "gap_final_heading_rad",
    "gap_landmark_rmse_m",
    "sigma_ratio_position",
    "sigma_ratio_heading",
    "time_total_s",
    "time_marginals_s",
    "time_per_step_mean_us",
    "time_per_step_median_us",
    "time_per_step_p99_us",
]


@pytest.fixture
def dataset():
    """Thirty metres along a curve; landmark 2 is seen at steps 1 and 2, landmark 6 at step 2."""
    increments = np.tile([0.5, 0.0, 0.05], (COUNT - 1, 1))
    truth = geo.integrate([1.0, 2.0, 3.0], increments)
    positions = np.array([[0.0, 5.0], [4.0, 4.0]])
    seen = [(1, 0), (2, 0), (2, 1)]
    return Dataset(
        "curve",
        (
            Robot(
                MotionModel("odometry", covariance=np.eye(3) * 1e-4),
                increments,
                Prior(truth[0]),
                truth,
            ),
        ),
        np.arange(COUNT) * 0.1,
        (Sensor("xy", np.eye(2), name="camera"),),
        Observations(
            [step for step, _ in seen],
            [geo.to_frame(truth[step], positions[row]) for step, row in seen],
            [2, 2, 6],
        ),
        true_map=LandmarkMap([2, 6], positions),
        true_landmark=[2, 2, 6],
        seed=11,
    )


@pytest.fixture
def estimate(dataset):
    """Both series, off by chosen amounts, with everything an estimate can hold."""
    along = np.linspace(0.0, 1.0, COUNT)[:, None]
    covariances = np.tile(np.diag([0.04, 0.01, 1e-4]), (COUNT, 1, 1))
    covariances[0] = 0.0  # an exactly known start
    online = Trajectory(geo.compose(dataset.truth, along * [0.6, 0.0, 0.02]), covariances)
    smoothed = Trajectory(geo.compose(dataset.truth, along * [0.3, 0.0, 0.01]), covariances / 4)
    innovation, S = np.full((3, 2), np.nan), np.full((3, 2, 2), np.nan)
    innovation[1], S[1] = [0.3, -0.4], [[0.25, 0.0], [0.0, 0.16]]
    step_nis, step_dof = np.full(COUNT, np.nan), np.zeros(COUNT, dtype=int)
    step_nis[[2, 3, 4]], step_dof[[2, 3, 4]] = [1.36, 3.0, 9.0], [2, 2, 4]
    return Estimate(
        "both",
        dataset.name,
        "known",
        online,
        smoothed,
        LandmarkEstimates(
            np.array([2, 6, 9]),
            np.array([[0.3, 5.4], [4.0, 4.0], [9.0, 9.0]]),
            np.array([[[0.09, 0.0], [0.0, 0.16]], np.zeros((2, 2)), np.eye(2)]),
        ),
        innovations=Innovations(
            np.array([Decision.NEW, Decision.ACCEPTED, Decision.REJECTED]),
            np.array([2, 2, -1]),
            innovation,
            S,
        ),
        step_nis=step_nis,
        step_dof=step_dof,
        step_seconds=np.arange(COUNT) * 1e-6,
        time_total=0.5,
        time_marginals=0.25,
        graph_error=60.0,
        graph_dof=100,
        message='floor, "1e-4 m"',
    )


def without_truth(dataset):
    return replace(
        dataset, robots=(replace(dataset.robot, truth=None),), true_map=None, true_landmark=None
    )


# Shape ------------------------------------------------------------------------------------------


def test_the_summary_has_exactly_its_columns():
    assert list(SCHEMAS["summary"]) == SUMMARY


def test_every_table_has_its_columns_and_dtypes_whatever_is_known(dataset, estimate):
    failed = Estimate("gone", dataset.name, status="failed", message="no reason")
    bare = Estimate("bare", dataset.name, online=Trajectory(dataset.truth))
    for data in (dataset, without_truth(replace(dataset, seed=None))):
        for record in (estimate, bare, failed):
            for name, table in all_tables(data, record).items():
                assert_schema(name, table)
    for name in SCHEMAS:
        assert_schema(name, tables.concat(name, []))


def test_rows_per_series_step_landmark_and_observation(dataset, estimate):
    rows = {name: len(table) for name, table in all_tables(dataset, estimate).items()}
    assert rows == {
        "summary": 2,
        "trajectories": 2 * COUNT,
        "landmarks": 2 * 3,
        "innovations": 3,
        "association": 2,
    }
    trajectories = tables.trajectories(dataset, estimate)
    assert not trajectories.duplicated(["series", "step"]).any()


def test_concatenation_keeps_columns_dtypes_and_rows(dataset, estimate):
    failed = Estimate("gone", "curve", status="failed", message="no reason")
    parts = [all_tables(dataset, record) for record in (failed, estimate, failed)]
    for name in SCHEMAS:
        table = tables.concat(name, [part[name] for part in parts])
        assert_schema(name, table)
        assert len(table) == sum(len(part[name]) for part in parts)
        assert table.index.equals(pd.RangeIndex(len(table)))
    with pytest.raises(UnknownNameError, match="did you mean summary"):
        tables.concat("sumary", [])


def test_every_column_is_documented_and_every_documented_column_exists():
    page = (Path(__file__).parents[1] / "docs" / "tables.md").read_text(encoding="utf-8")
    sections = re.split(r"^## ", page, flags=re.MULTILINE)[1:]
    documented = {
        section.split("\n", 1)[0].strip(): re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)
        for section in sections
    }
    others = ("Conventions", "Campaign tables")  # those of campaigns have tests of their own
    assert {name: list(columns) for name, columns in SCHEMAS.items()} == {
        name: columns for name, columns in documented.items() if name not in others
    }


def test_the_evaluation_needs_no_estimator_and_no_figures():
    code = (
        "import sys, ekfslam.evaluation.tables; "
        "print([m for m in ('matplotlib', 'gtsam', 'numba', 'evo', 'baselines', "
        "'ekfslam.filters', 'ekfslam.plots') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


@pytest.mark.parametrize("alignment", ["none", "se2"])
def test_tables_survive_csv_without_loss(dataset, estimate, tmp_path, alignment):
    odd = replace(estimate, estimator="NA", message="nan\nnull", association="None")
    failed = Estimate("gone", "curve", status="failed")
    for name in SCHEMAS:
        parts = [all_tables(dataset, record, alignment)[name] for record in (odd, estimate, failed)]
        table = tables.concat(name, parts)
        for content in (table, table.iloc[:0]):
            content.to_csv(tmp_path / f"{name}.csv", index=False)
            again = tables.read_csv(name, tmp_path / f"{name}.csv")
            pd.testing.assert_frame_equal(again, content, check_exact=True, rtol=0, atol=0)


def test_files_that_are_no_such_table_are_refused(dataset, estimate, tmp_path):
    path = tmp_path / "table.csv"
    with pytest.raises(FileFormatError, match=r"table\.csv"):
        tables.read_csv("summary", path)
    path.write_text("")
    with pytest.raises(FileFormatError, match=r"table\.csv"):
        tables.read_csv("summary", path)
    tables.innovations(dataset, estimate).to_csv(path, index=False)
    with pytest.raises(FileFormatError, match="columns of summary"):
        tables.read_csv("summary", path)
    tables.innovations(dataset, estimate).assign(step="two").to_csv(path, index=False)
    with pytest.raises(FileFormatError, match="innovations"):
        tables.read_csv("innovations", path)


# Content ----------------------------------------------------------------------------------------


def test_summary_of_chosen_errors(dataset, estimate):
    table = tables.summary_rows(dataset, estimate, reference=estimate).set_index("series")
    online, smoothed = table.loc["online"], table.loc["smoothed"]
    assert online[["dataset", "seed", "robot", "estimator", "association"]].tolist() == [
        "curve",
        11,
        "robot",
        "both",
        "known",
    ]
    said = 'floor, "1e-4 m"; NEES skipped at 1 of 61 poses (singular covariance)'
    assert online[["alignment", "status", "message"]].tolist() == ["none", "ok", said]
    assert online["steps":"landmarks_undetermined"].tolist() == [COUNT, COUNT, 3, 2, 3, 0]
    assert online["landmarks_matched":"landmarks_merged"].tolist() == [2, 0, 1, 0, 0]
    # Landmark 6 is in the map that no observation put there, and was not recognised.
    assert online[["association_precision", "association_recall"]].tolist() == [1.0, 0.5]

    # Errors grow linearly to 0.6 m along the true heading and 0.02 rad.
    shares = np.linspace(0, 1, COUNT)
    rms = np.sqrt(np.mean(shares**2))
    expected = {
        "ate_position_rmse_m": 0.6 * rms,
        "ate_position_max_m": 0.6,
        "ate_heading_rmse_rad": 0.02 * rms,
        "landmark_rmse_m": 0.5 / np.sqrt(2),
        "landmark_max_m": 0.5,
        "nees_landmark_mean": 2.0,  # the other covariance is singular, the third is spurious
        "nis_per_dof": (1.36 + 3 + 9) / 8,
        "nis_inside_95": 1.0,
        "time_total_s": 0.5,
        "time_marginals_s": 0.25,
        "time_per_step_mean_us": 30.0,
        "time_per_step_median_us": 30.0,
        "time_per_step_p99_us": 59.4,
        "gap_landmark_rmse_m": 0.0,
        "sigma_ratio_position": 2.0,
        "sigma_ratio_heading": 2.0,
        "gap_final_position_m": 0.3,
        "gap_final_heading_rad": 0.01,
    }
    for column, value in expected.items():
        assert online[column] == pytest.approx(value, abs=1e-12), column
    rpe = relative_errors(estimate.online.poses, dataset.truth, 10.0)
    assert online["rpe_position_rmse_m"] == np.sqrt(np.mean(rpe.position**2))
    assert online["rpe_heading_rmse_rad"] == pytest.approx(0.02 / 3, abs=1e-12)
    assert online[["graph_error", "graph_chi2_per_dof"]].isna().all()

    assert smoothed["ate_position_rmse_m"] == pytest.approx(0.3 * rms, abs=1e-12)
    assert smoothed[["graph_error", "graph_chi2_per_dof"]].tolist() == [60.0, 1.2]
    assert smoothed[["nis_per_dof", "nis_inside_95"]].isna().all()
    # The reference against itself.
    assert smoothed["gap_final_position_m":"sigma_ratio_heading"].tolist() == [0, 0, 0, 1, 1]


def test_summary_agrees_with_the_other_tables(dataset, estimate):
    for alignment in ("none", "se2"):
        made = all_tables(dataset, estimate, alignment)
        for row in made["summary"].to_dict("records"):
            poses = made["trajectories"].query(f"series == '{row['series']}'")
            marks = made["landmarks"].query(f"series == '{row['series']}'")
            squares = (poses.error_position_m**2).mean(), (marks.error_m**2).mean()
            found = [row["ate_position_rmse_m"] ** 2, row["landmark_rmse_m"] ** 2]
            np.testing.assert_allclose(found, squares, rtol=1e-12)
            assert row["nees_pose_mean"] == pytest.approx(poses.nees.mean(), rel=1e-12)
            assert row["nees_pose_final"] == poses.nees.iloc[-1]
            assert row["nees_pose_invariant_mean"] == pytest.approx(poses.nees_invariant.mean())
            assert row["nees_landmark_mean"] == pytest.approx(marks.nees.mean(), rel=1e-12)


def test_the_share_of_nees_is_of_the_poses_not_skipped(dataset, estimate):
    row = tables.summary_rows(dataset, estimate).iloc[0]
    nees = tables.trajectories(dataset, estimate).nees[:COUNT]
    assert np.isnan(nees[0])  # the exactly known start
    assert nees[1:].notna().all()
    assert row.nees_pose_inside_95 == nees[1:].between(0.2158, 9.3484).mean()
    assert 0.0 < row.nees_pose_inside_95 < 1.0


def test_the_distance_of_relative_errors_can_be_set(dataset, estimate):
    near, far, beyond = (
        tables.summary_rows(dataset, estimate, rpe_distance=d).rpe_position_rmse_m[0]
        for d in (1.0, 20.0, 50.0)
    )
    assert near < far
    assert np.isnan(beyond)


def test_alignment_moves_poses_and_map_but_neither_covariances_nor_nees(dataset, estimate):
    motion = np.array([20.0, -10.0, 1.0])
    moved = replace(
        estimate,
        smoothed=None,
        online=replace(estimate.online, poses=geo.compose(motion, dataset.truth)),
        landmarks=replace(
            estimate.landmarks, positions=geo.from_frame(motion, estimate.landmarks.positions)
        ),
    )
    plain, aligned = (all_tables(dataset, moved, alignment) for alignment in ("none", "se2"))
    summary = aligned["summary"].iloc[0]
    assert summary.alignment == "se2"
    assert summary[["ate_position_max_m", "ate_heading_rmse_rad"]].max() < 1e-12
    assert summary.landmark_max_m == pytest.approx(0.5, abs=1e-12)
    assert plain["summary"].ate_position_rmse_m[0] > 10
    assert plain["summary"].landmark_rmse_m[0] > 10
    poses = aligned["trajectories"][["x_m", "y_m", "theta_rad"]]
    np.testing.assert_allclose(poses, dataset.truth, atol=1e-12)
    np.testing.assert_allclose(
        aligned["landmarks"][["x_m", "y_m"]], estimate.landmarks.positions, atol=1e-12
    )
    for name in ("summary", "trajectories", "landmarks"):
        kept = [c for c in SCHEMAS[name] if c.startswith(("nees", "cov_", "gap_", "sigma_"))]
        pd.testing.assert_frame_equal(plain[name][kept], aligned[name][kept])
    assert plain["summary"].nees_pose_mean[0] > 1000


def test_trajectories_hold_poses_truth_and_what_each_step_cost(dataset, estimate):
    table = tables.trajectories(dataset, estimate)
    online = table[table.series == "online"]
    np.testing.assert_array_equal(online.step, np.arange(COUNT))
    np.testing.assert_array_equal(online.time_s, dataset.times)
    np.testing.assert_array_equal(online[["true_x_m", "true_y_m", "true_theta_rad"]], dataset.truth)
    error = geo.additive_error(dataset.truth, estimate.online.poses)
    np.testing.assert_allclose(
        online[["error_x_m", "error_y_m", "error_theta_rad"]], error, atol=1e-12
    )
    np.testing.assert_array_equal(online.time_step_s, estimate.step_seconds)
    np.testing.assert_array_equal(online.nis, estimate.step_nis)
    np.testing.assert_array_equal(online.nis_dof, estimate.step_dof)
    assert table[table.series == "smoothed"][["nis", "nis_dof"]].isna().all(axis=None)


def test_covariance_columns_are_the_upper_triangle(dataset, estimate, rng):
    factors = rng.normal(size=(COUNT, 3, 3))
    covariances = factors @ np.swapaxes(factors, 1, 2)
    record = replace(estimate, smoothed=None, online=Trajectory(dataset.truth, covariances))
    table = tables.trajectories(dataset, record)
    for name, (i, j) in {
        "cov_xx": (0, 0),
        "cov_xy": (0, 1),
        "cov_xt": (0, 2),
        "cov_yy": (1, 1),
        "cov_yt": (1, 2),
        "cov_tt": (2, 2),
    }.items():
        np.testing.assert_array_equal(table[name], covariances[:, i, j])


def test_landmarks_hold_matches_and_errors(dataset, estimate):
    table = tables.landmarks(dataset, estimate)
    table = table[table.series == "smoothed"].set_index("landmark")
    assert table.true_landmark.to_list() == [2, 6, pd.NA]
    first = table.loc[2]
    assert first["x_m":"cov_yy"].tolist() == [0.3, 5.4, 0.09, 0.0, 0.16]
    np.testing.assert_allclose(
        first["true_x_m":"nees"].astype(float), [0, 5, 0.3, 0.4, 0.5, 2.0], atol=1e-12
    )
    assert table.loc[6].error_m == 0.0
    assert np.isnan(table.loc[6].nees)  # singular
    assert table.loc[9]["true_x_m":"nees"].isna().all()  # spurious


def test_innovations_hold_decisions_and_nis(dataset, estimate):
    table = tables.innovations(dataset, estimate)
    assert table.decision.tolist() == ["new", "accepted", "rejected"]
    assert table.landmark.to_list() == [2, 2, pd.NA]
    assert table.sensor.tolist() == ["camera"] * 3
    assert table.step.tolist() == [1, 2, 2]
    np.testing.assert_array_equal(table.time_s, dataset.observation_times)
    assert table.dof.to_list() == [pd.NA, 2, pd.NA]
    values = table.loc[1, "innovation_0":"nis"].tolist()
    assert values == pytest.approx([0.3, -0.4, 0.25, 0.0, 0.16, 1.36], rel=1e-12)
    assert table.loc[[0, 2], "innovation_0":"nis"].isna().all(axis=None)


def test_without_truth_what_needs_it_is_empty_and_the_rest_is_there(dataset, estimate):
    data = without_truth(dataset)
    summary = tables.summary_rows(data, estimate, "se2", reference=estimate).iloc[0]
    prefixes = ("ate_", "rpe_", "nees_", "landmark_")
    assert summary[[c for c in SUMMARY if c.startswith(prefixes)]].isna().all()
    assert summary.alignment == "none"
    assert summary.nis_per_dof > 0
    assert summary.gap_final_position_m > 0
    assert summary.landmarks_true == 2  # the identities that the data carry
    table = tables.trajectories(data, estimate, "se2")
    empty = [c for c in table if c.startswith(("true_", "error_", "nees"))]
    assert table[empty].isna().all(axis=None)
    np.testing.assert_array_equal(table[["x_m"]][:COUNT], estimate.online.poses[:, :1])


@pytest.mark.parametrize("status", ["failed", "skipped"])
def test_an_estimate_without_series_is_one_row(dataset, estimate, status):
    record = Estimate("gone", "curve", status=status, message="the reason")
    table = tables.summary_rows(dataset, record, reference=estimate)
    assert len(table) == 1
    row = table.iloc[0]
    assert row[["estimator", "status", "message"]].tolist() == ["gone", status, "the reason"]
    assert pd.isna(row.series)
    assert row["ate_position_rmse_m":].isna().all()
    for name, other in all_tables(dataset, record).items():
        assert len(other) == (name == "summary")


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_a_run_gone_wrong_keeps_what_is_finite_without_a_warning(dataset, estimate, value):
    poses, positions = estimate.online.poses.copy(), estimate.landmarks.positions.copy()
    poses[40:], positions[1] = value, value
    record = replace(
        estimate,
        status="diverged",
        online=replace(estimate.online, poses=poses),
        landmarks=replace(estimate.landmarks, positions=positions),
    )
    made = all_tables(dataset, record, "se2")
    row = made["summary"].iloc[0]
    assert row.status == "diverged"
    for scalar in (row.ate_position_rmse_m, row.landmark_rmse_m):
        assert np.isnan(scalar) if not np.isfinite(value) else scalar == np.inf
    assert np.isfinite(row.nis_per_dof)
    assert row.time_total_s == 0.5
    trajectories = tables.trajectories(dataset, record)
    assert trajectories.x_m[:COUNT].isna().sum() == (0 if np.isfinite(value) else COUNT - 40)
    plain = tables.trajectories(dataset, estimate)
    columns = ["error_position_m", "nees", "nees_invariant"]
    pd.testing.assert_frame_equal(trajectories[columns][:40], plain[columns][:40])


def test_an_estimate_of_another_dataset_is_refused(dataset, estimate):
    short = replace(estimate, online=Trajectory(np.zeros((4, 3))))
    for table in (
        tables.summary_rows,
        tables.trajectories,
        tables.landmarks,
        tables.innovations,
        tables.association,
    ):
        with pytest.raises(InputError, match="must have shape"):
            table(dataset, short)
    with pytest.raises(UnknownNameError, match="alignment"):
        tables.summary_rows(dataset, estimate, "sim3")


# Own identities ---------------------------------------------------------------------------------


def test_own_identities_are_matched_within_the_radius_after_alignment(dataset, estimate):
    """Landmark 2 is 0.5 m off, 6 is exact; then the whole world is found elsewhere."""
    own = replace(estimate, association="nearest", smoothed=None)
    wide, narrow = (tables.summary_rows(dataset, own, match_radius=r).iloc[0] for r in (0.51, 0.49))
    assert (wide.landmarks_matched, narrow.landmarks_matched) == (2, 1)
    assert wide.landmark_max_m == pytest.approx(0.5, abs=1e-12)
    assert narrow.landmark_max_m == 0.0
    assert tables.landmarks(dataset, own).true_landmark.to_list() == [2, 6, pd.NA]
    narrow_table = tables.landmarks(dataset, own, match_radius=0.49)
    assert narrow_table.true_landmark.to_list() == [pd.NA, 6, pd.NA]
    motion = np.array([20.0, -10.0, 1.0])
    positions = geo.from_frame(motion, estimate.landmarks.positions)
    moved = replace(
        own,
        online=Trajectory(geo.compose(motion, dataset.truth)),
        landmarks=replace(estimate.landmarks, positions=positions),
    )
    for alignment, matched in (("none", 0), ("se2", 2)):
        row = tables.summary_rows(dataset, moved, alignment).iloc[0]
        assert row.landmarks_matched == matched
        assert row.landmarks_missed == 1  # 6 was rejected: where landmarks are is no matter here
        table = tables.landmarks(dataset, moved, alignment)
        assert table.true_landmark.notna().sum() == matched
        assert row.landmark_max_m == pytest.approx(table.error_m.max(), abs=1e-12, nan_ok=True)


def test_landmarks_of_open_distance_are_counted_and_not_listed(dataset, estimate):
    opened = replace(
        estimate,
        landmarks=replace(
            estimate.landmarks,
            undetermined=np.array([11, 12]),
            inverse_depth=np.tile([0.0, 0.0, 0.5, 0.1], (2, 1)),
        ),
    )
    summary, plain = (tables.summary_rows(dataset, e).iloc[0] for e in (opened, estimate))
    assert summary["landmarks_estimated":"landmarks_undetermined"].tolist() == [3, 2]
    assert plain.landmarks_undetermined == 0
    assert summary.landmarks_spurious == plain.landmarks_spurious + 2  # no such landmarks
    pd.testing.assert_frame_equal(
        tables.landmarks(dataset, opened), tables.landmarks(dataset, estimate)
    )


def test_every_decision_has_a_name(dataset, estimate):
    met = estimate.innovations
    for codes in ([0, 1, 2], [3, 4, 5]):
        record = replace(estimate, innovations=replace(met, decision=np.array(codes)))
        names = [Decision(code).name.lower() for code in codes]
        assert tables.innovations(dataset, record).decision.tolist() == names


# Association ------------------------------------------------------------------------------------


def test_the_counts_of_a_row_add_up(dataset, estimate, rng):
    """Over random decisions: every observation is in one column, every mapped one too."""
    count = 200
    step = np.sort(rng.integers(0, COUNT, count))
    data = replace(
        dataset,
        observations=Observations(step, rng.normal(size=(count, 2))),
        true_landmark=rng.integers(-1, 6, count),
    )
    decision = rng.choice([0, 0, 0, 1, 2, 3, 4], count)
    landmark = np.where(decision < 2, rng.integers(0, 9, count), -1)
    nan = np.full((count, 2), np.nan)
    record = replace(
        estimate,
        association="nearest",
        innovations=Innovations(decision, landmark, nan, np.full((count, 2, 2), np.nan)),
    )
    table = tables.association(data, record)
    assert table.step.tolist() == np.unique(step).tolist()
    assert (table.observations == np.bincount(step)[table.step]).all()
    parts = table[["accepted", "new", "rejected", "ambiguous", "tentative"]].sum(axis=1)
    assert (parts == table.observations).all()
    assert (table.correct + table.false == table.accepted).all()
    assert (table.correct + table.missed + table.duplicates <= table.mapped).all()
    totals, summary = table.sum(numeric_only=True), tables.summary_rows(data, record).iloc[0]
    assert totals[["rejected", "ambiguous", "tentative"]].gt(0).all()
    assert summary.association_precision == totals.correct / totals.accepted
    assert summary.association_recall == totals.correct / totals.mapped


def test_without_the_truth_of_associations_there_are_no_rows(dataset, estimate):
    unknown = replace(
        dataset,
        true_landmark=None,
        observations=Observations(dataset.observations.step, dataset.observations.values),
    )
    for data, record in ((unknown, estimate), (dataset, replace(estimate, innovations=None))):
        table = tables.association(data, record)
        assert_schema("association", table)
        assert len(table) == 0
        row = tables.summary_rows(data, record).iloc[0]
        assert np.isnan([row.association_precision, row.association_recall]).all()
