"""The rungs of the ladder with several robots and sensors, inverse depths, and what waits."""

from __future__ import annotations

from dataclasses import replace

import family_mistakes as wrong
import numpy as np
import pytest
import textbook_family as book
from problems import rows_kept

from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Decision, Linearizations
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.options import UPDATES
from ekfslam.registry import resolve
from ekfslam.simulation import simulate
from ekfslam.validation import check, gauge, rungs

SCENARIOS = ("team", "two-sensors", "cloister-bearing", "cloister-range", "hand-held")
BAR = 1e-9


class Tampered(Ekf):
    """The filter, with something done to the linear models that it tells."""

    def __init__(self, act, **options):
        super().__init__(**options)
        object.__setattr__(self, "_act", act)

    def linearizations(self, dataset):
        estimate, linear = super().linearizations(dataset)
        return estimate, self._act(linear)


def climb(rung, name, subject=None, dataset=None, **options):
    """What a rung measures on a scenario."""
    dataset = simulate(name, seed=1) if dataset is None else dataset
    return rung(Ekf(**options) if subject is None else subject, dataset, name, 1)


# 1 ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCENARIOS)
def test_jacobians_are_central_differences(name):
    assert climb(rungs.jacobians, name).value < BAR


def test_jacobians_of_naive_priors_and_infinite_uncertainty_too():
    for name, options in (
        ("cloister-bearing", {"bearings": "naive"}),
        ("cloister-range", {"ranges": "naive"}),
        ("two-sensors", {"initiation": "infinite"}),
        ("team", {"initiation": "allocated"}),
    ):
        assert climb(rungs.jacobians, name, **options).value < BAR


@pytest.mark.parametrize(
    ("name", "event", "size", "said"),
    [
        ("team", Linearizations.OBSERVED, 2, "observations of the sensor (2 coordinates)"),
        ("team", Linearizations.OBSERVED, 3, "observations of the sensor (3 coordinates)"),
        ("team", Linearizations.CREATED, 2, "new landmarks of the sensor (2 coordinates)"),
        ("two-sensors", Linearizations.OBSERVED, 4, "observations of the "),
        ("two-sensors", Linearizations.CREATED, 4, "new landmarks of the camera (4 coordinates)"),
        ("two-sensors", Linearizations.CONVERTED, 4, "conversions to points"),
        ("cloister-range", Linearizations.OBSERVED, 2, "observations of the sensor"),
    ],
)
def test_a_jacobian_that_is_off_is_found_and_named(name, event, size, said):
    def act(linear):
        jacobian = linear.jacobian.copy()
        at = np.flatnonzero((linear.event == event) & (linear.size == size))[-1]
        jacobian[at, 0, 3 if event == Linearizations.CONVERTED else 2] += 1e-5
        return replace(linear, jacobian=jacobian)

    measurement = climb(rungs.jacobians, name, Tampered(act))
    assert measurement.value == pytest.approx(1e-5, rel=1e-3)
    assert said in measurement.detail


# 3 ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_linear_oracle_gives_means_and_joint_covariance(name, update):
    assert climb(rungs.oracle, name, update=update).value < BAR


@pytest.mark.parametrize("initiation", ["infinite", "allocated"])
@pytest.mark.parametrize("name", ["team", "loop-15"])
def test_also_from_infinity(name, initiation):
    """Where a variance of 1e4 leaves twelve digits; the oracle has the same prior."""
    assert climb(rungs.oracle, name, initiation=initiation, variance=1e4).value < BAR


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("two-sensors", {"matching": "one-by-one"}),
        ("cloister-bearing", {"bearings": "naive"}),
        ("cloister-range", {"ranges": "naive"}),
    ],
)
def test_also_with_other_ways_to_match_and_to_start(name, options):
    assert climb(rungs.oracle, name, **options).value < BAR


@pytest.mark.parametrize("name", ["team", "cloister-bearing", "two-sensors"])
def test_also_after_deletions(name):
    """Landmarks go when their sightings are far off, and come in anew where they now are."""
    dataset = simulate(name, seed=1)
    seen, values = dataset.observations, dataset.observations.values.copy()
    often = [i for i in np.unique(seen.landmark) if (seen.landmark == i).sum() > 40][:6]
    rows = np.isin(seen.landmark, often) & (seen.step > 0.6 * dataset.poses)
    values[rows, 0] += 0.8
    moved = replace(dataset, observations=replace(seen, values=values))
    options = {"known_gate": 0.9999, "corrupt": 2}
    decision = Ekf(**options).estimate(moved).innovations.decision
    again = (decision == Decision.NEW).sum() - len(np.unique(seen.landmark[seen.landmark >= 0]))
    assert again >= 3
    assert climb(rungs.oracle, name, dataset=moved, **options).value < BAR


def test_also_of_a_landmark_that_is_gone_at_the_end():
    dataset = simulate("team", seed=1)
    middle = dataset.observations.step < 150
    gone = np.unique(dataset.observations.landmark[middle])[1:4]
    left = rows_kept(dataset, middle | ~np.isin(dataset.observations.landmark, gone))
    estimate = Ekf(forget=5).estimate(left)
    assert not np.isin(gone, estimate.landmarks.ids).any()
    assert climb(rungs.oracle, "team", dataset=left, forget=5).value < BAR


@pytest.mark.parametrize(
    ("event", "column"),
    [
        (Linearizations.OBSERVED, "innovation"),
        (Linearizations.CREATED, "noise"),
        (Linearizations.CONVERTED, "innovation"),
    ],
)
def test_a_linear_model_that_was_not_used_shows(event, column):
    def act(linear):
        changed = getattr(linear, column).copy()
        at = np.flatnonzero(linear.event == event)[10]
        changed[at, 0] += 1e-3
        return replace(linear, **{column: changed})

    assert climb(rungs.oracle, "two-sensors", Tampered(act)).value > 100 * BAR


def test_a_bank_of_hypotheses_is_no_linear_model():
    with pytest.raises(UnsupportedError, match="not one linear model"):
        climb(rungs.oracle, "cloister-range", ranges="bank")


# 2, 4 and 5 ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCENARIOS)
def test_moving_the_world_moves_the_answer(name):
    assert climb(rungs.rigid_motion, name).value < 1e-8


def test_moving_the_world_moves_a_bank_of_hypotheses_too():
    """Its hypotheses stand in the directions of the robot, which turns with the world."""
    assert climb(rungs.rigid_motion, "cloister-range", ranges="bank", hypotheses=6).value < 1e-8


def test_a_world_that_does_not_move_its_inverse_depths_is_found():
    class Still(Ekf):
        """Forgets to turn the direction of what is undetermined."""

        def estimate(self, dataset, progress=None):
            estimate = super().estimate(dataset)
            ahead = estimate.landmarks.inverse_depth.copy()
            ahead[:, 2] = 0.0
            return replace(estimate, landmarks=replace(estimate.landmarks, inverse_depth=ahead))

    short = simulate("cloister-bearing", seed=1)
    short = rows_kept(short, short.observations.step < 4)
    measurement = climb(rungs.rigid_motion, "cloister-bearing", Still(), short)
    assert measurement.value > 0.1
    assert "inverse depths" in measurement.detail


@pytest.mark.parametrize("name", ["team", "hand-held", "cloister-range"])
def test_data_without_noise_return_the_truth(name):
    assert climb(rungs.zero_noise, name).value < BAR


@pytest.mark.parametrize("name", ["team", "hand-held"])
def test_the_gap_to_the_batch_shrinks_with_the_square_of_the_noise(name):
    assert climb(rungs.small_noise, name).value > 1.7


def test_what_a_prior_or_waiting_rules_out():
    for rung, name, said in (
        (rungs.zero_noise, "two-sensors", "camera reports bearing alone: the prior"),
        (rungs.small_noise, "cloister-bearing", "sensor reports bearing alone"),
        (rungs.small_noise, "cloister-range", "sensor reports range alone"),
    ):
        with pytest.raises(UnsupportedError, match=said):
            climb(rung, name)


def test_the_whole_ladder_on_a_team():
    report = check("ekf", scenarios="team")
    assert report.passed
    outcomes = [rung.outcome for rung in report.rungs]
    assert outcomes == 5 * ["pass"] + ["inconsistent", "does not apply"]
    assert "team" in report.rungs[-1].detail


# 6 and 7 ------------------------------------------------------------------------------------------


CONSISTENT = [book.Ideal, book.FirstEstimates, book.RightInvariant, book.Robocentric]
LEARNS = [wrong.FejAugmentsAtUpdated, wrong.FejMovesFromUpdated, wrong.OcForgetsDelta]


@pytest.mark.parametrize("name", ["cloister", "loop-15"])
@pytest.mark.parametrize("kind", CONSISTENT)
def test_a_consistent_filter_learns_nothing_that_cannot_be_learnt(kind, name):
    assert climb(gauge.standing_still, name, book.Textbook(kind)).value < 1e-12
    assert climb(gauge.gauge, name, book.Textbook(kind)).value < 1e-9


@pytest.mark.parametrize("kind", [book.Standard, *LEARNS])
def test_what_a_filter_makes_of_the_prior_shows(kind):
    measurement = climb(gauge.gauge, "loop-15", book.Textbook(kind))
    assert measurement.value > 0.01
    assert "whitened innovations" in measurement.detail


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (book.Standard, "covariances"),
        (book.ObservabilityConstrained, "covariances"),
        (wrong.RiKeepsPrior, "covariances"),
        (wrong.OcForgetsDelta, "covariances"),
    ],
)
def test_what_is_learnt_standing_still_shows(kind, said):
    measurement = climb(gauge.standing_still, "cloister", book.Textbook(kind))
    assert measurement.value > 0.01
    assert said in measurement.detail


def test_a_pose_that_moves_where_nobody_does_shows():
    class Drifting(Ekf):
        def estimate(self, dataset, progress=None):
            estimate = book.Textbook(book.RightInvariant).estimate(dataset)
            poses = estimate.online.poses.copy()
            poses[-1, 0] += 1e-6
            return replace(estimate, online=replace(estimate.online, poses=poses))

    measurement = climb(gauge.standing_still, "loop-15", Drifting())
    assert measurement.value == pytest.approx(1e-6)
    assert "poses" in measurement.detail


def test_the_prior_may_not_change_which_sightings_are_used():
    class Choosy:
        """Drops the innovations of the first ten steps if it is unsure of the start."""

        def estimate(self, dataset):
            estimate = book.Textbook(book.RightInvariant).estimate(dataset)
            if dataset.prior.covariance[0, 0] < 0.1:
                return estimate
            innovation = estimate.innovations.innovation.copy()
            innovation[dataset.observations.step < 10] = np.nan
            return replace(
                estimate, innovations=replace(estimate.innovations, innovation=innovation)
            )

    measurement = climb(gauge.gauge, "loop-15", Choosy())
    assert measurement.value > 10
    assert "under one of the priors" in measurement.detail


@pytest.mark.parametrize("name", ["cloister-bearing", "cloister-range", "two-sensors", "hand-held"])
def test_partial_views_know_the_gauge_too(name):
    """A robot that stands still needs a sensor that shows where a landmark is."""
    assert 1e-3 < climb(gauge.gauge, name).value < 100
    if name.startswith("cloister"):
        with pytest.raises(UnsupportedError, match="where landmarks are"):
            climb(gauge.standing_still, name)


def test_consistency_is_asked_of_filters_alone():
    dataset = simulate("loop-15", seed=1)
    for rung in (gauge.standing_still, gauge.gauge):
        with pytest.raises(UnsupportedError, match="innovations"):
            climb(rung, "loop-15", resolve("dead-reckoning"), dataset)
    with pytest.raises(UnsupportedError, match="robot"):
        climb(gauge.gauge, "team")
    recorded = replace(dataset, true_map=None)
    with pytest.raises(UnsupportedError, match="truth"):
        climb(gauge.standing_still, "loop-15", dataset=recorded)


def test_a_smoother_that_tells_no_innovations_is_not_asked_for_them():
    report = check("gtsam-isam2", "cloister")
    last = report.rungs[-1]
    assert (last.number, last.outcome) == (7, "does not apply")
    assert "innovations" in last.detail


def test_a_filter_that_samples_is_asked_what_fits_it():
    """Noise that it draws itself is no mistake; a moved world moves the answer all the same."""
    report = check("fastslam2(particles=5)", scenarios="cloister")
    outcomes = {rung.number: rung.outcome for rung in report.rungs}
    assert outcomes == {n: "pass" if n == 4 else "does not apply" for n in range(1, 8)}
    assert report.passed
    assert report.consistent is None
