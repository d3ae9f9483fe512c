"""Ranges that wait until they determine their landmark, and are then all used at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from problems import compass, problem, rows_kept, scanner, sonar
from stepwise import slam_of

from ekfslam import EkfSlam
from ekfslam import geometry as geo
from ekfslam.dataset import LandmarkMap, Prior, Sightings
from ekfslam.estimates import Decision, Linearizations
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.engine import CLONES
from ekfslam.filters.waiting import APART, MOST
from ekfslam.models.motion import MotionModel
from ekfslam.models.sensors import Sensor
from ekfslam.observations import Observations
from ekfslam.simulation import Scenario, load_scenario, simulate
from ekfslam.validation import rungs

SENSOR = Sensor("range", [[0.01]], mount=[0.3, 0.1, 0.4])
PRIOR = Prior([1.0, -2.0, 0.5], np.diag([0.01, 0.02, 0.001]))
Q = np.array([[4e-4, 1e-4, 0], [1e-4, 2e-4, -5e-5], [0, -5e-5, 1e-4]])
NEW, ACCEPTED, REJECTED, DELAYED = (
    int(Decision[name]) for name in ("NEW", "ACCEPTED", "REJECTED", "DELAYED")
)
BAR = 1e-9


def along(*pieces, landmarks):
    """A walk of pieces (steps, way, turn) with a beacon receiver that hears everything."""
    controls = np.concatenate([np.tile([way, 0, turn], (n, 1)) for n, way, turn in pieces])
    motion = MotionModel("odometry", np.diag([1e-4, 1e-4, 1e-5]))
    positions = LandmarkMap(np.arange(len(landmarks)), landmarks)
    sensor = Sensor("range", [[0.01]])
    return simulate(Scenario("walk", positions, [0, 0, 0], controls, motion, (sensor,)), seed=2)


def seen_once(dataset, sensor, from_step):
    """Without what a sensor saw before a step."""
    seen = dataset.observations
    return rows_kept(dataset, (seen.sensor != sensor) | (seen.step >= from_step))


# A batch solution ---------------------------------------------------------------------------------


def test_the_landmark_is_that_of_one_gaussian_over_all_poses():
    """Dense: the chain of poses, ranges linearised where the filter did, no prior of the beacon.

    Where that is, the filter's search for the least squares optimum tells to some 1e-9.
    """
    beacon, delta = np.array([5.0, 1.0]), np.array([0.9, 0.1, 0.5])
    slam, truth = EkfSlam(PRIOR), PRIOR.mean
    errors, poses, F = [0.05, -0.08, 0.02, 0.06, -0.04, 0.01, 0.03], [], []
    values = []
    for error in errors:
        before = slam.pose
        slam.predict(delta, Q)
        truth = geo.compose(truth, delta)
        values.append(SENSOR.observe(truth, beacon)[0] + error)
        poses.append(slam.pose)
        F.append(geo.compose_jacobians(before, delta))
        met = slam.observe(Sightings.of(SENSOR, [values[-1]], [7]))
        if met.decision[0] == NEW:
            break
        assert met.decision.tolist() == [DELAYED]
    count, poses = len(poses), np.array(poses)
    assert count > 2
    # Covariance of all poses, from the start on.
    P, cross = PRIOR.covariance, np.zeros((3 * count, 3 * count))
    for k, (along_pose, along_motion) in enumerate(F):
        P = along_pose @ P @ along_pose.T + along_motion @ Q @ along_motion.T
        here = slice(3 * k, 3 * k + 3)
        cross[here, : 3 * k] = along_pose @ cross[3 * k - 3 : 3 * k, : 3 * k] if k else 0
        cross[: 3 * k, here] = cross[here, : 3 * k].T
        cross[here, here] = P
    # Where the filter linearised: the least squares optimum at the poses as they were known.
    point = slam.landmarks.positions[0]
    for _ in range(50):
        expected, _, wrt_point = SENSOR.observe(poses, point)
        A, b = wrt_point[:, 0], (np.array(values) - expected)[:, 0]
        point = point + np.linalg.lstsq(A, b, rcond=None)[0]
    expected, wrt_pose, wrt_point = SENSOR.observe(poses, point)
    H = np.zeros((count, 3 * count + 2))
    for k in range(count):
        H[k, 3 * k : 3 * k + 3], H[k, -2:] = wrt_pose[k, 0], wrt_point[k, 0]
    information = np.zeros((3 * count + 2, 3 * count + 2))
    information[:-2, :-2] = np.linalg.inv(cross)
    information += H.T @ H / 0.01
    covariance = np.linalg.inv(information)
    mean = covariance @ H.T @ (np.array(values) - expected)[:, 0] / 0.01
    np.testing.assert_allclose(slam.pose, poses[-1] + mean[-5:-2], rtol=0, atol=1e-8)
    np.testing.assert_allclose(slam.landmarks.positions[0], point + mean[-2:], rtol=0, atol=1e-8)
    last = slice(3 * count - 3, 3 * count + 2)
    _, joint = slam._engine.landmarks(np.array([7]))
    np.testing.assert_allclose(joint, covariance[last, last], rtol=0, atol=1e-8)


OFTEN = {"steps": 25, "turn": 0.3}
PROBLEMS = {
    "one robot": lambda: problem(sonar(), **OFTEN),
    "a mounted sonar": lambda: problem(sonar(0.7, -0.3, 1.0), **OFTEN),
    "two sonars": lambda: problem(sonar(0.7, -0.3, 1.0), sonar(-0.5, 0.0, 0.0), **OFTEN),
    "two robots": lambda: problem(sonar(0.3, 0.1, 0.0), robots=2, **OFTEN),
    "robots that meet": lambda: problem(sonar(), scanner(), robots=3, meet=(1,), steps=12),
    "a scanner later": lambda: seen_once(problem(sonar(), scanner(), **OFTEN), 1, 2),
    "a compass later": lambda: seen_once(
        problem(sonar(), replace(compass(0.2, 0.0, 0.3), min_range=0.4), **OFTEN), 1, 2
    ),
    "a compass": lambda: problem(sonar(), replace(compass(), min_range=0.4), **OFTEN),
}


@pytest.mark.parametrize("update", ["joint", "sequential"])
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_linear_oracle_agrees_whatever_else_sees_the_landmark(name, update):
    dataset = PROBLEMS[name]()
    estimate, linear = Ekf(update=update).linearizations(dataset)
    delayed = estimate.innovations.decision == DELAYED
    assert delayed.any()
    assert rungs.oracle(Ekf(update=update), dataset, name, 1).value < BAR
    # What waited is used, each once.
    observed = linear.row[linear.event == Linearizations.OBSERVED]
    assert len(np.unique(observed)) == len(observed)
    assert estimate.message == ""
    assert np.isin(np.flatnonzero(delayed), observed).all()


@pytest.mark.parametrize("name", ["a scanner later", "a compass later"])
def test_what_waited_is_not_lost_when_another_view_comes_first(name):
    """A landmark that ranges have waited for is known better than one without them."""
    dataset = PROBLEMS[name]()
    start = rows_kept(dataset, dataset.observations.step < 3)
    without = rows_kept(start, (start.observations.sensor == 1) | (start.observations.step == 2))
    waited = Ekf().estimate(start)
    assert (waited.innovations.decision == DELAYED).sum() == 15
    one, other = (np.diag(e.joint_covariance) for e in (waited, Ekf().estimate(without)))
    assert len(one) == len(other)
    assert (one < other).all()


# Until then ---------------------------------------------------------------------------------------


def test_until_then_the_filter_is_dead_reckoning_to_the_bit():
    dataset = simulate("cloister-range", seed=1)
    nothing = replace(dataset, observations=Observations([], np.zeros((0, 2))), true_landmark=None)
    estimate, blind = Ekf().estimate(dataset), Ekf().estimate(nothing)
    decision, step = estimate.innovations.decision, dataset.observations.step
    first = int(step[np.flatnonzero(decision == NEW)[0]])
    assert first > 3
    assert (decision[step < first] == DELAYED).any()
    for column in ("poses", "covariances"):
        one, other = (getattr(e.online, column) for e in (estimate, blind))
        np.testing.assert_array_equal(one[:first], other[:first])
    assert (estimate.online.poses[first] != blind.online.poses[first]).any()
    assert np.isnan(estimate.step_nis[:first]).all()


def test_a_range_from_where_the_last_one_came_does_not_wait():
    """So that a robot at rest keeps no ranges that tell nothing new."""
    slam, beacon = EkfSlam(PRIOR), np.array([5.0, 1.0])
    value = SENSOR.observe(PRIOR.mean, beacon)[0]
    look = Sightings.of(SENSOR, [value], [7])
    near, far = APART * value[0] * np.array([0.9, 1.1])
    for way, decision in ((0.0, DELAYED), (0.0, REJECTED), (near, REJECTED), (far - near, DELAYED)):
        slam.predict([way, 0.0, 0.0], np.diag([1e-6, 1e-6, 1e-8]))
        assert slam.observe(look).decision.tolist() == [decision]


def test_past_poses_leave_the_state_with_the_last_range_that_needs_them():
    few = load_scenario("cloister-range")
    few = replace(few, landmarks=LandmarkMap(few.landmarks.ids[::5], few.landmarks.positions[::5]))
    dataset = simulate(few, seed=1)
    slam, largest = slam_of(dataset), 0
    for step in dataset.steps():
        slam.predict(step.increment, step.covariance)
        slam.observe(step.observations)
        engine = slam._engine
        waiting, mapped = engine._waiting, (engine.register.offsets >= 0).sum()
        clones = np.unique(waiting.clone[waiting.row >= 0])
        assert (waiting.clones >= 0).sum() == len(clones)
        assert engine.slam.size == 3 + 2 * mapped + 3 * len(clones)
        largest = max(largest, len(clones))
    assert largest > 3
    assert len(clones) == 0
    assert engine.slam.size == 3 + 2 * len(few.landmarks)


def test_ranges_along_a_straight_line_wait_for_a_turn():
    """The beacon and its mirror image agree with all of them; after the turn it is one."""
    beacons = [[6.0, 4.0], [9.0, -5.0]]
    straight = Ekf().estimate(along((40, 0.4, 0.0), landmarks=beacons))
    assert len(straight.landmarks) == 0
    assert straight.message == "2 landmarks not determined"
    assert set(straight.innovations.decision) <= {DELAYED, REJECTED}
    turned = Ekf().estimate(along((40, 0.4, 0.0), (20, 0.4, 0.15), landmarks=beacons))
    assert turned.message == ""
    np.testing.assert_allclose(turned.landmarks.positions, beacons, atol=0.6)


def test_those_that_never_turn_do_not_grow_the_state_without_end():
    """A landmark keeps its newest ranges; past poses are bounded for all together."""
    beacons = np.column_stack([np.linspace(-50, 250, 12), np.full(12, 3.0)])
    dataset = along((600, 0.5, 0.0), landmarks=beacons)
    slam = slam_of(dataset)
    for step in dataset.steps():
        slam.predict(step.increment, step.covariance)
        slam.observe(step.observations)
        waiting = slam._engine._waiting
        index = waiting.landmark[waiting.row >= 0]
        assert np.bincount(index, minlength=1).max() <= MOST
        assert slam._engine.slam.size <= 3 + 3 * CLONES + 2 * len(beacons)
    assert np.isfinite(slam.pose_covariance).all()


def test_a_delayed_row_stands_for_its_landmark():
    dataset = simulate("cloister-range", seed=1)
    met = Ekf().estimate(dataset).innovations
    waits = np.isin(met.decision, [DELAYED, NEW, REJECTED])
    np.testing.assert_array_equal(met.landmark[waits], dataset.observations.landmark[waits])
    assert np.isnan(met.innovation[waits]).all()
    assert (np.isfinite(met.innovation[~waits, 0])).all()
    for landmark in np.unique(dataset.observations.landmark):
        decision = met.decision[dataset.observations.landmark == landmark]
        founded = np.flatnonzero(decision == NEW)
        assert len(founded) == 1
        assert (decision[founded[0] + 1 :] == ACCEPTED).all()
        assert not (decision[: founded[0]] == ACCEPTED).any()
