"""The page on one's own filter: all of it runs in order, and the filter in it is right."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from textbook import TextbookEkf

import ekfslam
from ekfslam.simulation import simulate

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "your_own_filter.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+) ?(\S*)\n(.*?)^```$", PAGE, flags=re.M | re.S)
FILES = {file: text for _, file, text in BLOCKS if file}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder to work in; what its modules leave in the interpreter is taken back."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if Path(getattr(sys.modules[name], "__file__", None) or "").parent == tmp_path:
            del sys.modules[name]


@pytest.fixture
def mine(folder):
    """The filter of the page."""
    names = {"__name__": "my_filter"}
    exec(compile(FILES["my_filter.py"], "my_filter.py", "exec"), names)
    return names["MyFilter"]


def assert_as_printed(text, shown):
    """The lines of the page are there, to their last digit but one, and for the times at their end.

    Rounding to what is printed differs where the numbers do, which depend on libraries a little.
    """
    lines = [line.split() for line in shown.splitlines()]
    for line in text.splitlines():
        *words, _, _ = line.split()
        (match,) = [other for other in lines if other[:2] == words[:2]]
        for word, other in zip(words, match, strict=False):
            number = re.fullmatch(r"[\d.]+", word)
            assert float(other) == pytest.approx(float(word), rel=0.02) if number else other == word


def test_it_runs_in_order(folder, run_command, monkeypatch, capsys):
    """Files are written, Python runs in one namespace, and what commands print is as it says."""
    monkeypatch.setenv("COLUMNS", "200")
    names, shown, commands = {"__name__": "page"}, "", []
    for language, file, text in BLOCKS:
        if file:
            Path(file).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(compile(text, "your_own_filter.md", "exec"), names)
            shown = capsys.readouterr().out
        elif language == "sh":
            for program, *words in map(shlex.split, text.splitlines()):
                assert program == "ekfslam"
                run = run_command(*words)
                assert run.status == 0, run.out + run.err
                shown = run.out
                commands.append(words[0])
        else:
            assert_as_printed(text, shown)
    assert {"check", "compare", "campaign"} <= set(commands)
    assert "MyFilter" in names["comparison"].summary["estimator"].tolist()


def test_links_lead_to_files():
    links = re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", PAGE)
    assert links
    assert [link for link in links if not (DOCS / link).exists()] == []


@pytest.mark.parametrize("scenario", ["cloister", "loop-15-rb"])
def test_the_filter_is_right(mine, scenario):
    """As another one that shares no line with it, and as the compiled one."""
    dataset = simulate(scenario, seed=2)
    found = ekfslam.estimate(dataset, mine)
    expected = TextbookEkf(update="sequential").estimate(dataset)
    close = {"rtol": 0, "atol": 1e-10}
    np.testing.assert_allclose(found.online.poses, expected.online.poses, **close)
    np.testing.assert_allclose(found.online.covariances, expected.online.covariances, **close)
    np.testing.assert_array_equal(found.landmarks.ids, expected.landmarks.ids)
    np.testing.assert_allclose(found.landmarks.positions, expected.landmarks.positions, **close)
    np.testing.assert_allclose(found.joint_covariance, expected.joint_covariance, **close)
    compiled = ekfslam.estimate(dataset, "ekf", update="sequential")
    np.testing.assert_array_equal(found.innovations.decision, compiled.innovations.decision)
    np.testing.assert_array_equal(found.step_dof, compiled.step_dof)
    np.testing.assert_allclose(found.step_nis, compiled.step_nis, rtol=1e-8)


def test_it_says_what_it_is_not_for(mine):
    table = ekfslam.compare(["loop-15", "two-sensors"], [mine]).summary
    assert table["status"].tolist() == ["skipped"] * 2
    assert table["message"][0].startswith("MyFilter is for range-bearing, but ")
