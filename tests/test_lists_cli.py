"""The commands `datasets` and `estimators` as a user meets them: what there is, what is here."""

from __future__ import annotations

import re
from importlib.metadata import EntryPoint

import pytest

from ekfslam import registry
from ekfslam.datasets import RECORDED


@pytest.fixture
def command(tmp_path, monkeypatch, run_command):
    """Run the command in this process, on a wide page; its output, errors and exit status."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    for name in ("FORCE_COLOR", "PY_COLORS", "GITHUB_ACTIONS", "TERMINAL_WIDTH", "EKFSLAM_DATA"):
        monkeypatch.delenv(name, raising=False)

    def run(*words):
        told = run_command(*words)
        return " ".join(told.out.split()), told.err, told.status

    return run


@pytest.fixture
def mrclam(tmp_path):
    """A folder of sets, with the first of MRCLAM and of its robots one."""
    folder = tmp_path / "sets" / "MRCLAM_Dataset1"
    folder.mkdir(parents=True)
    for name in ("Barcodes.dat", "Landmark_Groundtruth.dat.gz", "Robot2_Odometry.dat",
                 "Robot2_Measurement.dat"):  # fmt: skip
        (folder / name).touch()
    return folder.parent


def test_datasets(command):
    shown, _, status = command("datasets")
    assert status == 0
    names = ("cloister", "loop-15", "park", "orchard", "team", *RECORDED)
    for words in (*names, "60 landmarks", "6969 poses", "clutter 0.3", "3 robots"):
        assert words in shown
    for name, recorded in RECORDED.items():
        assert (f"[not here: ekfslam datasets {name}]" in shown) == bool(recorded.published)


@pytest.mark.parametrize("how", ["option", "variable"])
def test_sets_that_are_here(command, mrclam, monkeypatch, how):
    if how == "variable":
        monkeypatch.setenv("EKFSLAM_DATA", str(mrclam))
    words = ["--data", mrclam] if how == "option" else []
    listed, _, status = command("datasets", *words)
    assert status == 0
    for name, recorded in RECORDED.items():
        away = recorded.published and name != "mrclam1"
        assert (f"[not here: ekfslam datasets {name}]" in listed) == bool(away)
    for name in ("mrclam1", "mrclam1/robot2"):
        told, _, status = command("datasets", name, *words)
        assert status == 0
        assert f"here yes, in {mrclam / 'MRCLAM_Dataset1'}" in told
        assert "; not here: robot1, robot3, robot4, robot5 files" in told
        assert "Robot1_Odometry.dat, Robot1_Measurement.dat for mrclam1/robot1" in told
    told, _, _ = command("datasets", "mrclam2", *words)
    assert f"here no: {mrclam} has no Barcodes.dat, Landmark_Groundtruth.dat" in told
    assert "published asrl.utias.utoronto.ca" in told
    told, _, _ = command("datasets", "plaza1", *words)
    assert "here yes, in " in told


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("mrlam1", "unknown recorded dataset 'mrlam1'; did you mean mrclam1"),
        ("park", "unknown recorded dataset 'park'"),
        ("mrclam1/robot7", "unknown part of mrclam1 'robot7'"),
        ("lego/robot1", "lego has no parts, so no lego/robot1"),
    ],
)
def test_a_name_that_is_none(command, name, said):
    shown, error, status = command("datasets", name)
    assert (shown, status) == ("", 2)
    assert error.startswith(f"ekfslam: {said}")
    assert error.count("\n") == 1


def test_estimators(command):
    shown, _, status = command("estimators")
    assert status == 0
    for words in ("ekf", "gtsam-batch", "gtsam-isam2", "dead-reckoning", "baselines.batch"):
        assert words in shown


def test_an_estimator_that_cannot_be_loaded_is_listed_with_the_reason(command, monkeypatch):
    broken = EntryPoint("broken", "absent_dependency:Thing", registry.GROUP)
    known = registry.registered()
    monkeypatch.setattr(registry, "registered", lambda: {**known, "broken": broken})
    shown, _, status = command("estimators")
    assert status == 0
    assert re.search("broken .*absent_dependency", shown)
    assert "gtsam-batch" in shown
