"""The map of EKF-SLAM: one Gaussian over the poses of the robots and all landmarks (Solà, 2.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ekfslam.blas import on_threads
from ekfslam.checks import check_fits
from ekfslam.dataset import Prior
from ekfslam.errors import EkfslamError, InputError
from ekfslam.filters import kernels, triangle
from ekfslam.filters.arrays import MapArrays, Points, Workspace
from ekfslam.filters.delayed import bring_up_to_date, room_for
from ekfslam.filters.measure import POINT, POSE
from ekfslam.geometry import Array

AT_ONCE = 32  # rows of a correction that there is room for to begin with
ASK_FROM = 5000  # coordinates from which memory is asked for first


def check_covariance_fits(size: int) -> None:
    """Refuse a covariance that memory cannot hold.

    Parameters
    ----------
    size : int
        Coordinates.

    Raises
    ------
    UnsupportedError
        With the size that it needs.
    """
    if size >= ASK_FROM:
        what = f"the covariance of {size // POINT} landmarks"
        check_fits(8 * size**2, what, "take fewer landmarks, or a machine with more memory")


class GaussianMap:
    """Mean and covariance in preallocated storage that doubles when it is full.

    What is allocated and not yet used takes no memory on the usual systems: the storage of a map
    whose landmarks are known ahead is what it holds, and that of one that grows has half of that
    again for a moment, while it is copied.

    Only the upper triangle of the covariance is stored and updated, so it is symmetric by
    construction. The four operations are those of Solà's Table 1, in sparse form.

    Parameters
    ----------
    priors : Prior or sequence of Prior
        Of the pose of each robot; independent of each other.
    landmarks : int
        Room to begin with, in points.
    late : int
        Rows of corrections that may wait, see `ekfslam.filters.delayed`.
    """

    def __init__(self, priors: Prior | Sequence[Prior], landmarks: int = 32, late: int = 0) -> None:
        priors = [priors] if isinstance(priors, Prior) else list(priors)
        self.robots, self.late = len(priors), late
        capacity = POSE * self.robots + POINT * max(landmarks, 1)
        check_covariance_fits(capacity)
        self.arrays = MapArrays(
            np.zeros(capacity),
            np.zeros((capacity, capacity)),
            np.array([POSE * self.robots], dtype=np.int64),
            Points.of(capacity),
            np.zeros((room_for(late, capacity), capacity)),
            np.array([0], dtype=np.int64),
            Workspace.of(AT_ONCE, capacity),
        )
        for robot, prior in enumerate(priors):
            at = slice(POSE * robot, POSE * robot + POSE)
            self.arrays.mean[at] = prior.mean
            self.arrays.covariance[at, at] = prior.covariance

    @property
    def size(self) -> int:
        """Dimension of the state."""
        return int(self.arrays.size[0])

    @property
    def mean(self) -> Array:
        """Mean (poses, landmarks), (size,); a view."""
        return self.arrays.mean[: self.size]

    @property
    def covariance(self) -> Array:
        """Covariance (size, size), additive; a full symmetric copy."""
        self.settle()
        n = self.size
        P = self.arrays.covariance[:n, :n].copy()
        triangle.rearrange(P, n, np.arange(n))
        return P

    def settle(self) -> None:
        """Bring the covariance up to date with corrections that wait."""
        with on_threads():
            bring_up_to_date(self.arrays)

    def block(self, offset: int, size: int) -> Array:
        """Marginal covariance of some coordinates, (size, size); a copy at the block's cost."""
        some = slice(offset, offset + size)
        waiting = self.arrays.late[: self.arrays.held[0], some]
        upper = np.triu(self.arrays.covariance[some, some] - waiting.T @ waiting)
        return upper + np.triu(upper, 1).T

    def surrendered(self, order: np.ndarray) -> Array:
        """Covariance of some coordinates in a given order, (m, m), in the memory of this map.

        No copy is made: what stood there is gone, and the map is of no more use.

        Parameters
        ----------
        order : (m,) ndarray of int
            Coordinates, each at most once.
        """
        self.settle()
        P, n = self.arrays.covariance, self.size
        rest = np.setdiff1d(np.arange(n), order)
        triangle.rearrange(P, n, np.concatenate([order, rest]))
        return P[: len(order), : len(order)]

    def reserve(self, size: int) -> None:
        """Make room for a state of the given dimension, at least doubling the storage."""
        capacity = len(self.arrays.mean)
        if size <= capacity:
            return
        check_covariance_fits(size)
        capacity = max(size, 2 * capacity)
        n = self.size
        mean, covariance = np.zeros(capacity), np.zeros((capacity, capacity))
        late = np.zeros((room_for(self.late, capacity), capacity))
        late[: len(self.arrays.late), :n] = self.arrays.late[:, :n]
        mean[:n] = self.arrays.mean[:n]
        triangle.copy_triangle(self.arrays.covariance, n, covariance)
        points, room = self.arrays.points, np.zeros(capacity - len(self.arrays.mean))
        points = points._replace(
            at=np.concatenate([points.at, room]), first=np.concatenate([points.first, room])
        )
        self.arrays = self.arrays._replace(
            mean=mean,
            covariance=covariance,
            points=points,
            late=late,
            workspace=Workspace.of(len(self.arrays.workspace.rows), capacity),
        )

    def widen(self, rows: int) -> None:
        """Enlarge the workspace, if need be, for a correction with so many rows."""
        if rows > len(self.arrays.workspace.rows):
            workspace = Workspace.of(rows, len(self.arrays.mean))
            self.arrays = self.arrays._replace(workspace=workspace)

    def move(self, increment: Array, covariance: Array, robot: int = 0) -> None:
        """Robot motion.

        Parameters
        ----------
        increment : (3,) ndarray
            In the frame of the pose before [m, m, rad].
        covariance : (3, 3) ndarray
            Of the increment, in that frame.
        robot : int
        """
        mean, P, *_ = self.arrays
        kernels.move(mean, P, self.size, POSE * robot, increment, covariance)

    def correct(
        self, offsets: np.ndarray, H: Array, innovation: Array, R: Array, robot: int = 0
    ) -> float:
        """Map correction by m observations from one pose jointly.

        Parameters
        ----------
        offsets : (m,) ndarray of int
            Where the observed landmarks stand in the state.
        H : (m, d, 3 + s) ndarray
            Jacobians of d values each with respect to pose and landmark of s coordinates.
        innovation : (m, d) ndarray
        R : (m, d, d) ndarray
            Noise.
        robot : int

        Returns
        -------
        float
            Joint squared Mahalanobis norm of the innovations.

        Raises
        ------
        EkfslamError
            If the innovation covariance is not positive definite; the map is untouched.
        """
        self.settle()
        mean, P, *_ = self.arrays
        n, pose = self.size, POSE * robot
        m, d, size = H.shape[0], H.shape[1], H.shape[2] - POSE
        rows = np.empty((d * m, len(mean)))
        for i, offset in enumerate(offsets):
            kernels.project(P, n, pose, int(offset), size, H[i], d, rows[d * i : d * i + d])
        S = np.zeros((d * m, d * m))
        for i, offset in enumerate(offsets):
            columns = np.r_[pose : pose + POSE, offset : offset + size]
            block = slice(d * i, d * i + d)
            S[:, block] = rows[:, columns] @ H[i].T
            S[block, block] += R[i]
        nu = innovation.reshape(-1).copy()
        nis = kernels.correct(mean, P, n, rows, S, nu, d * m, self.robots)
        if np.isnan(nis):
            raise EkfslamError("the innovation covariance is not positive definite")
        return float(nis)

    def append(
        self,
        landmark: Array,
        wrt_pose: Array,
        wrt_value: Array,
        R: Array,
        wrt_prior: Array | None = None,
        S: Array | None = None,
        robot: int = 0,
    ) -> int:
        """Landmark initialization g(R, S, y, s), with a prior s where y is partial.

        Solà, Eqs. 31 to 38 for full observations and 39 to 45 for partial ones: the covariance of
        the landmark given the pose is ``G_y R G_y' + G_s S G_s'``.

        Parameters
        ----------
        landmark : (n,) ndarray
            Its coordinates.
        wrt_pose : (n, 3) ndarray
            G_R, their derivative with respect to the pose.
        wrt_value : (n, d) ndarray
            G_y, with respect to the measurement.
        R : (d, d) ndarray
            Noise of the measurement.
        wrt_prior : (n, p) ndarray, optional
            G_s, with respect to the prior.
        S : (p, p) ndarray, optional
            Covariance of the prior.
        robot : int
            From whose pose it is seen.

        Returns
        -------
        int
            Offset of the landmark in the state.
        """
        n, size = self.size, len(landmark)
        noise = wrt_value @ R @ wrt_value.T
        if wrt_prior is not None and S is not None:
            noise = noise + wrt_prior @ S @ wrt_prior.T
        self.settle()
        self.reserve(n + size)
        mean, P, total, *_ = self.arrays
        poses = np.array([POSE * robot])
        G = np.ascontiguousarray(wrt_pose, dtype=float)[None]
        kernels.append(mean, P, n, poses, np.asarray(landmark, dtype=float), size, G, noise)
        total[0] = n + size
        return n

    def replace(self, offset: int, landmark: Array, jacobian: Array) -> None:
        """Put a function of a landmark in its place, such as a point for an inverse depth.

        Parameters
        ----------
        offset : int
            Of the landmark in the state.
        landmark : (m,) ndarray
            The new coordinates, no more than the old.
        jacobian : (m, n) ndarray
            Their derivative with respect to the old.
        """
        self.settle()
        mean, P, total, *_ = self.arrays
        new, old = jacobian.shape
        self._check(offset, old)
        kernels.replace(mean, P, self.size, offset, old, landmark, new, jacobian)
        total[0] -= old - new

    def remove(self, offset: int, size: int = POINT) -> None:
        """Landmark deletion; landmarks behind it move up.

        Parameters
        ----------
        offset : int
            Of the landmark in the state.
        size : int
            Its coordinates.
        """
        self._check(offset, size)
        self.settle()
        mean, P, total, *_ = self.arrays
        kernels.remove(mean, P, self.size, offset, size)
        total[0] -= size

    def _check(self, offset: int, size: int) -> None:
        if not POSE * self.robots <= offset <= self.size - size:
            raise InputError(
                f"there is no landmark of {size} coordinates at offset {offset} "
                f"of a state of {self.size}"
            )
