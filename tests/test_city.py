"""The city: landmarks along its streets, the tour that drives them all, and what is seen of it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ekfslam
from ekfslam import geometry as geo
from ekfslam.errors import InputError
from ekfslam.simulation import load_scenario, scenario_hash, simulate
from ekfslam.simulation.blocks import Blocks
from ekfslam.simulation.paths import tour
from ekfslam.simulation.worlds import streets

BLOCK, CORNER, FACADE, RADIUS = 60.0, 8.0, 3.5, 6.0
COUNTS = [100, 300, 1000, 5000]


def size(points: np.ndarray, block: float = BLOCK) -> tuple[int, int]:
    """Columns and rows of the blocks that landmarks outline."""
    columns, rows = np.round(points.max(axis=0) / block).astype(int)
    return int(columns), int(rows)


def sides(columns: int, rows: int) -> int:
    """Sides of streets: each row of blocks has a street more than it has blocks, and so on."""
    return 2 * (columns * (rows + 1) + rows * (columns + 1))


def driven(count: int, spacing: float = 1.6, **options) -> np.ndarray:
    path = tour(count, spacing, **options)
    assert path.motion == "odometry"
    return geo.integrate(path.start, path.controls)


def passes(poses: np.ndarray, block: float = BLOCK) -> list[tuple[int, tuple[int, int, int]]]:
    """Step and street, as twice its middle in blocks and its direction, of each drive by a middle.

    An independent account: a middle is passed where one coordinate steps over half a block while
    the other is that of a street.
    """
    found = []
    for k, (a, b) in enumerate(pairwise(poses[:, :2] / block)):
        for axis in (0, 1):
            across = a[1 - axis]
            crossed = np.floor(a[axis] - 0.5) != np.floor(b[axis] - 0.5)
            if crossed and abs(across - round(across)) < 1e-9:
                middle = 2 * round(min(a[axis], b[axis]) + 0.25 - 0.5) + 1
                place = [middle, 2 * round(across)]
                found.append((k, (*place[:: 1 - 2 * axis], axis)))
    return found


# The world -------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, *COUNTS])
@pytest.mark.parametrize("seed", [1, 2])
def test_landmarks_stand_along_the_streets(count, seed):
    points = streets(count, seed)
    assert points.shape == (count, 2)
    # One coordinate is near the middle of a street, the other well away from any crossing.
    away = np.sort(np.abs(points - BLOCK * np.round(points / BLOCK)), axis=1)
    assert away[:, 0].min() >= 4.5 - 1e-9
    assert away[:, 0].max() <= 6.0 + 1e-9
    assert away[:, 1].min() >= CORNER - 1e-9
    assert points.min() >= -6.0


@pytest.mark.parametrize("count", [300, 5000])
def test_both_sides_of_every_street_have_their_share(count):
    points = streets(count, seed=1)
    columns, rows = size(points)
    nearest = np.round(points / BLOCK)
    eastward = np.abs(points - BLOCK * nearest).argmax(axis=1) == 0
    line = np.where(eastward, nearest[:, 1], nearest[:, 0])
    along = np.where(eastward, points[:, 0], points[:, 1])
    left = np.where(eastward, points[:, 1], points[:, 0]) > BLOCK * line
    keys = np.column_stack([eastward, line, along // BLOCK, left])
    facades, counts = np.unique(keys, axis=0, return_counts=True)
    assert len(facades) == sides(columns, rows)
    # Landmark i is within its i-th share of all facades: a facade can win or lose one at each end.
    assert np.abs(counts - count / len(facades)).max() < 2


@pytest.mark.parametrize("count", COUNTS)
def test_landmarks_keep_their_distance(count):
    for points in (streets(count, seed=3), streets(count, seed=3, facade=2.0)):
        assert cKDTree(points).query(points, k=2)[0][:, 1].min() >= 2.0 - 1e-9


@pytest.mark.parametrize("count", [200, 500, 1000, 2000, 5000, 20_000])
def test_the_city_grows_with_its_landmarks(count):
    columns, rows = size(streets(count, seed=1))
    assert columns - rows in (0, 1)
    room = sides(columns, rows) * (BLOCK - 2 * CORNER) / count
    # A city without the last row or column would be too small: the density is that of large cities
    # to the share of one, which goes down with the root of the count.
    smaller = (columns - 1, rows) if columns > rows else (columns, rows - 1)
    assert sides(*smaller) * (BLOCK - 2 * CORNER) / count < FACADE <= room
    assert room < FACADE * (1 + 8 / np.sqrt(count))


def test_a_map_depends_on_its_seed_alone():
    np.testing.assert_array_equal(streets(500, seed=1), streets(500, seed=1))
    assert (streets(500, seed=1) != streets(500, seed=2)).all()


def test_places_are_uniform_in_their_shares():
    points = streets(5000, seed=1)
    away = np.abs(points - BLOCK * np.round(points / BLOCK)).min(axis=1)
    counts = np.histogram(away, bins=10, range=(4.5, 6.0))[0]
    assert ((counts - 500) ** 2 / 500).sum() < 27.9  # chi-square of 9 dof at 0.999


@pytest.mark.parametrize("block", [20.0, 45.0, 100.0])
def test_blocks_of_any_size(block):
    points, poses = streets(200, 1, block), driven(200, 1.0, block=block)
    columns, rows = size(points, block)
    assert poses[:, :2].max() == pytest.approx(block * columns)
    assert len({street for _, street in passes(poses, block)}) == sides(columns, rows) / 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 0}, "count must be at least 1"),
        ({"seed": -1}, "seed must be at least 0"),
        ({"block": 19.0}, "block must be at least 20 m"),
        ({"block": np.inf}, "block must be at least 20 m"),
        ({"facade": 1.9}, "facade must be at least 2 m"),
        ({"facade": np.nan}, "facade must be at least 2 m"),
    ],
)
def test_impossible_cities_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        streets(**{"count": 100, "seed": 1} | options)


# The tour --------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("spacing", [0.5, 1.6])
def test_the_tour_keeps_to_the_streets(count, spacing):
    poses = driven(count, spacing)
    columns, rows = size(streets(count, seed=1))
    crossing = BLOCK * np.round(poses[:, :2] / BLOCK)
    assert (crossing >= 0).all()
    assert (crossing <= [BLOCK * columns, BLOCK * rows]).all()
    offset = poses[:, :2] - crossing
    away = np.sort(np.abs(offset), axis=1)
    quarter = np.abs(np.remainder(poses[:, 2] + np.pi / 4, np.pi / 2) - np.pi / 4)
    straight = away[:, 0] < 1e-7
    # On a line: in the middle of the street, and along it.
    headed = np.abs(np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1))
    onward = np.abs(offset[:, ::-1])[np.arange(len(poses)), headed.argmax(axis=1)]
    assert quarter[straight].max() < 2e-4  # an arc is 1e-7 m off its tangent when it has turned so
    assert onward[straight].max() < 1e-7
    # On an arc: about a centre in the block that it turns into, and at right angles to its radius.
    turning = ~straight
    assert 0.01 < turning.mean() < 0.35
    radial = offset[turning] - RADIUS * np.sign(offset[turning])
    np.testing.assert_allclose(np.hypot(*radial.T), RADIUS, atol=1e-7)
    heading = poses[turning, 2]
    forward = np.column_stack([np.cos(heading), np.sin(heading)])
    np.testing.assert_allclose((radial * forward).sum(axis=1), 0, atol=1e-6)


def test_steps_are_smooth_and_of_equal_length():
    spacing = 0.5
    path = tour(1000, spacing)
    turns = np.abs(path.controls[:, 2])
    assert turns.max() <= spacing / RADIUS + 1e-9
    whole = (turns < 1e-9) | (turns > spacing / RADIUS - 1e-9)  # the rest begin or end an arc
    curvature = turns / spacing
    chords = np.hypot(*path.controls[:, :2].T)
    expected = np.where(curvature > 1e-9, 2 * np.sin(turns / 2) / np.maximum(curvature, 1e-9), 0.5)
    np.testing.assert_allclose(chords[whole], expected[whole], atol=1e-9)
    assert (chords <= spacing + 1e-9).all()
    assert whole.mean() > 0.95
    # Signs: left turns and right turns, and as many rounds of either as the track needs.
    assert (path.controls[:, 2] > 0.01).any()
    assert (path.controls[:, 2] < -0.01).any()
    np.testing.assert_array_equal(path.start, [0, 0, 0])


@pytest.mark.parametrize("count", COUNTS)
def test_every_street_is_driven_and_the_last_one_last(count):
    columns, rows = size(streets(count, seed=1))
    found = [street for _, street in passes(driven(count))]
    assert len(set(found)) == sides(columns, rows) / 2
    assert found.count(found[-1]) == 1
    assert len(found) <= 1.5 * len(set(found))


def test_some_streets_are_driven_again_soon_and_some_late():
    found = [street for _, street in passes(driven(2000))]
    last: dict[tuple[int, int, int], int] = {}
    gaps = []
    for number, street in enumerate(found):
        if street in last:
            gaps.append(number - last[street])
        last[street] = number
    assert len(gaps) >= 0.25 * len(last)
    assert np.mean(np.array(gaps) <= 8) > 0.5
    assert max(gaps) > 0.6 * len(last)


def test_crossings_are_met_again_round_the_block_and_after_the_long_way():
    poses = driven(2000)
    step = 0
    last: dict[tuple[int, int], int] = {}
    metres = []
    crossing = np.round(poses[:, :2] / BLOCK).astype(int)
    near = np.abs(poses[:, :2] - BLOCK * crossing).max(axis=1) < RADIUS + 1
    for step in np.flatnonzero(near):
        here = (int(crossing[step, 0]), int(crossing[step, 1]))
        if here in last and step - last[here] > 20:
            metres.append(1.6 * (step - last[here]))
        last[here] = int(step)
    assert 4 * BLOCK - 4 * RADIUS < np.median(metres) < 6 * BLOCK
    assert max(metres) > 3000


@pytest.mark.parametrize("steps", [1, 35, 77, 400, 700])
def test_a_short_tour_is_the_beginning_of_the_whole_one(steps):
    whole, short = driven(300), driven(300, steps=steps)
    assert len(short) == steps + 1
    shared = min(len(short), len(whole) - 5)  # at the last crossing it does not turn
    np.testing.assert_allclose(short[:shared], whole[:shared], atol=1e-9)


def test_a_long_tour_drives_the_city_again_and_again():
    found = [street for _, street in passes(driven(300, steps=6000))]
    counts = np.unique(found, axis=0, return_counts=True)[1]
    assert len(counts) == 12
    assert counts.min() >= 9  # 160 streets, of which one in three or four leads to another
    assert counts.max() <= 2 * counts.min()


def test_nobody_turns_round_and_the_least_driven_street_is_next():
    city = Blocks.for_landmarks(1000)
    left, driven_, at = set(city.streets), 0, np.zeros(2, int)
    before = None
    for heading in city.once():
        assert left
        assert before is None or (heading - before) % 4 != 2
        step = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[heading]
        first = np.minimum(at, at + step)
        street = (*first.tolist(), heading % 2)
        assert street in city.streets
        driven_ += street not in left
        left.discard(street)
        at, before = at + step, heading
    assert not left
    assert driven_ > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 0}, "count must be at least 1"),
        ({"block": 10.0}, "block must be at least 20 m"),
        ({"facade": 0.0}, "facade must be at least 2 m"),
        ({"spacing": 0.0}, "spacing must be positive"),
        ({"spacing": 61.0}, "spacing must be positive and at most a block"),
        ({"spacing": np.nan}, "spacing must be positive"),
        ({"spacing": 1e-4}, "makes more than 1000000 steps"),
        ({"steps": 0}, "steps must be from 1"),
        ({"steps": 1_000_001}, "steps must be from 1 to 1000000"),
    ],
)
def test_impossible_tours_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        tour(**{"count": 100, "spacing": 1.6} | options)


# The scenario ----------------------------------------------------------------------------------


def test_the_city_is_set_by_its_count_alone():
    for count in (300, 1000):
        scenario = load_scenario("city", {"world.count": count})
        np.testing.assert_array_equal(scenario.landmarks.positions, streets(count, seed=1))
        np.testing.assert_array_equal(scenario.controls, tour(count, 1.6).controls)
    assert len(load_scenario("city").landmarks) == 2000


def test_world_and_tour_share_their_blocks():
    changes = {"world.count": 300, "world.block": 45.0, "world.facade": 5.0, "path.steps": 99}
    scenario = load_scenario("city", changes)
    assert len(scenario.controls) == 99
    expected = tour(300, 1.6, steps=99, block=45.0, facade=5.0).controls
    np.testing.assert_array_equal(scenario.controls, expected)
    said_twice = load_scenario("city", changes | {"path.count": 300, "path.block": 45.0})
    assert scenario_hash(said_twice) == scenario_hash(scenario)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"path.count": 300}, r"city: \[path\]: count 300 is not that of \[world\]; leave it out"),
        ({"path.block": 80.0}, r"city: \[path\]: block 80.0 is not that of \[world\]"),
        ({"path.facade": 3.0, "world.facade": 4.0}, r"facade 3.0 is not that of \[world\]"),
        ({"world.count": 0}, r"city: \[world\]: count must be at least 1"),
        ({"world.count": "many"}, r"city: \[world\]: count must be a whole number"),
        ({"path.steps": 0}, r"city: \[path\]: steps must be from 1"),
        ({"motion.kind": "advance-turn", "motion.sigmas": [0.1, 0.1]}, "motion kind 'odometry'"),
        (
            {"world": {"kind": "points", "landmarks": [[0.0, 5.0]]}},
            r"the path 'tour' needs a \[world\] of kind 'streets'",
        ),
    ],
)
def test_cities_that_do_not_fit_together_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        load_scenario("city", changes)


def test_each_robot_of_a_team_may_tour_the_city(tmp_path):
    robots = """
[[robots]]
name = "{}"
path = {{ kind = "tour", spacing = {}, steps = 50 }}
motion = {{ kind = "odometry", sigmas = [0.03, 0.01, 0.001] }}
"""
    text = '[world]\nkind = "streets"\ncount = 300\nseed = 1\n'
    text += robots.format("one", 1.0) + robots.format("two", 2.0)
    text += '[[sensors]]\nkind = "xy"\nsigmas = [0.1, 0.1]\nmax_range = 12\n'
    file = tmp_path / "two.toml"
    file.write_text(text)
    one, two = load_scenario(file).robot_plans
    np.testing.assert_array_equal(one.controls, tour(300, 1.0, steps=50).controls)
    np.testing.assert_array_equal(two.controls, tour(300, 2.0, steps=50).controls)
    file.write_text(text.replace("spacing = 2.0", "spacing = 2.0, count = 301"))
    with pytest.raises(InputError, match=r"count 301 is not that of \[world\]"):
        load_scenario(file)


@pytest.mark.parametrize("count", [100, 300, 1000])
def test_every_landmark_is_seen_and_a_step_sees_some_five(count):
    data = simulate(load_scenario("city", {"world.count": count}), seed=2)
    assert len(np.unique(data.true_landmark)) == count
    per_step = len(data.observations) / (data.poses - 1)
    assert 4 <= per_step <= 5.5


def test_a_neighbourhood_of_a_hundred_landmarks_holds_the_robot_for_a_hundred_steps():
    data = simulate(load_scenario("city", {"world.count": 1000}), seed=2)
    held = []
    for start in range(0, data.poses - 300, 50):
        seen: set[int] = set()
        step = start
        while len(seen) < 100:
            seen.update(data.true_landmark[slice(*data.offsets[step : step + 2])].tolist())
            step += 1
        held.append(step - start)
    assert min(held) >= 60
    assert max(held) <= 150


def test_no_landmark_comes_near_the_driven_line():
    data = simulate(load_scenario("city", {"world.count": 1000, "path.spacing": 0.2}), draw=0.0)
    # The street keeps 4.5 m; a turn about (6, 6) passes the corner (8, 4.5) at 6 - hypot(2, 1.5).
    away = cKDTree(data.true_map.positions).query(data.truth[:, :2])[0]
    assert away.min() >= 3.5
    sigma = np.sqrt(data.sensors[0].covariance[0, 0])
    assert data.observations.values[:, 0].min() > 30 * sigma


def test_what_is_seen_is_what_the_truth_shows():
    data = simulate(load_scenario("city", {"world.count": 300}), draw=0.0)
    points = data.true_map.positions[None] - data.truth[:, None, :2]
    frame = (points[..., 0] + 1j * points[..., 1]) * np.exp(-1j * data.truth[:, None, 2])
    visible = (np.abs(frame) <= 12) & (np.abs(np.angle(frame)) <= np.pi / 2)
    visible[0] = False
    step, landmark = np.nonzero(visible)
    np.testing.assert_array_equal(step, data.observations.step)
    np.testing.assert_array_equal(landmark, data.true_landmark)
    values = np.column_stack([np.abs(frame[visible]), np.angle(frame[visible])])
    np.testing.assert_allclose(data.observations.values, values, atol=1e-9)


def test_the_same_seed_gives_the_same_bytes():
    one, again, other = (
        simulate(load_scenario("city", {"world.count": 300}), seed=s) for s in (5, 5, 6)
    )
    assert one.observations.values.tobytes() == again.observations.values.tobytes()
    assert one.robot.controls.tobytes() == again.robot.controls.tobytes()
    np.testing.assert_array_equal(one.true_map.positions, other.true_map.positions)
    assert (one.observations.values != other.observations.values).all()


@pytest.mark.parametrize("association", ["known", "nearest"])
def test_a_filter_finds_its_way_through_the_city(association):
    data = simulate(load_scenario("city", {"world.count": 300}), seed=1)
    estimate = ekfslam.estimate(data, "ekf", association=association)
    error = geo.additive_error(data.truth, estimate.online.poses)
    sigmas = np.sqrt(np.diagonal(estimate.online.covariances, axis1=1, axis2=2))
    assert np.abs(error[:, :2]).max() < 3
    assert (np.abs(error[1:]) < 8 * sigmas[1:]).all()
    assert len(estimate.landmarks.positions) == 300
