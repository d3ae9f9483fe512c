"""The command in scripts: JSON, CSV, exit statuses, pipes, colours."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_cli import PLAIN, SMALL

import ekfslam
from ekfslam import registry
from ekfslam.cli import tables
from ekfslam.cli.output import plain
from ekfslam.datasets import RECORDED
from ekfslam.evaluation.tables import read_csv
from ekfslam.simulation import scenarios

CAMPAIGN = """
seeds = 2
estimators = ["dead-reckoning", "campaigns:Broken"]
[[scenarios]]
name = "loop-15"
set.path.repeat = 8
[compare]
baseline = "dead-reckoning"
metrics = ["ate_position_rmse_m"]
"""
BAD = """
class Raises:
    def estimate(self, dataset):
        raise ValueError("never")
class Lost:
    def estimate(self, dataset):
        from dataclasses import replace
        from ekfslam.estimates import Trajectory
        import ekfslam
        good = ekfslam.estimate(dataset, "dead-reckoning")
        return replace(good, online=Trajectory(good.online.poses + 1e6, good.online.covariances))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder of its own; nothing that forces colours."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("FORCE_COLOR", "NO_COLOR", "COLUMNS"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.fixture
def small(folder):
    """A scenario file that is quick to run."""
    path = folder / "small.toml"
    path.write_text(SMALL)
    return path


@pytest.fixture
def asked(run_command):
    """The document that a command prints with --json, and its exit status."""

    def ask(*words):
        shown = run_command(*words, "--json")

        def refuse(word):
            raise AssertionError(f"{word} is no JSON")

        document = json.loads(shown.out, parse_constant=refuse)
        assert document["ekfslam"] == ekfslam.__version__
        assert document["command"] == words[0]
        return document, shown

    return ask


def same(rows, table):
    """Whether rows of a document hold what a table holds, digit by digit."""
    assert len(rows) == len(table)
    for row, (_, expected) in zip(rows, table.iterrows(), strict=True):
        assert list(row) == list(table.columns)
        for name, value in row.items():
            if value is None:
                assert pd.isna(expected[name]) or math.isinf(expected[name]), name
            else:
                assert value == expected[name], name


# JSON -------------------------------------------------------------------------------------------


def test_a_comparison_as_json_is_its_summary(asked, small):
    words = ["--estimators", "dead-reckoning,ekf", "--out", "out", "--no-figures"]
    document, shown = asked("compare", small, *words)
    assert (shown.status, shown.err) == (0, "")
    summary = read_csv("summary", small.parent / "out" / "summary.csv")
    same(document["summary"], summary)
    assert any(value is None for value in document["summary"][0].values())
    assert document["config"]["seed"] == 0
    assert document["notes"] == {"small": []}
    assert sorted(document["files"]) == sorted(f"out/{p.name}" for p in Path("out").iterdir())
    assert asked("compare", small, *words[:2])[0]["files"] == []


def test_a_campaign_as_json(asked, folder):
    (folder / "mine.toml").write_text(CAMPAIGN)
    document, shown = asked("campaign", "mine.toml", "--out", "out", "--no-figures")
    assert (shown.status, shown.err) == (0, "")
    assert document["cells"] == {"done": 4, "all": 4}
    results = ekfslam.read_campaign("out")
    same(document["summary"], results.summary)
    same(document["pairs"], results.pairs)
    again, shown = asked("summary", "out", "--no-figures")
    assert again == document | {"command": "summary"}
    _, shown = asked("campaign", "mine.toml", "--out", "out", "--no-figures")
    assert "4 of 4 cells are there already" in shown.err


def test_a_check_as_json(asked):
    document, shown = asked("check", "dead-reckoning")
    report = ekfslam.check("dead-reckoning")
    assert (shown.status, document["passed"], document["consistent"]) == (0, True, None)
    same([{k: v for k, v in r.items() if k != "at_least"} for r in document["rungs"]], report.table)
    assert [r["at_least"] for r in document["rungs"]] == [r.at_least for r in report.rungs]
    assert document["findings"] == []


def test_lists_as_json(asked, tmp_path, monkeypatch):
    monkeypatch.delenv("EKFSLAM_DATA", raising=False)
    listed = asked("datasets")[0]["datasets"]
    assert [row["name"] for row in listed] == [*scenarios(), *RECORDED]
    by_name = {row["name"]: row for row in listed}
    assert by_name["park"]["here"] is by_name["plaza1"]["here"] is True
    assert by_name["lego"]["here"] is False
    assert by_name["lego"]["missing"] == "ekfslam datasets lego"
    assert "[not here" not in "".join(row["description"] for row in listed)
    about = asked("datasets", "mrclam1/robot2")[0]
    assert about["is_here"] is False
    assert about["parts"] == [f"robot{k}" for k in range(1, 6)]
    assert about["about"]["what"] == RECORDED["mrclam1"].description
    found = {row["name"]: row for row in asked("estimators")[0]["estimators"]}
    assert set(found) == set(registry.registered())
    assert found["ekf"]["place"] == "ekfslam.filters.ekf:Ekf"
    assert {row["error"] for row in found.values()} == {""}


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (float("nan"), None),
        (-math.inf, None),
        (np.float64("nan"), None),
        (np.float64(0.1), 0.1),
        (np.int64(2**60), 2**60),
        (np.True_, True),
        (pd.NA, None),
        (pd.NaT, None),
        (1 / 3, 1 / 3),
        (("a", [math.nan]), ["a", [None]]),
        ({3: Path("x/y")}, {"3": "x/y"}),
    ],
)
def test_what_is_no_number_is_null(value, expected):
    assert plain(value) == expected
    assert type(plain(value)) is type(expected)


# CSV --------------------------------------------------------------------------------------------


def test_csv_is_the_file(run_command, small):
    words = ["--estimators", "dead-reckoning,ekf", "--out", "out", "--no-figures", "--csv"]
    shown = run_command("compare", small, *words)
    assert shown.status == 0
    assert shown.out.encode() == (small.parent / "out" / "summary.csv").read_bytes()
    assert shown.err.startswith("6 files in out: association.csv, ")


def test_csv_of_a_campaign_is_the_file(run_command, folder):
    (folder / "mine.toml").write_text(CAMPAIGN)
    run_command("campaign", "mine.toml", "--out", "out", "--no-figures")
    shown = run_command("summary", "out", "--no-figures", "--csv")
    assert shown.out.encode() == (folder / "out" / "summary.csv").read_bytes()


@pytest.mark.parametrize("words", ["compare", "campaign x.toml --out out", "summary out"])
def test_two_kinds_of_output_are_refused(run_command, folder, words):
    refused = run_command(*words.split(), "--json", "--csv")
    assert (refused.status, refused.out) == (2, "")
    assert "give one of them" in refused.err
    assert not list(folder.iterdir())


# Exit statuses ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "status"), [("Raises", 1), ("Lost", 1), (None, 0)])
def test_a_row_that_is_no_estimate_counts_where_that_is_asked_for(
    run_command, small, name, status
):  # fmt: skip
    (small.parent / "bad.py").write_text(BAD)
    names = ",".join(filter(None, ["dead-reckoning", name and f"bad:{name}"]))
    assert run_command("compare", small, "--estimators", names).status == 0
    strict = run_command("compare", small, "--estimators", names, "--strict")
    assert strict.status == status
    assert "dead-reckoning  online" in strict.out


def test_a_run_that_failed_counts_in_a_campaign(run_command, folder):
    (folder / "mine.toml").write_text(CAMPAIGN)
    words = ["mine.toml", "--out", "out", "--no-figures"]
    assert run_command("campaign", *words, "--strict").status == 1
    assert run_command("campaign", *words).status == 0
    assert run_command("summary", "out", "--no-figures", "--strict").status == 1
    (folder / "mine.toml").write_text(CAMPAIGN.replace(', "campaigns:Broken"', ""))
    assert run_command("campaign", *words, "--strict").status == 0


def test_an_error_that_is_nobodys_input_is_told_from_a_failed_check(run_command, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("ekfslam.validation.check", broken)
    shown = run_command("check", "ekf")
    assert shown.status == 3
    assert "ZeroDivisionError: a bug" in shown.err
    assert shown.err.splitlines()[-1].startswith("ekfslam: an error that is nobody's input")


# Pipes and colours ------------------------------------------------------------------------------


def shell(line, cwd, **more):
    """Run a line of bash in which the command is known."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-c", f"set -o pipefail; {line}"],
        cwd=cwd,
        env={**PLAIN, "PATH": path, **more},
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_reader_that_goes_away_leaves_no_traceback(small):
    run = shell("ekfslam datasets | head -1", small.parent)
    assert run.stderr == ""
    assert run.stdout.count("\n") == 1
    run = shell("ekfslam estimators | true", small.parent)
    assert (run.returncode, run.stdout, run.stderr) == (141, "", "")
    words = "compare small.toml --estimators dead-reckoning --out out --no-figures"
    run = shell(f"ekfslam {words} | true", small.parent)
    assert (run.returncode, run.stderr) == (141, "")
    assert (small.parent / "out" / "summary.csv").exists()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
@pytest.mark.parametrize("words", ["estimators", "estimators --json", "--help", "datasets lego"])
def test_a_full_disk_behind_the_output_is_one_line(words, tmp_path):
    run = shell(f"ekfslam {words} > /dev/full", tmp_path)
    assert run.returncode == 2
    assert run.stderr == "ekfslam: cannot write to standard output: No space left on device\n"


def test_in_a_pipe_every_row_is_a_line_without_escapes(small):
    for words in ("datasets", "estimators"):
        rows = shell(f"ekfslam {words} | cat", small.parent, COLUMNS="40").stdout.splitlines()
        names = {*scenarios(), *RECORDED} if words == "datasets" else set(registry.registered())
        assert {row.split()[0] for row in rows} == names
        assert len(rows) == len(names)
    long = "dead-reckoning"
    run = shell(f"ekfslam check {long} | cat", small.parent, COLUMNS="40")
    rungs = [line for line in run.stdout.splitlines() if re.match(r" \d ", line)]
    assert len(rungs) == 14
    assert "\x1b" not in run.stdout


@pytest.mark.parametrize(
    ("forced", "refused", "escapes"), [("1", "", True), ("1", "1", False), ("", "", False)]
)
def test_colours_are_forced_and_refused(small, forced, refused, escapes):
    wanted = {"FORCE_COLOR": forced, "NO_COLOR": refused}
    environment = {name: value for name, value in wanted.items() if value}
    line = "ekfslam compare small.toml --estimators dead-reckoning"
    run = shell(line, small.parent, **environment)
    assert ("\x1b[" in run.stdout) == escapes
    assert "dead-reckoning" in run.stdout
    assert "\x1b" not in shell(f"{line} --csv", small.parent, **environment).stdout


@pytest.mark.parametrize("width", [40, 80, 120, 300])
def test_a_table_goes_on_below_itself(width, monkeypatch, capsys):
    monkeypatch.setattr(tables, "terminal_width", lambda: width)
    names = [f"n{k}" for k in range(12)]
    rows = pd.DataFrame({"estimator": ["ekf", "iekf"]} | {n: [0.125, 12345.0] for n in names})
    columns = [tables.Column(name, f"{name}\n[m]", "{:.3f}".format) for name in names]
    tables.print_table(rows, ["estimator"], columns, "a title [m]")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "a title [m]"
    assert max(map(len, lines)) <= width
    for name, value in (("ekf", "0.125"), ("iekf", "12345.000")):
        parts = [line.split() for line in lines if line.startswith(f" {name} ")]
        assert [part[0] for part in parts] == [name] * len(parts)
        assert [number for part in parts for number in part[1:]] == [value] * 12
    headings = [word for line in lines for word in line.split() if re.fullmatch(r"n\d+", word)]
    assert headings == names
    assert len([line for line in lines if line.startswith(" ekf ")]) == {
        40: 6, 80: 2, 120: 2, 300: 1,
    }[width]  # fmt: skip
