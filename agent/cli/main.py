"""Program `volcal`, with its own commands and with the commands that other packages declare as entry points.

The module of a command is imported only if that command is called. `volcal --help` and shell completion therefore start
without the plotting and protocol libraries.
"""

from __future__ import annotations

import logging
import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

import click

from agent.cli.errors import VolcalGroup
from agent.cli.invocation import will_run
from agent.lasting_output import lasting

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

# Matrices here have a hundred rows: more BLAS threads only wait for each other (measured: identification 30 ms with
# one, 59 ms with two). It must be set before numpy is first imported, which the commands below do.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

COMMAND_GROUP = "volcal.commands"
HELP_GROUP = "volcal.command_help"
"""Group of entry points that load the help lines of commands. Each one has the name of its command; its module imports
quickly.
"""
LONGEST_HELP = 200


class OwnCommand(NamedTuple):
    """Import path and one-line help of a command that is part of the program `volcal` itself.

    `help` is the first sentence of the command's help text. It is repeated here so that the list of all commands can be
    shown without importing the commands.

    `logs` is True if any code that the command calls writes logs. If `logs` is False, the logging library is not
    imported.
    """

    import_path: str
    help: str
    logs: bool = True


OWN_COMMANDS = {
    "acceptance": OwnCommand(
        "agent.cli.offline_commands.acceptance:acceptance_command",
        "Predict what a laser and a ballbar will show: the figures of ISO 230, each with its uncertainty.",
        logs=False,
    ),
    "actions": OwnCommand(
        "agent.cli.offline_commands.actions:actions_command",
        "Propose at most five mechanical actions on a machine, each with its amount and its gain.",
        logs=False,
    ),
    "abort": OwnCommand(
        "agent.cli.service_commands.requests:abort_command",
        "Stop the run, withdraw the probe and restore the previous table.",
        logs=False,
    ),
    "answer": OwnCommand(
        "agent.cli.service_commands.requests:answer_command",
        "Answer the open question of the run; `volcal status` shows it with its number.",
        logs=False,
    ),
    "artefact": OwnCommand(
        "agent.cli.offline_commands.artefact:artefact_group",
        "Import the digital calibration certificate of an artefact.",
        logs=False,
    ),
    "calibrate": OwnCommand(
        "agent.cli.run_commands.calibrate:calibrate_command",
        "Measure, identify, write the table and verify it; restore the previous table if the check fails.",
    ),
    "config": OwnCommand(
        "agent.cli.config:config_group",
        "Check settings files, show the cross-effect of a machine, and print the schema of the settings.",
    ),
    "demo": OwnCommand(
        "agent.cli.run_commands.demo:demo_command",
        "Start the simulated machine as a process, calibrate it over TCP and CAN, and compare with the truth.",
    ),
    "design": OwnCommand(
        "agent.cli.offline_commands.design:design_command",
        "Choose the positions that leave the smallest volumetric compensated error and write them as a position set.",
    ),
    "doctor": OwnCommand(
        "agent.cli.doctor:doctor_command",
        "Check settings, links and devices, and forecast the gates of a run; nothing moves.",
    ),
    "fe": OwnCommand(
        "agent.cli.offline_commands.fe:fe_group",
        "Make deflection grids from finite elements: import results, solve a small solid model, compare.",
        logs=False,
    ),
    "gcode": OwnCommand(
        "agent.cli.table_commands.gcode:gcode_group",
        "Correct part programs for controllers that have no compensation table.",
    ),
    "hold": OwnCommand(
        "agent.cli.service_commands.requests:hold_command",
        "Stop the axes where they are until `volcal resume`.",
        logs=False,
    ),
    "history": OwnCommand(
        "agent.cli.history:history_group", "List every run of this machine and its trends.", logs=False
    ),
    "identify": OwnCommand(
        "agent.cli.offline_commands.identify:identify", "Identify a machine from measured ball centres."
    ),
    "init": OwnCommand(
        "agent.cli.init:init_command",
        "Ask about a machine and write machine, artefact, settings and simulator files into DIRECTORY, ready to run.",
    ),
    "nightly": OwnCommand(
        "agent.cli.run_commands.nightly:nightly_command",
        "Verify the machine and, within limits, fuse the measurements of the slot with earlier nights.",
    ),
    "notify": OwnCommand(
        "agent.cli.notify:notify_command",
        "Send a test notice to every receiver of the settings, once and without the service.",
    ),
    "pair": OwnCommand(
        "agent.cli.service_commands.pair:pair_command",
        "Show a code with which a panel or a phone may use the page.",
        logs=False,
    ),
    "plan": OwnCommand(
        "agent.cli.run_commands.plan:plan_command",
        "Run the preflight of the whole procedure: limits, collisions, minutes and the expected VCE.",
    ),
    "predict": OwnCommand(
        "agent.cli.offline_commands.predict:predict_command",
        "Predict the errors of the features of a workpiece, with their uncertainty, and say which will conform.",
        logs=False,
    ),
    "report": OwnCommand(
        "agent.cli.report:report_command",
        "Write the report of RUN (its identity, or `last`) from the journal alone, whatever the outcome of the run.",
    ),
    "study": OwnCommand(
        "agent.cli.offline_commands.study:study_command",
        "Study the procedure without a machine and write NAME.png, NAME.svg, NAME.csv and NAME.json into DIR.",
    ),
    "rank": OwnCommand(
        "agent.cli.offline_commands.rank:rank_command",
        "Show which errors a set-up can determine and which changes would determine more, without any device.",
    ),
    "reset": OwnCommand(
        "agent.cli.service_commands.requests:reset_command",
        "Acknowledge a fault, an abort or an alarm between runs.",
        logs=False,
    ),
    "resume": OwnCommand(
        "agent.cli.run_commands.resume:resume_command",
        "Resume the interrupted run; completed measurements are not repeated.",
    ),
    "serve": OwnCommand(
        "agent.cli.service_commands.serve:serve_command",
        "Run the service that owns the machine and accepts requests from timer, page, panel and command line.",
    ),
    "start": OwnCommand("agent.cli.service_commands.start:start_command", "Request a run from the service."),
    "status": OwnCommand(
        "agent.cli.service_commands.status:status_command",
        "Show what the service is doing and which requests it accepts.",
        logs=False,
    ),
    "timing": OwnCommand(
        "agent.cli.timing:timing_command",
        "Compare a run's step times with the prediction and suggest latencies for the settings.",
    ),
    "try": OwnCommand(
        "agent.cli.run_commands.trial:try_command",
        "Measure one ball, check probe and latch on it, and write nothing: the first run on a machine.",
    ),
    "verify": OwnCommand(
        "agent.cli.run_commands.nightly:verify_command",
        "Measure a few positions with the active table and compare with the last accepted night.",
    ),
    "table": OwnCommand("agent.cli.table_commands.table:table_group", "Show, export and restore compensation tables."),
}


class LazyGroup(VolcalGroup):
    """Group of click commands that imports the module of a command only when the command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*OWN_COMMANDS, *_declared(COMMAND_GROUP).names})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in OWN_COMMANDS:
            module, _, attribute = OWN_COMMANDS[cmd_name].import_path.partition(":")
            return _as_command(getattr(import_module(module), attribute))
        for entry in _declared(COMMAND_GROUP).select(name=cmd_name):
            return _as_command(entry.load())
        return None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, _help_line(name)) for name in self.list_commands(ctx)])


@click.group(cls=LazyGroup)
@click.version_option(package_name="volcal")
@click.option("--verbose", "-v", is_flag=True, help="Log the traffic of the links.")
@click.pass_context
def main(ctx: click.Context, verbose: bool) -> None:
    """On-machine volumetric calibration of machine tools with a ball artefact."""
    own = OWN_COMMANDS.get(ctx.invoked_subcommand or "")
    if will_run() and (own is None or own.logs):
        configure_logging(logging.DEBUG if verbose else logging.WARNING)


def configure_logging(level: int) -> None:
    """Configure structured logging for messages of `level` and above.

    Logs are written to stderr, because stdout is for results. A log that cannot be written is discarded.
    """
    import structlog  # noqa: PLC0415  slow to import, and the list of commands does not log

    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            structlog.processors.KeyValueRenderer(key_order=["timestamp", "level", "event"]),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.WriteLoggerFactory(file=lasting(sys.stderr)),
    )


def _declared(group: str) -> EntryPoints:
    """Return the entry points of a group from the metadata of all installed packages, without importing the
    packages."""
    from importlib.metadata import entry_points  # noqa: PLC0415  slow to import, and own commands do not need it

    return entry_points(group=group)


def _help_line(name: str) -> str:
    """Return the help line of a command without importing the command."""
    if name in OWN_COMMANDS:
        return OWN_COMMANDS[name].help
    for entry in _declared(HELP_GROUP).select(name=name):
        return str(entry.load())
    for entry in _declared(COMMAND_GROUP).select(name=name):
        return "" if entry.dist is None else f"(from the package {entry.dist.name})"
    return ""


def _as_command(loaded: object) -> click.Command:
    if not isinstance(loaded, click.Command):
        raise TypeError(f"{loaded!r} is not a click command")
    return loaded


if __name__ == "__main__":
    main()
