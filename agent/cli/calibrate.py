"""Command `volcal calibrate`, which carries out a full calibration of the machine described in the settings."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import click
from rich.console import Console

from agent.cli.errors import fail, reported
from agent.cli.options import config_option, procedure_options
from agent.cli.printing import facts_table, results_console, travel_rows
from agent.cli.progress import watching
from agent.errors import GateRefused
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.results.run_outcome import Outcome
from agent.runs.requested_run import job_of, kind_of
from agent.runs.run_context import RunHooks
from agent.runs.run_request import RunRequest
from agent.runs.session import RunResult, carry_out
from agent.settings.load import load_settings, naming, with_overrides
from agent.settings.schema import Settings
from drivers.errors import InputError

SCENARIO_FILE = "simulator.toml"
"""Name of the scenario beside the settings, as `volcal init` writes it."""


@click.command("calibrate")
@config_option
@procedure_options
@click.option("--simulated", is_flag=True, help="Calibrate a simulated machine, which is started for it, instead.")
@click.option(
    "--scenario",
    type=click.Path(path_type=Path),
    help="With --simulated: scenario of the simulation [default: simulator.toml beside the settings].",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@reported
def calibrate_command(
    config: Path,
    position_set: str | None,
    stations: list[int] | None,
    formulation: str | None,
    simulated: bool,
    scenario: Path | None,
    as_json: bool,
) -> None:
    """Measure, identify, write the table and verify it; restore the previous table if the check fails."""
    settings = with_overrides(
        load_settings(config), position_set=position_set, stations=stations, formulation=formulation
    )
    if simulated:
        from agent.cli.demo import calibrate_simulated  # noqa: PLC0415  it imports this module

        named = scenario or config.parent / SCENARIO_FILE
        calibrate_simulated(settings, config, named, simulated_state(settings), as_json=as_json)
        return
    if scenario is not None:
        raise InputError("--scenario needs --simulated", hint="a real machine is not described by a scenario")
    with naming(config):
        ended = run_here(calibration_here(), settings, config.resolve().parent)
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


def calibration_here() -> RunRequest:
    """Return the request for a calibration that is started on the command line.

    The request includes the consent to move the machine, because the person who types the command is at the machine.
    """
    return RunRequest(kind="calibrate", source="command line", consent=True)


def run_here(request: RunRequest, settings: Settings, base: Path, *, nights: float | None = None) -> RunResult:
    """Carry out the run that `request` asks for, in this process and with a progress bar on stderr. Return the result
    of the run. `base` is the directory to which relative paths in the settings refer.

    Ctrl-C and SIGTERM abort the run. `nights` is the number of nights since the last run whose result was accepted as
    the reference for later runs. If `nights` is None, the number is computed from the calendar.
    """
    job = job_of(request, settings, base)
    kind = kind_of(request, slot_minutes=request.slot_minutes, nights=nights)
    with watching(Console(stderr=True)) as listener, interruptible() as interrupts:
        return carry_out(job, kind, base, RunHooks(announce=listener, attach=interrupts.append))


@contextmanager
def interruptible() -> Iterator[list[Supervisor]]:
    """Yield an empty list to which the caller can add supervisors, the objects that receive requests to stop a run.

    During the `with` block, Ctrl-C and SIGTERM send an abort request to every supervisor in the list.
    """
    supervisors: list[Supervisor] = []

    def ask(number: int, _: FrameType | None) -> None:
        for supervisor in supervisors:
            supervisor.request_abort(signal.Signals(number).name)

    former = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield supervisors
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


def conclude(ended: RunResult) -> None:
    """Return without a value if the new compensation table of the finished run is active and was verified, or if the
    run confirmed the active compensation.

    Otherwise, print the error that describes the outcome, and end the program with the exit code of this error.
    """
    if ended.error is not None:
        raise fail(ended.error)
    if ended.outcome.confirmed is not None:
        return
    proof = ended.outcome.proof
    if proof is None or not proof.accepted:
        reason = "the new table was not better on the held-out positions; the previous table is active again"
        raise fail(GateRefused(reason if proof is None else f"{reason}: {proof.reason}"))


def show_summary(outcome: Outcome) -> None:
    """Print the result of a run as text.

    The path of the run's report file is printed on a separate line and is never truncated.
    """
    console = results_console()
    console.print(facts_table(_rows(outcome), title=f"{outcome.run_id}: {outcome.state.value}"))
    console.print(f"report: {outcome.report or 'none'}", markup=False)


def _rows(outcome: Outcome) -> list[tuple[str, str]]:
    rows = [
        ("position set", f"{outcome.position_set}, {outcome.formulation}"),
        ("measured", f"{outcome.balls} balls, {outcome.touches} touches"),
        ("machine time", f"{outcome.machine_minutes:.1f} min (predicted {_number(outcome.predicted_minutes)})"),
    ]
    if outcome.estimated_ve_um is not None:
        rows.append(("VE before, estimated", f"{outcome.estimated_ve_um:.2f} µm (aligned)"))
        rows.append(("VCE predicted", f"{_number(outcome.predicted_vce_um)} µm (aligned)"))
        if outcome.thermometer is not None:
            rows.append(("temperature", outcome.thermometer.short_text))
        rows += travel_rows(outcome.travel)
        rows.append(("rank", f"{outcome.rank} of {outcome.parameters} parameters"))
    if outcome.proof is not None:
        proof = outcome.proof
        text = f"{proof.before_um:.2f} → {proof.after_um:.2f} µm, predicted {proof.predicted_um:.2f} µm"
        rows.append(("held-out positions", text))
        rows.append(("verdict", "accepted" if proof.accepted else f"restored: {proof.reason}"))
    if outcome.confirmed is not None:
        rows.append(("held-out positions", f"{outcome.confirmed.held_out_um:.2f} µm with the active compensation"))
        rows.append(("verdict", outcome.confirmed.text))
    if outcome.state in (RunState.COMPLETE, RunState.REFUSED):
        rows.append(("active bank", str(outcome.table_bank)))
    return rows


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:.2f}"
