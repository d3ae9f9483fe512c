"""The study of recorded sets: who is asked for how, what is a row, what is missing."""

from __future__ import annotations

import json

import pandas as pd
import pytest
from mrclam_made import write_set

from ekfslam.errors import FileFormatError, InputError, UnknownNameError
from ekfslam.experiments.recorded import (
    CASES,
    ESTIMATORS,
    FILTERS,
    KEPT,
    Case,
    recorded_study,
    texts_of,
)
from ekfslam.registry import parse, resolve

QUICK = ("dead-reckoning", "ekf-localization", "ekf-ideal")


@pytest.fixture(autouse=True)
def no_data_folder(monkeypatch):
    monkeypatch.delenv("EKFSLAM_DATA", raising=False)


@pytest.mark.parametrize("case", CASES, ids=[case.source for case in CASES])
def test_every_estimator_is_asked_for_in_words_that_can_be_read(case):
    texts = texts_of(case)
    assert set(texts) == set(ESTIMATORS)
    for name, text in texts.items():
        assert parse(text).name == name
        resolve(text)


def test_where_identities_are_not_known_filters_decide_and_smoothers_take_theirs():
    texts = texts_of(Case("somewhere", "association=joint, confirm=2, within=5"))
    own = "ekf(association=joint, confirm=2, within=5)"
    for name in FILTERS:
        assert texts[name].startswith(f"{name}(association=joint")
    assert texts["gtsam-batch"] == f"gtsam-batch(initial={own})"
    assert texts["gtsam-isam2"].startswith(f"gtsam-isam2(association={own}, marginal_every=")
    assert texts["ekf-robocentric"] == "ekf-robocentric(association=joint)"
    assert texts_of(Case("somewhere"))["ekf"] == "ekf"


def test_sets_of_the_package_run_and_what_does_not_apply_says_why(tmp_path):
    found = recorded_study(tmp_path, ["plaza2"], QUICK)
    rows = found.summary.set_index("estimator")
    assert rows.loc["dead-reckoning", "status"] in ("ok", "diverged")
    assert rows.loc["ekf-localization", "status"] == "ok"
    assert rows.loc["ekf-ideal", "status"] == "skipped"
    assert "determine a point" in rows.loc["ekf-ideal", "message"]
    aligned = rows.loc["dead-reckoning", "aligned_ate_position_rmse_m"]
    assert 0 < aligned < rows.loc["dead-reckoning", "ate_position_rmse_m"]
    assert found.missing == {}
    assert {f"{name}.csv" for name in KEPT} < {
        file.name for file in (tmp_path / "plaza2").iterdir()
    }
    assert (tmp_path / "plaza2" / "plaza2-map.png").is_file()
    stored = pd.read_csv(tmp_path / "summary.csv")
    assert list(stored["estimator"]) == list(found.summary["estimator"])
    assert json.loads((tmp_path / "config.json").read_text())["study"] == "recorded"


def test_sets_that_are_not_here_are_told(tmp_path, monkeypatch):
    monkeypatch.setattr("ekfslam.experiments.recorded.CASES", (Case("lego"), Case("plaza2")))
    found = recorded_study(tmp_path, estimators=["dead-reckoning"])
    assert list(found.summary["dataset"].unique()) == ["plaza2"]
    assert "Leibniz" in found.missing["lego"]
    monkeypatch.setattr("ekfslam.experiments.recorded.CASES", (Case("lego"),))
    with pytest.raises(InputError, match="no recorded set is here"):
        recorded_study(tmp_path)
    with pytest.raises(FileFormatError, match="lego: give the folder"):
        recorded_study(tmp_path, ["lego"])


def test_a_robot_whose_files_are_not_here_is_told(tmp_path, monkeypatch, rng):
    write_set(tmp_path / "MRCLAM_Dataset1", rng)
    cases = (Case("mrclam1/robot3"), Case("mrclam1/robot5"))
    monkeypatch.setattr("ekfslam.experiments.recorded.CASES", cases)
    who = ["dead-reckoning"]
    found = recorded_study(tmp_path / "out", estimators=who, path=tmp_path)
    assert list(found.summary["dataset"]) == ["mrclam1/robot3"]
    assert list(found.missing) == ["mrclam1/robot5"]


def test_two_processes_find_the_same(tmp_path, monkeypatch):
    sets, who = ["plaza1", "plaza2"], ["dead-reckoning"]
    one = recorded_study(tmp_path / "one", sets, who).summary
    two = recorded_study(tmp_path / "two", sets, who, workers=2).summary
    untimed = [name for name in one if not str(name).startswith("time_")]
    pd.testing.assert_frame_equal(one[untimed], two[untimed])


def test_names_that_are_none_of_the_study(tmp_path):
    with pytest.raises(UnknownNameError, match="recorded set of the study 'plaza3'; did you mean"):
        recorded_study(tmp_path, ["plaza3"])
    with pytest.raises(UnknownNameError, match="estimator of the study 'ukf'"):
        recorded_study(tmp_path, ["plaza2"], ["ukf"])
