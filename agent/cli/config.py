"""Commands `volcal config check`, `volcal config machine` and `volcal config schema`, which check a settings file,
print the cross-effect of a machine file, and print the JSON schema of settings files.
"""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import VolcalGroup, reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH, SETTINGS_FILE, case_options
from drivers.errors import ConfigurationError

if will_run():
    from rich.table import Table

    from agent.cli.printing import gates_table, results_console
    from agent.model_files import load_machine
    from agent.planning.job_preparation import prepare_job
    from agent.results.gates.gate_forecast import forecast_gates, require_forecast
    from agent.service.opcua.node_set_files import node_sets_to_load
    from agent.settings.load import load_settings, naming
    from agent.settings.plausible_ranges import implausible_values
    from agent.settings.schema import Settings
    from twin.machine.machine_description import MachineDescription
    from twin.machine.structure import own_axis_degrees
    from twin.units import MICRO_UNITS


@click.group("config", cls=VolcalGroup)
def config_group() -> None:
    """Check settings files, show the cross-effect of a machine, and print the schema of the settings."""


@config_group.command("check")
@click.argument("file", type=click.Path(path_type=Path), required=False)
@reported
def check(file: Path | None) -> None:
    """Read the settings and every file they name, warn of implausible values, and forecast the gates; no device is
    contacted. FILE is volcal.toml of the current directory unless another is named."""
    if file is None:
        if not SETTINGS_FILE.exists():
            raise ConfigurationError(
                f"this directory has no {SETTINGS_FILE}",
                hint="name the settings file, or write one with `volcal init`",
            )
        file = SETTINGS_FILE
    settings = load_settings(file)
    with naming(file):
        if settings.opcua.enabled:
            node_sets_to_load(settings.opcua)
        job = prepare_job(settings, file.resolve().parent)
        held_out, gates = job.held_out, forecast_gates(job)
    for warning in implausible_values(settings, file):
        click.echo(f"warning: {warning}", err=True)
    results_console().print(gates_table(gates))
    with naming(file):
        require_forecast(gates)
    click.echo(
        f"{file}: good. Machine {job.machine.name}, artefact {job.artefact.name}, "
        f"{len(job.positions)} positions, {len(held_out)} held out, {len(settings.devices)} devices."
    )


@config_group.command("machine")
@case_options
@click.option("--machine", "file", type=PATH, help="Machine file (TOML) instead of the one in the settings.")
@reported
def machine_command(config: Path, file: Path | None) -> None:
    """Print the cross-effect of the machine: the parameters that follow from its beams, and their polynomials."""
    machine = load_machine(file or load_settings(config).machine)
    console = results_console()
    for error, degree in own_axis_degrees(machine.beams, machine.model).items():
        if degree > machine.model.orders[error]:
            click.echo(
                f"warning: {error} has the order {machine.model.orders[error]}, but its beams need the order {degree}: "
                "the series represents the deflection only in part; raise model.order",
                err=True,
            )
    if not machine.model.cross_terms and not machine.derived_terms:
        console.print(f"{machine.name}: no cross-effect", markup=False)
        return
    console.print(_cross_effect_table(machine))
    console.print("x, y, z: axis positions as fractions of the axis ranges, 0 at the lower end.", markup=False)
    if any(derived.redundant for derived in machine.derived_terms):
        console.print(
            "Not identified: terms that the error motions of single axes represent up to a rigid motion.", markup=False
        )


def _cross_effect_table(machine: MachineDescription) -> Table:
    """Return the table of the cross-effect terms, those that are not identified included."""
    table = Table(title=f"cross-effect of {machine.name}", title_justify="left")
    for heading in ("parameter", "beams", "added to", "polynomial"):
        table.add_column(heading)
    for heading in ("expected", "prior ±"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    widths = dict(zip(machine.model.names, machine.family.half_widths.tolist(), strict=True))
    derived = {one.term.name: one for one in machine.derived_terms}
    terms = [one.term for one in machine.derived_terms] or machine.model.cross_terms
    for term in terms:
        unit, factor = MICRO_UNITS[term.unit]
        origin = derived.get(term.name)
        expected = None if origin is None else origin.expected
        table.add_row(
            term.name,
            "" if origin is None else ", ".join(origin.beams),
            term.error,
            str(term.polynomial),
            "" if expected is None else f"{factor * expected:.3g}",
            f"{factor * widths[term.name]:.3g}" if term.name in widths else "not identified",
            unit,
        )
    return table


@config_group.command("schema")
def schema() -> None:
    """Print the JSON schema of the settings (config/schema/settings.json is this text)."""
    click.echo(schema_text(), nl=False)


def schema_text() -> str:
    """Return the JSON schema of the agent's settings file as text."""
    return json.dumps(Settings.model_json_schema(), indent=2, ensure_ascii=False) + "\n"
