"""Two estimators on the same seeds: intervals, tests, and who is said to be better."""

import numpy as np
import pandas as pd
import pytest
from drawn import runs_of
from scipy.stats import permutation_test

from ekfslam.errors import InputError, UnknownNameError
from ekfslam.evaluation import compare_pairs
from ekfslam.evaluation.paired import PAIRS, TARGETS
from ekfslam.evaluation.resampling import holm, mean_interval, sign_flip_p

ATE, NEES = "ate_position_rmse_m", "nees_pose_mean_kept"


def runs(metric=ATE, scenario="loop", **estimators):
    """Runs of several estimators, with a number for each seed."""
    return pd.concat(
        runs_of(range(len(values)), name, scenario=scenario, **{metric: values})
        for name, values in estimators.items()
    )


def only(table):
    assert len(table) == 1
    return table.iloc[0]


# Intervals and tests ----------------------------------------------------------------------------


@pytest.mark.parametrize("probability", [0.8, 0.95])
@pytest.mark.parametrize("count", [8, 40])
@pytest.mark.parametrize("kind", ["normal", "skewed"])
def test_intervals_cover_what_they_say(rng, probability, count, kind):
    """The difference of two gamma numbers is skewed as differences of mean NEES are."""
    draws, mean = rng.normal(size=(count, 1500)), 0.0
    if kind == "skewed":
        draws, mean = rng.gamma(1.9, 2.5, draws.shape) - rng.gamma(1.9, 1.6, draws.shape), 1.71
    half_width, p = mean_interval(draws, probability, 999, 5)
    covered = np.mean(np.abs(draws.mean(axis=0) - mean) <= half_width)
    # Four sigmas of the count, and what Hall's order 1 / n^2 leaves of so few.
    slack = 4 * np.sqrt(probability * (1 - probability) / 1500) + 1.0 / count**2
    assert covered == pytest.approx(probability, abs=slack)
    # The p value is that of the interval: below the level where it leaves zero out.
    outside = np.abs(draws.mean(axis=0)) > half_width
    assert np.mean(outside != (p <= 1 - probability + 1e-12)) < 0.002


def test_intervals_are_those_of_a_loop_over_resamples(rng):
    x = rng.exponential(size=12)
    half_width, _ = mean_interval(x[:, None], 0.9, 4000, 1)
    ratios = []
    for _ in range(4000):
        drawn = rng.choice(x, 12)
        ratios.append(abs(drawn.mean() - x.mean()) / (drawn.std(ddof=1) / np.sqrt(12)))
    expected = np.quantile(ratios, 0.9) * x.std(ddof=1) / np.sqrt(12)
    assert half_width[0] == pytest.approx(expected, rel=0.08)


def test_equal_samples_have_no_width_and_nearly_equal_ones_an_infinite_one():
    equal = np.column_stack([np.full(10, 2.0), np.zeros(10), np.eye(10)[0]])
    half_width, p = mean_interval(equal, 0.95, 999, 0)
    assert half_width.tolist() == [0.0, 0.0, np.inf]
    assert p.tolist()[:2] == [0.0, 1.0]
    assert p[2] > 0.05


@pytest.mark.parametrize("count", [6, 9, 13])
def test_few_signs_are_all_tried(rng, count):
    differences = rng.normal(0.5, 1.0, (count, 3))
    found = sign_flip_p(differences, 10, 0)
    for column, p in zip(differences.T, found, strict=True):
        exact = permutation_test(
            (column,),
            lambda x, axis: np.abs(np.mean(x, axis=axis)),
            permutation_type="samples",
            alternative="greater",
            n_resamples=np.inf,
            vectorized=True,
        )
        assert p == pytest.approx(exact.pvalue, abs=1e-12)
    assert sign_flip_p(np.abs(differences), 10, 0) == pytest.approx(2 / 2**count)


def test_many_signs_are_drawn_and_p_is_uniform_where_there_is_no_difference(rng):
    p = sign_flip_p(rng.standard_t(2, (30, 2000)), 999, 3)
    for level in (0.05, 0.2, 0.5):
        assert np.mean(p <= level) == pytest.approx(level, abs=4 * np.sqrt(level / 2000))
    assert sign_flip_p(np.ones((30, 1)), 999, 3)[0] == 1 / 1000
    assert sign_flip_p(np.zeros((30, 1)), 999, 3)[0] == 1.0


def test_holm_by_hand_and_its_level(rng):
    adjusted = holm(np.array([0.04, 0.01, np.nan, 0.03, 0.5]))
    np.testing.assert_allclose(adjusted, [0.09, 0.04, np.nan, 0.09, 0.5])
    assert holm(np.array([0.9, 0.8])).tolist() == [1.0, 1.0]
    assert len(holm(np.array([]))) == 0
    families = np.array([holm(p).min() for p in rng.uniform(size=(2000, 8))])
    assert np.mean(families <= 0.05) == pytest.approx(0.05, abs=4 * np.sqrt(0.05 / 2000))


# Who is better ----------------------------------------------------------------------------------


def test_numbers_of_a_pair_are_those_of_its_differences(rng):
    a, b = rng.normal(2.0, 0.3, 40), rng.normal(2.5, 0.3, 40)
    table = compare_pairs(runs(ours=a, theirs=b), ATE)
    row = only(table)
    assert dict(table.dtypes.astype(str)) == dict(PAIRS)
    assert (row["a"], row["b"], row["seeds"], row["missing"]) == ("ours", "theirs", 40, 0)
    assert row["share_a_less"] == np.mean(a < b)
    assert (row["mean_a"], row["mean_b"]) == pytest.approx((a.mean(), b.mean()))
    assert row["mean_difference"] == pytest.approx(np.mean(a - b))
    assert row["median_difference"] == pytest.approx(np.median(a - b))
    t_width = 2.02 * np.std(a - b, ddof=1) / np.sqrt(40)
    assert row["half_width"] == pytest.approx(t_width, rel=0.15)
    assert row["better"] == "ours"
    said = f"ours beats theirs on {ATE} by {-row['mean_difference']:.3g} ± {row['half_width']:.2g}"
    assert row["verdict"].startswith(f"{said} (95 %), 40 seeds, p 0.0001 adjusted for 1 comparison")
    turned = only(compare_pairs(runs(theirs=b, ours=a), ATE))
    assert turned["better"] == "ours"
    assert turned["mean_difference"] == pytest.approx(-row["mean_difference"])
    assert turned["half_width"] == pytest.approx(row["half_width"])


def test_what_the_seeds_share_drops_out(rng):
    """A difference of a tenth of the spread between seeds is seen, since pairs are compared."""
    shared = rng.gamma(2.0, 1.0, 50)
    a, b = shared + rng.normal(0, 0.02, 50), shared + 0.1 + rng.normal(0, 0.02, 50)
    assert only(compare_pairs(runs(a=a, b=b), ATE))["better"] == "a"
    row = only(compare_pairs(runs(a=a, b=rng.permutation(b)), ATE))
    assert pd.isna(row["better"])
    assert row["verdict"].startswith(f"no difference seen on {ATE}: ")


def test_no_difference_is_seen_as_rarely_as_the_level_says(rng):
    values = rng.gamma(2.0, 1.0, (2, 300, 25))
    table = pd.concat(
        runs_of(
            np.tile(np.arange(25), 300),
            name,
            scenario=np.repeat(np.arange(300), 25).astype(str),
            ate_position_rmse_m=each.ravel(),
        )
        for name, each in zip("ab", values, strict=True)
    )
    found = compare_pairs(table, ATE, resamples=999)
    assert len(found) == 300
    assert np.mean(found["p"] <= 0.05) == pytest.approx(0.05, abs=4 * np.sqrt(0.05 / 300))
    assert found["better"].notna().sum() <= 1  # of all 300 together, by chance, at 5 %
    assert (found["comparisons"] == 300).all()


def test_nees_is_better_nearer_to_what_it_should_be(rng):
    consistent, optimistic, pessimistic = (rng.gamma(1.9, m / 1.9, 200) for m in (3.0, 6.0, 0.8))
    table = compare_pairs(runs(NEES, ri=consistent, std=optimistic, wide=pessimistic), NEES)
    table = table.set_index(["a", "b"])
    assert (table["target"] == 3.0).all()
    assert table.loc[("ri", "std"), "better"] == "ri"
    assert table.loc[("ri", "wide"), "better"] == "ri"
    verdict = table.loc[("ri", "std"), "verdict"]
    means = f"{consistent.mean():.3g} against {optimistic.mean():.3g} and nearer to 3"
    assert verdict.startswith(f"ri beats std on {NEES}, {means}, by ")
    # A run of the pessimistic one is nearer to 3 more often than not; its mean is not.
    assert np.mean(np.abs(consistent - 3)) < 2.5


def test_an_inflated_covariance_is_no_merit(rng):
    """Each run of it is nearer to 3 on average, but what NEES should be is a mean of 3."""
    nees = rng.gamma(1.9, 3 / 1.9, 400)
    inflated = nees / 1.5
    assert np.mean(np.abs(inflated - 3)) < np.mean(np.abs(nees - 3))
    assert only(compare_pairs(runs(NEES, a=inflated, b=nees), NEES))["better"] == "b"


def test_two_that_err_on_opposite_sides_are_different_but_none_is_better(rng):
    level = rng.normal(0, 0.3, 60)
    a, b = 2.5 + level + rng.normal(0, 0.05, 60), 3.5 + level + rng.normal(0, 0.05, 60)
    row = only(compare_pairs(runs(NEES, a=a, b=b), NEES))
    assert abs(row["mean_difference"]) > 10 * row["half_width"]
    assert pd.isna(row["better"])
    assert row["verdict"].startswith(f"neither seen nearer to 3 on {NEES}: -")
    # Of an error the smaller is better all the same.
    assert only(compare_pairs(runs(a=a, b=b), ATE))["better"] == "a"


def test_a_share_is_better_the_nearer_it_is_to_one(rng):
    a, b = 1 - 0.02 * rng.uniform(size=30), 1 - 0.2 * rng.uniform(size=30)
    row = only(compare_pairs(runs("association_recall", a=a, b=b), "association_recall"))
    assert (row["better"], row["share_a_less"] < 0.5) == ("a", True)


def test_targets_are_columns_of_the_runs():
    assert set(TARGETS) <= set(runs_of([0]))


# Missing numbers --------------------------------------------------------------------------------


def test_seeds_without_a_pair_are_counted_and_said(rng):
    a, b = rng.normal(1.0, 0.1, 30), rng.normal(2.0, 0.1, 30)
    a[:3], b[2:5], b[9] = np.nan, np.nan, np.inf
    table = runs(a=a, b=b)
    gone = runs_of([30, 31], "b", series=None, robot=None, status="failed")
    row = only(compare_pairs(pd.concat([table, gone]), ATE))
    assert (row["seeds"], row["missing"]) == (24, 8)
    assert "24 seeds; 8 seeds without a pair" in row["verdict"]
    kept = np.isfinite(a) & np.isfinite(b)
    assert row["mean_difference"] == pytest.approx(np.mean((a - b)[kept]))


def test_one_that_always_failed_has_a_row_and_does_not_count(rng):
    a, b = rng.normal(1.0, 0.1, 20), rng.normal(2.0, 0.1, 20)
    gone = runs_of(range(20), "gone", series=None, robot=None, status="failed")
    table = compare_pairs(pd.concat([runs(a=a, b=b), gone]), ATE).set_index(["a", "b"])
    assert (table["comparisons"] == 1).all()
    row = table.loc[("a", "gone")]
    assert (row["seeds"], row["missing"]) == (0, 20)
    assert row[["mean_difference", "half_width", "p", "p_adjusted", "better"]].isna().all()
    assert row["verdict"] == f"no seed has a number of both on {ATE}; 20 seeds without a pair"
    assert table.loc[("a", "b"), "better"] == "a"


@pytest.mark.parametrize("count", [1, 4, 5])
def test_too_few_pairs_conclude_nothing(count):
    row = only(compare_pairs(runs(a=np.arange(count), b=np.arange(count) + 1.0), ATE))
    assert row[["mean_difference", "median_difference"]].tolist() == [-1.0, -1.0]
    assert row[["half_width", "p", "p_adjusted", "better"]].isna().all()
    assert row["comparisons"] == 0
    assert row["verdict"] == f"too few pairs to tell on {ATE}: {count} seeds"


def test_equal_numbers_and_equal_differences(rng):
    a = rng.normal(2.0, 1.0, 20)
    row = only(compare_pairs(runs(a=a, b=a * (1 + 1e-13)), ATE))
    assert (row["p"], row["share_a_less"], row["half_width"]) == (1.0, 0.5, 0.0)
    assert row["verdict"] == f"no difference seen on {ATE}: equal on every seed, 20 seeds"
    row = only(compare_pairs(runs(a=a, b=a + 0.5), ATE))
    assert row["better"] == "a"
    assert row["half_width"] == pytest.approx(0.0, abs=1e-12)
    one = a.copy()
    one[4] += 1.0
    row = only(compare_pairs(runs(a=a, b=one), ATE))
    assert pd.isna(row["half_width"])
    assert row["verdict"].startswith(f"no difference seen on {ATE}: -0.05, 20 seeds")


# Which pairs ------------------------------------------------------------------------------------


def test_rows_are_per_metric_scenario_and_pair_and_correct_each_other(rng):
    def drawn(*means):
        return {name: rng.normal(m, 0.2, 20) for name, m in zip("abc", means, strict=True)}

    table = pd.concat([runs(scenario="x", **drawn(1, 1, 2)), runs(scenario="y", **drawn(1, 3, 1))])
    table["landmark_rmse_m"] = table[ATE] ** 2
    whole = compare_pairs(table, [ATE, "landmark_rmse_m"])
    assert len(whole) == 2 * 2 * 3
    assert (whole["comparisons"] == 12).all()
    np.testing.assert_allclose(whole["p_adjusted"], holm(whole["p"].to_numpy()))
    chosen = compare_pairs(table, ATE, pairs=[("c", "a")])
    assert chosen[["scenario", "a", "b"]].to_numpy().tolist() == [["x", "c", "a"], ["y", "c", "a"]]
    against = compare_pairs(table, ATE, baseline="b")
    assert against["a"].tolist() == ["a", "c"] * 2
    # A row is the same in whatever company, but for the correction.
    same = ["mean_difference", "half_width", "p", "seeds"]
    mine = whole[(whole["metric"] == ATE) & (whole["b"] == "b")]
    np.testing.assert_array_equal(against[against["a"] == "a"][same], mine[same])


def test_series_and_robots_are_kept_apart(rng):
    smoothed, online, robot = (rng.normal(m, 0.1, 20) for m in (1.0, 2.0, 3.0))
    table = pd.concat(
        [
            runs(isam=online),
            runs(isam=smoothed).assign(series="smoothed"),
            runs(ekf=online + 1.0),
        ]
    )
    found = compare_pairs(table, ATE, baseline="ekf")
    assert found["a"].tolist() == ["isam (online)", "isam (smoothed)"]
    assert (found["better"] == found["a"]).all()
    with pytest.raises(UnknownNameError, match=r"isam \(online\)"):
        compare_pairs(table, ATE, baseline="isam")
    second = runs(ekf=robot).assign(robot="second")
    team = pd.concat([table, second, runs(isam=robot + 1).assign(robot="second")])
    found = compare_pairs(team, ATE, pairs=[("isam (online)", "ekf")]).set_index("robot")
    assert found["better"].tolist() == ["isam (online)", "ekf"]


def test_the_table_depends_on_the_seed_and_not_on_the_order_of_the_runs(rng):
    table = pd.concat(
        [runs(a=rng.normal(size=30), b=rng.normal(size=30)), runs(c=rng.normal(size=22))]
    )
    found = compare_pairs(table, ATE, baseline="a")
    shuffled = compare_pairs(table.sample(frac=1, random_state=2), ATE, baseline="a")
    shuffled = shuffled.sort_values("a").reset_index(drop=True)
    pd.testing.assert_frame_equal(found, shuffled, check_exact=True)
    other = compare_pairs(table, ATE, baseline="a", seed=1)
    assert (other["half_width"] != found["half_width"]).all()
    assert found["missing"].tolist() == [0, 8]


def test_requests_that_make_no_sense_are_refused(rng):
    table = runs(a=rng.normal(size=9), b=rng.normal(size=9))
    for message, settings in (
        ("pairs or a baseline", {"pairs": [("a", "b")], "baseline": "a"}),
        ("with itself", {"pairs": [("a", "a")]}),
        ("probability", {"probability": 95}),
        ("resamples", {"resamples": 0}),
        ("seed", {"seed": -1}),
    ):
        with pytest.raises(InputError, match=message):
            compare_pairs(table, ATE, **settings)
    with pytest.raises(UnknownNameError, match="unknown competitor 'ab'; "):
        compare_pairs(table, ATE, pairs=[("a", "ab")])
    with pytest.raises(InputError, match="runs lacks the columns error"):
        compare_pairs(table, "error")
    with pytest.raises(InputError, match="runs holds a row twice: scenario loop"):
        compare_pairs(pd.concat([table, table[:1]]), ATE)
    assert list(compare_pairs(table[:0], ATE)) == list(PAIRS)
