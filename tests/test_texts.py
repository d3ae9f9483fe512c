"""The closed forms of the five texts against ours, and their errors against derivatives.

Each text is cited by its author, the notes on Brenner's lectures and the anonymous "Extended
Kalman Filter SLAM" by their titles. Where a text is right, its Jacobian must equal ours; where it
is wrong, as printed it must differ from a numerical derivative while ours agrees.
"""

from __future__ import annotations

import numpy as np
import pytest
from numerics import central_difference, subtract_angles, subtract_last_angle
from numpy.testing import assert_allclose
from scipy.stats import chi2

from ekfslam import geometry as geo
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

TIGHT = {"rtol": 0, "atol": 1e-9}

POSE = np.array([1.5, -0.7, 0.9])
POINT = np.array([4.2, 3.1])
POSES = np.array([POSE, [0.0, 0.0, 0.0], [-3.0, 2.0, -2.6], [0.4, 1.0, 1.7]])
POINTS = np.array([POINT, [-2.0, 0.5], [1.0, -4.0]])

# Where turn times width is lost in the wheels' round-off, the closed forms of the texts are worth
# nothing (they divide by the square of the turn); their limits are tested apart.
TURNS = [3.0, 1.2, -0.8, 0.1, -0.02]
WIDTH = 0.55


def rotation(theta):
    c, s = np.cos(theta), np.sin(theta)
    return np.array([[c, -s], [s, c]])


def motion_jacobians(model, pose, control):
    """G and V of the world frame, from the body increment of a model."""
    delta, jacobian = (array[0] for array in model.increment([control]))
    wrt_pose, wrt_delta = geo.compose_jacobians(pose, delta)
    return wrt_pose, wrt_delta @ jacobian


def moved(model, pose, control):
    return geo.compose(pose, model.increment([control])[0][0])


# Notes on the EKF of Brenner's lectures --------------------------------------------------------

WHEELS = MotionModel("wheel-increments", covariance=np.eye(2), width=WIDTH)


def wheel_controls():
    return [(0.8 - 0.5 * WIDTH * turn, 0.8 + 0.5 * WIDTH * turn) for turn in TURNS]


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize(("left", "right"), wheel_controls())
def test_brenner_motion_in_both_published_forms(pose, left, right):
    x, y, theta = pose
    alpha = (right - left) / WIDTH
    for radius in (
        left / alpha + WIDTH / 2,
        (right + left) / (right - left) * WIDTH / 2,
    ):
        expected = [
            x + radius * (np.sin(theta + alpha) - np.sin(theta)),
            y + radius * (-np.cos(theta + alpha) + np.cos(theta)),
            theta + alpha,
        ]
        difference = subtract_last_angle(moved(WHEELS, pose, (left, right)), expected)
        assert_allclose(difference, 0, atol=1e-12)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize(("left", "right"), wheel_controls())
def test_brenner_jacobians(pose, left, right):
    theta = pose[2]
    alpha = (right - left) / WIDTH
    radius = left / alpha + WIDTH / 2
    dcos = np.cos(theta + alpha) - np.cos(theta)
    dsin = np.sin(theta + alpha) - np.sin(theta)
    expected_G = [[1, 0, radius * dcos], [0, 1, radius * dsin], [0, 0, 1]]
    square, ratio = (right - left) ** 2, (right + left) / (right - left)
    c, s = np.cos(theta + alpha), np.sin(theta + alpha)
    expected_V = [
        [
            WIDTH * right / square * dsin - ratio / 2 * c,
            -WIDTH * left / square * dsin + ratio / 2 * c,
        ],
        [
            -WIDTH * right / square * dcos - ratio / 2 * s,
            WIDTH * left / square * dcos + ratio / 2 * s,
        ],
        [-1 / WIDTH, 1 / WIDTH],
    ]
    G, V = motion_jacobians(WHEELS, pose, (left, right))
    assert_allclose(G, expected_G, **TIGHT)
    assert_allclose(V, expected_V, **TIGHT)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("way", [0.8, -0.3, 0.0])
def test_brenner_limits_of_equal_wheels(pose, way):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    k = way / WIDTH
    expected_G = [[1, 0, -way * s], [0, 1, way * c], [0, 0, 1]]
    expected_V = [
        [(c + k * s) / 2, (c - k * s) / 2],
        [(s - k * c) / 2, (s + k * c) / 2],
        [-1 / WIDTH, 1 / WIDTH],
    ]
    for difference in (0.0, 1e-14, -1e-14):
        G, V = motion_jacobians(WHEELS, pose, (way - difference, way + difference))
        assert_allclose(G, expected_G, **TIGHT)
        assert_allclose(V, expected_V, **TIGHT)


def test_brenner_control_covariance_and_its_size():
    """Sigma_control of p1, p2; R = V Sigma V' is 3 x 3, not 3 x 2 as the notes say."""
    left, right, p1, p2 = 0.5, 0.7, 0.3, 0.6
    model = MotionModel("wheel-increments", proportional=(p1, p2), width=WIDTH)
    turning = (p2 * (left - right)) ** 2
    control = np.diag([(p1 * left) ** 2 + turning, (p1 * right) ** 2 + turning])
    _, V = motion_jacobians(model, POSE, (left, right))
    body = model.increments([(left, right)]).covariances[0]
    world = geo.body_to_additive(POSE, body)
    assert world.shape == (3, 3)
    assert_allclose(world, V @ control @ V.T, atol=1e-15)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("ahead", [0.0, 0.35])
def test_brenner_scanner_ahead_of_the_axle(pose, point, ahead):
    scanner = Sensor("range-bearing", np.eye(2), mount=[ahead, 0.0, 0.0])
    x, y, theta = pose
    dx = point[0] - (x + ahead * np.cos(theta))
    dy = point[1] - (y + ahead * np.sin(theta))
    q = dx**2 + dy**2
    c, s = np.cos(theta), np.sin(theta)
    expected = [
        [-dx / np.sqrt(q), -dy / np.sqrt(q), ahead / np.sqrt(q) * (dx * s - dy * c)],
        [dy / q, -dx / q, -ahead / q * (dx * c + dy * s) - 1],
    ]
    value, H, _ = scanner.observe(pose, point)
    assert_allclose(H, expected, **TIGHT)
    assert_allclose(value[0], np.sqrt(q), atol=1e-12)
    located = [
        x + ahead * c + value[0] * np.cos(theta + value[1]),
        y + ahead * s + value[0] * np.sin(theta + value[1]),
    ]
    assert_allclose(scanner.locate(pose, value)[0], located, atol=1e-12)
    assert_allclose(located, point, atol=1e-12)


def test_brenner_arctan_must_be_atan2():
    """Of a point behind the scanner, the printed arctan sees the opposite direction."""
    scanner = Sensor("range-bearing", np.eye(2))
    for point, error in (([3.0, 1.0], 0.0), ([-3.0, 1.0], np.pi)):
        printed = np.arctan(point[1] / point[0])
        bearing = scanner.observe(np.zeros(3), point)[0][1]
        assert_allclose(np.abs(subtract_angles(printed, bearing)), error, atol=1e-12)
        assert_allclose(scanner.locate(np.zeros(3), [np.hypot(*point), bearing])[0], point)


def test_brenner_note_about_angles():
    """150 degrees less -135 degrees is -75 degrees."""
    values, expected = np.deg2rad([[0.0, 150.0], [0.0, -135.0]])
    difference = Sensor("range-bearing", np.eye(2)).difference(values, expected)
    assert_allclose(np.rad2deg(difference), [0.0, -75.0], atol=1e-12)


# Ciatto ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("pose", POSES)
def test_ciatto_eq_2_1_is_an_euler_step(pose):
    vl, vr, dt, half = 0.9, 1.4, 0.5, WIDTH / 2
    turn = rotation(pose[2])
    step = dt * np.array([(vl + vr) / 2, 0.0, (vr - vl) / (2 * half)])
    printed = pose + np.append(turn @ step[:2], step[2])
    settings = {"covariance": np.eye(2), "width": WIDTH}
    euler = moved(MotionModel("wheel-speeds-euler", **settings), pose, (vl, vr, dt))
    exact = moved(MotionModel("wheel-speeds", **settings), pose, (vl, vr, dt))
    assert_allclose(subtract_last_angle(euler, printed), 0, atol=1e-14)
    # Half the turn across the way, to first order.
    gap = np.linalg.norm(exact[:2] - printed[:2])
    assert gap == pytest.approx(step[0] * step[2] / 2, rel=0.02)
    # A hundred of its steps come a hundred times nearer to the arc.
    fine = np.tile([vl, vr, dt / 100], (100, 1))
    model = MotionModel("wheel-speeds-euler", **settings)
    end = geo.integrate(pose, model.increment(fine)[0])[-1]
    assert np.linalg.norm(exact[:2] - end[:2]) == pytest.approx(gap / 100, rel=0.05)


@pytest.mark.parametrize("pose", POSES)
def test_ciatto_eq_2_2_odometry(pose):
    control = np.array([0.6, -0.1, 0.4])
    printed = pose + np.append(rotation(pose[2]) @ control[:2], control[2])
    model = MotionModel("odometry", covariance=np.eye(3))
    assert_allclose(subtract_last_angle(moved(model, pose, control), printed), 0, atol=1e-14)


@pytest.mark.parametrize("pose", POSES)
def test_ciatto_eq_2_3_takes_the_first_column(pose):
    """rho multiplies the first column of the rotation by alpha; as printed, a matrix comes out."""
    offset, (rho, alpha) = np.array([0.3, -0.2]), (3.0, 0.7)
    sensor = Sensor("range-bearing", np.eye(2), mount=[*offset, 0.0])
    right = rotation(pose[2]) @ (offset + rho * rotation(alpha)[:, 0]) + pose[:2]
    printed = rotation(pose[2]) @ (offset[:, None] + rho * rotation(alpha)) + pose[:2, None]
    located = sensor.locate(pose, [rho, alpha])[0]
    assert printed.shape == (2, 2)
    assert_allclose(located, right, atol=1e-14)
    assert_allclose(located, printed[:, 0], atol=1e-14)
    assert np.linalg.norm(located - printed[:, 1]) > 1.0


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("point", POINTS)
def test_ciatto_direct_model_off_centre(pose, point):
    """Section 2.3 with Eq. 2.4."""
    offset = np.array([0.3, -0.2])
    xs, ys = rotation(pose[2]) @ offset + pose[:2]
    expected = [
        np.hypot(point[0] - xs, point[1] - ys),
        np.arctan2(point[1] - ys, point[0] - xs) - pose[2],
    ]
    value = Sensor("range-bearing", np.eye(2), mount=[*offset, 0.0]).observe(pose, point)[0]
    assert_allclose(subtract_last_angle(value, expected), 0, atol=1e-14)


def test_ciatto_a_2_subtracts_before_it_rotates():
    """With scales of one, A.2 turns and then subtracts t; the inverse of A.1 does the opposite."""
    transformed = rotation(POSE[2]) @ POINT + POSE[:2]
    printed = rotation(POSE[2]).T @ transformed - POSE[:2]
    assert_allclose(geo.to_frame(POSE, transformed), POINT, atol=1e-14)
    assert np.linalg.norm(printed - POINT) > 0.1


def test_ciatto_a_2_does_not_invert_the_scales():
    c, s, sx, sy = np.cos(0.4), np.sin(0.4), 2.0, 3.0
    forward = np.array([[sx * c, -s], [s, sy * c]])
    printed = np.array([[c / sx, s], [-s, c / sy]])
    assert np.abs(printed @ forward - np.eye(2)).max() > 0.1


def test_ciatto_3_7_maps_the_measurement_error_by_the_measurement():
    """Lambda of the new landmark is d lambda / d s; the landmark is no argument of lambda."""
    sensor = Sensor("range-bearing", np.eye(2))
    value = np.array([3.0, 0.7])
    _, _, wrt_value = sensor.locate(POSE, value)
    numeric = central_difference(lambda s: sensor.locate(POSE, s)[0], value)
    assert_allclose(wrt_value, numeric, **TIGHT)
    assert np.abs(wrt_value - np.eye(2)).max() > 0.5


# "Extended Kalman Filter SLAM" -----------------------------------------------------------------

VELOCITY = MotionModel("velocity", covariance=np.eye(2))


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("omega", [2.0, -0.7, 0.05])
def test_ekf_slam_text_velocity_motion_and_signs_of_its_jacobian(pose, omega):
    """Section 3.4 is right; line 4 of the algorithm has both signs flipped."""
    v, dt = 1.1, 0.8
    theta, ratio = pose[2], v / omega
    after = theta + omega * dt
    way = [
        -ratio * np.sin(theta) + ratio * np.sin(after),
        ratio * np.cos(theta) - ratio * np.cos(after),
        omega * dt,
    ]
    expected = np.add(pose, way)
    control = (v, omega, dt)
    assert_allclose(subtract_last_angle(moved(VELOCITY, pose, control), expected), 0, atol=1e-12)

    section = np.eye(3)
    section[0, 2] = -ratio * np.cos(theta) + ratio * np.cos(after)
    section[1, 2] = -ratio * np.sin(theta) + ratio * np.sin(after)
    line = 2 * np.eye(3) - section
    numeric = central_difference(
        lambda x: moved(VELOCITY, x, control), pose, difference=subtract_last_angle
    )
    G, _ = motion_jacobians(VELOCITY, pose, control)
    assert_allclose(G, numeric, **TIGHT)
    assert_allclose(section, numeric, **TIGHT)
    assert np.abs(line - numeric).max() > 0.1


def test_ekf_slam_text_adds_the_identity_twice():
    """Section 3.4 adds I to a block that holds ones already: the pose covariance grows fourfold."""
    G, _ = motion_jacobians(VELOCITY, POSE, (1.0, 0.5, 0.1))
    covariance = np.diag([1.0, 2.0, 0.0])
    printed = np.eye(3) + G
    assert_allclose(geo.congruence(G, covariance), covariance, atol=1e-14)
    assert_allclose(geo.congruence(printed, covariance), 4 * covariance, atol=1e-14)


def test_ekf_slam_text_does_not_treat_a_straight_line():
    v, dt = 1.1, 0.8
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.float64(v) / 0.0
        printed = -ratio * np.sin(POSE[2]) + ratio * np.sin(POSE[2])
    assert np.isnan(printed)
    way = v * dt * np.array([np.cos(POSE[2]), np.sin(POSE[2])])
    assert_allclose(moved(VELOCITY, POSE, (v, 0.0, dt))[:2], POSE[:2] + way, atol=1e-14)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("point", POINTS)
def test_ekf_slam_text_observation_factor_is_one_over_q(pose, point):
    """Printed with 1 / sqrt(q): both rows are too large by the range itself."""
    dx, dy = point - pose[:2]
    q = dx**2 + dy**2
    root = np.sqrt(q)
    matrix = np.array([[-root * dx, -root * dy, 0, root * dx, root * dy], [dy, -dx, -q, -dy, dx]])
    sensor = Sensor("range-bearing", np.eye(2))
    numeric = central_difference(
        lambda x: sensor.observe(x[:3], x[3:])[0],
        [*pose, *point],
        difference=subtract_last_angle,
    )
    _, wrt_pose, wrt_point = sensor.observe(pose, point)
    assert_allclose(np.hstack([wrt_pose, wrt_point]), numeric, **TIGHT)
    assert_allclose(matrix / q, numeric, **TIGHT)
    assert_allclose(matrix / root, root * numeric, atol=1e-8)
    assert np.abs(matrix / root - numeric).max() > 0.1


# Principles of Robot Autonomy, chapter 17 ------------------------------------------------------


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("point", POINTS)
def test_autonomy_eq_17_3(pose, point):
    dx, dy = point - pose[:2]
    q = dx**2 + dy**2
    root = np.sqrt(q)
    expected = [
        [-dx / root, -dy / root, 0, dx / root, dy / root],
        [dy / q, -dx / q, -1, -dy / q, dx / q],
    ]
    sensor = Sensor("range-bearing", np.eye(2))
    value, wrt_pose, wrt_point = sensor.observe(pose, point)
    assert_allclose(np.hstack([wrt_pose, wrt_point]), expected, **TIGHT)
    bearing = value[1] + pose[2]
    expected_point = pose[:2] + value[0] * np.array([np.cos(bearing), np.sin(bearing)])
    assert_allclose(sensor.locate(pose, value)[0], expected_point, atol=1e-13)


def test_autonomy_eq_17_2_needs_its_angles_wrapped():
    """As printed, two nearly equal bearings differ by a whole turn; so do those of other texts."""
    pose, point = np.array([0.0, 0.0, 3.0]), np.array([-3.0, -0.1])
    printed = np.arctan2(point[1], point[0]) - pose[2]
    sensor = Sensor("range-bearing", np.eye(2))
    value = sensor.observe(pose, point)[0]
    assert abs(value[1] - printed) == pytest.approx(2 * np.pi)
    expected = [value[0], printed]
    assert_allclose(sensor.difference(value, expected), 0, atol=1e-12)


# Solà ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", POSES)
@pytest.mark.parametrize("point", POINTS)
def test_sola_c_1_1_frame_transformations(frame, point):
    x, y, a = frame
    px, py = point
    c, s = np.cos(a), np.sin(a)
    to_frame = [
        [-c, -s, c * (py - y) - s * (px - x)],
        [s, -c, -c * (px - x) - s * (py - y)],
    ]
    from_frame = [[1, 0, -py * c - px * s], [0, 1, px * c - py * s]]
    assert_allclose(geo.to_frame(frame, point), rotation(a).T @ (point - frame[:2]), atol=1e-14)
    assert_allclose(geo.from_frame(frame, point), rotation(a) @ point + frame[:2], atol=1e-14)
    for printed, ours in (
        ((to_frame, rotation(a).T), geo.to_frame_jacobians(frame, point)),
        ((from_frame, rotation(a)), geo.from_frame_jacobians(frame, point)),
    ):
        assert_allclose(ours[0], printed[0], **TIGHT)
        assert_allclose(ours[1], printed[1], **TIGHT)


SCANNER = Sensor("range-bearing", np.eye(2))


@pytest.mark.parametrize("point", POINTS)
def test_sola_c_1_2_scan_whose_jacobian_is_missing_in_print(point):
    px, py = point
    d = np.hypot(px, py)
    expected = [[px / d, py / d], [-py / d**2, px / d**2]]
    view = SCANNER.view
    numeric = central_difference(view.project, point, difference=subtract_last_angle)
    assert_allclose(view.project_jacobian(point), expected, **TIGHT)
    assert_allclose(numeric, expected, **TIGHT)


@pytest.mark.parametrize(("d", "a"), [(3.0, 0.4), (1.0, -3.0), (0.5, np.pi / 2)])
def test_sola_c_1_3_back_projection(d, a):
    expected = [[np.cos(a), -d * np.sin(a)], [np.sin(a), d * np.cos(a)]]
    value = np.array([d, a])
    assert_allclose(SCANNER.view.back_project(value), [d * np.cos(a), d * np.sin(a)], atol=1e-15)
    assert_allclose(SCANNER.view.back_project_jacobian(value), expected, **TIGHT)


@pytest.mark.parametrize("pose", POSES)
def test_sola_c_2_1_move(pose):
    advance, turn = 0.9, 2.5
    model = MotionModel("advance-turn", covariance=np.eye(2))
    c, s = np.cos(pose[2]), np.sin(pose[2])
    wrt_pose = [[1, 0, -advance * s], [0, 1, advance * c], [0, 0, 1]]
    wrt_noise = [[c, 0], [s, 0], [0, 1]]
    expected = [pose[0] + advance * c, pose[1] + advance * s, pose[2] + turn]
    after = moved(model, pose, (advance, turn))
    assert_allclose(subtract_last_angle(after, expected), 0, atol=1e-14)
    assert -np.pi <= after[2] < np.pi
    G, V = motion_jacobians(model, pose, (advance, turn))
    assert_allclose(G, wrt_pose, **TIGHT)
    assert_allclose(V, wrt_noise, **TIGHT)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("point", POINTS)
def test_sola_c_2_2_chain_rule_of_the_direct_model(pose, point):
    """Printed `Y_p = Y_p * PR_p`: it must be the scan's Jacobian that multiplies PR_p."""
    px, py = rotation(pose[2]).T @ (point - pose[:2])
    d = np.hypot(px, py)
    Y_pr = np.array([[px / d, py / d], [-py / d**2, px / d**2]])
    PR_r, PR_p = geo.to_frame_jacobians(pose, point)
    numeric = central_difference(
        lambda p: SCANNER.observe(pose, p)[0], point, difference=subtract_last_angle
    )
    _, Y_r, Y_p = SCANNER.observe(pose, point)
    assert_allclose(Y_p, numeric, **TIGHT)
    assert_allclose(Y_pr @ PR_p, numeric, **TIGHT)
    assert_allclose(Y_r, Y_pr @ PR_r, **TIGHT)
    if pose[2]:  # otherwise the two frames are parallel and the turn does nothing
        assert np.abs(numeric @ PR_p - numeric).max() > 0.1


@pytest.mark.parametrize("pose", POSES)
def test_sola_c_2_3_inverse_model_gives_a_global_point(pose):
    """The help of `invObserve` says sensor frame; what comes out is in the global one."""
    value = np.array([3.0, 0.7])
    local = SCANNER.view.back_project(value)
    P_r, P_pr = geo.from_frame_jacobians(pose, local)
    point, wrt_pose, wrt_value = SCANNER.locate(pose, value)
    assert_allclose(point, rotation(pose[2]) @ local + pose[:2], atol=1e-14)
    assert_allclose(wrt_pose, P_r, **TIGHT)
    assert_allclose(wrt_value, P_pr @ SCANNER.view.back_project_jacobian(value), **TIGHT)


def test_sola_table_3_is_right_and_its_sentence_is_not(rng):
    """In the plane 2 and 3 sigma enclose 86.5 % and 98.9 %, not "97 % to 99 %"."""
    shares = chi2.cdf(np.array([1, 2, 3, 4]) ** 2, df=2)
    assert_allclose(shares, [0.394, 0.865, 0.989, 0.9997], atol=6e-4)
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
    draws = rng.multivariate_normal([0, 0], covariance, 40_000)
    squared = np.einsum("ki,ij,kj->k", draws, np.linalg.inv(covariance), draws)
    for sigmas, share in ((2, 0.8647), (3, 0.9889)):
        spread = np.sqrt(share * (1 - share) / len(draws))
        assert np.mean(squared < sigmas**2) == pytest.approx(share, abs=5 * spread)
    assert shares[1] < 0.97 - 0.1
