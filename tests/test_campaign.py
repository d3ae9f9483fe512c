"""Campaigns: every cell once, the same bytes wherever it ran, and only what is missing."""

from __future__ import annotations

import json
import logging
import os
import re
import subprocess
import sys
from copy import deepcopy

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from campaigns import SMALL, files, tables
from distributed import LocalCluster

import ekfslam
from ekfslam.errors import FileFormatError, InputError
from ekfslam.evaluation import judged
from ekfslam.evaluation.run_metrics import RUN_METRICS, run_metrics
from ekfslam.evaluation.tables import summary_rows, trajectories
from ekfslam.experiments import load_campaign, read_campaign, run_campaign
from ekfslam.experiments.rows import SCHEMAS, table_of
from ekfslam.experiments.store import Store
from ekfslam.simulation import simulate


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A campaign that has run in this process."""
    folder = tmp_path_factory.mktemp("finished")
    run_campaign(SMALL, folder)
    return folder


def run(document, folder, **options):
    """Run, and tell how many cells were worked on and what was said."""
    done, told = [], []
    run_campaign(
        document, folder, watch=lambda *news: done.append(news), tell=told.append, **options
    )
    return done[-1][3], told


# Rows -------------------------------------------------------------------------------------------


def test_every_cell_is_a_row_in_the_order_of_the_campaign(finished):
    results = read_campaign(finished)
    labels = [variant.label for variant in load_campaign(SMALL).variants]
    keys = results.runs[["scenario", "seed", "estimator"]].to_numpy().tolist()
    assert keys == [
        [label, seed, name]
        for label in labels
        for seed in range(3)
        for name in ("ekf", "dead-reckoning")
    ]
    assert results.cells == (12, 12)
    assert results.runs["campaign"].unique().tolist() == ["small"]
    assert results.timings[["scenario", "seed", "estimator"]].to_numpy().tolist() == keys


def test_a_row_is_what_one_run_gives(finished):
    results, variant = read_campaign(finished), load_campaign(SMALL).variants[1]
    data = simulate(variant.scenario, seed=2)
    estimate = judged(data, ekfslam.estimate(data, "ekf"))
    row = results.runs[results.runs["scenario"] == variant.label].iloc[4]
    assert (row["seed"], row["estimator"], row["scenario_hash"]) == (2, "ekf", variant.digest)
    expected = summary_rows(data, estimate).iloc[0].to_dict()
    expected |= run_metrics(data, estimate, skip=3)[0]
    for name in [*RUN_METRICS, "ate_position_rmse_m", "nees_pose_mean", "landmarks_matched"]:
        same = row[name] == expected[name]
        assert same or (pd.isna(row[name]) and pd.isna(expected[name])), name
    kept = results.steps[results.steps["scenario"] == variant.label]
    kept = kept[(kept["seed"] == 2) & (kept["estimator"] == "ekf")]
    path = trajectories(data, estimate).iloc[[0, 5, 10, 12]].reset_index(drop=True)
    shared = [name for name in path if name in kept and name not in ("seed", "estimator")]
    assert {"cov_xt", "error_theta_rad", "nees_invariant", "nis_dof"} <= set(shared)
    found = kept[shared].reset_index(drop=True)
    pd.testing.assert_frame_equal(found, path[shared], check_exact=True)


def test_a_reference_gives_gaps_whether_or_not_it_takes_part(tmp_path):
    document = SMALL | {"seeds": 1, "metrics": {"reference": "dead-reckoning"}}
    both = run_campaign(document, tmp_path / "both").runs
    alone = run_campaign(document | {"estimators": ["ekf"]}, tmp_path / "alone").runs
    data = simulate(load_campaign(document).variants[0].scenario, seed=0)
    ekf, dead = (ekfslam.estimate(data, name) for name in ("ekf", "dead-reckoning"))
    gap = np.hypot(*(ekf.online.poses[-1] - dead.online.poses[-1])[:2])
    assert gap > 0
    for runs in (both, alone):
        row = runs[runs["estimator"] == "ekf"].iloc[0]
        assert row["gap_final_position_m"] == pytest.approx(gap, rel=1e-12)
        assert row["gap_final_mahalanobis2"] > 0
    assert (both["gap_final_position_m"][both["estimator"] == "dead-reckoning"] == 0).all()
    assert alone["estimator"].unique().tolist() == ["ekf"]


def test_of_an_estimator_with_two_series_both_are_compared(tmp_path):
    document = SMALL | {"seeds": 1, "estimators": ["ekf", "gtsam-isam2"]}
    pairs = run_campaign(document, tmp_path).pairs
    assert set(pairs["a"]) == {"gtsam-isam2 (online)", "gtsam-isam2 (smoothed)"}
    assert set(pairs["b"]) == {"ekf"}


def test_failures_are_rows_and_stop_nobody(tmp_path):
    names = ["campaigns:Broken", "campaigns:Refusing", "campaigns:Quitting", "dead-reckoning"]
    document = SMALL | {"estimators": names, "compare": {"baseline": "Broken"}}
    results = run_campaign(document, tmp_path)
    runs = results.runs[results.runs["scenario"] == results.runs["scenario"][0]]
    status = runs.pivot(index="seed", columns="estimator", values="status")
    assert status["Broken"].tolist() == ["ok", "failed", "ok"]
    assert status["Refusing"].tolist() == ["skipped"] * 3
    assert status["Quitting"].tolist() == ["failed"] * 3
    assert status["dead-reckoning"].tolist() == ["ok"] * 3
    messages = runs.set_index(["estimator", "seed"])["message"]
    assert re.fullmatch(
        r"RuntimeError: odd seeds \(campaigns.py, line \d+, in estimate\)", messages["Broken", 1]
    )
    assert messages["Refusing", 0] == "not for me"
    assert messages["Quitting", 0] == "SystemExit: enough"
    assert results.summary.set_index("estimator")["failed"]["Broken"].tolist() == [1, 1]
    assert set(results.pairs["b"]) == {"Broken"}


def test_what_cannot_be_tabulated_is_a_failure_of_its_own(tmp_path):
    document = SMALL | {"seeds": 1, "estimators": ["campaigns:Nonsense", "ekf"], "compare": {}}
    runs = run_campaign(document, tmp_path).runs
    assert runs["status"].tolist() == ["failed", "ok"] * 2
    assert "'soon'" in runs["message"][0]


def test_a_draw_that_cannot_be_made_is_rows_too(tmp_path):
    far = {"name": "loop-15", "set": {"path.repeat": 3, "sensors.0": {"kind": "range"}}}
    far["set"]["sensors.0"] |= {"sigmas": [50.0], "max_range": 100.0}
    runs = run_campaign(SMALL | {"scenarios": [far], "metrics": {}}, tmp_path).runs
    assert (runs["status"] == "failed").all()
    assert runs["message"].str.contains("InputError: .*range").all()
    assert len(runs) == 6


def test_what_is_not_known_is_empty():
    part = {"estimator": "ekf", "series": "", "nis": None, "nees": np.array([1.0, np.nan])}
    table = table_of("steps", [part, {"step": np.array([3, 4])}], rows=2)
    assert table["estimator"].to_pylist() == ["ekf", "ekf", None, None]
    assert table["nees"].to_pylist() == [1.0, None, None, None]
    assert table["step"].to_pylist() == [None, None, 3, 4]
    for name in ("series", "nis", "cov_xx", "seed"):
        assert table[name].null_count == 4, name
    assert table_of("steps", []).num_rows == 0


def test_one_dtype_for_each_column(finished):
    results = read_campaign(finished)
    for name in SCHEMAS:
        table = getattr(results, name)
        assert {c: str(table[c].dtype) for c in table} == {c: SCHEMAS[name][c] for c in table}
        assert set(SCHEMAS[name]) - set(table) <= {"campaign", "versions"}


def test_pandas_reads_a_folder_as_one_table_that_says_where_rows_come_from(finished):
    for name, rows in (("runs", 12), ("steps", 48), ("timings", 12)):
        table = pd.read_parquet(finished / name)
        assert len(table) == rows
        for key in ("campaign", "scenario", "scenario_hash", "seed", "estimator", "versions"):
            assert table[key].notna().all(), (name, key)
        assert {c: str(dtype) for c, dtype in table.dtypes.items()} == dict(SCHEMAS[name])
    assert "numpy 2" in table["versions"][0]
    assert not {"time_total_s", "time_per_step_median_us"} & set(pd.read_parquet(finished / "runs"))


# Wherever it runs -------------------------------------------------------------------------------


def test_the_same_bytes_in_one_process_in_two_and_on_a_cluster(tmp_path):
    """And linear algebra keeps to one thread in all of them."""
    document = SMALL | {"estimators": [*SMALL["estimators"], "campaigns:Threads"]}
    run_campaign(document, tmp_path / "one")
    run_campaign(document, tmp_path / "two", workers=2)
    with LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    ) as cluster:
        run_campaign(document, tmp_path / "cluster", scheduler=cluster.scheduler_address)
    expected = tables(tmp_path / "one"), files(tmp_path / "one")
    assert len(expected[1]) == 12
    for other in ("two", "cluster"):
        assert (tables(tmp_path / other), files(tmp_path / other)) == expected
        configs = [(tmp_path / name / "config.json").read_bytes() for name in ("one", other)]
        assert configs[0] == configs[1]
    runs = read_campaign(tmp_path / "one").runs
    (message,) = set(runs["message"][runs["estimator"] == "Threads"])
    assert message.startswith("RuntimeError: 1 (campaigns.py, ")


def test_importing_costs_no_cluster():
    code = "import sys, ekfslam.experiments; sys.exit('distributed' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_an_estimator_that_workers_do_not_have_is_told_and_no_row(tmp_path, monkeypatch):
    """It was there when the campaign was read, but is not where the work is done."""
    campaign = load_campaign(SMALL)
    unit = campaign.units({})[0]._replace(estimators={"efk": "efk"})
    monkeypatch.setattr(type(campaign), "units", lambda *_: [unit, unit])
    for workers in (1, 2):
        with pytest.raises(InputError, match="unknown estimator 'efk'; did you mean ekf"):
            run_campaign(campaign, tmp_path, workers=workers)
    assert read_campaign(tmp_path).cells == (0, 12)


def test_no_scheduler_at_the_address(tmp_path, monkeypatch):
    monkeypatch.setattr("ekfslam.experiments.cluster.PATIENCE", "0.3s")
    with pytest.raises(InputError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:9"):
        run_campaign(SMALL, tmp_path, scheduler="tcp://127.0.0.1:9")
    monkeypatch.setattr("distributed.Client", None)  # it could not be closed, and would say so
    for address in ("nonsense", "none://sense:8786", ""):
        with pytest.raises(InputError, match=f"no Dask scheduler at {address}"):
            run_campaign(SMALL, tmp_path, scheduler=address)
    with pytest.raises(InputError, match="either workers or a scheduler"):
        run_campaign(SMALL, tmp_path, workers=2, scheduler="tcp://127.0.0.1:9")
    with pytest.raises(InputError, match="workers must be a whole number from 1 on"):
        run_campaign(SMALL, tmp_path, workers=0)


# What is missing --------------------------------------------------------------------------------


def test_a_finished_campaign_runs_nothing(finished):
    before = files(finished)
    assert run(SMALL, finished) == (0, ["12 of 12 cells are there already"])
    assert files(finished) == before


def test_added_seeds_estimators_and_scenarios_run_alone(tmp_path):
    larger = deepcopy(SMALL) | {
        "seeds": 4,
        "estimators": ["ekf", "dead-reckoning", "campaigns:Broken"],
    }
    larger["scenarios"][0]["sweep"]["motion.sigmas"].append([0.02, 0.06])
    assert run(SMALL, tmp_path / "grown") == (12, [])
    kept = files(tmp_path / "grown")
    assert run(SMALL | {"seeds": 4}, tmp_path / "grown")[0] == 2 * 2
    assert (
        run(SMALL | {"estimators": larger["estimators"]}, tmp_path / "grown", seeds=4)[0] == 2 * 4
    )
    assert run(larger, tmp_path / "grown")[0] == 3 * 4
    assert files(tmp_path / "grown").items() >= kept.items()
    run(larger, tmp_path / "at once")
    assert tables(tmp_path / "grown") == tables(tmp_path / "at once")


def test_fewer_seeds_of_one_are_all_it_runs_and_shows(tmp_path):
    few = SMALL | {"estimators": ["ekf", {"name": "dead-reckoning", "seeds": 2}]}
    results = run_campaign(few, tmp_path)
    assert results.cells == (10, 10)
    assert results.runs.groupby("estimator")["seed"].nunique().to_dict() == {
        "dead-reckoning": 2,
        "ekf": 3,
    }
    assert (results.pairs["seeds"] == 2).all()
    assert run_campaign(SMALL, tmp_path).cells == (12, 12)  # the missing ones are run
    assert run_campaign(few, tmp_path).cells == (10, 10)  # and are not shown where not wanted


def test_what_a_campaign_no_longer_wants_is_kept_and_not_shown(tmp_path):
    run(SMALL, tmp_path / "large")
    smaller = SMALL | {"estimators": ["dead-reckoning"], "compare": {}}
    assert run(smaller, tmp_path / "large", seeds=2)[0] == 0
    run(smaller, tmp_path / "small", seeds=2)
    assert tables(tmp_path / "large") == tables(tmp_path / "small")
    assert run(SMALL, tmp_path / "large")[0] == 0


def test_a_label_may_change(tmp_path):
    document = deepcopy(SMALL)
    run(document, tmp_path)
    document["scenarios"][0]["label"] = "another"
    assert run(document, tmp_path)[0] == 0
    assert read_campaign(tmp_path).runs["scenario"].str.startswith("another(").all()


def test_a_changed_scenario_is_run_again_and_nothing_is_mixed(tmp_path):
    document = deepcopy(SMALL)
    document["scenarios"] = [
        {"name": "loop-15", "label": "a", "set": {"path.repeat": 12}},
        {"name": "loop-15", "label": "b", "set": {"path.repeat": 11}},
    ]
    run(document, tmp_path / "edited")
    document["scenarios"][0]["set"]["path.repeat"] = 10
    count, told = run(document, tmp_path / "edited")
    place = tmp_path / "edited" / "superseded"
    assert (count, told[0]) == (6, f"a has changed: 6 cells of before are set aside in {place}")
    assert len(list((place / "runs").iterdir())) == 3
    run(document, tmp_path / "fresh")
    assert tables(tmp_path / "edited") == tables(tmp_path / "fresh")
    assert files(tmp_path / "edited") == files(tmp_path / "fresh")


def test_other_judgement_is_another_row(tmp_path):
    run(SMALL, tmp_path / "edited")
    document = SMALL | {"metrics": {"skip": 4}}
    count, told = run(document, tmp_path / "edited")
    assert count == 12
    assert told[0].startswith("runs are judged otherwise than before: 12 cells are set aside")
    run(document, tmp_path / "fresh")
    assert files(tmp_path / "edited") == files(tmp_path / "fresh")


def test_rows_of_other_versions_stay_and_are_told_of(tmp_path, monkeypatch):
    run(SMALL | {"seeds": 1}, tmp_path)
    before = files(tmp_path)
    for module in ("cells", "running"):
        path = f"ekfslam.experiments.{module}.versions_in_words"
        monkeypatch.setattr(path, lambda: "python 9, numpy 9")
    count, told = run(SMALL, tmp_path)
    assert count == 8
    assert told[0] == "4 of 12 cells are there already"
    assert told[1].startswith("4 of them stay from other versions: python 3")
    assert files(tmp_path).items() >= before.items()
    assert read_campaign(tmp_path).runs["versions"].nunique() == 2


def test_failed_cells_run_again_when_asked(tmp_path):
    document = SMALL | {"estimators": ["campaigns:Broken", "ekf"], "compare": {}}
    run(document, tmp_path)
    before = tables(tmp_path)
    count, told = run(document, tmp_path)
    assert count == 0
    assert told[0] == "2 cells failed before and are not run again, unless retried"
    assert run(document, tmp_path, retry_failed=True)[0] == 4
    assert tables(tmp_path) == before


# The folder -------------------------------------------------------------------------------------


def test_a_folder_has_one_campaign_at_work(tmp_path):
    with (
        Store(tmp_path).opened(),
        pytest.raises(InputError, match="another campaign is at work"),
    ):
        run_campaign(SMALL, tmp_path)
    run_campaign(SMALL | {"seeds": 1}, tmp_path)


def test_strange_files_are_left_alone(tmp_path):
    (tmp_path / "runs").mkdir()
    for name in ("notes.txt", ".hidden", "mine.parquet"):
        (tmp_path / "runs" / name).write_text("mine")
    run_campaign(SMALL | {"seeds": 1}, tmp_path)
    assert (tmp_path / "runs" / "mine.parquet").read_text() == "mine"
    assert len(read_campaign(tmp_path).runs) == 4


def test_a_damaged_file_is_named(tmp_path):
    run_campaign(SMALL | {"seeds": 1}, tmp_path)
    path = next((tmp_path / "runs").iterdir())
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(FileFormatError, match=path.name):
        run_campaign(SMALL, tmp_path)


def test_no_campaign_in_a_folder(tmp_path):
    with pytest.raises(FileFormatError, match="no campaign is kept here"):
        read_campaign(tmp_path)
    for text in ("{", "[]", '{"campaign": "x"}'):
        (tmp_path / "config.json").write_text(text)
        with pytest.raises(FileFormatError, match="damaged, or not of a campaign"):
            read_campaign(tmp_path)


@pytest.mark.skipif(os.getuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_to(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="permission denied"):
        run_campaign(SMALL, tmp_path / "x")


def test_a_mistake_leaves_no_folder(tmp_path):
    with pytest.raises(InputError):
        run_campaign(SMALL | {"seeds": 0}, tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_exports_hold_what_the_tables_hold(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(
        'seeds = 2\nestimators = ["ekf"]\n[[scenarios]]\nname = "loop-15"\nset.path.repeat = 5'
    )
    results = run_campaign(file, tmp_path / "out")
    written = [path.name for path in results.save(figures=False)]
    assert written == [
        *("nees_over_time.csv", "pairs.csv", "runs.csv", "summary.csv", "timings.csv"),
    ]
    assert (tmp_path / "out" / "campaign.toml").read_text() == file.read_text()
    config = json.loads((tmp_path / "out" / "config.json").read_text())
    assert config["campaign"] == "mine"
    assert config["seeds"] == [0, 1]
    assert {"python", "numpy", "ekfslam"} <= set(config["versions"])
    back = pd.read_csv(tmp_path / "out" / "runs.csv", dtype=str)
    assert (back["nis_sum"].astype(float) == results.runs["nis_sum"]).all()
    schema = pq.read_schema(next((tmp_path / "out" / "steps").iterdir()))
    assert schema.names == list(SCHEMAS["steps"])
