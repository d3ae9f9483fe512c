"""Filters and functions as estimators.

What a user brings need not know `Estimate`. A filter has ``predict(increment, covariance)`` and
``observe(observations)``, as `ekfslam.EkfSlam` has, and holds its state in attributes; a function
takes a dataset and returns poses. Here they are run over a dataset; what they hold or return is
checked and copied.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ekfslam.checks import check_finite, checked_array
from ekfslam.dataset import Dataset, Prior
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError, blamed
from ekfslam.estimates import Estimate, Linearizations, Trajectory
from ekfslam.geometry import wrap
from ekfslam.held import POSE, Held, innovation_norms, joined
from ekfslam.models.sensors import VIEWS

Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all) on long work."""


def name_of(thing: Any) -> str:
    """How an estimator is called: its `name`, or what its class or function is called."""
    name = getattr(thing, "name", None)
    if isinstance(name, str):
        return name
    if isinstance(thing, partial):
        return name_of(thing.func)
    return str(getattr(thing, "__name__", type(thing).__name__))


def is_filter(thing: Any) -> bool:
    """Whether a class or an object has ``predict`` and ``observe``."""
    return all(callable(getattr(thing, call, None)) for call in ("predict", "observe"))


def adapted(maker: Any, options: dict[str, Any]) -> FilterEstimator | FunctionEstimator | None:
    """The estimator of a class of filters, of a function that makes one, or of one of a dataset.

    Parameters
    ----------
    maker : class or callable
    options : dict
        To call it with, besides a prior or a dataset.

    Returns
    -------
    FilterEstimator, FunctionEstimator or None
        None for what is called without either: it makes an estimator, or is none.

    Raises
    ------
    InputError
        For a class of filters that asks for more.
    """
    kind, name = isinstance(maker, type), name_of(maker)
    if kind and (hasattr(maker, "estimate") or not is_filter(maker)):
        return None
    if kind or _takes_prior(maker):
        prior = {"prior": None} if _takes_prior(maker) else {}
        try:
            inspect.signature(maker).bind(**prior, **options)
        except TypeError as error:
            raise InputError(
                f"cannot make {name}: {error}; it is called with prior=, if it takes that, "
                f"and with options, as in {name}(option=value)"
            ) from None
        return FilterEstimator(maker, name, options)
    needed = [
        each
        for each in _parameters(maker)
        if each.default is each.empty
        and each.kind in (each.POSITIONAL_ONLY, each.POSITIONAL_OR_KEYWORD)
        and each.name not in options
    ]
    return FunctionEstimator(maker, name, options) if len(needed) == 1 else None


def _parameters(maker: Any) -> list[inspect.Parameter]:
    """What it is called with; nothing is known of some compiled code."""
    try:
        return list(inspect.signature(maker).parameters.values())
    except (TypeError, ValueError):
        return []


def _takes_prior(maker: Any) -> bool:
    """Whether there is a parameter `prior`; of a class, also one for whatever is named."""
    by_name = [each for each in _parameters(maker) if each.kind is not each.POSITIONAL_ONLY]
    others = isinstance(maker, type) and any(each.kind is each.VAR_KEYWORD for each in by_name)
    return others or any(each.name == "prior" for each in by_name)


@dataclass(frozen=True, eq=False)
class FilterEstimator:
    """A filter that is driven over a dataset, anew each time.

    For every entry of ``dataset.steps()`` it is told ``predict(increment, covariance)`` and
    ``observe(observations)``, also for pose 0, whose increment is zero. Then it is asked for

    - ``mean`` (3 + 2 n,), pose and points, with ``ids``, the identities of the n points, and
      ``covariance`` (3 + 2 n, 3 + 2 n), if it has that;
    - or ``pose`` (3,), and ``pose_covariance`` (3, 3), if it has that;

    and at the end, if the state has no points, for ``landmarks``: `LandmarkEstimates`, or positions
    (2,) by identity. What ``observe`` returns may be `Innovations`, one row per observation; where
    several observations correct together, ``nis`` is the squared norm of their innovations.
    Attributes ``association`` (the default is "known") and ``kinds``, the views that it can work
    with (all by default), say what it is for; ``linearizations`` may hold `Linearizations`, or
    return them when called.

    Parameters
    ----------
    source : class, callable or object
        A class, or a function with a parameter `prior`, is called for every dataset, with the prior
        of its first pose, if it takes that, and the options. An object is copied.
    name : str
    options : dict
    """

    source: Any
    name: str
    options: dict[str, Any] = field(default_factory=dict)

    def estimate(self, dataset: Dataset, progress: Progress | None = None) -> Estimate:
        """Drive the filter over a dataset.

        Parameters
        ----------
        dataset : Dataset
        progress : callable, optional
            Called with (steps done, steps in all).

        Returns
        -------
        Estimate
            Times are those of making the filter and of its calls. The NIS of a step is what the
            filter states as ``nis``, or else the sum over its observations: chi-squared if these
            correct one after another, right in the mean if they correct together.

        Raises
        ------
        InputError
            For what the filter holds or returns; names the attribute, the step, and what is
            expected.
        UnsupportedError
            For several robots, unknown identities or a view that it cannot work with.
        """
        return self._run(dataset, progress)[1]

    def linearizations(self, dataset: Dataset) -> tuple[Estimate, Linearizations]:
        """Drive the filter over a dataset; its estimate and every linear model that it used.

        Raises
        ------
        UnsupportedError
            For a filter that does not tell; otherwise as `estimate`.
        InputError
            As `estimate`.
        """
        slam, estimate = self._run(dataset, None)
        with blamed(slam):
            linear = getattr(slam, "linearizations", None)
            linear = linear() if callable(linear) else linear
        if linear is None:
            raise UnsupportedError(
                "needs an attribute linearizations of the filter that holds the Linearizations "
                "behind the estimate (ekfslam.estimates)"
            )
        if not isinstance(linear, Linearizations):
            raise InputError(
                f"{self.name}.linearizations must be Linearizations, got {type(linear).__name__}"
            )
        return estimate, linear

    def _run(self, dataset: Dataset, progress: Progress | None) -> tuple[Any, Estimate]:
        started = time.perf_counter()
        slam = self._made(dataset.prior)
        making = time.perf_counter() - started
        association = str(getattr(slam, "association", None) or "known")
        _check_suits(slam, self.name, association, dataset)
        message = _start_elsewhere(slam, self.name, dataset.prior)
        steps = dataset.poses
        poses, seconds, stated = np.empty((steps, POSE)), np.empty(steps), np.empty(steps)
        covariances, met = np.empty((steps, POSE, POSE)), []
        for k, step in enumerate(dataset.steps()):
            with blamed(slam, f"at step {k}"):
                started = time.perf_counter()
                slam.predict(step.increment, step.covariance)
                answer = slam.observe(step.observations)
                seconds[k] = time.perf_counter() - started
            held = Held(slam, self.name, k)
            met.append(held.met(answer, step.observations))
            poses[k], covariances[k] = held.pose()
            stated[k] = held.nis()
            if progress is not None and (k + 1 == steps or k % max(1, steps // 100) == 0):
                progress(k + 1, steps)
        mapped, joint = held.map()
        innovations = joined(met, self.name)
        nis, dof = (None, None)
        if innovations is not None:
            nis, dof = innovation_norms(dataset, innovations)
            nis = np.where(np.isfinite(nis) & np.isfinite(stated), stated, nis)
        return slam, Estimate(
            estimator=self.name,
            dataset=dataset.name,
            association=association,
            online=Trajectory(poses, None if np.isnan(covariances).all() else covariances),
            landmarks=mapped,
            joint_covariance=joint,
            innovations=innovations,
            step_nis=nis,
            step_dof=dof,
            step_seconds=seconds,
            time_total=making + float(seconds.sum()),
            time_marginals=0.0,
            message=message,
            options=dict(self.options),
        )

    def _made(self, prior: Prior) -> Any:
        """A filter that has seen nothing yet."""
        if is_filter(self.source) and not isinstance(self.source, type):
            try:
                return deepcopy(self.source)
            except Exception as error:
                raise InputError(
                    f"cannot copy {self.name} for a dataset of its own: {error}; give its class"
                ) from None
        known = {"prior": prior} if _takes_prior(self.source) else {}
        with blamed(self.source):
            made = self.source(**known, **self.options)
        if not is_filter(made):
            raise InputError(f"{self.name} made {made!r}, which has no predict and observe")
        return made


def _start_elsewhere(slam: Any, name: str, prior: Prior) -> str:
    """That a filter does not start where the dataset says, in words; nothing if it does."""
    try:
        start = Held(slam, name, 0).pose()[0]
    except Exception:  # it need not hold a state before its first step
        return ""
    if np.allclose(start, [*prior.mean[:2], wrap(prior.mean[2])], rtol=0, atol=1e-9):
        return ""
    here, there = (", ".join(f"{x:.3g}" for x in pose) for pose in (start, prior.mean))
    return f"starts at ({here}), not at the dataset's prior ({there}): take prior= to start there"


def _check_suits(slam: Any, name: str, association: str, dataset: Dataset) -> None:
    """Refuse a dataset that a filter is not for."""
    if association == "known" and not dataset.association_known:
        raise UnsupportedError(
            f"{name} needs known identities, which {dataset.name} does not have; a filter that "
            "finds them says so in its attribute association"
        )
    kinds = getattr(slam, "kinds", None)
    if kinds is None:
        return
    kinds = (kinds,) if isinstance(kinds, str) else tuple(kinds)
    for kind in kinds:
        if kind not in VIEWS:
            raise UnknownNameError(f"view in {name}.kinds", kind, VIEWS)
    for index in np.unique(dataset.observations.sensor).tolist():
        sensor = dataset.sensors[index]
        if sensor.kind not in kinds:
            raise UnsupportedError(
                f"{name} is for {', '.join(kinds)}, but {sensor.name} reports {sensor.kind}"
            )


@dataclass(frozen=True, eq=False)
class FunctionEstimator:
    """A function of a dataset.

    Parameters
    ----------
    function : callable
        Returns an `Estimate`, poses (K + 1, 3), or poses and covariances (K + 1, 3, 3). Poses are
        taken for online ones, each from measurements up to it: only an `Estimate` can say that they
        are smoothed.
    name : str
    options : dict
        Of the function, besides the dataset.
    """

    function: Any
    name: str
    options: dict[str, Any] = field(default_factory=dict)

    def estimate(self, dataset: Dataset) -> Estimate:
        """Call the function.

        Parameters
        ----------
        dataset : Dataset

        Raises
        ------
        InputError
            For what it returns; says what is expected.
        UnsupportedError
            For poses of one robot where there are several.
        """
        started = time.perf_counter()
        with blamed(self.function):
            answer = self.function(dataset, **self.options)
        elapsed = time.perf_counter() - started
        if isinstance(answer, Estimate):
            timed = np.isfinite(answer.time_total)
            return answer if timed else replace(answer, time_total=elapsed)
        pair = isinstance(answer, tuple) and len(answer) == 2
        poses, covariances = answer if pair else (answer, None)
        steps = dataset.poses
        if poses is None:
            raise InputError(
                f"{self.name} returned nothing: it must return an Estimate, poses ({steps}, 3), or "
                f"poses and covariances ({steps}, 3, 3)"
            )
        _ = dataset.robot
        told = f"that {self.name} returned"
        poses = np.array(checked_array(poses, float, (steps, POSE), f"poses {told}"))
        check_finite(poses, f"poses {told}")
        poses[:, 2] = wrap(poses[:, 2])
        if covariances is not None:
            shape, title = (steps, POSE, POSE), f"covariances {told}"
            covariances = checked_array(covariances, float, shape, title)
        return Estimate(
            estimator=self.name,
            dataset=dataset.name,
            online=Trajectory(poses, covariances),
            time_total=elapsed,
            time_marginals=0.0,
            options=dict(self.options),
        )
