"""Printed table of the steps that a verification finds."""

from __future__ import annotations

from rich.table import Table

from agent.cli.printing import columns_table
from agent.probing.run_plan import position_key
from agent.runs.kinds.verification_power import FoundSteps, VerificationPower
from twin.identification.jump import ERRORS
from twin.machine.error_model import SQUARENESS
from twin.monitoring.step_power import POWER, ROTATIONS, SmallestStep, largest_of

_COLUMNS = ("verification", "positions", "min", "evidence", "squareness", "rotation", "displacement")
_OTHERS = tuple(error for error in ERRORS if error not in (*SQUARENESS, *ROTATIONS))

_NO_SQUARENESS = (
    "no squareness of this machine can change: as many positions as at the beginning of a night, "
    "those that show a jump of any error"
)


def power_table(verified: VerificationPower) -> Table:
    """Return a table of the smallest steps that a verification finds, with one row for each set of positions."""
    title = f"smallest steps found by a verification at station {verified.station} with {100.0 * POWER:.0f} %"
    table = columns_table(_COLUMNS, title=title, numbers=_COLUMNS[1:4])
    planned = verified.planned
    for found in verified.by_positions:
        more = len(found.positions) - len(planned.positions)
        name = "volcal verify" if more == 0 else f"{abs(more)} {'more' if more > 0 else 'fewer'}"
        table.add_row(name, *_cells(found))
    fewest = "fewest for any squareness or rotation"
    angles = verified.fewest_angles
    table.add_row(*((fewest, *_cells(angles)) if angles is not None else (fewest, "none", "", "", "", "", "")))
    night = f"beginning of a night ({100.0 * verified.night_false_alarm:.2g} % false alarms)"
    table.add_row(night, *_cells(verified.night))
    return table


def power_notes(verified: VerificationPower) -> str:
    """Return what `volcal verify` measures and how often it is wrong, and the errors that the table leaves out."""
    sought, alarms = f"{verified.sought_urad:g} µrad of any squareness", f"{100.0 * verified.false_alarm:.2g} %"
    positions = ", ".join(position_key(position) for position in verified.planned.positions)
    notes = [f"volcal verify: {positions}; at most {alarms} of the verifications raise a false alarm"]
    if not verified.seeks_squareness:
        notes.append(_NO_SQUARENESS)
    elif verified.fewest_squareness is None:
        notes.append(f"{sought}: not found with all positions at station {verified.station}")
    if verified.no_effect:
        notes.append(f"left out, because they do not move the tool: {', '.join(verified.no_effect)}")
    return "\n".join(notes)


def power_text(verified: VerificationPower) -> str:
    """Return in words which step of a squareness `volcal verify` finds, and how long that takes."""
    planned = verified.planned
    if not verified.seeks_squareness:
        return f"{_largest(planned.steps, ROTATIONS)} of any rotation in {_effort(planned)}\n{_NO_SQUARENESS}"
    own = f"any squareness by {_largest(planned.steps, SQUARENESS)} with {100.0 * POWER:.0f} % in {_effort(planned)}"
    if verified.fewest_squareness is not None:
        return own
    return f"{own}\n{verified.sought_urad:g} µrad: not with all positions there"


def _effort(found: FoundSteps) -> str:
    return f"{found.machine_minutes:.1f} min, {len(found.positions)} positions"


def _cells(found: FoundSteps) -> list[str]:
    kinds = (_largest(found.steps, errors) for errors in (SQUARENESS, ROTATIONS, _OTHERS))
    return [str(len(found.positions)), f"{found.machine_minutes:.1f}", f"{found.evidence:.1f}", *kinds]


def _largest(steps: tuple[SmallestStep, ...], errors: tuple[str, ...]) -> str:
    """Return the step that is found worst among those of `errors`, in words."""
    found = [step for step in steps if step.error in errors]
    return largest_of(found).text if found else "no effect"
