"""The textbook's EKF-SLAM correction in sparse NumPy: what the benchmark measures against.

``K = P H' S^-1`` on the five columns of P that H touches, ``P -= K S K'`` on the full square
(Solà, Eqs. 26 to 30), one observation after another.
"""

from __future__ import annotations

import numpy as np


class TextbookEkf:
    """Pose and N landmarks, all mapped; range and bearing.

    Parameters
    ----------
    mean : (3 + 2 N,) ndarray
    covariance : (3 + 2 N, 3 + 2 N) ndarray
    """

    def __init__(self, mean: np.ndarray, covariance: np.ndarray) -> None:
        self.mean, self.covariance = mean.copy(), covariance.copy()

    def predict(self, delta: np.ndarray, Q: np.ndarray) -> None:
        """Robot motion (Solà, Eqs. 14 to 17)."""
        x, P = self.mean, self.covariance
        c, s = np.cos(x[2]), np.sin(x[2])
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        moved = R @ delta
        F = np.array([[1.0, 0.0, -moved[1]], [0.0, 1.0, moved[0]], [0.0, 0.0, 1.0]])
        x[:3] += moved
        P[:3, 3:] = F @ P[:3, 3:]
        P[3:, :3] = P[:3, 3:].T
        P[:3, :3] = F @ P[:3, :3] @ F.T + R @ Q @ R.T

    def correct(self, landmark: int, value: np.ndarray, noise: np.ndarray) -> None:
        """Map correction by one observation (Solà, Eqs. 26 to 30)."""
        x, P = self.mean, self.covariance
        at = 3 + 2 * landmark
        columns = [0, 1, 2, at, at + 1]
        dx, dy = x[at] - x[0], x[at + 1] - x[1]
        q = dx * dx + dy * dy
        r = np.sqrt(q)
        H = np.array(
            [
                [-dx / r, -dy / r, 0.0, dx / r, dy / r],
                [dy / q, -dx / q, -1.0, -dy / q, dx / q],
            ]
        )
        z = np.array([value[0] - r, value[1] - np.arctan2(dy, dx) + x[2]])
        z[1] = (z[1] + np.pi) % (2 * np.pi) - np.pi
        PH = P[:, columns] @ H.T
        S = H @ PH[columns] + noise
        K = PH @ np.linalg.inv(S)
        x += K @ z
        P -= K @ S @ K.T
