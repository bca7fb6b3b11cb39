"""Comparison of position sets designed for several measuring variants (tools, touches per ball, bars). The design that
meets the goal of the design best is marked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from agent.planning.design.design_problem import DesignProblem
from agent.planning.design.design_result import DesignResult, Prove, Say, find_design
from agent.planning.design.variants import Variant
from drivers.errors import UserError
from twin.design.goals import Goal, TargetErrorGoal


@dataclass(frozen=True, eq=False)
class VariantDesign:
    """Position set designed for one measuring variant.

    If the goal of the design cannot be reached with this variant, `design` is None and `reason` states the cause.
    `best` is True for the best of the designs compared.
    """

    variant: Variant
    design: DesignResult | None
    reason: str = ""
    best: bool = False

    @property
    def result(self) -> DesignResult:
        """Position set designed for this variant. Raises ValueError with the text `reason` if `design` is None."""
        if self.design is None:
            raise ValueError(self.reason)
        return self.design


def compare_variants(
    variants: Sequence[Variant], goal: Goal, grid_deg: float, *, verify: bool, prove: Prove, say: Say
) -> list[VariantDesign]:
    """Return a designed position set for each variant, and mark the best design. `prove` carries out the preflight of
    a design.

    If `goal` is a target error, the best design is the one that takes the least machine time. For any other goal, the
    best design is the one with the smallest expected volumetric error after compensation (VCE). If no variant reaches
    the goal, the error raised for the first variant is raised.
    """
    choices: list[VariantDesign] = []
    errors: list[UserError] = []
    for variant in variants:
        try:
            problem = DesignProblem(variant.jobs, grid_deg)
            found = find_design(problem, goal, verify=verify, prove=None if variant.made_up else prove, say=say)
            choices.append(VariantDesign(variant, found))
        except UserError as error:
            errors.append(error)
            choices.append(VariantDesign(variant, None, error.message))
    if len(errors) == len(choices):
        raise errors[0]
    reached = [number for number, choice in enumerate(choices) if choice.design is not None]
    best = min(reached, key=lambda number: _rank(choices[number].result, goal))
    choices[best] = replace(choices[best], best=True)
    return choices


def _rank(found: DesignResult, goal: Goal) -> tuple[float, float]:
    vce, minutes = found.valuation.after.aligned_mm, found.minutes
    return (minutes, vce) if isinstance(goal, TargetErrorGoal) else (vce, minutes)
