"""Noise models as gtsam wants them: regular, shared where equal, robust on request."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam import noiseModel

from ekfslam.checks import checked_number
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.geometry import Array

# With their customary tuning: 95 % efficiency on Gaussian noise of one dimension for Huber and
# Cauchy (Holland and Welsch 1977), Phi = 1 for dynamic covariance scaling (Agarwal et al. 2013).
KERNELS = {
    "huber": (noiseModel.mEstimator.Huber, 1.345),
    "cauchy": (noiseModel.mEstimator.Cauchy, 2.3849),
    "dcs": (noiseModel.mEstimator.DCS, 1.0),
}


class Kernel:
    """A robust loss of the whitened norm of a residual.

    Parameters
    ----------
    name : {"huber", "cauchy", "dcs"}
    scale : float, optional
        From where on residuals count less, in standard deviations (of DCS: its Phi, squared).

    Raises
    ------
    UnknownNameError, InputError
        For another name, or a scale that is not positive and finite.
    """

    def __init__(self, name: str, scale: float | None = None) -> None:
        if not isinstance(name, str) or name not in KERNELS:
            raise UnknownNameError("robust kernel", str(name), KERNELS)
        kind, customary = KERNELS[name]
        self.name = name
        self.scale = customary if scale is None else checked_number(scale, "robust_scale")
        if not 0 < self.scale < np.inf:
            raise InputError(f"robust_scale must be positive and finite, got {scale}")
        self._loss = kind.Create(self.scale)

    def around(self, model: noiseModel.Base) -> noiseModel.Base:
        """A noise model under this loss."""
        return noiseModel.Robust.Create(self._loss, model)

    def __str__(self) -> str:
        return f"{self.name} kernel of scale {self.scale:g}"


def chosen(robust: str | None, scale: float | None) -> Kernel | None:
    """The kernel of the options ``robust`` and ``robust_scale`` of a smoother.

    Raises
    ------
    UnknownNameError, InputError
        See `Kernel`.
    """
    if robust is not None:
        return Kernel(robust, scale)
    if scale is not None:
        raise InputError(f"robust_scale needs a kernel: robust must be one of {', '.join(KERNELS)}")
    return None


def floored(covariances: Array, floor: float) -> tuple[Array, int]:
    """Covariances with no standard deviation below a floor, and how many were changed.

    Parameters
    ----------
    covariances : (n, d, d) ndarray
    floor : float

    Returns
    -------
    (n, d, d) ndarray, int
    """
    eigenvalues, vectors = np.linalg.eigh(covariances)
    low = eigenvalues[:, 0] < floor**2
    if not low.any():
        return covariances, 0
    raised = vectors[low] * np.maximum(eigenvalues[low], floor**2)[:, None, :]
    covariances = covariances.copy()
    covariances[low] = raised @ np.swapaxes(vectors[low], 1, 2)
    return covariances, int(low.sum())


def models(covariances: Array, kernel: Kernel | None = None) -> list[noiseModel.Base]:
    """Noise models of covariances (n, d, d); equal ones share a model."""
    if len(covariances) == 0:
        return []
    flat = covariances.reshape(len(covariances), -1)
    if (np.abs(flat - flat[0]) <= 1e-12 * np.abs(flat[0]).max()).all():
        return [_model(covariances[0], kernel)] * len(covariances)
    return [_model(covariance, kernel) for covariance in covariances]


def _model(covariance: Array, kernel: Kernel | None) -> noiseModel.Base:
    gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return gaussian if kernel is None else kernel.around(gaussian)
