"""Campaigns that are killed lose nothing that was done, and go on to the same tables."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from campaigns import SMALL, files, tables

from ekfslam import storage
from ekfslam.errors import InputError
from ekfslam.experiments import cluster, read_campaign, run_campaign

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Tables and files of the small campaign when nothing happens to it."""
    folder = tmp_path_factory.mktemp("finished")
    run_campaign(SMALL, folder)
    return tables(folder), files(folder)


# A worker ---------------------------------------------------------------------------------------

DYING = {
    "name": "dying",
    "seeds": 4,
    "estimators": ["dead-reckoning", "campaigns:Deadly"],
    "scenarios": [{"name": "loop-15", "set": {"path.repeat": 12}}],
}


@pytest.fixture
def undying(tmp_path, monkeypatch):
    """Tables of the same campaign if nothing dies; the folder to work in is new."""
    monkeypatch.chdir(tmp_path)
    Path("died").touch()
    run_campaign(DYING, tmp_path / "undying")
    Path("died").unlink()
    Path("runs.log").unlink()
    return tables(tmp_path / "undying")


def test_cells_of_a_worker_that_dies_run_again(undying, tmp_path):
    run_campaign(DYING, tmp_path / "out", workers=2)
    assert tables(tmp_path / "out") == undying
    runs = Path("runs.log").read_text().split()
    assert runs.count("1") == 2
    assert set(read_campaign(tmp_path / "out").runs["status"]) == {"ok"}


def test_a_cell_that_kills_every_worker_is_a_row_and_harms_no_other(undying, tmp_path, monkeypatch):
    deadly = "campaigns:Deadly(always=True)"
    document = DYING | {"estimators": ["dead-reckoning", deadly]}
    monkeypatch.setitem(cluster.SETTINGS, "distributed.scheduler.allowed-failures", 1)
    runs = run_campaign(document, tmp_path / "out", workers=2).runs
    failed = runs[runs["status"] == "failed"]
    assert failed[["seed", "estimator"]].to_numpy().tolist() == [[1, "Deadly(always=True)"]]
    assert failed["message"].str.contains("the worker died").all()
    assert len(failed) == 1
    assert len(runs) == 8
    others = runs[runs["estimator"] == "dead-reckoning"].reset_index(drop=True)
    before = read_campaign(tmp_path / "undying").runs
    before = before[before["estimator"] == "dead-reckoning"].reset_index(drop=True)
    assert others.to_csv() == before.to_csv()


# The whole campaign -----------------------------------------------------------------------------

TINY = {
    "name": "tiny",
    "seeds": 2,
    "estimators": ["dead-reckoning"],
    "scenarios": [{"name": "loop-15", "set": {"path.repeat": 4}}],
}
AT_EVERY_MOMENT = """
import json, os, signal, sys, traceback
from pathlib import Path
from ekfslam.experiments import run_campaign

def forked(work):
    child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        except BaseException:
            traceback.print_exc()
        os._exit(1)
    return os.waitpid(child, 0)[1]

def run_until(moment, folder):
    calls = 0
    def deadly(original):
        def call(*arguments):
            nonlocal calls
            calls += 1
            if calls == moment:
                os.kill(os.getpid(), signal.SIGKILL)
            return original(*arguments)
        return call
    os.replace, os.fsync = deadly(os.replace), deadly(os.fsync)
    run_campaign(TINY, folder)

def go_on(folder):
    def done():
        return {path.name: path.stat().st_mtime_ns for path in folder.glob("runs/[!.]*")}
    before = done()
    run_campaign(TINY, folder)
    assert done().items() >= before.items()
    leftovers = [path for path in folder.rglob(".*") if path.name != ".lock"]
    assert not leftovers, leftovers

ends = []
for moment in range(1, 99, 2):  # a unit takes nine calls: two of them come to each
    folder = Path(f"at-{moment}")
    ends.append(forked(lambda: run_until(moment, folder)))
    assert forked(lambda: go_on(folder)) == 0
    if ends[-1] == 0:
        break
print(json.dumps(ends))
"""


def test_killed_at_any_moment_of_its_writing_it_goes_on(tmp_path):
    """Before each file is synchronised or renamed, in forks, so that it takes seconds."""
    code = f"import sys; sys.path.insert(0, {str(HERE)!r})\nTINY = {TINY!r}\n{AT_EVERY_MOMENT}"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=tmp_path,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    ends = json.loads(done.stdout)
    assert len(ends) > 8
    assert ends == [signal.SIGKILL] * (len(ends) - 1) + [0]
    run_campaign(TINY, tmp_path / "whole")
    for moment in range(1, 2 * len(ends), 2):
        assert files(tmp_path / f"at-{moment}") == files(tmp_path / "whole"), moment


def test_killed_from_outside_with_its_workers_at_work(tmp_path):
    document = SMALL | {"seeds": 12}
    code = f"""if __name__ == "__main__":
        from ekfslam.experiments import run_campaign
        run_campaign({document!r}, "out", workers=2)"""
    (tmp_path / "run.py").write_text(code)
    victim = subprocess.Popen([sys.executable, "run.py"], cwd=tmp_path)
    try:
        until(lambda: len(list(tmp_path.glob("out/runs/[!.]*"))) >= 3)
        family = psutil.Process(victim.pid).children(recursive=True)
        victim.kill()
    finally:
        victim.wait()
    assert len(family) >= 2
    until(lambda: not any(each.is_running() and each.status() != "zombie" for each in family))
    there = files(tmp_path / "out")
    done = {
        name: data for name, data in there.items() if f"runs{os.sep}" in name and "/." not in name
    }
    assert 3 <= len(done) < 24
    told: list[str] = []
    run_campaign(document, tmp_path / "out", tell=told.append)
    assert told == [f"{2 * len(done)} of 48 cells are there already"]
    assert files(tmp_path / "out").items() >= done.items()
    run_campaign(document, tmp_path / "whole")
    assert files(tmp_path / "out") == files(tmp_path / "whole")


def until(happened, patience=300.0):
    begin = time.monotonic()
    while not happened():
        assert time.monotonic() < begin + patience, "it never happened"
        time.sleep(0.02)


# A full disk ------------------------------------------------------------------------------------


@pytest.mark.parametrize("workers", [1, 2])
def test_a_full_disk_is_told_and_loses_nothing(finished, tmp_path, monkeypatch, workers):
    written, sync = [], os.fsync

    def full(handle):
        written.append(handle)
        if len(written) > 8:  # in the third unit
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(handle)

    done: list[int] = []
    with monkeypatch.context() as patch:
        patch.setattr(storage.os, "fsync", full)
        patch.setattr("ekfslam.experiments.store._sync", lambda folder: None)
        with pytest.raises(InputError, match=r"No space left on device; what was done stays"):
            run_campaign(SMALL, tmp_path, workers, watch=lambda *news: done.append(news[2]))
    assert done == [0, 2, 4]
    there = files(tmp_path)
    assert len(there) == 4
    assert not [name for name in there if "/." in name]
    run_campaign(SMALL, tmp_path)
    assert files(tmp_path).items() >= there.items()
    assert (tables(tmp_path), files(tmp_path)) == finished


def mount(*options):
    return subprocess.run(["mount", *options], capture_output=True, check=False).returncode == 0


@pytest.fixture
def small_disk(tmp_path):
    """A file system with room for some units of work."""
    place = tmp_path / "disk"
    place.mkdir()
    if not mount("-t", "tmpfs", "-o", "size=200k", "tmpfs", str(place)):
        pytest.skip("file systems cannot be mounted here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_a_disk_that_is_really_full(finished, small_disk):
    with pytest.raises(InputError, match="No space left on device"):
        run_campaign(SMALL, small_disk)
    there = files(small_disk)
    done = [name for name in there if name.startswith("runs")]
    assert 0 < len(done) < 6
    assert not [name for name in there if "/." in name]
    with pytest.raises(InputError, match="No space left on device"):
        run_campaign(SMALL, small_disk)
    assert files(small_disk) == there
    assert mount("-o", "remount,size=20m", str(small_disk))
    results = run_campaign(SMALL, small_disk)
    assert (tables(small_disk), files(small_disk)) == finished
    results.save(figures=False)
