"""Motion models as increments of SE(2): ``pose' = pose * delta(u)``.

A model says what body increment ``delta`` a control ``u`` commands, with ``d delta / d u``. All of
it is vectorised over a run: increments and their covariances do not depend on the state.

==================== ============== ========= =================================================
kind                 control        needs     source
==================== ============== ========= =================================================
odometry             dh, dl, dtheta           Ciatto, Eq. 2.2 (Solà, Eqs. 58 to 60)
advance-turn         dx, dalpha               Solà, C.2.1 (turn after the advance)
velocity             v, omega, dt             "Extended Kalman Filter SLAM", 3.4; exact arc
velocity-euler       v, omega, dt             its Euler step
wheel-speeds         vl, vr, dt     width     Ciatto, A.5; exact arc
wheel-speeds-euler   vl, vr, dt     width     Ciatto, Eq. 2.1
wheel-increments     l, r           width     notes on Brenner's lectures; exact arc
car                  V, gamma, dt   wheelbase Bailey et al. 2006
none                                          Solà, 1.4.1 (the control may be void)
==================== ============== ========= =================================================

Lengths in m, speeds in m/s, angles in rad, times in s. ``width`` is the distance between the
wheels: 2L of Ciatto, W of the notes on Brenner's lectures. A ``dt`` is exact; the others are noisy.
``none`` is a sensor in somebody's hand: the increment is zero and its noise is the perturbation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ekfslam.checks import checked_array, checked_covariance, checked_number
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.geometry import Array, arc_coefficient_derivatives, arc_coefficients, congruence
from ekfslam.models.mixture import Components, Mixture, checked_mixture, mixture_of


class Increments(NamedTuple):
    """Body increments of a run and their uncertainty, in the frame of the first pose.

    Attributes
    ----------
    deltas : (K, 3) ndarray
        Increment from pose k to pose k + 1 [m, m, rad].
    covariances : (K, 3, 3) ndarray
        ``J Sigma_u J'`` plus lateral slip.
    """

    deltas: Array
    covariances: Array


def _matrices(rows: list[list[Any]], count: int) -> Array:
    """Stack rows of scalars and (K,) arrays into (K, m, n)."""
    return np.stack(
        [np.stack([np.broadcast_to(x, count) for x in row], axis=-1) for row in rows], axis=-2
    ).astype(float)


def _arc(distance: Array, turn: Array) -> tuple[Array, Array]:
    """Chord of a constant turn: delta(d, a) = (s(a) d, c(a) d, a), with its Jacobian (K, 3, 2)."""
    s, c = arc_coefficients(turn)
    ds, dc = arc_coefficient_derivatives(turn)
    delta = np.column_stack([s * distance, c * distance, turn])
    return delta, _matrices([[s, ds * distance], [c, dc * distance], [0, 1]], len(turn))


def _euler(distance: Array, turn: Array) -> tuple[Array, Array]:
    """Straight on, then turn: delta(d, a) = (d, 0, a)."""
    delta = np.column_stack([distance, np.zeros_like(distance), turn])
    return delta, _matrices([[1, 0], [0, 0], [0, 1]], len(turn))


def _odometry(u: Array) -> tuple[Array, Array]:
    return u.copy(), np.broadcast_to(np.eye(3), (len(u), 3, 3)).copy()


def _advance_turn(u: Array) -> tuple[Array, Array]:
    return _euler(u[:, 0], u[:, 1])


def _from_velocity(step: Callable[[Array, Array], tuple[Array, Array]], u: Array) -> Any:
    v, omega, dt = u.T
    delta, jacobian = step(v * dt, omega * dt)
    return delta, jacobian @ _matrices([[dt, 0, v], [0, dt, omega]], len(u))


def _from_wheels(
    step: Callable[[Array, Array], tuple[Array, Array]], u: Array, width: float
) -> tuple[Array, Array]:
    left, right = u.T
    delta, jacobian = step(0.5 * (left + right), (right - left) / width)
    return delta, jacobian @ _matrices([[0.5, 0.5], [-1 / width, 1 / width]], len(u))


def _from_wheel_speeds(
    step: Callable[[Array, Array], tuple[Array, Array]], u: Array, width: float
) -> tuple[Array, Array]:
    vl, vr, dt = u.T
    delta, jacobian = _from_wheels(step, np.column_stack([vl * dt, vr * dt]), width)
    return delta, jacobian @ _matrices([[dt, 0, vl], [0, dt, vr]], len(u))


def _car(u: Array, wheelbase: float) -> tuple[Array, Array]:
    v, gamma, dt = u.T
    c, s = np.cos(gamma), np.sin(gamma)
    delta = np.column_stack([v * dt * c, v * dt * s, v * dt * s / wheelbase])
    jacobian = _matrices(
        [
            [dt * c, -v * dt * s, v * c],
            [dt * s, v * dt * c, v * s],
            [dt * s / wheelbase, v * dt * c / wheelbase, v * s / wheelbase],
        ],
        len(u),
    )
    return delta, jacobian


def _none(u: Array) -> tuple[Array, Array]:
    return np.zeros((len(u), 3)), np.zeros((len(u), 3, 0))


class _Kind(NamedTuple):
    controls: tuple[str, ...]
    noisy: int  # the first so many controls carry noise
    parameter: str | None
    function: Callable[..., tuple[Array, Array]]

    @property
    def noises(self) -> int:
        """How many numbers carry noise: controls, or the whole increment if there are none."""
        return self.noisy or 3


KINDS: Mapping[str, _Kind] = {
    "odometry": _Kind(("dh", "dl", "dtheta"), 3, None, _odometry),
    "advance-turn": _Kind(("dx", "dalpha"), 2, None, _advance_turn),
    "velocity": _Kind(("v", "omega", "dt"), 2, None, lambda u: _from_velocity(_arc, u)),
    "velocity-euler": _Kind(("v", "omega", "dt"), 2, None, lambda u: _from_velocity(_euler, u)),
    "wheel-speeds": _Kind(
        ("vl", "vr", "dt"), 2, "width", lambda u, width: _from_wheel_speeds(_arc, u, width)
    ),
    "wheel-speeds-euler": _Kind(
        ("vl", "vr", "dt"), 2, "width", lambda u, width: _from_wheel_speeds(_euler, u, width)
    ),
    "wheel-increments": _Kind(
        ("l", "r"), 2, "width", lambda u, width: _from_wheels(_arc, u, width)
    ),
    "car": _Kind(("V", "gamma", "dt"), 2, "wheelbase", _car),
    "none": _Kind((), 0, None, _none),
}


@dataclass(frozen=True, eq=False)
class MotionModel:
    """How controls move the robot, and how far they can be trusted.

    Parameters
    ----------
    kind : str
        A name of the table above.
    covariance : (n, n) array_like, optional
        Constant covariance of the n noisy controls, in their units squared; off-diagonal terms
        (correlated wheels) allowed. Of kind ``none``: (3, 3), of the increment itself.
    proportional : (float, float), optional
        p1 and p2 of the notes on Brenner's lectures, for the kinds with a left and a right wheel:
        ``sigma_l^2 = (p1 l)^2 + (p2 (l - r))^2``, and the same for r. Per-wheel distance, or
        speed for the wheel-speed kinds. Exactly one of `covariance` and `proportional` is given.
    slip : float
        Standard deviation [m] of a lateral slip added to every increment in the frame of its
        first pose. It makes the covariance of a model with two noisy controls regular.
    width, wheelbase : float, optional
        Distance between the wheels, or between the axles [m]; required by the kinds that use it.
    mixture : (C, 2) or (C, 2 + n) array_like, optional
        Components (weight, scale, offset of each noisy control) of a noise that is no Gaussian:
        with probability `weight` it is ``offset + scale * N(0, Sigma_u)``; see
        `ekfslam.models.mixture`. One component of scale 1 without offset by default.

    Raises
    ------
    InputError
        For a missing or surplus parameter, a covariance of the wrong shape or not positive
        semi-definite, or a mixture whose weights are not positive or do not sum to 1.
    UnknownNameError
        For an unknown kind.
    """

    kind: str
    covariance: Array | None = None
    proportional: tuple[float, float] | None = None
    slip: float = 0.0
    width: float | None = None
    wheelbase: float | None = None
    mixture: Array | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UnknownNameError("motion model", self.kind, KINDS)
        kind = KINDS[self.kind]
        for name in ("width", "wheelbase"):
            value = getattr(self, name)
            if (value is not None) != (kind.parameter == name):
                verb = "needs" if value is None else "takes no"
                raise InputError(f"motion model {self.kind!r} {verb} {name}")
            if value is not None and not 0 < checked_number(value, name) < np.inf:
                raise InputError(f"{name} must be positive and finite, got {value}")
        if not 0 <= checked_number(self.slip, "slip") < np.inf:
            raise InputError(f"slip must be a non-negative length [m], got {self.slip}")
        if (self.covariance is None) == (self.proportional is None):
            raise InputError(
                "give either covariance or proportional (p1, p2) for the control noise"
            )
        if self.proportional is not None:
            if "wheel" not in self.kind:
                raise InputError(f"proportional noise is for wheels, not for {self.kind!r}")
            p1, p2 = checked_array(self.proportional, float, (2,), "proportional").tolist()
            if not (np.isfinite([p1, p2]).all() and p1 >= 0 and p2 >= 0):
                raise InputError(f"p1 and p2 must be non-negative and finite, got {p1}, {p2}")
            object.__setattr__(self, "proportional", (p1, p2))
        else:
            object.__setattr__(
                self, "covariance", checked_covariance(self.covariance, kind.noises, "covariance")
            )
        if self.mixture is not None:
            object.__setattr__(self, "mixture", checked_mixture(self.mixture, kind.noises))

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the columns of a control."""
        return KINDS[self.kind].controls

    @property
    def noises(self) -> int:
        """How many numbers carry noise: controls, or the whole increment if there are none."""
        return KINDS[self.kind].noises

    @property
    def noisy_controls(self) -> int:
        """How many of the first control columns carry noise."""
        return KINDS[self.kind].noisy

    def increment(self, controls: Any) -> tuple[Array, Array]:
        """Body increments and their Jacobians.

        Parameters
        ----------
        controls : (K, m) array_like
            One control per row, columns `control_names`.

        Returns
        -------
        deltas : (K, 3) ndarray
            [m, m, rad], in the frame of the pose that the control starts from.
        jacobians : (K, 3, m) ndarray
            Derivatives with respect to every control column.
        """
        kind = KINDS[self.kind]
        parameter = {kind.parameter: getattr(self, kind.parameter)} if kind.parameter else {}
        return kind.function(self._checked(controls), **parameter)

    def _checked(self, controls: Any) -> Array:
        controls = np.asarray(controls, dtype=float)
        if controls.ndim != 2 or controls.shape[1] != len(self.control_names):
            columns = ", ".join(self.control_names) or "(none at all)"
            raise InputError(
                f"controls of {self.kind!r} need the columns {columns}; "
                f"got an array of shape {controls.shape}"
            )
        return controls

    def control_covariances(self, controls: Any) -> Array:
        """Covariance of the noisy controls, (K, n, n); of kind ``none``, of the increments.

        With a mixture, of a component of scale 1.
        """
        controls = np.asarray(controls, dtype=float)
        if self.covariance is not None:
            return np.broadcast_to(self.covariance, (len(controls), *self.covariance.shape))
        assert self.proportional is not None
        p1, p2 = self.proportional
        left, right = controls[:, 0], controls[:, 1]
        turn = (p2 * (left - right)) ** 2
        zero = np.zeros_like(turn)
        return _matrices(
            [[(p1 * left) ** 2 + turn, zero], [zero, (p1 * right) ** 2 + turn]], len(left)
        )

    def increments(self, controls: Any, covariance: Array | None = None) -> Increments:
        """Increments of a run with their body covariances ``J Sigma_u J' + slip``.

        Without controls, the perturbation's covariance stands for ``J Sigma_u J'``. A mixture
        stands as the Gaussian with its mean and covariance: the mean is taken off the controls.

        Parameters
        ----------
        controls : (K, m) array_like
        covariance : (K, n, n) ndarray, optional
            Noise of each control instead of the model's own; with a mixture, of a component of
            scale 1.

        Returns
        -------
        Increments
            In the frame of the first pose of each step: the EKF uses the covariance there; GTSAM's
            `BetweenFactorPose2` wants it rotated into the frame of the second.
        """
        mixture = None if self.mixture is None else mixture_of(self.mixture)
        return self._matched(controls, covariance, mixture)

    def components(self, controls: Any, covariance: Array | None = None) -> Components:
        """Increments of a run as the mixture that they are.

        Parameters
        ----------
        controls, covariance
            As of `increments`.

        Returns
        -------
        Components
            Component c has the increments of the controls less its offset, and the covariances of
            noise of its scale; without a mixture, one component equal to `increments`.
        """
        if self.mixture is None:
            only = self.increments(controls, covariance)
            return Components(np.ones(1), only.deltas[None], only.covariances[None])
        alone = self.mixture.copy()
        alone[:, 0] = 1.0
        parts = [self._matched(controls, covariance, mixture_of(row[None])) for row in alone]
        deltas, covariances = map(np.stack, zip(*parts, strict=True))
        return Components(mixture_of(self.mixture).weights, deltas, covariances)

    def _matched(
        self, controls: Any, covariance: Array | None, mixture: Mixture | None
    ) -> Increments:
        """Increments under the mean and the covariance of a mixture."""
        controls, noisy = self._checked(controls), self.noisy_controls
        if mixture is not None and noisy:
            controls = np.hstack([controls[:, :noisy] - mixture.mean, controls[:, noisy:]])
        deltas, jacobians = self.increment(controls)
        noise = self.control_covariances(controls) if covariance is None else covariance
        if mixture is not None:
            noise = mixture.covariances(noise)
            deltas = deltas if noisy else deltas - mixture.mean
        covariances = congruence(jacobians[:, :, :noisy], noise) if noisy else noise.copy()
        covariances[:, 1, 1] += self.slip**2
        return Increments(deltas, covariances)

    def scaled(self, factor: float) -> MotionModel:
        """The same model with every standard deviation and offset of its noise scaled."""
        changes: dict[str, Any] = {"slip": factor * self.slip}
        if self.proportional is not None:
            changes["proportional"] = tuple(factor * p for p in self.proportional)
        else:
            assert self.covariance is not None
            changes["covariance"] = factor**2 * self.covariance
        if self.mixture is not None:
            shape = [1, 1] + [factor] * self.noises
            changes["mixture"] = self.mixture * shape
        return replace(self, **changes)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for TOML and JSON."""
        values: dict[str, Any] = {"kind": self.kind, "slip": self.slip}
        if self.covariance is not None:
            values["covariance"] = self.covariance.tolist()
        for name in ("proportional", "width", "wheelbase"):
            if getattr(self, name) is not None:
                values[name] = getattr(self, name)
        if self.mixture is not None:
            values["mixture"] = self.mixture.tolist()
        return values

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MotionModel) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash(self.kind)
