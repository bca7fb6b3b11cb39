"""A run as another process reads it from the journal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from agent.execution.journal_reader import open_journal
from agent.execution.journal_rows import BallRow, DecisionRow, EventRow, RunRow, StepRow, TableRow, TouchRow


@dataclass(frozen=True)
class StoredRun:
    row: RunRow
    steps: tuple[StepRow, ...]
    touches: tuple[TouchRow, ...]
    balls: tuple[BallRow, ...]
    events: tuple[EventRow, ...]
    decisions: tuple[DecisionRow, ...]
    tables: tuple[TableRow, ...]

    @property
    def states(self) -> list[str]:
        """Every state that the run entered, in order."""
        return [event.record["state"] for event in self.events if event.kind == "state"]

    @property
    def measured_twice(self) -> list[str]:
        """Keys of touches and balls that the procedure has more than once."""
        return repeated(row.key for row in self.touches) + repeated(row.key for row in self.balls)

    def steps_of(self, *kinds: str) -> list[StepRow]:
        return [step for step in self.steps if step.kind in kinds]

    def results(self, key: str) -> list[object]:
        """Results of the steps with that key."""
        return [step.result for step in self.steps if step.key == key]


def stored_run(state: Path, run_id: str | None = None) -> StoredRun:
    """Return a run of the journal in the state directory; the only one if no identity is given."""
    with open_journal(state) as reader:
        if run_id is None:
            (row,) = reader.runs()
        else:
            row = reader.require_run(run_id)
        return StoredRun(
            row=row,
            steps=reader.steps(row.run),
            touches=reader.touches(row.run),
            balls=reader.balls(row.run),
            events=reader.events(row.run),
            decisions=reader.decisions(row.run),
            tables=reader.tables(row.run),
        )


def repeated(keys: Iterable[str]) -> list[str]:
    return [key for key, count in Counter(keys).items() if count > 1]
