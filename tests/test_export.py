"""Files that other programs read: g2o and TUM, held against what was written into them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from baselines.landmark_graph import Association, LandmarkGraph
from ekfslam.dataset import Dataset, Observations, Prior, Robot
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.estimates import Trajectory
from ekfslam.export import write_g2o, write_tum
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

MOTION = [[4e-4, 1e-4, 2e-5], [1e-4, 9e-4, -3e-5], [2e-5, -3e-5, 1e-4]]
NOISE = [[0.04, 0.006], [0.006, 0.01]]
MOUNT = [0.4, -0.2, 0.7]


def small(kind="range-bearing", **changes):
    """Four poses that turn, two landmarks with gaps in their numbers, a mounted sensor."""
    dataset = Dataset(
        name="small",
        robots=(
            Robot(
                MotionModel("odometry", MOTION),
                [[1.0, 0.1, 0.8], [0.5, -0.2, -1.9], [0.7, 0.0, 3.0]],
                Prior([2.0, -1.0, 2.5]),
            ),
        ),
        times=[0.0, 0.5, 1.0, 2.0],
        sensors=(Sensor(kind, NOISE, mount=MOUNT),),
        observations=Observations(
            step=[0, 1, 1, 3],
            values=[[2.0, 0.3], [1.5, -1.2], [3.0, 2.0], [2.5, -0.4]],
            landmark=[17, 17, 4, 4],
        ),
    )
    return replace(dataset, **changes)


def read(path):
    """What a g2o file says: rows of numbers by tag, without what follows a #."""
    rows: dict[str, list[list[float]]] = {}
    for line in Path(path).read_text().splitlines():
        tag, *words = line.partition("#")[0].split()
        rows.setdefault(tag, []).append([float(word) for word in words])
    return rows


def symmetric(upper, size):
    """A matrix from its upper triangle, row by row."""
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = upper
    return matrix + np.triu(matrix, 1).T


def turn(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def chained(a, b):
    """Pose b of frame a, in the world."""
    return np.array([*(a[:2] + turn(a[2]) @ b[:2]), a[2] + b[2]])


@pytest.fixture
def path(tmp_path):
    return tmp_path / "graph.g2o"


# g2o --------------------------------------------------------------------------------------------


def test_the_vertices_are_where_the_odometry_and_the_first_sightings_put_them(path):
    data = small()
    write_g2o(data, path)
    rows = read(path)
    poses = [data.prior.mean]
    for control in data.robot.controls:
        poses.append(chained(poses[-1], control))
    written = np.array(rows["VERTEX_SE2"])
    np.testing.assert_array_equal(written[:, 0], range(4))
    np.testing.assert_allclose(written[:, 1:3], np.array(poses)[:, :2], atol=1e-14)
    turned = np.exp(1j * written[:, 3]) - np.exp(1j * np.array(poses)[:, 2])
    np.testing.assert_allclose(turned, 0, atol=1e-14)
    # Landmarks are numbered after the poses in order of identity: 4, first seen in row 2 from
    # pose 1, then 17, first seen in row 0 from pose 0.
    expected = []
    for pose, (r, b) in ((poses[1], (3.0, 2.0)), (poses[0], (2.0, 0.3))):
        eye = chained(pose, MOUNT)
        expected.append(eye[:2] + r * np.array([np.cos(eye[2] + b), np.sin(eye[2] + b)]))
    np.testing.assert_allclose(np.array(rows["VERTEX_XY"])[:, 1:], expected, atol=1e-14)
    np.testing.assert_array_equal(np.array(rows["VERTEX_XY"])[:, 0], [4, 5])
    assert rows["FIX"] == [[0.0]]


def test_motions_carry_their_noise_in_the_frame_of_the_second_pose(path):
    data = small()
    write_g2o(data, path)
    for k, row in enumerate(read(path)["EDGE_SE2"]):
        control = data.robot.controls[k]
        assert row[:2] == [k, k + 1]
        np.testing.assert_array_equal(row[2:5], control)
        back = np.eye(3)
        back[:2, :2] = turn(control[2]).T
        information = np.linalg.inv(back @ MOTION @ back.T)
        np.testing.assert_allclose(symmetric(row[5:], 3), information, rtol=1e-10, atol=1e-9)


def edges(path):
    """Rows of EDGE_SE2_XY as (pose, landmark, point, information)."""
    for row in read(path)["EDGE_SE2_XY"]:
        yield int(row[0]), int(row[1]), np.array(row[2:4]), symmetric(row[4:], 2)


def test_an_xy_sensor_is_written_exactly(path, rng):
    """The squared residual is the same for any pose and landmark, however far off."""
    data = small("xy")
    write_g2o(data, path)
    found = list(edges(path))
    assert [(k, j) for k, j, _, _ in found] == [(0, 5), (1, 5), (1, 4), (3, 4)]
    for row, (_, _, point, information) in enumerate(found):
        pose, landmark = rng.normal(size=3), rng.normal(scale=5, size=2)
        residual = point - turn(pose[2]).T @ (landmark - pose[:2])
        expected = data.sensors[0].observe(pose, landmark)[0]
        mismatch = data.observations.values[row] - expected
        np.testing.assert_allclose(
            residual @ information @ residual,
            mismatch @ np.linalg.inv(NOISE) @ mismatch,
            rtol=1e-11,
        )


def test_a_range_bearing_sensor_is_written_to_first_order(path, rng):
    """Half as far off, the squared residuals differ by half as much of themselves."""
    data = small()
    write_g2o(data, path)
    sensor = data.sensors[0]
    for row, (_, _, point, information) in enumerate(edges(path)):
        pose, aside = rng.normal(size=3), rng.normal(size=2)
        errors = []
        for size in (2e-4, 1e-4):
            offset = size * aside
            landmark = pose[:2] + turn(pose[2]) @ (point + offset)
            mismatch = sensor.difference(
                data.observations.values[row], sensor.observe(pose, landmark)[0]
            )
            exact = mismatch @ np.linalg.inv(NOISE) @ mismatch
            errors.append(abs(offset @ information @ offset / exact - 1))
        assert errors[0] < 2e-3
        assert errors[1] == pytest.approx(errors[0] / 2, rel=0.02)


def test_noise_given_per_row_and_noise_that_grows_with_range(path):
    noises = np.array([np.diag([0.01 * (k + 1), 0.02]) for k in range(4)])
    write_g2o(
        replace(small("xy"), observations=replace(small("xy").observations, covariance=noises)),
        path,
    )
    for noise, (_, _, _, information) in zip(noises, edges(path), strict=True):
        mounted = turn(MOUNT[2]) @ np.linalg.inv(noise) @ turn(MOUNT[2]).T
        np.testing.assert_allclose(information, mounted, rtol=1e-12, atol=1e-11)
    growing = Sensor("range-bearing", np.diag([0.01, 1e-4]), range_growth=0.1)
    write_g2o(small(sensors=(growing,)), path)
    for (r, _), (_, _, point, information) in zip(
        small().observations.values, edges(path), strict=True
    ):
        along = point / np.linalg.norm(point)
        variance = along @ np.linalg.inv(information) @ along
        assert variance == pytest.approx(0.01 + (0.1 * r) ** 2, rel=1e-12)


def test_gtsam_reads_the_graph_that_the_baselines_solve(path):
    data = small(sensors=(Sensor("range-bearing", NOISE),))
    write_g2o(data, path)
    graph, values = gtsam.readG2o(str(path))
    ours = LandmarkGraph(data, Association.known(data)).graph()
    ours = [ours.at(i) for i in range(ours.size())]
    motions = [factor for factor in ours if isinstance(factor, gtsam.BetweenFactorPose2)]
    assert graph.size() == len(motions) == 3  # gtsam has no factor for EDGE_SE2_XY
    for i, motion in enumerate(motions):
        edge = graph.at(i)
        assert list(edge.keys()) == [i, i + 1]
        np.testing.assert_allclose(edge.measured().matrix(), motion.measured().matrix(), atol=1e-14)
        theirs, mine = edge.noiseModel().R(), motion.noiseModel().R()
        np.testing.assert_allclose(theirs.T @ theirs, mine.T @ mine, rtol=1e-9, atol=1e-6)
    vertices = {int(row[0]): row[1:] for row in read(path)["VERTEX_SE2"]}
    for k, pose in vertices.items():
        at = values.atPose2(k)
        np.testing.assert_allclose([at.x(), at.y()], pose[:2], atol=1e-12)
        assert np.exp(1j * at.theta()) == pytest.approx(np.exp(1j * pose[2]), abs=1e-12)
    for row in read(path)["VERTEX_XY"]:
        point = values.atPoint2(gtsam.symbol("l", int(row[0])))
        np.testing.assert_allclose(point, row[1:], atol=1e-12)


def test_a_run_without_observations(path):
    none = Observations(step=[], values=np.zeros((0, 2)))
    write_g2o(small(observations=none), path)
    assert {tag: len(rows) for tag, rows in read(path).items()} == {
        "VERTEX_SE2": 4,
        "FIX": 1,
        "EDGE_SE2": 3,
    }


def team(**changes):
    """Two robots that see the same two landmarks, each with a sensor of its own."""
    one = small().robot
    other = replace(
        one, controls=one.controls * [1, -1, -0.5], prior=Prior([-3.0, 4.0, 0.3]), name="other"
    )
    seen = small().observations
    return small(
        robots=(one, other),
        sensors=(Sensor("range-bearing", NOISE, mount=MOUNT), Sensor("xy", NOISE)),
        observations=replace(seen, robot=[0, 1, 1, 0], sensor=[0, 1, 1, 0]),
        **changes,
    )


def test_each_robot_has_vertices_of_its_own_and_they_share_the_landmarks(path):
    """The graph of both is the graphs of each, numbered on."""
    data = team()
    write_g2o(data, path)
    both, edges_of_both = read(path), list(edges(path))
    assert [row[0] for row in both["VERTEX_SE2"]] == list(range(8))
    assert [row[0] for row in both["VERTEX_XY"]] == [8, 9]
    assert both["FIX"] == [[0.0], [4.0]]
    assert len(both["EDGE_SE2"]) == 6
    for index, robot in enumerate(data.robots):
        mine = data.observations.robot == index
        seen = data.observations
        write_g2o(
            replace(
                data,
                robots=(robot,),
                observations=Observations(
                    seen.step[mine], seen.values[mine], seen.landmark[mine], seen.sensor[mine]
                ),
            ),
            path,
        )
        single, first = read(path), 4 * index
        for k in range(4):
            assert both["VERTEX_SE2"][first + k] == [first + k, *single["VERTEX_SE2"][k][1:]]
        for k, row in enumerate(single["EDGE_SE2"]):
            assert both["EDGE_SE2"][3 * index + k] == [row[0] + first, row[1] + first, *row[2:]]
        expected = [edges_of_both[row] for row in np.flatnonzero(mine)]
        for (k, j, point, information), other in zip(edges(path), expected, strict=True):
            assert (k + first, j - 4 + 8) == other[:2]
            np.testing.assert_array_equal(point, other[2])
            np.testing.assert_array_equal(information, other[3])
    # Landmark 4 is first seen by the second robot, at its second pose; landmark 17 by the first.
    other = data.robots[1]
    pose = chained(other.prior.mean, other.controls[0])
    seen = pose[:2] + turn(pose[2]) @ data.observations.values[2]
    np.testing.assert_allclose(both["VERTEX_XY"][0][1:], seen, atol=1e-14)
    write_g2o(small(), path)
    assert both["VERTEX_XY"][1][1:] == read(path)["VERTEX_XY"][1][1:]


def test_what_g2o_has_no_word_for_is_unsupported(path):
    seen = team().observations
    meeting = replace(seen, landmark=[17, 17, 4, -1], observed_robot=np.array([-1, -1, -1, 1]))
    with pytest.raises(UnsupportedError, match="small cannot be written as g2o: robots see robots"):
        write_g2o(replace(team(), observations=meeting), path)
    for kind in ("bearing", "range"):
        sensor = Sensor(kind, [[0.01]], name="half")
        alone = Observations([0, 1], [[0.5], [0.7]], [17, 17], sensor=[1, 1])
        data = small(sensors=(Sensor("xy", NOISE), sensor), observations=alone)
        with pytest.raises(UnsupportedError, match=f"a {kind} of half makes no point"):
            write_g2o(data, path)
        write_g2o(small(sensors=(*small().sensors, sensor)), path)  # it saw nothing
        path.unlink()
    assert list(path.parent.iterdir()) == []


def robot(**changes):
    return (replace(small().robot, **changes),)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"robots": robot(motion=MotionModel("odometry", np.diag([0.01, 0.0, 0.01])))},
            "odometry noise is singular",
        ),
        ({"sensors": (Sensor("xy", np.diag([0.01, 0.0])),)}, "observation noise is singular"),
        (
            {"observations": replace(small().observations, landmark=[17, 17, -1, 4])},
            "association is not known",
        ),
    ],
)
def test_what_g2o_cannot_say_is_refused(changes, message, path):
    with pytest.raises(InputError, match=message) as caught:
        write_g2o(small(**changes), path)
    assert "\n" not in str(caught.value)
    assert list(path.parent.iterdir()) == []


def test_a_failed_write_keeps_the_file_that_was_there(path, monkeypatch):
    path.write_text("precious")
    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(InputError, match="No space left"):
        write_g2o(small(), path)
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    assert path.read_text() == "precious"


def fail(*_):
    raise OSError(28, "No space left on device")


# TUM --------------------------------------------------------------------------------------------


def test_evo_reads_the_trajectory_without_loss(tmp_path, rng):
    from evo.tools.file_interface import read_tum_trajectory_file

    headings = np.array([-np.pi, -3.0, -1e-9, 0.0, 0.5, 2.0, 3.14159])
    poses = np.column_stack([rng.normal(scale=1e3, size=(7, 2)), headings])
    times = 1.6e9 + np.arange(7) / 3  # as recorded logs have them
    write_tum(Trajectory(poses), times, tmp_path / "run.tum")
    read_back = read_tum_trajectory_file(str(tmp_path / "run.tum"))
    np.testing.assert_array_equal(read_back.timestamps, times)
    np.testing.assert_array_equal(read_back.positions_xyz[:, :2], poses[:, :2])
    np.testing.assert_array_equal(read_back.positions_xyz[:, 2], 0.0)
    for pose, matrix in zip(poses, read_back.poses_se3, strict=True):
        np.testing.assert_allclose(matrix[:2, :2], turn(pose[2]), atol=1e-15)
        np.testing.assert_allclose(matrix[2, :3], [0, 0, 1], atol=1e-15)


def test_a_trajectory_needs_a_time_for_every_pose(tmp_path):
    with pytest.raises(InputError, match="times"):
        write_tum(Trajectory(np.zeros((4, 3))), np.arange(3.0), tmp_path / "run.tum")
    assert list(tmp_path.iterdir()) == []


def test_each_of_several_robots_has_a_file_of_its_own(tmp_path, rng):
    team = Trajectory(rng.normal(size=(2, 4, 3)))
    times, path = np.arange(4.0), tmp_path / "run.tum"
    for index in (0, 1):
        write_tum(team, times, path, robot=index)
        ours = path.read_bytes()
        write_tum(Trajectory(team.poses[index]), times, path)
        assert path.read_bytes() == ours
    path.unlink()
    with pytest.raises(InputError, match="one robot of 2; say which by `robot`"):
        write_tum(team, times, path)
    for trajectory, index in ((team, 2), (team, -1), (Trajectory(team.poses[0]), 1)):
        with pytest.raises(InputError, match=f"robot is {index}"):
            write_tum(trajectory, times, path, robot=index)
    assert list(tmp_path.iterdir()) == []
