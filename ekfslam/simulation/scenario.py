"""Scenarios: a world, robots with their paths and motion models, and sensors.

`ekfslam.simulation.load_scenario` reads one by name or from a TOML file::

    description = "A square of four landmarks."
    association = "known"         # or "unknown": observations carry no identity
    noise_on = "odometry"         # or "motion"
    time_step = 1.0               # [s]; not for motion models whose controls have a dt
    observe_start = false         # whether pose 0 observes too
    observe_every = 1             # observe at every so many poses
    new_landmarks_per_step = 1    # optional; see `Scenario`
    clutter = 0.3                 # optional: spurious sightings per look
    wrong_ids = 0.01              # optional: share of sightings that carry another's identity
    descriptor_sigma = 0.02       # optional: noise of the descriptors of the world
    known_map = 0.5               # optional: share of the landmarks on the map for localization

    [world]                       # kind and parameters of a function in ekfslam.simulation.worlds
    kind = "points"
    landmarks = [[0, 0], [4, 0], [4, 4], [0, 4]]
    descriptors = [0.2, 0.5]      # optional: one number of each landmark, such as a diameter [m];
                                  # a list that is too short starts again

    [path]                        # the same as the world, of ekfslam.simulation.paths
    kind = "controls"
    start = [2, 0, 0]
    controls = [[0.1, "3 deg"]]
    repeat = 120

    [motion]                      # parameters of ekfslam.models.motion.MotionModel
    kind = "advance-turn"
    sigmas = [0.01, "1 deg"]
    slip = 0.001                  # the default for two noisy controls, 0 otherwise
    mixture = [                   # optional: noise that is no Gaussian, as components of a weight,
      [0.95, 1, 0, 0],            # a factor on the sigmas, and an offset of each noisy control;
      [0.05, 1, 0.2, 0],          # offsets of zero may be left out of all
    ]

    [prior]                       # optional: an exactly known start is the default
    sigmas = [0.1, 0.1, "2 deg"]
    mean = [2, 0, 0]              # the true start by default
    draw = true                   # draw the mean of the prior about `mean`; false by default

    [[sensors]]                   # parameters of ekfslam.models.sensors.Sensor, one table each
    kind = "range-bearing"
    sigmas = [0.1, "1 deg"]       # one number for a bearing or a range alone
    max_range = 5.0
    every = 2                     # optional: looks at the poses offset, offset + every, ...
    offset = 1
    robots = ["one"]              # optional: who carries it, all by default
    mutual = true                 # optional: sees other robots, too

Paths that are listed have the kind ``poses``, or ``points`` with a spacing, for the motion model
``odometry``; all kinds are in `ekfslam.simulation.paths`.

Points that are not ours to copy are named by file: ``file = "maps/some.mat"`` instead of the
``landmarks`` of a world of kind ``points``, or of the ``waypoints`` of a path of that kind; see
`ekfslam.simulation.world_files`.

A city needs its count of landmarks alone: a path of kind ``tour`` has the blocks of the world of
kind ``streets``, which grow with the count.

Several robots have a table each instead of the tables path, motion and prior; they make the same
number of steps at the same times::

    [[robots]]
    name = "one"
    [robots.path]                 # as [path] above
    [robots.motion]               # as [motion] above
    [robots.prior]                # as [prior] above

A hand-held sensor has a path of kind ``unguided``, which says how many steps, a motion of kind
``none``, whose sigmas are those of the perturbation (x, y, heading), and ``noise_on = "motion"``.

Numbers are in SI units and radians; a string such as ``"3 deg"`` stands for an angle in degrees.
Wherever a ``covariance`` is asked for, standard deviations ``sigmas`` may be given instead; a
covariance itself takes no degrees.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ekfslam.checks import check_finite, checked_array
from ekfslam.errors import InputError
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import BEARING, Sensor
from ekfslam.robots import LandmarkMap, Prior
from ekfslam.simulation.plans import RobotPlan, SensorPlan


@dataclass(frozen=True, eq=False)
class Scenario:
    """A SLAM problem to draw datasets from with `ekfslam.simulation.simulate`.

    Variants are made with `dataclasses.replace`.

    Parameters
    ----------
    name : str
    landmarks : LandmarkMap
        The world.
    start, controls, motion
        Of the robot, or the first one; see `RobotPlan`.
    sensors : tuple of Sensor or SensorPlan
        With the noise that is both simulated and stated in the dataset. A `SensorPlan` says who
        carries it, when it looks, and whether it sees robots; a `Sensor` is carried by all and
        always looks.
    description : str
    association : {"known", "unknown"}
        Whether observations carry the identity of their landmark.
    noise_on : {"odometry", "motion"}
        "odometry": the truth follows the command and the measured controls are perturbed;
        "motion": the truth is disturbed and the measured controls are the command. Lateral slip
        has no control that could measure it and disturbs the truth in both. A motion model without
        controls needs "motion".
    time_step : float, optional
        Time from pose to pose [s], 1 by default. Motion models with a dt take theirs from it.
    prior, draw_prior
        Of the robot, or the first one; see `RobotPlan`.
    observe_start : bool
        Whether pose 0 observes too; a step is otherwise a motion and then a look.
    observe_every : int
        Only the poses whose number is a multiple of it observe.
    new_landmarks_per_step : int, optional
        Drop the sightings of all but so many landmarks, picked at random, of those that have not
        been seen before: the policy of Solà's demo (C.3, with 1), made part of the data so that
        every estimator solves the same problem. Off by default.
    team : tuple of RobotPlan
        Further robots, with as many steps at the same times.
    robot_name : str
        Of the first robot.
    clutter : float
        Mean number of spurious sightings in a look, one sensor at one pose: Poisson, uniform over
        what the sensor sees. They carry no identity.
    wrong_ids : float
        Share of the sightings of landmarks that carry the identity of one that is not in the look,
        each with the same probability; their own where none is left. For a known association.
    descriptors : (L,) array_like, optional
        One number of each landmark that its sightings report, such as a trunk diameter [m].
    descriptor_sigma : float
        Standard deviation of the noise of descriptors.
    known_map : float
        Share of the landmarks that the dataset's known map holds, for those who localize on it:
        all by default, so many picked at random, or, with 0, no map at all.

    Raises
    ------
    InputError
        For values that make no sense; the message names them.
    """

    name: str
    landmarks: LandmarkMap
    start: Array
    controls: Array
    motion: MotionModel
    sensors: tuple[Sensor, ...]
    description: str = ""
    association: str = "known"
    noise_on: str = "odometry"
    time_step: float | None = None
    prior: Prior | None = None
    draw_prior: bool = False
    observe_start: bool = False
    observe_every: int = 1
    new_landmarks_per_step: int | None = None
    team: tuple[RobotPlan, ...] = ()
    robot_name: str = "robot"
    clutter: float = 0.0
    wrong_ids: float = 0.0
    descriptors: Array | None = None
    descriptor_sigma: float = 0.0
    known_map: float = 1.0

    def __post_init__(self) -> None:
        for name, known in (
            ("association", ("known", "unknown")),
            ("noise_on", ("odometry", "motion")),
        ):
            if getattr(self, name) not in known:
                raise InputError(f"{name} must be {' or '.join(map(repr, known))}")
        if self.time_step is not None and not (np.isfinite(self.time_step) and self.time_step > 0):
            raise InputError(f"time_step must be positive, got {self.time_step}")
        for name in ("observe_every", "new_landmarks_per_step"):
            count = getattr(self, name)
            if count is not None and count < 1:
                raise InputError(f"{name} must be at least 1, got {count}")
        self._check_kinds()
        object.__setattr__(self, "sensors", tuple(self.sensors))
        object.__setattr__(self, "team", tuple(self.team))
        for name in ("start", "controls"):
            object.__setattr__(self, name, getattr(self.robot_plans[0], name))
        self._check_robots()
        self._check_sensors()
        self._check_descriptors()
        if not 0 <= self.known_map <= 1:
            raise InputError(f"known_map must be a share from 0 to 1, got {self.known_map}")

    def _check_kinds(self) -> None:
        """Say what is wanted where Python's own containers are likely to be given."""
        if not isinstance(self.landmarks, LandmarkMap):
            raise InputError(
                "landmarks must be a LandmarkMap(ids, positions), such as "
                f"LandmarkMap(range(4), positions); got {type(self.landmarks).__name__}"
            )
        if not isinstance(self.motion, MotionModel):
            raise InputError(f"motion must be a MotionModel, got {type(self.motion).__name__}")
        listed = isinstance(self.sensors, tuple | list)
        if not listed or not all(isinstance(sensor, Sensor) for sensor in self.sensors):
            raise InputError(f"sensors must be a list of Sensor, got {self.sensors!r}")

    def _check_robots(self) -> None:
        names = [plan.name for plan in self.robot_plans]
        if len(set(names)) < len(names):
            raise InputError(f"robots need names of their own, got {', '.join(names)}")
        for plan in self.robot_plans:
            if len(plan.controls) != len(self.controls):
                raise InputError(
                    f"robots make the same number of steps, but {plan.name} makes "
                    f"{len(plan.controls)} and {names[0]} {len(self.controls)}"
                )
            if plan.times is not None:
                if self.time_step is not None:
                    kind = plan.motion.kind
                    raise InputError(f"time_step is the dt of {kind!r} controls; leave out")
                if not np.allclose(plan.times, self.times):
                    raise InputError(f"the dt of {plan.name}'s controls differ from another's")
            if not plan.motion.control_names and self.noise_on == "odometry":
                raise InputError(
                    f"{plan.name} has no control to measure (motion {plan.motion.kind!r}): "
                    "set noise_on to 'motion'"
                )

    def _check_sensors(self) -> None:
        names = {plan.name for plan in self.robot_plans}
        for sensor in self.sensor_plans:
            for name in sensor.robots or ():
                if name not in names:
                    known = ", ".join(sorted(names))
                    raise InputError(f"{sensor.name} is of no robot {name!r}; known: {known}")
            if sensor.mutual and len(names) == 1:
                raise InputError(f"mutual of {sensor.name} needs several robots")
            endless = not np.isfinite(sensor.max_range) and sensor.view.code != BEARING
            if self.clutter and endless:
                raise InputError(f"clutter needs a max_range of {sensor.name}")
        if not 0 <= self.clutter < np.inf:
            raise InputError(f"clutter must be a non-negative mean, got {self.clutter}")
        if not 0 <= self.wrong_ids <= 1:
            raise InputError(f"wrong_ids must be a share from 0 to 1, got {self.wrong_ids}")
        if self.wrong_ids and self.association == "unknown":
            raise InputError("wrong_ids needs sightings that carry identities: a known association")

    def _check_descriptors(self) -> None:
        if not 0 <= self.descriptor_sigma < np.inf:
            raise InputError(f"descriptor_sigma must not be negative, got {self.descriptor_sigma}")
        if self.descriptors is None:
            if self.descriptor_sigma:
                raise InputError("descriptor_sigma needs descriptors of the world")
            return
        shape = (len(self.landmarks),)
        descriptors = checked_array(self.descriptors, float, shape, "descriptors")
        check_finite(descriptors, "descriptors")
        object.__setattr__(self, "descriptors", descriptors)

    @cached_property
    def robot_plans(self) -> tuple[RobotPlan, ...]:
        """All robots."""
        first = RobotPlan(
            self.start, self.controls, self.motion, self.prior, self.draw_prior, self.robot_name
        )
        return (first, *self.team)

    @cached_property
    def sensor_plans(self) -> tuple[SensorPlan, ...]:
        """The sensors, with what a plain one leaves open."""
        return tuple(
            sensor if isinstance(sensor, SensorPlan) else SensorPlan(**sensor.to_dict())
            for sensor in self.sensors
        )

    @property
    def times(self) -> Array:
        """Times of the poses [s], (K + 1,)."""
        for plan in self.robot_plans:
            if plan.times is not None:
                return plan.times
        step = 1.0 if self.time_step is None else self.time_step
        return step * np.arange(len(self.controls) + 1, dtype=float)

    def looks(self, sensor: SensorPlan) -> np.ndarray:
        """Whether a sensor looks at each pose, (K + 1,) of bool."""
        steps = np.arange(len(self.controls) + 1)
        looking = (steps % self.observe_every == 0) & ((steps > 0) | self.observe_start)
        return looking & sensor.looks(steps)

    def describe(self) -> str:
        """What it is, in one line."""
        plans = self.robot_plans
        lengths = " and ".join(dict.fromkeys(f"{plan.length:.0f}" for plan in plans))
        guided = any(plan.motion.control_names for plan in plans)
        mixed = any(plan.motion.mixture is not None for plan in plans)
        motions = [p.motion.kind if p.motion.control_names else "unguided" for p in plans]
        facts = [
            f"{len(self.landmarks)} landmarks",
            f"{len(plans)} robots" if self.team else "",
            f"{len(self.controls)} steps" + (f" over {lengths} m" if guided else ""),
            " and ".join(dict.fromkeys(motions)) + " motion",
            " and ".join(map(_in_words, self.sensor_plans)) or "no sensor",
            f"noise on the {self.noise_on}" + (", a mixture" if mixed else ""),
            f"clutter {self.clutter:g} per look" if self.clutter else "",
            f"wrong identities {self.wrong_ids:.3g}" if self.wrong_ids else "",
            "descriptors" if self.descriptors is not None else "",
            f"{self.known_map:.3g} of the map known" if self.known_map < 1 else "",
            f"association {self.association}",
        ]
        return f"{self.description} [{'; '.join(filter(None, facts))}]".strip()


def _in_words(sensor: SensorPlan) -> str:
    """What a sensor is, who carries it, how often it looks, and whether it sees robots."""
    words = [sensor.kind]
    if sensor.robots is not None:
        words.append(f"of {', '.join(sensor.robots)}")
    if sensor.every > 1:
        words.append(f"every {sensor.every} steps")
    if sensor.mutual:
        words.append("of landmarks and robots")
    return " ".join(words)
