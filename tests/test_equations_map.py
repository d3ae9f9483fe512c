"""The map of the texts: what it names exists, and no numbered equation is left out."""

from __future__ import annotations

import ast
import re
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")
FUNCTION = re.compile(r"`((?:ekfslam|baselines)[\w.]*):([\w.]+)`")
TEST = re.compile(r"`(tests/\w+\.py)::(\w+)`")
WRONG = "Where the texts are wrong, loose or damaged"


def chapters():
    """Text of the page by heading."""
    parts = re.split(r"^## (.*)\n", PAGE, flags=re.M)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def rows(chapter):
    """Cells of the rows of its table."""
    lines = [line for line in chapter.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


@cache
def names_in(path):
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize(("module", "name"), sorted(set(FUNCTION.findall(PAGE))))
def test_functions_exist(module, name):
    found = import_module(module)
    for part in name.split("."):
        found = getattr(found, part)


@pytest.mark.parametrize(("path", "name"), sorted(set(TEST.findall(PAGE))))
def test_tests_exist(path, name):
    assert name in names_in(path)


def test_whatever_looks_like_a_name_is_one():
    for quoted in re.findall(r"`([^`]+)`", PAGE):
        if ":" not in quoted:
            continue
        known = FUNCTION.fullmatch(f"`{quoted}`") or TEST.fullmatch(f"`{quoted}`")
        assert known or quoted == "module:name", quoted


def test_every_row_names_a_function_and_a_test():
    assert len(chapters()) == 6
    for title, chapter in chapters().items():
        assert len(rows(chapter)) > 5
        for row in rows(chapter):
            assert len(row) == 4
            assert TEST.search(row[3]), row
            assert title == WRONG or FUNCTION.search(row[2]), row


# Numbers ----------------------------------------------------------------------------------------

EQUATIONS = {
    "Solà": [str(k) for k in range(1, 88)],
    "Ciatto": [
        *(f"2.{k}" for k in range(1, 5)),
        *(f"3.{k}" for k in range(1, 19)),
        *(f"A.{k}" for k in range(1, 10)),
    ],
    "*Principles": [f"17.{k}" for k in range(1, 5)],
    "*Extended": [str(k) for k in range(1, 12)],
}
LINES = {"Ciatto": range(1, 13), "*Extended": range(1, 19)}
NUMBER = r"(?:[A\d]+\.\d+|\d+)"
NUMBERS = rf"{NUMBER}(?:(?:, | to | and ){NUMBER})*"


def numbered(words, known):
    """The numbers that words such as "14, 16 to 18" stand for, in the order of those known."""
    found = set()
    for part in re.split(", | and ", words):
        first, _, last = part.partition(" to ")
        at = known.index(first)
        found.update(known[at : known.index(last or first) + 1])
    return found


def of_text(start):
    """What a chapter says it maps: its first column, and what follows the table."""
    (chapter,) = (text for title, text in chapters().items() if title.startswith(start))
    first = [row[0] for row in rows(chapter)]
    return "\n".join([*first, chapter.rpartition("|\n")[2]])


@pytest.mark.parametrize("start", EQUATIONS)
def test_no_numbered_equation_is_left_out(start):
    known, mapped = EQUATIONS[start], set()
    for words in re.findall(rf"Eqs?\. ({NUMBERS})", of_text(start)):
        mapped |= numbered(words, known)
    assert not set(known) - mapped


@pytest.mark.parametrize("start", LINES)
def test_no_line_of_an_algorithm_is_left_out(start):
    known, mapped = [str(k) for k in LINES[start]], set()
    for words in re.findall(rf"lines? ({NUMBERS})", of_text(start)):
        mapped |= numbered(words, known)
    assert not set(known) - mapped


def test_algorithms_and_operations_are_named():
    for start, name in (("*Principles", "Alg. 1"), ("*Principles", "Alg. 2"),
                        ("*Principles", "Alg. 3"), ("Solà", "Table 1")):  # fmt: skip
        assert name in of_text(start)
