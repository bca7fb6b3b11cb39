"""The two ways to answer the questions of `volcal init`: in the terminal, and on a page in the browser."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click

from agent.files import translated
from agent.runs.new_machine.answers import InitOptions, SetupAnswers
from agent.runs.new_machine.fields import option_texts
from agent.runs.new_machine.new_files import PREVIEW, NewFiles, prepare_files
from agent.runs.new_machine.questions import ProposalsOnly
from drivers.errors import InputError

Answer = TypeVar("Answer")


class TerminalQuestions:
    """Questions to a person at a terminal, who is asked again after an answer that cannot be read."""

    def ask(
        self,
        option: str,
        question: str,
        read: Callable[[str], Answer],
        *,
        proposal: str | None = None,
        choices: Sequence[str] = (),
    ) -> Answer:
        kind = click.Choice(list(choices)) if choices else None
        while True:
            text = str(click.prompt(question, default=proposal, type=kind, err=True))
            try:
                with translated(InputError, option=option):
                    return read(text)
            except InputError as error:
                click.echo(f"{error}", err=True)


def ask_here(directory: Path, typed: Mapping[str, Any], *, interactive: bool) -> tuple[NewFiles, dict[str, Any]]:
    """Ask in the terminal, write the files, and return them with the result."""
    answers = SetupAnswers(InitOptions(**typed), TerminalQuestions() if interactive else ProposalsOnly(), directory)
    with tempfile.TemporaryDirectory() as scratch:
        try:
            files = prepare_files(answers, Path(scratch))
        finally:
            for note in answers.notes:
                click.echo(f"note: {note}", err=True)
        files.write(directory)
        preview = files.draw(directory / PREVIEW)
    return files, {**files.document(directory), "preview": [str(path) for path in preview]}


def ask_on_page(
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
