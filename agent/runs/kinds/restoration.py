"""Kind of run `restore`. The run reactivates a compensation table that is stored in the journal. The machine does not
move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from agent.execution.encoding import is_same_table, table_digest
from agent.execution.journal_reader import open_journal
from agent.execution.journal_schema import FILE_NAME
from agent.execution.states import RunState
from agent.execution.steps import Enter, Fork, RunPlan, known
from agent.planning.job import Job
from agent.probing import publish
from agent.probing.publish import ActiveCompensation
from agent.runs.kinds.run_parts import complete, found_compensation, record_table
from agent.runs.planned_run import PlannedRun, StartConditions, plan_run
from agent.runs.reference_state import TABLE_RESTORED
from agent.runs.run_results import BankInUse
from drivers.errors import InputError, NotActiveYet
from drivers.roles import StoreLimits, TableImage

TableRole = Literal["backup", "staged", "restored"]
TABLE_ROLES: tuple[TableRole, ...] = ("backup", "staged", "restored")

ALREADY, WRITTEN_AGAIN = "already active", "table activated"


@dataclass(frozen=True)
class Restoration:
    """Kind of run that reactivates a compensation table stored in the journal, namely the latest table that the run
    `run_id` stored in the role `role`. The role is "backup" (table active before the run), "staged" (table written by
    the run) or "restored" (table that the run reactivated)."""

    run_id: str
    role: TableRole = "backup"
    name: str = "restore"

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        """Return the planned run. Raises InputError if the journal does not contain the table to be restored."""
        image = stored_table(job.settings.state_directory, self.run_id, self.role)
        return plan_run(job, self, start, lambda: restoration(self, image, start.store), watch)


def restoration(asked: Restoration, image: TableImage | None, limits: StoreLimits) -> RunPlan:
    """Return the plan that writes `image` to an inactive bank, activates this bank and checks that it is active.

    If the stored state is without compensation, `image` is None, no table is written and bank 0 is activated.
    """
    found = yield from found_compensation()
    yield Enter("state/restoring", RunState.RESTORING)
    return Fork(
        "restore-table/needed",
        lambda: ALREADY if is_same_table(found.table, image) else WRITTEN_AGAIN,
        {
            WRITTEN_AGAIN: lambda: _written_again(asked, image, limits, found),
            ALREADY: lambda: _already(found),
        },
        expected=WRITTEN_AGAIN,
    )


def _already(found: ActiveCompensation) -> RunPlan:
    yield from complete(lambda: f"bank {found.bank} already held that table and was active")
    return None


def _written_again(
    asked: Restoration, image: TableImage | None, limits: StoreLimits, found: ActiveCompensation
) -> RunPlan:
    bank = 0 if image is None else publish.choose_bank(limits.banks, found.bank)
    if image is not None:
        yield from publish.stage_table(bank, image)
    yield from record_table("staged", bank, image)
    yield known("restore-table/bank", BankInUse(bank))
    late = ""
    try:
        yield from publish.activate("restore-table", bank, limits.activation)
    except NotActiveYet as waits:
        late = f". {waits.message}. {waits.hint}"
    crc32 = None if image is None else table_digest(image)
    record = {"of_run": asked.run_id, "role": asked.role, "bank": bank, "crc32": crc32}
    yield known("restore-table/done", None, lambda journal, _: journal.decision(TABLE_RESTORED, record))
    yield from complete(lambda: f"bank {bank} holds the {asked.role} table of run {asked.run_id}{late}")
    return None


def stored_table(directory: Path, run_id: str, role: str) -> TableImage | None:
    """Return the last compensation table that the run `run_id` stored in the journal in the role `role` ("backup",
    "staged" or "restored"). The result is None if the record states that no compensation was active.

    Raises InputError if the run stored no such table.
    """
    with open_journal(directory) as reader:
        run = reader.run(run_id)
        table = None if run is None else reader.last_table(run.run, role)
        image = None if table is None else reader.image(table)
    if table is None:
        file = str(directory / FILE_NAME)
        raise InputError(f"run {run_id} has stored no {role} table", hint="`/api/tables` lists them", file=file)
    return image
