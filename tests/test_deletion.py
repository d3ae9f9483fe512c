"""Landmarks leave the map: by request, unseen where they should be, or corrupted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from problems import first_steps, rows_kept
from stepwise import assert_same_bits, slam_of
from textbook import two_sensors

from ekfslam import EkfSlam
from ekfslam.dataset import Prior, Sightings
from ekfslam.errors import InputError
from ekfslam.estimates import Decision
from ekfslam.filters.ekf import Ekf
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import simulate

XY = Sensor("xy", np.diag([0.01, 0.01]))
AHEAD = Sensor("xy", np.diag([1e-4, 1e-4]), max_range=5.0, field_of_view=np.pi / 2)
STILL = np.zeros(3), np.zeros((3, 3))
NEW, ACCEPTED, REJECTED = (int(Decision[n]) for n in ("NEW", "ACCEPTED", "REJECTED"))


# By request ---------------------------------------------------------------------------------------


@cache
def drawn(name):
    """A scenario, cut to where the test of it needs it."""
    if name == "pair":
        return simulate(two_sensors(), seed=1)
    return first_steps(simulate(name, seed=1), 80)


def joint(slam, robots, ids=(), directions=()):
    """Joint mean and covariance of poses, points, and inverse depths of given identities."""
    engine = slam._engine
    landmarks, covariance = engine.landmarks(slam._names())
    open_ids = [] if landmarks.undetermined is None else list(landmarks.undetermined)
    at = [list(landmarks.ids).index(i) for i in ids]
    beyond = [open_ids.index(i) for i in directions]
    first = 3 * robots + 2 * len(landmarks)
    rows = [np.arange(3 * robots)]
    rows += [3 * robots + 2 * i + np.arange(2) for i in at]
    rows += [first + 4 * i + np.arange(4) for i in beyond]
    rows = np.concatenate(rows)
    parts = [slam.pose.reshape(-1), landmarks.positions[at].reshape(-1)]
    if beyond:
        parts.append(landmarks.inverse_depth[beyond].reshape(-1))
    return np.concatenate(parts), covariance[np.ix_(rows, rows)]


# Which landmarks go, by the order of their places in the state.
CASES = [
    ("pair", 20, [0]),
    ("pair", 20, [-1]),
    ("pair", 20, [1, 2, 4]),
    ("team", 20, [0]),
    ("team", 20, [-1]),
    ("team", 20, [1, 5, 6, -1]),
    ("team", 50, [12]),
    ("two-sensors", 6, [0]),
    ("two-sensors", 6, [1, 2, -1]),
    ("two-sensors", 20, [3, 4]),
    ("cloister-bearing", 3, [0, 4, 20]),
    ("cloister-bearing", 30, [2]),
    ("cloister-range", 40, [5, -1]),
]


@pytest.mark.parametrize("update", ["joint", "sequential"])
@pytest.mark.parametrize(("name", "step", "places"), CASES)
def test_the_rest_is_as_if_the_landmark_were_kept_and_never_used_again(name, step, places, update):
    """Solà, Table 1: to delete is to marginalise, and the trajectory goes on as it would."""
    dataset = drawn(name)
    removed, kept = (slam_of(dataset, update=update) for _ in range(2))
    robots, gone = len(dataset.robots), None
    for k, now in enumerate(dataset.steps()):
        if k == step:
            offsets = kept._engine.register.offsets[: len(kept._names())]
            in_order = np.argsort(offsets)[(offsets < 0).sum() :]
            gone = kept._names()[in_order[places]]
            for landmark in gone:
                removed.delete(int(landmark))
        seen = now.observations
        if gone is not None:
            seen = Sightings(*(column[~np.isin(seen.landmark, gone)] for column in seen))
        for slam in (removed, kept):
            slam.predict(now.increment, now.covariance)
        met = [slam.observe(seen) for slam in (removed, kept)]
        np.testing.assert_array_equal(met[0].decision, met[1].decision)
        np.testing.assert_allclose(removed.pose, kept.pose, rtol=0, atol=1e-9)
    ids = removed.landmarks.ids
    assert not np.isin(gone, ids).any()
    open_ids = [removed.landmarks.undetermined, kept.landmarks.undetermined]
    open_ids = [np.zeros(0, int) if i is None else i for i in open_ids]
    assert set(ids) | set(open_ids[0]) | set(gone) == set(kept.landmarks.ids) | set(open_ids[1])
    (mean, P), (other, Q) = (joint(slam, robots, ids, open_ids[0]) for slam in (removed, kept))
    np.testing.assert_allclose(mean, other, rtol=0, atol=1e-9)
    np.testing.assert_allclose(P, Q, rtol=0, atol=1e-9 * np.abs(Q).max())


def test_to_delete_is_the_marginal_to_the_bit():
    dataset = drawn("team")
    slam = slam_of(dataset)
    for step in list(dataset.steps())[:30]:
        slam.predict(step.increment, step.covariance)
        slam.observe(step.observations)
    ids = slam.landmarks.ids
    rest = np.delete(ids, [1, 4, len(ids) - 1])
    mean, P = joint(slam, 3, rest)
    for landmark in np.setdiff1d(ids, rest):
        slam.delete(int(landmark))
    np.testing.assert_array_equal(slam.landmarks.ids, rest)
    np.testing.assert_array_equal(joint(slam, 3, rest)[0], mean)
    np.testing.assert_array_equal(joint(slam, 3, rest)[1], P)


@pytest.mark.parametrize("association", ["known", "nearest"])
def test_seen_again_it_starts_anew(association):
    slam = EkfSlam(association=association)
    look = Sightings.of(XY, [[4.0, 0.0], [0.0, 9.0], [9.0, 9.0]], [7, 8, 9])
    slam.observe(look)
    slam.observe(look)
    before = slam.landmarks
    slam.delete(int(before.ids[1]))
    met = slam.observe(look)
    assert met.decision.tolist() == [ACCEPTED, NEW, ACCEPTED]
    after = slam.landmarks
    at = list(after.ids).index(met.landmark[1])
    np.testing.assert_allclose(after.covariances[at], 0.01 * np.eye(2), rtol=1e-12)
    # Of the filter's own numbers none is given twice.
    assert after.ids.tolist() == ([7, 8, 9] if association == "known" else [0, 2, 3])


@pytest.mark.parametrize("association", ["known", "nearest"])
def test_memory_is_used_again(association):
    """Many landmarks come and go, of which ten at a time are in the map."""
    slam, sizes = EkfSlam(association=association), []
    for cycle in range(60):
        points = np.column_stack([np.arange(10) + 3.0, np.full(10, 5.0 * cycle)])
        met = slam.observe(Sightings.of(XY, points, 10 * cycle + np.arange(10)))
        assert (met.decision == NEW).all()
        sizes.append((slam._engine.slam.size, len(slam._engine.slam.arrays.mean)))
        for landmark in met.landmark:
            slam.delete(int(landmark))
    assert len(slam.landmarks) == 0
    assert set(sizes) == {(23, sizes[0][1])}
    np.testing.assert_array_equal(slam.pose_covariance, 0)


@pytest.mark.parametrize("landmark", [3, -1, 8])
def test_what_is_not_in_the_map_cannot_be_deleted(landmark):
    slam = EkfSlam()
    slam.observe(Sightings.of(XY, [[4.0, 0.0], [1.0, 1.0]], [7, 8]))
    slam.delete(8)
    with pytest.raises(InputError, match=f"there is no landmark {landmark} in the map"):
        slam.delete(landmark)
    assert slam.landmarks.ids.tolist() == [7]


def test_what_still_waits_is_not_in_the_map():
    dataset = drawn("cloister-range")
    slam = slam_of(dataset)
    for step in list(dataset.steps())[:2]:
        slam.predict(step.increment, step.covariance)
        slam.observe(step.observations)
    with pytest.raises(InputError, match="there is no landmark"):
        slam.delete(int(dataset.observations.landmark[0]))


# Not seen where it should be ----------------------------------------------------------------------


def looks(slam, points, ids, count):
    """Some looks at the same points from where the robot is; how long each landmark lived."""
    lives = dict.fromkeys(slam.landmarks.ids.tolist(), 0)
    for _ in range(count):
        slam.predict(*STILL)
        slam.observe(Sightings.of(AHEAD, points, ids))
        for landmark in slam.landmarks.ids.tolist():
            lives[landmark] = lives.get(landmark, 0) + 1
    return lives


@pytest.mark.parametrize(("forget", "seen"), [(1, 1), (3, 1), (3, 2), (3, 7), (5, 5)])
def test_a_landmark_that_vanished_goes_when_its_evidence_has_run_out(forget, seen):
    """Sightings count up to `forget` and misses against them, down to ``-forget``."""
    slam = EkfSlam(forget=forget)
    looks(slam, [[3.0, 0.0], [4.0, 0.5]], [7, 8], seen)
    lives = looks(slam, [[4.0, 0.5]], [8], 20)
    assert lives[7] == min(seen, forget) + forget - 1
    assert lives[8] == 20


def test_it_never_goes_by_itself_otherwise():
    slam = EkfSlam()
    looks(slam, [[3.0, 0.0], [4.0, 0.5]], [7, 8], 1)
    assert looks(slam, [[4.0, 0.5]], [8], 50)[7] == 50


@pytest.mark.parametrize(
    ("point", "missed"),
    [
        ([3.0, 0.0], True),
        ([4.9, 0.0], True),
        ([4.99, 0.0], False),  # at the far edge: three sigmas are 4 cm
        ([5.2, 0.0], False),
        ([3.0, 2.9], True),
        ([3.0, 2.98], False),  # at the edge of the field of view
        ([3.0, 3.5], False),
        ([-3.0, 0.0], False),
    ],
)
def test_one_at_the_edge_of_the_view_is_not_missed(point, missed):
    """Inside by three sigmas all around, of the landmark and of the robot."""
    slam = EkfSlam(forget=2)
    everywhere = replace(AHEAD, max_range=np.inf, field_of_view=2 * np.pi)
    slam.observe(Sightings.of(everywhere, [point, [4.0, 0.5]], [7, 8]))
    assert (looks(slam, [[4.0, 0.5]], [8], 20)[7] < 20) == missed


def test_one_that_an_uncertain_robot_may_not_see_is_not_missed():
    for variance, gone in ((1e-6, True), (1.0, False)):
        slam = EkfSlam(forget=2)
        slam.observe(Sightings.of(AHEAD, [[3.0, 0.0]], [7]))
        for k in range(12):  # what is seen instead is new: it tells nothing of the robot
            slam.predict(np.zeros(3), np.diag([0, 0, variance]))
            slam.observe(Sightings.of(AHEAD, [[4.0, 0.5]], [100 + k]))
        assert (7 not in slam.landmarks.ids) == gone


def test_one_too_near_to_be_seen_is_not_missed():
    slam = EkfSlam(forget=2)
    blind = replace(AHEAD, min_range=2.0)
    slam.observe(Sightings.of(AHEAD, [[1.5, 0.0], [4.0, 0.5]], [7, 8]))
    for _ in range(10):
        slam.observe(Sightings.of(blind, [[4.0, 0.5]], [8]))
    assert 7 in slam.landmarks.ids


def test_what_another_robot_sees_is_not_missed_by_it():
    """Each look counts for its own robot's view."""
    priors = [Prior(), Prior([0.0, 0.0, np.pi])]
    slam = EkfSlam(priors, forget=2)
    slam.observe(Sightings.of(AHEAD, [[3.0, 0.0], [4.0, 0.5]], [7, 8]))
    for _ in range(20):
        slam.observe(Sightings.of(AHEAD, [[4.0, 0.5]], [9], robot=1))
    assert set(slam.landmarks.ids) == {7, 8, 9}


def vanishing(name, forget):
    """Landmarks that are often seen until the middle, and nowhere afterwards."""
    dataset = simulate(name, seed=1)
    seen, half = dataset.observations, dataset.poses // 2
    before, after = (
        np.unique(seen.landmark[(seen.landmark >= 0) & which], return_counts=True)
        for which in (seen.step < half, seen.step >= half)
    )
    often = [set(ids[counts > 4 * forget]) for ids, counts in (before, after)]
    gone = sorted(often[0] & often[1])[:4]
    keep = (seen.step < half) | ~np.isin(seen.landmark, gone)
    return rows_kept(dataset, keep), np.array(gone)


@pytest.mark.parametrize("matching", ["scan", "one-by-one"])
@pytest.mark.parametrize("association", ["known", "nearest"])
@pytest.mark.parametrize("name", ["loop-15", "team", "park"])
def test_what_vanished_from_a_world_is_forgotten_and_nothing_else(name, association, matching):
    """However a look is matched, it is one look: what any of its sightings shows is not missed."""
    dataset, gone = vanishing(name, 8)
    assert len(gone) == 4
    options = {"association": association, "matching": matching}
    kept = Ekf(**options).estimate(dataset)
    estimate = Ekf(**options, forget=8).estimate(dataset)
    lost = np.setdiff1d(kept.landmarks.ids, estimate.landmarks.ids)
    if association == "known":
        np.testing.assert_array_equal(lost, gone)
    else:
        decision, own = kept.innovations.decision, kept.innovations.landmark
        founded = decision == Decision.NEW
        true = dict(zip(own[founded], dataset.true_landmark[founded], strict=True))
        assert sorted(true[i] for i in lost) == gone.tolist()
    assert_same_bits(estimate, dataset, **options, forget=8)


def test_what_was_forgotten_no_longer_counts_and_what_came_before_does():
    """The trajectory is that of a filter that keeps them: to be missed is no measurement."""
    dataset, _ = vanishing("team", 8)
    kept, forgotten = Ekf().estimate(dataset), Ekf(forget=8).estimate(dataset)
    np.testing.assert_allclose(forgotten.online.poses, kept.online.poses, rtol=0, atol=1e-10)
    for column in ("decision", "landmark"):
        one, other = (getattr(e.innovations, column) for e in (kept, forgotten))
        np.testing.assert_array_equal(one, other)


# Corrupted ----------------------------------------------------------------------------------------


def sight(slam, *points, ids):
    slam.predict(*STILL)
    return slam.observe(Sightings.of(XY, points, ids)).decision.tolist()


@pytest.mark.parametrize("corrupt", [1, 3])
def test_one_that_is_refused_again_and_again_is_corrupted(corrupt):
    """It stood elsewhere when it was mapped: it goes, and comes in where it now is."""
    slam = EkfSlam(known_gate=0.99, corrupt=corrupt)
    here, there = [4.0, 0.0], [4.0, 2.0]
    assert sight(slam, here, [0.0, 9.0], ids=[7, 8]) == [NEW, NEW]
    for _ in range(corrupt):
        assert sight(slam, there, [0.0, 9.0], ids=[7, 8]) == [REJECTED, ACCEPTED]
    assert sight(slam, there, [0.0, 9.0], ids=[7, 8]) == [NEW, ACCEPTED]
    assert sight(slam, there, [0.0, 9.0], ids=[7, 8]) == [ACCEPTED, ACCEPTED]
    at = list(slam.landmarks.ids).index(7)
    np.testing.assert_allclose(slam.landmarks.positions[at], there, atol=1e-12)


def test_in_a_row_means_that_one_good_sighting_forgives():
    slam = EkfSlam(known_gate=0.99, corrupt=3)
    here, there = [4.0, 0.0], [4.0, 2.0]
    assert sight(slam, here, ids=[7]) == [NEW]
    for _ in range(5):
        assert sight(slam, there, ids=[7]) == [REJECTED]
        assert sight(slam, there, ids=[7]) == [REJECTED]
        assert sight(slam, here, ids=[7]) == [ACCEPTED]
    assert slam.landmarks.ids.tolist() == [7]


def test_without_a_count_it_stays_and_without_a_gate_it_is_believed():
    for options, expected in (({"known_gate": 0.99}, REJECTED), ({"corrupt": 2}, ACCEPTED)):
        slam = EkfSlam(**options)
        sight(slam, [4.0, 0.0], ids=[7])
        for _ in range(6):
            assert sight(slam, [4.0, 2.0], ids=[7]) == [expected]
        assert slam.landmarks.ids.tolist() == [7]


def test_a_new_life_has_no_record():
    """Rejections of the life before do not count, nor ranges that were refused while waiting."""
    slam = EkfSlam(known_gate=0.99, corrupt=2)
    places = [[4.0, 2.0 * k] for k in range(4)]
    sight(slam, places[0], ids=[7])
    for place in places[1:]:
        assert [sight(slam, place, ids=[7]) for _ in range(3)] == [[REJECTED], [REJECTED], [NEW]]
    ranges = simulate("cloister-range", seed=1)
    with_count, without = (Ekf(known_gate=0.9999, corrupt=c).estimate(ranges) for c in (1, 0))
    delayed = without.innovations.decision == Decision.DELAYED
    assert delayed.any()
    first = int(np.flatnonzero(without.innovations.decision == NEW)[0])
    np.testing.assert_array_equal(
        with_count.innovations.decision[: first + 1], without.innovations.decision[: first + 1]
    )
