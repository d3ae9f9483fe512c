"""Who saw whom: the gates, the choice from a table of distances, and whole runs without names."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from textbook import two_sensors

from ekfslam import geometry as geo
from ekfslam.association.gates import Gates, chi2_gate
from ekfslam.association.nearest import AMBIGUOUS, NEW, nearest_neighbour
from ekfslam.dataset import LandmarkMap, Prior, Sightings
from ekfslam.errors import InputError
from ekfslam.estimates import Decision
from ekfslam.filters.ekf import Ekf, EkfSlam
from ekfslam.models.sensors import Sensor
from ekfslam.simulation import load_scenario, simulate

# Gates ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("probability", "dof", "squared"),
    [(0, 2, 0), (0.95, 2, 5.9915), (0.98889, 2, 9.0), (0.99, 2, 9.2103), (0.999, 2, 13.8155),
     (0.95, 3, 7.8147), (0.99, 3, 11.3449), (0.6827, 1, 1.0)],
)  # fmt: skip
def test_gates_are_chi_square_quantiles(probability, dof, squared):
    assert chi2_gate(probability, dof) == pytest.approx(squared, abs=1e-3)


def test_gates_near_one_keep_their_digits():
    # For two degrees of freedom the quantile is -2 log(1 - p).
    assert chi2_gate(0.999999, 2) == pytest.approx(-2 * np.log(1e-6), rel=1e-9)


@pytest.mark.parametrize("probability", [1.0, 1.5, -0.1, float("nan")])
def test_gates_are_probabilities(probability):
    with pytest.raises(InputError, match="probability"):
        chi2_gate(probability, 2)


def test_the_gate_for_new_landmarks_is_not_inside_the_other():
    Gates(0.99, 0.99)
    with pytest.raises(InputError, match="must not be below"):
        Gates(0.99, 0.98)


# The choice -------------------------------------------------------------------------------------

INF = np.inf


@pytest.fixture(params=["compiled", "python"])
def choose(request):
    function = nearest_neighbour
    if request.param == "python":
        function = getattr(function, "py_func", function)

    def choice(distances, accept=9.0, new=25.0):
        distances = np.array(distances, dtype=float)
        out = np.full(len(distances), -9)
        function(distances, accept, new, out)
        return out.tolist()

    return choice


@pytest.mark.parametrize(
    ("distances", "expected"),
    [
        pytest.param([[4, 1, 7]], [1], id="the nearest"),
        pytest.param([[4, 4]], [0], id="the first of two alike"),
        pytest.param([[10, 20]], [AMBIGUOUS], id="too far to accept, too near to be new"),
        pytest.param([[26, 30]], [NEW], id="far from all"),
        pytest.param([[9, 30]], [0], id="on the gate to accept"),
        pytest.param([[25, 30]], [AMBIGUOUS], id="on the gate for new ones"),
        pytest.param([[INF, 3]], [1], id="a pair out of the question"),
        pytest.param([[INF, INF]], [NEW], id="nothing in question"),
        pytest.param([[], []], [NEW, NEW], id="an empty map"),
        pytest.param([[1, 8], [2, 7]], [0, AMBIGUOUS], id="claimed twice, nearer first"),
        pytest.param([[2, 7], [1, 8]], [AMBIGUOUS, 0], id="claimed twice, nearer last"),
        pytest.param([[2, 7], [2, 8]], [0, AMBIGUOUS], id="claimed twice alike"),
        pytest.param([[3], [1], [2]], [AMBIGUOUS, 0, AMBIGUOUS], id="claimed three times"),
        pytest.param([[1], [12]], [0, AMBIGUOUS], id="no claim from between the gates"),
        pytest.param([[1, 50], [50, 1]], [0, 1], id="no conflict"),
    ],
)
def test_choice_from_a_table(choose, distances, expected):
    assert choose(np.array(distances, dtype=float).reshape(len(expected), -1)) == expected


def test_choice_against_its_definition(choose, rng):
    for _ in range(50):
        table = rng.exponential(12.0, size=(6, 5))
        chosen = choose(table)
        for i, choice in enumerate(chosen):
            nearest, j = table[i].min(), int(table[i].argmin())
            rivals = [r for r in range(6) if table[r].argmin() == j and table[r].min() <= 9]
            if nearest > 25:
                assert choice == NEW
            elif nearest > 9 or min(rivals, key=lambda r: table[r, j]) != i:
                assert choice == AMBIGUOUS
            else:
                assert choice == j
        taken = [j for j in chosen if j >= 0]
        assert len(taken) == len(set(taken))


# Through the filter -----------------------------------------------------------------------------

XY = Sensor("xy", np.diag([0.01, 0.01]))
GATES = {"accept": 0.99, "new": 0.9999}  # at 3.03 and 4.29 sigmas


def a_map(*points):
    """A robot that knows exactly where it is and has seen some landmarks once."""
    slam = EkfSlam(association="nearest", **GATES)
    slam.observe(Sightings.of(XY, points))
    return slam


def test_two_gates():
    """A landmark of variance 0.01 seen with variance 0.01: sigma of the innovation is 0.1414."""
    sigma = np.sqrt(0.02)
    met = a_map([4, 0], [0, 9], [9, 9]).observe(
        Sightings.of(XY, [[4 + 3.0 * sigma, 0], [0, 9 + 3.1 * sigma], [9 + 4.3 * sigma, 9]])
    )
    assert met.decision.tolist() == [Decision.ACCEPTED, Decision.AMBIGUOUS, Decision.NEW]
    assert met.landmark.tolist() == [0, -1, 3]
    np.testing.assert_allclose(met.innovation[0], [3.0 * sigma, 0], rtol=0, atol=1e-12)
    assert np.isnan(met.innovation[1:]).all()


def test_what_is_ambiguous_changes_nothing():
    slam = a_map([4, 0])
    before = slam.landmarks
    met = slam.observe(Sightings.of(XY, [[4.5, 0]]))
    assert met.decision.tolist() == [Decision.AMBIGUOUS]
    np.testing.assert_array_equal(slam.pose, 0)
    np.testing.assert_array_equal(slam.landmarks.positions, before.positions)
    np.testing.assert_array_equal(slam.landmarks.covariance, before.covariance)


def test_one_look_sees_a_landmark_once():
    met = a_map([4, 0]).observe(Sightings.of(XY, [[4.1, 0], [3.95, 0]]))
    assert met.decision.tolist() == [Decision.AMBIGUOUS, Decision.ACCEPTED]


def test_two_looks_may_see_the_same_landmark():
    look = Sightings.of(XY, [[4.1, 0], [3.95, 0]])
    met = a_map([4, 0]).observe(look._replace(look=np.array([0, 1])))
    assert met.decision.tolist() == [Decision.ACCEPTED, Decision.ACCEPTED]
    met = a_map([9, 9]).observe(look._replace(look=np.array([0, 1])))
    assert met.decision.tolist() == [Decision.NEW, Decision.ACCEPTED]
    assert met.landmark.tolist() == [1, 1]


def test_the_uncertainty_of_the_robot_widens_the_gate():
    """What is far from a landmark for a robot that knows its pose is near for one that does not."""
    far = Sightings.of(XY, [[4.8, 0]])
    assert a_map([4, 0]).observe(far).decision.tolist() == [Decision.NEW]
    slam = a_map([4, 0])
    slam.predict(np.zeros(3), np.diag([0.2, 0.2, 0.0]))
    assert slam.observe(far).decision.tolist() == [Decision.ACCEPTED]


def test_identities_are_not_looked_at():
    dataset = simulate("loop-15", seed=1)
    blank = np.full(len(dataset.observations), -1)
    hidden = replace(dataset, observations=replace(dataset.observations, landmark=blank))
    one, other = (Ekf("nearest").estimate(d) for d in (dataset, hidden))
    np.testing.assert_array_equal(one.innovations.landmark, other.innovations.landmark)
    np.testing.assert_array_equal(one.online.poses, other.online.poses)


@cache
def park(seed):
    """The park without names: the dataset, and estimates without and with them."""
    unnamed = simulate(replace(load_scenario("park"), association="unknown"), seed=seed)
    return unnamed, Ekf().estimate(unnamed), Ekf().estimate(simulate("park", seed=seed))


def ate(estimate, dataset):
    error = geo.additive_error(dataset.truth, estimate.online.poses)[:, :2]
    return np.sqrt(np.mean(np.sum(error**2, axis=1)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nearest_neighbour_makes_no_wrong_match_in_the_park(seed):
    dataset, estimate, named = park(seed)
    assert estimate.association == "nearest"
    decision, landmark = estimate.innovations.decision, estimate.innovations.landmark
    first = decision == Decision.NEW
    true_of = dict(zip(landmark[first], dataset.true_landmark[first], strict=True))
    assert len(set(true_of.values())) == len(true_of) == len(named.landmarks)  # each mapped once
    accepted = decision == Decision.ACCEPTED
    matched = np.array([true_of[i] for i in landmark[accepted]])
    np.testing.assert_array_equal(matched, dataset.true_landmark[accepted])  # precision 1
    assert accepted.sum() > 0.99 * (~first).sum()  # recall
    # What the gate leaves out is 1 in 1000 and moves the path by less than its own error.
    assert ate(estimate, dataset) == pytest.approx(ate(named, dataset), rel=0.1)


def test_two_sensors_build_one_map():
    """What the scanner maps the camera recognises, in the same step."""
    unnamed = simulate(two_sensors(association="unknown"), seed=1)
    estimate = Ekf().estimate(unnamed)
    seen = np.unique(unnamed.true_landmark)
    assert len(estimate.landmarks) == len(seen)


def test_bearings_are_compared_around_the_circle():
    """A landmark straight behind, whose bearing jumps from pi to -pi, is recognised."""
    ring = two_sensors(
        landmarks=LandmarkMap([0, 1], [[-9.0, 0.02], [-9.0, -6.0]]),
        start=[0.0, 0.0, 0.0],
        controls=np.tile([0.1, 0.0, 0.0], (40, 1)),
        sensors=(Sensor("range-bearing", np.diag([0.01, 1e-4])),),
        prior=Prior(),
        association="unknown",
    )
    dataset = simulate(ring, seed=1)
    bearings = dataset.observations.values[dataset.true_landmark == 0, 1]
    assert bearings.min() < -3 < 3 < bearings.max()
    assert len(Ekf().estimate(dataset).landmarks) == 2
