"""Command `volcal demo`, which calibrates a simulated machine over real communication links.

The command compares the result of the calibration with the true errors of the simulated machine.
"""

from __future__ import annotations

from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.run_commands.sequential_options import SequentialOptions, sequential_options
from agent.cli.run_commands.simulator_process import ANY_SOCKETCAND
from agent.lasting_output import lasting_output

if will_run():
    from agent.cli.run_commands.simulated_calibration import calibrate_simulated
    from agent.planning.case_file import shipped_case
    from agent.settings.load import load_settings, with_overrides


@click.command("demo")
@click.option(
    "--case",
    "case_name",
    default="case-study",
    show_default=True,
    metavar="NAME",
    help="Shipped machine: its settings and its scenario.",
)
@click.option("--config", type=click.Path(path_type=Path), help="Settings instead of those of the case.")
@click.option("--scenario", type=click.Path(path_type=Path), help="Scenario to simulate instead of that of the case.")
@click.option("--position-set", metavar="SET", help="S1, S2, S3, joined by +, or a position file.")
@click.option("--formulation", type=click.Choice(["centres", "distances"]))
@sequential_options
@click.option(
    "--can",
    default=ANY_SOCKETCAND,
    show_default=True,
    help="CAN between the processes, in the form of `volcal simulate --can`.",
)
@click.option(
    "--modbus-rtu",
    metavar="PATH|any[@BAUD,8P1]",
    help="Controller on a serial line instead of TCP, in the form of `volcal simulate --modbus-rtu`.",
)
@click.option(
    "--cross-check",
    is_flag=True,
    help="Afterwards measure the machine with a virtual laser and ballbar, and compare with the prediction.",
)
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs"), show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@lasting_output()
@reported
def demo_command(
    case_name: str,
    config: Path | None,
    scenario: Path | None,
    position_set: str | None,
    formulation: str | None,
    sequential: bool,
    target_vce_um: float | None,
    slot_minutes: float | None,
    can: str,
    modbus_rtu: str | None,
    cross_check: bool,
    out: Path,
    as_json: bool,
) -> None:
    """Start the simulated machine as a process, calibrate it over TCP and CAN, and compare with the truth."""
    end = SequentialOptions(sequential, target_vce_um, slot_minutes)
    case = shipped_case(case_name)
    config = config or case.settings
    settings = with_overrides(load_settings(config), position_set=position_set, formulation=formulation)
    named = case.name if config == case.settings else None
    calibrate_simulated(
        settings,
        config,
        scenario or case.scenario,
        out,
        case=named,
        can=can,
        modbus_rtu=modbus_rtu,
        end=end,
        cross_check=cross_check,
        as_json=as_json,
    )
