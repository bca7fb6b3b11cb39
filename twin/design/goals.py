"""What a design is to reach: a number of positions, a slot of time, or a volumetric compensated error."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from twin.design.search import ExchangeSearch, FeasibleMask, Mask, Selection
from twin.errors import DataError

FEWEST_POSITIONS = 2
"""Fewer cannot tell machine from artefact, whatever the prior says."""


@dataclass(frozen=True)
class PositionCountGoal:
    """So many positions; time does not matter. DataError for one alone."""

    count: int

    def __post_init__(self) -> None:
        if self.count < FEWEST_POSITIONS:
            raise DataError(
                f"{self.count} position(s) cannot tell machine from artefact",
                hint="ask for two or more",
                key="positions",
            )

    def select(self, search: ExchangeSearch) -> tuple[int, ...]:
        """Indices of the chosen candidates. DataError where there are not as many."""
        if self.count > search.candidates.count:
            raise _too_few(search.candidates.count, self.count)
        room = _up_to(self.count, search.candidates.count)
        grown = _last(search, Selection.of(search.candidates), room, per_minute=False)
        if len(grown.chosen) < self.count:
            raise _too_few(len(grown.chosen), self.count)
        return search.exchange(grown, room).chosen


@dataclass(frozen=True)
class TimeSlotGoal:
    """As good as it can be within so many machine minutes."""

    minutes: float

    def select(self, search: ExchangeSearch) -> tuple[int, ...]:
        """Indices of the chosen candidates. DataError where two positions take longer, saying how long."""
        shortest = search.costs.cheapest_pairs()
        if self.minutes < shortest.min():
            raise DataError(
                f"{self.minutes:g} min are too short: machine and artefact are told apart by two positions, and the "
                f"shortest two take {shortest.min():.1f} min",
                hint="give a longer slot, fewer touches or fewer balls",
                key="slot",
            )

        def room(chosen: Sequence[int]) -> Mask:
            if not chosen:
                return np.asarray(shortest <= self.minutes)
            return np.asarray(search.costs.total(chosen) + search.costs.marginal(chosen) <= self.minutes)

        return _settled(search, room).chosen


@dataclass(frozen=True)
class TargetErrorGoal:
    """As short as it can be with an expected VCE (mm, aligned) no larger than this."""

    vce_mm: float

    def select(self, search: ExchangeSearch) -> tuple[int, ...]:
        """Indices of the chosen candidates. DataError where all of them together do not reach it, saying what they
        do."""
        candidates = search.candidates
        wanted = self.vce_mm**2 - candidates.form.unresolved_mm2
        floor = candidates.vce(range(candidates.count)).aligned_mm
        if self.vce_mm < floor:
            raise _unattainable(self.vce_mm, floor, candidates.count)
        start = best = Selection.of(candidates)
        for best in search.grow(start, _up_to(candidates.count, candidates.count), per_minute=True):
            if best.value <= wanted and len(best.chosen) >= FEWEST_POSITIONS:
                return _thinned(search, best, wanted).chosen
        raise _unattainable(self.vce_mm, candidates.vce(best.chosen).aligned_mm, len(best.chosen))


Goal = PositionCountGoal | TimeSlotGoal | TargetErrorGoal


def _up_to(count: int, candidates: int) -> FeasibleMask:
    return lambda chosen: np.full(candidates, len(chosen) < count)


def _last(search: ExchangeSearch, selection: Selection, room: FeasibleMask, *, per_minute: bool) -> Selection:
    """The last of the selections grown; the given one where there is no room at all."""
    return deque(chain([selection], search.grow(selection, room, per_minute=per_minute)), maxlen=1).pop()


def _settled(search: ExchangeSearch, room: FeasibleMask) -> Selection:
    """Grown by gain per minute and by gain alone, and the better of the two once each is exchanged and filled up."""
    start = Selection.of(search.candidates)
    grown = [_last(search, start, room, per_minute=per_minute) for per_minute in (True, False)]
    return min((_filled(search, selection, room) for selection in grown), key=lambda one: one.value)


def _filled(search: ExchangeSearch, selection: Selection, room: FeasibleMask) -> Selection:
    """Exchanged, and filled up with what room that made, until neither helps."""
    while True:
        exchanged = search.exchange(selection, room)
        filled = _last(search, exchanged, room, per_minute=False)
        if len(filled.chosen) == len(exchanged.chosen):
            return filled
        selection = filled


def _thinned(search: ExchangeSearch, selection: Selection, wanted: float) -> Selection:
    """Exchange, and do without whatever the value allows; ends when nothing more can be spared."""
    while True:
        minutes = search.costs.total(selection.chosen)

        def room(chosen: Sequence[int], minutes: float = minutes) -> Mask:
            return np.asarray(search.costs.total(chosen) + search.costs.marginal(chosen) <= minutes)

        selection = search.exchange(selection, room)
        spared = _spared(selection, wanted)
        if len(spared.chosen) == len(selection.chosen):
            return selection
        selection = spared


def _spared(selection: Selection, wanted: float) -> Selection:
    while len(selection.chosen) > FEWEST_POSITIONS:
        order, losses = selection.by_rising_loss()
        if selection.value + losses[0] > wanted:
            break
        selection = selection.with_removed(order[0])
    return selection


def _unattainable(wanted_mm: float, floor_mm: float, positions: int) -> DataError:
    return DataError(
        f"a VCE of {1e3 * wanted_mm:.2f} µm cannot be reached: with all {positions} positions that can be measured "
        f"{1e3 * floor_mm:.2f} µm are left",
        hint="what stays is noise, certificate and what no table holds; take more touches, a better certificate or "
        "another target",
        key="target-vce",
    )


def _too_few(found: int, wanted: int) -> DataError:
    return DataError(
        f"only {found} positions can be measured, {wanted} are asked for",
        hint="take a finer grid or more stations",
        key="positions",
    )
