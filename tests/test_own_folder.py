"""The command in a folder of a user's own: no source tree, a module beside it, three forms."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

MODULE = """
import numpy as np

from ekfslam import EkfSlam, estimate

RATE = 1.0


class Mine(EkfSlam):
    def predict(self, increment, covariance):
        super().predict(RATE * increment, covariance)


class Broken(Mine):
    def observe(self, observations):
        return {}["nothing"]


class Whole:
    def estimate(self, dataset):
        return estimate(dataset, "ekf")


def poses(dataset):
    return estimate(dataset, "ekf").online.poses


ready = Mine()
"""
CAMPAIGN = """
seeds = 2
estimators = ["ekf", "mine:Mine", "mine:poses", "mine:Whole"]
[[scenarios]]
name = "loop-15"
set.path.repeat = 20
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "mine.py").write_text(MODULE)
    (tmp_path / "mine.toml").write_text(CAMPAIGN)
    return tmp_path


def command(folder, *words):
    """Run the command as it is installed; nothing but the package and the folder is there."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    return subprocess.run(
        [str(Path(sys.executable).with_name("ekfslam")), *words],
        cwd=folder,
        env=environment | {"NO_COLOR": "1", "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_every_form_is_compared_by_its_name(folder):
    names = "ekf,mine:Mine,mine:ready,mine:Whole,mine:poses,mine:Broken"
    # A class and an object share a name: each is asked for by itself.
    clash = command(folder, "compare", "loop-15", "--estimators", names.replace("ready", "Mine"))
    assert clash.returncode == 2
    assert clash.stderr == ("ekfslam: two estimators are called Mine; give one another `name`\n")
    shown = command(folder, "compare", "loop-15", "--estimators", names, "--out", "out")
    assert (shown.returncode, shown.stderr) == (0, "")
    assert re.search(
        r"Broken: KeyError: 'nothing' \(mine.py, line 16, in observe, at step 0\)", shown.stdout
    )
    summary = pd.read_csv(folder / "out" / "summary.csv").set_index("estimator")
    assert summary["status"].to_dict() == {
        "ekf": "ok",
        "Mine": "ok",
        "ready": "ok",
        "Whole": "ok",
        "poses": "ok",
        "Broken": "failed",
    }
    errors = summary["ate_position_rmse_m"].dropna()
    assert len(errors) == 5
    np.testing.assert_array_equal(errors, errors["ekf"])
    assert (folder / "out" / "loop-15-map.png").exists()


def test_workers_find_the_module_and_edits_are_seen(folder):
    words = ("campaign", "mine.toml", "--out", "out", "--workers", "2", "--no-figures")
    shown = command(folder, *words)
    assert (shown.returncode, shown.stderr) == (0, "")
    runs = pd.read_csv(folder / "out" / "runs.csv")
    assert (runs["status"] == "ok").all()
    before = runs.set_index(["estimator", "seed"])["ate_position_rmse_m"]
    np.testing.assert_array_equal(before["Mine"], before["ekf"])
    (folder / "mine.py").write_text(MODULE.replace("RATE = 1.0", "RATE = 1.25"))
    shown = command(folder, *words)
    said = shown.stderr.splitlines()
    assert said == [
        "the module of Mine, poses, Whole has changed: 8 cells are set aside in out/superseded"
    ]
    after = pd.read_csv(folder / "out" / "runs.csv").set_index(["estimator", "seed"])
    after = after["ate_position_rmse_m"]
    assert (after["Mine"] > before["Mine"]).all()
    np.testing.assert_array_equal(after["ekf"], before["ekf"])


@pytest.mark.parametrize(
    ("source", "name", "said"),
    [
        ("", "absent:Mine", r"No module named 'absent': there is no absent.py in /.*, nor is it"),
        ("", "mine:Mien", "module 'mine' has no attribute 'Mien'"),
        ("class Mine(:", "mine:Mine", r"invalid syntax .*mine.py, line 1\)"),
        (
            "\nimport absent",
            "mine:Mine",
            r"No module named 'absent' \(mine.py, line 2, in <module>\)",
        ),
        ("\n\n1 / 0", "mine:Mine", r"ZeroDivisionError: .* \(mine.py, line 3, in <module>\)"),
        (
            "class Mine: pass",
            "mine:Mine",
            r"<mine.Mine object .* is no estimator: it has no estimate",
        ),
    ],
)
def test_what_cannot_be_used_is_told_in_a_line(
    source, name, said, tmp_path, monkeypatch, run_command
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "mine.py").write_text(source)
    try:
        shown = run_command("compare", "loop-15", "--estimators", f"ekf,{name}")
    finally:
        sys.modules.pop("mine", None)
    assert (shown.status, shown.out) == (2, "")
    assert re.fullmatch(rf"ekfslam: .*{said}.*\n", shown.err)
