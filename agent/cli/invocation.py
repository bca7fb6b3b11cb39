"""Distinction between a process of `volcal` that carries out a command and one that only shows a help text.

The libraries with which a command works take a second to import, its help text needs none of them. A module with a
command therefore imports them only if `will_run`:

    if will_run():
        from agent.planning.job_preparation import prepare_job

Only what the options themselves are made of, such as names to choose from, is imported in any case. Such a name must
come from a module that imports quickly.
"""

from __future__ import annotations

from collections.abc import Sequence

HELP = "--help"


class _Process:
    """Purpose of this process. `shows_help` is set once, before the module of a command is imported."""

    shows_help = False


def will_run() -> bool:
    """Return False if this process only shows the help text of a command."""
    return not _Process.shows_help


def program_arguments(arguments: Sequence[str]) -> list[str]:
    """Return the arguments to pass to the program, given the `arguments` on its command line.

    If one of them asks for help, only the names of the commands and this request are kept, so that no command can run.
    The value of an option is never mistaken for the name of a command. `will_run` returns False from then on.
    """
    own = list(arguments[: arguments.index("--")] if "--" in arguments else arguments)
    if HELP not in own:
        return list(arguments)
    _Process.shows_help = True
    return [*(word for word in own[: own.index(HELP)] if not word.startswith("-")), HELP]
