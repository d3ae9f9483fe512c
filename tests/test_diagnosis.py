"""The diagnosis: mistakes are called by their names, and right filters are left in peace."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import seeded
import seeded_again
from seeded import EXPECTED, MORE, TEN, Homework, homework
from simulated import past_points
from textbook import TextbookEkf

from ekfslam.cli.printing import print_report
from ekfslam.errors import UnknownNameError
from ekfslam.estimates import Estimate, LandmarkEstimates, Trajectory
from ekfslam.filters.family import Iekf
from ekfslam.registry import resolve
from ekfslam.validation import check, diagnose
from ekfslam.validation.catalogue import CATALOGUE
from ekfslam.validation.suspects import run

PAGE = (Path(__file__).parents[1] / "docs" / "validation.md").read_text(encoding="utf-8")


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
    """And at least eight of them are to be named; whether they are is asked below."""
    assert len(TEN) == 10
    assert not TEN.keys() & MORE.keys()
    assert sum(bool(EXPECTED.get(key, (key,))) for key in TEN) >= 8


@pytest.mark.parametrize("key", [*TEN, *MORE])
def test_a_seeded_mistake_is_named(key):
    found = diagnose(homework(key))
    assert seeded.row(key, found) in PAGE
    assert found
    assert tuple(m for f in found for m in f.mistakes) == EXPECTED.get(key, (key,))
    if not found[0].named:  # by its stage at least
        assert found[0].stage == {"half-turned-noise": "new landmark"}.get(key, "correction")


def test_the_second_list_is_ten_and_its_filter_right_but_for_mounts():
    assert len(seeded_again.TEN) == 10
    (found,) = diagnose(seeded_again.jointly())
    assert found.mistakes == ("no-mount",)


@pytest.mark.parametrize(("key", "name"), [*seeded_again.TEN.items(), *seeded_again.MORE.items()])
def test_a_mistake_of_the_second_list_is_named(key, name):
    found = diagnose(seeded_again.jointly(key))
    assert seeded_again.named(found) == name
    assert seeded_again.row(key, found) in PAGE


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


TOLD = (
    (),
    ("covariances",),
    ("landmarks",),
    ("covariances", "landmarks"),
)
# What poses alone, or with some more, cannot tell from another mistake.
BLACK = (
    "motion-jacobian-sign",
    "q-not-rotated",
    "q-scaled",
    "no-cross-covariance",
    "certain-pose",
    "r-root",
    "h-transposed",
    "innovation-sign",
    "robot-only",
    "no-wrap",
    "no-mount",
)


@pytest.mark.parametrize("parts", TOLD, ids=" ".join)
@pytest.mark.parametrize("name", BLACK)
def test_a_black_box_is_seen_through(name, parts):
    """Its mistake is the finding, or one of few that its poses cannot tell apart."""
    found = diagnose(Planted({name: 0.3}, parts))
    assert len(found) == 1
    assert name in found[0].mistakes
    assert len(found[0].mistakes) <= 3


def test_a_right_black_box_is_not_accused():
    for parts in TOLD:
        assert diagnose(Planted({}, parts)) == ()
        assert diagnose(Planted({"in-order": 1.0}, parts)) == ()


def test_a_function_that_returns_poses_is_enough():
    def poses(dataset):
        return Planted({"no-cross-covariance": 1.0}).estimate(dataset).online.poses

    assert names(poses) == ("no-cross-covariance",)


class OwnNoise(Homework):
    """Numbers of another robot in the filter."""

    def __init__(self, prior, which):
        super().__init__(prior)
        self.which = which

    def predict(self, increment, covariance):
        own = {"q": np.any(covariance), "q at once": True}.get(self.which, False)
        super().predict(increment, np.diag([0.01, 0.02, 0.003]) if own else covariance)

    def observe(self, sightings):
        own = np.broadcast_to(np.diag([0.05, 0.002]), sightings.covariance.shape)
        super().observe(sightings._replace(covariance=own) if self.which == "r" else sightings)


@pytest.mark.parametrize("which", ["q", "q at once", "r"])
def test_noise_of_its_own_is_told(which):
    (found,) = diagnose(resolve(OwnNoise, which=which))
    assert found.mistakes == (f"{which[0]}-own",)
    shown = {"q": "[0.0, 0.02, 0.0]", "r": "[[0.05, 0.0], [0.0, 0.002]]"}
    assert shown[which[0]] in found.usually


def test_a_mistake_in_a_variant_is_named_to_first_order():
    """An iterated filter has other numbers than a plain one; where noise is small, it has not."""

    class Doubting(Iekf):
        def estimate(self, dataset, progress=None):
            doubted = tuple(replace(s, covariance=4 * s.covariance) for s in dataset.sensors)
            return super().estimate(replace(dataset, sensors=doubted))

    (found,) = diagnose(Doubting())
    assert found.mistakes == ("r-scaled",)
    assert "uses 4 times" in found.says


# Gates ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("probability", [0.95, 0.99, 0.999])
def test_a_gate_that_makes_sense_is_no_mistake(probability):
    (found,) = diagnose(f"ekf(known_gate={probability})")
    assert not found.named
    assert f"where {100 * (1 - probability):.2g} % of right ones are" in found.says


@pytest.mark.parametrize("method", ["nearest", "global", "joint"])
def test_the_gates_of_association_are_no_mistakes(method):
    assert not any(finding.named for finding in diagnose(f"ekf(association={method})"))


class Gated(Homework):
    """Rejects by a rule of its own."""

    def __init__(self, prior, rule):
        super().__init__(prior)
        self.rule = rule

    def correct(self, landmark, z, R, polar, mount, before):
        mean, covariance = self.mean, self.covariance
        super().correct(landmark, z, R, polar, mount, before)
        expected, H = numeric(self.sensor, mean, 3 + 2 * self.ids.index(landmark), mount)
        nu = z - expected
        nu[1] = seeded.wrapped(nu[1])
        if self.rule(nu @ np.linalg.inv(H @ covariance @ H.T + R) @ nu, nu):
            self.mean, self.covariance = mean, covariance


def numeric(sensor, mean, j, mount):
    """Range and bearing with their derivative by differences."""

    def see(x):
        (a, b, c), _ = sensor(mount, x)
        dx, dy = x[j] - a, x[j + 1] - b
        return np.array([np.hypot(dx, dy), seeded.wrapped(np.arctan2(dy, dx) - c)])

    steps = 1e-6 * np.eye(len(mean))
    return see(mean), np.array([(see(mean + s) - see(mean - s)) / 2e-6 for s in steps]).T


@pytest.mark.parametrize(
    ("rule", "name"),
    [
        (lambda d2, nu: np.sqrt(d2) > 5.99, "gate-square"),
        (lambda d2, nu: d2 > np.sqrt(5.99), "gate-root"),
        (lambda d2, nu: d2 > 3.0, "gate-root"),
        (lambda d2, nu: d2 > 9.0, None),
        (lambda d2, nu: d2 > 7.0, None),
        (lambda d2, nu: d2 > 2.0**2, None),
        (lambda d2, nu: abs(nu[0]) > 0.3, None),
    ],
)
def test_squared_against_unsquared_and_nothing_else(rule, name):
    (found,) = diagnose(resolve(Gated, rule=rule))
    assert found.mistakes == ((name,) if name else ())
    assert found.stage == "gate"


# What is judged, and what is shown --------------------------------------------------------------


class XyOnly(Homework):
    """A filter for one kind of sensor."""

    kinds = ("xy",)


def test_a_filter_for_xy_alone_is_judged_by_xy():
    assert diagnose(XyOnly) == ()
    assert names(resolve(XyOnly, mistakes="no-cross-covariance")) == ("no-cross-covariance",)


class Raising:
    def estimate(self, dataset):
        raise RuntimeError("no")


def test_who_cannot_be_judged_is_not_accused():
    assert diagnose(Raising()) == ()
    with pytest.raises(UnknownNameError):
        diagnose("efk")


SMALL = past_points("A few steps.", [[3, 3], [6, -4], [9, 3]], steps=15, turn=0.05)


@pytest.fixture
def small(tmp_path):
    (tmp_path / "small.toml").write_text(SMALL)
    return str(tmp_path / "small.toml")


def test_the_check_says_it_in_lines_for_a_narrow_terminal(small, capsys):
    report = check(homework("no-cross-covariance + no-wrap"), scenarios=small)
    assert [finding.mistakes for finding in report.findings] == [
        ("no-cross-covariance",),
        ("no-wrap",),
    ]
    print_report(report)
    said = capsys.readouterr().out.partition("what is wrong, most likely\n")[2]
    assert said.endswith("FAILED\n")
    assert max(map(len, said.splitlines())) <= 80
    whole = re.sub(r"\s+", " ", said)
    for part in ("1. new landmark", "2. angles", "usually:", "look at:", "evidence:"):
        assert part in whole
    (shown,) = re.findall(r"```\n(what is wrong.*?)```", PAGE, flags=re.S)
    (rounding,) = re.findall(r"\de-1\d", shown)
    first = said.partition("2. angles")[0]
    assert re.sub(r"\de-1\d", rounding, first) == shown.partition("\n")[2]
    for finding in report.findings:
        for text in (finding.says, *finding.details.values()):
            assert text in whole
    html = report._repr_html_()
    assert html.count("<p><b>") == 2
    assert "P[l, :] = G_r P[r, :]" in html


def test_a_gate_is_mentioned_where_a_rung_has_failed(small):
    """Scenarios with known identities do not show a wide one; what has a name is always told."""
    wide = check(homework("gate-unsquared"), scenarios=small)
    assert wide.passed
    assert [finding.mistakes for finding in wide.findings] == [("gate-square",)]
    assert check("ekf(known_gate=0.999999)", scenarios=small).findings == ()
    tight = check("ekf(known_gate=0.5)", scenarios=small)
    assert not tight.passed
    assert [finding.stage for finding in tight.findings] == ["gate"]
    assert not tight.findings[0].named
