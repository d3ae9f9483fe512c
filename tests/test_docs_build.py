"""The documentation is built without a warning, links names to the reference, and works offline."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html import unescape
from pathlib import Path

import pytest
import typer

import ekfslam
from ekfslam.cli import app

pytest.importorskip("sphinx", reason="sphinx is not installed: pip install 'ekfslam[docs]'")

ROOT = Path(__file__).parents[1]
REFERENCE = "\n".join(
    path.read_text(encoding="utf-8") for path in sorted(ROOT.glob("docs/reference/*.md"))
)
OPTIONS = ["-W", "--keep-going", "-q", "-c", "docs"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built pages by name."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "sphinx",
            *OPTIONS,
            "-d",
            str(folder / "trees"),
            ".",
            str(folder / "pages"),
        ],
        cwd=ROOT,
        env=os.environ | {"NO_COLOR": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    pages = (folder / "pages").rglob("*.html")
    return {
        path.relative_to(folder / "pages").with_suffix("").as_posix(): path.read_text("utf-8")
        for path in pages
    }


def test_the_pages_are_all_there(site):
    pages = [*ROOT.glob("docs/*.md"), *ROOT.glob("docs/reference/*.md"), *ROOT.glob("notebooks/*")]
    assert {"index", "search"} | {
        path.relative_to(ROOT).with_suffix("").as_posix()
        for path in pages
        if path.suffix in (".md", ".ipynb")
    } <= set(site)


def test_equations_lead_to_functions(site):
    """Each function that the map of the texts names is a link to what it does."""
    text = (ROOT / "docs" / "equations.md").read_text("utf-8")
    named = {".".join(found) for found in re.findall(r"`((?:ekf|bas)[\w.]*):([\w.]+)`", text)}
    link = (
        r'<a class="reference internal" href="[^"]*#[^"]*"[^>]*><code[^>]*><span class="pre">(.*?)<'
    )
    assert len(named) > 70
    # A table of views has no docstring that it could be described by.
    assert named - set(re.findall(link, site["docs/equations"])) == {"ekfslam.models.sensors.VIEWS"}


def test_nothing_is_loaded_from_elsewhere(site):
    for name, page in site.items():
        loaded = re.findall(r'<(?:script|img|iframe)[^>]* src="([^"]*)"', page)
        loaded += re.findall(r'<link[^>]* rel="stylesheet"[^>]* href="([^"]*)"', page)
        assert [link for link in loaded if re.match(r"(https?:)?//", link)] == [], name


def test_every_command_is_described_with_its_options(site):
    page = unescape(re.sub(r"<[^>]+>", "", site["docs/reference/commands"]))

    def described(command, words):
        assert " ".join(words) in page
        for parameter in command.params:
            assert all(option in page for option in parameter.opts if option.startswith("--"))
        for name, each in getattr(command, "commands", {}).items():
            described(each, [*words, name])

    described(typer.main.get_command(app), ["ekfslam"])
    assert not re.search(r"\[/?(bold|dim)\]|–out|`", page)


def test_fields_without_a_description_are_left_out(site):
    assert not [name for name, page in site.items() if "Alias for field" in page]


def test_the_line_of_a_property_is_whole(site):
    page = re.sub(r"<[^>]+>", "", site["docs/reference/data"])
    assert "Row of the first observation of each step, (K + 2,): step k has" in page


def test_every_name_of_the_package_is_in_the_reference():
    for name in ekfslam.__all__:
        assert f"ekfslam.{name}`" in REFERENCE or f"ekfslam.{name}\n" in REFERENCE, name


def test_every_module_is_in_the_reference(site):
    pages = "".join(text for name, text in site.items() if name.startswith("docs/reference/"))
    for path in [*ROOT.glob("ekfslam/**/*.py"), *ROOT.glob("baselines/**/*.py")]:
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        if "__" not in name and not name.startswith("ekfslam.cli."):
            assert f'id="module-{name}"' in pages, name
