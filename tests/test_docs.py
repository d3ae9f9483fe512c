"""The pages: what they say runs, what they quote is a command, and their links lead somewhere."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

import pytest
from pages import (
    DATA,
    PAGES,
    ROOT,
    anchors,
    assert_shown,
    blocks,
    check_command,
    follow,
    links,
    perform,
    quoted_commands,
)

LANGUAGES = {"", "bibtex", "console", "csv", "python", "sh", "text", "toml"}
DIRECTIVES = {"{eval-rst}", "{toctree}"}
# Less of the same where a page takes its time.
SHORTER = {
    "README.md": {
        '["park", "victoria-park"], ["ekf"': '["park", "cloister"], ["ekf"',
        ', "results/many", workers=2': ', "results/many"',
        'save("results/mine")': 'save("results/mine", figures=False)',
    },
    "docs/pytest.md": {
        '"loop-15", ate_position': '"loop-15", 20, ate_position',
        'assert_consistent(FILTER, "loop-15")': 'assert_consistent(FILTER, "loop-15", 20)',
        "seeds=40": "seeds=10",
        '"loop-15", metric=': '"loop-15", seeds=20, metric=',
    },
    "docs/report.md": {"compare park victoria-park": "compare cloister --no-figures"},
    "docs/your_own_filter.md": {
        "seeds = 10\n": "seeds = 2\n",
        " --workers 2": " --no-figures",
        '["park", "cloister"], ["ekf", MyFilter]': '["cloister"], ["ekf", MyFilter]',
        'simulate("park", seed=1), MyFilter': 'simulate("cloister", seed=1), MyFilter',
    },
    "docs/partial.md": {
        "range(50)": "range(1)",
        "(16, 0.01), (16, 0.001), (32, 0.01), (32, 0.001)": "(4, 0.01),",
    },
    "docs/campaigns.md": {
        "seeds = 100  ": "seeds = 2  ",
        ' = ["1 deg", "10 deg"]': ' = ["1 deg"]',
        " --workers 2": " --no-figures",
        ", workers=2": "",
    },
    "docs/large-maps.md": {
        "(world.count=1000)": "(world.count=100)",
        "(world.count=5000, path.steps=10000)": "(world.count=100, path.steps=100)",
    },
}
# That of the example package is followed where the package is installed, by its own test.
FOLLOWED = [page for page in PAGES if blocks(PAGES[page]) and not page.startswith("examples")]
ON_DATA = sorted(
    {
        line
        for text in PAGES.values()
        for line in [
            *(line for block in blocks(text) if not block.reason for line in block.commands),
            *quoted_commands(text),
        ]
        if DATA in line and " study " not in line
    }
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder to work in; what its modules leave in the interpreter is taken back."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if Path(getattr(sys.modules[name], "__file__", None) or "").parent == tmp_path:
            del sys.modules[name]


# What is run -------------------------------------------------------------------------------------


def stored_results(text):
    """Results of the repository that the blocks of a page read."""
    said = "\n".join(block.text for block in blocks(text) if not block.reason)
    names = set(re.findall(r"(?<!--out )\bresults/([\w-]+)", said))
    made = set(re.findall(r"--out results/([\w-]+)", said))
    return [name for name in names - made if (ROOT / "results" / name / "config.json").exists()]


@pytest.mark.parametrize("page", FOLLOWED)
def test_what_a_page_says_runs(page, folder, run_command, capsys):
    """From top to bottom, in a folder with what the repository holds; campaigns have two seeds."""
    shutil.copytree(ROOT / "examples", folder / "examples")
    (folder / "experiments").mkdir()
    for path in (ROOT / "experiments").iterdir():
        text = re.sub("^seeds = .*", "seeds = 2", path.read_text("utf-8"), flags=re.MULTILINE)
        (folder / "experiments" / path.name).write_text(text, encoding="utf-8")
    for name in stored_results(PAGES[page]):
        shutil.copytree(ROOT / "results" / name, folder / "results" / name)
    follow(page, run_command, capsys, SHORTER.get(page))


def test_the_first_table_of_all_is_what_its_command_prints(folder, run_command):
    command = "ekfslam compare park victoria-park --seed 1"
    assert command in quoted_commands(PAGES["README.md"])
    (table,) = (block.text for block in blocks(PAGES["README.md"]) if not block.language)
    assert_shown(table, perform(command, run_command))


@pytest.mark.parametrize("line", ON_DATA)
def test_commands_on_recorded_data_run(line, folder, run_command, monkeypatch):
    """With few estimators, where the page names none."""
    if not os.environ.get("EKFSLAM_DATA"):
        pytest.skip("EKFSLAM_DATA names no folder")
    few = "" if "--estimators" in line else " --estimators dead-reckoning,ekf"
    where = os.environ["EKFSLAM_DATA"]
    if line.startswith("EKFSLAM_DATA"):
        line = line.partition(" ")[2]
    else:
        monkeypatch.delenv("EKFSLAM_DATA")
    shown = perform(f"{line.partition('#')[0].replace(DATA, where)}{few}", run_command)
    assert "ok" in shown.split()


# What is only looked at --------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES)
def test_blocks_are_of_a_known_kind_and_none_is_overlooked(page):
    found = blocks(PAGES[page])
    assert PAGES[page].count("```") == 2 * len(found)
    assert {block.language for block in found} <= LANGUAGES | DIRECTIVES


@pytest.mark.parametrize("page", PAGES)
def test_commands_have_the_form_that_they_must_have(page):
    """Also those that are not run, and those in the midst of a sentence."""
    for block in blocks(PAGES[page]):
        for line in block.commands:
            if line.startswith(("ekfslam", "make", "pip", "python", "EKFSLAM_DATA")):
                check_command(line)
    for command in quoted_commands(PAGES[page]):
        check_command(command, mention=True)


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    for link in links(PAGES[page]):
        path, _, anchor = link.partition("#")
        target = ((ROOT / page).parent / path).resolve() if path else ROOT / page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target.read_text(encoding="utf-8")), link


# The helpers themselves --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line",
    [
        "ekfslam compare park --estimator ekf",
        "ekfslam compare park --estimators ekg",
        "ekfslam comapre park",
        "ekfslam check",
        "ekfslam campaign experiments/none.toml --out results/none",
        "make tests",
        "pip install 'ekfslam[doc]'",
        "python benchmarks/walk.py",
        "cmake .",
    ],
)
def test_a_command_that_is_none_is_found(line):
    with pytest.raises(Exception):  # noqa: B017, PT011
        check_command(line)


def test_a_mention_may_be_short_but_not_wrong():
    check_command("ekfslam compare --out", mention=True)
    with pytest.raises(AssertionError):
        check_command("ekfslam compare --into", mention=True)


TABLE = """\
                ATE   sigma   time
  estimator     [m]   ratio    [s]
  ekf           0.3   0.996  {}
"""


def test_what_is_shown_is_held_to_two_percent_and_without_times():
    shown = TABLE.format("0.123") + "\nafter 3 runs\n"
    assert_shown(TABLE.format("4.567"), shown)
    assert_shown("after 3 runs", shown)
    for wrong in (TABLE.format("0.123").replace("0.3", "0.4"), "after 4 runs", "after 3 turns"):
        with pytest.raises(AssertionError):
            assert_shown(wrong, shown)
    with pytest.raises(AssertionError, match="ekf"):  # the order is that of the page
        assert_shown("after 3 runs\n\n" + TABLE.format("1"), shown)
