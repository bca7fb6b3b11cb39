"""`volcal serve`: the night service, under systemd or in a terminal."""

from __future__ import annotations

import logging
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.options import config_option
from agent.service.daemon.logs import log_as_json
from agent.service.daemon.serve import serve


@click.command("serve")
@config_option
@click.pass_context
@reported
def serve_command(ctx: click.Context, config: Path) -> None:
    """Own the machine, and let timer, page, panel and command line ask for runs. Logs go to stdout as JSON lines."""
    verbose = bool(ctx.parent is not None and ctx.parent.params.get("verbose"))
    log_as_json(logging.DEBUG if verbose else logging.INFO)
    serve(config)
