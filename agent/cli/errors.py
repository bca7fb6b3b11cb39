"""How a command ends badly: one line on stderr, the exit code of the error tree, never a traceback.

`volcal` ends with 0 when all went well, 2 for wrong input (click's own usage errors included), 3 for a
device, 4 when the run itself decided, 5 when somebody aborted it, 6 when the service
let no run begin at this time, 1 for what should not have happened.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import click

from agent.errors import Aborted
from drivers.errors import VolcalError

P = ParamSpec("P")
R = TypeVar("R")


def fail(error: VolcalError) -> SystemExit:
    """Print the error as people should see it and return the exit to raise."""
    click.echo(f"error: {error}", err=True)
    return SystemExit(error.exit_code)


def reported(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a command's body so that an error of the tree becomes a message and an exit code."""

    @wraps(function)
    def command(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except VolcalError as error:
            raise fail(error) from None

    return command


class VolcalGroup(click.Group):
    """A group of commands that all end as this module says."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except VolcalError as error:
            raise fail(error) from None
        except KeyboardInterrupt:
            raise fail(Aborted("interrupted from the keyboard")) from None
        except BrokenPipeError:
            sys.stderr.close()  # nobody reads on: silence the interpreter's own complaint too
            raise SystemExit(1) from None
