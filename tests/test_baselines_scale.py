"""What smoothers ask and keep on a large map: no more for each step than there is new in it."""

from __future__ import annotations

import weakref
from collections import Counter
from dataclasses import fields, is_dataclass

import gtsam
import numpy as np
import psutil
import pytest
from corridor import corridor
from problems import near

from baselines import batch, selected_inverse
from baselines.association import Association
from baselines.batch import GtsamBatch
from baselines.entry import Entrance, all_at_once, located
from baselines.fixed_lag import GtsamFixedLag
from baselines.isam2 import GtsamIsam2
from baselines.landmark_graph import LandmarkGraph
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.estimates import OK
from ekfslam.simulation import simulate

SHORT, LONG = 60, 120  # steps
LINEAR = 2.4  # what is twice as long may take, with ends; what is quadratic takes 4 times as much


class Watched:
    """iSAM2 that counts what it is asked, and what it is given."""

    def __init__(self, isam, counts):
        self._isam, self._counts = isam, counts

    def update(self, *new):
        for what, part in zip(("factors", "variables"), new, strict=False):
            self._counts[what] += part.size()
            self._counts[f"most {what}"] = max(self._counts[f"most {what}"], part.size())
        self._isam.update(*new)

    def __getattr__(self, name):
        self._counts[name] += 1
        return getattr(self._isam, name)


@pytest.fixture
def counts(monkeypatch):
    """Of an iSAM2 that is made from here on."""
    counted, isam2 = Counter(), gtsam.ISAM2
    monkeypatch.setattr(gtsam, "ISAM2", lambda parameters: Watched(isam2(parameters), counted))
    return counted


@pytest.mark.parametrize("every", [1, 10])
def test_isam2_is_given_each_thing_once_and_asked_for_the_newest_pose(counts, every):
    dataset = corridor(SHORT)
    estimate = GtsamIsam2(marginal_every=every).estimate(dataset)
    assert estimate.status == OK
    landmarks, rows = len(estimate.landmarks), len(dataset.observations)
    assert counts["variables"] == dataset.poses + landmarks
    assert counts["factors"] == dataset.poses + rows
    assert counts["most factors"] <= 1 + np.bincount(dataset.observations.step).max()
    assert counts["calculateEstimatePose2"] == dataset.poses
    assert counts["calculateEstimate"] == 1
    assert counts["marginalCovariance"] == len(set(range(0, dataset.poses, every)) | {SHORT})


def test_the_smoother_is_asked_nothing_else_without_covariances(counts):
    GtsamIsam2(marginals=False).estimate(corridor(SHORT))
    asked = {name for name in counts if name not in ("factors", "variables")}
    asked -= {"most factors", "most variables"}
    assert asked == {"calculateEstimatePose2", "calculateEstimate"}


def size_of(record):
    """Bytes of all arrays in a record."""
    if isinstance(record, np.ndarray):
        return record.nbytes
    if not is_dataclass(record):
        return 0
    return sum(size_of(getattr(record, entry.name)) for entry in fields(record))


@pytest.mark.parametrize("smoother", [GtsamIsam2(), GtsamBatch()], ids=lambda s: s.name)
def test_an_estimate_is_as_large_as_the_run(smoother):
    """A joint covariance of the map would be as large as its square."""
    short, long = (smoother.estimate(corridor(steps)) for steps in (SHORT, LONG))
    assert long.landmarks.covariances.shape == (len(long.landmarks), 2, 2)
    assert long.joint_covariance is long.landmarks.covariance is None
    assert size_of(long) < LINEAR * size_of(short)


def test_covariances_of_all_take_entries_like_the_run(monkeypatch):
    entries, analysed = [], selected_inverse.analysed

    def watched(*arguments):
        shape = analysed(*arguments)
        entries.append(shape.begin[-1])
        return shape

    for steps in (SHORT, LONG):
        dataset = corridor(steps)
        start = near(dataset)
        GtsamBatch(initial=start).estimate(dataset)  # compiles
        monkeypatch.setattr(selected_inverse, "analysed", watched)
        GtsamBatch(initial=start).estimate(dataset)
        monkeypatch.undo()
    assert len(entries) == 4
    assert entries[3] < LINEAR * entries[1]


def test_the_map_of_the_start_is_let_go_before_the_batch_runs(monkeypatch):
    """Of thousands of landmarks an EKF's joint covariance is a gigabyte."""
    dataset, starts, alive = corridor(SHORT), [], []
    solve = GtsamBatch.solve

    class Start:
        name = "start"

        def estimate(self, dataset):
            start = near(dataset)
            starts.append(weakref.ref(start))
            return start

    def watched(self, *arguments):
        alive.append(starts[0]() is not None)
        return solve(self, *arguments)

    monkeypatch.setattr(GtsamBatch, "solve", watched)
    assert GtsamBatch(initial=Start()).estimate(dataset).status == OK
    assert alive == [False]


@pytest.mark.parametrize("smoother", [GtsamIsam2(), GtsamFixedLag(lag=3)], ids=lambda s: s.name)
def test_progress_is_told_on_the_way(smoother):
    told = []
    dataset = corridor(LONG)
    smoother.estimate(dataset, lambda done, of: told.append((done, of)))
    assert [of for _, of in told] == [dataset.poses] * len(told)
    assert [done for done, _ in told] == [0, 50, 100]


# Landmarks that wait --------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cloister-bearing", "two-sensors", "team"])
def test_all_at_once_is_each_by_itself(name):
    dataset = simulate(name, seed=2)
    problem = LandmarkGraph(dataset, Association.known(dataset))
    poses = np.array([robot.truth for robot in dataset.robots])
    o = dataset.observations
    none = near(dataset).landmarks
    none = type(none)(none.ids[:0], none.positions[:0])
    entry, positions = all_at_once(problem, poses, none)
    for landmark in np.unique(o.landmark[o.landmark >= 0]).tolist():
        rows = np.flatnonzero(o.landmark == landmark).tolist()
        expected = located(dataset, rows, lambda rows: poses[o.robot[rows], o.step[rows]])
        assert (landmark in entry) == (expected is not None)
        if expected is not None:
            assert entry[landmark] == rows[0]
            np.testing.assert_array_equal(positions[landmark], expected)


def test_what_was_given_up_is_looked_at_no_more():
    """Landmarks that were seen once, long ago, would be gone through at every step."""
    dataset = simulate("cloister-bearing", seed=2)
    problem = LandmarkGraph(dataset, Association.known(dataset))
    o, truth = dataset.observations, dataset.robot.truth
    entrance = Entrance(problem)
    given_up = []
    for k in range(20):
        entrance.forget(k)
        given_up += [row for row in entrance.lost if row not in given_up]
        assert not entrance._kept
        own = range(*dataset.offsets[k : k + 2])
        entrance.arrive(own, lambda rows: truth[o.step[rows]])
        assert len(entrance._kept) == len(own)
    assert given_up == list(range(dataset.offsets[19]))


# What is too large ------------------------------------------------------------------------------


def test_a_window_of_too_many_landmarks_is_refused():
    dataset = corridor(SHORT)
    count = len(np.unique(dataset.observations.landmark))
    refused = rf"{count} landmarks are more than max_landmarks={count - 1}: .* take gtsam-isam2"
    with pytest.raises(UnsupportedError, match=refused):
        GtsamFixedLag(max_landmarks=count - 1).estimate(dataset)
    assert GtsamFixedLag(max_landmarks=count).estimate(dataset).status == OK
    with pytest.raises(InputError, match="max_landmarks must be a whole number from 1"):
        GtsamFixedLag(max_landmarks=0)


def test_a_window_that_does_not_fit_is_refused_with_its_size(monkeypatch):
    dataset = corridor(SHORT)
    count = len(np.unique(dataset.observations.landmark))
    square = 8 * (2 * count) ** 2
    memory = psutil.virtual_memory()._replace(available=8 * square)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: memory)
    refused = rf"a window with {count} landmarks needs \S+ .B, \S+ .B are free: take gtsam-isam2"
    with pytest.raises(UnsupportedError, match=refused):
        GtsamFixedLag().estimate(dataset)
    assert GtsamFixedLag(marginals=False).estimate(dataset).status == OK


def test_the_joint_covariance_is_symmetric_to_the_last_bit():
    joint = GtsamFixedLag(lag=3).estimate(simulate("team", seed=1)).joint_covariance
    np.testing.assert_array_equal(joint, joint.T)


def test_the_start_of_a_large_map_is_the_compressed_filters(monkeypatch):
    """The same estimate as the full filter's, so that the smoother ends where it would have."""
    data = corridor(SHORT)
    plain = GtsamBatch().estimate(data)
    assert "from ekf;" in f"{plain.message};"
    monkeypatch.setattr(batch, "LARGE", 10)
    started = GtsamBatch().estimate(data)
    assert "from ekf-compressed" in started.message
    assert started.options["initial"] == "ekf-compressed"
    np.testing.assert_allclose(started.smoothed.poses, plain.smoothed.poses, atol=1e-9)
    bearings = simulate("cloister-bearing", seed=1)
    assert "from ekf;" in f"{GtsamBatch().estimate(bearings).message};"
