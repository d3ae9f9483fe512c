"""Smoothing on a known map: poses alone, landmarks held exactly where they are."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from baselines import covariances
from baselines.association import Association
from baselines.batch import GtsamBatch, ready, source_name, start_of
from baselines.isam2 import GtsamIsam2
from baselines.landmark_graph import ODOMETRY_FLOOR, LandmarkGraph
from baselines.noise import chosen
from baselines.options import check
from ekfslam.adapters import Progress
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError, UnsupportedError
from ekfslam.estimates import FAILED, Decision, Estimate

METHODS = ("batch", "isam2")

Smoother = TypeVar("Smoother", GtsamBatch, GtsamIsam2)


@dataclass(frozen=True)
class GtsamLocalization:
    """GTSAM on the graph of the poses, with the landmarks of the dataset's known map as constants.

    Landmarks are held by constraints and not by stiff priors, which would spoil the conditioning;
    the copies that sightings have of them leave a chain of poses, see `baselines.landmark_graph`.
    Sightings of landmarks that are not on the map, and of robots, are not used. An estimate has no
    landmarks, for none is estimated.

    Parameters
    ----------
    method : {"batch", "isam2"}
        Levenberg-Marquardt on all of it, which gives the smoothed series; or iSAM2 step by step,
        which gives the online series, too.
    initial : str, Estimator or Estimate
        Whose association to take where the dataset has none; and where the batch starts, which from
        dead reckoning would be no baseline.
    relative_tolerance, max_iterations
        Of the batch, see `baselines.batch.GtsamBatch`.
    relinearize_threshold, relinearize_skip, final_updates, marginal_every
        Of iSAM2, see `baselines.isam2.GtsamIsam2`.
    marginals : bool
        Whether to recover covariances.
    odometry_floor : float
        See `baselines.landmark_graph.LandmarkGraph`.
    robust : {"huber", "cauchy", "dcs"}, optional
        Loss of the sightings, see `baselines.batch.GtsamBatch`.
    robust_scale : float, optional
        Of the loss; by default the customary one.

    Raises
    ------
    UnknownNameError, InputError
        For a loss or a method that is not there, or numbers that make no sense.
    """

    method: str = "batch"
    initial: Any = "ekf-localization"
    relative_tolerance: float = 1e-10
    max_iterations: int = 100
    relinearize_threshold: float = 0.1
    relinearize_skip: int = 10
    final_updates: int = 0
    marginal_every: int = 1
    marginals: bool = True
    odometry_floor: float = ODOMETRY_FLOOR
    robust: str | None = None
    robust_scale: float | None = None
    name = "gtsam-localization"

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(f"method must be {' or '.join(METHODS)}, got {self.method!r}")
        check(self)

    def estimate(self, dataset: Dataset, progress: Progress | None = None) -> Estimate:
        """Smooth a dataset.

        Parameters
        ----------
        dataset : Dataset
        progress : callable, optional
            Called with (steps done, steps in all) by iSAM2; the batch tells nothing on its way.

        Returns
        -------
        Estimate
            With the smoothed trajectory, of iSAM2 the online one, too, and the error of the graph.
            A system that gtsam finds indeterminate gives status `failed` and names the variable.

        Raises
        ------
        UnsupportedError
            If the dataset has no known map, or no identities and the start has none of that map.
        """
        known, batch = dataset.known_map, self.method == "batch"
        if known is None:
            raise UnsupportedError(f"{dataset.name} has no known map to localize on")
        covariances.warm_up()
        asked = batch or not dataset.association_known
        source = ready(self.initial, dataset) if asked else None
        started = time.perf_counter()
        first = (
            source if source is None or isinstance(source, Estimate) else source.estimate(dataset)
        )
        association = Association.on(known, *_shown(dataset, first))
        kernel = chosen(self.robust, self.robust_scale)
        problem = LandmarkGraph(dataset, association, self.odometry_floor, kernel, held=known)
        blank = Estimate(
            self.name,
            dataset.name,
            association.name,
            options=asdict(replace(self, initial=source_name(self.initial))),
        )
        if batch:
            assert first is not None
            poses = start_of(first, dataset)
            if poses is None:
                text = f"the start, {source_name(self.initial)}, is not finite"
                return replace(blank, status=FAILED, message=text)
            rows = problem.rows.tolist()
            found = self._as(GtsamBatch).solve(problem, blank, poses, {}, rows, started)
        else:
            found = self._as(GtsamIsam2).solve(problem, blank, started, progress)
        # A landmark of the map was there before the first sighting.
        record = association.record(dict.fromkeys(known.ids.tolist(), -1))
        return replace(found, landmarks=None, innovations=record)

    def _as(self, smoother: type[Smoother]) -> Smoother:
        """The smoother of a method, with the options that it shares."""
        shared = {f.name for f in fields(smoother)} & {f.name for f in fields(self)}
        return smoother(**{name: getattr(self, name) for name in shared})


def _shown(dataset: Dataset, first: Estimate | None) -> tuple[np.ndarray, str]:
    """Identity of what each observation shows, -1 where it is not used, and who says so."""
    landmark = dataset.observations.landmark
    if first is None or first.association == "known":
        return landmark, "known"
    if first.association == "" and (dataset.association_known or (landmark >= 0).any()):
        return landmark, "known"
    if first.association == "" or first.innovations is None:
        raise UnsupportedError(f"{first.estimator} made no associations")
    if first.landmarks is not None:
        raise UnsupportedError(
            f"{first.estimator} names landmarks of a map of its own; who is seen of the known map "
            "is for one that localizes to say, such as initial=ekf-localization"
        )
    used = first.innovations.decision == Decision.ACCEPTED
    return np.where(used, first.innovations.landmark, -1), first.association
