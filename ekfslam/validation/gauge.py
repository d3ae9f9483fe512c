"""What a consistent filter shows beyond being right: it learns nothing that cannot be learnt.

Where the world is, and how it is turned, is in no sighting of landmarks. The standard EKF, which
linearises at its latest estimates, finds information on it all the same (Huang et al. 2010).

Rungs of the ladder, as `ekfslam.validation.rungs`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Innovations, Trajectory
from ekfslam.geometry import Array
from ekfslam.models.motion import MotionModel
from ekfslam.observations import Observations
from ekfslam.registry import Estimator
from ekfslam.robots import LandmarkMap, Prior
from ekfslam.validation.rungs import Measurement, estimated, refuse_samples, worst

LOOKS = 50
UNSURE = np.diag([0.2, 0.3, np.deg2rad(10.0)]) ** 2  # of where one stands
TIGHT = 1e-12 * np.eye(3)
LOOSE = np.diag([1.0, 2.0, np.deg2rad(20.0) ** 2])


def standing_still(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Look fifty times at what is new, without moving: pose and covariance must not change.

    Zhang et al. 2017, theorem 1. The robot stands where it made its first look of several
    coordinates, and is unsure of its heading by 10 degrees; changes of the pose are in metres and
    radians, those of its covariance in units of the prior.
    """
    still = _standing(dataset, seed)
    trajectory, _ = _filtered(subject, still)
    root = np.linalg.inv(np.linalg.cholesky(UNSURE))
    return worst(
        {
            "the poses": geo.additive_error(still.prior.mean, trajectory.poses),
            "the covariances (in units of the prior)": root
            @ (trajectory.covariances - UNSURE)
            @ root.T,
        }
    )


def _standing(dataset: Dataset, seed: int) -> Dataset:
    """The first full sighting of a dataset made again and again, with noise drawn anew."""
    if dataset.true_map is None or dataset.true_landmark is None:
        raise UnsupportedError("needs the truth of the map")
    full = np.array([sensor.view.size == 2 for sensor in dataset.sensors])
    seen = dataset.observations
    rows = np.flatnonzero(full[seen.sensor] & (dataset.true_landmark >= 0))
    if not len(rows):
        raise UnsupportedError("needs a sensor that sees where landmarks are")
    row = rows[0]
    sensor, robot = dataset.sensors[seen.sensor[row]], dataset.robots[seen.robot[row]]
    if robot.truth is None:
        raise UnsupportedError("needs the truth of the poses")
    here, landmark = robot.truth[seen.step[row]], dataset.true_landmark[row : row + 1]
    place = dataset.true_map.positions[dataset.true_map.ids == landmark]
    exact = sensor.observe(here, place)[0]
    random = np.random.default_rng(seed)
    noise = random.multivariate_normal(np.zeros(2), sensor.covariances(exact)[0], size=LOOKS)
    start = here + random.multivariate_normal(np.zeros(3), UNSURE)
    start[2] = geo.wrap(start[2])
    return Dataset(
        name=f"{dataset.name}, standing still",
        robots=(
            replace(
                robot,
                motion=MotionModel("odometry", covariance=np.zeros((3, 3))),
                controls=np.zeros((LOOKS - 1, 3)),
                prior=Prior(start, UNSURE),
                truth=np.tile(here, (LOOKS, 1)),
            ),
        ),
        times=np.arange(float(LOOKS)),
        sensors=(sensor,),
        observations=Observations(np.arange(LOOKS), exact + noise, np.repeat(landmark, LOOKS)),
        true_map=LandmarkMap(landmark, place),
        true_landmark=np.repeat(landmark, LOOKS),
    )


def gauge(subject: Estimator, dataset: Dataset, scenario: str, seed: int) -> Measurement:
    """Whiten the innovations under a prior of 1e-12 I and under one of (1 m, 1.4 m, 20 degrees).

    No prior of the first pose can change what is expected of the sightings: sequences that differ
    show that the filter takes them for information on where the world is.
    """
    if len(dataset.robots) > 1:
        raise UnsupportedError("needs one robot: a team has no prior of its common frame")
    white = []
    for covariance in (LOOSE, TIGHT):
        robot = replace(dataset.robot, prior=Prior(dataset.prior.mean, covariance))
        _, met = _filtered(subject, replace(dataset, robots=(robot,)))
        if not np.isfinite(met.innovation).any():
            raise UnsupportedError("needs a filter: one that tells its innovations")
        white.append(_whitened(met))
    used = [np.isfinite(each) for each in white]
    if (used[0] != used[1]).any():
        count = (used[0] != used[1]).any(axis=1).sum()
        return Measurement(float(count), "sightings that are used under one of the priors alone")
    return worst({"the whitened innovations": (white[0] - white[1])[used[0]]})


def _filtered(subject: Estimator, dataset: Dataset) -> tuple[Trajectory, Innovations]:
    """What a filter says as it goes: poses with their covariances, and innovations."""
    estimate = estimated(subject, dataset)[0]
    refuse_samples(estimate, "their spread is a sample")
    online, met = estimate.online, estimate.innovations
    if online is None or online.covariances is None or met is None:
        raise UnsupportedError("needs a filter: one with online covariances and innovations")
    return online, met


def _whitened(met: Innovations) -> Array:
    """Innovations by the Cholesky factors of their own covariances, (M, 2); NaN where none are."""
    white = np.full(met.innovation.shape, np.nan)
    for size in (1, 2):  # numbers that were reported
        rows = np.isfinite(met.innovation).sum(axis=1) == size
        factors = np.linalg.cholesky(met.S[rows][:, :size, :size])
        values = met.innovation[rows][:, :size, None]
        white[rows, :size] = np.linalg.solve(factors, values)[..., 0]
    return white


LADDER = (
    ("standing still tells nothing of the pose", 1e-9, standing_still),
    ("the prior of the pose changes no innovation", 1e-7, gauge),
)
