"""How a time grows with the size of the map."""

from __future__ import annotations

import numpy as np


def exponent(sizes: np.ndarray, times: np.ndarray) -> float:
    """Least-squares exponent of ``time = c size^e``, fitted to logarithms.

    Raises
    ------
    ValueError
        For fewer than two different sizes.
    """
    if len(np.unique(sizes)) < 2:
        raise ValueError("an exponent takes at least two sizes")
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
