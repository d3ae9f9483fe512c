"""Datasets drawn from scenarios."""

from __future__ import annotations

from os import PathLike

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset, Prior, Robot
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.mixture import Mixture, mixture_of
from ekfslam.models.motion import MotionModel
from ekfslam.observations import NO_LANDMARK, Observations
from ekfslam.simulation.draws import (
    COMPONENTS,
    CONTROL,
    MISTAKES,
    POLICY,
    START,
    part_of,
    shaped,
    stream,
)
from ekfslam.simulation.outliers import clutter, mistake
from ekfslam.simulation.plans import RobotPlan
from ekfslam.simulation.reading import load_scenario
from ekfslam.simulation.scenario import Scenario
from ekfslam.simulation.sightings import Rows, in_order, introduce_slowly, see_landmarks, see_robots


def simulate(
    scenario: str | PathLike[str] | Scenario,
    seed: int = 0,
    noise: float = 1.0,
    draw: float = 1.0,
    odometry_noise: float = 1.0,
) -> Dataset:
    """Draw a dataset from a scenario; the same arguments give the same bytes.

    Parameters
    ----------
    scenario : str, path or Scenario
        As for `load_scenario`.
    seed : int
        Of the run. Controls, mixture components and prior of each robot, landmark policy, outliers
        and each sensor have random streams of their own, and the noise of a sighting depends on
        pose, sensor and landmark alone: a further sensor or robot, a landmark that drops out of
        sight, or clutter changes no other draw.
    noise : float
        Scales every standard deviation, and the offsets of mixtures, as stated in the dataset and
        as drawn: the same draw of a smaller problem.
    draw : float
        Scales what is drawn and not what is stated; 0 gives data without noise that still state
        theirs. Outliers are not noise and stay, and so does the mean of a mixture, which an
        estimator takes off.
    odometry_noise : float
        Scales the noise of the controls and the slip alone, stated and drawn.

    Returns
    -------
    Dataset
        With the truth of poses, map and associations, and the map that may be known.

    Raises
    ------
    UnknownNameError, FileFormatError, InputError
        As `load_scenario`; and InputError if seed or a scale is negative, a range that was drawn
        is, or no landmark can be taken for another because all are always in sight.

    Notes
    -----
    What a sensor sees is decided on the truth. Noise that depends on a control or on a range is
    drawn from the true one; an estimator has the measured one to compute it from.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed must be a whole number from 0 on, got {seed!r}")
    scales = (("noise", noise), ("draw", draw), ("odometry_noise", odometry_noise))
    for name, scale in scales:
        if not (np.isfinite(scale) and scale >= 0):
            raise InputError(f"{name} must be a non-negative factor, got {scale}")
    seed = int(seed)
    robots, truths = [], []
    for number, plan in enumerate(scenario.robot_plans):
        motion = plan.motion.scaled(noise * odometry_noise)
        scale = noise * odometry_noise * draw
        controls, truth = _drive(plan, motion, scenario.noise_on, seed, number, scale)
        prior = _draw_prior(plan, stream(seed, START, number), noise, draw)
        robots.append(Robot(motion, controls, prior, truth, plan.name))
        truths.append(truth)
    seen = _look(scenario, np.stack(truths), seed, noise * draw)
    known = scenario.association == "known"
    provenance = f"simulated: scenario {scenario.name}, seed {seed}, noise {noise:g}, draw {draw:g}"
    if odometry_noise != 1:
        provenance += f", odometry noise {odometry_noise:g}"
    return Dataset(
        name=scenario.name,
        robots=tuple(robots),
        times=scenario.times,
        sensors=tuple(sensor.stated(noise) for sensor in scenario.sensor_plans),
        observations=Observations(
            seen.step,
            seen.values,
            seen.named if known else np.full_like(seen.named, NO_LANDMARK),
            seen.sensor,
            seen.robot,
            observed_robot=seen.target if (seen.target >= 0).any() else None,
            descriptor=None if scenario.descriptors is None else seen.descriptor,
        ),
        known_map=part_of(scenario.landmarks, scenario.known_map, seed),
        true_map=scenario.landmarks,
        true_landmark=seen.landmark,
        provenance=provenance,
        seed=seed,
    )


def _drive(
    plan: RobotPlan, stated: MotionModel, noise_on: str, seed: int, number: int, scale: float
) -> tuple[Array, Array]:
    """Measured controls (K, m) and true poses (K + 1, 3)."""
    motion, command = plan.motion, plan.controls
    covariances = motion.control_covariances(command)
    random = stream(seed, CONTROL, number)
    draws = random.standard_normal((len(command), covariances.shape[-1] + 1))
    on_odometry = noise_on == "odometry"
    noise = scale * shaped(covariances, draws[:, :-1])
    if motion.mixture is not None and stated.mixture is not None:
        factors, away = _components(mixture_of(motion.mixture), len(command), seed, number)
        offset = scale * away + mixture_of(stated.mixture).mean
        noise = factors * noise + (offset if on_odometry else -offset)  # measured less true
    noisy = motion.noisy_controls
    perturbed = command.copy()
    perturbed[:, :noisy] += noise[:, :noisy]
    driven, measured = (command, perturbed) if on_odometry else (perturbed, command)
    increments = motion.increment(driven)[0]
    if not noisy:  # no control to perturb: the robot itself is
        increments += noise
    increments[:, 1] += scale * motion.slip * draws[:, -1]
    return measured, geo.integrate(plan.start, increments)


def _components(mixture: Mixture, steps: int, seed: int, number: int) -> tuple[Array, Array]:
    """Scale (steps, 1) and offset from the mean (steps, n) of a component drawn for each step."""
    draws = stream(seed, CONTROL, number, COMPONENTS).random(steps)
    drawn = np.searchsorted(np.cumsum(mixture.weights)[:-1], draws, side="right")
    return mixture.scales[drawn, None], mixture.offsets[drawn] - mixture.mean


def _look(scenario: Scenario, truths: Array, seed: int, scale: float) -> Rows:
    """All sightings of a run, by step, robot and sensor."""
    landmarks = scenario.landmarks
    seen = in_order(see_landmarks(scenario, truths, seed, scale))
    if scenario.new_landmarks_per_step is not None:
        random = stream(seed, POLICY)
        limit = scenario.new_landmarks_per_step
        seen = introduce_slowly(seen, limit, len(landmarks), random)
    if scenario.wrong_ids:
        random = stream(seed, POLICY, 0, MISTAKES)
        seen = mistake(seen, scenario.wrong_ids, landmarks.ids, random)
    others = list(see_robots(scenario, truths, seed, scale))
    if scenario.clutter:
        others += clutter(scenario, seed)
    return in_order([seen, *others]) if others else seen


def _draw_prior(plan: RobotPlan, random: np.random.Generator, noise: float, draw: float) -> Prior:
    prior = Prior(plan.start) if plan.prior is None else plan.prior
    mean = prior.mean.copy()
    if plan.draw_prior:
        mean += noise * draw * shaped(prior.covariance[None], random.standard_normal((1, 3)))[0]
        mean[2] = geo.wrap(mean[2])
    return Prior(mean, noise**2 * prior.covariance)
