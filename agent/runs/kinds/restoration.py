"""`restore`: have a table act again that the journal has kept. Nothing moves and nothing is measured."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from agent.execution.encoding import table_digest, table_from
from agent.execution.journal import FILE_NAME
from agent.execution.states import RunState
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult
from agent.probing import publish
from agent.probing.run_plan import Measured
from agent.runs.guarded_run import GuardedRun, Means
from agent.runs.kinds.kind import Ready
from agent.runs.start_conditions import Outset
from drivers.errors import InputError, NotActiveYet
from drivers.roles import TableImage

Role = Literal["backup", "staged", "restored"]
ROLES: tuple[Role, ...] = ("backup", "staged", "restored")
DECISION = "table-restored"
"""What makes the table of such a run the one that is expected to act."""

_NOTHING = Measured((), (), 0, None, {})


@dataclass(frozen=True)
class Restoration:
    """The table that run `run_id` kept as `role`; of several the last."""

    run_id: str
    role: Role = "backup"
    name: str = "restore"

    def ready(self, job: Job, _: Outset) -> Ready:
        """InputError where the journal has no such table."""
        image = kept_table(job.settings.state_directory, self.run_id, self.role)
        preflight = PreflightResult(_NOTHING, _NOTHING, {}, (), 0.0, 0.0, 0)
        return Ready(job, preflight, lambda means: RestorationRun(job, means, image, self))


class RestorationRun(GuardedRun):
    """Stage, read back, activate, read back; where that fails, what acted acts again."""

    def __init__(self, job: Job, means: Means, image: TableImage | None, wanted: Restoration) -> None:
        super().__init__(job, means)
        self._image = image
        self._wanted = wanted

    def _work(self) -> None:
        found = self._begin()
        self._tracker.enter(RunState.RESTORING)
        if _same(found.table, self._image):
            self._tracker.enter(RunState.COMPLETE, f"bank {found.bank} held that table and acted already")
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
        record = {"of_run": self._wanted.run_id, "role": self._wanted.role, "bank": bank, "crc32": crc32}
        self._journal.decision(DECISION, record)
        text = f"bank {bank} holds the {self._wanted.role} table of run {self._wanted.run_id}{late}"
        self._tracker.enter(RunState.COMPLETE, text)

    def _staged(self, active: int) -> int:
        """The bank that holds it now; bank 0 where no compensation is wanted."""
        if self._image is None:
            return 0
        bank = publish.choose_bank(self._rig.store.store_limits().banks, active)
        self._engine.run(publish.stage_table(bank, self._image))
        return bank


def kept_table(directory: Path, run_id: str, role: str) -> TableImage | None:
    """None where bank 0, no compensation, was kept. InputError where nothing was."""
    path = directory / FILE_NAME
    query = (
        "SELECT origin_mm, step_mm, resolution_mm, shape, counts FROM tables JOIN runs USING (run) "
        "WHERE run_id = ? AND role = ? ORDER BY tables.rowid DESC LIMIT 1"
    )
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=2.0)) as connection:
            row = connection.execute(query, (run_id, role)).fetchone()
    except sqlite3.Error as error:
        raise InputError(f"the journal cannot be read: {error}", file=str(path)) from error
    if row is None:
        raise InputError(f"run {run_id} has kept no {role} table", hint="`/api/tables` lists them", file=str(path))
    return None if row[4] is None else table_from(*row)


def _same(one: TableImage | None, other: TableImage | None) -> bool:
    return one is other if one is None or other is None else one.same_as(other)
