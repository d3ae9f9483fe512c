"""What the benchmark computes: competitors that are right, its data, its fits and its table."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from contenders import Problem, by_dataset, by_step, check_same, in_the_city, on_the_ring
from figure import LIMIT, draw
from growth import exponent
from limit import update_limit
from map_size import Row, bars, exponents, faster, measured
from ratios import COLUMNS, alone, renewed
from textbook_filters import DenseTextbook, JointTextbook, Textbook
from worlds import PER_STEP, RANGE, city, mapped_after, ring, shortened

from ekfslam import geometry as geo
from ekfslam.filters.ekf import Ekf

STEPS = 12


@pytest.fixture(scope="module")
def problem():
    return Problem.of(ring(8, 1 + STEPS + 20))


# Competitors -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "update"),
    [(Textbook, "sequential"), (JointTextbook, "joint"), (DenseTextbook, "joint")],
)
def test_the_textbooks_filters_are_ours(problem, kind, update):
    """Means and whole covariances after a dozen steps, and after one that sees nothing."""
    slam = kind(problem.mean, problem.covariance)
    for step in problem.steps[problem.mapped : problem.mapped + STEPS]:
        slam.step(step.increment, step.covariance, step.observations)
    blind = problem.steps[problem.mapped + STEPS]
    slam.step(blind.increment, blind.covariance, blind.observations.rows(0, 0))
    ours = Ekf(update=update).estimate(shortened(problem.data, STEPS, 1))
    expected = np.concatenate([ours.online.poses[-1], ours.landmarks.positions.ravel()])
    slam.mean[2], expected[2] = geo.wrap(slam.mean[2] - expected[2]), 0.0
    np.testing.assert_allclose(slam.mean, expected, atol=1e-11)
    scale = np.abs(ours.joint_covariance).max()
    np.testing.assert_allclose(slam.covariance, ours.joint_covariance, atol=1e-11 * scale)


def test_joint_and_sequential_are_different_filters(problem):
    """So that a check of one against the other would be seen to fail."""
    joint, sequential = (by_step(kind, problem, STEPS) for kind in (JointTextbook, Textbook))
    with pytest.raises(AssertionError, match="another pose"):
        check_same(on_the_ring(20)[0], joint, sequential)


def test_a_covariance_that_is_off_is_found(problem):
    timing = by_step(Textbook, problem, STEPS)
    other = timing._replace(covariance=timing.covariance * (1 + 1e-7))
    with pytest.raises(AssertionError, match="another covariance"):
        check_same(on_the_ring(20)[0], other, timing)


@pytest.mark.parametrize("name", ["roboticstoolbox", "filterpy"])
def test_peers_compute_the_same(problem, name):
    contender = next(each for each in on_the_ring(20) if each.name == name)
    if not contender.here:
        pytest.skip(f"{name} is not installed: pip install -e '.[bench]'")
    timing = contender.run(problem, STEPS)
    ours = by_dataset(f"ekf(update={contender.update})", problem, STEPS)
    check_same(contender, timing, ours)


# Data --------------------------------------------------------------------------------------------


def test_the_ring_is_mapped_at_once_and_then_seen_five_by_five():
    data = ring(30, 10)
    per_step = np.bincount(data.observations.step)
    assert per_step.tolist() == [0, 30, *[PER_STEP] * 9]
    assert mapped_after(data) == 2
    for step in range(2, 11):
        assert len(set(data.observations.landmark[data.observations.step == step])) == PER_STEP


def test_a_shortened_run_begins_with_the_same_and_ends_blind():
    data = ring(30, 20)
    short = shortened(data, 5, 3)
    assert short.poses == 2 + 5 + 3
    assert short.observations.step.max() == 6
    rows = len(short.observations)
    np.testing.assert_array_equal(short.observations.values, data.observations.values[:rows])
    np.testing.assert_array_equal(short.robot.truth, data.robot.truth[: short.poses])


def test_the_city_is_surveyed_and_then_seen_from_its_streets():
    data = city(250, 40)
    steps, landmarks = data.observations.step, data.observations.landmark
    assert mapped_after(data) == 4  # 250 landmarks, a hundred a step at most
    assert sorted(landmarks[steps < 4]) == list(range(250))
    np.testing.assert_array_equal(data.robot.truth[:4], data.robot.truth[[0] * 4])
    later = steps >= 4
    pose, point = data.robot.truth[steps[later]], data.true_map.positions[landmarks[later]]
    seen = geo.between(pose, np.column_stack([point, np.zeros(len(point))]))
    assert (np.hypot(seen[:, 0], seen[:, 1]) < RANGE).all()
    assert (seen[:, 0] >= -1e-9).all()


# Numbers -----------------------------------------------------------------------------------------


def test_an_exponent_is_recovered():
    sizes = np.array([300, 1000, 2000, 5000])
    assert exponent(sizes, 7e-3 * sizes**1.7) == pytest.approx(1.7, abs=1e-12)
    with pytest.raises(ValueError, match="two sizes"):
        exponent(np.array([300, 300]), np.array([1.0, 2.0]))


def test_the_limit_is_what_an_observation_has_of_a_large_update(monkeypatch):
    """Two rows of 256, of the least of several times: here they take 5, 3 and 4 seconds."""
    ticks = iter([0.0, 5.0, 10.0, 13.0, 20.0, 24.0])
    monkeypatch.setattr("limit.time.perf_counter", lambda: next(ticks))
    assert update_limit(30) == pytest.approx(1e6 * 3.0 * 2 / 256)


# Tables ------------------------------------------------------------------------------------------


def rows(part, *values):
    return pd.DataFrame([[part, *alone(f"{part} {v}", v, "s", 5)] for v in values], columns=COLUMNS)


def test_a_part_renews_its_rows_where_they_stand():
    table = pd.concat([rows("a", 1.0), rows("b", 2.0, 3.0), rows("c", 9.0)], ignore_index=True)
    after = renewed(table, "b", rows("b", 4.0))
    assert after.part.tolist() == ["a", "b", "c"]
    assert after.ours.tolist() == [1.0, 4.0, 9.0]
    assert after.holds.tolist() == [True, True, False]
    assert renewed(table, "d", rows("d", 7.0)).part.tolist() == ["a", "b", "b", "c", "d"]
    assert renewed(table[:0], "d", rows("d", 7.0)).ours.tolist() == [7.0]


def made(problem, estimator, times):
    """Rows of a table where the limit is a microsecond at 1000 landmarks and quadratic."""
    return [
        Row(problem, estimator, n, t, t / 2, t / (n / 1000) ** 2, 10, 3) for n, t in times.items()
    ]


def test_bars_are_ratios_of_what_was_measured():
    table = pd.DataFrame(
        [
            *made("ring", "ekf", {20: 1.0, 100: 2.0, 2000: 100.0}),
            *made("ring", "textbook, joint", {20: 14.9, 2000: 2500.0}),
            *made("city", "textbook, joint", {2000: 52.6}),
            *made("ring", "gtsam-isam2", {100: 3.0}),
            *made("city", "ekf-compressed", {1000: 0.4, 2000: 2.1, 5000: 9.0}),
        ]
    )
    found = {row[0]: row[1:] for row in bars(table)}
    assert found["ring, 20 landmarks: ekf, textbook, joint"][3:] == [14.9, ">= 15", False]
    assert found["city, 2000 landmarks: ekf-compressed, textbook, joint"][-1]
    assert found["ring, 2000 landmarks: ekf, textbook, joint"][-1]
    assert found["ring, 100 landmarks: ekf, gtsam-isam2"][:3] == [10.0, 15.0, "us/step"]
    half = found["city, 2000 landmarks: ekf-compressed, limit of the update"]
    assert half[:2] == pytest.approx([2.1, 4.0])
    assert not half[-1]
    rising = found["city, ekf-compressed over the limit: at 5000 landmarks, at 1000"]
    assert rising[3] == pytest.approx((9.0 / 25) / 0.4)
    assert rising[-1]
    assert len(found) == 6
    assert faster({}, "ring", "ekf", "filterpy", 20, 1) == []


def test_growth_is_fitted_to_large_maps_alone():
    times = {20: 50.0, 300: 3.0**2, 1000: 100.0, 5000: 2500.0}
    (row,) = exponents(pd.DataFrame(made("ring", "ekf", times)))
    assert row[0] == "ring: growth exponent of ekf, 300 to 5000 landmarks"
    assert row[1] == pytest.approx(2.0)


def test_the_figure_has_a_line_for_everyone_measured():
    table = pd.DataFrame(
        [
            *made("ring", LIMIT, {20: 0.1, 100: 1.0}),
            *made("ring", "ekf", {20: 1.0, 100: 2.0}),
            *made("ring", "ekf-ri", {20: 1.5, 100: 3.0}),
            *made("ring", "filterpy", {20: np.nan, 100: np.nan}),
            *made("city", "ekf-compressed", {1000: 0.4, 2000: 2.1}),
        ]
    )
    figure = draw(table)
    names = [[line.get_label() for line in ax.lines] for ax in figure.axes]
    assert names == [[LIMIT, "ekf"], ["ekf-compressed"], ["ekf", "ekf-ri"], [LIMIT, "ekf"]]
    assert {ax.get_xscale() for ax in figure.axes} == {"log"}
    assert {ax.get_yscale() for ax in figure.axes} == {"log"}


def test_who_is_missing_has_a_row_that_says_so(monkeypatch):
    import contenders

    monkeypatch.setattr(contenders, "find_spec", lambda name: None)
    some = [c._replace(steps={20: 3}) for c in on_the_ring(20) if c.name in ("ekf", "filterpy")]
    found = list(measured(ring(20, 30), some))
    assert [row.estimator for row in found] == [LIMIT, "ekf", "filterpy"]
    assert found[1].note == ""
    assert np.isfinite(found[1].us_per_observation)
    assert found[2].note == "not installed"
    assert np.isnan(found[2].us_per_observation)


def test_every_size_of_a_figure_is_measured_by_us():
    assert {c.name for size in (20, 5000) for c in on_the_ring(size)} >= {"ekf", "gtsam-isam2"}
    assert "ekf-compressed" in {c.name for c in in_the_city(2000)}
