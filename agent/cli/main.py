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
from typing import NamedTuple

import click
import structlog

from agent.cli.errors import VolcalGroup

# Matrices here have a hundred rows: more BLAS threads only wait for each other (measured: identification 30 ms with
# one, 59 ms with two). It must be said before numpy is first imported, which the commands below do.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

COMMAND_GROUP = "volcal.commands"
LONGEST_HELP = 200


class OwnCommand(NamedTuple):
    """Where a command is, and the first sentence of its help: said here again, so that the list of all commands
    imports none of them."""

    place: str
    says: str


OWN_COMMANDS = {
    "abort": OwnCommand(
        "agent.cli.service_commands.requests:abort_command", "Stop, withdraw, restore the former table."
    ),
    "answer": OwnCommand(
        "agent.cli.service_commands.requests:answer_command",
        "Answer the question that the run has asked; `volcal status` shows it with its number.",
    ),
    "calibrate": OwnCommand(
        "agent.cli.calibrate:calibrate_command",
        "Measure, identify, write the table, prove it, or restore what was there.",
    ),
    "config": OwnCommand("agent.cli.config:config_group", "Settings files."),
    "demo": OwnCommand(
        "agent.cli.demo:demo_command",
        "Start the simulated machine as a process, calibrate it over TCP and CAN, compare with the truth.",
    ),
    "design": OwnCommand(
        "agent.cli.design:design_command",
        "Choose the positions that leave the smallest volumetric compensated error, and write them as a position set.",
    ),
    "doctor": OwnCommand(
        "agent.cli.doctor:doctor_command", "Check settings, links and devices without moving anything."
    ),
    "gcode": OwnCommand(
        "agent.cli.gcode:gcode_group", "Part programs for controllers that have no compensation table."
    ),
    "hold": OwnCommand(
        "agent.cli.service_commands.requests:hold_command", "Have the axes stop where they are until `volcal resume`."
    ),
    "history": OwnCommand("agent.cli.history:history_group", "Every run of this machine, and its trends."),
    "identify": OwnCommand("agent.cli.identify:identify", "Identify a machine from measured ball centres."),
    "nightly": OwnCommand(
        "agent.cli.nightly:nightly_command",
        "Verify; within limits fuse what the slot allows with the nights before, and write a table that is worth it.",
    ),
    "plan": OwnCommand(
        "agent.cli.plan:plan_command",
        "Run the preflight of the whole procedure: limits, collisions, minutes and the expected VCE.",
    ),
    "report": OwnCommand(
        "agent.cli.report:report_command",
        "Write the report of RUN (its identity, or `last`), whatever it came to, from the journal alone.",
    ),
    "study": OwnCommand(
        "agent.cli.study:study_command",
        "Study the procedure without a machine; writes NAME.png, NAME.svg, NAME.csv and NAME.json into DIR.",
    ),
    "rank": OwnCommand(
        "agent.cli.rank:rank_command",
        "What a set-up will see of a machine, and what would show more; nothing is measured, no device is touched.",
    ),
    "reset": OwnCommand(
        "agent.cli.service_commands.requests:reset_command",
        "Acknowledge a fault or an abort, so that the next run may start.",
    ),
    "resume": OwnCommand(
        "agent.cli.resume:resume_command",
        "Go on with the run that broke off, where it broke off: nothing that is measured is measured again.",
    ),
    "serve": OwnCommand(
        "agent.cli.service_commands.serve:serve_command",
        "Own the machine, and let timer, page, panel and command line ask for runs.",
    ),
    "start": OwnCommand("agent.cli.service_commands.start:start_command", "Ask the service for a run."),
    "status": OwnCommand(
        "agent.cli.service_commands.status:status_command", "What the service does now, and what it may be asked for."
    ),
    "timing": OwnCommand(
        "agent.cli.timing:timing_command",
        "Compare a run's step times with the prediction, and suggest latencies for the settings.",
    ),
    "verify": OwnCommand(
        "agent.cli.verify:verify_command",
        "Measure a few positions with the compensation active and compare with the last accepted night.",
    ),
    "table": OwnCommand("agent.cli.table:table_group", "Compensation tables in the controller."),
}


class LazyGroup(VolcalGroup):
    """Commands by name, imported on demand."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*OWN_COMMANDS, *(entry.name for entry in entry_points(group=COMMAND_GROUP))})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in OWN_COMMANDS:
            module, _, attribute = OWN_COMMANDS[cmd_name].place.partition(":")
            return _as_command(getattr(import_module(module), attribute))
        for entry in entry_points(group=COMMAND_GROUP, name=cmd_name):
            return _as_command(entry.load())
        return None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, self._says(ctx, name)) for name in self.list_commands(ctx)])

    def _says(self, ctx: click.Context, name: str) -> str:
        if name in OWN_COMMANDS:
            return OWN_COMMANDS[name].says
        command = self.get_command(ctx, name)
        return command.get_short_help_str(LONGEST_HELP) if command else ""


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
