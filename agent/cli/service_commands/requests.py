"""Commands `volcal hold`, `volcal abort`, `volcal reset` and `volcal answer`.

Each command sends one request to the service, the process that owns the machine.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import config_option

if will_run():
    from agent.printable import MAX_REASON, one_line
    from agent.service.client import Client, NoService
    from agent.settings.load import read_settings
    from agent.settings.schema import Settings
    from drivers.errors import ConfigurationError

ABORT_REASON = "volcal abort"


@click.command("hold")
@config_option
@reported
def hold_command(config: Path) -> None:
    """Stop the axes where they are until `volcal resume`."""
    with Client(read_settings(config)) as client:
        client.post("/api/hold")
    click.echo("hold requested")


@click.command("abort")
@config_option
@click.option("--reason", default=ABORT_REASON, show_default=True, help="Reason to record in the journal.")
@reported
def abort_command(config: Path, reason: str) -> None:
    """Stop the run, withdraw the probe and restore the previous table.

    Needs no token. Has no effect between runs.
    """
    try:
        client = Client(read_settings(config))
    except ConfigurationError as error:
        elsewhere = "the abort was NOT sent: abort on the page or at the panel, or press the emergency stop"
        raise ConfigurationError(error.message, hint=elsewhere, **error.where) from error
    with client:
        # Also a reason that cannot be sent as it is, such as bytes that are not UTF-8, must not keep the abort back.
        client.post("/api/abort", {"reason": one_line(reason, MAX_REASON) or ABORT_REASON}, token=False)
    click.echo("abort requested")


@click.command("reset")
@config_option
@reported
def reset_command(config: Path) -> None:
    """Acknowledge a fault, an abort or an alarm between runs. Nothing moves."""
    with Client(read_settings(config)) as client:
        client.post("/api/reset")
    click.echo("reset")


@click.command("answer")
@click.argument("number", type=click.IntRange(min=1))
@click.argument("said", type=click.Choice(["yes", "no"]))
@config_option
@reported
def answer_command(number: int, said: str, config: Path) -> None:
    """Answer the open question of the run; `volcal status` shows it with its number."""
    with Client(read_settings(config)) as client:
        client.post("/api/answer", {"number": number, "yes": said == "yes"})
    click.echo(f"question {number}: {said}")


def resumed_by_service(settings: Settings) -> bool:
    """Request the service to resume the run that is held or was interrupted.

    Return True if the request was sent, and False if no service is running.
    """
    try:
        client = Client(settings)
    except NoService:
        return False
    with client:
        if "resume" in client.get("/api/status")["may"]:
            client.post("/api/resume")
            click.echo("resume requested")
        else:
            click.echo(client.post("/api/resume-run", {"source": "command line"})["run_id"])
    return True


def settled_by_service(settings: Settings, *, give_up: bool) -> Mapping[str, Any] | None:
    """Request the service to reactivate the former table in place of an unproved one, and with `give_up` to end the
    unfinished run.

    Return the status of the service before and after it, as `former` and `now`. Return None if no service is running.
    Raises StoreError if the table is still active, and NotAllowedInState if the service knows of no unproved table and,
    with `give_up`, of no unfinished run, or if it waits for a reset.
    """
    try:
        client = Client(settings)
    except NoService:
        return None
    with client:
        former = client.get("/api/status")
        client.post("/api/give-up-run" if give_up else "/api/unproved-table/restore")
        return {"former": former, "now": client.get("/api/status")}
