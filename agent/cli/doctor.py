"""Command `volcal doctor`, which tests every device named in the settings.

The command connects to each device, reads from it and measures its latency. It moves nothing and writes nothing.
"""

from __future__ import annotations

import json
from pathlib import Path

import click
from rich.table import Table

from agent.cli.errors import reported
from agent.cli.options import config_option
from agent.cli.printing import columns_table, results_console
from agent.execution.device_assembly import assemble, closing_clock, make_clock
from agent.planning.job_preparation import prepare_job
from agent.settings.load import load_settings, naming
from agent.settings.schema import Settings
from drivers.errors import DeviceError, VolcalError
from drivers.roles import Device, DiagnosticFinding


@click.command("doctor")
@config_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
@reported
def doctor_command(config: Path, as_json: bool) -> None:
    """Check settings, links and devices without moving anything."""
    settings = load_settings(config)
    base = config.resolve().parent
    with naming(config):
        prepare_job(settings, base)
    findings = examine(settings, base)
    if as_json:
        document = {name: [vars(f) for f in lines] for name, lines in findings.items()}
        click.echo(json.dumps(document))
    else:
        results_console().print(_table(findings))
    if any(not finding.ok for lines in findings.values() for finding in lines):
        raise SystemExit(DeviceError.exit_code)


def examine(settings: Settings, base: Path) -> dict[str, list[DiagnosticFinding]]:
    """Test every device and return a mapping from the name of each device to its findings. Each finding says whether
    one property of the device is in order.

    If a device cannot be opened, one of its findings states this, and the other devices are still tested.
    """
    with closing_clock(make_clock(settings.clock)) as clock:
        rig = assemble(settings, clock, base)
        return {name: _examined(device) for name, device in rig.devices.items()}


def _examined(device: Device) -> list[DiagnosticFinding]:
    try:
        device.open()
    except VolcalError as error:
        return [DiagnosticFinding("open", ok=False, text=str(error)), *_without_opening(device)]
    try:
        return device.diagnose()
    except DeviceError as error:
        return [DiagnosticFinding("diagnose", ok=False, text=str(error))]
    finally:
        device.close()


def _without_opening(device: Device) -> list[DiagnosticFinding]:
    """Return the findings of a device that could not be opened. The list is empty if the device can be diagnosed only
    when it is open.
    """
    try:
        return device.diagnose()
    except VolcalError:
        return []


def _table(findings: dict[str, list[DiagnosticFinding]]) -> Table:
    table = columns_table(("device", "subject", "", "finding"), whole=("device",))
    for name, lines in findings.items():
        for finding in lines:
            mark = "[green]ok[/green]" if finding.ok else "[red]no[/red]"
            table.add_row(name, finding.subject, mark, finding.text)
    return table
