"""Kind of run `restore`. The run reactivates a compensation table that is stored in the journal. The machine does not
move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from agent.execution.encoding import table_digest
from agent.execution.journal_reader import open_journal
from agent.execution.journal_schema import FILE_NAME
from agent.execution.states import RunState
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult
from agent.probing import publish
from agent.probing.run_plan import MeasuredPositions
from agent.runs.guarded_run import GuardedRun
from agent.runs.planned_run import PlannedRun, StartConditions
from agent.runs.reference_state import TABLE_RESTORED
from agent.runs.run_context import RunContext
from drivers.errors import InputError, NotActiveYet
from drivers.roles import TableImage

TableRole = Literal["backup", "staged", "restored"]
TABLE_ROLES: tuple[TableRole, ...] = ("backup", "staged", "restored")

_NOTHING = MeasuredPositions((), (), 0, None, {})


@dataclass(frozen=True)
class Restoration:
    """Kind of run that reactivates a compensation table stored in the journal, namely the latest table that the run
    `run_id` stored in the role `role`. The role is "backup" (table active before the run), "staged" (table written by
    the run) or "restored" (table that the run reactivated)."""

    run_id: str
    role: TableRole = "backup"
    name: str = "restore"

    def plan(self, job: Job, start: StartConditions, _: Callable[[], None]) -> PlannedRun:
        """Return the planned run. Raises InputError if the journal does not contain the table to be restored."""
        image = stored_table(job.settings.state_directory, self.run_id, self.role)
        preflight = PreflightResult(_NOTHING, _NOTHING, {}, (), 0.0, 0.0, 0)
        return PlannedRun(job, self, start, preflight, lambda context: RestorationRun(job, context, image, self))


class RestorationRun(GuardedRun):
    """Run that writes a compensation table stored in the journal to an inactive bank (memory of the controller for one
    table), activates this bank and checks that it is active.

    If one of these steps fails, the table active before the run is reactivated. If the stored state is without
    compensation, no table is written and bank 0 is activated.
    """

    def __init__(self, job: Job, context: RunContext, image: TableImage | None, kind: Restoration) -> None:
        super().__init__(job, context)
        self._image = image
        self._kind = kind

    def _work(self) -> None:
        found = self._begin()
        self._tracker.enter(RunState.RESTORING)
        if _same(found.table, self._image):
            self._tracker.enter(RunState.COMPLETE, f"bank {found.bank} already held that table and was active")
            return
        bank = self._staged(found.bank)
        self._journal.table("staged", bank, self._image)
        self.progress.active_bank = bank
        late = ""
        try:
            self._engine.run(publish.activate("restore-table", bank, self.activation))
        except NotActiveYet as waits:
            late = f". {waits.message}. {waits.hint}"
        crc32 = None if self._image is None else table_digest(self._image)
        record = {"of_run": self._kind.run_id, "role": self._kind.role, "bank": bank, "crc32": crc32}
        self._journal.decision(TABLE_RESTORED, record)
        text = f"bank {bank} holds the {self._kind.role} table of run {self._kind.run_id}{late}"
        self._tracker.enter(RunState.COMPLETE, text)

    def _staged(self, active: int) -> int:
        """Stage the table and return its bank; return bank 0 if the restored state is without compensation."""
        if self._image is None:
            return 0
        bank = publish.choose_bank(self._rig.store.store_limits().banks, active)
        self._engine.run(publish.stage_table(bank, self._image))
        return bank


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


def _same(one: TableImage | None, other: TableImage | None) -> bool:
    return one is other if one is None or other is None else one.same_as(other)
