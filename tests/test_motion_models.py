"""Motion models: Jacobians, limits, noise, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from numerics import assert_sampled, central_difference
from numpy.testing import assert_allclose, assert_array_equal

from ekfslam import geometry as geo
from ekfslam.checks import checked_covariance
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.models.motion import KINDS, MotionModel

WIDTH, WHEELBASE = 0.7, 2.83

COMMANDED = [kind for kind in KINDS if kind != "none"]
WHEELED = ["wheel-increments", "wheel-speeds", "wheel-speeds-euler"]
TURNS = np.geomspace(1e-14, 3.0, 29)
TURNS = np.concatenate([-TURNS[::-1], [0.0], TURNS])


def model(kind, **settings):
    parameter = {"width": WIDTH, "wheelbase": WHEELBASE}
    needed = KINDS[kind].parameter
    if needed:
        settings.setdefault(needed, parameter[needed])
    if "proportional" not in settings:
        settings.setdefault("covariance", np.eye(3 if kind == "none" else KINDS[kind].noisy))
    return MotionModel(kind, **settings)


def control_of_turn(kind, distance, turn):
    """The control of a kind that makes a motion of this length turn by this angle."""
    dt = 0.4
    left, right = distance - 0.5 * WIDTH * turn, distance + 0.5 * WIDTH * turn
    if kind == "odometry":
        return [distance, 0.3 * distance, turn]
    if kind == "advance-turn":
        return [distance, turn]
    if kind.startswith("velocity"):
        return [distance / dt, turn / dt, dt]
    if kind == "wheel-increments":
        return [left, right]
    if kind.startswith("wheel-speeds"):
        return [left / dt, right / dt, dt]
    return [distance / dt, turn / 3, dt]  # a car's steering angle stays below 1 rad


# Increments and Jacobians ----------------------------------------------------------------------


@pytest.mark.parametrize("distance", [1.3, -0.4, 0.0])
@pytest.mark.parametrize("kind", COMMANDED)
def test_jacobian_is_the_central_difference(kind, distance):
    motion = model(kind)
    for turn in TURNS:
        control = np.array(control_of_turn(kind, distance, turn))
        _, jacobian = motion.increment([control])
        numeric = central_difference(lambda u: motion.increment([u])[0][0], control)
        assert_allclose(jacobian[0], numeric, rtol=0, atol=1e-9, err_msg=f"turn {turn}")


@pytest.mark.parametrize("kind", COMMANDED)
def test_a_run_at_once_is_its_steps_one_by_one(kind):
    motion = model(kind, slip=0.01)
    controls = np.array([control_of_turn(kind, 0.9, turn) for turn in TURNS])
    together = motion.increments(controls)
    deltas, jacobians = motion.increment(controls)
    assert_array_equal(together.deltas, deltas)
    for k, control in enumerate(controls):
        alone = motion.increments([control])
        assert_allclose(together.deltas[k], alone.deltas[0], rtol=1e-15)
        assert_allclose(jacobians[k], motion.increment([control])[1][0], rtol=1e-15)
        assert_allclose(together.covariances[k], alone.covariances[0], rtol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_without_controls_is_empty(kind):
    deltas, covariances = model(kind).increments(np.zeros((0, len(KINDS[kind].controls))))
    assert deltas.shape == (0, 3)
    assert covariances.shape == (0, 3, 3)


@pytest.mark.parametrize("kind", ["velocity", "wheel-speeds"])
@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.5, -2.5])
def test_exact_arc_is_the_limit_of_euler_steps(kind, turn):
    """Euler converges with the first power of the step; extrapolation removes that power."""
    whole = np.array(control_of_turn(kind, 1.1, turn))

    def by_euler(count):
        steps = np.tile(whole * [1, 1, 1 / count], (count, 1))
        return geo.integrate(np.zeros(3), model(f"{kind}-euler").increment(steps)[0])[-1]

    exact = model(kind).increment([whole])[0][0]
    fine, finer = by_euler(4000), by_euler(8000)
    assert_allclose(2 * finer - fine, exact, atol=1e-7)
    if abs(turn) > 0.1:
        ratio = np.linalg.norm(fine - exact) / np.linalg.norm(finer - exact)
        assert ratio == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize("kind", ["velocity", "wheel-speeds", "wheel-increments"])
def test_exact_arcs_of_one_curvature_chain(kind):
    """Twice half the control is the whole control: only exact arcs have this."""
    whole = np.array(control_of_turn(kind, 1.1, 2.2))
    part = whole * (0.5 if kind == "wheel-increments" else [1, 1, 0.5])
    halves = model(kind).increment([part, part])[0]
    assert_allclose(
        geo.compose(halves[0], halves[1]), model(kind).increment([whole])[0][0], atol=1e-14
    )


def test_kinds_agree_where_they_describe_the_same_motion():
    distance, dt = 0.8, 0.4
    for turn in TURNS:
        arcs = [
            model(kind).increment([control_of_turn(kind, distance, turn)])[0]
            for kind in ("velocity", "wheel-speeds", "wheel-increments")
        ]
        # A width of 0.7 m turns the last bit of a wheel into 1e-16 / 0.7 of angle.
        assert_allclose(arcs[1], arcs[0], atol=1e-15)
        assert_allclose(arcs[2], arcs[0], atol=1e-15)
    for kind in ("velocity-euler", "wheel-speeds-euler", "advance-turn"):
        delta = model(kind).increment([control_of_turn(kind, distance, 0.6)])[0][0]
        assert_allclose(delta, [distance, 0.0, 0.6], atol=1e-15)
    odometry = model("odometry").increment([[0.1, 0.2, 0.3]])[0][0]
    assert_array_equal(odometry, [0.1, 0.2, 0.3])
    straight = model("car").increment([[distance / dt, 0.0, dt]])[0][0]
    assert_allclose(straight, [distance, 0.0, 0.0], atol=1e-15)


def test_car_turns_about_its_steering_angle():
    v, gamma, dt = 3.0, 0.4, 0.025
    delta = model("car").increment([[v, gamma, dt]])[0][0]
    expected = v * dt * np.array([np.cos(gamma), np.sin(gamma), np.sin(gamma) / WHEELBASE])
    assert_allclose(delta, expected, rtol=1e-15)


def test_wheels_turn_to_the_left_when_the_right_one_is_faster():
    delta = model("wheel-increments").increment([[0.5, 0.6]])[0][0]
    assert delta[2] == pytest.approx(0.1 / WIDTH)
    assert delta[1] > 0


# Noise -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", COMMANDED)
def test_covariance_is_propagated_control_noise_and_slip(kind, rng):
    """Drawn controls pushed through the model itself, with a slip across the first heading."""
    size, slip = KINDS[kind].noisy, 2e-3
    root = 1e-3 * (np.eye(size) + 0.6 * np.tri(size, k=-1))
    motion = model(kind, covariance=root @ root.T, slip=slip)
    control = np.array(control_of_turn(kind, 0.8, 0.9))
    count = 100_000
    drawn = np.tile(control, (count, 1))
    drawn[:, :size] += rng.normal(size=(count, size)) @ root.T
    deltas = motion.increment(drawn)[0]
    deltas[:, 1] += slip * rng.normal(size=count)
    nominal, covariances = motion.increments([control])
    assert_sampled(deltas - nominal, covariances[0])


@pytest.mark.parametrize("kind", WHEELED)
def test_correlated_wheels_change_the_covariance_as_they_should(kind):
    """Wheels that err together keep the heading; wheels that err apart keep the distance."""
    control = [control_of_turn(kind, 0.8, 0.0)]
    together = model(kind, covariance=1e-4 * np.ones((2, 2))).increments(control)[1][0]
    apart = model(kind, covariance=1e-4 * np.array([[1, -1], [-1, 1]])).increments(control)[1][0]
    assert_allclose(together[2, 2], 0.0, atol=1e-18)
    assert together[0, 0] > 1e-6
    assert_allclose(apart[0, 0], 0.0, atol=1e-18)
    assert apart[2, 2] > 1e-6


@pytest.mark.parametrize("kind", WHEELED)
def test_proportional_noise_is_the_published_one(kind):
    """sigma_l^2 = (p1 l)^2 + (p2 (l - r))^2, and r alike (notes on Brenner's lectures)."""
    p1, p2 = 0.35, 0.6
    controls = np.array([control_of_turn(kind, 0.8, turn) for turn in (0.7, -0.2, 0.0)])
    motion = model(kind, proportional=(p1, p2))
    covariances = motion.control_covariances(controls)
    for (left, right, *_), covariance in zip(controls, covariances, strict=True):
        turning = (p2 * (left - right)) ** 2
        expected = np.diag([(p1 * left) ** 2 + turning, (p1 * right) ** 2 + turning])
        assert_allclose(covariance, expected, rtol=1e-14)
    jacobian = motion.increment(controls)[1][0][:, :2]
    assert_allclose(
        motion.increments(controls).covariances[0],
        jacobian @ covariances[0] @ jacobian.T,
        rtol=1e-12,
        atol=1e-18,
    )


def test_slip_adds_to_the_lateral_variance_alone():
    control = [control_of_turn("velocity", 0.8, 0.9)]
    without = model("velocity").increments(control).covariances[0]
    with_slip = model("velocity", slip=0.1).increments(control).covariances[0]
    assert_allclose(with_slip - without, np.diag([0, 0.01, 0]), atol=1e-15)


def test_slip_makes_the_covariance_of_two_noises_regular():
    control = [control_of_turn("wheel-increments", 0.8, 0.0)]
    noise = 1e-4 * np.eye(2)
    singular = model("wheel-increments", covariance=noise).increments(control).covariances[0]
    regular = model("wheel-increments", covariance=noise, slip=1e-3).increments(control)[1][0]
    assert np.linalg.matrix_rank(singular) == 2
    assert np.linalg.eigvalsh(regular).min() > 1e-7


def test_dt_is_exact():
    for kind in ("velocity", "wheel-speeds", "car"):
        assert model(kind).noisy_controls == 2
        assert model(kind).control_names[2] == "dt"


def test_without_controls_the_increment_is_zero_and_its_noise_is_the_perturbation():
    noise = np.array([[4e-4, 1e-4, 0], [1e-4, 2e-4, -5e-5], [0, -5e-5, 1e-4]])
    held = MotionModel("none", noise, slip=0.1)
    assert held.control_names == ()
    assert held.noisy_controls == 0
    deltas, jacobians = held.increment(np.zeros((4, 0)))
    assert_array_equal(deltas, np.zeros((4, 3)))
    assert jacobians.shape == (4, 3, 0)
    increments = held.increments(np.zeros((4, 0)))
    assert_array_equal(increments.deltas, deltas)
    assert_allclose(increments.covariances, np.tile(noise + np.diag([0, 0.01, 0]), (4, 1, 1)))
    assert_array_equal(held.covariance, noise)
    assert MotionModel(**held.to_dict()) == held


# What is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"kind": "odometry"}, "give either covariance or proportional"),
        ({"kind": "none"}, "give either covariance or proportional"),
        ({"kind": "none", "covariance": np.eye(2)}, r"covariance must have shape \(3, 3\)"),
        ({"kind": "none", "proportional": (0.1, 0.1)}, "is for wheels"),
        ({"kind": "odometry", "proportional": (0.1, 0.1)}, "is for wheels"),
        (
            {"kind": "wheel-increments", "width": 1, "covariance": [[1]]},
            r"covariance must have shape \(2, 2\), got \(1, 1\)",
        ),
        (
            {
                "kind": "wheel-increments",
                "width": 1,
                "covariance": np.eye(2),
                "proportional": (0.1, 0.1),
            },
            "give either covariance or proportional",
        ),
        ({"kind": "wheel-increments", "covariance": np.eye(2)}, "needs width"),
        ({"kind": "car", "covariance": np.eye(2)}, "needs wheelbase"),
        ({"kind": "car", "covariance": np.eye(2), "wheelbase": 1, "width": 1}, "takes no width"),
        ({"kind": "car", "covariance": np.eye(2), "wheelbase": 0}, "wheelbase must be positive"),
        ({"kind": "car", "covariance": np.eye(2), "wheelbase": np.inf}, "wheelbase must be"),
        ({"kind": "wheel-increments", "width": 1, "proportional": (-0.1, 0)}, "non-negative"),
        ({"kind": "wheel-increments", "width": 1, "proportional": (0, np.nan)}, "non-negative"),
        ({"kind": "odometry", "covariance": np.eye(3), "slip": -1e-3}, "slip must be"),
        ({"kind": "odometry", "covariance": np.eye(3), "slip": np.nan}, "slip must be"),
        ({"kind": "odometry", "covariance": np.diag([1, -1, 1])}, "positive semi-definite"),
        ({"kind": "odometry", "covariance": np.diag([1, np.nan, 1])}, "NaN or infinite"),
        ({"kind": "odometry", "covariance": np.diag([1, np.inf, 1])}, "NaN or infinite"),
        ({"kind": "odometry", "covariance": np.tri(3)}, "not symmetric"),
    ],
)
def test_parameters_that_make_no_sense(settings, message):
    with pytest.raises(InputError, match=message) as caught:
        MotionModel(**settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "settings",
    [
        {"proportional": (0.1, 0.2, 0.3)},
        {"proportional": "ab"},
        {"proportional": 0.1},
        {"covariance": "ab"},
        {"covariance": [[1.0], [1.0, 2.0]]},
        {"covariance": np.eye(2), "width": "wide"},
        {"covariance": np.eye(2), "slip": "much"},
        {"covariance": np.eye(2), "slip": "0.1"},
        {"covariance": np.eye(2), "width": "0.5"},
    ],
)
def test_parameters_of_the_wrong_type(settings):
    with pytest.raises(InputError):
        MotionModel("wheel-increments", **{"width": 1.0, **settings})


def test_unknown_kind_names_the_close_ones():
    with pytest.raises(UnknownNameError, match="did you mean odometry"):
        MotionModel("odometri", covariance=np.eye(3))


@pytest.mark.parametrize("controls", [np.zeros(3), np.zeros((4, 2)), np.zeros((2, 2, 3))])
def test_controls_of_the_wrong_shape_name_the_columns(controls):
    with pytest.raises(InputError, match="dh, dl, dtheta"):
        model("odometry").increments(controls)


def test_a_control_for_a_model_without_controls():
    with pytest.raises(InputError, match=r"controls of .none. need the columns .none at all"):
        model("none").increments(np.zeros((4, 3)))


def test_covariance_is_a_read_only_copy():
    given = np.eye(3)
    motion = MotionModel("odometry", covariance=given)
    given[0, 0] = 9.0
    assert motion.covariance[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        motion.covariance[0, 0] = 9.0


def test_semi_definite_and_nearly_symmetric_covariances_are_taken():
    """Round-off in a product J P J' is no error; what comes out is symmetric."""
    rough = np.array([[1.0, 1.0 + 1e-13], [1.0, 1.0]])
    matrix = checked_covariance(rough, 2, "P")
    assert_array_equal(matrix, matrix.T)
    assert_array_equal(checked_covariance(np.zeros((2, 2)), 2, "P"), np.zeros((2, 2)))


def test_singular_covariances_are_taken_whatever_the_frame():
    """Turning v v' leaves a variance of round-off size where there was none."""
    for direction in ([1.0, 1.0, 0.0], [1.0, -1.0, 1.0], [0.3, 2.0, -1e-3]):
        covariance = np.outer(direction, direction)
        for angle in np.linspace(-np.pi, np.pi, 17):
            turned = geo.congruence(geo.heading_block(angle), covariance)
            assert_array_equal(checked_covariance(turned, 3, "P"), turned)


def test_a_small_negative_variance_beside_a_large_one_is_refused():
    """1e6 m^2 of position must not hide a heading variance of -1e-4 rad^2."""
    with pytest.raises(InputError, match="positive semi-definite"):
        checked_covariance(np.diag([1e6, 1e6, -1e-4]), 3, "P")


def test_to_dict_makes_the_same_model_again():
    for settings in ({"covariance": [[2.0, 1.0], [1.0, 3.0]]}, {"proportional": (0.1, 0.2)}):
        motion = model("wheel-speeds", slip=0.01, **settings)
        again = MotionModel(**motion.to_dict())
        controls = [control_of_turn("wheel-speeds", 1.0, 0.3)]
        for one, other in zip(motion.increments(controls), again.increments(controls), strict=True):
            assert_array_equal(one, other)


def test_two_models_can_be_compared():
    assert (model("odometry") == model("odometry")) in (True, False)
