"""Options of EKF-SLAM as users state them, and as the compiled loop reads them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ekfslam.association.gates import Gates, chi2_gate, quantiles
from ekfslam.checks import checked_number
from ekfslam.errors import InputError
from ekfslam.filters.delayed import FROM, ROWS
from ekfslam.filters.measure import INVERSE_DEPTH, POINT
from ekfslam.filters.variants import EKF, ROBOCENTRIC
from ekfslam.geometry import Array
from ekfslam.models.sensors import BEARING, RANGE

(
    KNOWN,
    NEAREST,
    EUCLIDEAN,
    EUCLIDEAN_FIRST,
    MAHALANOBIS_FIRST,
    SMALLEST_DISTANCE,
    MAXIMUM_LIKELIHOOD,
    GLOBAL,
    JOINT,
) = range(9)
ASSOCIATIONS = {
    "known": KNOWN,
    "nearest": NEAREST,
    "euclidean": EUCLIDEAN,
    "euclidean-first": EUCLIDEAN_FIRST,
    "mahalanobis-first": MAHALANOBIS_FIRST,
    "smallest-distance": SMALLEST_DISTANCE,
    "maximum-likelihood": MAXIMUM_LIKELIHOOD,
    "global": GLOBAL,
    "joint": JOINT,
}
OF_POINTS = ("euclidean", "euclidean-first", "mahalanobis-first")  # need a full view
MATCHINGS = ("scan", "one-by-one")
UPDATES = ("joint", "sequential")
MAPPED, INFINITE, ALLOCATED = range(3)
INITIATIONS = {"mapped": MAPPED, "infinite": INFINITE, "allocated": ALLOCATED}
BEARINGS = ("inverse-depth", "naive")
DELAYED, BANK, NAIVE = range(3)
RANGES = {"delayed": DELAYED, "bank": BANK, "naive": NAIVE}
DIMENSIONS = 4  # gates are for innovations of 1 or 2 rows, and one more with a descriptor
MOST = 2**31  # of any count
LARGEST_LOOK = 2048  # rows of innovations that a joint gate is tabulated for


class Settings(NamedTuple):
    """Options as the compiled loop reads them; gates on squared distances, by their dimension."""

    method: int
    plain: bool
    partial: bool
    scan: bool
    joint: bool
    accept: Array
    new: Array
    known: Array
    threshold: float
    compatible: Array
    limit: int
    descriptor_variance: float
    initiation: int
    variance: float
    confirm: int
    within: int
    inverse_depth: bool
    distance_mean: float
    distance_variance: float
    linearity: float
    ranges: int
    hypotheses: int
    prune: float
    forget: int
    corrupt: int
    robots: int
    poses: int
    variant: int
    iterations: int
    tolerance: float
    largest: int
    most: int
    delay_from: int


@dataclass(frozen=True)
class Options:
    """How EKF-SLAM associates, corrects, extends and forgets.

    Thresholds are probabilities: the quantile of chi-square, on the *squared* Mahalanobis distance
    of the innovation, inside which a true match falls with that probability.

    Parameters
    ----------
    association : str, optional
        "known" (identities from the dataset) or how they are found, see `ekfslam.association`:
        "nearest", "euclidean", "euclidean-first", "mahalanobis-first", "smallest-distance",
        "maximum-likelihood", "global" or "joint". By default "known" where every observation has
        its identity, else "nearest".
    matching : {"scan", "one-by-one"}
        Match all that a sensor saw at one instant at the predicted pose (notes on Brenner's
        lectures; the default), or each observation after the correction by the one before (Ciatto,
        Algorithm 1; Principles of Robot Autonomy, Alg. 2).
    update : {"joint", "sequential"}
        Correct with a whole scan at once, linearised at the predicted state (the default), or with
        one observation after another, each at the state that the one before left.
    accept, new : float
        The two gates of Bailey et al. 2006, see `ekfslam.association.gates.Gates`. `accept` is also
        the threshold of "mahalanobis-first" (there of the distance in the landmark's own
        covariance) and of "smallest-distance".
    radius : float
        Threshold of the two Euclidean methods [m].
    compatible : float
        Gate of joint compatibility.
    limit : int
        Bound on the search for joint compatibility, in nodes per scan. Where it is hit, the best
        hypothesis found so far stands, which is no worse than sequential compatibility.
    known_gate : float, optional
        Gate for known identities, which may be wrong; none by default: they are trusted.
    descriptor_sigma : float, optional
        Standard deviation of a descriptor's reading, in its unit; with it, descriptors enter the
        distance of an innovation (Principles of Robot Autonomy, 17.2). Not used by default.
    initiation : {"mapped", "infinite", "allocated"}
        A new landmark has the mapped observation error (Ciatto, 3.7; Solà, 2.3.4; the default); or
        an uncorrelated `variance` and is then corrected by its first measurement (Ciatto's first
        example); or all landmarks of known identity stand in the state with that variance from the
        start (Principles of Robot Autonomy, 17.1.2).
    variance : float
        What stands for infinity [m^2]. At 1e6 the covariance is off by some 1e-7, relative; with
        more it loses digits, with less it is a prior.
    confirm, within : int
        A new landmark must have been seen in `confirm` steps, the last of them less than `within`
        steps after the first, before it enters the map; until then the filter knows nothing of it,
        and what is not seen often enough in time starts anew. 1 by default: at once.
    bearings : {"inverse-depth", "naive"}
        How a bearing starts a landmark: with a prior on the inverse depth from the sensor's
        minimum range (Solà, 2.3.6; the default), or, as a bad example, with a Gaussian prior on the
        distance.
    naive_distance : (float, float)
        Mean and standard deviation of that prior [m].
    linearity : float
        Linearity index below which an inverse depth becomes a point (Civera et al. 2008). Their
        threshold of 0.1 makes a planar filter overconfident: 0.02, the default, costs nothing.
    ranges : {"delayed", "bank", "naive"}
        How ranges start a landmark: when enough of them determine it (the default), from a bank of
        bearing hypotheses at once, or, as a bad example, with a Gaussian prior on the bearing.
    hypotheses : int
        In the bank.
    prune : float
        Probability below which a hypothesis is dropped, as a share of an equal one.
    forget : int
        Delete a landmark that was not seen in so many more looks than it was seen, of those in
        which it should have been; 0, the default, never does. A look that shows nothing at all is
        not in the data and counts for nothing; a sighting that is not accepted counts as a miss.
    corrupt : int
        Delete a landmark when `known_gate` has refused so many sightings of it in a row; 0, the
        default, never does, nor does it without a gate.
    delay : int, optional
        Rows of corrections that may wait before the whole map is updated, see
        `ekfslam.filters.delayed`; 0 for none. By default as many as pay on a map of its size. The
        estimate is the same but for rounding.
    threads : int
        Of BLAS, which updates a large map; 1 by default, so that runs side by side leave each other
        their cores. With another number the last bits of an estimate may differ.

    Raises
    ------
    InputError
        For a value that makes no sense; the message names it.
    """

    association: str | None = None
    matching: str = "scan"
    update: str = "joint"
    accept: float = Gates.accept
    new: float = Gates.new
    radius: float = 1.0
    compatible: float = 0.999
    limit: int = 10_000
    known_gate: float | None = None
    descriptor_sigma: float | None = None
    initiation: str = "mapped"
    variance: float = 1e6
    confirm: int = 1
    within: int = 5
    bearings: str = "inverse-depth"
    naive_distance: tuple[float, float] = (5.0, 2.5)
    linearity: float = 0.02
    ranges: str = "delayed"
    hypotheses: int = 32
    prune: float = 0.001
    forget: int = 0
    corrupt: int = 0
    delay: int | None = None
    threads: int = 1
    variant = EKF  # of the family, no option: every filter of `ekfslam.filters.family` has its own
    points_only = False  # whether sensors must determine a point, no option either

    def __post_init__(self) -> None:
        choices = (
            ("association", (None, *ASSOCIATIONS)),
            ("matching", MATCHINGS),
            ("update", UPDATES),
            ("initiation", tuple(INITIATIONS)),
            ("bearings", BEARINGS),
            ("ranges", tuple(RANGES)),
        )
        for name, known in choices:
            if getattr(self, name) not in known:
                listed = ", ".join(str(k) for k in known if k is not None)
                raise InputError(f"{name} must be one of {listed}, got {getattr(self, name)!r}")
        Gates(self.accept, self.new)
        chi2_gate(self.compatible, 1)
        if self.known_gate is not None and not chi2_gate(self.known_gate, 1) > 0:
            raise InputError("known_gate 0 would let nothing pass; leave it out for no gate")
        for name in ("radius", "variance", "linearity"):
            _positive(getattr(self, name), name)
        if self.descriptor_sigma is not None:
            _positive(self.descriptor_sigma, "descriptor_sigma")
        if not isinstance(self.naive_distance, tuple | list) or len(self.naive_distance) != 2:
            raise InputError(
                f"naive_distance must be a mean and a deviation, got {self.naive_distance!r}"
            )
        for value in self.naive_distance:
            _positive(value, "naive_distance")
        for name, least in (
            ("limit", 1),
            ("confirm", 1),
            ("within", 1),
            ("hypotheses", 3),
            ("forget", 0),
            ("corrupt", 0),
            ("threads", 1),
        ):
            value = getattr(self, name)
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not whole or not least <= value <= MOST:
                raise InputError(f"{name} must be a whole number from {least} on, got {value!r}")
        if self.delay is not None and not (
            isinstance(self.delay, int | np.integer)
            and self.delay is not True
            and 0 <= self.delay <= LARGEST_LOOK
        ):
            raise InputError(
                f"delay must be a number of rows from 0 to {LARGEST_LOOK}, got {self.delay!r}"
            )
        if not 0 <= checked_number(self.prune, "prune") < 1:
            raise InputError(f"prune must be in [0, 1), got {self.prune}")
        if self.confirm > self.within:
            raise InputError(
                f"confirm ({self.confirm}) sightings do not fit into within ({self.within}) steps"
            )
        if self.initiation == "allocated" and self.association not in (None, "known"):
            raise InputError("initiation 'allocated' needs association 'known'")

    def settings(self, association: str, kinds: set[int], landmarks: int, robots: int) -> Settings:
        """The same for compiled code.

        Parameters
        ----------
        association : str
            The method, decided.
        kinds : set of int
            Codes of the views that there will be.
        landmarks : int
            How many there can be, 0 for not known.
        robots : int
        """
        ranges = RANGES[self.ranges]
        partial = bool(kinds & {BEARING, RANGE}) or self.initiation != "mapped"
        largest = POINT
        if BEARING in kinds and self.bearings == "inverse-depth":
            largest = INVERSE_DEPTH
        if RANGE in kinds and ranges == BANK:
            largest = max(largest, POINT * self.hypotheses)
        bounded = landmarks > 0 and not (RANGE in kinds and ranges == DELAYED)
        most = 3 * robots + largest * landmarks if bounded else np.iinfo(np.int64).max
        extras = self.known_gate, self.descriptor_sigma, self.forget or None
        return Settings(
            method=ASSOCIATIONS[association],
            # What the compiled loop does by itself; the rest is done look by look.
            plain=association == "known" and extras == (None, None, None) and not partial,
            partial=partial,
            scan=self.matching == "scan",
            joint=self.update == "joint",
            accept=quantiles(self.accept, DIMENSIONS),
            new=quantiles(self.new, DIMENSIONS),
            known=quantiles(self.known_gate or 0.0, DIMENSIONS),
            threshold=self._threshold(association),
            compatible=quantiles(self.compatible, LARGEST_LOOK),
            limit=self.limit,
            descriptor_variance=0.0
            if self.descriptor_sigma is None
            else float(self.descriptor_sigma) ** 2,
            initiation=INITIATIONS[self.initiation],
            variance=float(self.variance),
            confirm=self.confirm,
            within=self.within,
            inverse_depth=self.bearings == "inverse-depth",
            distance_mean=float(self.naive_distance[0]),
            distance_variance=float(self.naive_distance[1]) ** 2,
            linearity=float(self.linearity),
            ranges=ranges,
            hypotheses=self.hypotheses,
            prune=float(self.prune),
            forget=self.forget,
            corrupt=self.corrupt,
            robots=robots,
            # The robocentric filter keeps the pose of the start beside the robot's.
            poses=robots + (self.variant == ROBOCENTRIC),
            variant=self.variant,
            iterations=1,
            tolerance=0.0,
            largest=largest,
            most=int(most),
            delay_from=self._delay_from(),
        )

    @property
    def late(self) -> int:
        """Rows of corrections that may wait."""
        return ROWS if self.delay is None else int(self.delay)

    def _delay_from(self) -> int:
        """Coordinates of a state from which the map update is delayed."""
        if self.delay is None:
            return FROM
        return 0 if self.delay > 0 else int(np.iinfo(np.int64).max)

    def _threshold(self, association: str) -> float:
        """Of the methods that have only one, on what they compare with it."""
        squared = chi2_gate(self.accept, 2)
        by_method = {
            "euclidean": self.radius,
            "euclidean-first": self.radius,
            "mahalanobis-first": np.sqrt(squared),
        }
        return float(by_method.get(association, squared))


def _positive(value: float, name: str) -> None:
    if not 0 < checked_number(value, name) < np.inf:
        raise InputError(f"{name} must be positive and finite, got {value}")
