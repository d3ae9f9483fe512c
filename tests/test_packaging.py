"""Wheel and sdist: what is in them, and that the wheel works where the sources are not."""

from __future__ import annotations

import ast
import email
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
from importlib import import_module
from pathlib import Path
from zipfile import ZipFile

import pytest

import ekfslam

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with the wheel and the sdist."""
    pytest.importorskip("hatchling", reason="what builds the package is not installed")
    folder = tmp_path_factory.mktemp("dist")
    words = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(words, cwd=ROOT, capture_output=True, check=True)
    return folder


def the(folder, pattern):
    (path,) = folder.glob(pattern)
    return path


def test_the_wheel_has_all_modules_and_data_and_nothing_else(built):
    names = ZipFile(the(built, "*.whl")).namelist()
    kinds = {".py", ".toml", ".html", ".css", ".js", ".typed"}
    wanted = {
        str(path.relative_to(ROOT))
        for package in ("ekfslam", "baselines")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    found = {name for name in names if ".dist-info/" not in name}
    assert found == {name.replace(os.sep, "/") for name in wanted}
    assert {Path(name).suffix for name in found} == kinds
    for name in (
        "ekfslam/py.typed",
        "baselines/py.typed",
        "ekfslam/simulation/scenarios/park.toml",
        "ekfslam/report/page.html",
        "ekfslam/testing/plugin.py",
    ):
        assert name in found


def test_the_wheel_says_what_it_is(built):
    wheel = ZipFile(the(built, "*.whl"))
    info = f"ekfslam-{ekfslam.__version__}.dist-info"
    told = email.message_from_bytes(wheel.read(f"{info}/METADATA"))
    assert (told["Name"], told["Version"]) == ("ekfslam", ekfslam.__version__)
    assert told["License-Expression"] == PROJECT["license"]
    assert f"{info}/licenses/LICENSE" in wheel.namelist()
    points = wheel.read(f"{info}/entry_points.txt").decode()
    for group in ("console_scripts", "ekfslam.estimators", "ekfslam.oracles", "pytest11"):
        assert f"[{group}]" in points


def test_the_sdist_has_what_it_takes_and_no_junk(built):
    with tarfile.open(the(built, "*.tar.gz")) as archive:
        members = archive.getmembers()
    names = {member.name.partition("/")[2] for member in members}
    tops = {name.partition("/")[0] for name in names}
    assert tops >= {"ekfslam", "baselines", "tests", "docs", "examples", "experiments", "results"}
    assert tops >= {"README.md", "LICENSE", "CITATION.cff", "CHANGELOG.md", "pyproject.toml"}
    assert not tops & {".venv", ".ci", ".git", "dist", "build"}
    junk = [n for n in names if re.search(r"__pycache__|\.pyc$|_cache/|\.npz$|checkpoints", n)]
    assert junk == []
    assert sum(member.size for member in members) < 20e6


def test_the_citation_is_that_of_the_readme():
    cited = (ROOT / "CITATION.cff").read_text()
    bibtex = (ROOT / "README.md").read_text().partition("```bibtex")[2].partition("```")[0]
    title = re.search(r"title += \{(.*)\}", bibtex)[1]
    assert f'title: "{title}"' in cited
    assert f"name: {re.search(r'author += .{2}(.*?)}', bibtex)[1]}" in cited
    assert f"Version {ekfslam.__version__}" in bibtex
    assert f"version: {ekfslam.__version__}\n" in cited
    assert f"license: {PROJECT['license']}\n" in cited
    released = re.search(r'date-released: "(\d{4})-\d\d-\d\d"', cited)[1]
    assert f"year   = {{{released}}}" in bibtex


def test_python_versions_agree():
    tried = [c.rpartition(" ")[2] for c in PROJECT["classifiers"] if "Python :: 3." in c]
    assert PROJECT["requires-python"] == f">={tried[0]}"


# Installed --------------------------------------------------------------------------------------

USE = """
import sys
from pathlib import Path
import baselines, ekfslam
for package in (ekfslam, baselines):
    assert Path(sys.prefix) in Path(package.__file__).parents, package.__file__
"""
TEST = """
from ekfslam.testing import assert_accuracy

def test_the_plugin_is_there(pytestconfig):
    assert pytestconfig.pluginmanager.has_plugin("ekfslam")

def test_accuracy():
    assert_accuracy("dead-reckoning", "loop-15", seeds=8, ate_position_rmse_m=5.0)
"""
SCRIPT = """
import numpy as np
import ekfslam
from baselines.batch import GtsamBatch

data: ekfslam.Dataset = ekfslam.simulate("park", seed=7)
estimate: ekfslam.Estimate = ekfslam.estimate(data, GtsamBatch())
assert estimate.online is not None
poses: np.ndarray = estimate.online.poses
wrong: int = ekfslam.compare(data, "ekf").summary
GtsamBatch(no_such_option=1)
"""


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """A new environment with the wheel; what it depends on is taken from this one."""
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder / "venv", with_pip=False)
    (packages,) = (folder / "venv").rglob("site-packages")
    python = folder / "venv" / "bin" / "python"
    if not python.exists():
        pytest.skip("environments are laid out otherwise here")
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet"]
    words = ["--no-deps", "--no-index", "--disable-pip-version-check", the(built, "*.whl")]
    subprocess.run([*pip, *map(str, words)], capture_output=True, check=True)
    # Links to sources are not followed from a path that is added so.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (folder / "use.py").write_text(USE)
    (folder / "test_mine.py").write_text(TEST)
    return folder


def run(installed, *words):
    """Run a program of the environment, where the sources are not."""
    keep = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL", "COV"))}
    return subprocess.run(
        [installed / "venv" / "bin" / words[0], *words[1:]],
        cwd=installed,
        env=keep,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "words",
    [
        "python use.py",
        "ekfslam --version",
        "ekfslam compare loop-15 victoria-park --estimators dead-reckoning --out out",
        "ekfslam report out",
        "ekfslam check dead-reckoning",
        "python -m pytest -q -p no:cacheprovider test_mine.py",
    ],
)
def test_the_wheel_works_where_the_sources_are_not(installed, words):
    done = run(installed, *words.split())
    assert done.returncode == 0, done.stdout + done.stderr
    assert str(ROOT) not in done.stdout + done.stderr


def test_type_checkers_see_the_names_that_the_package_offers():
    tree = ast.parse((ROOT / "ekfslam" / "__init__.py").read_text())
    block = next(node for node in tree.body if isinstance(node, ast.If))
    shown = {
        alias.asname: f"{node.module}.{alias.name}"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.asname
    }
    assert {*shown, "estimate", "load"} == set(ekfslam.__all__)
    for name, place in shown.items():
        module, _, attribute = place.rpartition(".")
        assert getattr(import_module(module), attribute) is getattr(ekfslam, name)


def test_types_are_shipped(installed):
    (installed / "script.py").write_text(SCRIPT)
    python = installed / "venv" / "bin" / "python"
    words = ["--python-executable", str(python), "--no-incremental", "script.py"]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--no-error-summary", *words],
        cwd=installed,
        capture_output=True,
        text=True,
        check=False,
    )
    errors = [line for line in done.stdout.splitlines() if ": error: " in line]
    assert [re.search(r"\[([\w-]+)\]$", line)[1] for line in errors] == ["assignment", "call-arg"]
    assert [int(line.split(":")[1]) for line in errors] == [10, 11]
