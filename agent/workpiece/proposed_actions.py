"""Mechanical actions that an estimate file proposes, in words and as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.files import translated
from agent.workpiece.estimate_and_table import read_estimate_and_table
from twin.units import UM_PER_MM
from twin.workpiece.mechanical_actions import (
    ActionKind,
    ActionPlan,
    MechanicalAction,
    VolumetricState,
    plan_actions,
)

UM_PER_M = 1e6
"""Micrometres per metre, or microradians, of an amount of 1."""
AT_THIS_TEMPERATURE = (
    "A scale is that of the machine's temperature during the measurement: a steel scale changes by about 11 µm/m per K."
)
_DIGITS = 3


@dataclass(frozen=True)
class ProposedActions:
    """Plan of actions on the machine of the file `estimate`."""

    estimate: Path
    plan: ActionPlan

    def as_json(self) -> dict[str, Any]:
        """Return the plan as a JSON object, with volumetric errors in µm and amounts in µm/m."""
        before, *after = self.plan.states
        return {
            "estimate": str(self.estimate),
            "ve_before": _state(before),
            "actions": [
                {
                    "kind": action.kind.value,
                    "axis": action.axis,
                    "towards": action.towards,
                    "amount_um_per_m": round(UM_PER_M * action.amount, _DIGITS),
                    "expanded_um_per_m": round(UM_PER_M * action.expanded, _DIGITS),
                    "travel_mm": action.travel_mm,
                    "over_travel_um": round(UM_PER_MM * action.over_travel_mm, _DIGITS),
                    "text": action_text(action),
                    "ve_after": _state(state),
                }
                for action, state in zip(self.plan.actions, after, strict=True)
            ],
        }


def propose_actions(estimate: Path, most: int, tool_offset_mm: tuple[float, float, float] | None) -> ProposedActions:
    """Return the actions that the estimate of a file, or of the folder of a run, proposes.

    Raises InputError, which names the file and the key, if the file is invalid.
    """
    known = read_estimate_and_table(estimate, None, True, tool_offset_mm)
    with translated(file=str(estimate)):
        plan = plan_actions(known.estimate, known.tool_offset_mm, most)
    return ProposedActions(estimate, plan)


def action_text(action: MechanicalAction) -> str:
    """Return what to turn, in words."""
    over = f"{UM_PER_MM * abs(action.over_travel_mm):.1f} µm"
    if action.kind is ActionKind.SCALE:
        verb = "lengthen" if action.amount > 0.0 else "shorten"
        return f"{verb} the scale of {action.axis}: {over} over {action.travel_mm:g} mm"
    sign = "+" if action.amount > 0.0 else "-"
    return (
        f"turn the guide of {action.axis}: over {action.travel_mm:g} mm towards +{action.axis}, the tool must move "
        f"{over} further towards {sign}{action.towards} relative to the workpiece"
    )


def _state(state: VolumetricState) -> dict[str, Any]:
    return {
        "expected_um": round(UM_PER_MM * state.expected_mm, _DIGITS),
        "limits_um": [round(UM_PER_MM * one, _DIGITS) for one in (state.low_mm, state.high_mm)],
    }
