"""Unknown identities: the likeliest landmark of each particle's own map, and evidence for it."""

from __future__ import annotations

import numpy as np
import pytest
from made import make
from problems import camera, problem, scanner
from scipy.stats import chi2, multivariate_normal

import ekfslam
from ekfslam import geometry as geo
from ekfslam.association.nearest import AMBIGUOUS, NEW
from ekfslam.dataset import Dataset, Prior, Robot, Sightings
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Decision
from ekfslam.filters.fastslam.estimators import Fastslam1, Fastslam2, _logdets
from ekfslam.filters.fastslam.particles import Maps, add_landmark
from ekfslam.filters.fastslam.recognition import UNDECIDED, likeliest
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations
from ekfslam.robots import LandmarkMap

BOTH = pytest.mark.parametrize("kind", [Fastslam1, Fastslam2])
GATE = chi2(2).ppf(0.9999)
POSE = np.array([0.3, -0.4, 0.8])


def mapped(means, covariances):
    """One particle's map."""
    maps = Maps.of(1, len(means))
    for index, (mean, C) in enumerate(zip(means, covariances, strict=True)):
        page, place = add_landmark(maps, 0, index)
        maps.gaussians[page, place] = [*mean, C[0, 0], C[0, 1], C[1, 1]]
    return maps


def plainly(sensor, values, P, means, covariances):
    """Likelihoods against that of something new, by scipy; a landmark claimed twice is settled."""
    choice, best = [], []
    for z in values:
        R = sensor.covariances(z)
        new = multivariate_normal(cov=R).logpdf([0, 0]) - 0.5 * GATE
        likelihoods = []
        for mean, C in zip(means, covariances, strict=True):
            expected, Hx, Hm = sensor.observe(POSE, mean)
            S = Hx @ P @ Hx.T + Hm @ C @ Hm.T + R
            nu = sensor.difference(z, expected)
            likelihoods.append(multivariate_normal(cov=S).logpdf(nu) - new)
        best.append(max(likelihoods, default=-np.inf))
        choice.append(int(np.argmax(likelihoods)) if best[-1] >= 0 else NEW)
    return [
        AMBIGUOUS
        if mine >= 0 and any(mine == other and best[j] > best[i] for j, other in enumerate(choice))
        else mine
        for i, mine in enumerate(choice)
    ]


@pytest.mark.parametrize("kind", ["range-bearing", "xy"])
@pytest.mark.parametrize("certain", [True, False])
def test_the_likeliest_is_that_of_plain_likelihoods(kind, certain, rng):
    """In maps where sightings fall near the gate, of small and large landmarks, near and far."""
    sensor = Sensor(kind, [[0.02, 0.002], [0.002, 0.01]], mount=[0.3, 0.2, -0.6])
    told = set()
    for _ in range(60):
        count = int(rng.integers(0, 12))
        means = geo.from_frame(geo.compose(POSE, sensor.mount), rng.uniform(-4, 4, (count, 2)))
        roots = rng.normal(size=(count, 2, 2)) * 10.0 ** rng.uniform(-2, -0.3, (count, 1, 1))
        covariances = roots @ np.swapaxes(roots, 1, 2)
        L = 0.1 * rng.normal(size=(3, 3))
        P = np.zeros((3, 3)) if certain else L @ L.T
        values = sensor.observe(POSE, rng.uniform(-4, 4, (5, 2)))[0]
        for k in range(min(count, 3)):
            values[k] = sensor.observe(POSE, means[k])[0] + rng.normal(size=2) * 0.3
        if kind == "range-bearing":
            values[:, 0] = np.abs(values[:, 0])
        sightings = Sightings.of(sensor, values)
        choice = np.full(5, UNDECIDED)
        maps = mapped(means, covariances)
        likeliest(sightings, 0, 5, maps, 0, POSE, P, GATE, _logdets(sightings), choice)
        assert choice.tolist() == plainly(sensor, values, P, means, covariances)
        told |= set(np.sign(choice).tolist()) | {int(choice.min())}
    assert {AMBIGUOUS, NEW} <= told
    assert max(told) > 0


def test_a_heading_that_swings_the_sensor_along_with_its_robot_lets_it_be_farther_off():
    """Position and heading err together, and the sensor by the sum of both."""
    sensor = Sensor("range-bearing", np.diag([0.01, 0.25]), mount=[1.0, 0.0, 0.0])
    left = np.array([-np.sin(POSE[2]), np.cos(POSE[2])])
    together = 0.5 * np.append(left, 1.0)
    P = np.outer(together, together)
    means, covariances = [geo.compose(POSE, sensor.mount)[:2] + 8.0 * left], [np.zeros((2, 2))]
    values = sensor.observe(POSE, means[0])[0][None] + 3.6 * np.array([-1.0, -0.5])
    sightings, choice = Sightings.of(sensor, values), np.array([UNDECIDED])
    maps = mapped(means, covariances)
    likeliest(sightings, 0, 1, maps, 0, POSE, P, GATE, _logdets(sightings), choice)
    assert choice.tolist() == plainly(sensor, values, P, means, covariances) == [0]


def test_what_a_row_shows_is_out_of_the_question_for_the_others():
    sensor = Sensor("xy", 0.01 * np.eye(2))
    maps = mapped([[1.0, 0.0]], [0.01 * np.eye(2)])
    sightings = Sightings.of(sensor, [[1.0, 0.0], [1.01, 0.0]])
    choice, zero = np.array([UNDECIDED, 0]), np.zeros((3, 3))
    likeliest(sightings, 0, 2, maps, 0, np.zeros(3), zero, GATE, _logdets(sightings), choice)
    assert choice.tolist() == [NEW, 0]


@BOTH
def test_where_landmarks_are_far_apart_it_is_the_filter_with_known_identities(kind):
    """Also with two sensors that see each landmark twice in a step."""
    data = problem(scanner(0.3, -0.2, 0.5), camera(-0.4, 0.1, 2.8), steps=20, noise=0.1, seed=2)
    known = kind(particles=25).estimate(data)
    found = kind(particles=25, new=1 - 1e-12).estimate(data.without_identities())
    assert (known.association, found.association) == ("known", "maximum-likelihood")
    assert known.effective_samples.min() < 12.5
    np.testing.assert_allclose(found.online.poses, known.online.poses, atol=1e-9)
    np.testing.assert_allclose(found.effective_samples, known.effective_samples, rtol=1e-6)
    np.testing.assert_allclose(found.smoothed.poses, known.smoothed.poses, atol=1e-9)
    np.testing.assert_array_equal(found.innovations.decision, known.innovations.decision)
    # Particles drawn from the motion alone may be so far off that a sighting is none of theirs;
    # they have no weight after it, but their share in what was expected of it before.
    alike = np.isclose(found.innovations.innovation, known.innovations.innovation, equal_nan=True)
    assert alike.mean() > 0.95
    assert alike.all() or kind is Fastslam1
    first = np.unique(data.observations.landmark, return_index=True)[1]
    assert found.landmarks.ids.tolist() == sorted(first.tolist())


@BOTH
def test_decisions_are_the_history_of_the_map_that_is_told(kind):
    data = ekfslam.simulate("orchard", seed=3).without_identities()
    estimate = kind(particles=20).estimate(data)
    decision, landmark = estimate.innovations.decision, estimate.innovations.landmark
    rows = np.arange(len(decision))
    new = decision == Decision.NEW
    np.testing.assert_array_equal(landmark[new], rows[new])
    assert set(estimate.landmarks.ids.tolist()) <= set(rows[new].tolist())
    accepted = decision == Decision.ACCEPTED
    assert new[landmark[accepted]].all()
    assert (landmark[accepted] < rows[accepted]).all()
    assert (landmark[decision == Decision.AMBIGUOUS] == -1).all()
    truth = data.true_landmark
    assert (truth[landmark[accepted]] == truth[accepted]).mean() > 0.98


def standing(steps, rows, limits):
    """A robot that stands and looks; rows are (step, x, y)."""
    sensor = Sensor("xy", 0.01 * np.eye(2), **limits)
    robot = Robot(MotionModel("odometry", 1e-6 * np.eye(3)), np.zeros((steps, 3)), Prior())
    step, x, y = np.array(rows, dtype=float).T
    seen = Observations(step.astype(int), np.column_stack([x, y]))
    return Dataset("standing", (robot,), np.arange(steps + 1.0), (sensor,), seen)


GHOST = [(0, 2.0, 2.0), (1, 2.0, 2.0)]
TREE = [(k, 3.0, 0.0) for k in range(8)]


@BOTH
@pytest.mark.parametrize(
    ("limits", "options", "left"),
    [
        ({"max_range": 6.0}, {}, 1),
        ({"max_range": 6.0}, {"evidence": False}, 2),
        ({}, {}, 2),  # no range is stated: nothing should be seen
        ({"max_range": 6.0, "field_of_view": 1.0}, {}, 2),  # behind the edge of the view
        ({"max_range": 2.9}, {}, 2),  # at 2.83 m, with its spread
    ],
)
def test_what_is_not_seen_where_it_should_be_is_forgotten(kind, limits, options, left):
    """Seen in two looks and missed in three: after that its evidence is below zero."""
    for steps in (5, 4):  # looks 2, 3, 4; and one too few
        rows = sorted(GHOST + TREE[:steps])
        data = standing(steps - 1, rows, limits)
        estimate = kind(particles=5, **options).estimate(data)
        assert len(estimate.landmarks) == (left if steps == 5 else 2)


def test_evidence_is_not_asked_where_identities_are_known():
    data = make(
        step=[0, 1, 1, 2],
        values=[[2.0, 0.0], [2.0, 1.0], [1.0, 0.0], [1.0, 1.0]],
        landmark=[1, 2, 3, 4],
        sensors=(Sensor("range-bearing", np.diag([0.01, 1e-4]), max_range=9.0),),
    )
    assert Fastslam1().estimate(data).landmarks.ids.tolist() == [1, 2, 3, 4]


def test_a_map_that_grows_is_the_map_that_was_large(monkeypatch):
    """Room for landmarks is found on the way; the random numbers are not drawn anew for it."""
    data = ekfslam.simulate("orchard", seed=1).without_identities()
    small = Fastslam2(particles=10).estimate(data)
    monkeypatch.setattr("ekfslam.filters.fastslam.estimators.LANDMARKS", 1000)
    large = Fastslam2(particles=10).estimate(data)
    assert len(small.landmarks) > 64
    np.testing.assert_array_equal(small.online.poses, large.online.poses)
    np.testing.assert_array_equal(small.landmarks.positions, large.landmarks.positions)


def test_noise_that_is_zero_in_a_direction_tells_nothing_apart():
    data = make(sensors=(Sensor("range-bearing", np.diag([0.01, 0.0])),))
    with pytest.raises(UnsupportedError, match="noise in all directions"):
        Fastslam1().estimate(data)


def test_particles_may_disagree_and_the_set_decides_later():
    """Two landmarks 1 m apart and a pose that is uncertain by as much: both readings survive."""
    sensor = Sensor("xy", 0.0025 * np.eye(2), max_range=20.0)
    motion = MotionModel("odometry", np.diag([1e-6, 0.25, 1e-8]))
    robot = Robot(motion, np.tile([1.0, 0.0, 0.0], (2, 1)))
    seen = [[5.0, 0.0], [5.0, 1.0], [4.0, 0.45], [3.0, 0.4], [3.0, 1.4]]
    data = Dataset(
        "twins",
        (robot,),
        [0.0, 1.0, 2.0],
        (sensor,),
        Observations([0, 0, 1, 2, 2], seen),
        true_map=LandmarkMap([0, 1], [[5.0, 0.0], [5.0, 1.0]]),
    )
    estimate = Fastslam1(particles=2000).estimate(data)
    lateral = np.sqrt(estimate.online.covariances[:, 1, 1])
    assert lateral[1] > 0.4  # both
    assert lateral[2] < 0.1  # one
    assert estimate.online.poses[2, 1] == pytest.approx(-0.4, abs=0.1)
