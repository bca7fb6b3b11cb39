"""Parts of which the plans of all kinds of run are composed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from agent.execution.journal import RunJournal
from agent.execution.states import RunState
from agent.execution.steps import Conclude, Enter, Plan, RunPlan, known
from agent.planning.job import Job
from agent.probing import publish
from agent.probing.measured_balls import Correction, no_correction
from agent.probing.position import PositionRules
from agent.probing.preparation import PreparationResult
from agent.probing.publish import ActiveCompensation
from agent.results.journal_entries import record_probe
from agent.results.table_image import table_of
from drivers.roles import Activation, TableImage


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """Run that is ready to measure its positions: the compensation found, and the results of the checks of the
    probe."""

    job: Job
    found: ActiveCompensation
    prepared: PreparationResult

    @property
    def rules(self) -> PositionRules:
        """Rules of measurement, with the qualified stylus if the stylus has been qualified in this run."""
        return self.prepared.rules

    @property
    def correction(self) -> Correction:
        """Correction that the table active at the start adds to displayed axis positions."""
        table = self.found.table
        return no_correction if table is None else table_of(table, self.job.tool_offset_mm).at


def found_compensation() -> Plan[ActiveCompensation]:
    """Read, journal and return the active compensation before anything moves."""
    yield Enter("state/measuring", RunState.MEASURING)
    found = yield from publish.read_state("before")
    yield known("before/found", found, lambda journal, _: _record(journal, "backup", found))
    return found


def prepared_run(job: Job, found: ActiveCompensation) -> Plan[PreparedRun]:
    """Check and qualify the probe. The result is valid for all later measurements of the run."""
    prepared = yield from job.preparation_plan()
    yield known("probe/prepared", prepared, record_probe)
    return PreparedRun(job, found, prepared)


def restored(found: ActiveCompensation, activation: Activation) -> Plan[None]:
    """Reactivate the compensation that was found at the start of the run. Raises ReadBackMismatch if its bank contains
    another table meanwhile; this table is the one that is journaled."""
    yield from publish.restore(found.bank, after_fault=False, activation=activation)
    held = yield from publish.read_restored(found.bank)
    yield known("restore/found", held, lambda journal, _: _record(journal, "restored", held))
    publish.require_as_found(found, held)


def record_table(role: str, bank: int, image: TableImage | None) -> Plan[None]:
    """Store a compensation table in the journal with the role `role`."""
    yield known(f"{role}/{bank}", None, lambda journal, _: journal.table(role, bank, image))


def complete(text: Callable[[], str]) -> Plan[None]:
    """End the run in the state COMPLETE, with the explanation that `text` returns."""
    yield Enter("state/complete", RunState.COMPLETE, text)


def refused(refuse: Callable[[], None]) -> RunPlan:
    """End the run with the GateRefused that `refuse` raises."""
    yield Conclude("refused", refuse)
    return None


def _record(journal: RunJournal, role: str, found: ActiveCompensation) -> None:
    journal.table(role, found.bank, found.table)
