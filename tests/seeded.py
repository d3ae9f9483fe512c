"""A homework filter, and the mistakes that are planted in it to see whether the check names them.

`Homework` is what a student hands in: loops, one sighting after another in the order in which they
come, formulas written out. It shares no line with the package. `TEN` was drawn up before the
diagnosis was written, `MORE` with it; `EXPECTED` says what the diagnosis is to call each.

``python tests/seeded.py`` prints the table of docs/validation.md.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ekfslam.validation import Finding, diagnose

TEN = {
    "transposed-jacobian": "the block of H for positions is transposed",
    "no-cross-covariance": "a new landmark is correlated with nothing",
    "no-wrap": "the innovation of a bearing is not wrapped",
    "gate-root": "the squared distance is held against the root of the quantile",
    "noise-not-rotated": "the motion noise is added as if the robot faced along x",
    "sigma-for-variance": "R holds standard deviations",
    "motion-jacobian-sign": "the effect of the heading on the position has the wrong sign",
    "robot-only": "a correction changes the pose, and of the covariance its block alone",
    "no-wrap + no-cross-covariance": "two at once",
    "diagonal-s": "the innovation covariance is cut down to its diagonal",
}
MORE = {
    "gate-unsquared": "the distance is held against the quantile of its square",
    "certain-pose": "a new landmark has the noise of the sensor alone",
    "no-heading": "a new landmark is put along the bearing, without the heading",
    "innovation-sign": "expected minus measured",
    "no-motion-noise": "the motion adds no noise",
    "jacobian-after": "the motion's Jacobian is taken at the heading after it",
    "pose-cross-only": "a new landmark is correlated with the pose alone",
    "degrees": "turns are taken for degrees",
    "double-r": "twice the noise of the sensor",
    "no-mount": "the sensor is taken to sit in the middle of the robot",
    "stale": "all sightings of a step are compared with the state before the first of them",
    "noise-not-rotated + transposed-jacobian": "two at once",
    "motion-jacobian-sign + robot-only + no-mount": "three at once",
    "half-turned-noise": "the sensor's noise is turned by the bearing, without the heading",
    "lazy-heading": "the heading is corrected by half of what it should",
}
EXPECTED: dict[str, tuple[str, ...]] = {  # what differs from the key
    "transposed-jacobian": ("h-transposed",),
    "noise-not-rotated": ("q-not-rotated",),
    "sigma-for-variance": ("r-root",),
    "no-wrap + no-cross-covariance": ("no-cross-covariance", "no-wrap"),
    "diagonal-s": (),
    "gate-unsquared": ("gate-square",),
    "no-heading": ("new-without-heading",),
    "no-motion-noise": ("q-forgotten",),
    "pose-cross-only": ("cross-with-pose-only",),
    "degrees": ("turn-in-degrees",),
    "double-r": ("r-scaled",),
    "noise-not-rotated + transposed-jacobian": ("q-not-rotated", "h-transposed"),
    "motion-jacobian-sign + robot-only + no-mount": (
        "motion-jacobian-sign",
        "robot-only",
        "no-mount",
    ),
    "half-turned-noise": (),
    "lazy-heading": (),
}


class Homework:
    """EKF-SLAM for range-bearing and xy sensors.

    Parameters
    ----------
    prior : Prior
    mistakes : str
        Some of the keys above, between " + ".
    """

    def __init__(self, prior: Any, mistakes: str = "") -> None:
        self.wrong = set(mistakes.split(" + "))
        self.mean = np.array(prior.mean)
        self.covariance = np.array(prior.covariance)
        self.ids: list[int] = []

    def predict(self, increment: Any, covariance: Any) -> None:
        n = len(self.mean)
        ahead, aside, turn = increment
        if "degrees" in self.wrong:
            turn = turn * np.pi / 180
        th = self.mean[2]
        self.mean[0] += ahead * np.cos(th) - aside * np.sin(th)
        self.mean[1] += ahead * np.sin(th) + aside * np.cos(th)
        self.mean[2] = wrapped(th + turn)
        at = th + turn if "jacobian-after" in self.wrong else th
        F = np.eye(n)
        F[0, 2] = -ahead * np.sin(at) - aside * np.cos(at)
        F[1, 2] = ahead * np.cos(at) - aside * np.sin(at)
        if "motion-jacobian-sign" in self.wrong:
            F[:2, 2] *= -1
        V = np.array([[np.cos(th), -np.sin(th), 0], [np.sin(th), np.cos(th), 0], [0, 0, 1]])
        if "noise-not-rotated" in self.wrong:
            V = np.eye(3)
        Q = np.zeros((n, n))
        if "no-motion-noise" not in self.wrong:
            Q[:3, :3] = V @ covariance @ V.T
        self.covariance = F @ self.covariance @ F.T + Q

    def observe(self, sightings: Any) -> None:
        before = self.mean.copy()
        for i in range(len(sightings.values)):
            landmark, R = int(sightings.landmark[i]), sightings.covariance[i]
            polar, mount = sightings.kind[i] == 0, sightings.mount[i]
            if "no-mount" in self.wrong:
                mount = np.zeros(3)
            if "sigma-for-variance" in self.wrong:
                R = np.diag(np.sqrt(np.diag(R)))
            if "double-r" in self.wrong:
                R = 2 * R
            if landmark in self.ids:
                self.correct(landmark, sightings.values[i], R, polar, mount, before)
            else:
                self.extend(landmark, sightings.values[i], R, polar, mount)

    def sensor(self, mount: Any, mean: Any) -> tuple[Any, Any]:
        """Pose of the sensor in the world, and its derivative with respect to the robot's."""
        c, s = np.cos(mean[2]), np.sin(mean[2])
        a, b = c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]
        pose = np.array([mean[0] + a, mean[1] + b, mean[2] + mount[2]])
        return pose, np.array([[1, 0, -b], [0, 1, a], [0, 0, 1.0]])

    def correct(self, landmark: int, z: Any, R: Any, polar: bool, mount: Any, before: Any) -> None:
        n, j = len(self.mean), 3 + 2 * self.ids.index(landmark)
        mean = self.mean
        if "stale" in self.wrong and len(before) > j:
            mean = before
        (sx, sy, sth), D = self.sensor(mount, mean)
        dx, dy = mean[j] - sx, mean[j + 1] - sy
        q = dx * dx + dy * dy
        if polar:
            expected = np.array([np.sqrt(q), np.arctan2(dy, dx) - sth])
            block = np.array([[dx / np.sqrt(q), dy / np.sqrt(q)], [-dy / q, dx / q]])
            turn = np.array([0.0, -1.0])
        else:
            c, s = np.cos(sth), np.sin(sth)
            expected = np.array([c * dx + s * dy, -s * dx + c * dy])
            block = np.array([[c, s], [-s, c]])
            turn = np.array([-s * dx + c * dy, -c * dx - s * dy])
        if "transposed-jacobian" in self.wrong:
            block = block.T
        H = np.zeros((2, n))
        H[:, :3] = np.column_stack([-block, turn]) @ D
        H[:, j : j + 2] = block
        nu = z - expected
        if polar and "no-wrap" not in self.wrong:
            nu[1] = wrapped(nu[1])
        if "innovation-sign" in self.wrong:
            nu = -nu
        S = H @ self.covariance @ H.T + R
        d2 = nu @ np.linalg.inv(S) @ nu
        if "gate-root" in self.wrong and d2 > np.sqrt(9.2103):
            return
        if "gate-unsquared" in self.wrong and np.sqrt(d2) > 9.2103:
            return
        if "diagonal-s" in self.wrong:
            S = np.diag(np.diag(S))
        K = self.covariance @ H.T @ np.linalg.inv(S)
        change, smaller = K @ nu, (np.eye(n) - K @ H) @ self.covariance
        if "robot-only" in self.wrong:
            change[3:] = 0
            whole, smaller = smaller, self.covariance.copy()
            smaller[:3, :3] = whole[:3, :3]
        if "lazy-heading" in self.wrong:
            change[2] /= 2
        self.mean = self.mean + change
        if "no-wrap" not in self.wrong:
            self.mean[2] = wrapped(self.mean[2])
        self.covariance = (smaller + smaller.T) / 2

    def extend(self, landmark: int, z: Any, R: Any, polar: bool, mount: Any) -> None:
        n = len(self.mean)
        (sx, sy, sth), D = self.sensor(mount, self.mean)
        if "no-heading" in self.wrong:
            sth = mount[2]
        c, s = np.cos(sth), np.sin(sth)
        if polar:
            b = z[1] + sth
            dx, dy = z[0] * np.cos(b), z[0] * np.sin(b)
            if "half-turned-noise" in self.wrong:
                b = z[1]
            V = np.array([[np.cos(b), -z[0] * np.sin(b)], [np.sin(b), z[0] * np.cos(b)]])
        else:
            dx, dy = c * z[0] - s * z[1], s * z[0] + c * z[1]
            V = np.array([[c, -s], [s, c]])
        G = np.array([[1, 0, -dy], [0, 1, dx]]) @ D
        P = np.zeros((n + 2, n + 2))
        P[:n, :n] = self.covariance
        P[n:, n:] = G @ self.covariance[:3, :3] @ G.T + V @ R @ V.T
        if "certain-pose" in self.wrong:
            P[n:, n:] = V @ R @ V.T
        if "no-cross-covariance" not in self.wrong:
            cross = G @ self.covariance[:3, :]
            if "pose-cross-only" in self.wrong:
                cross[:, 3:] = 0
            P[n:, :n], P[:n, n:] = cross, cross.T
        self.covariance = P
        self.mean = np.append(self.mean, [sx + dx, sy + dy])
        self.ids.append(landmark)


def wrapped(angle: Any) -> Any:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def homework(mistakes: str = "") -> Any:
    """A class of filters, as the check takes it."""
    return partial(Homework, mistakes=mistakes)


def verdict(key: str, found: tuple[Finding, ...]) -> tuple[str, str]:
    """What the diagnosis makes of a seeded mistake: how it ends, and the names it gives."""
    names = tuple(" or ".join(finding.mistakes) for finding in found if finding.named)
    if not found:
        return "missed", ""
    if not all(finding.named for finding in found) or names != EXPECTED.get(key, (key,)):
        return "found, not named", ", ".join(finding.stage for finding in found)
    return "named", ", ".join(f"`{name}`" for name in names)


def row(key: str, found: tuple[Finding, ...]) -> str:
    """Its line in the table of docs/validation.md."""
    what = TEN.get(key) or MORE[key]
    return "| " + " | ".join([f"`{key}`", what, *verdict(key, found)]) + " |"


if __name__ == "__main__":
    for seeds in (TEN, MORE):
        print("\n".join(row(key, diagnose(homework(key))) for key in seeds), end="\n\n")
