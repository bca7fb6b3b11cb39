"""Design of an artefact with its mount and its position set: search among variants, and a full design of the best."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from agent.errors import PlanRefused
from agent.planning.design.artefact_effects import PropertyEffect, property_effects
from agent.planning.design.artefact_screening import ScreenedVariant, Screening
from agent.planning.design.artefact_search import VariantSearch, euro_front
from agent.planning.design.artefact_variants import ArtefactVariant
from agent.planning.design.design_problem import DesignProblem
from agent.planning.design.design_result import (
    DesignResult,
    Prove,
    VariantDesign,
    find_design,
    proved_design,
    refuse_fixed_stations,
    with_free_stations,
)
from agent.planning.design.variants import Variant
from agent.planning.run_minutes import STATION_CHANGES
from drivers.errors import InputError, UserError
from twin.design.goals import TimeSlotGoal

_MOST_FINALISTS = 3  # times the number of finalists, if all before collide


@dataclass(frozen=True, eq=False)
class DesignedVariant:
    """Variant of artefact and mount with its designed position set.

    `purchase` is its purchase in euro by part, and `run_euro` the cost of a run. If no set can be measured within the
    slot, or if the bar would collide, `design` is None and `reason` says why.
    """

    variant: ArtefactVariant
    purchase: Mapping[str, float]
    design: DesignResult | None = None
    run_euro: float = 0.0
    reason: str = ""

    @property
    def purchase_euro(self) -> float:
        return sum(self.purchase.values())

    @property
    def result(self) -> DesignResult:
        """Designed position set. Raises ValueError with the text `reason` if there is none."""
        if self.design is None:
            raise ValueError(self.reason)
        return self.design

    @property
    def vce_um(self) -> float:
        return self.result.valuation.after.aligned_um


@dataclass(frozen=True, eq=False)
class ArtefactDesign:
    """Result of the design of an artefact with its mount.

    `present` is the present equipment, bought anew, with a position set designed for the same slot; `finalists` are the
    variants that were designed completely, and `best` is the best of them, perhaps with other places of its stations.
    `screened` contains all variants that were screened, in this order. `changes` contains those of them that differ
    from `best` in one property, and `screened_best` is the result of screening `best`. `exhausted` is True if the
    search ended before it was complete.
    """

    present: DesignedVariant
    finalists: tuple[DesignedVariant, ...]
    best: DesignedVariant
    screened: tuple[ScreenedVariant, ...]
    screened_best: ScreenedVariant
    changes: tuple[ScreenedVariant, ...]
    exhausted: bool

    @property
    def euro_front(self) -> tuple[ScreenedVariant, ...]:
        """Screened variants that no other one beats both in purchase and in error."""
        return euro_front(self.screened)

    @property
    def effects(self) -> tuple[PropertyEffect, ...]:
        """Effect of each of `changes` on the expected error, over all screened variants."""
        return property_effects(self.best.variant, self.changes, self.screened)

    @property
    def refused(self) -> tuple[ScreenedVariant, ...]:
        """Screened variants that cannot be measured, with the reason of each."""
        return tuple(one for one in self.screened if not one.measurable)


@dataclass(frozen=True, eq=False)
class ArtefactDesigner:
    """Design of an artefact with its mount for runs that fit the slot of `search`.

    The `finalists` best screened variants are designed completely, with positions of a grid of `grid_deg`. `prove`
    carries out the preflight of the set of the best one. `say` is called with the name of the current activity.
    """

    search: VariantSearch
    grid_deg: float
    finalists: int
    prove: Prove
    say: Callable[[str], None]

    @property
    def _screening(self) -> Screening:
        return self.search.screening

    @property
    def _goal(self) -> TimeSlotGoal:
        return TimeSlotGoal(self._screening.slot_minutes)

    def run(self, *, free_stations: bool) -> ArtefactDesign:
        """Return the best artefact and mount that were found. If `free_stations` is True, the places of the stations of
        the best one are improved as well.

        Raises InputError if the budget or the slot is too small, and the error of the best variant if none of the
        finalists can be measured without a collision.
        """
        if free_stations:
            refuse_fixed_stations(self._screening.present.job)
        own = self._screening.present.variant
        # the run with the present equipment shows what a change gains, whether it is within the budget or not
        self._screening.result(own)
        affordable = self.search.run()
        finalists = [self._designed(one.variant) for one in affordable[: self.finalists]]
        for one in affordable[self.finalists : _MOST_FINALISTS * self.finalists]:
            if any(found.design is not None for found in finalists):
                break
            finalists.append(self._designed(one.variant))
        present = next((one for one in finalists if one.variant == own), None) or self._designed(own)
        exhausted = self.search.exhausted
        best, changes = self._improved(finalists)
        if free_stations:
            best = self._with_free_stations(best)
        return ArtefactDesign(
            present=present,
            finalists=tuple(finalists),
            best=best,
            screened=self._screening.screened,
            screened_best=self._screening.result(best.variant),
            changes=changes,
            exhausted=exhausted,
        )

    def _improved(self, finalists: list[DesignedVariant]) -> tuple[DesignedVariant, tuple[ScreenedVariant, ...]]:
        """Return the best of `finalists` whose preflight passes, and the results of screening the variants that differ
        from it in one property. Of those that cost no more than the budget and screen better than it, the best one is
        designed too and becomes a finalist, until it is not better or there is none."""
        former = None
        while True:
            best = self._proved(finalists)
            changes = tuple(self._screening.result(one) for one in self.search.changes(best.variant))
            known = {one.variant for one in finalists}
            rivals = [one for one in self.search.affordable(changes) if one.variant not in known]
            own_um = self._screening.result(best.variant).vce_um
            if best.variant == former or not rivals or not rivals[0].vce_um < own_um:
                return best, changes
            former = best.variant
            finalists.append(self._designed(rivals[0].variant))

    def _designed(self, variant: ArtefactVariant) -> DesignedVariant:
        try:
            job = self._screening.present.job_of(variant)
            problem = DesignProblem({job.settings.tool: job}, self.grid_deg, self._screening.plan_of)
            found = find_design(problem, self._goal, verify=False, prove=None, say=self.say)
        except UserError as error:
            return DesignedVariant(variant, self._purchase(variant), reason=error.message)
        return self._valued(variant, found)

    def _valued(self, variant: ArtefactVariant, found: DesignResult) -> DesignedVariant:
        carrying = found.minutes_by_phase.by_phase[STATION_CHANGES]
        equipment = self._screening.present.equipment(variant)
        run_euro = self._screening.costs.run_euro(equipment, found.minutes, carrying)
        return DesignedVariant(variant, self._purchase(variant), found, run_euro)

    def _purchase(self, variant: ArtefactVariant) -> Mapping[str, float]:
        return self._screening.costs.purchase(self._screening.present.equipment(variant))

    def _proved(self, finalists: list[DesignedVariant]) -> DesignedVariant:
        """Return the best of `finalists` whose preflight passes. What the preflight changes is changed in the list too.
        Raises InputError if no finalist can be measured."""
        while True:
            ranked = [number for number, one in enumerate(finalists) if one.design is not None]
            if not ranked:
                raise InputError(
                    f"none of the {len(finalists)} best variants can be measured without a collision: "
                    f"{finalists[0].reason}",
                    hint="allow other rotation centres or heights, or more finalists",
                    key="--finalists",
                )
            number = min(ranked, key=lambda number: finalists[number].vce_um)
            best = finalists[number]
            if best.result.preflight_passed:
                return best
            try:
                proved = proved_design(best.result, self._goal, verify=False, prove=self.prove, say=self.say)
                finalists[number] = self._valued(best.variant, proved)
            except (UserError, PlanRefused) as error:
                finalists[number] = replace(best, design=None, reason=error.message)

    def _with_free_stations(self, best: DesignedVariant) -> DesignedVariant:
        """Return a better design of the same variant with other places of its stations, or `best`."""
        job = best.result.problem.job
        touches = job.settings.procedure.touches_per_ball
        made_up = Variant(touches, best.variant.balls, best.variant.tilt_deg, {job.settings.tool: job}, made_up=True)
        choice = VariantDesign(made_up, best.result)
        moved, _ = with_free_stations(choice, self._goal, verify=False, prove=self.prove, say=self.say)
        if moved is choice:
            return best
        try:
            proved = proved_design(moved.result, self._goal, verify=False, prove=self.prove, say=self.say)
        except (UserError, PlanRefused):
            return best
        return self._valued(best.variant, proved) if proved.valuation.after.aligned_um < best.vce_um else best
