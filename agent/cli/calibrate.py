"""`volcal calibrate`: a full calibration of the machine that the settings describe."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import click
from rich.console import Console
from rich.table import Table

from agent.cli.errors import fail, reported
from agent.cli.options import procedure_options
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


@click.command("calibrate")
@procedure_options
@click.option("--json", "as_json", is_flag=True, help="End with one JSON object on stdout.")
@reported
def calibrate_command(
    config: Path,
    position_set: str | None,
    stations: list[int] | None,
    formulation: str | None,
    as_json: bool,
) -> None:
    """Measure, identify, write the table, prove it, or restore what was there."""
    settings = with_overrides(
        load_settings(config), position_set=position_set, stations=stations, formulation=formulation
    )
    with naming(config):
        ended = run_here(calibration_here(), settings, config.resolve().parent)
    if as_json:
        click.echo(json.dumps(ended.outcome.as_json(), allow_nan=False))
    else:
        Console().print(summary_table(ended.outcome))
    conclude(ended)


def calibration_here() -> RunRequest:
    """Return the request for a calibration from the command line: whoever types it stands by."""
    return RunRequest(kind="calibrate", source="command line", consent=True)


def run_here(request: RunRequest, settings: Settings, base: Path, *, nights: float | None = None) -> RunResult:
    """Carry out a request in this process, with a progress bar on stderr; Ctrl-C and SIGTERM abort it.

    `nights` since the last accepted one; None: by the calendar.
    """
    job = job_of(request, settings, base)
    kind = kind_of(request, slot_minutes=request.slot_minutes, nights=nights)
    with watching(Console(stderr=True)) as listener, interruptible() as interrupts:
        return carry_out(job, kind, base, RunHooks(announce=listener, attach=interrupts.append))


@contextmanager
def interruptible() -> Iterator[list[Supervisor]]:
    """While the block runs, Ctrl-C and SIGTERM ask the supervisors in the list to abort."""
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
    """Exit as the run ended: 0 only where the new table acts and was proved."""
    if ended.error is not None:
        raise fail(ended.error)
    proof = ended.outcome.proof
    if proof is None or not proof.accepted:
        reason = "the new table did not prove better; the former one acts again"
        raise fail(GateRefused(reason if proof is None else f"{reason}: {proof.reason}"))


def summary_table(outcome: Outcome) -> Table:
    """The result as people read it."""
    table = Table(title=f"{outcome.run_id}: {outcome.state.value}", show_header=False)
    for name, value in _rows(outcome):
        table.add_row(name, value)
    return table


def _rows(outcome: Outcome) -> list[tuple[str, str]]:
    rows = [
        ("position set", f"{outcome.position_set}, {outcome.formulation}"),
        ("measured", f"{outcome.balls} balls, {outcome.touches} touches"),
        ("machine time", f"{outcome.machine_minutes:.1f} min (predicted {_number(outcome.predicted_minutes)})"),
    ]
    if outcome.estimated_ve_um is not None:
        rows.append(("VE before, estimated", f"{outcome.estimated_ve_um:.2f} µm (aligned)"))
        rows.append(("VCE predicted", f"{_number(outcome.predicted_vce_um)} µm (aligned)"))
        rows.append(("rank", f"{outcome.rank} of {outcome.parameters} parameters"))
    if outcome.proof is not None:
        proof = outcome.proof
        text = f"{proof.before_um:.2f} → {proof.after_um:.2f} µm, predicted {proof.predicted_um:.2f} µm"
        rows.append(("held-out positions", text))
        rows.append(("verdict", "accepted" if proof.accepted else f"restored: {proof.reason}"))
    if outcome.state in (RunState.COMPLETE, RunState.REFUSED):
        rows.append(("active bank", str(outcome.table_bank)))
    rows.append(("report", str(outcome.report) if outcome.report else "none"))
    return rows


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:.2f}"
