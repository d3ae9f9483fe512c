"""A second homework filter with mistakes of its own, to see how the check does on others' work.

It corrects jointly, with whole matrices, and was written, with the list of its mistakes, without a
look at what the diagnosis knows. When it was tried first, seven of `TEN` were named and three were
found by their stage: those in `LEARNT`, which the diagnosis has had to learn since.

``python tests/seeded_again.py`` prints the table of docs/validation.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ekfslam.validation import Finding, diagnose
from ekfslam.validation.mistakes import MOUNT

TEN = {
    "sign in the motion Jacobian": "motion-jacobian-sign",
    "noise not turned": "q-not-rotated",
    "bearing not wrapped": "no-wrap",
    "no cross-covariance": "no-cross-covariance",
    "heading left out of a new landmark": "new-heading-missing",
    "sign of the landmark's part": "h-landmark-sign",
    "sigma for variance": "s-root",
    "blocks on the diagonal alone are corrected": "blocks-only",
    "gate without square": "gate-square",
    "composed after the turn": "turn-first",
}
"""Of one term of one entry, the first; and what the diagnosis is to call each."""

MORE = {"bearing row over r": "h-root-of-q", "noise forgotten": "s-forgotten"}
LEARNT = (
    "sign in the motion Jacobian",
    "blocks on the diagonal alone are corrected",
    "composed after the turn",
)


class Jointly:
    """The filter, which knows neither mounts nor another view than range and bearing."""

    kinds = ("range-bearing",)
    wrong = ""

    def __init__(self, prior: Any) -> None:
        self.mean = np.array(prior.mean, float)
        self.covariance = np.array(prior.covariance, float)
        self.ids: list[int] = []

    def predict(self, increment: Any, covariance: Any) -> None:
        x, y, t = self.mean[:3]
        dx, dy, dt = increment
        h = t + dt if self.wrong == "composed after the turn" else t
        c, s = np.cos(h), np.sin(h)
        n = len(self.mean)
        F = np.eye(n)
        F[0, 2] = -s * dx - c * dy
        F[1, 2] = c * dx - s * dy
        if self.wrong == "sign in the motion Jacobian":
            F[0, 2] = +s * dx - c * dy
        L = np.zeros((n, 3))
        L[:3] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        if self.wrong == "noise not turned":
            L[:3] = np.eye(3)
        self.mean[:3] = x + c * dx - s * dy, y + s * dx + c * dy, wrapped(t + dt)
        self.covariance = F @ self.covariance @ F.T + L @ covariance @ L.T

    def observe(self, seen: Any) -> None:
        rows = list(zip(seen.landmark.tolist(), seen.values, seen.covariance, strict=True))
        self.correct([row for row in rows if row[0] in self.ids])
        for landmark, value, R in rows:
            if landmark not in self.ids:
                self.extend(landmark, value, R)

    def correct(self, rows: list[Any]) -> None:
        models = [self.model(*row) for row in rows]
        models = [each for each in models if self.passes(*each)]
        if not models:
            return
        H, v = np.vstack([each[0] for each in models]), np.concatenate([m[1] for m in models])
        R = np.zeros((len(v), len(v)))
        for k, each in enumerate(models):
            R[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = each[2]
        if self.wrong == "noise forgotten":
            R = 1e-12 * np.eye(len(v))
        S = H @ self.covariance @ H.T + R
        K = self.covariance @ H.T @ np.linalg.inv(S)
        self.mean = self.mean + K @ v
        self.mean[2] = wrapped(self.mean[2])
        corrected = self.covariance - K @ S @ K.T
        if self.wrong == "blocks on the diagonal alone are corrected":
            for block in [slice(0, 3)] + [slice(k, k + 2) for k in range(3, len(K), 2)]:
                self.covariance[block, block] = corrected[block, block]
        else:
            self.covariance = (corrected + corrected.T) / 2

    def model(self, landmark: int, value: Any, R: Any) -> tuple[Any, Any, Any]:
        at = 3 + 2 * self.ids.index(landmark)
        dx, dy = self.mean[at : at + 2] - self.mean[:2]
        q = dx * dx + dy * dy
        r = np.sqrt(q)
        A = np.array([[dx / r, dy / r], [-dy / q, dx / q]])
        if self.wrong == "bearing row over r":
            A[1] *= r
        H = np.zeros((2, len(self.mean)))
        H[:, :2], H[1, 2] = -A, -1
        H[:, at : at + 2] = -A if self.wrong == "sign of the landmark's part" else A
        v = value - [r, np.arctan2(dy, dx) - self.mean[2]]
        if self.wrong != "bearing not wrapped":
            v[1] = wrapped(v[1])
        return H, v, np.diag(np.sqrt(np.diag(R))) if self.wrong == "sigma for variance" else R

    def passes(self, H: Any, v: Any, R: Any) -> bool:
        if self.wrong != "gate without square":
            return True
        return bool(np.sqrt(v @ np.linalg.solve(H @ self.covariance @ H.T + R, v)) < 9.21)

    def extend(self, landmark: int, value: Any, R: Any) -> None:
        t = self.mean[2] + value[1]
        c, s = np.cos(t), np.sin(t)
        G = np.array([[1, 0, -value[0] * s], [0, 1, value[0] * c]])
        if self.wrong == "heading left out of a new landmark":
            G[:, 2] = 0
        Y = np.array([[c, -value[0] * s], [s, value[0] * c]])
        n = len(self.mean)
        P = np.zeros((n + 2, n + 2))
        P[:n, :n] = self.covariance
        P[n:, n:] = G @ self.covariance[:3, :3] @ G.T + Y @ R @ Y.T
        if self.wrong != "no cross-covariance":
            P[:n, n:] = self.covariance[:, :3] @ G.T
            P[n:, :n] = P[:n, n:].T
        self.mean = np.append(self.mean, self.mean[:2] + value[0] * np.array([c, s]))
        self.covariance = P
        self.ids.append(landmark)


def wrapped(angle: Any) -> Any:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def jointly(wrong: str = "") -> type[Jointly]:
    """The filter with a mistake."""
    return type("Jointly", (Jointly,), {"wrong": wrong})


def named(found: tuple[Finding, ...]) -> str:
    """What the diagnosis calls it, besides that the filter knows no mounts."""
    of_it = [finding for finding in found if finding.stage != MOUNT]
    return ", ".join(" or ".join(each.mistakes) or f"wrong: {each.stage}" for each in of_it)


def row(wrong: str, found: tuple[Finding, ...]) -> str:
    """Its line in the table of docs/validation.md."""
    return f"| {wrong} | {'no' if wrong in LEARNT else 'yes'} | `{named(found)}` |"


if __name__ == "__main__":
    print("\n".join(row(wrong, diagnose(jointly(wrong))) for wrong in [*TEN, *MORE]))
