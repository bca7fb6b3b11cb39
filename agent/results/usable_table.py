"""Conditions under which a table that was read from a file may be used."""

from __future__ import annotations

from pathlib import Path

from agent.errors import GateRefused
from agent.model_files import load_machine
from agent.settings.load import naming, read_settings
from drivers.errors import InputError
from twin.compensation.table import CompensationTable


def require_unmarked(table: CompensationTable, file: str) -> None:
    """Raise GateRefused if `table`, read from `file`, carries the mark that it was written although gates had not been
    passed."""
    if table.gates_not_passed:
        raise GateRefused(
            f"the table was written although it did not pass the gates {', '.join(table.gates_not_passed)}",
            hint="the report beside it says why; `--even-so` uses the table all the same",
        ).at(file=file)


def require_machine(table: CompensationTable, config: Path, file: str) -> None:
    """Raise InputError if `table`, read from `file`, corrects a machine other than that of the settings file `config`.
    A table that does not name its machine is accepted."""
    with naming(config):
        machine = load_machine(read_settings(config).machine).name
    if table.machine and table.machine != machine:
        raise InputError(
            f"the table corrects the machine {table.machine}, but the settings are those of the machine {machine}",
            hint=f"take a table of {machine}, or name the settings of {table.machine} with --config",
            file=file,
        )
