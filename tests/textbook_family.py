"""The family of EKF-SLAM filters as the papers write them, in dense NumPy: an oracle.

One robot, known association, full views; every look corrects at once, and new landmarks come in
after it. The state is x = (p, theta, l_1, ..., l_N) and every matrix is written out in full. Not
even geometry or sensor models are shared with the package, only its records.

Sources: Smith and Cheeseman 1987 (`Standard`); Bell and Cathey 1993 (`Iterated`); Huang, Mourikis
and Roumeliotis 2010 (`Ideal`, `FirstEstimates`, `ObservabilityConstrained`); Barrau and Bonnabel
2015 (`RightInvariant`); Castellanos et al. 2007 (`Robocentric`).
"""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np
from numpy.linalg import inv, norm, solve

from ekfslam.dataset import Dataset
from ekfslam.estimates import Decision, Estimate, Innovations, LandmarkEstimates, Trajectory

J = np.array([[0.0, -1.0], [1.0, 0.0]])
POSE = slice(0, 3)


# Geometry and models ----------------------------------------------------------------------------


def rotation(angle: float) -> Any:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def wrapped(angle: float) -> float:
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def arc(angle: float) -> Any:
    """V(a), which takes the tangent of SE(2) to its position."""
    if abs(angle) < 1e-4:
        s, c = 1 - angle**2 / 6, angle / 2 - angle**3 / 24
    else:
        s, c = np.sin(angle) / angle, (1 - np.cos(angle)) / angle
    return np.array([[s, -c], [c, s]])


def view(sensor: Any, y: Any) -> tuple[Any, Any]:
    """What a mounted sensor reports of a point y of the body frame, and the derivative D."""
    turn = rotation(sensor.mount[2]).T
    x1, x2 = turn @ (y - sensor.mount[:2])
    if sensor.kind == "xy":
        return np.array([x1, x2]), turn
    r = np.hypot(x1, x2)
    D = np.array([[x1 / r, x2 / r], [-x2 / r**2, x1 / r**2]])
    return np.array([r, np.arctan2(x2, x1)]), D @ turn


def back(sensor: Any, z: Any) -> tuple[Any, Any]:
    """The point of the body frame that a measurement shows, and its derivative."""
    turn = rotation(sensor.mount[2])
    if sensor.kind == "xy":
        return sensor.mount[:2] + turn @ z, turn
    r, b = z
    local = np.array([r * np.cos(b), r * np.sin(b)])
    Dz = np.array([[np.cos(b), -r * np.sin(b)], [np.sin(b), r * np.cos(b)]])
    return sensor.mount[:2] + turn @ local, turn @ Dz


def innovation(sensor: Any, z: Any, expected: Any) -> Any:
    nu = z - expected
    if sensor.kind == "range-bearing":
        nu[1] = wrapped(nu[1])
    return nu


def retracted(xi: Any, x: Any) -> Any:
    """Exp(xi) X on SE_{1+N}(2): heading, position and landmarks turn and shift together."""
    turn, V = rotation(xi[2]), arc(xi[2])
    moved = x.copy()
    moved[2] = wrapped(x[2] + xi[2])
    for at in points(len(x)):
        moved[at] = turn @ x[at] + V @ xi[at]
    return moved


def invariant_error(x: Any, estimate: Any) -> Any:
    """Log(X Xh^-1), inverse of `retracted`."""
    xi = np.empty(len(x))
    xi[2] = wrapped(x[2] - estimate[2])
    turn, V = rotation(xi[2]), arc(xi[2])
    for at in points(len(x)):
        xi[at] = solve(V, x[at] - turn @ estimate[at])
    return xi


def lever(x: Any) -> Any:
    """T, which takes right-invariant errors to additive ones, to first order."""
    T = np.eye(len(x))
    for at in points(len(x)):
        T[at, 2] = J @ x[at]
    return T


def points(size: int) -> list[slice]:
    """Where position and landmarks are in a state."""
    return [slice(0, 2)] + [slice(i, i + 2) for i in range(3, size, 2)]


# Filters ----------------------------------------------------------------------------------------


class Standard:
    """Linearised at the latest estimates; the hooks say where its variants are."""

    name = "ekf"

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        self.x = dataset.prior.mean.copy()
        self.P = dataset.prior.covariance.copy()
        self.at: dict[int, slice] = {}  # where each landmark is in the state
        self.k = 0
        self.transitions: list[Any] = []  # Phi of each step
        self.jacobians: list[list[Any]] = []  # H of each look of each step
        self.history: list[Any] = []  # additive state and covariance after each step

    # Hooks: where things are linearised

    def motion_points(self, before: Any, after: Any, seen: list[int]) -> tuple[Any, Any, float]:
        """Positions before and after the motion, and heading before it."""
        return before[:2], after[:2], before[2]

    def view_points(self, landmark: int) -> tuple[Any, float, Any]:
        """Position, heading and landmark of H."""
        return self.x[:2], self.x[2], self.x[self.at[landmark]]

    def birth_points(self, i: int, l: Any) -> tuple[Any, float, Any, Any]:
        """Position, heading, landmark and measurement of the Jacobians of a new landmark."""
        return self.x[:2], self.x[2], l, self.dataset.observations.values[i]

    # The filter

    def predict(self, delta: Any, Q: Any, seen: list[int]) -> None:
        before, after = self.x[POSE].copy(), self.x[POSE].copy()
        after[:2] += rotation(before[2]) @ delta[:2]
        after[2] = wrapped(before[2] + delta[2])
        start, end, heading = self.motion_points(before, after, seen)
        n = len(self.x)
        F, W = np.eye(n), np.zeros((n, 3))
        F[:2, 2] = J @ (end - start)
        W[:2, :2], W[2, 2] = rotation(heading), 1.0
        self.x[POSE] = after
        self.P = F @ self.P @ F.T + W @ Q @ W.T
        self.transitions.append(F)

    def expected(self, i: int) -> Any:
        """What the sensor should report, by the latest estimates."""
        sensor, landmark = self.sensor(i), self.landmark(i)
        y = rotation(self.x[2]).T @ (self.x[self.at[landmark]] - self.x[:2])
        return view(sensor, y)[0]

    def jacobian(self, i: int) -> Any:
        landmark = self.landmark(i)
        p, heading, l = self.view_points(landmark)
        C = rotation(heading).T
        D = view(self.sensor(i), C @ (l - p))[1]
        H = np.zeros((2, len(self.x)))
        H[:, :2] = -D @ C
        H[:, 2] = -D @ C @ J @ (l - p)
        H[:, self.at[landmark]] = D @ C
        return H

    def correct(self, rows: list[int]) -> tuple[Any, Any]:
        nu, H, R = self.stacked(rows)
        S = H @ self.P @ H.T + R
        K = self.P @ H.T @ inv(S)
        self.retract(K @ nu)
        self.joseph(K, H, R)
        return nu, S

    def retract(self, error: Any) -> None:
        self.x = self.x + error
        self.x[2] = wrapped(self.x[2])

    def extend(self, i: int) -> None:
        sensor, n = self.sensor(i), len(self.x)
        l = self.x[:2] + rotation(self.x[2]) @ back(sensor, self.dataset.observations.values[i])[0]
        p, heading, there, z = self.birth_points(i, l)
        A = np.zeros((2, n))
        A[:, :2] = np.eye(2)
        A[:, 2] = J @ (there - p)
        self.append(i, l, A, rotation(heading) @ back(sensor, z)[1])

    def world(self) -> tuple[Any, Any]:
        """State and covariance, additive and in the world."""
        return self.x, self.P

    # What all share

    def sensor(self, i: int) -> Any:
        return self.dataset.sensors[self.dataset.observations.sensor[i]]

    def landmark(self, i: int) -> int:
        return int(self.dataset.observations.landmark[i])

    def stacked(self, rows: list[int]) -> tuple[Any, Any, Any]:
        """Innovation, Jacobian and noise of the sightings of a look."""
        nu, R = [], np.zeros((2 * len(rows), 2 * len(rows)))
        for j, i in enumerate(rows):
            z = self.dataset.observations.values[i]
            nu.append(innovation(self.sensor(i), z, self.expected(i)))
            R[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] = self.dataset.sightings.covariance[i]
        return np.concatenate(nu), np.concatenate([self.jacobian(i) for i in rows]), R

    def joseph(self, K: Any, H: Any, R: Any) -> None:
        self.jacobians[-1].append(H)
        left = np.eye(len(self.P)) - K @ H
        self.P = left @ self.P @ left.T + K @ R @ K.T

    def append(self, i: int, l: Any, A: Any, N: Any) -> None:
        """A landmark ``l`` with the error ``A e + N v``."""
        n = len(self.x)
        self.at[self.landmark(i)] = slice(n, n + 2)
        self.x = np.concatenate([self.x, l])
        noise = N @ self.dataset.sightings.covariance[i] @ N.T
        AP = A @ self.P
        self.P = np.block([[self.P, AP.T], [AP, AP @ A.T + noise]])

    def settle(self) -> None:
        """What is left to do before anything is read or put in."""

    def run(self) -> Estimate:
        data = self.dataset
        rows, poses = len(data.observations), data.poses
        decision = np.full(rows, Decision.NEW, dtype=np.int64)
        nus, S = np.full((rows, 2), np.nan), np.full((rows, 2, 2), np.nan)
        nis, dof = np.full(poses, np.nan), np.zeros(poses, dtype=np.int64)
        for self.k in range(poses):
            here = range(data.offsets[self.k], data.offsets[self.k + 1])
            self.jacobians.append([])
            self.predict(
                data.moves.deltas[0, self.k],
                data.moves.covariances[0, self.k],
                [self.landmark(i) for i in here],
            )
            for _, look in groupby(here, data.sightings.look.item):
                look = list(look)
                known = [i for i in look if self.landmark(i) in self.at]
                if known:
                    nu, joint = self.correct(known)
                    nis[self.k] = np.nan_to_num(nis[self.k]) + nu @ solve(joint, nu)
                    dof[self.k] += len(nu)
                    for j, i in enumerate(known):
                        mine = slice(2 * j, 2 * j + 2)
                        nus[i], S[i] = nu[mine], joint[mine, mine]
                        decision[i] = Decision.ACCEPTED
                self.settle()
                for i in look:
                    if i not in known:
                        self.extend(i)
            self.settle()
            x, P = self.world()
            self.history.append((x.copy(), P))
        x, P = self.history[-1]
        ids = np.array(sorted(self.at), dtype=np.int64)
        places = [np.arange(self.at[i].start, self.at[i].stop) for i in ids.tolist()]
        order = np.concatenate([np.arange(3), *places]).astype(int)
        joint = P[np.ix_(order, order)]
        blocks = [joint[j : j + 2, j : j + 2] for j in range(3, len(joint), 2)]
        return Estimate(
            estimator=self.name,
            dataset=data.name,
            association="known",
            online=Trajectory(
                np.array([x[POSE] for x, _ in self.history]),
                np.array([P[POSE, POSE] for _, P in self.history]),
            ),
            landmarks=LandmarkEstimates(
                ids, x[order[3:]].reshape(-1, 2), np.array(blocks).reshape(-1, 2, 2), joint[3:, 3:]
            ),
            joint_covariance=joint,
            innovations=Innovations(decision, data.observations.landmark, nus, S),
            step_nis=nis,
            step_dof=dof,
        )


class Iterated(Standard):
    """Each look is corrected by Gauss and Newton; innovations are the predicted ones.

    Where the prior is wide the search is slow, or goes to and fro for ever: where it ends is part
    of the definition, and by a length, which is the same in a world that is turned.
    """

    name = "iekf"
    most, still = 20, 1e-6

    def correct(self, rows: list[int]) -> tuple[Any, Any]:
        predicted = self.x.copy()
        first: Any = None
        for _ in range(self.most):
            nu, H, R = self.stacked(rows)
            S = H @ self.P @ H.T + R
            first = (nu, S) if first is None else first
            K = self.P @ H.T @ inv(S)
            off = predicted - self.x
            off[2] = wrapped(off[2])
            step = off + K @ (nu - H @ off)
            self.retract(step)
            if norm(step) < self.still:
                break
        self.joseph(K, H, R)
        return first


class Ideal(Standard):
    """Linearised at the truth; the estimates are in the innovations alone."""

    name = "ekf-ideal"

    def true_landmark(self, landmark: int) -> Any:
        world = self.dataset.true_map
        return world.positions[world.ids.tolist().index(landmark)]

    def motion_points(self, before, after, seen):
        start, end = self.dataset.truth[max(self.k - 1, 0)], self.dataset.truth[self.k]
        return start[:2], end[:2], start[2]

    def view_points(self, landmark):
        here = self.dataset.truth[self.k]
        return here[:2], here[2], self.true_landmark(landmark)

    def birth_points(self, i, l):
        p, heading, there = self.view_points(self.landmark(i))
        return p, heading, there, view(self.sensor(i), rotation(heading).T @ (there - p))[0]


class FirstEstimates(Standard):
    """Linearised at the prediction of the pose and the first estimate of each landmark."""

    name = "ekf-fej"

    def __init__(self, dataset):
        super().__init__(dataset)
        self.pm = self.x[POSE].copy()  # prediction of the current step
        self.lf: dict[int, Any] = {}

    def motion_points(self, before, after, seen):
        start, self.pm = self.pm, after.copy()
        return start[:2], after[:2], before[2]

    def view_points(self, landmark):
        return self.pm[:2], self.pm[2], self.lf[landmark]

    def birth_points(self, i, l):
        self.lf[self.landmark(i)] = l
        return self.pm[:2], self.pm[2], l, self.dataset.observations.values[i]


class ObservabilityConstrained(FirstEstimates):
    """Linearised nearest to the latest estimates of all that keep four directions unobservable."""

    name = "ekf-oc"

    def __init__(self, dataset):
        super().__init__(dataset)
        self.delta = np.zeros(2)

    def motion_points(self, before, after, seen):
        p = before[:2]
        mapped = list(dict.fromkeys(i for i in seen if i in self.at))
        # Minimise |ps - p|^2 + sum |ls_i - l_i|^2 over ps where ls_i = ps - (pm - lf_i + delta).
        wanted = [p]
        for i in mapped:
            wanted.append(self.x[self.at[i]] + self.pm[:2] - self.lf[i] + self.delta)
        ps = np.mean(wanted, axis=0)
        self.delta = self.delta + self.pm[:2] - ps
        self.pm = after.copy()
        return ps, after[:2], before[2]

    def view_points(self, landmark):
        return self.pm[:2], self.pm[2], self.lf[landmark] - self.delta

    def birth_points(self, i, l):
        p, heading, _, z = super().birth_points(i, l)
        return p, heading, l - self.delta, z


class RightInvariant(Standard):
    """Errors are of SE_{1+N}(2), on the side of the world."""

    name = "ekf-ri"

    def __init__(self, dataset):
        super().__init__(dataset)
        back_to = inv(lever(self.x))
        self.P = back_to @ self.P @ back_to.T

    def noise_matrix(self, before, after):
        """How the noise of an increment enters, after the motion."""
        G = np.zeros((len(self.x), 3))
        G[:2, :2], G[2, 2] = rotation(before[2]), 1.0
        for at in points(len(self.x)):
            G[at, 2] = -J @ (after[at] if at.start == 0 else self.x[at])
        return G

    def predict(self, delta, Q, seen):
        before = self.x[POSE].copy()
        self.x[:2] = before[:2] + rotation(before[2]) @ delta[:2]
        self.x[2] = wrapped(before[2] + delta[2])
        G = self.noise_matrix(before, self.x[POSE])
        self.P = self.P + G @ Q @ G.T
        self.transitions.append(np.eye(len(self.x)))

    def jacobian(self, i):
        landmark, C = self.landmark(i), rotation(self.x[2]).T
        D = view(self.sensor(i), C @ (self.x[self.at[landmark]] - self.x[:2]))[1]
        H = np.zeros((2, len(self.x)))
        H[:, :2], H[:, self.at[landmark]] = -D @ C, D @ C
        return H

    def retract(self, error):
        self.x = retracted(error, self.x)

    def extend(self, i):
        z = self.dataset.observations.values[i]
        y, Dz = back(self.sensor(i), z)
        A = np.zeros((2, len(self.x)))
        A[:, :2] = np.eye(2)
        turn = rotation(self.x[2])
        self.append(i, self.x[:2] + turn @ y, A, turn @ Dz)

    def world(self):
        T = lever(self.x)
        return self.x, T @ self.P @ T.T


class Robocentric(Standard):
    """The state is in the frame of the robot: where it started, and the landmarks.

    The increment of a step is part of the state until the first look has corrected it; then it is
    composed with the rest. Later looks of the step are made from where the robot then is.
    """

    name = "ekf-robocentric"

    def __init__(self, dataset):
        super().__init__(dataset)
        self.base = self.x.copy()
        B = np.eye(3)
        B[:2, :2] = rotation(self.base[2]).T
        self.P = B @ self.P @ B.T  # an error of the base is minus one of the robot
        self.x = np.zeros(3)
        self.pending = False

    def predict(self, delta, Q, seen):
        n = len(self.x)
        self.x = np.concatenate([self.x, delta])
        self.P = np.block([[self.P, np.zeros((n, 3))], [np.zeros((3, n)), Q]])
        self.pending = True

    def increment(self):
        return self.x[-3:] if self.pending else np.zeros(3)

    def expected(self, i):
        u, q = self.increment(), self.x[self.at[self.landmark(i)]]
        return view(self.sensor(i), rotation(u[2]).T @ (q - u[:2]))[0]

    def jacobian(self, i):
        u, at = self.increment(), self.at[self.landmark(i)]
        C = rotation(u[2]).T
        y = C @ (self.x[at] - u[:2])
        D = view(self.sensor(i), y)[1]
        H = np.zeros((2, len(self.x)))
        H[:, at] = D @ C
        if self.pending:
            H[:, -3:-1], H[:, -1] = -D @ C, -D @ J @ y
        return H

    def correct(self, rows):
        nu, S = super().correct(rows)
        self.settle()
        return nu, S

    def retract(self, error):
        self.x = self.x + error

    def settle(self):
        """Compose with the increment, which leaves the state."""
        if not self.pending:
            return
        n, u = len(self.x) - 3, self.x[-3:]
        C = rotation(u[2]).T
        moved, F = self.x[:n].copy(), np.zeros((n, n + 3))
        moved[2] = wrapped(self.x[2] - u[2])
        F[2, 2], F[2, -1] = 1.0, -1.0
        for at in points(n):
            moved[at] = C @ (self.x[at] - u[:2])
            F[at, at], F[at, -3:-1], F[at, -1] = C, -C, -J @ moved[at]
        self.x, self.P, self.pending = moved, F @ self.P @ F.T, False

    def extend(self, i):
        y, Dz = back(self.sensor(i), self.dataset.observations.values[i])
        self.append(i, y, np.zeros((2, len(self.x))), Dz)

    def world(self):
        """From the base, and then to where the base is in the world."""
        n, turn = len(self.x), rotation(-self.x[2])
        local, T = np.zeros(n), np.zeros((n, n))
        local[2] = -self.x[2]
        local[:2] = -turn @ self.x[:2]
        T[:2, :2], T[:2, 2], T[2, 2] = -turn, -J @ local[:2], -1.0
        for at in points(n)[1:]:
            local[at] = local[:2] + turn @ self.x[at]
            T[at, :2], T[at, 2], T[at, at] = -turn, -J @ local[at], turn
        out, B = local.copy(), np.eye(n)
        out[2] = wrapped(local[2] + self.base[2])
        for at in points(n):
            B[at, at] = rotation(self.base[2])
            out[at] = self.base[:2] + B[at, at] @ local[at]
        return out, B @ T @ self.P @ T.T @ B.T


# By name ----------------------------------------------------------------------------------------


FAMILY = {
    kind.name: kind
    for kind in (
        Standard,
        Iterated,
        Ideal,
        FirstEstimates,
        ObservabilityConstrained,
        RightInvariant,
        Robocentric,
    )
}


class Textbook:
    """A filter of this file as an estimator."""

    def __init__(self, kind: type[Standard]) -> None:
        self.kind, self.name = kind, f"textbook-{kind.name}"

    def estimate(self, dataset: Dataset) -> Estimate:
        return self.kind(dataset).run()
