"""What decisions are made on, against dense algebra; and what the filter makes of each method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from ekfslam import EkfSlam
from ekfslam import geometry as geo
from ekfslam.dataset import Prior, Sightings
from ekfslam.estimates import Decision
from ekfslam.filters import recognition
from ekfslam.models.landmarks import observe_inverse_depth
from ekfslam.models.sensors import Sensor

PRIORS = [
    Prior([1.0, -2.0, 0.5], [[0.04, 0.01, 0], [0.01, 0.09, 0.01], [0, 0.01, 0.01]]),
    Prior([-1.0, 2.0, -2.5], np.diag([0.02, 0.01, 0.005])),
]
NOISE = np.array([[0.04, 0.006], [0.006, 0.01]])
MOUNT = [0.7, -0.3, -1.9]
FULL = [Sensor(kind, NOISE, mount=MOUNT) for kind in ("range-bearing", "xy")]
CAMERA = Sensor("bearing", [[0.0004]], mount=MOUNT, min_range=0.8)
XY = Sensor("xy", np.diag([0.01, 0.01]))
NEW, ACCEPTED, AMBIGUOUS = (int(Decision[name]) for name in ("NEW", "ACCEPTED", "AMBIGUOUS"))


def a_state(association, rng, **options):
    """Two robots that have each mapped some landmarks, by points and by directions."""
    slam = EkfSlam(PRIORS, **options)
    for robot in (0, 1):
        values = np.column_stack([rng.uniform(2, 8, 4), rng.uniform(-3, 3, 4)])
        ids = 4 * robot + np.arange(4)
        slam.observe(Sightings.of(FULL[0], values, ids, robot=robot))
        slam.predict(np.full((2, 3), 0.1), 1e-3 * np.eye(3)[None].repeat(2, axis=0))
    slam.observe(Sightings.of(CAMERA, [[0.3], [-2.0]], [8, 9], robot=1))
    # From here on identities are not known.
    slam._engine.settings = EkfSlam(PRIORS, association, **options)._engine.settings
    return slam


def dense(slam, sensor, robot, index, value):
    """Squared distance and log det S of a pair, with H as wide as the state."""
    register, P = slam._engine.register, slam._engine.slam.covariance
    at, size = register.offsets[index], register.sizes[index]
    mean = slam._engine.slam.mean
    pose, target = mean[3 * robot : 3 * robot + 3], mean[at : at + size]
    model = observe_inverse_depth if size == 4 else None
    seen = model(sensor, pose, target) if model else sensor.observe(pose, target)
    expected, wrt_pose, wrt_target = seen
    H = np.zeros((len(expected), len(P)))
    H[:, 3 * robot : 3 * robot + 3], H[:, at : at + size] = wrt_pose, wrt_target
    S = H @ P @ H.T + sensor.covariance
    z = sensor.difference(value, expected)
    return z @ np.linalg.solve(S, z), np.log(np.linalg.det(S))


def evidence(slam, seen):
    engine = slam._engine
    return recognition.gather(engine.state, seen, 0, len(seen.values), engine.settings)


# The evidence -------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [0, 1])
@pytest.mark.parametrize("sensor", [*FULL, CAMERA], ids=lambda sensor: sensor.kind)
def test_distances_are_those_of_the_dense_innovation(sensor, robot, rng):
    slam = a_state("nearest", rng)
    d = sensor.view.size
    values = np.array([[3.0, 0.4], [6.0, -2.9], [5.0, 3.0]])[:, :d]
    if sensor.kind == "range-bearing":
        values[:, 0] = np.abs(values[:, 0])
    found = evidence(slam, Sightings.of(sensor, values, robot=robot))
    np.testing.assert_array_equal(found.candidates, np.arange(10))  # all may be visible
    sizes = slam._engine.register.sizes
    for k, value in enumerate(values):
        for j, index in enumerate(found.candidates):
            if sizes[index] == 4 and sensor.kind != "bearing":
                continue  # linearised elsewhere: test_measure_kernels
            distance, logdet = dense(slam, sensor, robot, index, value)
            np.testing.assert_allclose(found.distances[k, j], distance, rtol=1e-9)
            np.testing.assert_allclose(found.logdets[k, j], logdet, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("sensor", FULL, ids=lambda sensor: sensor.kind)
def test_points_are_compared_without_what_is_uncertain_of_robot_and_measurement(sensor, rng):
    """Ciatto, 3.6: in metres, or in the sigmas of the landmark alone."""
    value = np.array([[3.0, 0.4], [5.0, 3.0]])
    for method in ("euclidean", "mahalanobis-first"):
        slam = a_state(method, np.random.default_rng(3), radius=0.5)
        found = evidence(slam, Sightings.of(sensor, value, robot=1))
        P, mean = slam._engine.slam.covariance, slam._engine.slam.mean
        points = sensor.locate(mean[3:6], value)[0]
        for j, index in enumerate(found.candidates):
            at = slam._engine.register.offsets[index]
            if slam._engine.register.sizes[index] == 4:
                continue  # no view of points has made it
            apart = points - mean[at : at + 2]
            expected = np.linalg.norm(apart, axis=1)
            if method == "mahalanobis-first":
                inverse = np.linalg.inv(P[at : at + 2, at : at + 2])
                expected = np.sqrt(np.einsum("ki,ij,kj->k", apart, inverse, apart))
            np.testing.assert_allclose(found.points[:, j], expected, rtol=1e-10)


def test_candidates_are_what_may_be_visible():
    slam = EkfSlam(association="nearest")
    slam.observe(Sightings.of(XY, [[4.0, 0.0], [-4.0, 0.0], [0.0, 6.0], [20.0, 0.0]]))
    ahead = replace(XY, max_range=10.0, field_of_view=np.pi / 2)
    found = evidence(slam, Sightings.of(ahead, [[4.0, 0.1]]))
    assert found.candidates.tolist() == [0]
    slam.predict(np.zeros(3), np.diag([0, 0, 4.0]))  # who knows where it looks now
    assert evidence(slam, Sightings.of(ahead, [[4.0, 0.1]])).candidates.tolist() == [0, 1, 2, 3]


# Methods ------------------------------------------------------------------------------------------


def at_once(landmarks):
    """Points seen for the first time in one look, each with a noise of its own."""
    look = Sightings.of(XY, [point for point, _ in landmarks])
    return look._replace(covariance=np.array([sigma**2 * np.eye(2) for _, sigma in landmarks]))


def met(association, landmarks, seen, matching="scan", turn=0.0, noise=None, **options):
    """What sightings are taken for by a robot whose landmarks have different uncertainties."""
    slam = EkfSlam(association=association, matching=matching, **options)
    slam.observe(at_once(landmarks))
    if noise is not None:
        slam.predict(np.zeros(3), noise)
    values = np.array(seen) @ geo.rotation(turn)
    found = slam.observe(Sightings.of(XY, values))
    return found.landmark.tolist(), found.decision.tolist()


# One is known well and 0.5 m away, one badly and 1.5 m away.
NEAR_AND_VAGUE = [([5.0, 0.5], 0.05), ([5.0, -1.5], 1.0)]


def test_nearest_in_metres_in_sigmas_and_by_likelihood_differ():
    """The vague one is nearer in sigmas; a likelihood holds its vagueness against it."""
    here = [[5.0, 0.0]]
    assert met("euclidean", NEAR_AND_VAGUE, here, radius=2.0)[0] == [0]
    for method in ("nearest", "smallest-distance", "global", "joint"):
        assert met(method, NEAR_AND_VAGUE, here, accept=0.99999, new=0.999999)[0] == [1]
    likelier = met("maximum-likelihood", NEAR_AND_VAGUE, [[5.0, 0.22]], accept=0.99999)[0]
    smallest = met("smallest-distance", NEAR_AND_VAGUE, [[5.0, 0.22]], accept=0.99999)[0]
    assert (likelier, smallest) == ([0], [1])


@pytest.mark.parametrize("order", [1, -1])
def test_the_first_within_the_threshold_is_taken_whatever_comes_after(order):
    """Ciatto, 3.6: by the order in which they came into the map."""
    landmarks = [([5.0, 0.6], 0.3), ([5.0, -0.2], 0.3)][::order]
    nearest = [[5.0, 0.2], [5.0, -0.2]].index([5.0, -0.2])
    for first in ("euclidean-first", "mahalanobis-first"):
        assert met(first, landmarks, [[5.0, 0.0]], radius=1.0)[0] == [0]
    expected = nearest if order == 1 else 1 - nearest
    assert met("euclidean", landmarks, [[5.0, 0.0]], radius=1.0)[0] == [expected]


def test_the_uncertainty_of_the_robot_is_left_out_by_the_first_within():
    """It makes a new landmark of what an innovation gate accepts."""
    landmark, here, lost = [([5.0, 0.0], 0.05)], [[5.8, 0.0]], np.diag([0.1, 0.1, 0.0])
    assert met("nearest", landmark, here, noise=lost)[1] == [ACCEPTED]
    assert met("mahalanobis-first", landmark, here, noise=lost)[1] == [NEW]


def test_only_joint_compatibility_sees_that_all_are_turned_together():
    """The robot has turned by 0.14 rad and does not know it: each is now next to its neighbour."""
    ring = [([10 * np.cos(a), 10 * np.sin(a)], 0.02) for a in 0.2 * np.arange(6)]
    seen, doubt = [point for point, _ in ring], np.diag([1e-4, 1e-4, 0.1**2])
    alone = met("nearest", ring, seen, turn=0.14, noise=doubt)[0]
    together = met("joint", ring, seen, turn=0.14, noise=doubt)[0]
    assert together == [0, 1, 2, 3, 4, 5]
    assert alone != together


@pytest.mark.parametrize("association", ["nearest", "global", "joint", "maximum-likelihood"])
def test_one_by_one_uses_what_the_sighting_before_has_taught(association):
    """After the first correction the robot knows its turn, and the second one is near again."""
    landmarks = [([10.0, 0.0], 0.02), ([0.0, 10.0], 0.02), ([-0.9, 9.95], 0.02)]
    seen, doubt = [[10.0, 0.0], [0.0, 10.0]], np.diag([1e-4, 1e-4, 0.05**2])
    one_by_one = met(association, landmarks, seen, "one-by-one", turn=-0.06, noise=doubt)
    assert one_by_one == ([0, 1], [ACCEPTED, ACCEPTED])
    if association in ("nearest", "maximum-likelihood"):
        assert met(association, landmarks, seen, turn=-0.06, noise=doubt)[0] == [0, 2]


def test_one_assignment_for_all_where_the_greedy_one_fails():
    """Both are nearest to the same; the assignment gives the other its second choice."""
    landmarks, seen = [([5.0, 0.0], 0.3), ([5.0, 1.2], 0.3)], [[5.0, 0.45], [5.0, -0.35]]
    assert met("global", landmarks, seen)[0] == [1, 0]
    greedy = met("nearest", landmarks, seen)
    assert greedy[1].count(AMBIGUOUS) == 1


@pytest.mark.parametrize(("limit", "cut"), [(2, True), (10_000, False)])
def test_a_search_that_is_cut_is_told(limit, cut):
    crowd = [([5 + 0.05 * k, 0.05 * (k % 3)], 0.3) for k in range(12)]
    slam = EkfSlam(association="joint", limit=limit)
    slam.observe(at_once(crowd))
    values = np.array([point for point, _ in crowd[:4]])
    slam.observe(Sightings.of(XY, values))
    assert (slam._engine.searches_cut > 0) == cut


def test_a_descriptor_is_one_more_row_of_the_innovation():
    """Its variance is that of the reading and of the mean of n readings before."""
    sigma, readings = 0.05, [0.30, 0.34, 0.35]
    slam = EkfSlam(association="nearest", descriptor_sigma=sigma)
    for reading in readings:
        slam.observe(Sightings.of(XY, [[5.0, 0.0], [0.0, 5.0]], descriptor=[reading, np.nan]))
    seen = Sightings.of(XY, [[5.1, 0.0], [5.1, 0.0]], descriptor=[0.5, np.nan])
    found, plain = (
        evidence(slam, seen),
        evidence(slam, seen._replace(descriptor=np.full(2, np.nan))),
    )
    more = (0.5 - np.mean(readings)) ** 2 / (sigma**2 * (1 + 1 / 3))
    np.testing.assert_allclose(found.distances[0, 0] - plain.distances[0, 0], more, rtol=1e-9)
    # Where there is nothing to compare, nothing is added; gates are those of the rows there are.
    np.testing.assert_array_equal(found.distances[1], plain.distances[1])
    np.testing.assert_array_equal(found.distances[:, 1], plain.distances[:, 1])
    np.testing.assert_allclose(found.accept, chi2.ppf(0.999, [3, 2]), rtol=1e-9)
    np.testing.assert_allclose(found.new, chi2.ppf(0.999999, [3, 2]), rtol=1e-9)
