"""Who was taken for whom: by hand, and against a sequential account of the same definitions."""

from dataclasses import replace

import numpy as np
import pytest

from ekfslam.dataset import Dataset, LandmarkMap, Observations, Robot
from ekfslam.estimates import Decision, Estimate, Innovations, LandmarkEstimates
from ekfslam.evaluation import association_scores, count_landmarks
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor

DECISIONS = {
    "A": Decision.ACCEPTED,
    "N": Decision.NEW,
    "R": Decision.REJECTED,
    "?": Decision.AMBIGUOUS,
    "T": Decision.TENTATIVE,
    "D": Decision.DELAYED,
}
UNUSED = "R?T"


def dataset_of(origin, landmark=None, **changes):
    """A robot that stands and sees one thing per step."""
    count = len(origin)
    robot = Robot(MotionModel("odometry", covariance=np.eye(3)), np.zeros((count, 3)))
    data = Dataset(
        "stand",
        (robot,),
        np.arange(count + 1.0),
        (Sensor("xy", np.eye(2)),),
        Observations(np.arange(count), np.zeros((count, 2)), landmark),
        true_landmark=origin,
    )
    return replace(data, **changes)


def estimate_of(story, in_map=None, association="nearest", undetermined=None):
    """From words such as "N4": new, taken for landmark 4. The map holds all it names, or these."""
    words = story.split()
    taken = [int(word[1:]) if len(word) > 1 else -1 for word in words]
    if in_map is None:
        in_map = sorted({number for number in taken if number >= 0})
    landmarks = LandmarkEstimates(
        np.array(in_map, dtype=np.int64),
        np.zeros((len(in_map), 2)),
        undetermined=None if undetermined is None else np.array(undetermined),
    )
    innovations = Innovations(
        np.array([DECISIONS[word[0]] for word in words], dtype=np.int64),
        np.array(taken, dtype=np.int64),
        np.full((len(words), 2), np.nan),
        np.full((len(words), 2, 2), np.nan),
    )
    return Estimate("filter", "stand", association, landmarks=landmarks, innovations=innovations)


def rows(flags):
    return np.flatnonzero(flags).tolist()


def scored(origin, story, **changes):
    return association_scores(dataset_of(origin), estimate_of(story, **changes))


def counted(origin, story, **changes):
    return tuple(count_landmarks(dataset_of(origin), estimate_of(story, **changes)))


# By hand ---------------------------------------------------------------------------------------


def test_every_verdict_once():
    #         0   1   2   3   4   5  6  7   8   9   10  11
    origin = [3, 3, 5, 5, -1, -1, 3, 5, 5, -1, 3, 7]
    story = "N0 A0 N1 A0 A1  R  ?  T  N2 N3  A3 R"
    scores = scored(origin, story)
    assert rows(scores.founded) == [0, 2, 8, 9]
    assert rows(scores.accepted) == [1, 3, 4, 10]
    assert rows(scores.correct) == [1]
    assert rows(scores.false) == [3, 4, 10]  # another landmark, clutter, clutter's landmark
    assert rows(scores.mapped) == [1, 3, 6, 7, 8, 10]
    assert rows(scores.missed) == [6, 7]  # 11 was never mapped, 5 is clutter and rightly left out
    assert rows(scores.duplicates) == [8]
    assert rows(scores.spurious) == [9]
    assert rows(scores.merging) == [3]
    assert scores.precision == 1 / 4
    assert scores.recall == 1 / 6


def test_a_perfect_run_has_precision_and_recall_one_and_nothing_else():
    scores = scored([3, 5, 3, -1, 5, 3], "N1 N0 A1 R A0 A1")
    assert scores.precision == scores.recall == 1.0
    for flags in (scores.false, scores.missed, scores.duplicates, scores.spurious, scores.merging):
        assert not flags.any()


def test_shares_of_nothing_are_undefined():
    scores = scored([3, -1], "N0 R")
    assert np.isnan(scores.precision)
    assert np.isnan(scores.recall)
    assert np.isnan(association_scores(dataset_of([]), estimate_of("")).precision)


def test_the_numbers_of_an_estimate_mean_nothing():
    """Landmark 5 of the estimate was founded by a sighting of 3, whatever the dataset calls 5."""
    assert rows(scored([3, 3, 5], "N5 A5 A5").correct) == [1]


def test_what_a_landmark_stands_for_is_said_by_the_first_not_by_the_most():
    scores = scored([3, 5, 5, 5, 3], "N0 A0 A0 A0 A0")
    assert rows(scores.correct) == [4]
    assert rows(scores.merging) == [1]


def test_clutter_stands_for_nothing_whatever_it_takes_afterwards():
    scores = scored([-1, 3, 3, -1], "N0 A0 A0 A0")
    assert rows(scores.false) == [1, 2, 3]
    assert not scores.mapped.any()
    assert not scores.merging.any()  # it took one true landmark only


def test_only_what_was_founded_earlier_in_the_order_of_the_rows_is_mapped():
    scores = scored([3, 3, 3], "T N0 R")
    assert rows(scores.mapped) == [2]
    assert rows(scores.missed) == [2]


def test_a_landmark_merges_once_and_is_counted_once():
    origin, story = [3, 5, 7, 5, 7, 3], "N0 A0 A0 N1 A1 A1"
    assert rows(scored(origin, story).merging) == [1, 4]
    assert counted(origin, story) == (3, 1, 0, 0, 2)


# Deletion --------------------------------------------------------------------------------------


def test_a_landmark_that_the_final_map_lacks_was_in_the_map_until_its_last_use():
    origin, story = [3, 3, 3, 3, 3], "N0 A0 R N1 A1"
    kept, deleted = scored(origin, story), scored(origin, story, in_map=[1])
    assert rows(kept.mapped) == [1, 2, 3, 4]
    assert rows(kept.duplicates) == [3]
    assert rows(deleted.mapped) == [1, 4]
    assert rows(deleted.missed) == []
    assert rows(deleted.duplicates) == []


def test_an_identity_that_is_used_again_is_another_landmark():
    scores = scored([3, 3, 5, 5, 3], "N0 A0 N0 A0 A0")
    assert rows(scores.correct) == [1, 3]
    assert rows(scores.mapped) == [1, 3]  # 3 went when its number was given away
    assert rows(scores.merging) == [4]
    assert counted([3, 3, 5, 5, 3], "N0 A0 N0 A0 A0") == (2, 1, 0, 0, 1)


def test_counts_are_of_the_final_map_alone():
    origin = [3, 3, -1, -1, 5, 3, 5]
    story = "N0 N1 N2 N3 N4 A4 N5"
    assert counted(origin, story) == (2, 0, 2, 2, 1)
    assert counted(origin, story, in_map=[1, 3]) == (2, 1, 1, 0, 0)
    assert counted(origin, story, in_map=[]) == (2, 2, 0, 0, 0)


# Delay -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("story", ["D0 D0 N0 A0", "D0 D0 D0 A0"])
def test_the_first_of_the_delayed_founds_and_the_others_are_used_by_it(story):
    scores = scored([3, 5, 3, 3], story)
    assert rows(scores.founded) == [0]
    assert rows(scores.accepted) == [1, 2, 3]
    assert rows(scores.false) == [1]
    assert rows(scores.mapped) == [2, 3]


def test_what_is_not_kept_for_a_landmark_that_waits_is_not_missed():
    """Before it is determined there is nothing in the map to recognise."""
    scores = scored([3, 3, 3, 3, 3, 3], "D0 R D0 N0 R A0")
    assert rows(scores.correct) == [2, 3, 5]
    assert rows(scores.missed) == [4]
    assert scores.recall == 3 / 4


def test_a_delay_after_a_use_is_another_founding():
    scores = scored([3, 3, 3, 5, 5, 5], "D0 N0 A0 D0 N0 A0", in_map=[0])
    assert rows(scores.founded) == [0, 3]
    assert rows(scores.correct) == [1, 2, 4, 5]


def test_landmarks_of_open_distance_are_in_the_map():
    origin, story = [3, 3, -1, 3], "N0 A0 N1 R"
    assert counted(origin, story, in_map=[]) == (1, 1, 0, 0, 0)
    assert counted(origin, story, in_map=[], undetermined=[1, 0]) == (1, 0, 1, 0, 0)
    assert rows(scored(origin, story, in_map=[], undetermined=[0]).missed) == [3]


# Known association -----------------------------------------------------------------------------


def test_known_association_with_wrong_identities_is_false():
    given = [3, 3, 5, 5, 5, 3, -1]
    data = dataset_of([3, 3, 5, 3, 5, -1, -1], landmark=given)
    estimate = estimate_of("N3 A3 N5 A5 A5 A3 R", association="known")
    scores = association_scores(data, estimate)
    assert rows(scores.correct) == [1, 4]
    assert rows(scores.false) == [3, 5]
    assert scores.precision == 2 / 4
    assert scores.recall == 2 / 3
    assert tuple(count_landmarks(data, estimate)) == (2, 0, 0, 0, 1)


def test_a_known_landmark_stands_for_its_identity_even_if_founded_by_mistake():
    data = dataset_of([3, 5, 3], landmark=[5, 5, 3])
    scores = association_scores(data, estimate_of("N5 A5 N3", association="known"))
    assert rows(scores.correct) == [1]
    assert rows(scores.duplicates) == []


def test_identities_that_no_true_landmark_carries_are_spurious():
    data = dataset_of([3, 5], landmark=[3, 8])
    assert tuple(count_landmarks(data, estimate_of("N3 N8", association="known")))[:4] == (
        2,
        1,
        1,
        0,
    )


def test_a_map_given_in_advance_is_mapped_from_the_start():
    given = LandmarkMap([3, 5, 7], np.zeros((3, 2)))
    story = estimate_of("A3 A3 R A7", in_map=[3, 5, 7])
    data = dataset_of([3, 5, 5, 7], known_map=given)
    scores = association_scores(data, story)
    assert rows(scores.mapped) == [0, 1, 2, 3]
    assert rows(scores.correct) == [0, 3]
    assert rows(scores.missed) == [2]
    assert tuple(count_landmarks(data, story)) == (3, 0, 0, 0, 1)
    # Without that map nobody knows what the numbers mean.
    assert not association_scores(dataset_of([3, 5, 5, 7]), story).mapped.any()


def test_known_identities_are_counted_without_innovations():
    data = dataset_of([1, 1, 3], landmark=[1, 1, 3], true_map=LandmarkMap([1, 3, 7], np.eye(3, 2)))
    estimate = replace(estimate_of("", in_map=[1, 7, 9], association="known"), innovations=None)
    assert tuple(count_landmarks(data, estimate)) == (2, 1, 1, 0, None)
    assert association_scores(data, estimate) is None


# What is not known -----------------------------------------------------------------------------


def test_the_identities_of_the_data_stand_in_for_the_truth():
    data = dataset_of([3, 3, 5], landmark=[3, 3, 5], true_landmark=None)
    assert rows(association_scores(data, estimate_of("N0 A0 A0")).correct) == [1]


def test_without_the_origin_of_the_observations_nothing_is_scored_or_counted():
    data, estimate = dataset_of([3, 3], true_landmark=None), estimate_of("N0 A0")
    assert association_scores(data, estimate) is None
    assert tuple(count_landmarks(data, estimate)) == (None,) * 5


def test_without_decisions_or_map_only_the_true_ones_are_counted():
    bare = replace(estimate_of("N0 A0"), innovations=None)
    assert association_scores(dataset_of([3, 3]), bare) is None
    assert tuple(count_landmarks(dataset_of([3, 3]), bare)) == (1, None, None, None, None)
    no_map = replace(estimate_of("N0 A0 R"), landmarks=None)
    assert tuple(count_landmarks(dataset_of([3, 3, 5]), no_map)) == (2, None, None, None, None)
    assert rows(association_scores(dataset_of([3, 3, 3]), no_map).mapped) == [1, 2]


def test_sightings_of_robots_are_left_out():
    data = dataset_of([3, 3, 3])  # whatever the truth says in the row of a robot
    robots = (data.robot, replace(data.robot, name="other"))
    seen = replace(data.observations, observed_robot=np.array([-1, 1, -1]))
    data = replace(data, robots=robots, observations=seen)
    scores = association_scores(data, estimate_of("N0 A A0"))
    assert rows(scores.scored) == [0, 2]
    assert rows(scores.accepted) == rows(scores.correct) == rows(scores.mapped) == [2]
    assert scores.precision == 1.0


# A sequential account --------------------------------------------------------------------------


class Ledger:
    """The definitions once more, row by row, as one would keep book by hand."""

    def __init__(self, origin, story, in_map):
        self.verdicts, self.words = [], story.split()
        self.lives = []  # of each: identity, founding row, true landmark, rows
        current = {}
        for row, word in enumerate(self.words):
            if word[0] in UNUSED:
                continue
            life = current.get(word[1:])
            delayed = life is not None and self.words[life["rows"][-1]][0] == "D"
            if life is None or (word[0] in "ND" and not delayed):
                founds = word[0] in "ND"
                life = {"id": int(word[1:]), "founder": row if founds else -1, "rows": []}
                life["whom"] = origin[row] if founds else -1
                current[word[1:]] = life
                self.lives.append(life)
            life["rows"].append(row)
        for life in self.lives:
            kept = [row for row in life["rows"] if self.words[row][0] in "ND"]
            life["entry"] = max(kept, default=-1)
            life["lasting"] = current[str(life["id"])] is life and life["id"] in in_map
        self.origin = origin

    def mapped(self, row):
        return self.origin[row] >= 0 and any(
            life["whom"] == self.origin[row]
            and life["entry"] < row
            and (life["lasting"] or row <= life["rows"][-1])
            for life in self.lives
        )

    def flags(self):
        """Rows of each verdict."""
        found = {"founded": [], "accepted": [], "correct": [], "merging": [], "spurious": []}
        for life in self.lives:
            took = []
            for row in life["rows"]:
                true = self.origin[row]
                if row == life["founder"]:
                    found["founded"].append(row)
                    found["spurious"] += [row] * (true < 0)
                else:
                    found["accepted"].append(row)
                    found["correct"] += [row] * (true >= 0 and true == life["whom"])
                if true >= 0 and true not in took:
                    took.append(true)
                    found["merging"] += [row] * (len(took) == 2)
        found["mapped"] = [
            row for row in range(len(self.words)) if self.mapped(row) or row in found["correct"]
        ]
        return {name: sorted(rows) for name, rows in found.items()}

    def counts(self):
        final = [life for life in self.lives if life["lasting"]]
        observed = {true for true in self.origin if true >= 0}
        standing = [life["whom"] for life in final if life["whom"] >= 0]
        mixed = [{self.origin[r] for r in life["rows"]} - {-1} for life in final]
        return (
            len(observed),
            len(observed - set(standing)),
            len(final) - len(standing),
            len(standing) - len(set(standing)),
            sum(len(origins) >= 2 for origins in mixed),
        )


@pytest.mark.parametrize("seed", range(60))
def test_random_stories_are_scored_as_by_hand(seed):
    random = np.random.default_rng(seed)
    origin = random.integers(-1, 4, 30).tolist()
    letters = random.choice(list("AAAANNRDD?T"), 30)
    story = " ".join(
        letter if letter in UNUSED else f"{letter}{random.integers(0, 5)}" for letter in letters
    )
    in_map = sorted({int(word[1:]) for word in story.split() if word[1:] in ("0", "2", "4")})
    ledger = Ledger(origin, story, in_map)
    scores = scored(origin, story, in_map=in_map)
    found = {name: rows(getattr(scores, name)) for name in ledger.flags()}
    assert found == ledger.flags()
    assert counted(origin, story, in_map=in_map) == ledger.counts()


@pytest.mark.parametrize("seed", range(10))
def test_every_mapped_observation_has_one_verdict_and_every_landmark_one_account(seed):
    random = np.random.default_rng(seed)
    origin = random.integers(-1, 6, 40)
    story = " ".join(
        letter if letter in UNUSED else f"{letter}{random.integers(0, 8)}"
        for letter in random.choice(list("AAAANR?T"), 40)
    )
    data, estimate = dataset_of(origin), estimate_of(story)
    scores = association_scores(data, estimate)
    kinds = [scores.correct, scores.false & scores.mapped, scores.missed, scores.duplicates]
    np.testing.assert_array_equal(np.sum(kinds, axis=0), scores.mapped)
    # Nothing changes if landmarks are numbered otherwise, by the estimate or by the world.
    renamed = estimate_of(
        " ".join(w[0] + str(70 - int(w[1:])) if w[1:] else w for w in story.split())
    )
    other = association_scores(dataset_of(np.where(origin < 0, -1, 50 - origin)), renamed)
    for flags, again in zip(scores, other, strict=True):
        np.testing.assert_array_equal(flags, again)
    counts = count_landmarks(data, estimate)
    held = counts.true - counts.missed + counts.duplicate + counts.spurious
    assert held == len(estimate.landmarks)
