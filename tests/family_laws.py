"""Laws of the family of EKF-SLAM filters, without statistics.

Each takes an estimator and tells by how much it breaks the law: round-off, or a mistake. Nothing is
asked but estimates, so that a law holds a textbook filter and a compiled one to the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from linear_case import known_headings, least_squares
from problems import camera, first_steps, problem, rows_kept, scanner

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.estimates import Estimate
from ekfslam.models.motion import MotionModel
from ekfslam.observations import Observations
from ekfslam.robots import LandmarkMap, Prior, Robot

TIGHT = 1e-12 * np.eye(3)
LOOSE = np.diag([1.0, 2.0, np.deg2rad(20.0) ** 2])
STANDS = np.array([1.0, -2.0, 0.7])
UNSURE = np.diag([0.04, 0.09, np.deg2rad(10.0) ** 2])
RIGID_MOTION = np.array([50.0, -30.0, 2.0])


# Problems ---------------------------------------------------------------------------------------


def gradual(dataset: Dataset) -> Dataset:
    """The landmarks come into view one after another, when the robot has moved and learnt."""
    seen = dataset.observations
    first = 2 * np.searchsorted(np.unique(seen.landmark), seen.landmark)
    return rows_kept(dataset, seen.step >= first)


def turning(*sensors: Any, steps: int = 15, seed: int = 0, **changes: Any) -> Dataset:
    """Large turns, correlated noise of moderate size, and landmarks that come in gradually."""
    sensors = sensors or (scanner(0.3, -0.2, 0.5), camera(-0.4, 0.0, 2.8))
    return gradual(problem(*sensors, steps=steps, seed=seed, **changes))


def with_prior(dataset: Dataset, covariance: Any) -> Dataset:
    robot = dataset.robot
    return replace(
        dataset, robots=(replace(robot, prior=Prior(robot.prior.mean, np.asarray(covariance))),)
    )


def standing(sensor: Any, draw: float = 1.0, looks: int = 50, seed: int = 0) -> Dataset:
    """A robot that does not move, unsure of its heading, looks at one landmark."""
    rng = np.random.default_rng(seed)
    landmarks = LandmarkMap([4], [[4.0, 1.0]])
    truth = np.tile(STANDS, (looks, 1))
    exact = sensor.observe(STANDS, landmarks.positions[0])[0]
    noise = rng.multivariate_normal(np.zeros(2), sensor.covariance, size=looks)
    start = STANDS + draw * rng.multivariate_normal(np.zeros(3), UNSURE)
    motion = MotionModel("odometry", covariance=np.zeros((3, 3)))
    robot = Robot(motion, np.zeros((looks - 1, 3)), Prior(start, UNSURE), truth)
    return Dataset(
        name="standing",
        robots=(robot,),
        times=np.arange(float(looks)),
        sensors=(sensor,),
        observations=Observations(np.arange(looks), exact + draw * noise, np.full(looks, 4)),
        true_map=landmarks,
        true_landmark=np.full(looks, 4),
    )


def whitened(estimate: Estimate) -> Any:
    """Innovations, each by the Cholesky factor of its own covariance, (M, 2); NaN if none."""
    met = estimate.innovations
    known = np.isfinite(met.innovation[:, 0])
    white = np.full(met.innovation.shape, np.nan)
    factors = np.linalg.cholesky(met.S[known])
    white[known] = np.linalg.solve(factors, met.innovation[known][..., None])[..., 0]
    return white


def by_identity(estimate: Estimate) -> tuple[Any, Any]:
    """State and joint covariance with the landmarks in the order of their identities."""
    order = np.argsort(estimate.landmarks.ids)
    rows = np.concatenate([np.arange(3), (3 + 2 * order[:, None] + np.arange(2)).ravel()])
    x = np.concatenate([estimate.online.poses[-1], estimate.landmarks.positions[order].ravel()])
    return x, estimate.joint_covariance[np.ix_(rows, rows)]


def gap(one: Estimate, other: Estimate) -> float:
    """Largest difference of poses and final map, or of covariances, relative to the largest entry:
    those of all poses and the final joint one.
    """
    (x, P), (y, Q) = by_identity(one), by_identity(other)
    poses = geo.additive_error(one.online.poses, other.online.poses)
    states = max(np.abs(poses).max(), np.abs((x - y)[3:]).max(initial=0.0))
    blocks = one.online.covariances - other.online.covariances
    scale = np.abs(other.online.covariances).max(initial=1e-300)
    joint = np.abs(P - Q).max() / max(np.abs(Q).max(), 1e-300)
    return float(max(states, np.abs(blocks).max() / scale, joint))


# Laws -------------------------------------------------------------------------------------------


def standing_still(subject: Any, sensor: Any) -> tuple[float, float]:
    """Zhang et al. 2017, theorem 1: who stands still learns nothing of where he is.

    Largest change of the pose, and of its covariance in units of the prior.
    """
    dataset = standing(sensor)
    online = subject.estimate(dataset).online
    moved = geo.additive_error(online.poses, dataset.prior.mean)
    root = np.linalg.inv(np.linalg.cholesky(UNSURE))
    return np.abs(moved).max(), np.abs(root @ (online.covariances - UNSURE) @ root.T).max()


def landmark_from_standing(subject: Any, looks: int) -> float:
    """Huang and Dissanayake 2007: after k equal looks P_LL = A P0 A' + C / k, A = [I, J (l - p)].

    Without noise, so that all are linearised at the truth for good.
    """
    sensor = scanner(0.3, -0.2, 0.5)
    dataset = standing(sensor, draw=0.0, looks=looks)
    _, A, N = sensor.locate(STANDS, dataset.observations.values[0])
    expected = A @ UNSURE @ A.T + N @ sensor.covariance @ N.T / looks
    actual = subject.estimate(dataset).landmarks.covariances[0]
    return np.abs(actual - expected).max() / np.abs(expected).max()


def gauge(subject: Any, dataset: Dataset) -> float:
    """Where the world is cannot be learnt: the prior changes no whitened innovation."""
    tight, loose = (
        whitened(subject.estimate(with_prior(dataset, prior))) for prior in (TIGHT, LOOSE)
    )
    np.testing.assert_array_equal(np.isnan(tight), np.isnan(loose))
    return float(np.nanmax(np.abs(tight - loose)))


def step_gauge(subject: Any, dataset: Dataset) -> float:
    """The same of the joint norm of all innovations of a step, relative."""
    tight, loose = (
        subject.estimate(with_prior(dataset, prior)).step_nis for prior in (TIGHT, LOOSE)
    )
    return float(np.nanmax(np.abs(tight - loose) / (1 + tight)))


def nees(dataset: Dataset, estimate: Estimate) -> Any:
    error = geo.additive_error(dataset.truth, estimate.online.poses)
    solved = np.linalg.solve(estimate.online.covariances, error[..., None])[..., 0]
    return np.sum(error * solved, axis=-1)


def rigid_transform(subject: Any, dataset: Dataset) -> tuple[float, float]:
    """Relative change of NIS and of the NEES of the pose when the world is moved."""
    moved = dataset.moved(RIGID_MOTION)
    here, there = subject.estimate(dataset), subject.estimate(moved)
    nis = np.nanmax(np.abs(there.step_nis - here.step_nis) / (1 + here.step_nis))
    before = nees(dataset, here)
    return float(nis), float(np.max(np.abs(nees(moved, there) - before) / (1 + before)))


def linear_case(subject: Any) -> float:
    """Distance to batch least squares where everything is linear."""
    dataset = known_headings()
    ids, solution, covariance = least_squares(dataset)
    estimate = subject.estimate(dataset)
    x, P = by_identity(estimate)
    last = dataset.poses - 1
    np.testing.assert_array_equal(np.sort(estimate.landmarks.ids), ids)
    known = np.delete(np.arange(len(P)), 2)
    state = np.abs(x[known].reshape(-1, 2) - solution[last:]).max()
    marginal = covariance[2 * last :, 2 * last :]
    off = np.abs(P[np.ix_(known, known)] - marginal).max() / np.abs(marginal).max()
    return float(max(state, off))


def linear_gap(subject: Any, reference: Any) -> float:
    """Distance to the standard EKF where everything is linear."""
    dataset = known_headings()
    return gap(subject.estimate(dataset), reference.estimate(dataset))


def information_grows(subject: Any, dataset: Dataset) -> float:
    """Dissanayake et al. 2001: no step adds to the covariance of the map as it was before.

    Largest eigenvalue of P_mm(after) - P_mm(before) over the steps.
    """
    worst, before, ids = -np.inf, np.zeros((0, 0)), np.zeros(0, dtype=np.int64)
    for count in range(1, dataset.poses + 1):
        estimate = subject.estimate(first_steps(dataset, count))
        _, joint = by_identity(estimate)
        now = np.sort(estimate.landmarks.ids)
        places = np.searchsorted(now, ids)
        rows = (3 + 2 * places[:, None] + np.arange(2)).ravel()
        if len(rows):
            change = joint[np.ix_(rows, rows)] - before
            worst = max(worst, float(np.linalg.eigvalsh(change).max()))
        before, ids = joint[3:, 3:], now
    return worst


def parked(looks: int, prior: Any, seed: int = 0) -> Dataset:
    """Known headings, all landmarks in view from the start, noise of all kinds."""
    motion = MotionModel("odometry", covariance=np.diag([4e-3, 2e-3, 0.0]))
    dataset = problem(camera(0.5, 0.1, 0.2), steps=looks - 1, known_start=True, seed=seed)
    robot = dataset.robot
    controls = robot.controls.copy()
    controls[:, 2] = np.diff(np.unwrap(robot.truth[:, 2]))
    robot = replace(robot, motion=motion, controls=controls, prior=Prior(robot.truth[0], prior))
    return replace(dataset, robots=(robot,))


def common_limit(subject: Any, looks: int) -> tuple[float, float, float]:
    """Dissanayake et al. 2001, in the linear case: what becomes of the map.

    Returns
    -------
    apart : float
        The covariance of the start is in the block of every pair of landmarks, as it is: largest
        relative deviation of P(prior) - P(0) from it.
    below : float
        How far a landmark gets below the covariance of the start (least eigenvalue).
    open : float
        One less the smallest correlation of two landmarks.
    """
    start = np.diag([0.1**2, 0.2**2, 0.0])
    joint = subject.estimate(parked(looks, start)).joint_covariance[3:, 3:]
    sure = subject.estimate(parked(looks, np.zeros((3, 3)))).joint_covariance[3:, 3:]
    count = len(joint) // 2
    common = np.tile(start[:2, :2], (count, count))
    blocks = [joint[j : j + 2, j : j + 2] - start[:2, :2] for j in range(0, 2 * count, 2)]
    sigma = np.sqrt(np.diag(joint))
    correlation = joint / np.outer(sigma, sigma)
    same_axis = correlation[0::2, 0::2], correlation[1::2, 1::2]
    return (
        float(np.abs(joint - sure - common).max() / common.max()),
        float(min(np.linalg.eigvalsh(block).min() for block in blocks)),
        float(1 - min(axis.min() for axis in same_axis)),
    )


def created_then_blind(steps: int = 6, known_start: bool = False) -> Dataset:
    """All landmarks are seen once, at the start; from there the robot is blind."""
    sensors = scanner(0.3, -0.2, 0.5), camera(-0.4, 0.0, 2.8)
    dataset = problem(*sensors, steps=steps, known_start=known_start)
    seen = dataset.observations
    return rows_kept(dataset, (seen.step == 0) & (seen.sensor == seen.landmark % 2))


def prediction(subject: Any, reference: Any) -> float:
    """Where nothing is corrected, all predict the same, of the map as well."""
    dataset = created_then_blind()
    return gap(subject.estimate(dataset), reference.estimate(dataset))


def autonomy(subject: Any) -> tuple[float, float]:
    """Barrau and Bonnabel 2015: a finite invariant error stays as it is, and so its covariance.

    Deviation of Log(f(X) f(Xh)^-1) from the error of the start, and relative change of the
    covariance of the pose in invariant coordinates; moves are without noise.
    """
    dataset = created_then_blind()
    robot = dataset.robot
    still = MotionModel("odometry", covariance=np.zeros((3, 3)))
    xi = np.array([0.4, -0.7, 0.9])
    runs = []
    for start in (robot.prior.mean, geo.compose(geo.exp(xi), robot.prior.mean)):
        moved = replace(robot, motion=still, prior=Prior(start, robot.prior.covariance))
        runs.append(subject.estimate(replace(dataset, robots=(moved,))).online)
    error = geo.invariant_error(runs[1].poses, runs[0].poses) - xi
    invariant = geo.additive_to_invariant(runs[0].poses, runs[0].covariances)
    return (
        float(np.abs(error).max()),
        float(np.abs(invariant - invariant[0]).max() / np.abs(invariant[0]).max()),
    )


def first_step(subject: Any, reference: Any) -> float:
    """From an exactly known start: one move, and the first landmarks."""
    dataset = problem(scanner(0.3, -0.2, 0.5), steps=1, known_start=True)
    dataset = rows_kept(dataset, dataset.observations.step == 1)
    return gap(subject.estimate(dataset), reference.estimate(dataset))


def second_step(subject: Any, reference: Any) -> float:
    """One more move, and the first correction."""
    dataset = problem(scanner(0.3, -0.2, 0.5), steps=2, known_start=True)
    dataset = rows_kept(dataset, dataset.observations.step >= 1)
    return gap(subject.estimate(dataset), reference.estimate(dataset))


def without_noise(subject: Any, reference: Any) -> float:
    """Where every estimate is the truth, all linearise there, and believe the same of it."""
    dataset = turning(noise=0.0)
    return gap(subject.estimate(dataset), reference.estimate(dataset))


# Who keeps what ---------------------------------------------------------------------------------

ALL = ("ekf", "iekf", "ekf-ideal", "ekf-fej", "ekf-oc", "ekf-ri", "ekf-robocentric")
CONSISTENT = ("ekf-ideal", "ekf-fej", "ekf-oc", "ekf-ri", "ekf-robocentric")
AT_ESTIMATES = tuple(name for name in ALL if name != "ekf-ideal")
ADDITIVE = ("ekf", "iekf", "ekf-ideal", "ekf-fej", "ekf-oc")
BODY_SENSORS = {"range-bearing": scanner(0.3, -0.2, 0.5), "xy": camera(0.3, -0.2, 0.5)}
PROBLEMS: dict[str, Callable[[], Dataset]] = {
    "two sensors": turning,
    "range-bearing": lambda: turning(scanner(), steps=25, seed=2),
    "xy": lambda: turning(camera(), steps=25, seed=3),
}


class Law(NamedTuple):
    """A law, the filters that keep it, and mistakes that break it.

    Attributes
    ----------
    measure : callable
        (subject, reference) to the deviation; the reference is a standard EKF.
    bound : float
        What round-off may come to.
    keep : tuple of str
    broken_by : tuple of str
        Filters, and those of `family_mistakes`, that break it by a hundred times the bound.
    """

    measure: Callable[[Any, Any], float]
    bound: float
    keep: tuple[str, ...]
    broken_by: tuple[str, ...]


RI_NOISE = ("RiLeverBefore", "RiHeadingAfter")
LAWS: dict[str, Law] = {}
for _kind, _sensor in BODY_SENSORS.items():
    LAWS[f"standing still, pose, {_kind}"] = Law(
        lambda subject, _, sensor=_sensor: standing_still(subject, sensor)[0],
        1e-12,
        CONSISTENT,
        ("ekf", "iekf", "OcForgetsDelta"),
    )
    # The constrained one learns of its position: its linearisation point of a pose moves while
    # the robot does not.
    LAWS[f"standing still, covariance, {_kind}"] = Law(
        lambda subject, _, sensor=_sensor: standing_still(subject, sensor)[1],
        1e-12,
        tuple(name for name in CONSISTENT if name != "ekf-oc"),
        ("ekf", "iekf", "ekf-oc", "RiKeepsPrior", "RiTells"),
    )
for _name, _make in PROBLEMS.items():
    LAWS[f"gauge, {_name}"] = Law(
        lambda subject, _, make=_make: gauge(subject, make()),
        2e-11,
        CONSISTENT,
        ("ekf", "iekf", "FejAugmentsAtUpdated", "FejMovesFromUpdated", "OcForgetsDelta"),
    )
LAWS |= {
    "gauge, joint": Law(
        lambda subject, _: step_gauge(subject, turning()),
        2e-11,
        CONSISTENT,
        ("ekf", "iekf", "FejAugmentsAtUpdated", "FejMovesFromUpdated", "OcForgetsDelta"),
    ),
    "a landmark seen once and fifty times": Law(
        lambda subject, _: max(landmark_from_standing(subject, looks) for looks in (1, 2, 50)),
        1e-12,
        ALL,
        ("RiKeepsPrior", "RiTells"),
    ),
    "NIS in a moved world": Law(
        lambda subject, _: rigid_transform(subject, turning())[0], 1e-8, ALL, ()
    ),
    "NEES in a moved world": Law(
        lambda subject, _: rigid_transform(subject, turning())[1],
        1e-8,
        ALL,
        ("RiKeepsPrior", "RiPseudo", "RiAdds", "RiTells"),
    ),
    # Least squares by normal equations leaves this much.
    "linear case, least squares": Law(
        lambda subject, _: linear_case(subject),
        1e-11,
        ALL,
        ("RiHeadingAfter", "RobocentricKeepsIncrement", "IteratesFromTheUpdated"),
    ),
    "linear case, all the same": Law(
        lambda subject, reference: linear_gap(subject, reference),
        1e-12,
        ALL,
        ("RiHeadingAfter", "RobocentricKeepsIncrement", "IteratesFromTheUpdated"),
    ),
    # Not of the others: their covariances in the world move with the estimate.
    "information grows": Law(
        lambda subject, _: information_grows(subject, turning()), 1e-12, ADDITIVE, ("ekf-ri",)
    ),
    "prediction": Law(prediction, 1e-12, AT_ESTIMATES, (*RI_NOISE, "RiKeepsPrior", "RiTells")),
    "a finite error stays": Law(lambda subject, _: autonomy(subject)[0], 1e-12, ALL, ()),
    "its covariance stays": Law(
        lambda subject, _: autonomy(subject)[1], 1e-12, AT_ESTIMATES, ("ekf-ideal", "RiTells")
    ),
    "first step": Law(first_step, 1e-12, AT_ESTIMATES, (*RI_NOISE, "RiTells")),
    "second step": Law(
        second_step,
        1e-12,
        ("ekf", "ekf-fej", "ekf-oc"),
        ("ekf-ri", "RobocentricKeepsIncrement"),
    ),
    "without noise": Law(without_noise, 1e-11, ALL, (*RI_NOISE, "RiKeepsPrior", "RiTells")),
}
CASES = [(law, name) for law, each in LAWS.items() for name in each.keep]
