"""The compressed filter against the full one: the same, whenever the whole map is asked for."""

import numpy as np
import pytest
from simulated import drawn
from test_delayed_update import assert_same

import ekfslam
from ekfslam import Prior, Sensor, Sightings
from ekfslam import geometry as geo
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.estimates import Decision
from ekfslam.filters import local_map
from ekfslam.filters.compressed import CompressedEngine, EkfCompressed
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.online import EkfSlam

EXACT = 1e-8
AREAS = [1, 5, 20, 100]


def city(count=250, **changes):
    """Streets that a sensor sees a small part of."""
    scenario = ekfslam.load_scenario("city", {"world.count": count, **changes})
    return ekfslam.simulate(scenario, seed=2)


@pytest.fixture
def ways_home(monkeypatch):
    """How often the whole map was brought up to date."""
    count, come_home = [0], CompressedEngine.come_home

    def counted(self):
        count[0] += 1
        come_home(self)

    monkeypatch.setattr(CompressedEngine, "come_home", counted)
    return count


@pytest.mark.parametrize("area", AREAS)
@pytest.mark.parametrize("scenario", ["loop-15", "park", "team"])
def test_the_compressed_filter_is_the_full_one(scenario, area):
    dataset = drawn(scenario)
    assert_same(EkfCompressed(area=area).estimate(dataset), Ekf().estimate(dataset), EXACT)


@pytest.mark.parametrize("area", [10, 100])
def test_on_victoria_park(area):
    dataset = ekfslam.load("victoria-park")
    assert_same(EkfCompressed(area=area).estimate(dataset), Ekf().estimate(dataset), EXACT)


def test_on_city_trees(recorded_data):
    dataset = recorded_data("city-trees/mc0")
    assert_same(EkfCompressed().estimate(dataset), Ekf().estimate(dataset), EXACT)


@pytest.mark.parametrize("association", ["known", "nearest", "joint", "maximum-likelihood"])
def test_in_a_city_with_and_without_identities(association, ways_home):
    """Recognition finds the same landmarks on the local map as on the whole."""
    dataset = city()
    full = Ekf(association).estimate(dataset)
    assert_same(EkfCompressed(association, area=40).estimate(dataset), full, EXACT)
    assert ways_home[0] > 5
    assert len(full.landmarks) > 200


@pytest.mark.parametrize(
    "options",
    [
        {"update": "sequential"},
        {"association": "nearest", "matching": "one-by-one"},
        {"association": "nearest", "confirm": 2},
        {"known_gate": 0.95},
        {"association": "euclidean"},
    ],
    ids=str,
)
def test_options_mean_what_they_mean(options):
    dataset = city(120)
    assert_same(
        EkfCompressed(**options, area=15).estimate(dataset), Ekf(**options).estimate(dataset), EXACT
    )


def test_a_look_that_is_larger_than_the_area():
    dataset = drawn("loop-15")
    assert np.diff(dataset.offsets).max() > 2
    assert_same(EkfCompressed(area=1).estimate(dataset), Ekf().estimate(dataset), EXACT)


def test_an_area_that_holds_all_never_needs_the_way_home(ways_home):
    EkfCompressed(area=100).estimate(drawn("park"))
    assert ways_home[0] == 1  # at the end


def test_a_revisit_is_no_new_landmark(ways_home):
    """Three laps of park, small areas: every landmark has left its area and come back."""
    estimate = EkfCompressed(area=10).estimate(drawn("park"))
    assert ways_home[0] > 10
    assert len(np.unique(estimate.landmarks.ids)) == len(estimate.landmarks)
    assert (estimate.innovations.decision == Decision.NEW).sum() == len(estimate.landmarks)


def test_without_noise_it_says_the_truth():
    dataset = ekfslam.simulate("park", seed=1, draw=0.0)
    estimate = EkfCompressed(area=10).estimate(dataset)
    truth = dataset.robots[0].truth
    np.testing.assert_allclose(geo.additive_error(estimate.online.poses, truth), 0.0, atol=1e-9)


def test_asked_at_any_step_and_afterwards_it_goes_on():
    dataset = city(120)
    compressed = EkfSlam(dataset.prior, estimator="ekf-compressed", area=15)
    full = EkfSlam(dataset.prior)
    asked = np.random.default_rng(5).random(dataset.poses) < 0.03
    for k, step in enumerate(dataset.steps()):
        for slam in (compressed, full):
            slam.predict(step.increment, step.covariance)
            slam.observe(step.observations)
        np.testing.assert_allclose(compressed.pose, full.pose, atol=EXACT)
        np.testing.assert_allclose(compressed.pose_covariance, full.pose_covariance, atol=EXACT)
        if asked[k]:
            one, other = compressed.landmarks, full.landmarks
            np.testing.assert_array_equal(one.ids, other.ids)
            np.testing.assert_allclose(one.positions, other.positions, atol=EXACT)
            np.testing.assert_allclose(one.covariance, other.covariance, atol=EXACT)


def test_one_landmark_beyond_the_area_is_as_in_the_whole_map(ways_home):
    dataset = city(120)
    compressed = EkfSlam(dataset.prior, estimator="ekf-compressed", area=15)
    full = EkfSlam(dataset.prior)
    for step in list(dataset.steps())[:200]:
        for slam in (compressed, full):
            slam.predict(step.increment, step.covariance)
            slam.observe(step.observations)
    ids, before = full.landmarks.ids, ways_home[0]
    beyond = [i for i in ids if compressed._engine.register.offsets[compressed._index(i)] < 0]
    assert len(beyond) > 20
    for landmark in beyond[:10]:
        for a, b in zip(compressed.landmark(landmark), full.landmark(landmark), strict=True):
            np.testing.assert_allclose(a, b, atol=EXACT)
    assert ways_home[0] == before
    np.testing.assert_allclose(
        compressed.landmarks.covariance, full.landmarks.covariance, atol=1e-8
    )


def test_deletion_wherever_a_landmark_stands():
    dataset = city(120)
    compressed = EkfSlam(dataset.prior, estimator="ekf-compressed", area=15)
    full = EkfSlam(dataset.prior)
    for k, step in enumerate(list(dataset.steps())[:150]):
        for slam in (compressed, full):
            slam.predict(step.increment, step.covariance)
            slam.observe(step.observations)
        if k in (60, 90, 120):
            gone = [int(full._names()[0]), int(full._names()[-1])]  # far away, and in sight
            for slam in (compressed, full):
                for landmark in gone:
                    if landmark in slam.landmarks.ids:
                        slam.delete(landmark)
    np.testing.assert_array_equal(compressed.landmarks.ids, full.landmarks.ids)
    np.testing.assert_allclose(
        compressed.landmarks.covariance, full.landmarks.covariance, atol=EXACT
    )
    with pytest.raises(InputError, match="no landmark 999"):
        compressed.landmark(999)


def test_it_tells_what_it_linearised():
    """So that the linear oracle can check it."""
    dataset = drawn("loop-15")
    _, ours = EkfCompressed(area=3).linearizations(dataset)
    _, full = Ekf().linearizations(dataset)
    np.testing.assert_array_equal(ours.landmark, full.landmark)
    np.testing.assert_allclose(ours.jacobian, full.jacobian, atol=EXACT)
    np.testing.assert_allclose(ours.point, full.point, atol=EXACT)


# What may be in view -----------------------------------------------------------------------------


def watcher(reach, sigma):
    """Sees all around to a short range."""
    return Sensor("xy", sigma**2 * np.eye(2), max_range=reach)


def both(*priors, **options):
    """The full filter and the compressed one, step by step, for identities that are not known."""
    return (
        EkfSlam(list(priors), association="nearest", **options),
        EkfSlam(
            list(priors), association="nearest", estimator="ekf-compressed", area=20, **options
        ),
    )


def test_what_a_correction_has_moved_far_away_is_found_where_it_now_is():
    """A way of 60 m that was 23 m off to the side; at its end a landmark, out of the area.

    Another one, which stands beyond the range, is nearer than it was, and has not moved.
    """
    sensor, still, off = watcher(2.0, 0.05), 1e-6 * np.eye(3), np.diag([1e-4, 36.0, 1e-9])
    for slam in both(Prior(), accept=0.9999):
        slam.observe(Sightings.of(sensor, [[1.0, 1.0]]))
        slam.predict([62.0, 25.0, 0.0], still)
        slam.observe(Sightings.of(sensor, [[1.0, 1.0]]))
        slam.predict([-62.0, -25.0, 0.0], still)
        slam.predict([60.0, 0.0, 0.0], off)
        slam.observe(Sightings.of(sensor, [[1.0, 1.0]]))
        assert len(slam.landmarks) == 3
        slam.predict([-60.0, 0.0, 0.0], still)
        again = slam.observe(Sightings.of(sensor, [[1.0, 1.0 - 23.0]]))
        assert again.landmark.tolist() == [0]
        np.testing.assert_allclose(slam.pose[:2], [0.0, 23.0], atol=0.2)
        slam.predict([60.0, 0.0, 0.0], still)
        again = slam.observe(Sightings.of(sensor, [[1.0, 1.0]]))
        assert again.landmark.tolist() == [2]


def test_what_one_robot_has_mapped_is_in_view_of_another():
    """While the first is far away, and another landmark is nearer."""
    sensor, still = watcher(2.5, 0.1), np.tile(1e-6 * np.eye(3), (2, 1, 1))
    for slam in both(Prior(), Prior([100.0, 1.0, 0.0])):
        for along in (0.0, 4.0):
            slam.predict([[along, 0.0, 0.0], np.zeros(3)], still)
            slam.observe(Sightings.of(sensor, [[1.0, 1.0]]))
        assert len(slam.landmarks) == 2
        slam.predict([[60.0, 0.0, 0.0], [-96.7, 0.0, 0.0]], still)
        again = slam.observe(Sightings.of(sensor, [[-2.3, 0.0]], robot=1))
        assert again.landmark.tolist() == [0]


def test_what_one_robot_learns_of_another_moves_its_landmarks_too():
    """Before any landmark is in the area. Then each sees it, far away from the other."""
    sensor, still = watcher(2.0, 0.1), np.tile(1e-6 * np.eye(3), (2, 1, 1))
    far = Prior([20.0, 20.0, 0.0], np.diag([25.0, 25.0, 1e-6]))  # in truth at the origin
    for slam in both(far, Prior([60.0, 1.0, 0.0], 1e-6 * np.eye(3))):
        slam.observe(Sightings.of(sensor, [[1.0, 1.0]]))
        assert len(slam.landmarks) == 1
        slam.predict([[60.0, 0.0, 0.0], [0.0, 0.0, 0.0]], still)
        slam.observe(Sightings.of(sensor, [[0.0, -1.0]], robot=1, observed_robot=[0]))
        np.testing.assert_allclose(slam.pose[0], [60.0, 0.0, 0.0], atol=0.1)
        for moves in ([-60.0, 0.0], [60.0, -60.0]):
            slam.predict([[along, 0.0, 0.0] for along in moves], still)
            robot = 0 if moves[0] < 0 else 1
            value = [[1.0, 1.0 - robot]]
            again = slam.observe(Sightings.of(sensor, value, robot=robot))
            assert again.landmark.tolist() == [0]


@pytest.mark.parametrize("errs", ["the sensor", "the map"])
def test_what_stands_beyond_the_range_may_be_in_view_if_so_much_is_not_known(errs):
    """And another landmark, behind, is nearer."""
    precise, rough = watcher(2.0, 0.05), watcher(2.0, 3.0)
    still, looks = 1e-9 * np.eye(3), 50 if errs == "the sensor" else 1
    for slam in both(Prior()):
        for _ in range(looks):
            slam.predict(np.zeros(3), still)
            slam.observe(Sightings.of(rough, [[1.0, 0.0]]))
        slam.predict([-14.0, 0.0, 0.0], still)
        slam.observe(Sightings.of(precise, [[-1.0, 0.0]]))
        assert len(slam.landmarks) == 2
        slam.predict([6.0, 0.0, 0.0], still)  # 7 m from one, 9 m from the other
        now = rough if errs == "the sensor" else precise
        again = slam.observe(Sightings.of(now, [[2.0, 0.0]]))
        assert again.landmark.tolist() == [0]


def test_after_a_look_that_fails_it_goes_on_as_the_full_one_does():
    """One after another: what was used before the failure counts."""
    exact, points = watcher(20.0, 1e-15), [[3.0, 1.0], [4.0, -2.0], [5.0, 2.0], [2.0, 2.2]]
    met = []
    for slam in both(Prior(covariance=np.diag([1.0, 1.0, 0.1])), update="sequential"):
        slam.observe(Sightings.of(exact, points))
        assert len(slam.landmarks) == 4
        with pytest.raises(InputError, match="not positive definite"):
            slam.observe(Sightings.of(exact, points))
        again = slam.observe(Sightings.of(watcher(20.0, 0.1), points))
        met.append((again.decision.tolist(), again.landmark.tolist()))
    assert met[0] == met[1]


def test_a_landmark_that_is_far_away_is_deleted_while_others_are_in_the_area():
    dataset = city(120)
    slams = [EkfSlam(dataset.prior, estimator="ekf-compressed", area=15), EkfSlam(dataset.prior)]
    for slam in slams:
        for k, step in enumerate(list(dataset.steps())[:100]):
            slam.predict(step.increment, step.covariance)
            slam.observe(step.observations)
            if k == 90:
                slam.delete(int(slam._names()[0]))
    one, other = (slam.landmarks for slam in slams)
    np.testing.assert_array_equal(one.ids, other.ids)
    np.testing.assert_allclose(one.covariance, other.covariance, atol=EXACT)


def test_all_landmarks_can_be_asked_for_one_by_one():
    """More than the local map has room for."""
    dataset = city(120)
    slams = [EkfSlam(dataset.prior, estimator="ekf-compressed", area=1), EkfSlam(dataset.prior)]
    for slam in slams:
        for step in list(dataset.steps())[:150]:
            slam.predict(step.increment, step.covariance)
            slam.observe(step.observations)
    for landmark in slams[1].landmarks.ids.tolist():
        for a, b in zip(*(slam.landmark(landmark) for slam in slams), strict=True):
            np.testing.assert_allclose(a, b, atol=EXACT)


def test_where_all_may_be_seen_the_area_grows_instead_of_going_home_for_every_look(ways_home):
    """A sensor of unlimited range without identities: every landmark is brought in, once."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-50, 50, (60, 2))
    sensor = ekfslam.Sensor("xy", 0.01 * np.eye(2))
    slam = EkfSlam(association="nearest", estimator="ekf-compressed", area=5)
    slam.observe(ekfslam.Sightings.of(sensor, points))
    for k in range(6):
        slam.predict([0.1, 0.0, 0.0], 1e-4 * np.eye(3))
        seen = points[:5] - [0.1 * (k + 1), 0.0]
        assert set(slam.observe(ekfslam.Sightings.of(sensor, seen)).landmark) == set(range(5))
    assert ways_home[0] <= 2


def test_known_looks_larger_than_the_area_do_not_go_home_for_every_new_landmark(ways_home):
    rng = np.random.default_rng(1)
    points = rng.uniform(-50, 50, (40, 2))
    sensor = ekfslam.Sensor("xy", 0.01 * np.eye(2))
    slam = EkfSlam(estimator="ekf-compressed", area=5)
    for k in range(10, 40):  # each look has one more
        slam.predict([0.0, 0.0, 0.0], 1e-6 * np.eye(3))
        slam.observe(ekfslam.Sightings.of(sensor, points[:k], np.arange(k)))
    assert ways_home[0] <= 6


@pytest.mark.parametrize("association", ["known", "nearest"])
def test_many_landmarks_seen_once_do_not_make_the_area_smaller_or_larger(association, ways_home):
    """A survey of all, then a few at a time: the next look leaves the survey's area behind."""
    rng = np.random.default_rng(2)
    points = rng.uniform(-50, 50, (200, 2))
    near = np.flatnonzero(np.hypot(*points.T) < 10.0)
    survey = ekfslam.Sensor("xy", 1e-4 * np.eye(2))
    laser = ekfslam.Sensor("xy", 1e-4 * np.eye(2), max_range=10.5, name="laser")
    slam = EkfSlam(association=association, estimator="ekf-compressed", area=20)
    full = int(slam._engine.area.full[0])
    known = association == "known"
    slam.observe(ekfslam.Sightings.of(survey, points, np.arange(200) if known else None))
    for _ in range(5):
        slam.predict([0.0, 0.0, 0.0], 1e-6 * np.eye(3))
        slam.observe(ekfslam.Sightings.of(laser, points[near], near if known else None))
    assert slam._engine.area.full[0] == full
    assert slam._engine.slam.size <= full
    assert ways_home[0] == 1
    assert len(slam.landmarks) == 200


def test_a_generous_area_takes_no_memory_that_it_does_not_need():
    dataset = drawn("loop-15")
    assert_same(EkfCompressed(area=10**8).estimate(dataset), Ekf().estimate(dataset), EXACT)


def test_reading_landmarks_does_not_fill_the_area():
    dataset = city(120)
    slam = EkfSlam(dataset.prior, estimator="ekf-compressed", area=15)
    for step in list(dataset.steps())[:200]:
        slam.predict(step.increment, step.covariance)
        slam.observe(step.observations)
    size = slam._engine.slam.size
    for landmark in slam._names().tolist():
        slam.landmark(landmark)
    assert slam._engine.slam.size == size


# Parts -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rank", [0, 1, 4, 9])
def test_a_square_root_of_any_rank(rank, rng):
    scale = 10.0 ** rng.uniform(-4, 4, 9)  # radians and metres
    half = scale[:, None] * rng.normal(size=(9, rank))
    half[3] = 0.0  # nothing was seen of it
    psi = half @ half.T
    root = local_map.square_root(psi)
    assert root.shape == (9, min(rank, 8))
    unit = np.outer(scale, scale)
    np.testing.assert_allclose(root @ root.T / unit, psi / unit, atol=1e-12)


# What cannot be used -----------------------------------------------------------------------------


@pytest.mark.parametrize("area", [0, -3, 2.5, True, "all"])
def test_an_area_that_makes_no_sense(area):
    with pytest.raises(InputError, match="area"):
        EkfCompressed(area=area)


@pytest.mark.parametrize("option", [{"forget": 5}, {"corrupt": 2, "known_gate": 0.9}, {"delay": 5}])
def test_options_that_the_local_map_does_not_know(option):
    with pytest.raises(InputError, match=f"no option {next(iter(option))}"):
        EkfCompressed(**option)


@pytest.mark.parametrize("scenario", ["cloister-bearing", "cloister-range"])
def test_partial_views_are_refused(scenario):
    with pytest.raises(UnsupportedError, match="ekf-compressed needs sensors that determine"):
        EkfCompressed().estimate(drawn(scenario))
    dataset = drawn(scenario)
    slam = EkfSlam(dataset.prior, estimator="ekf-compressed")
    with pytest.raises(UnsupportedError, match="ekf-compressed needs sensors that determine"):
        slam.observe(dataset.sightings.rows(0, 1))
