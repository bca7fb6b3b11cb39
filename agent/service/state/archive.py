"""Content of the journal as plain documents for the endpoints. It is read through separate connections, which never
delay a run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.errors import JournalFailed
from agent.execution.journal_reader import ANY_RUN, JournalReader, has_journal, open_journal
from agent.execution.journal_rows import RunCounts, RunRow, TableRow
from agent.execution.stored_gates import gate_records
from agent.execution.stored_json import stored_json
from agent.results.decision_kinds import OUTCOME
from agent.results.run_verdict import run_figures
from drivers.errors import InputError

Document = dict[str, Any]


class UnknownRun(InputError):
    """Error raised if the journal has no run with the requested identity, or if the run does not have the requested
    document."""


@dataclass(frozen=True)
class Archive:
    """Runs, balls, events and tables of the journal in the state directory `directory`.

    `reports` is a function that returns the path of the report of a run; it renders the report if necessary. `running`
    is a function that returns the identity of the run in progress, or None.
    """

    directory: Path
    reports: Callable[[str], Path]
    running: Callable[[], str | None] = lambda: None

    def runs(self, limit: int, before: str | None = None) -> list[Document]:
        """Return summaries of at most `limit` runs, the latest first. If `before` is the identity of a run, only
        earlier runs are returned.
        """
        if not has_journal(self.directory):
            return []
        with self._reading() as reader:
            before_run = _run(reader, before).run if before else ANY_RUN
            return [self._summary(reader, counts) for counts in reader.run_counts(limit, before_run)]

    def run(self, run_id: str) -> Document:
        """Return the summary of a run with its request, its gates and its decisions."""
        with self._reading() as reader:
            run = _run(reader, run_id).run
            (counts,) = reader.run_counts(1, run + 1)
            settings = stored_json(reader.settings_text(run))
            decisions = reader.decisions(run)
            asked = reader.events(run, ("asked",), limit=1)
            gates = (one.record for one in decisions if one.kind == "gate")
            return {
                **self._summary(reader, counts),
                "position_set": settings["procedure"]["position_set"],
                "asked": asked[0].record if asked else None,
                "gates": gate_records(gates, settings),
                "decisions": [
                    {"at": one.at, "kind": one.kind, "record": one.record}
                    for one in decisions
                    if one.kind not in ("gate", "accepted")
                ],
                "accepted": any(one.kind == "accepted" for one in decisions),
            }

    def settings(self, run_id: str) -> Document:
        """Return the settings with which a run was started. Raise UnknownRun if the journal does not have the run."""
        with self._reading() as reader:
            settings: Document = stored_json(reader.settings_text(_run(reader, run_id).run))
            return settings

    def balls(self, run_id: str) -> list[Document]:
        """Return the records of the measured balls of a run, in the order of measurement."""
        with self._reading() as reader:
            return [{"key": ball.key, **ball.record} for ball in reader.balls(_run(reader, run_id).run)]

    def temperatures(self, run_id: str) -> list[Document]:
        """Return the temperature readings of a run. The field `minutes` of a reading is the machine time in min since
        the first step of the run."""
        with self._reading() as reader:
            rows = reader.temperatures(_run(reader, run_id).run)
            return [{"minutes": row.minutes, "celsius": row.record} for row in rows]

    def events(self, run_id: str, limit: int, after: int = 0) -> list[Document]:
        """Return at most `limit` events of a run, in the order in which they were written. `after` is the number of the
        last event that the caller already has."""
        with self._reading() as reader:
            rows = reader.events(_run(reader, run_id).run, after=after, limit=limit)
            return [{"number": row.number, "at": row.at, "kind": row.kind, "record": row.record} for row in rows]

    def estimate(self, run_id: str) -> Document:
        """Return the content of the estimate file of a run. Raise UnknownRun if the run has no estimate."""
        with self._reading() as reader:
            text = reader.last_estimate(_run(reader, run_id).run)
        if text is None:
            raise UnknownRun(f"run {run_id} has no estimate", hint="the run ended before the errors were identified")
        document: Document = stored_json(text)
        return document

    def report(self, run_id: str) -> Path:
        """Return the path of the report of a run. Raise UnknownRun if the run has not ended, and InputError if the
        report cannot be rendered."""
        with self._reading() as reader:
            ended = _run(reader, run_id).ended
        if ended is None:
            raise UnknownRun(f"run {run_id} has no report yet", hint="the run has not ended")
        return self.reports(run_id)

    def tables(self, limit: int) -> list[Document]:
        """Return at most `limit` stored compensation tables, the latest first. They comprise backups, staged tables
        (written into an inactive bank) and restored tables."""
        if not has_journal(self.directory):
            return []
        with self._reading() as reader:
            return [_table(row) for row in reader.latest_tables(limit)]

    def _reading(self) -> AbstractContextManager[JournalReader]:
        if not has_journal(self.directory):
            raise UnknownRun("there is no run yet", hint="the journal is created by the first run")
        return open_journal(self.directory, JournalFailed)

    def _summary(self, reader: JournalReader, counts: RunCounts) -> Document:
        run = counts.run
        decision = reader.decision_records(run.run)
        figures = run_figures(run.state, decision)
        running = run.ended is None and run.run_id == self.running()
        verdict = figures.verdict(run.kind, run.state, ended=run.ended is not None, running=running)
        outcome = decision(OUTCOME) or {}
        return {
            "run_id": run.run_id,
            "kind": run.kind,
            "started": run.started,
            "ended": run.ended,
            "state": run.state,
            "reason": run.reason,
            "software": run.software,
            "balls": counts.balls,
            "touches": counts.touches,
            "machine_minutes": outcome.get("machine_minutes"),
            "verdict": verdict.as_json(),
            "ve_um": figures.ve_um,
            "vce_um": figures.vce_um,
            "held_out_before_um": figures.held_out_before_um,
            "held_out_after_um": figures.held_out_after_um,
            "report": (self.directory / run.run_id / "report.html").is_file(),
        }


def _run(reader: JournalReader, run_id: str) -> RunRow:
    run = reader.run(run_id)
    if run is None:
        raise UnknownRun(f"the journal has no run {run_id}", hint="`/api/runs` lists them")
    return run


def _table(row: TableRow) -> Document:
    """Return the facts of a stored table. The grid and the checksum are None if the bank was empty."""
    return {
        "run_id": row.run_id,
        "at": row.at,
        "role": row.role,
        "bank": row.bank,
        "crc32": None if row.crc32 is None else f"{row.crc32:08x}",
        "origin_mm": _listed(row.origin_mm_text),
        "step_mm": _listed(row.step_mm_text),
        "resolution_mm": row.resolution_mm,
        "shape": _listed(row.shape_text),
    }


def _listed(text: str | None) -> Any:
    return None if text is None else stored_json(text)
