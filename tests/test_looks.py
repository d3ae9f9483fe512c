"""Looks of estimators: whoever reads a figure tells them apart."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from numpy.testing import assert_allclose

from ekfslam import plots
from ekfslam.plots.style import LOOKS, METHODS, TRUTH
from ekfslam.plots.vision import _seen, apart


def test_looks_differ_and_do_not_depend_on_the_process():
    assert len({look.color for look in LOOKS.values()}) == len(LOOKS)
    assert len({look.marker for look in LOOKS.values()}) == len(LOOKS)
    # Python's own hash of a string changes from one process to the next.
    assert plots.look("fastslam") == ("#9CA45A", (4, 1, 0), "-")
    assert plots.look("fej-ekf") == ("#9CA45A", (4, 1, 45), ":")
    for taken in ("color", "marker"):
        ours = {getattr(look, taken) for look in LOOKS.values()}
        assert not {getattr(plots.look(f"filter-{k}"), taken) for k in range(50)} & ours


def test_a_thin_line_of_a_filter_of_a_user_is_seen_on_white():
    """Contrast of lightness (WCAG 2.1): none is fainter than ours, and none is near white."""

    def contrast(color):
        c = np.array(to_rgb(color))
        return 1.05 / (
            0.05 + np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ XYZ[1]
        )

    least = min(contrast(look.color) for look in LOOKS.values())
    for color in {plots.look(f"filter-{k}").color for k in range(50)}:
        assert contrast(color) > max(least, 2.5)
        assert distance(color, "#ffffff") > 40


# What is left of linear RGB without the red or the green cones (Machado et al. 2009, severity 1).
VISIONS = [
    np.eye(3),
    [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
]
XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


def lab(color, vision):
    """CIE L*a*b* (D65) of a colour as somebody sees it."""
    c = np.array(to_rgb(color))
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    x, y, z = XYZ @ np.clip(vision @ linear, 0, 1) / XYZ.sum(axis=1)
    fx, fy, fz = (np.cbrt(t) if t > 0.008856 else 7.787 * t + 16 / 116 for t in (x, y, z))
    return np.array([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)])


def distance(one, other):
    """For the eyes that see the least of it."""
    return min(np.linalg.norm(lab(one, vision) - lab(other, vision)) for vision in VISIONS)


# Figures that people look at: the default comparison, the family in a campaign, recorded sets.
TOGETHER = [
    "ekf gtsam-batch gtsam-isam2 gtsam-fixed-lag dead-reckoning",
    "ekf iekf ekf-ideal ekf-fej ekf-oc ekf-ri ekf-robocentric gtsam-batch",
    "dead-reckoning ekf ekf-ri gtsam-batch gtsam-isam2 fastslam1 fastslam2 ekf-localization",
    "ekf ekf-compressed gtsam-isam2",
]


def test_the_colour_blind_tell_the_estimators_apart():
    assert_allclose(lab("#ffffff", np.eye(3)), [100, 0, 0], atol=1e-6)
    for one, other in combinations(LOOKS.values(), 2):
        assert distance(one.color, other.color) > 13
    for names in TOGETHER:
        for one, other in combinations(names.split(), 2):
            if {one, other} != {"ekf", "ekf-compressed"}:  # two ways to compute the same numbers
                assert distance(LOOKS[one].color, LOOKS[other].color) > 18
    for look in LOOKS.values():  # a thin line on paper, and beside the truth
        assert distance(look.color, "#ffffff") > 25
        assert distance(look.color, TRUTH) > 20


def test_distances_of_colours_are_those_of_cie():
    """Of two implementations, and for normal eyes of known L*a*b* of the primaries."""
    for one, other in combinations(LOOKS.values(), 2):
        assert_allclose(apart(one.color, other.color), distance(one.color, other.color), atol=0.05)
    assert_allclose(_seen("#ff0000")[0], [53.24, 80.09, 67.20], atol=0.05)
    assert_allclose(_seen("#0000ff")[0], [32.30, 79.19, -107.86], atol=0.05)
    assert apart("#000000", "#ffffff") == pytest.approx(100, abs=0.01)
    red, green = _seen("#b3553c"), _seen("#6e6e3c")  # deuteranopes confuse them
    assert np.linalg.norm(red[0] - green[0]) > 40
    assert np.linalg.norm(red[2] - green[2]) < 12


COMPARED = ["ekf", "gtsam-batch", "gtsam-isam2", "dead-reckoning"]


@pytest.mark.parametrize("name", ["MyFilter", "mymodule:MyFilter", "ekf(update=sequential)", "x"])
def test_a_filter_of_a_user_is_told_from_those_that_it_is_compared_with(name):
    found = plots.looks([*COMPARED, name])
    assert {other: found[other] for other in COMPARED} == {n: LOOKS[n] for n in COMPARED}
    for other in COMPARED:
        assert distance(found[name].color, LOOKS[other].color) > 18
        assert found[name].marker != LOOKS[other].marker
    assert found[name] == plots.look(name)  # the same in any of these figures
    assert plots.looks([name, *reversed(COMPARED)]) == found


def test_several_filters_of_users_are_told_from_one_another():
    mine = [f"filter-{k}" for k in range(4)]
    found = plots.looks([*COMPARED, *mine])
    for one, other in combinations(found.values(), 2):
        assert distance(one.color, other.color) > 18
        assert one.marker != other.marker


def test_many_variants_take_colours_that_nobody_else_in_the_figure_has():
    variants = [f"fastslam{v}(particles={n})" for v in (1, 2) for n in (10, 30, 100, 300, 1000)]
    found = plots.looks(["ekf", "ekf-ri", "gtsam-isam2", *variants])
    assert len(set(found.values())) == 13
    for one, other in combinations(found.values(), 2):
        assert distance(one.color, other.color) > 12


def test_a_filter_of_the_family_is_no_method_of_association():
    assert plots.look("ekf-ri") == LOOKS["ekf-ri"]
    assert plots.look("ekf-oc") == LOOKS["ekf-oc"]
    assert plots.look("ekf-joint") == METHODS["joint"]
    assert not {name.removeprefix("ekf-") for name in LOOKS} & set(METHODS)


def test_methods_of_association_have_looks_that_can_be_told_apart():
    looks = {name: plots.look(f"ekf-{name}") for name in METHODS}
    assert looks == dict(METHODS)
    assert plots.look("ekf-known").color == plots.look("ekf").color  # the same filter
    assert len({(look.color, look.linestyle) for look in looks.values()}) == len(METHODS)
    assert len({look.marker for look in looks.values()}) == len(METHODS)
    compared = ["known", "nearest", "joint", "global", "maximum-likelihood", "euclidean"]
    assert len({looks[name].color for name in compared}) == len(compared)
    assert plots.look("ekf-jointly") not in looks.values()
    assert plots.look("joint") not in looks.values()
