"""Scenarios that come with the package, worlds, paths, and scenario files good and bad."""

from dataclasses import replace

import numpy as np
import pytest

from ekfslam import geometry as geo
from ekfslam.errors import FileFormatError, InputError, UnknownNameError
from ekfslam.simulation import (
    Scenario,
    describe_scenario,
    load_scenario,
    scenarios,
    simulate,
)
from ekfslam.simulation.paths import PATHS, figure_eight, repeated
from ekfslam.simulation.worlds import WORLDS, circle, cloister, scatter

SQUARE = """
description = "A square."
[world]
kind = "points"
landmarks = [[0, 0], [4, 0], [4, 4], [0, 4]]
[path]
kind = "controls"
start = [2, 0, 0]
controls = [[0.1, "3 deg"]]
repeat = 120
[motion]
kind = "advance-turn"
sigmas = [0.01, "1 deg"]
[[sensors]]
kind = "range-bearing"
sigmas = [0.1, "1 deg"]
max_range = 5.0
"""

SETTINGS = """
association = "unknown"
noise_on = "motion"
time_step = 0.5
observe_start = true
observe_every = 3
new_landmarks_per_step = 2
"""
TABLES = """
[[sensors]]
kind = "xy"
covariance = [[0.2, 0.1], [0.1, 0.3]]
mount = [0.5, 0, "180 deg"]
field_of_view = "120 deg"
max_range = inf
name = "rear"
[prior]
sigmas = [0.1, 0.2, "90 deg"]
mean = [1, 2, "-90 deg"]
draw = true
"""


@pytest.fixture
def load(tmp_path):
    def _load(text: str) -> Scenario:
        file = tmp_path / "square.toml"
        file.write_text(text)
        return load_scenario(file)

    return _load


def distances(a, b):
    return np.linalg.norm(a[:, None] - b[None], axis=-1)


# The scenarios that come with the package ------------------------------------------------------


def test_shipped_scenarios():
    assert {"cloister", "loop-15", "park"} <= set(scenarios())
    for name in scenarios():
        if "[not here" in describe_scenario(name):
            continue
        scenario = load_scenario(name)
        assert scenario.name == name
        line = scenario.describe()
        assert "\n" not in line
        assert scenario.description in line
        assert f"{len(scenario.landmarks)} landmarks" in line


def test_cloister_is_the_demo():
    scenario = load_scenario("cloister")
    # 5 landmarks on each side of the outer square, 16 around the inner one.
    ring = [(x, y) for x in range(-2, 3) for y in range(-2, 3) if max(abs(x), abs(y)) == 2]
    sides = [p for x in range(-2, 3) for p in ((x, 3), (x, -3), (3, x), (-3, x))]
    expected = sorted((8 / 6 * x, 8 / 6 * y) for x, y in ring + sides)
    assert len(expected) == 36
    got = sorted(map(tuple, np.round(scenario.landmarks.positions, 9)))
    np.testing.assert_allclose(got, np.round(expected, 9), atol=1e-9)

    assert scenario.motion.kind == "advance-turn"
    assert scenario.controls.tolist() == [[0.1, 0.05]] * 200
    assert scenario.start.tolist() == [0, -2, 0]
    np.testing.assert_allclose(scenario.motion.covariance, np.diag([0.01**2, 0.02**2]))
    assert scenario.motion.slip == 0.001
    data = simulate(scenario)
    assert len(data.observations) == 200 * 36
    np.testing.assert_allclose(
        data.sensors[0].covariance, np.diag([0.01, (np.pi / 180) ** 2]), rtol=1e-12
    )
    assert not data.prior.covariance.any()
    assert data.prior.mean.tolist() == [0, -2, 0]


def test_loop_15_is_the_small_loop_of_barrau_and_bonnabel():
    scenario = load_scenario("loop-15")
    angle = 2 * np.pi * np.arange(1, 16) / 15
    centre = np.array([0.1251, 3.3318])
    expected = centre + (3.3333 + 1) * np.column_stack([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(scenario.landmarks.positions, expected, atol=1e-12)
    assert scenario.controls.tolist() == [[0.25, 0.075, 1.0]] * 400
    sigma = 0.02
    np.testing.assert_allclose(
        scenario.motion.covariance,
        np.diag([sigma**2 / 2, 8 * sigma**2]),
        rtol=1e-12,
    )
    assert scenario.motion.kind == "velocity-euler"
    assert scenario.motion.slip == 0
    data = simulate(scenario)
    assert data.times.tolist() == list(range(401))
    np.testing.assert_array_equal(data.truth, simulate(scenario, seed=1).truth)
    # A lap is 2 pi / 0.075 = 83.8 steps about the stated centre.
    radii = np.hypot(*(data.truth[:, :2] - centre).T)
    np.testing.assert_allclose(radii, 0.25 / 2 / np.sin(0.075 / 2), atol=3e-4)
    (sensor,) = data.sensors
    assert (sensor.kind, sensor.min_range, sensor.max_range) == ("xy", 0.5, 5.0)
    np.testing.assert_allclose(sensor.covariance, 0.01 * np.eye(2))
    seen = distances(data.truth[1:, :2], data.true_map.positions)
    assert len(data.observations) == ((seen >= 0.5) & (seen <= 5)).sum()


def test_park_has_the_numbers_that_it_promises():
    scenario = load_scenario("park")
    positions = scenario.landmarks.positions
    assert len(positions) == 60
    assert (positions >= 0).all()
    assert (positions <= [60, 40]).all()
    assert (distances(positions, positions) + 9 * np.eye(60)).min() >= 4.0

    data = simulate(scenario, seed=7)
    assert data.poses == 966
    assert data.observations.step[0] == 1
    per_step = len(data.observations) / 965
    assert 6.6 <= per_step <= 7.0
    np.testing.assert_allclose(
        scenario.motion.covariance, np.diag([0.02, 0.005, np.deg2rad(0.3)]) ** 2, rtol=1e-12
    )
    assert scenario.motion.slip == 0
    (sensor,) = data.sensors
    assert (sensor.kind, sensor.max_range) == ("range-bearing", 10.0)
    np.testing.assert_allclose(sensor.covariance, np.diag([0.1, np.deg2rad(1)]) ** 2, rtol=1e-12)
    # Six sigmas of range: no drawn range turns negative.
    assert distances(data.truth[:, :2], positions).min() > 0.6


# Worlds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [3, 4, 7, 9])
def test_cloister_has_distinct_landmarks_symmetric_under_quarter_turns(n):
    points = cloister([-1, 1], [-1, 1], n)
    assert len(points) == 4 * (2 * n - 5)
    turned = np.column_stack([-points[:, 1], points[:, 0]])
    np.testing.assert_allclose(distances(points, turned).min(axis=1), 0, atol=1e-12)
    between = distances(points, points) + 9 * np.eye(len(points))
    assert between.min() > 0.5 / n
    assert np.abs(points).max() == pytest.approx(1)


def test_cloister_fills_its_limits():
    points = cloister([2, 10], [-3, 1])
    np.testing.assert_allclose([points.min(0), points.max(0)], [[2, -3], [10, 1]])


def test_circle():
    points = circle(6, 2.0, [1, -1])
    np.testing.assert_allclose(np.hypot(*(points - [1, -1]).T), 2)
    np.testing.assert_allclose(distances(points, np.roll(points, 1, axis=0)).diagonal(), 2)


def test_scatter_keeps_its_distance_and_depends_on_its_seed():
    points = scatter(40, [0, 30], [-10, 10], 3.0, seed=1)
    assert points.shape == (40, 2)
    assert (distances(points, points) + 9 * np.eye(40)).min() >= 3.0
    assert (points >= [0, -10]).all()
    assert (points <= [30, 10]).all()
    np.testing.assert_array_equal(points, scatter(40, [0, 30], [-10, 10], 3.0, seed=1))
    assert not np.array_equal(points, scatter(40, [0, 30], [-10, 10], 3.0, seed=2))


def test_scatter_fills_its_rectangle_evenly():
    points = scatter(900, [0, 1], [0, 1], 0.0, seed=3)
    counts = np.histogram2d(*points.T, bins=3, range=[[0, 1], [0, 1]])[0]
    assert ((counts - 100) ** 2 / 100).sum() < 26.1  # chi-square of 8 dof at 0.999


@pytest.mark.parametrize(
    "world",
    [
        lambda: scatter(50, [0, 5], [0, 5], 3.0, seed=1),
        lambda: scatter(0, [0, 5], [0, 5], 3.0, seed=1),
        lambda: scatter(5, [0, 5], [0, 5], 1.0, seed=-1),
        lambda: scatter(5, [0, 5, 6], [0, 5], 1.0, seed=1),
        lambda: cloister([0, 1], [0, 1], 2),
        lambda: cloister([0, np.nan], [0, 1], 5),
        lambda: circle(0, 1.0, [0, 0]),
        lambda: circle(3, 1.0, [0, 0, 0]),
    ],
)
def test_impossible_worlds_are_refused(world):
    with pytest.raises(InputError):
        world()


# Paths -----------------------------------------------------------------------------------------


def test_figure_eight_is_the_curve_in_steps_of_equal_length():
    path = figure_eight([30, 20], [24, 14.4], 0.5, laps=3)
    poses = geo.integrate(path.start, path.controls)
    assert len(poses) == 966
    # On the curve: cos t from x, then (y / ay)^2 = (2 sin t cos t)^2.
    x, y = (poses[:, 0] - 30) / 24, (poses[:, 1] - 20) / 14.4
    np.testing.assert_allclose(y**2, 4 * (1 - x**2) * x**2, atol=1e-10)
    # A chord is shorter than its arc by kappa^2 s^3 / 24, here less than 1e-2 of 0.5 m.
    chords = np.hypot(*path.controls[:, :2].T)
    curvature = np.abs(path.controls[:, 2]) / 0.5
    np.testing.assert_allclose(chords, 0.5 - curvature**2 * 0.5**3 / 24, atol=2e-5)
    # Headings are tangent: a chord bisects the headings at its ends, to third order in the step.
    bisector = np.arctan2(path.controls[:, 1], path.controls[:, 0])
    np.testing.assert_allclose(bisector, path.controls[:, 2] / 2, atol=2e-3)
    np.testing.assert_allclose(path.start, [54, 20, np.pi / 2], atol=1e-12)


def test_figure_eight_closes_after_a_lap():
    one = figure_eight([0, 0], [24, 14.4], 0.01)
    assert len(one.controls) * 0.01 == pytest.approx(161, abs=0.5)
    end = geo.integrate(one.start, one.controls)[-1]
    gap = np.hypot(*geo.between(end, one.start)[:2])
    assert gap < 0.02  # at most two steps short


def test_repeated_controls():
    path = repeated([0, 0, 0], [[1, 0.1], [2, 0.2]], repeat=2)
    assert path.controls.tolist() == [[1, 0.1], [2, 0.2], [1, 0.1], [2, 0.2]]


@pytest.mark.parametrize(
    "path",
    [
        lambda: repeated([0, 0, 0], [1, 2]),
        lambda: repeated([0, 0, 0], [[1, 2]], 0),
        lambda: figure_eight([0, 0], [1, 1], 0.0),
        lambda: figure_eight([0, 0], [1, -1], 0.1),
        lambda: figure_eight([0, 0], [1, 1], 0.1, laps=0.0),
        lambda: figure_eight([0, 0], [1, 1], 1e3),
        lambda: figure_eight([0, 0, 0], [1, 1], 0.1),
    ],
)
def test_impossible_paths_are_refused(path):
    with pytest.raises(InputError):
        path()


# Scenario files --------------------------------------------------------------------------------


def test_a_file_is_a_scenario(load, tmp_path):
    scenario = load(SQUARE)
    assert scenario.name == "square"
    assert scenario.controls.shape == (120, 2)
    np.testing.assert_allclose(scenario.controls[0], [0.1, np.pi / 60])
    np.testing.assert_allclose(scenario.motion.covariance, np.diag([0.01, np.pi / 180]) ** 2)
    assert scenario.motion.slip == 0.001  # the default for two noisy controls
    assert scenario.prior is None
    data = simulate(str(tmp_path / "square.toml"), seed=1)
    assert data.name == "square"
    assert data.poses == 121


def test_every_setting_arrives(load):
    scenario = load(SETTINGS + SQUARE.replace("[motion]", "[motion]\nslip = 0.02") + TABLES)
    assert (scenario.association, scenario.noise_on) == ("unknown", "motion")
    assert (scenario.observe_start, scenario.observe_every) == (True, 3)
    assert (scenario.new_landmarks_per_step, scenario.draw_prior) == (2, True)
    assert scenario.times[:3].tolist() == [0.0, 0.5, 1.0]
    assert scenario.motion.slip == 0.02
    front, rear = scenario.sensors
    assert front.max_range == 5.0
    assert rear.name == "rear"
    np.testing.assert_allclose(rear.covariance, [[0.2, 0.1], [0.1, 0.3]])
    np.testing.assert_allclose(rear.mount, [0.5, 0, np.pi])
    assert rear.field_of_view == pytest.approx(2 * np.pi / 3)
    np.testing.assert_allclose(scenario.prior.mean, [1, 2, -np.pi / 2])
    np.testing.assert_allclose(scenario.prior.covariance, np.diag([0.1, 0.2, np.pi / 2]) ** 2)


def test_no_slip_by_default_with_three_noisy_controls(load):
    text = SQUARE.replace('"advance-turn"', '"odometry"').replace(
        'sigmas = [0.01, "1 deg"]', "sigmas = [0.01, 0.01, 0.01]"
    )
    assert load(text.replace('[[0.1, "3 deg"]]', "[[0.1, 0, 0.05]]")).motion.slip == 0


def test_a_prior_is_about_the_true_start_by_default(load):
    scenario = load(SQUARE + "[prior]\nsigmas = [0.1, 0.1, 0.1]\n")
    assert scenario.prior.mean.tolist() == [2, 0, 0]
    assert not scenario.draw_prior


@pytest.mark.parametrize("kind", WORLDS)
def test_every_world_can_be_asked_for(load, kind):
    parameters = {
        "points": "landmarks = [[1, 2]]",
        "circle": "count = 5\nradius = 2\ncentre = [0, 0]",
        "cloister": "x = [0, 1]\ny = [0, 1]",
        "scatter": "count = 3\nx = [0, 9]\ny = [0, 9]\nmin_distance = 1\nseed = 1",
        "streets": "count = 40\nseed = 1",
    }
    world = f'kind = "{kind}"\n{parameters[kind]}\n'
    before, after = SQUARE.split('kind = "points"\nlandmarks = [[0, 0], [4, 0], [4, 4], [0, 4]]\n')
    assert len(load(before + world + after).landmarks) > 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("description", "descriptin", r"unknown key 'descriptin'; did you mean description"),
        ("[[sensors]]", "[[sensor]]", r"unknown key 'sensor'; did you mean .*sensors"),
        ("[[sensors]]", "[sensors]", r"at least one table \[\[sensors\]\]"),
        ("[world]", "[wrld]", r"unknown key 'wrld'; did you mean .*world"),
        ("description =", "name =", r"unknown key 'name'"),
        ('"A square."', "3", r"description must be text"),
        ("max_range = 5.0", 'max_range = "far"', r"\[\[sensors\]\] 1: max_range must be a number"),
        ("max_range", "max_rnge", r"\[\[sensors\]\] 1: unknown key 'max_rnge'; .*max_range"),
        ("max_range = 5.0", "max_range = -5.0", r"\[\[sensors\]\] 1: .*max_range"),
        ("repeat = 120", "repeat = 1.5", r"\[path\]: repeat must be a whole number"),
        ("repeat = 120", "repeat = true", r"\[path\]: repeat must be a whole number"),
        ("repeat = 120", "repeat = 0", r"\[path\]: repeat must be at least 1"),
        ("repeat = 120", "laps = 1", r"\[path\]: unknown key 'laps'"),
        ("start = [2, 0, 0]", "", r"\[path\]: missing key 'start'"),
        ("start = [2, 0, 0]", "start = [2, 0]", r"start must be a pose"),
        ("start = [2, 0, 0]", "start = 2", r"\[path\]: start must be a list of numbers"),
        ("start = [2, 0, 0]", 'start = [2, 0, "3"]', r"start must be a number"),
        ("start = [2, 0, 0]", "start = [2, 0, nan]", r"start holds NaN"),
        ('[[0.1, "3 deg"]]', "[[0.1]]", r"controls of 'advance-turn' need dx, dalpha"),
        ('[[0.1, "3 deg"]]', "[[0.1], [0.1, 0.2]]", r"\[path\]: controls has rows of different"),
        ('kind = "points"', "", r"\[world\]: missing key 'kind'"),
        ('kind = "points"', 'kind = "circl"', r"\[world\]: unknown kind 'circl'; .*circle"),
        ('kind = "points"', "kind = [1]", r"\[world\]: kind must be text"),
        ("[4, 4]", "[4, 4, 4]", r"\[world\]: landmarks has rows of different"),
        ("[[0, 0], [4, 0], [4, 4], [0, 4]]", "[0, 0]", r"landmark positions must have shape"),
        ('"advance-turn"', '"advance-trn"', r"\[motion\]: unknown motion model .*advance-turn"),
        ('sigmas = [0.01, "1 deg"]', "", r"\[motion\]: give either covariance or proportional"),
        ('sigmas = [0.01, "1 deg"]', "sigmas = [0.1]", r"\[motion\]: covariance must have shape"),
        ('sigmas = [0.1, "1 deg"]', "", r"1: missing key 'covariance' or 'sigmas'"),
        (
            'sigmas = [0.1, "1 deg"]',
            "sigmas = [0.1, 1]\ncovariance = [[1, 0], [0, 1]]",
            r"give either covariance or sigmas",
        ),
        ('sigmas = [0.1, "1 deg"]', "sigmas = [[0.1, 1]]", r"sigmas must be one number for each"),
        ('sigmas = [0.1, "1 deg"]', "sigmas = [0.1, -1]", r"sigmas must not be negative"),
        (
            'sigmas = [0.1, "1 deg"]',
            'covariance = [["1 deg", 0], [0, 1]]',
            r"covariance must be a number",
        ),
    ],
)
def test_a_mistake_in_a_file_is_named_with_file_table_and_key(load, old, new, message):
    assert old in SQUARE
    with pytest.raises(InputError, match=message) as caught:
        load(SQUARE.replace(old, new))
    assert "square.toml: " in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('association = "none"', "association must be 'known' or 'unknown'"),
        ('noise_on = "truth"', "noise_on must be 'odometry' or 'motion'"),
        ("time_step = 0", "time_step must be positive"),
        ("observe_every = 0", "observe_every must be at least 1"),
        ("observe_start = 1", "observe_start must be true or false"),
        ("new_landmarks_per_step = 0", "new_landmarks_per_step must be at least 1"),
        ("prior = 3", r"\[prior\] must be a table"),
    ],
)
def test_settings_are_checked(load, line, message):
    with pytest.raises(InputError, match=message):
        load(line + "\n" + SQUARE)


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        ("sigma = [1, 1, 1]", r"\[prior\]: unknown key 'sigma'; did you mean sigmas"),
        ("draw = 1", r"\[prior\]: draw must be true or false"),
        ("mean = [1, 2]", r"\[prior\]: prior mean must have shape"),
        ("covariance = [[1, 2], [2, 1]]", r"\[prior\]: prior covariance must have shape"),
    ],
)
def test_priors_are_checked(load, prior, message):
    with pytest.raises(InputError, match=message):
        load(SQUARE + "[prior]\n" + prior)


def test_a_curve_needs_odometry(load):
    path = 'kind = "figure-eight"\ncentre = [0, 0]\namplitude = [5, 3]\nspacing = 0.5\n'
    text = SQUARE.replace(
        'kind = "controls"\nstart = [2, 0, 0]\ncontrols = [[0.1, "3 deg"]]\nrepeat = 120\n', path
    )
    assert "figure-eight" in PATHS
    with pytest.raises(InputError, match="needs the motion kind 'odometry'"):
        load(text)


def test_a_controls_dt_is_the_time_step(load):
    text = SQUARE.replace('"advance-turn"', '"velocity"').replace(
        '[[0.1, "3 deg"]]', "[[0.1, 0.05, 0.25]]"
    )
    assert load(text).times[:3].tolist() == [0.0, 0.25, 0.5]
    with pytest.raises(InputError, match="time_step is the dt"):
        load("time_step = 1\n" + text)


def test_unreadable_files(tmp_path):
    with pytest.raises(FileFormatError, match=r"nowhere.toml: no such file"):
        load_scenario(tmp_path / "nowhere.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("a = 1\nb = = 2\n")
    with pytest.raises(FileFormatError, match=r"broken.toml: .*line 2"):
        load_scenario(broken)
    broken.write_bytes(b"\xff\xfe")
    with pytest.raises(FileFormatError, match=r"broken.toml: "):
        load_scenario(broken)
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(FileFormatError, match=r"folder.toml: "):
        load_scenario(tmp_path / "folder.toml")


def test_unknown_names_get_close_ones():
    with pytest.raises(UnknownNameError, match=r"unknown scenario 'cloisters'; .*cloister"):
        load_scenario("cloisters")


def test_variants_are_made_with_replace():
    variant = replace(load_scenario("loop-15"), name="short", controls=[[0.25, 0.075, 1.0]] * 3)
    assert simulate(variant).poses == 4
    with pytest.raises(InputError, match="controls of 'velocity-euler' need"):
        replace(variant, controls=[[1.0, 2.0]])
