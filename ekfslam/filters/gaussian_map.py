"""The map of EKF-SLAM: one Gaussian over the robot's pose and all landmarks (Solà, 2.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekfslam.dataset import Prior
from ekfslam.errors import EkfslamError, InputError
from ekfslam.filters import kernels
from ekfslam.geometry import Array

POSE, POINT = 3, 2


class MapArrays(NamedTuple):
    """What the compiled loop works on.

    Attributes
    ----------
    mean : (capacity,) ndarray
    covariance : (capacity, capacity) ndarray
        Its upper triangle up to `size` is the covariance.
    size : (1,) ndarray of int
        Dimension of the state.
    """

    mean: Array
    covariance: Array
    size: np.ndarray


class GaussianMap:
    """Mean and covariance in preallocated storage that doubles when it is full.

    Only the upper triangle of the covariance is stored and updated, so it is symmetric by
    construction. The four operations are those of Solà's Table 1, in sparse form.

    Parameters
    ----------
    prior : Prior
        Of the pose.
    landmarks : int
        Room to begin with.
    """

    def __init__(self, prior: Prior, landmarks: int = 32) -> None:
        capacity = POSE + POINT * max(landmarks, 1)
        self.arrays = MapArrays(
            np.zeros(capacity), np.zeros((capacity, capacity)), np.array([POSE], dtype=np.int64)
        )
        self.arrays.mean[:POSE] = prior.mean
        self.arrays.covariance[:POSE, :POSE] = prior.covariance

    @property
    def size(self) -> int:
        """Dimension of the state, 3 + 2 L."""
        return int(self.arrays.size[0])

    @property
    def mean(self) -> Array:
        """Mean (pose, landmarks), (3 + 2 L,); a view."""
        return self.arrays.mean[: self.size]

    @property
    def covariance(self) -> Array:
        """Covariance (3 + 2 L, 3 + 2 L), additive; a full symmetric copy."""
        upper = np.triu(self.arrays.covariance[: self.size, : self.size])
        return upper + np.triu(upper, 1).T

    def block(self, offset: int, size: int) -> Array:
        """Marginal covariance of some coordinates, (size, size); a copy at the block's cost."""
        upper = np.triu(self.arrays.covariance[offset : offset + size, offset : offset + size])
        return upper + np.triu(upper, 1).T

    def reserve(self, size: int) -> None:
        """Make room for a state of the given dimension, at least doubling the storage."""
        capacity = len(self.arrays.mean)
        if size <= capacity:
            return
        capacity = max(size, 2 * capacity)
        n = self.size
        mean, covariance = np.zeros(capacity), np.zeros((capacity, capacity))
        mean[:n] = self.arrays.mean[:n]
        covariance[:n, :n] = self.arrays.covariance[:n, :n]
        self.arrays = MapArrays(mean, covariance, self.arrays.size)

    def move(self, increment: Array, covariance: Array) -> None:
        """Robot motion.

        Parameters
        ----------
        increment : (3,) ndarray
            In the frame of the pose before [m, m, rad].
        covariance : (3, 3) ndarray
            Of the increment, in that frame.
        """
        mean, P, _ = self.arrays
        kernels.move(mean, P, self.size, increment, covariance)

    def correct(self, offsets: np.ndarray, H: Array, innovation: Array, R: Array) -> float:
        """Map correction by m observations jointly.

        Parameters
        ----------
        offsets : (m,) ndarray of int
            Where the observed landmarks stand in the state.
        H : (m, 2, 5) ndarray
            Jacobians with respect to pose and landmark.
        innovation : (m, 2) ndarray
        R : (m, 2, 2) ndarray
            Noise.

        Returns
        -------
        float
            Joint squared Mahalanobis norm of the innovations.

        Raises
        ------
        EkfslamError
            If the innovation covariance is not positive definite; the map is untouched.
        """
        mean, P, _ = self.arrays
        m, n = len(offsets), self.size
        rows = np.empty((2 * m, len(mean)))
        for i, offset in enumerate(offsets):
            kernels.project(P, n, int(offset), H[i], rows[2 * i : 2 * i + 2])
        S = np.zeros((2 * m, 2 * m))
        for i, offset in enumerate(offsets):
            columns = np.r_[:POSE, offset : offset + POINT]
            S[:, 2 * i : 2 * i + 2] = rows[:, columns] @ H[i].T
            S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += R[i]
        nis = kernels.correct(mean, P, n, rows, S, innovation.reshape(-1).copy(), 2 * m)
        if np.isnan(nis):
            raise EkfslamError("the innovation covariance is not positive definite")
        return float(nis)

    def append(self, landmark: Array, wrt_pose: Array, noise: Array) -> int:
        """Landmark initialization.

        Parameters
        ----------
        landmark : (2,) ndarray
            Position in the world.
        wrt_pose : (2, 3) ndarray
            Derivative of the position with respect to the pose.
        noise : (2, 2) ndarray
            Covariance of the position given the pose.

        Returns
        -------
        int
            Offset of the landmark in the state.
        """
        n = self.size
        self.reserve(n + POINT)
        mean, P, size = self.arrays
        kernels.append(mean, P, n, landmark, np.concatenate([wrt_pose, noise], axis=1))
        size[0] = n + POINT
        return n

    def remove(self, offset: int) -> None:
        """Landmark deletion; landmarks behind it move up by two coordinates.

        Parameters
        ----------
        offset : int
            Of the landmark in the state.
        """
        n = self.size
        if not POSE <= offset <= n - POINT or (offset - POSE) % POINT:
            raise InputError(f"there is no landmark at offset {offset} of a state of {n}")
        mean, P, size = self.arrays
        kernels.remove(mean, P, n, offset, POINT)
        size[0] = n - POINT
