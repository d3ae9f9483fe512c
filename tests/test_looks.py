"""Looks of estimators: whoever reads a figure tells them apart."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from matplotlib.colors import to_rgb
from numpy.testing import assert_allclose

from ekfslam import plots
from ekfslam.plots.style import LOOKS, METHODS


def test_looks_differ_and_do_not_depend_on_the_process():
    assert len({look.color for look in LOOKS.values()}) == len(LOOKS)
    assert len({look.marker for look in LOOKS.values()}) == len(LOOKS)
    # Python's own hash of a string changes from one process to the next.
    assert plots.look("fastslam") == ("#117733", "H", ":")
    assert plots.look("fej-ekf") == ("#997700", ">", "--")
    taken = {look.color for look in LOOKS.values()}
    assert not {plots.look(f"filter-{k}").color for k in range(50)} & taken


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


def test_the_colour_blind_tell_the_estimators_apart():
    """By colour or, where colours are near to one another for somebody, by the line."""
    assert_allclose(lab("#ffffff", np.eye(3)), [100, 0, 0], atol=1e-6)
    for one, other in combinations(LOOKS.values(), 2):
        for vision in VISIONS:
            distance = np.linalg.norm(lab(one.color, vision) - lab(other.color, vision))
            assert distance > 20 or one.linestyle != other.linestyle


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
