"""Campaign files: what they mean, and that a mistake is told before anything runs."""

from __future__ import annotations

import re
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from campaigns import SMALL
from numpy.testing import assert_array_equal

from ekfslam.errors import FileFormatError, InputError
from ekfslam.experiments import campaign as described
from ekfslam.experiments import load_campaign
from ekfslam.simulation import load_scenario, scenario_hash

ROOT = Path(__file__).parents[1]

FILE = """
description = "both"
seeds = { first = 10, count = 2 }
estimators = ["ekf", "ekf( confirm = 3 , association=joint)"]

[[scenarios]]
name = "worlds/mine.toml"
label = "my world"
[scenarios.set]
path.repeat = 5
sensors.0.max_range = 4.0
[scenarios.sweep]
motion.sigmas.0 = [0.01, 0.02]
prior.draw = [false, true]

[[scenarios]]
name = "loop-15"

[metrics]
skip = 2
steps = [5, 1]
reference = "ekf"
diverged_above = 9

[compare]
baseline = "ekf"
pairs = [["ekf", "ekf(confirm=3, association=joint)"]]
metrics = ["ate_position_rmse_m"]
"""


@pytest.fixture
def path(tmp_path):
    """A campaign file with a scenario file beside it."""
    (tmp_path / "worlds").mkdir()
    shipped = ROOT / "ekfslam" / "simulation" / "scenarios" / "loop-15.toml"
    prior = '[prior]\nsigmas = [0.1, 0.1, "5 deg"]\n'
    (tmp_path / "worlds" / "mine.toml").write_text(shipped.read_text() + prior)
    file = tmp_path / "first.toml"
    file.write_text(FILE)
    return file


# What a file means ------------------------------------------------------------------------------


def test_a_file_is_read_to_the_last_key(path):
    campaign = load_campaign(path)
    assert (campaign.name, campaign.description) == ("first", "both")
    assert campaign.text == FILE
    assert campaign.seeds == (10, 11)
    assert list(campaign.estimators) == ["ekf", "ekf(confirm=3, association=joint)"]
    assert [variant.label for variant in campaign.variants] == [
        "my world(motion.sigmas.0=0.01, prior.draw=false)",
        "my world(motion.sigmas.0=0.01, prior.draw=true)",
        "my world(motion.sigmas.0=0.02, prior.draw=false)",
        "my world(motion.sigmas.0=0.02, prior.draw=true)",
        "loop-15",
    ]
    assert campaign.cells == 5 * 2 * 2
    metrics = campaign.metrics
    assert (metrics.skip, metrics.reference, metrics.diverged_above) == (2, "ekf", 9.0)
    assert_array_equal(metrics.kept(6), [1, 5])
    joint = "ekf(confirm=3, association=joint)"
    assert campaign.pairing.pairs == ((joint, "ekf"),)  # the pair listed is the same two
    assert campaign.pairing.metrics == ("ate_position_rmse_m",)


def test_an_estimator_may_do_with_fewer_seeds():
    listed = ["ekf", {"name": "dead-reckoning", "seeds": 1}]
    campaign = load_campaign(changed(seeds=[7, 3], estimators=listed))
    assert campaign.seeds_of("ekf") == (7, 3)
    assert campaign.seeds_of("dead-reckoning") == (7,)
    assert campaign.cells == 3 * len(campaign.variants)
    assert [len(unit.estimators) for unit in campaign.units({}) if unit.seed == 3] == [1] * len(
        campaign.variants
    )


def test_values_are_set_and_swept_in_the_scenario(path):
    variant = load_campaign(path).variants[3]
    by_hand = load_scenario(
        path.parent / "worlds" / "mine.toml",
        changes={
            "path.repeat": 5,
            "sensors.0.max_range": 4.0,
            "motion.sigmas.0": 0.02,
            "prior.draw": True,
        },
    )
    assert variant.digest == scenario_hash(by_hand)[:16]
    assert len(variant.scenario.controls) == 5
    assert variant.scenario.draw_prior
    assert variant.scenario.sensors[0].max_range == 4.0
    assert variant.swept == {"motion.sigmas.0": 0.02, "prior.draw": True}


def test_the_example_in_the_docstring_is_a_campaign(tmp_path):
    lines = described.__doc__.splitlines()
    example = "\n".join(line[4:] for line in lines if line.startswith("    "))
    example = example.replace("prior.sigmas", "motion.sigmas").replace('0.05, 0.05, "1', '0.05, "1')
    example = example.replace('0.05, 0.05, "10', '0.05, "10')
    (tmp_path / "x.toml").write_text(example)
    campaign = load_campaign(tmp_path / "x.toml")
    assert campaign.name == "heading"
    assert len(campaign.variants) == 2
    assert_array_equal(campaign.metrics.kept(171)[[0, 1, -1]], [0, 10, 170])


@pytest.mark.parametrize(
    "file", sorted((ROOT / "experiments").glob("*.toml")), ids=lambda p: p.stem
)
def test_the_campaigns_that_come_with_the_repository_are_right(file):
    assert load_campaign(file).cells > 0


@pytest.mark.parametrize(
    ("stated", "asked", "seeds"),
    [
        (3, None, (0, 1, 2)),
        ({"count": 2}, None, (0, 1)),
        ([7, 3, 5], None, (7, 3, 5)),
        (3, 5, (0, 1, 2, 3, 4)),
        ({"first": 8, "count": 9}, 2, (8, 9)),
        ([7, 3, 5], 2, (7, 3)),
    ],
)
def test_seeds(stated, asked, seeds):
    assert load_campaign(SMALL | {"seeds": stated}, asked).seeds == seeds


def test_every_step_is_kept_by_default_and_the_last_one_always():
    document = {key: value for key, value in SMALL.items() if key != "metrics"}
    metrics = load_campaign(document).metrics
    assert_array_equal(metrics.kept(13), np.arange(13))
    assert_array_equal(load_campaign(SMALL).metrics.kept(13), [0, 5, 10, 12])


def test_what_rows_depend_on_is_told_apart():
    """The threshold of divergence is applied to finished runs; the rest is in their rows."""
    base = load_campaign(SMALL).metrics.digest

    def digest(**change):
        return load_campaign(SMALL | {"metrics": SMALL["metrics"] | change}).metrics.digest

    assert digest(diverged_above=5) == base
    others = [digest(skip=4), digest(steps="all"), digest(steps=[5]), digest(reference="ekf")]
    assert len({base, *others}) == 5


# Mistakes ---------------------------------------------------------------------------------------


def changed(**change):
    return deepcopy(SMALL) | change


def scenario(**change):
    return changed(scenarios=[{"name": "loop-15"} | change])


MISTAKES = [
    (changed(sead=1), "unknown key 'sead'; did you mean seeds"),
    ({k: v for k, v in SMALL.items() if k != "seeds"}, "missing key 'seeds'"),
    (changed(name=""), "name must be text"),
    (changed(description=3), "description must be text"),
    (changed(seeds=0), "seeds must be a whole number from 1 on, got 0"),
    (changed(seeds=True), "seeds must be a whole number"),
    (changed(seeds=[1, -1]), "seeds must be a whole number from 0 on"),
    (changed(seeds=[1, 1]), "seeds: 1 is there twice"),
    (changed(seeds=[]), "seeds must be a list of seeds"),
    (changed(seeds=[0, 2**63]), f"seeds: {2**63} is too large, a seed is at most {2**63 - 1}"),
    (changed(seeds={"first": 2**63 - 1, "count": 2}), f"seeds: {2**63 - 1} is too large"),
    (changed(seeds=10**15), "seeds: 10+ are too many, a campaign has at most 1000000 seeds"),
    (changed(seeds={"first": 3}), "seeds: missing key 'count'"),
    (changed(seeds={"number": 3}), "seeds: unknown key 'number'; known: count, first"),
    (changed(estimators="ekf"), "estimators must be a list of names"),
    (changed(estimators=["efk"]), "estimators: unknown estimator 'efk'; did you mean ekf"),
    (changed(estimators=["ekf(confirn=2)"]), "unknown option of ekf 'confirn'; did you mean conf"),
    (changed(estimators=["ekf(confirm=0)"]), "estimators: .*confirm must be"),
    (changed(estimators=["ekf", "ekf()"]), "estimators: 'ekf' is there twice"),
    (changed(estimators=["nowhere:Filter"]), "cannot load estimator 'nowhere:Filter'"),
    (changed(scenarios=[]), r"\[\[scenarios\]\] must be a list of tables"),
    (changed(scenarios=["loop-15"]), r"\[\[scenarios\]\] 1 must be a table"),
    (changed(scenarios=[{}]), r"\[\[scenarios\]\] 1: missing key 'name'"),
    (scenario(name="loop-51"), r"\[\[scenarios\]\] 1: unknown scenario 'loop-51'; did you mean"),
    (scenario(name="gone.toml"), r"\[\[scenarios\]\] 1: gone.toml: no such file"),
    (scenario(sets={}), r"\[\[scenarios\]\] 1: unknown key 'sets'; did you mean set"),
    (scenario(set=3), r"\[set\] must be a table"),
    (scenario(set={"motion.sigma": [1, 2]}), "unknown key 'sigma'; did you mean sigmas"),
    (scenario(set={"sensors.3.sigmas": [1, 2]}), "no item '3'"),
    (scenario(sweep={"path.repeat": 3}), r"\[sweep\] path.repeat must be a list"),
    (scenario(sweep={"path.repeat": []}), r"\[sweep\] path.repeat must be a list"),
    (scenario(sweep={"path.repeat": [4, "x"]}), "repeat must be a whole number"),
    (
        scenario(set={"path.repeat": 5}, sweep={"path": {"repeat": [3, 4]}}),
        "path.repeat is both set and swept",
    ),
    (scenario(sweep={"path.repeat": [4, 4]}), r"\[sweep\] path.repeat: 4 is there twice"),
    (
        changed(scenarios=[{"name": "loop-15"}, {"name": "loop-15", "label": "again"}]),
        "'loop-15' and 'again' are the same problem",
    ),
    (changed(metrics=3), r"\[metrics\] must be a table"),
    (changed(metrics={"skp": 1}), r"\[metrics\]: unknown key 'skp'; did you mean skip"),
    (changed(metrics={"skip": -1}), r"\[metrics\]: skip must be a whole number from 0"),
    (changed(metrics={"skip": 13}), r"\[metrics\]: skip = 13 leaves nothing of 13 poses"),
    (changed(metrics={"steps": "some"}), r"\[metrics\]: steps must be 'all'"),
    (changed(metrics={"steps": {"each": 2}}), "steps: unknown key 'each'"),
    (changed(metrics={"steps": {}}), "steps: missing key 'every'"),
    (changed(metrics={"steps": {"every": 0}}), "every must be a whole number from 1 on"),
    (changed(metrics={"steps": [13]}), "there is no step 13: a scenario has 13 poses"),
    (changed(metrics={"reference": "gtsam"}), "reference: unknown estimator 'gtsam'; did you"),
    (changed(metrics={"diverged_above": 0}), "diverged_above must be a positive number"),
    (changed(metrics={"diverged_above": "x"}), "diverged_above must be a positive number"),
    (changed(estimators=[{"seeds": 2}]), "estimators: name must be text, got None"),
    (changed(estimators=[{"name": "ekf", "seed": 2}]), "unknown key 'seed'; did you mean seeds"),
    (
        changed(estimators=[{"name": "ekf", "seeds": 0}]),
        "estimators: seeds of 'ekf' must be a whole number from 1 on",
    ),
    (changed(compare={"base": "ekf"}), r"\[compare\]: unknown key 'base'; did you mean baseline"),
    (
        changed(compare={"baseline": "ekf-ri"}),
        "baseline: unknown estimator 'ekf-ri'; did you mean ekf",
    ),
    (changed(compare={"pairs": [["ekf"]]}), "pairs must be pairs of estimators"),
    (changed(compare={"pairs": [["ekf", "ekf"]]}), "pairs must be pairs of estimators"),
    (
        changed(compare={"pairs": [["ekf", "dead-rec"]]}),
        "pairs: unknown estimator 'dead-rec'; did you mean",
    ),
    (
        changed(compare={"metrics": ["ate_rmse_m"]}),
        "metrics: unknown column 'ate_rmse_m'; did you mean",
    ),
    (changed(compare={"metrics": ["status"]}), "metrics: unknown column 'status'"),
    (changed(compare={"metrics": []}), "metrics must be a list of columns"),
]


@pytest.mark.parametrize(("document", "message"), MISTAKES, ids=[m for _, m in MISTAKES])
def test_a_mistake_names_the_key(document, message):
    with pytest.raises(InputError, match=f"^campaign: (.*){message}"):
        load_campaign(document)


def test_an_error_of_a_file_names_the_file(path):
    path.write_text(FILE.replace("skip = 2", "skip = -2"))
    with pytest.raises(InputError, match=f"^{re.escape(str(path))}: .metrics.: skip"):
        load_campaign(path)
    path.write_text(FILE.replace("skip = 2", "skip = "))
    with pytest.raises(FileFormatError, match=f"^{re.escape(str(path))}: .*line 20"):
        load_campaign(path)
    with pytest.raises(FileFormatError, match=r"gone\.toml: no such file"):
        load_campaign(path.parent / "gone.toml")


def test_more_seeds_than_are_listed():
    with pytest.raises(InputError, match="lists 2 seeds, 3 are asked for"):
        load_campaign(SMALL | {"seeds": [5, 9]}, 3)
    with pytest.raises(InputError, match="seeds must be a whole number from 1 on"):
        load_campaign(SMALL, 0)
