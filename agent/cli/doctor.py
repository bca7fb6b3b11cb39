"""Command `volcal doctor`, which tests every device named in the settings.

The command connects to each device, reads from it and measures its latency. It compares the limits of the controller
with the machine file, and forecasts the gates of a run. It moves nothing and writes nothing.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import config_option

if will_run():
    from rich.table import Table
    from rich.text import Text

    from agent.cli.printing import columns_table, results_console
    from agent.execution.device_assembly import assemble, closing_clock, make_clock
    from agent.execution.rig import Rig
    from agent.planning.controller_comparison import compare_with_controller
    from agent.planning.job import Job
    from agent.planning.job_preparation import prepare_job
    from agent.results.gates.gate_forecast import GateForecast, forecast_gates, require_forecast
    from agent.runs.reconcile import compensation_left
    from agent.settings.load import load_settings, naming
    from drivers.errors import DeviceError, VolcalError
    from drivers.roles import Device, DiagnosticFinding

GATES = "gates of a run"
"""Name under which the findings on the gates are listed; the blanks keep it apart from the name of any device."""


@click.command("doctor")
@config_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
@reported
def doctor_command(config: Path, as_json: bool) -> None:
    """Check settings, links and devices, and forecast the gates of a run; nothing moves."""
    settings = load_settings(config)
    with naming(config):
        job = prepare_job(settings, config.resolve().parent)
        diagnosis = examine(job, config.resolve().parent)
        gates = forecast_gates(job, diagnosis.store_limit_mm)
    findings = {**diagnosis.findings, GATES: [_gate_finding(gate) for gate in gates]}
    if as_json:
        click.echo(json.dumps({name: [vars(f) for f in lines] for name, lines in findings.items()}))
    else:
        results_console().print(_table(findings))
    if any(finding.ok is False for lines in diagnosis.findings.values() for finding in lines):
        raise SystemExit(DeviceError.exit_code)
    with naming(config):
        require_forecast(gates)


@dataclass
class Diagnosis:
    """Findings about each device by its name, and the largest correction in mm that the controller accepts, which is
    infinite if it could not be read."""

    findings: dict[str, list[DiagnosticFinding]] = field(default_factory=dict)
    store_limit_mm: float = math.inf


def examine(job: Job, base: Path) -> Diagnosis:
    """Test every device, and compare the limits of the controller with the machine file. `base` is the directory to
    which relative paths in the settings refer.

    If a device cannot be opened, one of its findings states this, and the other devices are still tested.
    """
    diagnosis, settings = Diagnosis(), job.settings
    with closing_clock(make_clock(settings.clock)) as clock:
        rig = assemble(settings, clock, base)
        for name, device in rig.devices.items():
            diagnosis.findings[name] = _examined(device, partial(_while_open, rig, name, job, diagnosis))
    return diagnosis


def _while_open(rig: Rig, name: str, job: Job, diagnosis: Diagnosis) -> list[DiagnosticFinding]:
    """Return the comparison of the open device `name` with the machine file if it is the controller; if it is the
    store, note its limit in `diagnosis`."""
    roles = job.settings.roles
    if name == roles.store:
        diagnosis.store_limit_mm = rig.store.store_limits().max_correction_mm
    found = _compensation_findings(rig, job.settings.state_directory) if name == roles.store else []
    if name == roles.machine:
        found += compare_with_controller(rig.machine.limits(), job.machine, job.settings.procedure)
    return found


def _compensation_findings(rig: Rig, state_directory: Path) -> list[DiagnosticFinding]:
    """Return the comparison of the active compensation with what the last run left, if there was a run. It is not good
    if no new run may start."""
    left = compensation_left(rig, state_directory)
    return [] if left is None else [DiagnosticFinding("compensation", ok=not left.blocks_runs, text=left.text)]


def _examined(device: Device, while_open: Callable[[], list[DiagnosticFinding]]) -> list[DiagnosticFinding]:
    try:
        device.open()
    except VolcalError as error:
        return [DiagnosticFinding("open", ok=False, text=str(error)), *_without_opening(device)]
    findings: list[DiagnosticFinding] = []
    try:
        findings.extend(device.diagnose())
        findings.extend(while_open())
    except DeviceError as error:
        findings.append(DiagnosticFinding("diagnose", ok=False, text=str(error)))
    finally:
        device.close()
    return findings


def _without_opening(device: Device) -> list[DiagnosticFinding]:
    """Return the findings of a device that could not be opened. The list is empty if the device can be diagnosed only
    when it is open.
    """
    try:
        return device.diagnose()
    except VolcalError:
        return []


def _gate_finding(gate: GateForecast) -> DiagnosticFinding:
    remedy = f"; {gate.remedy}" if gate.remedy else ""
    return DiagnosticFinding(gate.gate, gate.passes, f"{gate.figures} ({gate.key}): {gate.text}{remedy}")


def _table(findings: dict[str, list[DiagnosticFinding]]) -> Table:
    table = columns_table(("device", "subject", "", "finding"), whole=("device",))
    marks = {True: Text("ok", "green"), False: Text("no", "red"), None: Text("not read", "yellow")}
    for name, lines in findings.items():
        for finding in lines:
            table.add_row(name, finding.subject, marks[finding.ok], finding.text)
    return table
