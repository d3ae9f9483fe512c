"""The linear oracle against filters right and wrong, and the filter where all is linear anyway."""

from dataclasses import fields, replace

import numpy as np
import psutil
import pytest
from corridor import corridor
from linear_case import known_headings, least_squares
from numerics import subtract_angles
from problems import rows_kept
from textbook import TextbookEkf, two_sensors

from baselines import linear_oracle
from baselines.linear_oracle import solve
from ekfslam import geometry as geo
from ekfslam.dataset import Prior
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Linearizations
from ekfslam.filters.ekf import Ekf
from ekfslam.simulation import load_scenario, simulate

OBSERVED, CREATED, CONVERTED = range(3)
UPDATES = ("joint", "sequential")


def drawn(name, seed=1):
    return simulate(two_sensors() if name == "full" else load_scenario(name), seed=seed)


def deviations(dataset, estimate, linear):
    """Largest differences to the oracle: of means, and of the joint covariance (relative)."""
    solution = solve([robot.prior for robot in dataset.robots], linear)
    landmarks, robots = estimate.landmarks, len(dataset.robots)
    open_ids = [] if landmarks.undetermined is None else landmarks.undetermined.tolist()
    first = 3 * robots
    place = {i: (first + 2 * n, 2) for n, i in enumerate(solution.ids.tolist())}
    first += 2 * len(place)
    place |= {i: (first + 4 * n, 4) for n, i in enumerate(solution.undetermined.tolist())}
    ours = [place[i] for i in (*landmarks.ids.tolist(), *open_ids)]
    rows = [*range(3 * robots), *(at + j for at, size in ours for j in range(size))]
    mean = np.concatenate(
        [solution.poses.ravel(), solution.positions.ravel(), solution.inverse_depth.ravel()]
    )
    final = estimate.online.poses.reshape(robots, -1, 3)[:, -1]
    inverse_depth = np.zeros(0) if not open_ids else landmarks.inverse_depth.ravel()
    mine = np.concatenate([final.ravel(), landmarks.positions.ravel(), inverse_depth])
    means = np.abs(mine - mean[rows])
    means = np.minimum(means, 2 * np.pi - means)  # angles among them; nothing else is near 2 pi
    covariance = solution.covariance[np.ix_(rows, rows)]
    off = np.abs(estimate.joint_covariance - covariance).max()
    return means.max(), off / np.abs(covariance).max()


# Filters --------------------------------------------------------------------------------------

FULL = ("cloister", "loop-15", "full", "team", "hand-held")
PARTIAL = ("two-sensors", "cloister-bearing", "cloister-range")


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("name", FULL + PARTIAL)
def test_gives_the_final_state_of_the_filter_to_round_off(name, update):
    """Of several sensors and robots; with known starts and singular motions; with inverse depths
    that become points, and ranges that come late, from poses that are past.
    """
    dataset = drawn(name)
    assert max(deviations(dataset, *Ekf(update=update).linearizations(dataset))) < 2e-12


@pytest.mark.parametrize("name", ["loop-15", "team"])
def test_gives_the_final_state_of_the_textbook_filter_too(name):
    """Whose covariances, a plain difference, are worse by a digit or two."""
    dataset = drawn(name)
    assert max(deviations(dataset, *TextbookEkf().linearizations(dataset))) < 1e-10


@pytest.mark.parametrize("name", ["loop-15", "team"])
def test_deletion_leaves_no_trace(name, rng):
    """Also where a landmark that was deleted comes back under its identity."""
    dataset = drawn(name)
    dataset = rows_kept(dataset, rng.random(len(dataset.observations)) < 0.3)
    estimate, linear = Ekf(forget=3).linearizations(dataset)
    made = linear.landmark[linear.event == CREATED]
    assert len(made) > len(np.unique(made)) > len(estimate.landmarks)
    assert max(deviations(dataset, estimate, linear)) < 2e-12


@pytest.mark.parametrize("name", ["cloister", "loop-15"])
def test_a_landmark_that_knows_nothing_of_the_robot_shows(name):
    dataset = drawn(name)
    means, covariance = deviations(
        dataset, *TextbookEkf("no-cross-covariance").linearizations(dataset)
    )
    assert means > 1e-3
    assert covariance > 0.1


@pytest.mark.parametrize(
    ("name", "event", "size"),
    [
        ("loop-15", OBSERVED, 2),
        ("team", OBSERVED, 3),
        ("cloister-bearing", OBSERVED, 4),
        ("cloister-bearing", CREATED, 4),
        ("cloister-bearing", CONVERTED, 4),
    ],
)
def test_a_jacobian_that_was_not_used_shows(name, event, size):
    dataset = drawn(name)
    estimate, linear = Ekf().linearizations(dataset)
    changed = linear.jacobian.copy()
    at = np.flatnonzero((linear.event == event) & (linear.size == size))[10]
    columns = slice(None, 3) if event == CREATED else slice(3, None)
    changed[at, :, columns] *= 1.1
    means, covariance = deviations(dataset, estimate, replace(linear, jacobian=changed))
    assert means > 1e-8
    assert covariance > 1e-8


def test_what_a_filter_believes_wrongly_is_hidden_from_it():
    """The oracle checks the bookkeeping; a wrong noise shows only against the true model."""
    dataset = drawn("loop-15")
    assert max(deviations(dataset, *TextbookEkf("wrong-noise").linearizations(dataset))) < 2e-12


# A toy of every kind of event, against conditioning of one joint Gaussian ---------------------


class Gaussian:
    """Named vectors with a joint Gaussian, extended and conditioned the textbook way."""

    def __init__(self):
        self.mean, self.covariance, self.at = np.zeros(0), np.zeros((0, 0)), {}

    def extend(self, name, constant, terms, noise):
        """A vector ``constant + sum A x + v`` of vectors x that are there; renames, if it is."""
        A = self._matrix(terms, len(constant))
        cross = A @ self.covariance
        self.covariance = np.block(
            [[self.covariance, cross.T], [cross, A @ self.covariance @ A.T + noise]]
        )
        self.at[name] = slice(len(self.mean), len(self.mean) + len(constant))
        self.mean = np.concatenate([self.mean, constant + A @ self.mean])

    def condition(self, value, terms, noise):
        """Learn that ``value = sum A x + v``."""
        A = self._matrix(terms, len(value))
        gain = np.linalg.solve(A @ self.covariance @ A.T + noise, A @ self.covariance).T
        self.mean = self.mean + gain @ (value - A @ self.mean)
        reduced = np.eye(len(self.mean)) - gain @ A
        self.covariance = reduced @ self.covariance @ reduced.T + gain @ noise @ gain.T

    def _matrix(self, terms, rows):
        matrix = np.zeros((rows, len(self.mean)))
        for name, A in terms:
            matrix[:, self.at[name]] += A
        return matrix


class Toy:
    """Linear models as a filter might have used them, written down twice.

    The record has angles wrapped; the Gaussian of absolute values has not. Headings and directions
    scatter about pi, so that wrapping is all over the place.
    """

    def __init__(self, seed, priors, singular):
        self.rng, self.events = np.random.default_rng(seed), []
        self.gaussian, self.steps = Gaussian(), 8
        motions = []
        for robot, prior in enumerate(priors):
            name = (robot, "prior")
            self.gaussian.extend(name, prior.mean, [], prior.covariance)
            for k in range(self.steps):
                F = np.eye(3) + 0.1 * self.rng.normal(size=(3, 3))
                before, after = self._pose(), self._pose()
                noise = self._noise(3)
                if singular:
                    vector = self.rng.normal(size=(3, int(self.rng.integers(3))))
                    noise = 0.05 * vector @ vector.T
                self.gaussian.extend((robot, k), after - F @ before, [(name, F)], noise)
                name = (robot, k)
                motions.append((before, after, F, noise))
        shape = len(priors), self.steps
        columns = zip(*motions, strict=True)
        self.motion = [np.array(c).reshape(*shape, *np.shape(c[0])) for c in columns]

    def _pose(self):
        return np.array([30.0, -20.0, np.pi]) + 0.1 * self.rng.normal(size=3)

    def _ray(self):
        return np.array([25.0, -25.0, np.pi, 0.2]) + 0.1 * self.rng.normal(size=4)

    def _noise(self, size):
        root = self.rng.normal(size=(size, size + 2))
        return 0.02 * root @ root.T

    def _note(self, event, robot, k, landmark, target, size, point, jacobian, innovation, noise):
        rows = len(innovation)
        wide = np.zeros(7), np.zeros((4, 7)), np.zeros(4), np.zeros((4, 4))
        wide[0][: len(point)] = point
        wide[1][:rows, : jacobian.shape[1]] = jacobian
        wide[2][:rows], wide[3][:rows, :rows] = innovation, noise
        self.events.append((event, len(self.events), robot, k, landmark, target, size, rows, *wide))

    def create(self, landmark, robot, k, size):
        """A point, or an inverse depth whose first two coordinates are those of a sensor."""
        point = np.concatenate([self._pose(), self._ray()[:size]])
        G, noise = self.rng.normal(size=(size, 3)), self._noise(size)
        if size == 4:
            noise[:2] = noise[:, :2] = 0.0
        constant = point[3:] - G @ point[:3]
        self.gaussian.extend(landmark, constant, [((robot, k), G)], noise)
        self._note(CREATED, robot, k, landmark, -1, size, point, G, np.zeros(size), noise)

    def observe(self, landmark, robot, k, rows=2, target=-1):
        name = landmark if target < 0 else (target, k)
        size = self.gaussian.at[name].stop - self.gaussian.at[name].start
        seen = self._pose() if target >= 0 else self._ray()[:size]
        point = np.concatenate([self._pose(), seen])
        H, noise = self.rng.normal(size=(rows, 3 + size)), self._noise(rows)
        innovation = 0.1 * self.rng.normal(size=rows)
        terms = [((robot, k), H[:, :3]), (name, H[:, 3:])]
        self.gaussian.condition(innovation + H @ point, terms, noise)
        identity = landmark if target < 0 else -1
        self._note(OBSERVED, robot, k, identity, target, size, point, H, innovation, noise)

    def convert(self, landmark):
        point, J = np.concatenate([np.zeros(3), self._ray()]), self.rng.normal(size=(2, 4))
        there = self.rng.normal(size=2)
        constant = there - J @ point[3:]
        self.gaussian.extend(landmark, constant, [(landmark, J)], np.zeros((2, 2)))
        wide = np.concatenate([np.zeros((2, 3)), J], axis=1)
        none = np.zeros((2, 2))
        self._note(CONVERTED, 0, 0, landmark, -1, 4, point, wide, there, none)

    @property
    def linear(self):
        names = [f.name for f in fields(Linearizations)][4:]
        columns = dict(zip(names, map(np.array, zip(*self.events, strict=True)), strict=True))
        before, after, jacobian, noise = self.motion
        for poses in (before, after):
            poses[..., 2] = geo.wrap(poses[..., 2])
        points = columns["point"]
        points[:, 2] = geo.wrap(points[:, 2])
        angular = columns["size"] > 2
        points[angular, 5] = geo.wrap(points[angular, 5])
        return Linearizations(before, after, jacobian, noise, **columns)

    def play(self):
        """Everything that a filter may do to landmarks, from two robots."""
        self.create(7, 0, 0, size=2)
        self.create(3, 1, 0, size=4)
        self.observe(3, 1, 1, rows=1)
        self.observe(7, 1, 2)
        self.observe(-1, 0, 2, target=1)
        self.create(5, 0, 3, size=4)
        self.observe(5, 0, 3, rows=1)
        self.observe(3, 0, 3)
        self.convert(3)
        self.observe(3, 1, 4)
        self.observe(5, 1, 4, rows=1)
        self.create(7, 1, 4, size=4)  # deleted before, and made again of another kind
        self.observe(7, 0, 5, rows=1)
        self.observe(-1, 1, 5, rows=1, target=0)
        self.observe(7, 1, 2, rows=1)  # what was kept back comes late, from an earlier pose
        self.observe(3, 0, 1)
        self.create(9, 0, 6, size=2)
        self.observe(9, 1, 6)
        self.observe(3, 0, 7)


KNOWN = [Prior([30, -20, 3.1]), Prior([31, -19, -3.1])]
LOOSE = [
    Prior([30, -20, 3.1], np.diag([0.1, 0.2, 0.05])),
    Prior([31, -19, -3.1], [[0.2, 0.1, 0], [0.1, 0.1, 0.02], [0, 0.02, 0.05]]),
]
HALF = [LOOSE[0], Prior([31, -19, -3.1], np.diag([0, 0.3, 0]))]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("singular", [False, True])
@pytest.mark.parametrize("priors", [KNOWN, LOOSE, HALF], ids=["known", "loose", "half known"])
def test_every_kind_of_event_against_conditioning(priors, singular, seed):
    turn = np.array([0, 0, 2 * np.pi])
    unwrapped = [Prior(p.mean + turn * (p.mean[2] < 0), p.covariance) for p in priors]
    toy = Toy(seed, unwrapped, singular)
    toy.play()
    solution = solve(priors, toy.linear)
    assert solution.ids.tolist() == [3, 9]
    assert solution.undetermined.tolist() == [7, 5]
    names = [(0, 7), (1, 7), 3, 9, 7, 5]
    places = [toy.gaussian.at[name] for name in names]
    expected = [toy.gaussian.mean[place] for place in places]
    poses, points, rays = (np.array(expected[i : i + 2]) for i in (0, 2, 4))
    for actual, mean, angle in (
        (solution.poses, poses, 2),
        (solution.positions, points, None),
        (solution.inverse_depth, rays, 2),
    ):
        off = actual - mean
        if angle is not None:
            off[:, angle] = subtract_angles(actual[:, angle], mean[:, angle])
            assert (np.abs(actual[:, angle]) <= np.pi).all()
        np.testing.assert_allclose(off, 0, rtol=0, atol=1e-10 * np.abs(mean).max())
    rows = np.concatenate([np.arange(place.start, place.stop) for place in places])
    covariance = toy.gaussian.covariance[np.ix_(rows, rows)]
    off = solution.covariance - covariance
    np.testing.assert_allclose(off, 0, rtol=0, atol=1e-10 * np.abs(covariance).max())


def test_a_landmark_without_a_prior_is_the_limit_of_a_wide_one():
    def solved(variance):
        toy = Toy(5, LOOSE[:1], False)
        toy.create(4, 0, 1, size=2)
        for k in (1, 2, 3):
            toy.observe(4, 0, k, rows=1)
        linear = toy.linear
        jacobian, noise, rows = (a.copy() for a in (linear.jacobian, linear.noise, linear.rows))
        jacobian[0], noise[0], rows[0] = 0.0, variance * np.eye(4), 2 if variance else 0
        return solve(LOOSE[:1], replace(linear, jacobian=jacobian, noise=noise, rows=rows))

    flat, wide = solved(0.0), solved(1e7)
    np.testing.assert_allclose(flat.poses, wide.poses, rtol=0, atol=1e-5)
    np.testing.assert_allclose(flat.covariance, wide.covariance, rtol=0, atol=1e-5)


# Large problems ---------------------------------------------------------------------------------


def test_the_covariance_does_not_depend_on_how_many_columns_are_solved_at_once(monkeypatch):
    dataset = drawn("team")
    linear = Ekf().linearizations(dataset)[1]
    priors = [robot.prior for robot in dataset.robots]
    whole = solve(priors, linear)
    monkeypatch.setattr(linear_oracle, "AT_ONCE", 5)
    parts = solve(priors, linear)
    size = np.abs(whole.covariance).max()
    off = np.abs(parts.covariance - whole.covariance).max()
    assert len(whole.covariance) > 2 * 5
    assert off < 1e-13 * size
    for solution in (whole, parts):
        np.testing.assert_array_equal(solution.covariance, solution.covariance.T)


def test_the_factor_grows_like_the_run(monkeypatch):
    """A dense one, or one of landmarks that all hang together, has four times the entries."""
    entries = []
    eliminated = linear_oracle._Problem._eliminated

    def watched(problem):
        R, d, first = eliminated(problem)
        entries.append(R.nnz)
        return R, d, first

    monkeypatch.setattr(linear_oracle._Problem, "_eliminated", watched)
    for steps in (60, 120):
        dataset = corridor(steps)
        solve([dataset.prior], Ekf().linearizations(dataset)[1])
    assert entries[1] < 2.4 * entries[0]


def test_a_covariance_that_does_not_fit_is_refused(monkeypatch):
    memory = psutil.virtual_memory()._replace(available=500)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: memory)
    dataset = drawn("cloister")
    estimate, linear = Ekf().linearizations(dataset)
    size = 3 + 2 * len(estimate.landmarks)
    with pytest.raises(UnsupportedError, match=rf"of {size} coordinates .* 500 B are free"):
        solve([dataset.prior], linear)


# The linear case --------------------------------------------------------------------------------


@pytest.mark.parametrize("update", UPDATES)
def test_the_linear_case_is_batch_least_squares(update):
    dataset = known_headings()
    ids, solution, covariance = least_squares(dataset)
    estimate = Ekf(update=update).estimate(dataset)
    last = dataset.poses - 1
    np.testing.assert_allclose(estimate.online.poses[-1, :2], solution[last], rtol=0, atol=1e-11)
    np.testing.assert_array_equal(estimate.landmarks.ids, ids)
    positions = estimate.landmarks.positions
    np.testing.assert_allclose(positions, solution[last + 1 :], rtol=0, atol=1e-11)
    known = np.delete(np.arange(len(estimate.joint_covariance)), 2)
    marginal = covariance[2 * last :, 2 * last :]
    joint = estimate.joint_covariance[np.ix_(known, known)]
    np.testing.assert_allclose(joint, marginal, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(estimate.joint_covariance[2], 0)  # the heading stays known


def test_joint_and_sequential_agree_in_the_linear_case_and_only_there():
    joint, sequential = (Ekf(update=update).estimate(known_headings()) for update in UPDATES)
    difference = joint.online.poses - sequential.online.poses
    np.testing.assert_allclose(difference, 0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(joint.joint_covariance, sequential.joint_covariance, atol=1e-13)
    np.testing.assert_allclose(joint.step_nis, sequential.step_nis, rtol=1e-9)
    bent = [Ekf(update=update).estimate(drawn("full")).online.poses for update in UPDATES]
    assert np.abs(bent[0] - bent[1]).max() > 1e-6
