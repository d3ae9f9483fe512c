"""The tables of several robots, with sensors that report one number and robots that are seen."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from tabulated import all_tables, assert_schema

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, LandmarkMap, Observations, Prior, Robot
from ekfslam.estimates import Estimate, Innovations, LandmarkEstimates, Trajectory
from ekfslam.evaluation import tables
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

COUNT = 61


@pytest.fixture
def team():
    """Two robots on curves of their own; `far` sees landmark 2 and then `near`; its truth is known.

    Rows: near sees 2 by camera, far sees 6 by compass (a bearing), far sees near, near sees 2 by
    camera and 6 by compass.
    """
    increments = np.tile([0.5, 0.0, 0.05], (COUNT - 1, 1))
    truths = [geo.integrate(start, increments) for start in ([1.0, 2.0, 3.0], [9.0, -4.0, 0.5])]
    motion = MotionModel("odometry", covariance=np.eye(3) * 1e-4)
    return Dataset(
        "team",
        tuple(
            Robot(motion, increments, Prior(truth[0]), truth, name)
            for name, truth in zip(("near", "far"), truths, strict=True)
        ),
        np.arange(COUNT) * 0.1,
        (Sensor("xy", np.eye(2), name="camera"), Sensor("bearing", [[0.01]], name="compass")),
        Observations(
            [1, 1, 2, 2, 2],
            [[1.0, 2.0], [0.1, 0.0], [3.0, 4.0], [1.0, 2.0], [0.3, 0.0]],
            [2, 6, -1, 2, 6],
            sensor=[0, 1, 0, 0, 1],
            robot=[0, 1, 1, 0, 0],
            observed_robot=[-1, -1, 0, -1, -1],
        ),
        true_map=LandmarkMap([2, 6], [[0.0, 5.0], [4.0, 4.0]]),
        true_landmark=[2, 6, -1, 2, 6],
        seed=4,
    )


@pytest.fixture
def joint(team):
    """An estimate of the team: `far` is off by twice as much as `near`."""
    truth = np.stack([robot.truth for robot in team.robots])
    offset = np.array([0.1, 0.2])[:, None, None] * [1.0, 0.0, 0.0]
    covariances = np.tile(np.diag([0.04, 0.01, 1e-4]), (2, COUNT, 1, 1))
    covariances[1] *= 4
    innovation = np.array([[np.nan, np.nan], [np.nan, 0], [0.6, 0.8], [0.3, -0.4], [0.2, 0.0]])
    S = np.tile(np.eye(2), (5, 1, 1))
    S[3], S[4] = np.diag([0.25, 0.16]), [[0.01, 0.0], [0.0, 0.0]]
    S[:2] = np.nan
    step_nis, step_dof = np.full(COUNT, np.nan), np.zeros(COUNT, dtype=int)
    step_nis[2], step_dof[2] = 6.36, 5
    return Estimate(
        "both",
        team.name,
        "known",
        Trajectory(truth + offset, covariances),
        Trajectory(truth + offset / 2, covariances / 4),
        LandmarkEstimates(np.array([2, 6]), np.array([[0.3, 5.4], [4.0, 4.0]])),
        innovations=Innovations(
            np.array([1, 1, 0, 0, 0]), np.array([2, 6, -1, 2, 6]), innovation, S
        ),
        step_nis=step_nis,
        step_dof=step_dof,
        time_total=0.5,
    )


def alone(team, joint, robot):
    """The dataset and the estimate of one robot, with what it saw of landmarks."""
    mine = (team.observations.robot == robot) & (team.observed_robot < 0)
    seen = team.observations
    data = replace(
        team,
        robots=(team.robots[robot],),
        observations=Observations(
            seen.step[mine], seen.values[mine], seen.landmark[mine], seen.sensor[mine]
        ),
        true_landmark=team.true_landmark[mine],
    )
    met = joint.innovations
    innovations = Innovations(
        met.decision[mine], met.landmark[mine], met.innovation[mine], met.S[mine]
    )
    series = {name: s.of_robot(robot) for name, s in joint.series.items()}
    return data, replace(joint, innovations=innovations, **series)


def test_tables_of_several_robots_have_their_columns_and_rows(team, joint, tmp_path):
    made = all_tables(team, joint)
    for name, table in made.items():
        assert_schema(name, table)
        table.to_csv(tmp_path / name, index=False)
        again = tables.read_csv(name, tmp_path / name)
        pd.testing.assert_frame_equal(again, table, check_exact=True, rtol=0, atol=0)
    lengths = {name: len(table) for name, table in made.items()}
    assert lengths == {
        "summary": 2 * 2,
        "trajectories": 2 * 2 * COUNT,
        "landmarks": 2 * 2,
        "innovations": 5,
        "association": 3,
    }
    assert not made["trajectories"].duplicated(["robot", "series", "step"]).any()
    assert made["summary"].robot.tolist() == ["near"] * 2 + ["far"] * 2
    assert made["landmarks"].robot.isna().all()
    assert made["innovations"].robot.tolist() == ["near", "far", "far", "near", "near"]


@pytest.mark.parametrize("robot", [0, 1])
def test_the_rows_of_a_robot_are_those_it_has_alone(team, joint, robot):
    """But for what is of all robots: the map, the joint NIS, and what they saw."""
    name = team.robots[robot].name
    whole, single = all_tables(team, joint), all_tables(*alone(team, joint, robot))
    for table in ("summary", "trajectories"):
        mine = whole[table][whole[table].robot == name].reset_index(drop=True)
        common = ("landmark", "association_", "observations")
        shared = [c for c in mine if c.startswith(common)]
        pd.testing.assert_frame_equal(mine.drop(columns=shared), single[table].drop(columns=shared))
    summary = whole["summary"].query(f"robot == '{name}'").iloc[0]
    assert summary.observations == [3, 2][robot]
    assert summary.ate_position_rmse_m == pytest.approx([0.1, 0.2][robot], abs=1e-12)
    assert summary.nis_per_dof == pytest.approx(6.36 / 5, rel=1e-12)
    assert summary.landmark_max_m == pytest.approx(0.5, abs=1e-12)


def test_robots_and_map_are_aligned_by_one_motion(team, joint):
    """What all have in common is taken away; what one robot is off by itself stays."""
    motion = np.array([20.0, -10.0, 1.0])
    poses = geo.compose(motion, np.stack([robot.truth for robot in team.robots]))
    moved = replace(
        joint,
        online=Trajectory(poses),
        smoothed=None,
        landmarks=LandmarkEstimates(
            np.array([2, 6]), geo.from_frame(motion, team.true_map.positions)
        ),
    )
    summary = tables.summary_rows(team, moved, "se2")
    assert summary[["ate_position_max_m", "landmark_max_m"]].max(axis=None) < 1e-12
    apart = replace(moved, online=Trajectory(poses + np.array([[[0.0] * 3], [[3.0, 0.0, 0.0]]])))
    assert tables.summary_rows(team, apart, "se2").ate_position_rmse_m.min() > 0.5
    # A robot without truth moves with the others.
    partly = replace(team, robots=(team.robots[0], replace(team.robots[1], truth=None)))
    rows = tables.trajectories(partly, moved, "se2")
    found = rows[rows.robot == "far"][["x_m", "y_m", "theta_rad"]]
    np.testing.assert_allclose(found, team.robots[1].truth, atol=1e-12)
    assert rows[rows.robot == "far"].error_position_m.isna().all()
    assert (tables.summary_rows(partly, moved, "se2").alignment == "se2").all()


def test_gaps_are_those_of_each_robot(team, joint):
    summary = tables.summary_rows(team, joint, reference=joint)
    online = summary[summary.series == "online"]
    np.testing.assert_allclose(online.gap_final_position_m, [0.05, 0.1], rtol=1e-9)
    np.testing.assert_allclose(online.sigma_ratio_position, [2.0, 2.0], rtol=1e-12)


def test_a_failed_estimate_of_several_robots_is_one_row_of_them_all(team):
    failed = Estimate("gone", team.name, status="failed", message="no reason")
    row = tables.summary_rows(team, failed)
    assert len(row) == 1
    assert row.robot.isna().all()
    assert row.observations[0] == 5


def test_robots_of_the_same_name_are_told_apart(team, joint):
    twins = replace(team, robots=tuple(replace(robot, name="twin") for robot in team.robots))
    assert tables.summary_rows(twins, joint).robot.unique().tolist() == ["twin-1", "twin-2"]


def test_innovations_of_one_number_and_of_robots(team, joint):
    table = tables.innovations(team, joint)
    assert table.decision.tolist() == ["new", "new", "accepted", "accepted", "accepted"]
    assert table.observed_robot.to_list() == [pd.NA, pd.NA, "near", pd.NA, pd.NA]
    assert table.landmark.to_list() == [2, 6, pd.NA, 2, 6]
    assert table.dof.to_list() == [pd.NA, pd.NA, 2, 2, 1]
    np.testing.assert_allclose(table.nis, [np.nan, np.nan, 1.0, 1.36, 4.0], rtol=1e-12)
    assert table.loc[4, "innovation_0":"S_11"].isna().tolist() == [False, True, False, True, True]
    # What an estimator writes where there is no second number is its own affair.
    innovation, S = joint.innovations.innovation.copy(), joint.innovations.S.copy()
    innovation[[1, 4], 1], S[[1, 4], 1], S[[1, 4], :, 1] = np.nan, np.nan, np.nan
    other = replace(joint, innovations=replace(joint.innovations, innovation=innovation, S=S))
    pd.testing.assert_frame_equal(tables.innovations(team, other), table)


def test_associations_are_counted_by_robot_and_step(team, joint):
    """Near founds 2, far founds 6, far sees near, near takes 2 for 2 and then 2 for 6."""
    other = replace(team, true_landmark=[2, 6, -1, 2, 2])
    table = tables.association(other, joint)
    assert table.robot.tolist() == ["near", "near", "far"]
    assert table.step.tolist() == [1, 2, 1]
    first = {"observations": 1, "new": 1}
    second = {"observations": 2, "mapped": 2, "accepted": 2, "correct": 1, "false": 1, "merges": 1}
    counts = table.loc[:, "observations":]
    for row, expected in zip(counts.to_dict("records"), (first, second, first), strict=True):
        assert {name: number for name, number in row.items() if number} == expected
    summary = tables.summary_rows(other, joint)
    scores = summary[["association_precision", "association_recall"]].to_numpy()
    np.testing.assert_array_equal(scores[:2], 0.5)
    assert np.isnan(scores[2:]).all()  # far has accepted nothing of a landmark
    assert (summary.landmarks_merged == 1).all()
