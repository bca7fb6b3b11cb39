"""Greedy search for a set of artefact positions to be measured. The search adds the best position repeatedly, and then
exchanges positions as long as an exchange lowers the expected error.

The gain of each position (decrease of the expected error) is computed exactly at every step. Lazy evaluation, which
reuses old gains as upper bounds, is not used. It assumes that gains can only fall, but under this criterion (trace of
the covariance multiplied by a quadratic form) one position may increase the gain of another. Lazy evaluation would also
save little time, because `InformationState`, which stores the covariance, updates all gains at once.
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
"""Function that takes the chosen indices and returns the mask (N,) of the candidates that may still be added."""

_MIN_DECREASE = 1e-9  # relative decrease of the value below which an exchange is not made
# a guard: designs of the case study take two to four rounds
_MAX_ROUNDS = 10
_ALL_CANDIDATES = 200  # up to this number all candidates take part in an exchange


@dataclass(frozen=True, eq=False)
class Selection:
    """Candidate positions chosen for measurement, and the covariance of the unknowns (`information`) after they have
    been measured."""

    chosen: tuple[int, ...]
    information: InformationState

    @classmethod
    def of(cls, candidates: CandidatePositions, chosen: Sequence[int] = ()) -> Selection:
        covariance = candidates.covariance(chosen)
        return cls(tuple(chosen), InformationState.initial(candidates.factors, candidates.form.aligned, covariance))

    @property
    def value(self) -> float:
        """Expected mean square in mm² of the error field that remains after the chosen positions have been measured and
        the machine has been compensated, after the best-fitting rigid motion has been removed.

        Errors of the machine whose wavelength is too short for the model of the misfit are not included, since they are
        the same for all position sets.
        """
        return self.information.value

    @property
    def free(self) -> Mask:
        """Mask (N,) of the N candidates that is True for those that are not chosen."""
        free = np.ones(len(self.information.factors), dtype=bool)
        free[list(self.chosen)] = False
        return free

    def with_added(self, index: int) -> Selection:
        return Selection((*self.chosen, index), self.information.after_adding(self.information.factors[index]))

    def with_removed(self, index: int) -> Selection:
        kept = tuple(other for other in self.chosen if other != index)
        return Selection(kept, self.information.after_removing(self.information.factors[index]))

    def by_rising_loss(self) -> tuple[list[int], Array]:
        """Return the indices of the chosen candidates, sorted by rising loss, and the sorted losses. The loss of a
        candidate is the increase of `value` (expected mean square error in mm²) if the candidate is removed."""
        losses = self.information.losses(np.array(self.chosen, dtype=np.intp))
        order = np.argsort(losses, kind="stable")
        return [self.chosen[rank] for rank in order], losses[order]


@dataclass(frozen=True, eq=False)
class ExchangeSearch:
    """Search for the best artefact positions among `candidates`: greedy addition of positions, followed by exchange.
    `costs` gives the machine time of each candidate.

    `is_measurable` is a function that takes the index of a candidate and returns True if the candidate can really be
    measured. The function is slow and is therefore called only for the best candidates. The exchange ends after a round
    in which the value of the selection (expected mean square error) decreases by less than the fraction
    `min_improvement`.
    """

    candidates: CandidatePositions
    costs: MeasuringCosts
    is_measurable: Callable[[int], bool] = lambda _: True
    min_improvement: float = 5e-3

    def grow(self, selection: Selection, room: FeasibleMask, *, per_minute: bool) -> Iterator[Selection]:
        """Yield selections of positions of growing size. Each selection has one more position than the previous
        selection.

        The added position is the feasible position with the largest gain or, if `per_minute` is True, with the largest
        gain per minute. A position is feasible if it can be measured and `room` allows it. The function `room` takes
        the chosen indices and returns a mask of the candidates that may still be added. The search stops if no feasible
        position has a gain.
        """
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
        """Replace each chosen position by the best feasible candidate if the replacement lowers the value of the
        selection, the expected mean square error (Fedorov's exchange). A candidate is feasible if it can be measured
        and the function `room` allows it.

        Chosen positions are tried in the order of rising loss (increase of the value if the position is removed). Each
        round considers only the most promising candidates.
        """
        for _ in range(_MAX_ROUNDS):
            before = selection.value
            chosen = self._round(selection, room)
            selection = Selection.of(self.candidates, chosen)
            if selection.value > before * (1.0 - max(self.min_improvement, _MIN_DECREASE)):
                break
        return selection

    def _round(self, selection: Selection, room: FeasibleMask) -> tuple[int, ...]:
        kept = self._promising(selection)
        local = {int(index): number for number, index in enumerate(kept)}
        near = Selection(tuple(local[index] for index in selection.chosen), selection.information.restricted_to(kept))
        for index in near.by_rising_loss()[0]:
            near = self._exchange_one(near, index, room, kept)
        return tuple(int(kept[index]) for index in near.chosen)

    def _promising(self, selection: Selection) -> Indices:
        """Return the chosen positions together with the free candidates that have the largest gains, in candidate
        order.

        The number of free candidates is half the number of all candidates. It is raised to `_ALL_CANDIDATES` if there
        are that many.
        """
        # chosen positions come first whatever their gain, since an exchange needs their factors
        gains = np.where(selection.free, selection.information.gains(), np.inf)
        count = max(len(gains) // 2, min(len(gains), _ALL_CANDIDATES)) + len(selection.chosen)
        return np.sort(np.argsort(-gains, kind="stable")[:count])

    def _exchange_one(self, selection: Selection, index: int, room: FeasibleMask, kept: Indices) -> Selection:
        """Return the selection after one position has been exchanged, or the given selection if no exchange lowers the
        value. `kept` (n,) contains the candidate index for each index of the selection."""
        rest = selection.with_removed(index)
        # The gain of the candidate, seen from the selection without the removed position, must exceed the loss by the
        # removal.
        needed = rest.value - selection.value * (1.0 - _MIN_DECREASE)
        allowed = room([int(kept[other]) for other in rest.chosen])[kept] & selection.free
        best = self._best(rest.information.gains(), allowed, needed, kept)
        return selection if best is None else rest.with_added(best)

    def _best(self, worth: Array, allowed: Mask, above: float, kept: Indices | None = None) -> int | None:
        """Return the allowed and measurable candidate with the largest value of `worth`. Return None if no allowed and
        measurable candidate has a worth above `above`."""
        left = np.where(allowed, worth, -np.inf)
        while left[best := int(np.argmax(left))] > above:
            if self.is_measurable(best if kept is None else int(kept[best])):
                return best
            left[best] = -np.inf
        return None
