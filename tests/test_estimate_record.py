"""The estimate: its series, and that it survives a file without loss."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from numerics import assert_same_record
from numpy.testing import assert_array_equal

from ekfslam.estimates import (
    Decision,
    Estimate,
    Innovations,
    LandmarkEstimates,
    Trajectory,
)

STEPS, LANDMARKS, OPEN, ROWS = 4, 2, 1, 5


@pytest.fixture
def full(rng):
    """An estimate in which every field is set; awkward numbers included."""

    def draw(*shape):
        return rng.normal(size=shape)

    innovation = draw(ROWS, 2)
    innovation[0] = np.nan
    poses = draw(STEPS, 3)
    poses[0] = [-0.0, 5e-324, 1 / 3]
    return Estimate(
        estimator="filter",
        dataset="world",
        association="known",
        online=Trajectory(poses, draw(STEPS, 3, 3)),
        smoothed=Trajectory(draw(STEPS, 3)),
        landmarks=LandmarkEstimates(
            np.array([3, 2**60]),
            draw(LANDMARKS, 2),
            draw(LANDMARKS, 2, 2),
            draw(2 * LANDMARKS, 2 * LANDMARKS),
            np.array([9]),
            draw(OPEN, 4),
        ),
        joint_covariance=draw(*2 * (3 + 2 * LANDMARKS + 4 * OPEN,)),
        innovations=Innovations(
            np.array([Decision.NEW, Decision.DELAYED, Decision.TENTATIVE, Decision.AMBIGUOUS, 0]),
            np.array([3, 3, -1, -1, 2**60]),
            innovation,
            draw(ROWS, 2, 2),
        ),
        step_nis=draw(STEPS),
        step_dof=np.arange(STEPS),
        step_seconds=draw(STEPS) ** 2,
        effective_samples=1 + draw(STEPS) ** 2,
        time_total=0.1 + 0.2,
        time_marginals=1e-300,
        graph_error=float("inf"),
        graph_dof=17,
        status="diverged",
        message="lost at step 3: é, 'quoted'",
        options={"gate": 0.99, "joint": True, "association": "known", "nothing": None},
    )


def round_trip(estimate, tmp_path):
    estimate.save(tmp_path / "estimate.npz")
    return Estimate.load(tmp_path / "estimate.npz")


def test_every_field_survives_the_file_bit_for_bit(full, tmp_path):
    assert_same_record(round_trip(full, tmp_path), full)


def test_what_is_missing_stays_missing(tmp_path):
    bare = Estimate("filter", "world", status="failed", message="it broke")
    assert_same_record(round_trip(bare, tmp_path), bare)


def test_each_part_alone_survives_the_file(full, tmp_path):
    for name in ("online", "smoothed", "landmarks", "innovations"):
        alone = Estimate("filter", "world", **{name: getattr(full, name)})
        assert_same_record(round_trip(alone, tmp_path), alone)


def test_poses_of_several_robots_survive_the_file(tmp_path, rng):
    team = Estimate(
        "filter", "world", online=Trajectory(rng.normal(size=(3, 4, 3)), np.ones((3, 4, 3, 3)))
    )
    assert_same_record(round_trip(team, tmp_path), team)


def test_poses_of_one_robot_of_several(rng):
    team = Trajectory(rng.normal(size=(3, STEPS, 3)), rng.normal(size=(3, STEPS, 3, 3)))
    for robot in range(3):
        one = team.of_robot(robot)
        assert_array_equal(one.poses, team.poses[robot])
        assert_array_equal(one.covariances, team.covariances[robot])
        assert one.of_robot(robot) is one  # nothing to choose from
    assert Trajectory(team.poses).of_robot(1).covariances is None


def test_empty_arrays_survive_the_file(tmp_path):
    empty = Estimate(
        "filter",
        "world",
        landmarks=LandmarkEstimates(
            np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 0))
        ),
    )
    assert_same_record(round_trip(empty, tmp_path), empty)


def test_numbers_of_numpy_among_the_options_can_be_saved(tmp_path):
    estimate = Estimate("f", "d", options={"count": np.int64(3), "gate": np.float64(0.5)})
    assert round_trip(estimate, tmp_path).options == {"count": 3, "gate": 0.5}


def test_series_and_the_one_that_knows_most(full):
    assert list(full.series) == ["online", "smoothed"]
    assert full.final_trajectory is full.smoothed
    online = Estimate("f", "d", online=full.online)
    assert list(online.series) == ["online"]
    assert online.final_trajectory is full.online
    none = Estimate("f", "d")
    assert none.series == {}
    assert none.final_trajectory is None


def test_lengths(full):
    assert len(full.landmarks) == LANDMARKS
    assert len(full.innovations) == ROWS


def test_decisions_are_the_numbers_in_files():
    """Files hold these numbers: changing one needs a new format version."""
    assert [decision.value for decision in Decision] == [0, 1, 2, 3, 4, 5]
    names = ["ACCEPTED", "NEW", "REJECTED", "AMBIGUOUS", "TENTATIVE", "DELAYED"]
    assert [decision.name for decision in Decision] == names


@pytest.mark.parametrize("loaded", [False, True])
def test_arrays_are_read_only(full, loaded, tmp_path):
    estimate = round_trip(full, tmp_path) if loaded else full
    for array in (
        estimate.online.poses,
        estimate.online.covariances,
        estimate.landmarks.ids,
        estimate.landmarks.positions,
        estimate.landmarks.covariances,
        estimate.landmarks.covariance,
        estimate.landmarks.undetermined,
        estimate.landmarks.inverse_depth,
        estimate.innovations.decision,
        estimate.innovations.innovation,
        estimate.innovations.S,
        estimate.joint_covariance,
        estimate.step_nis,
        estimate.step_dof,
        estimate.step_seconds,
    ):
        before = array.copy()
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        assert_array_equal(array, before)


def test_attributes_cannot_be_set(full):
    for record in (full, full.online, full.landmarks, full.innovations):
        with pytest.raises(FrozenInstanceError):
            record.status = "ok"
