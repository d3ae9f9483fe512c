"""Films: what a picture shows is what was known at its step; files that others can play."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex, to_rgb
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import ekfslam
from ekfslam.errors import InputError
from ekfslam.estimates import FAILED, Trajectory
from ekfslam.experiments.film import animate, pictured, so_far
from ekfslam.moments import until
from ekfslam.plots import look
from ekfslam.plots.animation import Film, _palette, _Stage, save_film
from ekfslam.plots.style import TRUTH

STEPS = [10, 60, 140]


@pytest.fixture(scope="module")
def data():
    return ekfslam.simulate("cloister", seed=3)


@pytest.fixture(scope="module")
def film(data):
    part = until(data, STEPS[-1])
    return Film(part, STEPS, so_far(part, ["ekf", "gtsam-batch", "dead-reckoning"], STEPS))


def lines(stage, color):
    return [a for a in stage._axes.lines if to_hex(a.get_color()) == to_hex(color)]


def ellipses(stage, name):
    color = to_hex(look(name).color)
    drawn = [c for c in stage._axes.collections if isinstance(c, LineCollection)]
    own = [c for c in drawn if to_hex(c.get_edgecolor()[0]) == color and c.get_alpha() is None]
    return np.concatenate([np.stack(c.get_segments()) for c in own])


@pytest.mark.parametrize("index", [2, 0, 1])
def test_a_picture_shows_what_is_known_at_its_step(film, index):
    stage = _Stage(film, 300)
    for each in (2, index):  # what was shown before is gone
        stage.show(each)
    step = STEPS[index]
    assert f"step {step} of 140" in stage.figure.get_suptitle()
    (truth,) = lines(stage, TRUTH)
    assert_array_equal(truth.get_xydata(), film.dataset.truth[: step + 1, :2])
    for name, estimates in film.estimates.items():
        estimate = estimates[index]
        (path, *_) = [a for a in lines(stage, look(name).color) if a.get_linestyle() != "None"]
        assert_array_equal(path.get_xydata(), estimate.final_trajectory.poses[:, :2])
        assert len(path.get_xdata()) == step + 1
        mapped = estimate.landmarks
        means = estimate.final_trajectory.poses[-1:, :2]
        matrices = estimate.final_trajectory.covariances[-1:, :2, :2]
        if mapped is not None:
            means = np.concatenate([means, mapped.positions])
            matrices = np.concatenate([matrices, mapped.covariances])
        offset = ellipses(stage, name) - means[:, None]
        squared = np.einsum("npi,nij,npj->np", offset, np.linalg.inv(matrices), offset)
        assert_allclose(np.sqrt(squared), 3.0, rtol=1e-6)


def test_measurements_are_those_of_the_step_from_the_pose_of_the_first(film):
    stage = _Stage(film, 300)
    stage.show(1)
    (sights,) = [c for c in stage._axes.collections if c.get_alpha() is not None]
    assert to_hex(sights.get_edgecolor()[0]) == to_hex(look("ekf").color)
    assert len(sights.get_segments()) == (film.dataset.observations.step == 60).sum()
    pose = film.estimates["ekf"][1].online.poses[60]
    for start, _ in sights.get_segments():
        assert_allclose(start, pose[:2], atol=1e-12)


def test_measurements_that_come_seldom_are_not_missed(data):
    """Those of the newest step that has any since the picture before."""
    rows = data.observations.step <= 7
    seldom = until(data, 7)
    observations = seldom.observations
    longer = ekfslam.simulate("cloister", seed=3)
    columns = {f.name: getattr(longer.observations, f.name) for f in fields(observations)}
    cut = {k: v[rows] if isinstance(v, np.ndarray) else v for k, v in columns.items()}
    quiet = replace(
        longer,
        observations=replace(longer.observations, **cut),
        true_landmark=None if longer.true_landmark is None else longer.true_landmark[rows],
    )
    shown = Film(quiet, [10, 20], so_far(quiet, ["ekf"], [10, 20]))
    stage = _Stage(shown, 300)
    for index, expected in ((0, (observations.step == 7).sum()), (1, 0)):
        stage.show(index)
        sights = [c for c in stage._axes.collections if c.get_alpha() is not None]
        assert sum(len(c.get_segments()) for c in sights) == expected


def test_a_gif_has_a_picture_for_each_step(film, tmp_path):
    path = save_film(film, tmp_path / "run.gif", fps=10, width=301)
    with Image.open(path) as gif:
        assert gif.n_frames == len(STEPS)
        assert gif.size[0] % 2 == gif.size[1] % 2 == 0
        assert gif.info["loop"] == 0
        durations, pictures = [], []
        for index in range(gif.n_frames):
            gif.seek(index)
            durations.append(gif.info["duration"])
            pictures.append(np.asarray(gif.convert("RGB"), dtype=int))
    assert durations == [100, 100, 2000]
    expected = _Stage(film, 301)
    for index, picture in enumerate(pictures):
        whole = np.asarray(expected.picture(index), dtype=int)
        assert np.abs(picture - whole).mean() < 2  # of 255: the palette has 128 colours
    for color in (look("gtsam-batch").color, TRUTH):
        away = np.abs(pictures[-1] - 255 * np.array(to_rgb(color))).max(axis=2)
        assert (away < 40).sum() > 20
    assert path.stat().st_size < 200_000
    again = save_film(film, tmp_path / "again.gif", fps=10, width=301)
    assert again.read_bytes() == path.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["again.gif", "run.gif"]


def drifting(film):
    """The film with one who goes away, and with one of whom there is nothing."""
    run = film.estimates["dead-reckoning"]
    far = [
        replace(each, online=Trajectory(each.online.poses + np.array([500.0, 0.0, 0.0])))
        for each in run
    ]
    nothing = [replace(each, online=None, status=FAILED) for each in run]
    return film._replace(estimates={**film.estimates, "mine": far, "broken": nothing})


def test_the_legend_of_a_film_says_who_is_not_in_its_pictures(film):
    words = [
        t.get_text().replace("\n", " ") for t in _Stage(drifting(film), 300).figure.legends[0].texts
    ]
    assert "mine (online), leaves the frame" in words
    assert "broken (failed)" in words
    assert sum("leaves" in word for word in words) == 1


def test_the_palette_of_a_gif_has_the_colour_of_each_estimator(film):
    """Also of one whose only line is in the legend."""
    stage = _Stage(drifting(film), 300)
    values = _palette(stage.picture(2), stage.colors).getpalette()
    assert len(values) <= 3 * 128
    found = set(zip(values[::3], values[1::3], values[2::3], strict=True))
    assert (255, 255, 255) in found
    assert len(stage.colors) == 5
    for color in stage.colors:
        assert tuple(round(255 * value) for value in to_rgb(color)) in found


def test_the_axes_of_a_film_fill_it(film):
    figure = _Stage(film, 600).figure
    (axes,) = figure.axes
    title, frame = figure._suptitle.get_window_extent(), axes.get_window_extent()
    assert 0 < title.y0 - frame.y1 < 0.2 * figure.dpi


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no ffmpeg")
def test_an_mp4_plays(film, tmp_path):
    path = save_film(film, tmp_path / "run.mp4", fps=10, width=300)
    probe = ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json", str(path)]
    told = subprocess.run(probe, capture_output=True, text=True, check=True)
    (stream,) = json.loads(told.stdout)["streams"]
    assert stream["codec_name"] == "h264"
    assert stream["width"] == 300
    assert int(stream["nb_read_frames"]) == len(STEPS) + 20  # the last one stays for two seconds
    assert list(tmp_path.iterdir()) == [path]


def test_without_ffmpeg_an_mp4_says_so_before_anything_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda _: False))
    with pytest.raises(InputError, match=r"needs ffmpeg.*install.*or write a \.gif") as caught:
        animate("cloister", [Broken()], tmp_path / "run.mp4")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


class Broken:
    """Fails; counts how often it was asked."""

    name = "broken"

    def __init__(self):
        self.calls = 0

    def estimate(self, dataset):
        self.calls += 1
        raise ValueError("no luck")


def test_who_fails_on_the_whole_run_is_asked_once_and_the_others_are_shown(data, tmp_path):
    broken = Broken()
    found = so_far(until(data, 20), [broken, "ekf"], [5, 10, 20])
    assert broken.calls == 1
    assert [each.status for each in found["broken"]] == [FAILED] * 3
    path = save_film(Film(until(data, 20), [5, 10, 20], found), tmp_path / "run.gif", width=200)
    with Image.open(path) as gif:
        assert gif.n_frames == 3
    with pytest.raises(InputError, match="broken failed: ValueError: no luck"):
        animate(until(data, 20), [broken], tmp_path / "none.gif")
    told = []
    animate(
        until(data, 5), [broken, "ekf"], tmp_path / "two.gif", every=5, width=200, tell=told.append
    )
    assert len(told) == 1
    assert told[0].startswith("broken failed: ValueError: no luck")


def test_the_last_step_is_always_among_the_pictures():
    assert pictured(11, 3) == [1, 4, 7, 10]
    assert pictured(2, 5) == [1]
    assert pictured(1, 5) == [0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"path": "run.avi"}, "ends in .gif or .mp4"),
        ({"path": "nowhere/run.gif"}, "no folder nowhere"),
        ({"fps": 0}, "fps must be"),
        ({"fps": 2.5}, "fps must be"),
        ({"width": 10}, "width must be"),
        ({"every": 0}, "every must be"),
        ({"seconds": -1.0}, "seconds must be"),
        ({"seconds": 3.0, "every": 2}, "either every so many steps"),
    ],
)
def test_a_film_that_makes_no_sense_is_refused(options, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    broken = Broken()
    with pytest.raises(InputError, match=message):
        animate("cloister", [broken], **({"path": "run.gif"} | options))
    assert broken.calls == 0


def test_the_command_writes_a_film(tmp_path):
    command = [sys.executable, "-m", "ekfslam", "animate", "cloister", "--every", "100"]
    command += ["--width", "200", "--out", str(tmp_path / "run.gif")]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith(str(tmp_path / "run.gif"))
    with Image.open(tmp_path / "run.gif") as gif:
        assert gif.n_frames == 2


def test_robots_of_a_team_and_runs_without_a_truth(tmp_path):
    team = until(ekfslam.simulate("team", seed=1), 30)
    path = animate(team, "ekf", tmp_path / "team.gif", every=15, width=200)
    with Image.open(path) as gif:
        assert gif.n_frames == 2
    park = until(ekfslam.load("victoria-park"), 60)
    path = animate(park, ["ekf"], tmp_path / "park.gif", every=30, width=200)
    with Image.open(path) as gif:
        assert gif.n_frames == 2
