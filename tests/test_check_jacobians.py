"""`check_jacobians` passes what is right, and says of what is wrong where it is and what it is."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest

from ekfslam.differences import central_differences
from ekfslam.errors import InputError
from ekfslam.models.motion import KINDS, MotionModel
from ekfslam.models.sensors import VIEWS, Sensor
from ekfslam.own_models import OwnMotion
from ekfslam.testing.jacobians import check_jacobians

AT = [[2.0, 0.3], [1.0, 2.5], [3.0, -1.0]]


def f(u):
    return [u[0] * cos(u[1]), u[0] * sin(u[1])]


def J(u):
    return np.array([[cos(u[1]), -u[0] * sin(u[1])], [sin(u[1]), u[0] * cos(u[1])]])


# What is right ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "none"])
def test_motion_models_of_the_house(kind):
    needed = KINDS[kind].parameter
    parameter = {needed: 0.7} if needed else {}
    model = MotionModel(kind, np.eye(KINDS[kind].noisy), **parameter)
    assert check_jacobians(model) < 1e-9
    assert check_jacobians(model, at=np.full(len(model.control_names), 0.3)) < 1e-9


@pytest.mark.parametrize("kind", VIEWS)
def test_sensors_and_views_of_the_house(kind):
    view = VIEWS[kind]
    sensor = Sensor(kind, np.eye(view.size), mount=[0.3, -0.1, 2.0])
    assert check_jacobians(sensor) < 1e-9
    assert check_jacobians(sensor, at=([[0, 0, 3.0]], [[-4.0, 0.1]])) < 1e-9
    assert check_jacobians(view) < 1e-9


def test_plain_functions():
    assert check_jacobians(f, J, AT) < 1e-9
    assert check_jacobians(f, J(AT[0]), AT[0]) < 1e-9


def test_large_and_small_numbers():
    """Pixels, and metres of the order of thousands: the tolerance is relative to the entries."""

    def pixels(u):
        return [400 * u[0] / u[1], 80 / u[1]]

    def slopes(u):
        return [[400 / u[1], -400 * u[0] / u[1] ** 2], [0, -80 / u[1] ** 2]]

    assert check_jacobians(pixels, slopes, [[3.0, 5.0], [1e4, 3e4], [0.01, 0.02]]) < 1e-6


def test_differences_are_of_fourth_order():
    """The error of sin at 1 is cos(1) h^4 / 30, as long as rounding is below it."""
    at = np.ones((1, 1))
    for step in (0.1, 0.05):
        error = central_differences(np.sin, at, step)[0, 0, 0] - cos(1.0)
        assert error == pytest.approx(-4 * cos(1.0) * step**4 / 120, rel=0.02)


# What is wrong ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda u: J(u).T, "the matrix is transposed"),
        (lambda u: -J(u), "each of these entries has the wrong sign"),
        (lambda u: J(u) * [[1, 1], [-1, 1]], "the entry has the wrong sign"),
        (lambda u: J(u)[::-1], r"rows are exchanged: they stand in the order \[1, 0\]"),
        (lambda u: J(u)[:, ::-1], r"columns are exchanged: they stand in the order \[1, 0\]"),
        (lambda u: J(u) * [[1, 0], [1, 1]], "the entry is missing: zero everywhere"),
        (lambda u: J(u) * [1, 180 / np.pi], "in degrees where radians are wanted"),
        (lambda u: 2 * J(u), "twice what it should be"),
        (lambda u: np.add(J(u), [[0, 0.3], [0, 0]]), "derive that entry again"),
        (lambda u: J(u) * [[np.nan, 1], [1, 1]], "NaN or infinite"),
    ],
)
def test_a_wrong_matrix_is_recognised(wrong, words):
    with pytest.raises(AssertionError, match=words):
        check_jacobians(f, wrong, AT)


def test_the_message_names_entry_place_and_numbers():
    with pytest.raises(AssertionError) as caught:
        check_jacobians(f, lambda u: J(u) * [[1, 1], [-1, 1]], AT)
    lines = str(caught.value).splitlines()
    assert lines[0] == (
        f"f: d f[1] / d x[0], entry [1, 0], is {-sin(2.5):.9g}; "
        f"central differences give {sin(2.5):.9g}"
    )
    assert lines[1:3] == ["  at x[0] = 1, x[1] = 2.5", "  entries that are off: [1, 0] of 4"]


def test_an_error_of_the_size_of_the_tolerance_is_seen():
    for size, passes in ((0.5e-6, True), (2e-6, False)):

        def wrong(u, size=size):
            return np.add(J(u), [[size * 3, 0], [0, 0]])  # the largest entry there is near 3

        if passes:
            assert check_jacobians(f, wrong, [[3.0, -1.4]]) == pytest.approx(size, rel=0.05)
        else:
            with pytest.raises(AssertionError):
                check_jacobians(f, wrong, [[3.0, -1.4]])


def test_a_transposed_shape_is_recognised():
    def tall(u):
        return [u[0], u[1], u[0] * u[1]]

    def slopes(u):
        return np.array([[1, 0], [0, 1], [u[1], u[0]]])

    assert check_jacobians(tall, slopes, AT) < 1e-9
    with pytest.raises(AssertionError, match=r"shape \(2, 3\), wanted \(3, 2\).*is transposed"):
        check_jacobians(tall, lambda u: slopes(u).T, AT)
    with pytest.raises(AssertionError, match=r"shape \(2, 3\), wanted \(3, 2\)") as caught:
        check_jacobians(tall, lambda u: 2 * slopes(u).T, AT)
    assert "transposed" not in str(caught.value)


def test_angles_are_wrapped_where_they_are_named():
    def bearing(p):
        return [np.arctan2(p[1], p[0])]

    def slope(p):
        return [[-p[1] / (p @ p), p[0] / (p @ p)]]

    behind = [-2.0, 0.0]
    assert check_jacobians(bearing, slope, behind, angles=[0]) < 1e-9
    with pytest.raises(AssertionError, match=r"jumps there: if f\[0\] is an angle, say angles="):
        check_jacobians(bearing, slope, behind)


def test_a_model_of_ones_own_is_named():
    model = OwnMotion(
        "push",
        np.eye(2),
        controls=("way", "turn", "dt"),
        function=lambda u: [u[0] * u[2], 0, u[1]],
        jacobian=lambda u: [[u[2], 0, -u[0]], [0, 0, 0], [0, 1, 0]],
    )
    with pytest.raises(
        AssertionError, match=r"motion model 'push': d dx / d dt, entry .*\n.*\n.*\n.*wrong sign"
    ):
        check_jacobians(model)


def test_a_view_with_a_mistake_is_named():
    good = VIEWS["range-bearing"]
    bad = good._replace(back_project_jacobian=lambda v: -good.back_project_jacobian(v))
    with pytest.raises(AssertionError, match=r"back_project of the view: d p[xy] / d"):
        check_jacobians(bad)


class Sheared(Sensor):
    """A sensor whose direct and inverse models can be spoiled."""

    wrong = ""

    def observe(self, poses, points):
        values, pose, point = super().observe(poses, points)
        return values, pose * (1 if self.wrong != "observe" else [1, 1, -1]), point

    def locate(self, poses, values):
        points, pose, value = super().locate(poses, values)
        return points, pose, value * (1 if self.wrong != "locate" else 2)


@pytest.mark.parametrize("which", ["observe", "locate"])
def test_direct_and_inverse_models_are_both_checked(which, monkeypatch):
    sensor = Sheared("range-bearing", np.eye(2), mount=[0.1, 0.2, 0.3], name="laser")
    assert check_jacobians(sensor) < 1e-9
    monkeypatch.setattr(Sheared, "wrong", which)
    with pytest.raises(AssertionError, match=f"{which} of laser: d"):
        check_jacobians(sensor)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((f,), "a plain function needs its Jacobian"),
        ((f, J), "at is missing"),
        ((f, J(AT[0]), AT), "that of one point"),
        ((3, J, AT), "takes a model or a function"),
        ((f, J, [[np.nan, 0]]), "finite numbers"),
        ((lambda u: 1.0, J, AT), "must return numbers"),
        ((MotionModel("none", np.eye(3)),), "has no controls"),
        ((MotionModel("odometry", np.eye(3)), None, [[1.0, 2.0]]), "controls .* must have shape"),
    ],
)
def test_what_cannot_be_checked(arguments, message):
    with pytest.raises(InputError, match=message):
        check_jacobians(*arguments)
