"""Victoria Park: the file, the estimators on it, and the divergence that symmetry avoids."""

import gzip
import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import ekfslam
from baselines.batch import GtsamBatch
from baselines.dead_reckoning import DeadReckoning
from baselines.isam2 import GtsamIsam2
from ekfslam import geometry as geo
from ekfslam.datasets import load_recorded, victoria_park
from ekfslam.errors import FileFormatError, InputError, UnknownNameError
from ekfslam.estimates import OK
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.options import UPDATES


@cache
def park():
    return load_recorded("victoria-park")


# The file -----------------------------------------------------------------------------------------


def test_the_whole_set_is_there():
    dataset = park()
    assert dataset.poses == 6969
    assert len(dataset.observations) == 3640
    assert len(np.unique(dataset.observations.landmark)) == 151
    assert dataset.association_known
    assert dataset.truth is None
    assert dataset.sensors[0].kind == "range-bearing"
    np.testing.assert_array_equal(dataset.prior.covariance, 0)
    noise = dataset.robot.increments.covariances
    np.testing.assert_allclose(noise, np.broadcast_to(np.diag([0.01, 0.01, 1e-4]), noise.shape))
    np.testing.assert_allclose(dataset.sightings.covariance[0], np.diag([0.25, 0.0025]))


def test_noise_can_be_chosen():
    dataset = victoria_park.load(odometry_sigmas=(0.2, 0.1, 0.02), sensor_sigmas=(0.3, 0.04))
    np.testing.assert_allclose(dataset.robot.motion.covariance, np.diag([0.04, 0.01, 4e-4]))
    np.testing.assert_allclose(dataset.sensors[0].covariance, np.diag([0.09, 0.0016]))
    with pytest.raises(InputError, match="noise must be 'default' or 'file', got 'mine'"):
        victoria_park.load(noise="mine")
    with pytest.raises(InputError, match="odometry_sigmas must have shape"):
        victoria_park.load(odometry_sigmas=(0.1, 0.1))


def test_the_noise_of_the_file_is_for_x_and_y():
    plain, dataset = park(), victoria_park.load(noise="file")
    assert dataset.sensors[0].kind == "xy"
    np.testing.assert_allclose(dataset.robot.motion.covariance, np.diag([1e-4, 4e-6, 4e-6]))
    assert dataset.observations.covariance.shape == (3640, 2, 2)
    np.testing.assert_allclose(dataset.sightings.covariance[0], 0.4 * np.eye(2))
    r, b = plain.observations.values.T
    xy = np.column_stack([r * np.cos(b), r * np.sin(b)])
    np.testing.assert_allclose(dataset.observations.values, xy, rtol=0, atol=1e-12)


# A file of the same format, by hand: pose ids with gaps, a sighting before its neighbours.
ODOMETRY = "ODOMETRY {} {} 1 0.5 0.25 0.01 0.001 0.0002 0.02 0.0003 0.03\n"
SIGHTING = "LANDMARK {} {} 3 4 0.4 0.1 0.5\n"
SMALL = (
    ODOMETRY.format(0, 2)
    + SIGHTING.format(2, 1)
    + "\n"
    + ODOMETRY.format(2, 5)
    + SIGHTING.format(5, 3)
    + SIGHTING.format(2, 3)
)


@pytest.fixture
def small(tmp_path):
    """Writes a file and returns its path."""

    def write(text):
        path = tmp_path / "graph.txt"
        path.write_text(text)
        return path

    return write


def test_poses_are_numbered_in_the_order_of_travel_and_sightings_sorted(small):
    dataset = victoria_park.load(small(SMALL))
    assert dataset.times.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(dataset.robot.controls, [[1, 0.5, 0.25]] * 2)
    assert dataset.observations.step.tolist() == [1, 1, 2]
    assert dataset.observations.landmark.tolist() == [1, 3, 3]
    np.testing.assert_allclose(dataset.observations.values, [[5, np.arctan2(4, 3)]] * 3)
    given = victoria_park.load(small(SMALL), noise="file")
    np.testing.assert_array_equal(given.observations.values, [[3, 4]] * 3)
    np.testing.assert_array_equal(given.observations.covariance, [[[0.4, 0.1], [0.1, 0.5]]] * 3)
    upper = [[0.01, 0.001, 0.0002], [0.001, 0.02, 0.0003], [0.0002, 0.0003, 0.03]]
    np.testing.assert_array_equal(given.robot.motion.covariance, upper)


@pytest.mark.parametrize("noise", ["default", "file"])
def test_a_file_without_sightings_is_a_drive(small, noise):
    dataset = victoria_park.load(small(ODOMETRY.format(0, 1)), noise=noise)
    assert dataset.poses == 2
    assert len(dataset.observations) == 0


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("EDGE2 1 2 3", "unknown record 'EDGE2'"),
        ("LANDMARK 5 7 3 4 0.4 0.1", "LANDMARK needs 7 numbers, got 6"),
        ("ODOMETRY 5 6 1 0.5 0.25", "ODOMETRY needs 11 numbers, got 5"),
        ("LANDMARK 5 7 3 four 0.4 0.1 0.5", "y of LANDMARK is no number but 'four'"),
        ("LANDMARK 5 7 nan 4 0.4 0.1 0.5", "x of LANDMARK is nan"),
        ("LANDMARK 5 7 3 -inf 0.4 0.1 0.5", "y of LANDMARK is -inf"),
        ("LANDMARK 5 7.5 3 4 0.4 0.1 0.5", "ids of LANDMARK must be whole numbers"),
        ("LANDMARK -5 7 3 4 0.4 0.1 0.5", "ids of LANDMARK must be whole numbers"),
        (SIGHTING.format(6, 7), "landmark 7 is seen from pose 6, which has no odometry"),
        (ODOMETRY.format(6, 7), "the odometry chain breaks"),
        (ODOMETRY.format(5, 2), "pose 2"),  # reached twice
        (SIGHTING.format(5, 3), "landmark 3"),  # seen twice from pose 5
    ],
)
def test_a_malformed_line_is_named(small, line, said):
    path = small(SMALL + line)
    with pytest.raises(FileFormatError) as error:
        victoria_park.load(path)
    assert str(path) in str(error.value)
    assert "line 7" in str(error.value)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "line",
    [
        "ODOMETRY 5 6 1 0.5 0.25 0.01 0.001 0.0002 0.02 0.0003 0.04",  # another covariance
        "LANDMARK 5 7 3 4 0.4 0.9 0.5",  # indefinite
    ],
)
def test_a_covariance_of_the_file_that_cannot_be_used_is_named(small, line):
    path = small(SMALL + line)
    assert victoria_park.load(path).poses >= 3  # not looked at by default
    with pytest.raises(FileFormatError, match=r"line 7: .*covariance"):
        victoria_park.load(path, noise="file")


def test_a_file_that_is_none(small, tmp_path):
    for path, said in ((small(""), "is empty"), (tmp_path / "none", "no file or folder"),
                       (tmp_path, "has no victoria_park.txt")):  # fmt: skip
        with pytest.raises(FileFormatError, match=said) as error:
            victoria_park.load(path)
        assert str(path) in str(error.value)
    with pytest.raises(FileFormatError, match="holds no odometry"):
        victoria_park.load(small(SIGHTING.format(1, 2)))
    (tmp_path / "image").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(FileFormatError, match="cannot be read"):
        victoria_park.load(tmp_path / "image")


def test_recorded_sets_are_known_by_name(small):
    assert load_recorded("victoria-park", small(SMALL)).poses == 3
    with pytest.raises(UnknownNameError, match="did you mean victoria-park"):
        load_recorded("victoria-prak")


# The estimators -----------------------------------------------------------------------------------


def test_every_estimator_finishes_and_the_batch_optimum_is_one():
    dataset = park()
    filters = [Ekf(update=update).estimate(dataset) for update in UPDATES]
    isam2 = GtsamIsam2(marginals=False).estimate(dataset)
    batches = [
        GtsamBatch(start, marginals=False).estimate(dataset) for start in (filters[0], isam2)
    ]
    for estimate in (*filters, isam2, *batches, DeadReckoning().estimate(dataset)):
        assert estimate.status == OK
        assert np.isfinite(estimate.final_trajectory.poses).all()
    for estimate in filters:
        assert len(estimate.landmarks) == 151
        assert np.linalg.eigvalsh(estimate.joint_covariance).min() > 0
    errors = [batch.graph_error for batch in batches]
    assert errors[0] == pytest.approx(628.0781, abs=1e-3)
    assert errors[1] == pytest.approx(errors[0], rel=1e-6)
    assert isam2.graph_error == pytest.approx(errors[0], rel=1e-2)
    assert isam2.graph_error > errors[0]
    assert batches[0].graph_dof == 2 * 3640 - 2 * 151


def test_the_filter_finishes_on_the_noise_of_the_file():
    dataset = victoria_park.load(noise="file")
    for update in UPDATES:
        estimate = Ekf(update=update).estimate(dataset)
        assert estimate.status == OK
        assert np.isfinite(estimate.joint_covariance).all()


# Why one triangle ---------------------------------------------------------------------------------


def full_matrix_ekf(dataset, shortcut):
    """EKF-SLAM on a full covariance matrix whose two triangles may drift apart.

    Prediction copies the cross-covariances from one triangle to the other; correction is
    ``P -= K (P H')'`` (the shortcut, equal to the other only if P is symmetric) or
    ``P -= K S K'``. Returns poses, and the asymmetry of P at each step; both end where the state
    is no longer finite.
    """
    seen = dataset.sightings
    size = 3 + 2 * len(np.unique(seen.landmark))
    x, P, n = np.zeros(size), np.zeros((size, size)), 3
    offset, poses, asymmetry = {}, [], []
    for k, step in enumerate(dataset.steps()):
        F, G = geo.compose_jacobians(x[:3], step.increment)
        x[:3] = geo.compose(x[:3], step.increment)
        P[:3, :3] = F @ P[:3, :3] @ F.T + G @ step.covariance @ G.T
        P[:3, 3:n] = F @ P[:3, 3:n]
        P[3:n, :3] = P[:3, 3:n].T
        for i in range(dataset.offsets[k], dataset.offsets[k + 1]):
            (r, b), R = seen.values[i], seen.covariance[i]
            at = offset.setdefault(int(seen.landmark[i]), n)
            if at == n:
                c, s = np.cos(x[2] + b), np.sin(x[2] + b)
                x[n : n + 2] = x[0] + r * c, x[1] + r * s
                A, B = (
                    np.array([[1, 0, -r * s], [0, 1, r * c]]),
                    np.array([[c, -r * s], [s, r * c]]),
                )
                P[n : n + 2, :n] = A @ P[:3, :n]
                P[:n, n : n + 2] = P[n : n + 2, :n].T
                P[n : n + 2, n : n + 2] = A @ P[:3, :3] @ A.T + B @ R @ B.T
                n += 2
                continue
            dx, dy = x[at] - x[0], x[at + 1] - x[1]
            q = dx * dx + dy * dy
            d = np.sqrt(q)
            H = np.array(
                [[-dx / d, -dy / d, 0, dx / d, dy / d], [dy / q, -dx / q, -1, -dy / q, dx / q]]
            )
            five = [0, 1, 2, at, at + 1]
            PHt = P[:n, five] @ H.T
            S = H @ PHt[five] + R
            K = PHt @ np.linalg.inv(S)
            x[:n] += K @ [r - d, geo.wrap(b - np.arctan2(dy, dx) + x[2])]
            x[2] = geo.wrap(x[2])
            P[:n, :n] -= K @ (PHt.T if shortcut else S @ K.T)
        if not np.isfinite(x).all():
            break
        poses.append(x[:3].copy())
        asymmetry.append(np.abs(P[:n, :n] - P[:n, :n].T).max())
    return np.array(poses), np.array(asymmetry)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_shortcut_on_a_full_matrix_diverges():
    dataset = park()
    poses, asymmetry = full_matrix_ekf(dataset, shortcut=True)
    assert asymmetry[100] < 1e-13
    assert 500 < np.argmax(asymmetry > 1) < 2500  # grown from round-off
    assert len(poses) < dataset.poses or np.abs(poses[-1, :2]).max() > 1e4


def test_the_symmetric_update_runs_to_the_end():
    dataset = park()
    poses, asymmetry = full_matrix_ekf(dataset, shortcut=False)
    assert asymmetry.max() < 1e-9
    ours = Ekf(update="sequential").estimate(dataset)
    error = geo.additive_error(ours.online.poses, poses)
    np.testing.assert_allclose(error, 0, rtol=0, atol=1e-9)


@pytest.mark.skipif("EKFSLAM_DATA" not in os.environ, reason="EKFSLAM_DATA names no folder")
def test_the_published_file_is_the_one_of_the_wheel(tmp_path):
    packed = Path(os.environ["EKFSLAM_DATA"]) / "victoria_park" / "victoria_park.txt.gz"
    if not packed.exists():
        pytest.skip(f"{packed.name} is not in the data folder")
    path = tmp_path / "victoria_park.txt"
    path.write_bytes(gzip.decompress(packed.read_bytes()))
    ours, wheel = victoria_park.load(path), park()
    np.testing.assert_array_equal(ours.robot.controls, wheel.robot.controls)
    np.testing.assert_array_equal(ours.observations.values, wheel.observations.values)
    np.testing.assert_array_equal(ours.observations.landmark, wheel.observations.landmark)


def test_its_noise_can_be_stated_otherwise():
    data = ekfslam.load("victoria-park", odometry_sigmas=(0.05, 0.04, 0.003))
    np.testing.assert_allclose(np.diag(data.robot.motion.covariance) ** 0.5, [0.05, 0.04, 0.003])
    assert ekfslam.load("victoria-park", noise="file").sensors[0].kind == "xy"
    with pytest.raises(InputError, match=r"victoria-park.*nois"):
        ekfslam.load("victoria-park", nois="file")
    with pytest.raises(InputError, match="for recorded datasets"):
        ekfslam.load("park", noise="file")
