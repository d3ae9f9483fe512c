"""Keys of the variables of a graph, and what messages call them.

A key holds a letter, and below it the sensor, the robot and the step of a pose (of robots x, of
displaced sensors s), the identity of a landmark (l), or the row of a sighting (of a point that it
shows: of a robot q, of a landmark that is held m).
"""

from __future__ import annotations

from typing import TypeVar

import gtsam
import numpy as np

Index = TypeVar("Index", int, np.ndarray)

POSE, LANDMARK, SENSOR, SEEN, HELD = (gtsam.symbol(letter, 0) for letter in "xlsqm")
LETTER = 56  # bits below it
ROBOT, MOUNTED = 1 << 32, 1 << 44  # from one robot, and from one sensor, to the next


def pose_key(step: Index, robot: Index | int = 0) -> Index:
    """Key of a robot's pose."""
    return POSE + robot * ROBOT + step


def landmark_key(landmark: Index) -> Index:
    """Key of a landmark."""
    return LANDMARK + landmark


def sensor_key(step: Index, robot: Index, sensor: Index) -> Index:
    """Key of the pose of a displaced sensor."""
    return SENSOR + sensor * MOUNTED + robot * ROBOT + step


def seen_key(row: Index) -> Index:
    """Key of the point that a sighting of a robot shows."""
    return SEEN + row


def held_key(row: Index) -> Index:
    """Key of the landmark that a sighting shows, held where it is."""
    return HELD + row


def indices(key: int) -> tuple[int, int, int]:
    """Step, robot and sensor of the key of a pose."""
    return key % ROBOT, key % MOUNTED // ROBOT, key % (1 << LETTER) // MOUNTED


def carrier(key: Index) -> Index:
    """Key of the pose of the robot that carries a displaced sensor, from that of its pose."""
    return POSE + (key - SENSOR) % MOUNTED


def is_landmark(key: int) -> bool:
    """Whether a key is that of a landmark."""
    return key >> LETTER == LANDMARK >> LETTER


def is_sensor(key: int) -> bool:
    """Whether a key is that of a displaced sensor."""
    return key >> LETTER == SENSOR >> LETTER


def is_held(key: int) -> bool:
    """Whether a key is that of a landmark that is held."""
    return key >> LETTER == HELD >> LETTER


def has_letter(keys: np.ndarray, base: int) -> np.ndarray:
    """Which keys have the letter of one of the constants above."""
    return keys >> LETTER == base >> LETTER


def key_name(key: int) -> str:
    """A variable in words, for messages."""
    if is_landmark(key):
        return f"landmark {key - LANDMARK}"
    if key >> LETTER == SEEN >> LETTER:
        return f"point of observation {key - SEEN}"
    if is_held(key):
        return f"landmark of observation {key - HELD}"
    step, robot, sensor = indices(key)
    of = f" of robot {robot}" if robot else ""
    return f"pose {step} of sensor {sensor}{of}" if is_sensor(key) else f"pose {step}{of}"
