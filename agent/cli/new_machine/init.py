"""Command `volcal init`, which writes all files that volcal needs for a machine of one's own."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from agent.cli.errors import reported
from agent.cli.new_machine.answers import InitOptions, SetupAnswers
from agent.cli.new_machine.questions import SetupQuestions
from agent.cli.printing import facts_table, gates_table, results_console
from agent.errors import PlanRefused
from agent.files import check_folder, write_all_atomically
from agent.planning.design.set_valuation import valuation_of
from agent.planning.job import Job
from agent.planning.preflight import run_preflight
from agent.planning.setup_files.new_setup import POSITIONS_FILE, SETTINGS_FILE, NewSetup
from agent.planning.setup_proposal.controller_setup import CONTROLLERS
from agent.planning.setup_proposal.machine_class import MACHINE_CLASSES
from agent.planning.setup_proposal.spindle import SPINDLES, spindle_name
from agent.results.gate_forecast import require_forecast
from agent.results.sufficient_effort import ChosenFiles, choose_effort
from drivers.errors import ConfigurationError, InputError
from twin.units import S_PER_MIN

PREVIEW = "preview"
"""Directory of the preview, in the directory of the machine."""

THREE = {"nargs": 3, "type": float, "metavar": "X Y Z"}
OPTIONS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("--name", "Name of the machine [default: that of the directory].", {}),
    (
        "--class",
        "Class of the machine: typical errors, feeds and chain.",
        {"type": click.Choice(list(MACHINE_CLASSES))},
    ),
    ("--controller", "Controller [default: simulated].", {"type": click.Choice(CONTROLLERS)}),
    ("--address", "HOST[:PORT] of Modbus TCP, or the serial port.", {}),
    ("--travel", "Travel in mm: lengths, or LOWEST:HIGHEST positions.", {"nargs": 3, "metavar": "X Y Z"}),
    ("--spindle", "Direction from the spindle to the stylus.", {"type": click.Choice(SPINDLES)}),
    ("--chain", "Kinematic chain, such as tool-Z-bed-Y-X-workpiece.", {}),
    ("--stylus", "Ram reference to stylus centre in mm.", {"type": float}),
    ("--rapid", "Rapids in mm/min.", THREE),
    ("--feed", "Feeds in mm/min.", THREE),
    ("--acceleration", "Accelerations in mm/s².", THREE),
    ("--artefact", "Artefact file, of any shape; it is copied.", {"type": click.Path(path_type=Path)}),
    ("--bar", "Length of a ball bar between its end balls in mm.", {"type": float}),
    ("--balls", "Number of its balls.", {"type": click.IntRange(2, 99)}),
    ("--tilt", "Tilt of its holders in degrees; 0: straight.", {"type": click.FloatRange(0.0, 60.0)}),
    ("--holder", "Length of its holders in mm.", {"type": float}),
    ("--ball-diameter", "Diameter of its balls in mm.", {"type": float}),
    ("--mount-at", "Place of the mount, workpiece frame, in mm.", THREE),
    ("--shaft", "Azimuth axis to bar axis in mm.", {"type": float}),
    ("--table-z", "Height of the table, workpiece frame, in mm.", {"type": float}),
    ("--stations", "Number of stations.", {"type": click.IntRange(1, 20)}),
    ("--position-set", "S1, S2, S3, joined by +, or a position file.", {"metavar": "SET"}),
    ("--touches", "Touches of each ball: 5, 9, 13 or 25.", {"type": click.Choice([5, 9, 13, 25])}),
)
RENAMED = {"class": "machine_class"}


def _setup_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that answer the questions."""
    for flag, text, more in reversed(OPTIONS):
        parameter = flag.removeprefix("--").replace("-", "_")
        command = click.option(flag, RENAMED.get(parameter, parameter), help=text, **more)(command)
    return command


@click.command("init")
@click.argument("directory", type=click.Path(path_type=Path), default=Path())
@_setup_options
@click.option("--yes", "-y", is_flag=True, help="Ask nothing: take the proposals. Default without a terminal.")
@click.option("--force", is_flag=True, help="Replace files of the same names.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@reported
def init_command(directory: Path, yes: bool, force: bool, as_json: bool, **typed: Any) -> None:
    """Ask about a machine and write machine, artefact, settings and simulator files into DIRECTORY, ready to run."""
    _refuse_existing(directory, force)
    check_folder(directory)
    answers = SetupAnswers(InitOptions(**typed), SetupQuestions(sys.stdin.isatty() and not yes), directory)
    setup = answers.collect()
    for note in answers.notes:
        click.echo(f"note: {note}", err=True)
    with tempfile.TemporaryDirectory() as scratch:
        chosen = _chosen(setup, Path(scratch))
        refused, plan = _plan(chosen.job)
        while refused is not None and (shorter := answers.with_shorter_bar(setup)) is not None:
            setup = shorter
            chosen = _chosen(setup, Path(scratch))
            refused, plan = _plan(chosen.job)
        texts, job = chosen.texts, chosen.job
        write_all_atomically(directory, texts, removed=() if POSITIONS_FILE in texts else (POSITIONS_FILE,))
        preview = _draw(job, directory / PREVIEW, refused)
    document = {
        "directory": str(directory),
        "files": [str(directory / name) for name in texts],
        "preview": [str(path) for path in preview],
        **plan,
        "gates": [forecast.as_json() for forecast in chosen.forecasts],
        "next": _next_commands(setup, directory),
    }
    if as_json:
        click.echo(json.dumps(document, allow_nan=False))
    else:
        _show(setup, chosen, document)
    if refused is not None:
        raise refused
    require_forecast(chosen.forecasts)


def _refuse_existing(directory: Path, force: bool) -> None:
    settings = directory / SETTINGS_FILE
    if settings.exists() and not force:
        raise InputError(
            "there are settings of a machine already",
            hint="choose another directory, or add --force",
            file=str(settings),
        )


def _chosen(setup: NewSetup, scratch: Path) -> ChosenFiles:
    """Return the files that are written. An error of their check names the file as it will be called."""
    try:
        return choose_effort(setup, scratch)
    except ConfigurationError as error:
        error.where = {key: value.removeprefix(f"{scratch.resolve()}/") for key, value in error.where.items()}
        raise error.at(file=SETTINGS_FILE) from error.__cause__


def _plan(job: Job) -> tuple[PlanRefused | None, dict[str, object]]:
    """Run the preflight. Return the error if it refuses the plan, and the figures of the plan."""
    try:
        preflight = run_preflight(job)
    except PlanRefused as refused:
        return refused, {"positions": len(job.positions)}
    return None, {
        "positions": len(job.positions),
        "left_out": list(preflight.measured.left_out),
        "balls": sum(len(position.balls) for position in preflight.measured.positions),
        "machine_minutes": round(preflight.machine_seconds / S_PER_MIN, 1),
        "valuation_percent": round(valuation_of(job, job.positions).percent, 1),
    }


def _draw(job: Job, folder: Path, refused: PlanRefused | None) -> list[Path]:
    from agent.planning.preview.preview_files import write_preview  # noqa: PLC0415  plotting is slow to import

    return write_preview(job, folder, refused)


def _next_commands(setup: NewSetup, directory: Path) -> list[str]:
    """Return the commands to be typed next, in order."""
    enter = [] if directory.resolve() == Path.cwd() else [f"cd {directory}"]
    commands = [*enter, "volcal calibrate --simulated"]
    return commands if setup.controller.is_simulated else [*commands, "volcal doctor", "volcal calibrate"]


def _show(setup: NewSetup, chosen: ChosenFiles, document: Mapping[str, Any]) -> None:
    machine, stations, job = setup.machine, setup.stations, chosen.job
    procedure = job.settings.procedure
    travel = " × ".join(f"{length:g}" for length in machine.travel_mm)
    rows = [
        ("machine", f"{machine.name}: {machine.kind.name}, {travel} mm"),
        ("kinematics", f"{machine.chain}, spindle {spindle_name(machine.spindle)}"),
        ("artefact", f"{job.artefact.name}: {job.artefact.count} balls"),
        ("mount", f"{len(stations.places_mm)} stations, shaft {stations.shaft_mm:g} mm"),
        ("position set", f"{procedure.position_set}: {document['positions']} positions"),
        ("touches", f"{procedure.touches_per_ball} per ball"),
    ]
    if "balls" in document:
        rows += [
            ("measured", f"{document['balls']} balls in {document['machine_minutes']:.0f} min of machine time"),
            ("expected", f"{document['valuation_percent']:.0f} % of the volumetric error removed"),
        ]
    console = results_console()
    console.print(facts_table(rows, title="config check: the files are good"))
    console.print(gates_table(chosen.forecasts))
    for path in (*document["files"], *document["preview"]):
        click.echo(path)
    click.echo("next: " + " && ".join(document["next"]))
