"""Command `volcal calibrate`, which carries out a full calibration of the machine described in the settings."""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import config_option, procedure_options
from agent.cli.run_commands.sequential_options import SequentialOptions, sequential_options
from agent.lasting_output import lasting_output

if will_run():
    from agent.cli.run_commands.local_run import calibrate_here, conclude
    from agent.cli.run_commands.run_summary import show_summary
    from agent.cli.run_commands.simulated_calibration import calibrate_simulated
    from agent.settings.load import load_settings, naming, with_overrides
    from agent.settings.schema import Settings
    from agent.settings.simulator_command import SCENARIO_FILE
    from drivers.errors import InputError

"""Name of the scenario beside the settings, as `volcal init` writes it."""


@click.command("calibrate")
@config_option
@procedure_options
@sequential_options
@click.option("--simulated", is_flag=True, help="Calibrate a simulated machine, which is started for it, instead.")
@click.option(
    "--scenario",
    type=click.Path(path_type=Path),
    help="With --simulated: scenario of the simulation [default: simulator.toml beside the settings].",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@lasting_output()
@reported
def calibrate_command(
    config: Path,
    position_set: str | None,
    stations: list[int] | None,
    formulation: str | None,
    sequential: bool,
    target_vce_um: float | None,
    slot_minutes: float | None,
    simulated: bool,
    scenario: Path | None,
    as_json: bool,
) -> None:
    """Measure, identify, write the table and verify it; restore the previous table if the check fails."""
    end = SequentialOptions(sequential, target_vce_um, slot_minutes)
    settings = with_overrides(
        load_settings(config), position_set=position_set, stations=stations, formulation=formulation
    )
    if simulated:
        named = scenario or config.parent / SCENARIO_FILE
        calibrate_simulated(settings, config, named, simulated_state(settings), end=end, as_json=as_json)
        return
    if scenario is not None:
        raise InputError("--scenario needs --simulated", hint="a real machine is not described by a scenario")
    with naming(config):
        ended = calibrate_here(settings, config.resolve().parent, end)
    if as_json:
        click.echo(json.dumps(ended.outcome.as_json(), allow_nan=False))
    else:
        show_summary(ended.outcome)
    conclude(ended)


def simulated_state(settings: Settings) -> Path:
    """Return the state directory of simulated runs: that of the settings, or a subdirectory of it if the settings are
    those of a real machine, whose journal and history a simulated run must not enter."""
    if settings.clock.kind == "lockstep":
        return settings.state_directory
    return settings.state_directory / "simulated"
