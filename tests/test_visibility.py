"""Which landmarks may be visible: against brute force, in small maps and in large ones."""

from __future__ import annotations

import numpy as np
import pytest

from ekfslam import geometry as geo
from ekfslam.dataset import Prior
from ekfslam.filters import visibility
from ekfslam.filters.arrays import Register
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.filters.variants import EKF

MOUNT = np.array([0.7, -0.3, 0.4])
VIEWS = [
    np.array([0.5, 8.0, 1.0]),
    np.array([0.0, 8.0, np.pi]),
    np.array([2.0, 30.0, 0.3]),
    np.array([0.0, np.inf, 0.5]),
]


def a_map(rng, count, heading=0.02, rays=0, robots=2):
    """A map of points far and near, some of them deleted, with its register."""
    priors = [
        Prior([*rng.uniform(-5, 5, 2), rng.uniform(-3, 3)], np.diag([0.04, 0.02, heading**2]))
        for _ in range(robots)
    ]
    slam, register = GaussianMap(priors, count), Register.of(count)
    for index in range(count):
        sigma = rng.uniform(0.01, 0.5)
        if index < rays:
            size, mean = 4, np.array([*rng.uniform(-40, 40, 2), 0.5, 0.1])
        else:
            size, mean = 2, rng.uniform(-40, 40, 2)
        noise = sigma**2 * np.eye(size)
        at = slam.append(mean, np.zeros((size, 3)), np.eye(size), noise)
        register.offsets[index], register.sizes[index] = at, size
        register.spread[index] = sigma * np.sqrt(2)
    register.used[0] = count
    gone = rng.choice(count, count // 20, replace=False)
    register.offsets[gone] = -1
    return slam, register


def brute_force(slam, register, robot, limits, noise):
    """Points within three sigmas of the view, the sensor's frame computed from geometry."""
    found = []
    P = slam.covariance
    pose = slam.mean[3 * robot : 3 * robot + 3]
    own = P[3 * robot : 3 * robot + 3, 3 * robot : 3 * robot + 3]
    for index in range(int(register.used[0])):
        at = register.offsets[index]
        if at < 0:
            continue
        if register.sizes[index] == 4:
            found.append(index)
            continue
        local = geo.to_frame(geo.compose(pose, MOUNT), slam.mean[at : at + 2])
        distance, bearing = np.hypot(*local), np.arctan2(local[1], local[0])
        variance = np.trace(P[at : at + 2, at : at + 2]) + own[0, 0] + own[1, 1]
        slack = 3 * (np.sqrt(variance + distance**2 * own[2, 2]) + noise)
        if limits[0] - slack <= distance <= limits[1] + slack and (
            distance <= slack or abs(bearing) <= limits[2] + np.arcsin(slack / distance)
        ):
            found.append(index)
    return found


@pytest.mark.parametrize("limits", VIEWS, ids=str)
@pytest.mark.parametrize("heading", [0.02, 0.2, 0.4])
@pytest.mark.parametrize(("count", "rays"), [(60, 0), (60, 9), (1100, 0), (1100, 40)])
def test_feasible_is_brute_force(count, rays, heading, limits, rng):
    """From a thousand landmarks on by a grid, of which the answer must not depend."""
    slam, register = a_map(rng, count, heading, rays)
    for robot in (0, 1):
        found = visibility.feasible(slam.arrays, register, robot, MOUNT, limits, 0.1, EKF)
        assert found.tolist() == brute_force(slam, register, robot, limits, 0.1)


def test_large_is_what_the_grid_is_for():
    assert 60 < visibility.LARGE <= 1100


def test_a_narrow_view_of_a_large_map_has_few_candidates(rng):
    slam, register = a_map(rng, 1100)
    found = visibility.feasible(slam.arrays, register, 0, MOUNT, VIEWS[0], 0.1, EKF)
    assert 0 < len(found) < 100


@pytest.mark.parametrize(
    ("distance", "bearing", "slack", "may", "surely"),
    [
        (4.0, 0.0, 0.1, True, True),
        (8.05, 0.0, 0.1, True, False),
        (8.2, 0.0, 0.1, False, False),
        (7.95, 0.0, 0.1, True, False),
        (0.45, 0.0, 0.1, True, False),
        (0.3, 0.0, 0.1, False, False),
        (4.0, 1.02, 0.1, True, False),
        (4.0, -1.02, 0.1, True, False),
        (4.0, 1.03, 0.1, False, False),
        (4.0, 0.98, 0.1, True, False),
        (4.0, 0.97, 0.1, True, True),
        (4.0, 3.0, 5.0, True, False),  # it may be anywhere
    ],
)
def test_what_may_be_seen_and_what_surely_is(distance, bearing, slack, may, surely):
    """A view from 0.5 m to 8 m and 1 rad to either side; 0.1 m at 4 m are 0.025 rad."""
    assert visibility.may_see(distance, bearing, slack, VIEWS[0]) == may
    assert visibility.surely_sees(distance, bearing, slack, VIEWS[0]) == surely
