"""The page on pytest: its message is what is said, its rates are those measured."""

from __future__ import annotations

import pandas as pd
import plugin_rates
import pytest
from pages import PAGES, blocks
from scipy.stats import binom

from ekfslam.testing import assert_not_worse
from ekfslam.testing.runs import SEEDS

PAGE = PAGES["docs/pytest.md"]
RATES = pd.read_csv(plugin_rates.FILE)
METRICS = ["ate_position_rmse_m", "rpe_position_rmse_m"]


def test_the_message_is_the_one_that_comes():
    (shown,) = (block.text for block in blocks(PAGE) if not block.language)
    with pytest.raises(AssertionError) as error:
        assert_not_worse("iekf", "ekf", "loop-15", metric=METRICS)
    said = f"AssertionError: {error.value}".splitlines()
    assert " ".join(shown.split()) == said[0]
    assert "     28 " in "\n".join(said)  # the seed that the page runs alone


def row(kind, assertion, case, margin, seeds=SEEDS):
    """A measured rate."""
    wanted = {"kind": kind, "assertion": assertion, "case": case, "margin": margin, "seeds": seeds}
    (found,) = RATES[(RATES[list(wanted)] == pd.Series(wanted)).all(axis=1)].itertuples()
    return found


ALARMS = [
    ("assert_not_worse", "ate_position_rmse_m, two jitters", 0.01),
    ("assert_not_worse", "ate_position_rmse_m, two jitters", 0.0),
    ("assert_not_worse", "rpe_position_rmse_m, two jitters", 0.01),
    ("assert_not_worse", "rpe_position_rmse_m, two jitters", 0.0),
    ("assert_accuracy", "ate_position_rmse_m, bound at the mean", 0.0),
    ("assert_accuracy", "rpe_position_rmse_m, bound at the mean", 0.0),
    ("assert_consistent", "linear", 0.1),
    ("assert_consistent", "linear", 0.0),
]


@pytest.mark.parametrize(("assertion", "case", "margin"), ALARMS)
def test_false_alarms_are_within_the_stated_rate(assertion, case, margin):
    """Over 200 regressions of the default number of seeds: not more than chance gives."""
    found = row("false alarm", assertion, case, margin)
    assert found.regressions >= 200
    assert found.alpha == 0.01
    assert binom.sf(found.failed - 1, found.regressions, found.alpha) > 0.01
    line = (
        f"| `{assertion}` | {case} | {100 * margin:g} % | {found.failed} of {found.regressions} |"
    )
    assert line in PAGE


POWERS = [
    ("assert_not_worse", "ate_position_rmse_m, 10 % worse", 0.01),
    ("assert_not_worse", "rpe_position_rmse_m, 10 % worse", 0.01),
    ("assert_accuracy", "ate_position_rmse_m, 10 % worse", 0.0),
    ("assert_accuracy", "rpe_position_rmse_m, 10 % worse", 0.0),
    ("assert_consistent", "ekf, overconfident", 0.1),
]


@pytest.mark.parametrize(("assertion", "case", "margin"), POWERS)
def test_the_power_is_stated(assertion, case, margin):
    rates = [row("power", assertion, case, margin, seeds).rate for seeds in plugin_rates.SEEDS]
    shown = " | ".join(f"{100 * rate:.0f} %" for rate in rates)
    assert f"| `{assertion}` | {case} | {shown} |" in PAGE


def test_a_tenth_is_seen_at_the_default_number_of_seeds():
    assert row("power", "assert_not_worse", "ate_position_rmse_m, 10 % worse", 0.01).rate > 0.8
