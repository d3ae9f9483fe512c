"""Control noise that is a mixture: its moments, its components, its draws, and its scenarios."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numerics import assert_same_record, assert_sampled
from numpy.testing import assert_allclose, assert_array_equal

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.evaluation.summary import summary_rows
from ekfslam.models.motion import KINDS, MotionModel
from ekfslam.registry import resolve
from ekfslam.robots import Robot
from ekfslam.simulation import Scenario, load_scenario, scenario_hash, simulate

SPINNING = [[0.7, 1, 0, 0], [0.2, 2, 0.3, -0.1], [0.1, 0.5, 0, 0.4]]
STEPS = 20_000


def wheels(**settings) -> MotionModel:
    if "proportional" not in settings:
        settings.setdefault("covariance", np.array([[9e-4, 2e-4], [2e-4, 4e-4]]))
    return MotionModel("wheel-increments", width=0.5, **({"mixture": SPINNING} | settings))


def held(**settings) -> MotionModel:
    rows = [[0.8, 1, 0, 0, 0], [0.2, 3, 0.1, 0.2, -0.3]]
    return MotionModel("none", covariance=np.diag([0.01, 0.02, 0.03]), mixture=rows, **settings)


def straight(motion: MotionModel, command, steps: int = STEPS, **settings) -> Scenario:
    """A long run with a command and nothing to see."""
    scenario = load_scenario("park")
    controls = np.tile(np.asarray(command, dtype=float), (steps, 1))
    return replace(
        scenario, start=np.zeros(3), controls=controls, motion=motion, sensors=(), **settings
    )


def driven(data: Dataset) -> np.ndarray:
    """True increments (K, 3)."""
    truth = data.robot.truth
    return geo.between(truth[:-1], truth[1:])


def moments(rows) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of a mixture by the definition, E[x] and E[x x'] - E[x] E[x]'."""
    mean, second = np.zeros(2), np.zeros((2, 2))
    for weight, scale, *offset in rows:
        offset = np.array(offset)
        mean += weight * offset
        second += weight * (scale**2 * wheels().covariance + np.outer(offset, offset))
    return mean, second - np.outer(mean, mean)


# Components ------------------------------------------------------------------------------------


def test_a_component_is_a_plain_model_of_controls_less_its_offset():
    controls = np.array([[0.2, 0.25], [0.1, -0.1], [0.0, 0.0]])
    weights, deltas, covariances = wheels(slip=0.01).components(controls)
    assert_array_equal(weights, [0.7, 0.2, 0.1])
    for c, (_, scale, *offset) in enumerate(SPINNING):
        plain = wheels(mixture=None, covariance=scale**2 * wheels().covariance, slip=0.01)
        expected = plain.increments(controls - offset)
        assert_allclose(deltas[c], expected.deltas, rtol=1e-14)
        assert_allclose(covariances[c], expected.covariances, rtol=1e-12, atol=1e-18)


def test_noise_in_proportion_is_that_of_the_controls_less_the_offset():
    controls = np.array([[0.5, 0.45]])
    motion = wheels(proportional=(0.1, 0.2))
    for c, (_, scale, *offset) in enumerate(SPINNING):
        plain = wheels(mixture=None, proportional=(0.1 * scale, 0.2 * scale))
        expected = plain.increments(controls - offset)
        assert_allclose(motion.components(controls).covariances[c], expected.covariances)


def test_what_has_no_noise_has_no_offset():
    motion = MotionModel("velocity", covariance=np.eye(2), mixture=[[1, 1, 0.5, 0.1]])
    plain = MotionModel("velocity", covariance=np.eye(2))
    shifted = plain.increments([[1.5, 0.1, 0.2]])
    assert_allclose(motion.increments([[2.0, 0.2, 0.2]]).deltas, shifted.deltas)
    assert_allclose(motion.components([[2.0, 0.2, 0.2]]).deltas[0], shifted.deltas)


def test_a_sensor_in_somebodys_hand_goes_where_the_offsets_point_back_from():
    weights, deltas, covariances = held().components(np.zeros((2, 0)))
    assert_array_equal(weights, [0.8, 0.2])
    assert_array_equal(deltas, [np.zeros((2, 3)), np.tile([-0.1, -0.2, 0.3], (2, 1))])
    assert_allclose(covariances[1, 0], 9 * np.diag([0.01, 0.02, 0.03]))


def test_the_noise_that_a_set_gives_is_that_of_scale_one():
    controls = np.full((4, 2), 0.2)
    given = np.stack([k * np.diag([1e-4, 2e-4]) for k in range(1, 5)])
    robot = Robot(wheels(), controls, covariance=given)
    plain = Robot(wheels(mixture=None), controls - [0.3, -0.1], covariance=4 * given)
    assert_allclose(robot.components.deltas[1], plain.increments.deltas)
    assert_allclose(robot.components.covariances[1], plain.increments.covariances)
    assert robot.components is robot.components
    assert not robot.components.deltas.flags.writeable


@pytest.mark.parametrize("kind", KINDS)
def test_one_component_is_the_plain_model_bit_for_bit(kind):
    needed = {"width": 0.5, "wheelbase": 2.0}
    parameter = KINDS[kind].parameter
    settings = {parameter: needed[parameter]} if parameter else {}
    noise = np.diag(np.linspace(0.01, 0.03, KINDS[kind].noises))
    plain = MotionModel(kind, noise, slip=0.01, **settings)
    single = replace(plain, mixture=[[1, 1]])
    controls = np.random.default_rng(1).normal(size=(30, len(plain.control_names)))
    expected = plain.increments(controls)
    for of_one in (single.increments(controls), plain.components(controls)[1:]):
        for one, other in zip(of_one, expected, strict=True):
            assert_array_equal(one.reshape(other.shape), other)
    assert_array_equal(single.components(controls).deltas[0], expected.deltas)


# Two moments -----------------------------------------------------------------------------------


def test_increments_have_the_mean_and_the_covariance_of_the_mixture():
    mean, covariance = moments(SPINNING)
    plain = wheels(mixture=None, covariance=covariance)
    controls = np.array([[0.2, 0.25], [0.5, 0.5]])
    expected = plain.increments(controls - mean)
    got = wheels().increments(controls)
    assert_allclose(got.deltas, expected.deltas, rtol=1e-14)
    assert_allclose(got.covariances, expected.covariances, rtol=1e-12, atol=1e-18)


def test_two_moments_of_the_components_are_those_of_the_increments_where_it_is_linear():
    """Of ``odometry``, whose Jacobian is the identity: the law of total covariance."""
    rows = [[0.6, 1, 0, 0, 0], [0.4, 2, 0.5, 0.1, -0.2]]
    motion = MotionModel("odometry", np.diag([0.01, 0.02, 0.03]), mixture=rows)
    controls = np.array([[1.0, 0.0, 0.2], [0.5, 0.1, -0.4]])
    weights, deltas, covariances = motion.components(controls)
    got = motion.increments(controls)
    assert_allclose(got.deltas, np.einsum("c,cki->ki", weights, deltas), rtol=1e-14)
    away = deltas - got.deltas
    within = np.einsum("c,ckij->kij", weights, covariances)
    between = np.einsum("c,cki,ckj->kij", weights, away, away)
    assert_allclose(got.covariances, within + between, rtol=1e-12, atol=1e-16)


# What is drawn ---------------------------------------------------------------------------------


def assert_mixed(noise: np.ndarray, rows, covariance: np.ndarray) -> None:
    """Assert that noise (N, n) has the peaks, the shares and the spreads of a mixture.

    The peaks must be so far apart that the nearest one tells the component.
    """
    rows = np.asarray(rows, dtype=float)
    weights, scales, offsets = rows[:, 0], rows[:, 1], rows[:, 2:]
    nearest = np.linalg.norm(noise[:, None] - offsets, axis=2).argmin(axis=1)
    shares = np.bincount(nearest, minlength=len(rows)) / len(noise)
    # Five standard deviations of a binomial share.
    spread = np.sqrt(weights * (1 - weights) / len(noise))
    assert_allclose(shares, weights, rtol=0, atol=5 * spread.max())
    for c in range(len(rows)):
        mine = noise[nearest == c] - offsets[c]
        assert_sampled(mine, scales[c] ** 2 * covariance)
        sigmas = scales[c] * np.sqrt(np.diag(covariance) / len(mine))
        assert (np.abs(mine.mean(axis=0)) < 5 * sigmas).all()


APART = [[0.7, 1, 0, 0], [0.2, 2, 3.0, -1.0], [0.1, 0.5, 0, 4.0]]


def test_measured_controls_are_off_by_the_mixture():
    motion = wheels(mixture=APART)
    data = simulate(straight(motion, [0.2, 0.21]), seed=3)
    assert_mixed(data.robot.controls - [0.2, 0.21], APART, motion.covariance)
    assert data.robot.motion == motion


def test_noise_on_the_motion_has_the_same_sign():
    """Measured is true plus noise, whichever of the two is drawn."""
    rows = [[0.8, 1, 0, 0, 0], [0.2, 2, 1.0, 0, -0.5]]
    motion = MotionModel("odometry", np.diag([1e-4, 1e-4, 1e-4]), mixture=rows)
    command = [0.2, 0.0, 0.01]
    data = simulate(straight(motion, command, noise_on="motion"), seed=3)
    assert_array_equal(data.robot.controls, np.tile(command, (STEPS, 1)))
    assert_mixed(command - driven(data), rows, motion.covariance)


def test_a_hand_is_drawn_as_its_components_say():
    motion = held()
    data = simulate(straight(motion, np.zeros(0), noise_on="motion"), seed=1)
    increments = driven(data)
    robot = data.robot.increments
    mean, covariance = robot.deltas[0], robot.covariances[0]
    spread = np.sqrt(np.diag(covariance) / STEPS)
    assert (np.abs(increments.mean(axis=0) - mean) < 5 * spread).all()
    # The fourth moments of a mixture are larger than a Gaussian's: by their own spread.
    products = np.einsum("ki,kj->kij", increments - mean, increments - mean)
    deviation = products.std(axis=0) / np.sqrt(STEPS)
    assert (np.abs(products.mean(axis=0) - covariance) < 5 * deviation).all()


@pytest.mark.parametrize("command", [[0.2, 0.21], [0.5, 0.3]])
def test_true_increments_given_the_measured_are_spread_as_stated(command):
    """What was measured less its noise is what was true: the mixture by brute force.

    Noise so small that the increment is linear in it, relative to 1e-3.
    """
    rows = [[0.7, 1, 0, 0], [0.3, 2, 0.003, -0.001]]
    motion = wheels(covariance=np.diag([1e-6, 4e-7]), mixture=rows)
    data = simulate(straight(motion, command), seed=5)
    noise = data.robot.controls - command
    samples = motion.increment(np.asarray(command) - noise)[0]  # as if `command` had been measured
    stated = motion.increments([command])
    away = samples - stated.deltas[0]
    products = np.einsum("ki,kj->kij", away, away)
    deviation = products.std(axis=0) / np.sqrt(STEPS)
    bound = 5 * deviation + 1e-3 * np.abs(stated.covariances[0]).max()
    assert (np.abs(products.mean(axis=0) - stated.covariances[0]) < bound).all()


def test_components_have_a_stream_of_their_own():
    """With a mixture of two equal Gaussians nothing changes; with tails the small draws stay."""
    plain = straight(wheels(mixture=None), [0.2, 0.21], 200)
    equal = straight(wheels(mixture=[[0.5, 1], [0.5, 1]]), [0.2, 0.21], 200)
    tails = straight(wheels(mixture=[[0.9, 1], [0.1, 10]]), [0.2, 0.21], 200)
    one, other, third = (simulate(s, seed=4).robot.controls for s in (plain, equal, tails))
    assert_array_equal(one, other)
    factor = (third - [0.2, 0.21]) / (one - [0.2, 0.21])
    large = np.isclose(factor, 10).all(axis=1)
    assert_allclose(factor[~large], 1, rtol=1e-9)
    assert 5 <= large.sum() <= 38  # of 200 draws of 0.1, at four standard deviations


def test_scales_of_a_simulation_scale_the_peaks():
    scenario = straight(wheels(), [0.2, 0.21], 50)
    whole, half = simulate(scenario, seed=1), simulate(scenario, seed=1, noise=0.5)
    command = np.array([0.2, 0.21])
    assert_allclose(half.robot.controls - command, 0.5 * (whole.robot.controls - command))
    assert_allclose(half.robot.motion.mixture[:, 2:], 0.5 * whole.robot.motion.mixture[:, 2:])
    assert_array_equal(half.robot.motion.mixture[:, :2], whole.robot.motion.mixture[:, :2])
    assert half.robot.motion == simulate(scenario, seed=1, odometry_noise=0.5).robot.motion
    still = simulate(scenario, seed=1, draw=0.0)
    assert_allclose(still.robot.controls - moments(SPINNING)[0], np.tile(command, (50, 1)))
    assert_allclose(still.robot.increments.deltas, driven(still), atol=1e-12)
    assert still.robot.motion == whole.robot.motion


# Files -----------------------------------------------------------------------------------------


def test_a_mixture_is_saved_and_loaded_without_loss(tmp_path):
    data = simulate("spin", seed=2)
    data.save(tmp_path / "spin.npz")
    again = Dataset.load(tmp_path / "spin.npz")
    assert_same_record(again.robot.motion, data.robot.motion)
    assert again.robot.motion == data.robot.motion
    assert again.robot.motion != replace(data.robot.motion, mixture=None)
    assert_array_equal(again.robot.components.deltas, data.robot.components.deltas)


def test_a_mixture_counts_in_the_digest_and_its_absence_does_not():
    # As written before there were mixtures: stored campaigns are found by it.
    before = "1fddf0fba37e9cbfc02442a6d9fa69898dee2c4078289b0faa8dfdad174946f3"
    assert scenario_hash(load_scenario("park")) == before
    digests = {
        scenario_hash(load_scenario("park", {"motion.mixture": rows}))
        for rows in ([[1, 1]], [[0.9, 1], [0.1, 10]], [[0.9, 1], [0.1, 11]])
    }
    assert len(digests | {before}) == 4


def test_keys_of_a_mixture():
    changes = {"motion.mixture": [[0.9, 1], [0.1, 4]], "motion.mixture.1.1": 10}
    assert_array_equal(
        load_scenario("park", changes).motion.mixture, [[0.9, 1, 0, 0, 0], [0.1, 10, 0, 0, 0]]
    )
    turned = load_scenario("park", {"motion.mixture": [[1, 1, 0, 0, "90 deg"]]})
    assert turned.motion.mixture[0, 4] == np.pi / 2
    assert "noise on the odometry, a mixture" in turned.describe()


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([[0.9, 1], [0.2, 1]], r"the weights of mixture must sum to 1, got 1\.1"),
        ([[1.0, 1], [0.0, 1]], r"positive weights, got \[1\.0, 0\.0\]"),
        ([[1.5, 1], [-0.5, 1]], "positive weights"),
        ([[0.5, 1], [0.5, -1]], r"scales that are not negative, got \[1\.0, -1\.0\]"),
        ([[1.0, np.nan]], "mixture holds NaN"),
        ([[1.0, 1, 0]], r"mixture must have shape \(n, 4\), got \(1, 3\)"),
        ([[1.0, 1, 0, 0], [0.0, 1]], "mixture has components of different lengths"),
        ([1.0, 1.0], "mixture must have shape"),
        ([], "mixture must have shape"),
        ("spin", "mixture"),
    ],
)
def test_mistakes_are_named(rows, said):
    with pytest.raises(InputError, match=said):
        wheels(mixture=rows)


def test_mistakes_in_a_file_are_named_with_their_table():
    with pytest.raises(InputError, match=r"park: \[motion\]: the weights of mixture must sum"):
        load_scenario("park", {"motion.mixture": [[0.9, 1], [0.2, 1]]})
    with pytest.raises(InputError, match=r"park: \[motion\]: mixture has rows of different"):
        load_scenario("park", {"motion.mixture": [[0.9, 1], [0.1, 1, 0, 0, 0]]})


# The scenarios ---------------------------------------------------------------------------------


def far_off(data: Dataset) -> np.ndarray:
    """Errors of the measured controls over the sigmas, (K, 3)."""
    true = driven(data)
    return (data.robot.controls - true) / np.sqrt(np.diag(data.robot.motion.covariance))


def test_wheels_spin_in_a_step_of_fifty():
    found = []
    for seed in range(4):
        data = simulate("spin", seed=seed)
        off = data.robot.controls[:, 0] - driven(data)[:, 0]
        found.append(off > 0.6)
        assert_allclose(off[found[-1]], 1.2, atol=6 * 0.005)
        assert_allclose(off[~found[-1]], 0, atol=6 * 0.005)
    shares = np.mean(found, axis=1)
    assert abs(shares.mean() - 0.02) < 4 * np.sqrt(0.02 / np.size(found))
    assert len({tuple(np.flatnonzero(spun)) for spun in found}) == 4


def test_a_knock_in_a_hundred_steps():
    off = np.concatenate([far_off(simulate("heavy-tails", seed=seed)) for seed in range(5)])
    knocked = np.abs(off).max(axis=1) > 6
    # A knock passes for an ordinary step if all three draws are within 6 / 40: 0.0017 of them.
    assert abs(knocked.mean() - 0.01) < 4 * np.sqrt(0.01 / len(off))
    assert_allclose((off**2).mean(), 0.99 + 0.01 * 1600, rtol=0.5)


def test_both_courses_are_the_same():
    one, other = load_scenario("spin"), load_scenario("heavy-tails")
    assert_array_equal(one.landmarks.positions, other.landmarks.positions)
    assert_array_equal(one.controls, other.controls)
    assert scenario_hash(one) != scenario_hash(other)


def summary(scenario, name: str, seed: int):
    data = simulate(scenario, seed=seed)
    return summary_rows(data, resolve(name).estimate(data)).iloc[0]


def test_an_ekf_with_two_moments_is_consistent_where_wheels_spin():
    """NEES of a pose is 3 on average; NIS, of innovations that are white, tells it more sharply."""
    rows = [summary("spin", "ekf", seed) for seed in range(10)]
    nis = np.array([row.nis_per_dof for row in rows])
    assert abs(nis.mean() - 1) < 5 * nis.std(ddof=1) / np.sqrt(len(nis)) < 0.15
    assert 1.5 < np.mean([row.nees_pose_mean for row in rows]) < 6
    assert all(row.status == "ok" for row in rows)


def test_twins_are_taken_for_each_other_in_a_share_of_the_runs():
    rows = [summary("twins", "ekf", seed) for seed in range(20)]
    wrong = [row.landmarks_merged > 0 or row.landmarks_duplicate > 0 for row in rows]
    assert 6 <= sum(wrong) <= 16
    named = load_scenario("twins", {"association": "known"})
    known = [summary(named, "ekf", seed) for seed in range(20)]
    lost = [
        row.ate_position_rmse_m / best.ate_position_rmse_m
        for row, best, bad in zip(rows, known, wrong, strict=True)
        if bad
    ]
    assert np.mean(lost) > 1.2


def test_twins_stand_a_metre_apart():
    positions = load_scenario("twins").landmarks.positions
    assert_allclose(np.hypot(*(positions[::2] - positions[1::2]).T), 1, atol=0.01)
    others = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    assert np.sort(others, axis=1)[:, 2].min() > 5
