"""The search: add the best position again and again, then exchange while that helps.

Every gain is exact at every step. Lazy evaluation, which trusts that gains only fall, is not used: for the trace
criterion a position may gain from another one, so it would be wrong, and with `InformationState` it would save little.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.design.candidates import CandidatePositions, Indices
from twin.design.information import InformationState
from twin.design.measuring_cost import MeasuringCosts

Mask = NDArray[np.bool_]
FeasibleMask = Callable[[Sequence[int]], Mask]
"""Which candidates (N,) there is room for beside those already chosen."""

_BETTER = 1e-9  # relative fall of the value below which an exchange is not worth making
_MOST_ROUNDS = 10
_LOOKED_AT = 200  # candidates of which none is left out of an exchange


@dataclass(frozen=True, eq=False)
class Selection:
    """Some of the candidates and what is known once they are measured."""

    chosen: tuple[int, ...]
    information: InformationState

    @classmethod
    def of(cls, candidates: CandidatePositions, chosen: Sequence[int] = ()) -> Selection:
        covariance = candidates.covariance(chosen)
        return cls(tuple(chosen), InformationState.initial(candidates.factors, candidates.form.aligned, covariance))

    @property
    def value(self) -> float:
        """mm²: expected mean square of the aligned field that stays, as far as sets differ in it."""
        return self.information.value

    @property
    def free(self) -> Mask:
        """(N,) candidates that are not chosen."""
        free = np.ones(len(self.information.factors), dtype=bool)
        free[list(self.chosen)] = False
        return free

    def with_added(self, index: int) -> Selection:
        return Selection((*self.chosen, index), self.information.after_adding(self.information.factors[index]))

    def with_removed(self, index: int) -> Selection:
        kept = tuple(other for other in self.chosen if other != index)
        return Selection(kept, self.information.after_removing(self.information.factors[index]))

    def by_rising_loss(self) -> tuple[list[int], Array]:
        """The chosen ones, the most dispensable first, and by how much the value rises without each."""
        losses = self.information.losses(np.array(self.chosen, dtype=np.intp))
        order = np.argsort(losses, kind="stable")
        return [self.chosen[place] for place in order], losses[order]


@dataclass(frozen=True, eq=False)
class ExchangeSearch:
    """Greedy search with exchange over `candidates`.

    `is_measurable` checks if a candidate can really be measured; the check is expensive, so it is made late.
    The search stops after a round of exchanges that lowers the value by less than the share `min_improvement`.
    """

    candidates: CandidatePositions
    costs: MeasuringCosts
    is_measurable: Callable[[int], bool] = lambda _: True
    min_improvement: float = 5e-3

    def grow(self, selection: Selection, room: FeasibleMask, *, per_minute: bool) -> Iterator[Selection]:
        """Selections of one position more each, always the best by gain, or by gain per minute; ends when there is no
        room."""
        while True:
            worth = selection.information.gains()
            if per_minute:
                worth = worth / self.costs.marginal(selection.chosen)
            best = self._best(worth, room(selection.chosen) & selection.free, 0.0)
            if best is None:
                return
            selection = selection.with_added(best)
            yield selection

    def exchange(self, selection: Selection, room: FeasibleMask) -> Selection:
        """Each chosen position in turn, the most dispensable first, gives way to the best that there is room for, where
        that lowers the value (Fedorov's exchange). Each round looks at the candidates that promise most."""
        for _ in range(_MOST_ROUNDS):
            before = selection.value
            chosen = self._round(selection, room)
            selection = Selection.of(self.candidates, chosen)
            if selection.value > before * (1.0 - max(self.min_improvement, _BETTER)):
                break
        return selection

    def _round(self, selection: Selection, room: FeasibleMask) -> tuple[int, ...]:
        kept = self._promising(selection)
        place = {int(index): here for here, index in enumerate(kept)}
        near = Selection(tuple(place[index] for index in selection.chosen), selection.information.restricted_to(kept))
        for index in near.by_rising_loss()[0]:
            near = self._given_way(near, index, room, kept)
        return tuple(int(kept[index]) for index in near.chosen)

    def _promising(self, selection: Selection) -> Indices:
        """The chosen ones and the half of all others that would gain most now, in the order of the candidates."""
        gains = np.where(selection.free, selection.information.gains(), np.inf)
        count = max(len(gains) // 2, min(len(gains), _LOOKED_AT)) + len(selection.chosen)
        return np.sort(np.argsort(-gains, kind="stable")[:count])

    def _given_way(self, selection: Selection, index: int, room: FeasibleMask, kept: Indices) -> Selection:
        """`kept` (n,): which candidates the selection's numbers stand for."""
        rest = selection.with_removed(index)
        needed = rest.value - selection.value * (1.0 - _BETTER)
        allowed = room([int(kept[other]) for other in rest.chosen])[kept] & selection.free
        best = self._best(rest.information.gains(), allowed, needed, kept)
        return selection if best is None else rest.with_added(best)

    def _best(self, worth: Array, allowed: Mask, above: float, kept: Indices | None = None) -> int | None:
        """The candidate of most worth that is allowed, is_measurable and is worth more than `above`."""
        left = np.where(allowed, worth, -np.inf)
        while left[best := int(np.argmax(left))] > above:
            if self.is_measurable(best if kept is None else int(kept[best])):
                return best
            left[best] = -np.inf
        return None
