"""Ctrl-C and SIGTERM, as they come from outside: what was finished is kept and readable."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest

import ekfslam
from ekfslam.evaluation.tables import read_csv
from ekfslam.experiments import association_study
from ekfslam.experiments.attempts import Stopped
from ekfslam.experiments.study import sweep

SLOW = """
import time
from pathlib import Path
class Slow:
    def estimate(self, dataset):
        Path("started").touch()
        time.sleep(600)
"""
CAMPAIGN = """
seeds = 3000
estimators = ["dead-reckoning"]
[[scenarios]]
name = "loop-15"
set.path.repeat = 8
"""
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143}
FILES = ["association.csv", "config.json", "innovations.csv", "landmarks.csv", "summary.csv",
         "trajectories.csv"]  # fmt: skip


@pytest.fixture
def stopped(tmp_path):
    """Runs the command until something is there, and sends it a signal."""
    (tmp_path / "slow.py").write_text(SLOW)

    def run(words, number, there, patience=120.0):
        command = subprocess.Popen(
            [sys.executable, "-m", "ekfslam", *words.split()],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            begin = time.monotonic()
            while not there():
                assert command.poll() is None, command.communicate()
                assert time.monotonic() < begin + patience, "it never began"
                time.sleep(0.02)
            os.killpg(command.pid, number)  # a terminal sends it to the workers, too
            out, err = command.communicate(timeout=patience)
        finally:
            if command.poll() is None:
                os.killpg(command.pid, signal.SIGKILL)
        assert "Traceback" not in err
        return out, err, command.returncode

    return run


@pytest.mark.parametrize("number", STATUS)
def test_a_comparison_keeps_what_is_finished(stopped, tmp_path, number):
    words = "compare cloister loop-15 --estimators dead-reckoning,slow:Slow --out out"
    out, err, status = stopped(words, number, (tmp_path / "started").exists)
    assert status == STATUS[number]
    assert err == "stopped: 1 of 4 estimates are finished, and told of\n"
    assert " dead-reckoning  online  ok " in out
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == FILES
    config = json.loads((tmp_path / "out" / "config.json").read_text())
    assert list(config["datasets"]) == ["cloister"]
    others = [["cloister", "Slow"], ["loop-15", "dead-reckoning"], ["loop-15", "Slow"]]
    assert config["unfinished"] == others
    whole = ekfslam.compare("cloister", "dead-reckoning").summary
    kept = read_csv("summary", tmp_path / "out" / "summary.csv")
    timed = [name for name in whole if name.startswith("time_")]
    pd.testing.assert_frame_equal(kept.drop(columns=timed), whole.drop(columns=timed))


def test_earlier_results_are_not_replaced_by_half_of_new_ones(stopped, tmp_path):
    ekfslam.compare("loop-15", "dead-reckoning").save(tmp_path / "out", figures=False)
    before = {path: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    words = "compare cloister --estimators dead-reckoning,slow:Slow --out out --json"
    out, err, status = stopped(words, signal.SIGINT, (tmp_path / "started").exists)
    assert status == 130
    assert err.splitlines()[1:] == ["out holds earlier results, and is left as it was"]
    assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    document = json.loads(out)
    assert [row["estimator"] for row in document["summary"]] == ["dead-reckoning"]
    assert document["files"] == []


def test_before_anything_is_finished_nothing_is_left(stopped, tmp_path):
    words = "compare cloister --estimators slow:Slow --out out"
    out, err, status = stopped(words, signal.SIGTERM, (tmp_path / "started").exists)
    assert (out, err, status) == ("", "", 143)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("number", "workers"), [(signal.SIGINT, 2), (signal.SIGTERM, 1)])
def test_a_campaign_says_how_to_go_on_and_does(stopped, tmp_path, number, workers):
    (tmp_path / "mine.toml").write_text(CAMPAIGN)
    words = f"campaign mine.toml --out out --workers {workers}"

    def there():
        return len(list(tmp_path.glob("out/runs/[!.]*"))) > 1

    out, err, status = stopped(words, number, there)
    assert (out, status) == ("", STATUS[number])
    assert err == "stopped; what was done stays, run it again to go on\n"
    assert {path.name for path in (tmp_path / "out").rglob(".*")} == {".lock"}
    done, cells = ekfslam.read_campaign(tmp_path / "out").cells
    assert 1 < done < cells == 3000


# In Python --------------------------------------------------------------------------------------


def after(count):
    """A watch that interrupts at its call of that number."""
    calls = iter(range(count))

    def watch(*_):
        if next(calls, None) is None:
            raise KeyboardInterrupt

    return watch


def untimed(table):
    return table[[name for name in table if not name.startswith("time_")]]


def test_what_a_stopped_comparison_found_is_what_the_whole_one_finds():
    names = ["ekf", "gtsam-batch", "dead-reckoning"]
    whole = ekfslam.compare(["loop-15", "cloister"], names)
    order: list[str] = []

    def watch(dataset, estimator, done, total):
        if order[-1:] != [f"{dataset} {estimator}"]:
            order.append(f"{dataset} {estimator}")
        if len(order) == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        ekfslam.compare(["loop-15", "cloister"], names, watch=watch)
    stop = caught.value
    assert isinstance(stop, Stopped)
    assert (stop.done, stop.total) == (4, 6)
    assert order[3] == "cloister gtsam-batch"  # all are held against it
    finished = [("loop-15", name) for name in names] + [("cloister", "gtsam-batch")]
    assert list(stop.found.estimates) == finished
    assert stop.found.config["unfinished"] == [["cloister", "ekf"], ["cloister", "dead-reckoning"]]
    for name in ("summary", "trajectories", "landmarks", "innovations", "association"):
        table = getattr(whole, name)
        cells = pd.MultiIndex.from_frame(table[["dataset", "estimator"]])
        expected = table[cells.isin(finished)].reset_index(drop=True)
        pd.testing.assert_frame_equal(untimed(getattr(stop.found, name)), untimed(expected))


def test_what_a_stopped_study_found_is_the_beginning_of_the_whole_one():
    asked = {"methods": ["known"], "scales": [1.0, 2.0], "seeds": 2}
    whole = association_study("orchard", **asked)
    with pytest.raises(Stopped) as caught:
        association_study("orchard", **asked, watch=after(3))
    stop = caught.value
    assert (stop.done, stop.total, stop.found.config["draws_done"]) == (3, 4, 3)
    pd.testing.assert_frame_equal(stop.found.runs, whole.runs[:3])
    pd.testing.assert_frame_equal(stop.found.summary[:1], whole.summary[:1])
    assert "draws_done" not in whole.config


def test_draws_from_several_processes_are_kept_in_their_order():
    whole = sweep("loop-15", ["dead-reckoning"], seeds=4)
    with pytest.raises(Stopped) as caught:
        sweep("loop-15", ["dead-reckoning"], seeds=4, workers=2, watch=after(3))
    assert (caught.value.done, caught.value.total) == (3, 4)
    pd.testing.assert_frame_equal(caught.value.found, whole[:3])


def test_what_has_found_nothing_is_a_plain_interrupt():
    for run in (ekfslam.compare, association_study):
        with pytest.raises(KeyboardInterrupt) as caught:
            run(
                "orchard", ["dead-reckoning" if run is ekfslam.compare else "known"], watch=after(0)
            )
        assert not isinstance(caught.value, Stopped)


def test_the_command_keeps_the_draws_of_a_study(run_command, tmp_path, monkeypatch):
    def interrupted(*args, watch, **options):
        return association_study(*args, watch=after(2), **options)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ekfslam.experiments.association_study", interrupted)
    words = ["study", "association", "--methods", "known", "--seeds", 2, "--scales", "1"]
    for told in ("", "out holds earlier results, and is left as it was\n"):
        shown = run_command(*words, "--out", "out")
        assert shown.status == 130
        assert shown.err == f"stopped: 2 of 2 draws are finished, and told of\n{told}"
        assert "known" in shown.out
        assert len(pd.read_csv("out/runs.csv")) == 2


def test_studies_that_cannot_keep_anything_say_so(run_command, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ekfslam.experiments.partial_study", interrupted)
    monkeypatch.setattr("ekfslam.experiments.recorded.recorded_study", interrupted)
    shown = run_command("study", "partial", "--out", "out")
    assert (shown.status, shown.err) == (130, "stopped; nothing is written before all is done\n")
    shown = run_command("study", "recorded", "--out", "out")
    said = "stopped; the tables of sets that were finished are in out\n"
    assert (shown.status, shown.err) == (130, said)


def test_terminating_is_as_it_was_after_the_command(run_command):
    before = signal.getsignal(signal.SIGTERM)
    run_command("--version")
    assert signal.getsignal(signal.SIGTERM) is before
