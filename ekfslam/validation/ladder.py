"""Climb the ladder with an estimator, rung by rung."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.errors import UnsupportedError, in_words
from ekfslam.estimates import SKIPPED
from ekfslam.registry import Estimator, estimator_name, resolve
from ekfslam.simulation import simulate
from ekfslam.validation import gauge, rungs
from ekfslam.validation.diagnosis import Finding, diagnose

PASS, FAIL, NOT_APPLICABLE = "pass", "fail", "does not apply"
INCONSISTENT = "inconsistent"
SCENARIOS = ("cloister", "loop-15")
STAND_INS = {"loop-15": "loop-15-rb"}  # the same run, seen by range and bearing and not by x and y
RUNGS = (*rungs.LADDER, *gauge.LADDER)


@dataclass(frozen=True)
class Rung:
    """One question on one scenario, and what the estimator answered.

    Attributes
    ----------
    number : int
    name : str
        The question.
    scenario : str
    outcome : {"pass", "fail", "inconsistent", "does not apply"}
    measured, bound : float
        The largest deviation (or, for small noise, the exponent) and what it is held against.
    detail : str
        Where it was measured, what went wrong, or what would be needed.
    """

    number: int
    name: str
    scenario: str
    outcome: str
    measured: float
    bound: float
    detail: str

    @property
    def at_least(self) -> bool:
        """Whether the bound is a lower one."""
        return self.name == rungs.SMALL_NOISE

    @property
    def of_consistency(self) -> bool:
        """Whether it asks for consistency, which not every right filter has."""
        return self.name in {name for name, _, _ in gauge.LADDER}


@dataclass(frozen=True)
class Report:
    """All rungs of one estimator.

    Attributes
    ----------
    estimator : str
    rungs : tuple of Rung
    findings : tuple of Finding
        What is wrong, and what the mistake most likely is. If no rung failed, mistakes that have a
        name alone: scenarios do not show everything.
    """

    estimator: str
    rungs: tuple[Rung, ...]
    findings: tuple[Finding, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether some rung passed and none failed; what does not apply counts for neither.

        Nor does it count here that a filter is inconsistent, see `consistent`.
        """
        outcomes = {rung.outcome for rung in self.rungs}
        return PASS in outcomes and FAIL not in outcomes

    @property
    def consistent(self) -> bool | None:
        """Whether all rungs of consistency that apply passed; None if none applies."""
        outcomes = {r.outcome for r in self.rungs if r.of_consistency} - {NOT_APPLICABLE}
        return outcomes == {PASS} if outcomes else None

    @property
    def table(self) -> pd.DataFrame:
        """One row per rung."""
        names = ["number", "name", "scenario", "outcome", "measured", "bound", "detail"]
        return pd.DataFrame([[getattr(r, n) for n in names] for r in self.rungs], columns=names)

    def _repr_html_(self) -> str:
        return self.table.to_html(index=False) + "".join(
            finding._repr_html_() for finding in self.findings
        )


def check(
    estimator: str | Any, scenarios: str | Sequence[str] | None = None, seed: int = 1
) -> Report:
    """Run the ladder on an estimator.

    1. Jacobians equal central differences (needs ``linearizations``, see below).
    2. Data without noise return the truth.
    3. The linear oracle gives the same means and joint covariance (needs ``linearizations``).
    4. Moving the world moves the answer.
    5. The gap to the batch smoother shrinks with the square of the noise.

    A filter can be right in all of this and still believe to learn what no sighting tells: where
    the world is, and how it is turned. The last two rungs ask for that. The standard EKF is
    inconsistent by its nature (Huang et al. 2010), so that the outcome is then "inconsistent" and
    no failure; `Report.consistent` has the verdict.

    6. A robot that stands still, unsure of its heading, learns nothing of its pose.
    7. The prior of the first pose changes no whitened innovation.

    A filter is also run on a few tiny probes, to say in words what is wrong with it, see
    `ekfslam.validation.diagnose`.

    Parameters
    ----------
    estimator : str or object
        A registered name, ``module:Class``, or an object with ``estimate(dataset)``. Rungs 1 and 3
        ask for a method ``linearizations(dataset) -> (Estimate, Linearizations)``; rungs 6 and 7
        for an estimate with an online series and innovations.
    scenarios : str or sequence of str, optional
        Simulated scenarios, with known association. By default ``cloister`` and ``loop-15``, for
        an estimator that knows no sightings of x and y ``loop-15-rb``.
    seed : int
        Of their draws.

    Returns
    -------
    Report

    Raises
    ------
    UnknownNameError, InputError
        For an estimator or a scenario that cannot be found.
    """
    subject = resolve(estimator)
    if scenarios is None:
        scenarios = [_suitable(name, subject, seed) for name in SCENARIOS]
    names = [scenarios] if isinstance(scenarios, str) else scenarios
    datasets = {name: simulate(name, seed=seed) for name in names}
    found = []
    for number, (name, bound, measure) in enumerate(RUNGS, start=1):
        for scenario, dataset in datasets.items():
            blank = Rung(number, name, scenario, FAIL, float("nan"), bound, "")
            found.append(_climb(blank, measure, subject, dataset, seed))
    report = Report(estimator_name(estimator), tuple(found))
    findings = (*_view_not_read(report, subject, seed), *diagnose(subject))
    if report.passed:
        findings = tuple(finding for finding in findings if finding.named)
    return replace(report, findings=findings)


def _view_not_read(report: Report, subject: Estimator, seed: int) -> tuple[Finding, ...]:
    """That a filter takes x and y for range and bearing: seen by those, the same run is right."""
    number, measure = 2, rungs.zero_noise
    for rung in report.rungs:
        if rung.number == number and rung.outcome == FAIL and rung.scenario in STAND_INS:
            other = STAND_INS[rung.scenario]
            instead = _climb(
                replace(rung, scenario=other), measure, subject, simulate(other, seed=seed), seed
            )
            if instead.outcome == PASS:
                return (
                    Finding(
                        "sensor",
                        ("view-not-read",),
                        f"what {rung.scenario} sees is x and y in the robot's frame, and the "
                        "filter takes them for range and bearing",
                        'it is for one kind of sensor and does not say so: kinds = ("range-'
                        'bearing",) in the class, and other data are skipped, here too',
                        "the columns of values, and which sensor they are of",
                        f"without noise it is right on {other}, the same run seen by range and "
                        f"bearing, and wrong on {rung.scenario}",
                    ),
                )
    return ()


def _suitable(scenario: str, subject: Estimator, seed: int) -> str:
    """The scenario, or what stands in for it where the estimator does not know its sensor."""
    if scenario not in STAND_INS:
        return scenario
    try:
        skipped = subject.estimate(simulate(scenario, seed=seed)).status == SKIPPED
    except UnsupportedError:
        skipped = True
    except Exception:  # which is for the rungs to tell
        skipped = False
    return STAND_INS[scenario] if skipped else scenario


def _climb(
    rung: Rung,
    measure: Callable[..., rungs.Measurement],
    subject: Estimator,
    dataset: Dataset,
    seed: int,
) -> Rung:
    """One rung, filled in; an estimator that raises has failed it."""
    try:
        measured, detail = measure(subject, dataset, rung.scenario, seed)
    except UnsupportedError as reason:
        return replace(rung, outcome=NOT_APPLICABLE, detail=str(reason))
    except Exception as error:
        return replace(rung, detail=f"raised {in_words(error)}")
    outcome = FAIL
    if measured >= rung.bound if rung.at_least else measured <= rung.bound:
        outcome = PASS
    elif rung.of_consistency and np.isfinite(measured):
        outcome = INCONSISTENT
    return replace(rung, outcome=outcome, measured=measured, detail=detail)
