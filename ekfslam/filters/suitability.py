"""Whether a filter can work with what a dataset has: views, robots, options."""

from __future__ import annotations

import numpy as np

from ekfslam.dataset import Sightings
from ekfslam.errors import UnsupportedError
from ekfslam.filters.options import OF_POINTS, Options
from ekfslam.filters.variants import ALONE, EKF, NAMES, ROBOCENTRIC
from ekfslam.models.sensors import BEARING, RANGE


def views_of_landmarks(sightings: Sightings) -> set[int]:
    """Codes of the views that show landmarks; robots that are seen ask nothing of a view."""
    return {int(kind) for kind in np.unique(sightings.kind[sightings.target < 0])}


def check_views(options: Options, association: str, sightings: Sightings) -> None:
    """Refuse what cannot work with the views of landmarks.

    Parameters
    ----------
    options : Options
    association : str
    sightings : Sightings

    Raises
    ------
    UnsupportedError
        Says what to do.
    """
    kinds = views_of_landmarks(sightings)
    if (options.variant != EKF or options.points_only) and kinds & {BEARING, RANGE}:
        name = getattr(options, "name", NAMES[options.variant])
        raise UnsupportedError(f"{name} needs sensors that determine a point")
    bearings = (sightings.kind == BEARING) & (sightings.target < 0)
    nearest = sightings.limits[bearings, 0].min(initial=np.inf)
    partial = kinds & {BEARING, RANGE}
    if partial and association in OF_POINTS:
        raise UnsupportedError(f"association {association!r} needs sensors that determine a point")
    if RANGE in kinds and association != "known":
        raise UnsupportedError("ranges alone need association 'known'")
    if partial and options.confirm > 1:
        raise UnsupportedError("confirm needs sensors that determine a point")
    if partial and options.initiation == "allocated":
        raise UnsupportedError("initiation 'allocated' needs sensors that determine a point")
    if BEARING in kinds and options.bearings == "inverse-depth" and not nearest > 0:
        raise UnsupportedError(
            "the prior on the inverse depth of a bearing needs the sensor's min_range: state it"
        )


def check_variant(options: Options, robots: int) -> None:
    """Refuse options that a filter of the family cannot have, and teams it cannot take.

    Parameters
    ----------
    options : Options
    robots : int

    Raises
    ------
    UnsupportedError
        Says what it would take.
    """
    name = NAMES[options.variant]
    if options.variant in ALONE and robots > 1:
        raise UnsupportedError(f"{name} is for a single robot, there are {robots}")
    if options.variant != EKF and options.initiation != "mapped":
        raise UnsupportedError(f"{name} needs initiation 'mapped'")
    if options.variant == ROBOCENTRIC and options.confirm > 1:
        raise UnsupportedError(f"{name} has no fixed frame for tentative landmarks: confirm=1")
