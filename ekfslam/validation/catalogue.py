"""The classic mistakes of an EKF-SLAM, in words.

Each names the switches of `ekfslam.validation.suspects` that make it, in one form or several.
"""

from __future__ import annotations

from ekfslam.validation.catalogue_correction import OF_THE_CORRECTION
from ekfslam.validation.catalogue_map import OF_THE_MAP
from ekfslam.validation.mistakes import LANDMARK, MOTION, MOVED_POSE, Mistake

CATALOGUE = (*OF_THE_MAP, *OF_THE_CORRECTION)

OWN_NOISE = {
    "q": Mistake(
        "q-own",
        MOTION,
        "uses a motion noise of its own, not the one that it is given",
        "numbers of another robot, written into the filter: a covariance of {}",
        MOVED_POSE,
    ),
    "r": Mistake(
        "r-own",
        LANDMARK,
        "uses a sensor noise of its own, not the one that it is given",
        "numbers of another sensor, written into the filter: a covariance of {}",
        "R, wherever it is used",
    ),
}
