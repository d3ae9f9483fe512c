"""Control noise that is no Gaussian but a mixture of several.

With probability ``weight`` a control is off by ``offset + scale * N(0, Sigma_u)``: a wheel that
spins now and then (two peaks) has a component with an offset, a contaminated normal (heavy tails)
one with a large scale. The noise is on the measured control, ``measured = true + noise``; so given
a measured control u the true one is distributed about ``u - offset``. Offsets are absolute, in the
units of the controls: a slip that is a share of the way is one at a steady speed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ekfslam.checks import ROUNDING, check_finite, checked_array, frozen
from ekfslam.errors import InputError
from ekfslam.geometry import Array


class Components(NamedTuple):
    """Body increments of a run as a mixture of Gaussians, the same weights in every step.

    Attributes
    ----------
    weights : (C,) ndarray
        Probabilities of the components.
    deltas : (C, K, 3) ndarray
        Increment of each component from pose k to pose k + 1 [m, m, rad].
    covariances : (C, K, 3, 3) ndarray
        In the frame of the first pose, with the lateral slip.
    """

    weights: Array
    deltas: Array
    covariances: Array


class Mixture(NamedTuple):
    """The columns of a mixture.

    Attributes
    ----------
    weights, scales : (C,) ndarray
    offsets : (C, n) ndarray
        Of the noisy controls, in their units.
    """

    weights: Array
    scales: Array
    offsets: Array

    @property
    def mean(self) -> Array:
        """Mean of the noise, (n,)."""
        return np.asarray(self.weights @ self.offsets)

    def covariances(self, noise: Array) -> Array:
        """Covariances of the mixed noise about its mean.

        Parameters
        ----------
        noise : (K, n, n) ndarray
            Sigma_u, of a component of scale 1.

        Returns
        -------
        (K, n, n) ndarray
            ``sum w (s^2 Sigma_u + o o') - m m'`` with the mean m, written as a sum of squares
            about m, which rounding cannot make negative.
        """
        away = self.offsets - self.mean
        return (self.weights @ self.scales**2) * noise + (self.weights * away.T) @ away


def mixture_of(rows: Array) -> Mixture:
    """The columns of rows (weight, scale, offset...)."""
    return Mixture(rows[:, 0], rows[:, 1], rows[:, 2:])


def checked_mixture(value: Any, noises: int) -> Array:
    """Components (weight, scale, offset...) as a read-only array (C, 2 + noises).

    Parameters
    ----------
    value : (C, 2) or (C, 2 + noises) array_like
        Offsets that are left out are zero.
    noises : int
        How many numbers carry noise.

    Raises
    ------
    InputError
        For another shape, weights that are not positive or do not sum to 1, or negative scales.
    """
    try:
        bare = np.ndim(value) == 2 and np.shape(value)[1] == 2
    except ValueError:
        raise InputError("mixture has components of different lengths") from None
    rows = checked_array(value, float, (None, 2 if bare else 2 + noises), "mixture")
    check_finite(rows, "mixture")
    weights, scales = rows[:, 0], rows[:, 1]
    if (weights <= 0).any():
        raise InputError(f"mixture needs positive weights, got {weights.tolist()}")
    if abs(weights.sum() - 1) > ROUNDING:
        raise InputError(f"the weights of mixture must sum to 1, got {weights.sum():.10g}")
    if (scales < 0).any():
        raise InputError(f"mixture needs scales that are not negative, got {scales.tolist()}")
    return frozen(np.hstack([rows, np.zeros((len(rows), noises))])) if bare else rows
