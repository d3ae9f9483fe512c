"""Runs of a few poses, each made to show one part of a filter.

Headings are large, covariances correlated and of unlike sizes, and the start is uncertain, so that
no mistake hides behind a zero, a one or a symmetry. Sightings are half a sigma off, inside every
gate. All of it shrinks with a scale: what a filter does otherwise in second order alone, which is
no mistake, shrinks with its square.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle
from typing import NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations
from ekfslam.robots import LandmarkMap, Prior, Robot
from ekfslam.validation.mistakes import (
    ANGLES,
    CORRECTION,
    GATE,
    LANDMARK,
    MOTION,
    MOUNT,
    SEVERAL,
)

START = np.array([2.0, -1.0, 1.1])
UNSURE = np.array([[0.04, 0.012, -0.004], [0.012, 0.09, 0.006], [-0.004, 0.006, 0.0064]])
MOTION_NOISE = np.array([[4e-2, 4e-3, 2e-3], [4e-3, 9e-3, -1e-3], [2e-3, -1e-3, 2.5e-3]])
NOISE = {
    "range-bearing": np.array([[0.03, 0.0012], [0.0012, 0.0009]]),
    "xy": np.array([[0.03, 0.004], [0.004, 0.009]]),
}
MOVES = np.array([[0.9, 0.2, 0.8], [0.7, -0.3, -0.5], [0.8, 0.3, 0.4], [0.6, -0.2, -0.7]])
ONE, STANDING = MOVES[:1], np.zeros((1, 3))
AHEAD = {3: [4.0, 1.5], 5: [3.0, -2.5], 8: [6.0, 0.5]}  # landmarks, from the true start
MIDDLE, ASIDE = np.zeros(3), np.array([0.5, 0.2, 0.7])
OFF = np.array([[0.4, -0.3], [-0.5, 0.4], [0.3, 0.5], [-0.4, -0.5], [0.5, 0.2]])
OFF_COURSE = np.array([0.5, -0.6, 0.4])  # of the true start from the prior, in sigmas
WOBBLE = np.array([[-0.5, 0.3, 0.6], [0.6, 0.5, -0.4]])  # of the true moves, likewise
ONCE, TWICE = ((0, 3),), ((0, 3), (1, 3))


class Probe(NamedTuple):
    """A question to a filter.

    Attributes
    ----------
    name : str
    stage : str
        What it is made to show.
    looks : tuple of (int, int)
        Step and landmark of each sighting.
    moves : (K, 3) ndarray
        Increments.
    landmarks : dict
        Identity to position, in the frame of the start.
    mount : (3,) ndarray
    heading : float
        Of the start.
    rest : float
        Noise of standing still, as a share of that of moving.
    """

    name: str
    stage: str
    looks: tuple[tuple[int, int], ...]
    moves: Array
    landmarks: dict[int, list[float]] = AHEAD
    mount: Array = MIDDLE
    heading: float = float(START[2])
    rest: float = 0.0

    @property
    def needs(self) -> frozenset[str]:
        """Stages that it goes through before its own."""
        again = len({landmark for _, landmark in self.looks}) < len(self.looks)
        through = {MOTION} if self.moves.any() else set()
        through |= {LANDMARK} if self.looks else set()
        through |= {CORRECTION} if again else set()
        return frozenset(through - {self.stage})

    @property
    def styles(self) -> tuple[tuple[str | None, ...], ...]:
        """In what right filters differ here, and how: a way of each tuple."""
        crowded = len({step for step, _ in self.looks}) < len(self.looks)
        orders, mounts = (None, "sequential", "in-order"), (None, "mount-last")
        return (orders if crowded else (None,), mounts if self.mount.any() else (None,))

    def dataset(self, kind: str, scale: float = 1.0) -> Dataset:
        """The run, with all uncertainty scaled.

        Parameters
        ----------
        kind : {"range-bearing", "xy"}
        scale : float
        """
        start = np.array([*START[:2], self.heading])
        Q = np.tile(scale**2 * MOTION_NOISE, (len(self.moves), 1, 1))
        Q[~self.moves.any(axis=1)] *= self.rest**2
        truth = [geo.compose(start, scale * OFF_COURSE * np.sqrt(np.diag(UNSURE)))]
        for move, noise, wobble in zip(self.moves, Q, cycle(WOBBLE), strict=False):
            truth.append(geo.compose(truth[-1], move + wobble * np.sqrt(np.diag(noise))))
        poses = np.array(truth)
        ids = np.array(list(self.landmarks))
        world = LandmarkMap(ids, geo.from_frame(poses[0], np.array([*self.landmarks.values()])))
        sensor = Sensor(kind, scale**2 * NOISE[kind], mount=self.mount)
        step, seen = np.array(self.looks, dtype=np.int64).reshape(-1, 2).T
        values = sensor.observe(poses[step], world.positions[np.searchsorted(ids, seen)])[0]
        values = values + scale * OFF[: len(seen)] * np.sqrt(np.diag(NOISE[kind]))
        return Dataset(
            name=self.name,
            robots=(
                Robot(
                    MotionModel("odometry", covariance=np.zeros((3, 3))),
                    self.moves,
                    Prior(start, scale**2 * UNSURE),
                    truth=poses,
                    covariance=Q,
                ),
            ),
            times=np.arange(float(len(poses))),
            sensors=(sensor,),
            observations=Observations(step, sensor.difference(values, np.zeros(2)), seen),
            true_map=world,
            true_landmark=seen,
        )


PROBES = (
    Probe("one move", MOTION, (), ONE),
    Probe("two moves", MOTION, (), MOVES[:2]),
    Probe("a landmark seen once", LANDMARK, ONCE, STANDING),
    Probe("two landmarks seen once", LANDMARK, ((0, 3), (1, 5)), STANDING),
    Probe("a landmark seen twice, standing still", CORRECTION, TWICE, STANDING),
    Probe("a landmark seen twice, with a move between", CORRECTION, TWICE, ONE),
    Probe("two landmarks seen twice", CORRECTION, ((0, 3), (0, 5), (1, 5), (2, 3)), MOVES[:2]),
    Probe("a longer walk", CORRECTION, ((0, 3), (1, 3), (2, 5), (3, 5), (4, 3)), MOVES),
    Probe("three landmarks at once", SEVERAL, ((0, 3), (0, 5), (1, 3), (1, 8), (1, 5)), ONE),
    Probe("a mounted sensor looks once", MOUNT, ONCE, STANDING, mount=ASIDE),
    Probe("a mounted sensor looks twice", MOUNT, TWICE, ONE, mount=ASIDE),
)
ANGULAR = (  # judged when it is known where a filter rejects what is far off
    Probe(
        "a bearing that jumps between pi and -pi",
        ANGLES,
        ((0, 3), (1, 3), (2, 3), (3, 3)),
        np.zeros((3, 3)),
        {3: [-4.0, 0.0]},
    ),
    Probe("a heading that passes pi", ANGLES, TWICE, ONE, heading=2.8),
    Probe("a landmark in the direction pi", ANGLES, TWICE, MOVES[1:2], heading=2.8),
)
AT_A_DISTANCE = Probe("a landmark seen again at a chosen distance", GATE, TWICE, ONE)


def with_last(dataset: Dataset, value: Array | None, whole: bool = False) -> Dataset:
    """The same run with another last sighting, without it, or without any.

    Parameters
    ----------
    dataset : Dataset
    value : (2,) array_like or None
        What it reports; None leaves it out.
    whole : bool
        Leave all out.
    """
    seen, truth = dataset.observations, dataset.true_landmark
    values, kept = seen.values.copy(), 0 if whole else len(seen) - (value is None)
    if value is not None:
        values[-1] = value
    return replace(
        dataset,
        observations=Observations(seen.step[:kept], values[:kept], seen.landmark[:kept]),
        true_landmark=None if truth is None else truth[:kept],
    )
