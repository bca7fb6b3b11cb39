"""Errors of a command: one line on stderr, the exit code of the error tree, never a traceback.

Exit codes of `volcal`: 0 success; 2 wrong input (usage errors of click included); 3 a device failed; 4 the run itself
decided; 5 a person aborted it; 6 the service did not start a run at this time; 1 an unexpected error.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from difflib import get_close_matches
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import click

from agent.errors import Aborted
from drivers.errors import VolcalError

P = ParamSpec("P")
R = TypeVar("R")


def fail(error: VolcalError) -> SystemExit:
    """Print the error for people and return the exit to raise."""
    click.echo(f"error: {error}", err=True)
    return SystemExit(error.exit_code)


def reported(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate the body of a command so that an error of the tree becomes a message and an exit code."""

    @wraps(function)
    def command(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except VolcalError as error:
            raise fail(error) from None

    return command


class VolcalGroup(click.Group):
    """Group of commands that turn errors into messages and exit codes, and suggest the nearest command for a typo."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        known = self.list_commands(ctx)
        if not ctx.resilient_parsing and name not in known and not name.startswith("-"):
            near = get_close_matches(name, known, n=1, cutoff=0.5)
            suggestion = f" Did you mean {near[0]!r}?" if near else ""
            ctx.fail(f"No such command {name!r}.{suggestion}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except VolcalError as error:
            raise fail(error) from None
        except KeyboardInterrupt:
            raise fail(Aborted("interrupted from the keyboard")) from None
        except BrokenPipeError:
            sys.stderr.close()  # the reader is gone: silence the message of the interpreter too
            raise SystemExit(1) from None
