"""Pages as a reader takes them: their blocks in order, their commands, their links.

A block is told by its fence. What follows the language is the name of a file that the block is
saved as; ``text`` is what the block before it prints. A block that would take too long stands
below a comment that says so, ``<!-- not run: an hour on two cores -->``.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tomllib
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import pytest
import typer

from ekfslam.cli import app
from ekfslam.registry import resolve, split

ROOT = Path(__file__).parents[1]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in sorted(
        [*ROOT.glob("*.md"), *ROOT.glob("examples/*/*.md"), *ROOT.glob("docs/**/*.md")]
    )
    if "_build" not in path.parts
}
FENCE = re.compile(
    r"^(?:<!-- not run: (?P<reason>[^\n]*) -->\n+)?```(?P<language>\S*) ?(?P<file>\S*)\n"
    r"(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
DATA = "FOLDER"  # stands for the folder of the recorded sets
EXAMPLE = "mean-map"  # joins with the example package, which is not installed here
SHELL = set("|>;&$")


class Block(NamedTuple):
    """What stands between two fences."""

    language: str
    file: str
    text: str
    line: int
    reason: str

    @property
    def commands(self) -> list[str]:
        """The lines of a shell, joined where they go on."""
        if self.language not in ("sh", "console") or self.file:
            return []
        lines = self.text.replace("\\\n", " ").splitlines()
        if self.language == "console":  # the other lines are what is shown
            lines = [line[2:] for line in lines if line.startswith("$ ")]
        return [line for line in lines if line.partition("#")[0].strip()]


def blocks(text: str) -> list[Block]:
    found = []
    for match in FENCE.finditer(text):
        line = text.count("\n", 0, match.start("text"))
        parts = match.group("language", "file", "text")
        found.append(Block(*parts, line, match["reason"] or ""))
    return found


def prose(text: str) -> str:
    """A page without its blocks and comments."""
    return re.sub(r"<!--.*?-->", "", FENCE.sub("", text), flags=re.DOTALL)


def quoted_commands(text: str) -> list[str]:
    """Commands in backticks."""
    found = re.findall(r"(?<!`)`((?:ekfslam|make|pip|python) [^`]+)`(?!`)", prose(text))
    return [" ".join(command.split()) for command in found]


def links(text: str) -> list[str]:
    """Where the links and pictures of a page lead, if not out into the net."""
    found = re.findall(r"\]\(([^)\s]+)\)", prose(text))
    return [link for link in found if not re.match(r"[a-z]+:", link)]


def anchors(text: str) -> set[str]:
    """The headings of a page, as a code host makes anchors of them."""
    titles = re.findall(r"^#+ (.*)$", FENCE.sub("", text), flags=re.MULTILINE)
    titles = [re.sub(r"\[(.*?)\]\(.*?\)", r"\1", title).lower() for title in titles]
    return {re.sub(r"[^\w\- ]", "", title).strip().replace(" ", "-") for title in titles}


# Commands that are not run -----------------------------------------------------------------------


def check_command(line: str, mention: bool = False) -> None:
    """A command has the form that it must have, and what it names is there.

    A mention may leave out what a command needs, as in "`ekfslam compare --out`".
    """
    words = [word for word in shlex.split(line, comments=True) if not re.match(r"[A-Z_]+=", word)]
    program, *words = takewhile(lambda word: word not in ("|", ">"), words)
    check = {
        "ekfslam": _check_ekfslam,
        "make": _check_make,
        "pip": _check_pip,
        "python": _check_python,
        "python3": _check_python,
    }
    assert program in check, f"nothing is known of {line!r}"
    if program == "ekfslam":
        _check_ekfslam(words, mention)
    else:
        check[program](words)


def _check_ekfslam(words, mention=False):
    command, context = typer.main.get_command(app), None
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        command = command.commands[words.pop(0)]
    if mention and all(word.startswith("-") for word in words):
        known = {name for each in command.params for name in each.opts + each.secondary_opts}
        assert set(words) <= known | {"--help", "-h"}, f"{words} of {command.name}"
        return
    context = command.make_context(command.name, list(words), resilient_parsing=False)
    for name in split(context.params.get("estimators") or ""):
        if ":" not in name and not name.startswith(EXAMPLE):
            resolve(name)
    for word in words:
        if word.startswith("experiments/"):
            assert (ROOT / word).exists(), word


def _check_make(words):
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    assert {word for word in words if "=" not in word} <= set(targets), words


def _check_pip(words):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    verb, *rest = words
    assert verb == "install"
    for word in rest:
        name, _, extras = word.rstrip("]").partition("[")
        assert name in ("-e", "--editable", project["name"]) or (ROOT / name).is_dir(), word
        assert set(extras.split(",")) - {""} <= set(project["optional-dependencies"]), word


def _check_python(words):
    if words[0] == "-m":
        assert words[1] in ("ekfslam", "pip", "pytest", "pydoc", "venv"), words
    else:
        assert (ROOT / words[0]).exists(), words


# Pages that are followed ------------------------------------------------------------------------


def follow(page: str, run_command, capsys, changed: dict[str, str] | None = None) -> dict:
    """Do what a page says from top to bottom, in the working folder.

    Files are written, Python runs in one namespace, which is returned, commands run, and what a
    block prints is as the page has it. ``changed`` makes it shorter: other text for some of it.
    """
    names, shown = {"__name__": "page"}, ""
    text = PAGES[page]
    for old, new in (changed or {}).items():
        assert old in text, f"{page} says no more {old!r}"
        text = text.replace(old, new)
    for block in blocks(text):
        if block.file:
            Path(block.file).parent.mkdir(parents=True, exist_ok=True)
            Path(block.file).write_text(block.text, encoding="utf-8")
        elif block.reason:
            continue
        elif block.language == "python":
            exec(compile("\n" * block.line + block.text, page, "exec"), names)
            shown = capsys.readouterr().out
        elif block.commands:
            for line in block.commands:
                if DATA not in line:
                    shown = perform(line, run_command)
        elif block.language == "text":
            assert_shown(block.text, shown)
    return names


def perform(line: str, run_command) -> str:
    """Run a line of a shell; what it printed."""
    words = shlex.split(line, comments=True)
    if words[0] == "ekfslam" and not SHELL & set("".join(words)):
        run = run_command(*words[1:])
        expected = re.search(r"# exit status (\d+)", line)
        assert run.status == int(expected[1] if expected else 0), f"{line}\n{run.out}{run.err}"
        said = run.out.replace("NEES skipped", "").split()
        bad = {"failed", "skipped", "diverged"} if words[1] == "compare" else set()
        assert not bad & set(said), f"{line}\n{run.out}"
        return run.out
    if words[0] in ("make", "pip") or (words[0] == "python" and not Path(words[1]).exists()):
        check_command(line)  # of the repository, not of this folder
        return ""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-c", line],
        env=os.environ
        | {"PATH": path}
        | ({"PYTHONWARNINGS": "error"} if words[0] == "pytest" else {}),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
    return done.stdout


def without_times(text: str) -> list[list[str]]:
    """Words of the lines; columns of times, which are the last of a table, are left out."""
    lines, end = [], None
    for line in text.splitlines():
        if not line.strip():
            end = None
        if heading := re.search(r"\s\s+time\b", line):
            end = heading.start()
        lines.append(line[:end].split())
    return [words for words in lines if words]


def assert_shown(text: str, shown: str) -> None:
    """The lines of a page are printed in this order, others between them or not.

    Numbers differ by their last digits where libraries do, and times are of a machine.
    """
    printed = iter(without_times(shown))
    for words in without_times(text):
        assert any(_same(words, others) for others in printed), f"{' '.join(words)}\n{shown}"


def _same(words: list[str], others: list[str]) -> bool:
    return len(words) == len(others) and all(map(_same_word, words, others))


def _same_word(word: str, other: str) -> bool:
    number = re.compile(r"-?\d[\d.]*(?:e[+-]?\d+)?")
    if number.sub("#", word) != number.sub("#", other):
        return False
    pairs = zip(number.findall(word), number.findall(other), strict=True)
    return all(
        float(b.rstrip(".")) == pytest.approx(float(a.rstrip(".")), rel=0.02) for a, b in pairs
    )
