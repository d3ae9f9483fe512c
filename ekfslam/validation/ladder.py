"""Climb the ladder with an estimator, rung by rung."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.errors import UnsupportedError
from ekfslam.registry import Estimator, estimator_name, resolve
from ekfslam.simulation import simulate
from ekfslam.validation import rungs

PASS, FAIL, NOT_APPLICABLE = "pass", "fail", "does not apply"
SCENARIOS = ("cloister", "loop-15")
Measure = Callable[[Estimator, Dataset], "rungs.Measurement"]


@dataclass(frozen=True)
class Rung:
    """One question on one scenario, and what the estimator answered.

    Attributes
    ----------
    number : int
    name : str
        The question.
    scenario : str
    outcome : {"pass", "fail", "does not apply"}
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


@dataclass(frozen=True)
class Report:
    """All rungs of one estimator.

    Attributes
    ----------
    estimator : str
    rungs : tuple of Rung
    """

    estimator: str
    rungs: tuple[Rung, ...]

    @property
    def passed(self) -> bool:
        """Whether some rung passed and none failed; one that does not apply counts for neither."""
        outcomes = {rung.outcome for rung in self.rungs}
        return PASS in outcomes and FAIL not in outcomes

    @property
    def table(self) -> pd.DataFrame:
        """One row per rung."""
        names = ["number", "name", "scenario", "outcome", "measured", "bound", "detail"]
        return pd.DataFrame([[getattr(r, n) for n in names] for r in self.rungs], columns=names)

    def _repr_html_(self) -> str:
        return self.table.to_html(index=False)


def check(
    estimator: str | Any, scenarios: str | Sequence[str] = SCENARIOS, seed: int = 1
) -> Report:
    """Run the ladder on an estimator.

    1. Jacobians equal central differences (needs ``linearizations``, see below).
    2. Data without noise return the truth.
    3. The linear oracle gives the same means and joint covariance (needs ``linearizations``).
    4. Moving the world moves the answer.
    5. The gap to the batch smoother shrinks with the square of the noise.

    Parameters
    ----------
    estimator : str or object
        A registered name, ``module:Class``, or an object with ``estimate(dataset)``. Rungs 1 and 3
        ask for a method ``linearizations(dataset) -> (Estimate, Linearizations)``.
    scenarios : str or sequence of str
        Simulated scenarios, with known association.
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
    names = [scenarios] if isinstance(scenarios, str) else scenarios
    datasets = {name: simulate(name, seed=seed) for name in names}
    found = []
    for number, (name, bound, measure) in enumerate(rungs.LADDER, start=1):
        for scenario, dataset in datasets.items():
            found.append(_climb(number, name, bound, measure, subject, scenario, dataset, seed))
    return Report(estimator_name(estimator), tuple(found))


def _climb(
    number: int,
    name: str,
    bound: float,
    measure: Callable[..., rungs.Measurement],
    subject: Estimator,
    scenario: str,
    dataset: Dataset,
    seed: int,
) -> Rung:
    """One rung; an estimator that raises has failed it."""
    nan = float("nan")
    try:
        measured, detail = measure(subject, dataset, scenario, seed)
    except UnsupportedError as reason:
        return Rung(number, name, scenario, NOT_APPLICABLE, nan, bound, str(reason))
    except Exception as error:
        text = f"raised {type(error).__name__}: {' '.join(str(error).split())}"
        return Rung(number, name, scenario, FAIL, nan, bound, text)
    good = measured >= bound if name == rungs.SMALL_NOISE else measured <= bound
    return Rung(number, name, scenario, PASS if good else FAIL, measured, bound, detail)
