"""ATE and RPE against evo and against laws of rigid motion."""

from dataclasses import replace

import numpy as np
import pytest
from evo.core.metrics import APE, RPE, PoseRelation, Unit
from evo.core.trajectory import PosePath3D

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, Observations, Robot
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.estimates import Trajectory
from ekfslam.evaluation import (
    absolute_errors,
    alignment_motion,
    frame_motion,
    path_length,
    relative_errors,
)
from ekfslam.evaluation.statistics import rmse
from ekfslam.models.motion import MotionModel

# Positions within 100 m and headings carry round-off near 1e-14; evo goes through SVD and arccos.
CLOSE = {"rtol": 0.0, "atol": 1e-9}


@pytest.fixture(params=range(4))
def pair(request):
    """Well-spread planar trajectories: the truth, and an estimate that is off by a little."""
    rng = np.random.default_rng(request.param)
    increments = rng.normal([1.0, 0.0, 0.0], [0.3, 0.2, 0.3], (200, 3))
    noise = rng.normal(0.0, [0.05, 0.05, 0.02], (200, 3))
    start = rng.uniform([-50, -50, -3], [50, 50, 3])
    drifted = geo.compose(start, rng.normal(0.0, [1.0, 1.0, 0.2]))
    return geo.integrate(drifted, increments + noise), geo.integrate(start, increments)


def path(poses):
    """Planar poses as evo's spatial ones."""
    spatial = np.tile(np.eye(4), (len(poses), 1, 1))
    spatial[:, :2, :2] = geo.rotation(poses[:, 2])
    spatial[:, :2, 3] = poses[:, :2]
    return PosePath3D(poses_se3=list(spatial))


def evo_errors(metric, poses, truth, align=False):
    estimate, reference = path(poses), path(truth)
    if align:
        estimate.align(reference)
    metric.process_data((reference, estimate))
    return metric.error


@pytest.mark.parametrize("alignment", ["none", "se2"])
def test_absolute_errors_agree_with_evo(pair, alignment):
    poses, truth = pair
    moved = geo.compose(alignment_motion(poses, truth, alignment), poses)
    ours = absolute_errors(moved, truth)
    align = alignment == "se2"
    position = evo_errors(APE(PoseRelation.translation_part), poses, truth, align)
    heading = evo_errors(APE(PoseRelation.rotation_angle_rad), poses, truth, align)
    np.testing.assert_allclose(ours.position, position, **CLOSE)
    np.testing.assert_allclose(ours.heading, heading, **CLOSE)
    assert rmse(ours.position) == pytest.approx(np.sqrt(np.mean(position**2)), abs=1e-9)


@pytest.mark.parametrize(
    ("field", "relation"),
    [("position", PoseRelation.translation_part), ("heading", PoseRelation.rotation_angle_rad)],
)
def test_relative_errors_per_step_agree_with_evo(pair, field, relation):
    poses, truth = pair
    expected = evo_errors(RPE(relation, delta=1, delta_unit=Unit.frames), poses, truth)
    np.testing.assert_allclose(getattr(relative_errors(poses, truth), field), expected, **CLOSE)


def test_relative_errors_per_distance_agree_with_a_plain_search(pair):
    poses, truth = pair
    travelled = path_length(truth)
    position, heading = [], []
    for i in range(len(truth)):
        for j in range(i, len(truth)):
            if travelled[j] - travelled[i] >= 10.0:
                true = np.linalg.solve(path(truth).poses_se3[i], path(truth).poses_se3[j])
                ours = np.linalg.solve(path(poses).poses_se3[i], path(poses).poses_se3[j])
                error = np.linalg.solve(true, ours)
                position.append(np.hypot(*error[:2, 3]))
                heading.append(abs(np.arctan2(error[1, 0], error[0, 0])))
                break
    found = relative_errors(poses, truth, 10.0)
    assert 100 < len(found.position) < len(truth)
    np.testing.assert_allclose(found.position, position, **CLOSE)
    np.testing.assert_allclose(found.heading, heading, **CLOSE)


def test_a_whole_number_of_equal_steps_reaches_the_distance():
    truth = geo.integrate([0, 0, 0.3], np.tile([0.1, 0.0, 0.0], (300, 1)))
    shrunk = geo.integrate([0, 0, 0.3], np.tile([0.09, 0.0, 0.0], (300, 1)))
    # One step too many would read 1.01.
    np.testing.assert_allclose(relative_errors(shrunk, truth, 10.0).position, 1.0, atol=1e-9)


def test_a_robot_that_stands_is_paired_with_the_first_pose_far_enough():
    truth = np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0]], dtype=float)
    poses = truth.copy()
    poses[:, 1] = [0, 1, 2, 4, 8]
    np.testing.assert_allclose(relative_errors(poses, truth, 1.0).position, [2, 1, 6, 4])


def test_a_path_shorter_than_the_distance_has_no_pairs(pair):
    poses, truth = pair
    assert len(relative_errors(poses, truth, 1e6).position) == 0
    assert np.isnan(rmse(relative_errors(poses, truth, 1e6).position))


def test_the_truth_itself_has_no_error(pair):
    _, truth = pair
    np.testing.assert_array_equal(alignment_motion(truth, truth), np.zeros(3))
    for errors in (absolute_errors(truth, truth), relative_errors(truth, truth, 5.0)):
        assert not errors.position.any()
        assert not errors.heading.any()


def test_aligned_errors_do_not_depend_on_the_frame_of_the_estimate(pair):
    poses, truth = pair
    expected = absolute_errors(geo.compose(alignment_motion(poses, truth, "se2"), poses), truth)
    moved = geo.compose([30.0, -70.0, 2.5], poses)
    again = absolute_errors(geo.compose(alignment_motion(moved, truth, "se2"), moved), truth)
    np.testing.assert_allclose(again.position, expected.position, rtol=0, atol=1e-11)
    np.testing.assert_allclose(again.heading, expected.heading, rtol=0, atol=1e-12)
    assert not np.allclose(absolute_errors(moved, truth).position, expected.position)


def test_relative_errors_do_not_depend_on_either_frame(pair):
    poses, truth = pair
    expected = relative_errors(poses, truth, 10.0)
    moved = relative_errors(
        geo.compose([30.0, -70.0, 2.5], poses), geo.compose([-5.0, 8.0, -1.0], truth), 10.0
    )
    np.testing.assert_allclose(moved.position, expected.position, rtol=0, atol=1e-11)
    np.testing.assert_allclose(moved.heading, expected.heading, rtol=0, atol=1e-12)


def test_alignment_is_the_least_squares_optimum(pair):
    poses, truth = pair
    motion = alignment_motion(poses, truth, "se2")

    def cost(g):
        return rmse(absolute_errors(geo.compose(g, poses), truth).position)

    for nudge in np.concatenate([np.eye(3), -np.eye(3)]) * 1e-3:
        assert cost(motion + nudge) > cost(motion)


def test_heading_errors_are_wrapped():
    errors = absolute_errors([[0, 0, 3.1]], [[0, 0, -3.1]])
    assert errors.heading[0] == pytest.approx(2 * np.pi - 6.2, abs=1e-14)


def test_poses_that_are_not_finite_do_not_spoil_the_alignment(pair):
    poses, truth = (x.copy() for x in pair)
    expected = alignment_motion(poses[5:], truth[5:], "se2")
    poses[:5] = np.nan
    np.testing.assert_allclose(alignment_motion(poses, truth, "se2"), expected, atol=1e-12)


@pytest.fixture
def three(pair):
    """A dataset of three robots on the same errors as `pair`, and the estimate of their poses."""
    poses, truth = pair
    starts = np.array([[0.0, 0.0, 0.0], [80.0, -20.0, 1.0], [5.0, 60.0, -2.0]])
    motion = MotionModel("odometry", covariance=np.eye(3))
    dataset = Dataset(
        "three",
        tuple(Robot(motion, np.zeros((200, 3)), truth=geo.compose(s, truth)) for s in starts),
        np.arange(201.0),
        (),
        Observations([], np.empty((0, 2))),
    )
    return dataset, Trajectory(np.stack([geo.compose(s, poses) for s in starts]))


def test_robots_share_one_alignment_which_is_that_of_all_their_positions(three):
    dataset, series = three
    motion = frame_motion(dataset, series, "se2")
    truths = np.concatenate([robot.truth for robot in dataset.robots])

    def cost(g):
        return rmse(absolute_errors(geo.compose(g, series.poses.reshape(-1, 3)), truths).position)

    for nudge in np.concatenate([np.eye(3), -np.eye(3)]) * 1e-3:
        assert cost(motion + nudge) > cost(motion)
    np.testing.assert_array_equal(frame_motion(dataset, series), np.zeros(3))


def test_robots_without_truth_take_no_part_in_the_alignment(three):
    dataset, series = three
    first, second, third = dataset.robots
    known = replace(dataset, robots=(replace(first, truth=None), second, third))
    motion = alignment_motion(
        series.poses[1:].reshape(-1, 3), np.concatenate([second.truth, third.truth]), "se2"
    )
    np.testing.assert_array_equal(frame_motion(known, series, "se2"), motion)
    unknown = replace(dataset, robots=tuple(replace(r, truth=None) for r in dataset.robots))
    np.testing.assert_array_equal(frame_motion(unknown, series, "se2"), np.zeros(3))
    with pytest.raises(UnknownNameError, match="'sim3'"):
        frame_motion(unknown, series, "sim3")


def test_a_single_robot_is_aligned_as_ever(three, pair):
    dataset, series = three
    alone = replace(dataset, robots=dataset.robots[:1])
    poses, truth = pair
    expected = alignment_motion(poses, truth, "se2")
    np.testing.assert_allclose(frame_motion(alone, series.of_robot(0), "se2"), expected, atol=1e-12)


def test_bad_arguments_are_named():
    poses = np.zeros((3, 3))
    with pytest.raises(UnknownNameError, match="'sim3'"):
        alignment_motion(poses, poses, "sim3")
    for distance in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="distance"):
            relative_errors(poses, poses, distance)
    with pytest.raises(InputError, match=r"\(2, 3\)"):
        absolute_errors(poses[:2], poses)
