"""What a user's filter holds and returns, step by step, checked and copied."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from inspect import getattr_static
from typing import Any

import numpy as np

from ekfslam.checks import check_finite, checked_array, checked_number
from ekfslam.dataset import Dataset, Sightings
from ekfslam.errors import InputError, blamed
from ekfslam.estimates import Decision, Innovations, LandmarkEstimates
from ekfslam.geometry import Array, wrap
from ekfslam.mahalanobis import squared_mahalanobis

POSE, POINT = 3, 2


@dataclass(frozen=True, eq=False)
class Held:
    """What a filter holds after a step, checked and copied."""

    slam: Any
    name: str
    step: int

    def _title(self, attribute: str) -> str:
        return f"{self.name}.{attribute} at step {self.step}"

    def _has(self, attribute: str) -> bool:
        """Whether it is there; a property that fails is, and is asked again to say why."""
        try:
            return getattr(self.slam, attribute) is not None
        except AttributeError:
            return getattr_static(self.slam, attribute, None) is not None
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

    def pose(self) -> tuple[Array, Array]:
        """The pose (3,), heading wrapped, and its covariance (3, 3), NaN if there is none."""
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
            return pose, np.full((POSE, POSE), np.nan)
        with blamed(self.slam):
            value = getattr(self.slam, attribute)
        # Of a large state only the corner is looked at in every step.
        shaped = isinstance(value, np.ndarray) and value.shape == (size, size)
        if not shaped:
            value = checked_array(value, float, (size, size), self._title(attribute))
        corner = checked_array(value[:POSE, :POSE], float, (POSE, POSE), self._title(attribute))
        check_finite(corner, self._title(attribute))
        return pose, corner

    def nis(self) -> float:
        """Joint squared norm of the innovations of the step, NaN if it is not stated."""
        if not self._has("nis"):
            return float("nan")
        with blamed(self.slam):
            value = self.slam.nis
        return checked_number(value, self._title("nis"))

    def map(self) -> tuple[LandmarkEstimates | None, Array | None]:
        """The map, and the joint covariance of pose and map, as far as there are any."""
        if not self._has("mean"):  # ids are those of the points in mean
            return self._landmarks(), None
        mean = self._mean()
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
            names: Any = list(value)
            places: Any = list(value.values()) or np.zeros((0, POINT))
        elif isinstance(value, LandmarkEstimates):
            names, places = value.ids, value.positions
        else:
            raise InputError(
                f"{title} must be LandmarkEstimates, or positions (2,) by identity, "
                f"got {type(value).__name__}"
            )
        ids = checked_array(names, np.int64, (None,), f"identities in {title}")
        points = checked_array(places, float, (len(ids), POINT), f"positions in {title}")
        check_finite(points, f"positions in {title}")
        self._check_distinct(ids, "landmarks")
        if isinstance(value, LandmarkEstimates):
            return replace(deepcopy(value), ids=ids, positions=points)
        return LandmarkEstimates(ids, points)

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


def joined(met: list[Innovations | None], name: str) -> Innovations | None:
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


def innovation_norms(dataset: Dataset, met: Innovations) -> tuple[Array, np.ndarray]:
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
