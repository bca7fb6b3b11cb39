"""Mechanical actions that an estimate file proposes, in words and as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.files import translated
from agent.model_files import load_machine
from agent.workpiece.estimate_and_table import read_estimate_and_table
from drivers.errors import InputError
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import AXES
from twin.machine.mounting import Mounting
from twin.units import UM_PER_MM
from twin.workpiece.action_fields import ActionKind, MechanicalAction
from twin.workpiece.mechanical_actions import ActionPlan, VolumetricState, plan_actions

UM_PER_M = 1e6
"""Micrometres per metre, or microradians, of an amount of 1."""
AT_THIS_TEMPERATURE = (
    "A scale is that of the machine's temperature during the measurement: a steel scale changes by about 11 µm/m per K."
)
_DIGITS = 3
_LEAST_HEIGHT_MM = 5e-4  # a smaller one would be stated as 0


@dataclass(frozen=True)
class ProposedActions:
    """Plan of actions on the machine of the file `estimate`. `unknown_guides` are the axes whose guides were not
    stated."""

    estimate: Path
    plan: ActionPlan
    unknown_guides: tuple[str, ...]

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
                    "travel_mm": action.travel_mm,
                    **_amounts(action),
                    "text": action_text(action),
                    "ve_after": _state(state),
                }
                for action, state in zip(self.plan.actions, after, strict=True)
            ],
        }


def propose_actions(
    estimate: Path, most: int, tool_offset_mm: tuple[float, float, float] | None, machine: Path | None = None
) -> ProposedActions:
    """Return the actions that the estimate of a file, or of the folder of a run, proposes.

    `machine` is the machine file that states guides and feet, None without one.

    Raises InputError, which names the file and the key, if a file is invalid or describes another machine.
    """
    known = read_estimate_and_table(estimate, None, True, tool_offset_mm)
    mounting = Mounting() if machine is None else _mounting(machine, known.estimate.model)
    with translated(file=str(estimate)):
        plan = plan_actions(known.estimate, known.tool_offset_mm, most, mounting)
    return ProposedActions(estimate, plan, tuple(axis for axis in AXES if axis not in mounting.guides))


def unknown_guides_text(axes: tuple[str, ...]) -> str:
    """Return which rails are not straightened because nothing is known about their guides; empty if none."""
    if not axes:
        return ""
    return (
        f"Shims under the rails of {', '.join(axes)} are not proposed: a shim also tilts the carriage. State the "
        f"distance of its shoes in the machine file (axes.{axes[0]}.guide), and name this file with --machine."
    )


def action_text(action: MechanicalAction) -> str:
    """Return what to do at the machine, in words."""
    if action.kind is ActionKind.STRAIGHTNESS:
        return _shims_text(action)
    if action.kind is ActionKind.LEVEL:
        return _level_text(action)
    over = f"{UM_PER_MM * abs(action.over_travel_mm):.1f} µm"
    if action.kind is ActionKind.SCALE:
        verb = "lengthen" if action.amount > 0.0 else "shorten"
        return f"{verb} the scale of {action.axis}: {over} over {action.travel_mm:g} mm"
    sign = "+" if action.amount > 0.0 else "-"
    return (
        f"turn the guide of {action.axis}: over {action.travel_mm:g} mm towards +{action.axis}, the tool must move "
        f"{over} further towards {sign}{action.towards} relative to the workpiece"
    )


def amount_texts(action: MechanicalAction) -> tuple[str, str]:
    """Return the amounts of an action and their expanded uncertainties (k = 2), with their unit."""
    if action.kind is ActionKind.STRAIGHTNESS:
        amounts = ", ".join(f"{UM_PER_MM * shim.amount_mm:.1f}" for shim in action.shims)
        bounds = ", ".join(f"{UM_PER_MM * shim.expanded_mm:.1f}" for shim in action.shims)
        return f"{amounts} µm", f"± {bounds} µm"
    return f"{UM_PER_M * action.amount:+.1f} µm/m", f"± {UM_PER_M * action.expanded:.1f} µm/m"


def _shims_text(action: MechanicalAction) -> str:
    """Return where a guide is to be shimmed by how much."""
    first, *between, last = (f"{UM_PER_MM * shim.amount_mm:.1f} µm" for shim in action.shims)
    # Values alone, so that the list is the same in each language.
    places = (f" ({action.axis} = {shim.at_mm:.0f} mm)" for shim in action.shims[1:-1])
    shims = ", ".join([first, *map("".join, zip(between, places, strict=True)), last])
    return f"straighten the guide of {action.axis} with shims towards +{action.towards}, from end to end: {shims}"


def _level_text(action: MechanicalAction) -> str:
    low_mm, high_mm = action.low_mm, action.low_mm + action.travel_mm
    half = 0.5 * UM_PER_M * action.amount
    roll = (
        f"level the guide of {action.axis}: roll about +{action.axis} by {-half:+.1f} µm/m at {action.axis} = "
        f"{low_mm:.0f} mm and {half:+.1f} µm/m at {high_mm:.0f} mm"
    )
    raised = [foot for foot in action.feet if foot.height_mm > _LEAST_HEIGHT_MM]
    if not raised:
        return roll
    feet = ", ".join(f"{foot.name}: {UM_PER_MM * foot.height_mm:.0f} µm" for foot in raised)
    return f"{roll}; raise these feet of the bed: {feet}"


def _amounts(action: MechanicalAction) -> dict[str, Any]:
    """Return the amounts of an action by their names in the JSON object."""
    if action.kind is ActionKind.STRAIGHTNESS:
        shims = [
            {
                "at_mm": round(shim.at_mm, _DIGITS),
                "amount_um": round(UM_PER_MM * shim.amount_mm, _DIGITS),
                "expanded_um": round(UM_PER_MM * shim.expanded_mm, _DIGITS),
            }
            for shim in action.shims
        ]
        return {"shims": shims}
    found: dict[str, Any] = {
        "amount_um_per_m": round(UM_PER_M * action.amount, _DIGITS),
        "expanded_um_per_m": round(UM_PER_M * action.expanded, _DIGITS),
    }
    if action.kind is ActionKind.LEVEL:
        feet = {foot.name: round(UM_PER_MM * foot.height_mm, _DIGITS) for foot in action.feet}
        return found | {"raised_feet_um": feet}
    return found | {"over_travel_um": round(UM_PER_MM * action.over_travel_mm, _DIGITS)}


def _mounting(machine: Path, model: ErrorModel) -> Mounting:
    """Return the guides and feet of a machine file. Raises InputError if it describes another machine than `model`."""
    described = load_machine(machine)
    if (described.model.chain, described.model.ranges_mm) != (model.chain, model.ranges_mm):
        raise InputError(
            "the machine file describes another machine than the estimate: its chain or its axis ranges differ",
            hint="Name the machine file with which the machine was measured",
            file=str(machine),
        )
    return described.mounting


def _state(state: VolumetricState) -> dict[str, Any]:
    return {
        "expected_um": round(UM_PER_MM * state.expected_mm, _DIGITS),
        "limits_um": [round(UM_PER_MM * one, _DIGITS) for one in (state.low_mm, state.high_mm)],
    }
