"""Complete runs of one machine, read from its journal to learn from them for the next run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.execution.journal_reader import ANY_RUN, JournalReader, has_journal, open_journal
from agent.execution.journal_rows import RunRow
from agent.execution.states import RunState
from agent.execution.stored_json import stored_json
from agent.results.decision_kinds import INPUTS


@dataclass(frozen=True)
class CompleteRun:
    """Journal row of a complete run, and the journal with its decisions."""

    row: RunRow
    reader: JournalReader

    def decision(self, kind: str) -> Mapping[str, Any]:
        """Return the content of the run's last decision of the kind `kind`; an empty mapping if there is none."""
        row = self.reader.decision(self.row.run, kind)
        return {} if row is None else row.record

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings with which the run was started."""
        document: dict[str, Any] = stored_json(self.reader.settings_text(self.row.run))
        return document


def complete_runs(state_directory: Path, machine: str, before_run: int = ANY_RUN) -> Iterator[CompleteRun]:
    """Yield the complete runs of the machine with the name `machine` in the journal of `state_directory`, the latest
    first. Only runs with numbers below `before_run` count. Raises InputError if the journal cannot be read."""
    if not has_journal(state_directory):
        return
    with open_journal(state_directory) as reader:
        for row in reversed(reader.runs()):
            if row.state != RunState.COMPLETE.value or row.run >= before_run:
                continue
            run = CompleteRun(row, reader)
            if run.decision(INPUTS).get("machine") == machine:
                yield run
