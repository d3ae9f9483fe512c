"""Clutter, mistaken identities and descriptors: their statistics, and that they disturb nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numerics import assert_sampled
from numpy.testing import assert_allclose, assert_array_equal
from simulated import exact_values, trio

from ekfslam import geometry as geo
from ekfslam.dataset import LandmarkMap
from ekfslam.errors import InputError
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import Scenario, simulate

FIELD = np.deg2rad(200)


def walk(steps: int = 400, kind: str = "range-bearing", **changes) -> Scenario:
    """A robot on a circle among ten landmarks, of which it sees those near by."""
    size = 1 if kind in ("bearing", "range") else 2
    angles = np.arange(10) * np.pi / 5
    sensor = Sensor(
        kind, 1e-4 * np.eye(size), [0.3, 0, 0.5], min_range=1.0, max_range=6.0, field_of_view=FIELD
    )
    scenario = Scenario(
        name="walk",
        landmarks=LandmarkMap(
            np.arange(10) * 3 + 1, 5 * np.column_stack([np.cos(angles), np.sin(angles)])
        ),
        start=[3.0, 0.0, np.pi / 2],
        controls=np.tile([0.3, 0.0, 0.1], (steps, 1)),
        motion=MotionModel("odometry", 1e-4 * np.eye(3)),
        sensors=(sensor,),
    )
    return replace(scenario, **changes)


def real(data):
    """Rows that are no clutter."""
    return (data.true_landmark >= 0) | (data.observed_robot >= 0)


def assert_uniform(samples, bins=20):
    """Chi-square of a histogram over [0, 1) below its quantile of 0.9999 (about 50.8)."""
    counts = np.histogram(samples, bins, range=(0, 1))[0]
    assert counts.sum() == len(samples)
    expected = len(samples) / bins
    assert ((counts - expected) ** 2 / expected).sum() < 50.8


# Clutter ---------------------------------------------------------------------------------------


def test_clutter_in_a_look_is_poisson():
    data = simulate(walk(20_000, clutter=1.3), seed=1)
    spurious = data.observations.step[~real(data)]
    counts = np.bincount(spurious, minlength=data.poses)[1:]
    assert_sampled((counts - 1.3)[:, None], [[1.3]])
    # A fourth moment of mu (1 + 3 mu) tells it from other laws of that mean and variance.
    assert np.mean(counts == 0) == pytest.approx(np.exp(-1.3), abs=5 * np.sqrt(0.2 / 20_000))
    assert len(spurious) == pytest.approx(1.3 * 20_000, abs=5 * np.sqrt(1.3 * 20_000))


@pytest.mark.parametrize("kind", ["range-bearing", "xy", "bearing", "range"])
def test_clutter_is_uniform_over_the_visible_area(kind):
    data = simulate(walk(20_000, kind, clutter=1.0), seed=2)
    values = data.observations.values[~real(data)]
    if kind == "xy":
        values = np.column_stack([np.hypot(*values.T), np.arctan2(values[:, 1], values[:, 0])])
    if kind != "bearing":
        area = (values[:, 0] ** 2 - 1) / (6**2 - 1)
        assert_uniform(area)
    if kind != "range":
        bearing = values[:, 0 if kind == "bearing" else 1]
        assert_uniform(bearing / FIELD + 0.5)
    if kind in ("xy", "range-bearing"):
        assert abs(np.corrcoef(area, bearing)[0, 1]) < 5 / np.sqrt(len(values))
    else:
        assert not values[:, 1].any()


def test_clutter_all_around_is_in_every_direction():
    sensor = Sensor("bearing", [[1e-4]])
    data = simulate(walk(20_000, sensors=(sensor,), clutter=1.0), seed=2)
    assert_uniform(data.observations.values[~real(data), 0] / geo.TAU + 0.5)


def test_clutter_carries_no_identity_and_stands_for_nothing():
    data = simulate(walk(clutter=0.5), seed=1)
    spurious = ~real(data)
    assert spurious.any()
    assert (data.observations.landmark[spurious] == -1).all()
    assert_array_equal(data.observations.landmark[~spurious], data.true_landmark[~spurious])


def test_clutter_changes_no_other_draw():
    changes = {"descriptors": [0.1] * 9, "descriptor_sigma": 0.1}
    clean = simulate(trio(**changes, wrong_ids=0.2), seed=5)
    cluttered = simulate(trio(**changes, wrong_ids=0.2, clutter=0.7), seed=5)
    kept = real(cluttered)
    assert (~kept).sum() > 50
    assert_array_equal(cluttered.true_landmark[kept], clean.true_landmark)
    for name in ("step", "robot", "sensor", "landmark", "observed_robot", "values", "descriptor"):
        mine, theirs = (getattr(data.observations, name) for data in (cluttered, clean))
        assert_array_equal(mine[kept], theirs, err_msg=name)
    for mine, theirs in zip(cluttered.robots, clean.robots, strict=True):
        assert_array_equal(mine.controls, theirs.controls)
        assert_array_equal(mine.truth, theirs.truth)


def test_every_sensor_of_every_robot_has_clutter_of_its_own_when_it_looks():
    data = simulate(trio(300, clutter=0.7), seed=5)
    o = data.observations
    spurious = ~real(data)
    pairs = {(r, s) for r, s in zip(o.robot[spurious], o.sensor[spurious], strict=True)}
    assert pairs == {(0, 0), (1, 0), (2, 0), (1, 1)}
    camera = spurious & (o.sensor == 1)
    assert (o.step[camera] % 3 == 1).all()
    steps = [o.step[spurious & (o.robot == r) & (o.sensor == 0)].tolist() for r in range(3)]
    assert steps[0] != steps[1] != steps[2]
    assert 0 not in steps[0]


def test_clutter_is_the_same_whatever_the_noise():
    full = simulate(walk(clutter=0.5), seed=1)
    quiet = simulate(walk(clutter=0.5), seed=1, noise=0.5, draw=0.0)
    some, other = (data.observations.values[~real(data)] for data in (full, quiet))
    assert_array_equal(some, other)


@pytest.mark.parametrize("kind", ["range-bearing", "xy", "range"])
def test_clutter_needs_an_end_of_sight(kind):
    endless = replace(walk(kind=kind).sensors[0], max_range=np.inf, name="eye")
    with pytest.raises(InputError, match="clutter needs a max_range of eye"):
        walk(sensors=(endless,), clutter=0.1)
    assert not walk(sensors=(endless,)).clutter


# Wrong identities ------------------------------------------------------------------------------


def looks_of(data):
    """Row numbers of each look."""
    o = data.observations
    keys = np.column_stack([o.step, o.robot, o.sensor])
    for key in np.unique(keys, axis=0):
        yield np.flatnonzero((keys == key).all(axis=1))


def test_a_share_of_the_sightings_carries_the_identity_of_another():
    data = simulate(walk(4000, wrong_ids=0.1), seed=1)
    wrong = data.observations.landmark != data.true_landmark
    count = len(wrong)
    assert wrong.mean() == pytest.approx(0.1, abs=5 * np.sqrt(0.09 / count))
    assert set(data.observations.landmark[wrong].tolist()) == set(data.true_map.ids.tolist())


def test_only_the_identity_is_wrong():
    right, wrong = simulate(walk(), seed=1), simulate(walk(wrong_ids=0.3), seed=1)
    assert_array_equal(wrong.observations.values, right.observations.values)
    assert_array_equal(wrong.true_landmark, right.true_landmark)
    assert_array_equal(wrong.robot.controls, right.robot.controls)
    assert right.association_known
    assert wrong.association_known


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_a_wrong_identity_is_of_a_landmark_that_is_not_in_the_look(share):
    data = simulate(walk(100, wrong_ids=share), seed=1)
    for rows in looks_of(data):
        named, true = data.observations.landmark[rows], data.true_landmark[rows]
        assert len(set(named.tolist())) == len(named)
        assert not set(named[named != true].tolist()) & set(true.tolist())
        if share == 1:  # all that can: of ten landmarks, as many are left as are not in the look
            assert (named != true).sum() == min(len(rows), 10 - len(rows))
    assert (data.observations.landmark != data.true_landmark).any()


def test_every_other_landmark_is_as_likely():
    """One landmark in sight, nine others: each is taken for it as often as any other."""
    scenario = walk(9000, wrong_ids=1.0)
    positions = np.array(scenario.landmarks.positions)
    positions[1:] += 100.0
    positions[0] = [1.5, 2.5]
    landmarks = LandmarkMap(scenario.landmarks.ids, positions)
    sensor = Sensor("xy", np.eye(2), max_range=50.0)
    data = simulate(replace(scenario, landmarks=landmarks, sensors=(sensor,)), seed=1)
    assert set(data.true_landmark.tolist()) == {1}
    counts = np.bincount(data.observations.landmark)[4::3]
    assert counts.sum() == 9000
    assert ((counts - 1000) ** 2 / 1000).sum() < 31.8  # chi-square of 8 dof at 0.9999


def test_robots_are_not_mistaken():
    data = simulate(trio(wrong_ids=0.2), seed=1)
    mutual = data.observed_robot >= 0
    assert (data.observations.landmark[mutual] == -1).all()
    assert (data.observations.landmark != data.true_landmark).any()


def test_an_error_where_no_landmark_is_ever_left_to_be_taken_for():
    everything = Sensor("xy", np.eye(2))
    with pytest.raises(InputError, match="wrong_ids: every look holds all landmarks"):
        simulate(walk(sensors=(everything,), wrong_ids=1.0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"clutter": -0.1}, "clutter must be a non-negative mean"),
        ({"clutter": np.nan}, "clutter must be a non-negative mean"),
        ({"wrong_ids": 1.1}, "wrong_ids must be a share from 0 to 1"),
        ({"wrong_ids": np.nan}, "wrong_ids must be a share from 0 to 1"),
        ({"wrong_ids": 0.1, "association": "unknown"}, "wrong_ids needs sightings that carry"),
        ({"descriptors": [0.1, 0.2]}, r"descriptors must have shape \(10,\)"),
        ({"descriptors": [np.nan] * 10}, "descriptors holds NaN"),
        ({"descriptor_sigma": 0.1}, "descriptor_sigma needs descriptors of the world"),
        (
            {"descriptors": [0.1] * 10, "descriptor_sigma": -0.1},
            "descriptor_sigma must not be negative",
        ),
    ],
)
def test_outliers_that_make_no_sense(changes, message):
    with pytest.raises(InputError, match=message):
        walk(**changes)


# Descriptors -----------------------------------------------------------------------------------

DIAMETERS = np.linspace(0.1, 0.55, 10)


def test_sightings_carry_the_landmarks_descriptor_with_its_noise():
    data = simulate(walk(4000, descriptors=DIAMETERS, descriptor_sigma=0.02), seed=1)
    true = DIAMETERS[(data.true_landmark - 1) // 3]
    noise = (data.observations.descriptor - true)[:, None]
    assert_sampled(noise, [[0.02**2]])
    pair = np.hstack([noise / 0.02, (data.observations.values - exact_values(data)) / 0.01])
    assert_sampled(pair, np.eye(3))
    assert_array_equal(data.sightings.descriptor, data.observations.descriptor)
    exact = simulate(walk(descriptors=DIAMETERS, descriptor_sigma=0.02), seed=1, draw=0.0)
    assert_allclose(exact.observations.descriptor, DIAMETERS[(exact.true_landmark - 1) // 3])


def test_descriptors_change_no_other_draw():
    without, described = simulate(walk(), seed=1), simulate(walk(descriptors=DIAMETERS), seed=1)
    assert without.observations.descriptor is None
    assert_array_equal(without.observations.values, described.observations.values)


def test_clutter_looks_like_some_landmark_and_a_robot_like_none():
    changes = {"descriptors": [0.1, 0.2, 0.3] * 3, "clutter": 0.5}
    data = simulate(trio(300, **changes), seed=1)
    described = data.observations.descriptor
    assert set(described[~real(data)].tolist()) == {0.1, 0.2, 0.3}
    assert np.isnan(described[data.observed_robot >= 0]).all()
    assert np.isfinite(described[data.true_landmark >= 0]).all()
