"""Journal records of a resumed run, in the order written. The run replays its procedure and compares what it does with
these records.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from agent.errors import PlanDiverged
from agent.execution.encoding import decode_result
from agent.execution.journal_reader import JournalReader
from agent.execution.journal_rows import EventRow, StepRow
from agent.execution.states import RunState
from agent.execution.stored_json import stored_json

_PASSING = (RunState.IDLE, RunState.PREFLIGHT, RunState.RESUMING, RunState.HELD, RunState.WRITTEN)
_ENDING = (RunState.ABORTING, RunState.ABORTED, RunState.FAULTED)
_PROCESS_EVENTS = frozenset({"state", "note", "fault", "asked"})
_UNREPLAYED_DECISIONS = frozenset({"inputs", "outcome"})


@dataclass(frozen=True, slots=True)
class RecordedStep:
    """Step of a run read from the journal, with its decoded result.

    `ordinal` is the sequence number of the step in the run, `key` its unique key, `kind` the name of its class, and
    `detail` the JSON text of its other fields.

    `finished_s` is the machine time in s at which the step ended; it is None if the step did not end.
    """

    ordinal: int
    key: str
    kind: str
    detail: str
    finished_s: float | None
    result: Any


@dataclass
class ReplayLog:
    """Queues of the journal records of a resumed run. When the run replays its procedure, it removes each record from
    its queue instead of writing it again.

    `steps` contains the steps that ended, and `states` the states of the run. `unfinished` is the last step if it began
    but did not end, else None. `entries` maps the name of each database table to the entries of that table, each of
    which is compared as a whole. `ordinal` is the last sequence number assigned in the run. `resumptions` is the number
    of times that the run has been resumed.

    Records that are not part of the procedure, such as steps that withdraw the probe, are not in the queues.
    """

    steps: deque[RecordedStep] = field(default_factory=deque)
    unfinished: RecordedStep | None = None
    states: deque[RunState] = field(default_factory=deque)
    entries: dict[str, deque[tuple[Any, ...]]] = field(default_factory=dict)
    ordinal: int = 0
    resumptions: int = 0

    def awaits(self, table: str) -> bool:
        """Return True if a recorded entry of the database table `table` is left."""
        return bool(self.entries.get(table))

    def consume(self, table: str, *entry: Any) -> bool:
        """Remove the next recorded entry of the database table `table` and return True if it equals `entry`.

        Return False if no recorded entry of this table is left. Raises PlanDiverged if the next entry differs from
        `entry`.
        """
        waiting = self.entries.get(table)
        if not waiting:
            return False
        head = waiting.popleft()
        if head != entry:
            raise PlanDiverged(
                f"the {table} of the journal have {head[0]!r} where the run now comes to {_difference(head, entry)}",
                hint="settings, files or software differ from those the run began with; start a new run",
            )
        return True


def read_replay_log(reader: JournalReader, run: int) -> ReplayLog:
    """Return the journal records of the run number `run`, with which a resumed run compares its rebuilt plan."""
    steps = [_recorded(step) for step in reader.steps(run, procedure_only=True)]
    states = reader.events(run, ("state",))
    return ReplayLog(
        steps=deque(step for step in steps if step.finished_s is not None),
        unfinished=steps[-1] if steps and steps[-1].finished_s is None else None,
        states=deque(_procedure_states(states)),
        entries=_entries(reader, run),
        ordinal=reader.last_ordinal(run),
        resumptions=sum(_state(event) is RunState.RESUMING for event in states),
    )


def comparable_estimate(estimate: str) -> tuple[str, dict[str, Any]]:
    """Return the format of the estimate with the JSON text `estimate`, and its document without the time at which it
    was written.

    The documents of two estimates are then equal if the estimates differ only in this time.
    """
    document: dict[str, Any] = stored_json(estimate)
    provenance: Mapping[str, Any] = document.get("provenance", {})
    timeless = {name: value for name, value in provenance.items() if name != "time"}
    return str(document.get("format", "")), {**document, "provenance": timeless}


def _recorded(step: StepRow) -> RecordedStep:
    result = None if step.finished_s is None else decode_result(step.kind, step.result_text)
    return RecordedStep(step.ordinal, step.key, step.kind, step.detail_text, step.finished_s, result)


def _entries(reader: JournalReader, run: int) -> dict[str, deque[tuple[Any, ...]]]:
    """Return the rows written by the plans, by table.

    States, notes and faults are omitted, because the process wrote them and not a plan.
    """
    events = reader.events(run, procedure_only=True)
    decisions = reader.decisions(run, procedure_only=True)
    tables = reader.tables(run, procedure_only=True)
    return {
        "balls": deque((ball.key, ball.record_text) for ball in reader.balls(run)),
        "events": deque((one.kind, one.record_text) for one in events if one.kind not in _PROCESS_EVENTS),
        "decisions": deque((one.kind, one.record_text) for one in decisions if one.kind not in _UNREPLAYED_DECISIONS),
        "estimates": deque(comparable_estimate(text) for text in reader.estimates(run)),
        "tables": deque((one.role, str(one.bank), "" if one.crc32 is None else str(one.crc32)) for one in tables),
    }


def _procedure_states(events: Iterable[EventRow]) -> list[RunState]:
    """Return the states of the procedure in order. A state to which a hold or a resumption returned is listed once."""
    found: list[RunState] = []
    for state in map(_state, events):
        if state not in (*_PASSING, *_ENDING) and (not found or found[-1] is not state):
            found.append(state)
    return found


def _state(event: EventRow) -> RunState:
    return RunState(event.record["state"])


def _difference(head: tuple[Any, ...], entry: tuple[Any, ...]) -> str:
    return repr(entry[0]) if entry[0] != head[0] else "the same with other figures"
