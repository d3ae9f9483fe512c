"""Joint compatibility branch and bound, against all hypotheses tried one by one."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations, product

import numpy as np
import pytest

from ekfslam.association.gates import chi2_gate, quantiles
from ekfslam.association.joint import Factor, Pairs, extend, joint_compatibility
from ekfslam.association.nearest import AMBIGUOUS, NEW, nearest_neighbour

PLENTY = 1_000_000


@dataclass(frozen=True)
class Look:
    """A linear world: poses (x, y, theta) and landmarks as one Gaussian, seen in the x-y view.

    The observation of landmark j is its place minus the robot's, turned by a small heading.
    """

    values: np.ndarray  # (m, 2)
    rows: int
    noise: np.ndarray  # (m, 2, 2)
    landmarks: np.ndarray  # (C, 2)
    P: np.ndarray  # (3 + 2C, 3 + 2C)
    truth: np.ndarray  # (m,) landmark of each observation, -1 for clutter
    accept: float = 0.999
    new: float = 0.999999

    def H(self, j):
        x, y = self.landmarks[j]
        H = np.zeros((2, len(self.P)))
        H[:, :3] = [[-1, 0, y], [0, -1, -x]]
        H[:, 3 + 2 * j : 5 + 2 * j] = np.eye(2)
        return H[: self.rows]

    def innovation(self, i, j):
        return (self.values[i] - self.landmarks[j])[: self.rows]

    def R(self, i):
        return self.noise[i, : self.rows, : self.rows]

    @cached_property
    def distances(self):
        m, C = len(self.values), len(self.landmarks)
        return np.array([[self.joint([(i, j)]) for j in range(C)] for i in range(m)]).reshape(m, C)

    @cached_property
    def gates(self):
        m = len(self.values)
        return tuple(np.full(m, chi2_gate(p, self.rows)) for p in (self.accept, self.new))

    def joint(self, hypothesis):
        """Joint squared Mahalanobis distance of pairs (i, j), by a dense solve."""
        if not hypothesis:
            return 0.0
        H = np.concatenate([self.H(j) for _, j in hypothesis])
        S = H @ self.P @ H.T
        for k, (i, _) in enumerate(hypothesis):
            block = slice(k * self.rows, (k + 1) * self.rows)
            S[block, block] += self.R(i)
        v = np.concatenate([self.innovation(i, j) for i, j in hypothesis])
        return float(v @ np.linalg.solve(S, v))

    def compatible(self, hypothesis):
        dof = self.rows * len(hypothesis)
        return self.joint(hypothesis) <= (chi2_gate(self.accept, dof) if dof else 0.0)

    @cached_property
    def candidates(self):
        """Landmarks inside the gate of each observation."""
        return [
            np.flatnonzero(inside).tolist() for inside in self.distances <= self.gates[0][:, None]
        ]

    def pairs(self, which):
        """Pairs (i, j) as the functions under test take them; what they may not read is NaN."""
        K = len(which)
        entries = (2 * np.arange(K)[:, None] + np.arange(self.rows)).ravel()
        innovations, H_P_H = np.full(2 * K, np.nan), np.full((2 * K, 2 * K), np.nan)
        if which:
            H = np.concatenate([self.H(j) for _, j in which])
            innovations[entries] = np.concatenate([self.innovation(i, j) for i, j in which])
            H_P_H[np.ix_(entries, entries)] = H @ self.P @ H.T
        H_P_H[np.triu_indices(2 * K, 1)] = np.nan
        row, column = np.array(which, dtype=int).reshape(K, 2).T.copy()
        return Pairs(row, column, innovations, np.full(K, self.rows), H_P_H, self.noise)

    def choose(self, limit=PLENTY, which=None):
        """The function under test: whether the search was complete, and the choice."""
        m = len(self.values)
        if which is None:
            which = [(i, j) for i in range(m) for j in self.candidates[i]]
        choice = np.full(m, -9)
        joint = quantiles(self.accept, 2 * m)
        complete = joint_compatibility(
            *self.pairs(which), self.distances, *self.gates, joint, limit, choice
        )
        return complete, choice

    def in_order(self, order):
        """The same look, its observations in another order."""
        return replace(
            self, values=self.values[order], noise=self.noise[order], truth=self.truth[order]
        )


def spread(rng, n):
    """A random covariance with correlations, of unit size."""
    A = rng.normal(size=(n, n)) / np.sqrt(n)
    return A @ A.T + 0.1 * np.eye(n)


def draw(rng, m, C, rows=2, pose=0.5, field=3.0, clutter=0.3, accept=0.999):
    """A look of m observations at C landmarks from a robot lost by about its pose's sigma."""
    landmarks = rng.uniform(-field, field, size=(C, 2))
    scale = np.concatenate([[pose, pose, 0.05], np.full(2 * C, 0.1)])
    P = scale[:, None] * spread(rng, 3 + 2 * C) * scale
    noise = np.array([0.05**2 * spread(rng, 2) for _ in range(m)]).reshape(m, 2, 2)
    truth = np.full(m, -1)
    known = min(m, C)
    truth[rng.permutation(m)[:known]] = rng.permutation(C)[:known]
    truth[rng.random(m) < clutter] = -1
    look = Look(rng.uniform(-field, field, size=(m, 2)), 2, noise, landmarks, P, truth, accept)
    state = rng.multivariate_normal(np.zeros(len(P)), P)
    for i in np.flatnonzero(truth >= 0):
        noisy = rng.multivariate_normal([0, 0], noise[i])
        look.values[i] = landmarks[truth[i]] + look.H(truth[i]) @ state + noisy
    return replace(look, rows=rows)


def pairs_of(choice):
    return [(i, int(j)) for i, j in enumerate(choice) if j >= 0]


def brute_force(look):
    """The best of all compatible hypotheses: most pairs, then the smallest distance."""
    options = [[None, *look.candidates[i]] for i in range(len(look.values))]
    best = (0, 0.0, [])
    for picks in product(*options):
        pairs = [(i, j) for i, j in enumerate(picks) if j is not None]
        if len({j for _, j in pairs}) == len(pairs) and look.compatible(pairs):
            best = min(best, (-len(pairs), look.joint(pairs), pairs))
    return best[2]


def sequential(look):
    """Sequential compatibility: pairs in turn, the observation with fewest candidates first."""
    pairs, used = [], set()
    for i in sorted(range(len(look.values)), key=lambda i: len(look.candidates[i])):
        free = [j for j in look.candidates[i] if j not in used]
        if free:
            j = min(free, key=lambda j: look.joint([*pairs, (i, j)]))
            if look.compatible([*pairs, (i, j)]):
                pairs.append((i, j))
                used.add(j)
    return sorted(pairs)


def rank(look, choice):
    """Smaller is better; rounding does not count."""
    pairs = pairs_of(choice)
    return -len(pairs), round(look.joint(pairs), 6)


# What a complete search finds -------------------------------------------------------------------


@pytest.mark.parametrize("accept", [0.9, 0.999])
@pytest.mark.parametrize("rows", [1, 2])
def test_against_all_hypotheses(rng, rows, accept):
    conflicts = 0
    for _ in range(60):
        m, C = rng.integers(1, 6), rng.integers(1, 5)
        look = draw(rng, m, C, rows, accept=accept)
        complete, choice = look.choose()
        assert complete
        assert pairs_of(choice) == brute_force(look)
        conflicts += pairs_of(choice) != sequential(look)
    assert conflicts > 5  # the search had something to find


def test_the_order_of_observations_and_of_pairs_does_not_matter(rng):
    """Nor do pairs outside the gate, which are left out."""
    for _ in range(40):
        look = draw(rng, 7, 6, clutter=0.2, accept=0.95)
        order = rng.permutation(7)
        _, choice = look.choose()
        scrambled = [(i, j) for i in rng.permutation(7) for j in rng.permutation(6)]
        _, moved = look.in_order(order).choose(which=scrambled)
        np.testing.assert_array_equal(moved, choice[order])


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_a_part_outside_its_own_gate_can_grow_into_a_whole_inside(order):
    """Two observations disagree at 6.5 > 5.99 (2 dof); with the third it is 6.5 < 7.81 (3 dof)."""
    landmarks = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]])
    P = np.diag([1.0, 1.0, 0.0, *[0.0] * 6])
    noise = np.tile(np.diag([0.01, 0.01]), (3, 1, 1))
    off = np.array([[0.18, 0.0], [-0.18, 0.0], [0.0, 0.0]])
    look = Look(landmarks + off, 1, noise, landmarks, P, np.arange(3), accept=0.95)
    assert not look.compatible([(0, 0), (1, 1)])
    assert look.compatible([(0, 0), (1, 1), (2, 2)])
    assert look.in_order(list(order)).choose()[1].tolist() == list(order)


def test_the_choice_is_jointly_compatible_and_one_to_one(rng):
    for _ in range(20):
        look = draw(rng, 10, 12, pose=1.0)
        complete, choice = look.choose()
        pairs = pairs_of(choice)
        assert complete
        assert len({j for _, j in pairs}) == len(pairs)
        assert look.compatible(pairs)
        assert rank(look, choice) <= rank(look, sequential_choice(look))


def sequential_choice(look):
    choice = np.full(len(look.values), NEW)
    for i, j in sequential(look):
        choice[i] = j
    return choice


def test_observations_without_a_landmark_are_new_or_ambiguous(rng):
    seen = set()
    for _ in range(40):
        look = draw(rng, 5, 3, accept=0.9)
        _, choice = look.choose()
        for i in np.flatnonzero(choice < 0):
            beyond = look.distances[i].min() > look.gates[1][i]
            assert choice[i] == (NEW if beyond else AMBIGUOUS)
            seen.add(int(choice[i]))
    assert seen == {NEW, AMBIGUOUS}


@pytest.mark.parametrize(("m", "C"), [(0, 0), (0, 3), (3, 0)])
def test_nothing_to_choose_from(rng, m, C):
    complete, choice = draw(rng, m, C).choose(limit=0)
    assert complete
    assert choice.tolist() == [NEW] * m


def test_an_open_gate_still_leaves_out_what_has_no_distance(rng):
    look = draw(rng, 3, 3, clutter=0.0)
    pairs = look.pairs([(i, j) for i in range(3) for j in range(3)])
    apart, choice = np.full((3, 3), np.inf), np.full(3, -9)
    apart[0, 1], open_ = 1.0, np.full(3, np.inf)
    joint_compatibility(*pairs, apart, open_, look.gates[1], np.full(7, np.inf), PLENTY, choice)
    assert choice.tolist() == [1, NEW, NEW]


def test_a_common_error_is_seen_through():
    """A robot 0.8 m off its estimate sees three posts; each alone fits another post better."""
    landmarks = np.array([[0.0, 0.0], [1.0, 0.0], [2.5, 0.0], [3.3, 0.0]])
    P = np.diag([1.0, 1.0, 1e-6, *[1e-4] * 8])
    noise = np.tile(np.diag([0.01, 0.01]), (3, 1, 1))
    values = landmarks[:3] + np.array([0.8, 0.0])
    look = Look(values, 2, noise, landmarks, P, np.arange(3))
    apart = np.full(3, -9)
    nearest_neighbour(look.distances, *look.gates, apart)
    assert apart.tolist() == [1, 2, 3]
    assert look.choose()[1].tolist() == [0, 1, 2]


def test_it_beats_the_nearest_neighbour_where_the_robot_is_lost(rng):
    """Share of right decisions over looks at a dense field from an uncertain pose."""
    right = {"joint": 0, "nearest": 0}
    for _ in range(100):
        look = draw(rng, 6, 12, pose=0.7, field=4.0, clutter=0.1)
        apart = np.full(6, -9)
        nearest_neighbour(look.distances, *look.gates, apart)
        for name, choice in (("joint", look.choose()[1]), ("nearest", apart)):
            right[name] += np.sum((choice == look.truth) & (look.truth >= 0))
    assert right["joint"] > 1.3 * right["nearest"]


# The bound on the search ------------------------------------------------------------------------


def test_without_a_search_it_is_sequential_compatibility(rng):
    for rows in (1, 2):
        for _ in range(30):
            look = draw(rng, 6, 6, rows)
            _, choice = look.choose(limit=0)
            assert pairs_of(choice) == sequential(look)


def test_more_search_is_never_worse(rng):
    cut = 0
    for _ in range(15):
        look = draw(rng, 8, 10, pose=1.0, clutter=0.4)
        before = rank(look, sequential_choice(look))
        for limit in (1, 10, 30, 100, 1000, PLENTY):
            complete, choice = look.choose(limit)
            cut += not complete
            after = rank(look, choice)
            assert after <= before
            assert look.compatible(pairs_of(choice))
            before = after
        assert complete
    assert cut > 15


# The joint distance -----------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [1, 2])
def test_the_joint_distance_grows_pair_by_pair(rng, rows):
    """The factor grown row by row against a dense solve; a sibling overwrites only its own rows."""
    look = draw(rng, 6, 6, rows)
    which = [(i, int(j)) for i, j in enumerate(rng.permutation(6))]
    pairs = look.pairs([*which, (5, 0)])
    factor = Factor(np.empty(12, np.int64), np.full((12, 12), np.nan), np.empty(12))
    total = 0.0
    for k in range(6):
        extend(pairs, factor, 6, rows * k)
        total += extend(pairs, factor, k, rows * k)
        assert total == pytest.approx(look.joint(which[: k + 1]), rel=1e-9)


def test_a_covariance_that_is_not_positive_definite_pairs_nothing(rng):
    look = draw(rng, 3, 3, rows=1, clutter=0.0)
    bad = replace(look, P=-look.P).pairs([(i, i) for i in range(3)])
    assert extend(bad, Factor(np.empty(2, np.int64), np.empty((2, 2)), np.empty(2)), 0, 0) == np.inf
    choice = np.full(3, -9)
    joint = quantiles(0.999, 6)
    assert joint_compatibility(*bad, np.zeros((3, 3)), *look.gates, joint, PLENTY, choice)
    assert choice.tolist() == [AMBIGUOUS] * 3
