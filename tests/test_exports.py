"""Runs for other programs: evo agrees with our errors, and a recording holds what is known when."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import ekfslam
from ekfslam.errors import InputError
from ekfslam.experiments.exports import export
from ekfslam.experiments.film import so_far
from ekfslam.export import write_rerun
from ekfslam.export.rerun_file import load_rerun
from ekfslam.moments import until


def run(*arguments, **environment):
    command = [sys.executable, "-m", "ekfslam", "export", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | environment
    )


# TUM --------------------------------------------------------------------------------------------


def test_evo_finds_the_errors_that_our_tables_state(tmp_path):
    """From the files of the command alone."""
    from evo.core import metrics, sync
    from evo.tools.file_interface import read_tum_trajectory_file

    done = run("cloister", "--seed", 3, "--estimators", "ekf,gtsam-isam2", "--tum", tmp_path / "t")
    assert done.returncode == 0, done.stderr
    names = ["ekf-online", "gtsam-isam2-online", "gtsam-isam2-smoothed", "truth"]
    files = sorted((tmp_path / "t").iterdir())
    assert [path.name for path in files] == [f"cloister-{name}.tum" for name in names]
    assert sorted(done.stdout.split()) == [str(path) for path in files]
    summary = ekfslam.compare("cloister", ["ekf", "gtsam-isam2"], seed=3).summary
    truth = read_tum_trajectory_file(str(tmp_path / "t" / "cloister-truth.tum"))
    for row in summary.itertuples():
        path = tmp_path / "t" / f"cloister-{row.estimator}-{row.series}.tum"
        pair = sync.associate_trajectories(truth, read_tum_trajectory_file(str(path)))
        error = metrics.APE(metrics.PoseRelation.translation_part)
        error.process_data(pair)
        rmse = error.get_statistic(metrics.StatisticsType.rmse)
        assert rmse == pytest.approx(row.ate_position_rmse_m, rel=1e-12)


def test_each_robot_of_a_team_has_its_own_files(tmp_path):
    team = until(ekfslam.simulate("team", seed=1), 20)
    written = export(team, ["ekf"], tum=tmp_path)
    expected = [
        f"team-{what}-{r.name}.tum" for r in team.robots for what in ("truth", "ekf-online")
    ]
    assert [path.name for path in written] == expected
    for robot in team.robots:
        rows = np.loadtxt(tmp_path / f"team-truth-{robot.name}.tum")
        assert_array_equal(rows[:, 1:3], robot.truth[:, :2])


def test_poses_that_are_not_known_have_no_line(tmp_path):
    data = until(ekfslam.simulate("cloister", seed=3), 10)
    truth = data.truth.copy()
    truth[[2, 5], 2] = np.nan
    partial = replace(data, robots=(replace(data.robot, truth=truth),))
    export(partial, ["dead-reckoning"], tum=tmp_path)
    times = np.loadtxt(tmp_path / "cloister-truth.tum")[:, 0]
    assert_array_equal(times, np.delete(data.times, [2, 5]))
    truth[:, 2] = np.nan
    without = replace(data, robots=(replace(data.robot, truth=truth),))
    written = export(without, ["dead-reckoning"], tum=tmp_path / "none")
    assert [path.name for path in written] == ["cloister-dead-reckoning-online.tum"]


# g2o --------------------------------------------------------------------------------------------


def test_a_graph_needs_no_estimator(tmp_path):
    done = run("cloister", "--seed", 3, "--g2o", tmp_path / "run.g2o", "--estimators", "nobody")
    assert done.returncode == 0, done.stderr
    ekfslam.load(tmp_path / "run.g2o")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "nothing to write: say where to by tum, g2o or rerun"),
        ({"g2o": "nowhere/run.g2o"}, "there is no folder nowhere"),
        ({"tum": "t", "every": 0}, "every must be a number of steps"),
    ],
)
def test_what_makes_no_sense_is_refused(options, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message):
        export("cloister", ["ekf"], **options)
    assert list(tmp_path.iterdir()) == []


class Silent:
    """Has nothing to say."""

    name = "silent"

    def estimate(self, dataset):
        raise ValueError("no luck")


def test_estimators_none_of_which_says_anything(tmp_path):
    with pytest.raises(InputError, match="silent failed: ValueError: no luck"):
        export(until(ekfslam.simulate("cloister", seed=3), 5), [Silent()], tum=tmp_path / "t")
    assert list(tmp_path.iterdir()) == []


def test_who_is_missing_in_the_files_is_told(tmp_path):
    """In the library by `tell`, of the command on standard error."""
    told = []
    short = until(ekfslam.simulate("cloister", seed=3), 5)
    export(short, [Silent(), "ekf"], tum=tmp_path / "t", tell=told.append)
    assert len(told) == 1
    assert told[0].startswith("silent failed: ValueError: no luck")
    done = run(
        "cloister",
        "--estimators",
        "ekf,test_exports:Silent",
        "--tum",
        tmp_path / "u",
        PYTHONPATH=os.pathsep.join([str(Path(__file__).parent), *sys.path]),
    )
    assert done.returncode == 0
    assert "Silent failed: ValueError: no luck" in done.stderr


# Rerun ------------------------------------------------------------------------------------------


def test_without_its_package_a_recording_is_refused_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError, match=r'pip install "ekfslam\[rerun\]"') as caught:
        export("cloister", ["ekf"], rerun=tmp_path / "run.rrd")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


class Stream:
    """Stands for a recording: keeps what is logged, and when."""

    made: ClassVar[list[Stream]] = []

    def __init__(self, application, recording_id):
        self.now, self.rows = {}, []
        Stream.made.append(self)

    def save(self, path):
        path.write_bytes(b"recording")

    def set_time(self, timeline, **at):
        self.now[timeline] = next(iter(at.values()))

    def log(self, place, what, static=False):
        place = place if isinstance(place, str) else "/".join(place)
        self.rows.append((None if static else self.now["step"], place, what))

    def flush(self):
        pass

    disconnect = flush


def kind(name):
    return lambda *values, **named: (name, *values, named)


@pytest.fixture
def rerun(monkeypatch):
    """The part of the package that is used."""
    module = ModuleType("rerun")
    module.RecordingStream = Stream
    module.ViewCoordinates = type("ViewCoordinates", (), {"RIGHT_HAND_Z_UP": "z up"})
    for name in ("Points3D", "LineStrips3D", "Arrows3D"):
        setattr(module, name, kind(name))
    monkeypatch.setitem(sys.modules, "rerun", module)
    Stream.made.clear()


@pytest.mark.usefixtures("rerun")
def test_a_recording_holds_at_each_step_what_is_known_at_it(tmp_path):
    data = until(ekfslam.simulate("cloister", seed=3), 30)
    steps = [10, 20, 30]
    found = so_far(data, ["ekf", "gtsam-batch"], steps)
    colors = {"ekf": "#0072B2", "gtsam-batch": "#009E73"}
    write_rerun(data, steps, found, tmp_path / "run.rrd", colors)
    assert [path.name for path in tmp_path.iterdir()] == ["run.rrd"]
    (stream,) = Stream.made
    logged = {(step, place): what for step, place, what in stream.rows}
    assert len(logged) == len(stream.rows)
    static = logged[None, "world/true landmarks"]
    assert_array_equal(static[1][:, :2], data.true_map.positions)
    for index, step in enumerate(steps):
        (truth,) = logged[step, "world/truth"][1]
        assert_array_equal(truth[:, :2], data.truth[: step + 1, :2])
        for name, color in (("ekf", [0, 0x72, 0xB2]), ("gtsam-batch", [0, 0x9E, 0x73])):
            estimate, place = found[name][index], f"world/{name}"
            poses = estimate.final_trajectory.poses
            _, (path,), look = logged[step, f"{place}/path"]
            assert_array_equal(path, np.column_stack([poses[:, :2], np.zeros(step + 1)]))
            assert look["colors"] == color
            arrow = logged[step, f"{place}/pose"][-1]
            assert_array_equal(arrow["origins"][0, :2], poses[-1, :2])
            assert np.arctan2(*arrow["vectors"][0, 1::-1]) == pytest.approx(poses[-1, 2])
            mapped = estimate.landmarks
            _, points, named = logged[step, f"{place}/landmarks"]
            assert_array_equal(points[:, :2], mapped.positions)
            assert named["labels"] == [str(each) for each in mapped.ids]
            contours = np.array(logged[step, f"{place}/landmark ellipses"][1])[..., :2]
            offset = contours - mapped.positions[:, None]
            weights = np.linalg.inv(mapped.covariances)
            squared = np.einsum("npi,nij,npj->np", offset, weights, offset)
            assert_allclose(np.sqrt(squared), 3.0, rtol=1e-6)
            seen = logged[step, f"{place}/seen"][1]
            assert len(seen) == (data.observations.step == step).sum()
            assert_allclose([line[0, :2] for line in seen], poses[-1:, :2].repeat(len(seen), 0))


@pytest.mark.usefixtures("rerun")
def test_the_export_asks_for_moments_with_the_colours_of_the_figures(tmp_path):
    from ekfslam.plots import look

    data = until(ekfslam.simulate("cloister", seed=3), 30)
    written = export(data, ["ekf"], rerun=tmp_path / "run.rrd", every=10)
    assert written == [tmp_path / "run.rrd"]
    steps = [step for step, place, _ in Stream.made[0].rows if place == "world/ekf/path"]
    assert steps == [10, 20, 30]
    color = next(
        w[-1]["colors"] for _, place, w in Stream.made[0].rows if place == "world/ekf/path"
    )
    assert "#{:02X}{:02X}{:02X}".format(*color) == look("ekf").color


def test_the_viewer_reads_a_recording(tmp_path):
    try:
        load_rerun()
    except InputError:
        pytest.skip('rerun is not installed: pip install "ekfslam[rerun]"')
    data = until(ekfslam.simulate("team", seed=1), 20)
    export(data, ["ekf", "dead-reckoning"], rerun=tmp_path / "run.rrd", every=5)
    verify = [sys.executable, "-m", "rerun", "rrd", "verify", str(tmp_path / "run.rrd")]
    done = subprocess.run(verify, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
