"""How an assertion fails: words, tables, figures, and what to do."""

from __future__ import annotations

import re
import shlex
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd

from ekfslam.testing.findings import WORST, Finding, in_text
from ekfslam.testing.metrics import in_words
from ekfslam.testing.runs import Problem, name_of
from ekfslam.testing.session import current

__tracebackhide__ = True  # a failed test shows the user's line


def command() -> str:
    """What rewrites the reference of the test that runs now."""
    test = current().test
    return " ".join(filter(None, ["pytest", test and shlex.quote(test), "--ekfslam-update"]))


def fail(finding: Finding, estimator: Any, problem: Problem, rewritable: bool = False) -> None:
    """Raise what the finding says if it does not hold.

    Parameters
    ----------
    finding : Finding
    estimator : str or object
    problem : Problem
        Of which a figure is drawn.
    rewritable : bool
        Whether a reference may be rewritten.

    Raises
    ------
    AssertionError
    """
    if finding.holds:
        return
    parts = [str(finding), ""]
    try:
        parts += [f"figure: {path}" for path in _drawn(finding, estimator, problem)]
    except Exception as error:  # what cannot be drawn hides no failure
        parts.append(f"no figure: {type(error).__name__}: {error}")
    if rewritable:
        parts.append(f"if this is meant to be, write the reference anew: {command()}")
    raise AssertionError("\n".join(parts))


def fail_for_lost(lost: pd.DataFrame, runs: int, note: str = "") -> None:
    """Raise if runs were lost: diverged, failed or skipped.

    Parameters
    ----------
    lost : DataFrame
        A row for each.
    runs : int
        How many there are in all.
    note : str
        Is added to the first line.

    Raises
    ------
    AssertionError
    """
    if len(lost):
        table = lost[["scenario", "seed", "status", "message"]].head(WORST)
        raise AssertionError(f"{in_words(lost, runs)}{note}\n\n{in_text(table)}")


def _drawn(finding: Finding, estimator: Any, problem: Problem) -> list[Path]:
    """Numbers of the seeds, and the map of the worst one."""
    from ekfslam.experiments import compare
    from ekfslam.plots import save
    from ekfslam.plots.seeds import plot_seeds

    name, folder = name_of(estimator), current().figures
    stem = re.sub(r"[^\w.=-]+", "-", f"{name}-{problem.name}").strip("-")
    broken = finding.claims[~finding.claims["holds"]]
    what = broken[["scenario", "what"]].iloc[0]
    seeds = finding.seeds.merge(broken[["scenario", "what"]])
    paths = [save(plot_seeds(seeds, name), folder, f"{stem}-seeds")[0]]
    with suppress(Exception):  # the map is an extra
        mine = seeds[(seeds["scenario"] == problem.name) & (seeds["what"] == what["what"])]
        dataset = problem.draw(int(mine["seed"].iloc[0]))
        figure = compare(dataset, estimator).plot_map()
        paths.append(save(figure, folder, f"{stem}-map-of-worst")[0])
    return paths
