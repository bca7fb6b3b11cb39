"""Commands `volcal table show`, `volcal table export` and `volcal table restore`.

The commands use the compensation tables in the controller and the tables that earlier runs stored in the journal.
"""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import VolcalGroup, reported
from agent.cli.invocation import will_run
from agent.cli.options import case_options, config_option
from agent.cli.table_commands.table_export import export

if will_run():
    import numpy as np
    from rich.text import Text

    from agent.cli.printing import columns_table, results_console
    from agent.cli.service_commands.start import conclude, waited_for
    from agent.cli.table_commands.store_connection import connected
    from agent.execution.encoding import table_digest
    from agent.figures.heading import subject
    from agent.runs.reconcile import compensation_left
    from agent.service.client import Client
    from agent.settings.load import load_settings
    from drivers.clock import RealClock
    from drivers.roles import TableImage


ROLES = ("backup", "staged", "restored")
"""Roles under which runs store tables: `agent.runs.kinds.restoration.TABLE_ROLES`, which is slow to import."""


@click.group("table", cls=VolcalGroup)
def table_group() -> None:
    """Show, export and restore compensation tables."""


@table_group.command("show")
@case_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
@reported
def show(config: Path, as_json: bool) -> None:
    """Show every bank: whether it is active, its grid, checksum and largest correction."""
    with connected(config) as (job, rig):
        active = rig.store.active_bank()
        banks = {bank: rig.store.read_table(bank) for bank in rig.store.store_limits().banks if bank}
        left = compensation_left(rig, job.settings.state_directory)
    if as_json:
        named = {"machine": job.machine.name, "artefact": job.artefact.name}
        found = None if left is None else {"found": left.state.value, "person": left.instruction}
        contents = {str(number): _facts(image) for number, image in banks.items()}
        document = {**named, "active_bank": active, "compensation": found, "banks": contents}
        click.echo(json.dumps(document))
        return
    console = results_console()
    console.print(subject(job.machine.name, job.artefact.name), markup=False)
    table = columns_table(("bank", "state", "grid", "CRC-32", "largest correction"), whole=("CRC-32",))
    table.add_row("0", Text("active", "bold") if active == 0 else "", "no compensation", "", "")
    for bank, image in banks.items():
        facts = _facts(image)
        kept = "staged or previous" if image else "empty"
        grid = " × ".join(str(n) for n in image.shape) if image else ""
        crc, largest = (facts["crc32"], f"{facts['largest_um']} µm") if facts else ("", "")
        table.add_row(str(bank), Text("active", "bold") if bank == active else kept, grid, str(crc), largest)
    console.print(table)
    if left is not None:
        console.print(left.text, markup=False)


table_group.add_command(export)


@table_group.command("restore")
@click.argument("run", metavar="RUN")
@click.option(
    "--role",
    type=click.Choice(ROLES),
    default="backup",
    show_default=True,
    help="Role under which the run stored the table.",
)
@config_option
@click.confirmation_option(prompt="Activate this table again? The next part is made with it")
@reported
def restore(run: str, role: str, config: Path) -> None:
    """Activate again a table that RUN stored: stage, read back, activate, read back. Nothing moves.

    The service does it as a separate run; the exit code is that of this run.
    """
    with Client(load_settings(config)) as client:
        asked = {"run_id": run, "role": role, "source": "command line"}
        run_id = str(client.post("/api/tables/restore", asked)["run_id"])
        click.echo(run_id)
        conclude(client, waited_for(client, run_id, RealClock()))


def _facts(image: TableImage | None) -> dict[str, object] | None:
    if image is None:
        return None
    return {
        "shape": list(image.shape),
        "origin_mm": list(image.origin_mm),
        "step_mm": list(image.step_mm),
        "crc32": f"{table_digest(image):08x}",
        "largest_um": round(float(np.abs(image.counts).max()) * image.resolution_mm * 1e3, 3),
    }
