"""Command `volcal pair`, which lets a panel or a phone use the page: it shows a code of six digits that the page
exchanges for a token of its own. The command also lists and revokes paired clients.
"""

from __future__ import annotations

import io
import json
import math
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import config_option

if will_run():
    import segno

    from agent.cli.printing import columns_table, results_console
    from agent.service.access.page_address import is_reachable
    from agent.service.client import Client
    from agent.settings.load import read_settings

ROLES = ("operator", "engineer")
LONGEST_MINUTES = 60
SHOWN = ("code", "ends", "role", "name", "address")


def _finite(_: click.Context, parameter: click.Parameter, minutes: float) -> float:
    if math.isnan(minutes):  # lies in every range for click
        raise click.BadParameter("nan is not a number of minutes", param=parameter)
    return minutes


@click.command("pair")
@click.option("--role", type=click.Choice(ROLES), default="operator", show_default=True, help="What the client may do.")
@click.option("--name", help="Name of the client in journal and history; default: its role and a number.")
@click.option(
    "--minutes",
    type=click.FloatRange(1, LONGEST_MINUTES),
    callback=_finite,
    default=5.0,
    show_default=True,
    metavar="N",
    help="Validity of the code.",
)
@click.option("--list", "listed", is_flag=True, help="List the paired clients instead.")
@click.option("--revoke", metavar="NAME", help="Refuse the token of this client from now on instead.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
@config_option
@reported
def pair_command(
    role: str, name: str | None, minutes: float, listed: bool, revoke: str | None, as_json: bool, config: Path
) -> None:
    """Show a code with which a panel or a phone may use the page.

    The page asks for the code, or reads it from the QR code. The code is good for one client. Needs the token of the
    machine.
    """
    if listed and revoke is not None:
        raise click.UsageError("--list and --revoke exclude each other: give one of the two")
    settings = read_settings(config)
    with Client(settings) as client:
        if revoke is not None:
            client.post("/api/pairing/revoke", {"name": revoke})
            _print({"revoked": revoke}, f"{revoke} is revoked", as_json=as_json)
        elif listed:
            _list(client.get("/api/pairing/clients", token=True), as_json=as_json)
        else:
            found = client.post("/api/pairing/code", {"role": role, "name": name, "minutes": minutes})
            _show({name: found[name] for name in SHOWN}, as_json=as_json)


def _show(found: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps(found))
        return
    ends = datetime.fromisoformat(found["ends"]).astimezone()
    code = f"{found['code'][:3]} {found['code'][3:]}"
    picture = qr_code(found["address"])
    if _can_print(picture):
        # Readers expect dark modules on a light ground, whatever the colours of the terminal are.
        click.echo("\n".join(click.style(line, fg="bright_white", bg="black") for line in picture.splitlines()))
    click.echo(f"code      {click.style(code, bold=True)}")
    click.echo(f"valid     until {ends:%H:%M:%S}, for one client")
    click.echo(f"client    {found['name']} ({found['role']})")
    click.echo(f"page      {found['address']}")
    if not is_reachable(found["address"]):
        click.echo(
            "note: only a browser on this PC reaches this address; other devices need `service.host` and "
            "`service.host_names` in the settings (docs/how-to/pair-a-panel.md)",
            err=True,
        )


def qr_code(text: str) -> str:
    """Return the QR code of `text` in block characters, two modules above each other in each."""
    drawn = io.StringIO()
    segno.make(text, micro=False).terminal(drawn, compact=True)
    return drawn.getvalue()


def _can_print(text: str) -> bool:
    try:
        text.encode(sys.stdout.encoding or "ascii")
    except UnicodeEncodeError:
        return False
    return True


def _list(found: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps(found))
        return
    if not found["clients"]:
        click.echo("no client is paired")
        return
    table = columns_table(("name", "role", "paired"), whole=("name",))
    for client in found["clients"]:
        paired = datetime.fromisoformat(client["paired"]).astimezone()
        table.add_row(client["name"], client["role"], f"{paired:%Y-%m-%d %H:%M}")
    results_console().print(table)


def _print(document: dict[str, Any], text: str, *, as_json: bool) -> None:
    click.echo(json.dumps(document) if as_json else text)
