"""MRCLAM: what its pitfalls make of a log, and the real ones where they are."""

from __future__ import annotations

import numpy as np
import pytest
from mrclam_made import (
    BARCODES,
    EPOCH,
    PLACES,
    TRUE_PLACES,
    drive,
    driven,
    load,
    sightings_of,
    told,
    write,
    write_robot,
    write_set,
    write_world,
)
from numpy.testing import assert_allclose, assert_array_equal

import ekfslam
from ekfslam import geometry as geo
from ekfslam.datasets import mrclam
from ekfslam.errors import FileFormatError
from ekfslam.evaluation.summary import summary_rows


@pytest.fixture
def folder(tmp_path, rng):
    """Set 1 with one robot, number 3."""
    return write_set(tmp_path, rng)


# Laws ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.1, 0.2, 0.7])
def test_without_noise_dead_reckoning_and_sightings_are_the_truth(folder, step):
    dataset = load(folder, step=step)
    assert_allclose(np.diff(dataset.times), step)
    assert dataset.times[0] == 0
    path = geo.integrate(dataset.prior.mean, dataset.robot.increments.deltas)
    start = float(dataset.provenance.partition("from ")[2].partition(" ")[0])
    rows = np.loadtxt(folder / "Robot3_Odometry.dat")
    exact = driven(rows, (0.1, 0.2, 0.3), start + dataset.times)
    exact[:, 2] = geo.wrap(exact[:, 2])
    assert np.abs(geo.additive_error(exact, path)).max() < 1e-6
    # Between two of its rows the truth goes straight on, where a command may change.
    away = np.abs(geo.additive_error(exact, dataset.truth)).max(axis=0)
    assert (away < np.array([0.09, 0.09, 1.2]) * 0.016 / 2).all()
    assert len(dataset.times) > 18 / step
    images = driven(rows, (0.1, 0.2, 0.3), start + np.append(0, dataset.observations.time))[1:]
    places = np.array([TRUE_PLACES[s] for s in dataset.observations.landmark])
    expected = dataset.sensors[0].observe(images, places)[0]
    assert_allclose(dataset.observations.values, expected, atol=1e-6)


@pytest.mark.parametrize("option", [{"lag": 0.1}, {"v_scale": 0.95}, {"w_scale": 0.9}])
def test_each_correction_matters(folder, option):
    def error(dataset):
        path = geo.integrate(dataset.prior.mean, dataset.robot.increments.deltas)
        return np.abs(geo.additive_error(dataset.truth, path)).max()

    assert error(load(folder, **option)) > 4 * error(load(folder))


def test_a_sighting_is_at_the_nearest_pose_and_keeps_its_time(folder):
    dataset = load(folder)
    o = dataset.observations
    away = np.abs(o.time[:, None] - dataset.times)
    assert_array_equal(o.step, away.argmin(axis=1))
    later = load(folder, image_shift=0.02)
    assert_allclose(later.observations.time - o.time, 0.05, atol=1e-6)


def test_noise_grows_with_time_whatever_the_step_and_rests_with_the_robot(tmp_path):
    write_world(tmp_path)
    stamps = EPOCH + np.arange(0, 8, 0.016)
    going = np.where(stamps < EPOCH + 4, 0.05, 0.0)
    commands = np.column_stack([stamps, going, np.zeros(len(stamps))])
    write_robot(tmp_path, 3, commands, sightings_of(commands, (0, 0, 0)), (0, 0, 0))
    sigmas = (0.03, 0.01, 0.02)
    for step in (0.5, 1.0):
        dataset = load(tmp_path, step=step, odometry_sigmas=sigmas)
        covariances = dataset.robot.increments.covariances
        variances = np.array(sigmas) ** 2 * step
        variances[1] += sigmas[2] ** 2 * (0.045**2) * step**3 / 3  # a turn moves what comes after
        assert_allclose(np.diagonal(covariances[0]), variances, rtol=0.02)
        assert_allclose(covariances[-1], 0.01 * np.diag(np.array(sigmas) ** 2 * step), rtol=1e-4,
                        atol=1e-12)  # fmt: skip


def test_one_robot_starts_where_it_truly_is(folder):
    dataset = load(folder, prior_sigmas=(0.1, 0.2, 0.3))
    assert_array_equal(dataset.prior.mean, dataset.truth[0])
    assert_allclose(dataset.prior.covariance, np.diag([0.01, 0.04, 0.09]))
    assert dataset.robot.truth_known
    assert dataset.name == "mrclam1/robot3"
    assert dataset.robot.name == "robot3"


# Who is who ---------------------------------------------------------------------------------------


def test_the_pair_that_set_1_has_swapped_is_swapped_back(folder):
    dataset = load(folder)
    found = dict(zip(dataset.true_map.ids.tolist(), dataset.true_map.positions, strict=True))
    for subject, place in TRUE_PLACES.items():
        assert_allclose(found[subject], place)
    assert told(dataset, "swapped back")
    assert_array_equal(dataset.known_map.positions, dataset.true_map.positions)


def test_a_corrected_file_is_read_instead(folder):
    places = {**TRUE_PLACES, 6: (3.01, 0.51)}
    rows = [(s, *xy, 1e-4, 2e-4) for s, xy in places.items()]
    write(folder, "Landmark_Groundtruth.corrected.dat", rows)
    dataset = load(folder)
    assert_allclose(dataset.true_map.positions, list(places.values()))
    assert told(dataset, "Landmark_Groundtruth.corrected.dat")


@pytest.mark.parametrize("moved", [False, True])
def test_what_is_not_the_published_file_of_set_1_is_not_swapped(folder, moved):
    places = {**PLACES, 11: (1.0, 1.0)} if moved else TRUE_PLACES
    write_world(folder, places)
    dataset = load(folder, misread_beyond=4.0)
    assert_allclose(dataset.true_map.positions, list(places.values()))
    assert told(dataset, "not swapped") == moved
    write_world(folder)
    other = mrclam.load(2, folder, "robot3", misread_beyond=4.0)
    assert_allclose(other.true_map.positions, list(PLACES.values()))


def test_barcodes_become_subjects_and_strangers_are_counted(folder):
    write(folder, "Robot3_Measurement.dat", [
        (EPOCH + 3.0, 72, 2.0, 0.1), (EPOCH + 3.0, 99, 2.0, 0.1), (EPOCH + 3.5, 41, 1.0, 0.1),
        (EPOCH + 3.0, 14, 1.0, 0.1), (EPOCH + 3.0, 72, 2.2, 0.1), (EPOCH + 4.0, 27, 2.0, -0.5),
        (EPOCH + 25.0, 27, 2.0, -0.5),
    ])  # fmt: skip
    dataset = load(folder, misread_beyond=4.0)
    assert_array_equal(dataset.observations.landmark, [6, 7])
    assert_allclose(dataset.observations.values, [[2.0, 0.1], [2.0, -0.5]])
    assert dataset.association_known
    assert told(dataset, "7 sightings read (4 of landmarks, 2 of robots, 1 of unknown barcodes)")
    assert told(dataset, "2 used, left out 2 of an unknown barcode or its own; 1 of robots that are"
                " not there; 1 before or after the run; 1 repeated at one instant")  # fmt: skip


def test_a_misread_barcode_is_left_out_where_the_truth_knows(folder):
    rows = np.loadtxt(folder / "Robot3_Measurement.dat")
    rows[5, 3] += 0.5
    rows[9, 3] += 0.2
    write(folder, "Robot3_Measurement.dat", rows)
    dataset, kept = load(folder), load(folder, misread_beyond=3.2)
    assert len(kept.observations) == len(rows)
    assert_allclose(dataset.observations.values, np.delete(kept.observations.values, 5, axis=0))
    assert told(dataset, "1 misread, as the truth has it")
    (folder / "Robot3_Groundtruth.dat").unlink()
    assert len(load(folder).observations) == len(rows)


# Stamps -------------------------------------------------------------------------------------------


def test_stamps_that_repeat_or_go_back_keep_their_order(folder):
    plain = load(folder)
    rows = np.loadtxt(folder / "Robot3_Odometry.dat")
    mixed = np.insert(rows, 300, rows[300], axis=0)
    mixed[300, 1:] = 0.5  # holds for no time: the one after has the same stamp
    mixed[[700, 701]] = mixed[[701, 700]]
    write(folder, "Robot3_Odometry.dat", mixed)
    assert_allclose(load(folder).robot.controls, plain.robot.controls, atol=1e-12)


def test_several_sightings_of_one_landmark_within_a_step_are_kept(folder):
    times = EPOCH + 5 + np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 6.0])
    write(folder, "Robot3_Measurement.dat", [(t, 72, 3.0, 0.1) for t in times])
    dataset = load(folder, step=0.5, misread_beyond=4.0)
    o = dataset.observations
    assert len(o) == 7
    assert np.bincount(o.step).max() >= 3
    assert_allclose(np.diff(o.time), np.diff(times), atol=1e-6)
    alone = dataset.sensors[0].covariances(o.values)
    assert_allclose(dataset.sightings.covariance, alone)
    once = load(folder, step=0.5, misread_beyond=4.0, correlated=5.0)
    counts = np.array([6, 6, 6, 6, 6, 6, 1])[:, None, None]
    assert_allclose(once.sightings.covariance, counts * alone)
    assert told(once, "within 5 s count as one")


def test_sightings_that_count_together_are_those_of_one_thing_by_one_robot(folder):
    write(folder, "Robot3_Measurement.dat", [
        (EPOCH + 3.0, 72, 3.0, 0.1), (EPOCH + 3.0, 27, 3.0, 0.1), (EPOCH + 4.0, 72, 3.0, 0.1),
        (EPOCH + 7.9, 72, 3.0, 0.1), (EPOCH + 8.1, 72, 3.0, 0.1), (EPOCH + 12.0, 72, 3.0, 0.1),
    ])  # fmt: skip
    dataset = load(folder, misread_beyond=4.0, correlated=5.0)
    alone = dataset.sensors[0].covariances(dataset.observations.values)
    assert_allclose(dataset.sightings.covariance[:, 0, 0] / alone[:, 0, 0], [3, 1, 3, 3, 2, 2])


def test_thinned_sightings_are_as_many_as_may_be_and_so_far_apart(folder):
    everything, thinned = load(folder), load(folder, every=3.0)
    for landmark in PLACES:
        time = everything.observations.time[everything.observations.landmark == landmark]
        kept = thinned.observations.time[thinned.observations.landmark == landmark]
        assert (np.diff(kept) >= 3.0 - 1e-9).all()
        left = np.setdiff1d(time, kept)
        last = kept[np.searchsorted(kept, left) - 1]
        assert (left - last < 3.0).all()
        assert len(left)
    count = len(everything.observations) - len(thinned.observations)
    assert told(thinned, f"{count} less than 3 s after the last of the same")


def test_a_sensor_is_as_measured_or_as_told(folder):
    camera = load(folder).sensors[0]
    assert_allclose(camera.covariances([[2.0, 0.0]]), [np.diag([0.05**2 + 0.08**2, 0.015**2])])
    other = load(
        folder, range_sigma=0.1, range_growth=0.0, bearing_sigma=0.2, range_bias=(0.1, 1 / 9)
    )
    assert_allclose(other.sensors[0].covariance, np.diag([0.01, 0.04]))
    plain = load(folder).observations.values
    assert_allclose(other.observations.values[:, 0], (plain[:, 0] - 0.1) * 0.9)
    for number in (1, 2):
        for kind in ("Odometry", "Measurement", "Groundtruth"):
            text = (folder / f"Robot3_{kind}.dat").read_bytes()
            (folder / f"Robot{number}_{kind}.dat").write_bytes(text)
    team = load(folder, None, misread_beyond=4.0)
    assert [np.sqrt(s.covariance[1, 1]) for s in team.sensors] == [0.03, 0.015, 0.015]


# The team -----------------------------------------------------------------------------------------


@pytest.fixture
def team(tmp_path, rng):
    """Three robots that see each other; the second comes later, the third has sparse truth."""
    write_world(tmp_path)
    for robot, start in ((1, (0.0, 0.0, 0.1)), (2, (1.0, -0.5, 0.0)), (3, (0.5, 1.0, -0.2))):
        commands = drive(rng)
        commands[:, 0] += 1.5 * (robot == 2)
        rows = sightings_of(commands, start, (6, 7))
        other = 1 + robot % 3
        rows += [(row[0] + 0.011, BARCODES[other], 1.0, 0.2) for row in rows[::4]]
        sparse = "Groundtruth_sparse" if robot == 3 else "Groundtruth"
        poses = write_robot(tmp_path, robot, commands, sorted(rows), start, sparse, packed=True)
        if robot == 3:
            rows = np.column_stack([poses, np.full(len(poses), 3)])[240::100]
            write(tmp_path, "Robot3_Groundtruth_sparse.dat", rows, packed=True)
    return tmp_path


def test_the_team_keeps_the_robots_that_it_sees(team):
    dataset = load(team, None, misread_beyond=4.0)
    assert [robot.name for robot in dataset.robots] == ["robot1", "robot2", "robot3"]
    o = dataset.observations
    shown = o.observed_robot >= 0
    assert shown.sum() > 20
    assert_array_equal(o.observed_robot[shown], (o.robot[shown] + 1) % 3)
    assert (o.landmark[shown] == -1).all()
    assert set(o.landmark[~shown]) == {6, 7}
    assert (np.diff(o.time) >= 0).all()
    for robot in dataset.robots:
        assert_array_equal(robot.prior.mean, robot.truth[0])
    single = load(team, "robot1")
    assert single.observations.observed_robot is None
    left = len(np.loadtxt(team / "Robot1_Measurement.dat.gz")) - len(single.observations)
    assert told(single, f"{left} of robots that are not there")
    estimate = ekfslam.estimate(dataset, "ekf")
    assert estimate.status == "ok"


@pytest.mark.parametrize("step", [0.2, 0.7, 1.1])
def test_sparse_truth_is_used_within_half_a_step(team, step):
    dataset = load(team, "robot3", step=step)
    rows = np.loadtxt(team / "Robot3_Groundtruth_sparse.dat.gz")
    start = float(dataset.provenance.partition("from ")[2].partition(" ")[0])
    assert start == pytest.approx(rows[0, 0], abs=1e-3)
    known = np.isfinite(dataset.truth[:, 0])
    inside = rows[rows[:, 0] < start + dataset.times[-1] + 0.5 * step]
    assert known.sum() == len(inside)
    assert_allclose(dataset.truth[known], inside[:, 1:4], atol=1e-9)
    away = np.abs(start + dataset.times[known] - inside[:, 0])
    assert (away <= 0.5 * step + 1e-6).all()
    write(team, "Robot3_Groundtruth_sparse.dat", rows[:, :4], packed=True)
    assert_array_equal(load(team, "robot3", step=step).truth, dataset.truth)


def test_the_full_truth_counts_if_both_are_there(folder):
    plain = load(folder)
    write(folder, "Robot3_Groundtruth_sparse.dat", [(EPOCH + 5.0, 1.0, 2.0, 3.0, 4)])
    assert_array_equal(load(folder).truth, plain.truth)


def test_who_saw_whom_counts_together_in_the_team(team):
    dataset = load(team, None, misread_beyond=4.0, correlated=2.0)
    o = dataset.observations
    alone = np.array(
        [dataset.sensors[s].covariances(v) for s, v in zip(o.sensor, o.values, strict=True)]
    )
    found = dataset.sightings.covariance[:, 1, 1] / alone[:, 1, 1]
    key = np.column_stack([o.robot, o.landmark, o.observed_robot])
    for pair in np.unique(key, axis=0):
        rows = np.flatnonzero((key == pair).all(axis=1))
        while len(rows):
            group = rows[o.time[rows] - o.time[rows[0]] < 2.0]
            assert_allclose(found[group], len(group))
            rows = rows[len(group) :]


def test_where_the_truth_has_a_gap_nothing_is_known(folder):
    rows = np.loadtxt(folder / "Robot3_Groundtruth.dat")
    gap = (rows[:, 0] > EPOCH + 8) & (rows[:, 0] < EPOCH + 12)
    write(folder, "Robot3_Groundtruth.dat", rows[~gap])
    dataset = load(folder)
    start = float(dataset.provenance.partition("from ")[2].partition(" ")[0])
    unknown = np.isnan(dataset.truth).all(axis=1)
    at = start + dataset.times
    assert_array_equal(unknown, (at > EPOCH + 8) & (at < EPOCH + 12))
    assert told(dataset, f"the truth is known of {(~unknown).sum()} of {len(unknown)} poses")


def test_who_has_no_truth_starts_at_zero_and_is_in_no_team(team):
    (team / "Robot2_Groundtruth.dat.gz").unlink()
    alone = load(team, "robot2")
    assert alone.truth is None
    assert alone.known_map is None
    assert_array_equal(alone.prior.mean, np.zeros(3))
    assert alone.true_map is not None
    dataset = load(team, None)
    assert [robot.name for robot in dataset.robots] == ["robot1", "robot3"]
    assert told(dataset, "robot2 (no truth to start from)")
    assert told(dataset, "robot4 (no Robot4_Odometry.dat and Robot4_Measurement.dat)")
    for name in ("Robot1_Groundtruth.dat.gz", "Robot3_Groundtruth_sparse.dat.gz"):
        (team / name).unlink()
    with pytest.raises(FileFormatError, match="no truth of any robot"):
        load(team, None)


# The real sets ------------------------------------------------------------------------------------

# commands, and sightings of landmarks, of robots, of unknown barcodes
COUNTS = {
    (1, 1): (97890, 4771, 952, 0),
    (1, 2): (94826, 5543, 1156, 0),
    (1, 3): (97351, 6771, 1969, 2),
    (1, 4): (100012, 3269, 722, 0),
    (1, 5): (100726, 7137, 1654, 1),
    (2, 1): (121742, 6852, 1901, 0),
    (2, 2): (121507, 6309, 1924, 0),
    (2, 3): (122651, 8695, 2117, 4),
    (2, 4): (111986, 4011, 1036, 0),
    (2, 5): (119878, 11483, 2160, 7),
}
each_robot = pytest.mark.parametrize("which", COUNTS)


@pytest.fixture(scope="module")
def loaded():
    return {}


@pytest.fixture
def real(recorded_data, loaded):
    """Loads each robot once."""

    def load_once(which):
        if which not in loaded:
            loaded[which] = recorded_data("mrclam{}/robot{}".format(*which))
        return loaded[which]

    return load_once


@each_robot
def test_real_files_are_read_whole(real, which):
    dataset = real(which)
    commands, landmarks, robots, unknown = COUNTS[which]
    seen = landmarks + robots + unknown
    assert told(dataset, f"robot{which[1]}: {commands} commands and {seen} sightings read (")
    kinds = f"{landmarks} of landmarks, {robots} of robots, {unknown} of unknown barcodes"
    assert told(dataset, kinds)
    assert len(np.unique(dataset.observations.landmark)) == 15
    lost = 152 if which == (1, 5) else 9  # before the sparse truth starts; misread
    assert landmarks - lost <= len(dataset.observations) <= landmarks
    assert dataset.robot.truth_known == (which != (1, 5))


@each_robot
def test_real_sightings_are_where_the_map_has_them(real, which):
    """Also 11 and 17 of set 1, and about as far off as the sensor says."""
    dataset = real(which)
    o, camera = dataset.observations, dataset.sensors[0]
    where = np.searchsorted(dataset.true_map.ids, o.landmark)
    expected = camera.observe(dataset.truth[o.step], dataset.true_map.positions[where])[0]
    error = camera.difference(o.values, expected)
    sigma = np.sqrt(np.diagonal(camera.covariances(o.values), axis1=1, axis2=2))
    known = np.isfinite(error[:, 0])
    for landmark in dataset.true_map.ids:
        mine = known & (o.landmark == landmark)
        if mine.sum() > 20:
            relative = error[mine] / np.where([True, False], expected[mine], 1.0)
            off = np.median(relative, axis=0)
            assert (np.abs(off) < [0.1, 0.03]).all()  # of the range; rad
    spread = (error[known] / sigma[known]).std(axis=0)
    least = 0.3 if which == (1, 5) else 0.6  # its truth is of rest, when bearings are better
    assert (spread > least).all()
    assert (spread < 1.5).all()


@each_robot
def test_filters_halve_the_error_of_dead_reckoning(real, which):
    dataset = real(which)

    def errors(estimator, alignment):
        estimate = ekfslam.estimate(dataset, estimator)
        row = summary_rows(dataset, estimate, alignment).iloc[0]
        return row.ate_position_rmse_m, row.landmark_rmse_m

    alone = errors("dead-reckoning", "none")[0]
    for estimator in ("ekf", "ekf-ri"):
        assert errors(estimator, "none")[0] < 0.5 * alone
        assert errors(estimator, "se2")[1] < 0.25
