"""Truth that is known in part: evaluated where it is known, and as if nothing else had been there.

The oracles are the same run cut down by hand to what is known, and the full truth.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drawn import runs_of
from scipy.stats import chi2
from tabulated import all_tables

from ekfslam import geometry as geo
from ekfslam.cli.printing import print_summary
from ekfslam.dataset import Dataset, LandmarkMap, Observations, Robot
from ekfslam.estimates import Estimate, LandmarkEstimates, Trajectory
from ekfslam.evaluation import (
    absolute_errors,
    frame_motion,
    judged,
    path_length,
    relative_errors,
    run_metrics,
    summarise,
    tables,
)
from ekfslam.experiments.rows import COMPARABLE, SCHEMAS
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

COUNT = 80
OF_TRUTH = ("true_", "error_", "nees")  # columns of trajectories that need it
OF_POSES = ("ate_", "rpe_", "nees_pose", "nees_position")  # columns of summary that do
NAN = np.nan


def drawn(rng, truth, scale):
    """A series off by draws of its own covariances; the start is exactly known."""
    roots = scale * rng.normal(size=(len(truth), 3, 3))
    covariances = roots @ np.swapaxes(roots, 1, 2) + 1e-3 * np.eye(3)
    errors = np.array([rng.multivariate_normal(np.zeros(3), each) for each in covariances])
    covariances[0], errors[0] = 0.0, 0.0
    return Trajectory(truth + errors, covariances)


def along(truth, name="curve", **columns):
    """A dataset of one robot with this truth."""
    controls = np.tile([0.5, 0.0, 0.1], (len(truth) - 1, 1))
    motion = MotionModel("odometry", covariance=1e-4 * np.eye(3))
    sensor = Sensor("xy", np.eye(2), name="camera")
    seen = Observations([], np.zeros((0, 2)))
    robot = Robot(motion, controls, truth=truth)
    return Dataset(name, (robot,), np.arange(len(truth)) * 0.5, (sensor,), seen, **columns)


@pytest.fixture
def truth():
    """Along a curve of 39.5 m, some metres from the origin."""
    return geo.integrate([8.0, -6.0, 1.0], np.tile([0.5, 0.0, 0.1], (COUNT - 1, 1)))


@pytest.fixture
def estimate(rng, truth):
    """Both series, and a landmark."""
    landmark = LandmarkEstimates(np.array([3]), np.array([[2.0, 1.0]]), 0.01 * np.eye(2)[None])
    return Estimate(
        "both", "curve", "known", drawn(rng, truth, 0.3), drawn(rng, truth, 0.1), landmark
    )


def with_truth(dataset, truth):
    return replace(dataset, robots=(replace(dataset.robot, truth=truth),))


def gaps(truth):
    """Without the start, two gaps and the end."""
    known = np.ones(COUNT, dtype=bool)
    known[:4] = known[20:26] = known[40] = known[70:] = False
    return np.where(known[:, None], truth, NAN), known


MASKS = {
    "gaps": lambda k: (k >= 4) & (k != 40) & ((k < 20) | (k >= 26)) & (k < 70),
    "every fifth": lambda k: k % 5 == 2,
    "the start alone": lambda k: k < 3,
    "one pose": lambda k: k == 33,
    "the last pose": lambda k: k == COUNT - 1,
    "all": lambda k: k >= 0,
    "none": lambda k: k < 0,
}


@pytest.fixture(params=MASKS)
def mask(request):
    return MASKS[request.param](np.arange(COUNT))


def of_poses(row):
    return row[[name for name in row.index if name.startswith(OF_POSES)]].astype(float)


# Whole poses ----------------------------------------------------------------------------------


def restricted(estimate, known):
    """The estimate as if the known poses were all there had been."""
    kept = {
        name: Trajectory(series.poses[known], series.covariances[known])
        for name, series in estimate.series.items()
    }
    return replace(estimate, **kept)


@pytest.mark.parametrize("known", [name for name in MASKS if name != "none"])
@pytest.mark.parametrize("alignment", ["none", "se2"])
def test_numbers_are_those_of_the_run_cut_down_to_the_known_poses(
    truth, estimate, known, alignment
):
    mask = MASKS[known](np.arange(COUNT))
    masked = along(np.where(mask[:, None], truth, NAN))
    found = tables.summary_rows(masked, estimate, alignment, rpe_distance=6.0)
    alone = along(truth[mask])
    expected = tables.summary_rows(alone, restricted(estimate, mask), alignment, rpe_distance=6.0)
    for (_, row), (_, whole) in zip(found.iterrows(), expected.iterrows(), strict=True):
        assert row.truth_poses == mask.sum() == whole.truth_poses == whole.steps
        assert str(row.message) == str(whole.message)
        pd.testing.assert_series_equal(of_poses(row), of_poses(whole), check_names=False)
        assert np.isfinite(row.ate_position_rmse_m)
        assert np.isfinite(row.ate_heading_rmse_rad)


@pytest.mark.parametrize(
    ("known", "skip"),
    [
        *[("gaps", 0), ("gaps", 7), ("gaps", 60), ("every fifth", 7), ("the start alone", 1)],
        *[("one pose", 0), ("one pose", 33), ("the last pose", 60), ("all", 7)],
    ],
)
def test_metrics_are_those_of_the_run_cut_down_to_the_known_poses(truth, estimate, known, skip):
    mask = MASKS[known](np.arange(COUNT))
    before = int(mask[:skip].sum())
    masked = along(np.where(mask[:, None], truth, NAN))
    found = run_metrics(masked, estimate, skip=skip)
    expected = run_metrics(along(truth[mask]), restricted(estimate, mask), skip=before)
    for row, whole in zip(found, expected, strict=True):
        assert row.pop("steps_skipped") == skip
        assert whole.pop("steps_skipped") == before
        pd.testing.assert_series_equal(pd.Series(row), pd.Series(whole), rtol=1e-12)


def test_averages_of_nothing_known_after_the_skip_are_empty(truth, estimate):
    masked = along(np.where(np.arange(COUNT)[:, None] < 5, truth, NAN))
    row = run_metrics(masked, estimate, skip=5)[0]
    assert all(row[name] is None for name in row if name.endswith(("_kept", "_m2", "_rad2")))
    error = geo.additive_error(truth, estimate.online.poses)[4]
    assert row["final_position_error_m"] == pytest.approx(np.hypot(*error[:2]))
    sigma = np.sqrt(np.trace(estimate.online.covariances[4][:2, :2]))
    assert row["final_position_sigma_m"] == pytest.approx(sigma)


@pytest.mark.parametrize("headings", [True, False])
def test_a_row_of_trajectories_does_not_know_what_is_known_of_others(
    truth, estimate, mask, headings
):
    masked = np.where(mask[:, None], truth, NAN)
    if not headings:
        masked[:, 2] = NAN
    found = tables.trajectories(along(masked), estimate)
    expected = tables.trajectories(along(truth), estimate)
    unknown = np.tile(~mask, 2)
    needy = [name for name in found if name.startswith(OF_TRUTH)]
    expected.loc[unknown, needy] = NAN
    if not headings:
        assert expected.loc[~unknown, "nees"].notna().any() or not mask[1:].any()
        expected[["true_theta_rad", "error_theta_rad", "nees", "nees_invariant"]] = NAN
    pd.testing.assert_frame_equal(found, expected, check_exact=True)


def test_a_pose_that_is_not_finite_counts_where_its_truth_is_known_alone(truth, estimate):
    masked, known = gaps(truth)
    for step, empty in ((22, False), (27, True)):
        poses = estimate.online.poses.copy()
        poses[step] = NAN
        broken = replace(estimate, online=Trajectory(poses, estimate.online.covariances))
        row = tables.summary_rows(along(masked), broken).iloc[0]
        for value in (row.ate_position_rmse_m, row.ate_position_max_m, row.ate_heading_rmse_rad):
            assert np.isnan(value) == empty
        assert known[step] == empty


# Positions alone ------------------------------------------------------------------------------


def test_of_positions_alone_there_are_position_errors_and_their_nees(truth, estimate, mask):
    masked = np.where(mask[:, None], truth, NAN)
    masked[:, 2] = NAN
    table = tables.summary_rows(along(masked), estimate)
    metrics = run_metrics(along(masked), estimate)
    for (_, row), kept, series in zip(
        table.iterrows(), metrics, estimate.series.values(), strict=True
    ):
        assert row.truth_poses == mask.sum()
        empty = ("ate_heading", "rpe_", "nees_pose")
        assert row[[name for name in row.index if name.startswith(empty)]].isna().all()
        error = (series.poses - truth)[mask, :2]
        size = np.linalg.norm(error, axis=1)
        regular = mask & (np.arange(COUNT) > 0)
        nees = np.array(
            [
                (p - t)[:2] @ np.linalg.inv(P[:2, :2]) @ (p - t)[:2]
                for p, t, P in zip(
                    series.poses[regular], truth[regular], series.covariances[regular], strict=True
                )
            ]
        )
        if mask.any():
            assert row.ate_position_rmse_m == pytest.approx(np.sqrt(np.mean(size**2)))
            assert row.ate_position_max_m == pytest.approx(size.max())
            assert row.nees_position_mean == pytest.approx(nees.mean())
            assert kept["nees_position_mean_kept"] == pytest.approx(nees.mean())
            low, high = chi2.ppf([0.025, 0.975], 2)
            inside = np.mean((nees > low) & (nees < high))
            assert row.nees_position_inside_95 == pytest.approx(inside)
            last = np.flatnonzero(mask)[-1]
            assert kept["final_position_error_m"] == pytest.approx(size[-1])
            sigma = np.sqrt(np.trace(series.covariances[last][:2, :2]))
            assert kept["final_position_sigma_m"] == pytest.approx(sigma)
        else:
            assert row[["ate_position_rmse_m", "nees_position_mean"]].isna().all()
        for name in ("heading", "pose", "position_invariant"):
            assert kept[f"nees_{name}_mean_kept"] is None
        assert kept["final_heading_error_rad"] is None


def test_positions_whose_nees_is_skipped_are_counted(truth, estimate):
    positions = truth.copy()
    positions[:, 2] = NAN
    positions[10:30] = NAN
    row = tables.summary_rows(along(positions), estimate).iloc[0]
    assert row.message == f"NEES skipped at 1 of {COUNT - 20} poses (singular covariance)"


def test_a_heading_here_and_there_gives_headings_there(truth, estimate):
    mixed = truth.copy()
    mixed[np.arange(COUNT) % 4 != 1, 2] = NAN
    row = tables.summary_rows(along(mixed), estimate).iloc[0]
    full = tables.trajectories(along(truth), estimate)[:COUNT]
    there = full[full.step % 4 == 1]
    assert row.truth_poses == COUNT
    assert row.ate_position_rmse_m == pytest.approx(np.sqrt((full.error_position_m**2).mean()))
    assert row.ate_heading_rmse_rad == pytest.approx(np.sqrt((there.error_theta_rad**2).mean()))
    assert row.nees_pose_mean == pytest.approx(there.nees.mean())
    assert row.nees_pose_final == there.nees.iloc[-1]
    assert row.nees_position_mean == pytest.approx(full.nees_position.mean())
    kept = run_metrics(along(mixed), estimate)[0]
    assert kept["position_mse_kept_m2"] == pytest.approx((full.error_position_m**2).mean())
    assert kept["heading_mse_kept_rad2"] == pytest.approx((there.error_theta_rad**2).mean())
    assert kept["final_position_error_m"] == full.error_position_m.iloc[-1]
    assert kept["final_heading_error_rad"] == abs(there.error_theta_rad.iloc[-1])
    assert kept["final_heading_sigma_rad"] == np.sqrt(there.cov_tt.iloc[-1])
    assert kept["nees_pose_invariant_final"] == there.nees_invariant.iloc[-1]


def test_of_gaussian_errors_the_nees_of_positions_is_chi_square_with_two_degrees(rng):
    many = 4000
    truth = rng.normal(size=(many, 3))
    series = drawn(rng, truth, 0.05)
    truth[:, 2] = NAN
    row = tables.summary_rows(along(truth), Estimate("drawn", "curve", online=series)).iloc[0]
    assert row.nees_position_mean == pytest.approx(2.0, abs=4 * np.sqrt(4 / many))
    assert row.nees_position_inside_95 == pytest.approx(0.95, abs=4 * np.sqrt(0.05 / many))


# Nothing --------------------------------------------------------------------------------------


@pytest.mark.parametrize("alignment", ["none", "se2"])
def test_a_truth_of_which_nothing_is_known_is_none(truth, estimate, alignment):
    found = all_tables(along(np.full((COUNT, 3), NAN)), estimate, alignment)
    expected = all_tables(along(truth), estimate, alignment)
    bare = all_tables(with_truth(along(truth), None), estimate, alignment)
    for name, table in found.items():
        pd.testing.assert_frame_equal(table, bare[name], check_exact=True)
        assert len(table) == len(expected[name])
    assert (found["summary"].truth_poses == 0).all()
    assert (found["summary"].alignment == "none").all()
    assert of_poses(found["summary"].iloc[0]).isna().all()


def test_without_a_series_the_known_poses_of_all_robots_are_counted(truth):
    masked, known = gaps(truth)
    robot = along(masked).robot
    pair = replace(along(masked), robots=(robot, replace(robot, truth=None)))
    gone = Estimate("gone", "curve", status="failed", message="the reason")
    (row,) = tables.summary_scalars(pair, gone)
    assert row["truth_poses"] == known.sum()


def test_the_terminal_says_how_much_is_known_and_judges_what_can_be(truth, estimate, capsys):
    masked, known = gaps(truth)
    positions = np.column_stack([masked[:, :2], np.full(COUNT, NAN)])
    for given, said, shown in (
        (truth, False, ["(3)"]),
        (masked, True, ["(3)"]),
        (positions, True, ["pos. (2)"]),
        (np.full((COUNT, 3), NAN), False, []),
    ):
        print_summary(tables.summary_rows(along(given), estimate))
        out = " ".join(capsys.readouterr().out.split())
        assert (f"true positions of {known.sum()} of {COUNT} poses" in out) == said
        assert [words for words in ("(3)", "pos. (2)") if words in out] == shown


# Lengths and pairs ----------------------------------------------------------------------------


def test_a_gap_counts_as_the_straight_line_across_it():
    corner = [[NAN, NAN], [0, 0], [3, 0], [NAN, NAN], [3, 4], [NAN, NAN], [NAN, NAN], [0, 0]]
    np.testing.assert_array_equal(path_length(corner), [NAN, 0, 3, NAN, 7, NAN, NAN, 12])
    assert np.isnan(path_length(np.full((4, 3), NAN))).all()
    assert path_length(np.empty((0, 3))).shape == (0,)


def test_a_path_with_gaps_is_no_longer_than_the_path(truth, mask):
    length = path_length(np.where(mask[:, None], truth, NAN))
    np.testing.assert_array_equal(np.isfinite(length), mask)
    whole = path_length(truth)
    first = whole[mask][:1].sum()
    assert (length[mask] <= whole[mask] - first + 1e-9).all()
    assert (np.diff(length[mask]) > 0).all()


def plain_pairs(truth, distance):
    """Pairs by a search that is written as it is said."""
    pairs = []
    for i in range(len(truth)):
        travelled, at = 0.0, i
        for j in range(i + 1, len(truth)):
            if not np.isfinite(truth[i]).all() or np.isnan(truth[j, 0]):
                continue
            travelled, at = travelled + np.linalg.norm(truth[j, :2] - truth[at, :2]), j
            if travelled >= distance * (1 - 1e-9) and np.isfinite(truth[j]).all():
                pairs.append((i, j))
                break
    return pairs


@pytest.mark.parametrize("seed", range(5))
def test_pairs_over_a_distance_are_those_of_a_plain_search(truth, estimate, seed):
    rng = np.random.default_rng(seed)
    masked = truth.copy()
    masked[rng.random(COUNT) < 0.4] = NAN
    masked[rng.random(COUNT) < 0.2, 2] = NAN
    pairs = plain_pairs(masked, 6.0)  # no gap is as long as that
    assert len(pairs) > 10
    found = relative_errors(estimate.online.poses, masked, 6.0)
    i, j = np.array(pairs).T
    poses = estimate.online.poses
    expected = geo.between(geo.between(truth[i], truth[j]), geo.between(poses[i], poses[j]))
    np.testing.assert_allclose(found.position, np.hypot(*expected[:, :2].T), rtol=1e-9)
    np.testing.assert_allclose(found.heading, np.abs(expected[:, 2]), rtol=1e-9)


def test_neighbours_are_paired_where_both_are_known(truth, estimate):
    masked, known = gaps(truth)
    masked[50, 2] = NAN
    both = known[:-1] & known[1:]
    both[[49, 50]] = False
    whole = relative_errors(estimate.online.poses, truth)
    found = relative_errors(estimate.online.poses, masked)
    np.testing.assert_array_equal(found.position, whole.position[both])
    np.testing.assert_array_equal(found.heading, whole.heading[both])


def test_a_pair_that_a_long_gap_makes_longer_is_left_out():
    straight = np.column_stack([np.arange(60.0), np.zeros(60), np.zeros(60)])
    poses = straight * [1.01, 1.0, 1.0]
    straight[20:40] = NAN
    # Poses 10 to 19 would be paired across 21 m, which is no 10 m any more.
    errors = relative_errors(poses, straight, 10.0).position
    np.testing.assert_allclose(errors, np.full(20, 0.1), atol=1e-12)
    # Over 30 m the gap is short enough, and makes the pairs of poses 0 to 9 longer at most.
    errors = relative_errors(poses, straight, 30.0).position
    far = [max(40 - i, 30) for i in range(20)]
    np.testing.assert_allclose(errors, 0.01 * np.array(far), atol=1e-12)


def test_absolute_errors_are_of_what_is_known():
    errors = absolute_errors(np.zeros((3, 3)), [[3, 4, 0.1], [3, 4, NAN], [NAN] * 3])
    np.testing.assert_array_equal(errors.position, [5.0, 5.0, NAN])
    np.testing.assert_array_equal(errors.heading, [0.1, NAN, NAN])


# Alignment and several robots -----------------------------------------------------------------


@pytest.mark.parametrize("headings", [True, False])
def test_alignment_is_that_of_the_known_positions(truth, estimate, mask, headings):
    masked = np.where(mask[:, None], truth, NAN)
    if not headings:
        masked[:, 2] = NAN
    motion = frame_motion(along(masked), estimate.online, "se2")
    expected = np.zeros(3)
    if mask.any():
        expected = geo.align(estimate.online.poses[mask, :2], truth[mask, :2])
    np.testing.assert_allclose(motion, expected, atol=1e-12)


@pytest.fixture
def team(rng, truth, estimate):
    """Three robots with their estimate: of the second nothing is known, of the third positions."""
    others = [geo.compose([1.0, 2.0, 0.5], truth), geo.compose([-3.0, 1.0, 2.0], truth)]
    positions = others[1].copy()
    positions[:, 2] = NAN
    masked, _ = gaps(truth)
    robot = along(truth).robot
    truths = {"first": masked, "unknown": np.full((COUNT, 3), NAN), "third": positions}
    data = replace(
        along(truth), robots=tuple(replace(robot, truth=t, name=n) for n, t in truths.items())
    )
    series = [estimate.online, *(drawn(rng, other, 0.3) for other in others)]
    online = Trajectory(
        np.array([s.poses for s in series]), np.array([s.covariances for s in series])
    )
    return data, Estimate("team", "curve", online=online)


def test_each_robot_has_the_numbers_of_its_own_truth(team):
    data, record = team
    table = tables.summary_rows(data, record).set_index("robot")
    for index, robot in enumerate(data.robots):
        alone = along(robot.truth)
        mine = Estimate("team", "curve", online=record.online.of_robot(index))
        row = tables.summary_rows(alone, mine).iloc[0]
        found = of_poses(table.loc[robot.name])
        pd.testing.assert_series_equal(found, of_poses(row), check_names=False)
        assert table.truth_poses[robot.name] == np.isfinite(robot.truth[:, 0]).sum()
    assert of_poses(table.loc["unknown"]).isna().all()


def test_robots_are_aligned_by_what_is_known_of_all_of_them(team):
    data, record = team
    known = [np.isfinite(robot.truth[:, 0]) for robot in data.robots]
    poses = np.concatenate([p[k, :2] for p, k in zip(record.online.poses, known, strict=True)])
    truths = np.concatenate([r.truth[k, :2] for r, k in zip(data.robots, known, strict=True)])
    motion = frame_motion(data, record.online, "se2")
    np.testing.assert_allclose(motion, geo.align(poses, truths), atol=1e-12)


# The verdict ----------------------------------------------------------------------------------


def off(truth, sigma, **steps):
    """An estimate of small errors but for those at chosen steps [m]."""
    poses = truth.copy()
    for step, error in steps.items():
        poses[int(step[1:]), 0] += error
    covariances = np.tile(sigma**2 * np.eye(3), (COUNT, 1, 1))
    return Estimate("off", "curve", online=Trajectory(poses, covariances))


@pytest.mark.parametrize("headings", [True, False])
def test_the_last_known_position_is_judged(truth, headings):
    masked, known = gaps(truth)
    if not headings:
        masked[:, 2] = NAN
    last = int(np.flatnonzero(known)[-1])
    assert last == 69
    length = path_length(masked)[last]
    lost = judged(along(masked), off(truth, 0.01, s69=0.06 * length))
    assert lost.status == "diverged"
    said = (
        f"online position of step 69 is {0.06 * length:.3g} m off: {6 * length:.0f} of its sigmas"
    )
    assert lost.message == f"{said}, 6 % of the path"
    assert judged(along(masked), off(truth, 0.01, s69=0.04 * length)).status == "ok"
    assert judged(along(masked), off(truth, 0.01 * length, s69=0.06 * length)).status == "ok"
    # Nobody knows that it is lost afterwards, or whether it was in a gap.
    assert judged(along(masked), off(truth, 0.01, s79=100.0, s22=100.0)).status == "ok"


def test_the_sigmas_of_a_lost_position_are_those_of_its_step(truth):
    masked, _ = gaps(truth)
    record = off(truth, 0.01, s69=5.0)
    covariances = record.online.covariances.copy()
    covariances[69] = np.eye(3)
    wide = replace(record, online=Trajectory(record.online.poses, covariances))
    assert judged(along(masked), record).status == "diverged"
    assert judged(along(masked), wide).status == "ok"
    covariances[69] = NAN  # not computed
    unknown = replace(record, online=Trajectory(record.online.poses, covariances))
    assert judged(along(masked), unknown).status == "ok"


@pytest.mark.parametrize("known", [[0], [COUNT - 1], [40], []])
def test_a_truth_of_one_position_has_no_path_and_judges_nobody(truth, known):
    masked = np.full((COUNT, 3), NAN)
    masked[known] = truth[known]
    record = off(truth, 0.0, s0=1e-12, s40=3.0, s79=3.0)
    for alignment in ("none", "se2"):
        assert judged(along(masked), record, alignment).status == "ok"


def test_a_robot_that_stands_may_be_lost(truth):
    standing = np.zeros((COUNT, 3))
    lost = judged(along(standing), off(standing, 0.01, s79=3.0))
    assert lost.message == "final online position is 3 m off: 300 of its sigmas"


# A map that is known, whatever is known of the poses --------------------------------------------


def test_landmarks_do_not_need_the_truth_of_poses(truth, estimate):
    landmark = {"true_map": LandmarkMap([3], [[2.3, 1.4]])}
    found = tables.landmarks(along(np.full((COUNT, 3), NAN), **landmark), estimate)
    expected = tables.landmarks(along(truth, **landmark), estimate)
    pd.testing.assert_frame_equal(found, expected, check_exact=True)
    assert found.error_m[0] == pytest.approx(0.5)


# Particles ------------------------------------------------------------------------------------


def test_effective_samples_are_in_the_rows_of_the_filter(truth, estimate, rng):
    samples = rng.uniform(10, 100, COUNT)
    samples[0] = NAN
    record = replace(estimate, effective_samples=samples)
    table = tables.trajectories(along(truth), record)
    np.testing.assert_array_equal(table.effective_samples[:COUNT], samples)
    assert table.effective_samples[COUNT:].isna().all()
    online, smoothed = (row for _, row in tables.summary_rows(along(truth), record).iterrows())
    assert online.effective_samples_mean == pytest.approx(samples[1:].mean())
    assert online.effective_samples_min == samples[1:].min()
    names = ["effective_samples_mean", "effective_samples_min"]
    assert smoothed[names].isna().all()
    assert tables.summary_rows(along(truth), estimate).iloc[0][names].isna().all()


def test_effective_samples_that_no_step_has_are_empty(truth, estimate):
    record = replace(estimate, effective_samples=np.full(COUNT, NAN))
    row = tables.summary_rows(along(truth), record).iloc[0]
    assert row[["effective_samples_mean", "effective_samples_min"]].isna().all()


def test_campaigns_average_effective_samples_but_nobody_wins_by_them():
    found = summarise(runs_of([0, 1, 2], effective_samples_mean=[40.0, 46.0, NAN])).iloc[0]
    assert found.effective_samples_mean == pytest.approx(43.0)
    assert found.effective_samples_se == pytest.approx(3.0)
    assert "effective_samples" in SCHEMAS["steps"]
    assert not [name for name in COMPARABLE if name.startswith("effective")]
