"""Which mistakes make a right filter say what another one says.

A case is a probe with the answer of the filter under test. Hypotheses, a few mistakes each, are
held against one case after another: those that do not fit are dropped, and where none is left, they
grow by one mistake, or by two.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.geometry import Array
from ekfslam.validation.catalogue import CATALOGUE, OWN_NOISE
from ekfslam.validation.mistakes import Mistake
from ekfslam.validation.probes import Probe
from ekfslam.validation.suspects import Answer, run

EXPONENTS = np.linspace(-9.0, 15.0, 49)  # of e: factors that are tried
CLEARLY = 0.05  # share of the largest deviation
FITTED = 1e-6  # [sigma]; a factor is found less exactly than numbers agree


class Case(NamedTuple):
    """A probe, the run that it is, what the filter said, and what the right one says."""

    probe: Probe
    dataset: Dataset
    told: Answer
    right: Answer


class Gap(NamedTuple):
    """How far an answer is from another, in sigmas, and where most."""

    size: float
    where: str


class Charge(NamedTuple):
    """One mistake in one of its forms."""

    mistake: Mistake
    switches: tuple[tuple[str, Any], ...]

    @property
    def says(self) -> str:
        """What a filter with it does."""
        return self.mistake.says.format(self.switches[0][1])

    @property
    def usually(self) -> str:
        """What it usually comes from."""
        value = self.switches[0][1]
        if isinstance(value, np.ndarray):
            value = np.where(np.abs(value) < 1e-9 * np.abs(value).max(), 0.0, value)
            value = [[float(f"{entry:.4g}") for entry in row] for row in value]
        return self.mistake.usually.format(value)


class Hypothesis(NamedTuple):
    """What a filter does.

    Attributes
    ----------
    charges : tuple of Charge
    style : tuple of str
        Ways to do it that are no mistakes.
    gate : float
        Squared distance beyond which it rejects sightings.
    """

    charges: tuple[Charge, ...] = ()
    style: tuple[str, ...] = ()
    gate: float = float("inf")

    @property
    def wrong(self) -> dict[str, Any]:
        """As `ekfslam.validation.suspects.run` takes it."""
        switches = [pair for charge in self.charges for pair in charge.switches]
        return {**dict(switches), **dict.fromkeys(self.style, 1.0), "gate": self.gate}


def gap_of(case: Case, wrong: Mapping[str, Any]) -> Gap:
    """Between what the filter said and what one with such mistakes says."""
    with np.errstate(all="ignore"):
        try:
            other = run(case.dataset, wrong)[0]
        except np.linalg.LinAlgError:
            return Gap(float("inf"), "everything")
    return gap_between(case.told, other, case.right)


def gap_between(told: Answer, other: Answer, right: Answer) -> Gap:
    """Largest deviation of any part that is told, in the sigmas of the right answer."""
    if len(told.ids) and not np.array_equal(told.ids, other.ids):
        return Gap(float("inf"), "the list of landmarks")
    assert right.joint is not None
    at = 3 + 2 * np.searchsorted(right.ids, told.ids)[:, None] + np.arange(2)
    sigma = np.sqrt(np.diag(right.joint))
    of_poses, of_points = _sigmas(right.covariances), sigma[at]
    parts = {"the pose": geo.additive_error(other.poses, told.poses) / of_poses}
    parts |= _apart("the covariance of the pose", told.covariances, other.covariances, of_poses)
    if len(told.ids):
        parts["a landmark"] = (told.positions - other.positions) / of_points
        whose = "the covariance of a landmark"
        parts |= _apart(whose, told.marginals, other.marginals, of_points)
    together = np.concatenate([sigma[:3], of_points.reshape(-1)])
    parts |= _apart("the joint covariance", told.joint, other.joint, together)
    sizes = {
        name: float(np.max(np.nan_to_num(np.abs(part), nan=np.inf), initial=0.0))
        for name, part in parts.items()
    }
    # The first that is clearly off: those that follow hold it, too.
    most = max(sizes.values())
    where = next(name for name, size in sizes.items() if size >= CLEARLY * most)
    return Gap(most, where)


def _sigmas(covariances: Array | None) -> Array:
    assert covariances is not None
    return np.sqrt(np.einsum("...ii->...i", covariances))


def _apart(name: str, told: Array | None, other: Array | None, sigma: Array) -> dict[str, Array]:
    """Deviation of a covariance, in units of its own; nothing where it is not told."""
    if told is None or other is None:
        return {}
    return {name: (told - other) / (sigma[..., :, None] * sigma[..., None, :])}


def fits(cases: Sequence[Case], hypothesis: Hypothesis, tolerance: float) -> bool:
    """Whether a hypothesis explains cases; the last one, the newest, is asked first."""
    if any(charge.mistake.fitted for charge in hypothesis.charges):
        tolerance = max(tolerance, FITTED)
    wrong = hypothesis.wrong
    return all(gap_of(case, wrong).size <= tolerance for case in reversed(cases))


def in_some_style(
    cases: Sequence[Case], hypotheses: Sequence[Hypothesis], tolerance: float
) -> list[Hypothesis]:
    """Those that explain the cases, if need be in another style than before."""
    found: list[Hypothesis] = []
    for each in hypotheses:
        tried = _in_styles(each, cases[-1].probe.styles)
        found += next(([one] for one in tried if fits(cases, one, tolerance)), [])
    return found


def _in_styles(
    hypothesis: Hypothesis, axes: tuple[tuple[str | None, ...], ...]
) -> Iterator[Hypothesis]:
    """The same in every style that goes with those that it has shown before."""
    shown = [[way for way in axis if way in hypothesis.style] for axis in axes]
    for ways in product(*(was or axis for was, axis in zip(shown, axes, strict=True))):
        style = dict.fromkeys([*hypothesis.style, *filter(None, ways)])
        yield hypothesis._replace(style=tuple(style))


def grown(
    cases: Sequence[Case], hypotheses: Sequence[Hypothesis], tolerance: float, most: int = 2
) -> list[Hypothesis]:
    """Hypotheses with one mistake more, or with two, that explain all cases; none if none does."""
    for more in (_singly, _fitted, _own, *([_in_pairs] if most > 1 else [])):
        found = [
            each
            for hypothesis in hypotheses
            for each in in_some_style(cases, list(more(cases, hypothesis)), tolerance)
        ]
        if found:
            return found
    return []


def _charges(hypothesis: Hypothesis) -> Iterator[Charge]:
    """Mistakes that are not among those of a hypothesis, in all their forms."""
    made = {charge.mistake.name for charge in hypothesis.charges}
    for mistake in CATALOGUE:
        if mistake.name not in made and not mistake.fitted:
            for form in mistake.switches:
                yield Charge(mistake, tuple((switch, 1.0) for switch in form))


def _singly(cases: Sequence[Case], hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    for charge in _charges(hypothesis):
        yield hypothesis._replace(charges=(*hypothesis.charges, charge))


def _in_pairs(cases: Sequence[Case], hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """Pairs of mistakes that each make a difference to the newest case."""
    last = cases[-1]
    before = gap_of(last, hypothesis.wrong).size
    useful = [
        charge
        for charge in _charges(hypothesis)
        if abs(gap_of(last, hypothesis.wrong | dict(charge.switches)).size - before)
        > 1e-12 * before
    ]
    for one, other in combinations(useful, 2):
        if one.mistake.name != other.mistake.name:
            yield hypothesis._replace(charges=(*hypothesis.charges, one, other))


def _fitted(cases: Sequence[Case], hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """Mistakes with a factor: the one that comes nearest in the newest case."""
    for mistake in CATALOGUE:
        if mistake.fitted and mistake.name not in hypothesis.wrong:
            factor = _nearest_factor(cases[-1], hypothesis.wrong, mistake.name)
            charge = Charge(mistake, ((mistake.name, factor),))
            yield hypothesis._replace(charges=(*hypothesis.charges, charge))


def _nearest_factor(case: Case, wrong: Mapping[str, Any], switch: str) -> float:
    def distance(exponent: float) -> float:
        return gap_of(case, {**wrong, switch: float(np.exp(exponent))}).size

    best = EXPONENTS[int(np.argmin([distance(exponent) for exponent in EXPONENTS]))]
    step = EXPONENTS[1] - EXPONENTS[0]
    bounds = best - step, best + step
    found = minimize_scalar(distance, bounds=bounds, method="bounded", options={"xatol": 1e-13})
    return float(np.exp(found.x))


def _own(cases: Sequence[Case], hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """A noise of the filter's own, read off the covariances of the newest case."""
    last = cases[-1]
    for switch, noise in own_noise(last.dataset, last.told):
        charge = Charge(OWN_NOISE[switch[0]], ((switch, noise),))
        yield hypothesis._replace(charges=(*hypothesis.charges, charge))


def own_noise(dataset: Dataset, told: Answer) -> Iterator[tuple[str, Array]]:
    """What a first step, move or sighting has added to the covariance, as a switch sets it."""
    prior, controls = dataset.prior, dataset.robot.controls
    if told.covariances is not None and controls.any():
        turn = geo.heading_block(prior.mean[2])
        F = geo.compose_jacobians(prior.mean, controls[0])[0]
        moved = told.covariances[1] - F @ prior.covariance @ F.T
        yield "q-own", turn.T @ moved @ turn
        yield "q-always", turn.T @ (told.covariances[0] - prior.covariance) @ turn
    elif told.marginals is not None and len(told.ids):
        place, G, V = dataset.sensors[0].locate(prior.mean, dataset.observations.values[0])
        at = int(np.argmin(np.linalg.norm(told.positions - place, axis=1)))
        undo = np.linalg.inv(V)
        yield "r-own", undo @ (told.marginals[at] - G @ prior.covariance @ G.T) @ undo.T
