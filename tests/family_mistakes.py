"""Details that published programs of the family get wrong: what `family_laws` must find."""

from __future__ import annotations

import numpy as np
from numpy.linalg import inv
from textbook_family import (
    FirstEstimates,
    Iterated,
    ObservabilityConstrained,
    RightInvariant,
    Robocentric,
    Standard,
    points,
    rotation,
    wrapped,
)


class FejAugmentsAtUpdated(FirstEstimates):
    """A new landmark is linearised at the updated pose, which published programs do."""

    def birth_points(self, i, l):
        _, _, there, z = super().birth_points(i, l)
        return self.x[:2], self.x[2], there, z


class FejMovesFromUpdated(FirstEstimates):
    """The transition is taken from the updated pose, not from its prediction."""

    def motion_points(self, before, after, seen):
        super().motion_points(before, after, seen)
        return before[:2], after[:2], before[2]


class OcForgetsDelta(ObservabilityConstrained):
    """The shift of the linearisation points is not carried on."""

    def motion_points(self, before, after, seen):
        found = super().motion_points(before, after, seen)
        self.delta = np.zeros(2)
        return found


class RiLeverBefore(RightInvariant):
    """The noise of the turn acts on the position before the motion."""

    def noise_matrix(self, before, after):
        return super().noise_matrix(before, before)


class RiHeadingAfter(RightInvariant):
    """The noise of the advance is turned by the heading after the motion."""

    def noise_matrix(self, before, after):
        return super().noise_matrix(np.array([*before[:2], after[2]]), after)


class RiKeepsPrior(RightInvariant):
    """The prior in (x, y, theta) is taken for one of the invariant error."""

    def __init__(self, dataset):
        super().__init__(dataset)
        self.P = dataset.prior.covariance.copy()


class RiPseudo(RightInvariant):
    """The retraction without V: position and landmarks shift by the tangent as it is."""

    def retract(self, error):
        turn = rotation(error[2])
        for at in points(len(self.x)):
            self.x[at] = turn @ self.x[at] + error[at]
        self.x[2] = wrapped(self.x[2] + error[2])


class RiAdds(RightInvariant):
    """The correction is added as if errors were additive."""

    def retract(self, error):
        Standard.retract(self, error)


class RiTells(RightInvariant):
    """The covariance is told in its own coordinates."""

    def world(self):
        return self.x, self.P


class RobocentricKeepsIncrement(Robocentric):
    """The state is composed with the increment as it was measured, not as it was corrected."""

    def correct(self, rows):
        measured = self.x[-3:].copy() if self.pending else None
        super_settle, self.settle = self.settle, lambda: None
        nu, S = super().correct(rows)
        self.settle = super_settle
        if measured is not None:
            self.x[-3:] = measured
        self.settle()
        return nu, S


class IteratesFromTheUpdated(Iterated):
    """Iterations that forget how far they have gone from the prediction.

    On a linear model the correction is then applied again and again.
    """

    def correct(self, rows):
        first = None
        for _ in range(3):
            nu, H, R = self.stacked(rows)
            S = H @ self.P @ H.T + R
            first = (nu, S) if first is None else first
            K = self.P @ H.T @ inv(S)
            self.retract(K @ nu)
        self.joseph(K, H, R)
        return first


MISTAKES = (
    FejAugmentsAtUpdated,
    FejMovesFromUpdated,
    OcForgetsDelta,
    RiLeverBefore,
    RiHeadingAfter,
    RiKeepsPrior,
    RiPseudo,
    RiAdds,
    RiTells,
    RobocentricKeepsIncrement,
    IteratesFromTheUpdated,
)
