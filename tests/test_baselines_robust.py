"""Robust losses: what they are, what they resist, and how they are asked for."""

from dataclasses import replace

import numpy as np
import pytest
from numerics import central_difference
from problems import DenseSmoother, gap, near, problem, rows_kept, scanner, stacked

from baselines.association import Association
from baselines.batch import GtsamBatch
from baselines.isam2 import GtsamIsam2
from baselines.landmark_graph import LandmarkGraph
from baselines.noise import KERNELS, Kernel
from ekfslam.errors import InputError, UnknownNameError

EAGER = {"relinearize_threshold": 1e-9, "relinearize_skip": 1, "final_updates": 200}


def loss(name, squared, scale):
    """Of a squared whitened norm."""
    norm = np.sqrt(squared)
    if name == "huber":
        return np.where(norm < scale, squared / 2, scale * (norm - scale / 2))
    if name == "cauchy":
        return scale**2 / 2 * np.log1p(squared / scale**2)
    weighted = (3 * squared - scale) * scale / (2 * (scale + squared))  # its slope is s^2 norm
    return np.where(squared < scale, squared / 2, weighted)


def objective(dataset, name, scale):
    """Robust on sightings of landmarks, quadratic on all else, as a function of the state."""
    dense = DenseSmoother(dataset)
    robots = dataset.observed_robot >= 0
    count = 2 * (~robots).sum()
    # Last come the sensor's sightings of landmarks, and then of robots.
    first = -2 * len(robots)

    def value(x):
        residuals = dense.residuals(x)
        sightings = residuals[first:][:count].reshape(-1, 2)
        plain = np.concatenate([residuals[:first], residuals[first:][count:]])
        return plain @ plain / 2 + loss(name, np.sum(sightings**2, axis=1), scale).sum()

    return value


def with_wrong_id(dataset, step=5, landmark=3, taken_for=13):
    """One sighting carries the identity of another landmark, whose own is left out."""
    at = dataset.observations.step == step
    some = rows_kept(dataset, ~(at & (dataset.observations.landmark == taken_for)))
    seen = some.observations
    wrong = (seen.step == step) & (seen.landmark == landmark)
    assert wrong.sum() == 1
    renamed = np.where(wrong, taken_for, seen.landmark)
    return replace(some, observations=replace(seen, landmark=renamed))


@pytest.mark.parametrize("scale", [None, 0.4])
@pytest.mark.parametrize("name", KERNELS)
def test_the_error_is_the_sum_of_losses_of_the_landmarks_sightings(name, scale, rng):
    dataset = problem(scanner(0.4, -0.2, 1.0), robots=2, meet=(0,))
    kernel = Kernel(name, scale)
    graphed = LandmarkGraph(dataset, Association.known(dataset), kernel=kernel)
    expected = objective(dataset, name, kernel.scale)
    for size in (0.0, 0.1, 0.5):
        there = near(dataset, rng, size)
        poses, points = there.online.poses, there.landmarks.positions
        places = dict(zip(there.landmarks.ids.tolist(), points, strict=True))
        values = graphed.values(poses, places, graphed.rows)
        x = np.concatenate([poses.ravel(), points.ravel()])
        assert graphed.graph().error(values) == pytest.approx(expected(x), rel=1e-10)


@pytest.mark.parametrize("name", KERNELS)
def test_both_smoothers_end_where_the_robust_objective_is_level(name):
    dataset = with_wrong_id(problem(scanner()))
    patient = {"relative_tolerance": 1e-15, "max_iterations": 1000}
    batch = GtsamBatch(initial=near(dataset), robust=name, **patient)
    for smoother in (batch, GtsamIsam2(robust=name, **EAGER)):
        estimate = smoother.estimate(dataset)
        kernel = Kernel(name)
        value = objective(dataset, name, kernel.scale)
        assert estimate.graph_error == pytest.approx(value(stacked(estimate)), rel=1e-9)
        slope = central_difference(value, stacked(estimate), step=1e-5)
        # In standard deviations, by which the unknowns are known: the slope that is left.
        sizes = np.concatenate(
            [
                np.sqrt(np.einsum("...ii->...i", covariances)).ravel()
                for covariances in (estimate.smoothed.covariances, estimate.landmarks.covariances)
            ]
        )
        assert np.abs(slope * sizes).max() < 1e-4


@pytest.mark.parametrize("make", ["batch", "isam2"])
@pytest.mark.parametrize("name", KERNELS)
def test_a_wrong_identity_moves_the_plain_smoother_and_hardly_a_robust_one(make, name):
    dataset = problem(scanner())
    wrong = with_wrong_id(dataset)

    def smoothed(data, **options):
        if make == "batch":
            return GtsamBatch(initial=near(data), **options).estimate(data)
        return GtsamIsam2(**EAGER, **options).estimate(data)

    best, plain = smoothed(dataset), smoothed(wrong)
    robust = smoothed(wrong, robust=name)
    assert gap(plain, best) > 0.5
    assert gap(robust, best) < 0.2 * gap(plain, best)


@pytest.mark.parametrize("name", ["huber", "cauchy", "dcs"])
def test_a_loss_that_begins_far_out_changes_nothing(name):
    dataset = problem(scanner())
    plain = GtsamBatch(initial=near(dataset)).estimate(dataset)
    wide = GtsamBatch(initial=near(dataset), robust=name, robust_scale=1e6).estimate(dataset)
    assert gap(wide, plain) < 1e-6
    assert wide.graph_error == pytest.approx(plain.graph_error, rel=1e-6)


def test_rows_say_which_loss_they_have():
    dataset = problem(scanner())
    for smoother in (
        GtsamBatch(initial=near(dataset), robust="cauchy", marginals=False),
        GtsamIsam2(robust="cauchy", marginals=False),
    ):
        estimate = smoother.estimate(dataset)
        assert "cauchy kernel of scale 2.3849 on sightings of landmarks" in estimate.message
        assert "the error is the sum of its losses" in estimate.message
        assert estimate.options["robust"] == "cauchy"
        assert estimate.options["robust_scale"] is None
        assert "kernel" not in type(smoother)().name


@pytest.mark.parametrize("smoother", [GtsamBatch, GtsamIsam2])
def test_a_loss_that_is_not_there_is_refused(smoother):
    with pytest.raises(
        UnknownNameError, match="unknown robust kernel 'hubert'; did you mean huber"
    ):
        smoother(robust="hubert")
    for scale in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(InputError, match="robust_scale must be positive and finite"):
            smoother(robust="huber", robust_scale=scale)
    with pytest.raises(InputError, match="robust_scale needs a kernel"):
        smoother(robust_scale=1.0)
