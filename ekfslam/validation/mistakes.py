"""The classic mistakes of an EKF-SLAM, in words.

Each names the switches of `ekfslam.validation.suspects` that make it, in one form or several.
"""

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


_MOVE = "the new pose: t += R(theta) (dx, dy), then theta += dtheta (Solà, Eqs. 59 and 60)"
_F = "F, heading column: d(x, y)/d theta = (-s dx - c dy, c dx - s dy) (Solà, Eq. 15)"
_Q = "P = F P F' + V Q V' with V = blkdiag(R(theta), 1), theta before the motion"
_P = "P of the pose, P[r, r] = F P[r, r] F' + V Q V' (Solà, Eq. 15)"
_NEW = "the inverse model: x + r cos(bearing + theta), y + r sin(bearing + theta)"
_CROSS = "the rows of the new landmark: P[l, :] = G_r P[r, :], all columns (Solà, Eq. 36)"
_OWN = "its own block: P[l, l] = G_r P[r, r] G_r' + G_y R G_y' (Solà, Eq. 35)"
_H = "H: rows (-dx/r, -dy/r, 0 | dx/r, dy/r) and (dy/q, -dx/q, -1 | -dy/q, dx/q), q = r^2"
_NU = "the innovation: measured minus expected, its angle wrapped to [-pi, pi)"
_S = "S = H P H' + R, with R of variances (Solà, Eq. 27)"
_GAIN = "x += K nu and P -= K S K' on the whole state, K = P H' S^-1 (Solà, Eqs. 28 to 30)"
_MOUNT = "the sensor's frame: pose of the robot composed with the mount (Solà, Eq. 63)"


def _noise(which: str, stage: str, what: str, look: str) -> tuple[Mistake, ...]:
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


OWN_NOISE = {
    "q": Mistake(
        "q-own",
        MOTION,
        "uses a motion noise of its own, not the one that it is given",
        "numbers of another robot, written into the filter: a covariance of {}",
        _P,
    ),
    "r": Mistake(
        "r-own",
        LANDMARK,
        "uses a sensor noise of its own, not the one that it is given",
        "numbers of another sensor, written into the filter: a covariance of {}",
        "R, wherever it is used",
    ),
}

CATALOGUE: tuple[Mistake, ...] = (
    Mistake(
        "increment-in-world",
        MOTION,
        "adds the increment along the axes of the world",
        "the increment is in the frame of the robot and must be turned by its heading",
        _MOVE,
    ),
    Mistake(
        "rotated-back",
        MOTION,
        "turns the increment by minus the heading",
        "R' for R: the matrix that takes the world into the robot's frame",
        _MOVE,
    ),
    Mistake(
        "turn-first",
        MOTION,
        "turns first and then moves along the new heading",
        "theta is updated before x and y, which then use the new one",
        _MOVE,
    ),
    Mistake(
        "turn-in-degrees",
        MOTION,
        "takes the turn for degrees",
        "np.deg2rad of what is in radians already",
        _MOVE,
    ),
    Mistake(
        "turn-clockwise",
        MOTION,
        "turns clockwise",
        "headings count counter-clockwise",
        _MOVE,
    ),
    Mistake(
        "motion-jacobian-sign",
        MOTION,
        "has the wrong sign in the motion Jacobian: how the heading moves the position",
        "d cos = -sin was forgotten, or the increment was taken backwards",
        _F,
    ),
    Mistake(
        "motion-jacobian-identity",
        MOTION,
        "leaves the heading out of the motion Jacobian: F = I",
        "the model was taken for linear, or Q alone is added to P",
        _F,
    ),
    Mistake(
        "motion-jacobian-transposed",
        MOTION,
        "transposes the motion Jacobian",
        "F' P F for F P F', or F filled by columns",
        _F,
    ),
    Mistake(
        "motion-jacobian-swapped",
        MOTION,
        "has the two entries of the motion Jacobian in each other's place",
        "x and y, or sine and cosine, are exchanged",
        _F,
    ),
    Mistake(
        "jacobian-after",
        MOTION,
        "takes the motion Jacobian at the heading after the motion",
        "the mean is updated before F is built",
        _F,
    ),
    Mistake(
        "map-left-behind",
        MOTION,
        "leaves the correlation of pose and map as it was when the robot moves",
        "only the block of the pose is multiplied by F",
        "P[r, m] = F P[r, m], and its transpose (Solà, Eqs. 16 and 17)",
    ),
    Mistake(
        "q-not-rotated",
        MOTION,
        "adds the motion noise without turning it into the world",
        "the noise is along and across the robot, not along x and y",
        _Q,
    ),
    Mistake(
        "q-rotated-back",
        MOTION,
        "turns the motion noise by minus the heading",
        "V' Q V for V Q V'",
        _Q,
    ),
    Mistake(
        "q-rotated-after",
        MOTION,
        "turns the motion noise by the heading after the motion",
        "the mean is updated before V is built",
        _Q,
    ),
    *_noise("q", MOTION, "the motion noise", _P),
    Mistake(
        "new-without-heading",
        LANDMARK,
        "puts a new landmark along its bearing without the robot's heading",
        "the bearing counts from the robot's nose, the landmark's direction from the x axis",
        _NEW,
    ),
    Mistake(
        "bearing-clockwise",
        LANDMARK,
        "counts bearings clockwise",
        "bearings count counter-clockwise from the x axis of the sensor",
        _NEW,
    ),
    Mistake(
        "bearing-in-degrees",
        LANDMARK,
        "takes bearings for degrees",
        "np.deg2rad of what is in radians already",
        _NEW,
    ),
    Mistake(
        "no-cross-covariance",
        LANDMARK,
        "puts a new landmark into the map without cross-covariance",
        "P is enlarged with zeros beside the new block: the filter takes the errors of pose "
        "and landmark for independent, and believes every sighting too much",
        _CROSS,
    ),
    Mistake(
        "cross-with-pose-only",
        LANDMARK,
        "correlates a new landmark with the pose alone, not with the other landmarks",
        "P[l, r] = G_r P[r, r] was written, and the columns of the map forgotten",
        _CROSS,
    ),
    Mistake(
        "cross-with-map-only",
        LANDMARK,
        "correlates a new landmark with the other landmarks, not with the pose",
        "an index that starts at 3",
        _CROSS,
    ),
    Mistake(
        "new-fixed",
        LANDMARK,
        "gives a new landmark a fixed variance of {:.6g} m^2 and no correlation",
        "right for a variance without end only; else the first sighting counts as none",
        _OWN,
        fitted=True,
    ),
    Mistake(
        "certain-pose",
        LANDMARK,
        "leaves the pose's uncertainty out of the variance of a new landmark",
        "only the noise of the sensor is put in, G_y R G_y'",
        _OWN,
    ),
    Mistake(
        "new-heading-missing",
        LANDMARK,
        "leaves the heading out of the Jacobian of the inverse model",
        "G_r = [I, 0]: as if the heading were known",
        "G_r = [1, 0, -r sin(bearing + theta); 0, 1, r cos(bearing + theta)] (Solà, Eq. 33)",
    ),
    Mistake(
        "new-heading-sign",
        LANDMARK,
        "has the wrong sign in the Jacobian of the inverse model: its heading column",
        "d cos = -sin was forgotten",
        "G_r = [1, 0, -r sin(bearing + theta); 0, 1, r cos(bearing + theta)] (Solà, Eq. 33)",
    ),
    Mistake(
        "new-noise-not-turned",
        LANDMARK,
        "adds the sensor's noise to a new landmark as it is",
        "variances of range and bearing were added to those of x and y",
        _OWN,
    ),
    *_noise("r", LANDMARK, "the sensor's noise", "R, of variances, wherever it is used"),
    *_noise("new", LANDMARK, "the sensor's noise of a new landmark", _OWN),
    Mistake(
        "expected-without-heading",
        CORRECTION,
        "expects bearings without the robot's heading",
        "atan2(dy, dx) counts from the x axis, a bearing from the robot's nose",
        "the expected bearing: atan2(dy, dx) - theta (Solà, Eq. 24)",
    ),
    Mistake(
        "h-transposed",
        CORRECTION,
        "transposes the observation Jacobian: its 2x2 blocks of pose and landmark",
        "written down by columns, or d(x, y)/d(r, b) for d(r, b)/d(x, y)",
        _H,
    ),
    Mistake(
        "h-robot-transposed",
        CORRECTION,
        "transposes the observation Jacobian: its 2x2 block of the robot's position",
        "written down by columns",
        _H,
    ),
    Mistake(
        "h-landmark-transposed",
        CORRECTION,
        "transposes the observation Jacobian: its 2x2 block of the landmark",
        "written down by columns",
        _H,
    ),
    Mistake(
        "h-heading-missing",
        CORRECTION,
        "leaves the heading out of the observation Jacobian",
        "the -1 in the row of the bearing is missing",
        _H,
    ),
    Mistake(
        "h-heading-sign",
        CORRECTION,
        "has the wrong sign in the observation Jacobian: its heading column",
        "+1 for -1 in the row of the bearing",
        _H,
    ),
    Mistake(
        "h-landmark-sign",
        CORRECTION,
        "has the wrong sign in the observation Jacobian: its block of the landmark",
        "the landmark's block is minus that of the robot's position",
        _H,
    ),
    Mistake(
        "h-robot-sign",
        CORRECTION,
        "has the wrong sign in the observation Jacobian: its block of the robot's position",
        "the block of the robot's position is minus that of the landmark",
        _H,
    ),
    Mistake(
        "h-root-of-q",
        CORRECTION,
        "divides by the range and not by its square in the row of the bearing",
        "1/sqrt(q) for 1/q",
        _H,
        (("h-root-of-q",), ("h-root-of-q", "whole-row")),
    ),
    Mistake(
        "innovation-sign",
        CORRECTION,
        "takes the innovation with the wrong sign",
        "expected minus measured: every correction goes the wrong way",
        _NU,
    ),
    *_noise("s", CORRECTION, "the sensor's noise in the innovation covariance", _S),
    Mistake(
        "robot-only",
        CORRECTION,
        "corrects the pose alone and leaves the landmarks as they are",
        "the gain was cut to its first three rows",
        _GAIN,
        (("robot-only",), ("robot-only", "frozen-gain"), ("robot-only", "frozen-mean")),
    ),
    Mistake(
        "map-only",
        CORRECTION,
        "corrects the landmarks and leaves the pose as it is",
        "the gain lacks its first three rows",
        _GAIN,
        (("map-only",), ("map-only", "frozen-gain"), ("map-only", "frozen-mean")),
    ),
    Mistake(
        "seen-only",
        CORRECTION,
        "corrects the pose and the landmark that is seen, and none of the others",
        "the gain was cut to the rows of pose and landmark: what correlates is not corrected",
        _GAIN,
        (("seen-only",), ("seen-only", "frozen-gain"), ("seen-only", "frozen-mean")),
    ),
    Mistake(
        "covariance-kept",
        CORRECTION,
        "never updates the covariance in a correction",
        "P -= K S K' is missing, or its result is not assigned",
        _GAIN,
    ),
    Mistake(
        "covariance-grows",
        CORRECTION,
        "adds K S K' to the covariance",
        "a plus for a minus: I + K H for I - K H",
        _GAIN,
    ),
    Mistake(
        "mean-kept",
        CORRECTION,
        "never updates the mean in a correction",
        "x += K nu is missing, or its result is not assigned",
        _GAIN,
    ),
    Mistake(
        "stale",
        SEVERAL,
        "compares all sightings of a step with the state before the first of them",
        "innovations are computed once, before the loop that corrects with each in turn",
        "innovation and H inside the loop, from the latest state; or one joint correction",
    ),
    Mistake(
        "first-only",
        SEVERAL,
        "uses the first of several sightings alone",
        "a return, break or index inside the loop over the sightings",
        "the loop over the sightings of a step",
    ),
    Mistake(
        "no-wrap",
        ANGLES,
        "does not wrap the innovation of a bearing",
        "near +-pi a small difference becomes one of 2 pi, and the filter jumps",
        _NU,
        (
            ("no-wrap",),
            ("no-wrap", "expected-unwrapped"),
            ("no-wrap", "expected-unwrapped", "heading-unwrapped"),
        ),
    ),
    Mistake(
        "wrapped-to-positive",
        ANGLES,
        "wraps the innovation of a bearing to [0, 2 pi)",
        "nu % (2 pi) for (nu + pi) % (2 pi) - pi: small negative ones become nearly 2 pi",
        _NU,
    ),
    Mistake(
        "no-mount",
        MOUNT,
        "takes the sensor to sit in the middle of the robot, looking ahead",
        "the mount of the sightings is not read",
        _MOUNT,
    ),
    Mistake(
        "mount-not-turned",
        MOUNT,
        "leaves the direction of the mounted sensor out",
        "only the position of the mount is used",
        _MOUNT,
    ),
    Mistake(
        "mount-not-shifted",
        MOUNT,
        "leaves the position of the mounted sensor out",
        "only the direction of the mount is used",
        _MOUNT,
    ),
    Mistake(
        "no-lever",
        MOUNT,
        "leaves the lever of the mount out of the Jacobians",
        "a turn of the robot also shifts a sensor that is not in its middle",
        "d(sensor's pose)/d(robot's pose): its heading column (Solà, Eq. 63)",
    ),
)

LINES = {
    MOTION: f"{_MOVE}; {_F}",
    LANDMARK: f"{_NEW}; {_OWN}",
    CORRECTION: f"{_S}; {_GAIN}",
    SEVERAL: "the loop over the sightings of a step",
    ANGLES: _NU,
    MOUNT: _MOUNT,
}
