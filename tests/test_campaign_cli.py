"""The commands `campaign` and `summary` as a user meets them."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass

import pytest

from ekfslam.cli import main

FILE = """
seeds = 2
estimators = ["ekf", "dead-reckoning", "campaigns:Broken"]
[[scenarios]]
name = "loop-15"
set.path.repeat = 8
sweep.sensors.0.max_range = [4.0, 5.0]
[compare]
baseline = "ekf"
metrics = ["ate_position_rmse_m"]
"""


@dataclass
class Run:
    """What a command printed, and its exit status."""

    out: str
    err: str
    status: int


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """Run the command in this process, in a folder with a campaign file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(FILE)
    for name in ("FORCE_COLOR", "PY_COLORS", "GITHUB_ACTIONS", "TERMINAL_WIDTH", "COLUMNS"):
        monkeypatch.delenv(name, raising=False)

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["ekfslam", *map(str, words)])
        status = 0
        try:
            main()
        except SystemExit as stop:
            status = stop.code or 0
        printed = capsys.readouterr()
        return Run(printed.out, printed.err, status)

    return run


@pytest.mark.parametrize("name", ["campaign", "summary"])
def test_help_of_a_command(command, name):
    shown = command(name, "-h")
    assert shown.status == 0
    assert f"ekfslam {name}" in re.split("Arguments", shown.out)[0].split("Example")[1]


def test_a_campaign_is_run_and_told(command, tmp_path):
    shown = command("campaign", "mine.toml", "--out", "out", "--no-figures")
    assert (shown.status, shown.err) == (0, "")
    lines = shown.out.splitlines()
    assert lines[0].strip() == "loop-15(sensors.0.max_range=4.0)"
    assert any(line.split()[:3] == ["ekf", "2", "0"] for line in lines)
    assert "  Broken: failed at 1 seeds: RuntimeError: odd seeds" in lines
    assert sum(line.startswith("  dead-reckoning, ekf: too few pairs") for line in lines) == 2
    assert lines[-1].startswith("5 files in out: nees_over_time.csv, pairs.csv, runs.csv")
    assert (tmp_path / "out" / "summary.csv").exists()


def test_it_goes_on_and_says_so(command):
    command("campaign", "mine.toml", "--out", "out", "--seeds", "1", "--no-figures")
    again = command("campaign", "mine.toml", "--out", "out", "--no-figures")
    assert again.err == "6 of 12 cells are there already\n"
    third = command("campaign", "mine.toml", "--out", "out", "--no-figures")
    assert third.err.startswith("2 cells failed before and are not run again, unless retried\n")
    assert third.out == again.out
    retried = command("campaign", "mine.toml", "--out", "out", "--no-figures", "--retry-failed")
    assert retried.err == "6 of 12 cells are there already\n"


def test_a_summary_of_what_is_there(command, tmp_path):
    shown = command("campaign", "mine.toml", "--out", "out")
    assert "nees-over-time.png" in shown.out
    for path in (tmp_path / "out").glob("*.csv"):
        path.unlink()
    assert command("summary", "out", "--no-figures").out == re.sub(
        r"\d+ files.*", "5 files in out: nees_over_time.csv, pairs.csv, runs.csv, summary.csv, "
        "timings.csv", shown.out,
    )  # fmt: skip
    for path in sorted((tmp_path / "out" / "runs").iterdir())[1:]:
        path.unlink()
    partial = command("summary", "out", "--no-figures")
    assert partial.out.startswith("3 of 12 cells are done; this is what they say\n")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["campaign", "gone.toml", "--out", "out"], "gone.toml: no such file"),
        (["campaign", "mine.toml", "--out", "mine.toml"], "cannot write to mine.toml: there is no"),
        (["campaign", "mine.toml"], "Missing option '--out'"),
        (["campaign", "mine.toml", "--out", "out", "--seeds", "0"], "seeds must be a whole number"),
        (["campaign", "mine.toml", "--out", "out", "--workers", "0"], "workers must be"),
        (["summary", "nowhere"], "nowhere: no campaign is kept here"),
    ],
)
def test_a_mistake_is_one_line(command, tmp_path, words, message):
    shown = command(*words)
    assert (shown.status, shown.out) == (2, "")
    assert shown.err.startswith("ekfslam: ")
    assert message in shown.err
    assert shown.err.count("\n") == 1
    assert not (tmp_path / "out").exists()
