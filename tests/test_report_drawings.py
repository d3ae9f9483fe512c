"""Figures as part of a page: colours that are seen, names that do not meet, nothing twice."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from reported import Page

from ekfslam.plots.style import LOOKS, METHODS, drawing, svg
from ekfslam.report.drawings import PAPER_DARK, Ink, contrast, on_dark

ROOT = Path(__file__).parents[1]


def test_colours_are_seen_on_the_dark_page():
    known = {look.color.lower()[1:] for look in (*LOOKS.values(), *METHODS.values())}
    for code in known:
        dark = on_dark(code)
        rgb = [int(dark[i : i + 2], 16) for i in (0, 2, 4)]
        assert contrast(rgb, PAPER_DARK) >= 2.95  # of whole numbers
    assert on_dark("ffffff") == PAPER_DARK
    assert on_dark("000000") == "ebebeb"


def test_contrast_is_that_of_the_guidelines():
    assert contrast([0, 0, 0], "ffffff") == pytest.approx(21.0)
    assert contrast([119, 119, 119], "ffffff") == pytest.approx(4.478, abs=1e-3)


def test_text_of_the_page_is_readable():
    css = (ROOT / "ekfslam/report/page.css").read_text()
    for block in re.findall(r":root \{(.*?)\}", css, flags=re.S):
        colors = dict(re.findall(r"--(\w+): #([0-9a-f]{6});", block))
        for paper in ("paper", "panel"):
            for ink in ("ink", "quiet", "link"):
                rgb = [int(colors[ink][i : i + 2], 16) for i in (0, 2, 4)]
                assert contrast(rgb, colors[paper]) >= 4.5, (ink, paper)
    assert f"--paper: #{PAPER_DARK};" in css


def test_drawings_share_a_page():
    """Names of one do not meet those of another, and nothing refers to what is not there."""
    ink, parts = Ink(), []
    for _ in range(2):
        with drawing(3, 2) as figure:
            axes = figure.add_subplot(title="$5 < 6 & 7")
            axes.plot([0, 1, 2], [0, 1, 0], "o", color="#0072b2")
        parts.append(ink.inline(svg(figure)))
    page = Page("".join(parts))
    names = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(names) == len(set(names)) > 0
    used = set(re.findall(r'href="#([^"]*)"|url\(#([^)]*)\)', "".join(parts) + ink.css))
    assert {a or b for a, b in used} <= set(names)
    assert "$5 < 6 & 7" in page.of("text")
    assert "--c0072b2:#0072b2" in ink.css
    assert "style=" not in "".join(parts)


def test_markers_on_one_another_are_drawn_once():
    counts = []
    for points in ([0.0], [0.0] * 50, [0.0, 1.0]):
        with drawing(3, 2) as figure:
            axes = figure.add_subplot(xlim=(-1, 2), ylim=(-1, 1))
            axes.set_axis_off()
            axes.plot(points, [0.0] * len(points), "o", color="#0072b2")
        counts.append(Ink().inline(svg(figure)).count("<use"))
    assert counts == [1, 1, 2]
