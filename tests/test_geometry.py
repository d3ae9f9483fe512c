"""SE(2): group laws, derivatives, series, conventions of covariance, alignment, ellipses."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from numerics import assert_sampled, central_difference, subtract_last_angle
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from ekfslam import geometry as geo

HALF_TURN = math.pi
IDENTITY = np.zeros(3)


def random_poses(rng, *shape):
    return np.concatenate(
        [rng.uniform(-20, 20, (*shape, 2)), rng.uniform(-np.pi, np.pi, (*shape, 1))], axis=-1
    )


def random_covariances(rng, *shape, size=3):
    root = rng.normal(size=(*shape, size, size))
    return root @ np.swapaxes(root, -1, -2)


def assert_same_pose(a, b, atol=1e-13):
    assert_allclose(subtract_last_angle(a, b), 0.0, atol=atol)


# Angles ----------------------------------------------------------------------------------------


def test_wrap_stays_in_the_half_open_interval_and_keeps_the_direction(rng):
    angles = np.concatenate([rng.uniform(-50, 50, 10_000), np.arange(-9, 10) * HALF_TURN])
    wrapped = geo.wrap(angles)
    assert (wrapped >= -np.pi).all()
    assert (wrapped < np.pi).all()
    assert_allclose(np.exp(1j * wrapped), np.exp(1j * angles), atol=1e-13)


@pytest.mark.parametrize("angle", [HALF_TURN, -HALF_TURN, 3 * HALF_TURN, -3 * HALF_TURN])
def test_wrap_sends_every_half_turn_to_minus_pi(angle):
    assert geo.wrap(angle) == -HALF_TURN


def test_wrap_leaves_the_interval_alone(rng):
    edges = [-HALF_TURN, np.nextafter(-HALF_TURN, 0), np.nextafter(HALF_TURN, 0)]
    tiny = [0.0, 5e-324, -5e-324, 1e-17, -1e-17]
    angles = np.concatenate([rng.uniform(-np.pi, np.pi, 10_000), edges, tiny])
    assert_array_equal(geo.wrap(angles), angles)


def test_wrap_just_outside_the_interval_stays_inside():
    outside = np.array([np.nextafter(-HALF_TURN, -9), np.nextafter(HALF_TURN, 9)])
    wrapped = geo.wrap(outside)
    assert (wrapped >= -np.pi).all()
    assert (wrapped < np.pi).all()
    assert_allclose(np.exp(1j * wrapped), np.exp(1j * outside), atol=1e-15)


# The group -------------------------------------------------------------------------------------


def test_composition_is_associative(rng):
    a, b, c = random_poses(rng, 3, 200)
    assert_same_pose(geo.compose(geo.compose(a, b), c), geo.compose(a, geo.compose(b, c)), 1e-12)


def test_identity_is_neutral(rng):
    a = random_poses(rng, 200)
    assert_array_equal(geo.compose(a, IDENTITY), a)
    assert_array_equal(geo.compose(IDENTITY, a), a)


def test_inverse_on_both_sides(rng):
    a = random_poses(rng, 200)
    assert_same_pose(geo.compose(geo.inverse(a), a), IDENTITY)
    assert_same_pose(geo.compose(a, geo.inverse(a)), IDENTITY)


def test_between_leads_from_one_pose_to_the_other(rng):
    a, b = random_poses(rng, 2, 200)
    assert_same_pose(geo.compose(a, geo.between(a, b)), b)
    assert_same_pose(geo.between(a, b), geo.compose(geo.inverse(a), b))


def test_composition_is_the_product_of_homogeneous_matrices(rng):
    def matrix(pose):
        x, y, theta = pose
        c, s = math.cos(theta), math.sin(theta)
        return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])

    for a, b in random_poses(rng, 20, 2):
        assert_allclose(matrix(geo.compose(a, b)), matrix(a) @ matrix(b), atol=1e-13)


def test_integrate_chains_composition(rng):
    start, increments = random_poses(rng), random_poses(rng, 50)
    poses = geo.integrate(start, increments)
    expected = [start]
    for increment in increments:
        expected.append(geo.compose(expected[-1], increment))
    assert_same_pose(poses, np.array(expected), 1e-11)
    assert_same_pose(geo.between(poses[:-1], poses[1:]), increments, 1e-11)


def test_integrate_without_increments_is_the_start():
    assert_array_equal(geo.integrate([1.0, 2.0, 3.0], np.zeros((0, 3))), [[1.0, 2.0, 3.0]])


def test_frames_are_inverse_and_agree_with_composition(rng):
    frame, point = random_poses(rng, 100), rng.normal(size=(100, 2))
    world = geo.from_frame(frame, point)
    assert_allclose(geo.to_frame(frame, world), point, atol=1e-13)
    as_pose = np.column_stack([point, np.zeros(100)])
    assert_allclose(world, geo.compose(frame, as_pose)[:, :2], atol=1e-13)


def test_perpendicular_is_the_derivative_of_a_rotation(rng):
    v = rng.normal(size=2)
    slope = central_difference(lambda t: geo.rotation(t[0]) @ v, [0.0])[:, 0]
    assert_allclose(geo.perpendicular(v), slope, atol=1e-12)


# Jacobians -------------------------------------------------------------------------------------


def test_compose_jacobians_are_central_differences(rng):
    for a, b in random_poses(rng, 20, 2):
        wrt_a, wrt_b = geo.compose_jacobians(a, b)
        numeric_a = central_difference(
            lambda x, b=b: geo.compose(x, b), a, difference=subtract_last_angle
        )
        numeric_b = central_difference(
            lambda x, a=a: geo.compose(a, x), b, difference=subtract_last_angle
        )
        assert_allclose(wrt_a, numeric_a, atol=1e-9)
        assert_allclose(wrt_b, numeric_b, atol=1e-9)


@pytest.mark.parametrize(
    ("function", "jacobians"),
    [(geo.from_frame, geo.from_frame_jacobians), (geo.to_frame, geo.to_frame_jacobians)],
)
def test_frame_jacobians_are_central_differences(function, jacobians, rng):
    for frame, point in zip(random_poses(rng, 20), rng.uniform(-9, 9, (20, 2)), strict=True):
        wrt_frame, wrt_point = jacobians(frame, point)
        numeric_frame = central_difference(lambda x, point=point: function(x, point), frame)
        numeric_point = central_difference(lambda x, frame=frame: function(frame, x), point)
        assert_allclose(wrt_frame, numeric_frame, atol=1e-9)
        assert_allclose(wrt_point, numeric_point, atol=1e-9)


@pytest.mark.parametrize(
    "jacobians", [geo.compose_jacobians, geo.from_frame_jacobians, geo.to_frame_jacobians]
)
def test_jacobians_broadcast(jacobians, rng):
    second = random_poses(rng, 5) if jacobians is geo.compose_jacobians else rng.normal(size=(5, 2))
    frame = random_poses(rng)
    together = jacobians(frame, second)
    for k in range(5):
        for stacked, single in zip(together, jacobians(frame, second[k]), strict=True):
            assert_array_equal(stacked[k], single)


# Arcs, exponential and logarithm ---------------------------------------------------------------


def exact_arc(angle):
    """s, c and their derivatives from the power series in rational numbers."""
    a = Fraction(angle)
    s = sum((-1) ** k * a ** (2 * k) / math.factorial(2 * k + 1) for k in range(25))
    c = sum((-1) ** k * a ** (2 * k + 1) / math.factorial(2 * k + 2) for k in range(25))
    ds = sum((-1) ** k * 2 * k * a ** (2 * k - 1) / math.factorial(2 * k + 1) for k in range(1, 25))
    dc = sum((-1) ** k * (2 * k + 1) * a ** (2 * k) / math.factorial(2 * k + 2) for k in range(25))
    return [float(term) for term in (s, c, ds, dc)]


ARC_ANGLES = [*np.geomspace(1e-14, 3.0, 43).tolist(), 0.299999, 0.3, 0.300001]


@pytest.mark.parametrize("sign", [1, -1])
def test_arc_coefficients_are_their_power_series(sign):
    angles = sign * np.array(ARC_ANGLES)
    got = [*geo.arc_coefficients(angles), *geo.arc_coefficient_derivatives(angles)]
    expected = np.array([exact_arc(angle) for angle in angles.tolist()]).T
    assert_allclose(got, expected, rtol=0, atol=1e-14)
    # The odd ones vanish with the angle: there the relative error counts.
    assert_allclose(got[1], expected[1], rtol=1e-13)
    assert_allclose(got[2], expected[2], rtol=1e-13)


def test_arc_coefficients_at_zero():
    s, c = geo.arc_coefficients(0.0)
    ds, dc = geo.arc_coefficient_derivatives(0.0)
    assert (s, c, ds, dc) == (1.0, 0.0, 0.0, 0.5)


def test_log_is_the_inverse_of_exp(rng):
    xi = random_poses(rng, 500)
    xi[:40, 2] *= np.geomspace(1e-16, 1, 40)
    assert_allclose(subtract_last_angle(geo.log(geo.exp(xi)), xi), 0, atol=1e-12)
    assert_same_pose(geo.exp(geo.log(xi)), xi, 1e-12)


def test_log_and_exp_at_half_a_turn():
    pose = np.array([1.0, 2.0, -HALF_TURN])
    assert_same_pose(geo.exp(geo.log(pose)), pose)


def test_exp_is_the_limit_of_many_small_steps(rng):
    xi = random_poses(rng)
    step, count = geo.exp(xi / 2**20), 20
    for _ in range(count):
        step = geo.compose(step, step)
    assert_same_pose(step, geo.exp(xi), 1e-8)
    # The matrix exponential itself, to first order, pins the scale of one small step.
    assert_allclose(geo.exp(1e-9 * xi), 1e-9 * xi, rtol=1e-7)


# Conventions of covariance ---------------------------------------------------------------------


def test_congruence_is_symmetric_to_the_last_bit(rng):
    matrix, covariance = rng.normal(size=(50, 2, 3)), random_covariances(rng, 50)
    product = geo.congruence(matrix, covariance)
    assert_array_equal(product, np.swapaxes(product, -1, -2))
    assert_allclose(product[7], matrix[7] @ covariance[7] @ matrix[7].T, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("there", "back"),
    [
        (geo.additive_to_body, geo.body_to_additive),
        (geo.additive_to_invariant, geo.invariant_to_additive),
    ],
)
def test_conversions_of_covariance_are_inverse(there, back, rng):
    pose, covariance = random_poses(rng, 50), random_covariances(rng, 50)
    assert_allclose(back(pose, there(pose, covariance)), covariance, atol=1e-9)
    assert_allclose(there(pose, back(pose, covariance)), covariance, atol=1e-9)
    assert not np.allclose(there(pose, covariance), covariance)


def test_conversions_of_covariance_follow_from_the_definitions_of_the_errors(rng):
    """Each is J P J' with J the derivative of the additive error with respect to the other."""
    for pose, covariance in zip(random_poses(rng, 10), random_covariances(rng, 10), strict=True):
        body = central_difference(
            lambda xi, pose=pose: subtract_last_angle(geo.compose(pose, geo.exp(xi)), pose),
            IDENTITY,
            difference=subtract_last_angle,
        )
        invariant = central_difference(
            lambda xi, pose=pose: subtract_last_angle(geo.compose(geo.exp(xi), pose), pose),
            IDENTITY,
            difference=subtract_last_angle,
        )
        assert_allclose(
            geo.body_to_additive(pose, covariance), body @ covariance @ body.T, atol=1e-9
        )
        assert_allclose(
            geo.invariant_to_additive(pose, covariance),
            invariant @ covariance @ invariant.T,
            rtol=1e-9,
            atol=1e-9,
        )


@pytest.mark.parametrize("side", ["body", "invariant"])
def test_conversions_of_covariance_match_drawn_errors(side, rng):
    pose, covariance = np.array([3.0, -2.0, 0.8]), 1e-6 * random_covariances(rng)
    xi = rng.multivariate_normal(IDENTITY, covariance, 100_000)
    if side == "body":
        truth, converted = (
            geo.compose(pose, geo.exp(xi)),
            geo.body_to_additive(pose, covariance),
        )
    else:
        truth, converted = (
            geo.compose(geo.exp(xi), pose),
            geo.invariant_to_additive(pose, covariance),
        )
    assert_sampled(subtract_last_angle(truth, pose), converted)


def test_additive_error_wraps_the_heading_and_only_the_heading():
    error = geo.additive_error([0.0, 0.0, 3.0], [5.0, -5.0, -3.0])
    assert_allclose(error, [5.0, -5.0, 2 * np.pi - 6.0], atol=1e-15)


def test_invariant_error_is_the_one_that_made_the_truth(rng):
    estimate, xi = random_poses(rng, 100), 0.3 * random_poses(rng, 100)
    truth = geo.compose(geo.exp(xi), estimate)
    assert_allclose(geo.invariant_error(truth, estimate), xi, atol=1e-11)


def test_invariant_error_does_not_see_the_common_motion(rng):
    truth, estimate, motion = random_poses(rng, 3, 50)
    moved = geo.invariant_error(geo.compose(truth, motion), geo.compose(estimate, motion))
    assert_allclose(subtract_last_angle(moved, geo.invariant_error(truth, estimate)), 0, atol=1e-9)


# Rigid motions and ellipses --------------------------------------------------------------------


def test_align_recovers_a_known_motion(rng):
    for motion in random_poses(rng, 20):
        source = rng.uniform(-30, 30, (12, 2))
        assert_same_pose(geo.align(source, geo.from_frame(motion, source)), motion, 1e-12)


def test_align_of_a_mirrored_set_is_still_a_rotation(rng):
    source = rng.normal(size=(9, 2))
    motion = geo.align(source, source * [1.0, -1.0])
    assert motion.shape == (3,)
    assert_allclose(np.linalg.det(geo.rotation(motion[2])), 1.0)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_align_beats_every_perturbation_of_it(mirror, rng):
    source = rng.uniform(-5, 5, (15, 2))
    target = geo.from_frame([1.0, 2.0, 2.5], source * [1.0, mirror]) + rng.normal(size=(15, 2))

    def cost(motion):
        return np.sum((geo.from_frame(motion, source) - target) ** 2)

    best = geo.align(source, target)
    for perturbation in rng.normal(size=(300, 3)):
        for scale in (1e-4, 1e-2, 1.0):
            assert cost(best) < cost(best + scale * perturbation)


COVARIANCES = [
    [[4.0, 1.5], [1.5, 1.0]],
    [[1e-8, 0.0], [0.0, 9.0]],
    [[2.0, -1.9], [-1.9, 2.0]],
]


@pytest.mark.parametrize("covariance", COVARIANCES)
@pytest.mark.parametrize("sigmas", [1.0, 2.0, 3.0])
def test_ellipse_is_the_locus_of_a_mahalanobis_distance(covariance, sigmas):
    mean = np.array([5.0, -3.0])
    contour = geo.ellipse(mean, covariance, sigmas, points=33) - mean
    assert contour.shape == (33, 2)
    distance = np.sqrt(np.einsum("ki,ij,kj->k", contour, np.linalg.inv(covariance), contour))
    assert_allclose(distance, sigmas, rtol=1e-8)
    assert_allclose(contour[0], contour[-1], atol=1e-14)


def test_ellipses_broadcast(rng):
    means, covariances = rng.normal(size=(4, 2)), random_covariances(rng, 4, size=2)
    contours = geo.ellipse(means, covariances)
    assert contours.shape == (4, 64, 2)
    assert_allclose(contours[2], geo.ellipse(means[2], covariances[2]), atol=1e-14)


@pytest.mark.parametrize(("sigmas", "share"), [(1, 0.393), (2, 0.865), (3, 0.989)])
def test_ellipse_encloses_its_share_of_probability(sigmas, share, rng):
    """Points inside the polygon are counted, so the size of the contour itself is tested."""
    assert chi2.cdf(sigmas**2, df=2) == pytest.approx(share, abs=5e-4)
    covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
    contour = geo.ellipse([0, 0], covariance, sigmas, points=721)
    draws = rng.multivariate_normal([0, 0], covariance, 40_000)
    bearing = np.arctan2(draws[:, 1], draws[:, 0])
    edge_bearing = np.arctan2(contour[:-1, 1], contour[:-1, 0])
    order = np.argsort(edge_bearing)
    edge = np.interp(
        bearing,
        edge_bearing[order],
        np.hypot(*contour[:-1].T)[order],
        period=2 * np.pi,
    )
    inside = np.mean(np.hypot(*draws.T) < edge)
    assert abs(inside - share) < 5 * math.sqrt(share * (1 - share) / 40_000) + 1e-3
