"""Who is timed on a map of some size: our filters, the textbook's, smoothers and peers."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from peers import FilterPy, RoboticsToolbox
from textbook_filters import DenseTextbook, JointTextbook, Textbook
from worlds import BLIND, mapped_after, shortened

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, Step
from ekfslam.estimates import Estimate
from ekfslam.filters.ekf import Ekf
from ekfslam.geometry import Array
from ekfslam.registry import parse, resolve


class Problem(NamedTuple):
    """Data, and what the filters of others begin with.

    Attributes
    ----------
    data : Dataset
    mapped : int
        Poses after which all landmarks are in the map.
    mean : (3 + 2 N,) ndarray
        Pose and landmarks after that.
    covariance : (3 + 2 N, 3 + 2 N) ndarray
    steps : list of Step
    """

    data: Dataset
    mapped: int
    mean: Array
    covariance: Array
    steps: list[Step]

    @classmethod
    def of(cls, data: Dataset) -> Problem:
        """Map the landmarks of a dataset."""
        mapped = Ekf().estimate(shortened(data, 0))
        ids = mapped.landmarks.ids
        assert (ids == np.arange(len(ids))).all(), "landmarks are numbered in order of the state"
        mean = np.concatenate([mapped.online.poses[-1], mapped.landmarks.positions.ravel()])
        return cls(data, mapped_after(data), mean, mapped.joint_covariance, list(data.steps()))


class Timing(NamedTuple):
    """What a run took, and where it was after the last observation.

    Attributes
    ----------
    observation : float
        Time of the steps after mapping for each of their observations, motion included [us].
    prediction : float
        Time of a step in which nothing is seen [us].
    pose : (3,) ndarray
    covariance : (3, 3) ndarray or None
    """

    observation: float
    prediction: float
    pose: Array
    covariance: Array | None


def by_dataset(name: str, problem: Problem, steps: int) -> Timing:
    """Time an estimator of the registry by its own clock of steps."""
    estimate = resolve(name).estimate(shortened(problem.data, steps, BLIND))
    last = problem.mapped + steps
    spent = float(estimate.step_seconds[problem.mapped : last].sum())
    return timing_of(estimate, last, spent / seen_in(problem, problem.mapped, last))


def by_progress(name: str, problem: Problem, steps: int) -> Timing:
    """Time a filter of the registry by the wall clock, as its run reports progress.

    So nothing is missed that passes between its steps, such as an update of the whole map; the
    reports are too slow for small maps.
    """
    last = problem.mapped + steps
    marks: list[tuple[int, float]] = []

    def report(step: int, of: int) -> None:
        marks.append((step, time.perf_counter()))

    estimate = resolve(name).estimate(shortened(problem.data, steps, BLIND), report)
    between = [mark for mark in marks if problem.mapped <= mark[0] <= last]
    (first, begin), (stop, end) = between[0], between[-1]
    return timing_of(estimate, last, (end - begin) / seen_in(problem, first, stop))


def timing_of(estimate: Estimate, last: int, observation: float) -> Timing:
    """The timing of a run that sees nothing from a pose on, given its seconds an observation."""
    online = estimate.online
    return Timing(
        1e6 * observation,
        1e6 * float(estimate.step_seconds[last:].mean()),
        online.poses[last - 1],
        None if online.covariances is None else online.covariances[last - 1],
    )


def by_step(make: Callable[[Array, Array], Any], problem: Problem, steps: int) -> Timing:
    """Time a filter that is given the map, and then one step after another."""
    slam = make(problem.mean, problem.covariance)
    last = problem.mapped + steps
    begin = time.perf_counter()
    for step in problem.steps[problem.mapped : last]:
        slam.step(step.increment, step.covariance, step.observations)
    observed = time.perf_counter() - begin
    pose, covariance = slam.mean[:3].copy(), slam.covariance[:3, :3].copy()
    blind = problem.steps[last : last + min(BLIND, steps)]
    begin = time.perf_counter()
    for step in blind:
        slam.step(step.increment, step.covariance, step.observations.rows(0, 0))
    predicted = time.perf_counter() - begin
    seen = seen_in(problem, problem.mapped, last)
    return Timing(1e6 * observed / seen, 1e6 * predicted / len(blind), pose, covariance)


def seen_in(problem: Problem, first: int, last: int) -> int:
    """Observations from a pose on to another."""
    offsets = problem.data.offsets
    return int(offsets[last] - offsets[first])


class Contender(NamedTuple):
    """One line of the figure.

    Attributes
    ----------
    name : str
    run : callable
        ``run(problem, steps) -> Timing``.
    steps : dict
        How many steps it is given after mapping, by number of landmarks: fewer where they are slow.
    update : {"joint", "sequential", ""}
        Our update that computes the same to round-off, if any does.
    """

    name: str
    run: Callable[[Problem, int], Timing]
    steps: dict[int, int]
    update: str = ""

    @property
    def here(self) -> bool:
        """Whether it can be run."""
        return self.name not in PEERS or find_spec(self.name) is not None


PEERS = ("roboticstoolbox", "filterpy")  # packages that need not be installed
SIZES = (20, 100, 300, 1000, 2000, 5000)
MANY = dict.fromkeys(SIZES, 200)
"""Steps of the fast: many map updates at any size, so that one that is pending counts little."""
LARGE = 1000  # landmarks of a map that may be updated between the steps
LOCAL = dict.fromkeys((300, 1000, 2000, 5000), 800)
AREAS = {300: 30, 1000: 100, 2000: 100, 5000: 100}  # landmarks of a local map
TWO_THREADS = "ekf, 2 threads"  # at the largest size alone, for the record
FAMILY = ("iekf", "ekf-ideal", "ekf-fej", "ekf-oc", "ekf-ri", "ekf-robocentric")


JOINT = {20: 200, 100: 200, 300: 80, 1000: 30, 2000: 8, 5000: 2}
TOOLBOX = {20: 60, 100: 60, 300: 10, 1000: 2, 2000: 1}


def on_the_ring(size: int) -> list[Contender]:
    """Where any landmark may be seen at any step; the slow are given fewer steps, or none."""
    family = {20: 200, 100: 200, 300: 60, 1000: 150}  # some updates of the whole map for each
    sequential = {20: 200, 100: 100, 300: 40, 1000: 10, 2000: 3, 5000: 1}
    dense = {20: 200, 100: 40, 300: 6, 1000: 1}
    filterpy = {20: 60, 100: 20, 300: 4, 1000: 1}
    everyone = [
        ours("ekf", MANY, size),
        ours("ekf(threads=2)", {5000: MANY[5000]}, size)._replace(name=TWO_THREADS),
        *(ours(name, family, size) for name in FAMILY),
        smoother(MANY),
        Contender("textbook, sequential", partial(by_step, Textbook), sequential, "sequential"),
        Contender("textbook, joint", partial(by_step, JointTextbook), JOINT, "joint"),
        Contender("textbook, dense", partial(by_step, DenseTextbook), dense, "joint"),
        Contender("roboticstoolbox", partial(by_step, RoboticsToolbox), TOOLBOX, "sequential"),
        Contender("filterpy", partial(by_step, FilterPy), filterpy, "joint"),
    ]
    return [each for each in everyone if size in each.steps]


def in_the_city(size: int) -> list[Contender]:
    """Where what is seen lies close together, and the robot moves on."""
    compressed = ours(f"ekf-compressed(area={AREAS[size]})", LOCAL, size)
    everyone = [
        ours("ekf", {300: 800, 1000: 400, 2000: 400, 5000: 150}, size),
        compressed._replace(update="joint"),
        smoother(LOCAL),
        Contender("textbook, joint", partial(by_step, JointTextbook), JOINT, "joint"),
        Contender("roboticstoolbox", partial(by_step, RoboticsToolbox), TOOLBOX, "sequential"),
    ]
    return [each for each in everyone if size in each.steps]


def ours(name: str, steps: dict[int, int], size: int) -> Contender:
    """A filter of the registry."""
    clock = by_progress if size >= LARGE else by_dataset
    return Contender(parse(name).name, partial(clock, name), steps)


def smoother(steps: dict[int, int]) -> Contender:
    """GTSAM's iSAM2 without covariances."""
    return Contender("gtsam-isam2", partial(by_dataset, "gtsam-isam2(marginals=False)"), steps)


def check_same(contender: Contender, timing: Timing, reference: Timing) -> None:
    """Hold a pose and its covariance to those of our filter.

    Raises
    ------
    AssertionError
        If they are apart by more than 1e-8, of the covariance relative to its largest entry.
    """
    apart = np.abs(geo.additive_error(timing.pose, reference.pose)).max()
    assert apart < 1e-8, f"{contender.name} computes another pose: {apart:.1e} apart"
    scale = np.abs(reference.covariance).max()
    apart = np.abs(timing.covariance - reference.covariance).max() / scale
    assert apart < 1e-8, f"{contender.name} computes another covariance: {apart:.1e} apart"
