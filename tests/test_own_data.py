"""Datasets as tables: what is written reads back to the last bit, and what is wrong is named."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from made import MOTION, make, pair
from numerics import assert_same_record
from numpy.testing import assert_array_equal

import ekfslam
from ekfslam.dataset import LandmarkMap, Prior, Robot
from ekfslam.errors import FileFormatError, InputError
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import load_scenario, scenarios

ODOMETRY = {"kind": "odometry", "sigmas": [0.1, 0.1, "1 deg"]}
LASER = {"name": "laser", "kind": "range-bearing", "sigmas": [0.1, "1 deg"]}
CAMERA = {"name": "camera", "kind": "bearing", "sigmas": ["1 deg"], "min_range": 0.5}


def here():
    """Scenarios whose worlds come with the package."""
    for name in scenarios():
        try:
            load_scenario(name)
        except FileFormatError:
            continue
        yield name


def both_ways(dataset, folder):
    """The dataset again, through frames and through files."""
    tables = ekfslam.to_tables(dataset)
    ekfslam.write_tables(dataset, folder)
    return ekfslam.from_tables(*tables[1:], **tables.header), ekfslam.load(folder)


# What is written reads back ---------------------------------------------------------------------


@pytest.mark.parametrize("name", list(here()))
def test_simulated_data_come_back_to_the_last_bit(name, tmp_path):
    dataset = ekfslam.simulate(name, seed=3)
    for again in both_ways(dataset, tmp_path / "tables"):
        assert_same_record(again, dataset)


@pytest.mark.parametrize(
    "name",
    ["victoria-park", "plaza2", "mrclam1", "lego", "car-park", "dlr", "victoria-park-raw"],
)
def test_recorded_data_come_back_to_the_last_bit(name, tmp_path, recorded_data):
    inside = name in ("victoria-park", "plaza2")  # of the gtsam package
    (ekfslam.load(name) if inside else recorded_data(name)).save(tmp_path / "run.npz")
    dataset = ekfslam.load(tmp_path / "run.npz")  # with Python's numbers
    for again in both_ways(dataset, tmp_path / "tables"):
        assert_same_record(again, dataset)


@pytest.mark.parametrize("name", ["park", "cloister-bearing", "team", "heavy-tails"])
def test_estimates_are_the_same_to_the_last_bit(name, tmp_path):
    dataset = ekfslam.simulate(name, seed=5)
    estimate = ekfslam.estimate(dataset, "ekf")
    for again in both_ways(dataset, tmp_path / "tables"):
        other = ekfslam.estimate(again, "ekf")
        assert_same_record(other.online, estimate.online)
        assert_same_record(other.landmarks, estimate.landmarks)


def test_every_field_and_column_comes_back(full_dataset, tmp_path):
    rows = len(full_dataset.robot.controls)
    noise = np.random.default_rng(1).normal(size=(rows, 2, 2)) / 10
    noise = noise @ np.swapaxes(noise, 1, 2)
    noise[0, 0, 1] *= 1 + 1e-12  # as far from symmetric as rounding makes it
    truth = full_dataset.truth.copy()
    truth[1], truth[2, 2] = np.nan, np.nan
    robot = replace(full_dataset.robot, covariance=noise, truth=truth, name='an "é", or so')
    laser = replace(full_dataset.sensors[0], name=" laser; 1")
    dataset = replace(
        full_dataset,
        robots=(robot,),
        sensors=(laser, full_dataset.sensors[1]),
        known_map=LandmarkMap([2**62, 9], [[-0.0, 5e-324], [1 / 3, 1e300]]),
        notes=("one, two", 'three "\n\tfour\\'),
    )
    for again in both_ways(dataset, tmp_path / "tables"):
        assert_same_record(again, dataset)


def test_robots_that_see_each_other_come_back(tmp_path):
    dataset = pair(covariance=[[[0.1, 0.0], [0.0, 0.2]], [[0.3, 0.01], [0.01, 0.2]]])
    for again in both_ways(dataset, tmp_path / "tables"):
        assert_same_record(again, dataset)


def test_a_run_without_motion_or_sightings_comes_back(tmp_path):
    for number, dataset in enumerate(
        (
            make(step=[], values=np.zeros((0, 2))),
            make(times=[4.0], step=[0]),
            make(sensors=(), step=[], values=np.zeros((0, 2))),
        )
    ):
        for again in both_ways(dataset, tmp_path / str(number)):
            assert_same_record(again, dataset)


def test_a_folder_is_not_written_over(tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(InputError, match="holds other files already"):
        ekfslam.write_tables(make(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_the_command_writes_a_folder_and_reads_it(tmp_path, run_command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_command("simulate", "cloister", "--out", "mine", "--seed", 4).status == 0
    assert_same_record(ekfslam.load("mine/"), ekfslam.simulate("cloister", seed=4))
    assert_same_record(ekfslam.load("mine/dataset.toml"), ekfslam.load(tmp_path / "mine"))
    run = run_command("compare", "mine/", "--estimators", "ekf")
    assert run.status == 0
    assert run.out.startswith("cloister")
    refused = run_command("simulate", "cloister", "--out", "mine.csv")
    assert refused.status == 2
    assert "a folder of tables has no ending" in refused.err


# What may be left out ---------------------------------------------------------------------------


def frames(**columns):
    """A table of two motions straight ahead, and one of sightings from the poses 0, 1 and 2."""
    controls = pd.DataFrame({"dx": [1.0, 1.0], "dy": 0.0, "dtheta": 0.0})
    seen = {"step": [0, 1, 2], "range": [3.0, 2.0, 1.0], "bearing": 0.0, "landmark": [4, 4, 4]}
    return controls, pd.DataFrame(seen | columns)


def build(controls=None, observations=None, **rest):
    """The dataset of such tables and a usual header, unless told otherwise."""
    usual, seen = frames()
    return ekfslam.from_tables(
        usual if controls is None else controls,
        seen if observations is None else observations,
        **{"motion": ODOMETRY, "sensors": [LASER]} | rest,
    )


def test_defaults_are_those_of_the_page():
    data = build()
    assert_array_equal(data.times, [0.0, 1.0, 2.0])
    assert_array_equal(data.prior.covariance, np.zeros((3, 3)))
    assert (data.truth, data.known_map, data.observations.covariance) == (None, None, None)
    assert data.observations.time is None
    assert_array_equal(data.robot.controls, [[1, 0, 0], [1, 0, 0]])


def test_times_are_the_sum_of_the_dt():
    controls = pd.DataFrame({"v": [1.0, 1.0], "omega": 0.0, "dt": [0.5, 0.25]})
    motion = {"kind": "velocity", "sigmas": [0.1, 0.1]}
    data = build(controls, motion=motion, start_time=3.0)
    assert_array_equal(data.times, [3.0, 3.5, 3.75])
    assert data.robot.motion.slip == 0.001
    bad = controls.assign(dt=[0.5, 0.0])
    with pytest.raises(InputError, match="controls, row 1, column dt: is not positive"):
        build(bad, motion=motion)


def test_models_may_be_objects_or_mappings():
    of_tables = build(prior={"mean": (1, 2, "90 deg"), "sigmas": np.array([0.1, 0.1, 0.2])})
    motion = ekfslam.MotionModel("odometry", np.diag([0.1, 0.1, np.deg2rad(1)]) ** 2)
    sensor = Sensor("range-bearing", np.diag([0.1, np.deg2rad(1)]) ** 2, name="laser")
    prior = Prior([1, 2, np.pi / 2], np.diag([0.1, 0.1, 0.2]) ** 2)
    assert_same_record(build(motion=motion, sensors=[sensor], prior=prior), of_tables)


def test_times_stand_for_steps():
    controls, seen = frames(time=[10.0, 10.5, 11.0])
    controls["time"] = [10.5, 11.0]
    seen = seen.drop(columns="step")
    exact = build(controls, seen, start_time=10.0)
    assert_array_equal(exact.observations.step, [0, 1, 2])
    assert exact.observations.time is None
    seen["time"] += [0.0, 0.01, -0.02]
    near = build(controls, seen, start_time=10.0, time_tolerance=0.05)
    assert_array_equal(near.observations.step, [0, 1, 2])
    assert_array_equal(near.observations.time, seen["time"])
    with pytest.raises(InputError, match=r"row 1, column time: 10.51 is the time of no pose"):
        build(controls, seen, start_time=10.0)
    with pytest.raises(InputError, match=r"row 1, .* within time_tolerance of the poses 1 and 2"):
        build(controls, seen, start_time=10.0, time_tolerance=0.495)
    with pytest.raises(InputError, match="start_time is missing"):
        build(controls, seen)


def test_each_time_goes_to_the_nearest_pose(rng):
    times = np.cumsum(rng.uniform(0.2, 1.0, 40))
    given = np.sort(times[rng.integers(0, 40, 300)] + rng.uniform(-0.09, 0.09, 300))
    controls = pd.DataFrame({"time": times[1:], "dx": 0.1, "dy": 0.0, "dtheta": 0.0})
    seen = pd.DataFrame({"time": given, "range": 1.0, "bearing": 0.0})
    data = build(controls, seen, start_time=times[0], time_tolerance=0.09)
    brute = np.abs(given[:, None] - times).argmin(axis=1)
    assert_array_equal(data.observations.step, brute)


def test_sigmas_and_covariances_say_the_same():
    _, seen = frames(sigma_range=[0.5, np.nan, 0.2], sigma_bearing=[0.1, np.nan, 0.3])
    noise = build(observations=seen).observations.covariance
    assert_array_equal(noise[0], np.diag([0.5, 0.1]) ** 2)
    assert_array_equal(noise[1], np.diag([0.1, np.deg2rad(1)]) ** 2)  # the sensor's
    _, same = frames(cov_range_range=[0.25, None, 0.04], cov_bearing_bearing=[0.01, None, 0.09])
    np.testing.assert_allclose(build(observations=same).observations.covariance, noise, rtol=1e-15)
    controls = frames()[0].assign(sigma_dx=0.3, sigma_dy=0.2, sigma_dtheta=0.1)
    assert_array_equal(build(controls).robot.covariance[1], np.diag([0.3, 0.2, 0.1]) ** 2)


def test_a_motion_of_ones_own_has_its_own_columns(tmp_path):
    motion = ekfslam.OwnMotion(
        "push",
        covariance=np.diag([0.01]),
        controls=("push", "dt"),
        function=lambda u: [u[0] * u[1], 0, 0],
        slip=0.01,
    )
    controls = pd.DataFrame({"push": [2.0, 1.0], "dt": [0.5, 0.5]})
    data = build(controls, motion=motion)
    assert_array_equal(data.times, [0.0, 0.5, 1.0])
    assert_array_equal(data.robot.increments.deltas[:, 0], [1.0, 0.5])
    for again in both_ways(data, tmp_path / "tables"):
        assert again.robot.motion.kind == "odometry"
        assert_same_record(tuple(again.robot.increments), tuple(data.robot.increments))


# What is refused --------------------------------------------------------------------------------

CASES = [
    ("controls", {"dx": [1.0, "fast"]}, "row 1, column dx: is no number but 'fast'"),
    ("controls", {"dx": [1.0, "1_0"]}, "row 1, column dx: is no number but '1_0'"),
    ("controls", {"dx": [True, 1.0]}, "row 0, column dx: is no number but 'True'"),
    ("controls", {"dx": [1.0, None]}, "row 1, column dx: is blank"),
    ("controls", {"dx": [1.0, -np.inf]}, "row 1, column dx: is infinite"),
    ("controls", {"dx": [1.0, 10**400]}, "row 1, column dx: is no number but .1000"),
    ("controls", {"step": [1, 3]}, "row 1, column step: is 3 where 2 is due"),
    ("controls", {"spede": 1.0}, "unknown column 'spede'"),
    ("controls", {"sigma_dx": [0.1, None]}, "row 0: states noise, but not sigma_dy"),
    ("observations", {"beraing": 0.1}, "unknown column 'beraing'; did you mean bearing"),
    ("observations", {"bearing": None}, "row 0, column bearing: is blank"),
    ("observations", {"step": [0, 1, 3]}, "row 2, column step: there are poses 0 to 2 alone"),
    ("observations", {"step": [0, 2, 1]}, "row 2, column step: comes after a later step"),
    ("observations", {"step": [0, 1, -1]}, "row 2, column step: is -1"),
    ("observations", {"step": [0, 1.5, 2]}, "row 1, column step: is no whole number but '1.5'"),
    ("observations", {"landmark": ["a", "b", "a"]}, "number what has names by pandas.factorize"),
    ("observations", {"landmark": [1, -7, 2]}, "row 1, column landmark: is -7"),
    ("observations", {"range": [1, -9, 2]}, "negative range -9.0 in row 1"),
    ("observations", {"step": [0, 1, 1]}, "landmark 4 is observed twice .* row 1"),
    ("observations", {"sensor": ["laser", "lasr", "laser"]}, "no sensor is called 'lasr'"),
    ("observations", {"robot": ["robot", "", "robot"]}, "row 1, column robot: is blank"),
    ("observations", {"sigma_range": -0.1, "sigma_bearing": 1}, "sigma_range: is negative"),
    ("observations", {"sigma_range": [None, 0.1, None]}, "row 1: states noise, but not sigma_b"),
]


@pytest.mark.parametrize(("table", "columns", "message"), CASES)
def test_a_bad_cell_is_named(table, columns, message, tmp_path):
    controls, seen = frames()
    if table == "controls":
        controls = controls.assign(**columns)
    else:
        seen = seen.assign(**columns)
    with pytest.raises(InputError, match=message) as caught:
        build(controls, seen)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(table)

    ekfslam.write_tables(build(), tmp_path / "mine")  # for a file, the same row by its line
    given = controls if table == "controls" else seen
    given.to_csv(tmp_path / "mine" / f"{table}.csv", index=False)
    if table == "controls":
        (tmp_path / "mine" / "observations.csv").unlink()
    with pytest.raises(FileFormatError) as named:
        ekfslam.load(tmp_path / "mine")
    assert str(named.value).startswith(str(tmp_path / "mine" / f"{table}.csv"))
    if "row " in str(caught.value):
        row = int(str(caught.value).split("row ")[1].split(",")[0].split(":")[0].split(")")[0][0])
        assert f"line {row + 2}" in str(named.value)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"motion": None}, r"\[motion\] must be a table"),
        ({"motion": {"kind": "odometri"}}, "missing key 'covariance' or|unknown motion model"),
        ({"motion": {**ODOMETRY, "sigma": [1]}}, "unknown key 'sigma'; did you mean sigmas"),
        ({"sensors": [LASER, LASER]}, "sensors need names of their own"),
        ({"sensors": [{**LASER, "kind": "sonar"}]}, "unknown sensor kind 'sonar'"),
        ({"sensors": []}, "the header names no sensors"),
        ({"sensors": [LASER, CAMERA]}, "'sensor' is missing, which names a sensor: laser, camera"),
        ({"nmae": "x"}, "unknown key 'nmae'; did you mean name"),
        ({"robots": [{"motion": ODOMETRY}]}, "give either robots or motion"),
        ({"time_tolerance": "wide"}, "time_tolerance must be a number"),
        ({"time_tolerance": np.nan}, "time_tolerance must not be negative .* got nan"),
        ({"time_tolerance": -0.1}, "time_tolerance must not be negative"),
        ({"start_time": 10**400}, "start_time is larger than any number"),
        ({"prior": {"mean": [0, 0]}}, r"\[prior\]: prior mean must have shape"),
    ],
)
def test_a_bad_header_is_named(header, message):
    with pytest.raises(InputError, match=message):
        build(**header)


@pytest.mark.parametrize("table", ["controls.csv", {"dx": [1], "dy": [1, 2]}])
def test_what_is_no_table_is_named(table):
    with pytest.raises(InputError, match=r"controls is no table: .*ekfslam.load\(folder\)"):
        build(table)


def test_motion_is_needed():
    with pytest.raises(InputError, match="motion is missing, such as kind = 'odometry'"):
        ekfslam.from_tables(frames()[0])


def test_cells_of_another_sensor_are_blank():
    seen = pd.DataFrame(
        {
            "step": [0, 1],
            "sensor": ["laser", "camera"],
            "range": [3.0, 2.0],
            "bearing": [0.1, 0.1],
        }
    )
    sensors = [LASER, CAMERA]
    with pytest.raises(InputError, match=r"row 1, column range: is not of camera \(bearing\)"):
        build(observations=seen, sensors=sensors)
    seen["range"] = [3.0, None]
    assert_array_equal(
        build(observations=seen, sensors=sensors).observations.values, [[3.0, 0.1], [0.1, 0.0]]
    )


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"x": [0, 1, None], "y": [0, 0, 0]}, "row 2: x and y are known, or neither"),
        ({"x": [0, 1, None], "y": [0, 0, None], "heading": 0}, "row 2: a heading needs"),
        ({"step": [0, 1, 1], "x": 0, "y": 0}, "row 2: has a pose that an earlier row has"),
    ],
)
def test_bad_truth_is_named(columns, message):
    truth = pd.DataFrame({"step": [0, 1, 2]} | columns)
    with pytest.raises(InputError, match=f"truth, {message}"):
        build(truth=truth)


def test_truth_may_be_known_in_part():
    truth = pd.DataFrame({"step": [2, 0], "x": [5.0, 1.0], "y": [6.0, 2.0]})
    nan = np.nan
    assert_array_equal(build(truth=truth).truth, [[1, 2, nan], [nan] * 3, [5, 6, nan]])


def test_maps_are_checked():
    places = pd.DataFrame({"id": [4, 4], "x": 0.0, "y": [1.0, 2.0]})
    with pytest.raises(InputError, match="landmarks, row 1, column id: is there twice"):
        build(landmarks=places)
    assert build(known_map=places.assign(id=[4, 7])).known_map.ids.tolist() == [4, 7]


def test_robots_share_times():
    one = frames()[0].assign(robot="one", time=[1.0, 2.0])
    other = frames()[0].assign(robot="other", time=[1.0, 2.5])
    robots = [{"name": name, "motion": ODOMETRY} for name in ("one", "other")]
    with pytest.raises(InputError, match="row 3, column time: robots share the times"):
        ekfslam.from_tables(pd.concat([one, other]), robots=robots, start_time=0.0)
    with pytest.raises(InputError, match="other makes 1 and one 2"):
        ekfslam.from_tables(pd.concat([one, other[:1]]), robots=robots, start_time=0.0)


def test_robots_share_what_their_dt_add_up_to():
    robots = [{"name": name, "motion": {"kind": "velocity", "sigmas": [1, 1]}} for name in "ab"]
    moved = pd.DataFrame({"robot": list("abab"), "v": 1.0, "omega": 0.0})
    times = ekfslam.from_tables(moved.assign(dt=[0.5, 0.5, 0.25, 0.25]), robots=robots).times
    assert_array_equal(times, [0.0, 0.5, 0.75])
    for dt, message in (
        ([1, 2, -1, 2], "row 2, column dt: is not positive"),
        ([1, 1, 1, -1], "row 3, column dt: is not positive"),
        ([1, 1, 1, 3], "row 3, column dt: robots share the times of poses, but a has 1.0"),
    ):
        with pytest.raises(InputError, match=message):
            ekfslam.from_tables(moved.assign(dt=dt), robots=robots)


# Files as people write them ---------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    ekfslam.write_tables(build(), tmp_path / "mine")
    return tmp_path / "mine"


def test_spaces_blank_lines_a_bom_and_gzip_are_taken(folder):
    text = "\ufeffdx, dy ,dtheta\r\n\r\n 1.0, 0 ,0\r\n1.0,0,0\r\n,,\r\n\r\n"
    (folder / "controls.csv.gz").write_bytes(gzip.compress(text.encode()))
    (folder / "controls.csv").unlink()
    assert_array_equal(ekfslam.load(folder).robot.controls, [[1, 0, 0], [1, 0, 0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("\n\n", "is empty"),
        ("\ndx,dy,dtheta\n1,0,0\n", "its first line is, which has to name the columns"),
        ("dx;dy;dtheta\n1;0;0\n", "columns are separated by commas"),
        ("dx,dy,dtheta\n1,0,0\n1,5,0,0\n", "line 3: 4 cells, where the first line has 3; .*point"),
        ("dx,dy,dtheta\n\n1,0,0\n1,0\n", "line 4, column dtheta: is blank"),
        ("dx,dy,dx\n1,0,0\n", "the column 'dx' is there twice"),
        ("dx,dy\n1,0\n", "the column 'dtheta' is missing; there are: dx, dy"),
        (b"\xff\xfe\x00", "cannot be read"),
    ],
)
def test_damaged_files_are_named(folder, text, message):
    (folder / "controls.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(FileFormatError, match=message) as caught:
        ekfslam.load(folder)
    assert "controls.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_compressed_file_that_is_damaged_is_named(folder):
    packed = bytearray(gzip.compress(b"dx,dy,dtheta\n" + b"1,0,0\n" * 1000))
    packed[20:30] = b"\xff" * 10
    (folder / "controls.csv.gz").write_bytes(packed)
    (folder / "controls.csv").unlink()
    with pytest.raises(FileFormatError, match=r"controls.csv.gz: cannot be read"):
        ekfslam.load(folder)


def test_a_folder_without_its_parts_is_named(folder, tmp_path):
    (folder / "controls.csv").unlink()
    with pytest.raises(FileFormatError, match=r"has no controls.csv beside dataset.toml"):
        ekfslam.load(folder)
    (folder / "dataset.toml").write_text("motion = [")
    with pytest.raises(FileFormatError, match=r"dataset.toml: Invalid value"):
        ekfslam.load(folder)
    (tmp_path / "other").mkdir()
    with pytest.raises(InputError, match=r"a folder of tables has a dataset.toml"):
        ekfslam.load(tmp_path / "other")


def test_the_folder_names_the_dataset(folder):
    header = (folder / "dataset.toml").read_text().replace('name = "tables"\n', "")
    (folder / "dataset.toml").write_text(header)
    assert ekfslam.load(folder).name == "mine"


def test_two_robots_of_one_name_cannot_be_written():
    robot = Robot(MOTION, np.zeros((2, 3)), name="a")
    dataset = make(robots=(robot, robot, replace(robot, name="a-2")))
    with pytest.raises(InputError, match="robots need names of their own"):
        ekfslam.to_tables(dataset)
