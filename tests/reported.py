"""Folders of results to make pages of, and a reader of the pages."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser

from ekfslam.experiments import compare
from ekfslam.registry import resolve
from ekfslam.simulation import load_scenario, simulate

NASTY = '<script>alert("$x$")</script>'
MESSAGE = "<img src=x onerror=alert(1)> & $\\nothing$"
FOUR = ("ekf", "gtsam-batch", "gtsam-isam2", "dead-reckoning")


class Nasty:
    """Calls itself what would be a script, and fails with what would be a picture."""

    name = '"><b onclick=alert(2)>$\\frac$'

    def __init__(self, fails=True):
        self.fails = fails

    def estimate(self, dataset):
        if self.fails:
            raise RuntimeError(MESSAGE)
        return replace(resolve("dead-reckoning").estimate(dataset), estimator=self.name)


def short(name, steps=60, seed=1):
    """The start of a scenario."""
    scenario = load_scenario(name)
    return simulate(replace(scenario, controls=scenario.controls[:steps]), seed=seed)


def compared():
    """Two datasets, one with a name that would be a script, and an estimator like that."""
    nasty = replace(short("loop-15", 30), name=NASTY)
    return compare([short("cloister"), nasty], [*FOUR, Nasty()], rpe_distance=1.0)


@dataclass
class Found:
    """A table of a page: headings, and a list of (text, value) of each row."""

    headings: list[str] = field(default_factory=list)
    numeric: list[bool] = field(default_factory=list)
    rows: list[list[tuple[str, str | None]]] = field(default_factory=list)


class Page(HTMLParser):
    """What a page holds: tags, text by tag, tables by caption, data of the maps."""

    def __init__(self, text):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.tables: dict[str, Found] = {}
        self.maps: list[dict] = []
        self._open: list[str] = []
        self._table = Found()
        self.feed(text)

    VOID = ("meta", "link", "path", "use", "line", "rect", "image", "stop")

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append((tag, attributes))
        if tag not in self.VOID:
            self._open.append(tag)
        if tag == "table":
            self._table = Found()
        elif tag == "tr" and "tbody" in self._open:
            self._table.rows.append([])
        elif tag in ("td", "th") and "tbody" in self._open:
            self._table.rows[-1].append(("", attributes.get("data-value")))
        elif tag == "th":
            self._table.headings.append("")
            self._table.numeric.append("number" in (attributes.get("class") or ""))

    def handle_endtag(self, tag):
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, text):
        tag = self._open[-1] if self._open else ""
        if text.strip():
            self.texts.append((tag, text.strip()))
        if "caption" in self._open:
            self.tables[text] = self._table
        elif tag in ("td", "th") and "tbody" in self._open:
            _, value = self._table.rows[-1][-1]
            self._table.rows[-1][-1] = (text, value)
        elif tag == "th":
            self._table.headings[-1] = text
        elif tag == "script" and text.startswith("{"):
            self.maps.append(json.loads(text))

    def of(self, *tags):
        """All text inside such tags."""
        return [text for tag, text in self.texts if tag in tags]
