"""What `Ekf` and `EkfSlam` share: the arrays of a filter, room for them, and the map at the end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ekfslam.association.assignment import global_nearest_neighbour
from ekfslam.association.nearest import NEW as NEW_LANDMARK
from ekfslam.blas import on_threads
from ekfslam.compiled import now, prepare
from ekfslam.dataset import Prior, Sightings
from ekfslam.errors import UnsupportedError
from ekfslam.estimates import Decision, LandmarkEstimates
from ekfslam.filters.arrays import Bank, Journal, Log, Register, State, Tentative, Waiting
from ekfslam.filters.delayed import bring_up_to_date
from ekfslam.filters.ekf_slam import (
    DONE,
    GROW,
    INDEFINITE,
    LOOK,
    end_of_look,
    predict,
    predict_elsewhere,
    run,
    update,
    write_step,
)
from ekfslam.filters.evidence import Evidence, gather
from ekfslam.filters.exchange import map_of, poses_of, starting
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.filters.initiation import extend, note_corrections, note_points
from ekfslam.filters.measure import BANKED, INVERSE_DEPTH, POINT, POSE
from ekfslam.filters.options import BANK, DELAYED, GLOBAL, JOINT, Options
from ekfslam.filters.partial import prepare_partial, see_to_partial
from ekfslam.filters.recognition import decide_jointly, recognise, robots_seen, settle
from ekfslam.filters.suitability import check_variant
from ekfslam.filters.triangle import copy_triangle, rearrange
from ekfslam.filters.upkeep import delete, upkeep
from ekfslam.filters.variants import (
    AT_ESTIMATES,
    EKF,
    INVARIANT,
    OF_THEIR_OWN,
    ROBOCENTRIC,
    settle_pose,
)
from ekfslam.filters.variants.robocentric import compose
from ekfslam.filters.waiting import MOST
from ekfslam.geometry import Array
from ekfslam.models.sensors import RANGE
from ekfslam.observations import WIDTH

TENTATIVES = 256  # things that can be tentative at once
CLONES = 128  # past poses that can be in the state at once
LANDMARKS = 32  # room to begin with, where their number is not known


class Engine:
    """The filter's arrays and the compiled steps on them.

    Parameters
    ----------
    priors : sequence of Prior
        One for each robot.
    options : Options
    association : str
        The method, decided.
    kinds : set of int
        Codes of the views that there will be.
    landmarks : int
        How many there can be at most, 0 for not known.
    noted : bool
        Whether a journal is kept.
    truth : (R, K + 1, 3) and (M, 2) ndarray, optional
        For the ideal filter: true poses, and true place of what each observation shows.

    Raises
    ------
    UnsupportedError
        If the options cannot work with such views, or the filter with so many robots.
    """

    def __init__(
        self,
        priors: Sequence[Prior],
        options: Options,
        association: str,
        kinds: set[int],
        landmarks: int = 0,
        noted: bool = False,
        truth: tuple[Array, Array] | None = None,
    ) -> None:
        check_variant(options, len(priors))
        settings = options.settings(association, kinds, landmarks, len(priors))
        settings = settings._replace(plain=settings.plain and not noted)
        self.settings, self.association = settings, association
        self.threads = int(options.threads)
        # None is a type of its own: what is compiled for it knows nothing of the family.
        self.other = None if settings.variant == EKF else True
        room = landmarks or LANDMARKS
        # Not where a motion changes all of the map.
        late = 0 if settings.variant in OF_THEIR_OWN else options.late
        self.slam = GaussianMap(
            starting(settings.variant, priors), room * settings.largest // POINT, late
        )
        self._start(priors, truth)
        self.register = Register.of(room)
        ranges = RANGE in kinds
        delayed = ranges and settings.ranges == DELAYED
        self._tentative = Tentative.of(TENTATIVES if options.confirm > 1 else 0)
        self._waiting = Waiting.of(MOST * max(room, 8), CLONES) if delayed else Waiting.of(0, 0)
        banked = ranges and settings.ranges == BANK
        self.bank = Bank.of(room if banked else 0, options.hypotheses)
        self._clock = np.array([-1], dtype=np.int64)
        self.searches_cut = 0  # for joint compatibility, at their limit
        self._owed = 0.0  # seconds that count for a step and were spent before it
        if options.initiation == "allocated":
            self._allocate(landmarks, options.variance)

    def _start(self, priors: Sequence[Prior], truth: tuple[Array, Array] | None) -> None:
        """Points of linearisation of the first poses."""
        arrays = self.slam.arrays
        poses = np.concatenate([prior.mean for prior in priors])
        if truth is not None:
            points = arrays.points._replace(poses=truth[0].copy(), places=truth[1].copy())
            self.slam.arrays = arrays = arrays._replace(points=points)
            poses = truth[0][:, 0].reshape(-1)
        arrays.points.at[: len(poses)] = poses
        if self.settings.variant in (INVARIANT, ROBOCENTRIC):
            arrays.points.first[: len(poses)] = poses

    def _allocate(self, landmarks: int, variance: float) -> None:
        """All landmarks stand in the state from the start, at 0 with a variance for infinity."""
        if landmarks == 0:
            raise UnsupportedError("initiation 'allocated' needs to know all identities beforehand")
        none, noise = np.zeros((POINT, POSE)), variance * np.eye(POINT)
        for index in range(landmarks):
            at = self.slam.append(np.zeros(POINT), none, np.eye(POINT), noise)
            self.register.offsets[index], self.register.sizes[index] = at, POINT
        self.register.used[0] = landmarks

    @property
    def state(self) -> State:
        """The arrays as compiled code takes them."""
        return State(
            self.slam.arrays, self.register, self._tentative, self._waiting, self.bank, self._clock
        )

    def make_room(self, rows: int, known: int = 0) -> None:
        """Enlarge what a step with so many observations could overflow.

        Parameters
        ----------
        rows : int
            Observations.
        known : int
            Identities that there are, of landmarks in the map or not.
        """
        settings = self.settings
        size = self.slam.size + settings.largest * rows + POSE * settings.poses
        self.slam.reserve(min(size, settings.most))
        if (indices := max(int(self.register.used[0]) + rows, known)) > len(self.register.offsets):
            self.register = self.register.grown(2 * indices)
        missing = len(self.register.offsets) - len(self.bank.offsets)
        if self.settings.ranges == BANK and len(self.bank.offsets) and missing > 0:
            more = Bank.of(missing, self.settings.hypotheses)
            self.bank = Bank(*map(np.concatenate, zip(self.bank, more, strict=True)))

    def prepare(
        self, moves: Any, offsets: np.ndarray, sightings: Sightings, log: Log, journal: Journal
    ) -> None:
        """Compile all that a run may need, so that no clock counts it."""
        state, settings = self.state, self.settings
        slam, register = self.slam.arrays, self.register
        prepare(copy_triangle, slam.covariance, 0, slam.covariance)
        prepare(rearrange, slam.covariance, 0, slam.size)
        prepare(bring_up_to_date, slam)
        prepare(run, 0, 0, *moves, offsets, sightings, slam, register, settings, log, self.other)
        if settings.plain:
            return
        look, scan = (state, sightings, 0, 0), (sightings, 0, 0)
        if settings.method in (GLOBAL, JOINT):
            prepare(robots_seen, *scan, log)
            prepare(gather, *look, settings)
            none, table, row = np.zeros(0, dtype=np.int64), np.zeros((0, 0)), np.zeros(0)
            evidence = Evidence(none, none, table, table, table, row, row)
            prepare(settle, state, sightings, evidence, none, settings, log)
            if settings.method == JOINT:
                prepare(decide_jointly, state, sightings, evidence, settings, none)
        else:
            prepare(recognise, *look, settings, log)
        prepare(end_of_look, *scan)
        prepare(update, slam, register, *scan, settings, log, self.other)
        prepare(extend, slam, register, *scan, settings, log)
        prepare(write_step, slam, 0, settings, log)
        if settings.variant in OF_THEIR_OWN:
            place = log.poses[0, 0], log.covariances[0, 0]
            prepare(settle_pose, settings.variant, slam, *place)
        if len(journal.event):
            prepare(note_corrections, *look, log, journal)
            prepare(note_points, *look, settings, log, journal)
        if settings.partial:
            prepare_partial(state, sightings, settings, log, journal)
        if settings.corrupt or settings.forget or settings.descriptor_variance:
            prepare(upkeep, *look, settings, log)

    # Steps --------------------------------------------------------------------------------------

    def run(
        self,
        start: int,
        stop: int,
        moves: Any,
        offsets: np.ndarray,
        sightings: Sightings,
        log: Log,
        journal: Journal,
    ) -> tuple[int, int]:
        """Steps from `start` to before `stop`; returns the step it came to, and how.

        That is `DONE`, or `INDEFINITE` where an innovation covariance was not positive definite.
        """
        why = DONE
        with on_threads(self.threads):
            while start < stop:
                start, why = self._plainly(start, stop, moves, offsets, sightings, log)
                if why == GROW:
                    self.make_room(int(offsets[start + 1] - offsets[start]))
                    self.slam.widen(int(self.slam.arrays.workspace.wanted[0]))
                elif why == LOOK:
                    begin = now()
                    first, last = int(offsets[start]), int(offsets[start + 1])
                    self._clock[0] = start
                    if not self._observe(sightings, first, last, start, log, journal):
                        return start, INDEFINITE
                    write_step(self.slam.arrays, start, self.settings, log)
                    if (variant := self.settings.variant) in OF_THEIR_OWN:
                        place = log.poses[0, start], log.covariances[0, start]
                        settle_pose(variant, self.slam.arrays, *place)
                    log.seconds[start] = now() - begin + self._owed
                    self._owed = 0.0
                    start += 1
                else:
                    break
        return start, INDEFINITE if why == INDEFINITE else DONE

    def _plainly(
        self,
        start: int,
        stop: int,
        moves: Any,
        offsets: np.ndarray,
        sightings: Sightings,
        log: Log,
    ) -> tuple[int, int]:
        """What the compiled loop does by itself; returns as it does."""
        (deltas, Qs), slam, register = moves, self.slam.arrays, self.register
        arguments = sightings, slam, register, self.settings, log
        return run(start, stop, deltas, Qs, offsets, *arguments, self.other)

    def predict(self, step: int, deltas: Array, Qs: Array, unseen: Sightings) -> None:
        """Move the robots, (R, 3) and (R, 3, 3); what they will see is not known (no rows)."""
        self._clock[0] = step
        slam, register = self.slam.arrays, self.register
        if self.settings.variant == ROBOCENTRIC:  # the end of the step before
            compose(slam.mean, slam.covariance, self.slam.size)
        if self.settings.variant in AT_ESTIMATES:
            predict(slam, deltas, Qs)
        else:
            predict_elsewhere(slam, deltas, Qs, step, register, unseen, 0, 0, self.settings)

    def observe(self, sightings: Sightings, log: Log) -> bool:
        """All observations of one step; whether innovation covariances were positive definite."""
        log.nis[0] = 0.0
        self.slam.widen(WIDTH * len(sightings.values))
        with on_threads(self.threads):
            return self._observe(sightings, 0, len(sightings.values), 0, log, Journal.of(0))

    def _observe(
        self, sightings: Sightings, first: int, last: int, k: int, log: Log, journal: Journal
    ) -> bool:
        """The loop of `ekfslam.filters.ekf_slam.run` over looks, with all that may be in them."""
        settings = self.settings
        while first < last:
            end = end_of_look(sightings, first, last)
            for at in [first] if settings.scan else range(first, end):
                until = end if settings.scan else at + 1
                used = int(self.register.used[0])
                self._approach(sightings, at, until)
                self.recognise(sightings, at, until, log)
                if np.isnan(self._use(sightings, at, until, k, log, journal)):
                    # What failed leaves nothing behind.
                    self.register.used[0] = used
                    log.decision[at:until], log.landmark[at:until] = Decision.REJECTED, -1
                    return False
                if settings.partial:
                    part = self.state, sightings, at, until
                    see_to_partial(*part, settings, log, journal)
            if settings.corrupt or settings.forget or settings.descriptor_variance:
                upkeep(self.state, sightings, first, end, settings, log)
            first = end
        return True

    def _use(
        self, sightings: Sightings, first: int, last: int, k: int, log: Log, journal: Journal
    ) -> float:
        """Correct and extend; the NIS, NaN if their covariance was not positive definite."""
        total = 0.0
        settings, slam, register = self.settings, self.slam.arrays, self.register
        noting = len(journal.event) > 0
        # Noted before they are used: one after another, where each is linearised anew.
        alone = noting and not settings.joint
        for i, j in [(i, i + 1) for i in range(first, last)] if alone else [(first, last)]:
            if noting:
                note_corrections(self.state, sightings, i, j, log, journal)
            nis, dof = update(slam, register, sightings, i, j, settings, log, self.other)
            if np.isnan(nis):
                return np.nan
            total += nis
            log.nis[k] += nis
            log.dof[k] += dof
        if noting:
            note_points(self.state, sightings, first, last, settings, log, journal)
        extend(slam, register, sightings, first, last, settings, log)
        return float(total)

    def _approach(self, sightings: Sightings, first: int, last: int) -> None:
        """Have at hand what a look may show: the whole map always is."""

    def recognise(self, sightings: Sightings, first: int, last: int, log: Log) -> None:
        """Who is seen in a look."""
        state, settings = self.state, self.settings
        if settings.method not in (GLOBAL, JOINT):
            recognise(state, sightings, first, last, settings, log)
            return
        robots_seen(sightings, first, last, log)
        evidence = gather(state, sightings, first, last, settings)
        choice = self._assign(sightings, evidence)
        settle(state, sightings, evidence, choice, settings, log)

    def _assign(self, sightings: Sightings, evidence: Evidence) -> np.ndarray:
        """Decide on all observations of a look together."""
        if self.settings.method == GLOBAL:
            return global_nearest_neighbour(evidence.distances, evidence.accept, evidence.new)
        most = (len(self.settings.compatible) - 1) // WIDTH
        if len(evidence.rows) > most:
            raise UnsupportedError(
                f"joint compatibility takes up to {most} observations in a look, "
                f"got {len(evidence.rows)}"
            )
        choice = np.full(len(evidence.rows), NEW_LANDMARK)
        if not decide_jointly(self.state, sightings, evidence, self.settings, choice):
            self.searches_cut += 1
        return choice

    # The map ------------------------------------------------------------------------------------

    def _map(self) -> tuple[GaussianMap, np.ndarray]:
        """The whole map, up to date, and where landmarks stand in it by register index."""
        return self.slam, self.register.offsets

    def landmarks(
        self, ids: np.ndarray, surrender: bool = False
    ) -> tuple[LandmarkEstimates, Array]:
        """The map, and the joint covariance of poses and map.

        Parameters
        ----------
        ids : (n,) ndarray of int
            Identity of each register index.
        surrender : bool
            Whether the filter gives up the memory of its covariance for that: it is then of no
            more use.
        """
        slam, offsets = self._map()
        return map_of(slam, offsets, self.register, self.settings, ids, surrender)

    def landmark(self, index: int) -> tuple[Array, Array]:
        """Position (2,) and covariance (2, 2) of a point in the map, by its register index."""
        if self.settings.variant in OF_THEIR_OWN:
            names = np.arange(int(self.register.used[0]))
            landmarks, _ = self.landmarks(names)
            row = int(np.flatnonzero(landmarks.ids == index)[0])
            assert landmarks.covariances is not None
            return landmarks.positions[row], landmarks.covariances[row]
        at = int(self.register.offsets[index])
        return self.slam.mean[at : at + POINT].copy(), self.slam.block(at, POINT)

    def is_point(self, index: int) -> bool:
        """Whether a landmark that the map knows is a point yet."""
        return bool(self.register.sizes[index] == POINT)

    def knows(self, index: int) -> bool:
        """Whether a landmark stands in the map, by its register index."""
        return bool(self.register.offsets[index] >= 0)

    def delete(self, index: int) -> None:
        """Take a landmark out of the map, by its register index."""
        with on_threads(self.threads):
            delete(self.state, index)

    @property
    def poses(self) -> tuple[Array, Array]:
        """Poses of the robots (R, 3), and their joint covariance (3 R, 3 R), additive."""
        return poses_of(self.slam, self.settings)

    @property
    def undetermined(self) -> int:
        """Landmarks that are seen but not yet points: directions, hypotheses, ranges alone."""
        used = int(self.register.used[0])
        sizes, unmapped = self.register.sizes[:used], self.register.offsets[:used] < 0
        count = int(np.isin(sizes, [INVERSE_DEPTH, BANKED]).sum())
        if len(self._waiting.row):  # what has no coordinates yet waits, or did
            count += int((unmapped & (sizes == 0)).sum())
        return count
