"""Graph files: each format by hand, our own exports, those that come with gtsam, and damage."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import fuzz
import gtsam
import numpy as np
import pytest
from problems import camera, problem, scanner, truths

import ekfslam
from baselines.batch import GtsamBatch
from baselines.landmark_graph import Association, LandmarkGraph
from ekfslam import geometry as geo
from ekfslam.datasets import graph_files
from ekfslam.errors import FileFormatError, InputError, UnknownNameError
from ekfslam.export import write_g2o
from ekfslam.filters.ekf import Ekf
from ekfslam.observations import Observations

WHEEL = Path(gtsam.__file__).parent / "Data"

G2O = """\
# a drive of two steps
VERTEX_SE2 0 1 2 0.5
VERTEX_SE2 1 2 2 0.7
VERTEX_SE2 2 3 2 0.9
VERTEX_XY 7 4 4  # a tree
VERTEX_XY 8 5 5
FIX 0
EDGE_SE2 0 1 1 0.1 0.8 500 20 10 400 -30 900
EDGE_SE2 1 2 0.9 -0.1 -1.2 500 20 10 400 -30 900
EDGE_SE2_XY 0 7 2 1 100 10 50
EDGE_SE2_XY 2 8 1 -1 100 10 50
EDGE_BEARING_SE2_XY 1 7 0.3 400
EDGE_RANGE_SE2_XY 1 8 2.5 25
"""
TORO = """\
VERTEX2 0 0 0 0
VERTEX2 1 1 0 0
VERTEX2 2 2 0 0
EDGE2 0 1 1 0.1 0.8 500 20 400 900 10 -30
EDGE2 1 2 0.9 -0.1 -1.2 500 20 400 900 10 -30
LANDMARK 0 7 2 1 100 10 50
LANDMARK 2 8 1 -1 100 10 50
BR 1 9 0.3 2.5 0.05 0.2
"""
PYFG = """\
VERTEX_SE2 0.5 A0 1 2 0.5
VERTEX_SE2 1.5 A1 2 2 0.7
VERTEX_SE2 2.5 A2 3 2 0.9
VERTEX_SE2 0.5 C0 0 0 0
VERTEX_SE2 1.5 C1 1 0 0
VERTEX_SE2 2.5 C2 2 0 0
VERTEX_XY L7 4 4
VERTEX_XY L8 5 5
VERTEX_SE2:PRIOR 0.5 A0 1.1 2.1 0.6 0.04 0.01 0.002 0.03 -0.001 0.02
EDGE_SE2 1.5 A0 A1 1 0.1 0.8 0.04 0.01 0.002 0.03 -0.001 0.02
EDGE_SE2 2.5 A1 A2 0.9 -0.1 -1.2 0.04 0.01 0.002 0.03 -0.001 0.02
EDGE_SE2 1.5 C0 C1 1 0 0 0.04 0 0 0.03 0 0.02
EDGE_SE2 2.5 C1 C2 1 0 0 0.04 0 0 0.03 0 0.02
EDGE_SE2_XY 0.6 A0 L7 2 1 0.01 0.001 0.02
EDGE_RANGE 2.5 C2 L8 2.5 0.04
EDGE_BEARING 1.5 C1 L7 0.3 0.0025
"""
ISAM = """\
EDGE2 0 1 1 0.1 0.8 50 2 1 40 -3 90
EDGE2 1 2 0.9 -0.1 -1.2 50 2 1 40 -3 90
LANDMARK 0 0 2 1 10 1 5
LANDMARK 2 1 1 -1 10 1 5
"""
CONTROLS = [[1, 0.1, 0.8], [0.9, -0.1, -1.2]]
TEXTS = {"small.g2o": G2O, "small.graph": TORO, "small.pyfg": PYFG, "small.txt": ISAM}


def matrix(*upper):
    """A symmetric matrix from its upper triangle, row by row."""
    size = {3: 2, 6: 3}[len(upper)]
    full = np.zeros((size, size))
    full[np.triu_indices(size)] = upper
    return full + np.triu(full, 1).T


def turned(covariance, angle):
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return R @ covariance @ R.T


INFORMATION = np.linalg.inv(matrix(500, 20, 10, 400, -30, 900))
SEEN = np.linalg.inv(matrix(100, 10, 50))


@pytest.fixture
def write(tmp_path):
    """Writes a file and returns its path."""

    def written(text, name):
        path = tmp_path / name
        path.write_text(text)
        return path

    return written


# By hand ------------------------------------------------------------------------------------------


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


def test_g2o(write):
    data = graph_files.load(write(G2O, "small.g2o"))
    assert data.name == "small"
    np.testing.assert_array_equal(data.robot.controls, CONTROLS)
    np.testing.assert_array_equal(data.prior.mean, [1, 2, 0.5])
    np.testing.assert_array_equal(data.prior.covariance, 0)
    close(data.robot.increments.covariances, [turned(INFORMATION, move[2]) for move in CONTROLS])
    assert [sensor.kind for sensor in data.sensors] == ["xy", "bearing", "range"]
    o, seen = data.observations, data.sightings
    np.testing.assert_array_equal(o.step, [0, 1, 1, 2])
    np.testing.assert_array_equal(o.landmark, [7, 7, 8, 8])
    np.testing.assert_array_equal(o.values, [[2, 1], [0.3, 0], [2.5, 0], [1, -1]])
    close(seen.covariance[[0, 3]], [SEEN, SEEN])
    close(seen.covariance[1:3, 0, 0], [1 / 400, 1 / 25])
    assert data.truth is None
    true = graph_files.load(write(G2O, "small.g2o"), truth=True)
    np.testing.assert_array_equal(true.truth, [[1, 2, 0.5], [2, 2, 0.7], [3, 2, 0.9]])
    np.testing.assert_array_equal(true.true_map.positions, [[4, 4], [5, 5]])


def test_toro_has_another_order(write):
    data = graph_files.load(write(TORO, "small.graph"))
    np.testing.assert_array_equal(data.robot.controls, CONTROLS)
    close(data.robot.increments.covariances, [turned(INFORMATION, move[2]) for move in CONTROLS])
    assert [sensor.kind for sensor in data.sensors] == ["xy", "range-bearing"]
    np.testing.assert_array_equal(data.observations.values, [[2, 1], [2.5, 0.3], [1, -1]])
    close(data.sightings.covariance[1], np.diag([0.2**2, 0.05**2]))
    close(data.sightings.covariance[0], SEEN)


def test_pyfg_has_times_and_robots(write):
    data = graph_files.load(write(PYFG, "small.pyfg"))
    np.testing.assert_array_equal(data.times, [0.5, 1.5, 2.5])
    one, two = data.robots
    np.testing.assert_array_equal(one.controls, CONTROLS)
    noise = matrix(0.04, 0.01, 0.002, 0.03, -0.001, 0.02)
    close(one.increments.covariances, [turned(noise, move[2]) for move in CONTROLS])
    close(two.increments.covariances, [np.diag([0.04, 0.03, 0.02])] * 2)
    np.testing.assert_array_equal(one.prior.mean, [1.1, 2.1, 0.6])
    close(one.prior.covariance, turned(noise, 0.6))
    np.testing.assert_array_equal(two.prior.covariance, 0)
    assert "how well pose C0 is known" in data.notes[-1]
    o = data.observations
    np.testing.assert_array_equal(o.robot, [0, 1, 1])
    np.testing.assert_array_equal(o.landmark, [7, 7, 8])
    np.testing.assert_array_equal(o.time, [0.6, 1.5, 2.5])
    assert [data.sensors[i].kind for i in o.sensor] == ["xy", "bearing", "range"]
    close(data.sightings.covariance[0], matrix(0.01, 0.001, 0.02))
    close(data.sightings.covariance[1:, 0, 0], [0.0025, 0.04])


def test_isam_has_square_roots_and_two_spaces_of_numbers(write):
    data = graph_files.load(write(ISAM, "small.txt"))
    R = np.array([[50, 2, 1], [0, 40, -3], [0, 0, 90.0]])
    close(data.robot.increments.covariances, [np.linalg.inv(R.T @ R)] * 2)
    assert data.robot.covariance is None
    R = np.array([[10, 1], [0, 5.0]])
    close(data.sightings.covariance, [np.linalg.inv(R.T @ R)] * 2)
    np.testing.assert_array_equal(data.observations.landmark, [0, 1])


def test_the_numbers_of_the_noise_may_be_said_to_be_others(write):
    path = write(ISAM, "small.txt")
    data = graph_files.load(path, noise="information")
    close(data.robot.increments.covariances[0], np.linalg.inv(matrix(50, 2, 1, 40, -3, 90)))
    path = write(TORO.replace("900", "9"), "small.graph")
    data = graph_files.load(path, noise="covariance")
    close(data.sightings.covariance[0], matrix(100, 10, 50))
    with pytest.raises(InputError, match="noise must be one of covariance, information, square"):
        graph_files.load(path, noise="sigmas")


def test_a_sensor_may_stand_off_the_robot(write):
    text = G2O + "PARAMS_SE2OFFSET 3 0.5 -0.2 1.5\nEDGE_SE2_POINTXY_OFFSET 1 8 3 2 2 100 10 50\n"
    data = graph_files.load(write(text, "small.g2o"))
    mounted = data.sensors[-1]
    np.testing.assert_array_equal(mounted.mount, [0.5, -0.2, 1.5])
    assert mounted.kind == "xy"
    row = int(np.flatnonzero(data.observations.sensor == len(data.sensors) - 1)[0])
    assert (data.observations.step[row], data.observations.landmark[row]) == (1, 8)
    for broken, said in (
        (text.replace("PARAMS_SE2OFFSET 3", "PARAMS_SE2OFFSET 4"), "line 15: an offset of which"),
        (text + "PARAMS_SE2OFFSET 3 0 0 0\n", "line 16: an offset that is there already"),
    ):
        with pytest.raises(FileFormatError, match=said):
            graph_files.load(write(broken, "small.g2o"))


def test_a_prior_of_g2o(write):
    text = G2O.replace("FIX 0", "EDGE_PRIOR_SE2 0 1.1 2.1 0.6 500 20 10 400 -30 900")
    data = graph_files.load(write(text, "small.g2o"))
    np.testing.assert_array_equal(data.prior.mean, [1.1, 2.1, 0.6])
    close(data.prior.covariance, turned(INFORMATION, 0.6))


@pytest.mark.parametrize(("name", "text"), TEXTS.items())
def test_line_ends_blank_lines_and_compression_do_not_matter(tmp_path, write, name, text):
    plain = graph_files.load(write(text, name))
    for content in (
        text.replace("\n", "\r\n"),
        text.replace("\n", "\r"),
        text.replace("\n", "\n\n"),
    ):
        path = tmp_path / name
        path.write_bytes(content.encode())
        packed = tmp_path / f"{name}.gz"
        packed.write_bytes(gzip.compress(content.encode()))
        for data in (graph_files.load(path), graph_files.load(packed)):
            assert data.name == "small"
            np.testing.assert_array_equal(data.sightings.covariance, plain.sightings.covariance)
            np.testing.assert_array_equal(data.observations.values, plain.observations.values)


def test_options_may_follow_the_name_of_a_graph(write):
    path = write(G2O + "EDGE_SE2 2 0 1 1 1 5 0 0 5 0 5\n", "small.g2o")
    data = ekfslam.load(f"{path}(unsupported=drop, truth=True)")
    assert data.poses == len(data.truth) == 3
    with pytest.raises(InputError, match=r"small\.g2o: .*'loops'"):
        ekfslam.load(f"{path}(loops=drop)")


def test_graphs_are_opened_by_their_names(write):
    assert ekfslam.load(write(G2O, "small.g2o")).poses == 3
    assert ekfslam.load(str(write(PYFG, "small.pyfg"))).poses == 3
    with pytest.raises(FileFormatError, match="no such file"):
        ekfslam.load("none.g2o")
    with pytest.raises(UnknownNameError):
        ekfslam.load("none.toro")
    with pytest.raises(InputError, match=r"ends in \.g2o, \.graph, \.pyfg, \.txt"):
        graph_files.load("none.toro")


# Damage -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "line", "said"),
    [
        ("small.g2o", "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1", "line 14: unknown.*3-D"),
        ("small.g2o", "VERTEX_TRACKXYZ 9 1 1 1", "line 14: unknown record.*3-D"),
        ("small.g2o", "EDGE_LINE 0 1 1", "line 14: unknown record 'EDGE_LINE'; known are VERTEX"),
        ("small.g2o", "EDGE_SE2 2 0 1 1 1 5 0 0 5 0 5", "line 14: a loop closure.*=drop"),
        ("small.g2o", "EDGE_SE2 2 3 1 1 1 5 0 0 5 0 5", "line 14: of pose 2 or pose 3 there is no"),
        ("small.g2o", "VERTEX_SE2 3 0 0 0", "line 14: pose 3 has no odometry"),
        ("small.g2o", "VERTEX_XY 2 0 0", "line 14: vertex 2 is there already"),
        ("small.g2o", "EDGE_SE2_XY 1 9 0 0 1 0 1", "line 14: of landmark 9 there is no vertex"),
        ("small.graph", "LANDMARK 0 7 2 1 9 0 9", "line 9: landmark 7 is seen twice from pose 0"),
        ("small.g2o", "EDGE_SE2_XY 1 8 0 0 1 3 1", "line 14: the information is not positive def"),
        ("small.g2o", "EDGE_SE2_XY 1 8 0 0 0 0 1", "line 14: the information is not positive def"),
        ("small.g2o", "EDGE_SE2_XY 1 8 0 0 1 0", "line 14: EDGE_SE2_XY needs 7 numbers, got 6"),
        ("small.g2o", "EDGE_SE2_XY 1 8 0 nan 1 0 1", "line 14: y of EDGE_SE2_XY is nan"),
        ("small.g2o", "EDGE_SE2_XY 1 8 0 2e9 1 0 1", r"line 14: y is beyond 1e\+08 m"),
        ("small.g2o", "EDGE_SE2_XY 1 eight 0 0 1 0 1", "line 14: ids of EDGE_SE2_XY must be whole"),
        ("small.g2o", "FIX", "line 14: FIX needs 1 numbers, got 0"),
        ("small.g2o", "FIX 0 12", "line 14: there is no 12 to fix"),
        ("small.graph", "EQUIV 0 2", "line 9: poses that are one; a dataset"),
        ("small.graph", "BR 2 9 0.3 2.5 0 0.2", "line 9: a sigma that is none"),
        ("small.graph", "EDGE2 0 2 1 0 0 1 0 1 1 0 0", "line 9: a loop closure"),
        ("small.pyfg", "VERTEX_XY:PRIOR 0 L7 1 1 1 0 1", "line 17: a prior of a landmark; a"),
        ("small.pyfg", "EDGE_RANGE 0.5 A0 C0 3 0.1", "line 17: a sighting of a pose"),
        ("small.pyfg", "EDGE_SE2 0.5 A2 C0 1 0 0 1 0 0 1 0 1", "line 17: a loop closure"),
        ("small.pyfg", "EDGE_RANGE 0.5 A0 7 3 0.1", "line 17: ids of EDGE_RANGE must be a letter"),
        ("small.pyfg", "VERTEX_SE2 2.5 A3 0 0 0", "line 17: pose A3 has no odometry"),
        ("small.pyfg", "EDGE_RANGE 0.5 A0 L8 3 -1", "line 17: the covariance is not positive"),
        ("small.txt", "LANDMARK 2 0 1 -1 10 1 -5", "line 5: the square root .* no positive dia"),
        ("small.txt", "EDGE2 2 3 1 0 0 1e-12 0 0 1 0 1", "line 5: the square root"),
    ],
)  # fmt: skip
def test_a_line_that_cannot_be_used_is_named(write, name, line, said):
    path = write(TEXTS[name] + line + "\n", name)
    with pytest.raises(FileFormatError, match=said) as error:
        graph_files.load(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_lines_that_have_no_place_can_be_left_out(write):
    closed = G2O + "EDGE_SE2 2 0 1 1 1 5 0 0 5 0 5\nEDGE_SE2 0 2 1 1 1 5 0 0 5 0 5\n"
    data = graph_files.load(write(closed, "small.g2o"), unsupported="drop")
    np.testing.assert_array_equal(data.robot.controls, CONTROLS)
    assert data.notes[-1].startswith("2 lines were left out, first line 14: a loop closure")


def test_a_time_that_does_not_go_on_is_named(write):
    text = PYFG.replace("VERTEX_SE2 1.5 A1", "VERTEX_SE2 0.25 A1")
    with pytest.raises(FileFormatError, match=r"line 2: time 0\.25 of pose A1 does not come after"):
        graph_files.load(write(text, "small.pyfg"))
    text = PYFG.replace("VERTEX_SE2 1.5 C1", "VERTEX_SE2 1.25 C1")
    with pytest.raises(FileFormatError, match=r"line 5: time 1\.25 of pose C1.*other robots"):
        graph_files.load(write(text, "small.pyfg"))
    frozen = PYFG.replace("VERTEX_SE2 1.5", "VERTEX_SE2 0.5").replace("SE2 2.5 A2", "SE2 0.5 A2")
    frozen = frozen.replace("VERTEX_SE2 2.5 C2", "VERTEX_SE2 0.5 C2")
    np.testing.assert_array_equal(graph_files.load(write(frozen, "small.pyfg")).times, [0, 1, 2])


def lines_arrive(dataset, files):
    """As many motions and sightings as the file has lines of them, whatever its line ends."""
    ((name, content),) = files.items()
    tags = [line.split()[0] for line in content.decode().splitlines() if line.split()]
    motions = sum(tag in ("EDGE_SE2", "EDGE2", "ODOMETRY") for tag in tags)
    seen = sum(tag in graph_files.FORMATS[Path(name).suffix].sightings for tag in tags)
    assert sum(len(robot.controls) for robot in dataset.robots) == motions
    assert len(dataset.observations) == seen


@pytest.mark.parametrize(("name", "text"), TEXTS.items())
def test_random_damage_is_named_or_harmless(tmp_path, name, text):
    told = fuzz.check(
        lambda folder: graph_files.load(folder / name),
        tmp_path,
        {name: text.encode()},
        count=1000,
        seed=11,
        whole=lines_arrive,
        certain=["empty", "missing"],
    )
    assert told["refused"] > 300
    assert told["loaded"] > 100


# Our own exports ----------------------------------------------------------------------------------


def again(dataset, path):
    write_g2o(dataset, path)
    return graph_files.load(path)


def numbered(dataset):
    """The dataset with its landmarks numbered as the vertices of its export are."""
    o = dataset.observations
    ids, number = np.unique(o.landmark, return_inverse=True)
    first = len(dataset.robots) * dataset.poses
    return replace(dataset, observations=replace(o, landmark=first + number)), ids


@pytest.mark.parametrize("robots", [1, 3])
def test_an_export_of_points_loads_back_as_the_same_problem(tmp_path, robots):
    """Turns and correlated noise; a mounted sensor becomes one at the robot's origin."""
    data = problem(camera(0.4, -0.2, 0.7), robots=robots, known_start=True)
    back = again(data, tmp_path / "graph.g2o")
    assert len(back.robots) == robots
    for ours, theirs in zip(data.robots, back.robots, strict=True):
        np.testing.assert_array_equal(ours.controls, theirs.controls)
        np.testing.assert_allclose(ours.prior.mean, theirs.prior.mean, rtol=0, atol=1e-15)
        np.testing.assert_allclose(
            ours.increments.covariances, theirs.increments.covariances, rtol=1e-9, atol=1e-14
        )
    seen = data.observations
    points = geo.from_frame(data.sensors[0].mount, seen.values)
    order = np.lexsort([np.arange(len(seen)), seen.step])
    np.testing.assert_allclose(back.observations.values, points[order], rtol=0, atol=1e-14)
    named, _ = numbered(data)
    np.testing.assert_array_equal(back.observations.landmark, named.observations.landmark[order])
    np.testing.assert_array_equal(back.observations.robot, seen.robot[order])


def answers(dataset):
    """Final poses and map of the filter and of the smoother."""
    found = []
    for estimator in (Ekf(), GtsamBatch(Ekf(), marginals=False)):
        estimate = estimator.estimate(dataset)
        assert estimate.status == "ok", estimate.message
        poses = estimate.final_trajectory.poses
        found.append((poses, estimate.landmarks.positions[np.argsort(estimate.landmarks.ids)]))
    return found


def gaps(dataset, path):
    """Largest difference of the answers to a dataset and to its export, by estimator."""
    return np.array(
        [
            np.abs(np.append(geo.additive_error(mine[0], theirs[0]), mine[1] - theirs[1])).max()
            for mine, theirs in zip(answers(dataset), answers(again(dataset, path)), strict=True)
        ]
    )


@pytest.mark.parametrize("robots", [1, 2])
def test_estimators_give_the_same_answer_to_an_export_of_points(tmp_path, robots):
    """Round-off for the filter; for the smoother what its tolerance leaves (1e-5 in the error)."""
    data = problem(camera(), robots=robots, known_start=True)
    filtered, smoothed = gaps(data, tmp_path / "graph.g2o")
    assert filtered < 1e-9
    assert smoothed < 1e-5


def quiet(scale):
    """One drive whose noise, drawn and stated, is scaled."""
    data = problem(scanner(), known_start=True, noise=scale)
    robot = replace(data.robot, motion=data.robot.motion.scaled(scale))
    sensor = replace(data.sensors[0], covariance=scale**2 * data.sensors[0].covariance)
    return replace(data, robots=(robot,), sensors=(sensor,))


def test_an_export_of_ranges_and_bearings_answers_to_first_order(tmp_path):
    """The gap is of second order in the noise: a tenth of the noise, a hundredth of the gap."""
    whole, tenth = (gaps(quiet(scale), tmp_path / "graph.g2o") for scale in (0.1, 0.01))
    spread = np.abs(answers(quiet(0.1))[0][0] - truths(quiet(0.1))[0]).max()
    assert (whole < 0.3 * spread).all()
    assert (whole / tenth > 10**1.5).all()


def test_what_was_loaded_is_written_as_it_was(tmp_path):
    """Numbers of the second export are those of the first: nothing turns once more."""
    first, second = tmp_path / "first.g2o", tmp_path / "second.g2o"
    write_g2o(problem(scanner(0.4, -0.2, 0.7), camera(), robots=2, known_start=True), first)
    write_g2o(graph_files.load(first), second)

    def rows(path):
        lines = [line.partition("#")[0].split() for line in path.read_text().splitlines()]
        return [line[0] for line in lines], [np.array(line[1:], dtype=float) for line in lines]

    (tags, numbers), (tags_again, numbers_again) = rows(first), rows(second)
    assert sorted(tags) == sorted(tags_again)
    ours = sorted(zip(tags, (n.tolist() for n in numbers), strict=True))
    theirs = sorted(zip(tags_again, (n.tolist() for n in numbers_again), strict=True))
    for (tag, mine), (_, back) in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, back, rtol=1e-9, atol=1e-7, err_msg=tag)


def test_an_export_of_a_robot_at_rest_loads_back(tmp_path):
    """It sees the same thing in one step twice, and with the same outcome."""
    dataset = problem(camera(), known_start=True)
    seen = dataset.observations
    rows = np.repeat(np.arange(len(seen)), np.where(np.arange(len(seen)) < 2, 2, 1))
    times = seen.step[rows] + 0.1 * (np.diff(rows, prepend=-1) == 0)
    of_rows = {name: getattr(seen, name)[rows] for name in ("step", "values", "landmark", "sensor")}
    twice = replace(dataset, observations=Observations(**of_rows, time=times), true_landmark=None)
    write_g2o(twice, tmp_path / "twice.g2o")
    loaded = graph_files.load(tmp_path / "twice.g2o")
    assert len(loaded.observations) == len(seen) + 2
    assert loaded.notes[1].startswith("2 sightings repeat another")
    assert len(loaded.sensors) == 2


def test_an_export_without_sightings_loads_back(tmp_path):
    data = problem(camera(), known_start=True)
    o = data.observations
    bare = replace(data, observations=type(o)(step=[], values=np.zeros((0, 2))), true_landmark=None)
    back = again(bare, tmp_path / "graph.g2o")
    assert len(back.observations) == 0
    np.testing.assert_array_equal(back.robot.controls, data.robot.controls)


def test_gtsam_reads_the_same_motions(tmp_path):
    """An independent reader of the file makes the factors that our graph of the dataset has."""
    path = tmp_path / "graph.g2o"
    data = again(problem(camera(), known_start=True), path)
    theirs, _ = gtsam.readG2o(str(path))
    ours = LandmarkGraph(data, Association.known(data)).graph()
    motions = [ours.at(i) for i in range(ours.size())]
    motions = [factor for factor in motions if isinstance(factor, gtsam.BetweenFactorPose2)]
    assert theirs.size() == len(motions) == data.poses - 1
    for k, mine in enumerate(motions):
        edge = theirs.at(k)
        np.testing.assert_allclose(edge.measured().matrix(), mine.measured().matrix(), atol=1e-12)
        R, Q = edge.noiseModel().R(), mine.noiseModel().R()
        np.testing.assert_allclose(R.T @ R, Q.T @ Q, rtol=1e-8, atol=1e-5)


# Files that come with gtsam -----------------------------------------------------------------------


def test_ranges_of_an_underwater_vehicle():
    data = graph_files.load(WHEEL / "goats_16.pyfg", truth=True)
    assert data.poses == 201
    assert [sensor.kind for sensor in data.sensors] == ["range"]
    assert len(data.observations) == 572
    np.testing.assert_array_equal(data.true_map.ids, [0, 1, 2, 3])
    np.testing.assert_array_equal(data.times, np.arange(201))
    drive = geo.integrate(data.prior.mean, data.robot.controls)
    off = np.linalg.norm(drive[:, :2] - data.truth[:, :2], axis=1)
    assert off.max() < 0.15 * np.linalg.norm(data.robot.controls[:, :2], axis=1).sum()


def test_bearings_and_ranges_of_an_example():
    data = graph_files.load(WHEEL / "example.graph")
    assert (data.poses, len(data.observations)) == (95, 422)
    theirs, _ = gtsam.load2D(str(WHEEL / "example.graph"))
    factors = [theirs.at(i) for i in range(theirs.size())]
    moves = [f.measured() for f in factors if isinstance(f, gtsam.BetweenFactorPose2)]
    np.testing.assert_allclose(
        data.robot.controls, [[m.x(), m.y(), m.theta()] for m in moves], rtol=0, atol=1e-12
    )
    seen = [f.measured() for f in factors if isinstance(f, gtsam.BearingRangeFactor2D)]
    seen = sorted((m.range(), m.bearing().theta()) for m in seen)
    ours = sorted(map(tuple, data.observations.values.tolist()))
    np.testing.assert_allclose(ours, seen, rtol=0, atol=1e-12)


def test_motions_that_are_written_backwards():
    """The odometry of w100 leads from each pose to the one before."""
    with pytest.raises(FileFormatError, match="line 120: a loop closure"):
        graph_files.load(WHEEL / "w100.graph")
    data = graph_files.load(WHEEL / "w100.graph", unsupported="drop")
    given = [line.split() for line in (WHEEL / "w100.graph").read_text().splitlines()]
    pairs = [(int(w[1]), int(w[2])) for w in given if w[0] == "EDGE2"]
    next_ = sum(abs(a - b) == 1 for a, b in pairs)
    assert data.poses == 100
    assert next_ == 99
    equal = sum(w[0] == "EQUIV" for w in given)
    assert data.notes[-1].startswith(f"{len(pairs) - next_ + equal} lines were left out")
    first = next(w for w in given if w[:3] == ["EDGE2", "1", "0"])
    np.testing.assert_allclose(
        data.robot.controls[0], geo.inverse(np.array(first[3:6], dtype=float)), rtol=0, atol=1e-12
    )
    # Dead reckoning is near the first vertices, and would be the other way if it were not turned.
    places = np.array([w[2:4] for w in given if w[0] == "VERTEX2"], dtype=float)
    drive = geo.integrate(data.prior.mean, data.robot.controls)
    assert np.linalg.norm(drive[:10, :2] - places[:10], axis=1).max() < 0.5
