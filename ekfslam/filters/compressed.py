"""The compressed filter (Guivant and Nebot 2001): EKF-SLAM at the cost of what is around."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ekfslam.blas import on_threads
from ekfslam.compiled import now, prepare
from ekfslam.dataset import Sightings
from ekfslam.errors import InputError
from ekfslam.filters.arrays import Journal, Log
from ekfslam.filters.ekf import Ekf
from ekfslam.filters.engine import Engine
from ekfslam.filters.evidence import widest
from ekfslam.filters.gaussian_map import GaussianMap
from ekfslam.filters.local_map import (
    EACH,
    LEAVE,
    Area,
    Survey,
    as_it_is,
    beyond,
    bring_in,
    carry,
    fits,
    reduce_rest,
    run_locally,
    square_root,
    within_reach,
)
from ekfslam.filters.measure import POINT, POSE
from ekfslam.filters.options import KNOWN, MOST
from ekfslam.filters.triangle import read_rows, write_rows
from ekfslam.geometry import Array

ROUNDING = 1e-9  # of variances: what their difference, that of two near landmarks, is right to
START = 512  # local coordinates that there is room for at first
UNBOUNDED = int(np.iinfo(np.int64).max)


class CompressedEngine(Engine):
    """The filter on a local map, see `ekfslam.filters.local_map`, and the whole map behind it.

    What the loop works on, `slam` and `register`, are local: a landmark that is not in the area
    has no offset there. `whole` is as the last way home left it.
    """

    def __init__(self, priors: Any, options: EkfCompressed, *arguments: Any) -> None:
        super().__init__(priors, options, *arguments)
        self.settings = self.settings._replace(most=UNBOUNDED)
        self.whole = self.slam
        full = np.array([2 * self._poses + EACH * options.area], dtype=np.int64)
        # No correction waits here: what enters the area reads all of it. BLAS is used even so.
        self.slam = GaussianMap(priors, min(int(full[0]), START) // POINT)
        nowhere = np.full(len(self.register.offsets), -1, dtype=np.int64)
        carried = np.zeros(len(self.slam.arrays.mean), dtype=np.int64)
        count = np.zeros(1, dtype=np.int64)
        self.area = Area(nowhere, carried, carried.copy(), count, full)
        self._surveys: dict[int, tuple[Array, Survey]] = {}  # of each robot, and where it was then
        self._moved = 0.0  # NIS of all corrections since the last way home
        self._set_out()

    @property
    def _poses(self) -> int:
        """Coordinates of the poses."""
        return POSE * self.settings.robots

    def _set_out(self) -> None:
        """A local map of the poses alone, which carry."""
        slam, poses = self.slam.arrays, self._poses
        slam.mean[poses : 2 * poses] = 0.0
        slam.covariance[:poses, poses : 2 * poses] = np.eye(poses)
        slam.covariance[poses : 2 * poses, poses : 2 * poses] = 0.0
        slam.size[0] = 2 * poses
        self.register.offsets[:] = -1
        self.area.carrying[0] = 0
        self._surveys, self._moved = {}, 0.0
        carry(self.area, poses, 0, poses)

    def come_home(self) -> None:
        """Bring the whole map up to date, and begin a new area."""
        whole, area, count = self.whole, self.area, int(self.area.carrying[0])
        carried, origin = area.carried[:count], area.origin[:count]
        mean, local = self.slam.mean, self.slam.covariance
        n, here, there = whole.size, *self._places()
        size = max(n, int(there[-1]) + 1)  # the newest landmark comes last
        before, after = np.empty((count, n)), np.empty((len(here), size))
        with on_threads(self.threads):
            read_rows(whole.arrays.covariance, n, origin, before)
            rest = square_root(-local[np.ix_(carried, carried)]).T @ before
            reduce_rest(whole.arrays.covariance, n, rest)
            np.matmul(local[np.ix_(here, carried)], before, out=after[:, :n])
            whole.mean[:] += mean[carried] @ before
        after[:, there] = local[np.ix_(here, here)]
        whole.reserve(size)
        write_rows(whole.arrays.covariance, size, there, after)
        whole.arrays.size[0] = size
        whole.mean[there] = mean[here]
        self._set_out()

    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Local coordinates of poses and landmarks, and where they stand in the whole map.

        New landmarks get their place in it, behind all others and in the order of their discovery.
        """
        offsets, home = self.register.offsets, self.area.home
        active = np.flatnonzero(offsets >= 0)
        active = active[np.lexsort((offsets[active], home[active] < 0))]
        new = active[home[active] < 0]
        home[new] = self.whole.size + POINT * np.arange(len(new))
        poses, pair = np.arange(self._poses), np.arange(POINT)
        here, there = (
            np.concatenate([poses, (at[active][:, None] + pair).reshape(-1)])
            for at in (offsets, home)
        )
        return here, there

    def make_room(self, rows: int, known: int = 0) -> None:
        """As of `Engine`, also for landmarks that are brought in."""
        super().make_room(rows, known)
        self.slam.reserve(self.slam.size + (EACH + POINT) * rows + self._poses)
        missing = len(self.register.offsets) - len(self.area.home)
        home = np.append(self.area.home, np.full(missing, -1, dtype=np.int64))
        room = np.zeros(len(self.slam.arrays.mean) - len(self.area.carried), dtype=np.int64)
        carried, origin = (np.append(a, room) for a in (self.area.carried, self.area.origin))
        self.area = self.area._replace(home=home, carried=carried, origin=origin)

    def prepare(
        self, moves: Any, offsets: np.ndarray, sightings: Sightings, log: Log, journal: Journal
    ) -> None:
        """As of `Engine`, with the local loop and the way home."""
        super().prepare(moves, offsets, sightings, log, journal)
        slam, register, whole, area = self._local
        rows, which = np.zeros((0, 0)), np.zeros(0, dtype=np.int64)
        local = sightings, slam, register, whole, area, self.settings, log, self.other
        prepare(run_locally, 0, 0, *moves, offsets, *local)
        prepare(bring_in, 0, slam, register, whole, area)
        for move in (read_rows, write_rows):
            prepare(move, slam.covariance, 0, which, rows)
        prepare(reduce_rest, slam.covariance, 0, rows)
        if self.settings.method == KNOWN:
            prepare(beyond, sightings, 0, 0, register, self.area)
            return
        row, three = np.zeros(0), np.zeros(POSE)
        survey = Survey(which, rows, row, 0, row)
        prepare(within_reach, survey, 0.0, *self._local, 0, three, three, 0.0)
        prepare(widest, sightings, 0, 0)

    @property
    def _local(self) -> tuple[Any, ...]:
        """Arrays of both maps as compiled code takes them."""
        return self.slam.arrays, self.register, self.whole.arrays, self.area

    def _plainly(
        self,
        start: int,
        stop: int,
        moves: Any,
        offsets: np.ndarray,
        sightings: Sightings,
        log: Log,
    ) -> tuple[int, int]:
        (deltas, Qs), why = moves, LEAVE
        while why == LEAVE:
            local = *self._local, self.settings, log, self.other
            first = start
            start, why = run_locally(start, stop, deltas, Qs, offsets, sightings, *local)
            if start > first:
                log.seconds[first] += self._owed
                self._owed = 0.0
            if why == LEAVE:
                begin = now()
                self.come_home()
                self._owed += now() - begin
        return start, why

    def _approach(self, sightings: Sightings, first: int, last: int) -> None:
        missing = self._missing(sightings, first, last)
        if not fits(self.slam.size + EACH * len(missing), self.area, False):
            self.come_home()
            missing = self._missing(sightings, first, last)
            fits(self.slam.size + EACH * len(missing), self.area, True)
        self.make_room(len(missing) + last - first)
        for index in missing:
            bring_in(index, *self._local)

    def _missing(self, sightings: Sightings, first: int, last: int) -> np.ndarray:
        """Landmarks beyond the area that a look shows, or may, by register index."""
        if self.settings.method == KNOWN:
            return beyond(sightings, first, last, self.register, self.area)
        limits, mount = sightings.limits[first], sightings.mount[first]
        robot = int(sightings.robot[first])
        here = self.slam.mean[POSE * robot : POSE * robot + 2].copy()
        which = np.flatnonzero(self.area.home >= 0)
        if not len(which):
            return which
        known = self._surveys.get(robot)
        if known is None or np.hypot(*(here - known[0])) > limits[1]:
            known = self._surveys[robot] = here, self._look_round(which, here)
        noise = widest(sightings, first, last)
        local = *self._local, robot, mount, limits, noise
        return within_reach(known[1], self._moved, *local)

    def _look_round(self, which: np.ndarray, here: Array) -> Survey:
        """What is known of the whole map, relative to a landmark near to a place."""
        home = self.area.home
        P, at = self.whole.arrays.covariance, home[which]
        positions = self.whole.mean[at[:, None] + np.arange(POINT)]
        anchor = int(which[np.argmin(((positions - here) ** 2).sum(axis=1))])
        if self.register.offsets[anchor] < 0:
            self.make_room(1)
            bring_in(anchor, *self._local)
        rows = np.empty((POINT, self.whole.size))
        read_rows(P, self.whole.size, home[anchor] + np.arange(POINT), rows)
        own = P.diagonal()
        variances = own[at] + own[at + 1]
        shared = rows[0, at] + rows[1, at + 1]
        apart = variances + variances[which == anchor] - 2.0 * shared
        apart = np.sqrt(np.maximum(apart, 0.0) + ROUNDING * variances)
        return Survey(which, positions, variances, anchor, apart)

    def _use(
        self, sightings: Sightings, first: int, last: int, k: int, log: Log, journal: Journal
    ) -> float:
        nis = super()._use(sightings, first, last, k, log, journal)
        self._moved += np.inf if np.isnan(nis) else nis  # a look that failed may have begun
        return nis

    # The map ------------------------------------------------------------------------------------

    def _map(self) -> tuple[GaussianMap, np.ndarray]:
        self.come_home()
        return self.whole, self.area.home

    def landmark(self, index: int) -> tuple[Array, Array]:
        """As of `Engine`."""
        if self.register.offsets[index] >= 0:
            return super().landmark(index)
        slam, _, whole, area = self._local
        place, covariance, _ = as_it_is(index, slam, whole, area)
        return place, covariance

    def knows(self, index: int) -> bool:
        """As of `Engine`."""
        return super().knows(index) or bool(self.area.home[index] >= 0)

    def delete(self, index: int) -> None:
        """As of `Engine`."""
        self.come_home()
        local = self.slam, self.register
        self.slam, self.register = self.whole, self.register._replace(offsets=self.area.home)
        super().delete(index)
        self.slam, self.register = local


@dataclass(frozen=True)
class EkfCompressed(Ekf):
    """Compressed EKF-SLAM (Guivant and Nebot 2001): the estimate of `ekf`, but for rounding.

    While the robot is among few landmarks, only they are updated; the rest of the map is brought
    up to date when they have become too many, or when it is asked for. This pays where a sensor
    sees a small part of a large map.

    Parameters
    ----------
    area : int
        Landmarks in the local map: about as many are seen before the next way home.

    The other parameters are those of `ekfslam.filters.options.Options`, without those that delete
    landmarks, and for sensors that determine a point.

    Raises
    ------
    InputError
        For an option that the local map does not know.
    """

    area: int = 100
    name = "ekf-compressed"
    engine: ClassVar[type[Engine]] = CompressedEngine
    points_only = True

    def __post_init__(self) -> None:
        super().__post_init__()
        whole = isinstance(self.area, int | np.integer) and self.area is not True
        if not whole or not 1 <= self.area <= MOST:
            raise InputError(f"area must be a number of landmarks from 1 on, got {self.area!r}")
        for name in ("initiation", "forget", "corrupt", "delay"):
            default = getattr(Ekf, name)
            if getattr(self, name) != default:
                raise InputError(f"{self.name} has no option {name}: leave it at {default!r}")
