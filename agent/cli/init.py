"""Command `volcal init`, which writes all files that volcal needs for a machine of one's own."""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.planning.new_machine.field import FieldKind, ProposalsOnly, SetupField
from agent.planning.new_machine.fields import SETUP_FIELDS, option_texts

if will_run():
    from agent.cli.printing import facts_table, gates_table, results_console
    from agent.files import check_folder
    from agent.planning.new_machine.answers import SetupAnswers
    from agent.planning.new_machine.new_setup import SETTINGS_FILE
    from agent.planning.new_machine.spindle import spindle_name
    from agent.results.gates.gate_forecast import require_forecast
    from agent.runs.new_machine_files import PREVIEW, NewFiles, prepare_files, refuse_existing
    from agent.settings.load import read_settings
    from agent.settings.plausible_ranges import implausible_values
    from drivers.errors import InputError

Answer = TypeVar("Answer")


class TerminalQuestions:
    """Questions to a person at a terminal, who is asked again after an answer that cannot be read."""

    def ask(self, field: SetupField[Any], question: str, read: Callable[[str], Answer], proposal: str | None) -> Answer:
        kind = click.Choice(list(field.choices)) if field.choices else None
        while True:
            text = str(click.prompt(question, default=proposal, type=kind, err=True))
            try:
                return read(text)
            except InputError as error:
                click.echo(f"{error}", err=True)


def _click_type(field: SetupField[Any]) -> dict[str, Any]:
    """Return the arguments of the option of a field that say what it takes."""
    lowest, highest = (None if math.isinf(end) else end for end in (field.lowest, field.highest))
    first, last = (None if end is None else int(end) for end in (lowest, highest))
    three = {"nargs": 3, "metavar": "X Y Z"}
    arguments: dict[FieldKind, dict[str, Any]] = {
        FieldKind.TEXT: {"metavar": field.metavar},
        FieldKind.CHOICE: {"type": click.Choice(list(field.choices))},
        FieldKind.NUMBER: {"type": float if lowest is highest is None else click.FloatRange(lowest, highest)},
        FieldKind.INTEGER: {"type": click.IntRange(first, last)},
        FieldKind.TRIPLE: {**three, "type": float},
        FieldKind.TRAVELS: three,
        FieldKind.FILE: {"type": click.Path(path_type=Path)},
    }
    return arguments[field.kind]


def _setup_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that answer the questions."""
    for field in reversed(SETUP_FIELDS):
        text = field.option or f"{field.en}."
        command = click.option(field.flag, field.name, help=text, **_click_type(field))(command)
    return command


@click.command("init")
@click.argument("directory", type=click.Path(path_type=Path), default=Path())
@_setup_options
@click.option("--page", is_flag=True, help="Ask on a page in the browser, with a drawing and checks of the axes.")
@click.option("--port", type=click.IntRange(0, 65535), help="Port of the page [default: 8518]; 0: any.")
@click.option("--yes", "-y", is_flag=True, help="Ask nothing: take the proposals. Default without a terminal.")
@click.option("--force", is_flag=True, help="Replace files of the same names.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@reported
def init_command(
    directory: Path, page: bool, port: int | None, yes: bool, force: bool, as_json: bool, **typed: Any
) -> None:
    """Ask about a machine and write machine, artefact, settings and simulator files into DIRECTORY, ready to run."""
    if not force:
        refuse_existing(directory)
    check_folder(directory)
    if page:
        files, document = _ask_on_page(directory, typed, port=port, force=force, as_json=as_json)
    elif port is not None:
        raise click.UsageError("--port needs --page")
    else:
        files, document = _ask_here(directory, typed, interactive=sys.stdin.isatty() and not yes)
    if as_json:
        click.echo(json.dumps(document, allow_nan=False))
    else:
        _show(files, document)
    if files.refused is not None:
        raise files.refused
    require_forecast(files.forecasts)


def _ask_here(directory: Path, typed: Mapping[str, Any], *, interactive: bool) -> tuple[NewFiles, dict[str, Any]]:
    """Ask in the terminal, write the files, and return them with the result."""
    answers = SetupAnswers(option_texts(typed), TerminalQuestions() if interactive else ProposalsOnly(), directory)
    with tempfile.TemporaryDirectory() as scratch:
        try:
            files = prepare_files(answers, Path(scratch))
        finally:
            for note in answers.notes:
                click.echo(f"note: {note}", err=True)
        files.write(directory)
        settings = directory / SETTINGS_FILE
        for warning in implausible_values(read_settings(settings), settings):
            click.echo(f"warning: {warning}", err=True)
        preview = files.draw(directory / PREVIEW)
    return files, {**files.document(directory), "preview": [str(path) for path in preview]}


def _ask_on_page(
    directory: Path, typed: Mapping[str, Any], *, port: int | None, force: bool, as_json: bool
) -> tuple[NewFiles, dict[str, Any]]:
    """Serve the set-up page until a person has written the files and finished it, and return them with the result.

    `typed` are the options of the command line, which the page shows as stated. Raises Aborted if the page was ended
    before anything was written.
    """
    from agent.service.daemon.serve_setup import SETUP_PORT, serve_setup  # noqa: PLC0415  the web server is slow to import
    from agent.service.setup.session import SetupSession  # noqa: PLC0415

    def ready(url: str) -> None:
        if as_json:
            click.echo(json.dumps({"url": url}))
        else:
            click.echo(f"open in a browser on this computer: {url}")
            click.echo("Ctrl-C ends the page; nothing is written before its last step")

    session = SetupSession(directory, option_texts(typed), force=force)
    serve_setup(session, SETUP_PORT if port is None else port, ready)
    files, document = session.written_files, session.written
    assert files is not None  # noqa: S101  serve_setup raises otherwise
    assert document is not None  # noqa: S101
    return files, document


def _show(files: NewFiles, document: Mapping[str, Any]) -> None:
    machine, stations, job = files.setup.machine, files.setup.stations, files.chosen.job
    procedure = job.settings.procedure
    travel = " × ".join(f"{length:g}" for length in machine.travel_mm)
    rows = [
        ("machine", f"{machine.name}: {machine.kind.name}, {travel} mm"),
        ("kinematics", f"{machine.chain}, spindle {spindle_name(machine.spindle)}"),
        ("artefact", f"{job.artefact.name}: {job.artefact.count} balls"),
        ("mount", f"{len(stations.places_mm)} stations, shaft {stations.shaft_mm:g} mm")
        if not stations.by_hand
        else ("places", f"{len(stations.places_mm)}, at which the artefact is placed by hand"),
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
    console.print(gates_table(files.forecasts))
    for path in (*document["files"], *document["preview"]):
        click.echo(path)
    for line in _closing_lines(files, document["next"]):
        click.echo(line)


def _closing_lines(files: NewFiles, commands: Sequence[str]) -> list[str]:
    """Return the lines that say what to do with the files of a machine."""
    line = " && ".join(commands)
    if not files.ready:
        return [
            f"next: correct {SETTINGS_FILE} as the error says, or state other options and add --force; then: {line}"
        ]
    if files.setup.controller.is_simulated:
        return [f"next: {line}"]
    return [
        "before a run on the machine: docs/how-to/your-machine.md, step 4 (certificate, mount, a hand at the emergency "
        "stop)",
        f"next: {line}",
        "then, if `volcal try` found everything as expected: volcal calibrate",
    ]
