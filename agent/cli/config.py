"""Commands `volcal config check` and `volcal config schema`, which check a settings file and print the JSON schema of
settings files.
"""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import VolcalGroup, reported
from agent.cli.invocation import will_run
from agent.cli.options import SETTINGS_FILE
from drivers.errors import ConfigurationError

if will_run():
    from agent.cli.printing import gates_table, results_console
    from agent.planning.job_preparation import prepare_job
    from agent.results.gate_forecast import forecast_gates, require_forecast
    from agent.service.opcua.node_set_files import node_sets_to_load
    from agent.settings.load import load_settings, naming
    from agent.settings.plausible_ranges import implausible_values
    from agent.settings.schema import Settings


@click.group("config", cls=VolcalGroup)
def config_group() -> None:
    """Check settings files and print their schema."""


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


@config_group.command("schema")
def schema() -> None:
    """Print the JSON schema of the settings (config/schema/settings.json is this text)."""
    click.echo(schema_text(), nl=False)


def schema_text() -> str:
    """Return the JSON schema of the agent's settings file as text."""
    return json.dumps(Settings.model_json_schema(), indent=2, ensure_ascii=False) + "\n"
