"""Completion in the shell: the right words, from bash as it asks, and nothing heavy imported."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from test_cli import HEAVY

from ekfslam import registry
from ekfslam.cli import completion
from ekfslam.datasets import RECORDED
from ekfslam.simulation import scenarios

BIN = Path(sys.executable).parent
ASK = """
eval "$(_EKFSLAM_COMPLETE=source_bash ekfslam)"
complete -p ekfslam
while IFS= read -r line; do
  IFS='|' read -r -a COMP_WORDS <<< "$line|"
  [[ $line == *'|' ]] && COMP_WORDS+=("")
  COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
  _ekfslam_completion ekfslam
  echo "${COMPREPLY[*]}" | tr '\\n' ' '
  echo
done
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with files that hold datasets, and one that does not."""
    monkeypatch.chdir(tmp_path)
    for name in ("run.npz", "mine.toml", "loop.g2o", "notes.txt"):
        (tmp_path / name).touch()
    return tmp_path


def environment(**more):
    return {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}", "HOME": "/nowhere", **more}


ASKED = {
    "ekfslam|comp": "compare",
    "ekfslam|study|": "association partial recorded",
    "ekfslam|compare|loop": "loop-15 loop-15-rb loop.g2o",
    "ekfslam|compare|park|r": "run.npz",
    "ekfslam|compare|mrclam3/robot4": "mrclam3/robot4",
    "ekfslam|compare|park|--estimators|ekf,gtsam-i": "ekf,gtsam-isam2",
    "ekfslam|compare|park|--align|": "none se2",
    "ekfslam|compare|park|--tables|p": "parquet",
    "ekfslam|check|ekf-r": "ekf-ri ekf-robocentric",
    "ekfslam|simulate|m": "mine.toml",
    "ekfslam|datasets|le": "lego",
    "ekfslam|study|recorded|plaza": "plaza1 plaza2",
    "ekfslam|study|association|--scenario|orch": "orchard",
    # Empty: bash goes on with files and folders.
    "ekfslam|compare|park|--out|m": "",
    "ekfslam|campaign|m": "",
    "ekfslam|summary|m": "",
    "ekfslam|report|m": "",
}


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_is_offered_the_right_words(folder):
    run = subprocess.run(
        ["bash", "--norc", "-c", ASK],
        input="\n".join(ASKED) + "\n",
        env=environment(),
        capture_output=True,
        text=True,
        check=True,
    )
    how, *offered = run.stdout.splitlines()
    assert how == "complete -o default -F _ekfslam_completion ekfslam"
    assert dict(zip(ASKED, map(str.strip, offered), strict=True)) == ASKED
    assert run.stderr == ""


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_shell_has_its_script(shell):
    run = subprocess.run(
        [BIN / "ekfslam"],
        env=environment(_EKFSLAM_COMPLETE=f"source_{shell}"),
        capture_output=True,
        text=True,
        check=True,
    )
    assert f"_EKFSLAM_COMPLETE=complete_{shell}" in run.stdout
    assert run.stderr == ""


@pytest.mark.parametrize("words", ["compare pa", "check e", "datasets m", "simulate p"])
def test_nothing_heavy_is_imported_to_complete(words, folder):
    script = (
        "import atexit, sys\n"
        f"atexit.register(lambda: print('loaded:', [m for m in {HEAVY!r} if m in sys.modules]))\n"
        "from ekfslam.cli import main\nsys.argv = ['ekfslam']\nmain()"
    )
    asked = {"COMP_WORDS": f"ekfslam {words}", "COMP_CWORD": "2"}
    run = subprocess.run(
        [sys.executable, "-c", script],
        env=environment(_EKFSLAM_COMPLETE="complete_bash", **asked),
        capture_output=True,
        text=True,
        check=True,
    )
    *offered, loaded = run.stdout.splitlines()
    assert offered
    assert loaded == "loaded: []"


def test_names_are_those_of_the_library(folder):
    """They are found without it, since it takes long to import."""
    assert completion.GROUP == registry.GROUP
    assert set(completion.estimators("")) == set(registry.registered())
    assert set(completion.recorded("")) == set(RECORDED)
    assert set(completion.scenarios("")) == {*scenarios(), "mine.toml"}
    files = {"run.npz", "mine.toml", "loop.g2o"}
    assert set(completion.datasets("")) == {*scenarios(), *RECORDED, *files}
    assert set(completion.recorded("mrclam1/")) == {f"mrclam1/robot{k}" for k in range(1, 6)}


@pytest.mark.parametrize(
    ("word", "offered"),
    [
        ("ekf(association=joint),gtsam-b", ["ekf(association=joint),gtsam-batch"]),
        ("ekf(association=jo", []),
        ("ekf(association=joint, conf", []),
        ("nobody", []),
    ],
)
def test_options_in_brackets_are_the_users_to_write(word, offered):
    assert completion.estimators(word) == offered
