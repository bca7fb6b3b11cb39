"""The command `volcal` in this process, which saves the start of a process of its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from agent.cli.main import main


def volcal(*arguments: str | Path, exit_code: int | None = 0) -> Result:
    """Run `volcal ARGUMENTS`. It must end with `exit_code`; None accepts any. A defect is raised."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert exit_code in (None, result.exit_code), result.output
    return result


def volcal_json(*arguments: str | Path, exit_code: int | None = 0) -> Any:
    """Return the object that `volcal ARGUMENTS --json` prints in its last line."""
    return json.loads(volcal(*arguments, "--json", exit_code=exit_code).stdout.splitlines()[-1])


def refused(*arguments: str | Path) -> tuple[int, str]:
    """Return the exit code and the one line, after a usage if any, that a command says when it refuses.

    Nothing may be on disk afterwards.
    """
    before = sorted(Path().rglob("*"))
    result = volcal(*arguments, exit_code=None)
    assert result.exit_code != 0
    assert result.stdout == ""
    assert sorted(Path().rglob("*")) == before
    *usage, line = result.stderr.strip().splitlines()
    assert not usage or usage[0].startswith("Usage: "), result.stderr
    return result.exit_code, line.removeprefix("error: ")
