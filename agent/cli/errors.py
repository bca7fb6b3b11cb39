"""Output of the errors of the commands of `volcal`. An error is printed as one line on stderr, never as a traceback,
and the exit code is that of the error's class.

Exit codes of `volcal`:

- 0: success
- 1: unexpected error
- 2: wrong input, including usage errors reported by click
- 3: failure of a device
- 4: error in the run itself, such as a refused plan, a failed check or another run in progress
- 5: abort by a person, or interruption of the run
- 6: the service declined to start a run at this time
- 7: a run with these settings is expected to be refused by a gate (plan, config check, doctor)
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import click

from agent.cli.invocation import program_arguments
from agent.errors import Aborted
from agent.printable import printable
from drivers.address_filter import FILTER_SETTING
from drivers.errors import ConfigurationError, VolcalError

P = ParamSpec("P")
R = TypeVar("R")

ABORT = "abort"


def fail(error: VolcalError) -> SystemExit:
    """Print `error` on stderr and return a SystemExit exception with the exit code that belongs to the class of
    `error`.

    The caller raises the returned exception, which ends the program.
    """
    click.echo(f"error: {printable(str(error))}", err=True)
    return SystemExit(error.exit_code)


def reported(function: Callable[P, R]) -> Callable[P, R]:
    """Wrap the function of a command so that its errors are printed as messages.

    If the function raises a VolcalError (the base class of all expected errors), the error is printed without a
    traceback, and the program exits with the exit code of the error's class.
    """

    @wraps(function)
    def command(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except VolcalError as error:
            raise fail(_naming_simulator(error)) from None

    return command


def _naming_simulator(error: VolcalError) -> VolcalError:
    """Return `error` or, if it says that the time server of a simulator did not accept the connection, the error that
    says how to start the simulated machine. The settings are those of the option `--config` of the command."""
    config: Path | None = click.get_current_context().params.get("config")
    if config is None or error.where.get("key") != "clock" or not isinstance(error.__cause__, OSError):
        return error
    if FILTER_SETTING in error.hint:
        return error
    from agent.settings.load import read_settings  # noqa: PLC0415  the help text needs neither
    from agent.settings.simulator_command import command_of_settings  # noqa: PLC0415

    settings = read_settings(config)
    if f"{settings.clock.host}:{settings.clock.port}" not in error.message:
        return ConfigurationError(
            "the simulated machine of this run has ended with the command that started it",
            hint="start a new run; one with `volcal simulate` in another terminal can be resumed",
            file=str(config),
        )
    command = command_of_settings(settings, config)
    start = "`volcal simulate --clock lockstep` with its scenario" if command is None else f"`{command}`"
    return ConfigurationError(
        f"the simulated machine of {'this directory' if config.resolve().parent == Path.cwd() else 'these settings'} "
        "is not running",
        hint=f"start it in another terminal with {start}; `volcal calibrate --simulated` starts one for its own run",
        file=str(config),
    )


class VolcalGroup(click.Group):
    """Group of commands that prints an error without a traceback and exits with the exit code of the error's class.

    If the name of a command is mistyped, the group suggests the most similar name. Arguments that are no text are
    refused, except those of an abort, which is sent whatever its reason.
    """

    def main(self, args: Sequence[str] | None = None, *rest: Any, **named: Any) -> Any:
        return super().main(program_arguments(sys.argv[1:]) if args is None else args, *rest, **named)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        known = self.list_commands(ctx)
        if not ctx.resilient_parsing and name not in known and not name.startswith("-"):
            near = get_close_matches(name, known, n=1, cutoff=0.5)
            suggestion = f" Did you mean {near[0]!r}?" if near else ""
            ctx.fail(f"No such command {name!r}.{suggestion}")
        if name != ABORT:
            _require_text(ctx, args)
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


def _require_text(ctx: click.Context, arguments: Sequence[str]) -> None:
    """Refuse arguments with bytes that are not text in the encoding of this terminal. They could be neither stored nor
    sent: Python keeps such bytes as lone surrogates, which no encoding knows."""
    for argument in arguments:
        try:
            argument.encode()
        except UnicodeEncodeError:
            ctx.fail(f"The argument {printable(argument)!r} is no text in UTF-8; write it, or name the file, in UTF-8.")
