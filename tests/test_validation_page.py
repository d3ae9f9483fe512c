"""The page on validation: the ladder's figures are those that the check measures."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ekfslam.validation import check

PAGE = (Path(__file__).parents[1] / "docs" / "validation.md").read_text(encoding="utf-8")


def test_the_ladder_on_the_page_is_the_ladder():
    number = r"([\d.e+-]+)"
    pattern = rf"\| (\d) \| (.*) \| {number} \| {number} \| (<=|>=) {number} \|"
    told = re.findall(pattern, PAGE)
    report = check("ekf")
    assert report.findings == ()
    assert 2 * len(told) == len(report.rungs)
    for rung in report.rungs:
        place, name, *measured, sign, bound = told[rung.number - 1]
        assert (int(place), name) == (rung.number, rung.name)
        assert (sign, float(bound)) == (">=" if rung.at_least else "<=", rung.bound)
        figure = float(measured[rung.scenario == "loop-15"])
        if figure < 1e-9:  # round-off has no digits to hold it to
            assert rung.measured < 10 * figure
        else:
            assert rung.measured == pytest.approx(figure, rel=0.05)
