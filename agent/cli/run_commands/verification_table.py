"""Printed table of the steps that a verification finds."""

from __future__ import annotations

from rich.table import Table

from agent.cli.printing import columns_table
from agent.probing.run_plan import position_key
from agent.runs.kinds.verification_power import SOUGHT_URAD, FoundSteps, VerificationPower
from twin.identification.jump import ERRORS
from twin.machine.error_model import SQUARENESS
from twin.monitoring.step_power import FALSE_ALARM, POWER, ROTATIONS, SmallestStep, largest_of

_COLUMNS = ("verification", "positions", "min", "evidence", "squareness", "rotation", "displacement")
_OTHERS = tuple(error for error in ERRORS if error not in (*SQUARENESS, *ROTATIONS))


def power_table(verified: VerificationPower) -> Table:
    """Return a table of the smallest steps that a verification finds, with one row for each set of positions."""
    title = f"smallest steps found by a verification at station {verified.station} with {100.0 * POWER:.0f} %"
    table = columns_table(_COLUMNS, title=title, numbers=_COLUMNS[1:4])
    planned = verified.planned
    for found in verified.by_positions:
        more = len(found.positions) - len(planned.positions)
        name = "volcal verify" if more == 0 else f"{abs(more)} {'more' if more > 0 else 'fewer'}"
        table.add_row(name, *_cells(found, found.evidence, found.steps))
    as_set = f"volcal verify as set ({100.0 * verified.set_false_alarm:.2g} % false alarms)"
    table.add_row(as_set, *_cells(planned, verified.set_evidence, verified.as_set))
    fewest = (("squareness", verified.fewest_squareness), ("squareness or rotation", verified.fewest_angles))
    for what, one in fewest:
        row = ["none", "", "", "", "", ""] if one is None else _cells(one, one.evidence, one.steps)
        table.add_row(f"fewest for {SOUGHT_URAD:g} µrad of any {what}", *row)
    return table


def power_notes(verified: VerificationPower) -> str:
    """Return the meaning of the limits in the table of `power_table`, the errors that it leaves out, and the fewest
    positions."""
    alarms = f"{100.0 * FALSE_ALARM:.0f} % of the verifications raise a false alarm at most"
    notes = [f"if nightly.step_evidence is set to 'evidence', {alarms}"]
    if verified.no_effect:
        notes.append(f"left out, because they do not move the tool: {', '.join(verified.no_effect)}")
    if verified.fewest_squareness is not None:
        positions = ", ".join(position_key(position) for position in verified.fewest_squareness.positions)
        notes.append(f"fewest for {SOUGHT_URAD:g} µrad of any squareness: {positions}")
    return "\n".join(notes)


def power_text(verified: VerificationPower) -> str:
    """Return in words which step of a squareness `volcal verify` finds, and how long the sought step takes."""
    planned, fewest = verified.planned, verified.fewest_squareness
    worst = _largest(planned.steps, SQUARENESS)
    own = f"any squareness by {worst} with {100.0 * POWER:.0f} % in {_effort(planned)}"
    needed = "not with all positions there" if fewest is None else f"{_effort(fewest)} chosen for it"
    return f"{own}\n{SOUGHT_URAD:g} µrad: {needed}"


def _effort(found: FoundSteps) -> str:
    return f"{found.machine_minutes:.1f} min, {len(found.positions)} positions"


def _cells(found: FoundSteps, evidence: float, steps: tuple[SmallestStep, ...]) -> list[str]:
    minutes = f"{found.machine_minutes:.1f}"
    kinds = (_largest(steps, errors) for errors in (SQUARENESS, ROTATIONS, _OTHERS))
    return [str(len(found.positions)), minutes, f"{evidence:.1f}", *kinds]


def _largest(steps: tuple[SmallestStep, ...], errors: tuple[str, ...]) -> str:
    """Return the step that is found worst among those of `errors`, in words."""
    found = [step for step in steps if step.error in errors]
    if not found:
        return "no effect"
    worst = largest_of(found)
    return f"{worst.error}: not found" if worst.size is None else f"{worst.size:.1f} {worst.unit} ({worst.error})"
