"""The command `volcal`: its own commands, and those that other packages declare as entry points.

A command's module is imported only when that command is asked for: `volcal --help` and a shell's completion
should not wait for plotting and protocol libraries.
"""

from __future__ import annotations

import logging
import os
import sys
from importlib import import_module
from importlib.metadata import entry_points

import click
import structlog

from agent.cli.errors import VolcalGroup

# Matrices here have a hundred rows: more BLAS threads only wait for each other (measured: identification 30 ms with
# one, 59 ms with two). It must be said before numpy is first imported, which the commands below do.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

COMMAND_GROUP = "volcal.commands"

OWN_COMMANDS = {
    "abort": "agent.cli.asking:abort_command",
    "answer": "agent.cli.asking:answer_command",
    "calibrate": "agent.cli.calibrate:calibrate_command",
    "config": "agent.cli.config:config_group",
    "demo": "agent.cli.demo:demo_command",
    "design": "agent.cli.design:design_command",
    "doctor": "agent.cli.doctor:doctor_command",
    "gcode": "agent.cli.gcode:gcode_group",
    "hold": "agent.cli.asking:hold_command",
    "history": "agent.cli.history:history_group",
    "identify": "agent.cli.identify:identify",
    "nightly": "agent.cli.nightly:nightly_command",
    "plan": "agent.cli.plan:plan_command",
    "report": "agent.cli.report:report_command",
    "study": "agent.cli.study:study_command",
    "rank": "agent.cli.rank:rank_command",
    "reset": "agent.cli.asking:reset_command",
    "resume": "agent.cli.resume:resume_command",
    "serve": "agent.cli.serve:serve_command",
    "start": "agent.cli.start:start_command",
    "status": "agent.cli.status:status_command",
    "timing": "agent.cli.timing:timing_command",
    "verify": "agent.cli.verify:verify_command",
    "table": "agent.cli.table:table_group",
}


class LazyGroup(VolcalGroup):
    """Commands by name, imported on demand."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*OWN_COMMANDS, *(entry.name for entry in entry_points(group=COMMAND_GROUP))})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in OWN_COMMANDS:
            module, _, attribute = OWN_COMMANDS[cmd_name].partition(":")
            return _as_command(getattr(import_module(module), attribute))
        for entry in entry_points(group=COMMAND_GROUP, name=cmd_name):
            return _as_command(entry.load())
        return None


@click.group(cls=LazyGroup)
@click.version_option(package_name="volcal")
@click.option("--verbose", "-v", is_flag=True, help="Log what the links do.")
def main(verbose: bool) -> None:
    """On-machine volumetric calibration of machine tools with a ball artefact."""
    configure_logging(logging.DEBUG if verbose else logging.WARNING)


def configure_logging(level: int) -> None:
    """Structured logs on stderr; stdout is for results."""
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            structlog.processors.KeyValueRenderer(key_order=["timestamp", "level", "event"]),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.WriteLoggerFactory(file=sys.stderr),
    )


def _as_command(loaded: object) -> click.Command:
    if not isinstance(loaded, click.Command):
        raise TypeError(f"{loaded!r} is no click command")
    return loaded


if __name__ == "__main__":
    main()
