"""Search for the variants of artefact and mount that are worth a full design.

Brute force over all combinations would take days. The search changes one property at a time, to the value with the
best score, until no change helps (coordinate descent). It begins with the best variant within the budget, then follows
the trade between error and purchase with several prices of the error, and ends with the budget again, from the best
variant known. All results are kept, so that the later descents need few new ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from operator import itemgetter
from typing import Any

from agent.planning.design.artefact_screening import ScreenedVariant, Screening
from agent.planning.design.artefact_variants import ArtefactVariant, RotationCentre
from drivers.errors import InputError
from twin.artefact.ball_spacing import BallSpacing

_WEIGHTS = (0.3, 1.0, 3.0)
"""Weights of the purchase against the error: the logarithm of the error that the whole budget is worth."""

_MIN_DECREASE = 1e-6


@dataclass(frozen=True)
class VariantChoices:
    """Values among which the search chooses each property of a variant, see `ArtefactVariant`. The order of the fields
    is that in which they are tried: the properties with the largest effect come first."""

    balls: tuple[int, ...]
    length_mm: tuple[float, ...]
    stations: tuple[int, ...]
    centre: tuple[RotationCentre, ...]
    height_mm: tuple[float, ...]
    across_mm: tuple[float, ...]
    spacing: tuple[BallSpacing, ...]
    tilt_deg: tuple[float, ...]
    stated_mm: tuple[tuple[float, ...], ...] = ((),)

    def of(self, name: str) -> tuple[Any, ...]:
        """Return the values of the property called `name`."""
        values: tuple[Any, ...] = getattr(self, name)
        return values

    def one_changed(self, variant: ArtefactVariant, name: str) -> tuple[ArtefactVariant, ...]:
        """Return the variants that differ from `variant` in the property called `name` alone."""
        changed = (replace(variant, **{name: value}) for value in self.of(name))
        return tuple(one for one in changed if one != variant)

    def allow(self, variant: ArtefactVariant) -> bool:
        """Return True if all properties of `variant` are among the choices."""
        return all(getattr(variant, name) in self.of(name) for name in PROPERTIES)

    def nearest(self, variant: ArtefactVariant) -> ArtefactVariant:
        """Return `variant` with each property that is not among the choices replaced: a number by the nearest one, any
        other by the first one."""
        for name in PROPERTIES:
            values, own = self.of(name), getattr(variant, name)
            if own not in values:
                numbers = isinstance(own, int | float)
                other = min(values, key=lambda value: abs(value - own)) if numbers else values[0]
                variant = replace(variant, **{name: other})
        return variant

    def cheapest(self, like: ArtefactVariant, price: Callable[[ArtefactVariant], float]) -> ArtefactVariant:
        """Return the variant with the least `price`; the prices of the properties add up."""
        for name in PROPERTIES:
            like = min((replace(like, **{name: value}) for value in self.of(name)), key=price)
        return like


PROPERTIES = tuple(field.name for field in fields(VariantChoices))
"""Names of the properties of a variant, in the order in which they are tried."""


@dataclass(frozen=True, eq=False)
class VariantSearch:
    """Search among `choices` for variants that cost at most `budget_euro`. At most `most` variants are screened."""

    screening: Screening
    choices: VariantChoices
    budget_euro: float
    most: int

    def run(self) -> tuple[ScreenedVariant, ...]:
        """Return the measurable variants within the budget, by rising error.

        Raises InputError if the cheapest variant costs more than the budget, or if none within the budget can be
        measured within the slot.
        """
        start = self._start()
        self._descend(start, None)
        at = self.choices.nearest(self.screening.present.variant)
        for weight in _WEIGHTS:
            at = self._descend(at, weight)
        found = self.affordable(self.screening.screened)
        if found:
            self._descend(found[0].variant, None)
            found = self.affordable(self.screening.screened)
        if not found:
            self._raise_nothing_measurable()
        return found

    def changes(self, variant: ArtefactVariant) -> Iterator[ArtefactVariant]:
        """Yield the variants that differ from `variant` in one property."""
        for name in PROPERTIES:
            yield from self.choices.one_changed(variant, name)

    @property
    def exhausted(self) -> bool:
        """True if the search has ended because `most` variants are screened."""
        return len(self.screening.screened) >= self.most

    def _start(self) -> ArtefactVariant:
        """Return the variant nearest to the present one or, if it costs more than the budget, the cheapest one."""
        present, price = self.screening.present.variant, self.screening.purchase_euro
        allowed = self.choices.nearest(present)
        if price(allowed) <= self.budget_euro:
            return allowed
        cheapest = self.choices.cheapest(present, price)
        if price(cheapest) > self.budget_euro:
            raise InputError(
                f"{self.budget_euro:g} € are too little: the cheapest artefact and mount that may be chosen cost "
                f"{math.ceil(price(cheapest))} €",
                hint="raise the budget, allow fewer balls, fewer stations or a shorter bar, or correct the costs",
                key="--budget",
            )
        return cheapest

    def _descend(self, variant: ArtefactVariant, weight: float | None) -> ArtefactVariant:
        """Return the variant at which no change of one property lowers the score, see `_score`."""
        best = (self._score(variant, weight), variant)
        while True:
            before = best[0]
            for name in PROPERTIES:
                for changed in self.choices.one_changed(best[1], name):
                    best = min(best, (self._score(changed, weight), changed), key=itemgetter(0))
            if not best[0] < before - _MIN_DECREASE:
                return best[1]

    def _score(self, variant: ArtefactVariant, weight: float | None) -> float:
        """Return the logarithm of the expected error, and the share of the budget that the purchase takes times
        `weight`. If `weight` is None, the purchase does not count, but a variant beyond the budget is not screened."""
        share = self.screening.purchase_euro(variant) / self.budget_euro
        found = None if weight is None and share > 1.0 else self._screened(variant)
        return math.inf if found is None else math.log(found.vce_um) + (weight or 0.0) * share

    def _screened(self, variant: ArtefactVariant) -> ScreenedVariant | None:
        """Return the result of screening `variant`, or None if `most` others are screened."""
        if self.exhausted and not self.screening.known(variant):
            return None
        return self.screening.result(variant)

    def affordable(self, screened: Iterable[ScreenedVariant]) -> tuple[ScreenedVariant, ...]:
        """Return those of `screened` that may be chosen, can be measured, and cost at most the budget, by rising
        error."""
        every = (one for one in screened if self.choices.allow(one.variant))
        within = (one for one in every if one.measurable and one.purchase_euro <= self.budget_euro)
        return tuple(sorted(within, key=lambda one: (one.vce_um, one.purchase_euro)))

    def _raise_nothing_measurable(self) -> None:
        reasons = [one.reason for one in self.screening.screened if one.reason]
        raise InputError(
            f"no artefact within {self.budget_euro:g} € can be measured in {self.screening.slot_minutes:g} min; "
            f"the first was refused because {reasons[0]}",
            hint="allow a longer slot or a larger budget, or allow other values of the properties",
            key="--slot",
        )


def euro_front(screened: Sequence[ScreenedVariant]) -> tuple[ScreenedVariant, ...]:
    """Return the variants that no other one beats both in purchase and in error, by rising purchase."""
    front: list[ScreenedVariant] = []
    for one in sorted(screened, key=lambda one: (one.purchase_euro, one.vce_um)):
        if one.measurable and (not front or one.vce_um < front[-1].vce_um):
            front.append(one)
    return tuple(front)
