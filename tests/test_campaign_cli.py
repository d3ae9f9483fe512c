"""The commands `campaign` and `summary` as a user meets them."""

from __future__ import annotations

import re
import shutil

import pytest

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


@pytest.fixture
def command(tmp_path, monkeypatch, run_command):
    """Run the command in this process, in a folder with a campaign file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(FILE)
    for name in ("FORCE_COLOR", "PY_COLORS", "GITHUB_ACTIONS", "TERMINAL_WIDTH", "COLUMNS"):
        monkeypatch.delenv(name, raising=False)

    return run_command


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
    failure = "  Broken: failed at 1 seeds: RuntimeError: odd seeds (campaigns.py, line "
    assert any(line.startswith(failure) for line in lines)
    rows = [line for line in lines if " dead-reckoning  ekf " in line]
    assert ["too few pairs to tell" in row for row in rows] == [True, True]
    assert lines[-1].startswith("5 files in out: nees_over_time.csv, pairs.csv, runs.csv")
    assert (tmp_path / "out" / "summary.csv").exists()


def test_pairs_are_a_table_and_strangers_a_line(command, tmp_path):
    names = '"ekf", "dead-reckoning", "ekf-ri", "campaigns:Never"'
    text = re.sub("estimators = .*", f"estimators = [{names}]", FILE).replace(
        "seeds = 2", "seeds = 8"
    )
    text = text.replace('["ate', '["final_heading_sigma_rad", "ate')
    (tmp_path / "mine.toml").write_text(re.sub("sweep.*", "", text))
    lines = command("campaign", "mine.toml", "--out", "out", "--no-figures").out.splitlines()
    table = lines[lines.index(next(line for line in lines if line.startswith("on the same"))) :]
    assert table[0].rstrip().endswith("intervals of each alone, p adjusted for 4 comparisons")
    metric = "final_heading_sigma_rad"
    row = next(line for line in table if line.split()[:2] == [metric, "dead-reckoning"])
    beats = r" +dead-reckoning +ekf +ekf beats dead-reckoning +0 % +[\d.]+ ± [\d.]+ +[\d.]+ +8 *"
    assert re.fullmatch(f" {metric}{beats}", row)
    assert sum("Never, ekf:" in line for line in lines) == 1
    assert f"  Never, ekf: no seed has a number of both on {metric}, ate_position_rmse_m" in table


def test_who_stops_a_campaign_is_told_once_that_it_goes_on(command, monkeypatch):
    def interrupted(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("ekfslam.experiments.run_campaign", interrupted)
    shown = command("campaign", "mine.toml", "--out", "out")
    assert (shown.status, shown.out) == (130, "")
    assert shown.err == "stopped; what was done stays, run it again to go on\n"


@pytest.mark.parametrize("name", ["campaign", "summary"])
def test_files_are_there_when_nobody_reads_to_the_end(command, tmp_path, monkeypatch, name):
    def closed(results):
        raise BrokenPipeError

    command("campaign", "mine.toml", "--out", "out", "--no-figures")
    (tmp_path / "out" / "summary.csv").unlink()
    monkeypatch.setattr("ekfslam.cli.campaigns.print_campaign", closed)
    words = {"campaign": ["mine.toml", "--out", "out"], "summary": ["out"]}[name]
    assert command(name, *words, "--no-figures").status == 141
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


def test_tables_of_runs_that_are_gone_stay(command, tmp_path):
    """As in a repository that keeps the tables alone."""
    command("campaign", "mine.toml", "--out", "out", "--no-figures")
    shutil.rmtree(tmp_path / "out" / "runs")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").glob("*.csv")}
    shown = command("summary", "out", "--json")
    assert (shown.status, shown.out) == (2, "")
    assert "its tables are of runs that are not here, and would be lost" in shown.err
    assert before == {path.name: path.read_bytes() for path in (tmp_path / "out").glob("*.csv")}


def test_figures_of_an_earlier_state_go(command, tmp_path):
    text = FILE.replace("[4.0, 5.0]", "[4.0]").replace(', "campaigns:Broken"', "")
    (tmp_path / "mine.toml").write_text(text)
    command("campaign", "mine.toml", "--out", "out")
    assert (tmp_path / "out" / "pairs.png").exists()
    (tmp_path / "out" / "pairs-of-mine.png").touch()
    (tmp_path / "mine.toml").write_text(text.partition("[compare]")[0])
    command("campaign", "mine.toml", "--out", "out")
    left = {path.name for path in (tmp_path / "out").glob("*.png")}
    assert left >= {"nees-over-time.png", "pairs-of-mine.png"}
    assert "pairs.png" not in left


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
