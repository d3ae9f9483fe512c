"""Filters and functions as estimators.

What a user brings need not know `Estimate`. A filter has ``predict(increment, covariance)`` and
``observe(observations)``, as `ekfslam.EkfSlam` has, and holds its state in attributes; a function
takes a dataset and returns poses. Here they are run over a dataset; what they hold or return is
checked and copied.
"""

from __future__ import annotations

import inspect
import os
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ekfslam.checks import check_finite, checked_array
from ekfslam.dataset import Dataset, Prior, Sightings
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.estimates import (
    Decision,
    Estimate,
    Innovations,
    LandmarkEstimates,
    Linearizations,
    Trajectory,
)
from ekfslam.geometry import Array, wrap
from ekfslam.mahalanobis import squared_mahalanobis
from ekfslam.models.sensors import VIEWS

if TYPE_CHECKING:
    from ekfslam.registry import Progress

POSE, POINT = 3, 2
WITHIN = ("ekfslam", "baselines")  # whose files are not a user's


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
    (2,) by identity. What ``observe`` returns may be `Innovations`, one row per observation.
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
            Times are those of making the filter and of its calls; the NIS of a step is the sum over
            its observations, which is chi-squared if they correct one after another.

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
        steps = dataset.poses
        poses, seconds = np.empty((steps, POSE)), np.empty(steps)
        covariances: Array | None = None
        met = []
        for k, step in enumerate(dataset.steps()):
            with blamed(slam, f"at step {k}"):
                started = time.perf_counter()
                slam.predict(step.increment, step.covariance)
                answer = slam.observe(step.observations)
                seconds[k] = time.perf_counter() - started
            held = _Held(slam, self.name, k)
            met.append(held.met(answer, step.observations))
            poses[k], covariance = held.pose()
            if k == 0 and covariance is not None:
                covariances = np.full((steps, POSE, POSE), np.nan)
            if covariances is not None and covariance is not None:
                covariances[k] = covariance
            if progress is not None and (k + 1 == steps or k % max(1, steps // 100) == 0):
                progress(k + 1, steps)
        mapped, joint = held.map()
        innovations = _joined(met, self.name)
        nis, dof = (None, None) if innovations is None else _step_nis(dataset, innovations)
        return slam, Estimate(
            estimator=self.name,
            dataset=dataset.name,
            association=association,
            online=Trajectory(poses, covariances),
            landmarks=mapped,
            joint_covariance=joint,
            innovations=innovations,
            step_nis=nis,
            step_dof=dof,
            step_seconds=seconds,
            time_total=making + float(seconds.sum()),
            time_marginals=0.0,
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
class _Held:
    """What a filter holds after a step, checked and copied."""

    slam: Any
    name: str
    step: int

    def _title(self, attribute: str) -> str:
        return f"{self.name}.{attribute} at step {self.step}"

    def _has(self, attribute: str) -> bool:
        """Whether it is there; a property that fails is, and is asked again to say why."""
        try:
            return getattr(self.slam, attribute, None) is not None
        except Exception:
            return True

    def _get(self, attribute: str, shape: tuple[int | None, ...], dtype: type = float) -> Any:
        """An array of an attribute."""
        with blamed(self.slam):
            value = getattr(self.slam, attribute)
        array = np.array(checked_array(value, dtype, shape, self._title(attribute)))
        check_finite(array, self._title(attribute))
        return array

    def _mean(self) -> Array:
        mean = self._get("mean", (None,))
        if len(mean) < POSE or (len(mean) - POSE) % POINT:
            raise InputError(
                f"{self._title('mean')} must have shape (3 + 2 n,), the pose and then the n points "
                f"of the map, got {mean.shape}"
            )
        return mean

    def pose(self) -> tuple[Array, Array | None]:
        """The pose (3,), heading wrapped, and its covariance (3, 3), if there is one."""
        if self._has("mean"):
            mean = self._mean()
            pose, size, attribute = mean[:POSE], len(mean), "covariance"
        elif self._has("pose"):
            pose, size, attribute = self._get("pose", (POSE,)), POSE, "pose_covariance"
        else:
            raise InputError(
                f"{self.name} holds no state at step {self.step}: it needs an attribute mean, "
                "(3 + 2 n,), with ids, or an attribute pose, (3,)"
            )
        pose[2] = wrap(pose[2])
        if not self._has(attribute):
            return pose, None
        with blamed(self.slam):
            value = getattr(self.slam, attribute)
        # Of a large state only the corner is looked at in every step.
        shaped = isinstance(value, np.ndarray) and value.shape == (size, size)
        if not shaped:
            value = checked_array(value, float, (size, size), self._title(attribute))
        corner = checked_array(value[:POSE, :POSE], float, (POSE, POSE), self._title(attribute))
        check_finite(corner, self._title(attribute))
        return pose, corner

    def map(self) -> tuple[LandmarkEstimates | None, Array | None]:
        """The map, and the joint covariance of pose and map, as far as there are any."""
        mean = self._mean() if self._has("mean") else np.zeros(POSE)
        if len(mean) == POSE and not self._has("ids"):
            return self._landmarks(), None
        if not self._has("ids"):
            raise InputError(
                f"{self.name} has no attribute ids at step {self.step}: it needs the identities "
                "of the points in mean, in their order"
            )
        count = (len(mean) - POSE) // POINT
        ids = self._get("ids", (count,), np.int64)
        self._check_distinct(ids, "ids")
        points = mean[POSE:].reshape(count, POINT)
        if not self._has("covariance"):
            return LandmarkEstimates(ids, points), None
        joint = self._get("covariance", (len(mean), len(mean)))
        block = joint[POSE:, POSE:]
        own = np.einsum("iaib->iab", block.reshape(count, POINT, count, POINT))
        return LandmarkEstimates(ids, points, np.ascontiguousarray(own), block), joint

    def _landmarks(self) -> LandmarkEstimates | None:
        """The attribute `landmarks`."""
        if not self._has("landmarks"):
            return None
        with blamed(self.slam):
            value = self.slam.landmarks
        title = self._title("landmarks")
        if isinstance(value, Mapping):
            points = list(value.values()) or np.zeros((0, POINT))
            value = LandmarkEstimates(np.array(list(value), dtype=object), np.array(points))
        elif not isinstance(value, LandmarkEstimates):
            raise InputError(
                f"{title} must be LandmarkEstimates, or positions (2,) by identity, "
                f"got {type(value).__name__}"
            )
        ids = checked_array(value.ids, np.int64, (None,), f"identities in {title}")
        points = checked_array(value.positions, float, (len(ids), POINT), f"positions in {title}")
        check_finite(points, f"positions in {title}")
        self._check_distinct(ids, "landmarks")
        return replace(deepcopy(value), ids=ids, positions=points)

    def _check_distinct(self, ids: np.ndarray, attribute: str) -> None:
        found, count = np.unique(ids, return_counts=True)
        if (count > 1).any():
            twice = found[count > 1][0]
            raise InputError(f"{self._title(attribute)} lists landmark {twice} twice")

    def met(self, answer: Any, observations: Sightings) -> Innovations | None:
        """What `observe` returned; no rows where there is nothing to tell."""
        count = len(observations.landmark)
        if answer is None:
            return None if count else _NOTHING
        if not isinstance(answer, Innovations):
            raise InputError(
                f"{self.name}.observe must return Innovations or nothing, "
                f"got {type(answer).__name__} at step {self.step}"
            )
        shapes: dict[str, tuple[type, tuple[int, ...]]] = {
            "decision": (np.int64, (count,)),
            "landmark": (np.int64, (count,)),
            "innovation": (float, (count, 2)),
            "S": (float, (count, 2, 2)),
        }
        columns = {
            name: checked_array(
                getattr(answer, name),
                dtype,
                shape,
                f"{name} that {self.name}.observe returned at step {self.step}",
            )
            for name, (dtype, shape) in shapes.items()
        }
        if not np.isin(columns["decision"], list(Decision)).all():
            raise InputError(
                f"decision that {self.name}.observe returned at step {self.step} "
                "holds a number of no Decision"
            )
        return Innovations(**columns)


_NOTHING = Innovations(
    np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2))
)


def _joined(met: list[Innovations | None], name: str) -> Innovations | None:
    """The rows of all steps; None of a filter that does not tell."""
    told = [each for each in met if each is not None]
    if len(told) < len(met):
        if any(len(each) for each in told):
            silent = next(k for k, each in enumerate(met) if each is None)
            raise InputError(
                f"{name}.observe returned nothing at step {silent}, but Innovations at others: "
                "return them always or never"
            )
        return None
    columns = [each.name for each in fields(Innovations)]
    return Innovations(*(np.concatenate([getattr(m, column) for m in told]) for column in columns))


def _step_nis(dataset: Dataset, met: Innovations) -> tuple[Array, np.ndarray]:
    """Sum of the NIS of each step's accepted observations, NaN for none, and its rows."""
    observed = dataset.observations
    size = np.array([sensor.view.size for sensor in dataset.sensors], dtype=np.int64)
    width, nis = size[observed.sensor], np.full(len(met), np.nan)
    for d in np.unique(width):
        rows = (width == d) & (met.decision == Decision.ACCEPTED)
        nis[rows] = squared_mahalanobis(met.innovation[rows, :d], met.S[rows, :d, :d])
    counted = np.isfinite(nis)
    steps, width = observed.step[counted], width[counted]
    dof = np.bincount(steps, width, dataset.poses).astype(np.int64)
    total = np.bincount(steps, nis[counted], dataset.poses)
    return np.where(dof > 0, total, np.nan), dof


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


@contextmanager
def blamed(owner: Any, when: str = "") -> Iterator[None]:
    """What is raised inside gets a note that says where, in the files of the owner's package.

    Parameters
    ----------
    owner : class, callable or object
    when : str
        Is part of the note.
    """
    try:
        yield
    except UnsupportedError:
        raise
    except Exception as error:
        note = ", ".join(filter(None, (place(error, owner), when)))
        if note:
            error.add_note(note)
        raise


def place(error: BaseException, owner: Any) -> str:
    """File, line and function of the owner's package that an error came from, or nothing.

    Parameters
    ----------
    error : BaseException
    owner : class, callable or object
        Of this package, too: then nothing.
    """
    while isinstance(owner, partial):
        owner = owner.func
    module = getattr(owner, "__module__", None) or type(owner).__module__
    package = str(module).partition(".")[0]
    if package in WITHIN:
        return ""
    words = ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        if str(frame.f_globals.get("__name__")).partition(".")[0] == package:
            code, here = frame.f_code, os.path.join(os.getcwd(), "")
            words = f"{code.co_filename.removeprefix(here)}, line {line}, in {code.co_name}"
    return words
