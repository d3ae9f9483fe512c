"""The filter with several robots and sensors and with landmarks of several sizes."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from problems import compass, first_steps, problem, rows_kept, scanner, sonar
from stepwise import assert_same_bits, slam_of
from textbook import TextbookEkf

from ekfslam.errors import InputError
from ekfslam.estimates import Decision
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.options import UPDATES
from ekfslam.observations import Observations, Sightings
from ekfslam.simulation import simulate

SCENARIOS = ("team", "two-sensors", "cloister-bearing", "cloister-range", "hand-held")


@cache
def drawn(name, steps=None):
    dataset = simulate(name, seed=1)
    return dataset if steps is None else first_steps(dataset, steps)


def joint_of(estimate, robots, ids):
    """Joint covariance of some robots and some points, in the order given."""
    count = estimate.online.poses.reshape(-1, estimate.online.poses.shape[-2], 3).shape[0]
    where = {int(landmark): i for i, landmark in enumerate(estimate.landmarks.ids)}
    poses = [3 * robot + np.arange(3) for robot in robots]
    points = [3 * count + 2 * where[int(i)] + np.arange(2) for i in ids]
    rows = np.concatenate([*poses, *points])
    return estimate.joint_covariance[np.ix_(rows, rows)]


# Oracles ------------------------------------------------------------------------------------------

STEPS = {"team": 50, "two-sensors": 120, "cloister-bearing": 60, "hand-held": None}
# Inverse depths of far points that a range pins down lose digits: their derivative is rho^-2.
DIGITS = {"two-sensors": 1e-7}


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("name", STEPS)
def test_equals_the_textbook_filter(name, update):
    dataset = drawn(name, STEPS[name])
    expected, told = TextbookEkf(update=update).linearizations(dataset)
    actual, tells = Ekf(update=update).linearizations(dataset)

    def close(a, b):
        np.testing.assert_allclose(a, b, rtol=0, atol=DIGITS.get(name, 1e-10))

    close(actual.online.poses, expected.online.poses)
    close(actual.online.covariances, expected.online.covariances)
    order = np.argsort(expected.landmarks.ids)
    np.testing.assert_array_equal(actual.landmarks.ids, expected.landmarks.ids[order])
    close(actual.landmarks.positions, expected.landmarks.positions[order])
    robots, ids = range(len(dataset.robots)), actual.landmarks.ids
    close(joint_of(actual, robots, ids), joint_of(expected, robots, ids))
    if expected.landmarks.undetermined is None:
        assert actual.landmarks.undetermined is None
    else:
        order = np.argsort(expected.landmarks.undetermined)
        still_open = expected.landmarks.undetermined[order]
        np.testing.assert_array_equal(actual.landmarks.undetermined, still_open)
        close(actual.landmarks.inverse_depth, expected.landmarks.inverse_depth[order])
    np.testing.assert_array_equal(actual.innovations.decision, expected.innovations.decision)
    np.testing.assert_array_equal(actual.innovations.landmark, expected.innovations.landmark)
    close(actual.innovations.innovation, expected.innovations.innovation)
    close(actual.innovations.S, expected.innovations.S)
    for column in ("event", "row", "robot", "step", "landmark", "target", "size", "rows"):
        np.testing.assert_array_equal(getattr(tells, column), getattr(told, column))
    for column in ("point", "innovation", "noise", "motion_from", "motion_to", "motion_noise"):
        close(getattr(tells, column), getattr(told, column))
    scale = 1 + np.abs(told.jacobian)
    close(tells.jacobian / scale, told.jacobian / scale)


@pytest.mark.parametrize("meet", [(), (0,), (0, 1), (0, 1, 2)])
def test_equals_it_whoever_sees_whom_with_what(meet):
    """Three robots with mounted scanners, compasses and sonars that see robots, or do not."""
    far = replace(compass(0.1, -0.2, 1.0), min_range=0.3)  # on which the prior of a distance rests
    sensors = scanner(0.3, 0.1, 0.4), far, sonar(0.0, 1.0, 2.0)
    dataset = problem(*sensors, robots=3, meet=meet, steps=4)
    expected, actual = TextbookEkf().estimate(dataset), Ekf().estimate(dataset)
    for column in ("poses", "covariances"):
        values = (getattr(e.online, column) for e in (actual, expected))
        np.testing.assert_allclose(*values, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(actual.innovations.decision, expected.innovations.decision)
    others = dataset.observed_robot >= 0
    assert others.any() == bool(meet)
    assert (actual.innovations.decision[others] == Decision.ACCEPTED).all()
    assert (actual.innovations.landmark[others] == -1).all()
    np.testing.assert_allclose(actual.innovations.S, expected.innovations.S, rtol=0, atol=1e-11)


WAYS = [
    *((name, {}) for name in SCENARIOS),
    *((name, {"update": "sequential"}) for name in SCENARIOS),
    ("team", {"association": "nearest"}),
    ("team", {"initiation": "infinite"}),
    ("two-sensors", {"association": "nearest"}),
    ("two-sensors", {"association": "joint"}),
    ("two-sensors", {"matching": "one-by-one", "known_gate": 0.9999, "corrupt": 3, "forget": 9}),
    ("cloister-bearing", {"bearings": "naive"}),
    ("cloister-bearing", {"association": "global"}),
    ("cloister-range", {"ranges": "bank", "hypotheses": 6}),
    ("cloister-range", {"ranges": "naive"}),
    *(
        ("orchard", {"association": association, "confirm": 3, "within": 8})
        for association in ("nearest", "maximum-likelihood", "global", "joint")
    ),
    ("orchard", {"association": "euclidean", "matching": "one-by-one", "forget": 4}),
]


@pytest.mark.parametrize(("name", "options"), WAYS, ids=str)
def test_step_by_step_gives_the_same_bits(name, options):
    dataset = drawn(name, 61)
    association = options.get("association", "known")
    estimate = Ekf(**options).estimate(dataset)
    assert estimate.association == association
    assert_same_bits(estimate, dataset, **{"association": association, **options})


# Robots -------------------------------------------------------------------------------------------


def apart(dataset, robots):
    """The same data if some robots met no landmark of the others and saw no robot."""
    seen = dataset.observations
    columns = {f.name: getattr(seen, f.name) for f in fields(Observations)}
    landmark = np.where(
        (seen.landmark >= 0) & np.isin(seen.robot, robots),
        seen.landmark + 1000 * (1 + seen.robot),
        seen.landmark,
    )
    own = replace(
        dataset, observations=Observations(**columns | {"landmark": landmark}), true_map=None
    )
    meeting = np.isin(seen.robot, robots) | np.isin(dataset.observed_robot, robots)
    return rows_kept(own, ~(meeting & (dataset.observed_robot >= 0)))


def test_a_robot_that_never_meets_the_others_stays_uncorrelated_with_them():
    dataset = apart(drawn("team", 150), [2])
    estimate = Ekf().estimate(dataset)
    ids = estimate.landmarks.ids
    hers = joint_of(estimate, [2, 0, 1], [*ids[ids >= 1000], *ids[ids < 1000]])
    first = np.r_[0:3, 9 : 9 + 2 * (ids >= 1000).sum()]
    rest = np.setdiff1d(np.arange(len(hers)), first)
    assert (ids >= 1000).sum() > 5
    np.testing.assert_array_equal(hers[np.ix_(first, rest)], 0)
    # The two that do meet are correlated, and so is each with what the other has mapped.
    others = hers[np.ix_(np.arange(3, 9), np.arange(3, 9))]
    assert (np.abs(others[:3, 3:]) > 1e-9).all()


def test_a_team_without_common_landmarks_is_as_many_filters():
    dataset = apart(drawn("team", 150), [0, 1, 2])
    together = Ekf().estimate(dataset)
    for robot in range(3):
        alone = replace(rows_kept(dataset, dataset.observations.robot == robot))
        seen = alone.observations
        columns = ("step", "values", "landmark", "sensor")
        single = replace(
            alone,
            robots=(dataset.robots[robot],),
            observations=Observations(**{c: getattr(seen, c) for c in columns}),
        )
        estimate = Ekf().estimate(single)
        mine = together.online.of_robot(robot)
        np.testing.assert_allclose(mine.poses, estimate.online.poses, rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            mine.covariances, estimate.online.covariances, rtol=0, atol=1e-13
        )
        ids = estimate.landmarks.ids
        np.testing.assert_allclose(
            joint_of(together, [robot], ids), joint_of(estimate, [0], ids), rtol=0, atol=1e-13
        )
    assert len(together.landmarks) == sum(
        len(np.unique(dataset.observations.landmark[dataset.observations.robot == r]))
        for r in range(3)
    )


def test_the_numbers_of_the_robots_mean_nothing():
    dataset = drawn("team", 100)
    number = np.array([2, 0, 1])  # the new number of each
    seen = dataset.observations
    other = np.where(dataset.observed_robot >= 0, number[dataset.observed_robot], -1)
    columns = {f.name: getattr(seen, f.name) for f in fields(Observations)}
    renumbered = replace(
        dataset,
        robots=tuple(dataset.robots[i] for i in np.argsort(number)),
        observations=Observations(
            **columns | {"robot": number[seen.robot], "observed_robot": other}
        ),
    )
    one, same = Ekf().estimate(dataset), Ekf().estimate(renumbered)
    for column in ("poses", "covariances"):
        values = getattr(one.online, column), getattr(same.online, column)[number]
        np.testing.assert_allclose(*values, rtol=0, atol=1e-11)
    np.testing.assert_allclose(one.landmarks.positions, same.landmarks.positions, atol=1e-11)


def test_a_robot_that_is_seen_is_corrected_and_its_heading_only_through_what_it_shares():
    """Two robots, of which one knows where it is and sees the other, which knows nothing else."""
    dataset = problem(scanner(), robots=2, meet=(0,), steps=1)
    slam = slam_of(dataset)
    before = slam.pose_covariance
    rows = dataset.sightings.robot[: dataset.offsets[1]] == 0
    look = Sightings(*(column[: dataset.offsets[1]][rows] for column in dataset.sightings))
    only = Sightings(*(column[look.target >= 0] for column in look))
    met = slam.observe(only)
    after = slam.pose_covariance
    assert met.decision.tolist() == [Decision.ACCEPTED]
    assert met.landmark.tolist() == [-1]
    assert len(slam.landmarks) == 0
    information = np.linalg.inv(after) - np.linalg.inv(before)
    assert np.linalg.matrix_rank(information, tol=1e-6) == 2  # two numbers were seen
    np.testing.assert_allclose(information[5], 0, atol=1e-6)  # that tell nothing of its heading
    assert np.linalg.det(after[3:5, 3:5]) < np.linalg.det(before[3:5, 3:5])


def test_nis_of_a_team_is_chi_square_distributed():
    """Innovations of landmarks and of robots alike: mean 1 per row."""
    for robots in (False, True):
        total = rows = 0.0
        for seed in range(3):
            dataset = simulate("team", seed=seed)
            met = Ekf().estimate(dataset).innovations
            which = (met.decision == Decision.ACCEPTED) & ((dataset.observed_robot >= 0) == robots)
            z, S = met.innovation[which], met.S[which]
            total += np.einsum("mi,mi->", z, np.linalg.solve(S, z[..., None])[..., 0])
            rows += 2 * which.sum()
        assert abs(total / rows - 1) < 5 * np.sqrt(2 / rows)


def test_robots_that_are_not_there_are_refused_online():
    slam = slam_of(drawn("team"))
    for column, value in (("robot", 3), ("target", 3)):
        seen = Sightings.of(scanner(), [[1.0, 0.0]], observed_robot=[1])
        with pytest.raises(InputError, match="a robot that there is not: there are 3"):
            slam.observe(seen._replace(**{column: np.array([value])}))
    with pytest.raises(InputError, match=r"increment must have shape \(3, 3\)"):
        slam.predict(np.zeros(3), np.zeros((3, 3)))
