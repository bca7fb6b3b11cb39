"""Command `volcal start`, which requests the service (the process of `volcal serve`) to start a run. A systemd timer
runs the same command.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from agent.cli.errors import fail, reported
from agent.cli.invocation import will_run
from agent.cli.options import Duration, config_option, measured_options
from agent.runs.run_kinds import KINDS

if will_run():
    from rich.console import Console

    from agent.errors import Busy, GateRefused, ResetMissing, RunError
    from agent.execution.states import RunState
    from agent.service.alarms import CODES
    from agent.service.allowed_requests import AT_REST
    from agent.service.client import Client
    from agent.settings.load import read_settings
    from drivers.clock import Clock, Deadline, RealClock
    from drivers.errors import LinkError, PermissionMissing, VolcalError

DECLINED = 6
"""Exit code if the service declines to start a run at this time. Nothing has moved, and a timer may try again later."""
STARTED_BY_SYSTEMD = "INVOCATION_ID"
LOOK_EVERY_S = 1.0
GONE_FOR_S = 90.0
"""Longest time in s to wait for a service that cannot be reached. A service that its watchdog restarts is available
sooner, and then reports how the run ended.
"""


@click.command("start")
@click.option("--kind", type=click.Choice(KINDS), required=True, help="Kind of the run.")
@click.option("--slot", type=Duration(), metavar="15min", help="Available machine time.")
@click.option("--full-allowed/--no-full", default=None, help="Whether a night may become a full calibration.")
@click.option("--consent", is_flag=True, help="You are at the machine, and it may move.")
@click.option("--wait", is_flag=True, help="Wait for the end of the run; the exit code is that of the run.")
@config_option
@measured_options
@reported
def start_command(
    kind: str,
    slot: float | None,
    full_allowed: bool | None,
    consent: bool,
    wait: bool,
    config: Path,
    position_set: str | None,
    stations: list[int] | None,
) -> None:
    """Request a run from the service.

    Without --consent the service decides by hours, warm-up and permissions, as for a timer.
    """
    body = {
        "kind": kind,
        "source": "timer" if STARTED_BY_SYSTEMD in os.environ else "command line",
        "position_set": position_set,
        "stations": stations,
        "slot_minutes": slot,
        "full_allowed": full_allowed,
        "consent": consent,
    }
    with Client(read_settings(config)) as client:
        run_id = begun(client, body)
        click.echo(run_id)
        if wait:
            conclude(client, waited_for(client, run_id, RealClock()))


def begun(client: Client, body: Mapping[str, object]) -> str:
    """Request the service to start the run described by `body`, the fields of the request. Return the identity of the
    run.

    End the program with the exit code DECLINED (6) if the service refuses the start because of the time of day, the
    warm-up, a missing permission or another run. Raise ResetMissing if a person must reset first: for a timer this is a
    failure, since it would be refused every night until then.
    """
    try:
        return str(client.post("/api/start", body)["run_id"])
    except ResetMissing:
        raise
    except (Busy, GateRefused, PermissionMissing) as error:
        fail(error)
        raise SystemExit(DECLINED) from None


def waited_for(client: Client, run_id: str, clock: Clock) -> Mapping[str, Any]:
    """Wait for the end of the run `run_id` and return the status of the run as the service then reports it.

    If the service cannot be reached, try again for at most GONE_FOR_S (90) seconds, then raise LinkError.
    """
    console = Console(stderr=True)
    said = ""
    while True:
        status = _status(client, clock)
        if status["doing"] != said and status["run_id"] == run_id:
            said = status["doing"]
            console.print(said, highlight=False, markup=False, emoji=False)
        if RunState(status["state"]) in AT_REST:
            return status if status["run_id"] == run_id else {**client.get(f"/api/runs/{run_id}"), "alarms": []}
        clock.sleep(LOOK_EVERY_S)


def conclude(client: Client, status: Mapping[str, Any]) -> None:
    """Return without a value if the run that `status` describes is complete and any compensation table that it wrote
    was verified.

    Otherwise, print the error that describes the outcome, and end the program with the exit code of this error.
    """
    state = RunState(status["state"])
    if status["alarms"]:
        raise fail(_error_of(status["alarms"][0]))
    if state is not RunState.COMPLETE:
        raise fail(RunError(f"the run ended {state.value}", hint="see its report and its events"))
    decisions = client.get(f"/api/runs/{status['run_id']}")["decisions"]
    proofs = [one["record"] for one in decisions if one["kind"] == "proof"]
    if proofs and not proofs[-1]["accepted"]:
        reason = "the new table was not better on the held-out positions; the previous table is active"
        raise fail(GateRefused(f"{reason}: {proofs[-1]['reason']}"))
    click.echo("complete", err=True)


def _status(client: Client, clock: Clock) -> Mapping[str, Any]:
    deadline = Deadline.after(clock, GONE_FOR_S)
    while True:
        try:
            return client.get("/api/status")
        except LinkError:
            if deadline.expired:
                raise
            clock.sleep(LOOK_EVERY_S)


def _error_of(alarm: Mapping[str, Any]) -> VolcalError:
    """Return an error of the class to which the alarm's number belongs, so that the command exits with the code of that
    class.
    """
    kind = next((kind for kind, code in CODES.items() if code.code == alarm["code"]), VolcalError)
    return kind(alarm["text"], hint=alarm["hint"], **alarm["where"])
