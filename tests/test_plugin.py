"""The pytest plugin: both outcomes of each assertion, what they say, and references."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

import ekfslam
from ekfslam.testing import assert_not_worse
from ekfslam.testing.references import TITLE, read_reference, rewrite

pytest_plugins = "pytester"

ATE = "ate_position_rmse_m"

WORSE = """
from dataclasses import replace
import ekfslam
from ekfslam.testing import assert_accuracy, assert_consistent, assert_not_worse

class Filter:
    '''The EKF, told that its sensor is better than it is by a factor.'''
    name = "mine"

    def __init__(self, factor=1.0):
        self.factor = factor

    def estimate(self, data):
        sensors = [replace(s, covariance=self.factor * s.covariance) for s in data.sensors]
        return ekfslam.estimate(replace(data, sensors=tuple(sensors)), "ekf")
"""


@pytest.fixture(scope="module", autouse=True)
def loaded():
    """All that a failure needs is imported: a session inside this one forgets what it imports."""
    with pytest.raises(AssertionError, match=r"figure: .*map-of-worst"):
        assert_not_worse("dead-reckoning", "ekf", ekfslam.simulate("loop-15", seed=0))


@pytest.fixture
def run(pytester, monkeypatch):
    """Run a file of tests, as a user does."""
    for name in ("CI", "BUILD_NUMBER"):  # there pytest writes every message twice
        monkeypatch.delenv(name, raising=False)

    def run(body, *options):
        pytester.makepyfile(test_mine=WORSE + body)
        found = pytester.runpytest("-W", "error", *options)
        text = "\n".join(found.outlines + found.errlines)
        assert "no figure" not in text
        return found, text

    return run


REFERRED = """
def test_no_worse():
    assert_not_worse(Filter({factor}), "stored/mine.csv", "loop-15", seeds={seeds}, metric={metric})
"""


def referred(factor=1.0, seeds=30, metric=ATE):
    return REFERRED.format(factor=factor, seeds=seeds, metric=repr(metric))


def test_a_reference_is_asked_for_written_met_and_missed(run, pytester):
    """The whole life of a reference, from none to one that a worse filter misses."""
    stored = Path(pytester.path, "stored", "mine.csv")
    found, text = run(referred())
    found.assert_outcomes(failed=1)
    assert "stored/mine.csv is missing: write it with" in text
    assert "pytest test_mine.py::test_no_worse --ekfslam-update" in text
    assert not stored.exists()

    found, text = run(referred(), "--ekfslam-update")
    found.assert_outcomes(passed=1)
    assert "stored/mine.csv: mine on loop-15" in text
    first = stored.read_bytes()
    lines = first.decode().splitlines()
    assert lines[0] == TITLE
    assert lines[1].startswith("# mine on loop-15: ekfslam ")
    assert lines[2] == f"scenario,estimator,series,robot,seed,status,draw,{ATE}"
    assert len(lines) == 3 + 30

    found, _ = run(referred())
    found.assert_outcomes(passed=1)
    assert stored.read_bytes() == first

    found, text = run(referred(4.0, metric="rpe_position_rmse_m"))
    found.assert_outcomes(failed=1)
    assert "stored/mine.csv: mine on loop-15 has no rpe_position_rmse_m: write it with" in text

    found, text = run(referred(0.02))
    found.assert_outcomes(failed=1)
    assert "mine on loop-15 is worse than stored/mine.csv: mean ate_position_rmse_m" in text
    assert "margin 1 % (99 % confidence); 30 seeds, false-alarm rate 1 %" in text
    assert "worst of 30 seeds, ate_position_rmse_m on loop-15:" in text
    pictures = [line.partition("figure: ")[2] for line in found.outlines if "figure: " in line]
    assert [Path(path).name for path in pictures] == [
        "mine-loop-15-seeds.png",
        "mine-loop-15-map-of-worst.png",
    ]
    assert all(Path(path).read_bytes().startswith(b"\x89PNG") for path in pictures)
    assert "test_mine.py-test_no_worse" in pictures[0]
    again = "if this is meant to be, write the reference anew: pytest test_mine.py::test_no_worse"
    assert f"{again} --ekfslam-update" in text
    assert stored.read_bytes() == first

    found, _ = run(referred(0.02), "--ekfslam-update")
    found.assert_outcomes(passed=1)
    assert stored.read_bytes() != first
    found, _ = run(referred(0.02))
    found.assert_outcomes(passed=1)


MANY = """
import pytest

@pytest.mark.parametrize("scenario", ["loop-15", "heading-sweep"])
@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_no_worse(scenario, factor):
    mine = Filter(factor)
    mine.name = f"mine-{factor:g}"
    assert_not_worse(mine, "mine.csv", scenario, seeds=8)

def test_another_metric():
    mine = Filter(1.0)
    mine.name = "mine-1"
    assert_not_worse(mine, "mine.csv", "loop-15", seeds=range(4, 12),
                     metric=["landmark_rmse_m", "rpe_position_rmse_m"])
"""


def test_workers_write_what_one_process_writes(run, pytester):
    """Every test into one file, in whatever order and process they run."""
    pytest.importorskip("xdist")
    stored = Path(pytester.path, "mine.csv")
    found, _ = run(MANY, "--ekfslam-update")
    found.assert_outcomes(passed=5)
    alone = stored.read_bytes()
    stored.unlink()
    found, text = run(MANY, "--ekfslam-update", "-n", "2")
    found.assert_outcomes(passed=5)
    assert "mine.csv: mine-1 on heading-sweep, mine-1 on loop-15, mine-4 on" in text
    assert stored.read_bytes() == alone
    table = read_reference(stored)
    assert table.groupby(["estimator", "scenario"])["seed"].count().to_dict() == {
        ("mine-1", "heading-sweep"): 8,
        ("mine-1", "loop-15"): 12,
        ("mine-4", "heading-sweep"): 8,
        ("mine-4", "loop-15"): 8,
    }
    assert table.groupby("estimator")["landmark_rmse_m"].count().to_dict() == {
        "mine-1": 8,
        "mine-4": 0,
    }
    found, _ = run(MANY, "-n", "2")
    found.assert_outcomes(passed=5)
    # One test alone rewrites its own rows, and leaves those of the others.
    changed = MANY.replace("mine = Filter(factor)", "mine = Filter(2 * factor)")
    found, _ = run(changed, "--ekfslam-update", "-k", "4.0 and loop")
    found.assert_outcomes(passed=1, deselected=4)
    both = read_reference(stored).merge(table, on=["scenario", "estimator", "seed"])
    assert len(both) == len(table)
    moved = both[f"{ATE}_x"] != both[f"{ATE}_y"]
    keys = both.loc[moved & both[f"{ATE}_x"].notna(), ["estimator", "scenario"]]
    assert set(map(tuple, keys.to_numpy())) == {("mine-4", "loop-15")}
    assert keys.shape[0] == 8


OUTCOMES = """
def test_accurate():
    assert_accuracy(Filter, "loop-15", seeds=20, ate_position_rmse_m=0.35, nis_inside_95=0.9)

def test_not_accurate():
    assert_accuracy(Filter, "loop-15", seeds=20, ate_position_rmse_m=0.1)

def test_not_precise():
    assert_accuracy(Filter, "loop-15", seeds=20, association_precision=1.1)

def test_consistent():
    assert_consistent("ekf-ri", "loop-15", seeds=20)

def test_overconfident():
    assert_consistent("ekf", "loop-15", seeds=40)

def test_underconfident():
    assert_consistent(Filter(4.0), "loop-15", seeds=20)

def test_as_good_as():
    assert_not_worse("ekf-ri", "ekf", "loop-15", seeds=20)

def test_not_as_good_as():
    assert_not_worse("dead-reckoning", "ekf", "loop-15", seeds=20)
"""


def test_each_assertion_has_two_outcomes(run):
    found, text = run(OUTCOMES)
    found.assert_outcomes(passed=3, failed=5)
    for line in (
        "AssertionError: mine on loop-15: mean ate_position_rmse_m 0.",
        "is below 1.1, at most 1 (99 % confidence); 20 runs, false-alarm rate 1 %",
        "AssertionError: ekf on loop-15 is overconfident: mean NEES of the final pose ",
        "AssertionError: mine on loop-15 is underconfident: mean NIS per dof 0.",
        "AssertionError: dead-reckoning on loop-15 is worse than ekf: mean ate_position_rmse_m",
    ):
        assert line in text
    assert "ekfslam/testing" not in text  # the traceback shows the user's line, not ours


def test_the_plugin_costs_an_unrelated_project_nothing():
    code = """
import pytest, sys
before = set(sys.modules)
import ekfslam.testing.plugin
ours = {"ekfslam", "ekfslam.testing", "ekfslam.testing.plugin", "ekfslam.testing.session"}
more = {name.partition(".")[0] for name in set(sys.modules) - before - ours}
assert not more - set(sys.stdlib_module_names), more
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


FIXTURE = """
def test_fixture(ekfslam_testing):
    assert not ekfslam_testing.updating
    assert ekfslam_testing.test == "test_mine.py::test_fixture"
    assert ekfslam_testing.figures.name == "test_mine.py-test_fixture"

def test_runs_are_kept(ekfslam_testing):
    calls = []
    class Counting(Filter):
        def estimate(self, data):
            calls.append(data.seed)
            return super().estimate(data)
    assert_accuracy(Counting, "loop-15", seeds=3, ate_position_rmse_m=1.0)
    assert_consistent(Counting, "loop-15", seeds=4)
    assert calls == [0, 1, 2, 3]
    ekfslam_testing.forget()
    assert_accuracy(Counting, "loop-15", seeds=[2], ate_position_rmse_m=1.0)
    assert calls == [0, 1, 2, 3, 2]

def test_an_object_that_changes_is_another():
    mine = Filter(1.0)
    good = assert_accuracy(mine, "loop-15", seeds=2, nis_per_dof=2.0)
    mine.factor = 4.0
    assert assert_accuracy(mine, "loop-15", seeds=2, nis_per_dof=2.0).claims["mean"][0] < 0.5
"""


def test_the_fixture_and_what_is_kept(run, pytester):
    found, _ = run(FIXTURE, "--ekfslam-figures", "pictures")
    found.assert_outcomes(passed=3)
    assert Path(pytester.path, "pictures", "test_mine.py-test_fixture").is_dir()


FOREIGN = """
def test_from_a_summary():
    assert_not_worse({name!r}, "summary.csv", seeds={seeds}, metric="rpe_position_rmse_m")
"""


def test_a_summary_is_a_reference_that_is_not_overwritten(run, pytester):
    runs = [ekfslam.compare("loop-15", "ekf", seed=seed).summary for seed in range(8)]
    summary = Path(pytester.path, "summary.csv")
    pd.concat(runs).to_csv(summary, index=False)
    before = summary.read_bytes()
    for options in ((), ("--ekfslam-update",)):
        found, _ = run(FOREIGN.format(name="ekf", seeds=None), *options)
        found.assert_outcomes(passed=1)
        found, text = run(FOREIGN.format(name="ekf", seeds=9), *options)
        found.assert_outcomes(failed=1)
        assert "summary.csv: ekf on loop-15 has no seed 8: it was not written by" in text
        found, text = run(FOREIGN.format(name="iekf", seeds=None), *options)
        found.assert_outcomes(failed=1)
        assert "summary.csv has no runs of iekf: say on which scenario" in text
    assert summary.read_bytes() == before


def test_of_a_run_on_another_draw_nothing_stays(tmp_path):
    file = tmp_path / "mine.csv"
    row = {"scenario": "s", "estimator": "e", "series": "online", "robot": "r", "status": "ok"}
    row |= {"versions": "v 1"}
    rewrite(file, [row | {"seed": seed, "draw": 10.0, ATE: 1.0} for seed in (0, 1)])
    rewrite(file, [row | {"seed": 0, "draw": 10.0 + 1e-9, "rpe": 2.0, "versions": "v 2"}])
    table = read_reference(file)
    assert table["rpe"].tolist()[:1] == [2.0]
    assert table[ATE].tolist() == [1.0, 1.0]
    assert "# e on s: v 2" in file.read_text().splitlines()
    rewrite(file, [row | {"seed": 0, "draw": 11.0, "rpe": 3.0}])
    assert read_reference(file)[ATE].isna().tolist() == [True, False]


def test_names_are_text_whatever_they_look_like(tmp_path):
    file = tmp_path / "mine.csv"
    row = {"estimator": "7", "series": "online", "status": "ok", "draw": 10.0, "versions": "v"}
    names = [("run #3", "1"), ("NA", "2"), ("1e3", None)]
    rows = [row | {"scenario": s, "robot": r, "seed": 0, ATE: 1.0} for s, r in names]
    for _ in range(2):  # again, over what was written
        rewrite(file, rows)
        table = read_reference(file)
        assert sorted(zip(table["scenario"], table["robot"].fillna(""), strict=True)) == [
            ("1e3", ""),
            ("NA", "2"),
            ("run #3", "1"),
        ]
        assert table["estimator"].tolist() == ["7"] * 3
        assert table[ATE].tolist() == [1.0] * 3


def test_a_number_that_is_no_more_does_not_stay(tmp_path):
    file = tmp_path / "mine.csv"
    row = {"scenario": "s", "estimator": "e", "series": "online", "robot": None, "draw": 10.0}
    row |= {"versions": "v"}
    rewrite(file, [row | {"seed": k, "status": "ok", ATE: 1.0, "rpe": 2.0} for k in (0, 1)])
    rewrite(file, [row | {"seed": 0, "status": "diverged", ATE: None}])
    table = read_reference(file)
    assert table["status"].tolist() == ["diverged", "ok"]
    assert table[ATE].isna().tolist() == [True, False]
    assert table["rpe"].tolist() == [2.0, 2.0]


LOST = """
class Breaks(Filter):
    def estimate(self, data):
        if data.seed == 3:
            raise ValueError("no pivot")
        return super().estimate(data)

def test_accuracy():
    assert_accuracy(Breaks, "loop-15", seeds=8, ate_position_rmse_m=9.0)

def test_consistency():
    assert_consistent(Breaks, "loop-15", seeds=8)

def test_not_worse():
    assert_not_worse(Breaks, Filter, "loop-15", seeds=8)
"""


def test_a_run_that_is_lost_fails_every_assertion(run):
    found, text = run(LOST)
    found.assert_outcomes(failed=3)
    line = "mine on loop-15: 1 failed of 8 runs, first seed 3 (ValueError: no pivot"
    assert text.count(f"AssertionError: {line}") == 3
    assert "; not so in mine" in text


def test_draws_of_another_scenario_are_not_paired(run, pytester):
    run(referred(seeds=8), "--ekfslam-update")
    stored = Path(pytester.path, "stored", "mine.csv")
    rows = stored.read_text().splitlines()
    fields = rows[5].split(",")
    fields[6] = str(1.001 * float(fields[6]))
    stored.write_text("\n".join([*rows[:5], ",".join(fields), *rows[6:]]) + "\n")
    found, text = run(referred(seeds=8))
    found.assert_outcomes(failed=1)
    assert "1 draws of loop-15 are not those of now, first seed 2" in text
