"""The command as a user meets it: what it prints, what it leaves, and how it refuses."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version

import numpy as np
import pandas as pd
import pytest
import typer
from pages import check_command
from simulated import past_points

import ekfslam
from ekfslam.cli import app
from ekfslam.evaluation import tables

HEAVY = ("numpy", "pandas", "scipy", "matplotlib", "numba", "gtsam")
# What a shell may set to force colours into a pipe.
PLAIN = {"PATH": os.environ["PATH"], "HOME": os.environ.get("HOME", "/"), "TERM": "xterm"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder of its own; nothing that forces colours."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("FORCE_COLOR", "PY_COLORS", "GITHUB_ACTIONS", "TERMINAL_WIDTH", "COLUMNS"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.fixture
def command(folder, run_command):
    """Run the command in this process."""

    def run(*words):
        printed = run_command(*words)
        assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f\x9b]", printed.out + printed.err)
        return printed

    return run


SMALL = past_points(
    "Straight on past five landmarks.", [[2, 1], [3, -2], [4, 3], [6, -4], [9, 3]], steps=12
)


@pytest.fixture
def small(folder):
    """A scenario file that is quick to run."""
    path = folder / "small.toml"
    path.write_text(SMALL)
    return path


# Help -------------------------------------------------------------------------------------------


def test_help_opens_with_worked_examples(command):
    shown = command("--help")
    assert shown.status == 0
    assert shown.err == ""
    lines = [line.strip() for line in shown.out.splitlines()]
    first = next(i for i, line in enumerate(lines) if line.startswith("ekfslam compare"))
    assert first < next(i for i, line in enumerate(lines) if "Options" in line)
    examples = [line for line in lines if line.startswith("ekfslam ")]
    assert {line.split()[1] for line in examples} >= {"compare", "check", "simulate", "study"}
    for name in ("compare", "check", "simulate", "datasets", "estimators", "study"):
        assert re.search(rf"│ {name} ", shown.out)


def every_command(group=None, before=()):
    """Words that lead to each command, with the command."""
    group = group or typer.main.get_command(app)
    for name, command in group.commands.items():
        yield (*before, name), command
        if hasattr(command, "commands"):
            yield from every_command(command, (*before, name))


COMMANDS = dict(every_command())


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_help_of_a_command_opens_with_examples(command, words):
    shown = command(*words, "-h")
    assert shown.status == 0
    first = re.split("─ (?:Arguments|Options)", shown.out)[0]
    heading, _, examples = first.partition(" Examples ")
    assert len(re.sub("Usage: .*", "", heading).split()) > 3  # what it does
    assert f"ekfslam {' '.join(words)}" in examples
    lines = [line.strip() for line in COMMANDS[words].help.splitlines()]
    given = [line for line in lines if line.startswith("ekfslam ")]
    assert given
    for line in given:
        check_command(line)


def test_help_of_the_studies(command):
    for words in (["study"], ["study", "--help"]):
        assert re.search(r"│ association ", command(*words).out)


def test_units_survive_in_the_help(command):
    shown = " ".join(re.sub("[│╭╮╰╯─]", " ", command("compare", "-h").out).split())
    assert "Length of relative errors [m]." in shown


def test_version(command):
    shown = command("--version")
    assert shown.status == 0
    said = "Python {}, gtsam {}, numpy {}, scipy {}, numba {}".format(
        platform.python_version(), *map(version, ("gtsam", "numpy", "scipy", "numba"))
    )
    assert shown.out == f"ekfslam {ekfslam.__version__} ({said})\n"


def test_without_words_it_helps(command):
    assert "ekfslam compare" in command().out


@pytest.mark.parametrize("words", [["--help"], ["compare", "--help"], ["--version"], ["bogus"]])
def test_nothing_heavy_is_imported_before_it_is_needed(words):
    script = (
        "import sys\nfrom ekfslam.cli import main\n"
        f"sys.argv = ['ekfslam', *{words!r}]\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        f"print('loaded:', [m for m in {HEAVY!r} if m in sys.modules])"
    )
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=PLAIN, check=True
    )
    assert run.stdout.splitlines()[-1] == "loaded: []"


def test_the_installed_command_and_the_module_are_the_same():
    command = os.path.join(os.path.dirname(sys.executable), "ekfslam")
    for words in ([command], [sys.executable, "-m", "ekfslam"]):
        run = subprocess.run(
            [*words, "compare", "nowhere"], capture_output=True, text=True, env=PLAIN, check=False
        )
        assert run.returncode == 2
        assert run.stdout == ""
        assert run.stderr.startswith("ekfslam: unknown dataset 'nowhere'")
        assert run.stderr.count("\n") == 1


# compare ----------------------------------------------------------------------------------------


def test_compare_shows_the_summary_dataset_by_dataset(command, small):
    shown = command("compare", small, "loop-15", "--seed", 3, "--estimators", "ekf,dead-reckoning")
    assert shown.status == 0
    assert shown.err == ""
    first, second = (shown.out.index(f"{name}, seed 3: ") for name in ("small", "loop-15"))
    assert first < second
    assert "small, seed 3: 13 poses, 60 observations, 5 landmarks" in shown.out
    table = shown.out[second:].splitlines()
    rows = [line.split() for line in table if line.strip()]
    assert ["ekf", "online", "ok"] in [row[:3] for row in rows]
    assert ["dead-reckoning", "online", "ok"] in [row[:3] for row in rows]
    data = ekfslam.simulate("loop-15", seed=3)
    summary = ekfslam.compare(data, "ekf").summary.iloc[0]
    shown_row = next(row for row in rows if row[0] == "ekf")
    assert float(shown_row[3]) == pytest.approx(summary["ate_position_rmse_m"], rel=6e-3)
    assert sorted(path.name for path in small.parent.iterdir()) == ["small.toml"]


def test_compare_writes_what_python_would(command, small):
    shown = command("compare", small, "--estimators", "ekf", "--out", "deep/out", "--no-figures")
    assert shown.status == 0
    out = small.parent / "deep" / "out"
    names = ["config.json", *(f"{name}.csv" for name in sorted(tables.SCHEMAS))]
    assert sorted(path.name for path in out.iterdir()) == sorted(names)
    assert all(name in shown.out for name in names)
    again = ekfslam.compare(str(small), "ekf")
    pd.testing.assert_frame_equal(
        tables.read_csv("trajectories", out / "trajectories.csv").drop(columns="time_step_s"),
        again.trajectories.drop(columns="time_step_s"),
    )


def test_compare_draws_into_the_folder(command, small):
    shown = command("compare", small, "--estimators", "ekf", "--out", "out")
    assert shown.status == 0
    for figure in ("map", "errors", "consistency", "times"):
        assert (small.parent / "out" / f"small-{figure}.png").stat().st_size
        assert (small.parent / "out" / f"small-{figure}.pdf").stat().st_size


def test_options_reach_the_comparison(command, small):
    words = ["--estimators", "dead-reckoning", "--align", "se2", "--rpe-distance", "1.5"]
    assert command("compare", small, *words, "--out", "out", "--no-figures").status == 0
    row = tables.read_csv("summary", small.parent / "out" / "summary.csv").iloc[0]
    assert row["alignment"] == "se2"
    assert '"rpe_distance_m": 1.5' in (small.parent / "out" / "config.json").read_text()


def cells(shown, name):
    """The words of the rows of an estimator, whose name may hold blanks."""
    return [
        line.split(name)[1].split() for line in shown.splitlines() if line.startswith(f" {name}  ")
    ]


def test_options_of_estimators_withheld_identities_and_who_was_taken_for_whom(command, small):
    variant = "ekf(association=joint, confirm=2)"
    estimators = f"ekf,{variant.replace(' ', '')}, dead-reckoning"
    words = ["--withhold-ids", "--match-radius", 0.25, "--out", "out", "--no-figures"]
    shown = command("compare", small, "--estimators", estimators, *words)
    assert shown.status == 0
    assert "who was taken for whom" in shown.out
    first, second = shown.out.split("who was taken for whom")
    assert cells(first, variant)[0][:2] == ["online", "ok"]
    headings = ["association", "precision", "recall", "in", "map", "missed", "spurious"]
    assert second.splitlines()[1].split()[1:8] == headings
    summary = tables.read_csv("summary", small.parent / "out" / "summary.csv")
    for name, method in (("ekf", "nearest"), (variant, "joint")):
        row = summary[summary["estimator"] == name].iloc[0]
        (written,) = cells(second, name)
        counts = [row[f"landmarks_{c}"] for c in ("estimated", "missed", "spurious", "duplicate")]
        scores = [row[f"association_{c}"] for c in ("precision", "recall")]
        assert written[0] == row["association"] == method
        assert [float(word) for word in written[1:3]] == pytest.approx(scores, abs=1e-4)
        assert [int(word) for word in written[3:7]] == counts
    assert not cells(second, "dead-reckoning")
    config = (small.parent / "out" / "config.json").read_text()
    assert '"match_radius_m": 0.25' in config
    assert '"ids_withheld": true' in config


def test_who_localizes_takes_somebody_for_somebody_too(command, small):
    words = ["--estimators", "ekf-localization,dead-reckoning", "--withhold-ids"]
    shown = command("compare", small, *words, "--out", "out", "--no-figures").out
    (written,) = cells(shown.split("who was taken for whom")[1], "ekf-localization")
    summary = tables.read_csv("summary", small.parent / "out" / "summary.csv")
    row = summary[summary["estimator"] == "ekf-localization"].iloc[0]
    scores = [row[f"association_{c}"] for c in ("precision", "recall")]
    assert written[0] == "nearest"
    assert [float(word) for word in written[1:]] == pytest.approx(scores, abs=1e-4)
    # Nobody knows whom it saw, and no map is estimated: there is nothing to tell.
    data = ekfslam.simulate(str(small)).without_identities()
    replace(data, true_landmark=None).save(small.parent / "recorded.npz")
    assert "who was taken" not in command("compare", "recorded.npz", *words[:2]).out


def test_nothing_is_said_of_identities_that_are_given(command, small):
    assert "who was taken" not in command("compare", small, "--estimators", "ekf").out


def test_landmarks_of_open_distance_are_counted(command, small):
    bearings = SMALL.replace('"range-bearing"', '"bearing"').replace('[0.1, "2 deg"]', '["9 deg"]')
    (small.parent / "bearings.toml").write_text(bearings + "min_range = 0.5\n")
    shown = command("compare", "bearings.toml", "--estimators", "ekf").out
    assert re.search(r"of open\s+estimator .* distance", shown.split("who was taken")[1])


def test_several_robots_have_rows_of_their_own(command):
    shown = command("compare", "team", "--estimators", "ekf,dead-reckoning").out
    assert re.search(r"team, seed 0: 301 poses, 4360 observations, 44 landmarks", shown)
    for name in ("ekf", "dead-reckoning"):
        rows = cells(shown, name)
        assert [row[:3] for row in rows] == [[r, "online", "ok"] for r in ("ada", "bob", "cid")]
        assert len({row[3] for row in rows}) == 3
    withheld = command("compare", "team", "--estimators", "ekf", "--withhold-ids").out
    rows = cells(withheld.split("who was taken")[1], "ekf")
    assert [row[:2] for row in rows] == [[r, "nearest"] for r in ("ada", "bob", "cid")]


def test_a_long_name_costs_no_number(command, small):
    name = "ekf(association=maximum-likelihood, confirm=2, within=7, accept=0.99, new=0.9999)"
    shown = command("compare", small, "--estimators", f"{name},gtsam-batch", "--withhold-ids")
    assert "…" not in shown.out
    assert len(cells(shown.out, name)) == 2
    assert max(map(len, shown.out.splitlines())) > 150


def test_options_of_a_recorded_set(command, folder):
    (folder / "graph.txt").write_text(
        "ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\nLANDMARK 1 5 2 1 0.4 0 0.4\n"
    )
    words = ["--data", "graph.txt", "--estimators", "dead-reckoning"]
    shown = command("compare", "victoria-park(noise=file)", "victoria-park", *words)
    assert "victoria-park(noise=file): 2 poses" in shown.out
    assert "victoria-park: 2 poses" in shown.out


def test_failures_are_rows_with_their_reason(command, small):
    (small.parent / "broken.py").write_text(
        "class Broken:\n    def estimate(self, dataset):\n"
        "        raise ValueError('a [red]word[/red]')\n"
    )
    shown = command("compare", small, "--estimators", "broken:Broken,ekf")
    assert shown.status == 0
    assert re.search(r"Broken +failed", shown.out)
    assert "Broken: ValueError: a [red]word[/red]" in shown.out
    assert re.search(r"ekf +online +ok", shown.out)


@pytest.mark.parametrize(
    "words", ["compare small.toml --estimators ekf,gtsam-batch", "check dead-reckoning"]
)
def test_a_narrow_terminal_shows_every_number(words, small):
    """Drawn at 80 columns as on a terminal, and nothing is cut off."""
    pty = pytest.importorskip("pty")
    here, there = pty.openpty()
    run = subprocess.Popen(
        [sys.executable, "-m", "ekfslam", *words.split()],
        cwd=small.parent,
        stdout=there,
        stderr=subprocess.DEVNULL,
        env={**PLAIN, "COLUMNS": "80"},
    )
    os.close(there)
    shown = b""
    try:
        while part := os.read(here, 65536):
            shown += part
    except OSError:
        pass  # the other end is closed
    os.close(here)
    assert run.wait() == 0
    text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.decode())
    assert words.split()[-1].rpartition(",")[2] in text
    assert "…" not in text


# simulate ---------------------------------------------------------------------------------------


def test_simulate_writes_a_dataset_that_compare_reads(command, small):
    shown = command("simulate", small, "--seed", 5, "--out", "run.npz", "--g2o", "run.g2o")
    assert shown.status == 0
    assert "13 poses, 60 observations" in shown.out
    assert "run.npz" in shown.out
    data = ekfslam.load("run.npz")
    drawn = ekfslam.simulate(str(small), seed=5)
    np.testing.assert_array_equal(data.observations.values, drawn.observations.values)
    assert (small.parent / "run.g2o").read_text().count("EDGE_SE2_XY") == 60
    assert "small, seed 5: 13 poses" in command("compare", "run.npz", "--estimators", "ekf").out


def test_simulate_scales_the_noise(command, small):
    command("simulate", small, "--noise", 0, "--out", "clean.npz")
    data = ekfslam.load("clean.npz")
    estimate = ekfslam.estimate(data, "dead-reckoning")
    np.testing.assert_allclose(estimate.online.poses, data.truth, atol=1e-12)


def test_simulate_scales_the_odometry_noise_alone(command, small):
    command("simulate", small, "--odometry-noise", 3, "--out", "rough.npz")
    rough, drawn = ekfslam.load("rough.npz"), ekfslam.simulate(str(small), odometry_noise=3.0)
    np.testing.assert_array_equal(rough.robot.controls, drawn.robot.controls)
    plain = ekfslam.simulate(str(small))
    assert rough.robot.motion.covariance == pytest.approx(9 * plain.robot.motion.covariance)
    assert rough.sensors[0].covariance == pytest.approx(plain.sensors[0].covariance)


# study ------------------------------------------------------------------------------------------


def test_the_study_of_association(command, folder):
    words = ["--methods", "joint, nearest", "--scales", "1,4.5", "--seeds", 2, "--confirm", 2]
    shown = command("study", "association", *words, "--within", 6, "--out", "deep/study")
    assert shown.status == 0
    assert shown.err == ""
    rows = [line.split() for line in shown.out.splitlines()]
    assert [row[:2] for row in rows if row[1:2] in (["joint"], ["nearest"])] == [
        ["1", "joint"],
        ["1", "nearest"],
        ["4.5", "joint"],
        ["4.5", "nearest"],
    ]
    summary = pd.read_csv(folder / "deep" / "study" / "summary.csv")
    joint = next(row for row in rows if row[:2] == ["4.5", "joint"])
    expected = summary[(summary["odometry_noise"] == 4.5) & (summary["method"] == "joint")].iloc[0]
    assert [float(joint[k]) for k in (2, 3, 4, 6, 7)] == pytest.approx(
        expected[["precision_mean", "recall_mean", "ate_m_mean", "ate_m_se", "ate_m_median"]],
        rel=0.05,
    )
    assert "joint minus nearest on the same draws" in shown.out
    assert "6 files in deep/study: association.pdf, association.png, config.json" in shown.out
    assert sorted(path.suffix for path in (folder / "deep" / "study").iterdir()) == [
        *([".csv"] * 3),
        *(".json", ".pdf", ".png"),
    ]
    runs = pd.read_csv(folder / "deep" / "study" / "runs.csv")
    assert set(runs["estimator"]) == {
        f"ekf(association={m}, confirm=2, within=6)" for m in ("joint", "nearest")
    }


# check ------------------------------------------------------------------------------------------


def test_check_shows_every_rung_and_passes(command):
    shown = command("check", "ekf")
    assert shown.status == 0
    lines = [line for line in shown.out.splitlines() if re.match(r" ?\d ", line)]
    assert [int(line.split()[0]) for line in lines] == [i for i in range(1, 8) for _ in range(2)]
    assert all((" pass " if line.split()[0] < "6" else " inconsistent ") in line for line in lines)
    for words in ("cloister", "loop-15", "<= 1e-09", ">= 1.7", "gaps "):
        assert words in shown.out
    assert shown.out.splitlines()[-1] == "passed"
    assert shown.out.splitlines()[-2].startswith("not consistent")


def test_check_fails_with_status_1(command, folder):
    (folder / "shaky.py").write_text(
        "from dataclasses import replace\nimport ekfslam\n"
        "from ekfslam.estimates import Trajectory\n"
        "class Shaky:\n    def estimate(self, dataset):\n"
        "        good = ekfslam.Ekf().estimate(dataset)\n"
        "        return replace(good, online=Trajectory(good.online.poses + 1e-6))\n"
    )
    shown = command("check", "shaky:Shaky")
    assert shown.status == 1
    assert shown.out.splitlines()[-1] == "FAILED"
    assert "fail " in shown.out
    assert "does not apply" in shown.out
    assert "linearizations(dataset)" in " ".join(shown.out.split())


# Mistakes ---------------------------------------------------------------------------------------


MISTAKES = {
    "a dataset that nobody knows": ("compare clojster", "did you mean cloister"),
    "an estimator that nobody knows": ("compare cloister --estimators efk", "did you mean ekf"),
    "a module that is not there": ("compare cloister --estimators no_module:X", "no_module"),
    "an attribute that is not there": ("compare cloister --estimators os:Absent", "Absent"),
    "something that is no estimator": ("compare cloister --estimators os:getcwd", "no estimator"),
    "no estimator": ("compare cloister --estimators ,", "nothing to compare"),
    "a missing dataset file": ("compare absent.npz", "absent.npz: no such file"),
    "a missing scenario file": ("compare absent.toml", "absent.toml: no such file"),
    "a damaged dataset file": ("compare garbage.npz", "garbage.npz: damaged"),
    "a cut dataset file": ("compare cut.npz", "cut.npz: damaged"),
    "nan in a dataset file": ("compare nan.npz", "nan.npz.*NaN"),
    "another record": ("compare estimate.npz", "estimate.npz: holds"),
    "a damaged scenario file": ("compare garbage.toml", "garbage.toml.*line 2"),
    "a scenario with nan": ("compare nan.toml", "nan.toml.*NaN"),
    "a misspelt key": ("compare misspelt.toml", "did you mean repeat"),
    "a folder": ("compare .", r"\.npz"),
    "another file": ("compare notes.txt", r"notes.txt.*\.npz"),
    "nothing": ("compare ''", "''|unknown"),
    "an alignment that nobody knows": ("compare cloister --align sim3", "alignment 'sim3'"),
    "no distance": ("compare cloister --rpe-distance 0", "rpe_distance"),
    "no number": ("compare cloister --rpe-distance nan", "rpe_distance"),
    "the same dataset twice": ("compare cloister cloister", "same name"),
    "the same estimator twice": ("compare cloister --estimators ekf,ekf", "two estimators"),
    "a path for a scenario": ("compare cloister --data .", "recorded"),
    "no recorded file": ("compare victoria-park --data absent", "absent"),
    "a damaged recorded file": ("compare victoria-park --data graph.txt", "graph.txt, line 2"),
    "an output that is a file": ("compare small.toml --out notes.txt", "notes.txt"),
    "an output below a file": ("compare small.toml --out notes.txt/out", "notes.txt"),
    "options that are none": ("compare cloister --estimators ekf(3)", "write option=value"),
    "an option without an end": ("compare cloister --estimators ekf(a=3", "do not match"),
    "an unknown option": ("compare cloister --estimators ekf(confrim=3)", "mean confirm"),
    "a method that is none": ("compare cloister --estimators ekf(association=x)", "must be one of"),
    "no radius": ("compare cloister --match-radius 0", "match_radius"),
    "an option of a set": ("compare victoria-park(noize=file)", "noize"),
    "a value of a set": ("compare victoria-park(odometry_sigmas=1)", "odometry_sigmas"),
    "a study that nobody knows": ("study assocation", "assocation"),
    "a method of no study": ("study association --methods jiont", "association must be one of"),
    "methods twice": ("study association --methods joint,joint", "given twice"),
    "scales that are none": ("study association --scales 1,x", "scales"),
    "a negative scale": ("study association --scales -1", "scales"),
    "no seeds": ("study association --seeds 0", "seeds"),
    "no workers": ("study association --workers 0", "workers"),
    "a study of a team": ("study association --scenario team", "several robots"),
    "a study of no world": ("study association --scenario orchart", "did you mean orchard"),
    "a study into a file": ("study association --out notes.txt", "notes.txt"),
    "negative odometry noise": (
        "simulate small.toml --odometry-noise -1 --out run.npz",
        "odometry_noise",
    ),
    "a negative seed": ("compare cloister --seed -1", "--seed"),
    "a seed that is no number": ("compare cloister --seed one", "--seed"),
    "an option that nobody knows": ("compare cloister --sed 1", "--sed"),
    "a command that nobody knows": ("compar cloister", "compar"),
    "nothing to check": ("check", "estimator"),
    "nobody to check": ("check efk", "did you mean ekf"),
    "no output": ("simulate small.toml", "--out"),
    "a scenario that nobody knows": ("simulate clojster --out run.npz", "did you mean cloister"),
    "an output in no folder": ("simulate small.toml --out absent/run.npz", "absent/run.npz"),
    "an output that compare could not read": ("simulate small.toml --out run.txt", r"\.npz"),
    "negative noise": ("simulate small.toml --noise -1 --out run.npz", "noise"),
    "noise that is no number": ("simulate small.toml --noise nan --out run.npz", "noise"),
    "what g2o cannot say": ("simulate loop-15 --out run.npz --g2o run.g2o", "singular"),
    "a graph in no folder": ("simulate small.toml --out run.npz --g2o absent/run.g2o", "absent"),
}


@pytest.fixture
def traps(small, folder):
    """Files with something wrong in each."""
    (folder / "notes.txt").write_text("precious\n")
    (folder / "garbage.npz").write_bytes(b"\x93garbage" * 40)
    (folder / "garbage.toml").write_text("[world]\nkind = \n")
    (folder / "nan.toml").write_text(SMALL.replace("[0.1, ", "[nan, "))
    (folder / "misspelt.toml").write_text(SMALL.replace("repeat", "repaet"))
    (folder / "graph.txt").write_text("ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\nLANDMARK 0 nan\n")
    data = ekfslam.simulate(str(small), seed=1)
    data.save(folder / "cut.npz")
    whole = (folder / "cut.npz").read_bytes()
    (folder / "cut.npz").write_bytes(whole[: len(whole) // 2])
    ekfslam.estimate(data, "dead-reckoning").save(folder / "estimate.npz")
    data.save(folder / "nan.npz")
    with np.load(folder / "nan.npz") as archive:
        arrays = dict(archive)
    arrays["observations.values"] = arrays["observations.values"] * np.nan
    np.savez(folder / "nan.npz", **arrays)
    return folder


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_and_leaves_nothing(mistake, command, traps):
    words, message = MISTAKES[mistake]
    before = {path: path.read_bytes() for path in traps.rglob("*") if path.is_file()}
    refused = command(*("" if word == "''" else word for word in words.split()))
    assert refused.status == 2
    assert refused.out == ""
    assert refused.err.startswith("ekfslam: ")
    assert refused.err.count("\n") == 1
    assert refused.err.endswith("\n")
    assert re.search(message, refused.err)
    assert {path: path.read_bytes() for path in traps.rglob("*") if path.is_file()} == before


def test_a_full_disk_is_one_line_too(command, small, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pd.DataFrame, "to_csv", full)
    refused = command("compare", small, "--estimators", "ekf", "--out", "out")
    assert refused.status == 2
    assert refused.err == "ekfslam: cannot write to out: No space left on device\n"
    monkeypatch.setattr(os, "replace", full)
    refused = command("simulate", small, "--out", "run.npz", "--g2o", "run.g2o")
    assert refused.status == 2
    assert refused.err.count("\n") == 1
    assert [path.name for path in small.parent.iterdir()] == ["small.toml"]


@pytest.mark.skipif(os.name != "posix", reason="permissions are those of POSIX")
def test_a_folder_without_permission(command, small, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_, **__: False)  # also true for an administrator
    refused = command("compare", small, "--estimators", "ekf", "--out", "out")
    assert (refused.status, refused.out) == (2, "")
    assert refused.err.count("\n") == 1


def test_an_interrupt_is_quiet_and_leaves_nothing(command, small, monkeypatch):
    (small.parent / "patient.py").write_text(
        "class Patient:\n    def estimate(self, dataset):\n        raise KeyboardInterrupt\n"
    )
    stopped = command("compare", small, "--estimators", "patient:Patient", "--out", "out")
    assert stopped.status == 130
    assert stopped.out == ""
    assert "Traceback" not in stopped.err
    assert not (small.parent / "out").exists()
    monkeypatch.setattr("ekfslam.plots.save", interrupted)
    assert command("compare", small, "--estimators", "ekf", "--out", "out").status == 130
    assert not (small.parent / "out").exists()


def interrupted(*_):
    raise KeyboardInterrupt
