"""The diagnosis: mistakes are called by their names, and right filters are left in peace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import seeded
from seeded import EXPECTED, MORE, TEN, Homework, homework
from textbook import TextbookEkf

from ekfslam import Ekf, check
from ekfslam.errors import UnknownNameError
from ekfslam.estimates import Estimate, Innovations, LandmarkEstimates, Trajectory
from ekfslam.filters.family import Iekf
from ekfslam.registry import resolve
from ekfslam.validation import Finding, diagnose
from ekfslam.validation.mistakes import CATALOGUE
from ekfslam.validation.suspects import run


def names(subject):
    return tuple(" or ".join(finding.mistakes) for finding in diagnose(subject))


# Right filters ----------------------------------------------------------------------------------

RIGHT = (
    "ekf",
    "ekf(update=sequential)",
    "ekf(initiation=infinite)",
    "ekf(initiation=allocated)",
    "ekf-compressed",
    "iekf",
    "ekf-ideal",
    "ekf-fej",
    "ekf-oc",
    "ekf-ri",
    "ekf-robocentric",
    "fastslam2",
    "dead-reckoning",
    "gtsam-batch",
    "gtsam-isam2",
    "gtsam-fixed-lag",
    TextbookEkf(update="joint"),
    TextbookEkf(update="sequential"),
    homework(),
)


@pytest.mark.parametrize("subject", RIGHT, ids=str)
def test_a_right_filter_is_not_accused(subject):
    assert diagnose(subject) == ()


# Seeded mistakes --------------------------------------------------------------------------------


def test_the_list_is_ten():
    assert len(TEN) == 10
    assert not TEN.keys() & MORE.keys()


@pytest.mark.parametrize("key", [*TEN, *MORE])
def test_a_seeded_mistake_is_named(key):
    found = diagnose(homework(key))
    assert found
    assert tuple(m for f in found for m in f.mistakes) == EXPECTED.get(key, (key,))
    if not found[0].named:  # by its stage at least
        assert found[0].stage == {"half-turned-noise": "new landmark"}.get(key, "correction")


@pytest.mark.parametrize(
    ("mistake", "name"),
    [
        ("transposed-jacobian", "h-robot-transposed"),
        ("no-cross-covariance", "no-cross-covariance"),
        ("no-wrap", "no-wrap"),
        ("sqrt-q", "h-root-of-q"),
        ("wrong-noise", "r-scaled"),
    ],
)
@pytest.mark.parametrize("update", ["joint", "sequential"])
def test_the_mistakes_of_the_textbook_are_named(mistake, name, update):
    assert names(TextbookEkf(mistake, update)) == (name,)


# What the diagnosis knows -----------------------------------------------------------------------

FORMS = [
    pytest.param(mistake, form, id="+".join(form))
    for mistake in CATALOGUE
    for form in mistake.switches
]


class Planted:
    """The textbook filter of the diagnosis itself, with a mistake switched on.

    It tells as much as `parts` says.
    """

    def __init__(self, wrong, parts=("covariances", "landmarks", "joint")):
        self.wrong, self.parts = wrong, parts

    def estimate(self, dataset):
        answer, _ = run(dataset, self.wrong)
        mapped = LandmarkEstimates(answer.ids, answer.positions, answer.marginals)
        return Estimate(
            "planted",
            dataset.name,
            "known",
            Trajectory(answer.poses, answer.covariances if "covariances" in self.parts else None),
            landmarks=mapped if "landmarks" in self.parts else None,
            joint_covariance=answer.joint if "joint" in self.parts else None,
        )


@pytest.mark.parametrize(("mistake", "form"), FORMS)
def test_every_mistake_of_the_catalogue_is_told_from_every_other(mistake, form):
    factor = 0.3 if mistake.fitted else 1.0
    found = diagnose(Planted(dict.fromkeys(form, factor)))
    assert [finding.mistakes for finding in found] == [(mistake.name,)]
    assert "0.3" in found[0].says or not mistake.fitted
    assert "{" not in found[0].says + found[0].usually
