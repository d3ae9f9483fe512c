"""The textbook's EKF-SLAM in NumPy, sparse and dense: what the benchmark measures against.

All landmarks are mapped already; sensors give range and bearing. The sparse forms take the columns
of P that H touches, as everyone does who writes this filter by hand, and then ``P -= K S K'`` on
the full square (Solà, Eqs. 26 to 30). They correct by one observation after another, or by all of
a step at once. The dense form has a column of H, a row and a column of F for every coordinate of
the state, and is cubic.
"""

from __future__ import annotations

import numpy as np

from ekfslam.observations import Sightings

POSE, POINT = 3, 2


class Textbook:
    """Pose and N landmarks, one observation after another on the columns that it touches.

    Parameters
    ----------
    mean : (3 + 2 N,) ndarray
        Copied, as is the covariance.
    covariance : (3 + 2 N, 3 + 2 N) ndarray
    """

    def __init__(self, mean: np.ndarray, covariance: np.ndarray) -> None:
        self.mean, self.covariance = mean.copy(), covariance.copy()

    def step(self, delta: np.ndarray, Q: np.ndarray, seen: Sightings) -> None:
        """Predict by a body increment, then correct by what is seen, landmarks in order of state.

        Parameters
        ----------
        delta : (3,) ndarray
        Q : (3, 3) ndarray
        seen : Sightings
        """
        self.predict(delta, Q)
        if len(seen.landmark):
            self.observe(seen.landmark, seen.values, seen.covariance)

    def predict(self, delta: np.ndarray, Q: np.ndarray) -> None:
        """Robot motion (Solà, Eqs. 14 to 17)."""
        P = self.covariance
        F, G = moved(self.mean, delta)
        P[:POSE, POSE:] = F @ P[:POSE, POSE:]
        P[POSE:, :POSE] = P[:POSE, POSE:].T
        P[:POSE, :POSE] = F @ P[:POSE, :POSE] @ F.T + G @ Q @ G.T

    def observe(self, landmarks: np.ndarray, values: np.ndarray, noises: np.ndarray) -> None:
        """Map correction by the observations of a step (Solà, Eqs. 26 to 30).

        Parameters
        ----------
        landmarks : (M,) ndarray of int
            Place of each in the state.
        values : (M, 2) ndarray
            Ranges and bearings [m, rad].
        noises : (M, 2, 2) ndarray
        """
        for landmark, value, noise in zip(landmarks.tolist(), values, noises, strict=True):
            at = POSE + POINT * landmark
            H, z = expected(self.mean, at, value)
            self._correct([0, 1, 2, at, at + 1], H, z, noise)

    def _correct(self, columns: list[int], H: np.ndarray, z: np.ndarray, R: np.ndarray) -> None:
        """Correct by measurements that touch some columns of P."""
        P = self.covariance
        PH = P[:, columns] @ H.T
        S = H @ PH[columns] + R
        K = PH @ np.linalg.inv(S)
        self.mean += K @ z
        P -= K @ S @ K.T


class JointTextbook(Textbook):
    """All observations of a step at once, on the columns that they touch."""

    def observe(self, landmarks: np.ndarray, values: np.ndarray, noises: np.ndarray) -> None:
        """Map correction, see `Textbook.observe`."""
        self._correct(*stacked(self.mean, landmarks, values, noises))


class DenseTextbook(JointTextbook):
    """All observations of a step at once, with dense F, H and I - K H."""

    def predict(self, delta: np.ndarray, Q: np.ndarray) -> None:
        """Robot motion, ``F P F' + G Q G'`` on the full square."""
        F, G = np.eye(len(self.mean)), np.zeros((len(self.mean), POSE))
        F[:POSE, :POSE], G[:POSE] = moved(self.mean, delta)
        self.covariance = F @ self.covariance @ F.T + G @ Q @ G.T

    def _correct(self, columns: list[int], H: np.ndarray, z: np.ndarray, R: np.ndarray) -> None:
        """Correct with an H of all columns."""
        P = self.covariance
        dense = np.zeros((len(z), len(P)))
        dense[:, columns] = H
        S = dense @ P @ dense.T + R
        K = P @ dense.T @ np.linalg.inv(S)
        self.mean += K @ z
        self.covariance = (np.eye(len(P)) - K @ dense) @ P


def moved(mean: np.ndarray, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compose the pose with a body increment, in place; Jacobians by the pose and by that."""
    c, s = np.cos(mean[2]), np.sin(mean[2])
    G = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    way = G @ delta
    mean[:POSE] += way
    return np.array([[1.0, 0.0, -way[1]], [0.0, 1.0, way[0]], [0.0, 0.0, 1.0]]), G


def expected(mean: np.ndarray, at: int, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian by pose and landmark, (2, 5), and innovation, (2,), of a range and a bearing."""
    dx, dy = mean[at] - mean[0], mean[at + 1] - mean[1]
    q = dx * dx + dy * dy
    r = np.sqrt(q)
    H = np.array(
        [
            [-dx / r, -dy / r, 0.0, dx / r, dy / r],
            [dy / q, -dx / q, -1.0, -dy / q, dx / q],
        ]
    )
    turn = value[1] - np.arctan2(dy, dx) + mean[2]
    return H, np.array([value[0] - r, (turn + np.pi) % (2 * np.pi) - np.pi])


def stacked(
    mean: np.ndarray, landmarks: np.ndarray, values: np.ndarray, noises: np.ndarray
) -> tuple[list[int], np.ndarray, np.ndarray, np.ndarray]:
    """Columns of the pose and of what is seen; Jacobian, innovation and noise of all together."""
    many = POINT * len(landmarks)
    H, z, R = np.zeros((many, POSE + many)), np.zeros(many), np.zeros((many, many))
    columns = [0, 1, 2]
    for row, landmark, value, noise in zip(
        range(0, many, POINT), landmarks.tolist(), values, noises, strict=True
    ):
        at, rows = POSE + POINT * landmark, slice(row, row + POINT)
        own, z[rows] = expected(mean, at, value)
        H[rows, :POSE], H[rows, POSE + row : POSE + row + POINT] = own[:, :POSE], own[:, POSE:]
        R[rows, rows] = noise
        columns += [at, at + 1]
    return columns, H, z, R
