"""Where the texts are wrong or loose on partial observations, in listings, and elsewhere.

`tests/test_texts.py` has the closed forms of the texts; here are the traps of Solà's 2.3.5 and
2.3.6 and of the algorithms, each against a limit, a derivative or drawn samples.
"""

from __future__ import annotations

import numpy as np
import pytest
from numerics import assert_sampled, central_difference, subtract_angles, subtract_last_angle
from numpy.testing import assert_allclose

from ekfslam import EkfSlam
from ekfslam import geometry as geo
from ekfslam.dataset import Prior, Sightings
from ekfslam.evaluation import pose_nees
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.models.landmarks import depth_prior, inverse_depth, observe_inverse_depth
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import simulate
from ekfslam.simulation.worlds import cloister

LASER = Sensor("range-bearing", np.diag([0.01, 0.0004]), mount=[0.3, -0.1, 0.2])
CAMERA = Sensor("bearing", [[1e-4]], min_range=0.5)
MOUNTED = Sensor("bearing", [[1e-4]], mount=[0.4, -0.3, 1.2], min_range=0.5)


# Solà ------------------------------------------------------------------------------------------


def line_of_sight(pose, landmark):
    """v of Eq. 50, and scaled by rho of Eq. 51."""
    direction = np.array([np.cos(landmark[2]), np.sin(landmark[2])])
    scaled = landmark[3] * (landmark[:2] - pose[:2]) + direction
    with np.errstate(divide="ignore"):
        return scaled / landmark[3], scaled


@pytest.mark.parametrize("alpha", [0.3, 1.8, -2.5])
def test_sola_eq_52_needs_atan2_of_the_scaled_line_of_sight(alpha):
    """Of one argument it is off by pi behind the y axis; of the unscaled v, beyond infinity."""
    pose = np.array([0.5, -0.2, 0.7])
    for rho in (0.4, 0.01, -0.01):
        landmark = np.array([1.0, 1.0, alpha, rho])
        v, scaled = line_of_sight(pose, landmark)
        bearing = observe_inverse_depth(CAMERA, pose, landmark)[0][0]
        printed = np.arctan(scaled[1] / scaled[0]) - pose[2]
        unscaled = np.arctan2(v[1], v[0]) - pose[2]
        assert_allclose(
            np.abs(subtract_angles(printed, bearing)), np.pi * (scaled[0] < 0), atol=1e-12
        )
        assert_allclose(np.abs(subtract_angles(unscaled, bearing)), np.pi * (rho < 0), atol=1e-12)
    near = [observe_inverse_depth(CAMERA, pose, [1, 1, alpha, rho])[0] for rho in (1e-9, -1e-9)]
    assert_allclose(subtract_angles(*near), 0, atol=1e-8)


def test_sola_eq_51_is_linear_in_rho_and_eq_50_is_not():
    pose = np.array([0.5, -0.2, 0.7])
    three = [line_of_sight(pose, np.array([1.0, 1.0, 0.3, rho])) for rho in (0.2, 0.6, 1.0)]
    plain, scaled = (np.array(column) for column in zip(*three, strict=True))
    assert_allclose(scaled[0] - 2 * scaled[1] + scaled[2], 0, atol=1e-14)
    assert np.abs(plain[0] - 2 * plain[1] + plain[2]).max() > 1


def test_sola_eq_53_starts_at_the_sensor_not_at_the_robot():
    """With t and theta of the robot, a mounted sensor does not see the ray where it saw it."""
    pose, bearing = np.array([1.0, 2.0, 0.7]), np.array([0.3])
    rho, _ = depth_prior(MOUNTED.min_range)
    printed = np.array([*pose[:2], pose[2] + bearing[0], rho])
    landmark, wrt_pose, _, _ = inverse_depth(MOUNTED, pose, bearing, rho)
    for start, off in ((landmark, False), (printed, True)):
        again = observe_inverse_depth(MOUNTED, pose, start)[0]
        assert (np.abs(subtract_angles(again, bearing)) > 0.1) == off
    numeric = central_difference(lambda x: inverse_depth(MOUNTED, x, bearing, rho)[0], pose)
    assert_allclose(wrt_pose, numeric, rtol=0, atol=1e-9)
    assert np.abs(numeric[:2, 2]).max() > 0.1  # the lever arm, which Eq. 53 does not have


@pytest.mark.parametrize(
    ("scenario", "naive"),
    [("cloister-bearing", {"bearings": "naive"}), ("cloister-range", {"ranges": "naive"})],
)
def test_sola_naive_priors_break_the_linearity_condition(scenario, naive):
    """2.3.5, note: they "most probably break the linearity condition and make EKF fail"."""
    nees = {}
    for name, options in (("default", {}), ("naive", naive)):
        runs = [(data, Ekf(**options).estimate(data)) for data in draws(scenario)]
        ends = [(e.online.poses[-1], d.truth[-1], e.online.covariances[-1]) for d, e in runs]
        nees[name] = pose_nees(*map(np.array, zip(*ends, strict=True)))
    # A consistent filter has a median of 2.4, and is above 30 once in a million runs.
    assert np.median(nees["default"]) < 30
    assert np.median(nees["naive"]) > 1000


def draws(scenario):
    return [simulate(scenario, seed=seed) for seed in range(8)]


def test_sola_cloister_calls_the_west_east():
    """A quarter turn (x, y) -> (-y, x) takes the north to the west; the whole is symmetric."""
    turn = np.array([[0, -1], [1, 0]])
    assert_allclose(turn @ [0, 1], [-1, 0])
    points = cloister([-4, 4], [-4, 4], 7)
    count = len(points) // 4
    assert (points[count : 2 * count, 0] < 0).all()
    assert_allclose(points[count : 2 * count], points[:count] @ turn.T, atol=1e-14)


@pytest.mark.parametrize(("asks_for_the_mapped", "expected"), [(True, 0), (False, 36)])
def test_sola_c_3_as_printed_maps_nothing(asks_for_the_mapped, expected):
    """Its branch for new landmarks asks whether there are mapped ones, and picks one of those."""
    rng, landmarks = np.random.default_rng(0), np.zeros((2, 36), dtype=int)
    free = 4
    for _ in range(200):
        mapped = np.flatnonzero(landmarks[0])  # lids = find(landmarks(1, :))
        candidates = mapped if asks_for_the_mapped else np.flatnonzero(landmarks[0] == 0)
        if len(candidates):
            landmarks[:, rng.choice(candidates)] = free, free + 1
            free += 2
    assert np.count_nonzero(landmarks[0]) == expected


# Ciatto ----------------------------------------------------------------------------------------


def test_ciatto_alg_1_observation_needs_the_index_of_the_landmark():
    """Given the back-projected measurement for a landmark, it expects what was measured."""
    pose, mapped = np.array([1.0, 2.0, 0.7]), np.array([4.0, 5.0])
    for value in ([2.0, 0.3], [5.0, -1.2]):
        printed = LASER.observe(pose, LASER.locate(pose, value)[0])[0]
        assert_allclose(LASER.difference(value, printed), 0, atol=1e-14)
        indexed = LASER.observe(pose, mapped)[0]
        assert np.abs(LASER.difference(value, indexed)).max() > 0.1


def test_ciatto_eq_3_17_has_its_blocks_the_other_way_round():
    """Lambda_r (sigma_rr, sigma_rm) is wide: it stands below, and its transpose beside."""
    prior = Prior([1.0, 2.0, 0.7], [[0.04, 0.01, 0], [0.01, 0.09, 0.01], [0, 0.01, 0.01]])
    world = GaussianMap(prior)
    for value in ([2.0, 0.3], [5.0, -1.2]):
        point, wrt_pose, wrt_value = LASER.locate(world.mean[:3], value)
        before = world.covariance
        at = world.append(point, wrt_pose, wrt_value, LASER.covariance)
        cross = wrt_pose @ before[:3]
        assert cross.shape == (2, at)
        assert_allclose(world.covariance[at:, :at], cross, atol=1e-15)
        assert_allclose(world.covariance[:at, at:], cross.T, atol=1e-15)


# Principles of Robot Autonomy ------------------------------------------------------------------


def test_autonomy_alg_3_weight_is_a_density_with_s_in_the_exponent():
    """With det(2 pi S) before and Q inside, it does not add up to one over all measurements."""
    Q = np.array([[0.04, 0.005], [0.005, 0.01]])
    S = Q + np.array([[0.05, -0.02], [-0.02, 0.06]])
    axis = np.linspace(-4, 4, 801)
    z = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    cell = (axis[1] - axis[0]) ** 2
    for matrix, total in ((S, 1.0), (Q, np.sqrt(np.linalg.det(Q) / np.linalg.det(S)))):
        squared = np.einsum("...i,ij,...j->...", z, np.linalg.inv(matrix), z)
        weights = np.exp(-0.5 * squared) / np.sqrt(np.linalg.det(2 * np.pi * S))
        assert_allclose(weights.sum() * cell, total, rtol=1e-9)
    assert total < 0.5


# Notes on the EKF of Brenner's lectures --------------------------------------------------------


@pytest.mark.parametrize("way", [0.8, -0.3, 0.0])
def test_brenner_motion_of_equal_wheels_is_not_given(way):
    """The notes take the limits of G and V; g itself is 0 / 0 there, and goes straight on."""
    width, pose = 0.55, np.array([1.5, -0.7, 0.9])
    left, right = np.float64(way), np.float64(way)
    with np.errstate(divide="ignore", invalid="ignore"):
        alpha = (right - left) / width
        radius = left / (right - left) * width + width / 2
        printed = pose[0] + radius * (np.sin(pose[2] + alpha) - np.sin(pose[2]))
    assert np.isnan(printed)
    model = MotionModel("wheel-increments", covariance=np.eye(2), width=width)
    after = geo.compose(pose, model.increment([(left, right)])[0][0])
    straight = way * np.array([np.cos(pose[2]), np.sin(pose[2]), 0.0])
    assert_allclose(after, pose + straight, atol=1e-14)


def test_brenner_mod_must_round_down():
    """Where mod takes the sign of the dividend, as in C, large negative angles stay outside."""
    for degrees, wrapped in ((285, -75), (-285, 75), (-540, -180)):
        angle = np.deg2rad(degrees)
        assert_allclose(np.mod(angle + np.pi, 2 * np.pi) - np.pi, np.deg2rad(wrapped), atol=1e-12)
        assert_allclose(geo.wrap(angle), np.deg2rad(wrapped), atol=1e-12)
    truncated = np.fmod(np.deg2rad(-285) + np.pi, 2 * np.pi) - np.pi
    assert truncated == pytest.approx(np.deg2rad(-285))


def test_brenner_expected_measurements_go_stale_in_the_loop():
    """Prior and two sightings of variance 1, both one off: 2/3 of the way, not 0.833."""
    mean, variance, stale = 0.0, 1.0, 0.0
    for _ in range(2):
        gain = variance / (variance + 1.0)
        stale += gain * (1.0 - 0.0)  # expected before the loop
        mean += gain * (1.0 - mean)
        variance *= 1.0 - gain
    assert mean == pytest.approx(2 / 3)
    assert stale == pytest.approx(5 / 6)
    # The same in the filter: two landmarks as good as known, a robot lost by 1 m along x.
    exact, rough = (Sensor("xy", variance * np.eye(2)) for variance in (1e-12, 1.0))
    slam, points = EkfSlam(update="sequential"), np.array([[3.0, 1.0], [2.0, -4.0]])
    slam.observe(Sightings.of(exact, points, [0, 1]))
    slam.predict([0.0, 0.0, 0.0], np.diag([1.0, 0.0, 0.0]))
    slam.observe(Sightings.of(rough, points - [1.0, 0.0], [0, 1]))
    assert_allclose(slam.pose, [2 / 3, 0, 0], atol=1e-9)


# "Extended Kalman Filter SLAM" -----------------------------------------------------------------


@pytest.mark.parametrize("heading", [0.0, 0.5 * np.pi, 2.1])
def test_ekf_slam_text_process_noise_must_be_mapped_by_the_controls(heading, rng):
    """Section 3.5 has one diagonal for every heading; the noise of (v, omega) lies along it."""
    control, sigmas = np.array([1.0, 0.4, 0.5]), np.array([0.02, 0.01])
    model = MotionModel("velocity", covariance=np.diag(sigmas**2))
    pose = np.array([0.3, -0.4, heading])
    mapped = geo.body_to_additive(pose, model.increments([control]).covariances[0])
    drawn = np.tile(control, (100_000, 1))
    drawn[:, :2] += rng.normal(size=(len(drawn), 2)) * sigmas
    ends = geo.compose(pose, model.increment(drawn)[0])
    exact = geo.compose(pose, model.increment([control])[0][0])
    assert_sampled(subtract_last_angle(ends, exact), mapped)
    assert np.linalg.matrix_rank(mapped, tol=1e-12) == 2
    across = np.array(
        [-np.sin(heading + 0.1), np.cos(heading + 0.1)]
    )  # of the chord, half the turn
    assert across @ mapped[:2, :2] @ across < 0.02 * np.trace(mapped[:2, :2])


def test_ekf_slam_text_has_sigma_where_its_square_belongs(rng):
    """NIS of true measurements is 2 in the mean; with sigma for sigma squared, their sum."""
    sigmas = np.array([0.1, 0.02])
    drawn = rng.normal(size=(20_000, 2)) * sigmas
    for variances, mean in ((sigmas**2, 2.0), (sigmas, sigmas.sum())):
        nis = np.sum(drawn**2 / variances, axis=1)
        assert_allclose(nis.mean(), mean, atol=5 * nis.std() / np.sqrt(len(nis)))
