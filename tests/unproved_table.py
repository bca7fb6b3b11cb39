"""The way out of an unproved table: what every link has to show, with a store that refuses some restores, or all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from agent.execution.engine import Engine
from agent.execution.journal import Journal
from agent.execution.rig import Rig
from agent.execution.states import RunState
from agent.probing import publish
from agent.runs.reconcile import compensation_left, reconcile, unproved_table
from agent.runs.reconcile_result import CompensationState, ReconcileAction
from agent.runs.resume.abandon import abandon
from drivers.errors import CommandRejected
from drivers.roles import TableImage


class RefusingStore:
    """Store of a controller that refuses to activate the former bank as often as stated."""

    def __init__(self, store: Any, bank: int) -> None:
        self._store, self._bank, self.refusals = store, bank, 0

    def activate(self, bank: int) -> None:
        if bank == self._bank and self.refusals > 0:
            self.refusals -= 1
            raise CommandRejected("the bank is locked", device="cnc")
        self._store.activate(bank)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._store, name)


def table(rig: Rig, count: int) -> TableImage:
    counts = np.full((2, 2, 2, 3), count, dtype=np.int32)
    return TableImage((0.0, 0.0, 0.0), (4000.0, 1300.0, 1500.0), rig.store.store_limits().resolution_mm, counts)


def left_unproved(rig: Rig, directory: Path) -> str:
    """Leave the machine as a run does that is stopped during the proof and cannot restore; return its identity."""
    rig.store.stage(1, table(rig, 1))
    rig.store.activate(1)
    journal = Journal(directory)
    record = journal.start_run("stopped", "calibrate", {}, "test", rig.clock)
    engine = Engine(rig.actions(), record)
    found = engine.run(publish.read_state("start"))
    record.table("backup", found.bank, found.table)
    written = table(rig, 3)
    engine.run(publish.stage_table(2, written))
    record.table("staged", 2, written)
    engine.run(publish.activate("activate", 2))
    record.state(RunState.ABORTED, "stopped during the proof; the restore failed", final=True)
    journal.close()
    return "stopped"


def assert_restored_in_the_end(rig: Rig, directory: Path) -> None:
    """A restore that fails some times is tried until it works."""
    run_id = left_unproved(rig, directory)
    refusing: Any = rig.store
    refusing.refusals = 3
    for _ in range(3):
        failed = reconcile(rig, directory)
        assert (failed.action, failed.active_bank) == (ReconcileAction.LEFT, 2)
        assert failed.refused == "the bank is locked"
        assert failed.unproved is not None and failed.unproved == unproved_table(directory)
        assert failed.unproved.situation == f"bank 2 is active with a table of run {run_id} that was never proved"
        assert rig.store.active_bank() == 2
    restored = reconcile(rig, directory)
    assert (restored.action, restored.active_bank, rig.store.active_bank()) == (ReconcileAction.RESTORED, 1, 1)
    assert unproved_table(directory) is None
    found = compensation_left(rig, directory)
    assert found is not None and not found.blocks_runs


def assert_given_up_and_settled(rig: Rig, directory: Path) -> None:
    """If a restore never works, giving up names the operator's action, and that action settles it."""
    left_unproved(rig, directory)
    refusing: Any = rig.store
    refusing.refusals = 1000
    given_up = abandon(rig, directory, "test")
    assert (given_up.action, given_up.active_bank) == (ReconcileAction.LEFT, 2)
    left = compensation_left(rig, directory)
    assert left is not None and left.blocks_runs and left.unproved is not None
    assert not left.unproved.provable
    assert "activate bank 1 at the controller" in left.text
    refusing.refusals = 0
    refusing.activate(1)  # by the operator at the controller
    settled = compensation_left(rig, directory)
    assert settled is not None and (settled.state, settled.blocks_runs) == (CompensationState.NOT_ACTIVATED, False)
