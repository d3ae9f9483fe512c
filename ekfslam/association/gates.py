"""Gates given as probabilities.

A threshold on the squared Mahalanobis distance of an innovation with d degrees of freedom is the
chi-square quantile of a probability p: a true match falls inside with probability p. For d = 2
(range and bearing, or x and y): 0.95 is 5.99, 0.989 is 9.0 (the 3 sigma of Solà's demo), 0.99 is
9.21, 0.999 is 13.8. Ciatto's threshold is on the unsquared distance; that of Principles of Robot
Autonomy (Alg. 2) on the squared one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ekfslam.checks import checked_number
from ekfslam.errors import InputError


def chi2_gate(probability: float, dof: int) -> float:
    """Squared Mahalanobis distance inside which a true match falls with a given probability.

    Parameters
    ----------
    probability : float
        In [0, 1); 0 lets nothing pass.
    dof : int
        Dimension of the innovation.

    Raises
    ------
    InputError
        For a probability outside [0, 1).
    """
    from scipy.special import chdtri

    if not 0 <= checked_number(probability, "a gate") < 1:
        raise InputError(f"a gate is a probability in [0, 1), got {probability}")
    return float(chdtri(dof, 1.0 - probability))


def quantiles(probability: float, most: int) -> NDArray[np.float64]:
    """Gates on a joint squared distance, by its degrees of freedom.

    Parameters
    ----------
    probability : float
        In [0, 1).
    most : int
        Largest number of degrees of freedom.

    Returns
    -------
    (most + 1,) ndarray
        Chi-square quantiles; the first, of no degree of freedom, is 0.

    Raises
    ------
    InputError
        For a probability outside [0, 1).
    """
    chi2_gate(probability, 1)  # refuses what is no probability
    return np.array(_quantiles(float(probability), most))


@cache
def _quantiles(probability: float, most: int) -> tuple[float, ...]:
    """What a campaign would compute anew for every run."""
    from scipy.special import chdtri

    return (0.0, *chdtri(np.arange(1, most + 1), 1.0 - probability).tolist())


@dataclass(frozen=True)
class Gates:
    """The two gates of Bailey et al. 2006, as probabilities.

    Parameters
    ----------
    accept : float
        An observation nearer to a landmark than this quantile may correct it.
    new : float
        One farther than this quantile from every landmark starts a new one; in between it is
        ambiguous and not used.
    """

    accept: float = 0.999
    new: float = 0.999999

    def __post_init__(self) -> None:
        chi2_gate(self.accept, 2)
        chi2_gate(self.new, 2)
        if self.new < self.accept:
            raise InputError(
                f"the gate for new landmarks ({self.new}) must not be below "
                f"the gate to accept ({self.accept})"
            )
