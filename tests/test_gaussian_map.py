"""The map as a data structure: its four operations against dense algebra, growth, deletion."""

import numpy as np
import pytest

from ekfslam import geometry as geo
from ekfslam.dataset import Prior
from ekfslam.errors import EkfslamError, InputError
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.models.landmarks import depth_prior, inverse_depth, observe_inverse_depth, to_point
from ekfslam.models.sensors import Sensor

Q = np.array([[4e-3, 1e-3, 0], [1e-3, 2e-3, -5e-4], [0, -5e-4, 1e-3]])
SENSOR = Sensor("range-bearing", [[0.01, 0.001], [0.001, 0.004]], mount=[0.3, 0.1, 0.4])
COMPASS = Sensor("bearing", [[0.001]], mount=[-0.2, 0.1, 1.0], min_range=1.0)
PRIOR = Prior([1.0, -2.0, 3.0], [[0.04, 0.01, 0], [0.01, 0.09, 0.01], [0, 0.01, 0.01]])


class DenseMap:
    """The same operations with full matrices."""

    def __init__(self, *priors):
        self.mean = np.concatenate([prior.mean for prior in priors])
        self.robots = len(priors)
        self.covariance = np.zeros((3 * self.robots, 3 * self.robots))
        for robot, prior in enumerate(priors):
            at = self.pose(robot)
            self.covariance[at, at] = prior.covariance

    @staticmethod
    def pose(robot):
        return slice(3 * robot, 3 * robot + 3)

    def move(self, delta, covariance, robot=0):
        n, at = len(self.mean), self.pose(robot)
        F, G = np.eye(n), np.zeros((n, 3))
        F[at, at], G[at] = geo.compose_jacobians(self.mean[at], delta)
        self.mean[at] = geo.compose(self.mean[at], delta)
        self.covariance = F @ self.covariance @ F.T + G @ covariance @ G.T

    def correct(self, offsets, H, innovation, R, robot=0):
        n, (m, d, width) = len(self.mean), H.shape
        full, noise = np.zeros((d * m, n)), np.zeros((d * m, d * m))
        for i, offset in enumerate(offsets):
            rows = slice(d * i, d * i + d)
            full[rows, self.pose(robot)] = H[i, :, :3]
            full[rows, offset : offset + width - 3] = H[i, :, 3:]
            noise[rows, rows] = R[i]
        z = innovation.reshape(-1)
        S = full @ self.covariance @ full.T + noise
        K = self.covariance @ full.T @ np.linalg.inv(S)
        self.mean = self.mean + K @ z
        headings = 3 * np.arange(self.robots) + 2
        self.mean[headings] = geo.wrap(self.mean[headings])
        self.covariance = self.covariance - K @ S @ K.T
        return z @ np.linalg.solve(S, z)

    def append(self, landmark, wrt_pose, wrt_value, R, wrt_prior=None, S=None, robot=0):
        n = len(self.mean)
        A = np.zeros((len(landmark), n))
        A[:, self.pose(robot)] = wrt_pose
        G_y, G_s = np.asarray(wrt_value), np.zeros((len(landmark), 1))
        if wrt_prior is not None:
            G_s = wrt_prior @ np.linalg.cholesky(S)
        P, noise = self.covariance, G_y @ R @ G_y.T + G_s @ G_s.T
        self.mean = np.append(self.mean, landmark)
        self.covariance = np.block([[P, P @ A.T], [A @ P, A @ P @ A.T + noise]])
        return n

    def replace(self, offset, landmark, jacobian):
        new, old = jacobian.shape
        T = np.eye(len(self.mean))
        T[offset : offset + new] = 0.0
        T[offset : offset + new, offset : offset + old] = jacobian
        self.mean[offset : offset + new] = landmark
        self.covariance = T @ self.covariance @ T.T
        self.remove(offset + new, old - new)

    def remove(self, offset, size=2):
        keep = np.delete(np.arange(len(self.mean)), offset + np.arange(size))
        self.mean, self.covariance = self.mean[keep], self.covariance[np.ix_(keep, keep)]


def see_new(slam, value, robot=0):
    """Put a landmark into the map from a measurement."""
    pose = slam.mean[3 * robot : 3 * robot + 3]
    point, wrt_pose, wrt_value = SENSOR.locate(pose, value)
    return slam.append(point, wrt_pose, wrt_value, SENSOR.covariances(value), robot=robot)


def see_again(slam, offsets, error, robot=0):
    """Correct with measurements that differ from the expected ones by `error`."""
    points = np.array([slam.mean[o : o + 2] for o in offsets])
    value, wrt_pose, wrt_point = SENSOR.observe(slam.mean[3 * robot : 3 * robot + 3], points)
    H = np.concatenate([wrt_pose, wrt_point], axis=2)
    innovation = np.tile(np.asarray(error, dtype=float), (len(offsets), 1))
    return slam.correct(np.array(offsets), H, innovation, SENSOR.covariances(value), robot)


def drive(slam, steps=6, use=(0, 1, 2)):
    """A small run: landmarks come in one by one, and those of `use` are seen again."""
    offsets = []
    for k in range(steps):
        slam.move(np.array([0.5, 0.1, 0.3]), Q)
        again = [offsets[i] for i in use if i < len(offsets)]
        if again:
            see_again(slam, again, [0.02 * (k + 1), -0.01 * k])
        offsets.append(see_new(slam, np.array([4.0 + k, 0.5 - 0.3 * k])))
    return offsets


def assert_same(slam, dense, tolerance=1e-12):
    np.testing.assert_allclose(slam.mean, dense.mean, rtol=0, atol=tolerance)
    np.testing.assert_allclose(slam.covariance, dense.covariance, rtol=0, atol=tolerance)


def test_a_run_equals_dense_algebra():
    slam, dense = GaussianMap(PRIOR), DenseMap(PRIOR)
    for each in (slam, dense):
        drive(each)
    assert slam.size == 15
    assert_same(slam, dense)
    nis = [see_again(slam, [5, 11], [0.1, 0.2]) for slam in (slam, dense)]
    np.testing.assert_allclose(*nis, rtol=1e-12)
    assert_same(slam, dense)


def take_bearing(slam, value, robot):
    """Put an inverse depth into the map from a bearing and a prior."""
    mean, variance = depth_prior(COMPASS.min_range)
    pose = slam.mean[3 * robot : 3 * robot + 3]
    landmark, wrt_pose, wrt_value, wrt_prior = inverse_depth(COMPASS, pose, [value], mean)
    prior = wrt_prior, np.array([[variance]])
    return slam.append(landmark, wrt_pose, wrt_value, COMPASS.covariance, *prior, robot=robot)


def take_bearings_again(slam, offsets, error, robot):
    """Correct with bearings of inverse depths, one row each."""
    landmarks = np.array([slam.mean[o : o + 4] for o in offsets])
    pose = slam.mean[3 * robot : 3 * robot + 3]
    _, wrt_pose, wrt_landmark = observe_inverse_depth(COMPASS, pose, landmarks)
    H = np.concatenate([wrt_pose, wrt_landmark], axis=2)
    noise = np.tile(COMPASS.covariance, (len(offsets), 1, 1))
    return slam.correct(np.array(offsets), H, np.full((len(offsets), 1), error), noise, robot)


def test_two_robots_with_points_and_inverse_depths_equal_dense_algebra():
    other = Prior([0.0, 1.0, -0.5], np.diag([0.01, 0.02, 0.03]))
    slam, dense = GaussianMap([PRIOR, other], landmarks=1), DenseMap(PRIOR, other)
    nis = []
    for each in (slam, dense):
        for k in range(4):
            each.move(np.array([0.5, 0.1, 0.3]), Q, robot=0)
            each.move(np.array([0.4, -0.1, -0.2]), 2 * Q, robot=1)
            see_new(each, np.array([4.0 + k, 0.5 - 0.3 * k]), robot=k % 2)
            at = take_bearing(each, 0.3 * k, robot=1)
            each.move(np.array([0.1, 0.2, 0.1]), Q, robot=1)
            first = [6 + 2, 6 + 2 + 6] if k else [8]  # a point and four more each time
            nis.append(take_bearings_again(each, first, 0.01 * k, robot=1))
            nis.append(see_again(each, [6], [0.02, -0.01], robot=k % 2))
        each.remove(20, 4)  # the third inverse depth
        point, jacobian = to_point(each.mean[8:12])
        each.replace(8, point, jacobian)
        see_again(each, [8, 6], [0.01, 0.0], robot=1)
        assert at == 26
    assert slam.size == len(dense.mean) == 6 + 4 * 6 - 4 - 2
    np.testing.assert_allclose(nis[: len(nis) // 2], nis[len(nis) // 2 :], rtol=1e-10)
    assert_same(slam, dense, 1e-11)


def test_robots_are_independent_until_one_sees_what_the_other_has_seen():
    slam = GaussianMap([PRIOR, PRIOR])
    mine, theirs = see_new(slam, np.array([4.0, 0.5])), see_new(slam, np.array([3.0, 0.1]), robot=1)
    for _ in range(3):
        for robot, landmark in enumerate((mine, theirs)):
            slam.move(np.array([0.5, 0.1, 0.3]), Q, robot=robot)
            see_again(slam, [landmark], [0.01, 0.02], robot=robot)
    ours, others = np.r_[0:3, 6:8], np.r_[3:6, 8:10]
    np.testing.assert_array_equal(slam.covariance[np.ix_(ours, others)], 0)
    see_again(slam, [theirs], [0.01, 0.02], robot=0)
    assert (np.abs(slam.covariance[np.ix_(ours, others)]) > 1e-6).all()


def test_the_covariance_is_symmetric_to_the_bit_and_blocks_are_cut_from_it():
    slam = GaussianMap(PRIOR)
    drive(slam)
    P = slam.covariance
    np.testing.assert_array_equal(P, P.T)
    np.testing.assert_array_equal(slam.block(0, 3), P[:3, :3])
    np.testing.assert_array_equal(slam.block(5, 4), P[5:9, 5:9])
    assert np.linalg.eigvalsh(P).min() > 0


def test_what_lies_below_the_diagonal_is_never_read():
    slam, clean = GaussianMap(PRIOR), GaussianMap(PRIOR)
    storage = slam.arrays.covariance
    storage[np.tril_indices(len(storage), -1)] = np.nan
    storage[slam.size :] = np.nan
    storage[:, slam.size :] = np.nan
    for map_ in (slam, clean):
        offsets = drive(map_)
        map_.remove(offsets[1])
        see_again(map_, [3, 7], [0.1, 0.0])
    np.testing.assert_array_equal(slam.mean, clean.mean)
    np.testing.assert_array_equal(slam.covariance, clean.covariance)


def test_storage_grows_by_doubling_and_changes_no_bit():
    tiny, roomy = GaussianMap(PRIOR, landmarks=1), GaussianMap(PRIOR, landmarks=500)
    sizes = set()
    for slam in (tiny, roomy):
        for _ in range(3):
            drive(slam)
            sizes.add(len(slam.arrays.mean))
    np.testing.assert_array_equal(tiny.mean, roomy.mean)
    np.testing.assert_array_equal(tiny.covariance, roomy.covariance)
    assert sizes == {20, 40, 1003}  # 5 -> 10 -> 20 -> 40; the roomy one stays
    tiny.reserve(10)
    assert len(tiny.arrays.mean) == 40


@pytest.mark.parametrize("gone", [0, 2, 5])
def test_after_a_deletion_the_rest_is_the_marginal(gone):
    slam, dense = GaussianMap(PRIOR), DenseMap(PRIOR)
    offset = drive(slam)[gone]
    drive(dense)
    before = slam.mean.copy(), slam.covariance
    slam.remove(offset)
    keep = np.delete(np.arange(15), [offset, offset + 1])
    np.testing.assert_array_equal(slam.mean, before[0][keep])
    np.testing.assert_array_equal(slam.covariance, before[1][np.ix_(keep, keep)])
    dense.remove(offset)
    for each in (slam, dense):
        see_again(each, [3, 9], [0.1, -0.1])
        see_new(each, np.array([3.0, 1.0]))
        drive(each, steps=2)
    assert_same(slam, dense)


def test_a_run_after_a_deletion_equals_one_that_never_uses_the_landmark_again():
    removed, kept = GaussianMap(PRIOR), GaussianMap(PRIOR)
    for slam in (removed, kept):
        drive(slam)
    removed.remove(7)
    for k in range(20):
        for slam, shift in ((removed, 0), (kept, 2)):
            slam.move(np.array([0.3, 0.0, -0.4]), Q)
            see_again(slam, [3, 9 + shift], [0.05, -0.01 * k])
            see_new(slam, np.array([2.0, 0.1 * k]))
    others = np.delete(np.arange(kept.size), [7, 8])
    np.testing.assert_allclose(removed.mean, kept.mean[others], rtol=0, atol=1e-12)
    rest = kept.covariance[np.ix_(others, others)]
    np.testing.assert_allclose(removed.covariance, rest, rtol=0, atol=1e-12)


def test_joint_equals_one_after_another_where_all_is_linear():
    joint, single = GaussianMap(PRIOR), GaussianMap(PRIOR)
    H, R = np.zeros((2, 2, 5)), np.tile(np.diag([0.1, 0.2]), (2, 1, 1))
    H[:, :, :2], H[:, :, 3:] = -np.eye(2), np.eye(2)
    z = np.array([[0.1, 0.2], [-0.2, 0.05]])
    for slam in (joint, single):
        drive(slam)
    start = single.mean.copy()
    together = joint.correct(np.array([3, 5]), H, z, R)
    apart = single.correct(np.array([3]), H[:1], z[:1], R[:1])
    moved = single.mean - start
    left = z[1:] - (moved[5:7] - moved[:2])
    apart += single.correct(np.array([5]), H[1:], left, R[1:])
    assert_same(joint, single, 1e-13)
    np.testing.assert_allclose(together, apart, rtol=1e-12)


def test_no_observation_changes_nothing():
    slam = GaussianMap(PRIOR)
    drive(slam)
    mean, P = slam.mean.copy(), slam.covariance
    empty = np.zeros(0, dtype=np.int64), np.zeros((0, 2, 5)), np.zeros((0, 2)), np.zeros((0, 2, 2))
    assert slam.correct(*empty) == 0
    np.testing.assert_array_equal(slam.mean, mean)
    np.testing.assert_array_equal(slam.covariance, P)


def test_an_innovation_that_is_certain_is_refused_and_the_map_untouched():
    slam = GaussianMap(Prior())
    offset = slam.append(np.array([1.0, 0.0]), np.eye(2, 3), np.eye(2), np.zeros((2, 2)))
    H = np.ones((1, 2, 5))
    with pytest.raises(EkfslamError, match="not positive definite"):
        slam.correct(np.array([offset]), H, np.ones((1, 2)), np.zeros((1, 2, 2)))
    np.testing.assert_array_equal(slam.mean, [0, 0, 0, 1, 0])
    np.testing.assert_array_equal(slam.covariance, np.zeros((5, 5)))


@pytest.mark.parametrize("offset", [0, 2, 14, 15, -2])
def test_only_landmarks_can_be_deleted(offset):
    slam = GaussianMap(PRIOR)
    drive(slam)
    with pytest.raises(InputError, match=f"no landmark of 2 coordinates at offset {offset} of a"):
        slam.remove(offset)
    with pytest.raises(InputError, match=f"no landmark of 4 coordinates at offset {offset} of a"):
        slam.replace(offset, np.zeros(2), np.ones((2, 4)))
    with pytest.raises(InputError, match="no landmark of 4 coordinates at offset 13"):
        slam.remove(13, 4)


@pytest.mark.parametrize("offset", [3, 5])
def test_another_robot_is_no_landmark(offset):
    slam = GaussianMap([PRIOR, PRIOR])
    see_new(slam, np.array([4.0, 0.5]))
    with pytest.raises(InputError, match=f"at offset {offset} of a state of 8"):
        slam.remove(offset)
