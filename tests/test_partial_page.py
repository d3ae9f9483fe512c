"""The page on partial observations: it speaks of what the study runs."""

from __future__ import annotations

from pathlib import Path

from ekfslam.experiments.partial import CASES, ON_RECORDED, RECORDED

PAGE = (Path(__file__).parents[1] / "docs" / "partial.md").read_text(encoding="utf-8")


def test_it_has_a_row_for_every_case_of_the_study():
    for name, estimators in (*CASES.items(), *((name, ON_RECORDED) for name in RECORDED)):
        for estimator in estimators:
            assert f"| {name} | `{estimator}` |" in PAGE
