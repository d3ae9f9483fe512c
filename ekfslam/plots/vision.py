"""How far apart colours are for those who see them, also for the colour-blind."""

from __future__ import annotations

from functools import cache

import numpy as np
from matplotlib.colors import to_rgb

# What is left of linear RGB with all cones, without the red and without the green ones (Machado et
# al. 2009, Table 1, severity 1).
_EYES = np.array(
    [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ],
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ],
    ]
)
_XYZ = np.array(  # of linear sRGB (IEC 61966-2-1)
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
_LAB = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])


@cache
def apart(one: str, other: str) -> float:
    """Distance of two colours for those who tell them apart worst.

    The least of the CIE 1976 distances in L*a*b* for normal eyes, protanopes and deuteranopes; 2.3
    is just noticeable side by side, and thin lines want 10 to 20.

    Parameters
    ----------
    one, other : str
        As matplotlib writes colours.
    """
    return float(np.linalg.norm(_seen(one) - _seen(other), axis=-1).min())


@cache
def _seen(color: str) -> np.ndarray:
    """L*a*b* for each kind of eyes, (3, 3)."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    white = _XYZ.sum(axis=1)
    relative = np.clip(_EYES @ linear, 0.0, 1.0) @ _XYZ.T / white
    compressed = np.where(
        relative > (6 / 29) ** 3, np.cbrt(relative), relative * (29 / 6) ** 2 / 3 + 4 / 29
    )
    lab: np.ndarray = compressed @ _LAB.T - [16.0, 0.0, 0.0]
    return lab
