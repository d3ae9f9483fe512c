"""Campaigns: scenarios × seeds × estimators, stated in a TOML file.

`load_campaign` reads one, `ekfslam.run_campaign` or the command ``ekfslam campaign`` runs it::

    name = "heading"                  # optional: the file's name by default
    description = "What an uncertain heading does to the filters."
    seeds = 100                       # 0 to 99; or { first = 1000, count = 100 }, or a list
    estimators = [
      "ekf", "ekf-ri", "gtsam-batch", "ekf(association=joint)",
      { name = "gtsam-isam2", seeds = 20 },   # a slow one: on the first 20 seeds alone
    ]

    [[scenarios]]                     # at least one
    name = "loop-15"                  # of a scenario, or a .toml file, relative to this one
    label = "small loop"              # optional: what tables call it; its name by default
    [scenarios.set]                   # optional: values of the scenario's file, by dotted key
    path.repeat = 170                 # with the numbers of list items from 0
    sensors.0.sigmas = [0.2, 0.2]
    [scenarios.sweep]                 # optional: lists of such values; every combination runs
    prior.sigmas = [[0.05, 0.05, "1 deg"], [0.05, 0.05, "10 deg"]]

    [metrics]                         # optional
    skip = 5                          # leave the first steps out of averages over a run; 0
    steps = { every = 10 }            # what the table `steps` keeps: multiples and the last one;
                                      # or a list of steps, or "all", which is the default
    reference = "gtsam-batch"         # what gaps and sigma ratios refer to; none by default
    diverged_above = 20               # mean pose NEES of a run that counts as diverged; 20

    [compare]                         # optional: paired on the same seeds
    baseline = "ekf"                  # each of the others against it
    pairs = [["ekf-ri", "gtsam-batch"]]               # and these; no two are compared twice
    metrics = ["nees_pose_mean_kept", "ate_position_rmse_m"]   # columns of `runs`

A variant of a scenario is what a combination of swept values makes of it. Its label, the column
``scenario`` of all tables, is the scenario's with the swept values in brackets:
``small loop(prior.sigmas=[0.05, 0.05, 1 deg])``. The reference runs in every cell whether or not
it is one of the estimators.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from ekfslam.experiments.cells import Metrics, Unit
from ekfslam.simulation import Scenario

COMPARED = ("nees_pose_mean_kept", "ate_position_rmse_m")


@dataclass(frozen=True, eq=False)
class Variant:
    """A scenario of a campaign with its values set.

    Attributes
    ----------
    label : str
        What tables call it.
    name : str
        Of the scenario, or its file, as written.
    swept : dict
        The values that tell it from the other variants of its entry, by dotted key.
    scenario : Scenario
    digest : str
        Of the problem that it states, 16 hexadecimal digits; see `simulation.scenario_hash`.
    """

    label: str
    name: str
    swept: Mapping[str, Any]
    scenario: Scenario
    digest: str


@dataclass(frozen=True)
class Pairing:
    """Which estimators are compared on the same seeds, and by which columns of `runs`."""

    pairs: tuple[tuple[str, str], ...] = ()
    metrics: tuple[str, ...] = COMPARED


@dataclass(frozen=True, eq=False)
class Campaign:
    """What a campaign file says, checked; made by `load_campaign`.

    Attributes
    ----------
    name, description : str
    variants : tuple of Variant
    seeds : tuple of int
    estimators : dict
        What they are called in tables, and the text that they are made from.
    metrics : Metrics
    pairing : Pairing
    few_seeds : dict
        How many of the seeds an estimator runs on, from the first on; those that run on all are
        not in it.
    text : str
        The file, empty if there is none.
    """

    name: str
    variants: tuple[Variant, ...]
    seeds: tuple[int, ...]
    estimators: Mapping[str, str]
    metrics: Metrics = field(default_factory=Metrics)
    pairing: Pairing = field(default_factory=Pairing)
    few_seeds: Mapping[str, int] = field(default_factory=dict)
    description: str = ""
    text: str = ""

    @property
    def cells(self) -> int:
        """How many there are: variants × seeds of each estimator."""
        return len(self.variants) * sum(len(self.seeds_of(name)) for name in self.estimators)

    def seeds_of(self, estimator: str) -> tuple[int, ...]:
        """Seeds that an estimator runs on."""
        return self.seeds[: self.few_seeds.get(estimator)]

    def units(self, done: Mapping[tuple[str, int], Collection[str]]) -> list[Unit]:
        """The work that is left, seed by seed, so that what is there first says most.

        Parameters
        ----------
        done : mapping
            Names of the estimators that are done, by digest of the scenario and seed.
        """
        units = []
        seeds_of = {name: set(self.seeds_of(name)) for name in self.estimators}
        for seed in self.seeds:
            on_it = {k: text for k, text in self.estimators.items() if seed in seeds_of[k]}
            for variant in self.variants:
                there = done.get((variant.digest, seed), ())
                left = {k: text for k, text in on_it.items() if k not in there}
                if left:
                    about = (variant.label, variant.digest, variant.scenario)
                    units.append(Unit(self.name, *about, seed, left, self.metrics))
        return units

    def config(self) -> dict[str, Any]:
        """What is run, as JSON can hold it."""
        return {
            "campaign": self.name,
            "description": self.description,
            "scenarios": [
                {"label": v.label, "name": v.name, "swept": dict(v.swept), "hash": v.digest}
                for v in self.variants
            ],
            "seeds": list(self.seeds),
            "estimators": dict(self.estimators),
            "few_seeds": dict(self.few_seeds),
            "metrics": asdict(self.metrics) | {"digest": self.metrics.digest},
            "compare": asdict(self.pairing),
        }
