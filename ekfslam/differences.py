"""Derivatives from values alone: what every Jacobian is held against."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

STEP = 1e-5  # of central differences, whose own error is then near 1e-10

_Array = NDArray[np.float64]


def central_differences(
    function: Callable[[_Array], _Array], point: _Array, step: Any = STEP
) -> _Array:
    """Derivative of a vectorised function: (n, d) -> (n, m) gives (n, m, d).

    Differences over one and two steps to either side are combined, so that their error falls with
    the fourth power of the step. Where an output is an angle, the function returns differences from
    its value at `point`, so that they can be wrapped.

    Parameters
    ----------
    function : callable
    point : (n, d) ndarray
    step : float or (n, d) array_like
        Of each input.

    Returns
    -------
    (n, m, d) ndarray
    """
    steps = np.broadcast_to(step, point.shape)
    columns = []
    for axis in range(point.shape[1]):
        nudge = np.zeros_like(point)
        nudge[:, axis] = steps[:, axis]
        near = function(point + nudge) - function(point - nudge)
        far = function(point + 2 * nudge) - function(point - 2 * nudge)
        columns.append((8 * near - far) / (12 * steps[:, axis, None]))
    return np.stack(columns, axis=-1)
