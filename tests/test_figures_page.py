"""The page on figures: its table is that of the style, and its distances are what it says."""

from __future__ import annotations

import re
from itertools import combinations

from pages import PAGES

from ekfslam.plots import PAGE
from ekfslam.plots.style import LOOKS
from ekfslam.plots.vision import apart

TEXT = PAGES["docs/figures.md"]


def test_the_table_is_that_of_the_style():
    rows = re.findall(r"^\| `(.+?)` \| `(.+?)` \| `(.+?)` .*? \| `(.+?)` .*? \|$", TEXT, re.M)
    assert rows == [(name, *look) for name, look in LOOKS.items()]


def test_the_distances_are_what_the_page_says():
    least = min(apart(a.color, b.color) for a, b in combinations(LOOKS.values(), 2))
    (said,) = re.findall(r"Any two of the table are (\d+) or more apart", TEXT)
    assert int(least) == int(said)


def test_the_width_is_that_of_a_page():
    assert f"width of a page, {PAGE} in" in TEXT
