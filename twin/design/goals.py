"""Goals of a design (choice of the artefact positions to be measured): a number of positions, a limit of machine time,
or a limit of the volumetric compensated error (error that remains after compensation)."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from twin.design.search import ExchangeSearch, FeasibleMask, Mask, Selection
from twin.errors import DataError

MIN_POSITIONS = 2
"""Minimum number of positions. With fewer, machine and artefact errors cannot be separated, whatever the prior."""


@dataclass(frozen=True)
class PositionCountGoal:
    """Goal of selecting `count` positions of the artefact, whatever machine time they take. Raises DataError if `count`
    is less than two."""

    count: int

    def __post_init__(self) -> None:
        if self.count < MIN_POSITIONS:
            raise DataError(
                f"{self.count} position(s) cannot separate machine errors from artefact errors",
                hint="request at least two positions",
                key="positions",
            )

    def select(self, search: ExchangeSearch) -> tuple[int, ...]:
        """Return the indices of the candidate positions selected by `search`. Raise DataError if fewer than `count`
        candidates can be measured."""
        if self.count > search.candidates.count:
            raise _too_few(search.candidates.count, self.count)
        room = _count_limit(self.count, search.candidates.count)
        grown = _last_selection(search, Selection.of(search.candidates), room, per_minute=False)
        if len(grown.chosen) < self.count:
            raise _too_few(len(grown.chosen), self.count)
        return search.exchange(grown, room).chosen


@dataclass(frozen=True)
class TimeSlotGoal:
    """Goal of reaching the smallest expected volumetric compensated error (VCE) within `minutes` of machine time."""

    minutes: float

    def select(self, search: ExchangeSearch, start: Sequence[int] = ()) -> tuple[int, ...]:
        """Return the indices of the candidate positions selected by `search`.

        If the selection `start` for a slot of about this length is given, it is improved instead of a new one being
        grown, which takes a fraction of the time. Raise DataError if `minutes` is too short for any two positions. The
        message states the shortest time in which two positions can be measured.
        """
        shortest = search.costs.cheapest_pairs()
        if self.minutes < shortest.min():
            raise DataError(
                f"{self.minutes:g} min are too short: separating machine and artefact errors takes two positions, and "
                f"the shortest two take {shortest.min():.1f} min{_of_which_fixed(search.costs.fixed_minutes)}",
                hint="allow a longer slot, or use fewer touches or fewer balls",
                key="slot",
            )

        def room(chosen: Sequence[int]) -> Mask:
            # A first position that leaves no time for a second one would end the search with a single position.
            if not chosen:
                return np.asarray(shortest <= self.minutes)
            return np.asarray(search.costs.total(chosen) + search.costs.marginal(chosen) <= self.minutes)

        if not start:
            return _best_selection(search, room).chosen
        selection = Selection.of(search.candidates, start)
        while len(selection.chosen) > 1 and search.costs.total(selection.chosen) > self.minutes:
            selection = selection.with_removed(selection.by_rising_loss()[0][0])
        improved = _exchange_and_fill(search, selection, room)
        return improved.chosen if len(improved.chosen) >= MIN_POSITIONS else _best_selection(search, room).chosen


@dataclass(frozen=True)
class TargetErrorGoal:
    """Goal of reaching an expected volumetric compensated error (VCE) of at most `vce_mm` in the shortest machine time.
    The VCE is taken after the best-fitting rigid motion has been removed."""

    vce_mm: float

    def select(self, search: ExchangeSearch) -> tuple[int, ...]:
        """Return the indices of the candidate positions selected by `search`.

        Raise DataError if even all candidates together do not reach an expected volumetric compensated error (VCE) of
        `vce_mm`. The message states the smallest possible VCE.
        """
        candidates = search.candidates
        # `Selection.value` leaves out the unresolved misfit, which no position reduces; so must the target.
        wanted = self.vce_mm**2 - candidates.form.unresolved_mm2
        floor = candidates.vce(range(candidates.count)).aligned_mm
        if self.vce_mm < floor:
            raise _unattainable(self.vce_mm, floor, candidates.count)
        start = best = Selection.of(candidates)
        for best in search.grow(start, _count_limit(candidates.count, candidates.count), per_minute=True):
            if best.value <= wanted and len(best.chosen) >= MIN_POSITIONS:
                return _thin_out(search, best, wanted).chosen
        raise _unattainable(self.vce_mm, candidates.vce(best.chosen).aligned_mm, len(best.chosen))


Goal = PositionCountGoal | TimeSlotGoal | TargetErrorGoal


def _of_which_fixed(minutes: float) -> str:
    return f", of which {minutes:.1f} min are checks and proof" if minutes > 0.0 else ""


def _count_limit(count: int, candidates: int) -> FeasibleMask:
    return lambda chosen: np.full(candidates, len(chosen) < count)


def _last_selection(search: ExchangeSearch, selection: Selection, room: FeasibleMask, *, per_minute: bool) -> Selection:
    """Return the selection after positions have been added until `room` allows no more. If no position can be added,
    the given selection is returned."""
    return deque(chain([selection], search.grow(selection, room, per_minute=per_minute)), maxlen=1).pop()


def _best_selection(search: ExchangeSearch, room: FeasibleMask) -> Selection:
    """Return the better of two selections. The first is grown greedily by gain per minute, and the second by gain. Both
    are then improved by exchanging and adding positions."""
    start = Selection.of(search.candidates)
    grown = [_last_selection(search, start, room, per_minute=per_minute) for per_minute in (True, False)]
    return min((_exchange_and_fill(search, selection, room) for selection in grown), key=lambda one: one.value)


def _exchange_and_fill(search: ExchangeSearch, selection: Selection, room: FeasibleMask) -> Selection:
    """Exchange positions and add positions in turn, until no position can be added. Exchanges can free machine time for
    the added positions."""
    while True:
        exchanged = search.exchange(selection, room)
        filled = _last_selection(search, exchanged, room, per_minute=False)
        if len(filled.chosen) == len(exchanged.chosen):
            return filled
        selection = filled


def _thin_out(search: ExchangeSearch, selection: Selection, wanted: float) -> Selection:
    """Exchange positions and remove positions in turn, until every remaining position is needed to reach the target."""
    while True:
        # Exchanges may not cost more machine time than the selection has now; the lower VCE that they bring can then
        # spare a position.
        minutes = search.costs.total(selection.chosen)

        def room(chosen: Sequence[int], minutes: float = minutes) -> Mask:
            return np.asarray(search.costs.total(chosen) + search.costs.marginal(chosen) <= minutes)

        selection = search.exchange(selection, room)
        spared = _remove_spare_positions(selection, wanted)
        if len(spared.chosen) == len(selection.chosen):
            return selection
        selection = spared


def _remove_spare_positions(selection: Selection, wanted: float) -> Selection:
    while len(selection.chosen) > MIN_POSITIONS:
        order, losses = selection.by_rising_loss()
        # The position whose removal costs least is tried first; if it is needed, so are all others.
        if selection.value + losses[0] > wanted:
            break
        selection = selection.with_removed(order[0])
    return selection


def _unattainable(wanted_mm: float, floor_mm: float, positions: int) -> DataError:
    return DataError(
        f"a VCE of {1e3 * wanted_mm:.2f} µm cannot be reached: with all {positions} measurable positions "
        f"{1e3 * floor_mm:.2f} µm remain",
        hint="noise, certificate and errors that no table can represent remain; use more touches, a better "
        "certificate or a larger target",
        key="target-vce",
    )


def _too_few(found: int, wanted: int) -> DataError:
    return DataError(
        f"only {found} positions can be measured, but {wanted} were requested",
        hint="use a finer grid or more stations",
        key="positions",
    )
