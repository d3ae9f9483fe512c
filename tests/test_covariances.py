"""Marginals at once: against the dense inverse, against gtsam's own one by one, and what fails."""

import gtsam
import numpy as np
import pytest
from problems import camera, compass, near, problem, scanner, sonar
from scipy.sparse import csc_array

from baselines import batch, isam2, keys
from baselines.association import Association
from baselines.batch import GtsamBatch, in_words
from baselines.covariances import recovered
from baselines.isam2 import GtsamIsam2
from baselines.landmark_graph import LandmarkGraph
from baselines.noise import Kernel
from baselines.selected_inverse import IndeterminateError, diagonal_blocks
from ekfslam import geometry as geo
from ekfslam.errors import InputError
from ekfslam.estimates import FAILED
from ekfslam.filters.ekf import Ekf
from ekfslam.robots import LandmarkMap
from ekfslam.simulation import simulate

# Blocks of the inverse -----------------------------------------------------------------------


def least_squares(rng, sizes, factors):
    """Information matrix of factors that each touch some variables, and of priors."""
    first = np.concatenate([[0], np.cumsum(sizes)])
    J = [0.3 * np.eye(first[-1])]
    for some in factors:
        rows = np.zeros((4, first[-1]))
        for v in some:
            rows[:, first[v] : first[v + 1]] = rng.normal(size=(4, sizes[v]))
        J.append(rows)
    J = np.concatenate(J)
    return J.T @ J, first


def chain(count):
    return [(k, k + 1) for k in range(count - 1)]


STRUCTURES = {
    "one": (1, [(0,)]),
    "apart": (30, []),
    "chain": (120, chain(120)),
    "loop": (120, [*chain(120), (0, 119)]),
    "star": (80, [(0, v) for v in range(1, 80)]),
    "all with all": (60, [tuple(range(60))]),
    "two ends": (90, [(v, end) for v in range(88) for end in (88, 89)]),
    "chain that sees": (150, [*chain(130), *((k, 130 + k * 7 % 20) for k in range(130))]),
}


@pytest.mark.parametrize("name", STRUCTURES)
def test_blocks_are_those_of_the_dense_inverse_in_any_order(name, rng):
    count, factors = STRUCTURES[name]
    sizes = rng.integers(1, 5, count)
    matrix, first = least_squares(rng, sizes, factors)
    inverse = np.linalg.inv(matrix)
    for order in (np.arange(count), np.arange(count)[::-1], rng.permutation(count)):
        blocks = diagonal_blocks(csc_array(matrix), sizes, order)
        assert blocks.shape == (count, sizes.max(), sizes.max())
        for v, block in enumerate(blocks):
            size, own = sizes[v], slice(first[v], first[v + 1])
            expected = inverse[own, own]
            atol = 1e-10 * np.abs(expected).max()
            np.testing.assert_allclose(block[:size, :size], expected, rtol=0, atol=atol)
            assert not block[size:].any()
            assert not block[:, size:].any()


def test_a_matrix_without_variables_has_no_blocks():
    empty = np.zeros(0, dtype=np.int64)
    assert diagonal_blocks(csc_array((0, 0)), empty, empty).shape == (0, 0, 0)


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 0, 2, 1], [2, 1, 3, 0]])
def test_what_is_not_determined_is_named(order, rng):
    """Distances along a chain say nothing of where it is; the last to go shows it."""
    J = np.zeros((6, 8))
    for k in range(3):
        J[2 * k : 2 * k + 2, 2 * k : 2 * k + 4] = np.hstack([-np.eye(2), np.eye(2)])
    sizes = np.full(4, 2)
    with pytest.raises(IndeterminateError) as caught:
        diagonal_blocks(csc_array(J.T @ J), sizes, np.array(order))
    assert caught.value.variable == order[-1]
    matrix = least_squares(rng, sizes, [(0, 1), (2, 3)])[0]
    matrix[4] = matrix[:, 4] = 0  # nothing is said of a coordinate of variable 2
    with pytest.raises(IndeterminateError, match="variable 2 is not determined"):
        diagonal_blocks(csc_array(matrix), sizes, np.array(order))


# Of graphs ---------------------------------------------------------------------------------------


def assert_as_gtsam_says(problem, graph, values, sure=1e-9):
    """Each block of `recovered` against `Marginals`, beside its largest entry."""
    poses = problem.poses_of(values)
    of_poses, of_points = recovered(problem, graph, values, poses)
    marginals = gtsam.Marginals(graph, values)
    for robot, k in np.ndindex(poses.shape[:2]):
        theirs = marginals.marginalCovariance(keys.pose_key(k, robot))
        expected = geo.body_to_additive(poses[robot, k], theirs)
        assert np.abs(of_poses[robot, k] - expected).max() <= sure * np.abs(expected).max()
    ids = problem.map_of(values)[0].tolist()
    assert len(of_points) == len(ids)
    for landmark, block in zip(ids, of_points, strict=True):
        expected = marginals.marginalCovariance(keys.landmark_key(landmark))[:2, :2]
        assert np.abs(block - expected).max() <= sure * np.abs(expected).max()


def at(dataset, there, kernel=None):
    graphed = LandmarkGraph(dataset, Association.known(dataset), kernel=kernel)
    poses = there.final_trajectory.poses.reshape(len(dataset.robots), dataset.poses, 3)
    places = dict(zip(there.landmarks.ids.tolist(), there.landmarks.positions, strict=True))
    return graphed, graphed.graph(), graphed.values(poses, places, graphed.rows)


SENSORS = {
    "scanner": (scanner(),),
    "scanners displaced": (scanner(0.4, -0.2, 1.0), scanner(-0.3, 0.1, -2.0)),
    "camera displaced": (camera(0.4, -0.2, 1.0),),
    "compass displaced, sonar": (compass(0.4, -0.2, 1.0), sonar(-0.3, 0.2, 0.0)),
}


@pytest.mark.parametrize("known_start", [False, True])
@pytest.mark.parametrize("robots", [1, 3])
@pytest.mark.parametrize("name", SENSORS)
def test_marginals_are_gtsams_wherever_the_graph_is_linearised(name, robots, known_start, rng):
    meet = (0,) if robots > 1 else ()
    dataset = problem(*SENSORS[name], robots=robots, meet=meet, known_start=known_start)
    for size in (0.0, 0.2):
        assert_as_gtsam_says(*at(dataset, near(dataset, rng, size)))


def test_a_sensor_that_is_not_where_its_tie_has_it(rng):
    """As in the middle of an optimisation; it moves with the robot from where it is."""
    dataset = problem(scanner(0.4, -0.2, 1.0))
    graphed, graph, values = at(dataset, near(dataset, rng, 0.1))
    for key in values.keys():  # noqa: SIM118
        if keys.is_sensor(key):
            moved = values.atPose2(key).compose(gtsam.Pose2(0.3, -0.2, 0.5))
            values.update(key, moved)
    assert_as_gtsam_says(graphed, graph, values)


@pytest.mark.parametrize("sensor", [scanner(), camera(0.4, -0.2, 1.0)])
def test_many_landmarks_that_all_poses_see(sensor, rng):
    many = LandmarkMap(np.arange(40), rng.uniform(-10, 10, (40, 2)))
    for steps in (9, 60):  # fewer poses than landmarks, and more
        dataset = problem(sensor, steps=steps, landmarks=many)
        assert_as_gtsam_says(*at(dataset, near(dataset)))


@pytest.mark.parametrize("name", ["park", "team"])
def test_marginals_of_a_run(name):
    dataset = simulate(name, seed=1)
    assert_as_gtsam_says(*at(dataset, Ekf().estimate(dataset)))


@pytest.mark.parametrize("name", ["huber", "cauchy", "dcs"])
def test_a_sighting_counts_as_much_as_its_loss_lets_it(name, rng):
    dataset = problem(scanner())
    start = near(dataset, rng, 0.1)
    assert_as_gtsam_says(*at(dataset, start, Kernel(name, 0.5)))
    plain, robust = (
        recovered(*at(dataset, start, kernel), start.online.poses[None])[1]
        for kernel in (None, Kernel(name, 0.5))
    )
    assert (np.linalg.eigvalsh(robust - plain) > 0).all()


def test_an_indeterminate_graph_names_a_variable(monkeypatch):
    dataset = problem(scanner())
    graphed, graph, values = at(dataset, near(dataset))
    graph.remove(0)  # the prior
    with pytest.raises(RuntimeError, match="indeterminate system near variable") as caught:
        recovered(graphed, graph, values, graphed.poses_of(values))
    words = in_words(caught.value).split()
    assert words[:3] == ["indeterminate", "system", "near"]
    assert words[3] in ("pose", "landmark")

    def fail(*_):
        raise caught.value

    monkeypatch.setattr(batch.covariances, "recovered", fail)
    estimate = GtsamBatch(initial=near(dataset)).estimate(dataset)
    assert estimate.status == FAILED
    assert estimate.message == " ".join(words)


# Of iSAM2 ----------------------------------------------------------------------------------------


@pytest.fixture
def smoothers(monkeypatch):
    """Instances of iSAM2 that are made."""
    made = []

    class Kept(gtsam.ISAM2):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            made.append(self)

    monkeypatch.setattr(isam2.gtsam, "ISAM2", Kept)
    return made


@pytest.mark.parametrize("threshold", [1e-3, 10.0])
@pytest.mark.parametrize("name", ["scanners displaced", "camera displaced"])
def test_marginals_of_isam2_are_those_of_its_own_system(name, threshold, smoothers):
    """Some variables linearised lately, some long ago."""
    dataset = problem(*SENSORS[name], robots=2, meet=(0,))
    estimate = GtsamIsam2(relinearize_threshold=threshold, relinearize_skip=3).estimate(dataset)
    (isam,) = smoothers
    there = estimate.smoothed.poses
    expected = np.array(
        [[isam.marginalCovariance(keys.pose_key(k, r)) for k in range(10)] for r in range(2)]
    )
    expected = geo.body_to_additive(there, expected)
    scale = np.abs(expected).max(axis=(2, 3), keepdims=True)
    assert np.abs((estimate.smoothed.covariances - expected) / scale).max() < 1e-9
    for landmark, block in zip(
        estimate.landmarks.ids.tolist(), estimate.landmarks.covariances, strict=True
    ):
        own = isam.marginalCovariance(keys.landmark_key(landmark))[:2, :2]
        assert np.abs(block - own).max() < 1e-9 * np.abs(own).max()
    last = estimate.smoothed.covariances[:, -1], estimate.online.covariances[:, -1]
    np.testing.assert_allclose(*last, rtol=0, atol=1e-9 * np.abs(last[0]).max())


def test_the_newest_pose_at_chosen_steps():
    dataset = problem(scanner())
    all_of_them, some = (GtsamIsam2(marginal_every=n).estimate(dataset) for n in (1, 4))
    assert np.isfinite(all_of_them.online.covariances).all()
    chosen = [0, 4, 8, 9]  # and the last
    left = np.setdiff1d(np.arange(10), chosen)
    ours, theirs = some.online.covariances, all_of_them.online.covariances
    np.testing.assert_array_equal(ours[chosen], theirs[chosen])
    assert np.isnan(ours[left]).all()
    np.testing.assert_array_equal(some.online.poses, all_of_them.online.poses)
    assert np.isfinite(some.smoothed.covariances).all()
    for wrong in (0, 2.5, np.nan):
        with pytest.raises(InputError, match="marginal_every must be a whole number from 1"):
            GtsamIsam2(marginal_every=wrong)


# What smoothers claim, over runs ------------------------------------------------------------------


def test_the_noise_of_the_factors_is_the_noise_of_the_simulation():
    """2 error / dof of the optimum is 1, and the errors of poses are what marginals say.

    On the small loop with ranges and bearings. The pose errors of a run hang together, so the
    scatter of the means of runs judges the mean over all.
    """
    squared, dof, means = 0.0, 0, []
    for seed in range(50):
        dataset = simulate("loop-15-rb", seed=seed)
        estimate = GtsamBatch().estimate(dataset)
        assert "floored" not in estimate.message
        squared, dof = squared + 2 * estimate.graph_error, dof + estimate.graph_dof
        errors = geo.additive_error(dataset.truth, estimate.smoothed.poses)[5:]
        whitened = np.linalg.solve(
            np.linalg.cholesky(estimate.smoothed.covariances[5:]), errors[..., None]
        )
        means.append(np.sum(whitened**2) / len(errors))
    assert abs(squared / dof - 1) < 4 * np.sqrt(2 / dof)
    assert abs(np.mean(means) - 3) < 4 * np.std(means) / np.sqrt(len(means))
