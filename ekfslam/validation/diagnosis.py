"""What the mistake in a filter most likely is, in words.

The filter is run on tiny probes (`ekfslam.validation.probes`), stage by stage, and its numbers are
held against those of a small textbook filter that makes classic mistakes on request. Where they
are equal to round-off, the mistake is named; it stays switched on for the stages that follow, so
that several can be found. Where no known mistake gives the numbers, the first stage that is wrong
is told, without a name.

What differs from a plain EKF in second order of the noise alone (another point of linearisation,
another order of the sightings, iterations, a smoother) is no mistake, and is not mentioned.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any, NamedTuple

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import FAILED, SKIPPED
from ekfslam.registry import Estimator, resolve
from ekfslam.validation.catalogue import OWN_NOISE
from ekfslam.validation.gates import Gate, measured_gate
from ekfslam.validation.matching import (
    Case,
    Charge,
    Gap,
    Hypothesis,
    fits,
    gap_between,
    gap_of,
    grown,
    in_some_style,
    own_noise,
)
from ekfslam.validation.mistakes import GATE, LINES, MOUNT
from ekfslam.validation.probes import ANGULAR, NOISE, PROBES, Probe, with_last
from ekfslam.validation.suspects import Answer, run


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a filter.

    Attributes
    ----------
    stage : str
        Of the filter.
    mistakes : tuple of str
        Its name; several if the probes cannot tell them apart, and none if it is not a known one.
    says : str
        What the filter does.
    usually : str
        What that usually comes from; empty if there is no name.
    look : str
        The line of the algorithm to look at.
    evidence : str
        The probe, and by how much the filter is off with and without the mistake.
    """

    stage: str
    mistakes: tuple[str, ...]
    says: str
    usually: str
    look: str
    evidence: str

    @property
    def named(self) -> bool:
        """Whether it is a known mistake."""
        return bool(self.mistakes)

    @property
    def details(self) -> dict[str, str]:
        """What there is to say besides, by heading."""
        whole = {"usually": self.usually, "look at": self.look, "evidence": self.evidence}
        return {heading: text for heading, text in whole.items() if text}

    def _repr_html_(self) -> str:
        rest = "".join(f"<br>{head}: {escape(text)}" for head, text in self.details.items())
        return f"<p><b>{escape(self.stage)}</b>: {escape(self.says)}{rest}</p>"


class Sharpness(NamedTuple):
    """At which scale of the uncertainty numbers are held against each other, and how sharply.

    Attributes
    ----------
    scale : float
    tolerance : float
        In sigmas.
    """

    scale: float
    tolerance: float


EXACT = Sharpness(1.0, 1e-8)  # round-off, and a good deal more
FIRST_ORDER = Sharpness(1e-3, 1e-2)  # right filters agree here, up to a few scales
FINER = 1 / 16  # where a deviation of second order
NEGLIGIBLE = 1e-5  # sigma: what stands for infinity or zero, and no mistake
UNEASY = 0.1  # standing still, with a share of the noise of moving
SHRUNK = 1 / 4  # has become smaller than this


def diagnose(estimator: str | Any) -> tuple[Finding, ...]:
    """Say what is wrong with a filter, and what the mistake most likely is.

    Parameters
    ----------
    estimator : str or object
        As `ekfslam.check` takes it. It need not tell more than its online poses; the more it tells
        (covariances, landmarks, the joint covariance), the more can be told apart.

    Returns
    -------
    tuple of Finding
        In the order of the stages of a filter, the mount last. Empty for a right filter, and for
        what cannot be judged: smoothers without an online series, filters of particles.

    Raises
    ------
    UnknownNameError, InputError
        For an estimator that cannot be found.
    """
    subject = resolve(estimator)
    for kind in NOISE:
        trial = _Trial(subject, kind, EXACT).climbed()
        if trial.judged:
            if trial.unnamed:
                rough = _Trial(subject, kind, FIRST_ORDER).climbed()
                trial = rough if len(rough.unnamed) < len(trial.unnamed) else trial
            return trial.findings
    return ()


class _Trial:
    """One pass over the probes.

    `hypotheses` explain all of `explained`; `evidence` has one text for each charge of them.
    """

    def __init__(self, subject: Estimator, kind: str, sharpness: Sharpness) -> None:
        self.subject, self.kind, self.sharpness = subject, kind, sharpness
        self.hypotheses = [Hypothesis()]
        self.explained: list[Case] = []
        self.evidence: list[str] = []
        self.unnamed: dict[str, Finding] = {}
        self.gate: tuple[Finding, ...] = ()
        self.judged = False

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All there are; what only mounted sensors bring out stands last."""
        found = (*self._named(), *self.unnamed.values(), *self.gate)
        return tuple(sorted(found, key=lambda finding: finding.stage == MOUNT))

    def climbed(self) -> _Trial:
        """After all probes; those that go through a stage that is wrong would say nothing new."""
        self._judge_all(PROBES)
        self._measure_gate()
        self._judge_all(ANGULAR)
        return self

    def _judge_all(self, probes: tuple[Probe, ...]) -> None:
        for probe in probes:
            if not (probe.needs | {probe.stage}) & self.unnamed.keys():
                case = self._case(probe, self.sharpness.scale)
                if case is not None:
                    self.judged |= bool(probe.looks)
                    self._judge(case)

    # What the filter says -----------------------------------------------------------------------

    def _answer(self, dataset: Dataset) -> Answer:
        estimate = self.subject.estimate(dataset)
        if estimate.status in (FAILED, SKIPPED):
            raise UnsupportedError(estimate.message)
        if estimate.effective_samples is not None:
            raise UnsupportedError("particles are drawn at random")
        answer = Answer.of(estimate)
        known = np.isin(answer.ids, dataset.observations.landmark).all()
        return answer if known and estimate.association in ("", "known") else answer.without_map()

    def _case(self, probe: Probe, scale: float) -> Case | None:
        """A probe with its answer; None for what the filter cannot do or does not attempt."""
        dataset = probe.dataset(self.kind, scale)
        try:
            told = self._answer(dataset)
        except Exception:  # what it raises is on the rungs of the ladder
            return None
        if told.poses.shape != (dataset.poses, 3):
            return None
        right = run(dataset, {})[0]
        if probe.looks and not len(told.ids):  # without a map, and nothing learnt: dead reckoning
            blind = run(with_last(dataset, None, whole=True), {})[0]
            if gap_between(told, blind, right).size <= self.sharpness.tolerance:
                return None
        return Case(probe, dataset, told, right)

    # What explains it ---------------------------------------------------------------------------

    def _judge(self, case: Case) -> None:
        tolerance, cases = self.sharpness.tolerance, [*self.explained, case]
        still = [each for each in self.hypotheses if fits([case], each, tolerance)]
        still = still or in_some_style(cases, self.hypotheses, tolerance)
        if still:
            self.hypotheses, self.explained = still, cases
            return
        before = self._least_gap(case)
        if before.size <= NEGLIGIBLE:
            return
        near = [each for each in self.hypotheses if self._of_second_order(case.probe, each)]
        if near:
            self.hypotheses = near
            return
        most = 2 if self.sharpness is EXACT else 1
        more = grown(cases, self.hypotheses, tolerance, most)
        more = [each for each in more if self._holds(each)]
        if not more:
            self.unnamed[case.probe.stage] = _without_name(case, before)
            return
        self.hypotheses, self.explained = more, cases
        after = self._least_gap(case)
        text = f"{_off(case, before)}; from one with this mistake, by {after.size:.0e}"
        self.evidence += [text] * (len(more[0].charges) - len(self.evidence))

    def _least_gap(self, case: Case) -> Gap:
        return min(gap_of(case, each.wrong) for each in self.hypotheses)

    def _of_second_order(self, probe: Probe, hypothesis: Hypothesis) -> bool:
        """Whether the deviation from a hypothesis vanishes with the noise: no further mistake.

        With some noise, since estimators may have ways of their own where there is none at all.
        """
        scale, uneasy = self.sharpness.scale, probe._replace(rest=UNEASY)
        cases = [self._case(uneasy, each) for each in (scale, FINER * scale)]
        sizes = [gap_of(case, hypothesis.wrong).size for case in cases if case is not None]
        return len(sizes) == 2 and sizes[1] <= max(SHRUNK * sizes[0], NEGLIGIBLE)

    def _holds(self, hypothesis: Hypothesis) -> bool:
        """Whether a noise that is taken for the filter's own is the same when less is given."""
        for charge in hypothesis.charges:
            if charge.mistake in OWN_NOISE.values() and not self._is_own(charge):
                return False
        return True

    def _is_own(self, charge: Charge) -> bool:
        (switch, noise), *_ = charge.switches
        for probe in PROBES:
            case = self._case(probe, 0.5 * self.sharpness.scale)
            for which, other in own_noise(case.dataset, case.told) if case else ():
                if switch == which:
                    return bool(np.allclose(noise, other, rtol=1e-6, atol=1e-9))
        return False

    # In words -----------------------------------------------------------------------------------

    def _named(self) -> tuple[Finding, ...]:
        """One finding for each charge; what cannot be told apart is in one of them."""
        found = []
        for place, evidence in enumerate(self.evidence):
            alike: dict[str, Charge] = {}
            for hypothesis in self.hypotheses:
                charge = hypothesis.charges[place]
                alike.setdefault(charge.mistake.name, charge)
            first = next(iter(alike.values()))
            found.append(
                Finding(
                    first.mistake.stage,
                    tuple(alike),
                    "your numbers equal those of a filter that "
                    + ", or of one that ".join(charge.says for charge in alike.values()),
                    first.usually,
                    first.mistake.look,
                    evidence,
                )
            )
        return tuple(found)

    def _measure_gate(self) -> None:
        wrong = self.hypotheses[0].wrong
        try:
            gate = measured_gate(self._answer, self.kind, wrong)
        except Exception:  # likewise
            return
        if gate is not None:
            self.judged = True
            self.hypotheses = [each._replace(gate=gate.threshold) for each in self.hypotheses]
            self.gate = (_of_gate(gate),)


def _without_name(case: Case, gap: Gap) -> Finding:
    """The first stage that is wrong, if no known mistake gives its numbers."""
    stage = case.probe.stage
    return Finding(
        stage,
        (),
        f"this is the first stage that is wrong, by a mistake that has no name here: "
        f"{gap.where} is off",
        "",
        LINES[stage],
        f"{_off(case, gap)}, and that does not vanish with the noise",
    )


def _off(case: Case, gap: Gap) -> str:
    unit = "of the variances" if "covariance" in gap.where else "sigma"
    size = f"{gap.size:.2g} {unit}" if np.isfinite(gap.size) else "no finite number"
    return f'on "{case.probe.name}" {gap.where} differs from a right filter by {size}'


def _of_gate(gate: Gate) -> Finding:
    """What a gate means; it has a name only if it is the root or the square of a usual one."""
    beyond = f"it rejects sightings beyond a squared distance of {gate.threshold:.4g}"
    # Of nearly all, the share inside would be rounded to all.
    lost = f"where {100 * (1.0 - gate.probability):.2g} % of right ones are"
    confused = gate.confused()
    if confused is None:
        others = ", ".join(f"{each:.3g}" for each in gate.squared)
        return Finding(
            GATE,
            (),
            f"{beyond}, {lost}: what is rejected is missing in the answer",
            "",
            "the gate, if there need be one where identities are known",
            f"rejected in three directions from squared Mahalanobis distances of {others}",
        )
    what, usual = confused
    side, name = (
        ("squared distance against the root of the", "gate-root")
        if what == "root"
        else ("distance against the", "gate-square")
    )
    return Finding(
        GATE,
        (name,),
        f"the filter holds the {side} quantile of squared distances: {beyond}, {lost}",
        f"squared against unsquared: {gate.threshold:.4g} is the {what} of {usual:.4g}",
        "the gate: nu' S^-1 nu, which is squared, against a chi-square quantile",
        "measured by moving one sighting away until it no longer counts",
    )
