"""Sightings that are not what they seem: clutter, and landmarks taken for others."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.sensors import Sensor
from ekfslam.simulation.draws import CLUTTER, SENSORS, stream
from ekfslam.simulation.scenario import Scenario
from ekfslam.simulation.sightings import Rows, carried


def clutter(scenario: Scenario, seed: int) -> Iterator[Rows]:
    """Spurious sightings, sensor by sensor and robot by robot.

    Their number in a look is Poisson. Each shows a point drawn uniformly from the sensor's visible
    area: of a bearing, that is uniform in the field of view. Its descriptor is one of the world's.

    Parameters
    ----------
    scenario : Scenario
    seed : int
        Of the run.
    """
    looks = len(scenario.times)
    for number, sensor, robot in carried(scenario):
        random = stream(seed, SENSORS + number, robot, CLUTTER)
        step = np.repeat(np.arange(looks), random.poisson(scenario.clutter, looks))
        values = sensor.view.project(_anywhere(sensor, random.random((len(step), 2))))
        described: Array | float = np.nan
        if scenario.descriptors is not None:
            described = random.choice(scenario.descriptors, len(step))
        rows = Rows.of(step, robot, number, values, descriptor=described)
        yield rows.take(scenario.looks(sensor)[step])


def _anywhere(sensor: Sensor, draws: Array) -> Array:
    """Uniform draws (m, 2) as points in a sensor's frame, uniform in its visible area (m, 2)."""
    least, most, half = sensor.limits
    if not np.isfinite(most):  # of a bearing, where any range will do
        most = least + 1.0
    distance = np.sqrt(least**2 + draws[:, :1] * (most**2 - least**2))
    bearing = half * (2 * draws[:, 1:] - 1)
    return distance * np.column_stack([np.cos(bearing), np.sin(bearing)])


def mistake(seen: Rows, share: float, ids: np.ndarray, random: np.random.Generator) -> Rows:
    """Let a share of the sightings carry the identity of a landmark out of sight.

    Parameters
    ----------
    seen : Rows
        Of landmarks, in order.
    share : float
        Probability that a sighting is mistaken.
    ids : (L,) ndarray of int
        Identities in the world. A mistaken sighting carries, with equal probability, one of those
        that nothing in the same look is or carries; its own where none is left.
    random : Generator

    Raises
    ------
    InputError
        If no look leaves any.
    """
    named = seen.named.copy()
    wrong = random.random(len(named)) < share
    look = np.column_stack([seen.step, seen.robot, seen.sensor])
    changes = np.flatnonzero((np.diff(look, axis=0) != 0).any(axis=1)) + 1
    for first, stop in pairwise([0, *changes.tolist(), len(named)]):
        for row in first + np.flatnonzero(wrong[first:stop]):
            taken = np.concatenate([seen.landmark[first:stop], named[first:stop]])
            free = np.setdiff1d(ids, taken)
            if len(free):
                named[row] = random.choice(free)
    if wrong.any() and (named == seen.named).all():
        raise InputError("wrong_ids: every look holds all landmarks; none is left to be taken for")
    return seen._replace(named=named)
