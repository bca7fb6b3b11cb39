"""What the journal holds of a run that is gone on with: handed out in the order in which it was written."""

from __future__ import annotations

import json
import sqlite3
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from agent.errors import PlanDiverged
from agent.execution.encoding import decode_result
from agent.execution.states import RunState

_PASSING = (RunState.IDLE, RunState.PREFLIGHT, RunState.RESUMING, RunState.HELD, RunState.WRITTEN)
_WAY_OUT = (RunState.ABORTING, RunState.ABORTED, RunState.FAULTED)


@dataclass(frozen=True, slots=True)
class RecordedStep:
    """`result` decoded; `finished_s` None for a step that began and did not end, which is never trusted."""

    ordinal: int
    key: str
    kind: str
    detail: str
    finished_s: float | None
    result: Any


@dataclass
class Recorded:
    """Queues of what a run has written; the replay takes from their heads what it would write again.

    `entries`: per table the entries that are compared as a whole. What was written on a way out or a way back is in
    none of them.
    """

    steps: deque[RecordedStep] = field(default_factory=deque)
    broken: RecordedStep | None = None
    states: deque[RunState] = field(default_factory=deque)
    entries: dict[str, deque[tuple[str, ...]]] = field(default_factory=dict)
    ordinal: int = 0
    legs: int = 0

    def takes(self, table: str, *entry: str) -> bool:
        """Whether the journal has this entry already. Raises PlanDiverged where it has another one in its place."""
        waiting = self.entries.get(table)
        if not waiting:
            return False
        head = waiting.popleft()
        if head != entry:
            raise PlanDiverged(
                f"the {table} of the journal have {head[0]!r} where the run now comes to {_difference(head, entry)}",
                hint="settings, files or software are not those the run began with; start a new run",
            )
        return True


def read_recorded(connection: sqlite3.Connection, run: int) -> Recorded:
    """Everything of `run` that a replay meets again."""
    steps = [
        RecordedStep(ordinal, key, kind, detail, finished, None if finished is None else decode_result(kind, result))
        for ordinal, key, kind, detail, finished, result in connection.execute(
            "SELECT ordinal, key, kind, detail, finished, result FROM steps WHERE run = ? AND NOT aside "
            "ORDER BY ordinal",
            (run,),
        )
    ]
    broken = steps[-1] if steps and steps[-1].finished_s is None else None
    return Recorded(
        steps=deque(step for step in steps if step.finished_s is not None),
        broken=broken,
        states=deque(_states(connection, run)),
        entries={
            "balls": _rows(connection, "SELECT key, record FROM balls WHERE run = ? ORDER BY ordinal", run),
            "events": _events(connection, run),
            "decisions": _rows(
                connection,
                "SELECT kind, record FROM decisions WHERE run = ? AND NOT aside "
                "AND kind NOT IN ('inputs', 'outcome') ORDER BY rowid",
                run,
            ),
            "estimates": deque(
                (comparable(text),)
                for (text,) in connection.execute("SELECT record FROM estimates WHERE run = ? ORDER BY rowid", (run,))
            ),
            "tables": _rows(
                connection,
                "SELECT role, cast(bank AS TEXT), coalesce(cast(crc32 AS TEXT), '') FROM tables "
                "WHERE run = ? AND NOT aside ORDER BY rowid",
                run,
            ),
        },
        ordinal=_largest_ordinal(connection, run),
        legs=_legs(connection, run),
    )


def comparable(estimate: str) -> str:
    """An estimate's text without the time at which it was written."""
    document: dict[str, Any] = json.loads(estimate)
    provenance: Mapping[str, Any] = document.get("provenance", {})
    kept = {name: value for name, value in provenance.items() if name != "time"}
    return json.dumps({**document, "provenance": kept}, sort_keys=True)


def _rows(connection: sqlite3.Connection, query: str, run: int) -> deque[tuple[str, ...]]:
    return deque(connection.execute(query, (run,)))


def _events(connection: sqlite3.Connection, run: int) -> deque[tuple[str, ...]]:
    """Only what plans have recorded; states, notes and faults tell of the process, not of the procedure."""
    query = (
        "SELECT kind, record FROM events WHERE run = ? AND NOT aside "
        "AND kind NOT IN ('state', 'note', 'fault', 'asked') ORDER BY rowid"
    )
    return _rows(connection, query, run)


def _states(connection: sqlite3.Connection, run: int) -> list[RunState]:
    """States of the procedure, each once: a hold, a way out and going on again lead back to the same one."""
    found: list[RunState] = []
    query = "SELECT record FROM events WHERE run = ? AND kind = 'state' ORDER BY rowid"
    for (text,) in connection.execute(query, (run,)):
        state = RunState(json.loads(text)["state"])
        if state not in (*_PASSING, *_WAY_OUT) and (not found or found[-1] is not state):
            found.append(state)
    return found


def _legs(connection: sqlite3.Connection, run: int) -> int:
    """How often the run has been gone on with."""
    query = "SELECT count(*) FROM events WHERE run = ? AND kind = 'state' AND record LIKE '%\"resuming\"%'"
    return int(connection.execute(query, (run,)).fetchone()[0])


def _largest_ordinal(connection: sqlite3.Connection, run: int) -> int:
    query = (
        "SELECT max(coalesce((SELECT max(ordinal) FROM steps WHERE run = ?), 0), "
        "coalesce((SELECT max(ordinal) FROM balls WHERE run = ?), 0))"
    )
    return int(connection.execute(query, (run, run)).fetchone()[0])


def _difference(head: tuple[str, ...], entry: tuple[str, ...]) -> str:
    return repr(entry[0]) if entry[0] != head[0] else "the same with other figures"
