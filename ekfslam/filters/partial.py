"""Landmarks that do not enter the map by the mapped error of one sighting.

Apart from the compiled loop, since it is rare: once in the map, a landmark is like any other.
"""

from __future__ import annotations

from ekfslam.compiled import prepare
from ekfslam.dataset import Sightings
from ekfslam.estimates import Decision
from ekfslam.filters.arrays import Journal, Log, State
from ekfslam.filters.delayed import bring_up_to_date
from ekfslam.filters.hypotheses import start_bank, update_bank
from ekfslam.filters.initiation import start_direction, start_uninformed, starts_as_point
from ekfslam.filters.measure import BANKED
from ekfslam.filters.options import DELAYED, MAPPED, Settings
from ekfslam.filters.upkeep import to_points
from ekfslam.filters.waiting import use_waiting, wait
from ekfslam.models.sensors import BEARING, RANGE


def see_to_partial(
    state: State,
    sightings: Sightings,
    first: int,
    last: int,
    settings: Settings,
    log: Log,
    journal: Journal,
) -> None:
    """Start, weigh or keep waiting what a look shows of such landmarks, after its correction."""
    for i in range(first, last):
        index, decision, kind = int(log.landmark[i]), int(log.decision[i]), int(sightings.kind[i])
        if index < 0:
            continue
        banked = decision == Decision.ACCEPTED and state.register.sizes[index] == BANKED
        if banked or (decision == Decision.NEW and not starts_as_point(kind, settings)):
            bring_up_to_date(state.slam)
        if banked:
            update_bank(state, sightings, i, settings, log)
        elif decision == Decision.NEW:
            if starts_as_point(kind, settings):
                pass
            elif kind == BEARING:
                start_direction(state, sightings, i, log, journal)
            elif kind != RANGE:
                start_uninformed(state, sightings, i, settings, log, journal)
            elif settings.ranges == DELAYED:
                wait(state, sightings, i, settings, log, journal)
            else:
                start_bank(state, sightings, i, settings, log)
            if len(state.waiting.row) and kind != RANGE:
                use_waiting(state, index, settings, journal)
    to_points(state, sightings, first, last, settings, log, journal)


def prepare_partial(
    state: State, sightings: Sightings, settings: Settings, log: Log, journal: Journal
) -> None:
    """Compile what `see_to_partial` may call with such state."""
    one = state, sightings, 0
    prepare(bring_up_to_date, state.slam)
    prepare(starts_as_point, 0, settings)
    prepare(start_direction, *one, log, journal)
    prepare(to_points, *one, 0, settings, log, journal)
    if settings.initiation != MAPPED:
        prepare(start_uninformed, *one, settings, log, journal)
    if len(state.waiting.row):
        prepare(wait, *one, settings, log, journal)
        prepare(use_waiting, state, 0, settings, journal)
    if len(state.bank.offsets):
        prepare(start_bank, *one, settings, log)
        prepare(update_bank, *one, settings, log)
