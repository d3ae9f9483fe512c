"""The example package: built, installed beside ekfslam, and used by the name that it joins with."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pandas as pd
import pytest

SOURCE = Path(__file__).parents[1] / "examples" / "ekfslam-example-filter"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder that it is installed into."""
    folder = tmp_path_factory.mktemp("installed")
    # Without the tool that builds it, pip gets that from the registry.
    here = ["--no-build-isolation"] if find_spec("hatchling") else []
    words = ["install", "--quiet", "--no-deps", *here, "--target", str(folder), str(SOURCE)]
    done = subprocess.run(
        [sys.executable, "-m", "pip", *words], capture_output=True, text=True, check=False
    )
    if done.returncode and "hatchling" in done.stderr:
        pytest.skip(f"hatchling is not here: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def command(installed, tmp_path):
    def run(*words):
        return subprocess.run(
            [str(Path(sys.executable).with_name("ekfslam")), *words],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(installed), "NO_COLOR": "1", "COLUMNS": "300"},
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    return run


def test_it_is_listed_with_where_it_comes_from(command):
    shown = " ".join(command("estimators").split())  # long lines are broken
    assert (
        "mean-map Dead reckoning, and every landmark the mean of where it was seen from there. "
        "(ekfslam_example_filter:MeanMap of ekfslam-example-filter 0.1.0)"
    ) in shown


def test_it_is_compared_with_options_in_its_name(command, tmp_path):
    names = "mean-map, mean-map(last=5), dead-reckoning"
    command("compare", "park", "--estimators", names, "--out", "out", "--no-figures")
    table = pd.read_csv(tmp_path / "out" / "summary.csv").set_index("estimator")
    assert (table["status"] == "ok").all()
    ate = table["ate_position_rmse_m"]
    assert ate.to_numpy() == pytest.approx(ate["dead-reckoning"], rel=1e-9)
    landmarks = table["landmark_rmse_m"]
    assert 0 < landmarks["mean-map"] < landmarks["mean-map(last=5)"]  # the first ones are best


def test_a_campaign_notes_its_version(command, tmp_path):
    (tmp_path / "my.toml").write_text(
        'seeds = 1\nestimators = ["mean-map"]\n[[scenarios]]\nname = "cloister"\n'
    )
    command("campaign", "my.toml", "--out", "out", "--no-figures")
    runs = pd.read_parquet(tmp_path / "out" / "runs")
    assert runs["versions"].str.endswith(", ekfslam-example-filter 0.1.0").all()
