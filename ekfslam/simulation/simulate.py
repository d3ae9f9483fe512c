"""Datasets drawn from scenarios."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from os import PathLike
from typing import NamedTuple

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, Prior, Robot
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import NO_LANDMARK, Observations
from ekfslam.simulation.scenario import Scenario, load_scenario

PAIRS_AT_ONCE = 1_000_000  # (pose, landmark) pairs held in memory


class _Sightings(NamedTuple):
    """Rows of observations with the truth of who was seen."""

    step: np.ndarray
    sensor: np.ndarray
    landmark: np.ndarray
    values: Array

    def rows(self, index: np.ndarray) -> _Sightings:
        return _Sightings(*(column[index] for column in self))


def simulate(
    scenario: str | PathLike[str] | Scenario, seed: int = 0, noise: float = 1.0, draw: float = 1.0
) -> Dataset:
    """Draw a dataset from a scenario; the same arguments give the same bytes.

    Parameters
    ----------
    scenario : str, path or Scenario
        As for `load_scenario`.
    seed : int
        Of the run. Controls, prior, landmark policy and each sensor have random streams of their
        own, and the noise of a sighting depends on pose, sensor and landmark alone: a further
        sensor, or a landmark that drops out of sight, changes no other draw.
    noise : float
        Scales every standard deviation, as stated in the dataset and as drawn: the same draw of a
        smaller problem.
    draw : float
        Scales what is drawn and not what is stated; 0 gives data without noise that still state
        theirs.

    Returns
    -------
    Dataset
        With the truth of poses, map and associations.

    Raises
    ------
    UnknownNameError, FileFormatError, InputError
        As `load_scenario`; and InputError if seed, `noise` or `draw` is negative, or a range that
        was drawn is.

    Notes
    -----
    What a sensor sees is decided on the truth. Noise that depends on a control or on a range is
    drawn from the true one; an estimator has the measured one to compute it from.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed must be a whole number from 0 on, got {seed!r}")
    for name, scale in (("noise", noise), ("draw", draw)):
        if not (np.isfinite(scale) and scale >= 0):
            raise InputError(f"{name} must be a non-negative factor, got {scale}")
    streams = np.random.SeedSequence(int(seed)).spawn(3 + len(scenario.sensors))
    control, start, policy, *looks = map(np.random.default_rng, streams)

    controls, truth = _drive(scenario, control, noise * draw)
    seen = _look(scenario, truth, looks, noise * draw)
    if scenario.new_landmarks_per_step is not None:
        seen = _introduce_slowly(
            seen, scenario.new_landmarks_per_step, len(scenario.landmarks), policy
        )
    known = scenario.association == "known"
    robot = Robot(
        _scaled_motion(scenario.motion, noise),
        controls,
        _draw_prior(scenario, start, noise, draw),
        truth,
    )
    return Dataset(
        name=scenario.name,
        robots=(robot,),
        times=scenario.times,
        sensors=tuple(_scaled_sensor(sensor, noise) for sensor in scenario.sensors),
        observations=Observations(
            seen.step,
            seen.values,
            seen.landmark if known else np.full_like(seen.landmark, NO_LANDMARK),
            seen.sensor,
        ),
        true_map=scenario.landmarks,
        true_landmark=seen.landmark,
        provenance=f"simulated: scenario {scenario.name}, seed {seed}, noise {noise:g}, "
        f"draw {draw:g}",
        seed=int(seed),
    )


def _drive(scenario: Scenario, random: np.random.Generator, scale: float) -> tuple[Array, Array]:
    """Measured controls (K, m) and true poses (K + 1, 3)."""
    motion, command = scenario.motion, scenario.controls
    noisy = motion.noisy_controls
    draws = random.standard_normal((len(command), noisy + 1))
    perturbed = command.copy()
    perturbed[:, :noisy] += scale * _shaped(motion.control_covariances(command), draws[:, :noisy])
    on_odometry = scenario.noise_on == "odometry"
    driven, measured = (command, perturbed) if on_odometry else (perturbed, command)
    increments = motion.increment(driven)[0]
    increments[:, 1] += scale * motion.slip * draws[:, noisy]
    return measured, geo.integrate(scenario.start, increments)


def _look(
    scenario: Scenario, truth: Array, randoms: list[np.random.Generator], scale: float
) -> _Sightings:
    """All sightings of a run, by step, then sensor, then landmark."""
    steps = np.arange(len(truth))
    looking = (steps % scenario.observe_every == 0) & ((steps > 0) | scenario.observe_start)
    none = np.empty(0, dtype=np.int64)
    parts = [_Sightings(none, none, none, np.empty((0, 2)))]
    for number, (sensor, random) in enumerate(zip(scenario.sensors, randoms, strict=True)):
        for some in _chunks(steps, len(scenario.landmarks)):
            draws = random.standard_normal((len(some), len(scenario.landmarks), 2))
            visible = sensor.sees(truth[some, None], scenario.landmarks.positions)
            row, landmark = np.nonzero(visible & looking[some, None])
            values = _measure(
                sensor,
                truth[some[row]],
                scenario.landmarks.positions[landmark],
                scale * draws[row, landmark],
            )
            ids = scenario.landmarks.ids[landmark]
            parts.append(_Sightings(some[row], np.full(len(row), number), ids, values))
    seen = _Sightings(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return seen.rows(np.lexsort((seen.landmark, seen.sensor, seen.step)))


def _chunks(steps: np.ndarray, landmarks: int) -> Iterator[np.ndarray]:
    size = max(1, PAIRS_AT_ONCE // max(1, landmarks))
    return (steps[first : first + size] for first in range(0, len(steps), size))


def _measure(sensor: Sensor, poses: Array, points: Array, draws: Array) -> Array:
    """Direct model plus noise shaped from standard normal draws, all (m, 2)."""
    exact = sensor.view.project(geo.to_frame(geo.compose(poses, sensor.mount), points))
    values = exact + _shaped(sensor.covariances(exact), draws)
    if sensor.view.names[0] == "range" and (values[:, 0] < 0).any():
        # Drawing again, or clipping, would bias the noise.
        near = exact[np.argmin(values[:, 0]), 0]
        raise InputError(
            f"noise made a range of {near:.3g} m of {sensor.name} negative; raise its min_range"
        )
    return np.where(sensor.view.angular, geo.wrap(values), values)


def _introduce_slowly(
    seen: _Sightings, limit: int, landmarks: int, random: np.random.Generator
) -> _Sightings:
    """Keep the sightings of landmarks seen before and, each step, of `limit` others."""
    mapped: set[int] = set()
    keep = np.ones(len(seen.step), dtype=bool)
    bounds = np.flatnonzero(np.diff(seen.step, prepend=-1, append=-1))
    for first, stop in pairwise(bounds):
        if len(mapped) == landmarks:
            break
        rows = seen.landmark[first:stop]
        fresh = sorted(set(rows.tolist()) - mapped)
        mapped.update(random.permutation(fresh)[:limit].tolist())
        keep[first:stop] = np.isin(rows, list(mapped))
    return seen.rows(keep)


def _draw_prior(
    scenario: Scenario, random: np.random.Generator, noise: float, draw: float
) -> Prior:
    prior = Prior(scenario.start) if scenario.prior is None else scenario.prior
    mean = prior.mean.copy()
    if scenario.draw_prior:
        mean += noise * draw * _shaped(prior.covariance[None], random.standard_normal((1, 3)))[0]
        mean[2] = geo.wrap(mean[2])
    return Prior(mean, noise**2 * prior.covariance)


def _shaped(covariances: Array, draws: Array) -> Array:
    """Standard normal draws (m, n) with covariances (m, n, n), which may be singular.

    The symmetric square root is unique, so that the draw does not hang on a library's choice.
    """
    values, vectors = np.linalg.eigh(covariances)
    along = np.einsum("mji,mj->mi", vectors, draws) * np.sqrt(np.maximum(values, 0.0))
    return np.einsum("mij,mj->mi", vectors, along)


def _scaled_motion(motion: MotionModel, scale: float) -> MotionModel:
    if motion.proportional is not None:
        p1, p2 = motion.proportional
        return replace(motion, proportional=(scale * p1, scale * p2), slip=scale * motion.slip)
    assert motion.covariance is not None
    return replace(motion, covariance=scale**2 * motion.covariance, slip=scale * motion.slip)


def _scaled_sensor(sensor: Sensor, scale: float) -> Sensor:
    return replace(
        sensor,
        covariance=scale**2 * sensor.covariance,
        range_growth=scale * sensor.range_growth,
    )
