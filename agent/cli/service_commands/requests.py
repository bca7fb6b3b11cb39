"""`volcal hold`, `abort`, `reset`, `answer`: one request each to the service."""

from __future__ import annotations

from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.options import config_option
from agent.service.client import Client, NoService
from agent.settings.load import read_settings
from agent.settings.schema import Settings


@click.command("hold")
@config_option
@reported
def hold_command(config: Path) -> None:
    """Have the axes stop where they are until `volcal resume`."""
    with Client(read_settings(config)) as client:
        client.post("/api/hold")
    click.echo("hold asked for")


@click.command("abort")
@config_option
@click.option("--reason", default="volcal abort", show_default=True, help="What the journal keeps.")
@reported
def abort_command(config: Path, reason: str) -> None:
    """Stop, withdraw, restore the former table. Needs no token; between runs nothing happens."""
    with Client(read_settings(config)) as client:
        client.post("/api/abort", {"reason": reason}, token=False)
    click.echo("abort asked for")


@click.command("reset")
@config_option
@reported
def reset_command(config: Path) -> None:
    """Acknowledge a fault or an abort, so that the next run may start. Moves nothing."""
    with Client(read_settings(config)) as client:
        client.post("/api/reset")
    click.echo("reset")


@click.command("answer")
@click.argument("number", type=click.IntRange(min=1))
@click.argument("said", type=click.Choice(["yes", "no"]))
@config_option
@reported
def answer_command(number: int, said: str, config: Path) -> None:
    """Answer the question that the run has asked; `volcal status` shows it with its number."""
    with Client(read_settings(config)) as client:
        client.post("/api/answer", {"number": number, "yes": said == "yes"})
    click.echo(f"question {number}: {said}")


def resumed_by_service(settings: Settings) -> bool:
    """Whether a service has been asked to go on, with what is held or with the run that broke off."""
    try:
        client = Client(settings)
    except NoService:
        return False
    with client:
        if "resume" in client.get("/api/status")["may"]:
            client.post("/api/resume")
            click.echo("resume asked for")
        else:
            click.echo(client.post("/api/resume-run", {"source": "command line"})["run_id"])
    return True
