"""The statistics of the assertions, against brute force and the definition of a false alarm."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import ekfslam
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.simulation import load_scenario, scenario_hash
from ekfslam.testing import assert_accuracy, assert_consistent, assert_not_worse
from ekfslam.testing.assertions import bounded
from ekfslam.testing.metrics import MORE
from ekfslam.testing.pairing import Pair, not_worse
from ekfslam.testing.references import DIGITS
from ekfslam.testing.runs import problem_of
from ekfslam.testing.statistics import SAME, expected_interval, least_mean, least_ratio

LOOP = problem_of("loop-15")


def contradicted(new, old, ratio, level):
    """Whether the one-sided sign-flip test of ``new - ratio * old`` rejects, by all patterns."""
    differences = new - ratio * old
    sums = [np.dot(signs, differences) for signs in product((-1, 1), repeat=len(new))]
    return np.mean(np.array(sums) >= differences.sum() - 1e-12) <= level


@pytest.mark.parametrize("level", [0.01, 0.05, 0.3])
def test_the_bound_is_where_the_sign_flip_test_stops_rejecting(rng, level):
    for _ in range(10):
        old = rng.lognormal(size=9)
        new = old * rng.lognormal(0.2, 0.3, size=9)
        least = least_ratio(new, old, level)
        assert contradicted(new, old, least * (1 - 1e-9), level)
        assert not contradicted(new, old, least * (1 + 1e-9), level)


@pytest.mark.parametrize("level", [0.01, 0.05, 0.3])
@pytest.mark.parametrize("equal", [0, 4])
def test_false_alarms_are_as_rare_as_stated_whatever_the_numbers(rng, level, equal):
    """Of all ways to say which of two numbers is the new one, at most the level is contradicted."""
    one, other = np.exp(3 * rng.standard_t(1.5, size=(2, 10)).clip(-9, 9))
    other[:equal] = one[:equal]
    patterns = [np.array(p, dtype=bool) for p in product((False, True), repeat=10)]
    new = [np.where(p, one, other) for p in patterns]
    alarms = [least_ratio(n, one + other - n, level) > 1 + 1e-12 for n in new]
    assert np.mean(alarms) <= level
    if not equal:
        assert np.mean(alarms) > level - 2 / len(patterns)


def test_random_subsets_say_what_all_subsets_say(rng):
    """16 seeds: more than are enumerated, few enough to enumerate here."""
    old = rng.lognormal(size=16)
    new = 1.1 * old * rng.lognormal(0, 0.2, size=16)
    inside = (np.arange(2**16)[:, None] >> np.arange(16)) & 1
    with np.errstate(invalid="ignore"):
        ratios = np.nan_to_num((inside @ new) / (inside @ old), nan=-np.inf)
    least = least_ratio(new, old, 0.05)
    # The rank of a quantile from 10,000 draws scatters by 22 of 10,000.
    assert np.mean(ratios < least) == pytest.approx(0.05, abs=4 * 0.0022)
    assert least_ratio(new, old, 0.05) == least


def test_units_do_not_matter(rng):
    old, new = rng.lognormal(size=(2, 30))
    assert least_ratio(100 * new, 100 * old, 0.01) == pytest.approx(least_ratio(new, old, 0.01))
    assert least_ratio(3 * new, old, 0.01) == pytest.approx(3 * least_ratio(new, old, 0.01))


def pair(now, stored):
    seeds = range(len(now))
    return Pair(
        LOOP, "ate_position_rmse_m", "", pd.Series(now, seeds), pd.Series(stored, seeds), True
    )


def test_equal_numbers_are_never_contradicted(rng):
    values = rng.lognormal(-3, 1, size=100)
    row = not_worse(pair(values, values), margin=0.0, level=0.4)
    assert row["holds"]
    assert (row["worse"], row["better"], row["change"], row["at_least"]) == (0, 0, 0, 0)


def test_the_digits_of_a_reference_are_enough(rng):
    values = np.exp(rng.uniform(-20, 10, size=1000))
    stored = np.array([float(f"{value:.{DIGITS}g}") for value in values])
    assert (np.abs(stored - values) <= SAME * stored).all()
    row = not_worse(pair(values, stored), margin=0.0, level=0.4)
    assert (row["worse"], row["better"], row["holds"]) == (0, 0, True)


def test_a_few_worse_seeds_among_equal_ones_are_told_by_their_number():
    """Of k that differ, all worse, the chance is 1 / 2^k: six of them are no evidence at 1 %."""
    old = np.ones(100)
    for count, holds in ((6, True), (9, False)):
        new = old.copy()
        new[:count] = 50.0
        assert not_worse(pair(new, old), margin=0.0, level=0.01)["holds"] == holds


def test_zeros_are_no_trouble():
    zeros, ones = np.zeros(8), np.ones(8)
    assert not_worse(pair(zeros, zeros), 0.0, 0.01)["holds"]
    assert not_worse(pair(zeros, ones), 0.0, 0.01)["holds"]
    assert not not_worse(pair(ones, zeros), 0.0, 0.01)["holds"]
    # Rounding on an error that is zero is none.
    assert not_worse(pair(1e-10 * ones, 1e-12 * ones), 0.0, 0.01)["holds"]


def test_the_margin_is_what_may_be_lost(rng):
    old = rng.lognormal(size=20)
    assert not not_worse(pair(1.03 * old, old), 0.02, 0.01)["holds"]
    assert not_worse(pair(1.03 * old, old), 0.04, 0.01)["holds"]


def test_too_few_seeds_are_refused_and_how_many_it_takes_is_said():
    with pytest.raises(InputError, match=r"5 seeds cannot contradict .* give 7 or more"):
        least_ratio(np.ones(5), np.ones(5), 0.01)
    assert least_ratio(2 * np.ones(7), np.ones(7), 0.01) == 2
    with pytest.raises(InputError, match="allow more false alarms"):
        least_ratio(np.ones(50), np.ones(50), 1e-7)


def test_the_bound_of_a_mean_is_students(rng):
    values = rng.normal(2.0, 0.5, size=12)
    low, _ = stats.t.interval(0.98, 11, values.mean(), stats.sem(values))
    assert least_mean(values, 0.01) == pytest.approx(low)


def test_the_interval_of_a_sum_is_chi_square_and_the_margin_widens_it():
    low, high = expected_interval(60.0, 0.0, 0.02)
    assert stats.chi2.cdf(60 * low, 60) == pytest.approx(0.01)
    assert stats.chi2.sf(60 * high, 60) == pytest.approx(0.01)
    assert expected_interval(60.0, 0.1, 0.02) == pytest.approx((0.9 * low, 1.1 * high))


def test_a_number_holds_against_itself():
    """The mean of equal numbers is another by a rounding error."""
    more = MORE[0]
    for value in (0.1, 0.3, 1.1):
        values = np.full(3, value)
        assert bounded(values, "ate_position_rmse_m", value, 0.01)["holds"]
        assert not bounded(values, "ate_position_rmse_m", value * (1 - 1e-9), 0.01)["holds"]
        assert bounded(values, more, value, 0.01)["holds"]
        assert not bounded(values, more, value * (1 + 1e-9), 0.01)["holds"]


# What is asked ---------------------------------------------------------------------------------


class Lost:
    """The EKF, but for seeds at which it ends a kilometre off."""

    name = "lost"

    def __init__(self, *seeds):
        self.seeds = seeds

    def estimate(self, data):
        estimate = ekfslam.estimate(data, "ekf")
        if data.seed not in self.seeds:
            return estimate
        poses = estimate.online.poses + np.array([1000.0, 0.0, 0.0])
        return replace(estimate, online=replace(estimate.online, poses=poses))


def test_a_run_that_diverges_where_the_reference_has_none_is_a_failure():
    with pytest.raises(
        AssertionError, match=r"1 diverged of 8 runs, first seed 5 .*; not so in lost"
    ):
        assert_not_worse(Lost(5), Lost(), "loop-15", seeds=8)
    assert assert_not_worse(Lost(), Lost(5), "loop-15", seeds=8).holds


def test_how_often_runs_diverge_is_a_claim_where_the_reference_has_some():
    held = assert_not_worse(Lost(1, 2), Lost(1, 3), "loop-15", seeds=10)
    assert list(held.claims["what"]) == ["ate_position_rmse_m", "diverged"]
    with pytest.raises(
        AssertionError, match=r"mean ate_position_rmse_m 1e\+03 against 100, \+898 %"
    ):
        assert_not_worse(Lost(*range(10)), Lost(3), "loop-15", seeds=10)


class Breaks(Lost):
    """The EKF, but for seeds at which it raises."""

    name = "breaks"

    def estimate(self, data):
        if data.seed in self.seeds:
            raise ValueError("no pivot")
        return super().estimate(data)


def test_a_seed_at_which_both_fail_is_left_out():
    with pytest.raises(AssertionError, match=r"1 failed of 9 runs, first seed 6 .*no pivot"):
        assert_not_worse(Breaks(5, 6), Breaks(5), "loop-15", seeds=9)
    found = assert_not_worse(Breaks(5), Breaks(5, 6), "loop-15", seeds=9)
    assert found.claims["seeds"].tolist() == [7]


class Forgets(Lost):
    """The EKF, but for seeds at which it tells no map."""

    name = "forgets"

    def estimate(self, data):
        estimate = ekfslam.estimate(data, "ekf")
        if data.seed not in self.seeds:
            return estimate
        return replace(estimate, landmarks=None, joint_covariance=None)


def test_a_number_that_is_missing_now_is_no_pair_less():
    with pytest.raises(
        AssertionError, match=r"no landmark_rmse_m in 2 of 4 runs, first seed 1, where forgets has"
    ):
        assert_not_worse(Forgets(1, 3), Forgets(), "loop-15", 4, metric="landmark_rmse_m")
    found = assert_not_worse(Forgets(1), Forgets(1, 3), "loop-15", 9, metric="landmark_rmse_m")
    assert found.claims["seeds"].tolist() == [7]


def test_several_robots_count_as_one_run_and_as_claims_of_their_own():
    together = assert_accuracy("ekf", "team", seeds=2, ate_position_rmse_m=9.0)
    one = assert_accuracy("ekf", "team", seeds=2, robot="bob", ate_position_rmse_m=9.0)
    assert together.claims["runs"][0] == one.claims["runs"][0] == 2
    assert together.claims["mean"][0] != one.claims["mean"][0]
    consistent = assert_consistent("ekf", "team", seeds=2, margin=0.9)
    assert len(consistent.claims) == 3 + 1


def test_a_scenario_with_a_motion_of_its_own_is_known_by_itself():
    def longer(factor):
        return ekfslam.OwnMotion(
            kind="mine",
            covariance=1e-4 * np.eye(2),
            controls=("v", "w", "dt"),
            function=lambda u: [factor * u[0] * u[2], 0.0, u[1] * u[2]],
            slip=1e-3,
        )

    loop = load_scenario("loop-15")
    drawn = [replace(loop, motion=longer(factor)) for factor in (1.0, 1.1)]
    means = [
        assert_accuracy("ekf", each, 2, ate_position_rmse_m=99.0).claims["mean"][0]
        for each in (*drawn, drawn[0])
    ]
    assert means[0] == means[2] != means[1]
    with pytest.raises(UnsupportedError, match="has no digest"):
        scenario_hash(drawn[0])


def test_one_dataset_is_held_against_the_bare_bound():
    data = ekfslam.simulate("loop-15", seed=1)
    ate = assert_accuracy("ekf", data, ate_position_rmse_m=9.0).claims["mean"][0]
    assert assert_accuracy("ekf", data, ate_position_rmse_m=ate).holds
    with pytest.raises(AssertionError, match="; one run, which has no spread"):
        assert_accuracy("ekf", data, ate_position_rmse_m=0.999 * ate)
    assert assert_not_worse("ekf", "dead-reckoning", data).holds
    with pytest.raises(AssertionError, match="; one run, which has no spread, margin 1 %"):
        assert_not_worse("dead-reckoning", "ekf", data)
    with pytest.raises(InputError, match="loop-15 is one dataset, which takes no seeds"):
        assert_accuracy("ekf", data, seeds=3, ate_position_rmse_m=9.0)
    with pytest.raises(InputError, match="one run says nothing of consistency"):
        assert_consistent("ekf", data)


def test_where_every_observation_is_rejected_there_is_no_nis_to_hold():
    found = assert_consistent("ekf(known_gate=1e-12)", "loop-15", seeds=3, margin=0.9)
    assert list(found.claims["what"]) == ["NEES of the final pose"]


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        ({}, InputError, "give at least one bound"),
        ({"ate": 1.0}, UnknownNameError, "unknown metric 'ate'"),
        ({"time_total_s": 1.0}, UnknownNameError, "unknown metric 'time_total_s'"),
        ({"ate_position_rmse_m": 1.0, "seeds": [1, 1]}, InputError, "all different"),
        ({"ate_position_rmse_m": 1.0, "seeds": -1}, InputError, "whole numbers from 0"),
        ({"ate_position_rmse_m": 1.0, "seeds": 2, "alpha": 0.7}, InputError, "alpha must be"),
        ({"ate_position_rmse_m": 1.0, "seeds": 2, "series": "x"}, UnknownNameError, "online"),
        ({"graph_error": 1.0, "seeds": 2}, InputError, "ekf on loop-15 has no graph_error"),
    ],
)
def test_what_makes_no_sense_is_refused_in_words(words, error, message):
    with pytest.raises(error, match=message):
        assert_accuracy("ekf", "loop-15", **words)


def test_a_metric_that_has_a_target_is_no_error():
    with pytest.raises(InputError, match=r"nees_pose_mean is no error.* it should be 3"):
        assert_not_worse("ekf", "ekf", "loop-15", seeds=8, metric="nees_pose_mean")
    with pytest.raises(InputError, match="say on which scenario"):
        assert_not_worse("ekf", "iekf")
    with pytest.raises(InputError, match="gtsam-isam2 has the series online and smoothed"):
        assert_accuracy("gtsam-isam2", "loop-15", seeds=1, ate_position_rmse_m=1.0)


def test_a_distance_from_the_smoother_runs_the_smoother():
    found = assert_accuracy("gtsam-batch", "loop-15", seeds=1, gap_final_position_m=1e-9)
    assert found.claims["mean"][0] == 0
    with pytest.raises(AssertionError, match=r"mean gap_final_position_m .* is above 0"):
        assert_accuracy("ekf", "loop-15", seeds=1, gap_final_position_m=0.0)
