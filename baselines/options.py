"""Options of the smoothers, looked at before anything runs."""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.noise import chosen
from ekfslam.checks import checked_number
from ekfslam.errors import InputError

# Least value of those that count, and those that measure.
COUNTS = {
    "max_iterations": 1,
    "relinearize_skip": 1,
    "final_updates": 0,
    "marginal_every": 1,
    "lag": 1,
    "max_landmarks": 1,
}
AMOUNTS = "relative_tolerance", "relinearize_threshold", "odometry_floor"
MOST = 2**31 - 1  # gtsam counts in 32 bits


def check(smoother: Any) -> None:
    """Refuse options that make no sense.

    gtsam would take most of them: one that is not a number changes nothing that is seen, and by a
    `relinearize_skip` of zero it divides.

    Parameters
    ----------
    smoother : object
        With any of the options of `COUNTS` and `AMOUNTS`; `marginals`, `robust` and `robust_scale`.

    Raises
    ------
    UnknownNameError, InputError
        For a loss that is not there, or a value that makes no sense; names it.
    """
    chosen(smoother.robust, smoother.robust_scale)
    if not isinstance(smoother.marginals, bool | np.bool_):
        raise InputError(f"marginals must be True or False, got {smoother.marginals!r}")
    for name, least in COUNTS.items():
        value = getattr(smoother, name, least)
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if not whole or not least <= value <= MOST:
            raise InputError(f"{name} must be a whole number from {least} to {MOST}, got {value!r}")
    for name in AMOUNTS:
        value = getattr(smoother, name, 0.0)
        if not 0 <= checked_number(value, name) < np.inf:
            raise InputError(f"{name} must be finite and not negative, got {value}")
