"""Screening of variants of artefact and mount: the expected error that a position set for the slot would leave.

The positions of a screened variant come from a coarse grid, and their paths are not checked for collisions. Machine
minutes of the run are those of `MeasuringCosts`. A design with all checks follows for the best variants only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from agent.files import translated
from agent.planning.design.artefact_costs import ArtefactCosts
from agent.planning.design.artefact_variants import ArtefactVariant, PresentEquipment
from agent.planning.design.design_problem import DesignProblem
from agent.planning.design.feasibility import FeasibilityCheck
from agent.planning.job import Planner
from drivers.errors import ConfigurationError, InputError, UserError
from twin.design.goals import TimeSlotGoal
from twin.design.search import ExchangeSearch

_TIMED = 12  # positions; estimated minutes deviate by 4.6 % rms on the case study, with 40 positions by 4.1 %


@dataclass(frozen=True)
class ScreenedVariant:
    """Screened variant of artefact and mount.

    `purchase_euro` is its purchase. `vce_um` is the expected volumetric error after compensation in µm, rigidly
    aligned, with `positions` positions of `balls` balls that a run of `minutes` measures; `run_euro` is the cost of
    this run. If the variant cannot be measured within the slot, `vce_um` is inf and `reason` says why.
    """

    variant: ArtefactVariant
    purchase_euro: float
    vce_um: float = math.inf
    minutes: float = math.nan
    run_euro: float = math.nan
    positions: int = 0
    balls: int = 0
    reason: str = ""

    @property
    def measurable(self) -> bool:
        return self.vce_um < math.inf


@dataclass(frozen=True, eq=False)
class Screening:
    """Screening of variants for runs of at most `slot_minutes` with positions of a grid of `grid_deg`.

    `plan_of` returns the plan of the run. Results are kept: `screened` contains them in the order of the requests.
    `say` is called with the number of variants before each one.
    """

    present: PresentEquipment
    costs: ArtefactCosts
    slot_minutes: float
    grid_deg: float
    plan_of: Planner
    say: Callable[[int], None] = lambda _: None
    _found: dict[ArtefactVariant, ScreenedVariant] = field(default_factory=dict, init=False, repr=False)

    @property
    def screened(self) -> tuple[ScreenedVariant, ...]:
        return tuple(self._found.values())

    def purchase_euro(self, variant: ArtefactVariant) -> float:
        return self.costs.purchase_euro(self.present.equipment(variant))

    def known(self, variant: ArtefactVariant) -> bool:
        return variant in self._found

    def result(self, variant: ArtefactVariant) -> ScreenedVariant:
        """Return the result for `variant`, which is computed on the first request."""
        if variant not in self._found:
            self.say(len(self._found))
            self._found[variant] = self._screened(variant)
        return self._found[variant]

    def _screened(self, variant: ArtefactVariant) -> ScreenedVariant:
        purchase_euro = self.purchase_euro(variant)
        try:
            job = self.present.job_of(variant)
            tool, check = job.settings.tool, FeasibilityCheck(job, _TIMED)
            problem = DesignProblem({tool: job}, self.grid_deg, self.plan_of, feasibility={tool: check})
            with translated(ConfigurationError, key="stations.places_mm"):
                candidates = problem.candidates
            search = ExchangeSearch(candidates, problem.prices(candidates))
            with translated(InputError):
                chosen = TimeSlotGoal(self.slot_minutes).select(search)
        except UserError as error:
            return ScreenedVariant(variant, purchase_euro, reason=error.message)
        costs, one_by_one = search.costs, float(search.costs.minutes[list(chosen)].sum())
        minutes = costs.total(chosen)
        carrying = minutes - one_by_one - costs.fixed_minutes
        return ScreenedVariant(
            variant=variant,
            purchase_euro=purchase_euro,
            vce_um=candidates.vce(chosen).aligned_um,
            minutes=minutes,
            run_euro=self.costs.run_euro(self.present.equipment(variant), minutes, carrying),
            positions=len(chosen),
            balls=int(candidates.balls[list(chosen)].sum()),
        )
