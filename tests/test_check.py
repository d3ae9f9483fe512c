"""The ladder: a right filter passes, every seeded mistake is caught, and it says by what."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from seeded_again import Jointly, jointly
from simulated import past_points
from textbook import MISTAKES, TextbookEkf

from ekfslam import Ekf
from ekfslam.cli.printing import print_report
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.estimates import Estimate, LandmarkEstimates, Trajectory
from ekfslam.registry import resolve
from ekfslam.validation import check

# Small, so that the textbook's dense filter is fast; and with bearings that jump between pi and
# -pi at any noise, which only a wrap at every difference survives.
ASTERN = past_points(
    "Straight on, with two landmarks astern.",
    [[-2, 0], [-5, 0], [3, 3], [6, -4], [12, 3]],
    steps=40,
)

# Which rungs find it. Rungs 1 and 3 read the filter's own linearisations; rung 5 needs none.
CAUGHT = {
    "transposed-jacobian": {1, 4, 5},
    "no-cross-covariance": {3, 5},
    "no-wrap": {5},
    "sqrt-q": {1, 5},
    "wrong-noise": {5},
}


@pytest.fixture
def astern(tmp_path):
    (tmp_path / "astern.toml").write_text(ASTERN)
    return (str(tmp_path / "astern.toml"),)


class Hidden:
    """An estimator that does not tell its linearisations."""

    name = "hidden"

    def __init__(self, inner):
        self.estimate = inner.estimate


class Tampered(Ekf):
    """The filter, with something done to what it says."""

    def __init__(self, estimate=lambda e: e, linear=lambda linear: linear):
        super().__init__()
        object.__setattr__(self, "_acts", (estimate, linear))

    def estimate(self, dataset, progress=None):
        return self._acts[0](super().estimate(dataset))

    def linearizations(self, dataset):
        estimate, linear = super().linearizations(dataset)
        return self._acts[0](estimate), self._acts[1](linear)


def outcomes(report, outcome):
    return {rung.number for rung in report.rungs if rung.outcome == outcome}


def measured(report, number):
    return [rung.measured for rung in report.rungs if rung.number == number]


# Right filters ----------------------------------------------------------------------------------


def test_the_ekf_passes_far_below_the_bounds():
    report = check("ekf")
    assert report.estimator == "ekf"
    assert report.passed
    assert outcomes(report, "pass") == {1, 2, 3, 4, 5}
    assert [rung.scenario for rung in report.rungs] == 7 * ["cloister", "loop-15"]
    # Central differences err by 1e-16 / 1e-6 times what is differentiated; the rest is round-off.
    for number, reached in ((1, 1e-8), (2, 1e-12), (3, 1e-11), (4, 1e-10)):
        assert max(measured(report, number)) < reached
        bounds = {rung.bound for rung in report.rungs if rung.number == number}
        assert bounds == {{1: 1e-6, 2: 1e-9, 3: 1e-9, 4: 1e-8}[number]}
    assert min(measured(report, 5)) > 1.75
    # Right, and inconsistent by its nature: by what theory says, and not by round-off.
    assert outcomes(report, "inconsistent") == {6, 7}
    assert report.consistent is False
    assert min(measured(report, 6) + measured(report, 7)) > 0.05
    assert all(rung.detail for rung in report.rungs)


CONSISTENT = {
    "iekf": False,
    "ekf-ideal": True,
    "ekf-fej": True,
    "ekf-oc": False,  # learns of its position when it stands still
    "ekf-ri": True,
    "ekf-robocentric": True,
}


@pytest.mark.parametrize("name", CONSISTENT)
def test_the_family_passes_and_is_as_consistent_as_theory_says(name, astern):
    report = check(name, scenarios=astern)
    assert report.passed
    assert report.consistent is CONSISTENT[name]
    assert outcomes(report, "inconsistent") == {"iekf": {6, 7}, "ekf-oc": {6}}.get(name, set())


@pytest.mark.parametrize("update", ["joint", "sequential"])
def test_the_textbook_filter_passes(update, astern):
    report = check(TextbookEkf(update=update), scenarios=astern)
    assert report.passed
    assert outcomes(report, "pass") == {1, 2, 3, 4, 5}


EASY = """
description = "A few landmarks, all in view: the filter is next to the smoother."
[world]
kind = "cloister"
x = [-4, 4]
y = [-4, 4]
n = 3
[path]
kind = "controls"
start = [0, -2, 0]
controls = [[0.1, 0.05]]
repeat = 60
[motion]
kind = "advance-turn"
sigmas = [0.01, 0.02]
slip = 0.001
[[sensors]]
kind = "range-bearing"
sigmas = [0.1, "1 deg"]
"""


@pytest.mark.parametrize("seed", range(4))
def test_a_right_filter_passes_on_any_draw(seed, astern, tmp_path):
    """Also where the gaps are so small that a floor under the smoother's noise would show."""
    (tmp_path / "easy.toml").write_text(EASY)
    assert check("ekf", scenarios=(*astern, str(tmp_path / "easy.toml")), seed=seed).passed


def test_the_same_seed_gives_the_same_report(astern):
    first, second, other = (check("ekf", scenarios=astern, seed=seed) for seed in (3, 3, 4))
    assert first == second
    assert first != other


# Mistakes ---------------------------------------------------------------------------------------


def test_every_mistake_is_looked_for():
    assert set(CAUGHT) == set(MISTAKES)


@pytest.mark.parametrize("mistake", CAUGHT)
def test_a_mistake_is_caught(mistake, astern):
    report = check(TextbookEkf(mistake), scenarios=astern)
    assert not report.passed
    assert outcomes(report, "fail") == CAUGHT[mistake]


@pytest.mark.parametrize("mistake", CAUGHT)
def test_a_mistake_is_caught_in_a_filter_that_hides_its_linearizations(mistake, astern):
    report = check(Hidden(TextbookEkf(mistake)), scenarios=astern)
    assert outcomes(report, "does not apply") == {1, 3}
    assert outcomes(report, "fail") == CAUGHT[mistake] - {1, 3}
    assert not report.passed


def test_wrong_noise_is_caught_on_the_scenarios_of_the_package():
    class Doubting(Ekf):
        """Takes every sensor for half as good as it says."""

        def estimate(self, dataset, progress=None):
            doubted = tuple(replace(s, covariance=4 * s.covariance) for s in dataset.sensors)
            return super().estimate(replace(dataset, sensors=doubted))

    failed = [r for r in check(Hidden(Doubting())).rungs if r.outcome == "fail"]
    assert [(r.number, r.scenario) for r in failed] == [(5, "cloister"), (5, "loop-15")]
    assert max(r.measured for r in failed) < 1.4


class NearlyRight:
    """The smoother's answer, off by what a wrong Jacobian did to a filter on `cloister`.

    There 1 / sqrt(q) for 1 / q left a gap of 17 mm times the noise beneath a second-order gap of
    45 cm times its square.
    """

    def estimate(self, dataset):
        best = resolve("gtsam-batch", marginals=False).estimate(dataset)
        scale = np.sqrt(dataset.sensors[0].covariance[0, 0]) / 0.1
        aside = np.array([0.0168 * scale + 0.448 * scale**2, 0.0, 0.0])
        return replace(
            best,
            smoothed=Trajectory(best.smoothed.poses + aside),
            landmarks=replace(best.landmarks, positions=best.landmarks.positions + aside[:2]),
        )


def test_a_small_gap_of_first_order_is_found_beneath_a_large_one_of_second(astern):
    (rung,) = [r for r in check(NearlyRight(), scenarios=astern).rungs if r.number == 5]
    assert rung.outcome == "fail"
    assert rung.measured < 1.6


def nudged(size):
    """The final pose off by so many metres."""

    def act(estimate):
        poses = estimate.online.poses.copy()
        poses[-1, 0] += size
        return replace(estimate, online=Trajectory(poses, estimate.online.covariances))

    return act


def swollen(size):
    """The joint covariance off by such a share."""
    return lambda e: replace(e, joint_covariance=(1 + size) * e.joint_covariance)


def skewed(size):
    """One Jacobian off in one entry."""

    def act(linear):
        jacobian = linear.jacobian.copy()
        jacobian[-1, 0, 0] += size
        return replace(linear, jacobian=jacobian)

    return act


def turned(size):
    """The first motion Jacobian off in one entry."""

    def act(linear):
        jacobian = linear.motion_jacobian.copy()
        jacobian[5, 0, 2] += size
        return replace(linear, motion_jacobian=jacobian)

    return act


@pytest.mark.parametrize(
    ("subject", "rung"),
    [
        (Tampered(linear=skewed(3e-6)), 1),
        (Tampered(linear=turned(3e-6)), 1),
        (Tampered(estimate=nudged(3e-9)), 2),
        (Tampered(estimate=nudged(3e-9)), 3),
        (Tampered(estimate=swollen(3e-9)), 3),
        (Tampered(linear=skewed(1e-4)), 3),
        (Tampered(estimate=nudged(3e-8)), 4),
    ],
)
def test_a_rung_is_as_sharp_as_its_bound(subject, rung, astern):
    report = check(subject, scenarios=astern)
    assert rung in outcomes(report, "fail")


def test_what_is_not_finite_fails(astern):
    def lost(estimate):
        poses = np.full_like(estimate.online.poses, np.nan)
        return replace(estimate, online=Trajectory(poses, estimate.online.covariances))

    report = check(Hidden(Tampered(estimate=lost)), scenarios=astern)
    assert outcomes(report, "fail") == {2, 4, 5, 6}


# What does not apply ----------------------------------------------------------------------------


class Raising:
    def __init__(self, error):
        self.error = error

    def estimate(self, dataset):
        raise self.error


def test_who_raises_has_failed_and_the_reason_is_one_line(astern):
    report = check(Raising(RuntimeError("in two\nlines")), scenarios=astern)
    assert outcomes(report, "fail") == {2, 4, 5, 6, 7}
    assert report.consistent is False
    failed = {rung.detail for rung in report.rungs if rung.outcome == "fail"}
    assert failed == {"raised RuntimeError: in two lines"}


def test_what_a_filter_raises_is_told_once_with_its_place(astern, capsys):
    class Stumbling:
        def __init__(self, prior):
            self.pose, self.steps = prior.mean, 0

        def predict(self, increment, covariance):
            self.steps += 1

        def observe(self, observations):
            if self.steps > 3:
                raise KeyError(7)

    print_report(check(Stumbling, scenarios=astern))
    shown = capsys.readouterr().out
    place = r"raised KeyError: 7 \(test_check.py, line \d+, in observe, at step 3\)"
    assert len(re.findall(place, shown)) == 1
    assert shown.count("raised the same") == 6
    assert "consistent" not in shown  # nothing was measured
    assert shown.endswith("FAILED\n")


@pytest.mark.parametrize("status", ["failed", "skipped"])
def test_the_status_of_an_estimate_counts(status, astern):
    subject = Tampered(estimate=lambda e: replace(e, status=status, message="because"))
    outcome = {"failed": "fail", "skipped": "does not apply"}[status]
    rungs = [r for r in check(Hidden(subject), scenarios=astern).rungs if r.number not in (1, 3)]
    assert {rung.outcome for rung in rungs} == {outcome}
    assert all("because" in rung.detail for rung in rungs)


def test_what_does_not_apply_counts_for_neither(astern):
    report = check("dead-reckoning", scenarios=astern)
    assert report.passed
    assert outcomes(report, "does not apply") == {1, 3, 5, 6, 7}
    assert report.consistent is None
    details = {rung.number: rung.detail for rung in report.rungs}
    assert "linearizations(dataset)" in details[1]
    assert "Linearizations" in details[3]
    assert "landmarks" in details[5]
    assert "innovations" in details[6]
    assert details[6] == details[7]
    assert all(np.isnan(r.measured) for r in report.rungs if r.outcome == "does not apply")


def test_nothing_that_applies_is_no_pass(astern):
    report = check(Raising(UnsupportedError("three robots only")), scenarios=astern)
    assert outcomes(report, "does not apply") == {1, 2, 3, 4, 5, 6, 7}
    assert not report.passed
    assert report.consistent is None


def test_a_filter_without_joint_covariance_is_told_what_is_missing(astern):
    subject = Tampered(estimate=lambda e: replace(e, joint_covariance=None))
    report = check(subject, scenarios=astern)
    assert outcomes(report, "does not apply") == {3}
    assert "joint covariance" in next(r.detail for r in report.rungs if r.number == 3)


def test_landmarks_with_numbers_of_their_own_cannot_be_compared(astern):
    """A filter that associates for itself is not to blame for its numbering."""
    report = check(Ekf(association="nearest"), scenarios=astern)
    assert outcomes(report, "fail") == set()
    assert "association" in next(r.detail for r in report.rungs if r.number == 2)


def test_a_smoother_passes_what_applies(astern):
    report = check("gtsam-batch", scenarios=astern)
    assert report.passed
    assert outcomes(report, "does not apply") == {1, 3, 6, 7}


def test_a_map_without_landmarks_does_not_pass_for_the_small_noise(astern):
    def forgetful(estimate):
        few = estimate.landmarks
        return replace(
            estimate,
            landmarks=LandmarkEstimates(few.ids + 100, few.positions, few.covariances),
        )

    report = check(Hidden(Tampered(estimate=forgetful)), scenarios=astern)
    assert 5 in outcomes(report, "fail")


# The report, and what can be asked for ----------------------------------------------------------


def test_the_report_as_a_table(astern):
    report = check("dead-reckoning", scenarios=astern)
    table = report.table
    assert list(table.columns) == [
        "number",
        "name",
        "scenario",
        "outcome",
        "measured",
        "bound",
        "detail",
    ]
    assert table["number"].tolist() == [1, 2, 3, 4, 5, 6, 7]
    assert table["outcome"].tolist() == [rung.outcome for rung in report.rungs]
    assert report._repr_html_().count("<tr") == 8
    assert [rung.number for rung in report.rungs if rung.at_least] == [5]
    assert [rung.number for rung in report.rungs if rung.of_consistency] == [6, 7]


@pytest.mark.parametrize(
    ("estimator", "scenarios", "error"),
    [
        ("efk", ("loop-15",), UnknownNameError),
        ("ekf", ("lop-15",), UnknownNameError),
        (Estimate("x", "y"), ("loop-15",), InputError),
    ],
)
def test_what_cannot_be_found(estimator, scenarios, error):
    with pytest.raises(error):
        check(estimator, scenarios=scenarios)


def test_a_filter_of_ranges_and_bearings_alone_is_asked_what_it_can_answer():
    report = check(jointly())
    assert {rung.scenario for rung in report.rungs} == {"cloister", "loop-15-rb"}
    passed = {(rung.number, rung.scenario) for rung in report.rungs if rung.outcome == "pass"}
    assert passed == {(n, s) for n in (2, 4, 5) for s in ("cloister", "loop-15-rb")}


def test_a_filter_that_does_not_say_that_it_is_for_ranges_and_bearings_is_told_to():
    class Silent(Jointly):
        kinds = None

    report = check(Silent)
    failed = {rung.scenario for rung in report.rungs if rung.outcome == "fail"}
    assert failed == {"loop-15"}
    first = report.findings[0]
    assert (first.stage, first.mistakes) == ("sensor", ("view-not-read",))
    assert 'kinds = ("range-bearing",)' in first.usually
