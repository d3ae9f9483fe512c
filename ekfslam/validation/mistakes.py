"""What a classic mistake of an EKF-SLAM is, the stages of a filter, and the lines to look at."""

from __future__ import annotations

from typing import NamedTuple

MOTION, LANDMARK, CORRECTION, SEVERAL, ANGLES, MOUNT, GATE = (
    "motion",
    "new landmark",
    "correction",
    "several sightings at once",
    "angles",
    "mounted sensor",
    "gate",
)


class Mistake(NamedTuple):
    """One mistake.

    Attributes
    ----------
    name : str
    stage : str
        Of the filter, where it is made.
    says : str
        What such a filter does: "a filter that ...". Braces stand for a factor that is fitted.
    usually : str
        What it usually comes from.
    look : str
        The line to look at.
    forms : tuple of tuple of str
        Switches; the name itself where none are given.
    fitted : bool
        Whether its switch has a factor that is found by trying.
    """

    name: str
    stage: str
    says: str
    usually: str
    look: str
    forms: tuple[tuple[str, ...], ...] = ()
    fitted: bool = False

    @property
    def switches(self) -> tuple[tuple[str, ...], ...]:
        """All forms of it."""
        return self.forms or ((self.name,),)


# Lines of the algorithm.
MOVE = "the new pose: t += R(theta) (dx, dy), then theta += dtheta (Solà, Eqs. 59 and 60)"
JACOBIAN = "F, heading column: d(x, y)/d theta = (-s dx - c dy, c dx - s dy) (Solà, Eq. 15)"
TURNED_NOISE = "P = F P F' + V Q V' with V = blkdiag(R(theta), 1), theta before the motion"
MOVED_POSE = "P of the pose, P[r, r] = F P[r, r] F' + V Q V' (Solà, Eq. 15)"
INVERSE = "the inverse model: x + r cos(bearing + theta), y + r sin(bearing + theta)"
CROSS = "the rows of the new landmark: P[l, :] = G_r P[r, :], all columns (Solà, Eq. 36)"
OWN_BLOCK = "its own block: P[l, l] = G_r P[r, r] G_r' + G_y R G_y' (Solà, Eq. 35)"
OBSERVATION = "H: rows (-dx/r, -dy/r, 0 | dx/r, dy/r) and (dy/q, -dx/q, -1 | -dy/q, dx/q), q = r^2"
INNOVATION = "the innovation: measured minus expected, its angle wrapped to [-pi, pi)"
UNCERTAINTY = "S = H P H' + R, with R of variances (Solà, Eq. 27)"
GAIN = "x += K nu and P -= K S K' on the whole state, K = P H' S^-1 (Solà, Eqs. 28 to 30)"
FRAME = "the sensor's frame: pose of the robot composed with the mount (Solà, Eq. 63)"


LINES = {
    MOTION: f"{MOVE}; {JACOBIAN}",
    LANDMARK: f"{INVERSE}; {OWN_BLOCK}",
    CORRECTION: f"{UNCERTAINTY}; {GAIN}",
    SEVERAL: "the loop over the sightings of a step",
    ANGLES: INNOVATION,
    MOUNT: FRAME,
}


def of_noise(which: str, stage: str, what: str, look: str) -> tuple[Mistake, ...]:
    """What can go wrong with a noise covariance."""
    forms = (f"{which}-squared",), (f"{which}-squared-whole",)
    return (
        Mistake(
            f"{which}-forgotten",
            stage,
            f"takes {what} for zero",
            "the noise is not passed on, or multiplied by something that is zero",
            look,
        ),
        Mistake(
            f"{which}-root",
            stage,
            f"uses standard deviations where {what} has variances",
            "a square is missing: diag(sigma) for diag(sigma**2)",
            look,
        ),
        Mistake(
            f"{which}-squared",
            stage,
            f"squares {what}, which holds variances already",
            "what is given was taken for standard deviations",
            look,
            forms,
        ),
        Mistake(
            f"{which}-diagonal",
            stage,
            f"uses the diagonal of {what} alone",
            "noise that is correlated was not thought of",
            look,
        ),
        Mistake(
            f"{which}-swapped",
            stage,
            f"has the entries of {what} in another order",
            "rows in the order bearing, range; or theta, y, x",
            look,
        ),
        Mistake(
            f"{which}-scaled",
            stage,
            f"uses {{:.6g}} times {what}",
            "added twice, halved, or scaled by a time step or by a hand-tuned factor",
            look,
            fitted=True,
        ),
    )
