"""Command `volcal actions`, which proposes mechanical actions on a machine from an estimate.

The command contacts no device.
"""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH
from agent.cli.triples import point_in_mm

if will_run():
    from agent.cli.printing import columns_table, results_console
    from agent.workpiece.proposed_actions import (
        AT_THIS_TEMPERATURE,
        ProposedActions,
        action_text,
        amount_texts,
        propose_actions,
        unknown_guides_text,
    )
    from twin.units import UM_PER_MM
    from twin.workpiece.action_fields import ActionKind
    from twin.workpiece.mechanical_actions import VolumetricState


@click.command("actions")
@click.argument("estimate", type=PATH)
@click.option("--most", type=click.IntRange(1, 5), default=5, show_default=True, help="Largest number of actions.")
@click.option(
    "--tool-offset",
    callback=point_in_mm,
    metavar="X,Y,Z",
    help="Offset in mm of the tool point [default: that of the measurement].",
)
@click.option(
    "--machine", type=PATH, metavar="FILE", help="Machine file with the guides and the feet, for shims and levelling."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout instead of a table.")
@reported
def actions_command(
    estimate: Path, most: int, tool_offset: tuple[float, float, float] | None, machine: Path | None, as_json: bool
) -> None:
    """Propose at most five mechanical actions on a machine, each with its amount and its gain.

    ESTIMATE is estimate.json, or the folder of a run or of `volcal identify`.
    """
    found = propose_actions(estimate, most, tool_offset, machine)
    if as_json:
        click.echo(json.dumps(found.as_json(), allow_nan=False))
    else:
        _show(found)


def _show(found: ProposedActions) -> None:
    headings = ("action", "amount", "U (k = 2)", "VE after / µm", "limits (95 %)")
    shown = columns_table(headings, numbers=headings[1:])
    before, *after = found.plan.states
    shown.add_row("none", "", "", *_cells(before))
    for action, state in zip(found.plan.actions, after, strict=True):
        shown.add_row(action_text(action), *amount_texts(action), *_cells(state))
    console = results_console()
    console.print(f"What to turn at the machine of {found.estimate}, in the order of the gain", markup=False)
    console.print(shown)
    if any(action.kind is ActionKind.SCALE for action in found.plan.actions):
        console.print(AT_THIS_TEMPERATURE)
    if found.unknown_guides:
        console.print(unknown_guides_text(found.unknown_guides), markup=False)
    if not found.plan.actions:
        console.print("No action is larger than its uncertainty.")


def _cells(state: VolumetricState) -> tuple[str, str]:
    return (
        f"{UM_PER_MM * state.expected_mm:.2f}",
        f"{UM_PER_MM * state.low_mm:.2f} … {UM_PER_MM * state.high_mm:.2f}",
    )
