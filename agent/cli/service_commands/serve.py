"""Command `volcal serve`, which runs the service, the process that owns the machine. The command is started by systemd
or in a terminal.
"""

from __future__ import annotations

import logging
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import config_option

if will_run():
    from agent.service.daemon.logs import log_as_json
    from agent.service.daemon.serve import serve


@click.command("serve")
@config_option
@click.pass_context
@reported
def serve_command(ctx: click.Context, config: Path) -> None:
    """Run the service that owns the machine and accepts requests from timer, page, panel and command line.

    Logs go to stdout as JSON lines.
    """
    verbose = bool(ctx.parent is not None and ctx.parent.params.get("verbose"))
    log_as_json(logging.DEBUG if verbose else logging.INFO)
    serve(config)
