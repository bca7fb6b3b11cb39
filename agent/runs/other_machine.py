"""Refusal of a state directory in which another machine has left an unfinished run or an unproved table.

Settings files of two machines in one folder share the default state directory, and so the journal. A run of one machine
would then end the unfinished run of the other one and hide its table.
"""

from __future__ import annotations

from dataclasses import dataclass

from agent.execution.journal_reader import JournalReader, open_journal
from agent.execution.stored_json import stored_json
from agent.model_files import load_machine
from agent.results.decision_kinds import INPUTS
from agent.runs.reconcile import unproved_table
from agent.runs.unfinished_run import unfinished_run
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError


@dataclass(frozen=True)
class _MachineNames:
    """Names of a machine in its file and in the settings of the history; None where there is none."""

    in_file: str | None
    in_history: str | None

    def differing(self, other: _MachineNames) -> str:
        """Return the name of this machine if `other` is another machine, and an empty text if it is the same or if that
        cannot be told. The name in the history is that of the machine even if the machine file was changed."""
        for mine, others in ((self.in_history, other.in_history), (self.in_file, other.in_file)):
            if mine is not None and others is not None:
                return "" if mine == others else mine
        return ""


def require_own_state_directory(settings: Settings) -> None:
    """Raise ConfigurationError if another machine has left a run that can be resumed or an unproved table in the state
    directory of `settings`. A run of the machine of `settings` would end that run or hide that table.

    A run in progress looks like one that can be resumed. Raises InputError if the journal cannot be read.
    """
    directory = settings.state_directory
    unproved, unfinished = unproved_table(directory), unfinished_run(directory)
    if unproved is not None:
        other = _other_machine(settings, unproved.run_id)
        if other:
            raise _refusal(f"a table of run {unproved.run_id} of another machine ({other}) was never proved")
    if unfinished is not None and unfinished.resumable:
        other = _other_machine(settings, unfinished.run_id)
        if other:
            raise _refusal(f"run {unfinished.run_id} of another machine ({other}) is unfinished")


def _refusal(message: str) -> ConfigurationError:
    return ConfigurationError(
        message,
        hint="use one state directory for each machine; if this machine was renamed, give it the former name until "
        "that run has been resumed or given up, or move the state directory away",
        key="state_directory",
    )


def _other_machine(settings: Settings, run_id: str) -> str:
    """Return the name of the machine of the run `run_id` if it is not that of `settings`, else an empty text."""
    with open_journal(settings.state_directory) as reader:
        recorded = _recorded_names(reader, reader.require_run(run_id).run)
    return recorded.differing(_MachineNames(load_machine(settings.machine).name, settings.history.machine))


def _recorded_names(reader: JournalReader, run: int) -> _MachineNames:
    inputs = reader.decision(run, INPUTS)
    history = stored_json(reader.settings_text(run)).get("history", {})
    return _MachineNames(None if inputs is None else inputs.record.get("machine"), history.get("machine"))
