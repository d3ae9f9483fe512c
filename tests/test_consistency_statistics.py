"""NEES, NIS, chi-square intervals, gaps to a reference, and the verdict `diverged`."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, LandmarkMap, Observations, Robot
from ekfslam.errors import InputError
from ekfslam.estimates import Estimate, Innovations, LandmarkEstimates, Trajectory
from ekfslam.evaluation import (
    chi2_interval,
    judged,
    pose_nees,
    pose_nees_invariant,
    share_inside,
    squared_mahalanobis,
)
from ekfslam.evaluation.consistency import gaps, validate
from ekfslam.evaluation.statistics import mean, rmse
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

# Two-sided 95 % intervals for the mean of N samples, printed to three digits.
PRINTED = {
    1: [(0.001, 5.02), (0.051, 7.38), (0.216, 9.35)],
    10: [(0.325, 2.05), (0.959, 3.42), (1.68, 4.70)],
    30: [(0.560, 1.57), (1.35, 2.78), (2.19, 3.94)],
    100: [(0.742, 1.30), (1.63, 2.41), (2.54, 3.50)],
    1000: [(0.914, 1.09), (1.88, 2.13), (2.85, 3.15)],
}


def random_covariances(rng, count, size, scale=1.0):
    factors = rng.normal(size=(count, size, size)) * scale
    return factors @ np.swapaxes(factors, 1, 2) + 0.1 * scale**2 * np.eye(size)


# Intervals and shares ---------------------------------------------------------------------------


@pytest.mark.parametrize("samples", PRINTED)
@pytest.mark.parametrize("dof", [1, 2, 3])
def test_intervals_of_the_mean_are_those_printed(samples, dof):
    low, high = chi2_interval(dof, samples=samples)
    printed_low, printed_high = PRINTED[samples][dof - 1]
    assert low == pytest.approx(printed_low, abs=5.1e-4 if printed_low < 1 else 5.1e-3)
    assert high == pytest.approx(printed_high, abs=5.1e-3)


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.997])
def test_intervals_hold_their_probability(probability):
    dof = np.array([1.0, 2.0, 3.0, 40.0])
    low, high = chi2_interval(dof, probability, samples=7)
    below, above = chi2.cdf(7 * low, 7 * dof), chi2.sf(7 * high, 7 * dof)
    np.testing.assert_allclose(below, (1 - probability) / 2, rtol=1e-10)
    np.testing.assert_allclose(above, (1 - probability) / 2, rtol=1e-10)


@pytest.mark.parametrize("arguments", [(2, 0.0), (2, 1.0), (2, np.nan), (0,), (2, 0.9, 0)])
def test_intervals_that_do_not_exist_are_refused(arguments):
    with pytest.raises(InputError):
        chi2_interval(*arguments)


def test_each_sample_is_held_against_its_own_degrees_of_freedom():
    # 9 is outside the interval of chi2(2), [0.05, 7.38], and inside that of chi2(4).
    assert share_inside([9.0, 9.0, np.nan], [2, 4, 4]) == 0.5
    assert share_inside([0.01, 2.0, 2.0, 2.0], 2) == 0.75
    assert np.isnan(share_inside([np.nan], 2))


def test_means_skip_what_was_skipped_but_errors_are_never_left_out():
    assert mean([1.0, np.nan, 3.0]) == 2.0
    assert np.isnan(mean([np.nan]))
    assert np.isnan(mean([]))
    assert rmse([3.0, 4.0]) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(rmse([1.0, np.nan]))
    assert np.isnan(rmse([]))


# NEES -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [2, 3])
def test_draws_from_the_claimed_gaussians_are_consistent(rng, size):
    count = 20000
    covariances = random_covariances(rng, count, size)
    errors = np.einsum(
        "nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(count, size))
    )
    nees = squared_mahalanobis(errors, covariances)
    # Five deviations of the mean of chi2(d), and of a share of 0.95.
    assert nees.mean() == pytest.approx(size, abs=5 * np.sqrt(2 * size / count))
    assert share_inside(nees, size) == pytest.approx(0.95, abs=5 * np.sqrt(0.95 * 0.05 / count))
    overconfident = squared_mahalanobis(errors, covariances / 2)
    np.testing.assert_allclose(overconfident, 2 * nees, rtol=1e-9)


def test_nees_agrees_with_the_inverse(rng):
    covariances = random_covariances(rng, 50, 3)
    errors = rng.normal(size=(50, 3))
    expected = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)
    np.testing.assert_allclose(squared_mahalanobis(errors, covariances), expected, rtol=1e-10)
    assert not squared_mahalanobis(np.zeros((50, 3)), covariances).any()
    pair = np.stack([errors, -2 * errors])  # broadcast over shared covariances
    np.testing.assert_allclose(
        squared_mahalanobis(pair, covariances), [expected, 4 * expected], rtol=1e-10
    )


def test_the_heading_error_is_wrapped(rng):
    covariance = random_covariances(rng, 1, 3)[0]
    poses, truth = np.array([1.0, 2.0, 3.1]), np.array([1.1, 1.9, -3.1])
    expected = pose_nees(poses - [0, 0, 0.2], truth - [0, 0, 0.2 - 2 * np.pi], covariance)
    assert pose_nees(poses, truth, covariance) == pytest.approx(float(expected), rel=1e-12)
    assert pose_nees(poses, truth, covariance) < 1e3


@pytest.mark.parametrize("nees", [pose_nees, pose_nees_invariant])
def test_nees_does_not_depend_on_the_frame(rng, nees):
    truth = rng.normal(size=(40, 3)) * [10, 10, 2]
    covariances = random_covariances(rng, 40, 3, 0.3)
    poses = truth + rng.multivariate_normal(np.zeros(3), 0.1 * np.eye(3), 40)
    motion = np.array([50.0, -30.0, 2.0])
    moved = nees(
        geo.compose(motion, poses),
        geo.compose(motion, truth),
        geo.congruence(geo.heading_block(motion[2]), covariances),
    )
    np.testing.assert_allclose(moved, nees(poses, truth, covariances), rtol=1e-9)


def test_invariant_nees_is_that_of_the_converted_covariance(rng):
    truth = rng.normal(size=(40, 3)) * [3, 3, 2]
    poses = truth + rng.normal(size=(40, 3)) * [0.3, 0.3, 0.4]
    covariances = random_covariances(rng, 40, 3, 0.3)
    expected = squared_mahalanobis(
        geo.invariant_error(truth, poses), geo.additive_to_invariant(poses, covariances)
    )
    found = pose_nees_invariant(poses, truth, covariances)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    # At such heading errors the two coordinates are far apart.
    assert np.abs(found / pose_nees(poses, truth, covariances) - 1).max() > 0.05


def test_draws_in_invariant_coordinates_are_consistent_at_large_heading_errors(rng):
    """The estimate's error is Exp of a Gaussian with 0.4 rad of heading: chi-square exactly."""
    count = 20000
    poses = rng.normal(size=(count, 3)) * [5, 5, 2]
    invariant = np.diag([0.04, 0.09, 0.16])
    xi = rng.multivariate_normal(np.zeros(3), invariant, count)
    xi = xi[np.abs(xi[:, 2]) < np.pi]
    poses = poses[: len(xi)]
    truth = geo.compose(geo.exp(xi), poses)
    covariances = geo.invariant_to_additive(poses, invariant)
    nees = pose_nees_invariant(poses, truth, covariances)
    assert nees.mean() == pytest.approx(3, abs=5 * np.sqrt(6 / count))
    assert pose_nees(poses, truth, covariances).mean() > 3.2


def test_additive_and_invariant_nees_agree_as_heading_errors_shrink(rng):
    truth = rng.normal(size=(40, 3)) * [5, 5, 2]
    directions = rng.normal(size=(40, 3))
    shape = random_covariances(rng, 40, 3)
    gaps_at = []
    for scale in (1e-2, 1e-3, 1e-4):
        poses, covariances = truth + scale * directions, scale**2 * shape
        additive = pose_nees(poses, truth, covariances)
        gap = np.abs(pose_nees_invariant(poses, truth, covariances) - additive)
        gaps_at.append(np.max(gap / additive))
    # The difference is of first order in the error: each is a tenth of the one before.
    assert gaps_at[0] < 0.2
    np.testing.assert_allclose(np.divide(gaps_at[1:], gaps_at[:-1]), 0.1, rtol=0.2)


def test_singular_covariances_are_skipped():
    regular = np.diag([1.0, 1e-8, 1e4])  # units far apart are no reason to skip
    correlated = np.array([[1, 1 - 1e-9, 0], [1 - 1e-9, 1, 0], [0, 0, 1]])
    singular = [
        np.zeros((3, 3)),
        np.diag([1.0, 1.0, 0.0]),
        np.ones((3, 3)),
        np.array([[1, 1 - 1e-11, 0], [1 - 1e-11, 1, 0], [0, 0, 1]]),
        np.diag([1.0, -1.0, 1.0]),
        np.array([[1, 2, 0], [2, 1, 0], [0, 0, 1]]),  # indefinite
        np.full((3, 3), np.nan),
        np.diag([1.0, np.inf, 1.0]),
    ]
    nees = squared_mahalanobis(np.ones(3), np.array([regular, correlated, *singular]))
    assert np.isfinite(nees[:2]).all()
    assert nees[0] == pytest.approx(1 + 1e8 + 1e-4, rel=1e-9)
    assert np.isnan(nees[2:]).all()
    assert np.isnan(squared_mahalanobis([1.0, np.inf, 0.0], regular))


def test_both_kinds_of_nees_skip_the_same_poses_far_from_the_origin():
    covariance = np.diag([0.01, 0.01, 0.01])
    pose = np.array([5e5, 4e6, 0.3])  # a metric grid
    truth = pose + np.array([0.1, 0.0, 0.0])
    assert pose_nees(pose, truth, covariance) == pytest.approx(1.0, rel=1e-6)
    assert pose_nees_invariant(pose, truth, covariance) == pytest.approx(1.0, rel=1e-6)


# Verdicts and gaps ------------------------------------------------------------------------------

COUNT = 101


@pytest.fixture
def line():
    """A hundred metres straight on, two landmarks, no observations."""
    truth = np.zeros((COUNT, 3))
    truth[:, 0] = np.arange(COUNT)
    motion = MotionModel("odometry", covariance=np.eye(3) * 1e-4)
    return Dataset(
        "line",
        (Robot(motion, np.tile([1.0, 0, 0], (COUNT - 1, 1)), truth=truth),),
        np.arange(float(COUNT)),
        (Sensor("xy", np.eye(2)),),
        Observations([], np.empty((0, 2))),
        true_map=LandmarkMap([3, 8], [[1.0, 2.0], [3.0, 4.0]]),
    )


def estimate_of(dataset, offset=(0.0, 0.0, 0.0), sigma=0.1, **changes):
    poses = dataset.truth + np.linspace(0, 1, COUNT)[:, None] * np.asarray(offset)
    covariances = np.tile(np.diag([sigma**2, sigma**2, 1e-4]), (COUNT, 1, 1))
    landmarks = LandmarkEstimates(
        np.array([3, 8]), dataset.true_map.positions, np.tile(0.04 * np.eye(2), (2, 1, 1))
    )
    return replace(
        Estimate("filter", dataset.name, "known", Trajectory(poses, covariances), None, landmarks),
        **changes,
    )


@pytest.mark.parametrize(
    ("offset", "sigma", "status"),
    [
        (0.0, 0.1, "ok"),
        (4.9, 0.1, "ok"),  # 49 sigmas, but less than 5 % of the path
        (5.1, 0.6, "ok"),  # 5.1 % of the path, but less than 10 sigmas
        (5.1, 0.5, "diverged"),
        (5.1, 0.0, "diverged"),
    ],
)
def test_a_run_is_lost_beyond_both_its_sigmas_and_a_share_of_the_path(line, offset, sigma, status):
    verdict = judged(line, estimate_of(line, (0, offset, 0), sigma))
    assert verdict.status == status
    assert ("5.1 m off" in verdict.message) == (status == "diverged")


def test_the_sigma_of_a_lost_run_is_that_of_the_largest_axis(line):
    estimate = estimate_of(line, (0, 6.0, 0))
    covariances = np.tile(np.diag([0.49, 1e-6, 1e-4]), (COUNT, 1, 1))
    wide = replace(estimate, online=Trajectory(estimate.online.poses, covariances))
    assert judged(line, wide).status == "ok"


def test_alignment_before_the_verdict_forgives_a_wrong_frame(line):
    estimate = estimate_of(line)
    moved = Trajectory(geo.compose([30, 20, 1.0], line.truth), estimate.online.covariances)
    estimate = replace(estimate, online=moved)
    assert judged(line, estimate).status == "diverged"
    assert judged(line, estimate, "se2").status == "ok"


def test_without_truth_or_covariance_nothing_is_lost(line):
    estimate = estimate_of(line, (0, 50.0, 0))
    assert judged(line, estimate).status == "diverged"
    unknown = replace(line, robots=(replace(line.robot, truth=None),))
    assert judged(unknown, estimate).status == "ok"
    bare = replace(estimate, online=Trajectory(estimate.online.poses))
    assert judged(line, bare).status == "ok"
    missing = Trajectory(estimate.online.poses, np.full((COUNT, 3, 3), np.nan))
    assert judged(line, replace(estimate, online=missing)).status == "ok"


def broken(estimate, what):
    poses, covariances = estimate.online.poses.copy(), estimate.online.covariances.copy()
    landmarks, joint = estimate.landmarks, None
    if what == "pose":
        poses[7:] = np.nan
    elif what == "overflow":
        poses[7:] = np.inf
    elif what == "negative":
        covariances[-1] = np.diag([1.0, -1e-3, 1.0])
    elif what == "indefinite":
        covariances[-1, 0, 1] = covariances[-1, 1, 0] = 2 * covariances[-1, 0, 0]
    elif what == "partly nan":
        covariances[-1, 0, 2] = np.nan
    elif what == "infinite":
        covariances[-1, 2, 2] = np.inf
    elif what == "landmark":
        landmarks = replace(landmarks, positions=np.array([[1.0, 2.0], [np.nan, 4.0]]))
    elif what == "landmark covariance":
        landmarks = replace(landmarks, covariances=np.array([np.eye(2), [[1, 2], [2, 1]]]))
    elif what == "joint":
        joint = np.eye(7) - 0.5
    return replace(
        estimate,
        online=Trajectory(poses, covariances),
        landmarks=landmarks,
        joint_covariance=joint,
    )


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("pose", "online pose of step 7 is not finite"),
        ("overflow", "online pose of step 7 is not finite"),
        ("negative", "final online pose is not positive"),
        ("indefinite", "final online pose is not positive"),
        ("partly nan", "final online pose is not positive"),
        ("infinite", "final online pose is not positive"),
        ("landmark", "landmark 8 is not finite"),
        ("landmark covariance", "of a landmark is not positive"),
        ("joint", "joint covariance of final pose and map is not positive"),
    ],
)
def test_numbers_that_are_none_have_diverged(line, what, message):
    estimate = estimate_of(line, message="floor 1e-4 m")
    assert judged(line, estimate) is estimate
    verdict = judged(line, broken(estimate, what))
    assert verdict.status == "diverged"
    assert message in verdict.message
    assert verdict.message.endswith("; floor 1e-4 m")


def test_the_smoothed_series_is_judged_too(line):
    estimate = estimate_of(line)
    smoothed = Trajectory(np.full((COUNT, 3), np.nan))
    assert "smoothed" in judged(line, replace(estimate, smoothed=smoothed)).message


def test_rounding_and_an_exactly_known_start_are_forgiven(line, rng):
    factor = rng.normal(size=(7, 3)) * np.logspace(-4, 4, 7)[:, None]
    semidefinite = factor @ factor.T  # rank 3: zero eigenvalues come out as about -1e-16
    assert judged(line, estimate_of(line, joint_covariance=semidefinite)).status == "ok"
    assert judged(line, estimate_of(line, joint_covariance=np.zeros((7, 7)))).status == "ok"
    stolen = semidefinite - 1e-3 * np.diag(np.diag(semidefinite))
    assert judged(line, estimate_of(line, joint_covariance=stolen)).status == "diverged"


@pytest.mark.parametrize("status", ["failed", "skipped"])
def test_other_verdicts_stand(line, status):
    estimate = estimate_of(line, (0, 50.0, 0), status=status, message="because")
    assert judged(line, estimate) is estimate


def test_an_estimate_of_another_size_is_refused(line):
    estimate = estimate_of(line)
    short = Trajectory(estimate.online.poses[:-1])
    with pytest.raises(InputError, match=r"online\.poses of filter .* \(101, 3\), got \(100, 3\)"):
        validate(line, replace(estimate, online=short))
    with pytest.raises(InputError, match="step_nis"):
        validate(line, replace(estimate, step_nis=np.zeros(3)))
    one = Innovations(np.zeros(1, int), np.zeros(1, int), np.zeros((1, 2)), np.zeros((1, 2, 2)))
    with pytest.raises(InputError, match=r"innovations\.decision"):
        validate(line, replace(estimate, innovations=one))
    twice = replace(estimate.landmarks, ids=np.array([3, 3]))
    with pytest.raises(InputError, match="distinct"):
        validate(line, replace(estimate, landmarks=twice))


def test_gaps_are_distances_and_ratios_of_sigmas(line):
    reference = estimate_of(line, sigma=0.2)
    reference = replace(reference, online=None, smoothed=reference.online)
    estimate = estimate_of(line, (3.0, 4.0, -0.1), sigma=0.1)
    apart = replace(
        estimate.landmarks,
        ids=np.array([8, 5]),
        positions=np.array([[3.0, 4.5], [99.0, 99.0]]),
    )
    estimate = replace(estimate, landmarks=apart)
    gap = gaps(line, estimate, estimate.online, reference)
    np.testing.assert_allclose(gap, [5.0, 0.1, 0.5, 0.5, 1.0], rtol=1e-12)
    own = gaps(line, reference, reference.smoothed, reference)
    np.testing.assert_allclose(own, [0, 0, 0, 1, 1], atol=1e-15)


def test_a_zero_with_rounding_on_it_is_a_zero():
    """The first step of a motion noise of rank two, turned through a frame and back."""
    covariance = np.diag([2e-4, 1e-20, 3e-3])
    error = np.array([0.01, 1e-5, 0.05])  # the small one is of second order in the others
    assert np.isnan(squared_mahalanobis(error, covariance))
    assert np.isfinite(squared_mahalanobis(error, np.diag([2e-4, 1e-12, 3e-3])))


def test_landmarks_are_compared_only_where_identities_mean_the_same(line):
    def made(landmark):
        count = len(landmark)
        nan = np.full((count, 2), np.nan)
        return Innovations(np.zeros(count, int), np.array(landmark), nan, np.zeros((count, 2, 2)))

    def gap(ours, theirs, our_choice=None, their_choice=None):
        estimate, reference = (
            replace(estimate_of(line, association=name), innovations=choice and made(choice))
            for name, choice in ((ours, our_choice), (theirs, their_choice))
        )
        return gaps(line, estimate, estimate.online, reference).landmark_rmse

    assert gap("known", "known") == 0.0
    assert gap("nearest", "nearest", [0, 1], [0, 1]) == 0.0
    assert np.isnan(gap("nearest", "nearest", [0, 1], [1, 0]))
    assert np.isnan(gap("nearest", "nearest"))  # the name of a method is no identity
    assert np.isnan(gap("nearest", "known"))


def test_a_reference_without_trajectory_or_sigma_gives_no_numbers(line):
    estimate = estimate_of(line)
    assert np.isnan(gaps(line, estimate, estimate.online, Estimate("batch", "line"))).all()
    exact = estimate_of(line, sigma=0.0)
    assert np.isnan(gaps(line, estimate, estimate.online, exact).sigma_ratio_position)


# Several robots and undetermined landmarks ------------------------------------------------------


@pytest.fixture
def pair(line):
    """The robot of the line, and another one ten metres beside it."""
    aside = line.truth + np.array([0.0, 10.0, 0.0])
    return replace(line, robots=(line.robot, replace(line.robot, truth=aside, name="beside")))


def pair_of(pair, offset=(0.0, 0.0, 0.0), sigma=0.1, **changes):
    """An estimate of both, of which the second is off in the end."""
    poses = np.stack([robot.truth for robot in pair.robots])
    poses[1] += np.linspace(0, 1, COUNT)[:, None] * np.asarray(offset)
    covariances = np.tile(np.diag([sigma**2, sigma**2, 1e-4]), (2, COUNT, 1, 1))
    return replace(
        Estimate("filter", pair.name, "known", Trajectory(poses, covariances)), **changes
    )


@pytest.mark.parametrize(("offset", "status"), [(4.9, "ok"), (5.1, "diverged")])
def test_one_lost_robot_is_enough_and_is_named(pair, offset, status):
    verdict = judged(pair, pair_of(pair, (0, offset, 0)))
    assert verdict.status == status
    lost = "beside: final online position is 5.1 m off: 51 of its sigmas, 5 % of the path"
    assert verdict.message == (lost if status == "diverged" else "")


def test_any_robot_and_any_pose_of_it_is_judged(pair):
    poses = pair_of(pair).online.poses.copy()
    poses[1, 7] = np.nan
    broken = pair_of(pair, online=Trajectory(poses))
    assert judged(pair, broken).message == "beside: online pose of step 7 is not finite"
    covariances = pair_of(pair).online.covariances.copy()
    covariances[0, -1] = -np.eye(3)
    broken = pair_of(pair, online=Trajectory(pair_of(pair).online.poses, covariances))
    assert (
        "robot: covariance of the final online pose is not positive" in judged(pair, broken).message
    )


def test_robots_are_aligned_as_one_before_the_verdict(pair):
    motion = np.array([30.0, 20.0, 1.0])
    estimate = pair_of(pair)
    moved = replace(estimate.online, poses=geo.compose(motion, estimate.online.poses))
    assert judged(pair, replace(estimate, online=moved)).status == "diverged"
    assert judged(pair, replace(estimate, online=moved), "se2").status == "ok"
    # One robot alone in the wrong place is not forgiven.
    poses = estimate.online.poses.copy()
    poses[1] = geo.compose(motion, poses[1])
    apart = replace(estimate, online=replace(estimate.online, poses=poses))
    assert judged(pair, apart, "se2").status == "diverged"


def test_sizes_of_several_robots_and_undetermined_landmarks(pair):
    landmarks = LandmarkEstimates(
        np.array([3]),
        np.zeros((1, 2)),
        np.eye(2)[None],
        np.eye(2),
        undetermined=np.array([8, 9]),
        inverse_depth=np.ones((2, 4)),
    )
    whole = pair_of(pair, landmarks=landmarks, joint_covariance=np.eye(6 + 2 + 8))
    validate(pair, whole)
    assert judged(pair, whole) is whole
    for wrong, message in [
        ({"online": Trajectory(np.zeros((COUNT, 3)))}, r"online\.poses .* \(2, 101, 3\)"),
        ({"step_nis": np.zeros((2, COUNT))}, "step_nis"),
        ({"joint_covariance": np.eye(5)}, r"joint_covariance .* \(16, 16\)"),
        ({"landmarks": replace(landmarks, inverse_depth=np.ones((3, 4)))}, "inverse_depth"),
        ({"landmarks": replace(landmarks, covariance=np.eye(4))}, r"landmarks\.covariance "),
        ({"landmarks": replace(landmarks, undetermined=np.array([3, 8]))}, "distinct"),
    ]:
        with pytest.raises(InputError, match=message):
            validate(pair, replace(whole, **wrong))
    opened = replace(landmarks, inverse_depth=np.array([[0, 0, 0, 1.0], [0, np.inf, 0, 1.0]]))
    assert judged(pair, replace(whole, landmarks=opened)).message == "landmark 9 is not finite"


def test_a_single_robot_has_no_axis_of_robots(line):
    poses = estimate_of(line).online.poses[None]
    with pytest.raises(InputError, match=r"online\.poses .* \(101, 3\), got \(1, 101, 3\)"):
        validate(line, replace(estimate_of(line), online=Trajectory(poses)))


def test_gaps_are_of_the_robot_that_is_asked_for(pair):
    reference, estimate = pair_of(pair, sigma=0.2), pair_of(pair, (3.0, 4.0, -0.1))
    first, second = (gaps(pair, estimate, estimate.online, reference, r) for r in (0, 1))
    np.testing.assert_allclose(first[:2], [0, 0], atol=1e-15)
    np.testing.assert_allclose(second[:2], [5.0, 0.1], rtol=1e-12)
    assert second.sigma_ratio_position == pytest.approx(0.5)
