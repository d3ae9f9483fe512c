"""The pages on models, worlds and data of one's own: all that stands in them runs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import NamedTuple

import pytest

DOCS = Path(__file__).parents[1] / "docs"
PAGES = ("your_own_models", "your_own_world", "your_own_data")
BLOCK = re.compile(r"^```(\w+)[ ]?(\S*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    language: str
    file: str
    text: str


def blocks(page):
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    assert text.count("```") == 2 * len(BLOCK.findall(text)), "a block that is not seen is not run"
    return [Block(*found) for found in BLOCK.findall(text)]


@pytest.mark.parametrize("page", PAGES)
def test_blocks_run_in_order(page, tmp_path, monkeypatch, run_command, capsys):
    """Files are written, Python runs in one namespace, commands run, output is as printed."""
    monkeypatch.chdir(tmp_path)
    names, printed = {"__name__": page}, ""
    for language, file, text in blocks(page):
        if file:
            Path(file).parent.mkdir(exist_ok=True)
            Path(file).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(compile(text, page, "exec"), names)
            printed = capsys.readouterr().out
        elif language == "sh":
            for command, *words in map(shlex.split, text.splitlines()):
                assert command == "ekfslam"
                run = run_command(*words)
                assert run.status == 0, run.err
                assert not re.search(
                    " (skipped|failed|diverged) ", run.out.replace("NEES skipped", "")
                )
        else:
            assert language == "text"
            assert printed == text


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files(page):
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", text)
    assert links
    assert [link for link in links if not (DOCS / link).exists()] == []
