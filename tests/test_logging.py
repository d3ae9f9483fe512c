"""What the library tells those who listen, and that it tells nobody else."""

from __future__ import annotations

import ast
import logging
import subprocess
import sys
from pathlib import Path

import pytest
from test_cli import PLAIN, SMALL

import ekfslam

ROOT = Path(__file__).parents[1]
MODULES = [
    path
    for folder in ("ekfslam", "baselines")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if "cli" not in path.parts
]


class Raises:
    """An estimator that does not."""

    name = "raises"

    def estimate(self, dataset):
        """Raise."""
        raise ValueError("too far")


def outspoken(text):
    """Lines of a module that print, warn, write to standard streams, or log to the root."""
    lines = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            if called in ("print", "warn", "warnings.warn", "logging.basicConfig"):
                lines.append(node.lineno)
            if called in {f"logging.{level}" for level in ("debug", "info", "warning", "error")}:
                lines.append(node.lineno)
        if isinstance(node, ast.Attribute) and ast.unparse(node) in ("sys.stdout", "sys.stderr"):
            lines.append(node.lineno)
    return lines


def test_only_the_command_prints():
    assert len(MODULES) > 100
    found = {str(path.relative_to(ROOT)): outspoken(path.read_text()) for path in MODULES}
    assert {name: lines for name, lines in found.items() if lines} == {}
    text = "import sys\nprint(1)\nsys.stderr.write('')\nlogging.info('x')\nwarnings.warn('x')\n"
    assert sorted(outspoken(text)) == [2, 3, 4, 5]


def test_estimates_are_told_of(caplog):
    data = ekfslam.simulate("loop-15")
    with caplog.at_level(logging.INFO, "ekfslam"):
        ekfslam.compare(data, ["dead-reckoning", Raises()])
    said = {record.levelname: record.getMessage() for record in caplog.records}
    assert said["INFO"].startswith("loop-15: dead-reckoning: ok after ")
    assert said["WARNING"].startswith("loop-15: raises: failed: ValueError: too far (test_logging")
    assert not any(record.exc_info for record in caplog.records)
    caplog.clear()
    with caplog.at_level(logging.DEBUG, "ekfslam"):
        ekfslam.compare(data, [Raises()])
    assert "in estimate" in caplog.text
    assert 'raise ValueError("too far")' in caplog.text


def test_a_campaign_is_told_of_unless_somebody_else_is(caplog, tmp_path):
    campaign = {
        "name": "tiny",
        "seeds": 1,
        "estimators": ["dead-reckoning"],
        "scenarios": [{"name": "loop-15", "set": {"path.repeat": 4}}],
    }
    ekfslam.run_campaign(campaign, tmp_path)
    with caplog.at_level(logging.INFO, "ekfslam"):
        ekfslam.run_campaign(campaign, tmp_path)
        assert "1 of 1 cells are there already" in caplog.messages
        caplog.clear()
        told: list[str] = []
        ekfslam.run_campaign(campaign, tmp_path, tell=told.append)
    assert told == ["1 of 1 cells are there already"]
    assert not any("there already" in words for words in caplog.messages)


def test_nobody_listens_and_nothing_is_heard():
    script = (
        "import ekfslam\n"
        "class Raises:\n    def estimate(self, dataset):\n        raise ValueError\n"
        "found = ekfslam.compare('loop-15', ['dead-reckoning', Raises()])\n"
        "assert 'failed' in set(found.summary['status'])"
    )
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, check=True
    )
    assert (run.stdout, run.stderr) == ("", "")


@pytest.mark.parametrize(("option", "lines"), [("", 0), ("-v", 2), ("-vv", 2)])
def test_the_command_shows_the_log(option, lines, tmp_path):
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "mine.py").write_text(
        "class Raises:\n    def estimate(self, dataset):\n        raise ValueError('no')\n"
    )
    words = [*filter(None, [option]), "compare", "small.toml"]
    run = subprocess.run(
        [sys.executable, "-m", "ekfslam", *words, "--estimators", "dead-reckoning,mine:Raises"],
        cwd=tmp_path,
        env=PLAIN,
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stderr.count("ekfslam.experiments.attempts: ") == lines
    assert ("Traceback" in run.stderr) == (option == "-vv")
    assert "Raises: ValueError: no" in run.stdout


def test_after_a_command_the_log_is_as_it_was(run_command):
    logger = logging.getLogger("ekfslam")
    before = list(logger.handlers), logger.level
    for status, name in ((0, "loop-15"), (2, "nowhere")):
        shown = run_command("-v", "compare", name, "--estimators", "dead-reckoning")
        assert shown.status == status
        assert shown.err.count("dead-reckoning: ok after") == (status == 0)
        assert (list(logger.handlers), logger.level) == before
